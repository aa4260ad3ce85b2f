//! The lag of two signals: the one correlation, and the one search for an offset of greatest likelihood.

use crate::series::{Interp, Ns, Series};

/// Largest rate at which signals are compared, Hz.
const MAX_RATE_HZ: f64 = 200.0;
/// Largest number of points of the search over all lags.
const COARSE_POINTS: usize = 4000;
/// Shortest motion, s: over longer points the standard deviation is compared instead of the mean.
const SHORT_S: f64 = 0.1;
/// Distance of an offset from the best one from which its correlation counts as that of another motion, s.
const NEAR_S: f64 = 1.0;
/// Fewest pairs of a correlation.
const FEWEST: usize = 8;
/// Longest autocorrelation that is considered, s, and largest number of products.
const MAX_MEMORY_S: f64 = 5.0;
const MAX_PRODUCTS: usize = 200_000_000;

/// Where a lag is looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Search {
    /// Middle of the offsets, s.
    pub around_s: f64,
    /// Largest distance from it, s.
    pub reach_s: f64,
    /// Shortest overlap of both signals, s.
    pub overlap_s: f64,
}

/// The lag of the largest correlation.
#[derive(Clone, Debug, PartialEq)]
pub struct Lag {
    /// To be added to the times of the second signal, s.
    pub offset_s: f64,
    /// Its standard deviation, s.
    pub sd_s: f64,
    /// The same without interpolation between the points that were compared, s.
    pub grid_offset_s: f64,
    /// Correlation there.
    pub correlation: f64,
    /// By how many standard deviations the correlation exceeds chance.
    pub deviations: f64,
    /// Interval at which the signals were compared, s.
    pub step_s: f64,
    /// By how much the largest correlation of the search exceeds that at offsets more than a second away: small where the motion
    /// repeats itself.
    pub lead: f64,
    /// Offsets of the search and their correlations.
    scores: Vec<(f64, f64)>,
}

impl Lag {
    /// The largest correlation of the search at offsets up to so many seconds.
    pub fn best_within(&self, reach_s: f64) -> f64 {
        let near = self.scores.iter().filter(|(offset_s, _)| offset_s.abs() <= reach_s);
        near.fold(f64::NEG_INFINITY, |most, (_, score)| most.max(*score))
    }
}

/// The lag of two signals, found at all offsets on a coarse grid, then refined between points of a fine one. `None` where they do
/// not overlap enough, or one does not change.
pub fn lag(a: &Series<f64>, b: &Series<f64>, search: &Search) -> Option<Lag> {
    let step_s = a.period_s().max(b.period_s()).max(1.0 / MAX_RATE_HZ);
    let fine = [Grid::of(a, step_s)?, Grid::of(b, step_s)?];
    let longest = fine[0].values.len().max(fine[1].values.len());
    let fold = longest.div_ceil(COARSE_POINTS).max(1);
    let coarse = fine.each_ref().map(|grid| grid.folded(fold));
    let apart_s = fine[0].start.since_s(fine[1].start);
    let offset_s = |lag: f64, step_s: f64| apart_s + lag * step_s;
    let least = ((search.overlap_s / coarse[0].step_s).ceil() as usize).max(FEWEST);
    let ends = -(coarse[1].values.len() as i64)..=coarse[0].values.len() as i64;
    let scores: Vec<(f64, f64, i64)> = ends
        .filter_map(|lag| {
            let offset_s = offset_s(lag as f64, coarse[0].step_s);
            let is_near = (offset_s - search.around_s).abs() <= search.reach_s;
            let score = is_near.then(|| correlation(&coarse, lag, least))?;
            Some((offset_s, score?, lag))
        })
        .collect();
    let (at_s, best, lag) = scores.iter().copied().max_by(|x, y| x.1.total_cmp(&y.1))?;
    // Neighbours fit too.
    let away = scores.iter().filter(|score| (score.0 - at_s).abs() > NEAR_S + coarse[0].step_s);
    let second = away.fold(-1.0, |most: f64, score| most.max(score.1));
    let peak = Peak::of(&fine, lag * fold as i64, fold as i64 + 1)?;
    let independent = independent(&fine, peak.lag.round() as i64);
    let rho = peak.correlation.clamp(1e-6, 1.0 - 1e-6);
    let information = independent * rho * peak.bend / (1.0 - rho * rho);
    Some(Lag {
        offset_s: offset_s(peak.lag, step_s),
        sd_s: step_s * (1.0 / information.max(1e-12)).sqrt(),
        grid_offset_s: offset_s(peak.point as f64, step_s),
        correlation: peak.correlation,
        deviations: peak.correlation.min(1.0 - 1e-6).atanh() * independent.sqrt(),
        step_s,
        lead: best - second,
        scores: scores.into_iter().map(|(offset_s, score, _)| (offset_s, score)).collect(),
    })
}

/// Values at equal steps, less their mean; not numbers in gaps.
struct Grid {
    start: Ns,
    step_s: f64,
    values: Vec<f64>,
}

impl Grid {
    fn of(series: &Series<f64>, step_s: f64) -> Option<Self> {
        let [start, end] = series.span()?;
        let count = (end.since_s(start) / step_s) as usize;
        let times = (0..=count).map(|k| start.after_s(k as f64 * step_s));
        let values = series.on(times, Interp::Linear).map(|at| at.map_or(f64::NAN, |at| at.value));
        let mut values: Vec<f64> = values.collect();
        let mean = mean(&values);
        values.iter_mut().for_each(|value| *value -= mean);
        Some(Self { start, step_s, values })
    }

    /// The mean of each `fold` points, or, where these are longer than a motion, their standard deviation.
    fn folded(&self, fold: usize) -> Self {
        let step_s = self.step_s * fold as f64;
        let is_short = fold == 1 || step_s <= SHORT_S;
        let of = |part: &[f64]| {
            let middle = mean(part);
            let square = |v: &f64| (v - middle).powi(2);
            if is_short { middle } else { mean(&Vec::from_iter(part.iter().map(square))).sqrt() }
        };
        let values = self.values.chunks_exact(fold).map(of).collect();
        Self { start: self.start, step_s, values }
    }
}

/// Mean of the numbers; not a number without any.
fn mean(values: &[f64]) -> f64 {
    let finite = || values.iter().filter(|value| value.is_finite());
    finite().sum::<f64>() / finite().count() as f64
}

/// The overlap when b is shifted by `lag` points.
fn overlap<'a>(grids: &'a [Grid; 2], lag: i64) -> impl Iterator<Item = (f64, f64)> + Clone + 'a {
    let from = |k: usize, lag: i64| {
        grids[k].values.get(lag.max(0) as usize..).unwrap_or_default().iter().copied()
    };
    from(0, lag).zip(from(1, -lag))
}

/// Correlation of the overlap, what is not a number left out; `None` of fewer pairs than `least`.
fn correlation(grids: &[Grid; 2], lag: i64, least: usize) -> Option<f64> {
    let (mut n, mut x, mut y, mut xx, mut xy, mut yy) = (0_usize, 0.0, 0.0, 0.0, 0.0, 0.0);
    for (p, q) in overlap(grids, lag).filter(|(p, q)| p.is_finite() && q.is_finite()) {
        n += 1;
        x += p;
        y += q;
        xx += p * p;
        xy += p * q;
        yy += q * q;
    }
    if n < least {
        return None;
    }
    let n = n as f64;
    let (xx, xy, yy) = (xx - x * x / n, xy - x * y / n, yy - y * y / n);
    (xx > 0.0 && yy > 0.0).then(|| xy / (xx * yy).sqrt())
}

/// The best lag within a few points, interpolated.
struct Peak {
    correlation: f64,
    point: i64,
    lag: f64,
    /// Second difference of the correlation there, negated.
    bend: f64,
}

impl Peak {
    fn of(grids: &[Grid; 2], around: i64, reach: i64) -> Option<Self> {
        let score = |lag: i64| correlation(grids, lag, FEWEST);
        let (peak, lag) = (around - reach..=around + reach)
            .filter_map(|lag| Some((score(lag)?, lag)))
            .max_by(|x, y| x.0.total_cmp(&y.0))?;
        let (before, after) = (score(lag - 1).unwrap_or(peak), score(lag + 1).unwrap_or(peak));
        let bend = 2.0 * peak - before - after;
        let shift = if bend > 0.0 { 0.5 * (after - before) / bend } else { 0.0 };
        let shifted = lag as f64 + shift.clamp(-0.5, 0.5);
        Some(Self { correlation: peak, point: lag, lag: shifted, bend })
    }
}

/// Number of independent values of the overlap, which follows from the length of the motion and its autocorrelation: rest before
/// and after a short motion does not count.
fn independent(grids: &[Grid; 2], lag: i64) -> f64 {
    let pairs = overlap(grids, lag).filter(|(p, q)| p.is_finite() && q.is_finite());
    let (mut x, mut y): (Vec<f64>, Vec<f64>) = pairs.unzip();
    for values in [&mut x, &mut y] {
        let mean = mean(values);
        values.iter_mut().for_each(|value| *value -= mean);
    }
    let product = |p: &[f64], q: &[f64]| p.iter().zip(q).map(|(p, q)| p * q).sum::<f64>();
    let (xx, yy) = (product(&x, &x), product(&y, &y));
    let energies: f64 = x.iter().zip(&y).map(|(p, q)| (p * q).powi(2)).sum();
    if !(xx > 0.0 && yy > 0.0 && energies > 0.0) {
        return 0.0;
    }
    let memory = ((MAX_MEMORY_S / grids[0].step_s) as usize)
        .min(MAX_PRODUCTS / x.len().max(1))
        .min(x.len().saturating_sub(1));
    let shared: f64 = (1..=memory)
        .map(|later| product(&x[later..], &x) / xx * product(&y[later..], &y) / yy)
        .sum();
    xx * yy / energies / (1.0 + 2.0 * shared).max(1.0)
}

/// The offset of greatest likelihood.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Likeliest {
    /// s.
    pub offset_s: f64,
    /// Its standard deviation, s, by the curvature of the log-likelihood.
    pub sd_s: f64,
    /// By how much the log-likelihood is greater than where the search began.
    pub gain: f64,
}

/// Climbs from an offset, s, in steps that are halved from the first to the last of `steps_s`, at most `reach_s` away, and takes
/// the vertex of the parabola through the greatest log-likelihood and those a step beside it. `None` without a maximum there.
pub(crate) fn likeliest(
    from_s: f64,
    [mut step_s, last_step_s]: [f64; 2],
    reach_s: f64,
    mut log_likelihood: impl FnMut(f64) -> Option<f64>,
) -> Option<Likeliest> {
    let first = log_likelihood(from_s)?;
    let (mut at_s, mut most) = (from_s, first);
    loop {
        let [before, after] = [log_likelihood(at_s - step_s)?, log_likelihood(at_s + step_s)?];
        if before.max(after) > most {
            most = before.max(after);
            at_s += if before > after { -step_s } else { step_s };
            if (at_s - from_s).abs() > reach_s {
                return None;
            }
        } else if step_s > last_step_s {
            step_s *= 0.5;
        } else {
            let bend = 2.0 * most - before - after;
            let off = 0.5 * (after - before) / bend;
            return (bend > 0.0).then(|| Likeliest {
                offset_s: at_s + step_s * off,
                sd_s: step_s / bend.sqrt(),
                gain: most - first + 0.25 * (after - before) * off,
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::likeliest;

    #[test]
    fn the_likeliest_offset_is_the_vertex_with_its_standard_deviation() {
        let log_likelihood = |offset_s: f64| Some(-0.5 * ((offset_s - 0.133) / 0.004).powi(2));
        for (from_s, steps_s) in [(0.0, [0.02, 0.02]), (1.0, [0.25, 0.03]), (0.13, [0.01, 0.01])] {
            let found = likeliest(from_s, steps_s, 2.0, log_likelihood).unwrap();
            assert!((found.offset_s - 0.133).abs() < 1e-9, "{found:?}");
            assert!((found.sd_s - 0.004).abs() < 1e-9, "{found:?}");
            let gain = 0.5 * ((from_s - 0.133) / 0.004_f64).powi(2);
            assert!((found.gain - gain).abs() < 1e-6 * gain.max(1.0), "{found:?}");
        }
        assert_eq!(likeliest(0.0, [0.02; 2], 0.05, log_likelihood), None, "beyond the reach");
        assert_eq!(likeliest(0.0, [0.02; 2], 1.0, |offset_s| Some(offset_s.abs())), None);
    }
}
