//! A recording of several accelerometers on one body: where they are, their calibration from the
//! rests in the recording, and the body's angular rate.

use std::path::Path;

use wimu_calib::{Gravity, Model, Pose, find_poses, multi_position};
use wimu_model::{ErrorModel, STANDARD_GRAVITY_MPS2, SpecificForceMps2};
use wimu_nav::array::{ArraySolver, Geometry, Observation, Spread, Step, Triad, track};

use crate::csv::{AccelerationUnit, CsvReader};
use crate::{ErrorCode, HostError, Result};

/// Counts of a 16-bit sensor from which on an axis is at its limit.
const LIMIT_COUNTS: f64 = 32_700.0;
/// Poses that a recording may have.
const MOST_POSES: usize = 256;
/// Noise that is assumed where there is no rest to see it, m/s².
const ASSUMED_NOISE_MPS2: f64 = 0.05;

/// Samples of several accelerometers.
#[derive(Clone, Debug, Default)]
pub struct ArrayRecording {
    /// Time of each sample, s.
    pub times_s: Vec<f64>,
    /// X, Y, Z of each sensor, m/s², body axes, sample by sample.
    pub outputs: Vec<Vec<[f64; 3]>>,
    /// Whether a sensor was at its limit.
    pub saturated: Vec<bool>,
    /// The file's other columns, by name.
    pub other: Vec<(String, Vec<f64>)>,
    /// What errors call it.
    pub name: String,
}

impl ArrayRecording {
    /// Reads a CSV file with columns `Accelerometer 0 X (…)`, `Accelerometer 1 X (…)`, …, all in the
    /// axes of the body. Counts are scaled by `sensitivity_lsb_per_g`.
    ///
    /// # Errors
    /// Those of [`CsvReader`]; `csv_missing_column` without times or with one accelerometer only.
    pub fn from_csv(path: &Path, sensitivity_lsb_per_g: f64) -> Result<Self> {
        let reader = CsvReader::open(path)?;
        let header = reader.header().clone();
        let name = reader.name().to_owned();
        if !header.time || header.accelerometers.len() < 2 {
            return Err(HostError::new(
                ErrorCode::CsvMissingColumn,
                "an array needs times and two accelerometers at the least",
                "name the columns `Time (s)`, `Accelerometer 0 X (LSB)`, `Accelerometer 1 X (LSB)`, …",
            )
            .at(format!("{name} line 1")));
        }
        let counts = header.acceleration_unit == AccelerationUnit::Lsb;
        let factor = header
            .acceleration_unit
            .mps2()
            .unwrap_or(STANDARD_GRAVITY_MPS2 / sensitivity_lsb_per_g);
        let mut recording = Self {
            name,
            other: header
                .other
                .iter()
                .map(|n| (n.clone(), Vec::new()))
                .collect(),
            ..Self::default()
        };
        for row in reader {
            let row = row?;
            recording
                .times_s
                .push(row.time_ns.unwrap_or_default() as f64 * 1e-9);
            let at_limit = |axis: &f64| counts && axis.abs() >= LIMIT_COUNTS;
            recording
                .saturated
                .push(row.accelerations.iter().flatten().any(at_limit));
            recording.outputs.push(
                row.accelerations
                    .iter()
                    .map(|sensor| sensor.map(|axis| axis * factor))
                    .collect(),
            );
            for ((_, values), text) in recording.other.iter_mut().zip(&row.other) {
                values.push(text.parse().unwrap_or(f64::NAN));
            }
        }
        if recording.times_s.len() < 2 {
            return Err(HostError::new(
                ErrorCode::NoRows,
                "there are fewer than two samples",
                "check the file",
            )
            .at(&recording.name));
        }
        Ok(recording)
    }

    /// How many accelerometers there are.
    pub fn sensors(&self) -> usize {
        self.outputs.first().map_or(0, Vec::len)
    }

    /// Median time between samples, s.
    pub fn period_s(&self) -> f64 {
        let mut steps: Vec<f64> = self.times_s.windows(2).map(|w| w[1] - w[0]).collect();
        steps.sort_by(f64::total_cmp);
        steps[steps.len() / 2].max(1e-6)
    }
}

/// Reads the places of an array's sensors, m: three rows `x`, `y`, `z` with one column a sensor, or
/// one row a sensor with columns `X (m)`, `Y (m)`, `Z (m)`.
///
/// # Errors
/// `file_unreadable`, `csv_bad_number`, `csv_missing_column`.
pub fn read_places(path: &Path) -> Result<Vec<[f64; 3]>> {
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|e| HostError::file(&name, "read", &e))?;
    let rows: Vec<Vec<&str>> = text
        .lines()
        .filter(|line| !line.trim().is_empty())
        .map(|line| line.split(',').map(str::trim).collect())
        .collect();
    let number = |text: &str, line: usize| {
        text.parse::<f64>()
            .ok()
            .filter(|v| v.is_finite())
            .ok_or_else(|| {
                HostError::new(
                    ErrorCode::CsvBadNumber,
                    format!("`{text}` is not a finite number"),
                    "give places in m",
                )
                .at(format!("{name} line {}", line + 1))
            })
    };
    let missing = || {
        HostError::new(
            ErrorCode::CsvMissingColumn,
            "it does not say where the sensors are",
            "write a line `X (m),Y (m),Z (m)` and a line with three numbers for each sensor",
        )
        .at(&name)
    };
    let head = rows.first().ok_or_else(missing)?;
    let row_of = |axis: &str| {
        rows.iter()
            .position(|row| row.first().is_some_and(|f| f.eq_ignore_ascii_case(axis)))
    };
    if let (Some(x), Some(y), Some(z)) = (row_of("x"), row_of("y"), row_of("z")) {
        return (1..head.len())
            .map(|sensor| {
                let mut place = [0.0; 3];
                for (axis, line) in [x, y, z].into_iter().enumerate() {
                    place[axis] = number(rows[line].get(sensor).copied().unwrap_or(""), line)?;
                }
                Ok(place)
            })
            .collect();
    }
    let column = |axis: &str| {
        head.iter()
            .position(|field| field.eq_ignore_ascii_case(&format!("{axis} (m)")))
            .ok_or_else(missing)
    };
    let columns = [column("X")?, column("Y")?, column("Z")?];
    rows.iter()
        .enumerate()
        .skip(1)
        .map(|(line, row)| {
            let mut place = [0.0; 3];
            for (axis, column) in columns.into_iter().enumerate() {
                place[axis] = number(row.get(column).copied().unwrap_or(""), line)?;
            }
            Ok(place)
        })
        .collect()
}

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
    /// What each sensor still adds at each rest, m/s².
    offsets: Vec<Vec<[f64; 3]>>,
}

impl ArrayCalibration {
    /// From the accelerometers alone: the rests are found in the mean of all sensors, each sensor is
    /// fitted to gravity (9 parameters), then turned to agree with the others.
    ///
    /// # Errors
    /// `data_refused` when there is no rest at all.
    pub fn of(recording: &ArrayRecording, gravity: Gravity) -> Result<Self> {
        let sensors = recording.sensors();
        let mean = recording.outputs.iter().map(|all| {
            let mut sum = [0.0; 3];
            for one in all {
                for axis in 0..3 {
                    sum[axis] += one[axis] / sensors as f64;
                }
            }
            (sum, None)
        });
        let mut poses = vec![Pose::default(); MOST_POSES];
        let found = find_poses(mean, 1.0 / recording.period_s(), &mut poses).min(MOST_POSES);
        let rests: Vec<(usize, usize)> = poses[..found]
            .iter()
            .map(|pose| (pose.first_sample as usize, pose.samples as usize))
            .filter(|(first, count)| first + count <= recording.outputs.len())
            .collect();
        if rests.is_empty() {
            return Err(HostError::new(
                ErrorCode::DataRefused,
                "there is no rest in the recording, so neither biases nor gravity are known",
                "hold the array still for two seconds, in several orientations",
            )
            .at(&recording.name));
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
        let models: std::result::Result<Vec<ErrorModel>, _> = per_sensor
            .iter()
            .map(|poses| multi_position(poses, gravity, Model::Full9).map(|e| e.model))
            .collect();
        let (models, uncalibrated) = match models {
            Ok(models) => (models, None),
            Err(refusal) => (
                vec![ErrorModel::default(); sensors],
                Some(refusal.to_string()),
            ),
        };
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
        let turns = if uncalibrated.is_none() {
            align(&forces)
        } else {
            vec![[0.0; 3]; sensors]
        };
        let mut calibration = Self {
            sensors: models.into_iter().zip(turns).collect(),
            noise_mps2,
            rests,
            disagreement_mps2: 0.0,
            uncalibrated,
            offsets: Vec::new(),
        };
        let mut squares = 0.0;
        for rest in 0..calibration.rests.len() {
            let turned: Vec<[f64; 3]> = (0..sensors)
                .map(|k| turn(forces[k][rest], calibration.sensors[k].1))
                .collect();
            let mut mean = [0.0; 3];
            for force in &turned {
                for axis in 0..3 {
                    mean[axis] += force[axis] / sensors as f64;
                }
            }
            let offsets: Vec<[f64; 3]> = turned
                .iter()
                .map(|force| core::array::from_fn(|axis| force[axis] - mean[axis]))
                .collect();
            squares += offsets.iter().flatten().map(|o| o * o).sum::<f64>();
            calibration.offsets.push(offsets);
        }
        let values = (calibration.rests.len() * sensors * 3) as f64;
        calibration.disagreement_mps2 = (squares / values).sqrt();
        Ok(calibration)
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

fn pose(recording: &ArrayRecording, sensor: usize, (first, count): (usize, usize)) -> Pose {
    let rows = &recording.outputs[first..first + count];
    let mut mean = [0.0; 3];
    let mut square = [0.0; 3];
    for axis in 0..3 {
        mean[axis] = rows.iter().map(|r| r[sensor][axis]).sum::<f64>() / count as f64;
        square[axis] = rows
            .iter()
            .map(|r| (r[sensor][axis] - mean[axis]).powi(2))
            .sum::<f64>()
            / count as f64;
    }
    let mut pose = Pose::from_mean(mean);
    pose.sd_mps2 = square.map(f64::sqrt);
    pose.samples = count as u32;
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

/// The angular rate of a body through a recording, from accelerometers alone.
#[derive(Clone, Debug)]
pub struct ArrayMotion {
    /// ω from all samples, rad/s, body axes.
    pub rate_rad_s: Vec<[f64; 3]>,
    /// Standard deviation of each component, rad/s.
    pub rate_sd_rad_s: Vec<[f64; 3]>,
    /// Slow part of ω̇, rad/s².
    pub angular_acceleration_rad_s2: Vec<[f64; 3]>,
    /// ω from the samples up to each one, rad/s: the likeliest root, nothing later used.
    pub causal_rad_s: Vec<[f64; 3]>,
    /// Specific force at the centre of the sensors, m/s², body axes.
    pub force_mps2: Vec<[f64; 3]>,
    /// Samples that were passed over because a sensor was at its limit.
    pub saturated: usize,
    /// How the angular rate moves, found from the recording.
    pub spread: Spread,
    /// Mean NIS per degree of freedom.
    pub nis: f64,
}

/// Follows the angular rate of `recording`; `places_m` says where its sensors are, body axes.
///
/// # Errors
/// `usage` when the numbers of sensors differ or are more than 16; `data_refused` when the geometry
/// shows no angular rate.
pub fn angular_rate(
    recording: &ArrayRecording,
    places_m: &[[f64; 3]],
    calibration: &ArrayCalibration,
) -> Result<ArrayMotion> {
    if places_m.len() != recording.sensors() {
        return Err(HostError::new(
            ErrorCode::Usage,
            format!(
                "the geometry has {} sensors, the recording {}",
                places_m.len(),
                recording.sensors()
            ),
            "give the geometry of this array",
        )
        .at(&recording.name));
    }
    match places_m.len() {
        0..=4 => follow::<12>(recording, places_m, calibration),
        5..=8 => follow::<24>(recording, places_m, calibration),
        9..=16 => follow::<48>(recording, places_m, calibration),
        many => Err(HostError::new(
            ErrorCode::Usage,
            format!("{many} sensors are more than 16"),
            "leave some out",
        )),
    }
}

fn follow<const M: usize>(
    recording: &ArrayRecording,
    places_m: &[[f64; 3]],
    calibration: &ArrayCalibration,
) -> Result<ArrayMotion> {
    let refused = |message: String| {
        HostError::new(
            ErrorCode::DataRefused,
            message,
            "four triads and more, not in a plane, show the angular rate best",
        )
    };
    let triads: Vec<Triad> = places_m
        .iter()
        .zip(&calibration.noise_mps2)
        .map(|(place, noise)| Triad::aligned(*place, *noise))
        .collect();
    let geometry = Geometry::<M>::from_triads(&triads).map_err(|e| refused(e.to_string()))?;
    let solver = ArraySolver::<f64, M>::new(&geometry).map_err(|e| refused(e.to_string()))?;
    let mut last = recording.times_s[0];
    let mut linears = Vec::with_capacity(recording.times_s.len());
    let observations: Vec<Observation> = recording
        .outputs
        .iter()
        .enumerate()
        .map(|(index, all)| {
            let mut output = [0.0; M];
            for (sensor, value) in all.iter().enumerate() {
                let force = calibration.force(sensor, *value, index);
                output[3 * sensor..3 * sensor + 3].copy_from_slice(&force);
            }
            let linear = solver.reduce(&output);
            linears.push(linear);
            let step_s = recording.times_s[index] - last;
            last = recording.times_s[index];
            Observation {
                step_s,
                linear: (!recording.saturated[index]).then_some(linear),
                excess: solver.excess(&output, &linear).unwrap_or(1.0),
            }
        })
        .collect();
    let mut steps = vec![Step::default(); observations.len()];
    let variance = calibration.noise_mps2.iter().map(|n| n * n).sum::<f64>()
        / calibration.noise_mps2.len() as f64;
    let found = track(&solver, variance, &observations, &mut steps)
        .ok_or_else(|| refused("the sensors' places show no angular rate".to_owned()))?;
    let force = |(step, linear): (&Step, &_)| {
        let [_, _, _, x, y, z] = solver.theta(linear, step.rate_rad_s);
        [x, y, z]
    };
    Ok(ArrayMotion {
        rate_rad_s: steps.iter().map(|s| s.rate_rad_s).collect(),
        rate_sd_rad_s: steps
            .iter()
            .map(|s| core::array::from_fn(|i| s.covariance[i][i].max(0.0).sqrt()))
            .collect(),
        angular_acceleration_rad_s2: steps
            .iter()
            .map(|s| s.angular_acceleration_rad_s2)
            .collect(),
        causal_rad_s: steps.iter().map(|s| s.causal_rad_s).collect(),
        force_mps2: steps.iter().zip(&linears).map(force).collect(),
        saturated: recording.saturated.iter().filter(|s| **s).count(),
        spread: found.spread,
        nis: found.nis,
    })
}
