//! Two tables of any two devices: no numbers, no common clock, so the motion itself aligns them.

use std::path::Path;

use serde::Serialize;
use wimu_calib::ReferenceTransfer;

use super::{Axis, refused};
use crate::Result;

mod correlation;
mod signal;
mod time_fit;
mod turn;

use correlation::{deviations, drift, refine, scores};
use signal::Signal;
use time_fit::TimeFit;
pub use turn::Turn;
use turn::scale_along_itself;

/// Both are brought to the slower one's rate, at most this, Hz.
const MAX_RATE_HZ: f64 = 200.0;
/// Points of the search over all lags.
const COARSE_POINTS: usize = 4000;
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
/// Below this overlap the clocks' rates are not compared, s.
const MIN_RATE_OVERLAP_S: f64 = 9.0;
/// Clocks farther apart than this are not compared.
const MAX_RATE: f64 = 0.01;
/// Straight lines between rows know a moment to this part of the time between them, at best.
const BETWEEN_ROWS: f64 = 0.02;

/// Rows on each side that the curve between two rows goes through, and those of the simpler one: what
/// these two make different is what the curve may lose.
const CURVE_ROWS: [usize; 2] = [3, 2];

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
    /// How the other's axes are turned against the reference's; `None` where the motion does not show it.
    pub turn: Option<Turn>,
    /// The other against the reference, X, Y, Z; `None` where they say nothing about each other. A scale
    /// factor is along the other's own axis, as far as the motion shows where that points.
    pub axes: Option<[Axis; 3]>,
    /// Why not.
    pub axes_reason: Option<String>,
}
/// Aligns two tables by the magnitude of their specific force, which no mounting changes, and
/// compares their values. In LSB, the median magnitude is taken for 1 g.
///
/// # Errors
/// Those of [`CsvReader`](crate::csv::CsvReader); `no_rows`, `csv_missing_column`; `data_refused` when no place, or more
/// than one, fits.
pub fn align(reference: &Path, other: &Path) -> Result<Alignment> {
    let names = [reference, other].map(|path| path.display().to_string());
    let [a, b] = [Signal::read(reference)?, Signal::read(other)?];
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
    let [mut transfer, mut simpler] = [0, 1].map(|_| ReferenceTransfer::of_unknown_noise());
    let (mut squares, mut sums, mut saturated) = ([0.0; 3], [[0.0; 3]; 2], 0);
    let mut sizes = [0.0; 2];
    // Where the slower one has its rows: between them, straight lines are flatter than the motion.
    let moments: Vec<(f64, f64)> = if b.rate_hz() < a.rate_hz() {
        b.times().map(|theirs| (fit.ours(theirs), theirs)).collect()
    } else {
        a.times().map(|time| (time, fit.theirs(time))).collect()
    };
    let mut compared = 0;
    for (time, theirs) in moments {
        let both = |rows| a.curved_at(time, rows).zip(b.curved_at(theirs, rows));
        if let (Some((x, y)), Some(simple)) = (both(CURVE_ROWS[0]), both(CURVE_ROWS[1])) {
            if a.is_saturated_at(time) || b.is_saturated_at(theirs) {
                saturated += 1;
                continue;
            }
            compared += 1;
            transfer.push(x, y);
            simpler.push(simple.0, simple.1);
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
    let simpler = simpler.result();
    let pairs = found.as_ref().map_or(compared, |found| found.samples);
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
            let mut plain = Axis {
                rms_before_mps2: (squares[axis] / count).sqrt(),
                ..Axis::new(found, axis, 0.0)
            };
            if let (Some(line), Some(seen)) = (&mut plain.line, &found.axes[axis].line) {
                [line.scale, line.scale_sd] = scale_along_itself(seen);
                if let Some(simple) = simpler
                    .as_ref()
                    .ok()
                    .and_then(|found| found.axes[axis].line)
                {
                    let lost = line.scale - scale_along_itself(&simple)[0];
                    line.scale_sd = line.scale_sd.hypot(lost);
                    let lost = line.bias_mps2 - simple.bias_mps2;
                    line.bias_sd_mps2 = line.bias_sd_mps2.hypot(lost);
                }
            }
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
        turn: found.as_ref().ok().and_then(Turn::of),
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
