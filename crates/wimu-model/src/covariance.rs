//! Covariance matrices, stored as Cholesky factors and therefore always valid.

use core::fmt;

use crate::root;

/// A matrix that is not a covariance: not finite, or not positive semi-definite.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CovarianceError;

impl fmt::Display for CovarianceError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("the covariance matrix is not finite or not positive semi-definite")
    }
}

impl core::error::Error for CovarianceError {}

/// Largest element of a factor, in its parameter's unit: no standard deviation is larger.
const MOST: f32 = 1e3;
/// Fraction of its variances that is added to a covariance. Cholesky's factors of what f64 rounded
/// exist from 12² ε = 3.2e-14 on (Higham, Accuracy and Stability, theorem 10.7); f32 holds 6e-8.
const ROUNDING: f64 = 1e-12;

macro_rules! covariance {
    ($(#[$doc:meta])* $name:ident, $size:literal, $rows:literal x $columns:literal, $as:literal) => {
        $(#[$doc])*
        ///
        /// Kept as the lower triangular L of L Lᵀ in f32, row by row, so that every value of this
        /// type is a covariance. A row of zeros is a parameter that was not estimated.
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[cfg_attr(feature = "serde", serde(try_from = $as, into = $as))]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub struct $name([[f32; $columns]; $rows]);

        impl $name {
            /// Number of parameters.
            pub const SIZE: usize = $size;

            /// The covariance of parameters that were not estimated.
            pub const ZERO: Self = Self([[0.0; $columns]; $rows]);

            /// From the full matrix; its lower triangle is used.
            ///
            /// # Errors
            /// [`CovarianceError`] when it is not finite, has standard deviations above 1000, or is
            /// not positive semi-definite.
            pub fn from_matrix(
                matrix: &[[f64; $size]; $size],
            ) -> Result<Self, CovarianceError> {
                let mut factor = [[0.0; $size]; $size];
                for row in 0..$size {
                    for column in 0..=row {
                        let mut rest = matrix[row][column];
                        for k in 0..column {
                            rest -= factor[row][k] * factor[column][k];
                        }
                        factor[row][column] = if row != column {
                            let pivot: f64 = factor[column][column];
                            // A parameter without variance has no covariance either.
                            if pivot > 0.0 { rest / pivot } else { 0.0 }
                        } else {
                            let variance = matrix[row][row];
                            let pivot = rest + ROUNDING * variance;
                            if pivot.is_nan() || pivot < -1e-6 * variance || variance < 0.0 {
                                return Err(CovarianceError);
                            }
                            root::sqrt(pivot.max(0.0))
                        };
                    }
                }
                let mut packed = Self::ZERO;
                let rows = factor.iter().enumerate();
                let lower = rows.flat_map(|(row, factors)| factors.iter().take(row + 1));
                for (place, &factor) in packed.0.as_flattened_mut().iter_mut().zip(lower) {
                    *place = factor as f32;
                }
                Self::from_factor(packed.0)
            }

            /// From the Cholesky factor, row by row.
            ///
            /// # Errors
            /// [`CovarianceError`] when an element is not finite or beyond ±1000.
            pub fn from_factor(
                factor: [[f32; $columns]; $rows],
            ) -> Result<Self, CovarianceError> {
                let sound = factor.iter().flatten().all(|element| element.abs() <= MOST);
                sound.then_some(Self(factor)).ok_or(CovarianceError)
            }

            /// The Cholesky factor, row by row.
            pub fn factor(&self) -> [[f32; $columns]; $rows] {
                self.0
            }

            fn element(&self, row: usize, column: usize) -> f64 {
                let place = row * (row + 1) / 2 + column;
                let line = self.0.get(place / $columns);
                line.and_then(|line| line.get(place % $columns))
                    .map_or(0.0, |element| f64::from(*element))
            }

            /// Covariance of two parameters by index; 0 beyond the last one.
            pub fn get(&self, a: usize, b: usize) -> f64 {
                if a.max(b) >= $size {
                    return 0.0;
                }
                (0..=a.min(b))
                    .map(|k| self.element(a, k) * self.element(b, k))
                    .sum()
            }

            /// Standard deviation of a parameter by index.
            pub fn sd(&self, place: usize) -> f64 {
                root::sqrt(self.get(place, place))
            }

            /// The full matrix.
            pub fn matrix(&self) -> [[f64; $size]; $size] {
                core::array::from_fn(|a| core::array::from_fn(|b| self.get(a, b)))
            }
        }

        impl Default for $name {
            fn default() -> Self {
                Self::ZERO
            }
        }

        impl TryFrom<[[f32; $columns]; $rows]> for $name {
            type Error = CovarianceError;

            fn try_from(factor: [[f32; $columns]; $rows]) -> Result<Self, CovarianceError> {
                Self::from_factor(factor)
            }
        }

        impl From<$name> for [[f32; $columns]; $rows] {
            fn from(covariance: $name) -> Self {
                covariance.0
            }
        }
    };
}

covariance!(
    /// Covariance of the 12 basic parameters of an error model: the bias X, Y, Z in m/s², then A
    /// row by row, dimensionless.
    ModelCovariance, 12, 6 x 13, "[[f32; 13]; 6]"
);

covariance!(
    /// Covariance of a rotation's error as a small rotation vector X, Y, Z, rad, about the axes
    /// that the rotation leads to.
    RotationCovariance, 3, 1 x 6, "[[f32; 6]; 1]"
);
