//! The angular rate through a recording: equations (77) to (80).

use nalgebra::{Cholesky, Const, Matrix3, SMatrix, SVector, Vector3};

use super::solver::{ArraySolver, Linear};

/// ω slow, its derivative, ω fast.
const STATES: usize = 9;
/// z, and ω̇.
const MEASURED: usize = 9;
/// Roots of a sample.
const ROOTS: usize = 8;
/// Linearise again so often; the path moves little after the second time.
const PASSES: usize = 4;
/// A root's χ² counts up to this: a sample with an outlier must not choose the path alone.
const MOST_CHI_SQUARE: f64 = 30.0;
/// Samples over which the vibration is averaged.
const VIBRATION_SAMPLES: usize = 31;
/// Samples over which a sample's own noise is steadied.
const NOISE_SAMPLES: usize = 9;
/// Share of the sample's own noise in its weight.
const OWN_SHARE: f64 = 0.8;
/// Times between samples beyond this are no motion that can be followed, s.
const LONGEST_STEP_S: f64 = 0.5;

type State = SVector<f64, STATES>;
type Square = SMatrix<f64, STATES, STATES>;

/// One sample of a recording, reduced.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Observation {
    /// Time since the sample before, s.
    pub step_s: f64,
    /// [`ArraySolver::reduce`]; `None` where a sensor was saturated or missing: the path is carried
    /// over it.
    pub linear: Option<Linear<f64>>,
    /// [`ArraySolver::excess`], 1 where there is none.
    pub excess: f64,
}

/// How the angular rate of this recording moves, found from the recording itself by the likelihood
/// of what was predicted one step ahead.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Random walk of the slow angular acceleration, rad/s² per √s and m/s² of vibration.
    pub acceleration_walk: f64,
    /// Fast angular acceleration, rad/s² per m/s² of vibration.
    pub fast_acceleration: f64,
    /// Fast angular rate, rad/s per m/s² of vibration.
    pub fast_rate: f64,
}

/// What is known about one sample, and the room that the work needs.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// ω from all samples, rad/s, body axes.
    pub rate_rad_s: [f64; 3],
    /// Its covariance, (rad/s)².
    pub covariance: [[f64; 3]; 3],
    /// Slow part of ω̇, rad/s².
    pub angular_acceleration_rad_s2: [f64; 3],
    /// ω from the samples up to this one, rad/s.
    pub causal_rad_s: [f64; 3],
    noise: f64,
    vibration: f64,
    roots: [[f64; 3]; ROOTS],
    turns: [[f64; 3]; ROOTS],
    costs: [f64; ROOTS],
    count: u8,
    from: [u8; ROOTS],
    at: [f64; 3],
    mean: State,
    spread: Square,
    predicted: State,
    predicted_spread: Square,
}

impl Default for Step {
    fn default() -> Self {
        Self {
            rate_rad_s: [0.0; 3],
            covariance: [[0.0; 3]; 3],
            angular_acceleration_rad_s2: [0.0; 3],
            causal_rad_s: [0.0; 3],
            noise: 1.0,
            vibration: 0.0,
            roots: [[0.0; 3]; ROOTS],
            turns: [[0.0; 3]; ROOTS],
            costs: [0.0; ROOTS],
            count: 0,
            from: [0; ROOTS],
            at: [0.0; 3],
            mean: State::zeros(),
            spread: Square::zeros(),
            predicted: State::zeros(),
            predicted_spread: Square::zeros(),
        }
    }
}

/// How a recording was followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Track {
    /// How its angular rate moves.
    pub spread: Spread,
    /// Logarithm of the likelihood of all samples.
    pub log_likelihood: f64,
    /// Mean NIS of the samples per degree of freedom: 1 when the covariances are right.
    pub nis: f64,
}

/// Follows the angular rate through `observations`, into `steps`; as many as the shorter has.
///
/// Every root of every sample is kept until the whole path decides (the likeliest chain of roots,
/// equation (78)); a smoother linearised on that path does the rest. `variance_mps2` is the variance
/// that the geometry declares for a sample, (m/s²)². `None` where the geometry shows no angular
/// rate or there is no sample.
pub fn track<const M: usize>(
    solver: &ArraySolver<f64, M>,
    variance_mps2: f64,
    observations: &[Observation],
    steps: &mut [Step],
) -> Option<Track> {
    let used = observations.len().min(steps.len());
    let steps = steps.get_mut(..used)?;
    let observations = observations.get(..used)?;
    if solver.rank() < 3 || used == 0 {
        return None;
    }
    weigh(variance_mps2, observations, steps);
    let mut spread = Spread {
        acceleration_walk: 25.0 / solver.arm_m(),
        fast_acceleration: 4.0 / solver.arm_m(),
        fast_rate: 0.02 / solver.arm_m(),
    };
    choose_roots(solver, &spread, observations, steps);
    let mut filter = Filter { solver, observations, spread };
    filter.forward(steps)?;
    backward(observations, steps);
    // Each parameter up and down by 2 as long as the likelihood grows.
    let mut best = filter.forward(steps)?;
    for _ in 0..4 {
        let before = best.log_likelihood;
        for parameter in 0..3 {
            for factor in [2.0, 0.5] {
                loop {
                    let mut trial = spread;
                    match parameter {
                        0 => trial.acceleration_walk *= factor,
                        1 => trial.fast_acceleration *= factor,
                        _ => trial.fast_rate *= factor,
                    }
                    filter.spread = trial;
                    match filter.forward(steps) {
                        Some(found) if found.log_likelihood > best.log_likelihood + 1.0 => {
                            best = found;
                            spread = trial;
                        }
                        _ => break,
                    }
                }
            }
        }
        if best.log_likelihood - before < 1.0 {
            break;
        }
    }
    choose_roots(solver, &spread, observations, steps);
    filter.spread = spread;
    let mut track = None;
    for _ in 0..PASSES {
        track = filter.forward(steps);
        backward(observations, steps);
    }
    track
}

/// Each sample's noise and vibration, equation (76).
fn weigh(variance: f64, observations: &[Observation], steps: &mut [Step]) {
    let mean = |centre: usize, width: usize| {
        let from = centre.saturating_sub(width / 2);
        let near =
            observations.get(from..(centre + width / 2 + 1).min(observations.len())).unwrap_or(&[]);
        let mut sum = 0.0;
        let mut count = 0.0;
        for observation in near.iter().filter(|o| o.linear.is_some()) {
            sum += observation.excess;
            count += 1.0;
        }
        if count > 0.0 { sum / count } else { 1.0 }
    };
    for (index, step) in steps.iter_mut().enumerate() {
        let own = observations.get(index).map_or(1.0, |o| o.excess);
        let steadied = OWN_SHARE * own + (1.0 - OWN_SHARE) * mean(index, NOISE_SAMPLES);
        step.noise = 1.0 + steadied;
        step.vibration = variance * mean(index, VIBRATION_SAMPLES).max(1.0);
    }
}

/// The roots of the sample before, ω̇ at each, and how many.
type Before = ([[f64; 3]; ROOTS], [[f64; 3]; ROOTS], usize);

/// The likeliest chain of roots: equation (78).
fn choose_roots<const M: usize>(
    solver: &ArraySolver<f64, M>,
    spread: &Spread,
    observations: &[Observation],
    steps: &mut [Step],
) {
    let mut scores = [0.0; ROOTS];
    let mut last: Option<Before> = None;
    let mut elapsed = 0.0;
    for (observation, step) in observations.iter().zip(steps.iter_mut()) {
        elapsed += observation.step_s;
        step.count = 0;
        let Some(linear) = observation.linear else {
            continue;
        };
        let mut count = 0;
        for hypothesis in solver.roots_of(&linear).hypotheses().take(ROOTS) {
            step.roots[count] = hypothesis.rate_rad_s;
            step.turns[count] = hypothesis.angular_acceleration_rad_s2;
            step.costs[count] = 0.5 * (hypothesis.chi_square / step.noise).min(MOST_CHI_SQUARE);
            count += 1;
        }
        step.count = count as u8;
        if count == 0 {
            continue;
        }
        let mut next = [0.0; ROOTS];
        for to in 0..count {
            let mut best = (f64::INFINITY, 0);
            if let Some((roots, turns, before)) = &last {
                let dt = elapsed.min(LONGEST_STEP_S);
                let fast = spread.fast_rate * spread.fast_rate
                    + spread.fast_acceleration * spread.fast_acceleration * dt * dt;
                let variance = fast * step.vibration + 0.01 + dt;
                for from in 0..*before {
                    let mut square = 0.0;
                    for i in 0..3 {
                        let slope = 0.5 * (turns[from][i] + step.turns[to][i]);
                        let d = step.roots[to][i] - roots[from][i] - slope * dt;
                        square += d * d;
                    }
                    let cost = scores[from] + 3.0 * libm::log1p(square / (3.0 * variance));
                    if cost < best.0 {
                        best = (cost, from);
                    }
                }
            } else {
                best.0 = 0.0;
            }
            next[to] = best.0 + step.costs[to];
            step.from[to] = best.1 as u8;
        }
        // Only differences count: keep them small.
        let least = next[..count].iter().copied().fold(f64::INFINITY, f64::min);
        for (score, value) in scores.iter_mut().zip(next) {
            *score = value - least;
        }
        let ahead = least_index(&scores, count);
        step.causal_rad_s = step.roots[ahead];
        last = Some((step.roots, step.turns, count));
        elapsed = 0.0;
    }
    let mut chosen: Option<usize> = None;
    let mut at = [0.0; 3];
    for step in steps.iter_mut().rev() {
        let count = usize::from(step.count).min(ROOTS);
        if count > 0 {
            let index = match chosen {
                Some(index) => index.min(count - 1),
                None => least_index(&scores, count),
            };
            at = step.roots[index];
            chosen = Some(usize::from(step.from[index]));
        }
        step.at = at;
    }
}

fn least_index(scores: &[f64; ROOTS], count: usize) -> usize {
    let mut best = 0;
    for index in 1..count.min(ROOTS) {
        if scores[index] < scores[best] {
            best = index;
        }
    }
    best
}

struct Filter<'a, const M: usize> {
    solver: &'a ArraySolver<f64, M>,
    observations: &'a [Observation],
    spread: Spread,
}

fn transition(dt: f64) -> Square {
    let mut f = Square::zeros();
    for i in 0..3 {
        f[(i, i)] = 1.0;
        f[(i, 3 + i)] = dt;
        f[(3 + i, 3 + i)] = 1.0;
    }
    f
}

impl<const M: usize> Filter<'_, M> {
    /// A Kalman filter linearised at each step's `at`: equation (79).
    fn forward(&self, steps: &mut [Step]) -> Option<Track> {
        let spread = &self.spread;
        let mut mean = State::zeros();
        let mut cov = Square::zeros();
        for i in 0..3 {
            cov[(i, i)] = 100.0;
            cov[(3 + i, 3 + i)] = 1e4;
        }
        let (mut log_likelihood, mut nis, mut count) = (0.0, 0.0, 0.0);
        let degrees = self.solver.rank() + 3;
        for (observation, step) in self.observations.iter().zip(steps.iter_mut()) {
            let dt = observation.step_s.clamp(0.0, LONGEST_STEP_S);
            let f = transition(dt);
            mean = f * mean;
            cov = f * cov * f.transpose();
            let walk = spread.acceleration_walk * spread.acceleration_walk * step.vibration;
            let fast = spread.fast_rate * spread.fast_rate * step.vibration;
            for i in 0..3 {
                cov[(i, i)] += walk * dt * dt * dt / 3.0;
                cov[(i, 3 + i)] += walk * dt * dt / 2.0;
                cov[(3 + i, i)] += walk * dt * dt / 2.0;
                cov[(3 + i, 3 + i)] += walk * dt;
                cov[(6 + i, 6 + i)] += fast;
            }
            step.predicted = mean;
            step.predicted_spread = cov;
            if let Some(linear) = &observation.linear {
                let (h, expected, noise) = self.measurement(step);
                let at = Vector3::from(step.at);
                let away: Vector3<f64> = mean.fixed_rows::<3>(0) + mean.fixed_rows::<3>(6) - at;
                let mut innovation = SVector::<f64, MEASURED>::zeros();
                for row in 0..MEASURED {
                    let measured =
                        if row < 6 { linear.z[row] } else { linear.theta[row - 6] - mean[row - 3] };
                    innovation[row] = measured
                        - expected[row]
                        - (h[(row, 0)] * away.x + h[(row, 1)] * away.y + h[(row, 2)] * away.z);
                }
                let s = h * cov * h.transpose() + noise;
                let factor = Cholesky::new(s)?;
                let gain = factor.solve(&(h * cov)).transpose();
                let weighted = factor.solve(&innovation);
                let square = innovation.dot(&weighted);
                let log_determinant: f64 =
                    (0..MEASURED).map(|i| 2.0 * libm::log(factor.l_dirty()[(i, i)])).sum();
                // A sample far out says little about the spread.
                log_likelihood -= 0.5 * (log_determinant + square.min(100.0 * degrees as f64));
                nis += square;
                count += degrees as f64;
                mean += gain * innovation;
                cov -= gain * (h * cov);
                cov = (cov + cov.transpose()) * 0.5;
            }
            step.mean = mean;
            step.spread = cov;
        }
        (log_likelihood.is_finite() && count > 0.0).then_some(Track {
            spread: *spread,
            log_likelihood,
            nis: nis / count,
        })
    }

    /// Derivatives, expected values and noise of a sample at the step's path.
    fn measurement(
        &self,
        step: &Step,
    ) -> (SMatrix<f64, MEASURED, STATES>, SVector<f64, MEASURED>, SMatrix<f64, MEASURED, MEASURED>)
    {
        let mut h = SMatrix::zeros();
        let mut expected = SVector::zeros();
        let mut noise = SMatrix::zeros();
        let (z, z_slope) = self.solver.expected_z(step.at);
        let (turn, turn_slope) = self.solver.expected_theta(step.at);
        for row in 0..MEASURED {
            let slope = if row < 6 { z_slope[row] } else { turn_slope[row - 6] };
            expected[row] = if row < 6 { z[row] } else { turn[row - 6] };
            for i in 0..3 {
                h[(row, i)] = slope[i];
                h[(row, 6 + i)] = slope[i];
            }
            if row < 6 {
                noise[(row, row)] = step.noise;
            }
        }
        let covariance = self.solver.covariance();
        let fast = self.spread.fast_acceleration * self.spread.fast_acceleration;
        for i in 0..3 {
            h[(6 + i, 3 + i)] = 1.0;
            for j in 0..3 {
                noise[(6 + i, 6 + j)] = covariance[i][j] * step.noise;
            }
            noise[(6 + i, 6 + i)] += fast * step.vibration;
        }
        (h, expected, noise)
    }
}

/// The smoother after Rauch, Tung and Striebel, and the next pass's path: equation (80).
fn backward(observations: &[Observation], steps: &mut [Step]) {
    let mut later: Option<(State, Square, State, Square, f64)> = None;
    for (observation, step) in observations.iter().zip(steps.iter_mut()).rev() {
        let (mut mean, mut cov) = (step.mean, step.spread);
        if let Some((next, next_cov, predicted, predicted_cov, dt)) = later {
            let f = transition(dt);
            let factor: Option<Cholesky<f64, Const<STATES>>> = Cholesky::new(predicted_cov);
            if let Some(factor) = factor {
                let gain = factor.solve(&(f * step.spread)).transpose();
                mean += gain * (next - predicted);
                cov += gain * (next_cov - predicted_cov) * gain.transpose();
            }
        }
        let both = |m: &Square| -> Matrix3<f64> {
            m.fixed_view::<3, 3>(0, 0)
                + m.fixed_view::<3, 3>(0, 6)
                + m.fixed_view::<3, 3>(6, 0)
                + m.fixed_view::<3, 3>(6, 6)
        };
        let rate: Vector3<f64> = mean.fixed_rows::<3>(0) + mean.fixed_rows::<3>(6);
        let covariance = both(&cov);
        step.at = rate.into();
        step.rate_rad_s = rate.into();
        step.covariance = core::array::from_fn(|i| core::array::from_fn(|j| covariance[(i, j)]));
        step.angular_acceleration_rad_s2 = [mean[3], mean[4], mean[5]];
        later = Some((
            mean,
            cov,
            step.predicted,
            step.predicted_spread,
            observation.step_s.clamp(0.0, LONGEST_STEP_S),
        ));
    }
}
