//! Range to an anchor: equations (161), (162) and (164).

use nalgebra::{Matrix1, RealField, Vector3};

use super::anchor::Anchor;
use super::line_of_sight::{LineOfSight, NonLineOfSight};
use super::{Measurement, Prediction};
use crate::filter::Filter;
use crate::real::Real;
use crate::rotation::real;
use crate::state::{ATTITUDE, Block, Jacobian, POSITION, VELOCITY};

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
        let direction = difference.try_normalize(real(1e-6)).unwrap_or_else(Vector3::zeros);
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
        let weighted = Self { deviation_m, ..*self };
        (weighted, found)
    }
}
