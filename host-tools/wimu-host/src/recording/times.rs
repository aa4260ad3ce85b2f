//! Sample rate and gaps from the times of a file's rows.

/// A longer time between two rows is a break, not a sample period, ns.
pub(crate) const BREAK_NS: i64 = 1_000_000_000;
/// Rows on either side of a step by which a gap is judged.
pub(crate) const REACH: usize = 128;
/// Fewest missing samples of a gap: fewer may be a delayed time stamp.
const MIN_MISSING: f64 = 3.0;

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
        let mut period = self.usual_step_ns().or(self.period_ns(&[]))?;
        let mut gaps = Vec::new();
        // Gaps are excluded from the period of the next pass.
        for _ in 0..3 {
            gaps = self.gaps(period);
            period = self.period_ns(&gaps)?;
        }
        Some((1e9 / period, gaps))
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

#[cfg(test)]
mod tests {
    use super::*;

    fn of(times_ms: impl IntoIterator<Item = i64>) -> (f64, Vec<usize>) {
        let times: Vec<i64> = times_ms.into_iter().map(|ms| ms * 1_000_000).collect();
        rate_and_gaps(&times).unwrap()
    }

    #[test]
    fn a_pause_is_found_and_is_no_part_of_the_rate() {
        for pause in [40, 100, 900, 1000, 1_200_000] {
            let times = (0..2000).map(|k| 10 * k + if k < 700 { 0 } else { pause });
            assert_eq!(of(times), (100.0, vec![700]), "{pause} ms");
        }
        let often = (0..5000).map(|k| 10 * k + 200 * (k / 50));
        let (rate, gaps) = of(often);
        assert!((rate - 100.0).abs() < 1e-9, "{rate}");
        assert_eq!(gaps, (1..100).map(|k| 50 * k).collect::<Vec<_>>());
    }

    #[test]
    fn a_few_late_rows_bursts_and_coarse_times_are_no_pause() {
        let late = (0..1000).map(|k| 10 * k + if k % 97 == 5 { 25 } else { 0 });
        assert!(of(late).1.is_empty(), "late");
        // Rows that come sixteen at a time, and rows stamped with whole seconds.
        let bursts = (0..4000).map(|k| 160 * (k / 16) + k % 16 / 8);
        assert!(of(bursts).1.is_empty(), "bursts");
        let seconds = (0..4000).map(|k| k / 100 * 1000);
        assert!(of(seconds).1.is_empty(), "seconds");
        // A reader that was held up and then made up for it.
        let held_up = (0..1000).map(|k| if (500..540).contains(&k) { 5400 } else { 10 * k });
        assert!(of(held_up).1.is_empty(), "held_up");
        let slower = (0..2000).map(|k| if k < 1000 { 5 * k } else { 10 * k - 5000 });
        assert!(of(slower).1.is_empty(), "slower");
    }

    #[test]
    fn a_pause_among_bursts_is_found() {
        let pause = |k: i64| if k < 2000 { 0 } else { 60_000 };
        let (rate, gaps) = of((0..4000).map(|k| 160 * (k / 16) + pause(k)));
        assert!((rate - 100.0).abs() < 1.0, "{rate}");
        assert_eq!(gaps, [2000]);
    }

    #[test]
    fn times_that_tell_no_rate_say_so() {
        for times in [vec![], vec![5], vec![7; 9], vec![0, 5_000_000_000]] {
            assert_eq!(rate_and_gaps(&times), None);
        }
        let far = [i64::MIN, i64::MIN + 1, i64::MAX - 1, i64::MAX];
        assert_eq!(rate_and_gaps(&far), Some((1e9, vec![2])));
    }
}
