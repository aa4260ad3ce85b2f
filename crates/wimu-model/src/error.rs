//! Why numbers are no model.

use core::fmt;

use crate::matrix::{self, Matrix3};

/// Lowest determinant of a model's matrix.
const LOWEST_DETERMINANT: f64 = 0.05;

/// Why the values of an error model, or of its quality record, are refused.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ModelError {
    /// A value is not a number, or outside its bounds.
    OutOfBounds {
        /// Its name.
        name: &'static str,
        /// Its unit, after a space; empty: it has none.
        unit: &'static str,
        /// Its axis (its row in a matrix), 0 = X; `None`: it has none.
        axis: Option<usize>,
        /// The value.
        value: f64,
        /// The lowest allowed.
        low: f64,
        /// The highest allowed.
        high: f64,
    },
    /// A matrix cannot be inverted, or is mirrored.
    Singular {
        /// Its name.
        name: &'static str,
        /// Its determinant; at least 0.05 is required.
        determinant: f64,
    },
}

impl fmt::Display for ModelError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::OutOfBounds { name, unit, axis, value, low, high } => {
                out.write_str(name)?;
                if let Some(axis) = axis.and_then(|axis| ["X", "Y", "Z"].get(axis)) {
                    write!(out, " {axis}")?;
                }
                write!(out, " = {value}{unit} is outside {low} to {high}{unit}")
            }
            Self::Singular { name, determinant } => write!(
                out,
                "{name} cannot be inverted or is mirrored: its determinant is {determinant}, at least \
                 {LOWEST_DETERMINANT} is required"
            ),
        }
    }
}

impl core::error::Error for ModelError {}

/// The bounds of a value: its name, its unit after a space, the lowest and the highest.
pub(crate) struct Bounds(
    pub(crate) &'static str,
    pub(crate) &'static str,
    pub(crate) f64,
    pub(crate) f64,
);

impl Bounds {
    pub(crate) fn check(&self, value: impl Into<f64>) -> Result<(), ModelError> {
        self.check_on(None, value.into())
    }

    /// Checks a value of each axis, or the elements of a matrix row by row.
    pub(crate) fn check_axes<T: Copy + Into<f64>>(&self, values: &[T]) -> Result<(), ModelError> {
        let row = values.len().div_ceil(3).max(1);
        let mut places = values.iter().enumerate();
        places.try_for_each(|(place, &value)| self.check_on(Some(place / row), value.into()))
    }

    pub(crate) fn check_on(&self, axis: Option<usize>, value: f64) -> Result<(), ModelError> {
        let &Self(name, unit, low, high) = self;
        if (low..=high).contains(&value) {
            return Ok(());
        }
        Err(ModelError::OutOfBounds { name, unit, axis, value, low, high })
    }
}

/// Checks the matrix of an accelerometer or a gyroscope: scale factors, misalignments, and that it can be inverted.
pub(crate) fn check_matrix(name: &'static str, matrix: &Matrix3) -> Result<(), ModelError> {
    for (row, values) in matrix.iter().enumerate() {
        for (column, value) in values.iter().enumerate() {
            let bounds = if row == column {
                Bounds("scale factor", "", 0.5, 1.5)
            } else {
                Bounds("misalignment", " rad", -0.3, 0.3)
            };
            bounds.check_on(Some(row), *value)?;
        }
    }
    let determinant = matrix::determinant(matrix);
    if determinant < LOWEST_DETERMINANT {
        return Err(ModelError::Singular { name, determinant });
    }
    Ok(())
}
