//! The result of a calibration: one struct that is JSON, text and page.

use std::cmp::Ordering;
use std::f64::consts::{FRAC_PI_6, PI};
use std::fmt;

use serde::{Deserialize, Serialize};
use wimu_calib::{Estimate, Method, Orientation, Parameter, Pose};
use wimu_model::{
    CalibratedTemperature, ErrorTerms, ParameterSet, STANDARD_GRAVITY_MPS2, TemperatureTerms,
};

use super::{Calibration, DatasheetReport, GyroscopeReport, MethodChoice, magnitude};
use crate::Problem;
use crate::chart::{Chart, Series, Style, broken};
use crate::digits::{signed, signed_with_sd, significant, with_sd};
use crate::document::Document;
use crate::plural::counted;
use crate::problem::{Outcome, Severity};
use crate::recording::{RateSource, Samples};

/// Largest number of poses that a report lists.
pub(super) const MAX_POSES: usize = 1000;
/// Suggested poses in the text of a refusal.
const SUGGESTED: usize = 3;
/// Smallest residual on a logarithmic axis, mm/s².
const LEAST_SHOWN_MM_S2: f64 = 1e-3;
/// Names of the axes.
pub(super) const AXES: [&str; 3] = ["X", "Y", "Z"];
/// Misalignments by name, row and column of A.
pub(super) const MISALIGNMENTS: [(&str, usize, usize); 6] = [
    ("m_yx", 0, 1),
    ("m_zx", 0, 2),
    ("m_xy", 1, 0),
    ("m_zy", 1, 2),
    ("m_xz", 2, 0),
    ("m_yz", 2, 1),
];

/// Where a number comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Source {
    /// Given by the user.
    Given,
    /// The default.
    #[default]
    Default,
    /// Reported by the board.
    Board,
    /// The fit, so that the mean scale factor is 1.
    Fit,
    /// Computed from a latitude and a height.
    Latitude,
    /// Assumed: the range that a 16-bit sensor has at this sensitivity.
    SixteenBits,
}

/// A recommended pose.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NextPose {
    /// Direction that points up, a unit vector in sensor axes.
    pub up: [f64; 3],
    /// The same as text.
    pub text: String,
    /// Instruction to a person.
    pub instruction: String,
}

impl From<Orientation> for NextPose {
    fn from(orientation: Orientation) -> Self {
        Self {
            up: orientation.up(),
            text: orientation.to_string(),
            instruction: orientation.instruction().to_string(),
        }
    }
}

/// How good a calibration is: its error at 1 *g* in the worst orientation, against a limit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Grade {
    /// The larger of the predicted standard deviation in the worst orientation and the leave-one-out error, mm/s².
    pub error_mm_s2: f64,
    /// The limit, mm/s²; `None` where neither a target is given nor the noise is known.
    pub limit_mm_s2: Option<f64>,
    /// What the limit is.
    pub criterion: Criterion,
    /// Whether the error is within the limit.
    pub met: Option<bool>,
}

/// What the error of a calibration is compared with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Criterion {
    /// The given target.
    Target,
    /// The noise of one sample, 1 σ: a smaller error is not seen in a sample.
    Noise,
    /// Nothing: pose means do not show the noise.
    None,
}

impl Grade {
    pub(super) fn new(estimate: &Estimate, poses: &[Pose], target_mps2: Option<f64>) -> Self {
        let left_out = estimate.loo_orientation_rms_mps2.or(estimate.loo_rms_mps2);
        let error = 1e3 * estimate.worst_sd_mps2.max(left_out.unwrap_or_default());
        let sd = |pose: &Pose| magnitude(pose.sd_mps2) / f64::sqrt(3.0);
        let noise = super::median(poses.iter().map(sd)).filter(|sd| *sd > 0.0);
        let (limit, criterion) = match (target_mps2, noise) {
            (Some(target), _) => (Some(target), Criterion::Target),
            (None, Some(noise)) => (Some(noise), Criterion::Noise),
            (None, None) => (None, Criterion::None),
        };
        let limit = limit.map(|mps2| mps2 * 1e3);
        Self {
            error_mm_s2: error,
            limit_mm_s2: limit,
            criterion,
            met: limit.map(|limit| error <= limit),
        }
    }
}

impl fmt::Display for Grade {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unit = |mm_s2: f64| {
            let mg = significant(mm_s2 / STANDARD_GRAVITY_MPS2, 3);
            format!("{} mm/s² ({mg} mg)", significant(mm_s2, 3))
        };
        write!(out, "error in the worst orientation {}", unit(self.error_mm_s2))?;
        let relation = match (self.criterion, self.met) {
            (Criterion::Target, Some(true)) => "meets the target of",
            (Criterion::Target, _) => "misses the target of",
            (Criterion::Noise, Some(true)) => "below the noise of a sample,",
            (Criterion::Noise, _) => "above the noise of a sample,",
            (Criterion::None, _) => return Ok(()),
        };
        write!(out, ", {relation} {}", unit(self.limit_mm_s2.unwrap_or_default()))
    }
}

/// The numbers of an estimate.
#[derive(Clone, Debug, Serialize)]
pub struct Fit {
    /// How good it is.
    pub grade: Grade,
    /// The parameters of A and b that were fitted, by name.
    pub fitted: Vec<String>,
    /// Parameters that were not observed, by name: the model has the ideal value, `sd` the standard deviation typical of
    /// datasheets.
    pub not_observed: Vec<String>,
    /// Degrees of freedom.
    pub dof: usize,
    /// |f| − g over all poses, mm/s² rms.
    pub rms_mm_s2: f64,
    /// |f| − g over the fitted poses, mm/s² rms.
    pub fitted_rms_mm_s2: f64,
    /// The largest over all poses, mm/s².
    pub max_mm_s2: f64,
    /// |f| − g of each fitted pose under the model fitted without it, mm/s² rms; `None` where no pose can be left out.
    pub loo_rms_mm_s2: Option<f64>,
    /// The same with all visits of the pose's orientation left out, which decides; `None` where no orientation was
    /// visited again.
    pub loo_orientation_rms_mm_s2: Option<f64>,
    /// Orientations among the poses: those within 10° of each other are visits of one.
    pub orientations: usize,
    /// Condition number of the fit; 1 is best.
    pub condition: f64,
    /// Expected standard deviation of |f| − g in the worst orientation, mm/s².
    pub worst_sd_mm_s2: f64,
    /// Mean temperature of the poses, °C.
    pub temperature_c: Option<f64>,
    /// Lowest and highest temperature of the poses, °C: temperature terms are valid between them.
    pub temperature_range_c: Option<[f64; 2]>,
    /// Bias drift over the session, where it was fitted: the model's bias is that at the end.
    pub drift: Option<DriftReport>,
    /// Placement error that the standard deviations include, 1 σ, where orientations were known.
    pub placement_sd_deg: Option<f64>,
    /// Repeatability of positions beyond noise and placement, mm/s², 1 σ; included in the standard deviations.
    pub revisit_sd_mm_s2: Option<f64>,
    /// The error model.
    pub model: ErrorTerms,
    /// Standard deviations, 1 σ, in the model's shape; 0 for terms that are fixed or not fitted.
    pub sd: ErrorTerms,
    /// Half width of the 95 % interval (Student's t) of the bias, then of A row by row; `None` for what was not observed.
    pub half_width_95: [Option<f64>; Parameter::COUNT],
    /// Covariance of the bias, then A row by row.
    pub covariance: [[f64; Parameter::COUNT]; Parameter::COUNT],
}

/// Bias drift over a session, linear in time.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct DriftReport {
    /// From the first pose to the last, m/s².
    pub change_m_s2: [f64; 3],
    /// Its standard deviation, m/s².
    pub sd_m_s2: [f64; 3],
    /// From the first pose to the last, s (poses, where they have no times).
    pub span_s: f64,
}

/// Standard deviations of a model's terms in its shape, from those of the 12 parameters.
pub(super) fn deviations(sd: impl Fn(usize) -> f64, slopes: [[f64; 3]; 2]) -> ErrorTerms {
    ErrorTerms {
        bias_mps2: [0, 1, 2].map(&sd),
        matrix: [3, 6, 9].map(|row| [row, row + 1, row + 2].map(&sd)),
        temperature: TemperatureTerms {
            reference_c: 0.0,
            bias_mps2_per_k: slopes[0],
            scale_per_k: slopes[1],
            ..TemperatureTerms::default()
        },
        nonlinearity: [0.0; 3],
    }
}

impl Fit {
    pub(super) fn new(estimate: &Estimate, grade: Grade) -> Self {
        let (term_sd, covariance) = (&estimate.term_sd, &estimate.covariance);
        let of_sides = match estimate.method {
            Method::SixPosition { placement_sd_rad, revisit_sd_mps2, .. } => {
                Some((placement_sd_rad, revisit_sd_mps2))
            }
            _ => None,
        };
        let unseen = estimate.not_observed();
        let mm = |mps2: Option<f64>| mps2.map(|mps2| mps2 * 1e3);
        Self {
            grade,
            fitted: estimate.fitted.iter().map(|p| p.to_string()).collect(),
            not_observed: unseen.iter().map(|p| p.to_string()).collect(),
            dof: estimate.dof,
            rms_mm_s2: estimate.rms_mps2 * 1e3,
            fitted_rms_mm_s2: estimate.fitted_rms_mps2 * 1e3,
            max_mm_s2: estimate.max_mps2 * 1e3,
            loo_rms_mm_s2: mm(estimate.loo_rms_mps2),
            loo_orientation_rms_mm_s2: mm(estimate.loo_orientation_rms_mps2),
            orientations: estimate.orientations,
            condition: estimate.condition,
            worst_sd_mm_s2: estimate.worst_sd_mps2 * 1e3,
            temperature_c: estimate.temperature_c,
            temperature_range_c: estimate.temperature_range_c,
            drift: estimate.drift.map(|drift| DriftReport {
                change_m_s2: drift.change_mps2,
                sd_m_s2: term_sd.drift_mps2,
                span_s: drift.span_s,
            }),
            placement_sd_deg: of_sides.map(|(placement, _)| placement.to_degrees()),
            revisit_sd_mm_s2: mm(of_sides.map(|(_, revisit)| revisit)),
            model: *estimate.model.terms(),
            sd: ErrorTerms {
                nonlinearity: term_sd.nonlinearity,
                ..deviations(
                    |place| covariance.sd(Parameter::ALL[place]),
                    [term_sd.bias_mps2_per_k, term_sd.scale_per_k],
                )
            },
            half_width_95: Parameter::ALL.map(|parameter| {
                (!unseen.contains(parameter)).then(|| estimate.half_width_95(parameter))
            }),
            covariance: *covariance.matrix(),
        }
    }
}

/// One static pose.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct StaticPose {
    /// Mean output at the nominal sensitivity, m/s².
    pub mean_m_s2: [f64; 3],
    /// Standard deviation of a sample, m/s²; 0 where it is unknown.
    pub sd_m_s2: [f64; 3],
    /// Number of samples in the mean.
    pub samples: u32,
    /// Its first row or sample, from 0.
    pub first_sample: u64,
    /// Its middle, s.
    pub time_s: f64,
    /// Mean temperature, °C.
    pub temperature_c: Option<f64>,
    /// |f| − g after correction, mm/s².
    pub residual_mm_s2: Option<f64>,
}

impl StaticPose {
    pub(super) fn new(pose: &Pose, estimate: Option<&Estimate>) -> Self {
        Self {
            mean_m_s2: pose.mean_mps2,
            sd_m_s2: pose.sd_mps2,
            samples: pose.samples,
            first_sample: pose.first_sample,
            time_s: pose.time_s,
            temperature_c: pose.temperature_c,
            residual_mm_s2: estimate.map(|estimate| estimate.residual_mps2(pose) * 1e3),
        }
    }
}

/// The result of a calibration: the JSON of `wimu calibrate --json`, with the numbers of the fit.
#[derive(Clone, Debug, Serialize)]
pub struct CalibrationReport {
    /// Status and findings.
    #[serde(skip)]
    pub outcome: Outcome,
    /// The data.
    pub source: String,
    /// `multi-position`, `six-position`, `four-angle` or `three-angle`.
    pub method: &'static str,
    /// Terms that were fitted.
    pub terms: Vec<&'static str>,
    /// Number of static poses found or given.
    pub poses: usize,
    /// Sample rate at which poses were searched, Hz; `None` for pose means.
    pub rate_hz: Option<f64>,
    /// Source of the rate.
    pub rate_source: Option<RateSource>,
    /// Gravity, m/s².
    pub gravity_m_s2: f64,
    /// Its standard deviation, m/s².
    pub gravity_sd_m_s2: f64,
    /// Source of gravity.
    pub gravity_source: Source,
    /// Unit of the data: `LSB`, or `m/s²` for g too.
    pub unit: &'static str,
    /// Nominal sensitivity, LSB/g; `None` for data in m/s² without a given one.
    pub sensitivity_lsb_per_g: Option<f64>,
    /// Source of the sensitivity.
    pub sensitivity_source: Option<Source>,
    /// Full-scale range, ± *g*; `None` where it is unknown.
    pub range_g: Option<u8>,
    /// Source of the range.
    pub range_source: Option<Source>,
    /// |y| − g over all poses before correction, mm/s² rms.
    pub uncalibrated_rms_mm_s2: Option<f64>,
    /// The estimate, if there is one.
    #[serde(flatten)]
    pub fit: Option<Fit>,
    /// Poses left out of the fit, by index from 0.
    pub rejected_poses: Vec<usize>,
    /// Number of poses left out; of very many, not all are listed.
    pub rejected: usize,
    /// Recommended poses, the most useful first: against a refusal, or to improve the answer.
    pub next_poses: Vec<NextPose>,
    /// How many more poses are worthwhile: each lowers the expected error by 3 % or more.
    pub poses_worth_adding: usize,
    /// The poses that were found or given; empty above 1000.
    pub static_poses: Vec<StaticPose>,
    /// The gyroscope, if it was calibrated.
    pub gyroscope: Option<GyroscopeReport>,
    /// Comparison with the sensor's datasheet, where the sensor is known.
    pub datasheet: Option<DatasheetReport>,
    /// The set for a board; `None` when the data's sensitivity is unknown.
    pub parameters: Option<ParameterSet>,
    /// Id of that set.
    pub parameter_id: Option<String>,
    /// The calibration file.
    #[serde(skip)]
    pub file: Option<Calibration>,
    /// What was estimated, if there is an answer.
    #[serde(skip)]
    pub estimate: Option<Estimate>,
}

impl fmt::Display for CalibrationReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(fit) = &self.fit else {
            write!(out, "{}\n{}", self.outcome, self.given())?;
            for pose in self.next_poses.iter().take(SUGGESTED) {
                write!(out, "\nadd a pose with {}: {}", pose.text, pose.instruction)?;
            }
            return Ok(());
        };
        writeln!(out, "{}\n{}", self.answer(fit), self.given())?;
        parameters(&fit.model, &fit.sd, &fit.fitted, &fit.not_observed, out)?;
        if let Some(gyroscope) = &self.gyroscope {
            write!(out, "{gyroscope}")?;
        }
        self.quality(fit, out)?;
        write!(out, "{}", self.more_poses())
    }
}

impl CalibrationReport {
    /// Error before and after, and how good that is.
    fn answer(&self, fit: &Fit) -> String {
        let before = significant(self.uncalibrated_rms_mm_s2.unwrap_or_default(), 3);
        let (after, how) = match fit.loo_orientation_rms_mm_s2.or(fit.loo_rms_mm_s2) {
            Some(loo) => (loo, "leave-one-out"),
            None => (fit.fitted_rms_mm_s2, "in sample: no pose can be left out"),
        };
        let after = significant(after, 3);
        let is_warning = |problem: &&Problem| problem.severity == Severity::Warning;
        let warnings = match self.outcome.findings.iter().filter(is_warning).count() {
            0 => String::new(),
            count => format!("; {}", counted(count, "warning")),
        };
        format!("|f| − g {before} mm/s² rms before, {after} after ({how}); {}{warnings}", fit.grade)
    }

    /// Data, method and what was taken as known.
    fn given(&self) -> String {
        let uncertain = match self.gravity_sd_m_s2 {
            0.0 => String::new(),
            sd => format!(" ± {sd}"),
        };
        let (poses, gravity) = (counted(self.poses, "static pose"), self.gravity_m_s2);
        let (source, method) = (&self.source, self.method);
        let text = format!("{source}: {poses}, {method}, g = {gravity:.5}{uncertain} m/s²");
        let Some(lsb_per_g) = self.sensitivity_lsb_per_g else { return text };
        let source = match self.sensitivity_source {
            Some(Source::Fit) => "mean of the fit",
            Some(Source::Board) => "as recorded",
            _ => "given",
        };
        format!("{text}, {lsb_per_g:.1} LSB/g ({source})")
    }

    /// The numbers by which the fit is judged.
    fn quality(&self, fit: &Fit, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let all = match self.rejected {
            0 => String::new(),
            _ => format!(" ({} over all poses)", significant(fit.rms_mm_s2, 3)),
        };
        let sizes = self.static_poses.iter().map(|pose| pose.residual_mm_s2.map(f64::abs));
        let worst =
            sizes.enumerate().max_by(|a, b| a.1.partial_cmp(&b.1).unwrap_or(Ordering::Equal));
        let at = worst.map_or(String::new(), |(pose, _)| format!(" at pose {pose} (from 0)"));
        writeln!(
            out,
            "in sample {} mm/s² rms{all}, largest {}{at}; condition {:.1}, {} degrees of freedom; ± is 1 σ of this \
             session",
            significant(fit.fitted_rms_mm_s2, 3),
            significant(fit.max_mm_s2, 3),
            fit.condition,
            fit.dof
        )?;
        if let Some(drift) = &fit.drift {
            let [x, y, z] = drift.change_m_s2.map(|axis| signed(axis * 1e3, 3));
            let span_s = drift.span_s;
            writeln!(
                out,
                "bias drift over {span_s:.0} s: {x} {y} {z} mm/s²; the bias is that at the end"
            )?;
        }
        let range = fit.temperature_range_c.map(|[low, high]| CalibratedTemperature {
            mean_c: fit.model.temperature.reference_c as f32,
            lowest_c: low as f32,
            highest_c: high as f32,
        });
        temperature(&fit.model, &fit.sd, range, out)
    }

    fn more_poses(&self) -> String {
        if self.method != MethodChoice::MultiPosition.name() {
            return "place the sensor more accurately rather than adding poses".to_owned();
        }
        match (self.poses_worth_adding, self.next_poses.first()) {
            (0, _) | (_, None) => "more poses would improve it little".to_owned(),
            (1, Some(next)) => format!("one more pose is worthwhile: {}", next.instruction),
            (more, Some(next)) => {
                format!("{more} more poses are worthwhile; the next: {}", next.instruction)
            }
        }
    }

    /// The report as one HTML page: the result, the samples with the poses found in them, |f| − g of each
    /// pose before and after, the poses on a sphere, their table, and the text.
    pub fn page(&self, samples: &Samples<'_>) -> Document {
        let title = format!("Calibration of {}", self.source);
        let mut page = page(title, &self.outcome, &self.to_string(), 0);
        if self.static_poses.is_empty() {
            return page;
        }
        let cells = |(k, pose): (usize, &StaticPose)| {
            let [x, y, z] = pose.mean_m_s2;
            let noise = magnitude(pose.sd_m_s2);
            let left_out = self.rejected_poses.contains(&k);
            vec![
                k.to_string(),
                format!("{x:+.4} {y:+.4} {z:+.4}"),
                pose.samples.to_string(),
                // Unknown for pose means.
                if noise > 0.0 { format!("{:.2}", noise * 1e3) } else { String::new() },
                pose.temperature_c.map_or(String::new(), |celsius| format!("{celsius:.1}")),
                pose.residual_mm_s2.map_or(String::new(), |residual| format!("{residual:+.3}")),
                if left_out { "left out" } else { "" }.to_owned(),
            ]
        };
        let rows: Vec<Vec<String>> = self.static_poses.iter().enumerate().map(cells).collect();
        let head =
            ["pose", "mean output, m/s²", "samples", "noise, mm/s²", "°C", "|f| − g, mm/s²", ""];
        if let Some(signal) = signal(samples, self.unit, &self.static_poses) {
            page.chart(&signal);
        }
        page.chart(&self.residuals()).chart(&self.sphere()).table("Static poses", &head, &rows);
        page
    }

    /// |f| − g of each pose before and after correction.
    fn residuals(&self) -> Chart {
        let before = |pose: &StaticPose| (magnitude(pose.mean_m_s2) - self.gravity_m_s2) * 1e3;
        let before = self.static_poses.iter().map(|pose| Some(before(pose)));
        let after = self.static_poses.iter().map(|pose| pose.residual_mm_s2);
        let series = vec![sizes("before correction", before), sizes("after correction", after)];
        Chart {
            log: true, ..Chart::new("Size of |f| − g in each pose", "pose", "mm/s²", series)
        }
    }

    /// The upward directions of the poses on the unit sphere in sensor axes.
    fn sphere(&self) -> Chart {
        let unit = |up: [f64; 3]| up.map(|axis| axis / magnitude(up));
        let poses = |name: &str, left_out: bool| {
            let all = self.static_poses.iter().enumerate();
            let (labels, up): (Vec<String>, Vec<[f64; 3]>) = all
                .filter(|(k, _)| self.rejected_poses.contains(k) == left_out)
                .map(|(k, pose)| (k.to_string(), unit(pose.mean_m_s2)))
                .unzip();
            Series { labels, ..Series::space(name, Style::Dots, &up) }
        };
        let advised: Vec<_> = self.next_poses.iter().map(|pose| unit(pose.up)).collect();
        let mut series = vec![
            poses("pose held", false),
            poses("left out", true),
            Series::space("pose to add", Style::Dots, &advised),
        ];
        series.retain(|series| !series.points.is_empty());
        let axis = |k: usize, end: f64| std::array::from_fn(|i| if i == k { end } else { 0.0 });
        let axes = [0, 1, 2].map(|k| [axis(k, 1.15), axis(k, -1.15), [f64::NAN; 3]]);
        let labels = ["+X", "−X", "", "+Y", "−Y", "", "+Z", "−Z", ""];
        series.push(Series {
            labels: labels.map(String::from).into(),
            ..Series::space("", Style::Guide, axes.as_flattened())
        });
        series.push(Series::space("", Style::Guide, &graticule()));
        Chart {
            title: "Upward directions of the poses: they should cover the sphere".to_owned(),
            equal: true,
            series,
            ..Chart::default()
        }
    }
}

/// The samples over time, with the rests that are poses; `None` for pose means.
fn signal(samples: &Samples<'_>, unit: &str, poses: &[StaticPose]) -> Option<Chart> {
    let last = samples.len().checked_sub(1).filter(|_| !samples.are_poses())?;
    let times_s = Vec::from_iter((0..=last).map(|index| samples.since_start_s(index)));
    let lines = AXES.into_iter().enumerate().map(|(axis, name)| {
        let values = samples.values().map(|value| value[axis]);
        Series::line(name, broken(times_s.iter().copied().zip(values).collect()))
    });
    let marked = |pose: &StaticPose| {
        let first = pose.first_sample as usize;
        let at = |index: usize| times_s[index.min(last)];
        (at(first), at(first + pose.samples as usize))
    };
    let lines = lines.collect();
    Some(Chart {
        marked: poses.iter().map(marked).collect(),
        note: "Grey: the rests that were used as poses.".to_owned(),
        ..Chart::new("Output of the accelerometer", "time, s", unit, lines)
    })
}

/// Sizes, mm/s², on a logarithmic axis.
pub(super) fn sizes(name: &str, values: impl Iterator<Item = Option<f64>>) -> Series {
    let points = values
        .enumerate()
        .filter_map(|(k, value)| Some((k as f64, value?.abs().max(LEAST_SHOWN_MM_S2))));
    Series::dots(name, points.collect())
}

/// A page with the refusal, or line `result` of the text of the command as its result.
pub(super) fn page(title: String, outcome: &Outcome, text: &str, result: usize) -> Document {
    let mut page = Document::new(title);
    match &outcome.reason {
        Some(_) => page.result(&outcome.to_string()),
        None => page.result(text.lines().nth(result).unwrap_or_default()),
    };
    page.printed(text).findings(&outcome.findings);
    page
}

/// Circles of latitude and longitude on the unit sphere, 30° apart.
fn graticule() -> Vec<[f64; 3]> {
    let point = |latitude: f64, longitude: f64| {
        let (up, across) = latitude.sin_cos();
        [across * longitude.cos(), across * longitude.sin(), up]
    };
    let circle = |of: &dyn Fn(f64) -> [f64; 3]| {
        let angles = (0..=48).map(|k| f64::from(k) * PI / 24.0);
        let points: Vec<_> = angles.map(of).chain([[f64::NAN; 3]]).collect();
        points
    };
    let parallels = (-2..=2).flat_map(|k| circle(&|angle| point(f64::from(k) * FRAC_PI_6, angle)));
    let meridians = (0..6).flat_map(|k| circle(&|angle| point(angle, f64::from(k) * FRAC_PI_6)));
    parallels.chain(meridians).collect()
}

/// A line for each axis, and one of the misalignments.
pub(super) fn parameters(
    model: &ErrorTerms,
    sd: &ErrorTerms,
    fitted: &[String],
    not_observed: &[String],
    out: &mut fmt::Formatter<'_>,
) -> fmt::Result {
    let has = |names: &[String], name: String| names.contains(&name);
    for (axis, name) in AXES.into_iter().enumerate() {
        let (bias, bias_sd) = (model.bias_mps2[axis], sd.bias_mps2[axis]);
        if has(not_observed, format!("bias {name}")) {
            write!(out, "{name}: bias not observed, taken as 0 ± {bias_sd:.1} m/s², ")?;
        } else {
            let mg = signed(bias * 1e3 / STANDARD_GRAVITY_MPS2, 3);
            write!(out, "{name}: bias {} m/s² ({mg} mg), ", signed_with_sd(bias, bias_sd))?;
        }
        let (scale, scale_sd) = (model.matrix[axis][axis], sd.matrix[axis][axis]);
        if has(fitted, format!("scale factor {name}")) {
            writeln!(out, "scale factor {}", with_sd(scale, scale_sd))?;
        } else {
            writeln!(out, "scale factor not observed, taken as 1 ± {scale_sd:.2}")?;
        }
    }
    let seen = |(name, ..): &(&str, _, _)| has(fitted, format!("misalignment {name}"));
    let text = |(name, r, c): (&str, usize, usize)| {
        let known = signed_with_sd(model.matrix[r][c] * 1e3, sd.matrix[r][c] * 1e3);
        format!("{name} {known}")
    };
    let misaligned: Vec<String> = MISALIGNMENTS.into_iter().filter(seen).map(text).collect();
    if misaligned.is_empty() {
        return Ok(());
    }
    writeln!(out, "misalignment, mrad: {}", misaligned.join(", "))
}

/// A line of the temperature coefficients, where they were fitted.
pub(super) fn temperature(
    model: &ErrorTerms,
    sd: &ErrorTerms,
    valid: Option<CalibratedTemperature>,
    out: &mut fmt::Formatter<'_>,
) -> fmt::Result {
    let (slopes, slopes_sd) = (&model.temperature, &sd.temperature);
    let Some(range) = valid.filter(|_| slopes_sd.bias_mps2_per_k[0] > 0.0) else {
        return Ok(());
    };
    let of = |value: [f64; 3], sd: [f64; 3], unit: f64| {
        [0, 1, 2].map(|k| signed_with_sd(value[k] * unit, sd[k] * unit)).join(", ")
    };
    writeln!(
        out,
        "per K from {:.1} °C, valid from {:.1} to {:.1} °C: bias {} mm/s², scale factor {} ppm",
        slopes.reference_c,
        range.lowest_c,
        range.highest_c,
        of(slopes.bias_mps2_per_k, slopes_sd.bias_mps2_per_k, 1e3),
        of(slopes.scale_per_k, slopes_sd.scale_per_k, 1e6),
    )
}
