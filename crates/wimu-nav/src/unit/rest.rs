//! What looks like a rest.

use super::UnitFilter;
use crate::Real;
use crate::vector::{Vector, dot, norm, scale, sub};

/// A rest shows less than this, m/s² rms, ...
const REST_MPS2: f64 = 0.12;
/// ... less than so many times the variance of the quietest time so far, ...
const REST_RATIO: f64 = 4.0;
/// ... where that is more than a sensor shows whose steps are coarse, m/s² rms, ...
const FLOOR_MPS2: f64 = 0.03;
/// ... a force this near to gravity, m/s², and an angular rate below this, rad/s, ...
const NEAR_MPS2: f64 = 0.3;
const STILL_RAD_S: f64 = 0.1;
/// ... for this long, s.
const REST_S: f64 = 0.5;
/// Mean and variance are over so long, s, and so many samples.
const QUIET_S: f64 = 0.2;
const QUIET_SAMPLES: f64 = 20.0;

/// Slow mean and variance of the force.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Quiet<R> {
    mean: Vector<R>,
    variance: R,
    rate: Vector<R>,
    rate_variance: R,
    /// The least variance of a second and more, of the force and of the angular rate times the step.
    level: Option<R>,
    walk: Option<R>,
    time_s: R,
    started: bool,
    age_s: R,
}

impl<R: Real> Quiet<R> {
    pub fn is_rest(&self) -> bool {
        self.time_s >= R::from_f64(REST_S)
    }

    /// What was taken for a rest is none.
    pub fn end(&mut self) {
        self.time_s = R::default();
    }

    /// Variance of a sample's force at the quietest rest, (m/s²)².
    pub fn force_variance(&self) -> Option<R> {
        self.level
    }

    /// Random walk of the angle at the quietest rest, squared, rad²/s.
    pub fn angle_walk2(&self) -> Option<R> {
        self.walk
    }
}

fn least<R: Real>(a: R, b: R) -> R {
    if a < b { a } else { b }
}

impl<R: Real> UnitFilter<R> {
    pub(super) fn judge(&mut self, force: Vector<R>, rate: Option<Vector<R>>, step: R) {
        let gravity = R::from_f64(self.config.gravity_mps2);
        let turning = rate.is_some_and(|rate| {
            let rate = sub(rate, self.part(super::OMEGA));
            dot(rate, rate) > R::from_f64(STILL_RAD_S * STILL_RAD_S)
        });
        let quiet = &mut self.quiet;
        if !quiet.started {
            quiet.mean = force;
            quiet.rate = rate.unwrap_or_default();
            quiet.started = true;
        }
        let share = least(
            step * R::from_f64(1.0 / QUIET_S),
            R::from_f64(1.0 / QUIET_SAMPLES),
        );
        let away = sub(force, quiet.mean);
        quiet.mean = crate::vector::add(quiet.mean, scale(away, share));
        quiet.variance += (dot(away, away) * R::from_f64(1.0 / 3.0) - quiet.variance) * share;
        if let Some(rate) = rate {
            let away = sub(rate, quiet.rate);
            quiet.rate = crate::vector::add(quiet.rate, scale(away, share));
            let square = dot(away, away) * R::from_f64(1.0 / 3.0);
            quiet.rate_variance += (square - quiet.rate_variance) * share;
        }
        quiet.age_s += step;
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
        let near = (norm(quiet.mean) - gravity).abs() < R::from_f64(NEAR_MPS2);
        if near && !turning && quiet.variance < most {
            quiet.time_s += step;
        } else {
            quiet.time_s = R::default();
        }
        if quiet.is_rest() && quiet.age_s > R::from_f64(1.0) {
            quiet.level = Some(match quiet.level {
                Some(level) => least(level, quiet.variance),
                None => quiet.variance,
            });
            if rate.is_some() {
                let walk = quiet.rate_variance * step;
                quiet.walk = Some(quiet.walk.map_or(walk, |before| least(before, walk)));
            }
        }
    }
}
