//! Times of sampling from times of arrival.

use super::unit::median_step_s;
use crate::stats::median;

/// Steps that differ from the median by more than this fraction are uneven, ...
const UNEVEN: f64 = 0.3;
/// ... and more than this fraction of uneven steps are those of times of arrival: a sensor's own clock is even.
const UNEVEN_FRACTION: f64 = 0.2;
/// Samples over which the period is measured for the search of losses.
const PERIOD_SAMPLES: usize = 64;
/// Samples before and after one among which the least delay counts. After: a backlog at the start of a recording is
/// sent at once, and its delay decays over hundreds of samples.
const BEFORE: usize = 300;
const AFTER: usize = 600;
/// Deviation of the times found, s: measured on the robot-arm recordings.
pub(crate) const TIME_SD_S: f64 = 1e-3;

/// The times at which samples were taken, s, if `times_s` are those at which they arrived: a constant period, and the
/// least delay nearby. `None` where the times are even.
///
/// A pause after which the delay does not fall again is a loss of
/// samples, and both sides of it are treated apart.
pub fn sampled_times(times_s: &[f64]) -> Option<Vec<f64>> {
    let usual = median_step_s(times_s);
    let uneven = |w: &&[f64]| (w[1] - w[0] - usual).abs() > UNEVEN * usual;
    let count = times_s.windows(2).filter(uneven).count();
    if times_s.len() <= 2 * PERIOD_SAMPLES
        || (count as f64) < UNEVEN_FRACTION * times_s.len() as f64
    {
        return None;
    }
    let slope = |w: &[f64]| (w[PERIOD_SAMPLES] - w[0]) / PERIOD_SAMPLES as f64;
    let about_s = median(times_s.windows(PERIOD_SAMPLES + 1).map(slope))?;
    let parts = parts(times_s, about_s);
    Some(parts.into_iter().flat_map(|part| of_part(&times_s[part], about_s)).collect())
}

/// The times of samples without a loss among them.
fn of_part(times_s: &[f64], about_s: f64) -> Vec<f64> {
    let found = with_period(times_s, about_s);
    // Over a quarter of the samples the period is exact, and a backlog at the start is in fewer than half of the slopes.
    let apart = (times_s.len() / 4).max(1);
    let slope = |w: &[f64]| (w[apart] - w[0]) / apart as f64;
    match median(found.windows(apart + 1).map(slope)) {
        Some(period_s) => with_period(times_s, period_s),
        None => found,
    }
}

/// Times with this period and the least delay nearby.
fn with_period(times_s: &[f64], period_s: f64) -> Vec<f64> {
    let delays = delays(times_s, period_s);
    let count = delays.len();
    let near =
        |k: usize, before: usize, after: usize| k.saturating_sub(before)..(k + after).min(count);
    let least: Vec<f64> = (0..count)
        .map(|k| {
            let nearby = delays[near(k, BEFORE, AFTER)].iter().copied();
            nearby.fold(f64::INFINITY, f64::min)
        })
        .collect();
    let time = |k: usize| {
        let nearby = &least[near(k, BEFORE / 2, BEFORE / 2 + 1)];
        k as f64 * period_s + nearby.iter().sum::<f64>() / nearby.len() as f64
    };
    (0..count).map(time).collect()
}

/// Times after multiples of a period.
fn delays(times_s: &[f64], period_s: f64) -> Vec<f64> {
    let delay = |(k, t): (u32, &f64)| t - f64::from(k) * period_s;
    (0_u32..).zip(times_s).map(delay).collect()
}

/// Runs between losses: after one the delay stays higher by three periods and more than it was just before.
fn parts(times_s: &[f64], period_s: f64) -> Vec<std::ops::Range<usize>> {
    let delays = delays(times_s, period_s);
    let least = |part: &[f64]| part.iter().copied().fold(f64::INFINITY, f64::min);
    let (mut parts, mut first) = (Vec::new(), 0);
    for k in 1..delays.len() {
        if delays[k] - delays[k - 1] < 3.0 * period_s || k - first < PERIOD_SAMPLES {
            continue;
        }
        let before = least(&delays[k - PERIOD_SAMPLES..k]);
        let after = least(&delays[k..(k + AFTER).min(delays.len())]);
        if after - before > 3.0 * period_s {
            parts.push(first..k);
            first = k;
        }
    }
    parts.push(first..delays.len());
    parts
}
