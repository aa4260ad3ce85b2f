//! Range to an anchor: equations (161), (162) and (164).

use nalgebra::{Matrix1, RealField, Vector3};

use super::line_of_sight::{LineOfSight, NonLineOfSight};
use super::{Measurement, Prediction};
use crate::filter::Filter;
use crate::process::{GaussMarkov, Process, Transition};
use crate::real::Real;
use crate::rotation::real;
use crate::state::{
    ATTITUDE, Block, Jacobian, Layout, LayoutFull, POSITION, Role, State, VELOCITY,
};

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
            some.then(|| layout.claim(Role::Estimated, [deviation]))
                .transpose()
        };
        let bias = one(errors.bias_m)?;
        let scale = one(errors.scale)?;
        let correlated = one(errors.correlated_m)?;
        let surveyed = errors.position_m > R::zero();
        let offset = surveyed
            .then(|| layout.claim(Role::Estimated, [errors.position_m; 3]))
            .transpose()?;
        Ok(Self {
            position_m,
            offset,
            bias,
            scale,
            correlated,
        })
    }

    /// Position, m: as given, and as estimated.
    pub fn position<const N: usize>(&self, state: &State<R, N>) -> Vector3<R> {
        self.position_m
            + self
                .offset
                .map_or_else(Vector3::zeros, |block| state.get(block))
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

/// A range.
#[derive(Clone, Copy, Debug)]
pub struct Range<'a, R> {
    /// The anchor.
    pub anchor: &'a Anchor<R>,
    /// Measured range, m.
    pub range_m: R,
    /// Standard deviation of its white noise, m.
    pub deviation_m: R,
    /// Antenna of the unit from its origin, m, body frame.
    pub lever_arm_m: Vector3<R>,
    /// The range is measured later than the state by this time, s.
    pub delay: Option<Block<1>>,
}

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 1> for Range<'_, R> {
    /// At the anchor itself the range has no direction, and the measurement no effect on the position.
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 1> {
        let (anchor, state) = (self.anchor, &filter.state);
        let arm = state.attitude * self.lever_arm_m;
        let velocity = state.get(VELOCITY);
        let delay = self.delay.map_or_else(R::zero, |block| state.get(block).x);
        let difference = state.get(POSITION) + velocity * delay + arm - anchor.position(state);
        let distance = difference.norm();
        let direction = difference
            .try_normalize(real(1e-6))
            .unwrap_or_else(Vector3::zeros);
        let one = Matrix1::from_element(R::one());
        let [bias, scale, correlated] = [anchor.bias, anchor.scale, anchor.correlated]
            .map(|block| block.map_or_else(R::zero, |block| state.get(block).x));
        let stretch = R::one() + scale;
        let slope = direction * stretch;
        let mut jacobian = Jacobian::zeros()
            .with(POSITION, slope.transpose())
            .with(VELOCITY, slope.transpose() * delay)
            .with(ATTITUDE, arm.cross(&slope).transpose());
        for block in [anchor.bias, anchor.correlated].into_iter().flatten() {
            jacobian = jacobian.with(block, one);
        }
        if let Some(block) = self.delay {
            jacobian = jacobian.with(block, one * slope.dot(&velocity));
        }
        if let Some(block) = anchor.scale {
            jacobian = jacobian.with(block, one * distance);
        }
        if let Some(block) = anchor.offset {
            jacobian = jacobian.with(block, -slope.transpose());
        }
        Prediction {
            innovation: Matrix1::new(self.range_m - distance * stretch - bias - correlated),
            jacobian,
            covariance: one * (self.deviation_m * self.deviation_m),
        }
    }
}

impl<R: Real> Range<'_, R> {
    /// The same range with the weight that it has in a mixture with non-line of sight, for an update without a gate.
    #[must_use]
    pub fn weighted<const N: usize>(
        &self,
        filter: &Filter<R, N>,
        model: &NonLineOfSight,
    ) -> (Self, LineOfSight) {
        let prediction = self.predict(filter);
        let variance = filter.variance_of(&prediction);
        let found = model.weigh(prediction.innovation.x.to_f64(), variance.x.to_f64());
        // Equation (164): the correction of the state is the weight times that with line of sight.
        let excess = variance.x * (R::one() / real::<R>(found.weight) - R::one());
        let deviation_m = (self.deviation_m * self.deviation_m + excess).sqrt();
        let weighted = Self {
            deviation_m,
            ..*self
        };
        (weighted, found)
    }
}
