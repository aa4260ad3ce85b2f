//! Result of a calibration.

use alloc::vec::Vec;

use nalgebra::DMatrix;
use wimu_model::{CalibrationMethod, CentiCelsius, ErrorModel, ErrorTerms, SpecificForceMps2};

use crate::magnitude::condition;
use crate::terms::{self, Term, Terms};
use crate::{Covariance, Gravity, Parameter, Parameters, Pose, student};

/// An error model and its quality.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Estimate {
    /// The error model.
    pub model: ErrorModel,
    /// How it was estimated.
    pub method: CalibrationMethod,
    /// The placement, with six known orientations.
    pub sides: Option<Sides>,
    /// The terms fitted in addition to the 12 parameters.
    pub terms: Terms,
    /// Which of the 12 parameters were fitted.
    pub fitted: Parameters,
    /// Those of them that the priors determine more than the poses do.
    pub assumed: Parameters,
    /// Covariance of the 12 parameters, including the uncertainty of gravity and of the terms; with
    /// drift at the last pose, with temperature terms at the reference temperature.
    pub covariance: Covariance,
    /// Standard deviations of the terms, in the order of [`Term::ALL`]: m/s² from the first pose to the last, m/s² per K,
    /// 1/K and s²/m; 0 for those that were not fitted.
    pub term_sd: [[f64; 3]; Term::ALL.len()],
    /// The reference gravity.
    pub gravity: Gravity,
    /// Number of fitted poses.
    pub poses: usize,
    /// Number of orientations: poses within 10° of each other have the same one.
    pub orientations: usize,
    /// Degrees of freedom: observations minus fitted parameters.
    pub dof: usize,
    /// Degrees of freedom of the standard deviations, without the contribution of gravity, for
    /// [`Estimate::half_width_95`]; `None` if they follow from a declared placement error instead
    /// of residuals.
    pub interval_dof: Option<f64>,
    /// Fraction of the variance of each parameter that is the priors' uncertainty, which no residual measures.
    pub(crate) prior_shares: [f64; Parameter::COUNT],
    /// Residual |f| − g over all given poses, including rejected ones, m/s² rms, unweighted.
    pub rms_mps2: f64,
    /// The same over the fitted poses only.
    pub fitted_rms_mps2: f64,
    /// Largest absolute residual, m/s².
    pub max_mps2: f64,
    /// Index of the pose with the largest residual.
    pub worst_pose: usize,
    /// Leave-one-out error: residual of each fitted pose under the model fitted without it, m/s² rms;
    /// `None` if a pose cannot be left out (six-position with one pose per side).
    pub loo_rms_mps2: Option<f64>,
    /// Leave-one-out error with whole orientations left out, which is the one that is judged;
    /// `None` if no orientation is repeated. With more than 256 poses, repeated orientations are
    /// not included.
    pub loo_orientation_rms_mps2: Option<f64>,
    /// Standard deviation of a fitted pose's residual besides known noise, m/s²; 0 for methods with
    /// known orientations.
    pub pose_sd_mps2: f64,
    /// Indices of the poses rejected as outliers.
    pub rejected: Vec<usize>,
    /// Cofactor matrix (JᵀJ)⁻¹ of the fitted parameters, scaled to m/s² at 1 g; empty for an orthogonal design.
    pub(crate) cofactors: DMatrix<f64>,
    /// Predicted standard deviation of |f| − g in the worst of 26 orientations, m/s².
    pub worst_sd_mps2: f64,
    /// Mean temperature of the poses that have one, °C.
    pub temperature_c: Option<f64>,
    /// Lowest and highest temperature of the poses, °C, if all have one: the range of validity of
    /// the temperature terms.
    pub temperature_range_c: Option<[f64; 2]>,
    /// Drift of the bias, if [`Term::Drift`](crate::Term::Drift) was fitted.
    pub drift: Option<Drift>,
}

impl Estimate {
    /// An estimate of all 12 parameters without terms from an orthogonal design, whose covariance
    /// and counts are still to be set.
    pub(crate) fn orthogonal(
        model: ErrorModel,
        method: CalibrationMethod,
        gravity: Gravity,
        residuals: &Residuals,
    ) -> Self {
        Self {
            model,
            method,
            gravity,
            fitted: Parameters::ALL,
            rms_mps2: residuals.rms(),
            fitted_rms_mps2: residuals.rms(),
            max_mps2: residuals.largest,
            worst_pose: residuals.worst,
            ..Self::default()
        }
    }

    /// The parameters that were not observed: the model has those of a perfect sensor, the
    /// covariance the tolerances of typical datasheets. Not included are the three that are 0 by
    /// convention because gravity alone does not determine a rotation.
    pub fn not_observed(&self) -> Parameters {
        if self.method == CalibrationMethod::MultiPosition {
            return Parameters::default();
        }
        Parameters::ALL.without(self.fitted)
    }

    /// Condition number of the Jacobian, with its parameters scaled to m/s² at 1 g; 1 is best.
    pub fn condition(&self) -> f64 {
        if self.cofactors.is_empty() { 1.0 } else { condition(&self.cofactors) }
    }

    /// Standard deviations of the parameters and terms in the form of the model: for unobserved ones the tolerance of
    /// typical datasheets, 0 for terms that were not fitted.
    pub fn sd(&self) -> ErrorTerms {
        self.covariance.deviations(&self.term_sd)
    }

    /// Half width of the 95 % confidence interval of a parameter, in its unit: Student's t with
    /// [`Estimate::interval_dof`] for what the residuals measure, the normal distribution for the contributions of gravity
    /// and of priors. Equation (43).
    pub fn half_width_95(&self, parameter: Parameter) -> f64 {
        let variance = self.covariance.get(parameter, parameter);
        let theta = terms::theta_of(&self.model);
        let of_gravity = self.covariance.of_gravity(&theta, self.gravity, parameter);
        let share = 1.0 - self.prior_shares[parameter.index()];
        let dof = self.interval_dof.unwrap_or(f64::INFINITY);
        let measured = if dof.is_finite() { (variance - of_gravity) * share } else { 0.0 };
        let quantile = |dof: f64| student::two_sided(0.05, dof);
        let (t, z) = (quantile(dof), quantile(f64::INFINITY));
        let squares = measured * t * t + (variance - measured) * z * z;
        libm::sqrt(squares)
    }

    /// Residual |f| − g of `pose`, m/s², at its time and temperature as far as the model depends on
    /// them.
    pub fn residual_mps2(&self, pose: &Pose) -> f64 {
        let mut pose = *pose;
        if let Some(drift) = self.drift {
            let progress = (pose.time_s - drift.end_s) / drift.span_s;
            for axis in 0..3 {
                pose.mean_mps2[axis] -= drift.change_mps2[axis] * progress;
            }
        }
        let temperature = pose.temperature_c.map(CentiCelsius::from_celsius);
        let output = SpecificForceMps2(pose.mean_mps2);
        self.model.correct(output, temperature).norm() - self.gravity.mps2()
    }
}

/// Linear drift of the bias over a session.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    /// From the first pose to the last, m/s².
    pub change_mps2: [f64; 3],
    /// Time of the last pose, at which the model's bias holds, s.
    pub end_s: f64,
    /// From the first pose to the last, s.
    pub span_s: f64,
}

/// How the sensor was placed in six known orientations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sides {
    /// Placement error in the covariance, rad, 1 σ about each axis: the declared one or, if the poses contradict it, the one
    /// that they show.
    pub placement_sd_rad: f64,
    /// The declared placement error, rad.
    pub declared_sd_rad: f64,
    /// Standard deviation between visits of a side, m/s², also in the covariance: with few visits mostly that of typical
    /// sensors.
    pub revisit_sd_mps2: f64,
    /// Poses beyond the first of each side.
    pub revisits: usize,
}

/// Rms of residuals, and the largest one.
#[derive(Clone, Copy, Default)]
pub(crate) struct Residuals {
    squares: f64,
    pub count: usize,
    pub largest: f64,
    /// Index of the largest.
    pub worst: usize,
}

impl Residuals {
    /// Of those with their indices.
    pub fn of(residuals: impl Iterator<Item = (usize, f64)>) -> Self {
        residuals.fold(Self::default(), |mut all, (index, residual)| {
            let size = residual.abs();
            (all.squares, all.count) = (all.squares + size * size, all.count + 1);
            if size > all.largest {
                (all.largest, all.worst) = (size, index);
            }
            all
        })
    }

    pub fn rms(&self) -> f64 {
        libm::sqrt(self.squares / self.count.max(1) as f64)
    }

    /// The rms without the largest.
    pub fn others_rms(&self) -> f64 {
        let rest = self.squares - self.largest * self.largest;
        libm::sqrt(rest.max(0.0) / self.count.saturating_sub(1).max(1) as f64)
    }
}
