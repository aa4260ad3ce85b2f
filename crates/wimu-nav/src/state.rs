//! State of the filter: an attitude on SO(3) and named blocks of a vector, each estimated or considered. Equation (112).

use alloc::vec;
use alloc::vec::Vec;

use nalgebra::{DVector, Rotation3, SVector, Vector3};

/// What the filter does with the states of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Updates correct them.
    Estimated,
    /// Updates leave them alone: what is uncertain but not observable. Their uncertainty reaches the other states
    /// through the correlations (S. F. Schmidt, "Application of state-space methods to navigation problems", 1966).
    Considered,
}

/// Place of `W` consecutive states in a [`Layout`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block<const W: usize>(usize);

impl<const W: usize> Block<W> {
    /// Index of the first state.
    pub const fn start(self) -> usize {
        self.0
    }

    /// Whether a state is in it.
    pub(crate) const fn contains(self, state: usize) -> bool {
        self.0 <= state && state < self.0 + W
    }

    /// The part of `V` states that begins after `skip` of them.
    ///
    /// # Panics
    /// When compiled, if the part reaches beyond the block.
    pub const fn part<const V: usize, const SKIP: usize>(self) -> Block<V> {
        const { assert!(V + SKIP <= W, "the part reaches beyond the block") };
        Block(self.0 + SKIP)
    }
}

/// Attitude error, rad, navigation frame.
pub const ATTITUDE: Block<3> = Block(0);
/// Its part about the vertical.
pub const HEADING: Block<1> = ATTITUDE.part::<1, 2>();
/// Velocity, m/s, navigation frame.
pub const VELOCITY: Block<3> = Block(3);
/// Position, m, navigation frame.
pub const POSITION: Block<3> = Block(6);

/// The blocks of a filter, with their initial standard deviations. Attitude, velocity and position are in every layout;
/// processes and sensors claim more.
#[derive(Clone, Debug)]
pub struct Layout {
    pub(crate) deviation: Vec<f64>,
    pub(crate) considered: Vec<bool>,
}

impl Layout {
    /// Attitude, velocity and position with their initial standard deviations, rad, m/s, m.
    pub fn new([east, north, up]: [f64; 3], velocity: f64, position: f64) -> Self {
        let (v, p) = (velocity, position);
        Self { deviation: vec![east, north, up, v, v, v, p, p, p], considered: vec![false; 9] }
    }

    /// Claims the next states, with their initial standard deviations.
    pub fn claim<const W: usize>(&mut self, role: Role, deviation: [f64; W]) -> Block<W> {
        let block = Block(self.len());
        self.deviation.extend(deviation);
        self.considered.resize(self.deviation.len(), role == Role::Considered);
        block
    }

    /// Claims states, unless all of them are known: with a standard deviation of zero.
    pub fn claim_unknown<const W: usize>(
        &mut self,
        role: Role,
        deviation: [f64; W],
    ) -> Option<Block<W>> {
        deviation.iter().any(|d| *d > 0.0).then(|| self.claim(role, deviation))
    }

    pub(crate) fn len(&self) -> usize {
        self.deviation.len()
    }
}

/// Nominal state.
#[derive(Clone, Debug)]
pub struct State {
    /// Body to navigation frame.
    pub attitude: Rotation3<f64>,
    /// All other blocks. The three numbers of [`ATTITUDE`] stay zero.
    pub vector: DVector<f64>,
}

impl State {
    /// Values of a block.
    pub fn get<const W: usize>(&self, block: Block<W>) -> SVector<f64, W> {
        self.vector.fixed_rows::<W>(block.0).into_owned()
    }

    /// The value of a state, zero without one.
    pub fn value(&self, block: Option<Block<1>>) -> f64 {
        block.map_or(0.0, |block| self.get(block).x)
    }

    /// Replaces the values of a block.
    pub fn set<const W: usize>(&mut self, block: Block<W>, values: SVector<f64, W>) {
        self.vector.fixed_rows_mut::<W>(block.0).copy_from(&values);
    }

    /// Adds an error: the attitude is rotated, all other blocks are sums.
    pub(crate) fn correct(&mut self, mut error: DVector<f64>) {
        let rotation = error.fixed_rows::<3>(ATTITUDE.0).into_owned();
        error.fixed_rows_mut::<3>(ATTITUDE.0).fill(0.0);
        self.attitude = Rotation3::new(rotation) * self.attitude;
        self.vector += error;
    }

    /// The error that makes this state the other one: the rotation vector between the attitudes, and differences.
    pub(crate) fn difference(&self, other: &Self) -> DVector<f64> {
        let m = other.attitude * self.attitude.inverse();
        let axis =
            Vector3::new(m[(2, 1)] - m[(1, 2)], m[(0, 2)] - m[(2, 0)], m[(1, 0)] - m[(0, 1)]);
        // 2 sin and 2 cos of the angle. `Rotation3::scaled_axis` has half the digits for small angles.
        let (sine, cosine) = (axis.norm(), m.matrix().trace() - 1.0);
        let factor = if sine > 1e-6 { libm::atan2(sine, cosine) / sine } else { 0.5 };
        let mut error = &other.vector - &self.vector;
        error.fixed_rows_mut::<3>(ATTITUDE.0).copy_from(&(axis * factor));
        error
    }

    pub(crate) fn is_finite(&self) -> bool {
        self.attitude.matrix().iter().chain(&self.vector).all(|x| x.is_finite())
    }
}
