//! What sensors do as the unit turns and goes on its way that no calibration has taken off: equation (110).

use super::model::{EVEN_GATE, SCALE_ERROR};
use super::{BIAS, PHI, POSITION, UnitFilter, VELOCITY};
use crate::Real;
use crate::vector::{Vector, add, cross, dot, scale, sub};

/// Standard deviation of each entry of the error of a gyroscope's matrix of scales and axes, which wimu does not
/// calibrate: half of the limits that data sheets give, 1 to 3 %, ...
const RATE_MATRIX: f64 = 0.015;
/// ... and of the time between both sensors, which their filters delay, s.
const DELAY_S: f64 = 5e-3;
/// What the rests say of these after a turn of at least so much, rad, ...
const TELLS_RAD: f64 = 0.1;
/// ... so many of them, with as much weight before the first, ...
const RESTS: f64 = 3.0;
const BEFORE: f64 = 2.0;
/// ... up to so many times the variance.
const MOST: f64 = 100.0;

/// What it turned by since the last rest.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turned<R> {
    /// Navigation axes, rad, and about the upright axis since the start: gravity does not tell that.
    by: Vector<R>,
    about: R,
    /// Their squares as far as they have grown.
    most: R,
    most_about: R,
    most_late: Vector<R>,
    /// The upright axis in the body at the rest, and how far it has gone from there.
    up: Option<Vector<R>>,
    most_apart: R,
    /// Variance of a component of the acceleration, (m/s²)², and of the velocity, (m/s)², that came of it.
    push2: R,
    speed2: R,
    /// Times the variance that rests have shown, and how many did.
    worse: R,
    rests: R,
    /// The way since the origin, m, in navigation axes and as the body saw it go, and the square of the longer as far as it has
    /// grown.
    way: [Vector<R>; 2],
    most_way: R,
}

impl<R: Real> Default for Turned<R> {
    fn default() -> Self {
        let (none, one) = (R::default(), R::from_f64(1.0));
        Self {
            by: [none; 3],
            about: none,
            most: none,
            most_about: none,
            most_late: [none; 3],
            up: None,
            most_apart: none,
            push2: none,
            speed2: none,
            worse: one,
            rests: none,
            way: [[none; 3]; 2],
            most_way: none,
        }
    }
}

/// By how much the greatest so far grows.
fn grown<R: Real>(most: &mut R, now: R) -> R {
    let more = now - *most;
    if more > R::default() {
        *most = now;
        more
    } else {
        R::default()
    }
}

fn square<R: Real>(value: f64) -> R {
    R::from_f64(value * value)
}

/// What a constant matrix makes of something of this square, and of it upward in axes that were levelled with it.
pub(super) fn spread<R: Real>(square_of: R) -> Vector<R> {
    let each = square::<R>(SCALE_ERROR) * square_of;
    [each, each, each + each]
}

impl<R: Real> Turned<R> {
    /// Gravity and velocity are known anew in this attitude, the heading is not.
    fn rest(&mut self, up: Vector<R>) {
        *self = Self {
            about: self.about,
            most_about: self.most_about,
            up: Some(up),
            worse: self.worse,
            rests: self.rests,
            way: self.way,
            most_way: self.most_way,
            ..Self::default()
        };
    }

    /// Position is that since here.
    pub fn depart(&mut self) {
        (self.way, self.most_way) = ([[R::default(); 3]; 2], R::default());
    }

    /// Variances of the way for what the accelerometer's matrix makes of it, m². Upward it is that of the levelling as well.
    pub fn way2(&self) -> Vector<R> {
        spread(self.most_way)
    }

    /// The heading is.
    pub fn head(&mut self) {
        (self.about, self.most_about) = (R::default(), R::default());
    }
}

impl<R: Real> UnitFilter<R> {
    pub(super) fn rest_from_turning(&mut self) {
        self.turned.rest(self.attitude[2]);
    }

    /// What the velocity makes of the way in `dt`.
    pub(super) fn follow_way(&mut self, dt: R) {
        let moved = scale(self.part(VELOCITY), dt);
        let seen = core::array::from_fn(|i| {
            (0..3).fold(R::default(), |sum, k| sum + self.attitude[k][i] * moved[k])
        });
        for (way, more) in self.turned.way.iter_mut().zip([moved, seen]) {
            *way = add(*way, more);
            grown(&mut self.turned.most_way, dot(*way, *way));
        }
    }

    /// Doubts a group of samples `step` s apart in which the unit turned by `by`, rad, navigation axes, as it was measured,
    /// under the mean `force`.
    pub(super) fn doubt_turn(&mut self, by: Vector<R>, force: Vector<R>, step: R) {
        let (one, half) = (R::from_f64(1.0), R::from_f64(0.5));
        let up = self.attitude[2];
        let turned = &mut self.turned;
        turned.by = add(turned.by, by);
        turned.about += by[2];
        let rate2 = square::<R>(RATE_MATRIX) * turned.worse;
        let tilt = rate2 * grown(&mut turned.most, dot(turned.by, turned.by));
        let about = rate2 * grown(&mut turned.most_about, turned.about * turned.about);
        let delay2 = (square::<R>(DELAY_S) + step * step * R::from_f64(1.0 / 12.0)) * turned.worse;
        let off = cross(force, turned.by);
        let late: Vector<R> =
            core::array::from_fn(|i| delay2 * grown(&mut turned.most_late[i], off[i] * off[i]));
        let apart = sub(up, *turned.up.get_or_insert(up));
        let apart = grown(&mut turned.most_apart, dot(apart, apart));
        let gravity2 = square::<R>(self.config.gravity_mps2);
        let matrix2 = gravity2 * square::<R>(SCALE_ERROR) * turned.worse;
        turned.push2 += gravity2 * tilt + matrix2 * apart;
        turned.speed2 += (late[0] + late[1]) * half;
        for (i, late) in late.into_iter().enumerate() {
            self.cov.add(VELOCITY, i, late);
            let more = if i == 2 && about > tilt { about } else { tilt };
            self.cov.add(PHI, i, more);
        }
        if apart > R::default() {
            let most = matrix2 + square(self.config.bias_mps2);
            let lost = half * apart * matrix2 / most;
            let kept = if lost < one { one - lost } else { R::default() };
            self.cov.shrink(BIAS, kept, most * (one - kept * kept));
            self.put(BIAS, scale(self.part(BIAS), kept));
        }
    }

    /// What looks like a rest begins, and the velocity is not zero: a turn may have made it so, by more than was thought.
    pub(super) fn learn_turn(&mut self, velocity: Vector<R>, noise: R) {
        let (one, third) = (R::from_f64(1.0), R::from_f64(1.0 / 3.0));
        let most = R::from_f64(MOST);
        let turned = self.turned;
        let lasted = self.since_rest_s;
        let speed2 = turned.speed2 + turned.push2 * lasted * lasted * third;
        // Else it is even motion.
        let could = dot(velocity, velocity) * turned.worse < R::from_f64(EVEN_GATE) * most * speed2;
        if turned.most < square(TELLS_RAD) || !could {
            return;
        }
        let variance = self.cov.variance(VELOCITY);
        let shown = (0..3).fold(R::default(), |sum, i| {
            sum + velocity[i] * velocity[i] / (variance[i] + noise)
        });
        let before = turned.rests + R::from_f64(BEFORE);
        let worse = turned.worse * (before + shown * third) / (before + one);
        let worse = if worse > most { most } else { worse };
        let worse = if worse > one { worse } else { one };
        self.turned.worse = worse;
        if turned.rests < R::from_f64(RESTS) {
            self.turned.rests += one;
        }
        if worse > turned.worse {
            // The velocity went wrong some time since the rest.
            let tilt = square::<R>(RATE_MATRIX) * (worse - turned.worse) * turned.most;
            for (i, variance) in variance.into_iter().enumerate() {
                let speed2 = variance * (worse / turned.worse - one);
                self.cov.add(PHI, i, tilt);
                self.cov.add(VELOCITY, i, speed2);
                let way = speed2 * lasted;
                self.cov
                    .add_between(VELOCITY, POSITION, i, way * R::from_f64(0.5));
                self.cov.add(POSITION, i, way * lasted * third);
            }
        }
    }
}
