//! Rotation between the axes of two devices.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use serde::Serialize;
use wimu_calib::{Line, Transfer};

use crate::stats::norm;

type Matrix = [[f64; 3]; 3];

/// Step of numerical derivatives.
const SMALL: f64 = 1e-6;

/// The rotation from the reference's axes to those of the other; the nearest one, where these are
/// not exactly orthogonal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Turn {
    /// Its angle, degrees.
    pub angle_deg: f64,
    /// Standard deviation of the angle.
    pub angle_sd_deg: f64,
    /// Rotation vector, degrees: it maps the reference's values to the other's.
    pub vector_deg: [f64; 3],
}

impl Turn {
    /// `None` where an axis did not move enough to observe its sensitivity to all others.
    pub(super) fn of(found: &Transfer) -> Option<Self> {
        let mut rows = [[0.0; 3]; 3];
        let mut variance = 0.0;
        for (row, axis) in rows.iter_mut().zip(&found.axes) {
            let line = axis.line.filter(|line| line.fitted == [true; 3])?;
            *row = line.row;
        }
        let vector = rotation_vector(&rows)?;
        let angle = norm(vector);
        for (index, axis) in found.axes.iter().enumerate() {
            let mut gradient = [0.0; 3];
            for (column, gradient) in gradient.iter_mut().enumerate() {
                let mut moved = rows;
                moved[index][column] += SMALL;
                *gradient = (norm(rotation_vector(&moved)?) - angle) / SMALL;
            }
            variance += axis.line.map_or(0.0, |line| of_row(&line, gradient));
        }
        Some(Self {
            angle_deg: angle.to_degrees(),
            angle_sd_deg: variance.max(0.0).sqrt().to_degrees(),
            vector_deg: vector.map(f64::to_degrees),
        })
    }
}

/// Sensitivity of the other's axis along itself, whichever direction it has, and its standard deviation:
/// the norm of its sensitivities to the reference's axes.
pub(super) fn scale_along_itself(line: &Line) -> [f64; 2] {
    let scale = norm(line.row);
    let variance = of_row(line, line.row.map(|seen| seen / scale));
    // Noise across it increases the norm.
    let longer = (1..4).map(|k| line.covariance[k][k]).sum::<f64>() / (2.0 * scale);
    [scale, variance.max(0.0).sqrt().hypot(longer)]
}

/// Variance of a quantity with this gradient by the elements of the row.
fn of_row(line: &Line, gradient: [f64; 3]) -> f64 {
    let terms = (0..9).map(|k| (k / 3, k % 3));
    terms.map(|(i, j)| gradient[i] * line.covariance[1 + i][1 + j] * gradient[j]).sum()
}

/// Vector of the rotation nearest to the rows, each normalised; `None` where they are not a rotation.
fn rotation_vector(rows: &Matrix) -> Option<[f64; 3]> {
    let unit = Matrix3::from_fn(|i, j| rows[i][j] / norm(rows[i]));
    let volume = unit.determinant();
    if volume.is_nan() || volume < 0.1 {
        return None;
    }
    // The orthogonal factor of the polar decomposition.
    let svd = unit.svd(true, true);
    let rotation = Rotation3::from_matrix_unchecked(svd.u? * svd.v_t?);
    Some(UnitQuaternion::from_rotation_matrix(&rotation).scaled_axis().into())
}
