//! What looks like a rest: equation (91).

use super::anchor::{self, Anchor, Verdict};
use super::model::REST_RAD_S;
use super::{OMEGA, UnitFilter};
use crate::Real;
use crate::vector::{Vector, add, dot, norm, scale, sub};

/// A rest shows less than this, m/s² rms, ...
const REST_MPS2: f64 = 0.12;
/// ... less than so many times the variance of the quietest time so far, and of what it is within a tenth
/// of a second (slow motion differs in its means), ...
const REST_RATIO: f64 = 4.0;
/// ... where that is more than a sensor shows whose steps are coarse, m/s² rms, ...
const FLOOR_MPS2: f64 = 0.03;
/// ... a force this near to gravity, m/s², and an angular rate below this, rad/s, ...
const NEAR_MPS2: f64 = 0.3;
const STILL_RAD_S: f64 = 0.1;
/// ... before a rest has shown what is its bias: this, rad/s, ...
const OFFSET_RAD_S: f64 = 0.5;
/// ... over so many parts, each of at least so long, s, and so many samples.
pub(super) const PARTS: usize = 5;
const PART_S: f64 = 0.1;
const PART_SAMPLES: f64 = 4.0;
/// Means of the parts scatter by so many times what samples of their level do: slow motion does more.
const BETWEEN: f64 = 4.0;
const BETWEEN_MPS2: f64 = 0.005;

/// Sums of force and angular rate over a part.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Part<R> {
    pub time_s: R,
    pub count: R,
    pub force: Vector<R>,
    force_square: R,
    rates: R,
    rate: Vector<R>,
    rate_square: R,
    /// Of the force, about each part's own mean.
    within: R,
    /// Of what the anchor has shown at each sample, less the same as the force.
    anchor: Vector<R>,
    pub field: Vector<R>,
    pub fields: R,
}

impl<R: Real> Part<R> {
    /// Mean force less that of the last rest, m/s², body axes.
    pub fn apart(&self) -> Vector<R> {
        let one = R::from_f64(1.0);
        let count = if self.count > one { self.count } else { one };
        scale(sub(self.force, self.anchor), one / count)
    }

    /// Variance of a component of the force.
    pub fn spread(&self) -> R {
        variance(self.force, self.force_square, self.count)
    }

    fn plus(&self, other: &Self) -> Self {
        Self {
            time_s: self.time_s + other.time_s,
            count: self.count + other.count,
            force: add(self.force, other.force),
            force_square: self.force_square + other.force_square,
            rates: self.rates + other.rates,
            rate: add(self.rate, other.rate),
            rate_square: self.rate_square + other.rate_square,
            within: self.within + other.within,
            anchor: add(self.anchor, other.anchor),
            field: add(self.field, other.field),
            fields: self.fields + other.fields,
        }
    }
}

/// Variance of a component from the sum, the sum of squares and the count.
fn variance<R: Real>(sum: Vector<R>, square: R, count: R) -> R {
    let value = (square - dot(sum, sum) / count) / (R::from_f64(3.0) * count);
    if value > R::default() {
        value
    } else {
        R::default()
    }
}

/// The last half second and more, as it moves on.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Quiet<R> {
    /// What is taken off before squares are summed, so that f32 keeps their difference.
    about: Vector<R>,
    parts: [Part<R>; PARTS],
    now: Part<R>,
    filled: usize,
    rest: bool,
    lasted_s: R,
    /// The least variance so far, of the force and of the angular rate times the step.
    level: Option<R>,
    walk: Option<R>,
    /// Mean angular rate at the rest that it is at, rad/s.
    still: Option<Vector<R>>,
    anchor: Option<Anchor<R>>,
    /// What looks like a rest and is a push, or a turn that nobody saw: how strong, m/s² body axes, and for
    /// how long, s.
    either: Option<(Vector<R>, R)>,
    /// A push below this would look like the rest that it is at, m/s².
    unseen: R,
    /// Stillnesses that were pushes, and whether it is at one.
    pushed: u32,
    pushing: bool,
}

impl<R: Real> Quiet<R> {
    pub fn is_rest(&self) -> bool {
        self.rest
    }

    /// Whether it has rested for so long, s.
    pub fn lasts(&self, time_s: R) -> bool {
        self.rest && self.lasted_s >= time_s
    }

    /// What was taken for a rest is none.
    pub fn end(&mut self) {
        self.rest = false;
        self.filled = 0;
        self.now = Part::default();
        self.parts = [Part::default(); PARTS];
        self.either = None;
    }

    /// Nothing is known of what was before.
    pub fn lose(&mut self) {
        self.end();
        self.anchor = None;
    }

    /// No rest was believed yet, as that before a start in motion, from which nothing was carried on: the next
    /// one is not compared with what it showed.
    fn forget(&mut self) {
        if self.anchor.take().is_some() {
            for part in self.parts.iter_mut().chain([&mut self.now]) {
                part.anchor = [R::default(); 3];
            }
        }
    }

    /// From here on what the rest has shown is carried by an angular rate.
    pub fn follow(&mut self) {
        if let Some(anchor) = &mut self.anchor {
            anchor.carried = true;
        }
    }

    /// Sums of the last half second, less `about` each sample.
    pub fn shown(&self) -> Option<Part<R>> {
        let all = |sum: Part<R>, part: &Part<R>| sum.plus(part);
        (self.filled == PARTS).then(|| self.parts.iter().fold(Part::default(), all))
    }

    pub fn about(&self) -> Vector<R> {
        self.about
    }

    pub fn anchor(&self) -> Option<&Anchor<R>> {
        self.anchor.as_ref()
    }

    /// Carries the anchor over a sample: [`Anchor::carry`].
    pub fn carry(&mut self, by: Option<Vector<R>>, step: R, walk2: R, gravity: R) {
        if let Some(anchor) = &mut self.anchor {
            anchor.carry(by, step, walk2, gravity);
        }
    }

    /// The last half second, part by part, and what came since.
    pub fn parts(&self) -> impl Iterator<Item = &Part<R>> {
        self.parts.iter().chain([&self.now])
    }

    /// A push, m/s² body axes, that a turn would look like, and for how long, s.
    pub fn either(&self) -> Option<(Vector<R>, R)> {
        self.either
    }

    /// A push below this would look like the rest that it is at, m/s².
    pub fn unseen(&self) -> R {
        self.unseen
    }

    /// The same as the standard deviation of a component.
    pub fn unseen_sd(&self) -> R {
        self.unseen * R::from_f64(1.0 / anchor::GATE.sqrt())
    }

    /// Whether it is pushed evenly: the force is steady, and not that of the last rest.
    pub fn is_pushed(&self) -> bool {
        self.pushing
    }

    /// Stillnesses that were pushes.
    pub fn pushed(&self) -> u32 {
        self.pushed
    }

    /// Mean angular rate at the rest that it is at, rad/s.
    pub fn still(&self) -> Option<Vector<R>> {
        self.still.filter(|_| self.rest)
    }

    /// Variance of a component of that as its parts scatter, (rad/s)²: a turn may have begun in the last.
    pub fn still_variance(&self) -> R {
        let mut sum = [R::default(); 3];
        let mut squares = R::default();
        for part in self.parts.iter().filter(|part| part.rates > R::default()) {
            let mean = scale(part.rate, R::from_f64(1.0) / part.rates);
            sum = add(sum, mean);
            squares += dot(mean, mean);
        }
        let parts = R::from_f64(PARTS as f64);
        let least = R::from_f64(REST_RAD_S * REST_RAD_S);
        variance(sum, squares, parts) / R::from_f64((PARTS - 1) as f64) + least
    }

    /// Whether a variance is that of a rest: of the force over a longer time, each axis.
    pub fn is_steady(&self, spread: R) -> bool {
        self.rest && self.level.is_some_and(|level| spread < most(level))
    }

    /// Whether enough was seen to say so.
    pub fn is_known(&self) -> bool {
        self.filled == PARTS
    }

    /// Variance of a sample's force at the quietest rest, (m/s²)².
    pub fn force_variance(&self) -> Option<R> {
        self.level
    }

    /// Random walk of the angle at the quietest rest, squared, rad²/s.
    pub fn angle_walk2(&self) -> Option<R> {
        self.walk
    }

    /// Takes a sample; the sums of the last parts where one is full.
    fn gather(
        &mut self,
        force: Vector<R>,
        rate: Option<Vector<R>>,
        field: Option<Vector<R>>,
        step: R,
    ) -> Option<Part<R>> {
        if self.now.count == R::default() && self.filled == 0 {
            self.about = force;
        }
        let force = sub(force, self.about);
        let mut sample = Part {
            time_s: step,
            count: R::from_f64(1.0),
            force,
            force_square: dot(force, force),
            anchor: match &self.anchor {
                Some(anchor) => sub(anchor.force, self.about),
                None => [R::default(); 3],
            },
            ..Part::default()
        };
        if let Some(field) = field {
            sample.fields = sample.count;
            sample.field = field;
        }
        if let Some(rate) = rate {
            sample.rates = sample.count;
            sample.rate = rate;
            sample.rate_square = dot(rate, rate);
        }
        self.now = self.now.plus(&sample);
        // A part of a step more: at no usual rate it depends on how times are rounded.
        let lasted = self.now.time_s + step * R::from_f64(0.3);
        let full = lasted >= R::from_f64(PART_S) && self.now.count >= R::from_f64(PART_SAMPLES);
        if !full {
            return None;
        }
        let mut part = core::mem::take(&mut self.now);
        part.within = part.force_square - dot(part.force, part.force) / part.count;
        self.parts.rotate_left(1);
        if let Some(last) = self.parts.last_mut() {
            *last = part;
        }
        self.filled = (self.filled + 1).min(PARTS);
        self.shown()
    }
}

fn least<R: Real>(a: R, b: R) -> R {
    if a < b { a } else { b }
}

/// The most variance of a rest where that of the quietest is `level`.
fn most<R: Real>(level: R) -> R {
    let floor = R::from_f64(FLOOR_MPS2 * FLOOR_MPS2);
    let level = if level > floor { level } else { floor };
    least(
        level * R::from_f64(REST_RATIO),
        R::from_f64(REST_MPS2 * REST_MPS2),
    )
}

impl<R: Real> Quiet<R> {
    /// A rest that was found: what it shows is the anchor from now on.
    fn hold(&mut self, all: &Part<R>, level: R, rated: bool) {
        let mut anchor = Anchor::new(all, self.about, level, rated);
        if let Some(before) = &self.anchor {
            anchor.follow(before);
        }
        let shown = sub(anchor.force, self.about);
        for part in self.parts.iter_mut() {
            part.anchor = scale(shown, part.count);
        }
        self.anchor = Some(anchor);
    }

    /// A rest that goes on: its oldest part is learnt.
    fn go_on(&mut self, level: R, rated: bool) {
        let (Some(anchor), Some(oldest)) = (&mut self.anchor, self.parts.first()) else {
            return;
        };
        let change = anchor.learn(oldest, level, rated);
        for part in &mut self.parts {
            part.anchor = add(part.anchor, scale(change, part.count));
        }
    }

    /// Whether the means of the parts scatter as their samples do.
    fn is_even(&self, all: &Part<R>, level: R) -> bool {
        let mean = all.apart();
        let mut sum = R::default();
        for part in &self.parts {
            let apart = sub(part.apart(), mean);
            sum += dot(apart, apart) * part.count;
        }
        let free = R::from_f64(3.0 * (PARTS - 1) as f64);
        let count = all.count / R::from_f64(PARTS as f64);
        let slack = R::from_f64(BETWEEN_MPS2 * BETWEEN_MPS2) * count;
        sum < free * R::from_f64(BETWEEN) * (level + slack)
    }
}

impl<R: Real> UnitFilter<R> {
    pub(super) fn judge(
        &mut self,
        force: Vector<R>,
        rate: Option<Vector<R>>,
        field: Option<Vector<R>>,
        step: R,
    ) {
        let gravity = R::from_f64(self.config.gravity_mps2);
        let (bias, known) = (self.part(OMEGA), self.gyroscope.on);
        let [x, y, z] = self.cov.variance(OMEGA);
        let third = R::from_f64(1.0 / 3.0);
        let rate_variance = if known {
            (x + y + z) * third
        } else {
            R::default()
        };
        let was = self.quiet.rest;
        let quiet = &mut self.quiet;
        if !was && !self.valid {
            quiet.forget();
        }
        let Some(all) = quiet.gather(force, rate, field, step) else {
            return;
        };
        let one = R::from_f64(1.0);
        let mean = add(quiet.about, scale(all.force, one / all.count));
        let spread = all.spread();
        let rated = all.rates > R::default();
        quiet.still = rated.then(|| scale(all.rate, one / all.rates));
        let turning = quiet.still.is_some_and(|rate| {
            let rate = sub(rate, bias);
            let limit = if known { STILL_RAD_S } else { OFFSET_RAD_S };
            dot(rate, rate) > R::from_f64(limit * limit)
        });
        let degrees = R::from_f64(3.0) * (all.count - R::from_f64(PARTS as f64));
        let within = all.within / degrees;
        let level = quiet.level.map_or(within, |level| least(level, within));
        let near = (norm(mean) - gravity).abs() < R::from_f64(NEAR_MPS2);
        let noise = if level > within { level } else { within };
        let still = near && !turning && spread < most(level) && quiet.is_even(&all, noise);
        let either = quiet.either.take();
        quiet.rest = still;
        quiet.pushing = false;
        if let (true, Some(anchor)) = (still, &mut quiet.anchor) {
            let disturbance = super::model::disturbance(anchor.since_s());
            match anchor.judge(&all, noise, rate_variance, gravity, disturbance) {
                Verdict::Rest(unseen) => quiet.unseen = unseen,
                Verdict::Pushed => {
                    quiet.rest = false;
                    quiet.pushing = true;
                    quiet.pushed = quiet.pushed.saturating_add(1);
                }
                Verdict::Either(push) => {
                    quiet.rest = false;
                    let part = all.time_s * R::from_f64(1.0 / PARTS as f64);
                    let lasted = either.map_or(all.time_s, |(_, lasted)| lasted + part);
                    quiet.either = Some((push, lasted));
                }
            }
        }
        if quiet.rest {
            let more = quiet.parts.last().filter(|_| was);
            quiet.lasted_s = more.map_or(all.time_s, |part| quiet.lasted_s + part.time_s);
            if was && quiet.anchor.is_some() {
                quiet.go_on(noise, rated && known);
            } else {
                quiet.hold(&all, noise, rated && known);
            }
            quiet.level = Some(quiet.level.map_or(spread, |before| least(before, spread)));
            if rated {
                let square = variance(all.rate, all.rate_square, all.rates);
                let walk = square * all.time_s / all.count;
                quiet.walk = Some(quiet.walk.map_or(walk, |before| least(before, walk)));
            }
        } else if was {
            self.regain();
        }
    }
}
