//! Correlation of two signals as a function of the lag.

/// Longest autocorrelation that is considered, s, and largest number of products.
const MAX_MEMORY_S: f64 = 5.0;
const MAX_PRODUCTS: usize = 200_000_000;

/// Correlation of pairs, those that are not numbers left out; `None` of fewer than `least`.
pub(crate) fn correlation(pairs: impl Iterator<Item = (f64, f64)>, least: usize) -> Option<f64> {
    let (mut n, mut x, mut y, mut xx, mut xy, mut yy) = (0_usize, 0.0, 0.0, 0.0, 0.0, 0.0);
    for (p, q) in pairs.filter(|(p, q)| p.is_finite() && q.is_finite()) {
        n += 1;
        x += p;
        y += q;
        xx += p * p;
        xy += p * q;
        yy += q * q;
    }
    if n < least.max(2) {
        return None;
    }
    let n = n as f64;
    let (xx, xy, yy) = (xx - x * x / n, xy - x * y / n, yy - y * y / n);
    (xx > 0.0 && yy > 0.0).then(|| xy / (xx * yy).sqrt())
}

/// The overlap when b is shifted by `lag`.
fn overlap<'a>(a: &'a [f64], b: &'a [f64], lag: i64) -> (&'a [f64], &'a [f64]) {
    let from = |values: &'a [f64], lag: i64| values.get(lag.max(0) as usize..).unwrap_or_default();
    (from(a, lag), from(b, -lag))
}

fn at_lag(a: &[f64], b: &[f64], lag: i64, least: usize) -> Option<f64> {
    let (a, b) = overlap(a, b, lag);
    correlation(a.iter().copied().zip(b.iter().copied()), least)
}

/// The correlation at every lag.
pub(crate) fn scores(a: &[f64], b: &[f64], least: usize) -> Vec<(f64, i64)> {
    (-(b.len() as i64)..=a.len() as i64)
        .filter_map(|lag| Some((at_lag(a, b, lag, least)?, lag)))
        .collect()
}

pub(crate) struct Best {
    pub score: f64,
    pub lag: f64,
}

/// The best lag within `reach` of `around`, interpolated between points.
pub(crate) fn refine(a: &[f64], b: &[f64], around: i64, reach: i64) -> Option<Best> {
    let score = |lag: i64| at_lag(a, b, lag, 8);
    let (peak, lag) = (around - reach..=around + reach)
        .filter_map(|lag| Some((score(lag)?, lag)))
        .max_by(|x, y| x.0.total_cmp(&y.0))?;
    let shift = match (score(lag - 1), score(lag + 1)) {
        (Some(before), Some(behind)) => {
            let bend = before - 2.0 * peak + behind;
            if bend < 0.0 { (0.5 * (before - behind) / bend).clamp(-0.5, 0.5) } else { 0.0 }
        }
        _ => 0.0,
    };
    Some(Best { score: peak, lag: lag as f64 + shift })
}

/// By how many standard deviations the correlation of the overlap, with b shifted by `lag`, exceeds
/// chance: Fisher's transformation, with the number of independent values, which follows from the length of the motion
/// and its autocorrelation; rest before and after a short motion does not count.
pub(crate) fn deviations(a: &[f64], b: &[f64], lag: i64, step: f64) -> f64 {
    let (x, y) = overlap(a, b, lag);
    let count = x.len().min(y.len());
    let about_mean = |values: &[f64]| -> Vec<f64> {
        let mean = values.iter().take(count).sum::<f64>() / count.max(1) as f64;
        values.iter().take(count).map(|v| v - mean).collect()
    };
    let (x, y) = (about_mean(x), about_mean(y));
    let product = |p: &[f64], q: &[f64]| p.iter().zip(q).map(|(p, q)| p * q).sum::<f64>();
    let (xx, yy) = (product(&x, &x), product(&y, &y));
    let energies: f64 = x.iter().zip(&y).map(|(p, q)| (p * q).powi(2)).sum();
    if !(xx > 0.0 && yy > 0.0 && energies > 0.0) {
        return 0.0;
    }
    let moving = xx * yy / energies;
    let memory = ((MAX_MEMORY_S / step) as usize)
        .min(MAX_PRODUCTS / count.max(1))
        .min(count.saturating_sub(1));
    let shared: f64 = (1..=memory)
        .map(|later| product(&x[later..], &x) / xx * product(&y[later..], &y) / yy)
        .sum();
    let independent = moving / (1.0 + 2.0 * shared).max(1.0);
    let score = (product(&x, &y) / (xx * yy).sqrt()).min(1.0 - 1e-6);
    score.atanh() * independent.sqrt()
}
