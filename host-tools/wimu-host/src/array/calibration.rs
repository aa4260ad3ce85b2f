//! An array's calibration from the rests in its own recording.

use wimu_calib::{Gravity, Model, Pose, find_poses, multi_position};
use wimu_model::{ErrorModel, SpecificForceMps2};

use super::ArrayRecording;
use crate::{ErrorCode, HostError, Result};

/// Poses that a recording may have.
const MOST_POSES: usize = 256;
/// Noise that is assumed where there is no rest to see it, m/s².
const ASSUMED_NOISE_MPS2: f64 = 0.05;

/// An array's calibration from the rests in its own recording.
#[derive(Clone, Debug)]
pub struct ArrayCalibration {
    /// Each sensor's error model and the small turn from its axes to the body's, rad.
    pub sensors: Vec<(ErrorModel, [f64; 3])>,
    /// Noise of each sensor at rest, m/s² an axis.
    pub noise_mps2: Vec<f64>,
    /// The rests, as first sample and number of samples.
    pub rests: Vec<(usize, usize)>,
    /// What the sensors disagree by at the rests after all, m/s² rms an axis.
    pub disagreement_mps2: f64,
    /// Why the error models are those of perfect sensors, where they are.
    pub uncalibrated: Option<String>,
    /// Sensors that are of no use, and why.
    pub left_out: Vec<(usize, String)>,
    /// What each sensor still adds at each rest, m/s².
    offsets: Vec<Vec<[f64; 3]>>,
}

impl ArrayCalibration {
    /// From the accelerometers alone, in body axes: the rests are found in the mean of all sensors,
    /// each sensor is fitted to gravity (9 parameters), then turned to agree with the others. A sensor
    /// that is dead, or is the only one that cannot be fitted, is left out.
    ///
    /// # Errors
    /// `data_refused` when there is no rest at all, or no sensor is alive.
    pub fn of(recording: &ArrayRecording, gravity: Gravity) -> Result<Self> {
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
        let mean = recording.outputs.iter().map(|all| {
            let alive = |(sensor, one): &(usize, &[f64; 3])| {
                !dead.contains(sensor) && one.iter().all(|v| v.is_finite())
            };
            let mut sum = [0.0; 3];
            let mut count = 0.0;
            for (_, one) in all.iter().enumerate().filter(alive) {
                for axis in 0..3 {
                    sum[axis] += one[axis];
                }
                count += 1.0;
            }
            (sum.map(|v| v / f64::max(count, 1.0)), None)
        });
        let mut poses = vec![Pose::default(); MOST_POSES];
        let found = find_poses(mean, 1.0 / recording.period_s(), &mut poses).min(MOST_POSES);
        let rests: Vec<(usize, usize)> = poses[..found]
            .iter()
            .map(|pose| (pose.first_sample as usize, pose.samples as usize))
            .filter(|(first, count)| first + count <= recording.outputs.len())
            .collect();
        if rests.is_empty() {
            return Err(refused(
                "there is no rest in the recording, so neither biases nor gravity are known",
                "hold the array still for two seconds, in several orientations",
            ));
        }
        let per_sensor: Vec<Vec<Pose>> = (0..sensors)
            .map(|sensor| {
                rests
                    .iter()
                    .map(|rest| pose(recording, sensor, *rest))
                    .collect()
            })
            .collect();
        let noise_mps2 = per_sensor
            .iter()
            .map(|poses| {
                let sum: f64 = poses
                    .iter()
                    .map(|p| p.sd_mps2.iter().map(|s| s * s).sum::<f64>() / 3.0)
                    .sum();
                let noise = (sum / poses.len() as f64).sqrt();
                if noise > 0.0 {
                    noise
                } else {
                    ASSUMED_NOISE_MPS2
                }
            })
            .collect();
        let mut models = vec![ErrorModel::default(); sensors];
        let mut refusals = Vec::new();
        for (sensor, poses) in per_sensor.iter().enumerate() {
            if dead.contains(&sensor) {
                continue;
            }
            let seen: Vec<Pose> = poses.iter().filter(|p| p.samples > 0).copied().collect();
            match multi_position(&seen, gravity, Model::Full9) {
                Ok(estimate) => models[sensor] = estimate.model,
                Err(refusal) => refusals.push((sensor, refusal.to_string())),
            }
        }
        // What most of them cannot be fitted to is the recording's fault, not theirs.
        let mut uncalibrated = None;
        if refusals.len() * 2 > sensors - dead.len() {
            uncalibrated = refusals.first().map(|(_, why)| why.clone());
            models = vec![ErrorModel::default(); sensors];
        } else {
            left_out.extend(refusals);
        }
        let used: Vec<usize> = (0..sensors)
            .filter(|sensor| left_out.iter().all(|(out, _)| out != sensor))
            .collect();
        let forces: Vec<Vec<[f64; 3]>> = models
            .iter()
            .zip(&per_sensor)
            .map(|(model, poses)| {
                poses
                    .iter()
                    .map(|p| model.correct(SpecificForceMps2(p.mean_mps2), None).0)
                    .collect()
            })
            .collect();
        let mut turns = vec![[0.0; 3]; sensors];
        if uncalibrated.is_none() {
            let chosen: Vec<Vec<[f64; 3]>> = used.iter().map(|k| forces[*k].clone()).collect();
            for (sensor, small) in used.iter().zip(align(&chosen)) {
                turns[*sensor] = small;
            }
        }
        let mut calibration = Self {
            sensors: models.into_iter().zip(turns).collect(),
            noise_mps2,
            rests,
            disagreement_mps2: 0.0,
            uncalibrated,
            left_out,
            offsets: Vec::new(),
        };
        let mut squares = 0.0;
        for rest in 0..calibration.rests.len() {
            let turned: Vec<[f64; 3]> = (0..sensors)
                .map(|k| turn(forces[k][rest], calibration.sensors[k].1))
                .collect();
            let mut mean = [0.0; 3];
            for sensor in &used {
                for axis in 0..3 {
                    mean[axis] += turned[*sensor][axis] / used.len() as f64;
                }
            }
            let offsets: Vec<[f64; 3]> = turned
                .iter()
                .map(|force| core::array::from_fn(|axis| force[axis] - mean[axis]))
                .collect();
            let of_used = used.iter().flat_map(|k| offsets[*k]);
            squares += of_used.map(|o| o * o).sum::<f64>();
            calibration.offsets.push(offsets);
        }
        let values = (calibration.rests.len() * used.len() * 3) as f64;
        calibration.disagreement_mps2 = (squares / values).sqrt();
        Ok(calibration)
    }

    /// Mean length of the mean output at the rests, m/s².
    pub fn mean_rest_mps2(&self, recording: &ArrayRecording) -> f64 {
        let length = |(first, count): &(usize, usize)| {
            let used: Vec<[f64; 3]> = (0..recording.sensors())
                .filter(|sensor| self.uses(*sensor))
                .map(|sensor| pose(recording, sensor, (*first, *count)).mean_mps2)
                .collect();
            let n = used.len() as f64;
            let square = |axis: usize| (used.iter().map(|f| f[axis]).sum::<f64>() / n).powi(2);
            (0..3).map(square).sum::<f64>().sqrt()
        };
        self.rests.iter().map(length).sum::<f64>() / self.rests.len() as f64
    }

    /// Whether a sensor is of use.
    pub fn uses(&self, sensor: usize) -> bool {
        self.left_out.iter().all(|(out, _)| *out != sensor)
    }

    /// Specific force of sensor `sensor` in body axes, m/s², without what it added at the latest rest
    /// before sample `index`: that part of its bias which the other sensors show.
    pub fn force(&self, sensor: usize, output_mps2: [f64; 3], index: usize) -> [f64; 3] {
        let Some((model, small)) = self.sensors.get(sensor) else {
            return output_mps2;
        };
        let force = turn(
            model.correct(SpecificForceMps2(output_mps2), None).0,
            *small,
        );
        let rest = self.rests.partition_point(|(first, _)| *first <= index);
        let offset = self.offsets[rest.saturating_sub(1)][sensor];
        core::array::from_fn(|axis| force[axis] - offset[axis])
    }
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

fn pose(recording: &ArrayRecording, sensor: usize, (first, count): (usize, usize)) -> Pose {
    let rows: Vec<[f64; 3]> = recording.outputs[first..first + count]
        .iter()
        .map(|row| row[sensor])
        .filter(|v| v.iter().all(|axis| axis.is_finite()))
        .collect();
    if rows.is_empty() {
        return Pose::default();
    }
    let n = rows.len() as f64;
    let mean: [f64; 3] = core::array::from_fn(|axis| rows.iter().map(|r| r[axis]).sum::<f64>() / n);
    let mut pose = Pose::from_mean(mean);
    pose.sd_mps2 = core::array::from_fn(|axis| {
        let square: f64 = rows.iter().map(|r| (r[axis] - mean[axis]).powi(2)).sum();
        (square / n).sqrt()
    });
    pose.samples = rows.len() as u32;
    pose
}

/// The small turn of each sensor, rad, that makes all of them agree best; their mean is zero.
fn align(forces: &[Vec<[f64; 3]>]) -> Vec<[f64; 3]> {
    let sensors = forces.len();
    let poses = forces.first().map_or(0, Vec::len);
    let mut turns = vec![[0.0; 3]; sensors];
    for _ in 0..20 {
        let turned: Vec<Vec<[f64; 3]>> = forces
            .iter()
            .zip(&turns)
            .map(|(forces, small)| forces.iter().map(|f| turn(*f, *small)).collect())
            .collect();
        for sensor in 0..sensors {
            // Σ |mean − f − δ × f|² over poses: (Σ |f|² 1 − f fᵀ) δ = Σ f × mean.
            let mut left = [[0.0; 3]; 3];
            let mut right = [0.0; 3];
            for pose in 0..poses {
                let f = turned[sensor][pose];
                let mut mean = [0.0; 3];
                for other in &turned {
                    for axis in 0..3 {
                        mean[axis] += other[pose][axis] / sensors as f64;
                    }
                }
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

/// Cramer's rule; `None` where it is singular.
fn solve3(m: [[f64; 3]; 3], v: [f64; 3]) -> Option<[f64; 3]> {
    let det = |m: [[f64; 3]; 3]| {
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
            - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    };
    let whole = det(m);
    let trace = m[0][0] + m[1][1] + m[2][2];
    (whole.abs() > 1e-9 * trace.powi(3).abs()).then(|| {
        core::array::from_fn(|column| {
            let mut changed = m;
            for row in 0..3 {
                changed[row][column] = v[row];
            }
            det(changed) / whole
        })
    })
}

/// Turns a vector by a rotation vector, rad.
fn turn(v: [f64; 3], by: [f64; 3]) -> [f64; 3] {
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
