//! Verification of a stored calibration, and its update as the prior of the same fit: equation (48).

use nalgebra::{DMatrix, DVector};
use wimu_model::{ErrorModel, ModelError, ParameterSet};

use crate::force;
use crate::least_squares::{Fit, Rows};
use crate::terms::{self, Theta};
use crate::{Covariance, Gravity, Parameter, Pose};

/// Standard deviations of the changes of a sensor since its calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ageing {
    /// Turn-on bias repeatability, m/s² per axis.
    pub turn_on_mps2: f64,
    /// Bias temperature sensitivity beyond the model, m/s² per K per axis.
    pub per_kelvin_mps2: f64,
    /// Deviation between poses besides noise, m/s².
    pub pose_mps2: f64,
}

impl Default for Ageing {
    /// Turn-on bias 15 mm/s² (MPU-9150: 10 to 20), 5 mm/s² per K (½ mg, from datasheets), 3 mm/s²
    /// between poses.
    fn default() -> Self {
        Self { turn_on_mps2: 0.015, per_kelvin_mps2: 0.005, pose_mps2: 0.003 }
    }
}

/// Result of a check with one pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Check {
    /// Residual |f| − g before the update, m/s².
    pub residual_mps2: f64,
    /// Standard deviation of the residual if the calibration holds, m/s².
    pub expected_sd_mps2: f64,
    /// Whether the calibration holds at this pose: significance level 10⁻³. A pose that contradicts
    /// it is not used for the update.
    pub holds: bool,
}

/// Quantile of the normal distribution, two-sided, 10⁻³.
const MOST_DEVIATIONS: f64 = 3.2905;

/// A stored calibration that is verified and updated at every rest.
///
/// Measured with the default ageing, 1000 runs of twelve rests, turn-on bias 15 mm/s² per axis: 0.8
/// % of the runs contradict the calibration at a rest, none at two successive rests. A bias step after six rests is contradicted within the next six, and
/// contradicted at two successive rests, in 9 and 0.4 % of the runs for 10 mm/s², in 72 and 25 % for 20, in 96 and
/// 67 % for 30, and in 100 and 92 % for 50.
///
/// ```
/// use wimu_calib::{Ageing, Covariance, Gravity, Pose, SelfCheck};
/// use wimu_model::ErrorModel;
///
/// let stored = ErrorModel::default();
/// let known = [[0.0; 12]; 12]; // as of an estimate: `estimate.covariance.matrix()`
/// let mut check = SelfCheck::new(&stored, &known, Gravity::UNKNOWN_PLACE, Ageing::default());
/// let at_rest = Pose::from_mean([0.0, 0.010, 9.810]);
/// assert!(check.push(&at_rest).is_some_and(|check| check.holds));
/// let knocked = Pose::from_mean([0.0, 0.010, 9.950]);
/// assert!(check.push(&knocked).is_some_and(|check| !check.holds));
/// // The rest updated the model.
/// assert!(check.model()?.terms().bias_mps2[2] > 0.0);
/// # Ok::<(), wimu_model::ModelError>(())
/// ```
#[derive(Clone, Debug)]
pub struct SelfCheck {
    stored: ErrorModel,
    /// Without the uncertainty of gravity.
    fit: Fit<Theta>,
    gravity: Gravity,
    ageing: Ageing,
    /// Standard deviation of the bias per kelvin, m/s², within the calibrated temperatures, °C, and those.
    slope_sd: [f64; 3],
    seen_c: [f64; 2],
    /// Temperature of the calibration, else of the first rest, and of the latest rest, °C.
    temperatures_c: Option<[f64; 2]>,
    poses: u32,
    contradictions: u32,
}

impl SelfCheck {
    /// A check of `stored`, whose 12 parameters have `covariance` (in the order of
    /// [`Parameter::ALL`]), calibrated and used at `gravity`. The uncertainty of gravity is removed
    /// from the covariance, because it does not affect |f| − g.
    pub fn new(
        stored: &ErrorModel,
        covariance: &[[f64; Parameter::COUNT]; Parameter::COUNT],
        gravity: Gravity,
        ageing: Ageing,
    ) -> Self {
        let theta = terms::theta_of(stored);
        let mut covariance = Covariance::from_matrix(covariance);
        covariance.remove_gravity(&theta, gravity);
        let turn_on = ageing.turn_on_mps2 * ageing.turn_on_mps2;
        for bias in Parameter::BIAS {
            covariance.add(bias, bias, turn_on);
        }
        Self {
            stored: *stored,
            fit: Fit {
                rows: Rows::zeros(0, 0),
                at: theta,
                inverse: DMatrix::from_fn(12, 12, |r, c| covariance.matrix()[r][c]),
                cost: 0.0,
            },
            gravity,
            ageing,
            slope_sd: [ageing.per_kelvin_mps2; 3],
            seen_c: [f64::NEG_INFINITY, f64::INFINITY],
            temperatures_c: None,
            poses: 0,
            contradictions: 0,
        }
    }

    /// A check of the calibration that a device stores; `None` if it has no quality record.
    ///
    /// If its model has a temperature term of the bias, the ageing with temperature is the standard
    /// deviation of that term within the calibrated temperatures. Outside them, and without such a
    /// term, it is [`Ageing::per_kelvin_mps2`].
    pub fn of(set: &ParameterSet, gravity: Gravity, ageing: Ageing) -> Option<Self> {
        let quality = set.quality.as_ref()?.terms();
        let mut check = Self::new(&set.model, &quality.covariance.matrix(), gravity, ageing);
        check.temperatures_c = quality.temperature.map(|t| [f64::from(t.mean_c); 2]);
        if let Some(seen) = quality.temperature
            && set.model.terms().temperature.bias_mps2_per_k != [0.0; 3]
        {
            check.slope_sd = quality.other_sd.bias_mps2_per_k.map(f64::from);
            check.seen_c = [f64::from(seen.lowest_c), f64::from(seen.highest_c)];
        }
        Some(check)
    }

    /// Checks a rest and updates the model. `None` if the pose is not finite, or |f| differs from
    /// gravity by more than half.
    pub fn push(&mut self, pose: &Pose) -> Option<Check> {
        let terms = self.stored.terms().temperature;
        let celsius = pose.temperature_c.filter(|celsius| celsius.is_finite());
        let warmer = celsius.map_or(0.0, |celsius| celsius - terms.reference_c);
        let mut output = pose.mean_mps2;
        for axis in 0..3 {
            output[axis] -= terms.bias_mps2_per_k2[axis] * warmer * warmer;
        }
        let g = self.gravity.mps2();
        let (force, row) = force::magnitude(&self.fit.at, output, warmer)
            .filter(|(force, _)| (0.5 * g..1.5 * g).contains(force))?;

        if let Some(now) = celsius {
            let [from, before] = *self.temperatures_c.get_or_insert([now; 2]);
            for axis in 0..3 {
                let moved = |to: f64| self.thermal_sd(axis, to) - self.thermal_sd(axis, from);
                let more = moved(now) * moved(now) - moved(before) * moved(before);
                self.fit.inverse[(axis, axis)] += more.max(0.0);
            }
            self.temperatures_c = Some([from, now]);
        }

        let residual_mps2 = force - g;
        let row = DVector::from_row_slice(&row);
        let apart = self.ageing.pose_mps2 * self.ageing.pose_mps2 + pose.mean_noise();
        let variance = self.fit.variance(&row) + apart;
        let expected_sd_mps2 = libm::sqrt(variance);
        let holds = residual_mps2.abs() <= MOST_DEVIATIONS * expected_sd_mps2;
        self.poses = self.poses.saturating_add(1);
        if holds {
            let weight = 1.0 / apart.max(f64::MIN_POSITIVE);
            let step = self.fit.change(&row, residual_mps2, weight);
            self.fit.at.iter_mut().zip(&step).for_each(|(theta, step)| *theta += step);
        } else {
            self.contradictions = self.contradictions.saturating_add(1);
        }
        Some(Check { residual_mps2, expected_sd_mps2, holds })
    }

    /// Integral over temperature of the standard deviation of the bias per kelvin, m/s².
    fn thermal_sd(&self, axis: usize, celsius: f64) -> f64 {
        let [low, high] = self.seen_c;
        let within = celsius.max(low).min(high);
        self.slope_sd[axis] * within + self.ageing.per_kelvin_mps2 * (celsius - within)
    }

    /// Number of poses.
    pub fn poses(&self) -> u32 {
        self.poses
    }

    /// Number of poses that contradicted the calibration.
    pub fn contradictions(&self) -> u32 {
        self.contradictions
    }

    /// The updated model.
    ///
    /// # Errors
    /// [`ModelError`] when a parameter is outside the bounds of an accelerometer.
    pub fn model(&self) -> Result<ErrorModel, ModelError> {
        let mut updated = *self.stored.terms();
        updated.bias_mps2 = terms::bias(&self.fit.at);
        updated.matrix = terms::matrix(&self.fit.at);
        ErrorModel::new(updated)
    }

    /// Covariance of the 12 parameters, including the uncertainty of gravity.
    pub fn covariance(&self) -> Covariance {
        let element = |r, c| self.fit.inverse[(r, c)];
        let matrix = core::array::from_fn(|r| core::array::from_fn(|c| element(r, c)));
        let mut covariance = Covariance::from_matrix(&matrix);
        covariance.add_gravity(&self.fit.at, self.gravity);
        covariance
    }
}
