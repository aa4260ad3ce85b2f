//! Recordings with a true path, and which of their samples and windows are scored.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use wimu_host::motion::{MotionRecording, Truth, sampled_times};

use crate::settings::Settings;

/// Windows are scored so long after their start, s.
pub const HORIZONS_S: [f64; 3] = [1.0, 2.0, 5.0];
/// A window begins at a whole second whose next 2 s move.
const MOVING_FOR_S: f64 = 2.0;
/// A sample moves if the truth is faster than this, m/s, over 0.2 s.
const MOVING_MPS: f64 = 0.05;
const MOVING_HALF_S: f64 = 0.1;
/// The shortest rest at which the error of a whole run is scored, s.
const REST_S: f64 = 1.0;
/// The truth of the robot arm is so much later than the sensor's samples, s (data/README.md).
const ROBOT_TRUTH_LAG_S: f64 = 0.09;

/// How well a truth is known, and how it is differentiated.
#[derive(Clone, Copy, Debug)]
pub struct TruthModel {
    /// Standard deviations of a component, m and m/s: added to every covariance that is scored.
    pub position: f64,
    pub velocity: f64,
    /// The true velocity is the mean over so much before and after, s, and at least one sample.
    pub half_s: f64,
}

/// Optical tracker of BROAD: foot.py and reference/estimator state 1 mm and 0.02 m/s.
const OPTICAL: TruthModel = TruthModel { position: 0.001, velocity: 0.02, half_s: 0.0 };
/// The pyshoe files are rounded to 0.1 mm at 5 ms.
const VICON: TruthModel = TruthModel { position: 0.001, velocity: 0.02, half_s: 0.02 };
/// 15 Hz interpolated; a lag that is wrong by 20 ms is 10 mm at 0.5 m/s.
const ROBOT: TruthModel = TruthModel { position: 0.01, velocity: 0.05, half_s: 1.0 / 15.0 };
/// Simulated: 1 mm as of a tracker, and the error of the central difference, which is up to 3 mm/s in a step.
pub const SIMULATED: TruthModel = TruthModel { position: 0.001, velocity: 0.002, half_s: 0.0 };

/// A recording of one unit with its truth.
pub struct Recording {
    pub name: String,
    /// Samples with their truth, right-handed, body to navigation frame, at the sensor's times.
    pub motion: MotionRecording,
    pub settings: Settings,
    pub truth: TruthModel,
    /// Whether each sample moves: only these are scored.
    pub moving: Vec<bool>,
}

/// Start and ends of a window, as indices of samples.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    pub start: usize,
    pub ends: [usize; 3],
}

impl Recording {
    /// A recording whose moving samples follow from its column `Moving`, else from the speed of its truth.
    pub fn new(motion: MotionRecording, settings: Settings, truth: TruthModel) -> Self {
        let mut recording =
            Self { name: motion.name.clone(), motion, settings, truth, moving: Vec::new() };
        let label = recording.motion.column("Moving").map(<[f64]>::to_vec);
        let moves = |k: usize| match &label {
            Some(label) => label[k] > 0.5,
            None => {
                recording.mean_velocity(k, MOVING_HALF_S).is_some_and(|v| v.norm() > MOVING_MPS)
            }
        };
        recording.moving = (0..recording.motion.samples.len()).map(moves).collect();
        recording
    }

    pub fn times_s(&self) -> &[f64] {
        &self.motion.times_s
    }

    /// True position, m.
    pub fn position(&self, k: usize) -> Option<Vector3<f64>> {
        self.motion.truth.get(k)?.map(|t| Vector3::from(t.position_m))
    }

    /// True direction of body x from east to north, rad.
    pub fn heading(&self, k: usize) -> Option<f64> {
        self.motion.truth.get(k)?.map(|t| t.heading_rad()).filter(|h| h.is_finite())
    }

    pub fn has_heading(&self) -> bool {
        (0..self.moving.len()).any(|k| self.heading(k).is_some())
    }

    pub fn has_field(&self) -> bool {
        self.motion.samples.iter().any(|s| s.field_ut.is_some())
    }

    /// True velocity, m/s.
    pub fn velocity(&self, k: usize) -> Option<Vector3<f64>> {
        self.mean_velocity(k, self.truth.half_s)
    }

    /// Mean true velocity over `half_s` before and after, m/s; at least from the sample before to that after.
    fn mean_velocity(&self, k: usize, half_s: f64) -> Option<Vector3<f64>> {
        let times = self.times_s();
        let before = times.partition_point(|t| *t < times[k] - half_s).min(k.checked_sub(1)?);
        let after = times.partition_point(|t| *t < times[k] + half_s).clamp(k + 1, times.len());
        let moved = self.position(after)? - self.position(before)?;
        Some(moved / (times[after] - times[before]))
    }

    /// Windows at whole seconds whose next 2 s move, with truth at the start and at every horizon. None where the truth
    /// has no attitude: the heading at the start is not known.
    pub fn windows(&self) -> Vec<Window> {
        let times = self.times_s();
        let index = |t: f64| times.partition_point(|x| *x < t);
        let mut found = Vec::new();
        let mut second = times[0].ceil();
        while second + 5.1 < times[times.len() - 1] {
            let start = index(second);
            let ends = HORIZONS_S.map(|h| index(times[start] + h));
            let moves = self.moving[start..index(second + MOVING_FOR_S)].iter().all(|m| *m);
            let known = self.velocity(start).is_some() && self.heading(start).is_some();
            if moves && known && ends.iter().all(|k| self.position(*k).is_some()) {
                found.push(Window { start, ends });
            }
            second += 1.0;
        }
        found
    }

    /// The middle of the last rest of a second and more after a motion, at which there is truth.
    pub fn last_rest(&self) -> Option<usize> {
        let times = self.times_s();
        let first = self.moving.iter().position(|m| *m)?;
        let mut end = self.moving.len();
        while end > first {
            let begin = self.moving[..end].iter().rposition(|m| *m)? + 1;
            let known: Vec<usize> = (begin..end).filter(|k| self.position(*k).is_some()).collect();
            if let (Some(a), Some(b)) = (known.first(), known.last())
                && times[*b] - times[*a] >= REST_S
            {
                return Some(known[known.len() / 2]);
            }
            end = begin - 1;
        }
        None
    }
}

/// The recordings of a data folder, sorted by name. A message for each that is missing.
pub fn load(data: &Path, wanted: impl Fn(&str) -> bool) -> (Vec<Recording>, Vec<String>) {
    let (mut found, mut messages) = (Vec::new(), Vec::new());
    for (folder, prefix, count) in [
        ("motion", "broad_", 4),
        ("motion", "robot_arm_", 4),
        ("gait", "pyshoe_2", 14),
        ("gait", "xio_", 1),
    ] {
        let files = files(&data.join(folder), prefix);
        if files.len() != count {
            messages.push(format!(
                "{}: {} of {count} recordings {prefix}* found",
                data.join(folder).display(),
                files.len()
            ));
        }
        for file in files {
            let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            if !wanted(&name) {
                continue;
            }
            match MotionRecording::from_csv(&file) {
                Ok(mut motion) => {
                    motion.name = name;
                    found.push(prepared(motion));
                }
                Err(error) => messages.push(format!("{name}: not readable: {error}")),
            }
        }
    }
    (found, messages)
}

fn files(folder: &Path, prefix: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files: Vec<PathBuf> = entries.map(|e| e.path()).collect();
    files.retain(|f| {
        let name = f.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with(prefix) && name.ends_with(".csv")
    });
    files.sort();
    files
}

/// Brings the truth of a recording to the project's conventions.
fn prepared(mut motion: MotionRecording) -> Recording {
    let name = motion.name.clone();
    if name.starts_with("robot_arm_") {
        let sampled = sampled_times(&motion.times_s).unwrap_or(motion.times_s.clone());
        motion.truth = robot_truth(&motion, &sampled);
        for (sample, pair) in motion.samples.iter_mut().skip(1).zip(sampled.windows(2)) {
            sample.step_s = pair[1] - pair[0];
        }
        motion.times_s = sampled;
        Recording::new(motion, Settings::HAND, ROBOT)
    } else if name.starts_with("pyshoe_") {
        // Left-handed truth.
        for truth in motion.truth.iter_mut().flatten() {
            truth.position_m[1] = -truth.position_m[1];
        }
        Recording::new(motion, Settings::FOOT, VICON)
    } else if name.starts_with("xio_") {
        Recording::new(motion, Settings::FOOT, VICON)
    } else {
        Recording::new(motion, Settings::HAND, OPTICAL)
    }
}

/// Truth of the robot arm at the sensor's times: its lag taken off by linear interpolation, its quaternion inverted.
fn robot_truth(motion: &MotionRecording, sampled_s: &[f64]) -> Vec<Option<Truth>> {
    let times = &motion.times_s;
    let at = |t: &f64| {
        let late = t + ROBOT_TRUTH_LAG_S;
        let after = times.partition_point(|x| *x < late);
        let (a, b) = ((*motion.truth.get(after.checked_sub(1)?)?)?, (*motion.truth.get(after)?)?);
        let share = (late - times[after - 1]) / (times[after] - times[after - 1]);
        let between = |a: f64, b: f64| a + share * (b - a);
        let dot: f64 = a.quaternion.iter().zip(b.quaternion).map(|(a, b)| a * b).sum();
        let mixed: [f64; 4] =
            std::array::from_fn(|i| between(a.quaternion[i], dot.signum() * b.quaternion[i]));
        let norm = mixed.iter().map(|q| q * q).sum::<f64>().sqrt();
        let [w, x, y, z] = mixed.map(|q| q / norm);
        Some(Truth {
            position_m: std::array::from_fn(|i| between(a.position_m[i], b.position_m[i])),
            quaternion: [w, -x, -y, -z],
        })
    };
    sampled_s.iter().map(at).collect()
}
