//! Calibration of an accelerometer array: one batch maximum-a-posteriori fit, equation (99).
//!
//! [`fit_array`] estimates bias, matrix row and position of each axis and the delay of each sensor from rests and from
//! samples in motion, with their posterior covariance, and tests whether the recording agrees with the geometry.

mod estimate;
mod fit;
mod motion;
mod moving;
mod rests;
mod size;

pub use estimate::{Agreement, ArrayEstimate, fit_array};

use crate::Gravity;

/// Recording of all axes of an array.
#[derive(Clone, Copy, Debug)]
pub struct ArrayData<'a, const M: usize> {
    /// Time of each sample, s, increasing.
    pub times_s: &'a [f64],
    /// Outputs of each sample in the order of the axes of the geometry, m/s². NaN: missing or saturated.
    pub outputs_mps2: &'a [[f64; M]],
    /// Rests, in order: first sample and number of samples.
    pub rests: &'a [(usize, usize)],
    /// Sample period, s.
    pub period_s: f64,
    /// Every n-th sample in motion is used; 1 for all.
    pub stride: usize,
}

/// Prior standard deviations: from a datasheet, or as stated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArrayPrior {
    /// Bias of an axis, m/s².
    pub bias_mps2: f64,
    /// Entry of the matrix (scale factor, misalignment), 1.
    pub matrix: f64,
    /// Coordinate of the position of an axis, m.
    pub position_m: f64,
    /// Delay of a sensor, s: it samples this much later than its times say. The mean delay is not observed.
    pub delay_s: f64,
    /// Change of a bias from rest to rest, m/s².
    pub repeatability_mps2: f64,
    /// Length of the specific force at rest, m/s²: local gravity, or that in the scale of uncalibrated sensors.
    pub gravity_mps2: f64,
    /// Its standard deviation, m/s².
    pub gravity_sd_mps2: f64,
}

impl Default for ArrayPrior {
    /// A consumer sensor off the reel (MPU-9150 datasheet: ±50 mg, ±3 % scale, ±2 % cross-axis) on a board from CAD.
    fn default() -> Self {
        Self {
            bias_mps2: 0.5,
            matrix: 0.03,
            position_m: 5e-4,
            delay_s: 3e-4,
            repeatability_mps2: 0.015,
            gravity_mps2: Gravity::UNKNOWN_PLACE.mps2(),
            gravity_sd_mps2: Gravity::UNKNOWN_PLACE.sd_mps2(),
        }
    }
}
