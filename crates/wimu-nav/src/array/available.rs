//! An array some of whose sensors may have no output.

use super::geometry::{Geometry, GeometryError};
use super::solver::{ArraySolver, Linear};

/// Sensors of an array, as bits: bit k for sensor k.
pub type SensorBits = u32;

/// A solver that leaves out sensors without an output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Array<const M: usize> {
    geometry: Geometry<M>,
    solver: ArraySolver<M>,
    absent: SensorBits,
}

impl<const M: usize> Array<M> {
    /// Of a geometry.
    ///
    /// # Errors
    /// As [`ArraySolver::new`]; [`GeometryError::TooMany`] for more sensors than a word has bits.
    pub fn new(geometry: Geometry<M>) -> Result<Self, GeometryError> {
        let (have, most) = (geometry.axes().len() / geometry.group(), SensorBits::BITS as usize);
        if have > most {
            return Err(GeometryError::TooMany { have, most });
        }
        Ok(Self { solver: ArraySolver::new(&geometry)?, geometry, absent: 0 })
    }

    /// The solver of the sensors that are in use now.
    pub fn solver(&self) -> &ArraySolver<M> {
        &self.solver
    }

    /// Takes one sample of all axes, m/s², those without an output not finite; what is left of it, and the sensors that are
    /// absent. Working out the geometry again when a sensor goes or comes back takes far longer than a sample.
    ///
    /// # Errors
    /// What is missing, where the sensors left do not suffice.
    pub fn reduce(
        &mut self,
        output_mps2: &[f64; M],
    ) -> Result<(Linear, SensorBits), GeometryError> {
        let group = self.geometry.group();
        let outputs = output_mps2.iter().take(self.geometry.axes().len()).enumerate();
        let absent = outputs.filter(|(_, value)| !value.is_finite());
        let absent = absent.fold(0, |bits, (index, _)| bits | 1 << (index / group));
        if absent != self.absent {
            self.solver = ArraySolver::of(&self.geometry, |k| absent >> k & 1 == 0)?;
            self.absent = absent;
        }
        let mut clean = *output_mps2;
        for (index, value) in clean.iter_mut().enumerate() {
            if index / group < SensorBits::BITS as usize && absent >> (index / group) & 1 == 1 {
                *value = 0.0;
            }
        }
        Ok((self.solver.reduce(&clean), absent))
    }
}
