//! Errors that last: of places, sensitivities, times and of the attitude; equations (104) and (105).

use super::super::hypothesis::{Hypothesis, OMEGA, PHI, TURN_BIAS, VELOCITY, Z_BIAS, dot, part, r};
use super::{ArrayFilter, EXCESS_SAMPLES};
use crate::Real;

/// Back by this share of the way, the force is on another one.
const TURNS_BACK: f64 = 0.3;
/// Centripetal acceleration of so many deviations of the biases shows a turn.
const SHOWS_SD: f64 = 3.0;

/// How the force on the sensors becomes another: where it comes from, the farthest from there and the square of
/// how far, (m/s²)².
#[derive(Clone, Copy, Debug)]
pub(super) struct Swing<R> {
    from: [R; 3],
    farthest: [R; 3],
    square: f64,
}

impl<R: Real> Swing<R> {
    pub(super) fn at(force: [R; 3]) -> Self {
        Self {
            from: force,
            farthest: force,
            square: 0.0,
        }
    }
}

/// What has gathered since the last rest: the turn, rad, the square of its farthest, and speed by the square of the
/// attitude's error, m/s.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Strayed {
    turned: [f64; 3],
    farthest: f64,
    speed: [f64; 3],
}

impl<R: Real, const M: usize> ArrayFilter<R, M> {
    /// Variance of an axis that errors of places, sensitivities and times bring while it moves, (m/s²)²: equation
    /// (104).
    pub(super) fn declared(&mut self, step: f64, output: &[R; M]) -> f64 {
        let config = &self.config;
        let variance = self.array.solver().variance_mps2().to_f64();
        if let Some(last) = self.last.filter(|_| step > 0.0) {
            let (mut squares, mut count) = (0.0, 0.0);
            for (now, before) in output.iter().zip(&last) {
                let change = (*now - *before).to_f64();
                if change.abs() < config.range_mps2 {
                    squares += change * change;
                    count += 1.0;
                }
            }
            let own = (squares / f64::max(count, 1.0) - 2.0 * variance).max(0.0) / (step * step);
            self.jerk += (own - self.jerk) / EXCESS_SAMPLES;
        }
        self.last = Some(*output);
        let rate = self.hypotheses[0].map_or(0.0, |best| {
            let rate = part(&best.mean, OMEGA);
            dot(&rate, &rate).to_f64()
        });
        config.place_sd_m * config.place_sd_m * (rate * rate / 1.5 + 2.0 * self.activity)
            + config.scale * config.scale * dot(&self.away, &self.away).to_f64()
            + config.delay_sd_s * config.delay_sd_s * self.jerk
    }

    /// By how much the square of the force's swing grows, with which the variance of the biases does, (m/s²)²: equation
    /// (104).
    pub(super) fn swung(&mut self, force: [R; 3]) -> f64 {
        let away = |from: &[R; 3]| -> f64 {
            let d: [R; 3] = core::array::from_fn(|i| force[i] - from[i]);
            dot(&d, &d).to_f64()
        };
        let swing = &mut self.swing;
        let from = away(&swing.from);
        let mut more = (from - swing.square).max(0.0);
        if more > 0.0 {
            (swing.farthest, swing.square) = (force, from);
        } else if away(&swing.farthest) > TURNS_BACK * TURNS_BACK * swing.square {
            // On its way back: from the farthest on it is another one.
            swing.from = swing.farthest;
            more = away(&swing.from);
            (swing.farthest, swing.square) = (force, more);
        }
        let g = self.config.gravity_mps2;
        if swing.square > g * g {
            *swing = Swing::at(force);
        }
        more
    }

    /// Square of the relative error of a rate that errors of places bring.
    pub(super) fn size_variance(&self) -> f64 {
        let solver = self.array.solver();
        let covariance = solver.covariance();
        let arms = (0..3).map(|i| covariance[i][i]).sum::<f64>() / 3.0;
        let place = self.config.place_sd_m;
        2.0 * place * place * arms / solver.variance_mps2().to_f64()
    }

    /// From 1, where biases may make all of the centripetal acceleration of ω, to 0: equation (105).
    pub(super) fn may_be_none(&self, all: &Hypothesis<R>) -> f64 {
        let solver = self.array.solver();
        let rank = solver.rank().min(6);
        let biases = (0..rank).map(|k| all.cov[Z_BIAS + k][Z_BIAS + k].to_f64().abs());
        let square = biases.sum::<f64>() / rank.max(1) as f64 * solver.variance_mps2().to_f64();
        let rate = part(&all.mean, OMEGA);
        let shows = dot(&rate, &rate).to_f64() * solver.arm_m();
        let ratio = shows * shows / (SHOWS_SD * SHOWS_SD * square).max(1e-12);
        1.0 / (1.0 + ratio * ratio)
    }

    /// The same of the variance that it gives ω: as far as the biases of ω̇ add up to it since the last rest.
    pub(super) fn none_variance(&self, all: &Hypothesis<R>) -> f64 {
        let biases = (0..3).map(|i| all.cov[TURN_BIAS + i][TURN_BIAS + i].to_f64().abs());
        let added = biases.sum::<f64>() * self.since_rest_s * self.since_rest_s;
        let rate = part(&all.mean, OMEGA);
        let square = dot(&rate, &rate).to_f64().max(1e-12);
        self.may_be_none(all) * (added / square).min(1.0)
    }

    /// What is the same from sample to sample and so does not average out: attitude by the error of places, velocity by
    /// the square of the attitude's: equation (105).
    pub(super) fn stray(&mut self, step: f64) {
        let Some(best) = &self.hypotheses[0] else {
            return;
        };
        let rate = part(&best.mean, OMEGA);
        let variance = |i: usize| best.cov[PHI + i][PHI + i].to_f64().clamp(0.0, 4.0);
        let tilt = 0.5 * (variance(0) + variance(1));
        let g = self.config.gravity_mps2;
        let fall = [
            0.5 * g * libm::sqrt(tilt * variance(2)),
            0.5 * g * libm::sqrt(tilt * variance(2)),
            g * tilt,
        ];
        let size = self.size_variance();
        let strayed = &mut self.strayed;
        for (turned, rate) in strayed.turned.iter_mut().zip(rate) {
            *turned += rate.to_f64() * step;
        }
        let angle = strayed.turned.iter().map(|t| t * t).sum::<f64>();
        let turned = size * (angle - strayed.farthest).max(0.0);
        strayed.farthest = strayed.farthest.max(angle);
        let mut faster = [0.0; 3];
        for ((faster, speed), fall) in faster.iter_mut().zip(&mut strayed.speed).zip(fall) {
            let before = *speed;
            *speed += fall * step;
            *faster = *speed * *speed - before * before;
        }
        for hypothesis in self.hypotheses.iter_mut().flatten() {
            for (i, faster) in faster.iter().enumerate() {
                hypothesis.cov[PHI + i][PHI + i] += r(turned);
                hypothesis.cov[VELOCITY + i][VELOCITY + i] += r(*faster);
            }
        }
    }
}
