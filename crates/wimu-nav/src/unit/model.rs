//! How the states go on, and what is measured of them: equations (83) to (85).

use super::anchor::BACK_S;
use super::covariance::{Row, pick};
use super::{
    ACCELERATION, ALIGN_S, BIAS, Block, FIELD, Group, OMEGA, PHI, POSITION, RISE, STATES, SWING,
    UnitFilter, VELOCITY,
};
use crate::Real;
use crate::vector::{
    Matrix, Vector, add, diagonal, dot, norm, orthonormal, product, scale, scaled, skew, sub,
    times, turn, zero,
};

/// How long a motion's angular rate lasts, s, and in what time its acceleration is forgotten.
const TURN_TIME_S: f64 = 0.2;
const ACCELERATION_TIME_S: f64 = 0.2;
/// The square of a tilt that swings with the motion swings twice as fast: so long does it last, s.
const SQUARE_TIME_S: f64 = 0.134;
/// Tilt variance beyond which second order says no more, rad².
const SQUARE_MOST: f64 = 0.25;
/// Acceleration that is seen at rest, m/s², and angular rate, rad/s.
const REST_MPS2: f64 = 0.02;
pub(super) const REST_RAD_S: f64 = 1e-3;
/// What departs from a rest by more than so many variances ends it.
const END_OF_REST: f64 = 9.0;
/// It turns for so long before that, s.
const ENDING_S: f64 = 0.1;
/// Magnetic disturbances indoors, µT, and how long they last for a body carried about, s.
pub(super) const DISTURBANCE_UT: f64 = 4.0;
const DISTURBANCE_TIME_S: f64 = 10.0;
/// A field that turns so many times as fast as the body usually does shows a turn.
const SWEPT: f64 = 2.0;
/// A push of so many m/s², over a second, for each rad/s of a spin, is taken for it.
const SPUN_MPS: f64 = 0.4;
/// Random walk of the field at one place, µT/√s.
const REST_UT: f64 = 0.1;
/// A magnetometer's noise after averaging, µT.
const FIELD_NOISE_UT: f64 = 0.5;
/// An innovation of the field beyond this many variances is a disturbance of another kind.
const FIELD_GATE: f64 = 25.0;
/// Bias of a calibrated accelerometer, m/s², and its random walk, m/s² per √s.
pub(super) const BIAS_MPS2: f64 = 0.05;
const BIAS_WALK: f64 = 1e-4;
/// Standard deviation of each entry of the error of an accelerometer's matrix of scales and axes, and how long an
/// acceleration lasts, s.
pub(super) const SCALE_ERROR: f64 = 0.01;
const PUSH_S: f64 = 0.2;
/// Random walk of a gyroscope's bias, rad/s per √s: 10 °/h within 100 s.
const RATE_WALK: f64 = 5e-6;
/// Random walk of the angle, rad/√s, and noise of an update's mean force, m/s², before a rest has shown
/// them, and the least of both.
const ANGLE_WALK: f64 = 3e-4;
const LEAST_WALK: f64 = 1e-5;
const FORCE_NOISE_MPS2: f64 = 0.05;
const LEAST_NOISE_MPS2: f64 = 0.01;
/// Speed that a rest may have, m/s.
const ZUPT_MPS: f64 = 0.005;
/// A velocity beyond so many variances at a seeming rest is even motion ...
pub(super) const EVEN_GATE: f64 = 9.0;
/// ... and stays it until it is within so many ...
const DOUBTED_GATE: f64 = 1.0;
/// ... unless the velocity's deviation is wrong: it grows e-fold in this time, s.
const EVEN_S: f64 = 10.0;
/// Odds that time jumped where samples seem to be missing.
const MISSED: f64 = 0.5;
/// What a push in the first rest gave is none of the frame in which its last seconds are at rest: it is forgotten in this
/// time, s.
const PUSHED_S: f64 = 30.0;
/// A push that is too weak to be seen is taken to last so long, s.
const FOLLOW_S: f64 = 2.0;
/// Speed where nothing is known of it, m/s.
pub(super) const UNKNOWN_MPS: f64 = 2.0;

/// How far the field at another place is off after so long, µT.
pub(super) fn disturbance<R: Real>(since_s: R) -> R {
    let kept = libm::exp(-2.0 * since_s.to_f64() / DISTURBANCE_TIME_S);
    let square = DISTURBANCE_UT * DISTURBANCE_UT * (1.0 - kept);
    R::from_f64((square + FIELD_NOISE_UT * FIELD_NOISE_UT).sqrt())
}

impl<R: Real> UnitFilter<R> {
    /// Even motion, or the end of a push, that the rest that it is at would not show.
    pub(super) fn unseen_mps(&self) -> R {
        let pushed = self.quiet.unseen() * R::from_f64(FOLLOW_S);
        let loose = R::from_f64(EVEN_GATE).sqrt() * self.loose_mps;
        if loose > pushed { loose } else { pushed }
    }

    pub(super) fn update(&mut self) {
        let group = core::mem::take(&mut self.group);
        let dt = group.time_s;
        let one = R::from_f64(1.0);
        let force = scale(group.force, one / group.count);
        let noise = self.force_noise(group.count);
        let rated = self.gyroscope.on && group.rated > R::default();
        self.unseen = self.unseen.after(dt);
        self.moved |= !self.quiet.is_rest();
        self.doubted &= self.quiet.is_rest();
        if !self.begun && self.config.zupt.is_on() && self.quiet.lasts(R::from_f64(ALIGN_S)) {
            return self.start_anew();
        }
        self.predict(force, &group, noise, rated);
        if rated {
            let by = times(&self.attitude, group.turned);
            self.doubt_turn(by, force, dt / group.count);
            self.follow_way(dt);
        }
        if !rated && group.fields > R::default() {
            let field = scale(group.field, one / group.fields);
            let [field, push] = [field, force].map(|v| {
                core::array::from_fn(|i| {
                    (0..3).fold(R::default(), |sum, k| sum + self.attitude[k][i] * v[k])
                })
            });
            self.swept.see(field, push, R::from_f64(FIELD_NOISE_UT), dt);
            self.doubt_spin(dt);
        }
        if !(rated && self.quiet.is_pushed()) {
            self.see_gravity(force, noise, dt);
        }
        if group.fields > R::default() {
            self.see_field(scale(group.field, one / group.fields));
        }
        if !rated && let Some((push, lasted)) = self.quiet.either() {
            self.doubt_push(push, lasted, dt);
        }
        if !self.quiet.is_rest() {
            let turn = (!rated).then(|| self.square(OMEGA));
            let (acceleration, speed) = (self.square(ACCELERATION), self.square(SWING));
            self.manner.learn(acceleration, speed, turn, dt);
        } else if self.config.zupt.is_on() {
            if rated {
                self.see_no_turn(&group);
            }
            if self.begun {
                self.see_rest(dt, rated);
            }
        }
        if self.is_at_origin() {
            self.stay(dt);
        }
        self.fold();
    }

    /// The way has not begun, and velocity is zero by definition, but for a push of the last seconds that did not show.
    fn stay(&mut self, dt: R) {
        if self.config.zupt.is_on() {
            if !self.held {
                return;
            }
        } else {
            let (gained, sd, _) = self.hidden();
            self.put(VELOCITY, zero());
            for (i, gained) in gained.into_iter().enumerate() {
                self.cov.know(VELOCITY.0 + i);
                self.cov.add(VELOCITY, i, gained * gained + sd * sd);
            }
            self.held = true;
        }
        // It may have ended already, and not have shown yet; a weak push may have begun before.
        let back = R::from_f64(BACK_S);
        self.rest_from_turning();
        self.set_origin();
        self.unseen.forget(dt * R::from_f64(1.0 / PUSHED_S));
        self.unseen.restart_before(R::from_f64(FOLLOW_S));
        self.cov.couple_by(POSITION, VELOCITY, back);
    }

    /// What a push that the rest does not show may have given, m/s, navigation axes, how well that is known, and the push,
    /// m/s².
    fn hidden(&self) -> (Vector<R>, R, Vector<R>) {
        let sd = self.quiet.unseen_sd() * R::from_f64(FOLLOW_S);
        let [gained, push] = match self.quiet.anchor() {
            Some(anchor) => [anchor.gained(), anchor.push()].map(|v| times(&self.attitude, v)),
            None => [zero(); 2],
        };
        (gained, sd, push)
    }

    /// A push or a turn, and nothing tells which: the velocity may have grown as the push would have it.
    fn doubt_push(&mut self, push: Vector<R>, lasted: R, dt: R) {
        let push = times(&self.attitude, push);
        for (i, a) in push.into_iter().enumerate() {
            self.cov
                .add(VELOCITY, i, R::from_f64(2.0) * a * a * lasted * dt);
        }
    }

    /// A spin about the upright axis turns the field as a tilt and a push that hides it would: the velocity may have that of such
    /// a push.
    fn doubt_spin(&mut self, dt: R) {
        let push = R::from_f64(SPUN_MPS) * self.swept.spin();
        for i in 0..2 {
            self.cov.add(VELOCITY, i, push * push * dt);
        }
    }

    /// Mean square of a block's components.
    fn square(&self, at: Block) -> R {
        let (mean, [x, y, z]) = (self.part(at), self.cov.variance(at));
        (dot(mean, mean) + x + y + z) * R::from_f64(1.0 / 3.0)
    }

    /// Variance of the mean force of `count` samples.
    fn force_noise(&self, count: R) -> R {
        let least = R::from_f64(LEAST_NOISE_MPS2 * LEAST_NOISE_MPS2);
        match (self.config.force_noise_mps2, self.quiet.force_variance()) {
            (Some(noise), _) => R::from_f64(noise * noise),
            (None, Some(variance)) if variance > least * count => variance / count,
            (None, Some(_)) => least,
            (None, None) => R::from_f64(FORCE_NOISE_MPS2 * FORCE_NOISE_MPS2),
        }
    }

    /// Random walk of the angle, squared, rad²/s.
    pub(super) fn angle_walk2(&self) -> R {
        let least = R::from_f64(LEAST_WALK * LEAST_WALK);
        match (self.config.angle_walk, self.quiet.angle_walk2()) {
            (Some(walk), _) => R::from_f64(walk * walk),
            (None, Some(seen)) if seen > least => seen,
            (None, Some(_)) => least,
            (None, None) => R::from_f64(ANGLE_WALK * ANGLE_WALK),
        }
    }

    /// Equation (83) over a group, in which the mean force was `force`, navigation axes.
    fn predict(&mut self, force: Vector<R>, group: &Group<R>, noise: R, rated: bool) {
        let dt = group.time_s;
        // Without ZUPT what looks like a rest may be even motion or a steady push, but for that at the start.
        let resting = self.quiet.is_rest() && (self.config.zupt.is_on() || !self.moved);
        let motion = if resting {
            R::from_f64(REST_MPS2)
        } else {
            self.manner.acceleration()
        };
        let square = self.square_of_tilt(force);
        self.cov.couple_by(POSITION, VELOCITY, dt);
        self.cov.couple(VELOCITY, PHI, &scaled(&skew(force), -dt));
        self.cov
            .couple(VELOCITY, BIAS, &scaled(&self.attitude, -dt));
        if let Some(drift) = self.config.drift {
            let share = R::from_f64(drift.share(self.age_s.to_f64()));
            self.cov
                .couple(VELOCITY, RISE, &scaled(&self.attitude, -dt * share));
        }
        let turned = scaled(&self.attitude, if rated { -dt } else { dt });
        for block in [ACCELERATION, SWING, FIELD] {
            let m = product(&skew(self.part(block)), &turned);
            self.cov.couple(block, OMEGA, &m);
        }
        self.cov.couple(PHI, OMEGA, &turned);
        // The acceleration swings: a half step, a whole one, in this order.
        let pull = -dt * self.manner.swing();
        self.cov.couple_by(ACCELERATION, SWING, pull);
        self.cov.couple_by(SWING, ACCELERATION, dt);
        let swing = self.part(SWING);
        let acceleration = add(self.part(ACCELERATION), scale(swing, pull));
        self.put(ACCELERATION, acceleration);
        self.put(SWING, add(swing, scale(acceleration, dt)));
        self.forget(ACCELERATION, dt, ACCELERATION_TIME_S, motion);
        if resting {
            // Rest or even motion: it does not swing back.
            let speed = motion / self.manner.swing().sqrt();
            self.forget(SWING, dt, ACCELERATION_TIME_S, speed);
        }
        if rated {
            let walk = self.angle_walk2() * dt + group.bends * R::from_f64(1.0 / 144.0);
            for i in 0..3 {
                self.cov
                    .add(OMEGA, i, R::from_f64(RATE_WALK * RATE_WALK) * dt);
                self.cov.add(PHI, i, walk);
            }
        } else {
            let turning = if resting {
                R::from_f64(REST_RAD_S)
            } else {
                let (usual, seen) = (self.manner.turn(), self.swept.turn());
                if seen > R::from_f64(SWEPT) * usual {
                    seen
                } else {
                    usual
                }
            };
            self.forget(OMEGA, dt, TURN_TIME_S, turning);
        }
        // A disturbance belongs to a place: it changes with the way, not at rest.
        if resting {
            for i in 0..3 {
                self.cov.add(FIELD, i, R::from_f64(REST_UT * REST_UT) * dt);
            }
        } else {
            self.forget(FIELD, dt, DISTURBANCE_TIME_S, R::from_f64(DISTURBANCE_UT));
        }

        let mut push = force;
        push[2] -= R::from_f64(self.config.gravity_mps2);
        let scaling = dot(push, push) * R::from_f64(SCALE_ERROR * SCALE_ERROR * PUSH_S) * dt;
        let walk = R::from_f64(BIAS_WALK * BIAS_WALK) * dt;
        // What a missing sample would have shown is as uncertain as the motion is strong, and so is whether time
        // passed, or its stamp jumped.
        let (missing, missed) = (group.missing, R::from_f64(MISSED));
        let (strength, turning) = (self.manner.acceleration(), self.manner.turn());
        if rated && missing > R::default() {
            let rate = dot(self.rate, self.rate) * R::from_f64(1.0 / 3.0);
            for i in 0..3 {
                self.cov
                    .add(PHI, i, missing * (turning * turning + rate) * missed);
            }
        }
        for (i, speed) in self.part(VELOCITY).into_iter().enumerate() {
            self.cov.add(POSITION, i, missing * speed * speed * missed);
            let lost = strength * strength + push[i] * push[i];
            self.cov.add(VELOCITY, i, missing * lost * missed);
        }
        let half = R::from_f64(0.5) * dt;
        // The trapezoid's error is of the size of what changes from sample to sample (87).
        let uneven = group.jumps * R::from_f64(1.0 / 36.0) + group.apart * R::from_f64(1.0 / 3.0);
        let gained = noise * dt * dt + scaling + uneven;
        for i in 0..3 {
            let spread = square[i] * square[i] * R::from_f64(4.0 * SQUARE_TIME_S) * dt;
            self.cov.add(BIAS, i, walk);
            self.cov.add(VELOCITY, i, gained + spread);
            self.mean[VELOCITY.0 + i] += square[i] * dt;
            self.mean[POSITION.0 + i] += square[i] * dt * half;
        }
    }

    /// A tilt that is not known turns gravity by its square, always downward: ½ E[φ × (φ × f)].
    fn square_of_tilt(&self, force: Vector<R>) -> Vector<R> {
        let p = self.cov.block(PHI, PHI);
        let trace = p[0][0] + p[1][1] + p[2][2];
        if trace > R::from_f64(SQUARE_MOST) {
            return zero();
        }
        scale(sub(times(&p, force), scale(force, trace)), R::from_f64(0.5))
    }

    /// A state that is forgotten in `time_s` and whose standard deviation is `sd` where nothing is known.
    fn forget(&mut self, at: Block, dt: R, time_s: f64, sd: R) {
        let kept = R::from_f64(libm::exp(-dt.to_f64() / time_s));
        let new = sd * sd * (R::from_f64(1.0) - kept * kept);
        self.cov.shrink(at, kept, new);
        self.put(at, scale(self.part(at), kept));
    }

    /// Gravity: in navigation axes its derivatives do not depend on the state.
    fn see_gravity(&mut self, force: Vector<R>, noise: R, dt: R) {
        let g = [
            R::default(),
            R::default(),
            R::from_f64(self.config.gravity_mps2),
        ];
        let innovation = sub(sub(force, g), self.part(ACCELERATION));
        let lever = skew(g);
        let one = diagonal(R::from_f64(1.0));
        let attitude = self.attitude;
        let share = self
            .config
            .drift
            .map_or(0.0, |d| d.share(self.age_s.to_f64()));
        let rise = scaled(&attitude, R::from_f64(share));
        let rows = |row: usize| {
            [
                (PHI, lever[row]),
                (ACCELERATION, one[row]),
                (BIAS, attitude[row]),
                (RISE, rise[row]),
            ]
        };
        if self.quiet.is_rest() {
            let mut expected = R::from_f64(3.0) * noise;
            for row in 0..3 {
                expected += self.cov.project(&rows(row)).1;
            }
            if dot(innovation, innovation) > R::from_f64(END_OF_REST) * expected {
                // The rest has ended: the body moves in its manner, and it has not tilted at once.
                self.regain();
                self.quiet.end();
                let square = self.manner.acceleration() * self.manner.acceleration();
                if !self.gyroscope.on {
                    // Or it has as far as it shows, and nobody saw it.
                    let shows = dot(innovation, innovation) / (g[2] * g[2]);
                    let most = self.manner.turn() * R::from_f64(ENDING_S);
                    let most = most * most;
                    let tilted = if shows < most { shows } else { most };
                    self.cov.add(PHI, 0, tilted);
                    self.cov.add(PHI, 1, tilted);
                    let turn = self.manner.turn() * self.manner.turn();
                    for i in 0..3 {
                        self.cov.add(OMEGA, i, turn);
                    }
                }
                for i in 0..3 {
                    self.cov.add(ACCELERATION, i, square);
                    self.cov.add(SWING, i, square / self.manner.swing());
                }
            }
        }
        if let Some(ratio) = self.measure(rows, innovation, noise, None)
            && !self.quiet.is_rest()
        {
            self.manner.innovate(ratio, dt);
        }
    }

    fn see_field(&mut self, seen: Vector<R>) {
        let Some(field) = self.field else {
            return;
        };
        let innovation = sub(sub(seen, field), self.part(FIELD));
        let lever = skew(field);
        let one = diagonal(R::from_f64(1.0));
        let rows = |row: usize| [(PHI, lever[row]), (FIELD, one[row])];
        let variance = R::from_f64(FIELD_NOISE_UT * FIELD_NOISE_UT);
        if self
            .measure(rows, innovation, variance, Some(FIELD_GATE))
            .is_none()
        {
            self.disturbed = self.disturbed.saturating_add(1);
        }
    }

    /// At a rest the angular rate is the bias of what measures it, unless that is known to be another.
    fn see_no_turn(&mut self, group: &Group<R>) {
        let one = diagonal(R::from_f64(1.0));
        let rows = |row: usize| [(OMEGA, one[row])];
        let mean = scale(group.turned, R::from_f64(1.0) / group.rated);
        let variance = self.angle_walk2() / group.rated;
        self.measure(rows, mean, variance, Some(EVEN_GATE));
    }

    /// What was taken for a rest may be even motion, with the velocity that it came with or that a push too weak
    /// to be seen has given it.
    fn hide(&mut self, velocity: Vector<R>, variance: Vector<R>) {
        if !self.held {
            self.unseen.arrived(velocity, variance);
        }
        let (gained, sd, push) = self.hidden();
        self.unseen.pushed(gained, sd, push);
    }

    /// What looks like a rest is one, unless the velocity is known to be another. Then both may be
    /// true, even motion and a velocity whose deviation is too small: that grows while it lasts. Where it
    /// was, the position is as uncertain as a velocity that went wrong some time since the rest before.
    /// Without an angular rate the velocity's error came and went with a tilt that nobody knows: it says
    /// nothing about the way before, and the position stays as it is.
    fn see_rest(&mut self, dt: R, rated: bool) {
        let velocity = self.part(VELOCITY);
        let one = diagonal(R::from_f64(1.0));
        let rows = |row: usize| [(VELOCITY, one[row])];
        let variance = R::from_f64(ZUPT_MPS * ZUPT_MPS);
        if rated && self.valid && !self.doubted && self.since_rest_s > dt {
            self.learn_turn(velocity, variance);
        }
        // A velocity after a gap is not known.
        let most = if self.doubted {
            DOUBTED_GATE
        } else {
            EVEN_GATE
        };
        let gate = self.valid.then_some(most);
        let position = self.part(POSITION);
        let covariance = self.cov.block(POSITION, POSITION);
        let known = scale(velocity, R::from_f64(-1.0));
        if self.since_rest_s > dt {
            let [x, y, z] = self.cov.variance(VELOCITY);
            let most = if x > y { x } else { y };
            let most = if most > z { most } else { z };
            let third = R::from_f64(1.0 / EVEN_GATE).sqrt();
            self.loose_mps = (most + variance).sqrt() + norm(velocity) * third;
        }
        let spread = self.cov.variance(VELOCITY);
        if self.measure(rows, known, variance, gate).is_some() {
            self.hide(velocity, spread);
            if !rated {
                self.put(POSITION, position);
                self.cov.set(POSITION, &covariance);
            }
            if self.doubted {
                let lasted = self.since_rest_s * self.since_rest_s * R::from_f64(1.0 / 3.0);
                for (i, speed) in velocity.iter().enumerate() {
                    self.cov.add(POSITION, i, *speed * *speed * lasted);
                }
            }
            self.doubted = false;
            self.rest_from_turning();
            self.held = true;
            self.since_rest_s = R::default();
            self.valid = true;
        } else {
            self.even = self.even.saturating_add(1);
            self.doubted = true;
            self.held = false;
            let [x, y, z] = self.cov.variance(VELOCITY);
            let doubt = (x + y + z) * dt * R::from_f64(2.0 / 3.0 / EVEN_S);
            for i in 0..3 {
                self.cov.add(VELOCITY, i, doubt);
            }
        }
    }

    /// One three-component measurement, component by component: the mean square of its innovations, each
    /// divided by its variance. `None` where one is beyond `gate` variances, and nothing is done.
    fn measure<const N: usize>(
        &mut self,
        rows: impl Fn(usize) -> Row<R, N>,
        innovation: Vector<R>,
        variance: R,
        gate: Option<f64>,
    ) -> Option<R> {
        if let Some(gate) = gate {
            for row in 0..3 {
                let s = self.cov.project(&rows(row)).1 + variance;
                if innovation[row] * innovation[row] > R::from_f64(gate) * s {
                    return None;
                }
            }
        }
        let mut correction = [R::default(); STATES];
        let mut squares = R::default();
        for row in 0..3 {
            let h = rows(row);
            let (column, square) = self.cov.project(&h);
            let s = square + variance;
            let left = innovation[row] - pick(&h, &correction);
            let rest = left / s;
            squares += left * rest;
            for (value, c) in correction.iter_mut().zip(&column) {
                *value += rest * *c;
            }
            self.cov.reduce(&column, s);
        }
        for (value, c) in self.mean.iter_mut().zip(&correction) {
            *value += *c;
        }
        Some(squares * R::from_f64(1.0 / 3.0))
    }

    /// Moves the attitude's error into the attitude; what is held in navigation axes turns with it.
    fn fold(&mut self) {
        let by: Matrix<R> = turn(self.part(PHI));
        self.attitude = orthonormal(&product(&by, &self.attitude));
        for block in [ACCELERATION, SWING, FIELD] {
            self.put(block, times(&by, self.part(block)));
        }
        self.put(PHI, zero());
    }
}
