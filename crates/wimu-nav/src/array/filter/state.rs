//! What is known after a sample: equations (102), (103) and (105).

use super::super::hypothesis::{
    Hypothesis, OMEGA, PHI, POSITION, TURN, TURN_BIAS, VELOCITY, block, dot, part, quaternion, r,
};
use super::super::matrix::times;
use super::{ArrayFilter, Wandered};
use crate::real::all_finite;
use crate::{Real, Zupt};

/// The part of a hidden turn's variance across the vertical: what holds the array on its circle tilts it.
const ASIDE: f64 = 0.04;

/// What is known after a sample. Means and covariances are those of all hypotheses together, each
/// with its probability.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArrayState<R> {
    /// ω, rad/s, body axes.
    pub rate_rad_s: [R; 3],
    /// Its covariance, (rad/s)². It grows at rest where no ZUPT is made: an array knows nothing of ω
    /// there.
    pub rate_covariance: [[R; 3]; 3],
    /// ω̇ without what lasts for one sample only, rad/s², body axes.
    pub angular_acceleration_rad_s2: [R; 3],
    /// Body to navigation axes (east-north-up; heading is that of the body at the start), W X Y Z.
    pub quaternion: [R; 4],
    /// Covariance of the attitude, turns about east, north and up, rad².
    pub attitude_covariance: [[R; 3]; 3],
    /// Velocity of the sensors' centre, m/s.
    pub velocity_mps: [R; 3],
    /// Its covariance, (m/s)².
    pub velocity_covariance: [[R; 3]; 3],
    /// Position of the sensors' centre, m.
    pub position_m: [R; 3],
    /// Its covariance, m².
    pub position_covariance: [[R; 3]; 3],
    /// Probability of the likeliest hypothesis: 1 where nothing is ambiguous.
    pub certainty: R,
    /// Seconds since velocity was last known to be zero (or given), or since the first sample.
    pub since_rest_s: R,
    /// Whether it is at rest now.
    pub resting: bool,
    /// The fastest even motion that would have looked like the rests, m/s: three standard deviations of the speed before
    /// one was taken for zero velocity.
    pub unseen_mps: R,
    /// How far even motion that no rest would have shown may have taken it, one standard deviation in space, m; it is in
    /// the covariance with [`Zupt::Assumed`]. 0 with ZUPT off.
    pub unseen_m: R,
    /// False before the first alignment, and after a gap or a start in motion until the next rest: position
    /// begins there. False where the filter diverged: a state that is not finite is never valid.
    pub valid: bool,
}

impl<R: Real> ArrayState<R> {
    /// Standard deviation of the position in space, m.
    pub fn position_sd_m(&self) -> R {
        let p = &self.position_covariance;
        (p[0][0] + p[1][1] + p[2][2]).abs().sqrt()
    }
}

impl<R: Real, const M: usize> ArrayFilter<R, M> {
    /// The angular rates that are still possible, rad/s, each with its probability: the likeliest
    /// first, more than one while the data do not decide.
    pub fn hypotheses(&self) -> impl Iterator<Item = (R, [R; 3])> {
        self.hypotheses
            .iter()
            .flatten()
            .map(|h| (r(libm::exp(h.weight)), part(&h.mean, OMEGA)))
    }

    /// What is known now.
    pub fn state(&self) -> ArrayState<R> {
        let zero = [R::default(); 3];
        let none = [zero; 3];
        let mut state = ArrayState {
            rate_rad_s: zero,
            rate_covariance: none,
            angular_acceleration_rad_s2: zero,
            quaternion: [r(1.0), R::default(), R::default(), R::default()],
            attitude_covariance: none,
            velocity_mps: zero,
            velocity_covariance: none,
            position_m: zero,
            position_covariance: none,
            certainty: R::default(),
            since_rest_s: r(self.since_rest_s),
            resting: self.resting(),
            unseen_mps: r(self.unseen_mps),
            unseen_m: self.unseen.position_sd_m(),
            valid: self.valid,
        };
        let mut all: Option<Hypothesis<R>> = None;
        for hypothesis in self.hypotheses.iter().flatten() {
            all = Some(match all {
                Some(all) => all.joined(hypothesis),
                None => *hypothesis,
            });
        }
        let (Some(all), Some(best)) = (all, &self.hypotheses[0]) else {
            return state;
        };
        let (rate, turn) = (part(&all.mean, OMEGA), part(&all.mean, TURN));
        let velocity = part(&all.mean, VELOCITY);
        // Equation (102).
        let at_time = |at: usize, change: [R; 3], surprise: f64| {
            let (scale, late) = (r::<R>(surprise), r::<R>(self.config.time_sd_s));
            let mut covariance = block(&all.cov, at, at);
            for (i, row) in covariance.iter_mut().enumerate() {
                for (j, value) in row.iter_mut().enumerate() {
                    *value = *value * scale + change[i] * late * change[j] * late;
                }
            }
            covariance
        };
        state.rate_rad_s = rate;
        state.rate_covariance = at_time(OMEGA, turn, self.surprise);
        // Equation (105).
        let size = r::<R>(self.size_variance()) * dot(&rate, &rate);
        let none = r::<R>(self.none_variance(&all));
        for (i, row) in state.rate_covariance.iter_mut().enumerate() {
            row[i] += size;
            for (value, other) in row.iter_mut().zip(rate) {
                *value += none * rate[i] * other;
            }
        }
        state.angular_acceleration_rad_s2 = turn;
        state.quaternion = quaternion(&all.attitude);
        state.attitude_covariance = at_time(PHI, times(&all.attitude, &rate), 1.0);
        state.velocity_mps = velocity;
        state.velocity_covariance = at_time(VELOCITY, all.acceleration, 1.0);
        state.position_m = part(&all.mean, POSITION);
        state.position_covariance = at_time(POSITION, velocity, 1.0);
        state.certainty = r(libm::exp(best.weight));
        if !self.config.zupt.is_on() {
            let Wandered { angle, speed, way } = self.wandered;
            for i in 0..2 {
                state.attitude_covariance[i][i] += r(angle * angle);
                state.velocity_covariance[i][i] += r(speed * speed);
                state.position_covariance[i][i] += r(way * way);
            }
        }
        if self.config.zupt == Zupt::Assumed {
            // Equation (103).
            let (speed2, way2) = (self.unseen.velocity2(), self.unseen.position2());
            for i in 0..3 {
                state.velocity_covariance[i][i] += speed2[i];
                state.position_covariance[i][i] += way2[i];
            }
            state.attitude_covariance[2][2] += r(self.hidden_turn.angle2);
            let rate2 = r::<R>(self.hidden_turn.rate2);
            let up = all.attitude[2];
            for (i, row) in state.rate_covariance.iter_mut().enumerate() {
                row[i] += rate2 * r(ASIDE);
                for (value, b) in row.iter_mut().zip(up) {
                    *value += rate2 * up[i] * b;
                }
            }
        }
        let means = [rate, velocity, state.position_m];
        let covariances = [
            state.rate_covariance,
            state.velocity_covariance,
            state.position_covariance,
        ];
        state.valid &= all_finite(
            all.attitude
                .iter()
                .chain(&means)
                .chain(covariances.iter().flatten()),
        );
        state
    }

    /// Samples at rests where velocity or attitude were wrong by far more than their covariance said: zero as
    /// long as places, sensitivity and noise are this array's.
    pub fn astray(&self) -> u32 {
        self.astray
    }

    /// Rests at which the speed was not likely to be zero: it may have gone on evenly, and the position is as
    /// uncertain as that.
    pub fn doubtful(&self) -> u32 {
        self.doubtful
    }

    /// Biases of the likeliest hypothesis and their standard deviations: of ω̇ (rad/s²), of s (m/s²),
    /// and of [`Linear::z`](crate::array::Linear::z) (in its units): the common six and those residual ones that rotation shows.
    pub fn biases(&self) -> [(R, R); 12] {
        let mut out = [(R::default(), R::default()); 12];
        if let Some(best) = &self.hypotheses[0] {
            for (k, (value, sd)) in out.iter_mut().enumerate() {
                let at = TURN_BIAS + k;
                *value = best.mean[at];
                *sd = best.cov[at][at].abs().sqrt();
            }
        }
        out
    }
}
