//! What a calibration gives back.

use core::fmt;

use wimu_model::{CentiCelsius, ErrorModel, Matrix3, SpecificForceMps2};

use crate::linear::Real;
use crate::terms::{self, Slot, Terms, Theta};
use crate::weights::Rejected;
use crate::{Covariance, Face, Gravity, Model, Parameter, Parameters, Pose, force, student};

/// An error model and how good it is.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Estimate {
    /// The error model.
    pub model: ErrorModel,
    /// How it was estimated.
    pub method: Method,
    /// The terms fitted on top of the 12 parameters.
    pub terms: Terms,
    /// Which of the 12 parameters were fitted.
    pub fitted: Parameters,
    /// Covariance of the 12 parameters, that of gravity and of the terms included: at the last pose
    /// where there is drift, at the reference temperature where it matters.
    pub covariance: Covariance,
    /// Standard deviations of the terms.
    pub term_sd: TermDeviations,
    /// The gravity it rests on.
    pub gravity: Gravity,
    /// How many poses were fitted.
    pub poses: usize,
    /// How many orientations these are: poses within 10° of each other count as visits of one.
    pub orientations: usize,
    /// Degrees of freedom: observations beyond the parameters fitted.
    pub dof: usize,
    /// Degrees of freedom of the standard deviations, without what gravity adds to them, for
    /// [`Estimate::half_width_95`]; `None` where they rest on a declared placement error and not on residuals.
    pub interval_dof: Option<f64>,
    /// |f| − g over all poses given, rejected ones included, m/s² rms, unweighted.
    pub rms_mps2: f64,
    /// The largest | |f| − g |, m/s².
    pub max_mps2: f64,
    /// The pose that has it, index into those given.
    pub worst_pose: usize,
    /// |f| − g of each pose under the model fitted without it, m/s² rms over all poses; `None`
    /// where a pose cannot be spared (six-position with one pose a side).
    pub loo_rms_mps2: Option<f64>,
    /// The same with all visits of the pose's orientation left out, which is what decides; `None` where none
    /// came again. Beyond 256 poses those that came again have no part in it.
    pub loo_orientation_rms_mps2: Option<f64>,
    /// Poses that the others contradict beyond chance, left out of the fit.
    pub rejected: Rejected,
    /// Condition of the Jacobian, its parameters scaled to m/s² at 1 g; 1 is best.
    pub condition: f64,
    /// Standard deviation of |f| − g to be expected in the worst of 26 orientations, m/s².
    pub worst_sd_mps2: f64,
    /// Share of the 26 orientations that are within 40° of a pose's, 0..=1.
    pub coverage: f64,
    /// Mean temperature of the poses, °C, where they have one.
    pub temperature_c: Option<f64>,
    /// Lowest and highest temperature of the poses, °C, where all have one: temperature terms hold
    /// between them.
    pub temperature_range_c: Option<[f64; 2]>,
    /// How the bias moved, where [`Term::Drift`](crate::Term::Drift) was fitted.
    pub drift: Option<Drift>,
}

impl Estimate {
    /// Of the 12 parameters those that nothing was seen of: the model has those of a perfect sensor,
    /// the covariance what datasheets make likely. Not among them are those that gravity alone leaves
    /// to choice, which are 0 by choice.
    pub fn not_observed(&self) -> Parameters {
        let chosen: Parameters = match self.method {
            Method::MultiPosition(_) => {
                use Parameter::{MisalignmentYx, MisalignmentZx, MisalignmentZy};
                [MisalignmentYx, MisalignmentZx, MisalignmentZy]
                    .into_iter()
                    .collect()
            }
            Method::SixPosition { .. } | Method::FourAngle | Method::ThreeAngle => {
                Parameters::default()
            }
        };
        Parameters::ALL.without(self.fitted).without(chosen)
    }

    /// Standard deviations of the parameters in the shape of the model; for one that was not
    /// observed what datasheets make likely.
    pub fn sd(&self) -> Deviations {
        let sd = Parameter::ALL.map(|parameter| self.covariance.sd(parameter));
        Deviations {
            bias_mps2: [sd[0], sd[1], sd[2]],
            matrix: [
                [sd[3], sd[4], sd[5]],
                [sd[6], sd[7], sd[8]],
                [sd[9], sd[10], sd[11]],
            ],
        }
    }

    /// The 95 % interval of a parameter is its value plus and minus this, in its unit: Student's t
    /// with [`Estimate::interval_dof`], more for what rests on gravity, whose uncertainty no residual
    /// tells: equation (43).
    pub fn half_width_95(&self, parameter: Parameter) -> f64 {
        let quantile = student::two_sided(0.05, self.dof_of(parameter));
        quantile * self.covariance.sd(parameter)
    }

    /// Degrees of freedom of a parameter's standard deviation; infinite where none of it is from
    /// residuals.
    fn dof_of(&self, parameter: Parameter) -> f64 {
        let Some(dof) = self.interval_dof else {
            return f64::INFINITY;
        };
        let variance = self.covariance.get(parameter, parameter);
        let theta = terms::theta_of(&self.model);
        let of_gravity = self.covariance.of_gravity(&theta, self.gravity, parameter);
        let share = (variance - of_gravity) / variance;
        if share > 0.0 {
            dof / (share * share)
        } else {
            f64::INFINITY
        }
    }

    /// |f| − g that this model leaves in `pose`, m/s²; at its time and temperature where those are
    /// in the model.
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

/// How the bias moved over a session, in proportion to time.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Drift {
    /// From the first pose to the last, m/s².
    pub change_mps2: [f64; 3],
    /// Time of the last pose, at which the model's bias holds, s.
    pub end_s: f64,
    /// From the first pose to the last, s.
    pub span_s: f64,
}

/// How an estimate was made.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Method {
    /// Six known orientations, 12 parameters.
    SixPosition {
        /// Placement error that the covariance includes, rad, 1 σ about each axis: what was
        /// declared or what the poses show, whichever is larger. A pair of sides that stands out is
        /// not in it.
        placement_sd_rad: f64,
        /// What was declared.
        declared_sd_rad: f64,
        /// A side that was placed much worse than the others; the covariance of its axis includes it.
        misplaced: Option<Misplaced>,
        /// What else a position differs by from one visit to the next, m/s², 1 σ, in the covariance
        /// too: as visits of one side show, and as real sensors have it where there are few.
        revisit_sd_mps2: f64,
        /// Visits beyond the first of each side.
        revisits: usize,
        /// Whether they differ by more than noise and placement explain.
        unexplained: bool,
    },
    /// Any orientations, from the magnitude of gravity.
    MultiPosition(Model),
    /// Turns of four steps about a level axis, bias and scale factor of the axes in the plane.
    FourAngle,
    /// Turns of three steps about a level axis.
    ThreeAngle,
}

impl fmt::Display for Method {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SixPosition { .. } => out.write_str("six-position"),
            Self::MultiPosition(model) => write!(out, "multi-position, {model}"),
            Self::FourAngle => out.write_str("four-angle"),
            Self::ThreeAngle => out.write_str("three-angle"),
        }
    }
}

/// A side that was put down much worse than the others.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Misplaced {
    /// The side, or one of the pair.
    pub face: Face,
    /// Whether it may as well be the opposite side: what tells them apart is that the sensor's axes are
    /// square to a degree or two.
    pub or_opposite: bool,
    /// Its tilt, if it is one side, rad.
    pub tilt_rad: f64,
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

/// Standard deviations, 1 σ, of what [`Terms`] add; 0 for what was not fitted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TermDeviations {
    /// Of the drift from the first pose to the last, m/s².
    pub drift_mps2: [f64; 3],
    /// Of b₁, m/s² per K.
    pub bias_mps2_per_k: [f64; 3],
    /// Of s₁, 1/K.
    pub scale_per_k: [f64; 3],
    /// Of q, s²/m.
    pub nonlinearity: [f64; 3],
}

impl TermDeviations {
    /// That of one parameter; 0 where it is no term's.
    pub(crate) fn get(&self, slot: Slot) -> f64 {
        let group = match slot.term() {
            None => return 0.0,
            Some(terms::Term::Drift) => &self.drift_mps2,
            Some(terms::Term::BiasTemperature) => &self.bias_mps2_per_k,
            Some(terms::Term::ScaleTemperature) => &self.scale_per_k,
            Some(terms::Term::Quadratic) => &self.nonlinearity,
        };
        group[slot.index() % 3]
    }

    /// Sets that of one parameter, where it is a term's.
    pub(crate) fn set(&mut self, slot: Slot, sd: f64) {
        let Some(term) = slot.term() else { return };
        let group = match term {
            terms::Term::Drift => &mut self.drift_mps2,
            terms::Term::BiasTemperature => &mut self.bias_mps2_per_k,
            terms::Term::ScaleTemperature => &mut self.scale_per_k,
            terms::Term::Quadratic => &mut self.nonlinearity,
        };
        group[slot.index() % 3] = sd;
    }
}

/// |f| − g over poses.
#[derive(Clone, Copy, Default)]
pub(crate) struct Residuals {
    squares: f64,
    count: f64,
    pub largest_mps2: f64,
    pub worst_pose: usize,
}

impl Residuals {
    /// Those of the first twelve parameters.
    pub fn of<'a, R: Real>(
        theta: &Theta<R>,
        poses: impl Iterator<Item = &'a Pose>,
        gravity_mps2: f64,
    ) -> Self {
        let mut residuals = Self::default();
        for (k, pose) in poses.enumerate() {
            residuals.add(k, force::residual(theta, pose, gravity_mps2));
        }
        residuals
    }

    pub fn add(&mut self, pose: usize, residual_mps2: f64) {
        let size = residual_mps2.abs();
        self.squares += size * size;
        self.count += 1.0;
        if size > self.largest_mps2 {
            self.largest_mps2 = size;
            self.worst_pose = pose;
        }
    }

    pub fn rms_mps2(&self) -> f64 {
        libm::sqrt(self.squares / self.count)
    }
}
