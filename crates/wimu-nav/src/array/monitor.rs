//! An array some of whose sensors may fail.

use super::geometry::{Geometry, GeometryError};
use super::solver::{ArraySolver, Linear};

/// Samples after which an output that has not moved by one bit counts as stuck, while another
/// sensor's has moved each time.
const STUCK_SAMPLES: u16 = 64;

/// Sensors left out of a sample, as bits: bit k for sensor k.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Dropped {
    /// Those with an output at or past the range, or said to be so.
    pub saturated: u32,
    /// Those with an output that is not finite, or that has not moved at all for 64 samples.
    pub dead: u32,
}

impl Dropped {
    /// All of them.
    pub fn all(self) -> u32 {
        self.saturated | self.dead
    }
}

/// A solver that leaves out sensors which are dead or saturated, and says so.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Array<const M: usize> {
    geometry: Geometry<M>,
    range_mps2: f64,
    solver: ArraySolver<M>,
    dropped: u32,
    last: [f64; M],
    unmoved: [u16; M],
}

impl<const M: usize> Array<M> {
    /// `range_mps2` is the output at which an axis saturates.
    ///
    /// # Errors
    /// As [`ArraySolver::new`]; [`GeometryError::TooMany`] for more than 32 sensors.
    pub fn new(geometry: Geometry<M>, range_mps2: f64) -> Result<Self, GeometryError> {
        let sensors = geometry.axes().len() / geometry.group();
        if sensors > 32 {
            return Err(GeometryError::TooMany { have: sensors, most: 32 });
        }
        Ok(Self {
            solver: ArraySolver::new(&geometry)?,
            geometry,
            range_mps2,
            dropped: 0,
            last: [0.0; M],
            unmoved: [0; M],
        })
    }

    /// The solver of the sensors that are in use now.
    pub fn solver(&self) -> &ArraySolver<M> {
        &self.solver
    }

    /// Takes one sample of all axes, m/s²; what is left of it, and the sensors that were left out. Working out the geometry
    /// again when a sensor goes or comes back takes far longer than a sample.
    ///
    /// # Errors
    /// What is missing, where the sensors left do not suffice.
    pub fn reduce(&mut self, output_mps2: &[f64; M]) -> Result<(Linear, Dropped), GeometryError> {
        let dropped = self.judge(output_mps2);
        if dropped.all() != self.dropped {
            let mask = dropped.all();
            self.solver = ArraySolver::of(&self.geometry, |k| mask >> (k % 32) & 1 == 0)?;
            self.dropped = mask;
        }
        let mut clean = *output_mps2;
        let group = self.geometry.group();
        for (index, value) in clean.iter_mut().enumerate() {
            if self.dropped >> (index / group % 32) & 1 == 1 {
                *value = 0.0;
            }
        }
        Ok((self.solver.reduce(&clean), dropped))
    }

    fn judge(&mut self, output: &[f64; M]) -> Dropped {
        let group = self.geometry.group();
        let used = self.geometry.axes().len();
        let mut dropped = Dropped::default();
        let moved = output.iter().zip(&self.last).take(used).filter(|(a, b)| a != b).count();
        for index in 0..used.min(M) {
            let bit = 1 << (index / group % 32);
            let value = output[index];
            if !value.is_finite() {
                dropped.dead |= bit;
            } else if value.abs() >= self.range_mps2 {
                dropped.saturated |= bit;
            }
            // One at its limit does not move either.
            if value != self.last[index] || dropped.saturated & bit != 0 {
                self.unmoved[index] = 0;
            } else if moved * 2 > used {
                self.unmoved[index] = self.unmoved[index].saturating_add(1);
            }
            if self.unmoved[index] >= STUCK_SAMPLES {
                dropped.dead |= bit;
            }
            self.last[index] = value;
        }
        dropped.saturated &= !dropped.dead;
        dropped
    }
}
