//! What sensors add to the mean of all, as far as a few rests tell it: equation (108).

use wimu_model::{ErrorModel, ErrorTerms};

use nalgebra::{Matrix4, Vector4};

type Vector = [f64; 3];

/// What one sensor adds: a bias, m/s², and a share of the force, with what is not known of it after all.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Departure {
    pub bias_mps2: Vector,
    /// Row i is what axis i adds of the force.
    pub matrix: [Vector; 3],
    /// Covariance of each row.
    pub left: [Vector; 3],
}

impl Departure {
    /// The likeliest one of the force and the departure at each rest, m/s², known to `rest_mps2`, where biases have the
    /// deviation `bias_mps2` and shares `scale` before.
    pub(super) fn of(
        rests: impl Iterator<Item = (Vector, Vector)>,
        bias_mps2: f64,
        scale: f64,
        rest_mps2: f64,
    ) -> Self {
        let known = [bias_mps2, scale, scale, scale];
        let mut normal = Matrix4::zeros();
        let mut right = [Vector4::zeros(); 3];
        for (i, sd) in known.into_iter().enumerate() {
            normal[(i, i)] += 1.0 / (sd * sd);
        }
        let weight = 1.0 / (rest_mps2 * rest_mps2);
        for ([x, y, z], departure) in rests {
            let row = [1.0, x, y, z];
            for i in 0..4 {
                for j in 0..4 {
                    normal[(i, j)] += row[i] * row[j] * weight;
                }
                for (right, value) in right.iter_mut().zip(departure) {
                    right[i] += row[i] * value * weight;
                }
            }
        }
        let Some(factor) = normal.cholesky() else {
            return Self::default();
        };
        let mut found = Self::default();
        for (axis, right) in right.iter().enumerate() {
            let x = factor.solve(right);
            found.bias_mps2[axis] = x[0];
            found.matrix[axis] = [x[1], x[2], x[3]];
        }
        let inverse = factor.inverse();
        found.left = [1, 2, 3].map(|i| [1, 2, 3].map(|j| inverse[(j, i)]));
        found
    }

    /// As a sensor's error model; `None` where no sensor is as wrong as that.
    pub(super) fn model(&self) -> Option<ErrorModel> {
        let mut terms = ErrorTerms {
            bias_mps2: self.bias_mps2,
            ..ErrorTerms::default()
        };
        for (row, more) in terms.matrix.iter_mut().zip(&self.matrix) {
            for (value, more) in row.iter_mut().zip(more) {
                *value += more;
            }
        }
        ErrorModel::new(terms).ok()
    }

    /// Mean variance of a share that is not known, in any direction of the force.
    pub(super) fn mean_variance(&self) -> f64 {
        (0..3).map(|i| self.left[i][i]).sum::<f64>() / 3.0
    }
}
