//! What looks like a rest.

use super::UnitFilter;
use crate::Real;
use crate::vector::{Vector, add, dot, norm, scale, sub};

/// A rest shows less than this, m/s² rms, ...
const REST_MPS2: f64 = 0.12;
/// ... less than so many times the variance of the quietest time so far, ...
const REST_RATIO: f64 = 4.0;
/// ... where that is more than a sensor shows whose steps are coarse, m/s² rms, ...
const FLOOR_MPS2: f64 = 0.03;
/// ... a force this near to gravity, m/s², and an angular rate below this, rad/s, ...
const NEAR_MPS2: f64 = 0.3;
const STILL_RAD_S: f64 = 0.1;
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
        self.parts.rotate_left(1);
        if let Some(last) = self.parts.last_mut() {
            *last = core::mem::take(&mut self.now);
        }
        self.filled = (self.filled + 1).min(PARTS);
        let all = |sum: Part<R>, part: &Part<R>| sum.plus(part);
        (self.filled == PARTS).then(|| self.parts.iter().fold(Part::default(), all))
    }
}

fn least<R: Real>(a: R, b: R) -> R {
    if a < b { a } else { b }
}

impl<R: Real> UnitFilter<R> {
    pub(super) fn judge(&mut self, force: Vector<R>, rate: Option<Vector<R>>, step: R) {
        let gravity = R::from_f64(self.config.gravity_mps2);
        let bias = self.part(super::OMEGA);
        let quiet = &mut self.quiet;
        let Some(all) = quiet.gather(force, rate, step) else {
            return;
        };
        let one = R::from_f64(1.0);
        let mean = add(quiet.about, scale(all.force, one / all.count));
        let spread = variance(all.force, all.force_square, all.count);
        let rated = all.rates > R::default();
        let turning = rated && {
            let rate = sub(scale(all.rate, one / all.rates), bias);
            dot(rate, rate) > R::from_f64(STILL_RAD_S * STILL_RAD_S)
        };
        let most = match quiet.level {
            Some(level) => {
                let floor = R::from_f64(FLOOR_MPS2 * FLOOR_MPS2);
                let level = if level > floor { level } else { floor };
                least(
                    level * R::from_f64(REST_RATIO),
                    R::from_f64(REST_MPS2 * REST_MPS2),
                )
            }
            None => R::from_f64(REST_MPS2 * REST_MPS2),
        };
        let near = (norm(mean) - gravity).abs() < R::from_f64(NEAR_MPS2);
        quiet.rest = near && !turning && spread < most;
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
