//! Start, rests, gaps and divergence of the filter of an array: equation (98).

use nalgebra::{Matrix1, Matrix3, Rotation3, SMatrix, SVector, Vector3};

use super::{Alignment, ArrayFilter, FREEDOM, START_ROTATION};
use crate::array::noise::Level;
use crate::array::solver::Linear;
use crate::filter::{Filter, Gate};
use crate::mixture::Mixture;
use crate::navigator::{DIVERGED_SPEED, LOST_POSITION, REST_INTERVAL_S, REST_SPEED, Rests};
use crate::process::{RigidArray, RigidArrayBlocks, Unmeasured};
use crate::rotation::level;
use crate::sensor::{Known, Velocity, VerticalRate};
use crate::state::{ATTITUDE, HEADING, POSITION, VELOCITY};

/// Time of the alignment, s.
const ALIGN_S: f64 = 0.5;
/// Start in motion: deviations of velocity, m/s, and tilt, rad.
const MOVING_VELOCITY: f64 = 10.0;
const MOVING_TILT: f64 = 1.0;
/// At a rest, as means of half a second: angular rate, rad/s; angular acceleration, rad/s².
const REST_ROTATION: [f64; 2] = [0.02, 0.1];
const REST_S: f64 = 0.5;
const ZERO_INTERVAL_S: f64 = 0.05;
/// How long a rest fails its test before it is certain, s.
const CERTAIN_REST_S: f64 = 0.25;
/// Variance of an unknown heading, rad²: a uniform distribution.
const HEADING_UNKNOWN: f64 = 3.29;

impl ArrayFilter {
    /// Alignment with the mean specific force; after a start in motion with that of the first rest.
    pub(super) fn align(&mut self, step: f64, linear: &Linear, at_rest: bool) {
        let align = &mut self.align;
        align.force += linear.force_mps2();
        align.time_s += step;
        align.count += 1.0;
        if align.time_s < ALIGN_S && !self.moving_start || align.count < 2.0 && !at_rest {
            return;
        }
        let force = if at_rest { self.rest_test.force() } else { align.force / align.count };
        self.align = Alignment::EMPTY;
        if let Some(attitude) = level(&force, None) {
            self.begin(attitude, &force, at_rest);
        }
    }

    pub(super) fn begin(&mut self, attitude: Rotation3<f64>, force: &Vector3<f64>, rest: bool) {
        let g = self.config.gravity_mps2;
        let [own, common] = self.bias_variances();
        let bias = own * self.array.solver().covariance()[(3, 3)] + common;
        let excess = force.norm() - g;
        let (tilt, velocity) = if rest {
            ((bias + excess * excess / 4.0) / (g * g) + 1e-6, 1e-6)
        } else {
            (MOVING_TILT * MOVING_TILT, MOVING_VELOCITY * MOVING_VELOCITY)
        };
        let diagonal = |variance: f64| Matrix3::from_diagonal_element(variance);
        let mut filter = Filter::new(&self.layout, attitude);
        let tilt = Matrix3::from_diagonal(&Vector3::new(tilt, tilt, 1e-8));
        filter.set_covariance(ATTITUDE, &tilt);
        filter.set_covariance(VELOCITY, &diagonal(velocity));
        if self.lost {
            filter.set_covariance(POSITION, &diagonal(LOST_POSITION * LOST_POSITION));
        }
        self.mixture = Some(Mixture::new(filter));
        self.begin_biases(true);
        self.direction = *force;
        self.last = None;
        self.moving_start = !rest;
        (self.valid, self.resting) = (rest, rest);
        if rest {
            self.since_rest_s = 0.0;
        }
    }

    /// Variances of the bias of an axis, in units of what the geometry declares for its noise, and of the bias that all
    /// sensors share, (m/s²)².
    pub(super) fn bias_variances(&self) -> [f64; 2] {
        let c = &self.config;
        let square = |x: f64| x * x;
        let variance = self.array.solver().variance_mps2();
        [
            (square(c.bias_mps2) + square(c.scale * c.gravity_mps2)) / variance,
            square(c.common_bias_mps2) + square(c.common_scale * c.gravity_mps2),
        ]
    }

    /// Biases as before the first sample; those of the specific force where `all`.
    pub(super) fn begin_biases(&mut self, all: bool) {
        let [own, common] = self.bias_variances();
        let solver = self.array.solver();
        let covariance = solver.covariance();
        let mut theta = covariance * own;
        for i in 3..6 {
            theta[(i, i)] += common;
        }
        let rank = solver.rank();
        let z = SMatrix::<f64, 6, 6>::from_fn(|i, j| if i == j && i < rank { own } else { 0.0 });
        let RigidArrayBlocks { bias, z_bias, .. } = self.blocks;
        let first = bias.part::<3, 0>();
        for filter in self.mixture.iter_mut().flat_map(Mixture::filters_mut) {
            if all {
                filter.set_covariance(bias, &theta);
                filter.state.set(bias, SVector::zeros());
            } else {
                filter.set_covariance(first, &theta.fixed_view::<3, 3>(0, 0).into_owned());
                filter.state.set(first, Vector3::zeros());
            }
            filter.set_covariance(z_bias, &z);
            filter.state.set(z_bias, SVector::zeros());
        }
    }

    /// Zero velocity and rotation at what looks like a rest. Where that may be constant velocity, after the start, no angular
    /// acceleration and a rotation about the vertical; one whose velocity fails its test is then left. Elsewhere it begins
    /// again.
    pub(super) fn rest(&mut self, step: f64) {
        if !self.resting {
            self.failing_s += step;
        }
        if self.config.rests == Rests::Ignored {
            // Part of the alignment, which gives no velocity.
            self.resting = true;
        } else if self.since_update_s >= REST_INTERVAL_S
            && let Some(mixture) = &mut self.mixture
        {
            self.since_update_s = 0.0;
            let zero = Velocity::zero(REST_SPEED, Some(self.hidden));
            let innovation = mixture.update_each(FREEDOM, Gate::ChiSquare, &zero);
            self.resting = innovation.is_some_and(|i| i.accepted);
            let stated = self.config.rests == Rests::ZeroVelocity;
            if !self.resting && stated && self.failing_s >= CERTAIN_REST_S {
                self.begin_again();
                self.resting = true;
            }
        }
        if self.resting {
            self.failing_s = 0.0;
            self.since_rest_s = 0.0;
            self.valid = true;
            // The mean over half a second, shared among the updates in it.
            self.since_zero_s += step;
            if self.since_zero_s < ZERO_INTERVAL_S {
                return;
            }
            let slower = libm::sqrt((REST_S / self.since_zero_s).max(1.0));
            self.since_zero_s = 0.0;
            let [rate, acceleration] = REST_ROTATION.map(|d| d * slower);
            let Some(mixture) = &mut self.mixture else {
                return;
            };
            let zero = Known::zero(self.blocks.acceleration(), [acceleration; 3]);
            mixture.update_each(FREEDOM, Gate::Open, &zero);
            let block = self.blocks.rate();
            if self.still_start || self.config.rests == Rests::ZeroVelocity {
                let deviation = [rate; 3];
                mixture.update_each(FREEDOM, Gate::Open, &Known::zero(block, deviation));
            } else {
                let deviation = rate;
                mixture.update_each(FREEDOM, Gate::Open, &VerticalRate { block, deviation });
            }
        }
    }

    /// At a rest that is certain, and whose velocity failed its test: the linearisation does not hold. Attitude, velocity,
    /// rotation and biases begin again, the position is uncertain by the velocity times the time since the last rest.
    pub(super) fn begin_again(&mut self) {
        let Some(mixture) = &self.mixture else {
            return;
        };
        let before = mixture.moments();
        let attitude = before.state.attitude;
        let force = self.rest_test.force();
        let up = attitude * force;
        let levelled =
            Rotation3::rotation_between(&up, &Vector3::z()).unwrap_or(Rotation3::identity());
        let heading = before.covariance(ATTITUDE)[(2, 2)] + libm::pow(levelled.angle(), 2.0);
        let moved = before.state.get(VELOCITY) * self.since_rest_s;
        let position =
            before.covariance(POSITION) + Matrix3::from_diagonal(&moved.component_mul(&moved));
        self.begin(levelled * attitude, &self.rest_test.force(), true);
        self.recoveries = self.recoveries.saturating_add(1);
        for filter in self.mixture.iter_mut().flat_map(Mixture::filters_mut) {
            filter.state.set(POSITION, before.state.get(POSITION));
            filter.set_covariance(POSITION, &position);
            let heading = Matrix1::new(heading.min(HEADING_UNKNOWN));
            filter.set_covariance(HEADING, &heading);
        }
    }

    /// Time without a usable sample. After a gap the rotation is unknown.
    pub(super) fn interrupt(&mut self, step: f64, gap: bool) {
        self.valid = false;
        self.resting = false;
        self.rest_test.interrupt();
        self.surprise = 1.0;
        self.last = None;
        let step_s = step.min(1e3);
        let solver = self.array.solver();
        let rotation = RigidArray {
            blocks: &self.blocks,
            solver,
            acceleration_walk: self.level.activity,
            rate_walk: 0.0,
            bias_decay: 1.0,
            bias_variance: 0.0,
            common_variance: 0.0,
            step_s,
        };
        let [rate, acceleration] = START_ROTATION.map(|d| d * d);
        let unknown = [rate, rate, rate, acceleration, acceleration, acceleration];
        let unknown = SMatrix::<f64, 6, 6>::from_diagonal(&unknown.into());
        for filter in self.mixture.iter_mut().flat_map(Mixture::filters_mut) {
            filter.predict(&Unmeasured { step_s, since_s: 0.0 });
            if gap {
                filter.set_covariance(self.blocks.rotation, &unknown);
            } else {
                filter.predict(&rotation);
            }
        }
    }

    /// Where a number is not finite, or the speed not possible, velocity and position are unknown until the next rest. The
    /// rotation continues if it is finite.
    pub(super) fn restart_if_diverged(&mut self) {
        let Some(mixture) = &mut self.mixture else {
            return;
        };
        let sound = mixture.components().iter().all(|c| c.filter.is_sound());
        let slow = |filter: &Filter| filter.state.get(VELOCITY).norm() < DIVERGED_SPEED;
        if sound && mixture.components().iter().all(|c| slow(&c.filter)) {
            return;
        }
        (self.valid, self.resting, self.lost, self.moving_start) = (false, false, true, true);
        if !sound {
            self.mixture = None;
            self.level = Level::new();
            return;
        }
        let diagonal = |d: f64| Matrix3::from_diagonal_element(d * d);
        for filter in mixture.filters_mut() {
            filter.state.set(VELOCITY, Vector3::zeros());
            filter.set_covariance(ATTITUDE, &diagonal(MOVING_TILT));
            filter.set_covariance(VELOCITY, &diagonal(MOVING_VELOCITY));
            filter.set_covariance(POSITION, &diagonal(LOST_POSITION));
        }
    }
}
