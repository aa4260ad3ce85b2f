//! A table as a signal in time.

use std::path::Path;

use wimu_model::STANDARD_GRAVITY_MPS2;

use super::{MAX_RATE, MIN_CORRELATION};
use crate::formats::{self, ReadOptions};
use crate::lag::refine;
use crate::recording::{OutputUnit, Selection};
use crate::series::period_s;
use crate::stats::norm;
use crate::{Code, Result};

/// Shortest motion, s.
const SHORT_S: f64 = 0.1;
/// Smallest relative standard deviation of the unit: the effect of a typical bias on the magnitude at rest.
const LEAST_UNIT_SD: f64 = 0.03;
/// Detection of saturation: rows for which an extreme value persists, number of such runs, and smallest step into or
/// out of a run, in multiples of the finest step.
const MIN_STAY: usize = 2;
const MIN_STOPS: usize = 2;
const STEEP: f64 = 4.0;

/// A table as a signal.
#[derive(Default)]
pub(super) struct Signal {
    /// s.
    times: Vec<f64>,
    /// m/s².
    values: Vec<[f64; 3]>,
    /// Whether an axis is saturated.
    saturated: Vec<bool>,
    /// Relative standard deviation of the unit, where it is assumed.
    pub unit_sd: Option<f64>,
}

/// Evenly sampled magnitudes, less their mean.
pub(super) struct Grid {
    pub start: f64,
    pub step: f64,
    pub values: Vec<f64>,
}

/// Rows with a saturated axis: at its largest or smallest value, where the motion stops and stays more than once.
fn saturated(values: &[[f64; 3]]) -> Vec<bool> {
    let mut saturated = vec![false; values.len()];
    for axis in 0..3 {
        let of = |row: usize| values[row][axis];
        // The finest step between two rows: within it a value may persist because of its resolution.
        let steps = values.windows(2).map(|pair| (pair[1][axis] - pair[0][axis]).abs());
        let finest = steps.filter(|step| *step > 0.0).fold(f64::MAX, f64::min);
        for sign in [1.0, -1.0] {
            let end = values.iter().map(|value| sign * value[axis]).fold(f64::MIN, f64::max);
            let at_end: Vec<usize> =
                (0..values.len()).filter(|row| sign * of(*row) == end).collect();
            let runs = at_end.chunk_by(|row, next| row + 1 == *next);
            let stops = runs.filter(|run| {
                let outside = [run[0].checked_sub(1), Some(run[run.len() - 1] + 1)];
                let steep = outside
                    .into_iter()
                    .flatten()
                    .filter(|row| *row < values.len())
                    .any(|row| (of(row) - of(run[0])).abs() > STEEP * finest);
                run.len() >= MIN_STAY && steep
            });
            if stops.count() >= MIN_STOPS {
                at_end.iter().for_each(|row| saturated[*row] = true);
            }
        }
    }
    saturated
}

impl Signal {
    /// Reads a table. In LSB, the median magnitude is taken as 1 g.
    pub fn read(path: &Path) -> Result<Signal> {
        let recording = formats::load(path, &ReadOptions::default())?;
        let samples = recording.samples(Selection::default())?;
        let mut signal = Signal::default();
        for (index, value) in samples.values().enumerate() {
            let time = samples.time_s(index).unwrap_or(index as f64 / samples.rate_hz);
            // Of equal times, the first counts.
            if signal.times.last().is_none_or(|last| time > *last) {
                signal.times.push(time);
                signal.values.push(value);
            }
        }
        if signal.times.len() < 2 {
            return Err(Code::NoRows
                .error("the table has fewer than two rows", "give a recording")
                .at(&recording.name));
        }
        let factor = match samples.unit {
            OutputUnit::Counts { .. } => {
                let mut norms: Vec<_> = signal.values.iter().map(norm).collect();
                norms.sort_by(f64::total_cmp);
                let at = |share: f64| norms[(share * (norms.len() - 1) as f64) as usize];
                let median = at(0.5).max(1e-9);
                // In motion the median is not the magnitude at rest.
                let spread = 0.5 * (at(0.84) - at(0.16)) / median;
                signal.unit_sd = Some(spread.hypot(LEAST_UNIT_SD));
                STANDARD_GRAVITY_MPS2 / median
            }
            OutputUnit::Mps2 => 1.0,
        };
        signal.saturated = saturated(&signal.values);
        for value in &mut signal.values {
            *value = value.map(|v| v * factor);
        }
        Ok(signal)
    }

    /// The median rate, Hz.
    pub fn rate_hz(&self) -> f64 {
        1.0 / period_s(&self.times)
    }

    /// Times of the rows, s.
    pub fn times(&self) -> impl Iterator<Item = f64> {
        self.times.iter().copied()
    }

    /// The value at a time, interpolated linearly; `None` outside, or in a gap of a second.
    pub fn at(&self, time: f64) -> Option<[f64; 3]> {
        let next = self.times.partition_point(|t| *t <= time);
        let before = next.checked_sub(1)?;
        let (t0, v0) = (self.times[before], self.values[before]);
        let Some(&t1) = self.times.get(next) else {
            return (time == t0).then_some(v0);
        };
        let v1 = self.values[next];
        let share = (time - t0) / (t1 - t0);
        (t1 - t0 < 1.0).then(|| [0, 1, 2].map(|axis| v0[axis] + share * (v1[axis] - v0[axis])))
    }

    /// The value at a time by polynomial interpolation over `rows` rows on each side, which is less flattened than
    /// linear interpolation. Where these rows are unevenly spaced, missing or saturated, [`Signal::at`].
    pub fn curved_at(&self, time: f64, rows: usize) -> Option<[f64; 3]> {
        let next = self.times.partition_point(|t| *t <= time);
        let near = next.saturating_sub(rows)..next + rows;
        let (Some(times), Some(values), Some(saturated)) =
            (self.times.get(near.clone()), self.values.get(near.clone()), self.saturated.get(near))
        else {
            return self.at(time);
        };
        let mean = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
        let even = |pair: &[f64]| (0.5..1.5).contains(&((pair[1] - pair[0]) / mean));
        if times.len() < 2 * rows || saturated.contains(&true) || !times.windows(2).all(even) {
            return self.at(time);
        }
        // Lagrange's polynomial.
        let mut curved = [0.0; 3];
        for (i, value) in values.iter().enumerate() {
            let others = (0..times.len()).filter(|j| *j != i);
            let weight: f64 = others.map(|j| (time - times[j]) / (times[i] - times[j])).product();
            for axis in 0..3 {
                curved[axis] += weight * value[axis];
            }
        }
        Some(curved)
    }

    /// Whether the value at a time depends on a saturated one.
    pub fn is_saturated_at(&self, time: f64) -> bool {
        let next = self.times.partition_point(|t| *t <= time);
        let rows = next.saturating_sub(1)..(next + 1).min(self.saturated.len());
        self.saturated[rows].contains(&true)
    }

    pub fn grid(&self, step: f64) -> Grid {
        let start = self.times[0];
        let length = self.times[self.times.len() - 1] - start;
        let mut last = norm(self.values[0]);
        let mut values: Vec<f64> = (0..=(length / step) as usize)
            .map(|k| {
                if let Some(value) = self.at(start + k as f64 * step) {
                    last = norm(value);
                }
                last
            })
            .collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        for value in &mut values {
            *value -= mean;
        }
        Grid { start, step, values }
    }
}

impl Grid {
    pub fn end(&self) -> f64 {
        self.start + (self.values.len() as f64 - 1.0) * self.step
    }

    /// The mean of each `fold` points, or, where these are longer than a motion, their standard deviation.
    pub fn folded(&self, fold: usize) -> Self {
        let values = if fold == 1 || self.step * fold as f64 <= SHORT_S {
            let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
            self.values.chunks_exact(fold).map(mean).collect()
        } else {
            let spread = |part: &[f64]| {
                let mean = part.iter().sum::<f64>() / part.len() as f64;
                let square = part.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
                (square / part.len() as f64).sqrt()
            };
            self.values.chunks_exact(fold).map(spread).collect()
        };
        Self { start: self.start, step: self.step * fold as f64, values }
    }
}

/// Growth of the lag from the first third of the overlap to the last, per second of the
/// reference; `None` where a third does not fit on its own.
pub(super) fn drift(
    a: &Grid,
    b: &Grid,
    lag: f64,
    (start, end): (f64, f64),
    shift: f64,
) -> Option<f64> {
    let third = (end - start) / 3.0;
    if third < 3.0 {
        return None;
    }
    let lag_of = |from: f64| {
        let cut = |grid: &Grid, from: f64| {
            let first = ((from - grid.start) / grid.step).round().max(0.0) as usize;
            let count = (third / grid.step) as usize;
            let last = (first + count).min(grid.values.len());
            (first, grid.values.get(first..last).unwrap_or_default().to_vec())
        };
        let ((first_a, a_part), (first_b, b_part)) = (cut(a, from), cut(b, from - shift));
        let expected = lag - (first_a as f64 - first_b as f64);
        // The largest rate difference.
        let reach = (MAX_RATE * (end - start) / a.step).ceil() as i64 + 1;
        let best = refine(&a_part, &b_part, expected.round() as i64, reach)?;
        (best.score >= MIN_CORRELATION)
            .then_some((best.lag + first_a as f64 - first_b as f64) * a.step)
    };
    Some((lag_of(end - third)? - lag_of(start)?) / (2.0 * third))
}
