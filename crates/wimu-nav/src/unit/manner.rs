//! In what manner the body moves: equation (89). Learnt from what the filter finds, each moment the
//! mean of what is expected of it after an update, so that no truth and no other sensor is needed.

use crate::Real;
use crate::vector::{Vector, cross, dot, norm, scale, sub};

/// What is carried about before anything is known of it: acceleration, m/s², the speed about which it
/// swings, m/s, and angular rate, rad/s.
const ACCELERATION_MPS2: f64 = 1.0;
const SPEED_MPS: f64 = 0.5;
const TURN_RAD_S: f64 = 0.3;
/// Swings of 0.16 to 2 Hz, rad/s squared.
const LEAST_SWING: f64 = 1.0;
const MOST_SWING: f64 = 150.0;
/// The manner of the last 3 s.
const MEMORY_S: f64 = 3.0;

/// The field's turn is measured over so long, s.
const SWEPT_S: f64 = 0.1;
/// It spins where it went on by this, rad, within that, s.
const SPIN_RAD: f64 = 0.5;
const SPIN_S: f64 = 0.4;

/// Mean squares of a component while the body moves.
#[derive(Clone, Copy, Debug)]
pub(super) struct Manner<R> {
    acceleration: R,
    speed: R,
    turn: R,
    innovation: R,
}

/// How fast the magnetic field turns in the body: as fast at least does the body.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Swept<R> {
    /// The field and the direction of the force.
    from: Option<[Vector<R>; 2]>,
    since_s: R,
    /// Mean squares of a component of the angular rate, (rad/s)², of the last two times.
    last: [R; 2],
    /// What it spun by about the upright axis of late, rad.
    spun: R,
}

impl<R: Real> Swept<R> {
    /// Takes a field, µT, that is known to `noise`, and a force, body axes, `step_s` after the ones before.
    pub fn see(&mut self, field: Vector<R>, force: Vector<R>, noise: R, step_s: R) {
        self.since_s += step_s;
        let one = R::from_f64(1.0);
        let pull = norm(force);
        let up = scale(force, one / if pull > one { pull } else { one });
        let Some([before, up_before]) = self.from else {
            self.from = Some([field, up]);
            self.since_s = R::default();
            return;
        };
        if self.since_s < R::from_f64(SWEPT_S) {
            return;
        }
        let (change, size) = (sub(field, before), dot(field, field));
        let two = R::from_f64(2.0);
        let scatter = two * two * noise * noise;
        let none = R::default();
        let time2 = self.since_s * self.since_s;
        let turned = dot(change, change) - scatter;
        let turned = turned / (two * time2 * (size + scatter));
        self.last = [self.last[1], if turned > none { turned } else { none }];
        // About the upright axis the field goes round, and gravity stays. Whether the force's direction turned with the
        // body or was that of a push, the spin is what is left either way.
        let round = cross(up, field);
        let level = dot(round, round);
        let tilted = cross(cross(up, sub(up, up_before)), field);
        let [seen, left] = [change, sub(change, tilted)].map(|by| dot(by, round));
        let less = if seen.abs() < left.abs() { seen } else { left };
        let spun = if seen * left > none {
            less / (level + scatter)
        } else {
            none
        };
        let kept = R::from_f64(libm::exp(-self.since_s.to_f64() / SPIN_S));
        self.spun = self.spun * kept + spun;
        self.from = Some([field, up]);
        self.since_s = none;
    }

    /// Standard deviation of the angular rate now, rad/s.
    pub fn turn(&self) -> R {
        let [a, b] = self.last;
        (if a > b { a } else { b }).sqrt()
    }

    /// Angular rate about the upright axis at which it goes on spinning, rad/s.
    pub fn spin(&self) -> R {
        let angle = self.spun.abs();
        let most = R::from_f64(SPIN_RAD);
        if angle > most {
            angle * R::from_f64(1.0 / SPIN_S)
        } else {
            R::default()
        }
    }
}

impl<R: Real> Default for Manner<R> {
    fn default() -> Self {
        Self {
            acceleration: R::from_f64(ACCELERATION_MPS2 * ACCELERATION_MPS2),
            speed: R::from_f64(SPEED_MPS * SPEED_MPS),
            turn: R::from_f64(TURN_RAD_S * TURN_RAD_S),
            innovation: R::from_f64(1.0),
        }
    }
}

impl<R: Real> Manner<R> {
    /// A start in motion: mean square of a component of the acceleration, (m/s²)².
    pub fn begin(&mut self, square: R) {
        if square > self.acceleration {
            let by = square / self.acceleration;
            self.acceleration = square;
            self.speed = self.speed * by;
            self.turn = self.turn * by;
        }
    }

    /// Takes what an update has found in `step_s`: mean squares of acceleration, swing and, where it is
    /// estimated, angular rate, their variances included.
    pub fn learn(&mut self, acceleration: R, speed: R, turn: Option<R>, step_s: R) {
        let share = step_s * R::from_f64(1.0 / MEMORY_S);
        self.acceleration += (acceleration - self.acceleration) * share;
        self.speed += (speed - self.speed) * share;
        if let Some(turn) = turn {
            self.turn += (turn - self.turn) * share;
        }
    }

    /// Takes an innovation's mean square, divided by what was expected.
    pub fn innovate(&mut self, ratio: R, step_s: R) {
        self.innovation += (ratio - self.innovation) * step_s * R::from_f64(1.0 / MEMORY_S);
    }

    /// Standard deviation of the acceleration, m/s².
    pub fn acceleration(&self) -> R {
        self.acceleration.sqrt()
    }

    /// Standard deviation of the angular rate, rad/s.
    pub fn turn(&self) -> R {
        self.turn.sqrt()
    }

    /// Frequency at which the acceleration swings, rad/s squared.
    pub fn swing(&self) -> R {
        let (least, most) = (R::from_f64(LEAST_SWING), R::from_f64(MOST_SWING));
        let found = self.acceleration / self.speed;
        // Not a number is none of both.
        if found < least {
            least
        } else if found < most {
            found
        } else {
            most
        }
    }

    pub fn innovation(&self) -> R {
        self.innovation
    }
}
