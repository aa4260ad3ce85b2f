//! Anchors of ranges, and the states of their errors: equations (127), (161) and (162).

use nalgebra::{RealField, Vector3};

use crate::process::{GaussMarkov, Process, Transition};
use crate::rotation::real;
use crate::state::{Block, Layout, LayoutFull, Role, State};

/// Errors of the ranges of one anchor, all as standard deviations. The defaults are those of ultra-wideband radios that are
/// not calibrated: antenna delays of 0.3 ns are 0.1 m.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct RangeErrors<R> {
    /// White noise of a range, m.
    pub noise_m: R,
    /// Error that is correlated over a time, m, and that time, s: reflections, antennas, clock.
    pub correlated_m: R,
    /// See [`correlated_m`](Self::correlated_m).
    pub time_s: R,
    /// Constant bias, m.
    pub bias_m: R,
    /// Scale error.
    pub scale: R,
    /// Position of the anchor, m, a component.
    pub position_m: R,
}

impl<R: RealField> Default for RangeErrors<R> {
    fn default() -> Self {
        Self {
            noise_m: real(0.03),
            correlated_m: real(0.06),
            time_s: real(1.0),
            bias_m: real(0.07),
            scale: real(0.0),
            position_m: real(0.0),
        }
    }
}

/// An anchor, and the states of its ranges. What has a standard deviation of zero has no state.
#[derive(Clone, Copy, Debug)]
pub struct Anchor<R> {
    /// Position as given, m, navigation frame.
    pub position_m: Vector3<R>,
    /// True minus given position, m.
    pub offset: Option<Block<3>>,
    /// Bias of the ranges, m.
    pub bias: Option<Block<1>>,
    /// Scale error of the ranges.
    pub scale: Option<Block<1>>,
    /// Correlated error of the ranges, m.
    pub correlated: Option<Block<1>>,
}

impl<R: RealField + Copy> Anchor<R> {
    /// Claims the states of an anchor: up to six.
    ///
    /// # Errors
    /// [`LayoutFull`].
    pub fn claim<const N: usize>(
        layout: &mut Layout<R, N>,
        position_m: Vector3<R>,
        errors: &RangeErrors<R>,
    ) -> Result<Self, LayoutFull> {
        let mut one = |deviation: R| {
            let some = deviation > R::zero();
            some.then(|| layout.claim(Role::Estimated, [deviation])).transpose()
        };
        let bias = one(errors.bias_m)?;
        let scale = one(errors.scale)?;
        let correlated = one(errors.correlated_m)?;
        let surveyed = errors.position_m > R::zero();
        let offset =
            surveyed.then(|| layout.claim(Role::Estimated, [errors.position_m; 3])).transpose()?;
        Ok(Self { position_m, offset, bias, scale, correlated })
    }

    /// Position, m: as given, and as estimated.
    pub fn position<const N: usize>(&self, state: &State<R, N>) -> Vector3<R> {
        self.position_m + self.offset.map_or_else(Vector3::zeros, |block| state.get(block))
    }
}

/// A step of the correlated errors of all anchors.
#[derive(Clone, Copy, Debug)]
pub struct CorrelatedErrors<'a, R> {
    /// The anchors.
    pub anchors: &'a [Anchor<R>],
    /// Their errors.
    pub errors: &'a RangeErrors<R>,
    /// Length of the step, s.
    pub step_s: R,
}

impl<R: RealField + Copy, const N: usize> Process<R, N> for CorrelatedErrors<'_, R> {
    fn propagate(&self, state: &mut State<R, N>, transition: &mut Transition<R, N>) {
        for block in self.anchors.iter().filter_map(|anchor| anchor.correlated) {
            let step = GaussMarkov {
                block,
                deviation: self.errors.correlated_m,
                time_s: self.errors.time_s,
                step_s: self.step_s,
            };
            step.propagate(state, transition);
        }
    }
}
