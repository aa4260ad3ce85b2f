//! The methods that are scored. In a window none of them takes a rest for zero velocity: that is a prior on speed.

use nalgebra::{Matrix3, Vector3};
use wimu_host::inertial::{Choice, InertialPath, Profile, navigate};
use wimu_host::motion::UnitSample;
use wimu_nav::navigator::{
    Gyroscope, Model, Navigator, NoGyroscope, Sample, Settings, Solution, Start,
};

use crate::baseline::{Filter, POSITION, VELOCITY};
use crate::low_pass::LowPass;
use crate::recording::{Recording, Window};
use crate::score::{Estimate, Track, Whole, Windows};
use crate::walks::{self, Walk};

/// Score of one method.
#[derive(Clone, Debug, Default)]
pub struct Scored {
    pub name: &'static str,
    /// Why the library refused the recording.
    pub refused: Option<String>,
    pub whole: Whole,
    /// Distance of the end from the origin where there is no truth and both are the same point, m.
    pub closure: Option<f64>,
    /// `None`: as those of the method before, which differs in the whole run only.
    pub windows: Option<Windows>,
    /// Walks on a foot.
    pub walks: Vec<Walk>,
}

impl Scored {
    /// Adds the score of another recording.
    pub fn merge(&mut self, other: &Self) {
        self.whole.merge(&other.whole);
        self.walks.extend(other.walks.iter().cloned());
        match (&mut self.windows, &other.windows) {
            (Some(windows), Some(more)) => windows.merge(more),
            (windows @ None, Some(more)) => *windows = Some(more.clone()),
            _ => {}
        }
    }
}

/// The library with a gyroscope: forward filter, and smoothed. Without, where it does not smooth.
pub const WITH_GYROSCOPE: &str = "wimu_gyroscope";
pub const WITHOUT_GYROSCOPE: &str = "wimu_no_gyroscope";
pub const WITH_GYROSCOPE_SMOOTHED: &str = "wimu_gyroscope_smoothed";
pub const ZUPT_FILTER: &str = "zupt_filter";
pub const LOW_PASS: &str = "low_pass";
pub const STAYS: &str = "stays_at_start";

/// Scores every method on a recording: the library with its defaults, then the plain baselines.
pub fn score(recording: &Recording) -> Vec<Scored> {
    let windows = recording.windows();
    let filtered = |gyroscope, name| {
        let windows = library_windows(recording, &windows, gyroscope);
        library(recording, gyroscope, name, Some(windows))
    };
    let mut found = vec![
        filtered(true, WITH_GYROSCOPE),
        library(recording, true, WITH_GYROSCOPE_SMOOTHED, None),
        filtered(false, WITHOUT_GYROSCOPE),
    ];
    found.push(zupt_filter(recording, &windows));
    if recording.has_field() {
        found.push(low_pass(recording, &windows));
    }
    found.push(stays(recording, &windows));
    found
}

fn closure(recording: &Recording, track: &Track) -> Option<f64> {
    let truth = recording.motion.truth.iter().any(Option::is_some);
    let (first, last) = (track.estimates.get(track.origin)?, track.estimates.last()?);
    (!truth).then(|| (last.position - first.position).norm())
}

/// The library: `wimu navigate` on the whole recording, smoothed if its windows are those of the method before.
fn library(
    recording: &Recording,
    gyroscope: bool,
    name: &'static str,
    windows: Option<Windows>,
) -> Scored {
    let mut motion = recording.motion.clone();
    if !gyroscope {
        motion.samples.iter_mut().for_each(|s| s.rate_rad_s = None);
    }
    let choice = Choice {
        profile: recording.settings.profile,
        limit_m: f64::INFINITY,
        smooth: windows.is_none(),
        ..Choice::default()
    };
    match navigate(&motion, &choice) {
        Ok(path) => {
            let track = track(&path);
            Scored {
                name,
                whole: Whole::of(recording, &track, &track),
                closure: closure(recording, &track),
                walks: walk(recording, &track),
                windows,
                refused: None,
            }
        }
        Err(error) => Scored {
            name,
            refused: Some(error.to_string()),
            whole: Whole::refused(recording),
            windows,
            ..Scored::default()
        },
    }
}

fn walk(recording: &Recording, track: &Track) -> Vec<Walk> {
    let on_foot = recording.settings.profile == Profile::Foot;
    let scored = on_foot.then(|| walks::score(recording, track));
    scored.flatten().into_iter().collect()
}

fn matrix(rows: [[f64; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|r, c| rows[r][c])
}

fn heading([w, x, y, z]: [f64; 4]) -> f64 {
    (2.0 * (x * y + w * z)).atan2(1.0 - 2.0 * (y * y + z * z))
}

fn track(path: &InertialPath) -> Track {
    let estimates = path.points.iter().map(|point| {
        let velocity_variance = Vector3::from(point.velocity_sd_mps).map(|s| s * s);
        Estimate {
            position: point.position_m.into(),
            velocity: point.velocity_mps.into(),
            heading: heading(point.quaternion),
            position_covariance: Some(matrix(point.covariance_m2)),
            velocity_covariance: Some(Matrix3::from_diagonal(&velocity_variance)),
            valid: point.valid,
        }
    });
    Track { origin: path.origin, estimates: estimates.collect() }
}

/// Standard deviations of position, m, velocity, m/s, and heading, rad, at the start of a window: those of the truth.
const WINDOW_START: [f64; 3] = [0.002, 0.02, 0.005];

fn library_windows(recording: &Recording, windows: &[Window], gyroscope: bool) -> Windows {
    let ends = match gyroscope {
        true => window_ends::<Gyroscope<f64>, 40>(recording, windows),
        false => window_ends::<NoGyroscope<f64>, 24>(recording, windows),
    };
    Windows::of(recording, windows, &ends)
}

/// Windows of the navigator, which runs on from the start of the recording. Rests of the windows are not used.
fn window_ends<M: Model<f64, N> + Clone, const N: usize>(
    recording: &Recording,
    windows: &[Window],
) -> Vec<[Estimate; 3]> {
    let samples: Vec<Sample<f64>> = recording.motion.samples.iter().map(sample).collect();
    let (force, rate) = vectors(recording);
    let at_rest = recording.settings.detector.detect(&force, &rate);
    let count = recording.settings.start_samples.min(samples.len());
    let rest = at_rest[..count].iter().any(|rest| *rest);
    let Some(begin) = Start::align(&samples[..count], rest) else {
        return Vec::new();
    };
    let settings = Settings::of(recording.settings.profile);
    let Ok(mut navigator) = Navigator::<f64, M, N>::new(settings, &begin) else {
        return Vec::new();
    };
    if let Some(heading) = (0..samples.len()).find_map(|k| recording.heading(k)) {
        navigator.set_heading(heading);
    }
    let mut ends = Vec::new();
    let mut next = windows.iter().peekable();
    for k in 0..samples.len() {
        // A sample that is not usable grows the covariance.
        let _ = navigator.push(&samples[k], at_rest[k]);
        if let Some(window) = next.next_if(|w| w.start == k)
            && let Some((position, velocity, heading)) = start(recording, k)
        {
            let mut navigator = navigator.clone();
            navigator.set_pose(position, velocity, heading, WINDOW_START);
            let mut at = k;
            ends.push(window.ends.map(|end| {
                while at < end {
                    at += 1;
                    let _ = navigator.push(&samples[at], false);
                }
                estimate(&navigator.solution())
            }));
        }
    }
    ends
}

/// True position, velocity and heading.
fn start(recording: &Recording, k: usize) -> Option<(Vector3<f64>, Vector3<f64>, f64)> {
    Some((recording.position(k)?, recording.velocity(k)?, recording.heading(k)?))
}

fn sample(sample: &UnitSample) -> Sample<f64> {
    Sample {
        step_s: sample.step_s,
        force_mps2: sample.force_mps2.into(),
        rate_rad_s: sample.rate_rad_s.map(Into::into),
        field_ut: sample.field_ut.map(Into::into),
    }
}

fn estimate(solution: &Solution<f64>) -> Estimate {
    Estimate {
        position: solution.position_m.into(),
        velocity: solution.velocity_mps.into(),
        heading: heading(solution.quaternion),
        position_covariance: Some(matrix(solution.position_covariance)),
        velocity_covariance: Some(matrix(solution.velocity_covariance)),
        valid: true,
    }
}

/// The plain error-state filter with zero-velocity updates.
fn zupt_filter(recording: &Recording, windows: &[Window]) -> Scored {
    let (force, rate) = vectors(recording);
    let at_rest = recording.settings.detector.detect(&force, &rate);
    let (track, nis, ends) = run_zupt_filter(recording, windows, &at_rest);
    let mut whole = Whole::of(recording, &track, &track);
    whole.non_finite += nis.iter().filter(|n| !n.is_finite()).count();
    whole.nis = nis.into_iter().filter(|n| n.is_finite()).collect();
    Scored {
        name: ZUPT_FILTER,
        whole,
        closure: closure(recording, &track),
        walks: walk(recording, &track),
        windows: Some(Windows::of(recording, windows, &ends)),
        refused: None,
    }
}

/// Specific force, m/s², and angular rate, rad/s, of every sample.
pub fn vectors(recording: &Recording) -> (Vec<Vector3<f64>>, Vec<Vector3<f64>>) {
    let samples = recording.motion.samples.iter();
    let rate = |rate: Option<[f64; 3]>| Vector3::from(rate.unwrap_or_default());
    samples.map(|s| (Vector3::from(s.force_mps2), rate(s.rate_rad_s))).unzip()
}

/// Estimates at every sample, NIS of every zero-velocity update, and estimates at the ends of the windows.
pub fn run_zupt_filter(
    recording: &Recording,
    windows: &[Window],
    at_rest: &[bool],
) -> (Track, Vec<f64>, Vec<[Estimate; 3]>) {
    let samples = &recording.motion.samples;
    let (force, rate) = vectors(recording);
    let settings = recording.settings;
    let step = |filter: &mut Filter, k: usize| {
        let mean = |v: &[Vector3<f64>]| {
            if settings.mean_of_two { 0.5 * (v[k - 1] + v[k]) } else { v[k] }
        };
        // Time stamps that repeat have no step.
        if samples[k].step_s > 0.0 {
            filter.predict(mean(&force), mean(&rate), samples[k].step_s);
        }
    };
    let mut filter = Filter::align(&force, &rate, settings);
    let (mut track, mut nis, mut ends) = (Track::default(), Vec::new(), Vec::new());
    let mut next = windows.iter().peekable();
    for k in 0..samples.len() {
        if k > 0 {
            step(&mut filter, k);
            if at_rest[k] {
                nis.push(filter.update_zero_velocity());
            }
        }
        track.estimates.push(filter_estimate(&filter));
        if let Some(window) = next.next_if(|w| w.start == k)
            && let Some((position, velocity, heading)) = start(recording, k)
        {
            let mut filter = filter.clone();
            filter.set_start(position, velocity, heading);
            let mut at = k;
            ends.push(window.ends.map(|end| {
                while at < end {
                    at += 1;
                    step(&mut filter, at);
                }
                filter_estimate(&filter)
            }));
        }
    }
    (track, nis, ends)
}

fn filter_estimate(filter: &Filter) -> Estimate {
    let block = |at| filter.covariance.fixed_view::<3, 3>(at, at).into_owned();
    Estimate {
        position: filter.position,
        velocity: filter.velocity,
        heading: filter.heading(),
        position_covariance: Some(block(POSITION)),
        velocity_covariance: Some(block(VELOCITY)),
        valid: true,
    }
}

fn without_covariance(position: Vector3<f64>, velocity: Vector3<f64>, heading: f64) -> Estimate {
    Estimate {
        position,
        velocity,
        heading,
        position_covariance: None,
        velocity_covariance: None,
        valid: true,
    }
}

/// The attitude of low-passed accelerometer and magnetometer, as in `bench_nav`.
fn low_pass(recording: &Recording, windows: &[Window]) -> Scored {
    let motion = &recording.motion;
    let gravity = motion.first_rest_mps2().unwrap_or(motion.gravity_mps2());
    let low_pass = LowPass::of(motion, gravity);
    let times = recording.times_s();
    let run = |window: &Window| {
        let (p, v, heading) = start(recording, window.start)?;
        let yaw = heading - low_pass.headings[window.start];
        let (mut at, mut state) = (window.start, (p.into(), v.into()));
        Some(window.ends.map(|end| {
            state = low_pass.integrate(times, at, end, yaw, state);
            at = end;
            without_covariance(state.0.into(), state.1.into(), low_pass.headings[end] + yaw)
        }))
    };
    let ends: Vec<[Estimate; 3]> = windows.iter().filter_map(run).collect();
    let mut track = Track::default();
    let mut state = ([0.0; 3], [0.0; 3]);
    for k in 0..motion.samples.len() {
        state = low_pass.integrate(times, k.saturating_sub(1), k, 0.0, state);
        let heading = low_pass.headings[k];
        track.estimates.push(without_covariance(state.0.into(), state.1.into(), heading));
    }
    Scored {
        name: LOW_PASS,
        whole: Whole::of(recording, &track, &track),
        windows: Some(Windows::of(recording, windows, &ends)),
        ..Scored::default()
    }
}

/// "Stays at the start point."
fn stays(recording: &Recording, windows: &[Window]) -> Scored {
    let rest = |position| without_covariance(position, Vector3::zeros(), 0.0);
    let at_start = |w: &Window| Some([rest(recording.position(w.start)?); 3]);
    let ends: Vec<[Estimate; 3]> = windows.iter().filter_map(at_start).collect();
    let estimates = vec![rest(Vector3::zeros()); recording.moving.len()];
    let track = Track { origin: 0, estimates };
    Scored {
        name: STAYS,
        whole: Whole::of(recording, &track, &track),
        windows: Some(Windows::of(recording, windows, &ends)),
        ..Scored::default()
    }
}
