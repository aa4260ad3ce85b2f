//! Values of a track at the times of another one.

use nalgebra::SVector;

use super::Track;
use crate::series::{Interp, Ns, Series};

/// A track of `N` values that is read at the rows of another one, in their order.
#[derive(Clone, Debug)]
pub(crate) struct Beside<'a, const N: usize> {
    track: &'a Track,
    /// The valid rows; `None` where both tracks have the same rows, as in a table: then the values are those of the row.
    series: Option<Series<SVector<f64, N>>>,
    /// The row that [`latest`](Self::latest) gave last.
    given: Option<usize>,
}

impl Track {
    /// This track at the rows of `other`.
    pub(crate) fn beside<const N: usize>(&self, other: &Track) -> Beside<'_, N> {
        let series = (self.times_ns != other.times_ns).then(|| self.series());
        Beside { track: self, series, given: None }
    }

    /// The valid rows, which have `N` values.
    pub(crate) fn series<const N: usize>(&self) -> Series<SVector<f64, N>> {
        let rows = self.valid().filter(|(_, row)| row.len() == N);
        Series::of(rows.map(|(time, row)| (Ns(time), SVector::from_row_slice(row))))
    }
}

impl<const N: usize> Beside<'_, N> {
    fn valid(&self, row: usize) -> Option<[f64; N]> {
        self.track.row(row).filter(|_| self.track.valid[row])?.try_into().ok()
    }

    /// The last values at or before a row and after the row of the previous call.
    pub fn latest(&mut self, row: usize, time_ns: i64) -> Option<[f64; N]> {
        let Some(series) = &self.series else { return self.valid(row) };
        let latest = series.latest(Ns(time_ns)).filter(|latest| Some(*latest) > self.given)?;
        self.given = Some(latest);
        Some(series.v[latest].into())
    }

    /// The values at a row: linear between the two valid rows around, if at most one is missing between them.
    pub fn at(&self, row: usize, time_ns: i64) -> Option<[f64; N]> {
        let Some(series) = &self.series else { return self.valid(row) };
        Some(series.at(Ns(time_ns), Interp::Linear)?.value.into())
    }
}
