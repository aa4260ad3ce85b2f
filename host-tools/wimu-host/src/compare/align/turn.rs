//! Rotation between the axes of two devices.

use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::Serialize;
use wimu_calib::{Line, Transfer};

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
        let lines = found.axes.each_ref().map(|axis| axis.line.filter(|l| l.fitted == [true; 3]));
        let lines = [lines[0]?, lines[1]?, lines[2]?];
        let rows = Matrix3::from_fn(|axis, column| lines[axis].row[column]);
        let vector = rotation_vector(&rows)?;
        let mut variance = 0.0;
        for (axis, line) in lines.iter().enumerate() {
            let mut gradient = Vector3::zeros();
            for column in 0..3 {
                let mut moved = rows;
                moved[(axis, column)] += SMALL;
                gradient[column] = (rotation_vector(&moved)?.norm() - vector.norm()) / SMALL;
            }
            variance += of_row(line, &gradient);
        }
        Some(Self {
            angle_deg: vector.norm().to_degrees(),
            angle_sd_deg: variance.max(0.0).sqrt().to_degrees(),
            vector_deg: vector.map(f64::to_degrees).into(),
        })
    }
}

/// Sensitivity of the other's axis along itself, whichever direction it has, and its standard deviation:
/// the norm of its sensitivities to the reference's axes.
pub(super) fn scale_along_itself(line: &Line) -> [f64; 2] {
    let row = Vector3::from(line.row);
    let scale = row.norm();
    let variance = of_row(line, &(row / scale));
    // Noise across it increases the norm.
    let longer = (1..4).map(|k| line.covariance[k][k]).sum::<f64>() / (2.0 * scale);
    [scale, variance.max(0.0).sqrt().hypot(longer)]
}

/// Variance of a quantity with this gradient by the elements of the row.
fn of_row(line: &Line, gradient: &Vector3<f64>) -> f64 {
    gradient.dot(&(Matrix3::from_fn(|i, j| line.covariance[1 + i][1 + j]) * gradient))
}

/// Vector of the rotation nearest to the rows, each normalised; `None` where they are not a rotation.
fn rotation_vector(rows: &Matrix3<f64>) -> Option<Vector3<f64>> {
    let unit = Matrix3::from_fn(|i, j| rows[(i, j)] / rows.row(i).norm());
    let volume = unit.determinant();
    if volume.is_nan() || volume < 0.1 {
        return None;
    }
    // The orthogonal factor of the polar decomposition.
    let svd = unit.svd(true, true);
    Some(Rotation3::from_matrix_unchecked(svd.u? * svd.v_t?).scaled_axis())
}
