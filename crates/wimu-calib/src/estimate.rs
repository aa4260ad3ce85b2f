//! What a calibration gives back.

use core::fmt;

use wimu_model::{ErrorModel, Matrix3, SpecificForceMps2};

use crate::least_squares::Theta;
use crate::{Gravity, Model, Parameter, Pose};

/// An error model and how good it is.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Estimate {
    /// The error model.
    pub model: ErrorModel,
    /// How it was estimated.
    pub method: Method,
    /// Covariance of the 12 parameters, that of gravity included.
    pub covariance: Covariance,
    /// The gravity it rests on.
    pub gravity: Gravity,
    /// How many poses were fitted.
    pub poses: usize,
    /// Degrees of freedom: observations beyond the parameters fitted.
    pub dof: usize,
    /// |f| − g over all poses given, m/s² rms, unweighted.
    pub rms_mps2: f64,
    /// The largest | |f| − g |, m/s².
    pub max_mps2: f64,
    /// The pose that has it, index into those given.
    pub worst_pose: usize,
    /// |f| − g of each pose under the model fitted without it, m/s² rms; `None` where a pose
    /// cannot be spared (six-position with one pose a side).
    pub loo_rms_mps2: Option<f64>,
    /// Condition of the Jacobian, its parameters scaled to m/s² at 1 g; 1 is best.
    pub condition: f64,
    /// Standard deviation of |f| − g to be expected in the worst of 26 orientations, m/s².
    pub worst_sd_mps2: f64,
    /// Mean temperature of the poses, °C, where they have one.
    pub temperature_c: Option<f64>,
}

impl Estimate {
    /// Standard deviations of the parameters in the shape of the model; 0 for one that was not
    /// fitted.
    pub fn sd(&self) -> Deviations {
        let sd = Parameter::ALL.map(|parameter| self.covariance.sd(parameter));
        Deviations {
            bias_mps2: crate::least_squares::bias(&sd),
            matrix: crate::least_squares::matrix(&sd),
        }
    }

    /// |f| − g that this model leaves in `pose`, m/s².
    pub fn residual_mps2(&self, pose: &Pose) -> f64 {
        residual_mps2(&self.model, self.gravity, pose)
    }
}

/// How an estimate was made.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Method {
    /// Six known orientations, 12 parameters.
    SixPosition {
        /// Placement error that the covariance includes, rad, 1 σ about each axis: what was
        /// declared or what the poses show, whichever is larger.
        placement_sd_rad: f64,
    },
    /// Any orientations, from the magnitude of gravity.
    MultiPosition(Model),
}

impl Method {
    /// How many parameters were fitted.
    pub fn parameters(self) -> usize {
        match self {
            Self::SixPosition { .. } => Parameter::COUNT,
            Self::MultiPosition(model) => model.parameters(),
        }
    }
}

impl fmt::Display for Method {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SixPosition { .. } => out.write_str("six-position"),
            Self::MultiPosition(model) => write!(out, "multi-position, {model}"),
        }
    }
}

/// Standard deviations, 1 σ, of an error model's terms.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Deviations {
    /// Of the bias, m/s².
    pub bias_mps2: [f64; 3],
    /// Of A.
    pub matrix: Matrix3,
}

/// Covariance of the 12 parameters of y = b + A f: m/s² for the bias, 1 for A.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Covariance([[f64; Parameter::COUNT]; Parameter::COUNT]);

impl Covariance {
    /// Covariance of two parameters, in the product of their units; 0 where one was not fitted.
    pub fn get(&self, a: Parameter, b: Parameter) -> f64 {
        self.0[a.index()][b.index()]
    }

    /// Standard deviation of a parameter, in its unit.
    pub fn sd(&self, parameter: Parameter) -> f64 {
        libm::sqrt(self.get(parameter, parameter).max(0.0))
    }

    /// All of it, in the order of [`Parameter::ALL`].
    pub fn matrix(&self) -> &[[f64; Parameter::COUNT]; Parameter::COUNT] {
        &self.0
    }

    pub(crate) const ZERO: Self = Self([[0.0; Parameter::COUNT]; Parameter::COUNT]);

    pub(crate) fn add(&mut self, a: Parameter, b: Parameter, covariance: f64) {
        self.0[a.index()][b.index()] += covariance;
    }

    /// Adds that of gravity: A goes with 1/g, so its relative error is common to all of A.
    /// The last term of equation (15).
    pub(crate) fn add_gravity(&mut self, theta: &Theta, gravity: Gravity) {
        let relative = gravity.sd_mps2() / gravity.mps2();
        for i in 3..Parameter::COUNT {
            for j in 3..Parameter::COUNT {
                self.0[i][j] += theta[i] * theta[j] * relative * relative;
            }
        }
    }
}

/// |f| − g over poses.
#[derive(Clone, Copy, Default)]
pub(crate) struct Residuals {
    pub rms_mps2: f64,
    pub max_mps2: f64,
    pub worst_pose: usize,
}

impl Residuals {
    pub fn of<'a>(
        model: &ErrorModel,
        gravity: Gravity,
        poses: impl Iterator<Item = &'a Pose>,
    ) -> Self {
        let mut residuals = Self::default();
        let mut squares = 0.0;
        let mut count = 0.0;
        for (k, pose) in poses.enumerate() {
            let residual = residual_mps2(model, gravity, pose).abs();
            squares += residual * residual;
            count += 1.0;
            if residual > residuals.max_mps2 {
                residuals.max_mps2 = residual;
                residuals.worst_pose = k;
            }
        }
        residuals.rms_mps2 = libm::sqrt(squares / count);
        residuals
    }
}

pub(crate) fn residual_mps2(model: &ErrorModel, gravity: Gravity, pose: &Pose) -> f64 {
    let force = model.correct(SpecificForceMps2(pose.mean_mps2), None);
    force.norm() - gravity.mps2()
}
