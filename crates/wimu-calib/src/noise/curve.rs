//! Fit of noise terms to an Allan deviation: equation (53).

use nalgebra::{Cholesky, Const, SMatrix, SVector};

use super::{Measured, POINTS, cluster};
use crate::student;

/// 2 ln 2 / π: Allan variance of flicker noise per B².
const FLICKER: f64 = 0.441_271_200_305_303_2;
/// Penalty per term on −2 ln likelihood in the selection of a set of terms.
const WORTH: f64 = 10.0;
/// Penalty per term in the weights of the other sets.
const LIKELY: f64 = 9.0;
/// Smallest increase of the penalised −2 ln likelihood without a term that makes it significant;
/// and for K against sets with a ramp instead, the other explanation of a rising curve.
const SEEN: f64 = 10.0;
const SEEN_BESIDE_RAMP: f64 = 1.0;
/// Number of noise terms: Q, N, B, K.
const NOISES: usize = 4;
/// Pairs of them.
const PAIRS: [(usize, usize); 10] =
    [(0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3)];
/// Number of terms: the noise terms and the ramp R.
const TERMS: usize = 5;
const QUANTISATION: usize = 0;
const WHITE: usize = 1;
const WALK: usize = 3;
const RAMP: usize = 4;
/// Number of octaves over which the correlation of points is computed; beyond, it is negligible.
const OCTAVES: usize = 6;
/// Largest number of reweighting iterations.
const ROUNDS: usize = 8;
/// Smallest fraction of the first point that a low-pass filter removes.
const FILTERED: f64 = 0.1;
/// Spare points required after points are left out.
const SPARE: usize = 2;
/// Smallest uncorrelated fraction of the variance of a point.
const OWN: f64 = 1e-6;

type Information = SMatrix<f64, TERMS, TERMS>;
type Weights = Cholesky<f64, Const<POINTS>>;

/// Degrees of freedom of σ²(τ) of `n` samples in clusters of `m`: the smallest of white, flicker
/// and random-walk noise.
pub(super) fn fewest_edf(n: f64, m: f64) -> f64 {
    if n < 3.0 * m {
        return 0.0;
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
    white.min(flicker).min(walk)
}

/// Allan variance at τ per Q², N², B², K² and R²: equation (53).
fn shares(tau_s: f64) -> [f64; TERMS] {
    let square = tau_s * tau_s;
    [3.0 / square, 1.0 / tau_s, FLICKER, tau_s / 3.0, square / 2.0]
}

fn total(terms: &[f64; TERMS], tau_s: f64) -> f64 {
    terms.iter().zip(shares(tau_s)).map(|(t, x)| t * x).sum()
}

/// Generalised covariances of the running sum at a lag of `t` samples, per Q² f², N² f, B²/2π and
/// K²/12f. They determine the covariances of second differences.
fn covariances(t: i64) -> [f64; NOISES] {
    let far = t.unsigned_abs() as f64;
    let quantised = if t == 0 { 1.0 } else { 0.0 };
    let flicker = if t == 0 { 0.0 } else { far * far * libm::log(far) };
    [quantised, -0.5 * far, flicker, far * far * far]
}

/// Covariances of the points: sums over all pairs of second differences at two averaging times of
/// the products of their covariances.
pub(super) struct Spans {
    /// Indexed by the shorter averaging time, the number of octaves to the longer one, and the pair
    /// of terms.
    sums: [[[f64; PAIRS.len()]; OCTAVES]; POINTS],
}

impl Spans {
    /// For a gap-free run of `samples`, and `counts` second differences at each averaging time over
    /// all runs.
    pub(super) fn new(samples: u64, counts: &[f64; POINTS]) -> Self {
        let samples = i64::try_from(samples).unwrap_or(i64::MAX / 4);
        // Step between differences, and how many there are in the run.
        let step = |place: usize| (cluster(place) / 8).max(1) as i64;
        let differences = |place: usize| {
            let left = samples - 2 * cluster(place) as i64;
            if left < 0 { 0 } else { left / step(place) + 1 }
        };
        let mut sums = [[[0.0; PAIRS.len()]; OCTAVES]; POINTS];
        for octaves in 0..OCTAVES {
            // Beyond 8 samples, averaging times differ only by a scale.
            for like in 0..4.min(POINTS) {
                let (short, long) = (1_i64 << like, 1_i64 << (like + octaves));
                for lag in -3 * long - 2 * short..=3 * long {
                    let product = products(lag, short, long);
                    let last = if like == 3 { POINTS } else { like + 1 };
                    for place in like..last {
                        let other = place + octaves;
                        if other >= POINTS || differences(other) == 0 {
                            break;
                        }
                        let (near, far) = (step(place), step(other));
                        let apart = lag * near;
                        // Number of pairs at this lag.
                        let first = (-apart).max(0) as u64;
                        let first = first.div_ceil(far as u64) as i64;
                        let room = (differences(place) - 1) * near - apart;
                        let last = room.div_euclid(far).min(differences(other) - 1);
                        let pairs = (last - first + 1).max(0) as f64;
                        for (sum, product) in sums[place][octaves].iter_mut().zip(product) {
                            *sum += pairs * product;
                        }
                    }
                }
            }
        }
        for (place, octaves) in sums.iter_mut().enumerate() {
            let m = cluster(place) as f64;
            for (octave, sums) in octaves.iter_mut().enumerate() {
                let other = place + octave;
                let long = cluster(other) as f64;
                let (Some(all), true) = (counts.get(other), other < POINTS) else {
                    continue;
                };
                let n = [place, other].map(|place| differences(place) as f64);
                // Further runs reduce the variance.
                let runs = n[1] / all.max(1.0);
                let scale = m / cluster(place.min(3)) as f64;
                let per = runs / (2.0 * m * m * long * long * n[0] * n[1]);
                for (sum, (a, b)) in sums.iter_mut().zip(PAIRS) {
                    let power = libm::pow(scale, (a + b) as f64);
                    let twice = if a == b { 1.0 } else { 2.0 };
                    *sum *= twice * power * per;
                }
            }
        }
        Self { sums }
    }

    /// Covariance of the Allan variances at two averaging times.
    fn covariance(&self, short: usize, long: usize, terms: &[f64; NOISES]) -> f64 {
        let sums = self.sums.get(short).and_then(|s| s.get(long - short));
        let products = sums.into_iter().flatten().zip(PAIRS);
        products.fold(0.0, |sum, (product, (a, b))| sum + terms[a] * terms[b] * product)
    }
}

/// Products of the covariances of two second differences, of `short` and `long` samples at a lag of
/// `lag`, for each pair of terms.
fn products(lag: i64, short: i64, long: i64) -> [f64; PAIRS.len()] {
    const WEIGHTS: [f64; 3] = [1.0, -2.0, 1.0];
    let mut found = [0.0; NOISES];
    for (i, a) in (0..).zip(WEIGHTS) {
        for (j, b) in (0..).zip(WEIGHTS) {
            let at = covariances(lag + i * short - j * long);
            for (found, at) in found.iter_mut().zip(at) {
                *found += a * b * at;
            }
        }
    }
    PAIRS.map(|(a, b)| found[a] * found[b])
}

/// The points of an axis.
#[derive(Clone, Copy)]
pub(super) struct Curve {
    rate_hz: f64,
    /// Length of the longest run without a gap.
    samples: f64,
    variance: SVector<f64, POINTS>,
    edf: SVector<f64, POINTS>,
    /// Points from `from` up to but excluding `used` are fitted.
    from: usize,
    used: usize,
}

/// Result of a fit.
pub(super) struct Fitted {
    /// Terms with standard deviations; `None` if not significant.
    pub(super) terms: [Option<Measured>; TERMS],
    /// χ² per degree of freedom.
    pub(super) misfit: f64,
    /// Shortest averaging time of the fit, s, if the output is filtered.
    pub(super) white_from_s: Option<f64>,
}

/// A fit of a set of terms (a bit each), with covariance.
#[derive(Clone, Copy)]
struct Fit {
    set: u32,
    terms: [f64; TERMS],
    covariance: Information,
    chi_square: f64,
    /// −2 ln of its likelihood, up to a constant.
    cost: f64,
}

/// The best set of terms, and whether it fits the curve.
struct Likeliest {
    fitted: Fitted,
    is_by_chance: bool,
}

impl Fit {
    fn has(&self, term: usize) -> bool {
        self.set >> term & 1 == 1
    }
}

impl Curve {
    pub(super) fn new(rate_hz: f64, samples: u64) -> Self {
        Self {
            rate_hz,
            samples: samples as f64,
            variance: SVector::zeros(),
            edf: SVector::repeat(1.0),
            from: 0,
            used: 0,
        }
    }

    /// Adds the next averaging time.
    pub(super) fn add(&mut self, place: usize, variance: f64, edf: f64) {
        if let (Some(own), Some(freedom)) = (self.variance.get_mut(place), self.edf.get_mut(place))
        {
            *own = variance;
            *freedom = edf;
            self.used = place + 1;
        }
    }

    fn tau_s(&self, place: usize) -> f64 {
        cluster(place) as f64 / self.rate_hz
    }

    /// Fits the whole curve or, if no set of terms fits and the curve starts below white noise, the
    /// part beyond a low-pass filter.
    pub(super) fn fit(&self, spans: &Spans) -> Option<Fitted> {
        let whole = self.likeliest(spans)?;
        let filtered = (!whole.is_by_chance).then(|| self.beyond_filter(spans));
        Some(filtered.flatten().unwrap_or(whole.fitted))
    }

    /// Beyond the memory of a filter, filtered white noise has the variance N²/τ − C/τ². The fit
    /// starts one octave above the shortest averaging time from which a set of terms fits.
    fn beyond_filter(&self, spans: &Spans) -> Option<Fitted> {
        let last = self.used.checked_sub(2 + SPARE)?;
        let beyond = |from: usize| Self { from, ..*self }.likeliest(spans);
        let first =
            (1..=last).find(|from| beyond(*from).is_some_and(|found| found.is_by_chance))?;
        let from = (first + 1).min(last);
        let found = beyond(from).filter(|found| found.is_by_chance)?;
        let white = found.fitted.terms[WHITE]?.value;
        // A filter reduces the first points; hum and vibration increase them.
        let share = |place: usize| self.variance[place] * self.tau_s(place) / (white * white);
        let rises = share(0) < (1.0 - 0.5 * FILTERED) * share(1);
        let is_less =
            share(0) < 1.0 - FILTERED && (0..first).all(|k| share(k) < 1.0 + 2.0 * FILTERED);
        (rises && is_less)
            .then_some(Fitted { white_from_s: Some(self.tau_s(from)), ..found.fitted })
    }

    /// Selects, among all sets of non-negative terms with N, the one with the best penalised
    /// likelihood. The standard deviations include the differences to the other sets, weighted by
    /// their likelihood. With a filter, −3Q² represents its effect and is in every set.
    fn likeliest(&self, spans: &Spans) -> Option<Likeliest> {
        let is_filtered = self.from > 0;
        let fits: [Option<Fit>; 1 << TERMS] = core::array::from_fn(|set| {
            let lacks = |term: usize| set >> term & 1 == 0;
            if lacks(WHITE) || is_filtered && lacks(QUANTISATION) {
                return None;
            }
            let fit = self.converged(set as u32, spans)?;
            (0..TERMS)
                .all(|k| !fit.has(k) || fit.terms[k] > 0.0 || is_filtered && k == QUANTISATION)
                .then_some(fit)
        });
        let penalised = |fit: &Fit| fit.cost + WORTH * f64::from(fit.set.count_ones());
        let fits = || fits.iter().flatten();
        let best = fits().min_by(|a, b| penalised(a).total_cmp(&penalised(b)))?;
        // A poor fit increases all standard deviations.
        let points = self.used.saturating_sub(self.from);
        let freedom = points.saturating_sub(best.set.count_ones() as usize).max(1);
        let left = best.chi_square / freedom as f64;
        let misfit = left.max(1.0);
        let worse = |fit: &Fit| {
            let cost = |fit: &Fit| fit.cost / misfit + LIKELY * f64::from(fit.set.count_ones());
            (cost(fit) - cost(best)).max(0.0)
        };
        let terms = core::array::from_fn(|k| {
            // A term is significant if no set without it fits nearly as well.
            let mut without = fits().filter(|fit| !fit.has(k));
            let enough = |fit: &Fit| match (k, fit.has(RAMP)) {
                (WALK, true) => SEEN_BESIDE_RAMP,
                _ => SEEN,
            };
            let is_noise = !(is_filtered && k == QUANTISATION);
            let seen = best.has(k)
                && is_noise
                && (k == WHITE || without.all(|fit| worse(fit) > enough(fit)));
            let (mut weight, mut variance) = (0.0, 0.0);
            // A ramp instead of K means K = 0.
            let says = |fit: &&Fit| fit.has(k) || (k == WALK && fit.has(RAMP));
            for fit in fits().filter(says) {
                let likely = libm::exp(-0.5 * worse(fit));
                let off = fit.terms[k] - best.terms[k];
                weight += likely;
                let own = if fit.has(k) { misfit * fit.covariance[(k, k)] } else { 0.0 };
                variance += likely * (own + off * off);
            }
            seen.then(|| {
                let value = libm::sqrt(best.terms[k]);
                Measured { value, sd: libm::sqrt(variance / weight) / (2.0 * value) }
            })
        });
        Some(Likeliest {
            fitted: Fitted { terms, misfit: left, white_from_s: None },
            is_by_chance: best.chi_square <= student::chi_squared_half_percent(freedom),
        })
    }

    /// Generalised least squares for the terms of `set`, with the covariance of the points computed
    /// from the terms.
    fn converged(&self, set: u32, spans: &Spans) -> Option<Fit> {
        // First iteration: observed values as expectation, independent points.
        let independent = SMatrix::from_diagonal(&self.edf.map(|edf| 2.0 / edf));
        let mut fit = self.solve(set, &self.variance, &Weights::new(independent)?)?;
        for _ in 0..ROUNDS {
            let f = self.rate_hz;
            let terms = fit.terms.map(|term| term.max(0.0));
            let [q, n, b, k, r] = terms;
            let parts = [q * f * f, n * f, b / core::f64::consts::TAU, k / (12.0 * f)];
            // The effect of a filter is part of the expectation, but not noise.
            let signed = [fit.terms[QUANTISATION], n, b, k, r];
            let mut expected = self.variance;
            for place in self.from..self.used {
                let sum = total(&signed, self.tau_s(place));
                if sum > 0.0 {
                    expected[place] = sum;
                }
            }
            let covariance = SMatrix::<f64, POINTS, POINTS>::from_fn(|row, column| {
                let (short, long) = (row.min(column), row.max(column));
                if long >= self.used || short < self.from {
                    return if row == column { 1.0 } else { 0.0 };
                }
                let noise = spans.covariance(short, long, &parts);
                let own = if row == column { noise * OWN } else { 0.0 };
                let beside = [row, column].map(|place| self.beside_ramp(place, r, expected[place]));
                let ratio = cluster(short) as f64 / cluster(long) as f64;
                let alike = (1.5 * ratio * libm::sqrt(ratio)).min(1.0);
                let beside = alike * beside[0] * beside[1];
                (noise + own + beside) / (expected[row] * expected[column])
            });
            let before = fit.terms;
            fit = self.solve(set, &expected, &Weights::new(covariance)?)?;
            if (0..TERMS).all(|k| (fit.terms[k] - before[k]).abs() <= 1e-4 * before[k].abs()) {
                break;
            }
        }
        Some(fit)
    }

    /// Standard deviation of a point from the product of noise and the ramp R²: the variance of the
    /// mean of its differences is 4/3 (m/(n − 2m))² of their Allan variance. The correlation of two
    /// points is 3/2 (m/M)^(3/2).
    fn beside_ramp(&self, place: usize, square: f64, expected: f64) -> f64 {
        let tau = self.tau_s(place);
        let ramp = square * tau * tau;
        let noise = (expected - 0.5 * ramp).max(0.0);
        let m = cluster(place) as f64;
        let share = m / (self.samples - 2.0 * m).max(1.0);
        share * libm::sqrt(ramp * noise * 4.0 / 3.0)
    }

    /// Weighted least squares for the terms of `set`; the others are 0.
    fn solve(&self, set: u32, expected: &SVector<f64, POINTS>, weights: &Weights) -> Option<Fit> {
        let inside = |k: usize| set >> k & 1 == 1;
        // Relative to the expectation, because the values span decades.
        let mut design = SMatrix::<f64, POINTS, TERMS>::zeros();
        let mut seen = SVector::<f64, POINTS>::zeros();
        let mut spread = 0.0;
        let whitener = weights.l();
        for place in self.from..self.used {
            let shares = shares(self.tau_s(place));
            for k in (0..TERMS).filter(|k| inside(*k)) {
                design[(place, k)] = shares[k] / expected[place];
            }
            seen[place] = self.variance[place] / expected[place];
            spread += 2.0 * libm::log(expected[place] * whitener[(place, place)]);
        }
        let design = whitener.solve_lower_triangular(&design)?;
        let seen = whitener.solve_lower_triangular(&seen)?;
        let mut information = design.tr_mul(&design);
        for k in (0..TERMS).filter(|k| !inside(*k)) {
            information[(k, k)] = 1.0;
        }
        let scale = information.diagonal().map(|d| 1.0 / libm::sqrt(d));
        let scaled = Information::from_fn(|r, c| information[(r, c)] * scale[r] * scale[c]);
        let factor = Cholesky::new(scaled)?;
        let right = design.tr_mul(&seen).component_mul(&scale);
        let terms = factor.solve(&right).component_mul(&scale);
        let inverse = factor.inverse();
        let off = seen - design * terms;
        let chi_square = off.norm_squared();
        Some(Fit {
            set,
            terms: core::array::from_fn(|k| if inside(k) { terms[k] } else { 0.0 }),
            covariance: Information::from_fn(|r, c| inverse[(r, c)] * scale[r] * scale[c]),
            chi_square,
            cost: chi_square + spread,
        })
    }
}
