//! Comparison of two tables of any two devices: without sequence numbers or a common clock, the motion aligns them.

use std::path::Path;

use nalgebra::Vector3;
use serde::Serialize;
use wimu_calib::{ReferenceTransfer, Transfer};

use super::{Axis, incomparable, refused};
use crate::lag::{Lag, Search, lag};
use crate::series::{Interp, Ns};

mod signal;
mod time_fit;
mod turn;

use crate::{Code, Problem, Result};
use signal::Signal;
use time_fit::TimeFit;
pub use turn::Turn;
use turn::scale_along_itself;

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
    let signals = [Signal::read(reference)?, Signal::read(other)?];
    let both = names.join(" and ");
    let lag = matching(&signals, &both)?;
    let fit = TimeFit::of(&signals, lag.offset_s, lag.step_s, MIN_RATE_OVERLAP_S);
    let pairs = Pairs::of(&signals, &fit);
    let unit_sd = signals.each_ref().map(|signal| signal.unit_sd);
    let found = pairs.transfer.result();
    let count = found.as_ref().map_or(pairs.count, |found| found.samples);
    if found.is_ok() {
        pairs.check_size(count, lag.correlation, unit_sd, &both)?;
    }
    let axes = found.as_ref().ok().map(|found| pairs.axes(found, unit_sd));
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
    if pairs.saturated > 0 {
        let text = format!("{} saturated samples are left out", pairs.saturated);
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
        offset_s: fit.offset_s,
        offset_sd_s: fit.sd[0],
        rate_ppm: fit.has_rate.then_some(fit.rate * 1e6),
        rate_sd_ppm: fit.has_rate.then_some(fit.sd[1] * 1e6),
        correlation: lag.correlation,
        overlap_s: fit.overlap_s[1] - fit.overlap_s[0],
        rate_hz: 1.0 / lag.step_s,
        pairs: count,
        saturated: pairs.saturated,
        unit_sd,
        turn,
        axes,
        axes_reason,
        findings,
    })
}

/// The lag of both magnitudes, if it is unique.
fn matching(signals: &[Signal; 2], both: &str) -> Result<Lag> {
    let [a, b] = signals.each_ref().map(|signal| signal.force.map(|force| force.norm()));
    let length_s = |span: Option<[Ns; 2]>| span.map_or(0.0, |[from, to]| to.since_s(from));
    let shorter_s = length_s(a.span()).min(length_s(b.span()));
    let overlap_s = MIN_OVERLAP_S.max(MIN_OVERLAP * shorter_s);
    let found = lag(&a, &b, &Search { around_s: 0.0, reach_s: f64::INFINITY, overlap_s });
    let Some(found) = found.filter(|lag| lag.correlation >= MIN_CORRELATION) else {
        return Err(refused(
            both,
            "the motions of the two tables do not match",
            "record one motion with both at the same time: shake them together at the beginning",
        ));
    };
    if found.lead < MIN_LEAD {
        return Err(refused(
            both,
            "the alignment is ambiguous: the motion repeats itself",
            "record a motion that does not repeat: shake them together once at the beginning",
        ));
    }
    if found.deviations < MIN_DEVIATIONS {
        return Err(refused(
            both,
            format!(
                "the matching motion (correlation {:.2}) is too short or too uniform to be unique",
                found.correlation
            ),
            "record one motion with both at the same time, longer and more varied",
        ));
    }
    Ok(found)
}

/// Values of both at the rows of the slower table: interpolation between these flattens the motion.
struct Pairs {
    transfer: ReferenceTransfer,
    /// By curves of lower order: the difference estimates the interpolation error.
    simpler: ReferenceTransfer,
    count: u64,
    saturated: u64,
    /// Of the reference and of the other.
    sums: [Vector3<f64>; 2],
    sizes: [f64; 2],
    /// Of the differences.
    squares: Vector3<f64>,
}

impl Pairs {
    fn of(signals: &[Signal; 2], fit: &TimeFit) -> Self {
        // Either device may be the noisier one.
        let [transfer, simpler] = [(); 2].map(|()| ReferenceTransfer::new());
        let mut pairs = Self {
            transfer,
            simpler,
            count: 0,
            saturated: 0,
            sums: [Vector3::zeros(); 2],
            sizes: [0.0; 2],
            squares: Vector3::zeros(),
        };
        let [a, b] = signals;
        let other_is_slower = b.force.period_s() > a.force.period_s();
        let slower = if other_is_slower { &b.force } else { &a.force };
        for time in &slower.t {
            let time_s = time.since_s(fit.origin);
            let (ours, theirs) = if other_is_slower {
                (fit.ours(time_s), time_s)
            } else {
                (time_s, fit.theirs(time_s))
            };
            let both = |how| a.at(fit.origin, ours, how).zip(b.at(fit.origin, theirs, how));
            let (Some((x, y)), Some(simple)) = (both(Interp::Quintic), both(Interp::Cubic)) else {
                continue;
            };
            if (x.flags | y.flags).is_saturated() {
                pairs.saturated += 1;
                continue;
            }
            pairs.count += 1;
            pairs.transfer.push(x.value.into(), y.value.into());
            pairs.simpler.push(simple.0.value.into(), simple.1.value.into());
            let difference = y.value - x.value;
            pairs.squares += difference.component_mul(&difference);
            for (k, value) in [x.value, y.value].into_iter().enumerate() {
                pairs.sums[k] += value;
                pairs.sizes[k] += value.norm_squared();
            }
        }
        pairs
    }

    /// Refuses a motion that is much larger in one of the tables.
    fn check_size(
        &self,
        count: u64,
        correlation: f64,
        unit_sd: [Option<f64>; 2],
        both: &str,
    ) -> Result<()> {
        let [x, y] = [0, 1].map(|table| {
            let mean = self.sums[table].norm_squared() / count.max(1) as f64;
            (self.sizes[table] - mean).max(0.0).sqrt()
        });
        // Noise affects both magnitudes, and the correlation.
        let most = MAX_SIZE / correlation * (1.0 + 3.0 * unit_sd.iter().flatten().sum::<f64>());
        if (1.0 / most..=most).contains(&(y / x)) {
            return Ok(());
        }
        Err(refused(
            both,
            format!(
                "the matching motion (correlation {correlation:.2}) is {:.1} times as large in the second table as in the first",
                y / x
            ),
            "record one motion with both at the same time; check the units",
        ))
    }

    fn axes(&self, found: &Transfer, unit_sd: [Option<f64>; 2]) -> [Axis; 3] {
        let count = found.samples.max(1) as f64;
        let simpler = self.simpler.result().ok();
        [0, 1, 2].map(|axis| {
            let mut plain = Axis {
                rms_before_mps2: (self.squares[axis] / count).sqrt(),
                ..Axis::new(found, axis, 0.0)
            };
            if let (Some(line), Some(seen)) = (&mut plain.line, &found.axes[axis].line) {
                [line.scale, line.scale_sd] = scale_along_itself(seen);
                if let Some(simple) = simpler.as_ref().and_then(|found| found.axes[axis].line) {
                    let lost = line.scale - scale_along_itself(&simple)[0];
                    line.scale_sd = line.scale_sd.hypot(lost);
                    let lost = line.bias_mps2 - simple.bias_mps2;
                    line.bias_sd_mps2 = line.bias_sd_mps2.hypot(lost);
                }
            }
            let means = self.sums.map(|sum| sum[axis] / count);
            plain.with_units_to(unit_sd.map(Option::unwrap_or_default), means)
        })
    }
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
