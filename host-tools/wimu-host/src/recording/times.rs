//! Sample rate and gaps from the times of a file's rows.

use crate::stats::median;

/// A longer time between two rows is a break, not a sample period, ns.
const BREAK_NS: i64 = 1_000_000_000;
/// Rows on either side of a step by which a gap is judged.
pub(crate) const REACH: usize = 128;
/// Fewest missing samples of a gap: fewer may be a delayed time stamp.
const MIN_MISSING: f64 = 3.0;
/// Fraction of the steps that are about the median where rows are regular and single ones are missing, and how near, relative.
const REGULAR: f64 = 0.8;
const NEAR: f64 = 0.1;

/// Rate, Hz, and the rows after a gap, from the times of the rows, ns; `None` without two times within a second.
///
/// Rows whose times come in bursts, such as times of arrival, have no gaps: the delay of a gap persists in the rows
/// that follow.
pub(crate) fn rate_and_gaps(times_ns: &[i64]) -> Option<(f64, Vec<usize>)> {
    RowTimes(times_ns).rate_and_gaps()
}

/// The times of the rows, ns, in order.
struct RowTimes<'a>(&'a [i64]);

impl RowTimes<'_> {
    fn rate_and_gaps(&self) -> Option<(f64, Vec<usize>)> {
        let regular = self.regular_step_ns();
        let mut period = regular.or(self.usual_step_ns()).or(self.period_ns(&[]))?;
        let mut gaps = Vec::new();
        // Gaps are excluded from the period of the next pass.
        for _ in 0..3 {
            gaps = self.gaps(period);
            period = regular.or(self.period_ns(&gaps))?;
        }
        Some((1e9 / period, gaps))
    }

    /// Mean of the steps about the median, ns, if they are most steps and most of the time: the others have missing rows.
    fn regular_step_ns(&self) -> Option<f64> {
        let steps = self.0.windows(2).map(|pair| pair[1].saturating_sub(pair[0]) as f64);
        let steps = steps.filter(|step| *step <= BREAK_NS as f64);
        let median = median(steps.clone()).filter(|step| *step > 0.0)?;
        let near: Vec<f64> =
            steps.clone().filter(|step| (step / median - 1.0).abs() < NEAR).collect();
        let sum: f64 = near.iter().sum();
        let is_most = near.len() as f64 >= REGULAR * steps.clone().count() as f64;
        (is_most && 2.0 * sum >= steps.sum()).then(|| sum / near.len() as f64)
    }

    /// The median step, ns, if steps of about its length are most of the time, which is not so in bursts.
    fn usual_step_ns(&self) -> Option<f64> {
        let steps = self.0.windows(2).map(|pair| pair[1].saturating_sub(pair[0]));
        let mut steps: Vec<i64> = steps.filter(|step| (0..=BREAK_NS).contains(step)).collect();
        steps.sort_unstable();
        let median = *steps.get(steps.len() / 2)?;
        let about = |step: &&i64| (median..=3 * median).contains(&(2 * **step));
        let usual: i64 = steps.iter().filter(about).sum();
        (usual > 0 && 2 * usual >= steps.iter().sum()).then_some(median as f64)
    }

    /// Mean step without breaks and `gaps`, ns.
    fn period_ns(&self, gaps: &[usize]) -> Option<f64> {
        let mut gaps = gaps.iter().peekable();
        let (mut total_ns, mut steps) = (0_i128, 0_u32);
        for (row, pair) in (1..).zip(self.0.windows(2)) {
            let step = pair[1].saturating_sub(pair[0]);
            if gaps.next_if(|gap| **gap == row).is_none() && (0..=BREAK_NS).contains(&step) {
                total_ns += i128::from(step);
                steps += 1;
            }
        }
        (total_ns > 0).then(|| total_ns as f64 / f64::from(steps))
    }

    /// Rows after a gap, at this period, ns.
    fn gaps(&self, period: f64) -> Vec<usize> {
        let times = self.0;
        let delay = |row: usize, from: usize| {
            times[row].saturating_sub(times[from]) as f64 - (row as f64 - from as f64) * period
        };
        (1..times.len())
            .filter(|row| delay(*row, row - 1) >= MIN_MISSING * period)
            .filter(|row| {
                let before = row.saturating_sub(REACH)..*row;
                let after = *row..times.len().min(row + REACH);
                let latest = before.map(|k| delay(k, row - 1)).fold(0.0, f64::max);
                let earliest = after.map(|k| delay(k, row - 1)).fold(f64::INFINITY, f64::min);
                earliest - latest >= MIN_MISSING * period
            })
            .collect()
    }
}
