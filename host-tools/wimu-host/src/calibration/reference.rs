//! One stream against another of the same motion: the wireless link against the cable, or one
//! accelerometer of a CSV file against another.

use std::fmt;
use std::path::Path;

use serde::Serialize;
use wimu_calib::{
    AxisTransfer, Line, NoiseFrom, NoiseRatio, Parameter, Pose, ReferenceTransfer, Transfer,
    TransferRefusal, find_poses,
};
use wimu_link::LinkRole;
use wimu_model::{
    CalibrationMethod, CalibrationQuality, ErrorTerms, ModelCovariance, ParameterSet, QualityTerms,
    Sensitivity, SensorId, TermDeviations,
};

use super::input::{magnitude, median, median_magnitude};
use super::numbers::MAX_POSES;
use super::range::Range;
use super::{CalibrationReport, Source};
use crate::csv::{CsvReader, Filter};
use crate::dataset::{Dataset, LoadOptions, OutputUnit};
use crate::decode::sequence_order;
use crate::error::{ErrorCode, HostError, Result};
use crate::history::Recording;
use crate::units::RawUnits;

/// Two streams of one motion, sample by sample.
#[derive(Clone, Debug)]
pub struct Paired {
    /// What errors call it.
    pub name: String,
    /// What the reference is.
    pub reference: String,
    /// What is compared with it.
    pub output: String,
    /// Reference and output, m/s², sensor axes, in order.
    pub pairs: Vec<[[f64; 3]; 2]>,
    /// Raw samples of both left out because the range may have changed there and no epoch tells.
    pub without_unit: usize,
    /// Sample rate, Hz.
    pub rate_hz: f64,
    /// Whether both are of one sensor, over two links: their axes are the same.
    pub one_sensor: bool,
    /// Sensitivity that turned counts into m/s², or that a board is to be told for data in m/s².
    pub sensitivity: Option<Sensitivity>,
    /// The unit that the reference came in.
    pub unit: OutputUnit,
    /// Full-scale range, ± *g*, where the data do not say it and somebody did.
    pub range_g: Option<u8>,
    /// The accelerometer, where a device has said which.
    pub sensor: Option<SensorId>,
}

impl Paired {
    /// Rows of a CSV file with several accelerometers: `reference` (the first of the file if
    /// `None`) and `output` (the other one if `None` and there are two).
    ///
    /// `sensitivity`, LSB/g, is the output's, and the reference's too unless `reference_sensitivity` is
    /// given; where it is not given, the median magnitude of the reference's counts is taken for 1 g.
    /// Data in m/s² ask for it only so that a board can be told.
    ///
    /// # Errors
    /// Those of [`Dataset::from_csv`]; `usage` when the file does not have the two.
    pub fn from_csv(
        path: &Path,
        filter: Option<&Filter>,
        reference: Option<u32>,
        output: Option<u32>,
        sensitivity: Option<Sensitivity>,
        reference_sensitivity: Option<Sensitivity>,
    ) -> Result<Self> {
        let sensors: Vec<u32> = {
            let reader = CsvReader::open(path)?;
            let all = &reader.header().accelerometers;
            all.iter().copied().flatten().collect()
        };
        let name = path.display().to_string();
        let usage = |message: String, remedy: String| {
            HostError::new(ErrorCode::Usage, message, remedy).at(&name)
        };
        let list = || {
            sensors
                .iter()
                .map(u32::to_string)
                .collect::<Vec<_>>()
                .join(", ")
        };
        let [first, _, ..] = sensors[..] else {
            return Err(usage(
                "it has one accelerometer: there is nothing to compare it with".to_owned(),
                "name the columns of two `Accelerometer 0 X (…)`, `Accelerometer 1 X (…)`"
                    .to_owned(),
            ));
        };
        let reference = reference.unwrap_or(first);
        let others: Vec<u32> = sensors
            .iter()
            .copied()
            .filter(|s| *s != reference)
            .collect();
        let output = match (output, &others[..]) {
            (Some(output), _) => output,
            (None, [other]) => *other,
            (None, _) => {
                return Err(usage(
                    format!("it has {} accelerometers", sensors.len()),
                    format!(
                        "choose the one to calibrate with --accelerometer: {}",
                        list()
                    ),
                ));
            }
        };
        if output == reference {
            return Err(usage(
                format!("accelerometer {output} cannot be its own reference"),
                format!(
                    "choose two of {} with --accelerometer and --reference",
                    list()
                ),
            ));
        }
        let load = |sensor| {
            let options = LoadOptions {
                filter: filter.cloned(),
                accelerometer: Some(sensor),
                ..LoadOptions::default()
            };
            Dataset::from_csv(path, &options)
        };
        let (x, y) = (load(reference)?, load(output)?);
        let sensitivity = match (x.unit, sensitivity) {
            (_, Some(given)) => Some(given),
            (OutputUnit::Mps2, None) => None,
            (OutputUnit::Counts { .. }, None) if reference_sensitivity.is_some() => {
                return Err(usage(
                    "of the reference's counts it is said what they are worth, of the others' not"
                        .to_owned(),
                    "give --sensitivity too".to_owned(),
                ));
            }
            (OutputUnit::Counts { .. }, None) => Some(
                Sensitivity::from_lsb_per_g(median_magnitude(&x)).map_err(|error| {
                    usage(
                        format!("the reference's counts make no accelerometer: {error}"),
                        "give --sensitivity".to_owned(),
                    )
                })?,
            ),
        };
        let scale = |known: Option<Sensitivity>| match (x.unit, known) {
            (OutputUnit::Counts { .. }, Some(known)) => known.mps2_per_lsb(),
            _ => 1.0,
        };
        let scales = [
            scale(reference_sensitivity.or(sensitivity)),
            scale(sensitivity),
        ];
        Ok(Self {
            reference: format!("accelerometer {reference}"),
            output: format!("accelerometer {output}"),
            pairs: x
                .outputs
                .iter()
                .zip(&y.outputs)
                .map(|(x, y)| {
                    [
                        x.value.map(|v| v * scales[0]),
                        y.value.map(|v| v * scales[1]),
                    ]
                })
                .collect(),
            without_unit: 0,
            rate_hz: x.rate_hz,
            one_sensor: false,
            sensitivity,
            unit: x.unit,
            range_g: None,
            sensor: None,
            name,
        })
    }

    /// The same, taken at this full-scale range, ± *g*, where it is said.
    #[must_use]
    pub fn at_range(self, range_g: Option<u8>) -> Self {
        Self {
            range_g: range_g.or(self.range_g),
            ..self
        }
    }

    /// The raw samples of a recording that came over both links, the cable's as reference.
    ///
    /// # Errors
    /// Those of [`Recording::link`]; `no_rows` when no sample came over both.
    pub fn from_recording(recording: &Recording) -> Result<Self> {
        let cable = recording.link(Some(LinkRole::Cable))?;
        let wireless = recording.link(Some(LinkRole::Wireless))?;
        let same_start = wireless.boots.iter().filter_map(|theirs| {
            let ours = cable
                .boots
                .iter()
                .find(|ours| ours.start == theirs.start && !ours.raw.is_empty())?;
            Some((ours, theirs))
        });
        let mut without_unit = 0;
        let mut pairs = Vec::new();
        let mut sensor = None;
        let mut known: Option<(Sensitivity, u8, f64)> = None;
        for (ours, theirs) in same_start {
            let Some(mark) = ours.epochs.first() else {
                continue;
            };
            let Ok(sensitivity) = Sensitivity::from_lsb_per_g(mark.epoch.sensitivity_lsb_per_g)
            else {
                continue;
            };
            let rate_hz = 1e9 / f64::from(mark.epoch.period_ns.max(1));
            sensor = sensor.or(ours.sensor());
            known.get_or_insert((sensitivity, mark.epoch.range_g, rate_hz));
            // What one link has lost, the other may tell.
            let epochs = ours.epochs.iter().chain(&theirs.epochs);
            let units = RawUnits::of_epochs(epochs.map(|mark| &mark.epoch));
            for sample in &theirs.raw {
                let found = ours
                    .raw
                    .binary_search_by(|ours| sequence_order(ours.sequence, sample.sequence));
                let Ok(index) = found else { continue };
                let Some(unit) = units.of(sample.sequence) else {
                    without_unit += 1;
                    continue;
                };
                let both = [ours.raw[index].value, sample.value];
                pairs.push(both.map(|value| unit.mps2(value)));
            }
        }
        let Some((sensitivity, range_g, rate_hz)) = known.filter(|_| !pairs.is_empty()) else {
            return Err(HostError::new(
                ErrorCode::NoRows,
                "no raw sample came over both links",
                "record both at once with `wimu record LINK --cable LINK`, raw samples on both",
            )
            .at(&recording.name));
        };
        Ok(Self {
            name: recording.name.clone(),
            reference: "cable".to_owned(),
            output: "wireless".to_owned(),
            pairs,
            without_unit,
            rate_hz,
            one_sensor: true,
            sensitivity: Some(sensitivity),
            unit: OutputUnit::Counts {
                nominal: Some(sensitivity),
                range_g: Some(range_g),
            },
            range_g: None,
            sensor,
        })
    }

    /// While the reference, 0, or the output, 1, was held still.
    fn rests(&self, which: usize) -> Vec<Pose> {
        let mut rests = vec![Pose::default(); MAX_POSES];
        let samples = self.pairs.iter().map(|pair| (pair[which], None));
        let found = find_poses(samples, self.rate_hz, &mut rests);
        rests.truncate(found);
        rests
    }
}

/// An axis in a [`ReferenceReport`].
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AxisReport {
    /// Mean of output less reference, m/s².
    pub offset_m_s2: f64,
    /// Its standard deviation, 1 σ, m/s².
    pub offset_sd_m_s2: f64,
    /// Mean of the reference, m/s²: where the offset holds.
    pub at_m_s2: f64,
    /// Motion of the axis, m/s² rms.
    pub motion_m_s2: f64,
    /// What is left, mm/s² rms.
    pub rms_mm_s2: f64,
    /// Whether bias and scale factor could be told apart.
    pub separated: bool,
    /// What told how much of the noise is whose, where they were.
    pub noise_from: Option<NoiseSource>,
}

/// What tells how much of the noise is whose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NoiseSource {
    /// The user said it.
    Given,
    /// Both streams at rest.
    Rests,
    /// Neighbouring samples, which share the motion and not the noise.
    Neighbours,
    /// Nothing: the standard deviations reach from all noise on one side to all on the other.
    Bounds,
}

/// What `wimu calibrate --method reference` says, and the file that `wimu params push` reads.
#[derive(Clone, Debug, Serialize)]
pub struct ReferenceReport {
    /// [`CalibrationReport::SCHEMA`].
    pub schema: &'static str,
    /// `ok` or `refused`.
    pub status: &'static str,
    /// Why it was refused, and what to do.
    pub reason: Option<String>,
    /// What the numbers do not show and a user should know.
    pub remarks: Vec<String>,
    /// The data.
    pub source: String,
    /// `reference`.
    pub method: &'static str,
    /// What was estimated of every axis.
    pub terms: &'static [&'static str],
    /// What the reference is.
    pub reference: String,
    /// What was compared with it.
    pub output: String,
    /// Pairs of samples.
    pub samples: usize,
    /// Fewest degrees of freedom of a standard deviation.
    pub dof: Option<usize>,
    /// Noise of the output per noise of the reference, as given or as seen at rest.
    pub noise_ratio: Option<f64>,
    /// Whether it was seen at rest.
    pub noise_ratio_seen: bool,
    /// Parameters that nothing was seen of, by name.
    pub not_observed: Vec<String>,
    /// X, Y, Z.
    pub axes: Option<[AxisReport; 3]>,
    /// Nominal sensitivity, LSB/g; `None` for data in m/s² without one given.
    pub sensitivity_lsb_per_g: Option<f64>,
    /// Where the full-scale range of the parameters comes from.
    pub range_source: Option<Source>,
    /// The error model that makes the reference of the output.
    pub model: Option<ErrorTerms>,
    /// Standard deviations, 1 σ, in the model's shape; what datasheets make likely for what was not
    /// observed.
    pub sd: Option<ErrorTerms>,
    /// Covariance of the bias, then A row by row.
    pub covariance: Option<[[f64; Parameter::COUNT]; Parameter::COUNT]>,
    /// What a board takes; `None` without a sensitivity.
    pub parameters: Option<ParameterSet>,
    /// Id of that set.
    pub parameter_id: Option<String>,
}

impl ReferenceReport {
    /// Exit code of a command that ends with it: 0, or 3 when the data do not support an answer.
    pub fn exit_code(&self) -> u8 {
        if self.model.is_some() { 0 } else { 3 }
    }
}

/// Bias and scale factor of one stream against the other.
///
/// `noise_ratio` is the noise of the output per noise of the reference (standard deviations), where
/// it is known; else it is that seen at rest, else what neighbouring samples tell. `utc_s`, s since 1970 UTC, is for the parameter set to say. Data that do not support an answer
/// give a report that says so.
///
/// # Errors
/// `usage` when `noise_ratio` is not positive and finite.
pub fn compare_with_reference(
    data: &Paired,
    noise_ratio: Option<f64>,
    utc_s: Option<u64>,
) -> Result<ReferenceReport> {
    let given = |ratio: f64| {
        NoiseRatio::new(ratio, 1.0).ok_or_else(|| {
            HostError::new(
                ErrorCode::Usage,
                format!("a noise ratio of {ratio} is none"),
                "give --noise-ratio the output's noise per the reference's, 2 if it is twice as noisy",
            )
        })
    };
    let (ratio, known_from) = match noise_ratio {
        Some(ratio) => (Some(given(ratio)?), NoiseSource::Given),
        None => (
            noise_ratio_at([0, 1].map(|which| data.rests(which))),
            NoiseSource::Rests,
        ),
    };
    let mut transfer =
        ratio.map_or_else(ReferenceTransfer::of_unknown_noise, ReferenceTransfer::new);
    if data.one_sensor {
        transfer = transfer.of_one_sensor();
    }
    for [reference, output] in &data.pairs {
        transfer.push(*reference, *output);
    }
    let mut report = ReferenceReport {
        schema: CalibrationReport::SCHEMA,
        status: "refused",
        reason: None,
        remarks: Vec::new(),
        source: data.name.clone(),
        method: "reference",
        terms: &[],
        reference: data.reference.clone(),
        output: data.output.clone(),
        samples: data.pairs.len(),
        dof: None,
        noise_ratio: ratio.map(NoiseRatio::get),
        noise_ratio_seen: ratio.is_some() && known_from == NoiseSource::Rests,
        not_observed: Vec::new(),
        axes: None,
        sensitivity_lsb_per_g: data.sensitivity.map(Sensitivity::lsb_per_g),
        range_source: None,
        model: None,
        sd: None,
        covariance: None,
        parameters: None,
        parameter_id: None,
    };
    let found = match transfer.result() {
        Ok(found) => found,
        Err(refusal) => return Ok(refused(report, &refusal)),
    };
    if data.without_unit > 0 {
        report.remarks.push(format!(
            "{} samples are left out: the range may have changed, and the epoch that tells is lost",
            data.without_unit
        ));
    }
    report.dof = Some(dof(&found));
    report.axes = Some(found.axes.map(|axis| AxisReport {
        offset_m_s2: axis.offset_mps2,
        offset_sd_m_s2: axis.offset_sd_mps2,
        at_m_s2: axis.at_mps2,
        motion_m_s2: axis.motion_mps2,
        rms_mm_s2: axis.rms_mps2 * 1e3,
        separated: axis.line.is_some(),
        noise_from: axis.line.map(|line| match line.noise_from {
            NoiseFrom::Ratio => known_from,
            NoiseFrom::Neighbours => NoiseSource::Neighbours,
            NoiseFrom::Bounds => NoiseSource::Bounds,
        }),
    }));
    let model = match found.model() {
        Ok(model) => model,
        Err(error) => {
            report.reason = Some(format!(
                "the result is no accelerometer's: {error}; check the units of both streams; counts of \
                 another sensitivity than the output's ask for --reference-sensitivity"
            ));
            return Ok(report);
        }
    };
    let names = ["X", "Y", "Z"];
    for (axis, transfer) in names.into_iter().zip(&found.axes) {
        for (other, seen) in names.into_iter().zip(transfer.cross_axis) {
            if seen != 0.0 {
                report.remarks.push(format!(
                    "{axis} of the output sees {:+.1} % of {other} of the reference: their axes are not \
                     parallel; the model has it",
                    seen * 100.0
                ));
            }
        }
        let unseen = |line: &Line, other: usize| !data.one_sensor && !line.fitted[other];
        if let Some(line) = transfer.line {
            let out: Vec<_> = (0..3).filter(|&other| unseen(&line, other)).collect();
            if !out.is_empty() {
                let others: Vec<_> = out.iter().map(|&other| names[other]).collect();
                report.remarks.push(format!(
                    "{} of the reference hardly moved on its own: what {axis} of the output may see of it, \
                     2 % (1 σ), is in the ± of {axis}; move it through all orientations",
                    others.join(" and ")
                ));
            }
        }
    }
    report.not_observed = Parameter::ALL
        .into_iter()
        .filter(|parameter| match parameter.index() {
            0..3 => false,
            of_a => {
                let line = found.axes[(of_a - 3) / 3].line;
                line.is_none_or(|line| !line.fitted[(of_a - 3) % 3])
            }
        })
        .map(|parameter| parameter.to_string())
        .collect();
    let covariance = covariance(&found);
    let sd = |index: usize| covariance[index][index].sqrt();
    report.status = "ok";
    let fitted = |axis: &AxisTransfer| axis.line.map_or([false; 3], |line| line.fitted);
    report.terms = if found.axes.iter().all(|axis| fitted(axis) == [true; 3]) {
        &["bias", "scale", "misalignment"]
    } else if found.axes.iter().all(|axis| axis.line.is_some()) {
        &["bias", "scale"]
    } else if found.axes.iter().any(|axis| axis.line.is_some()) {
        &["bias", "scale where it moved"]
    } else {
        &["offset"]
    };
    report.model = Some(*model.terms());
    report.sd = Some(ErrorTerms {
        bias_mps2: [sd(0), sd(1), sd(2)],
        matrix: std::array::from_fn(|row| std::array::from_fn(|col| sd(3 + 3 * row + col))),
        ..super::numbers::no_terms()
    });
    report.covariance = Some(covariance);
    let range = Range::of(data.unit, data.range_g, data.sensitivity);
    let told = data.sensitivity.zip(range);
    report.range_source = told.map(|(_, range)| range.source);
    (report.remarks).extend(told.and_then(|(sensitivity, range)| range.remark(sensitivity)));
    report.parameters = told.map(|(sensitivity, range)| ParameterSet {
        model,
        quality: quality(&found, &covariance, utc_s),
        sensor: data.sensor,
        ..ParameterSet::uncalibrated(range.g, sensitivity)
    });
    report.parameter_id = report
        .parameters
        .as_ref()
        .map(|set| wimu_link::message::parameter_id(set).to_string());
    Ok(report)
}

/// The fewest degrees of freedom of any standard deviation.
fn dof(found: &Transfer) -> usize {
    let lines = found.axes.iter().filter_map(|axis| axis.line);
    let least = lines
        .flat_map(|line| line.dof)
        .fold(f64::INFINITY, f64::min);
    found.dof.min(least as usize)
}

/// Noise of the output per noise of the reference, from what both show while they are held still.
fn noise_ratio_at([reference, output]: [Vec<Pose>; 2]) -> Option<NoiseRatio> {
    let sd = |rests: &[Pose]| median(rests.iter().map(|rest| magnitude(rest.sd_mps2)));
    NoiseRatio::new(sd(&output)?, sd(&reference)?)
}

fn refused(mut report: ReferenceReport, refusal: &TransferRefusal) -> ReferenceReport {
    report.reason = Some(refusal.to_string());
    report
}

fn quality(
    found: &Transfer,
    covariance: &[[f64; Parameter::COUNT]; Parameter::COUNT],
    utc_s: Option<u64>,
) -> Option<CalibrationQuality> {
    let count = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
    let squares = found.axes.iter().map(|axis| axis.rms_mps2 * axis.rms_mps2);
    CalibrationQuality::new(QualityTerms {
        method: CalibrationMethod::Reference,
        utc_s,
        temperature: None,
        poses: count(dof(found) + 1),
        dof: count(dof(found)),
        rms_mps2: squares.sum::<f64>().sqrt() as f32,
        loo_rms_mps2: None,
        condition: None,
        covariance: ModelCovariance::from_matrix(covariance).ok()?,
        other_sd: TermDeviations::default(),
    })
    .ok()
}

/// What datasheets make likely of what the streams do not show.
const USUAL_SCALE: f64 = 0.03;
const USUAL_CROSS_AXIS: f64 = 0.02;

/// In the order of [`Parameter::ALL`].
fn covariance(found: &Transfer) -> [[f64; Parameter::COUNT]; Parameter::COUNT] {
    let mut covariance = [[0.0; Parameter::COUNT]; Parameter::COUNT];
    for (axis, transfer) in found.axes.iter().enumerate() {
        // b, then the row of A.
        let row: [usize; 4] = std::array::from_fn(|i| if i == 0 { axis } else { 2 + 3 * axis + i });
        let own = 3 + 4 * axis;
        match transfer.line {
            Some(line) => {
                for (&i, row_of) in row.iter().zip(line.covariance) {
                    for (&j, value) in row.iter().zip(row_of) {
                        covariance[i][j] = value;
                    }
                }
            }
            None => {
                // The scale factor is taken as 1, and what it may be off is in the bias.
                let (at, unseen) = (transfer.at_mps2, USUAL_SCALE * USUAL_SCALE);
                covariance[axis][axis] = transfer.offset_sd_mps2.powi(2) + at * at * unseen;
                covariance[axis][own] = -at * unseen;
                covariance[own][axis] = -at * unseen;
                covariance[own][own] = unseen;
            }
        }
        for &across in row.iter().skip(1).filter(|&&across| across != own) {
            // Of one sensor over two links, or with no line.
            if covariance[across][across] == 0.0 {
                covariance[across][across] = USUAL_CROSS_AXIS * USUAL_CROSS_AXIS;
            }
        }
    }
    covariance
}

impl fmt::Display for ReferenceReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "{}: {} against {}, {} samples on both",
            self.source, self.output, self.reference, self.samples,
        )?;
        let (Some(axes), Some(model), Some(sd)) = (&self.axes, &self.model, &self.sd) else {
            return write!(
                out,
                "refused: {}",
                self.reason.as_deref().unwrap_or("no reason")
            );
        };
        for (axis, (name, report)) in ["X", "Y", "Z"].into_iter().zip(axes).enumerate() {
            if report.separated {
                writeln!(
                    out,
                    "{name}: bias {:+.5} ± {:.5} m/s², scale factor {:.6} ± {:.6}; {:.2} mm/s² rms left; \
                     {}",
                    model.bias_mps2[axis],
                    sd.bias_mps2[axis],
                    model.matrix[axis][axis],
                    sd.matrix[axis][axis],
                    report.rms_mm_s2,
                    match report.noise_from {
                        Some(NoiseSource::Given) => "ratio of the noises as given",
                        Some(NoiseSource::Rests) => "ratio of the noises as seen at rest",
                        Some(NoiseSource::Neighbours) | None =>
                            "noises parted by neighbouring samples",
                        Some(NoiseSource::Bounds) =>
                            "nothing parts the noises: ± reaches from all of it on one side to all on the \
                             other; hold both still for a while, or give --noise-ratio",
                    }
                )?;
            } else {
                writeln!(
                    out,
                    "{name}: offset {:+.5} ± {:.5} m/s² at {:+.2} m/s²; it moved {:.2} m/s² rms only: \
                     bias and scale factor cannot be told apart",
                    report.offset_m_s2, report.offset_sd_m_s2, report.at_m_s2, report.motion_m_s2
                )?;
            }
        }
        for remark in &self.remarks {
            writeln!(out, "{remark}")?;
        }
        write!(
            out,
            "± is 1 σ of {} degrees of freedom",
            self.dof.unwrap_or(0)
        )?;
        if self.parameters.is_none() {
            write!(out, "\n{}", super::words::NO_SENSITIVITY)?;
        }
        Ok(())
    }
}
