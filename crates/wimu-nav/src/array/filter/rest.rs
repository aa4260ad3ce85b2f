//! Rests of an array: the first attitude, and what a rest says.

use super::super::hypothesis::{
    FORCE_BIAS, Hypothesis, OMEGA, PHI, POSITION, STATES, TURN, VELOCITY, block, dot, part, r,
};
use super::super::matrix::{cross_matrix, times};
use super::super::solver::Linear;
use super::errors::Swing;
use super::{ArrayFilter, MOST};
use crate::Real;

/// The first attitude is from so much, s.
const ALIGN_S: f64 = 0.5;
/// A rest shows less than this, m/s² in each direction, for this long, s; |s| is near gravity then.
const REST_MPS2: f64 = 0.15;
/// A rest shows ω̇ and centripetal acceleration below so many variances.
const REST_SIGMA2: f64 = 20.0;
/// What it shows is the mean of so much, s.
const MEAN_S: f64 = 0.2;
const REST_NEAR_GRAVITY_MPS2: f64 = 0.3;
const REST_S: f64 = 0.5;
/// Speed, angular rate and acceleration, and departure from gravity that a rest may have over 0.5 s.
const REST_SPEED_MPS: f64 = 0.005;
const REST_RATE_RAD_S: f64 = 0.02;
const REST_TURN_RAD_S2: f64 = 0.1;
const REST_FORCE_MPS2: f64 = 0.02;

/// A mean of a rest stays where it was, by so many of its deviations, of which it has these besides noise, m/s².
const SETTLED: f64 = 4.6;
const SETTLED_MPS2: f64 = 0.005;
/// A push that would not show lasts so long, s.
const PUSH_S: f64 = 2.0;
/// A rate is seen beyond so many of its variances.
const SHOWS: f64 = 9.0;

/// Without a rest at the start: standard deviations of velocity, m/s, and tilt, rad.
const START_SPEED_MPS: f64 = 10.0;
const START_TILT_RAD: f64 = 1.0;

/// A speed beyond so many variances at the beginning of a rest may be an even motion's.
const DOUBTFUL: f64 = 9.0;

/// A rest's departure beyond so many variances shows that the covariance is wrong.
const ASTRAY: f64 = 50.0;

impl<R: Real, const M: usize> ArrayFilter<R, M> {
    pub(super) fn resting(&self) -> bool {
        self.quiet_s >= REST_S
    }

    pub(super) fn judge_rest(&mut self, step: f64, force: [R; 3], linear: &Linear<R>) {
        let follow = |mean: &mut [R; 3], share: f64| -> [R; 3] {
            let away: [R; 3] = core::array::from_fn(|i| force[i] - mean[i]);
            for (mean, away) in mean.iter_mut().zip(away) {
                *mean += away * r(share);
            }
            away
        };
        let begins = if self.slow_force == [R::default(); 3] {
            1.0
        } else {
            0.0
        };
        self.away = follow(&mut self.slow_force, (step / MEAN_S).clamp(begins, 1.0));
        // The mean since it is quiet: what went before does not count.
        self.mean_s += step;
        let away = follow(
            &mut self.quiet_mean,
            (step / self.mean_s.min(MEAN_S)).min(1.0),
        );
        let size = dot(&self.quiet_mean, &self.quiet_mean).sqrt().to_f64();
        // What it was as it became quiet: a slow push or turn is none.
        if self.quiet_s < MEAN_S {
            self.settled = self.quiet_mean;
        }
        let moved: [R; 3] = core::array::from_fn(|i| self.quiet_mean[i] - self.settled[i]);
        let slow = SETTLED * self.settled_sd();
        let steady = dot(&moved, &moved).to_f64() < slow * slow;
        let near = (size - self.config.gravity_mps2).abs() < REST_NEAR_GRAVITY_MPS2;
        let calm = dot(&away, &away).to_f64() < 3.0 * REST_MPS2 * REST_MPS2;
        // Neither ω̇ nor centripetal acceleration beyond noise and biases.
        let solver = self.array.solver();
        let variance = self.config.bias_mps2 * self.config.bias_mps2
            / solver.variance_mps2().to_f64()
            + self.excess.max(1.0);
        let within = |value: R, one: f64| {
            let value = value.to_f64();
            value * value < REST_SIGMA2 * variance * one
        };
        let covariance = solver.covariance();
        let turns = (0..3).any(|i| !within(linear.theta[i], covariance[i][i]))
            || linear.z.iter().any(|z| !within(*z, 1.0));
        if near && calm && steady && !turns {
            self.quiet_s += step;
        } else {
            self.quiet_s = 0.0;
        }
        if !calm {
            (self.quiet_mean, self.mean_s) = (force, 0.0);
        }
    }

    /// How well the mean force over 0.2 s is known beside its bias, m/s² an axis.
    fn settled_sd(&self) -> f64 {
        let samples = (MEAN_S / self.step_s.max(1e-4)).max(1.0);
        let variance = self.array.solver().covariance()[3][3] * self.excess.max(1.0) / samples;
        libm::sqrt(variance + SETTLED_MPS2 * SETTLED_MPS2)
    }

    /// Static alignment, equation (81) without a magnetometer. Where it does not rest, velocity is not known,
    /// and the attitude not well.
    pub(super) fn align_with(&mut self, step: f64, force: [R; 3]) {
        let (sum, square, count, time) = &mut self.align;
        for (sum, force) in sum.iter_mut().zip(force) {
            *sum += force;
        }
        *square += dot(&force, &force).to_f64();
        *count += 1.0;
        *time += step;
        if *time < ALIGN_S || *count < 2.0 {
            return;
        }
        let rests = self.quiet_s > 0.999 * *time;
        let mean = sum.map(|v| v.to_f64() / *count);
        let norm = libm::sqrt(mean.iter().map(|v| v * v).sum());
        let spread = (*square / *count - norm * norm).max(0.0);
        self.align = ([R::default(); 3], 0.0, 0.0, 0.0);
        if !(norm > 1.0 && norm.is_finite()) {
            return;
        }
        let g = self.config.gravity_mps2;
        let moved = spread + (norm - g) * (norm - g);
        let solver = self.array.solver();
        let mut hypothesis = Hypothesis {
            weight: 0.0,
            attitude: level(mean),
            acceleration: [R::default(); 3],
            mean: [R::default(); STATES],
            cov: [[R::default(); STATES]; STATES],
        };
        let bias = self.force_bias();
        let (strayed, speed) = if rests {
            (0.0, 1e-3)
        } else {
            (START_TILT_RAD, START_SPEED_MPS)
        };
        let tilt = strayed * strayed + moved * 0.25 / (g * g) + bias / (g * g) + 1e-6;
        for i in 0..3 {
            let mut set = |at: usize, variance: f64| hypothesis.cov[at + i][at + i] = r(variance);
            set(PHI, if i == 2 { 1e-8 } else { tilt });
            set(VELOCITY, speed * speed);
            set(OMEGA, 100.0);
            set(TURN, 1e4);
        }
        hypothesis.begin_biases(solver, &self.config, true);
        self.swing = Swing::at(mean.map(r));
        self.hypotheses = [None; MOST];
        self.hypotheses[0] = Some(hypothesis);
        if rests {
            self.since_rest_s = 0.0;
        }
        self.moving_start = !rests;
        self.still_start = rests;
        self.valid = rests;
    }

    /// The first rest after a start in motion: attitude is known from it, velocity is zero, and the position
    /// begins here.
    pub(super) fn begin_at_rest(&mut self) {
        let g = self.config.gravity_mps2;
        let tilt = self.force_bias() / (g * g) + 1e-6;
        let attitude = level(self.quiet_mean.map(|v| v.to_f64()));
        for hypothesis in self.hypotheses.iter_mut().flatten() {
            hypothesis.attitude = attitude;
            hypothesis.acceleration = [R::default(); 3];
            for at in 0..OMEGA {
                hypothesis.mean[at] = R::default();
                for k in 0..STATES {
                    hypothesis.cov[at][k] = R::default();
                    hypothesis.cov[k][at] = R::default();
                }
            }
            for i in 0..3 {
                hypothesis.cov[PHI + i][PHI + i] = r(if i == 2 { 1e-8 } else { tilt });
                hypothesis.cov[VELOCITY + i][VELOCITY + i] = r(1e-6);
            }
        }
        self.since_rest_s = 0.0;
        self.moving_start = false;
        self.valid = true;
    }

    pub(super) fn forget_biases(&mut self) {
        for hypothesis in self.hypotheses.iter_mut().flatten() {
            hypothesis.begin_biases(self.array.solver(), &self.config, true);
        }
    }

    /// Variance of the bias of s on an axis before anything is known of it, (m/s²)².
    fn force_bias(&self) -> f64 {
        let solver = self.array.solver();
        let (own, common) = (self.config.bias_mps2, self.config.common_bias_mps2);
        own * own / solver.variance_mps2().to_f64() * solver.covariance()[3][3] + common * common
    }

    /// Even motion shows as a rest does. Where the speed was not likely to be zero, the position is as
    /// uncertain as if it went on; what it may have been in any case is kept.
    pub(super) fn doubt_rest(&mut self, step: f64) {
        if self.rested_s == 0.0
            && self.valid
            && self.since_rest_s > REST_S
            && let Some(best) = &self.hypotheses[0]
        {
            let variance =
                |at: usize| -> [R; 3] { core::array::from_fn(|i| best.cov[at + i][at + i]) };
            self.taken_off = (part(&best.mean, VELOCITY), [R::default(); 3]);
            self.unseen
                .add_velocity(part(&best.mean, VELOCITY), variance(VELOCITY));
            let up = best.attitude[2];
            let rate = dot(&up, &part(&best.mean, OMEGA)).to_f64();
            let spread = dot(&up, &times(&block(&best.cov, OMEGA, OMEGA), &up)).to_f64();
            self.hidden_turn.rate2 += rate * rate + spread.max(0.0);
            let (mut squares, mut most) = (0.0, 0.0_f64);
            for i in VELOCITY..VELOCITY + 3 {
                let (speed, variance) = (best.mean[i].to_f64(), best.cov[i][i].to_f64().abs());
                if speed * speed > DOUBTFUL * variance {
                    squares += speed * speed;
                }
                most = most.max(variance);
            }
            self.unseen_mps = self.unseen_mps.max(libm::sqrt(DOUBTFUL * most));
            self.doubt_mps2 = squares / 3.0;
            if squares > REST_SPEED_MPS * REST_SPEED_MPS * DOUBTFUL {
                self.doubtful = self.doubtful.saturating_add(1);
            }
        }
        let slow = PUSH_S * self.settled_sd();
        self.unseen.at_least(r(slow));
        let before = self.rested_s;
        self.rested_s += step;
        let more = self.doubt_mps2 * (self.rested_s * self.rested_s - before * before);
        for hypothesis in self.hypotheses.iter_mut().flatten() {
            for i in POSITION..POSITION + 3 {
                hypothesis.cov[i][i] += r(more);
            }
        }
    }

    /// What even motion and an even turn that no rest has shown do in a step: equation (103), and of a turn the same about
    /// the vertical. A rate that shows is none that is hidden.
    pub(super) fn hide(&mut self, step: f64) {
        self.unseen = self.unseen.after(r(step));
        let Some(best) = &self.hypotheses[0] else {
            return;
        };
        let resting = self.quiet_s >= REST_S;
        if !self.config.zupt.is_on() {
            if self.still_start {
                return;
            }
            let rate = part(&best.mean, OMEGA);
            let square = dot(&rate, &rate).to_f64() * self.may_be_none(best);
            let to = &mut self.wandered;
            to.way = (to.way + to.speed * step).min(1e6);
            to.speed = (to.speed + self.config.gravity_mps2 * to.angle.min(1.0) * step).min(1e6);
            to.angle = (to.angle + libm::sqrt(square) * step).min(4.0);
            return;
        }
        let turn = &mut self.hidden_turn;
        let rate = part(&best.mean, OMEGA);
        let spread = (0..3)
            .map(|i| best.cov[OMEGA + i][OMEGA + i])
            .fold(R::default(), |a, b| a + b);
        if !resting && dot(&rate, &rate).to_f64() > SHOWS * spread.to_f64() {
            (turn.rate2, turn.both) = (0.0, 0.0);
        }
        let [east, north, _] = part(&best.mean, VELOCITY).map(|v| v.to_f64());
        let mut more = [0.0; 3];
        for ((more, way), speed) in more.iter_mut().zip(&mut turn.way).zip([-north, east, 0.0]) {
            let go = speed * step;
            *more = 2.0 * *way * go + turn.angle2 * go * go;
            *way += turn.angle2 * go;
        }
        self.unseen.add_position(more.map(r));
        turn.angle2 += step * (2.0 * turn.both + step * turn.rate2);
        turn.both += step * turn.rate2;
    }

    /// Velocity and angular rate are zero, gravity is vertical.
    pub(super) fn rest(&mut self, step: f64) {
        let place =
            |this: &Self| this.hypotheses[0].map_or([R::default(); 3], |h| part(&h.mean, POSITION));
        let before = place(self);
        self.measure_rest(step, true);
        self.since_rest_s = 0.0;
        self.valid = self.hypotheses[0].is_some();
        // Part of the way was taken off with the velocity: if it did not rest, it is missing.
        let after = place(self);
        let by: [R; 3] = core::array::from_fn(|i| before[i] - after[i]);
        let (velocity, sum) = &mut self.taken_off;
        self.unseen.add_correction(*velocity, *sum, by);
        for (sum, by) in sum.iter_mut().zip(by) {
            *sum += by;
        }
    }

    /// What a stillness says: no angular rate, gravity is vertical, and at a rest no velocity.
    pub(super) fn measure_rest(&mut self, step: f64, at_rest: bool) {
        // A rest's departures last as long as it was looked at.
        let slower = (REST_S / step.max(1e-3)).max(1.0);
        let variance = |sd: f64| r::<R>(sd * sd * slower);
        let g = self.config.gravity_mps2;
        let of_force = variance(REST_FORCE_MPS2) + r::<R>(self.array.solver().covariance()[3][3]);
        let mut went_astray = false;
        for hypothesis in self.hypotheses.iter_mut().flatten() {
            let lever = cross_matrix([R::default(), R::default(), r(g)]);
            let gravity = |attitude: &[[R; 3]; 3], i: usize| {
                let mut row = [R::default(); STATES];
                row[PHI..PHI + 3].copy_from_slice(&lever[i]);
                row[FORCE_BIAS..FORCE_BIAS + 3].copy_from_slice(&attitude[i]);
                row
            };
            let unit = |at: usize| {
                let mut row = [R::default(); STATES];
                row[at] = r(1.0);
                row
            };
            // A departure that the covariance cannot explain is no measurement of anything else:
            // velocity and attitude begin anew.
            let astray = (0..3).any(|i| {
                let v = hypothesis.mean[VELOCITY + i];
                let a = hypothesis.acceleration[i];
                let moves = hypothesis.departs(&unit(VELOCITY + i), v, variance(REST_SPEED_MPS));
                (at_rest && moves > ASTRAY)
                    || hypothesis.departs(&gravity(&hypothesis.attitude, i), a, of_force) > ASTRAY
            });
            if astray {
                went_astray = true;
                hypothesis.begin_again(g, self.since_rest_s);
            }
            let before = hypothesis.mean;
            let mut fit = 0.0;
            for i in 0..3 {
                let zeros = [
                    (TURN + i, REST_TURN_RAD_S2),
                    (OMEGA + i, REST_RATE_RAD_S),
                    (VELOCITY + i, REST_SPEED_MPS),
                ];
                for (at, sd) in zeros.into_iter().take(if at_rest { 3 } else { 2 }) {
                    fit += hypothesis.absorb(&unit(at), -hypothesis.mean[at], variance(sd));
                }
            }
            for i in 0..3 {
                let row = gravity(&hypothesis.attitude, i);
                // Less what the components before this one have explained.
                let learnt: [R; STATES] = core::array::from_fn(|k| hypothesis.mean[k] - before[k]);
                let rest = hypothesis.acceleration[i] - dot(&row, &learnt);
                fit += hypothesis.absorb(&row, rest, of_force);
            }
            hypothesis.weight -= 0.5 * fit;
            hypothesis.fold();
        }
        if went_astray {
            self.astray = self.astray.saturating_add(1);
        }
    }
}

/// Body to navigation axes of a body whose mean output is `mean`: up along it, east near body x (or y).
fn level<R: Real>(mean: [f64; 3]) -> [[R; 3]; 3] {
    let size = |v: &[f64; 3]| libm::sqrt(v.iter().map(|c| c * c).sum()).max(1e-9);
    let up = mean.map(|v| v / size(&mean));
    let first = if up[0].abs() < 0.9 { 0 } else { 1 };
    let mut east: [f64; 3] =
        core::array::from_fn(|i| if i == first { 1.0 } else { 0.0 } - up[first] * up[i]);
    let length = size(&east);
    east = east.map(|v| v / length);
    let north = [
        up[1] * east[2] - up[2] * east[1],
        up[2] * east[0] - up[0] * east[2],
        up[0] * east[1] - up[1] * east[0],
    ];
    [east, north, up].map(|row| row.map(r))
}
