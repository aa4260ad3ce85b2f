//! From an Allan deviation to the terms of noise: equation (53).

use nalgebra::{Cholesky, Const, SMatrix, SVector};

use super::{Measured, POINTS, cluster};
use crate::student;

/// 2 ln 2 / π: flicker noise of B² has this Allan variance.
const FLICKER: f64 = 0.441_271_200_305_303_2;
/// A term is there when it lowers −2 ln of the likelihood by more than this.
const WORTH: f64 = 10.0;
/// A set with one term less is as likely with this much more.
const LIKELY: f64 = 9.0;
/// By how much sets without a term must be worse for it to be told; and where they have a ramp
/// in the place of K, which is as long a curve's other way to rise.
const SEEN: f64 = 10.0;
const SEEN_BESIDE_RAMP: f64 = 1.0;
/// Kinds of noise: Q, N, B, K.
const NOISES: usize = 4;
/// Pairs of them.
const PRODUCTS: usize = NOISES * (NOISES + 1) / 2;
/// Terms: those, and the ramp R.
const TERMS: usize = 5;
const QUANTISATION: usize = 0;
const WHITE: usize = 1;
const WALK: usize = 3;
const RAMP: usize = 4;
/// Points up to this many octaves apart are known to be correlated; beyond, they hardly are.
const OCTAVES: usize = 6;
/// Rounds of weights by what was fitted the round before.
const ROUNDS: usize = 8;
/// A filter takes at least this share from the first point.
const FILTERED: f64 = 0.1;
/// Points beside the terms that a curve without its first ones needs.
const SPARE: usize = 2;
/// Least share of a variance that is each point's own.
const OWN: f64 = 1e-6;

type Information = SMatrix<f64, TERMS, TERMS>;
type Weights = Cholesky<f64, Const<POINTS>>;

/// Degrees of freedom of σ²(τ) of `n` samples in clusters of `m`: the fewest of white, flicker and
/// random-walk noise.
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

/// What Q², N², B², K² and R² add to the Allan variance at τ: equation (53).
fn shares(tau_s: f64) -> [f64; TERMS] {
    let square = tau_s * tau_s;
    [
        3.0 / square,
        1.0 / tau_s,
        FLICKER,
        tau_s / 3.0,
        square / 2.0,
    ]
}

fn total(terms: &[f64; TERMS], tau_s: f64) -> f64 {
    terms.iter().zip(shares(tau_s)).map(|(t, x)| t * x).sum()
}

/// Generalised covariances of the running sum at a distance of `t` samples, of Q² f², N² f, B²/2π
/// and K²/12f: whatever fourth differences leave.
fn covariances(t: i64) -> [f64; NOISES] {
    let far = t.unsigned_abs() as f64;
    let quantised = if t == 0 { 1.0 } else { 0.0 };
    let flicker = if t == 0 {
        0.0
    } else {
        far * far * libm::log(far)
    };
    [quantised, -0.5 * far, flicker, far * far * far]
}

/// Σ over all pairs of second differences at two averaging times of the products of their
/// covariances by the terms of noise: what decides how well points are known, and how much of it
/// they share.
pub(super) struct Spans {
    /// By the shorter averaging time, how many octaves longer the other is, and pair of terms.
    sums: [[[f64; PRODUCTS]; OCTAVES]; POINTS],
}

impl Spans {
    /// For an unbroken run of `samples`, and `counts` second differences at each averaging time in
    /// all runs.
    pub(super) fn new(samples: u64, counts: &[f64; POINTS]) -> Self {
        let samples = i64::try_from(samples).unwrap_or(i64::MAX / 4);
        // Step between differences, and how many there are in the run.
        let step = |place: usize| (cluster(place) / 8).max(1) as i64;
        let differences = |place: usize| {
            let left = samples - 2 * cluster(place) as i64;
            if left < 0 { 0 } else { left / step(place) + 1 }
        };
        let mut sums = [[[0.0; PRODUCTS]; OCTAVES]; POINTS];
        for octaves in 0..OCTAVES {
            // Averaging times of 8 samples and more are as that of 8, but for their scale.
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
                        // Pairs of differences that are so far apart.
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
                // What other runs add makes it better known.
                let runs = n[1] / all.max(1.0);
                let scale = m / cluster(place.min(3)) as f64;
                let per = runs / (2.0 * m * m * long * long * n[0] * n[1]);
                let mut pair = 0;
                for a in 0..NOISES {
                    for b in a..NOISES {
                        let power = libm::pow(scale, (a + b) as f64);
                        let twice = if a == b { 1.0 } else { 2.0 };
                        sums[pair] *= twice * power * per;
                        pair += 1;
                    }
                }
            }
        }
        Self { sums }
    }

    /// Covariance of the Allan variances at two averaging times.
    fn covariance(&self, short: usize, long: usize, terms: &[f64; NOISES]) -> f64 {
        let sums = self.sums.get(short).and_then(|s| s.get(long - short));
        let mut products = sums.into_iter().flatten();
        let mut covariance = 0.0;
        for a in 0..NOISES {
            for b in a..NOISES {
                covariance += terms[a] * terms[b] * products.next().unwrap_or(&0.0);
            }
        }
        covariance
    }
}

/// Products of the covariances of two second differences, of `short` and `long` samples and `lag`
/// apart, for each pair of terms.
fn products(lag: i64, short: i64, long: i64) -> [f64; PRODUCTS] {
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
    let mut products = [0.0; PRODUCTS];
    let mut pair = 0;
    for a in 0..NOISES {
        for b in a..NOISES {
            products[pair] = found[a] * found[b];
            pair += 1;
        }
    }
    products
}

/// The points of an axis.
#[derive(Clone, Copy)]
pub(super) struct Curve {
    rate_hz: f64,
    /// Of the longest unbroken run.
    samples: f64,
    variance: SVector<f64, POINTS>,
    edf: SVector<f64, POINTS>,
    /// Places from this one on, up to but without `used`.
    from: usize,
    used: usize,
}

/// What a curve says.
pub(super) struct Fitted {
    /// Terms and their standard deviations, `None` for those that are not seen.
    pub(super) terms: [Option<Measured>; TERMS],
    /// χ² per degree of freedom.
    pub(super) misfit: f64,
    /// Averaging time that they are from on, where the output is filtered, s.
    pub(super) white_from_s: Option<f64>,
}

/// A set of terms, as bits, their values, and their covariance.
#[derive(Clone, Copy)]
struct Fit {
    set: u32,
    terms: [f64; TERMS],
    covariance: Information,
    chi_square: f64,
    /// −2 ln of its likelihood, up to a constant.
    cost: f64,
}

/// The likeliest terms, and whether what they leave of the curve may be chance.
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

    /// Of the whole curve; or, where no terms explain that and it begins below white noise, of what
    /// is beyond a low-pass filter.
    pub(super) fn fit(&self, spans: &Spans) -> Option<Fitted> {
        let whole = self.likeliest(spans)?;
        let filtered = (!whole.is_by_chance).then(|| self.beyond_filter(spans));
        Some(filtered.flatten().unwrap_or(whole.fitted))
    }

    /// Beyond its memory, white noise that was filtered has the variance N²/τ − C/τ²: N is from the
    /// shortest averaging time that explains the rest, and one octave beyond.
    fn beyond_filter(&self, spans: &Spans) -> Option<Fitted> {
        let last = self.used.checked_sub(2 + SPARE)?;
        let beyond = |from: usize| Self { from, ..*self }.likeliest(spans);
        let first =
            (1..=last).find(|from| beyond(*from).is_some_and(|found| found.is_by_chance))?;
        let from = (first + 1).min(last);
        let found = beyond(from).filter(|found| found.is_by_chance)?;
        let white = found.fitted.terms[WHITE]?.value;
        // Hum and vibration add to white noise, a filter takes from it; and what is white at first is not filtered.
        let share = |place: usize| self.variance[place] * self.tau_s(place) / (white * white);
        let rises = share(0) < (1.0 - 0.5 * FILTERED) * share(1);
        let is_less =
            share(0) < 1.0 - FILTERED && (0..first).all(|k| share(k) < 1.0 + 2.0 * FILTERED);
        (rises && is_less).then_some(Fitted {
            white_from_s: Some(self.tau_s(from)),
            ..found.fitted
        })
    }

    /// Of all sets of terms with N and none below zero, the likeliest with a penalty per term; what other
    /// sets would say is in the standard deviations, as likely as they are. Beyond a filter 3Q² stands for
    /// what that takes, and is in all sets.
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
        // What no set of terms explains makes all of them less certain.
        let points = self.used.saturating_sub(self.from);
        let freedom = points.saturating_sub(best.set.count_ones() as usize).max(1);
        let left = best.chi_square / freedom as f64;
        let misfit = left.max(1.0);
        let worse = |fit: &Fit| {
            let cost = |fit: &Fit| fit.cost / misfit + LIKELY * f64::from(fit.set.count_ones());
            (cost(fit) - cost(best)).max(0.0)
        };
        let terms = core::array::from_fn(|k| {
            // A term is seen where no set without it does nearly as well.
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
            // A ramp in the place of K says that there is none.
            let says = |fit: &&Fit| fit.has(k) || (k == WALK && fit.has(RAMP));
            for fit in fits().filter(says) {
                let likely = libm::exp(-0.5 * worse(fit));
                let off = fit.terms[k] - best.terms[k];
                weight += likely;
                let own = if fit.has(k) {
                    misfit * fit.covariance[(k, k)]
                } else {
                    0.0
                };
                variance += likely * (own + off * off);
            }
            seen.then(|| {
                let value = libm::sqrt(best.terms[k]);
                Measured {
                    value,
                    sd: libm::sqrt(variance / weight) / (2.0 * value),
                }
            })
        });
        Some(Likeliest {
            fitted: Fitted {
                terms,
                misfit: left,
                white_from_s: None,
            },
            is_by_chance: best.chi_square <= student::chi_squared_half_percent(freedom),
        })
    }

    /// The terms of `set` by generalised least squares with the covariance of the points that they
    /// make themselves.
    fn converged(&self, set: u32, spans: &Spans) -> Option<Fit> {
        // What is expected is what was measured, and points are independent, in the first round.
        let independent = SMatrix::from_diagonal(&self.edf.map(|edf| 2.0 / edf));
        let mut fit = self.solve(set, &self.variance, &Weights::new(independent)?)?;
        for _ in 0..ROUNDS {
            let f = self.rate_hz;
            let terms = fit.terms.map(|term| term.max(0.0));
            let [q, n, b, k, r] = terms;
            let parts = [q * f * f, n * f, b / core::f64::consts::TAU, k / (12.0 * f)];
            // What a filter takes is part of what is expected, and no noise.
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

    /// Standard deviation of a point from noise that does not part from the ramp R² over the recording:
    /// the variance of the mean of its differences is 4/3 (m/(n − 2m))² of their Allan variance. Two points
    /// share 3/2 (m/M)^(3/2) of it: white noise at the ends of the recording, weighted by triangles.
    fn beside_ramp(&self, place: usize, square: f64, expected: f64) -> f64 {
        let tau = self.tau_s(place);
        let ramp = square * tau * tau;
        let noise = (expected - 0.5 * ramp).max(0.0);
        let m = cluster(place) as f64;
        let share = m / (self.samples - 2.0 * m).max(1.0);
        share * libm::sqrt(ramp * noise * 4.0 / 3.0)
    }

    /// The terms of `set`, the others 0.
    fn solve(&self, set: u32, expected: &SVector<f64, POINTS>, weights: &Weights) -> Option<Fit> {
        let inside = |k: usize| set >> k & 1 == 1;
        // As a share of the noise to be expected, which spans decades.
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
