//! Displacement that an undetected constant velocity at rests may have caused: equation (103).

use crate::Real;

/// Second moments of an axis: velocity that was taken for zero, and the displacement by it.
#[derive(Clone, Copy, Debug, Default)]
struct Axis<R> {
    velocity2: R,
    both: R,
    position2: R,
}

impl<R: Real> Axis<R> {
    fn after(self, dt: R) -> Self {
        let two = R::from_f64(2.0);
        let Self {
            velocity2,
            both,
            position2,
        } = self;
        Self {
            velocity2,
            both: both + dt * velocity2,
            position2: position2 + dt * (two * both + dt * velocity2),
        }
    }
}

/// The same of three axes.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Unseen<R>([Axis<R>; 3]);

impl<R: Real> Unseen<R> {
    /// After a time, s.
    #[must_use]
    pub fn after(self, dt: R) -> Self {
        Self(self.0.map(|axis| axis.after(dt)))
    }

    /// As a rest begins, an estimated velocity with its variance is taken for zero: it may go on.
    pub fn add_velocity(&mut self, velocity: [R; 3], variance: [R; 3]) {
        for (i, axis) in self.0.iter_mut().enumerate() {
            axis.velocity2 += velocity[i] * velocity[i] + variance[i];
        }
    }

    /// A rest does not exclude a velocity of this standard deviation, m/s, a component.
    pub fn at_least(&mut self, sd: R) {
        for axis in &mut self.0 {
            if axis.velocity2 < sd * sd {
                axis.velocity2 = sd * sd;
            }
        }
    }

    /// Zero-velocity updates corrected the position by `by` more, after `before`, m, together with a velocity, m/s.
    pub fn add_correction(&mut self, velocity: [R; 3], before: [R; 3], by: [R; 3]) {
        for (i, axis) in self.0.iter_mut().enumerate() {
            axis.position2 += by[i] * (by[i] + before[i] + before[i]);
            axis.both += by[i] * velocity[i];
            if axis.position2 < R::default() {
                axis.position2 = R::default();
            }
        }
    }

    /// Adds variances of the displacement, m².
    pub fn add_position(&mut self, variance: [R; 3]) {
        for (axis, variance) in self.0.iter_mut().zip(variance) {
            axis.position2 += variance;
        }
    }

    /// m²/s².
    pub fn velocity2(&self) -> [R; 3] {
        core::array::from_fn(|i| self.0[i].velocity2)
    }

    /// m².
    pub fn position2(&self) -> [R; 3] {
        core::array::from_fn(|i| self.0[i].position2)
    }

    /// Standard deviation of the displacement in space, m.
    pub fn position_sd_m(&self) -> R {
        let [x, y, z] = self.position2();
        let sum = x + y + z;
        if sum > R::default() {
            sum.sqrt()
        } else {
            R::default()
        }
    }
}
