//! What the last rest showed of gravity and bias, carried to now: what else looks like a rest must agree
//! with it. Equation (91).

use super::UnitFilter;
use super::rest::{PARTS, Part};
use crate::Real;
use crate::vector::{Vector, add, dot, norm, scale, sub, times, turn};

/// What an accelerometer shows at two rests at one attitude differs by this, m/s², ...
const SLACK_MPS2: f64 = 0.005;
/// ... drifts by this at rest, m/s² per √s, ...
const DRIFT_MPS2: f64 = 1e-3;
/// ... departs from its own last seconds by this, m/s², each tenth of a second with this weight, ...
const LAG_MPS2: f64 = 0.002;
const LAG: f64 = 0.05;
/// ... and at another attitude differs by this, m/s² per rad: its bias, and the scale of both sensors.
const TURN_MPS2: f64 = 0.1;
/// A mean beyond so many variances in space is not that of a rest: one of 10⁴ is.
pub(super) const GATE: f64 = 21.0;
/// Deviations beyond which a field has turned, or not turned with gravity.
const TURNED: f64 = 3.0;
/// While a stillness is refused, the deviation that it is measured by grows e-fold in this time, s.
const DOUBT_S: f64 = 10.0;
/// A rest's mean that a slow push shows against follows in this time, s, and what it gained is forgotten in that.
const SLOW_S: f64 = 20.0;
const GAINED_S: f64 = 5.0;
/// The mean follows a push: of what it was, so many times what shows.
const FOLLOWED: f64 = 1.5;
/// A rest so soon after one, s, and turned by less than this, rad, goes on with that.
const SAME_S: f64 = 1.0;
const SAME_RAD: f64 = 0.02;
/// Of the velocity that was gained before a rest was seen to end, what may have come before the last half
/// second.
const BEFORE: f64 = 0.3;
/// The way of what was gained in a part of that is known to this share, if all of it came at once.
const WITHIN: f64 = 0.2;
/// So far back a rest may have ended when it is seen to, s.
pub(super) const BACK_S: f64 = 0.6;

/// Of the last rest.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Anchor<R> {
    /// Mean force, body axes as they are now, m/s², and its variance.
    pub force: Vector<R>,
    variance: R,
    /// Mean field there, µT, body axes as they were.
    field: Option<Vector<R>>,
    /// What was turned since, rad, and how long ago it was, s.
    turned: Vector<R>,
    since_s: R,
    /// Whether an angular rate carried it all the way.
    pub carried: bool,
    /// Mean of what the last parts departed by from what was expected, m/s²: of a slow push all to one side.
    lag: Vector<R>,
    /// Mean force over the last of the rest, m/s², body axes as they are now, and over how many parts.
    slow: Vector<R>,
    parts: R,
    /// What a push that is too slow to end the rest would have gained, m/s, the same axes.
    gained: Vector<R>,
}

/// What a stillness is, as far as the anchor tells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Verdict<R> {
    /// It may be a rest: a push below this, m/s², would look the same.
    Rest(R),
    /// It is pushed.
    Pushed,
    /// It is pushed by this, m/s² body axes, or has turned, and nothing tells which.
    Either(Vector<R>),
}

impl<R: Real> Anchor<R> {
    /// From what a rest shows.
    pub fn new(all: &Part<R>, about: Vector<R>, level: R, rated: bool) -> Self {
        let one = R::from_f64(1.0);
        let force = add(about, scale(all.force, one / all.count));
        Self {
            force,
            variance: level / all.count,
            field: (all.fields > R::default()).then(|| scale(all.field, one / all.fields)),
            turned: [R::default(); 3],
            since_s: R::default(),
            carried: rated,
            lag: [R::default(); 3],
            slow: force,
            parts: R::from_f64(PARTS as f64),
            gained: [R::default(); 3],
        }
    }

    /// A rest that goes on after a moment at which it seemed to be none: what a slow push has shown stays.
    pub fn follow(&mut self, before: &Self) {
        let turned = R::from_f64(SAME_RAD);
        let same = dot(before.turned, before.turned) < turned * turned;
        if before.since_s < R::from_f64(SAME_S) && (same || !before.carried) {
            (self.slow, self.parts, self.gained) = (before.slow, before.parts, before.gained);
        }
    }

    /// Over a sample in which the unit turned by `by`, rad, as it was measured with a random walk of this
    /// variance, rad²/s; `None` where no angular rate was.
    pub fn carry(&mut self, by: Option<Vector<R>>, step: R, walk2: R, gravity: R) {
        let drift = R::from_f64(DRIFT_MPS2 * DRIFT_MPS2);
        self.since_s += step;
        self.variance += drift * step;
        match by {
            Some(by) if self.carried => {
                let back = turn(scale(by, R::from_f64(-1.0)));
                self.force = times(&back, self.force);
                self.slow = times(&back, self.slow);
                self.turned = add(self.turned, by);
                self.variance += gravity * gravity * walk2 * step;
            }
            _ => self.carried = false,
        }
    }

    /// Variance of a component of the mean of `count` samples of variance `level` at a rest now.
    fn expected(&self, level: R, count: R, rate_variance: R, gravity: R) -> R {
        let turned = norm(self.turned);
        let most = R::from_f64(core::f64::consts::PI);
        let turned = R::from_f64(TURN_MPS2) * if turned < most { turned } else { most };
        let drifted = gravity * gravity * rate_variance * self.since_s * self.since_s;
        let slack = R::from_f64(SLACK_MPS2 * SLACK_MPS2);
        let known = if self.carried { drifted } else { R::default() };
        self.variance + level / count + turned * turned + slack + known
    }

    /// Judges a stillness of which `all` are the sums.
    pub fn judge(
        &mut self,
        all: &Part<R>,
        level: R,
        rate_variance: R,
        gravity: R,
        disturbance: R,
    ) -> Verdict<R> {
        let apart = all.apart();
        let expected = self.expected(level, all.count, rate_variance, gravity);
        let most = R::from_f64(GATE) * expected;
        let square = dot(apart, apart);
        // Innovations of a rest that goes on are white: their mean over the last 2 s is smaller.
        let slack = R::from_f64(LAG_MPS2 * LAG_MPS2);
        let parts = level / all.count * R::from_f64(PARTS as f64) + self.variance;
        let lagging = R::from_f64(GATE) * (parts * R::from_f64(LAG / (2.0 - LAG)) + slack);
        let slow = dot(self.lag, self.lag) > lagging;
        if square < most && !slow {
            return Verdict::Rest(most.sqrt());
        }
        self.lag = [R::default(); 3];
        if self.carried {
            // Both may be true: a push, and an attitude that is known worse than it seems.
            let grown = R::from_f64(2.0 / DOUBT_S / PARTS as f64) * all.time_s;
            self.variance += expected * grown;
            return Verdict::Pushed;
        }
        match self.field_turned(all, apart, disturbance) {
            Some(true) => Verdict::Rest(most.sqrt()),
            Some(false) => Verdict::Pushed,
            None => Verdict::Either(apart),
        }
    }

    /// Whether the field turned with gravity: then the unit did. `None` where that does not show.
    fn field_turned(&self, all: &Part<R>, apart: Vector<R>, disturbance: R) -> Option<bool> {
        let before = self.field?;
        if all.fields <= R::default() {
            return None;
        }
        let one = R::from_f64(1.0);
        let now = scale(all.field, one / all.fields);
        let force = add(self.force, apart);
        let (size, pull) = (norm(self.force), norm(force));
        if size <= one || pull <= one {
            return None;
        }
        // Along gravity it is what it was, where only the unit turned.
        let along = dot(now, force) / pull - dot(before, self.force) / size;
        let other = norm(sub(now, before));
        let most = R::from_f64(TURNED) * disturbance;
        match (other > most, along.abs() > most) {
            (true, false) => Some(true),
            (false, true) => Some(false),
            _ => None,
        }
    }

    /// Takes what a rest that goes on showed half a second ago, and returns by how much it changed.
    pub fn learn(&mut self, part: &Part<R>, level: R, rated: bool) -> Vector<R> {
        let expected = self.variance + level / part.count;
        let share = self.variance / expected;
        let lag = R::from_f64(LAG);
        self.lag = add(self.lag, scale(sub(part.apart(), self.lag), lag));
        let one = R::from_f64(1.0);
        let apart = add(part.apart(), sub(self.force, self.slow));
        let kept = one - part.time_s * R::from_f64(1.0 / GAINED_S);
        self.gained = add(scale(self.gained, kept), scale(apart, part.time_s));
        self.parts += one;
        let least = part.time_s * R::from_f64(1.0 / SLOW_S);
        let new = one / self.parts;
        self.slow = add(
            self.slow,
            scale(apart, if new > least { new } else { least }),
        );
        let change = scale(part.apart(), share);
        self.force = add(self.force, change);
        self.variance = self.variance * (R::from_f64(1.0) - share);
        self.turned = [R::default(); 3];
        self.since_s = R::default();
        self.carried = rated;
        change
    }

    /// Variance of a component, (m/s²)².
    pub fn variance(&self) -> R {
        self.variance + R::from_f64(SLACK_MPS2 * SLACK_MPS2)
    }

    /// What a slow push would have gained at the rest, m/s, body axes.
    pub fn gained(&self) -> Vector<R> {
        scale(self.gained, R::from_f64(FOLLOWED))
    }

    /// The push itself, m/s², body axes.
    pub fn push(&self) -> Vector<R> {
        scale(sub(self.force, self.slow), R::from_f64(FOLLOWED))
    }

    pub fn since_s(&self) -> R {
        self.since_s
    }
}

impl<R: Real> UnitFilter<R> {
    /// A rest has ended, and what ended it began within the last half second, in which velocity was taken for
    /// zero: what the force gained in it comes back.
    pub(super) fn regain(&mut self) {
        let Some(known) = self.quiet.anchor().map(Anchor::variance) else {
            return;
        };
        if !core::mem::take(&mut self.held) {
            return;
        }
        let half = R::from_f64(0.5);
        let (mut velocity, mut way, mut lasted) =
            ([R::default(); 3], [R::default(); 3], R::default());
        let mut coarse = R::default();
        for part in self.quiet.parts() {
            let gained = scale(times(&self.attitude, part.apart()), part.time_s);
            let within = norm(gained) * part.time_s * R::from_f64(WITHIN);
            coarse += within * within;
            way = add(way, scale(add(velocity, scale(gained, half)), part.time_s));
            velocity = add(velocity, gained);
            lasted += part.time_s;
        }
        self.put(super::VELOCITY, velocity);
        self.put(super::POSITION, add(self.part(super::POSITION), way));
        // What the anchor does not know, and what came before.
        // Without an angular rate it may have been a turn, and nothing was gained.
        let share = if self.gyroscope.on { BEFORE } else { 1.0 };
        let before = R::from_f64(share) * norm(velocity);
        let variance = known * lasted * lasted + before * before;
        let off = before * lasted * half;
        for i in 0..3 {
            self.cov.add(super::VELOCITY, i, variance);
            self.cov.add(super::POSITION, i, coarse + off * off);
        }
    }
}
