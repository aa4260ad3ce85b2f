//! Gyroscope calibration from the rotations between rests.

mod checks;
mod fault;
mod model;
mod rests;
mod turn;

pub use fault::TurnFault;

use nalgebra::{SMatrix, SVector};
use wimu_model::{
    ErrorModel, GyroscopeModel, GyroscopeParameters, GyroscopeTerms, ModelError,
    STANDARD_GRAVITY_MPS2,
};

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use crate::estimate::Residuals;
use crate::orientation::axis_name;
use crate::{Covariance, Estimate, Parameters, Pose, Refusal, student};
use model::{Fit, Noise, Point, Rotations, Squares};
use rests::Session;

/// Number of parameters: bias X, Y, Z (rad/s), A row by row, G row by row (rad/s per m/s²).
const PARAMETERS: usize = 21;
/// Where A and G begin.
const MATRIX: usize = 3;
const G_SENSITIVITY: usize = 12;
/// The diagonal of a matrix row by row.
const DIAGONAL: [usize; 3] = [0, 4, 8];
/// Standard deviations of the parameters beforehand: the limits of the MPU-6050 datasheet, 20 °/s, 3 %,
/// 0.1 °/s per *g*; misalignment 2 % and 1° between the axes of gyroscope and accelerometer.
const PRIOR_SD: [f64; PARAMETERS] = {
    let mut sd = [0.35; PARAMETERS];
    let mut k = MATRIX;
    while k < PARAMETERS {
        sd[k] = match k {
            3 | 7 | 11 => 0.03,
            4..G_SENSITIVITY => 0.027,
            _ => 1.78e-4,
        };
        k += 1;
    }
    sd
};
/// A parameter is observed if its variance is less than this part of that beforehand.
const OBSERVED: f64 = 0.25;
/// Random walk of the bias, (rad/s)²/s: 0.01 °/s in 100 s, or more if the rests show it.
const BIAS_WALK: f64 = 3e-10;
/// Squared error of a turn over its angle, from nonlinearity and timing: the smallest, 0.003 %, and a
/// typical one, 0.1 %, if too few turns determine it (datasheets: 0.1 to 0.2 % of full scale).
const TURN_ERROR: [f64; 2] = [9e-10, 1e-6];
/// Fewest degrees of freedom with which a variance is estimated.
const LEAST_DOF: f64 = 3.0;
/// A variance is raised only for residuals above their expectation by this many standard deviations of
/// χ²: otherwise chance alone would raise it in every other session.
const CHANCE: f64 = 0.5;
/// Most rounds, and the relative change of the variances at which the fit has converged.
const ROUNDS: usize = 20;
const SETTLED: f64 = 0.02;
/// An outlier is larger than this, rad (1°), and than this multiple of the rms of the other turns; at most one
/// turn of this number is left out.
const OUTLIER: (f64, f64, usize) = (0.017, 5.0, 5);
/// Largest error of the predicted directions, rad rms (3°).
const LARGEST_RAD: f64 = 0.052;
/// Standard deviation in A above which another turn is advised.
const GOOD_ENOUGH: f64 = 1e-3;

type Theta = SVector<f64, PARAMETERS>;

/// One sample of a six-axis sensor, output not corrected.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SixAxisSample {
    /// Time since the previous sample, s.
    pub step_s: f64,
    /// Output of the gyroscope, rad/s, sensor axes.
    pub rate_rad_s: [f64; 3],
    /// Output of the accelerometer, m/s², sensor axes.
    pub output_mps2: [f64; 3],
}

/// The calibration of the accelerometer beside a gyroscope; its axes are the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AccelerometerCalibration {
    /// Error model.
    pub model: ErrorModel,
    /// Covariance of its parameters.
    pub covariance: Covariance,
    /// Error of a rest that noise does not explain, m/s², 1 σ: the residual of the fit.
    pub rms_mps2: f64,
}

impl AccelerometerCalibration {
    /// An accelerometer that is not calibrated: 50 mg, 3 %, 2 %, 1 σ.
    pub fn uncalibrated() -> Self {
        let mut covariance = Covariance::ZERO;
        covariance.take_for_granted(Parameters::ALL);
        Self { model: ErrorModel::default(), covariance, rms_mps2: 0.0 }
    }
}

impl From<&Estimate> for AccelerometerCalibration {
    fn from(estimate: &Estimate) -> Self {
        Self {
            model: estimate.model,
            covariance: estimate.covariance,
            rms_mps2: estimate.rms_mps2
                * libm::sqrt(estimate.poses as f64 / estimate.dof.max(1) as f64),
        }
    }
}

/// A session of rests in different orientations.
///
/// The mean output at a rest is b + G f. From one rest to the next the corrected rate rotates the
/// direction of gravity, which the accelerometer measures at both: a rotation about the vertical shows
/// nothing. Least squares with a prior from datasheets; what is not observed stays at the prior.
/// Equations (143) to (149) of docs/reference/equations, method of Tedaldi and others (ICRA 2014).
#[derive(Clone, Copy, Debug)]
pub struct GyroscopeSession<'a> {
    /// The rests, in order: output of the accelerometer, first sample and number of samples.
    pub poses: &'a [Pose],
    /// All samples.
    pub samples: &'a [SixAxisSample],
    /// The accelerometer.
    pub accelerometer: &'a AccelerometerCalibration,
    /// Full-scale range of the gyroscope, rad/s; `None`: clipping is searched at the usual ranges.
    pub full_scale_rad_s: Option<f64>,
}

/// A gyroscope model and its quality.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct GyroscopeEstimate {
    /// The error model; its bias is that at the last rest.
    pub model: GyroscopeModel,
    /// Covariance of the bias X, Y, Z, A row by row, G row by row; for what was not observed that of
    /// datasheets.
    pub covariance: [[f64; 21]; 21],
    /// Degrees of freedom of the variances for the intervals of bias and G, and of A; infinite if the
    /// noise of the samples explains the residuals.
    pub dof: [f64; 2],
    /// Number of turns used.
    pub turns: usize,
    /// Error of the predicted directions of gravity over the turns used, rad rms: uncalibrated, and
    /// corrected.
    pub before_rad: f64,
    /// Corrected.
    pub rms_rad: f64,
    /// Turns left out, by the index of the rest before, and why.
    pub left_out: Vec<(usize, TurnFault)>,
}

impl GyroscopeSession<'_> {
    /// Estimates the errors of the gyroscope.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn estimate(&self) -> Result<GyroscopeEstimate, Refusal> {
        let mut session = Session::new(self);
        let start = checks::plausible(&session)?;
        loop {
            let found =
                fit(&session, start).ok_or_else(|| checks::inconsistent(&Residuals::default()))?;
            let Residuals { largest, worst, count, .. } = found.angles;
            let (least, times, share) = OUTLIER;
            let is_outlier = largest > least.max(times * found.angles.others_rms());
            let left = session.contradicted.len();
            if is_outlier && share * (left + 1) <= count + left {
                session.contradicted.push(worst);
                continue;
            }
            if found.angles.rms() > LARGEST_RAD {
                return Err(checks::inconsistent(&found.angles));
            }
            return result(&session, &found)
                .map_err(|error| Refusal::out_of_bounds(error, "a gyroscope"));
        }
    }
}

/// The parameters of a perfect gyroscope.
fn perfect() -> Theta {
    Theta::from_fn(|i, _| if matches!(i, 3 | 7 | 11) { 1.0 } else { 0.0 })
}

/// A fit with the variances that its residuals show.
struct Found {
    fit: Fit,
    noise: Noise,
    squares: [Squares; 2],
    angles: Residuals,
}

/// Iterates the fit, and the variances with it: equation (149).
fn fit(session: &Session<'_>, start: checks::Start) -> Option<Found> {
    let mut at = Point::zeros();
    at.fixed_rows_mut::<PARAMETERS>(0).copy_from(&perfect());
    at.fixed_rows_mut::<3>(0).copy_from(&start.bias);
    let mut noise = Noise { sample: start.sample_variance, bias: BIAS_WALK, turn: TURN_ERROR[1] };
    let mut last = None;
    for round in 0..ROUNDS {
        let model = Rotations::new(session, &at, noise)?;
        let fit = model.fit(&at)?;
        let (squares, angles) = (model.squares(&fit)?, model.angles(&fit.at));
        at = fit.at;
        last = Some(Found { fit, noise, squares, angles });
        // The covariance of the residuals must be that near the solution before they show the noise.
        if round == 0 {
            continue;
        }
        let [rests, turns] = squares;
        let settled = [
            scale(&mut noise.bias, [BIAS_WALK; 2], rests),
            scale(&mut noise.turn, TURN_ERROR, turns),
        ];
        if settled == [true; 2] {
            break;
        }
    }
    last.filter(|found| found.fit.at.iter().all(|x| x.is_finite()))
}

/// Brings a variance to that of the residuals; the typical one if they are too few. Whether it was.
fn scale(variance: &mut f64, [least, typical]: [f64; 2], squares: Squares) -> bool {
    let (before, Squares { sum, dof }) = (*variance, squares);
    let ratio = sum / (dof + CHANCE * libm::sqrt(2.0 * dof.max(0.0)));
    *variance = if dof < LEAST_DOF { typical } else { (before * ratio).max(least) };
    *variance == before || dof >= LEAST_DOF && (ratio - 1.0).abs() < SETTLED
}

fn result(session: &Session<'_>, found: &Found) -> Result<GyroscopeEstimate, ModelError> {
    let Found { fit, noise, squares, angles } = found;
    let theta: Theta = fit.at.fixed_rows::<PARAMETERS>(0).into();
    let rows = |at: usize| [0, 1, 2].map(|r| [0, 1, 2].map(|c| theta[at + 3 * r + c]));
    let model = GyroscopeModel::new(GyroscopeTerms {
        bias_rad_s: [theta[0], theta[1], theta[2]],
        matrix: rows(MATRIX),
        g_sensitivity: rows(G_SENSITIVITY),
        ..GyroscopeTerms::default()
    })?;
    let mut covariance: SMatrix<f64, PARAMETERS, PARAMETERS> =
        fit.inverse.fixed_view::<PARAMETERS, PARAMETERS>(0, 0).into();
    // The vertical component of the Earth's rate is G = Ω/g on the diagonal.
    let earth = model::EARTH / (STANDARD_GRAVITY_MPS2 * STANDARD_GRAVITY_MPS2);
    for (a, b) in DIAGONAL.map(|a| DIAGONAL.map(|b| (a, b))).into_iter().flatten() {
        covariance[(G_SENSITIVITY + a, G_SENSITIVITY + b)] += earth;
    }
    // A constant bias is rounded alike at all rests.
    for axis in 0..3 {
        covariance[(axis, axis)] += session.rounding[axis];
    }
    let known = [noise.bias <= BIAS_WALK, noise.turn <= TURN_ERROR[0]];
    let dof = |k: usize| if known[k] { f64::INFINITY } else { squares[k].dof.max(LEAST_DOF) };
    Ok(GyroscopeEstimate {
        model,
        covariance: covariance.into(),
        dof: [dof(0), dof(1)],
        turns: angles.count,
        before_rad: session.angles(nalgebra::Matrix3::identity(), false).rms(),
        rms_rad: angles.rms(),
        left_out: session.left_out(&theta),
    })
}

impl GyroscopeEstimate {
    /// Standard deviation of a parameter, in the order of [`covariance`](Self::covariance).
    pub fn sd(&self, parameter: usize) -> f64 {
        let row = self.covariance.get(parameter);
        libm::sqrt(row.and_then(|row| row.get(parameter)).map_or(0.0, |v| v.max(0.0)))
    }

    /// Half width of its 95 % confidence interval: equation (43).
    pub fn half_width_95(&self, parameter: usize) -> f64 {
        let is_matrix = (MATRIX..G_SENSITIVITY).contains(&parameter);
        let [rests, turns] = self.dof;
        let dof = if is_matrix { turns } else { rests };
        student::two_sided(0.05, dof) * self.sd(parameter)
    }

    /// Whether the session determines it: its standard deviation is less than half that of datasheets.
    pub fn observed(&self, parameter: usize) -> bool {
        let prior = PRIOR_SD.get(parameter);
        let sd = self.sd(parameter);
        prior.is_some_and(|prior| sd * sd < OBSERVED * prior * prior)
    }

    /// The parameters for a board whose gyroscope has this range and sensitivity.
    ///
    /// # Errors
    /// [`ModelError`] if they are out of bounds.
    pub fn parameters(
        &self,
        range_dps: u16,
        rad_s_per_lsb: f64,
    ) -> Result<GyroscopeParameters, ModelError> {
        let sd = core::array::from_fn(|i| self.sd(i) as f32);
        GyroscopeParameters::new(range_dps, rad_s_per_lsb, self.model, Some(sd))
    }

    /// The movement that would improve the result most; `None` if A is known to 0.1 % and G is observed.
    pub fn advice(&self) -> Option<String> {
        let worst = |first: usize| {
            let sd =
                |axis: usize| (0..3).map(|row| self.sd(first + 3 * row + axis)).fold(0.0, f64::max);
            (0..3)
                .map(|axis| (sd(axis), axis))
                .fold((0.0, 0), |most, new| if new.0 > most.0 { new } else { most })
        };
        let (sd, axis) = worst(MATRIX);
        if sd > GOOD_ENOUGH {
            return Some(format!(
                "hold axis {} level, rotate by 90° to 180° about it within three seconds, and hold still; start with \
                 different sides up",
                axis_name(axis)
            ));
        }
        let name = axis_name(worst(G_SENSITIVITY).1);
        let is_unknown = (G_SENSITIVITY..PARAMETERS).any(|i| !self.observed(i));
        is_unknown.then(|| format!("hold still with {name} up, and with {name} down"))
    }
}
