//! An array's calibration from the rests in its own recording, or as it is stored.

use nalgebra::{Matrix3, Vector3};
use wimu_calib::{Estimate, Gravity, Model, Pose, find_poses, multi_position};
use wimu_model::{ErrorModel, STANDARD_GRAVITY_MPS2, SpecificForceMps2};

use super::departures::Departure;
use super::motion::check;
use super::rests::{EvenTurn, REST_BIAS_MPS2, judged};
use super::{ArrayGeometry, ArrayRecording};
use crate::{ErrorCode, HostError, Result};

/// Poses that a recording may have.
const MOST_POSES: usize = 256;
/// A sensor lives through a rest that has output in each part of so many samples.
const PART_SAMPLES: usize = 16;
/// Noise that is assumed where there is no rest to see it, m/s².
const ASSUMED_NOISE_MPS2: f64 = 0.05;

/// Bias that is left of a calibrated axis, m/s².
pub(super) const BIAS_MPS2: f64 = 0.02;
/// Error of sensitivity and direction of an uncalibrated axis, at least.
pub(super) const LEAST_SCALE: f64 = 0.002;
/// No sensor's sensitivities and directions are wrong by so much: its axes, or its model, are others than given.
pub(super) const MOST_SCALE: f64 = 0.05;
/// A sensor with a model of its own that departs by more than this at the rests, m/s², may have another's.
const DOUBTFUL_MPS2: f64 = 0.5;

/// An array's calibration from the rests in its own recording.
#[derive(Clone, Debug)]
pub struct ArrayCalibration {
    /// Each sensor's error model and the small turn from its axes to the body's, rad.
    pub sensors: Vec<(ErrorModel, [f64; 3])>,
    /// Noise of each sensor at rest, m/s² an axis.
    pub noise_mps2: Vec<f64>,
    /// The rests, as first sample and number of samples.
    pub rests: Vec<(usize, usize)>,
    /// What looks like rests in the mean of the sensors while they turn evenly, which shows among them.
    pub turns: Vec<EvenTurn>,
    /// An even turn about the vertical that is slower, rad/s, looks like a rest to this array: that there
    /// was none is assumed. `None` where the places show no angular rate.
    pub unseen_rad_s: Option<f64>,
    /// What the sensors disagree by at the rests after all, m/s² rms an axis.
    pub disagreement_mps2: f64,
    /// Standard deviation of the bias that is left of each axis, m/s².
    pub bias_mps2: f64,
    /// The same of its sensitivity, as a share, and direction, rad.
    pub scale: f64,
    /// The same of the mean of all sensors.
    pub common_scale: f64,
    /// How well each coordinate of a place is known, m: [`PLACE_SD_M`](Self::PLACE_SD_M) unless set.
    pub place_sd_m: f64,
    /// What the size of the whole adds to that where it was found from the motion, m.
    pub size_sd_m: f64,
    /// How well the sensors' times among each other are known, s: [`DELAY_SD_S`](Self::DELAY_SD_S) unless set.
    pub delay_sd_s: f64,
    /// Why the error models are those of perfect sensors, where they are.
    pub uncalibrated: Option<String>,
    /// Whether the geometry had an error model of each sensor, so that none was fitted.
    pub stored: bool,
    /// What came of the fit of each sensor; `None` where there was none.
    pub estimates: Vec<Option<Estimate>>,
    /// Sensors that are of no use, and why.
    pub left_out: Vec<(usize, String)>,
    /// What each sensor that is used departs from the mean of all by, m/s² rms, before the rests' departures were
    /// taken into the models.
    apart_mps2: Vec<(usize, f64)>,
    /// Mean force at each rest, m/s².
    rest_forces: Vec<[f64; 3]>,
    /// What each sensor still adds at each rest, m/s².
    offsets: Vec<Vec<[f64; 3]>>,
}

impl ArrayCalibration {
    /// How well a place is known where nobody says it, m.
    pub const PLACE_SD_M: f64 = 5e-4;
    /// How well the sensors' times among each other are known where nobody says it, s.
    pub const DELAY_SD_S: f64 = 3e-4;

    /// From the accelerometers alone, in body axes: the rests are where the mean of all sensors is steady
    /// and they agree with each other as at every other rest, each sensor is fitted to gravity (9
    /// parameters), then turned to agree with the others. A sensor that is dead, or is the only one that
    /// cannot be fitted, is left out; one that fails on the way counts as long as it lives. Sensors of which the
    /// geometry has an error model were corrected by [`ArrayRecording::arranged`] and are not fitted.
    ///
    /// # Errors
    /// `data_refused` when there is no rest at all, or no sensor is alive; `usage` when the geometry has
    /// another number of sensors, or more than 16.
    pub fn of(
        recording: &ArrayRecording,
        geometry: &ArrayGeometry,
        gravity: Gravity,
    ) -> Result<Self> {
        check(recording, geometry)?;
        let sensors = recording.sensors();
        let refused = |message: &str, remedy: &str| {
            HostError::new(ErrorCode::DataRefused, message, remedy).at(&recording.name)
        };
        let mut left_out: Vec<(usize, String)> = (0..sensors)
            .filter(|sensor| is_dead(recording, *sensor))
            .map(|sensor| (sensor, "its output never moves".to_owned()))
            .collect();
        if left_out.len() == sensors {
            return Err(refused(
                "no sensor's output moves",
                "check the sensors and the sensitivity",
            ));
        }
        let dead: Vec<usize> = left_out.iter().map(|(sensor, _)| *sensor).collect();
        let stretches = steady_stretches(recording, &dead);
        // Judged by the sensors that live through all of them.
        let lives: Vec<bool> = (0..sensors)
            .map(|sensor| {
                let seen = |span: &(usize, usize)| is_throughout(recording, sensor, *span);
                !dead.contains(&sensor) && stretches.iter().all(seen)
            })
            .collect();
        let judged = judged(recording, geometry, &stretches, &lives)?;
        let rests = judged.rests;
        if rests.is_empty() {
            return Err(if judged.turns.is_empty() {
                refused(
                    "there is no rest in the recording, so neither biases nor gravity are known",
                    "hold the array still for two seconds, in several orientations",
                )
            } else {
                refused(
                    "wherever the sensors are steady they show an even turn, so there is no rest, and \
                     neither biases nor gravity are known",
                    "hold the array still for two seconds, in several orientations; check the places of \
                     the sensors",
                )
            });
        }
        let per_sensor: Vec<Vec<Option<Pose>>> = (0..sensors)
            .map(|sensor| {
                let of_rest = |rest: &(usize, usize)| pose(recording, sensor, *rest);
                rests.iter().map(of_rest).collect()
            })
            .collect();
        let seen = |sensor: usize| per_sensor[sensor].iter().flatten();
        for sensor in 0..sensors {
            if !dead.contains(&sensor) && seen(sensor).next().is_none() {
                left_out.push((sensor, "it has no output at any rest".to_owned()));
            }
        }
        let noise_mps2 = (0..sensors)
            .map(|sensor| {
                let square = |p: &Pose| p.sd_mps2.iter().map(|s| s * s).sum::<f64>() / 3.0;
                let count = seen(sensor).count().max(1) as f64;
                let noise = (seen(sensor).map(square).sum::<f64>() / count).sqrt();
                if noise > 0.0 {
                    noise
                } else {
                    ASSUMED_NOISE_MPS2
                }
            })
            .collect();
        let mut models = vec![ErrorModel::default(); sensors];
        let mut estimates = vec![None; sensors];
        let mut refusals = Vec::new();
        let alive: Vec<usize> = (0..sensors)
            .filter(|sensor| left_out.iter().all(|(out, _)| out != sensor))
            .collect();
        let candidates: Vec<usize> = alive
            .iter()
            .copied()
            .filter(|sensor| geometry.sensors[*sensor].model.is_none())
            .collect();
        let stored = candidates.is_empty();
        for sensor in &candidates {
            let poses: Vec<Pose> = seen(*sensor).copied().collect();
            match multi_position(&poses, gravity, Model::Full9) {
                Ok(estimate) => {
                    models[*sensor] = estimate.model;
                    estimates[*sensor] = Some(estimate);
                }
                Err(refusal) => refusals.push((*sensor, refusal.to_string())),
            }
        }
        // What most of them cannot be fitted to is the recording's fault, not theirs.
        let mut uncalibrated = None;
        if refusals.len() * 2 > candidates.len() {
            uncalibrated = refusals.first().map(|(_, why)| why.clone());
            models = vec![ErrorModel::default(); sensors];
            estimates = vec![None; sensors];
        } else {
            left_out.extend(refusals);
        }
        let used: Vec<usize> = (0..sensors)
            .filter(|sensor| left_out.iter().all(|(out, _)| out != sensor))
            .collect();
        let mut forces: Vec<Vec<Option<[f64; 3]>>> = models
            .iter()
            .zip(&per_sensor)
            .map(|(model, poses)| {
                let force = |p: &Pose| model.correct(SpecificForceMps2(p.mean_mps2), None).0;
                poses.iter().map(|p| p.as_ref().map(force)).collect()
            })
            .collect();
        let mut turns = vec![[0.0; 3]; sensors];
        if uncalibrated.is_none() && !stored {
            let chosen: Vec<Vec<Option<[f64; 3]>>> =
                used.iter().map(|k| forces[*k].clone()).collect();
            for (sensor, small) in used.iter().zip(align(&chosen)) {
                turns[*sensor] = small;
            }
        }
        let mut calibration = Self {
            sensors: models.into_iter().zip(turns).collect(),
            noise_mps2,
            rests,
            turns: judged.turns,
            unseen_rad_s: judged.unseen_rad_s,
            disagreement_mps2: 0.0,
            bias_mps2: BIAS_MPS2,
            scale: 0.0,
            common_scale: 0.0,
            place_sd_m: Self::PLACE_SD_M,
            size_sd_m: 0.0,
            delay_sd_s: Self::DELAY_SD_S,
            uncalibrated,
            stored,
            estimates,
            left_out,
            apart_mps2: Vec::new(),
            rest_forces: Vec::new(),
            offsets: Vec::new(),
        };
        calibration.rest_forces = (0..calibration.rests.len())
            .map(|rest| mean(used.iter().filter_map(|k| forces[*k][rest])))
            .collect();
        let mut offsets = departures(&forces, &calibration, &used);
        let of_used = || {
            offsets
                .iter()
                .flat_map(|all| used.iter().filter_map(|k| all[*k]))
        };
        let squares = of_used().flatten().map(|o| o * o).sum::<f64>();
        let values = 3.0 * of_used().count() as f64;
        calibration.disagreement_mps2 = (squares / f64::max(values, 1.0)).sqrt();
        if calibration.uncalibrated.is_some() || stored {
            let count = used.len() as f64;
            let apart = calibration.disagreement_mps2 * (count / f64::max(count - 1.0, 1.0)).sqrt();
            calibration.bias_mps2 = apart.max(BIAS_MPS2);
            // In one orientation a bias and an error of scale are one.
            calibration.scale = scale_of(&offsets, &forces, &used)
                .unwrap_or(apart / STANDARD_GRAVITY_MPS2)
                .max(LEAST_SCALE);
            calibration.apart_mps2 = used.iter().map(|k| (*k, apart_of(*k, &offsets))).collect();
            if calibration.scale < MOST_SCALE {
                calibration.learn(&mut forces, &offsets, &used);
                offsets = departures(&forces, &calibration, &used);
            }
        }
        // A rest at which a sensor gave nothing says nothing about it: that before it counts, or the first.
        for sensor in 0..sensors {
            let mut last = offsets.iter().find_map(|all| all[sensor]);
            for all in &mut offsets {
                last = all[sensor].or(last);
                all[sensor] = last;
            }
        }
        calibration.offsets = offsets
            .iter()
            .map(|all| all.iter().map(|o| o.unwrap_or_default()).collect())
            .collect();
        Ok(calibration)
    }

    /// Takes what the rests tell of each sensor's departures from the mean of all into its model; what they do not
    /// tell stays in `scale`: equation (108).
    fn learn(
        &mut self,
        forces: &mut [Vec<Option<[f64; 3]>>],
        departures: &[Vec<Option<[f64; 3]>>],
        used: &[usize],
    ) {
        let (bias, scale) = (self.bias_mps2, self.scale);
        let mut left = Vec::new();
        for sensor in used {
            let seen = (self.rest_forces.iter().zip(departures))
                .filter_map(|(force, all)| Some((*force, all[*sensor]?)));
            let found = Departure::of(seen, bias, scale, REST_BIAS_MPS2);
            // Beyond what a model holds it is no sensor's error.
            let Some(model) = found.model() else { continue };
            self.sensors[*sensor].0 = model;
            for force in forces[*sensor].iter_mut().flatten() {
                *force = model.correct(SpecificForceMps2(*force), None).0;
            }
            left.push(found);
        }
        // In any direction alike.
        let variance = left.iter().map(Departure::mean_variance).sum::<f64>();
        if !left.is_empty() {
            self.scale = (variance / left.len() as f64).sqrt();
        }
        let learnt = scale * scale - self.scale * self.scale;
        self.common_scale = (learnt / used.len().max(1) as f64).sqrt();
    }

    /// What the force at sample `index` is beyond that at the rest before, m/s².
    pub(super) fn changed(&self, index: usize, force: [f64; 3]) -> [f64; 3] {
        let rest = self.rest_forces[self.offset_of(index)];
        std::array::from_fn(|i| force[i] - rest[i])
    }

    /// Mean length of the mean output at the rests, m/s².
    pub fn mean_rest_mps2(&self, recording: &ArrayRecording) -> f64 {
        let length = |rest: &(usize, usize)| {
            let used = (0..recording.sensors()).filter(|sensor| self.uses(*sensor));
            let force = mean(used.filter_map(|k| Some(pose(recording, k, *rest)?.mean_mps2)));
            force.iter().map(|f| f * f).sum::<f64>().sqrt()
        };
        self.rests.iter().map(length).sum::<f64>() / self.rests.len() as f64
    }

    /// What was assumed, found wrong and left out.
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        if let Some(fastest) = self.turns.iter().map(|t| t.rate_rad_s).reduce(f64::max) {
            remarks.push(format!(
                "{} stretches with a steady mean are no rests: among each other the sensors show an even turn, \
                 at up to {fastest:.1} rad/s",
                self.turns.len()
            ));
        }
        if let Some(unseen) = self.unseen_rad_s {
            let rests = match self.rests.len() {
                1 => "the one rest".to_owned(),
                many => format!("the {many} rests"),
            };
            remarks.push(format!(
                "that the array did not turn evenly about the vertical at {rests} is assumed: below \
                 {unseen:.1} rad/s it would look the same"
            ));
        }
        if let Some(why) = &self.uncalibrated {
            remarks.push(format!(
                "the array is not calibrated: {why}. As its sensors differ, biases of ± {:.3} m/s² are allowed for; \
                 what the rests tell of each one is taken off, which leaves sensitivities and directions wrong by ± {:.2} %. \
                 Rests in a dozen orientations tell all: `wimu calibrate RESTS.csv --geometry PLACES.csv -o ARRAY.json`",
                self.bias_mps2,
                self.scale * 100.0
            ));
        }
        if self.stored {
            remarks.push(format!(
                "the sensors have error models of their own: at the rests they differ by {:.3} m/s² after all, so that \
                 biases of ± {:.3} m/s² and sensitivities and directions wrong by ± {:.2} % are allowed for",
                self.disagreement_mps2,
                self.bias_mps2,
                self.scale * 100.0
            ));
            if let Some((sensor, apart)) = self.farthest()
                && apart > DOUBTFUL_MPS2
            {
                remarks.push(format!(
                    "sensor {sensor} (from 0) departs by {apart:.2} m/s² from the others at the rests: is its error model \
                     that of this sensor, and given in its place?"
                ));
            }
        }
        for (sensor, why) in &self.left_out {
            remarks.push(format!("sensor {sensor} (from 0) is left out: {why}"));
        }
        remarks
    }

    /// The sensor that departs most from the mean of all at the rests, and by how much, m/s² rms.
    fn farthest(&self) -> Option<(usize, f64)> {
        let all = self.apart_mps2.iter().copied();
        all.max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The rest whose departures are taken off sample `index`: the latest before it, or the first.
    pub(super) fn offset_of(&self, index: usize) -> usize {
        let rest = self.rests.partition_point(|(first, _)| *first <= index);
        rest.saturating_sub(1)
    }

    /// Whether a sensor is of use.
    pub fn uses(&self, sensor: usize) -> bool {
        self.left_out.iter().all(|(out, _)| *out != sensor)
    }

    /// Specific force of sensor `sensor` in body axes, m/s², without what it added at the latest rest
    /// before sample `index`: that part of its bias which the other sensors show.
    pub fn force(&self, sensor: usize, output_mps2: [f64; 3], index: usize) -> [f64; 3] {
        self.force_since(sensor, output_mps2, self.offset_of(index))
    }

    /// The same without what it added at rest `rest`.
    pub(super) fn force_since(
        &self,
        sensor: usize,
        output_mps2: [f64; 3],
        rest: usize,
    ) -> [f64; 3] {
        let Some((model, small)) = self.sensors.get(sensor) else {
            return output_mps2;
        };
        let force = turn(
            model.correct(SpecificForceMps2(output_mps2), None).0,
            *small,
        );
        let offset = self.offsets[rest][sensor];
        core::array::from_fn(|axis| force[axis] - offset[axis])
    }
}

/// By how much each sensor departs from the mean of those that are used, at each rest, m/s².
fn departures(
    forces: &[Vec<Option<[f64; 3]>>],
    calibration: &ArrayCalibration,
    used: &[usize],
) -> Vec<Vec<Option<[f64; 3]>>> {
    (0..calibration.rests.len())
        .map(|rest| {
            let turned: Vec<Option<[f64; 3]>> = (forces.iter().zip(&calibration.sensors))
                .map(|(forces, (_, small))| Some(turn(forces[rest]?, *small)))
                .collect();
            let mean = mean(used.iter().filter_map(|k| turned[*k]));
            let from_mean = |f: [f64; 3]| std::array::from_fn(|axis| f[axis] - mean[axis]);
            turned
                .into_iter()
                .map(|force| force.map(from_mean))
                .collect()
        })
        .collect()
}

/// How far a sensor departs from the mean at the rests, m/s² rms.
fn apart_of(sensor: usize, departures: &[Vec<Option<[f64; 3]>>]) -> f64 {
    let seen = || departures.iter().filter_map(|all| all[sensor]);
    let squares = seen().flatten().map(|o| o * o).sum::<f64>();
    (squares / seen().count().max(1) as f64).sqrt()
}

/// The error of sensitivity and direction that shows as the sensors' departures from their mean change with the
/// orientation; `None` where the rests are too much alike.
fn scale_of(
    offsets: &[Vec<Option<[f64; 3]>>],
    forces: &[Vec<Option<[f64; 3]>>],
    used: &[usize],
) -> Option<f64> {
    let square = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>();
    let (mut departures, mut changes, mut most) = (0.0, 0.0, 0.0_f64);
    for rest in 1..offsets.len() {
        for k in used {
            let now = (offsets[rest][*k], forces[*k][rest]);
            let before = (offsets[rest - 1][*k], forces[*k][rest - 1]);
            if let ((Some(o), Some(f)), (Some(p), Some(g))) = (now, before) {
                departures += square(o, p);
                changes += 3.0 * square(f, g);
                most = most.max(square(f, g));
            }
        }
    }
    let count = used.len() as f64;
    let alike = most < STANDARD_GRAVITY_MPS2.powi(2) || count < 2.0;
    (!alike).then(|| (departures / changes * count / (count - 1.0)).sqrt())
}

/// Whether no axis of a sensor ever moves, or it has no output.
fn is_dead(recording: &ArrayRecording, sensor: usize) -> bool {
    let outputs = || recording.outputs.iter().map(|row| row[sensor]);
    let finite = |v: &[f64; 3]| v.iter().all(|axis| axis.is_finite());
    let Some(first) = outputs().find(finite) else {
        return true;
    };
    outputs().filter(finite).all(|v| v == first)
}

/// Where the mean of the sensors that are not `dead` is steady: first sample and number of samples.
fn steady_stretches(recording: &ArrayRecording, dead: &[usize]) -> Vec<(usize, usize)> {
    let alive: Vec<usize> = (0..recording.sensors())
        .filter(|sensor| !dead.contains(sensor))
        .collect();
    let mean = (0..recording.outputs.len()).map(|k| {
        let seen = alive.iter().filter(|s| recording.has(k, **s));
        (mean(seen.map(|s| recording.outputs[k][*s])), None)
    });
    let mut poses = vec![Pose::default(); MOST_POSES];
    let found = find_poses(mean, 1.0 / recording.period_s(), &mut poses).min(MOST_POSES);
    poses[..found]
        .iter()
        .map(|pose| (pose.first_sample as usize, pose.samples as usize))
        .filter(|(first, count)| first + count <= recording.outputs.len())
        .collect()
}

/// 0 of none.
fn mean(values: impl Iterator<Item = [f64; 3]>) -> [f64; 3] {
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for value in values {
        for (sum, value) in sum.iter_mut().zip(value) {
            *sum += value;
        }
        count += 1.0;
    }
    sum.map(|v| v / f64::max(count, 1.0))
}

/// A sensor at a rest; `None` where it has no output for the most part.
fn pose(recording: &ArrayRecording, sensor: usize, (first, count): (usize, usize)) -> Option<Pose> {
    let rows: Vec<[f64; 3]> = (first..first + count)
        .filter(|k| recording.has(*k, sensor))
        .map(|k| recording.outputs[k][sensor])
        .collect();
    if rows.len() < 2 || rows.len() * 4 < count {
        return None;
    }
    let n = rows.len() as f64;
    let mean = mean(rows.iter().copied());
    let mut pose = Pose::from_mean(mean);
    pose.sd_mps2 = core::array::from_fn(|axis| {
        let square: f64 = rows.iter().map(|r| (r[axis] - mean[axis]).powi(2)).sum();
        (square / n).sqrt()
    });
    pose.samples = rows.len() as u32;
    Some(pose)
}

/// Whether a sensor gives output all through a rest, and not only for a part of it.
fn is_throughout(
    recording: &ArrayRecording,
    sensor: usize,
    (first, count): (usize, usize),
) -> bool {
    (0..count).step_by(PART_SAMPLES).all(|from| {
        let part = (first + from, PART_SAMPLES.min(count - from));
        part.1 < PART_SAMPLES || pose(recording, sensor, part).is_some()
    })
}

/// The small turn of each sensor, rad, that makes all of them agree best; their mean is zero.
fn align(forces: &[Vec<Option<[f64; 3]>>]) -> Vec<[f64; 3]> {
    let sensors = forces.len();
    let poses = forces.first().map_or(0, Vec::len);
    let mut turns = vec![[0.0; 3]; sensors];
    for _ in 0..20 {
        let turned: Vec<Vec<Option<[f64; 3]>>> = forces
            .iter()
            .zip(&turns)
            .map(|(forces, small)| forces.iter().map(|f| f.map(|f| turn(f, *small))).collect())
            .collect();
        let means: Vec<[f64; 3]> = (0..poses)
            .map(|pose| mean(turned.iter().filter_map(|one| one[pose])))
            .collect();
        for sensor in 0..sensors {
            // Σ |mean − f − δ × f|² over poses: (Σ |f|² 1 − f fᵀ) δ = Σ f × mean.
            let mut left = [[0.0; 3]; 3];
            let mut right = [0.0; 3];
            for (f, mean) in turned[sensor].iter().zip(&means) {
                let Some(f) = f else {
                    continue;
                };
                let square: f64 = f.iter().map(|v| v * v).sum();
                for i in 0..3 {
                    left[i][i] += square;
                    for j in 0..3 {
                        left[i][j] -= f[i] * f[j];
                    }
                    right[i] +=
                        f[(i + 1) % 3] * mean[(i + 2) % 3] - f[(i + 2) % 3] * mean[(i + 1) % 3];
                }
            }
            if let Some(delta) = solve3(left, right) {
                for axis in 0..3 {
                    turns[sensor][axis] += delta[axis];
                }
            }
        }
        for axis in 0..3 {
            let mean = turns.iter().map(|t| t[axis]).sum::<f64>() / sensors as f64;
            for small in &mut turns {
                small[axis] -= mean;
            }
        }
    }
    turns
}

/// m⁻¹ v; `None` where m is singular.
fn solve3(m: [[f64; 3]; 3], v: [f64; 3]) -> Option<[f64; 3]> {
    let m = Matrix3::from_fn(|row, column| m[row][column]);
    let inverse = m.try_inverse()?;
    let sound = m.determinant().abs() > 1e-9 * m.trace().powi(3).abs();
    sound.then(|| (inverse * Vector3::from(v)).into())
}

/// Turns a vector by a rotation vector, rad.
pub(super) fn turn(v: [f64; 3], by: [f64; 3]) -> [f64; 3] {
    let angle = by.iter().map(|a| a * a).sum::<f64>().sqrt();
    if angle < 1e-12 {
        return v;
    }
    let axis = by.map(|a| a / angle);
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    };
    let once = cross(axis, v);
    let twice = cross(axis, once);
    core::array::from_fn(|i| v[i] + angle.sin() * once[i] + (1.0 - angle.cos()) * twice[i])
}
