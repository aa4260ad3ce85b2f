//! An array some of whose sensors may have no output.

use super::geometry::{Geometry, GeometryError};
use super::solver::{ArraySolver, Linear};

/// Sensors of an array, as bits: bit k for sensor k.
pub type SensorBits = u32;

/// A solver that leaves out sensors without an output.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    geometry: Geometry,
    solver: ArraySolver,
    absent: SensorBits,
}

impl Array {
    /// Of a geometry.
    ///
    /// # Errors
    /// As [`ArraySolver::new`]; [`GeometryError::TooMany`] for more sensors than a word has bits.
    pub fn new(geometry: Geometry) -> Result<Self, GeometryError> {
        let (have, most) = (geometry.axes().len() / geometry.group(), SensorBits::BITS as usize);
        if have > most {
            return Err(GeometryError::TooMany { have, most });
        }
        Ok(Self { solver: ArraySolver::new(&geometry)?, geometry, absent: 0 })
    }

    /// The solver of the sensors that are in use now.
    pub fn solver(&self) -> &ArraySolver {
        &self.solver
    }

    /// Takes one sample of all axes, m/s², those without an output not finite; what is left of it, and the sensors that are
    /// absent. Working out the geometry again when a sensor goes or comes back takes far longer than a sample.
    ///
    /// # Errors
    /// What is missing, where the sensors left do not suffice.
    pub fn reduce(&mut self, output_mps2: &[f64]) -> Result<(Linear, SensorBits), GeometryError> {
        let (axes, group) = (self.geometry.axes().len(), self.geometry.group());
        let has_output = |axis: usize| output_mps2.get(axis).is_some_and(|value| value.is_finite());
        let absent = (0..axes).filter(|axis| !has_output(*axis));
        let absent = absent.fold(0, |bits, axis| bits | 1 << (axis / group));
        if absent != self.absent {
            self.solver = ArraySolver::of(&self.geometry, |k| absent >> k & 1 == 0)?;
            self.absent = absent;
        }
        Ok((self.solver.reduce(output_mps2), absent))
    }
}
