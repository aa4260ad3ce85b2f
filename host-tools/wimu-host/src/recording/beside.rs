//! Values of a track at the times of another one.

use super::Track;

/// Largest distance of two rows between which values are interpolated, in median steps: one missing row.
const MOST_STEPS: f64 = 2.5;

/// A track that is read at the rows of another one, in their order.
#[derive(Clone, Debug)]
pub(crate) struct Beside<'a> {
    track: &'a Track,
    /// Whether both have the same rows, as in a table: then the values are those of the row.
    same_rows: bool,
    most_between_ns: i64,
    /// The last valid row at or before the time.
    before: Option<usize>,
    /// The first row after the time.
    next: usize,
    /// The first valid row from `next` on.
    after: usize,
}

impl Track {
    /// This track at the rows of `other`.
    pub(crate) fn beside(&self, other: &Track) -> Beside<'_> {
        let step_ns = self.median_step_s().unwrap_or(0.0) * 1e9;
        Beside {
            track: self,
            same_rows: self.times_ns == other.times_ns,
            most_between_ns: (MOST_STEPS * step_ns) as i64,
            before: None,
            next: 0,
            after: 0,
        }
    }
}

impl<'a> Beside<'a> {
    fn valid(&self, row: usize) -> Option<&'a [f64]> {
        self.track.row(row).filter(|_| self.track.valid[row])
    }

    /// Whether a valid row was passed.
    fn advance(&mut self, time_ns: i64) -> bool {
        let (times, valid) = (&self.track.times_ns, &self.track.valid);
        let mut passed = false;
        while times.get(self.next).is_some_and(|time| *time <= time_ns) {
            if valid[self.next] {
                (self.before, passed) = (Some(self.next), true);
            }
            self.next += 1;
        }
        self.after = self.after.max(self.next);
        while valid.get(self.after) == Some(&false) {
            self.after += 1;
        }
        passed
    }

    /// The last values at or before a row and after the row of the previous call.
    pub fn latest(&mut self, row: usize, time_ns: i64) -> Option<&'a [f64]> {
        match self.same_rows {
            true => self.valid(row),
            false => self.advance(time_ns).then(|| self.valid(self.before?))?,
        }
    }

    /// The values at a row: linear between the two valid rows around, if at most one is missing between them.
    pub fn at<const N: usize>(&mut self, row: usize, time_ns: i64) -> Option<[f64; N]> {
        if self.same_rows {
            return self.valid(row)?.try_into().ok();
        }
        self.advance(time_ns);
        let before = self.before?;
        let from: [f64; N] = self.track.row(before)?.try_into().ok()?;
        let from_ns = self.track.times_ns[before];
        if from_ns == time_ns {
            return Some(from);
        }
        let to: [f64; N] = self.track.row(self.after)?.try_into().ok()?;
        let between_ns = self.track.times_ns[self.after].saturating_sub(from_ns);
        let share = time_ns.saturating_sub(from_ns) as f64 / between_ns as f64;
        (between_ns <= self.most_between_ns)
            .then(|| std::array::from_fn(|k| from[k] + share * (to[k] - from[k])))
    }
}
