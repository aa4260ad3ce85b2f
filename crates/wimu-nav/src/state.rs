//! State of the filter: an attitude on SO(3) and named blocks of a vector, each estimated or considered. Equation (112).

use core::fmt;

use nalgebra::{RealField, Rotation3, SMatrix, SVector};

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
pub(crate) const HEADING: Block<1> = ATTITUDE.part::<1, 2>();
/// Velocity, m/s, navigation frame.
pub const VELOCITY: Block<3> = Block(3);
/// Position, m, navigation frame.
pub const POSITION: Block<3> = Block(6);
const CORE: usize = 9;

/// More states were claimed than the filter has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LayoutFull {
    /// States that are needed.
    pub needed: usize,
    /// States of the filter.
    pub states: usize,
}

impl fmt::Display for LayoutFull {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { needed, states } = self;
        write!(f, "the blocks need {needed} states, and the filter has {states}")
    }
}

impl core::error::Error for LayoutFull {}

/// The blocks of a filter with `N` states, with their initial standard deviations. Attitude, velocity and position are
/// in every layout; processes and sensors claim more.
#[derive(Clone, Debug)]
pub struct Layout<R, const N: usize> {
    pub(crate) deviation: SVector<R, N>,
    pub(crate) considered: [bool; N],
    pub(crate) used: usize,
}

impl<R: RealField + Copy, const N: usize> Layout<R, N> {
    /// Attitude, velocity and position with their initial standard deviations, rad, m/s, m.
    pub fn new(attitude: [R; 3], velocity: R, position: R) -> Self {
        const { assert!(N >= CORE, "attitude, velocity and position need nine states") };
        let mut layout = Self { deviation: SVector::zeros(), considered: [false; N], used: CORE };
        for axis in 0..3 {
            layout.deviation[ATTITUDE.0 + axis] = attitude[axis];
            layout.deviation[VELOCITY.0 + axis] = velocity;
            layout.deviation[POSITION.0 + axis] = position;
        }
        layout
    }

    /// Claims the next states, with their initial standard deviations.
    ///
    /// # Errors
    /// [`LayoutFull`].
    pub fn claim<const W: usize>(
        &mut self,
        role: Role,
        deviation: [R; W],
    ) -> Result<Block<W>, LayoutFull> {
        let start = self.used;
        let needed = start + W;
        if needed > N {
            return Err(LayoutFull { needed, states: N });
        }
        for (k, deviation) in deviation.into_iter().enumerate() {
            self.deviation[start + k] = deviation;
            self.considered[start + k] = role == Role::Considered;
        }
        self.used = needed;
        Ok(Block(start))
    }
}

/// Nominal state.
#[derive(Clone, Debug)]
pub struct State<R, const N: usize> {
    /// Body to navigation frame.
    pub attitude: Rotation3<R>,
    /// All other blocks. The three numbers of [`ATTITUDE`] stay zero.
    pub vector: SVector<R, N>,
}

impl<R: RealField + Copy, const N: usize> State<R, N> {
    /// Values of a block.
    pub fn get<const W: usize>(&self, block: Block<W>) -> SVector<R, W> {
        self.vector.fixed_rows::<W>(block.0).into_owned()
    }

    /// Replaces the values of a block.
    pub fn set<const W: usize>(&mut self, block: Block<W>, values: SVector<R, W>) {
        self.vector.fixed_rows_mut::<W>(block.0).copy_from(&values);
    }

    /// Adds an error: the attitude is rotated, all other blocks are sums.
    pub(crate) fn correct(&mut self, mut error: SVector<R, N>) {
        let rotation = error.fixed_rows::<3>(ATTITUDE.0).into_owned();
        error.fixed_rows_mut::<3>(ATTITUDE.0).fill(R::zero());
        self.attitude = Rotation3::new(rotation) * self.attitude;
        self.vector += error;
    }

    /// The error that makes this state the other one.
    pub(crate) fn difference(&self, other: &Self) -> SVector<R, N> {
        let mut difference = other.vector - self.vector;
        let rotation = (other.attitude * self.attitude.transpose()).scaled_axis();
        difference.fixed_rows_mut::<3>(ATTITUDE.0).copy_from(&rotation);
        difference
    }

    pub(crate) fn is_finite(&self) -> bool {
        self.attitude.matrix().iter().chain(&self.vector).all(|x| x.is_finite())
    }
}

/// Derivative of `M` measured values with respect to the error state.
#[derive(Clone, Debug)]
pub struct Jacobian<R, const M: usize, const N: usize>(pub(crate) SMatrix<R, M, N>);

impl<R: RealField + Copy, const M: usize, const N: usize> Jacobian<R, M, N> {
    /// No dependence on any state.
    pub fn zeros() -> Self {
        Self(SMatrix::zeros())
    }

    /// The same, with the derivative with respect to a block.
    #[must_use]
    pub fn with<const W: usize>(mut self, block: Block<W>, derivative: SMatrix<R, M, W>) -> Self {
        self.0.fixed_columns_mut::<W>(block.0).copy_from(&derivative);
        self
    }

    /// The derivative with respect to a block.
    pub fn get<const W: usize>(&self, block: Block<W>) -> SMatrix<R, M, W> {
        self.0.fixed_columns::<W>(block.0).into_owned()
    }
}
