//! Values over time: the one container of samples between which values are wanted, and the one interpolation.
//!
//! ```
//! use wimu_host::series::{Interp, Ns, Series};
//!
//! let series = Series::of((0..10).map(|k| (Ns(100 * k), (k * k) as f64)));
//! let at = series.at(Ns(450), Interp::Cubic).expect("within the series");
//! assert!((at.value - 20.25).abs() < 1e-9 && at.error < 1e-9);
//! assert!(series.at(Ns(901), Interp::Cubic).is_none());
//! ```

use std::ops::{BitOr, BitOrAssign};

use nalgebra::SVector;

use crate::stats::median;

/// Steps of more median periods than this are gaps.
const GAP_PERIODS: f64 = 2.5;

/// Keeps every second item, the first one too.
pub(crate) fn thin_out<T>(items: &mut Vec<T>) {
    let mut kept = [true, false].into_iter().cycle();
    items.retain(|_| kept.next() == Some(true));
}

/// Time of one clock, ns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Ns(pub i64);

impl Ns {
    /// Of seconds, rounded.
    pub fn from_s(seconds: f64) -> Self {
        Self((seconds * 1e9).round() as i64)
    }

    /// In seconds.
    pub fn s(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// Seconds from an earlier time to this one.
    pub fn since_s(self, earlier: Self) -> f64 {
        Self(self.0.saturating_sub(earlier.0)).s()
    }

    /// The time so many seconds later.
    #[must_use]
    pub fn after_s(self, seconds: f64) -> Self {
        Self(self.0.saturating_add(Self::from_s(seconds).0))
    }
}

/// What is known of a row beside its value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flags(u8);

impl Flags {
    /// Nothing.
    pub const NONE: Self = Self(0);
    /// An axis is at the limit of its range.
    pub const SATURATED: Self = Self(1);

    /// [`SATURATED`](Self::SATURATED), or nothing.
    pub fn saturated(is_saturated: bool) -> Self {
        if is_saturated { Self::SATURATED } else { Self::NONE }
    }

    /// Whether an axis is at its limit.
    pub fn is_saturated(self) -> bool {
        self.0 & Self::SATURATED.0 != 0
    }
}

impl BitOr for Flags {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl BitOrAssign for Flags {
    fn bitor_assign(&mut self, other: Self) {
        *self = *self | other;
    }
}

/// What can be interpolated.
pub trait Value: Copy {
    /// Sum of values whose weights add up to one.
    fn combined(terms: impl Iterator<Item = (f64, Self)>) -> Self;

    /// Largest difference of a component.
    fn distance(&self, other: &Self) -> f64;

    /// Whether all components are numbers.
    fn is_finite(&self) -> bool;
}

impl Value for f64 {
    fn combined(terms: impl Iterator<Item = (f64, Self)>) -> Self {
        terms.map(|(weight, value)| weight * value).sum()
    }

    fn distance(&self, other: &Self) -> f64 {
        (self - other).abs()
    }

    fn is_finite(&self) -> bool {
        f64::is_finite(*self)
    }
}

impl<const N: usize> Value for SVector<f64, N> {
    fn combined(terms: impl Iterator<Item = (f64, Self)>) -> Self {
        terms.map(|(weight, value)| value * weight).sum()
    }

    fn distance(&self, other: &Self) -> f64 {
        (self - other).amax()
    }

    fn is_finite(&self) -> bool {
        self.iter().all(|component| component.is_finite())
    }
}

/// Polynomial through the rows around a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interp {
    /// Through one row on each side.
    Linear,
    /// Through two.
    Cubic,
    /// Through three.
    Quintic,
}

impl Interp {
    /// Rows on each side.
    fn rows(self) -> usize {
        match self {
            Self::Linear => 1,
            Self::Cubic => 2,
            Self::Quintic => 3,
        }
    }
}

/// An interpolated value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct At<T> {
    /// The value.
    pub value: T,
    /// Error of interpolation: half the difference of the polynomials without the last and without the first row.
    pub error: f64,
    /// Flags of all rows around.
    pub flags: Flags,
}

/// Values over time. Times increase strictly; values may be not finite, and are gaps then.
#[derive(Clone, Debug, PartialEq)]
pub struct Series<T> {
    /// Times.
    pub t: Vec<Ns>,
    /// Values.
    pub v: Vec<T>,
    /// Flags.
    pub flags: Vec<Flags>,
    /// Longest step over which a straight line is drawn, s.
    gap_s: f64,
    /// Longest step that a polynomial of higher order contains, s.
    even_s: f64,
}

impl<T> Default for Series<T> {
    /// Without rows: any step is bridged.
    fn default() -> Self {
        let (t, v, flags) = (Vec::new(), Vec::new(), Vec::new());
        Self { t, v, flags, gap_s: f64::INFINITY, even_s: f64::INFINITY }
    }
}

impl<T> Series<T> {
    /// Adds a row; returns whether it is later than the last one.
    pub fn push(&mut self, t: Ns, v: T, flags: Flags) -> bool {
        let is_later = self.t.last().is_none_or(|last| t > *last);
        if is_later {
            self.t.push(t);
            self.v.push(v);
            self.flags.push(flags);
        }
        is_later
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.t.len()
    }

    /// Whether it has no rows.
    pub fn is_empty(&self) -> bool {
        self.t.is_empty()
    }

    /// First and last time; `None` without rows.
    pub fn span(&self) -> Option<[Ns; 2]> {
        Some([*self.t.first()?, *self.t.last()?])
    }

    /// Median time between rows, s; 1 s with fewer than two.
    pub fn period_s(&self) -> f64 {
        let steps = self.t.windows(2).map(|pair| pair[1].since_s(pair[0]));
        median(steps).unwrap_or(1.0).max(1e-6)
    }

    /// A longer pause between rows is one in the motion, s: 0.25 s, or four times the usual step.
    pub fn pause_s(&self) -> f64 {
        f64::max(0.25, 4.0 * self.period_s())
    }

    /// Removes rows before a time, but for the last `kept` ones of all; returns their number.
    pub fn forget_before(&mut self, time: Ns, kept: usize) -> usize {
        let old = self.t.partition_point(|t| *t < time);
        let old = old.min(self.t.len().saturating_sub(kept));
        self.t.drain(..old);
        self.v.drain(..old);
        self.flags.drain(..old);
        old
    }
}

impl<T: Value> Series<T> {
    /// Of rows in the order of time; one that is not later than the row before is left out. Steps of more than 2.5 median
    /// periods are gaps.
    pub fn of(rows: impl IntoIterator<Item = (Ns, T)>) -> Self {
        Self::flagged(rows.into_iter().map(|(t, v)| (t, v, Flags::NONE)))
    }

    /// The same of rows with flags.
    pub fn flagged(rows: impl IntoIterator<Item = (Ns, T, Flags)>) -> Self {
        let mut series = Self::default();
        for (t, v, flags) in rows {
            series.push(t, v, flags);
        }
        series.even()
    }

    /// The same where steps of more than 2.5 median periods are gaps.
    #[must_use]
    pub fn even(self) -> Self {
        let gap_s = GAP_PERIODS * self.period_s();
        Self { gap_s, even_s: gap_s, ..self }
    }

    /// The same with another longest step over which a straight line is drawn, s.
    #[must_use]
    pub fn with_gap(self, gap_s: f64) -> Self {
        Self { gap_s, ..self }
    }

    /// Other values at the same times.
    pub fn map<U: Value>(&self, value: impl FnMut(&T) -> U) -> Series<U> {
        let Self { gap_s, even_s, .. } = *self;
        let v = self.v.iter().map(value).collect();
        Series { t: self.t.clone(), v, flags: self.flags.clone(), gap_s, even_s }
    }

    /// The same values at other times, which must increase as these do.
    #[must_use]
    pub fn retimed(&self, time: impl FnMut(&Ns) -> Ns) -> Self {
        Self { t: self.t.iter().map(time).collect(), ..self.clone() }
    }

    /// The rows from a time to another.
    #[must_use]
    pub fn within(&self, [from, to]: [Ns; 2]) -> Self {
        let rows = self.t.partition_point(|t| *t < from)..self.t.partition_point(|t| *t <= to);
        let [t, v, flags] = [(); 3].map(|()| rows.clone());
        Self {
            t: self.t[t].to_vec(),
            v: self.v[v].to_vec(),
            flags: self.flags[flags].to_vec(),
            ..*self
        }
    }

    /// The last row at or before a time.
    pub fn latest(&self, time: Ns) -> Option<usize> {
        self.t.partition_point(|t| *t <= time).checked_sub(1)
    }

    /// The row that begins the interval in which a time is; `None` outside of the series and in gaps.
    pub fn interval(&self, time: Ns) -> Option<usize> {
        let before = self.latest(time)?.min(self.len().checked_sub(2)?);
        let [from, to] = [self.t[before], self.t[before + 1]];
        (time <= to && to.since_s(from) <= self.gap_s).then_some(before)
    }

    /// The value at a time. `None` outside of the series, in a gap, and next to a value that is not finite. Where some of the
    /// rows that the order needs are missing, saturated or far apart, the order is lower.
    pub fn at(&self, time: Ns, how: Interp) -> Option<At<T>> {
        let before = self.latest(time)?;
        if self.t[before] == time {
            let (value, flags) = (self.v[before], self.flags[before]);
            return value.is_finite().then_some(At { value, error: 0.0, flags });
        }
        let around =
            (before + 1).saturating_sub(how.rows())..(before + 1 + how.rows()).min(self.len());
        let flags = self.flags[around].iter().fold(Flags::NONE, |all, flags| all | *flags);
        let mut at = (1..=how.rows()).rev().filter_map(|rows| self.through(before + 1, rows, time));
        at.next().map(|(value, error)| At { value, error, flags })
    }

    /// The values at several times.
    pub fn on<'a>(
        &'a self,
        times: impl IntoIterator<Item = Ns> + 'a,
        how: Interp,
    ) -> impl Iterator<Item = Option<At<T>>> + 'a {
        times.into_iter().map(move |time| self.at(time, how))
    }

    /// The polynomial through so many rows on each side of a time before row `next`, and its error.
    fn through(&self, next: usize, rows: usize, time: Ns) -> Option<(T, f64)> {
        let used = next.checked_sub(rows)?..next + rows;
        let (times, values) = (self.t.get(used.clone())?, &self.v[used.clone()]);
        let longest_s = if rows > 1 { self.even_s.min(self.gap_s) } else { self.gap_s };
        let is_even = times.windows(2).all(|pair| pair[1].since_s(pair[0]) <= longest_s);
        let is_sound = values.iter().all(Value::is_finite)
            && (rows == 1 || !self.flags[used].iter().any(|flags| flags.is_saturated()));
        if !is_even || !is_sound {
            return None;
        }
        let away_s = |i: usize| times[i].since_s(time);
        // Lagrange's polynomial.
        let polynomial = |from: usize, to: usize| {
            let weight = |i: usize| -> f64 {
                let others = (from..to).filter(|j| *j != i);
                others.map(|j| away_s(j) / (away_s(j) - away_s(i))).product()
            };
            T::combined((from..to).map(|i| (weight(i), values[i])))
        };
        let last = 2 * rows;
        let error = 0.5 * polynomial(0, last - 1).distance(&polynomial(1, last));
        Some((polynomial(0, last), error))
    }
}
