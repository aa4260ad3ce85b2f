//! What looks like a rest.

use super::UnitFilter;
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
const PARTS: usize = 5;
const PART_S: f64 = 0.1;
const PART_SAMPLES: f64 = 4.0;

/// Sums of force and angular rate over a part.
#[derive(Clone, Copy, Debug, Default)]
struct Part<R> {
    time_s: R,
    count: R,
    force: Vector<R>,
    force_square: R,
    rates: R,
    rate: Vector<R>,
    rate_square: R,
    /// Of the force, about each part's own mean.
    within: R,
}

impl<R: Real> Part<R> {
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
    /// The least variance so far, of the force and of the angular rate times the step.
    level: Option<R>,
    walk: Option<R>,
    /// Mean angular rate at the rest that it is at, rad/s.
    still: Option<Vector<R>>,
}

impl<R: Real> Quiet<R> {
    pub fn is_rest(&self) -> bool {
        self.rest
    }

    /// What was taken for a rest is none.
    pub fn end(&mut self) {
        self.rest = false;
        self.filled = 0;
        self.now = Part::default();
    }

    /// Mean angular rate at the rest that it is at, rad/s.
    pub fn still(&self) -> Option<Vector<R>> {
        self.still.filter(|_| self.rest)
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
    fn gather(&mut self, force: Vector<R>, rate: Option<Vector<R>>, step: R) -> Option<Part<R>> {
        if self.now.count == R::default() && self.filled == 0 {
            self.about = force;
        }
        let force = sub(force, self.about);
        let mut sample = Part {
            time_s: step,
            count: R::from_f64(1.0),
            force,
            force_square: dot(force, force),
            ..Part::default()
        };
        if let Some(rate) = rate {
            sample.rates = sample.count;
            sample.rate = rate;
            sample.rate_square = dot(rate, rate);
        }
        self.now = self.now.plus(&sample);
        let full =
            self.now.time_s >= R::from_f64(PART_S) && self.now.count >= R::from_f64(PART_SAMPLES);
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
        let all = |sum: Part<R>, part: &Part<R>| sum.plus(part);
        (self.filled == PARTS).then(|| self.parts.iter().fold(Part::default(), all))
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

impl<R: Real> UnitFilter<R> {
    pub(super) fn judge(&mut self, force: Vector<R>, rate: Option<Vector<R>>, step: R) {
        let gravity = R::from_f64(self.config.gravity_mps2);
        let (bias, known) = (self.part(super::OMEGA), self.gyroscope.on);
        let quiet = &mut self.quiet;
        let Some(all) = quiet.gather(force, rate, step) else {
            return;
        };
        let one = R::from_f64(1.0);
        let mean = add(quiet.about, scale(all.force, one / all.count));
        let spread = variance(all.force, all.force_square, all.count);
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
        quiet.rest = near && !turning && spread < most(level);
        if quiet.rest {
            quiet.level = Some(quiet.level.map_or(spread, |before| least(before, spread)));
            if rated {
                let square = variance(all.rate, all.rate_square, all.rates);
                let walk = square * all.time_s / all.count;
                quiet.walk = Some(quiet.walk.map_or(walk, |before| least(before, walk)));
            }
        }
    }
}
