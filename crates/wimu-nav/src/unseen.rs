//! What even motion could have hidden at what was taken for rests: equation (103).

use crate::Real;
use crate::vector::Vector;

/// Second moments of an axis: of a push that was taken for a tilt, of the velocity that was taken for zero and was
/// not, and of the way that it went.
#[derive(Clone, Copy, Debug, Default)]
struct Axis<R> {
    push2: R,
    push_speed: R,
    push_way: R,
    speed2: R,
    speed_way: R,
    way2: R,
}

impl<R: Real> Axis<R> {
    fn after(self, dt: R) -> Self {
        let (two, half) = (R::from_f64(2.0), R::from_f64(0.5) * dt * dt);
        let Self {
            push2: aa,
            push_speed: av,
            push_way: ap,
            speed2: vv,
            speed_way: vp,
            way2: pp,
        } = self;
        Self {
            push2: aa,
            push_speed: av + dt * aa,
            push_way: ap + dt * av + half * aa,
            speed2: vv + dt * (two * av + dt * aa),
            speed_way: vp + dt * (vv + ap + dt * av) + half * (av + dt * aa),
            way2: pp + dt * (two * vp + dt * vv) + two * half * (ap + dt * av) + half * half * aa,
        }
    }
}

/// The same of the three.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Unseen<R>([Axis<R>; 3]);

impl<R: Real> Unseen<R> {
    /// It goes on so long, s.
    #[must_use]
    pub fn after(self, dt: R) -> Self {
        Self(self.0.map(|axis| axis.after(dt)))
    }

    /// A velocity of this variance was taken for zero as a rest began: if it did not rest, it came there with it.
    pub fn arrived(&mut self, velocity: Vector<R>, variance: Vector<R>) {
        for (i, axis) in self.0.iter_mut().enumerate() {
            axis.speed2 += velocity[i] * velocity[i] + variance[i];
        }
    }

    /// At a rest a push to this velocity, known to `sd`, m/s an axis, would not have ended it, and goes on by this, m/s².
    pub fn pushed(&mut self, velocity: Vector<R>, sd: R, push: Vector<R>) {
        for (i, axis) in self.0.iter_mut().enumerate() {
            let square = velocity[i] * velocity[i] + sd * sd;
            if axis.speed2 < square {
                axis.speed2 = square;
            }
            axis.push2 = push[i] * push[i];
            axis.push_speed = R::default();
            axis.push_way = R::default();
        }
    }

    /// More of the way was taken off with a velocity that was taken for zero, `before` by now.
    pub fn missing(&mut self, velocity: Vector<R>, before: Vector<R>, by: Vector<R>) {
        for (i, axis) in self.0.iter_mut().enumerate() {
            axis.way2 += by[i] * (by[i] + before[i] + before[i]);
            axis.speed_way += by[i] * velocity[i];
            if axis.way2 < R::default() {
                axis.way2 = R::default();
            }
        }
    }

    /// The way has these variances besides, m².
    pub fn strayed(&mut self, more: Vector<R>) {
        for (axis, more) in self.0.iter_mut().zip(more) {
            axis.way2 += more;
        }
    }

    /// The way is measured from here.
    pub fn restart(&mut self) {
        for axis in &mut self.0 {
            axis.push_way = R::default();
            axis.speed_way = R::default();
            axis.way2 = R::default();
        }
    }

    /// So much of the velocity's variance is none any more.
    pub fn forget(&mut self, share: R) {
        for axis in &mut self.0 {
            axis.speed2 += -share * axis.speed2;
        }
    }

    /// The way is measured from where it was so long ago, s, at the velocity that it has.
    pub fn restart_before(&mut self, back_s: R) {
        for axis in &mut self.0 {
            axis.push_way = back_s * axis.push_speed;
            axis.speed_way = back_s * axis.speed2;
            axis.way2 = back_s * back_s * axis.speed2;
        }
    }

    /// (m/s)².
    pub fn speed2(&self) -> Vector<R> {
        core::array::from_fn(|i| self.0[i].speed2)
    }

    /// m².
    pub fn way2(&self) -> Vector<R> {
        core::array::from_fn(|i| self.0[i].way2)
    }

    /// In space, m.
    pub fn way_sd_m(&self) -> R {
        let [x, y, z] = self.way2();
        let sum = x + y + z;
        if sum > R::default() {
            sum.sqrt()
        } else {
            R::default()
        }
    }
}
