//! A sample's noise, and what passes between two samples: equations (76) and (96).

use super::super::hypothesis::{
    FORCE_BIAS, Noise, OMEGA, PHI, POSITION, TURN, TURN_BIAS, VELOCITY, Z_BIAS, couple, part, r,
    scaled_identity,
};
use super::super::matrix::{product, rotation};
use super::super::solver::Linear;
use super::{ArrayFilter, EXCESS_SAMPLES};
use crate::Real;

/// Share of the sample's own excess in its noise, the rest is that of the samples before it.
const OWN_SHARE: f64 = 0.8;
/// An excess up to this is noise, more of it is vibration.
const EXCESS_OF_NOISE: f64 = 2.0;
/// How long the size of ω̇ is remembered, s.
const ACTIVITY_S: f64 = 0.25;
/// ω̇ changes by 4 times its size in √s: a motion is another one after 1/16 s.
const TURN_WALK: f64 = 4.0;
/// A body at rest may begin to turn, rad/s² per √s.
const TURN_WALK_AT_REST: f64 = 20.0;
/// Part of ω̇ that lasts for one sample only.
const TURN_FAST: f64 = 0.2;
/// ω̇ of a vibration, and how far ω strays with it in √s, in units of vibration / arm.
const VIBRATION_TURN: f64 = 1.5;
const VIBRATION_RATE: f64 = 0.2;
/// Noise of ω̇ that is always there, rad/s².
const TURN_NOISE: f64 = 1.0;

impl<R: Real, const M: usize> ArrayFilter<R, M> {
    /// The sample's noise from its excess, equation (76), and the size of ω̇.
    pub(super) fn weigh(&mut self, step: f64, output: &[R; M], linear: &Linear<R>) -> Noise<R> {
        let declared = self.declared(step, output);
        let solver = self.array.solver();
        // Where the sensors do not show their own excess, it is what was declared.
        let own = solver
            .excess(output, linear)
            .map_or_else(
                || 1.0 + declared / solver.variance_mps2().to_f64(),
                |e| e.to_f64(),
            )
            .min(1e9);
        let steadied = OWN_SHARE * own + (1.0 - OWN_SHARE) * self.excess;
        self.excess += (own - self.excess) / EXCESS_SAMPLES;
        let variance = solver.variance_mps2().to_f64();
        let factor = steadied.max(1.0);
        let vibration = variance * (steadied - EXCESS_OF_NOISE).max(0.0);
        let covariance = solver.covariance();
        let [x, y, z, ..] = linear.theta.map(|v| v.to_f64());
        let seen = (x * x + y * y + z * z) / 3.0;
        let noise = (0..3).map(|i| covariance[i][i]).sum::<f64>() / 3.0 * factor;
        let size = (seen - 2.0 * noise).max(0.0);
        self.activity += (size - self.activity) * (step / ACTIVITY_S).min(1.0);
        let arm = solver.arm_m();
        let fast = TURN_NOISE * TURN_NOISE
            + TURN_FAST * TURN_FAST * self.activity
            + VIBRATION_TURN * VIBRATION_TURN * vibration / (arm * arm);
        Noise {
            factor: r(factor),
            fast: r(fast),
            vibration: r(vibration),
        }
    }

    /// What a pause does to what is known.
    pub(super) fn pause(&mut self, step_s: f64) {
        self.valid = false;
        self.quiet_s = 0.0;
        let step = step_s.min(1e3);
        for hypothesis in self.hypotheses.iter_mut().flatten() {
            for i in 0..3 {
                let mut add = |at: usize, variance: f64| {
                    hypothesis.cov[at + i][at + i] += r(variance);
                };
                add(PHI, 0.25 * step.min(10.0));
                add(VELOCITY, 4.0 * step);
                add(POSITION, 4.0 * step);
                add(OMEGA, 100.0);
                add(TURN, 1e4);
            }
        }
    }

    /// A sample without a usable output: ω goes on as it was.
    pub(super) fn carry(&mut self, step: f64) {
        self.surprise = 1.0;
        let noise = Noise {
            factor: r(1.0),
            fast: r(1.0),
            vibration: r(self.array.solver().variance_mps2().to_f64() * self.excess),
        };
        self.predict(step, &noise, 0.0);
        for hypothesis in self.hypotheses.iter_mut().flatten() {
            // As little is known of the acceleration as a hand's motion has of it.
            for i in 0..3 {
                let (v, p) = (VELOCITY + i, POSITION + i);
                hypothesis.cov[v][v] += r(2500.0 * step * step);
                hypothesis.mean[p] += hypothesis.mean[v] * r(step);
            }
            couple(
                &mut hypothesis.cov,
                POSITION,
                VELOCITY,
                &scaled_identity(r(step)),
            );
        }
        self.merge();
    }

    /// ω and ω̇ one step ahead, and attitude with them: equation (96).
    pub(super) fn predict(&mut self, step: f64, noise: &Noise<R>, swung: f64) {
        let arm = self.array.solver().arm_m();
        let walk = TURN_WALK_AT_REST * TURN_WALK_AT_REST + TURN_WALK * TURN_WALK * self.activity;
        let stray = VIBRATION_RATE * VIBRATION_RATE * noise.vibration.to_f64() / (arm * arm);
        let config = &self.config;
        let scaled = config.scale * config.scale * swung;
        let bias = (config.bias_walk * config.bias_walk * step + scaled)
            / self.array.solver().variance_mps2().to_f64();
        let rank = self.array.solver().rank();
        let covariance = *self.array.solver().covariance();
        let common = r::<R>(config.common_scale * config.common_scale * swung);
        // The force changes by 2 g at most.
        let g = config.gravity_mps2;
        let kept = r::<R>(if config.scale > 0.0 {
            libm::sqrt((1.0 - swung / (4.0 * g * g)).max(0.0))
        } else {
            1.0
        });
        for hypothesis in self.hypotheses.iter_mut().flatten() {
            let dt = r::<R>(step);
            let half = r::<R>(0.5 * step);
            let turn = part(&hypothesis.mean, TURN);
            let rate = part(&hypothesis.mean, OMEGA);
            let by: [R; 3] = core::array::from_fn(|i| (rate[i] + turn[i] * half) * dt);
            let attitude = hypothesis.attitude;
            hypothesis.attitude = product(&attitude, &rotation(by));
            if kept < r(1.0) {
                hypothesis.forget_part(kept);
            }
            let cov = &mut hypothesis.cov;
            couple(cov, PHI, OMEGA, &attitude.map(|row| row.map(|v| v * dt)));
            couple(
                cov,
                PHI,
                TURN,
                &attitude.map(|row| row.map(|v| v * dt * half)),
            );
            couple(cov, OMEGA, TURN, &scaled_identity(dt));
            for i in 0..3 {
                hypothesis.mean[OMEGA + i] += turn[i] * dt;
                let (w, t) = (OMEGA + i, TURN + i);
                let cube = step * step * step;
                cov[PHI + i][PHI + i] += r(stray * cube / 3.0 + walk * cube * step * step / 20.0);
                cov[w][w] += r(walk * step * step * step / 3.0 + stray * step);
                cov[w][t] += r(walk * step * step / 2.0);
                cov[t][w] += r(walk * step * step / 2.0);
                cov[t][t] += r(walk * step);
                cov[FORCE_BIAS + i][FORCE_BIAS + i] += common;
                for j in 0..3 {
                    let with_rate = stray * step * step / 2.0 + walk * cube * step / 8.0;
                    let crossed = attitude[i][j] * r(with_rate);
                    cov[PHI + i][OMEGA + j] += crossed;
                    cov[OMEGA + j][PHI + i] += crossed;
                    let crossed = attitude[i][j] * r(walk * cube / 6.0);
                    cov[PHI + i][TURN + j] += crossed;
                    cov[TURN + j][PHI + i] += crossed;
                    cov[TURN_BIAS + i][TURN_BIAS + j] += r(bias * covariance[i][j]);
                    cov[FORCE_BIAS + i][FORCE_BIAS + j] += r(bias * covariance[3 + i][3 + j]);
                }
            }
            for i in 0..rank.min(6) {
                cov[Z_BIAS + i][Z_BIAS + i] += r(bias);
            }
        }
    }
}
