//! Two tables of any two devices: no numbers, no common clock, so the motion itself aligns them.

use std::path::Path;

use serde::Serialize;
use wimu_calib::ReferenceTransfer;
use wimu_model::STANDARD_GRAVITY_MPS2;

use super::{Axis, refused};
use crate::csv::{AccelerationUnit, CsvReader};
use crate::{ErrorCode, HostError, Result};

/// Both are brought to the slower one's rate, at most this, Hz.
const MAX_RATE_HZ: f64 = 200.0;
/// Taken where a table has no times, Hz.
const ASSUMED_RATE_HZ: f64 = 100.0;
/// Points of the search over all lags.
const COARSE_POINTS: usize = 4000;
/// No motion is over so soon, s.
const SHORT_S: f64 = 0.1;
/// Least that must overlap, s, and as a share of the shorter table.
const MIN_OVERLAP_S: f64 = 2.0;
const MIN_OVERLAP: f64 = 0.2;
/// Streams of one motion are correlated at least this much when aligned.
const MIN_CORRELATION: f64 = 0.6;
/// Another place that fits within this makes the answer ambiguous.
const MIN_LEAD: f64 = 0.03;
/// By so many standard deviations a correlation is more than chance; at the best of thousands of lags
/// chance makes nearly four.
const MIN_DEVIATIONS: f64 = 4.0;
/// Two devices in one motion show as much of it, but for such a factor, however they are mounted.
const MAX_SIZE: f64 = 1.4;
/// What a motion shares with itself later than this counts as chance, s; at most so many products.
const MAX_MEMORY_S: f64 = 5.0;
const MAX_PRODUCTS: usize = 200_000_000;
/// Below this overlap the clocks' rates are not compared, s.
const MIN_RATE_OVERLAP_S: f64 = 9.0;
/// Clocks farther apart than this are not compared.
const MAX_RATE: f64 = 0.01;
/// Straight lines between rows know a moment to this part of the time between them, at best.
const BETWEEN_ROWS: f64 = 0.02;
/// What is left is the same for so long, s: its parts are taken for independent beyond.
const CLUSTER_S: f64 = 1.0;

/// A sensor's bias makes the magnitude at rest another than 1 g by about this, as a part of it.
const LEAST_UNIT_SD: f64 = 0.03;
/// A value stands at its sensor's end that stays for so many rows, so many times, and comes or goes by more
/// than so many of the finest steps at once.
const MIN_STAY: usize = 2;
const MIN_STOPS: usize = 2;
const STEEP: f64 = 4.0;

/// What the alignment of two tables found.
#[derive(Clone, Debug, Serialize)]
pub struct Alignment {
    /// The reference, and the other.
    pub sources: [String; 2],
    /// Add to the other's time to get the reference's at the middle of the overlap, s.
    pub offset_s: f64,
    /// Its standard deviation, s.
    pub offset_sd_s: f64,
    /// By how many ppm the other's clock is slow against the reference's; `None` where the
    /// overlap is too short to tell.
    pub rate_ppm: Option<f64>,
    /// Its standard deviation.
    pub rate_sd_ppm: Option<f64>,
    /// Correlation of the magnitudes when aligned.
    pub correlation: f64,
    /// Length of the overlap, s.
    pub overlap_s: f64,
    /// Rate at which the two were compared, Hz.
    pub rate_hz: f64,
    /// Values compared.
    pub pairs: u64,
    /// Moments left out because a value of either stands at its sensor's end.
    pub saturated: u64,
    /// Of the reference and the other: for a table in LSB, whose median magnitude is taken for 1 g,
    /// how far that may be off, as a part of 1. It is in the standard deviations.
    pub unit_sd: [Option<f64>; 2],
    /// The other against the reference, X, Y, Z; `None` where they say nothing about each other.
    pub axes: Option<[Axis; 3]>,
    /// Why not.
    pub axes_reason: Option<String>,
}

/// A table as a signal.
struct Signal {
    /// s.
    times: Vec<f64>,
    /// m/s².
    values: Vec<[f64; 3]>,
    /// Whether an axis stands at its sensor's end.
    saturated: Vec<bool>,
    /// How far the unit may be off, where it is guessed, as a part of 1.
    unit_sd: Option<f64>,
}

/// Evenly sampled magnitudes, less their mean.
struct Grid {
    start: f64,
    step: f64,
    values: Vec<f64>,
}

/// Aligns two tables by the magnitude of their specific force, which no mounting changes, and
/// compares their values. In LSB, the median magnitude is taken for 1 g.
///
/// # Errors
/// Those of [`CsvReader`]; `no_rows`, `csv_missing_column`; `data_refused` when no place, or more
/// than one, fits.
pub fn align(reference: &Path, other: &Path) -> Result<Alignment> {
    let names = [reference, other].map(|path| path.display().to_string());
    let [a, b] = [read(reference)?, read(other)?];
    let both = format!("{} and {}", names[0], names[1]);
    let rate_hz = a.rate_hz().min(b.rate_hz()).min(MAX_RATE_HZ);
    let step = 1.0 / rate_hz;
    let [fine_a, fine_b] = [a.grid(step), b.grid(step)];
    let shorter = fine_a.values.len().min(fine_b.values.len()) as f64 * step;
    let overlap = MIN_OVERLAP_S.max(MIN_OVERLAP * shorter);
    let none = || {
        refused(
            &both,
            "no part of the one fits the other",
            "record one motion with both at the same time: shake them together at the beginning",
        )
    };
    let longest = fine_a.values.len().max(fine_b.values.len());
    let fold = longest.div_ceil(COARSE_POINTS).max(1);
    let [coarse_a, coarse_b] = [fine_a.folded(fold), fine_b.folded(fold)];
    let least = (overlap / coarse_a.step).ceil() as usize;
    let scores = scores(&coarse_a.values, &coarse_b.values, least);
    let (best, lag) = scores
        .iter()
        .copied()
        .max_by(|x, y| x.0.total_cmp(&y.0))
        .ok_or_else(none)?;
    // Within a second of the best, neighbours fit too.
    let near = (1.0 / coarse_a.step).ceil() as i64 + 1;
    let second = scores
        .iter()
        .filter(|(_, other)| (other - lag).abs() > near)
        .fold(f64::MIN, |most, (score, _)| most.max(*score));
    let around = lag * fold as i64;
    let fine = refine(&fine_a.values, &fine_b.values, around, fold as i64 + 1).ok_or_else(none)?;
    if fine.score < MIN_CORRELATION {
        return Err(none());
    }
    if second > best - MIN_LEAD {
        return Err(refused(
            &both,
            "they fit each other at more than one place: the motion repeats itself",
            "record a motion that does not: shake them together once at the beginning",
        ));
    }
    // b[k] is at a[k + lag].
    let lag = fine.lag.round() as i64;
    if deviations(&fine_a.values, &fine_b.values, lag, step) < MIN_DEVIATIONS {
        return Err(refused(
            &both,
            format!(
                "what fits, to {:.2}, is so short or so even a motion that another would fit as well",
                fine.score
            ),
            "record one motion with both at the same time, longer and more varied",
        ));
    }
    let mut fit = TimeFit {
        offset_s: fine_a.start - fine_b.start + fine.lag * step,
        rate: 0.0,
        middle: 0.0,
        sd: [0.0; 2],
    };
    let overlap_at = |offset: f64| {
        let start = fine_a.start.max(fine_b.start + offset);
        (start, fine_a.end().min(fine_b.end() + offset))
    };
    let (start, end) = overlap_at(fit.offset_s);
    fit.middle = 0.5 * (start + end);
    let has_rate = end - start >= MIN_RATE_OVERLAP_S;
    // The rate moves the ends: first a small correction, then what it leaves.
    let rough = drift(&fine_a, &fine_b, fine.lag, (start, end), fit.offset_s);
    fit.rate = rough.filter(|_| has_rate).unwrap_or(0.0);
    for _ in 0..4 {
        fit = fit
            .refined(&a, &b, (start, end), step, has_rate)
            .unwrap_or(fit);
    }
    let between_s = BETWEEN_ROWS * step;
    fit.sd[0] = fit.sd[0].hypot(between_s);
    fit.sd[1] = fit.sd[1].hypot(between_s * 12.0_f64.sqrt() / (end - start));
    let rate = has_rate.then_some((fit.rate, fit.sd[1]));
    let offset_s = fit.offset_s;
    // Any two devices: nobody says which is the noisier.
    let mut transfer = ReferenceTransfer::of_unknown_noise();
    let (mut squares, mut sums, mut saturated) = ([0.0; 3], [[0.0; 3]; 2], 0);
    let mut sizes = [0.0; 2];
    let count = ((end - start) / step).max(0.0) as usize;
    for k in 0..count {
        let time = start + k as f64 * step;
        let theirs = fit.theirs(time);
        if let (Some(x), Some(y)) = (a.at(time), b.at(theirs)) {
            if a.is_saturated_at(time) || b.is_saturated_at(theirs) {
                saturated += 1;
                continue;
            }
            transfer.push(x, y);
            for axis in 0..3 {
                squares[axis] += (y[axis] - x[axis]).powi(2);
                sums[0][axis] += x[axis];
                sums[1][axis] += y[axis];
                sizes[0] += x[axis] * x[axis];
                sizes[1] += y[axis] * y[axis];
            }
        }
    }
    let found = transfer.result();
    let pairs = found.as_ref().map_or(count as u64, |found| found.samples);
    let unit_sd = [a.unit_sd, b.unit_sd];
    let [x, y] = [0, 1].map(|table| {
        let mean: f64 = sums[table].iter().map(|sum| sum * sum).sum();
        (sizes[table] - mean / pairs.max(1) as f64).max(0.0).sqrt()
    });
    // Noise is in both sizes, and in the correlation.
    let most = MAX_SIZE / fine.score * (1.0 + 3.0 * unit_sd.iter().flatten().sum::<f64>());
    if found.is_ok() && !(1.0 / most..=most).contains(&(y / x)) {
        return Err(refused(
            &both,
            format!(
                "what fits, to {:.2}, is {:.1} times as large a motion in the second as in the first",
                fine.score,
                y / x
            ),
            "record one motion with both at the same time; check the units",
        ));
    }
    let axes = found.as_ref().ok().map(|found| {
        let count = found.samples.max(1) as f64;
        [0, 1, 2].map(|axis| {
            let plain = Axis {
                rms_before_mps2: (squares[axis] / count).sqrt(),
                ..Axis::new(found, axis, 0.0)
            };
            let means = [0, 1].map(|table| sums[table][axis] / count);
            plain.with_units_to(unit_sd.map(Option::unwrap_or_default), means)
        })
    });
    Ok(Alignment {
        sources: names,
        offset_s,
        offset_sd_s: fit.sd[0],
        rate_ppm: rate.map(|(rate, _)| rate * 1e6),
        rate_sd_ppm: rate.map(|(_, sd)| sd * 1e6),
        correlation: fine.score,
        overlap_s: end - start,
        rate_hz,
        pairs,
        saturated,
        unit_sd,
        axes,
        axes_reason: found.err().map(|refusal| refusal.to_string()),
    })
}

impl Axis {
    /// The same where the units of reference and other are known to these parts of 1 only; their means,
    /// m/s².
    fn with_units_to(mut self, unit_sd: [f64; 2], means: [f64; 2]) -> Self {
        let widen = |sd: &mut f64, by: f64| *sd = sd.hypot(by);
        for (sd, mean) in unit_sd.into_iter().zip(means) {
            widen(&mut self.offset_sd_mps2, sd * mean);
        }
        if let Some(line) = &mut self.line {
            widen(&mut line.bias_sd_mps2, unit_sd[1] * line.bias_mps2);
            widen(
                &mut line.scale_sd,
                unit_sd[0].hypot(unit_sd[1]) * line.scale,
            );
        }
        self
    }
}

/// Which rows have an axis at the end of what its sensor shows: at its largest or smallest value, where the
/// motion stops and stays more than once.
fn saturated(values: &[[f64; 3]]) -> Vec<bool> {
    let mut saturated = vec![false; values.len()];
    for axis in 0..3 {
        let of = |row: usize| values[row][axis];
        // The finest step between two rows: a value may stay by itself for as coarse as it is.
        let steps = values
            .windows(2)
            .map(|pair| (pair[1][axis] - pair[0][axis]).abs());
        let finest = steps.filter(|step| *step > 0.0).fold(f64::MAX, f64::min);
        for sign in [1.0, -1.0] {
            let end = values
                .iter()
                .map(|value| sign * value[axis])
                .fold(f64::MIN, f64::max);
            let at_end: Vec<usize> = (0..values.len())
                .filter(|row| sign * of(*row) == end)
                .collect();
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

fn read(path: &Path) -> Result<Signal> {
    let reader = CsvReader::open(path)?;
    let name = reader.name().to_owned();
    let unit = reader.header().acceleration_unit;
    if reader.header().accelerometers.len() != 1 {
        return Err(HostError::new(
            ErrorCode::CsvMissingColumn,
            format!(
                "it has {} accelerometers",
                reader.header().accelerometers.len()
            ),
            "give tables with one each: `Accelerometer X (g)`, `Accelerometer Y (g)`, `Accelerometer Z (g)`",
        )
        .at(name));
    }
    let mut signal = Signal {
        times: Vec::new(),
        values: Vec::new(),
        saturated: Vec::new(),
        unit_sd: None,
    };
    for row in reader {
        let row = row?;
        let time = row
            .time_ns
            .map_or(signal.times.len() as f64 / ASSUMED_RATE_HZ, |time_ns| {
                time_ns as f64 * 1e-9
            });
        // Of equal times, the first counts.
        if signal.times.last().is_none_or(|last| time > *last) {
            signal.times.push(time);
            signal.values.push(row.accelerations[0]);
        }
    }
    if signal.times.len() < 2 {
        return Err(HostError::new(
            ErrorCode::NoRows,
            "there are fewer than two rows",
            "give a recording",
        )
        .at(name));
    }
    let factor = match unit {
        AccelerationUnit::Lsb => {
            let mut norms: Vec<_> = signal.values.iter().map(norm).collect();
            norms.sort_by(f64::total_cmp);
            let at = |share: f64| norms[(share * (norms.len() - 1) as f64) as usize];
            let median = at(0.5).max(1e-9);
            // In motion the median is not the magnitude at rest.
            let spread = 0.5 * (at(0.84) - at(0.16)) / median;
            signal.unit_sd = Some(spread.hypot(LEAST_UNIT_SD));
            STANDARD_GRAVITY_MPS2 / median
        }
        other => other.mps2().unwrap_or(1.0),
    };
    signal.saturated = saturated(&signal.values);
    for value in &mut signal.values {
        *value = value.map(|v| v * factor);
    }
    Ok(signal)
}

fn norm(v: &[f64; 3]) -> f64 {
    v.iter().map(|c| c * c).sum::<f64>().sqrt()
}

impl Signal {
    /// The median rate, Hz.
    fn rate_hz(&self) -> f64 {
        let mut steps: Vec<_> = self
            .times
            .windows(2)
            .map(|pair| pair[1] - pair[0])
            .collect();
        steps.sort_by(f64::total_cmp);
        1.0 / steps[steps.len() / 2].max(1e-6)
    }

    /// The value at a time, between two samples; `None` outside, or in a gap of a second.
    fn at(&self, time: f64) -> Option<[f64; 3]> {
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

    /// Whether the value at a time is made of one at its sensor's end.
    fn is_saturated_at(&self, time: f64) -> bool {
        let next = self.times.partition_point(|t| *t <= time);
        let rows = next.saturating_sub(1)..(next + 1).min(self.saturated.len());
        self.saturated[rows].contains(&true)
    }

    fn grid(&self, step: f64) -> Grid {
        let start = self.times[0];
        let length = self.times[self.times.len() - 1] - start;
        let mut last = norm(&self.values[0]);
        let mut values: Vec<f64> = (0..=(length / step) as usize)
            .map(|k| {
                if let Some(value) = self.at(start + k as f64 * step) {
                    last = norm(&value);
                }
                last
            })
            .collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        for value in &mut values {
            *value -= mean;
        }
        Grid {
            start,
            step,
            values,
        }
    }
}

impl Grid {
    fn end(&self) -> f64 {
        self.start + (self.values.len() as f64 - 1.0) * self.step
    }

    /// The mean of each `fold` points, or where these are longer than a motion how much it moves within
    /// them.
    fn folded(&self, fold: usize) -> Self {
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
        Self {
            start: self.start,
            step: self.step * fold as f64,
            values,
        }
    }
}

/// Correlation of what overlaps when b is moved by `lag`; `None` below `least` points.
fn correlation(a: &[f64], b: &[f64], lag: i64, least: usize) -> Option<f64> {
    let (a, b) = if lag >= 0 {
        (a.get(lag as usize..)?, b)
    } else {
        (a, b.get(lag.unsigned_abs() as usize..)?)
    };
    let n = a.len().min(b.len());
    if n < least.max(2) {
        return None;
    }
    let (mut x, mut y, mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (p, q) in a.iter().zip(b) {
        x += p;
        y += q;
        xx += p * p;
        xy += p * q;
        yy += q * q;
    }
    let n = n as f64;
    let (xx, xy, yy) = (xx - x * x / n, xy - x * y / n, yy - y * y / n);
    (xx > 0.0 && yy > 0.0).then(|| xy / (xx * yy).sqrt())
}

/// The correlation at every lag.
fn scores(a: &[f64], b: &[f64], least: usize) -> Vec<(f64, i64)> {
    (-(b.len() as i64)..=a.len() as i64)
        .filter_map(|lag| Some((correlation(a, b, lag, least)?, lag)))
        .collect()
}

struct Best {
    score: f64,
    lag: f64,
}

/// The best lag within `reach` of `around`, between points too.
fn refine(a: &[f64], b: &[f64], around: i64, reach: i64) -> Option<Best> {
    let score = |lag: i64| correlation(a, b, lag, 8);
    let (peak, lag) = (around - reach..=around + reach)
        .filter_map(|lag| Some((score(lag)?, lag)))
        .max_by(|x, y| x.0.total_cmp(&y.0))?;
    let shift = match (score(lag - 1), score(lag + 1)) {
        (Some(before), Some(behind)) => {
            let bend = before - 2.0 * peak + behind;
            if bend < 0.0 {
                (0.5 * (before - behind) / bend).clamp(-0.5, 0.5)
            } else {
                0.0
            }
        }
        _ => 0.0,
    };
    Some(Best {
        score: peak,
        lag: lag as f64 + shift,
    })
}

/// By how many standard deviations the correlation of what overlaps when b is moved by `lag` is more
/// than chance: Fisher's transformation, with as many independent values as the motion has. It has as many
/// as it is longer than what it shares with itself; and a short motion in a long rest is short.
fn deviations(a: &[f64], b: &[f64], lag: i64, step: f64) -> f64 {
    let (x, y) = if lag >= 0 {
        (a.get(lag as usize..).unwrap_or_default(), b)
    } else {
        (a, b.get(lag.unsigned_abs() as usize..).unwrap_or_default())
    };
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

/// The other's time in the reference's.
#[derive(Clone, Copy, Debug)]
struct TimeFit {
    /// Added to the other's time, s, at the middle.
    offset_s: f64,
    /// How much it grows per second of the reference.
    rate: f64,
    middle: f64,
    /// Standard deviations of both.
    sd: [f64; 2],
}

impl TimeFit {
    fn theirs(&self, time: f64) -> f64 {
        time - self.offset_s - self.rate * (time - self.middle)
    }

    /// One step towards the best fit of |y| of the other by c + k|x|, by the change of |x| for an offset
    /// and by how that grows for a rate. What is left is weighed by the change of |y|, whose noise is not
    /// that of the change of |x|: so noise makes no step too small. The standard deviations let what is
    /// left be alike within a second.
    fn refined(
        &self,
        a: &Signal,
        b: &Signal,
        (start, end): (f64, f64),
        step: f64,
        has_rate: bool,
    ) -> Option<Self> {
        let row = |time: f64| {
            let near = [time - step, time, time + step];
            let theirs = self.theirs(time);
            let is_saturated = |at: f64| a.is_saturated_at(at);
            if near.into_iter().any(is_saturated) || b.is_saturated_at(theirs) {
                return None;
            }
            let [before, now, after] = near.map(|at| a.at(at).map(|v| norm(&v)));
            let now = now?;
            let theirs = [theirs - step, theirs, theirs + step];
            let [y_before, y, y_after] = theirs.map(|at| b.at(at).map(|v| norm(&v)));
            let with = |change: f64| {
                let change = change / (2.0 * step);
                let growing = if has_rate {
                    change * (time - self.middle)
                } else {
                    0.0
                };
                [1.0, now, change, growing]
            };
            Some((with(after? - before?), with(y_after? - y_before?), y?))
        };
        let unknowns = if has_rate { 4 } else { 3 };
        let count = ((end - start) / step).max(0.0) as usize;
        let rows = || (1..count).filter_map(|k| row(start + k as f64 * step).map(|row| (k, row)));
        let (mut normal, mut right) = ([[0.0; 4]; 4], [0.0; 4]);
        for (_, (x, weights, y)) in rows() {
            for i in 0..unknowns {
                right[i] += weights[i] * y;
                for j in 0..unknowns {
                    normal[i][j] += weights[i] * x[j];
                }
            }
        }
        let inverse = inverse(normal, unknowns)?;
        let times =
            |v: [f64; 4]| inverse.map(|row| (0..unknowns).map(|j| row[j] * v[j]).sum::<f64>());
        let found = times(right);
        let of_cluster = (CLUSTER_S / step).ceil() as usize;
        let (mut sum, mut cluster, mut variances) = ([0.0; 4], 0, [0.0; 4]);
        let mut close = |sum: [f64; 4]| {
            for (variance, influence) in variances.iter_mut().zip(times(sum)) {
                *variance += influence * influence;
            }
        };
        for (k, (x, weights, y)) in rows() {
            if k / of_cluster != cluster {
                close(std::mem::take(&mut sum));
                cluster = k / of_cluster;
            }
            let left = y - (0..unknowns).map(|i| x[i] * found[i]).sum::<f64>();
            for i in 0..unknowns {
                sum[i] += weights[i] * left;
            }
        }
        close(sum);
        // How much the other shows of the reference's motion.
        let gain = found[1];
        if gain.abs() < 0.1 {
            return None;
        }
        let fit = Self {
            offset_s: self.offset_s + found[2] / gain,
            rate: self.rate + found[3] / gain,
            middle: self.middle,
            sd: [2, 3].map(|k| variances[k].sqrt() / gain.abs()),
        };
        // One step is small, or it leads nowhere.
        let moved = (fit.offset_s - self.offset_s).abs();
        (moved < 5.0 * step && fit.rate.abs() <= MAX_RATE).then_some(fit)
    }
}

/// The inverse of the first `size` rows and columns of a matrix that is nearly symmetric and positive.
fn inverse(mut matrix: [[f64; 4]; 4], size: usize) -> Option<[[f64; 4]; 4]> {
    // Of like size first: seconds beside seconds squared.
    let scale: [f64; 4] = std::array::from_fn(|k| matrix[k][k].sqrt());
    let mut inverse = [[0.0; 4]; 4];
    for row in 0..size {
        // Not a number where it was negative.
        if scale[row].is_nan() || scale[row] <= 0.0 {
            return None;
        }
        for column in 0..size {
            matrix[row][column] /= scale[row] * scale[column];
        }
        inverse[row][row] = 1.0;
    }
    for pivot in 0..size {
        let by = matrix[pivot][pivot];
        if by < 1e-9 {
            return None;
        }
        for column in 0..size {
            matrix[pivot][column] /= by;
            inverse[pivot][column] /= by;
        }
        for row in (0..size).filter(|row| *row != pivot) {
            let by = matrix[row][pivot];
            for column in 0..size {
                matrix[row][column] -= by * matrix[pivot][column];
                inverse[row][column] -= by * inverse[pivot][column];
            }
        }
    }
    for row in 0..size {
        for column in 0..size {
            inverse[row][column] /= scale[row] * scale[column];
        }
    }
    Some(inverse)
}

/// How much the lag grows from the first third of the overlap to the last, per second of the
/// reference; `None` where a third does not fit on its own.
fn drift(a: &Grid, b: &Grid, lag: f64, (start, end): (f64, f64), shift: f64) -> Option<f64> {
    let third = (end - start) / 3.0;
    if third < 3.0 {
        return None;
    }
    let lag_of = |from: f64| {
        let cut = |grid: &Grid, from: f64| {
            let first = ((from - grid.start) / grid.step).round().max(0.0) as usize;
            let count = (third / grid.step) as usize;
            let last = (first + count).min(grid.values.len());
            (
                first,
                grid.values.get(first..last).unwrap_or_default().to_vec(),
            )
        };
        let ((first_a, a_part), (first_b, b_part)) = (cut(a, from), cut(b, from - shift));
        let expected = lag - (first_a as f64 - first_b as f64);
        // 1 % of clock error is the most.
        let reach = (MAX_RATE * (end - start) / a.step).ceil() as i64 + 1;
        let best = refine(&a_part, &b_part, expected.round() as i64, reach)?;
        (best.score >= MIN_CORRELATION)
            .then_some((best.lag + first_a as f64 - first_b as f64) * a.step)
    };
    Some((lag_of(end - third)? - lag_of(start)?) / (2.0 * third))
}
