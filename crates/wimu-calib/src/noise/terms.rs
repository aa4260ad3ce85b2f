//! Noise terms of an Allan deviation as a residual model: equation (53).
//!
//! σ²(τ) = N²/τ + (2 ln 2/π) B² + K² τ/3, fitted to ln σ²(τ), of which the variance is 2 over the degrees of freedom.
//! A low-pass filter reduces it beyond its memory by C/τ², which is then fitted too.
//! Averaging times an octave apart share samples: their correlation is that of the noise that dominates there.

use alloc::vec::Vec;

use nalgebra::{DMatrix, DVector};

use super::Measured;
use crate::least_squares::{self, ResidualModel, Rows, Settings};

/// Number of noise terms: N, B, K; and with that of a filter.
const NOISES: usize = 3;
const TERMS: usize = 4;
/// 2 ln 2 / π: Allan variance of flicker noise per B².
const FLICKER: f64 = 0.441_271_200_305_303_2;
/// Correlation of ln σ² an octave apart in white, flicker and random-walk noise: of 600 simulations of 16,384 samples.
const CORRELATION: [f64; NOISES] = [0.53, 0.67, 0.87];
/// χ² that a term must explain to be in the fit (Akaike), and to be reported: a probability of 0.1 % by chance.
const FITTED: f64 = 2.0;
const REPORTED: f64 = 10.8;
/// Largest χ² per degree of freedom of the terms of a curve that is not filtered.
const BY_CHANCE: f64 = 2.5;
/// The term of a low-pass filter.
const FILTER: usize = 3;
/// Smallest part of the first point that a low-pass filter removes.
const FILTERED: f64 = 0.1;
/// Points beyond the terms that a part of the curve has at least.
const SPARE: usize = 3;
/// Convergence threshold, standard deviations of a point.
const SETTINGS: Settings = Settings { cauchy: None, last_step: 1e-6, magnitude: 1.0 };

/// Degrees of freedom of σ²(τ) of `n` samples in overlapping clusters of `m`, in white, flicker and random-walk noise
/// (Riley, NIST Special Publication 1065, table 5).
pub(super) fn degrees_of_freedom(n: f64, m: f64) -> [f64; NOISES] {
    if n < 3.0 * m {
        return [0.0; NOISES];
    }
    let white = (1.5 * (n - 1.0) / m - 2.0 * (n - 2.0) / n) * 4.0 * m * m / (4.0 * m * m + 5.0);
    let flicker = if m < 1.5 {
        2.0 * (n - 2.0) * (n - 2.0) / (2.3 * n - 4.9)
    } else {
        1.25 * n * n / (m * (n + 3.0 * m))
    };
    let less = n - 1.0;
    let walk =
        (n - 2.0) / m * (less * less - 3.0 * m * less + 4.0 * m * m) / ((n - 3.0) * (n - 3.0));
    [white, flicker, walk]
}

/// Allan variance at τ per N², B², K² and C.
fn shares(tau_s: f64) -> [f64; TERMS] {
    [1.0 / tau_s, FLICKER, tau_s / 3.0, -1.0 / (tau_s * tau_s)]
}

/// A point of the curve of an axis.
#[derive(Clone, Copy)]
pub(super) struct Point {
    pub tau_s: f64,
    pub variance: f64,
    /// In white, flicker and random-walk noise.
    pub dof: [f64; NOISES],
}

/// ln N², ln B², ln K², ln C; −∞ for a term that is not fitted.
type Logs = [f64; TERMS];

/// The terms of some points.
struct Curve<'a> {
    points: &'a [Point],
    fitted: Vec<usize>,
    /// Terms that say which noise dominates a point.
    about: Logs,
}

impl Curve<'_> {
    /// Allan variance of each term at a point.
    fn variances(point: &Point, terms: &Logs) -> Logs {
        let shares = shares(point.tau_s);
        core::array::from_fn(|k| libm::exp(terms[k]) * shares[k])
    }

    /// Mean of a property of the three noises, weighted by their parts of a point's variance.
    fn dominant(&self, point: &Point, of: [f64; NOISES]) -> f64 {
        let variances = Self::variances(point, &self.about);
        let sum: f64 = variances.iter().zip(of).map(|(variance, of)| variance * of).sum();
        sum / variances.iter().take(NOISES).sum::<f64>()
    }
}

impl ResidualModel for Curve<'_> {
    type Point = Logs;

    fn rows(&self, terms: &Logs) -> Option<Rows> {
        let (count, columns) = (self.points.len(), self.fitted.len());
        let mut rows =
            Rows { residual: DVector::zeros(count), jacobian: DMatrix::zeros(count, columns) };
        for (k, point) in self.points.iter().enumerate() {
            let variances = Self::variances(point, terms);
            let expected: f64 = variances.iter().sum();
            if expected <= 0.0 {
                return None;
            }
            let per_dof = self.dominant(point, point.dof.map(|dof| 1.0 / dof));
            let sd = libm::sqrt(2.0 * per_dof);
            // The mean of the logarithm of χ² per degree of freedom is −1 over the degrees.
            rows.residual[k] = (libm::log(expected / point.variance) - per_dof) / sd;
            for (column, term) in self.fitted.iter().enumerate() {
                rows.jacobian[(k, column)] = variances[*term] / (expected * sd);
            }
        }
        // A first-order autoregressive sequence over the octaves, made white from its end.
        for k in (1..count).rev() {
            let correlation = self.dominant(&self.points[k], CORRELATION);
            let own = libm::sqrt(1.0 - correlation * correlation);
            rows.residual[k] = (rows.residual[k] - correlation * rows.residual[k - 1]) / own;
            for column in 0..columns {
                let before = rows.jacobian[(k - 1, column)];
                let now = &mut rows.jacobian[(k, column)];
                *now = (*now - correlation * before) / own;
            }
        }
        Some(rows)
    }

    fn moved(&self, terms: &Logs, step: &DVector<f64>) -> Logs {
        let mut moved = *terms;
        for (term, step) in self.fitted.iter().zip(step) {
            // A factor of at most e³ in a step: from far off the model is not linear.
            moved[*term] += step.clamp(-3.0, 3.0);
        }
        moved
    }
}

/// Result of a fit.
pub(super) struct Fitted {
    /// N, B, K with standard deviations; `None` if not significant.
    pub terms: [Option<Measured>; NOISES],
    /// χ² per degree of freedom.
    pub misfit: f64,
    /// Shortest averaging time of the fit, s, if the output is filtered.
    pub white_from_s: Option<f64>,
}

/// Fits the whole curve or, if no terms fit and the curve begins below white noise, the part beyond a low-pass filter.
pub(super) fn fit(points: &[Point]) -> Option<Fitted> {
    let whole = of_part(points, &[])?;
    if whole.misfit <= BY_CHANCE {
        return Some(whole);
    }
    let last = points.len().saturating_sub(TERMS + SPARE);
    let beyond =
        |from: usize| of_part(&points[from..], &[FILTER]).filter(|found| found.misfit <= BY_CHANCE);
    let Some(first) = (1..=last).find(|from| beyond(*from).is_some()) else { return Some(whole) };
    // An octave more, for what the filter still removes there.
    let from = (first + 1).min(last);
    let Some(found) = beyond(from) else { return Some(whole) };
    let Some(white) = found.terms[0] else { return Some(whole) };
    // A filter reduces the first points; hum and vibration increase them.
    let share = |point: &Point| point.variance * point.tau_s / (white.value * white.value);
    let is_less = share(&points[0]) < 1.0 - FILTERED
        && share(&points[0]) < (1.0 - 0.5 * FILTERED) * share(&points[1])
        && points[..first].iter().all(|point| share(point) < 1.0 + 2.0 * FILTERED);
    if !is_less {
        return Some(whole);
    }
    Some(Fitted { white_from_s: Some(points[from].tau_s), ..found })
}

/// The terms of a part of the curve: white noise and the `given` terms, flicker noise and random walk as far as they explain
/// it.
fn of_part(points: &[Point], given: &[usize]) -> Option<Fitted> {
    let sets: [Vec<usize>; 4] =
        [&[0][..], &[0, 1], &[0, 2], &[0, 1, 2]].map(|set| [set, given].concat());
    let found = sets.each_ref().map(|set| of_terms(points, set));
    let cost = |k: usize| found[k].as_ref().map_or(f64::INFINITY, |fit| fit.cost);
    let penalised = |k: &usize| cost(*k) + FITTED * sets[*k].len() as f64;
    let best = (0..4).min_by(|a, b| penalised(a).total_cmp(&penalised(b)))?;
    let fit = found[best].as_ref()?;
    let freedom = points.len().saturating_sub(sets[best].len()).max(1);
    let misfit = fit.cost / freedom as f64;
    let terms = core::array::from_fn(|term| {
        let column = sets[best].iter().position(|fitted| *fitted == term)?;
        // The best fit without the term; all have white noise.
        let without = (0..4).filter(|k| !sets[*k].contains(&term)).map(cost);
        let is_seen = term == 0 || without.fold(f64::INFINITY, f64::min) > fit.cost + REPORTED;
        let value = libm::exp(0.5 * fit.at[term]);
        let sd = 0.5 * value * libm::sqrt(misfit.max(1.0) * fit.inverse[(column, column)]);
        is_seen.then_some(Measured { value, sd })
    });
    Some(Fitted { terms, misfit, white_from_s: None })
}

/// Twice: which noise dominates is known after the first fit.
fn of_terms(points: &[Point], set: &[usize]) -> Option<least_squares::Fit<Logs>> {
    let weights = alloc::vec![1.0; points.len()];
    let [first, .., last] = points else { return None };
    let least = points.iter().map(|point| point.variance).fold(f64::INFINITY, f64::min);
    let white = first.variance * first.tau_s;
    let start =
        [white, 0.5 * least / FLICKER, 1.5 * last.variance / last.tau_s, 0.1 * white * first.tau_s];
    let mut at: Logs = core::array::from_fn(|k| {
        if set.contains(&k) { libm::log(start[k]) } else { f64::NEG_INFINITY }
    });
    let mut about = [f64::NEG_INFINITY; TERMS];
    about[0] = at[0];
    let mut curve = Curve { points, fitted: set.to_vec(), about };
    for _ in 0..2 {
        at = least_squares::minimise(&curve, &at, &weights, SETTINGS)?.at;
        curve.about = at;
    }
    least_squares::minimise(&curve, &at, &weights, SETTINGS)
}
