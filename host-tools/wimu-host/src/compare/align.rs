//! Comparison of two tables of any two devices: without sequence numbers or a common clock, the motion aligns them.

use std::path::Path;

use serde::Serialize;
use wimu_calib::ReferenceTransfer;

use super::{Axis, incomparable, refused};
use crate::lag::{deviations, refine, scores};
use crate::{Code, Problem, Result};

mod signal;
mod time_fit;
mod turn;

use signal::{Signal, drift};
use time_fit::TimeFit;
pub use turn::Turn;
use turn::scale_along_itself;

/// Largest rate at which both are compared, Hz.
const MAX_RATE_HZ: f64 = 200.0;
/// Largest number of points of the search over all lags.
const COARSE_POINTS: usize = 4000;
/// Shortest overlap, s, and as a fraction of the shorter table.
const MIN_OVERLAP_S: f64 = 2.0;
const MIN_OVERLAP: f64 = 0.2;
/// Smallest correlation of aligned tables.
const MIN_CORRELATION: f64 = 0.6;
/// Smallest lead of the best correlation over that at another lag: below it the alignment is ambiguous.
const MIN_LEAD: f64 = 0.03;
/// Smallest correlation, in standard deviations of chance. The best of thousands of lags reaches nearly four by chance.
const MIN_DEVIATIONS: f64 = 4.0;
/// Largest ratio of the motions' magnitudes.
const MAX_SIZE: f64 = 1.4;
/// Shortest overlap from which the rates of the clocks are compared, s.
const MIN_RATE_OVERLAP_S: f64 = 9.0;
/// Largest rate difference of the clocks.
const MAX_RATE: f64 = 0.01;
/// Smallest standard deviation of a time, as a fraction of the row interval, because of linear interpolation.
const BETWEEN_ROWS: f64 = 0.02;

/// Rows on each side through which a curve is interpolated, and those of a simpler curve: their difference estimates
/// the interpolation error.
const CURVE_ROWS: [usize; 2] = [3, 2];

/// Result of the alignment of two tables.
#[derive(Clone, Debug, Serialize)]
pub struct Alignment {
    /// The reference, and the other.
    pub sources: [String; 2],
    /// Offset to add to the other's time at the middle of the overlap, s.
    pub offset_s: f64,
    /// Its standard deviation, s.
    pub offset_sd_s: f64,
    /// By how many ppm the other's clock is slow against the reference's; `None` where the
    /// overlap is too short.
    pub rate_ppm: Option<f64>,
    /// Its standard deviation.
    pub rate_sd_ppm: Option<f64>,
    /// Correlation of the aligned magnitudes.
    pub correlation: f64,
    /// Length of the overlap, s.
    pub overlap_s: f64,
    /// Rate at which the two were compared, Hz.
    pub rate_hz: f64,
    /// Values compared.
    pub pairs: u64,
    /// Moments excluded because a value of either is saturated.
    pub saturated: u64,
    /// Of the reference and the other: standard deviation, relative, of the unit of a table in LSB, whose median magnitude
    /// is taken as 1 g. It is included in the standard deviations.
    pub unit_sd: [Option<f64>; 2],
    /// Rotation of the other's axes against the reference's; `None` where it is not observable.
    pub turn: Option<Turn>,
    /// The other against the reference, X, Y, Z; `None` where they are not comparable. A scale
    /// factor is along the other's own axis, as far as the direction of that is observable.
    pub axes: Option<[Axis; 3]>,
    /// Why they are not.
    pub axes_reason: Option<String>,
    /// What was noticed.
    #[serde(skip)]
    pub findings: Vec<Problem>,
}

/// Aligns two tables by the magnitude of their specific force, which does not depend on the mounting, and
/// compares their values. In LSB, the median magnitude is taken as 1 g.
///
/// # Errors
/// Those of [`formats::load`](crate::formats::load); `no_rows`, `csv_missing_column`; `data_refused` when no alignment, or more
/// than one, fits.
pub fn align(reference: &Path, other: &Path) -> Result<Alignment> {
    let names = [reference, other].map(crate::untrusted::name);
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
            "the motions of the two tables do not match",
            "record one motion with both at the same time: shake them together at the beginning",
        )
    };
    let longest = fine_a.values.len().max(fine_b.values.len());
    let fold = longest.div_ceil(COARSE_POINTS).max(1);
    let [coarse_a, coarse_b] = [fine_a.folded(fold), fine_b.folded(fold)];
    let least = (overlap / coarse_a.step).ceil() as usize;
    let scores = scores(&coarse_a.values, &coarse_b.values, least);
    let (best, lag) = scores.iter().copied().max_by(|x, y| x.0.total_cmp(&y.0)).ok_or_else(none)?;
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
            "the alignment is ambiguous: the motion repeats itself",
            "record a motion that does not repeat: shake them together once at the beginning",
        ));
    }
    // b[k] is at a[k + lag].
    let lag = fine.lag.round() as i64;
    if deviations(&fine_a.values, &fine_b.values, lag, step) < MIN_DEVIATIONS {
        return Err(refused(
            &both,
            format!(
                "the matching motion (correlation {:.2}) is too short or too uniform to be unique",
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
    // The rate changes the ends: first a rough correction, then refinements.
    let rough = drift(&fine_a, &fine_b, fine.lag, (start, end), fit.offset_s);
    fit.rate = rough.filter(|_| has_rate).unwrap_or(0.0);
    for _ in 0..4 {
        fit = fit.refined(&a, &b, (start, end), step, has_rate).unwrap_or(fit);
    }
    let between_s = BETWEEN_ROWS * step;
    fit.sd[0] = fit.sd[0].hypot(between_s);
    fit.sd[1] = fit.sd[1].hypot(between_s * 12.0_f64.sqrt() / (end - start));
    let rate = has_rate.then_some((fit.rate, fit.sd[1]));
    let offset_s = fit.offset_s;
    // Either device may be the noisier one.
    let [mut transfer, mut simpler] = [0, 1].map(|_| ReferenceTransfer::of_unknown_noise());
    let (mut squares, mut sums, mut saturated) = ([0.0; 3], [[0.0; 3]; 2], 0);
    let mut sizes = [0.0; 2];
    // At the rows of the slower table: interpolation between them flattens the motion.
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
    // Noise affects both magnitudes, and the correlation.
    let most = MAX_SIZE / fine.score * (1.0 + 3.0 * unit_sd.iter().flatten().sum::<f64>());
    if found.is_ok() && !(1.0 / most..=most).contains(&(y / x)) {
        return Err(refused(
            &both,
            format!(
                "the matching motion (correlation {:.2}) is {:.1} times as large in the second table as in the first",
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
                if let Some(simple) = simpler.as_ref().ok().and_then(|found| found.axes[axis].line)
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
    let turn = found.as_ref().ok().and_then(Turn::of);
    let axes_reason = found.err().map(|refusal| refusal.to_string());
    let mut findings = Vec::from_iter(incomparable(axes_reason.as_deref()));
    for (source, sd) in names.iter().zip(unit_sd) {
        findings.extend(sd.map(|sd| {
            Code::UnitInferred.warning(format!(
                "{source} is in LSB: its median magnitude is taken as 1 g; the standard deviation of all scale factors is {:.0} %",
                100.0 * sd
            ))
        }));
    }
    if saturated > 0 {
        let text = format!("{saturated} saturated samples are left out");
        findings.push(Code::Saturated.note(text));
    }
    if axes.is_some() && turn.is_none() {
        let text = "the motion does not determine the rotation between the axes: 5° change a scale factor by 0.4 % and a bias \
                    by 9 % of the other axes' output";
        let finding = Code::Axes.warning(text);
        findings.push(finding.remedy("move both through all orientations"));
    }
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
        turn,
        axes,
        axes_reason,
        findings,
    })
}

impl Axis {
    /// Adds the relative standard deviations of the units of reference and other; `means` are their mean values, m/s².
    fn with_units_to(mut self, unit_sd: [f64; 2], means: [f64; 2]) -> Self {
        let widen = |sd: &mut f64, by: f64| *sd = sd.hypot(by);
        for (sd, mean) in unit_sd.into_iter().zip(means) {
            widen(&mut self.offset_sd_mps2, sd * mean);
        }
        if let Some(line) = &mut self.line {
            widen(&mut line.bias_sd_mps2, unit_sd[1] * line.bias_mps2);
            widen(&mut line.scale_sd, unit_sd[0].hypot(unit_sd[1]) * line.scale);
        }
        self
    }
}
