//! A table as a signal in time.

use std::path::Path;

use nalgebra::Vector3;
use wimu_model::STANDARD_GRAVITY_MPS2;

use crate::formats::{self, ReadOptions};
use crate::recording::{OutputUnit, Selection};
use crate::series::{At, Flags, Interp, Ns, Series};
use crate::stats::quantile;
use crate::{Code, Result};

/// Longest step over which values are interpolated linearly, s.
const GAP_S: f64 = 1.0;
/// Smallest relative standard deviation of the unit: the effect of a typical bias on the magnitude at rest.
const LEAST_UNIT_SD: f64 = 0.03;
/// Detection of saturation: rows for which an extreme value persists, number of such runs, and smallest step into or
/// out of a run, in multiples of the finest step.
const MIN_STAY: usize = 2;
const MIN_STOPS: usize = 2;
const STEEP: f64 = 4.0;

/// A table as a signal, m/s².
pub(super) struct Signal {
    pub force: Series<Vector3<f64>>,
    /// Relative standard deviation of the unit, where it is assumed.
    pub unit_sd: Option<f64>,
}

impl Signal {
    /// Reads a table. In LSB, the median magnitude is taken as 1 g.
    pub fn read(path: &Path) -> Result<Signal> {
        let recording = formats::load(path, &ReadOptions::default())?;
        let samples = recording.samples(Selection::default())?;
        let rows = samples.values().enumerate().map(|(index, value)| {
            let time_s = samples.time_s(index).unwrap_or(index as f64 / samples.rate_hz);
            (Ns::from_s(time_s), Vector3::from(value))
        });
        let mut force = Series::of(rows).with_gap(GAP_S);
        if force.len() < 2 {
            return Err(Code::NoRows
                .error("the table has fewer than two rows", "give a recording")
                .at(&recording.name));
        }
        force.flags = saturated(&force.v);
        let OutputUnit::Counts { .. } = samples.unit else {
            return Ok(Self { force, unit_sd: None });
        };
        let norms = || force.v.iter().map(Vector3::norm);
        let median = quantile(norms(), 2).unwrap_or(1.0).max(1e-9);
        // In motion the median is not the magnitude at rest: half the distance of the 16 % and the 84 % quantiles.
        let low = quantile(norms(), 6).unwrap_or(0.0);
        let high = -quantile(norms().map(|norm| -norm), 6).unwrap_or(0.0);
        let unit_sd = (0.5 * (high - low) / median).hypot(LEAST_UNIT_SD);
        let force = force.map(|value| value * (STANDARD_GRAVITY_MPS2 / median));
        Ok(Self { force, unit_sd: Some(unit_sd) })
    }

    /// The value at a time, s since `origin`.
    pub fn at(&self, origin: Ns, time_s: f64, how: Interp) -> Option<At<Vector3<f64>>> {
        self.force.at(origin.after_s(time_s), how)
    }
}

/// Rows with a saturated axis: at its largest or smallest value, where the motion stops and stays more than once.
fn saturated(values: &[Vector3<f64>]) -> Vec<Flags> {
    let mut flags = vec![Flags::NONE; values.len()];
    for axis in 0..3 {
        let of = |row: usize| values[row][axis];
        // The finest step between two rows: within it a value may persist because of its resolution.
        let steps = values.windows(2).map(|pair| (pair[1][axis] - pair[0][axis]).abs());
        let finest = steps.filter(|step| *step > 0.0).fold(f64::MAX, f64::min);
        for sign in [1.0, -1.0] {
            let end = values.iter().map(|value| sign * value[axis]).fold(f64::MIN, f64::max);
            let at_end: Vec<usize> =
                (0..values.len()).filter(|row| sign * of(*row) == end).collect();
            let stops = at_end.chunk_by(|row, next| row + 1 == *next).filter(|run| {
                let outside = [run[0].checked_sub(1), Some(run[run.len() - 1] + 1)];
                let mut inside = outside.into_iter().flatten().filter(|row| *row < values.len());
                let is_steep = inside.any(|row| (of(row) - of(run[0])).abs() > STEEP * finest);
                run.len() >= MIN_STAY && is_steep
            });
            if stops.count() >= MIN_STOPS {
                at_end.iter().for_each(|row| flags[*row] = Flags::SATURATED);
            }
        }
    }
    flags
}
