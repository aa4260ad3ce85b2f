//! Random walk and first-order Gauss–Markov process: equation (127) (A. Gelb, "Applied Optimal Estimation", 1974, section
//! 2.2).

use nalgebra::{RealField, SMatrix};

use super::{Process, Transition};
use crate::rotation::real;
use crate::state::{Block, State};

/// A step of a vector that decays towards zero and is driven by noise: dx/dt = −x/τ + w.
#[derive(Clone, Copy, Debug)]
pub struct GaussMarkov<R, const W: usize = 3> {
    /// Its states.
    pub block: Block<W>,
    /// Stationary standard deviation of a component.
    pub deviation: R,
    /// Correlation time τ, s.
    pub time_s: R,
    /// Length of the step, s.
    pub step_s: R,
}

impl<R: RealField + Copy, const N: usize, const W: usize> Process<R, N> for GaussMarkov<R, W> {
    fn propagate(&self, state: &mut State<R, N>, transition: &mut Transition<R, N>) {
        let decay = (-self.step_s / self.time_s).exp();
        let decayed = state.get(self.block) * decay;
        state.set(self.block, decayed);
        let one = real::<R>(1.0);
        let change = SMatrix::<R, W, W>::identity() * (decay - one);
        transition.add(self.block, self.block, change);
        transition.add_noise(self.block, self.deviation * self.deviation * (one - decay * decay));
    }
}

/// A step of a random walk: a bias with three components. For other blocks: [`Transition::add_noise`].
#[derive(Clone, Copy, Debug)]
pub struct RandomWalk<R> {
    /// Its states.
    pub block: Block<3>,
    /// Density of the noise, unit of the states/√s.
    pub density: R,
    /// Length of the step, s.
    pub step_s: R,
}

impl<R: RealField + Copy, const N: usize> Process<R, N> for RandomWalk<R> {
    fn propagate(&self, _: &mut State<R, N>, transition: &mut Transition<R, N>) {
        transition.add_noise(self.block, self.density * self.density * self.step_s);
    }
}
