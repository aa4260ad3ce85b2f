//! Whether the outputs of a moving array are those of one rigid body in its geometry, equation (101).

use nalgebra::{DVector, Vector3};
use wimu_model::STANDARD_GRAVITY_MPS2;
use wimu_nav::array::ArraySolver;

use super::motion::{axes, check, refused, sample};
use super::size::SizeTest;
use super::{Array, ArrayCalibration, ArrayGeometry};
use crate::{Code, Problem, Result};

/// Fraction of the variance among the sensors that no motion explains, from which on the geometry is not this array's.
const CONTRADICTION: f64 = 0.15;
/// Error of the size of a geometry that is reported: it makes the angular rate wrong by half of it.
const SIZE: f64 = 0.1;
/// A sample is tested if the standard deviation between the sensors exceeds this multiple of their noise, and this, m/s².
const NOISES: f64 = 10.0;
const LEAST_MPS2: f64 = 0.3;
/// Smallest number of tested samples for a result.
const LEAST_SAMPLES: usize = 50;
/// ω counts as observed from this many of its standard deviations on.
const OBSERVED_SD: f64 = 5.0;

/// Agreement of the outputs of a moving array with the motion of one rigid body, equation (101).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agreement {
    /// Samples tested: those whose variance between the sensors exceeds what noise and scale factors explain.
    pub samples: usize,
    /// Fraction of the variance among the sensors that no motion explains.
    pub unexplained: f64,
    /// That part, m/s² rms per axis.
    pub unexplained_mps2: f64,
    /// The sensor with the largest residual (from 0).
    pub worst: usize,
    /// Bounds of the size of the geometry over that of the array, from ω and ω̇; `None` with too few samples in motion.
    pub size: Option<[f64; 2]>,
    /// Standard deviation of a coordinate of the positions that the residuals show, m, and how many of them show it.
    place: (f64, usize),
}

impl Agreement {
    /// Of a recording in body axes; `None` with too few samples in motion, or where motion explains everything.
    ///
    /// # Errors
    /// `usage` when the numbers of sensors differ; `data_refused` when the geometry shows no angular acceleration or specific
    /// force.
    pub fn of(
        recording: &Array,
        geometry: &ArrayGeometry,
        calibration: &ArrayCalibration,
    ) -> Result<Option<Self>> {
        check(recording, geometry)?;
        let used = |sensor: usize| calibration.uses(sensor);
        let axes = axes(geometry, &calibration.noise_mps2)?;
        let solver = ArraySolver::of(&axes, used).map_err(refused)?;
        let motion = if solver.rank() == 6 { 3 } else { solver.rank() };
        let degrees = solver.used().saturating_sub(6 + motion);
        if degrees == 0 {
            return Ok(None);
        }
        let variance = solver.variance_mps2();
        // Where the sensors differ by less, errors of their scale factors alone look like a contradiction.
        let scale = calibration.scale * STANDARD_GRAVITY_MPS2;
        let least_variance = (NOISES * NOISES * variance + scale * scale / CONTRADICTION)
            .max(LEAST_MPS2 * LEAST_MPS2);
        let sensors: Vec<usize> = (0..recording.sensors()).filter(|sensor| used(*sensor)).collect();
        let (mut count, mut unexplained, mut square, mut weights) = (0, 0.0, 0.0, 0.0);
        let mut by_sensor = vec![0.0; recording.sensors()];
        let (mut size, mut beyond_noise, mut by_place) = (SizeTest::default(), 0.0, 0.0);
        for index in (0..recording.len()).filter(|index| !calibration.is_rest(*index)) {
            let rest = calibration.offset_of(index);
            let output = sample(recording, calibration, index, rest);
            if sensors.iter().any(|sensor| output[3 * sensor].is_nan()) {
                continue;
            }
            let moving = Moving::of(&solver, &output);
            let time_s = recording.times()[index].s();
            size.push(time_s, recording.period_s(), moving.rate);
            let between_sensors = variance_between(&output, &sensors);
            if between_sensors < least_variance {
                continue;
            }
            let left = moving.residuals.norm_squared() / degrees as f64;
            let weight = 1.0 / left.max(1.0);
            (count, weights) = (count + 1, weights + weight);
            square += weight * left;
            if let Some([rate, acceleration]) = moving.rate {
                beyond_noise += (left - 1.0) * variance;
                by_place += (rate.norm_squared().powi(2) + acceleration.norm_squared()) / 1.5;
            }
            let noise_ratio = between_sensors / variance;
            unexplained += left / noise_ratio;
            for (axis, residual) in moving.residuals.iter().enumerate() {
                by_sensor[axis / 3] += residual * residual / noise_ratio;
            }
        }
        let worst = (0..by_sensor.len()).max_by(|a, b| by_sensor[*a].total_cmp(&by_sensor[*b]));
        Ok((count >= LEAST_SAMPLES).then(|| Self {
            samples: count,
            unexplained: unexplained / count as f64,
            unexplained_mps2: (square / weights * variance).sqrt(),
            worst: worst.unwrap_or(0),
            size: size.bounds(),
            place: if by_place > 0.0 {
                ((beyond_noise / by_place).max(0.0).sqrt(), degrees)
            } else {
                (0.0, 0)
            },
        }))
    }

    /// Standard deviation of a coordinate of the positions, m: at most that stated, which counts as one more residual.
    pub(super) fn place_sd_m(&self, stated_m: f64) -> f64 {
        let (shown_m, count) = self.place;
        let squares = stated_m * stated_m + count as f64 * shown_m * shown_m;
        (squares / (1.0 + count as f64)).sqrt().min(stated_m)
    }

    /// Refuses sensors that contradict each other.
    ///
    /// # Errors
    /// `data_refused`, with what to check.
    pub fn check(&self, name: &str) -> Result<()> {
        if self.unexplained <= CONTRADICTION {
            return Ok(());
        }
        let what = format!(
            "{:.0} % of the variance among them in motion fits no motion of one rigid body; sensor {} (from 0) fits worst",
            100.0 * self.unexplained,
            self.worst
        );
        Err(contradiction(name, &what))
    }

    /// The agreement, and the size of the array where it is not that of the geometry.
    pub fn findings(&self) -> Vec<Problem> {
        let mut findings = vec![Code::Geometry.note(format!(
            "{:.1} % of the variance among the sensors in motion, {:.3} m/s² rms, fits no motion of one rigid body",
            100.0 * self.unexplained,
            self.unexplained_mps2
        ))];
        let other = self.size.filter(|[least, most]| *least > 1.0 + SIZE || *most < 1.0 - SIZE);
        if let Some([least, most]) = other {
            let text = format!(
                "the positions are {least:.2} to {most:.2} times as far apart as the sensors: the changes of the angular rate \
                 are not the integral of the angular acceleration"
            );
            let remedy = "check the unit of the positions and the distances between the sensors";
            findings.push(Code::Geometry.warning(text).remedy(remedy));
        }
        findings
    }
}

/// Refusal of sensors whose outputs are not those of one rigid body.
pub(super) fn contradiction(name: &str, what: &str) -> Problem {
    Code::DataRefused.error(format!("the sensors contradict each other: {what}"),
        "check the geometry: the order of the sensors, the signs of their positions, and the directions of their \
         axes. If they are right, calibrate the sensors: hold the array still in a dozen orientations, \
         `wimu calibrate RESTS.csv --setup geometry=PLACES.csv -o ARRAY.json`, and navigate with --setup geometry=ARRAY.json",
    )
    .at(name)
}

/// Variance between the sensors, mean over the axes, (m/s²)².
fn variance_between(output: &[f64], sensors: &[usize]) -> f64 {
    let count = sensors.len() as f64;
    let of_axis = |axis: usize| {
        let values = || sensors.iter().map(|sensor| output[3 * sensor + axis]);
        let mean = values().sum::<f64>() / count;
        values().map(|value| (value - mean).powi(2)).sum::<f64>()
    };
    (0..3).map(of_axis).sum::<f64>() / (3.0 * (count - 1.0)).max(1.0)
}

/// A sample in motion.
struct Moving {
    /// What no motion explains of each output, over its noise.
    residuals: DVector<f64>,
    /// ω up to its sign, rad/s, and ω̇, rad/s²; `None` where ω is not observed.
    rate: Option<[Vector3<f64>; 2]>,
}

impl Moving {
    fn of(solver: &ArraySolver, output: &[f64]) -> Self {
        let linear = solver.reduce(output);
        let best = solver.roots_of(&linear).first().copied().filter(|_| solver.rank() == 6);
        let Some(best) = best else {
            return Self { residuals: solver.residuals(output, &linear, &linear.z), rate: None };
        };
        let excess = solver.excess(output, &linear).unwrap_or(1.0).max(1.0);
        let (rate, covariance) = (best.rate_rad_s, best.information.try_inverse());
        let observed = covariance.is_some_and(|covariance| {
            let largest = covariance.symmetric_eigenvalues().max() * excess;
            rate.norm_squared() > OBSERVED_SD * OBSERVED_SD * largest
        });
        let turn = solver.theta(&linear, &rate).fixed_rows::<3>(0).into_owned();
        let (explained, _) = solver.expected_z(&rate);
        Self {
            residuals: solver.residuals(output, &linear, &explained),
            rate: observed.then_some([rate, turn]),
        }
    }
}
