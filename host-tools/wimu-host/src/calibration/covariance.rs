//! Covariances in calibration files.

use serde::{Deserialize, Serialize};
use wimu_calib::Parameter;
use wimu_model::{ModelCovariance, RotationCovariance};

/// A covariance matrix L Lᵀ and the order of its parameters.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Covariance {
    order: Vec<String>,
    /// L, lower triangular, row by row: exactly as a board stores it.
    cholesky: Vec<Vec<f32>>,
}

impl Covariance {
    pub(super) fn new<const N: usize>(order: [String; N], factor: &[f32]) -> Self {
        let row = |row: usize| factor.iter().skip(row * (row + 1) / 2).take(row + 1);
        Self { order: order.into(), cholesky: (0..N).map(|n| row(n).copied().collect()).collect() }
    }

    /// The elements of L, if it has this order.
    fn factor<const N: usize>(&self, order: [String; N]) -> std::result::Result<Vec<f32>, String> {
        let rows = self.cholesky.iter().map(Vec::len);
        if self.order != order || !rows.eq(1..=N) {
            return Err(format!("a covariance is not one of {}", order.join(", ")));
        }
        Ok(self.cholesky.concat())
    }

    pub(super) fn of_model(&self) -> std::result::Result<ModelCovariance, String> {
        let factor = self.factor(model_order())?;
        let mut rows = [[0.0; 13]; 6];
        rows.as_flattened_mut().copy_from_slice(&factor);
        ModelCovariance::from_factor(rows).map_err(|error| error.to_string())
    }

    pub(super) fn of_rotation(&self) -> std::result::Result<RotationCovariance, String> {
        let factor = self.factor(rotation_order())?;
        let mut rows = [[0.0; 6]];
        rows.as_flattened_mut().copy_from_slice(&factor);
        RotationCovariance::from_factor(rows).map_err(|error| error.to_string())
    }
}

/// The order of the covariance of an error model, and of an alignment.
pub(super) fn model_order() -> [String; Parameter::COUNT] {
    Parameter::ALL.map(|parameter| parameter.to_string())
}

pub(super) fn rotation_order() -> [String; 3] {
    ["X", "Y", "Z"].map(|axis| format!("rotation about {axis}"))
}
