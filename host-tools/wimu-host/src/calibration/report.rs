//! The result of a calibration: one struct that is JSON, text and page.

use std::f64::consts::{FRAC_PI_6, PI};
use std::fmt;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use wimu_calib::{Estimate, GyroscopeEstimate, Orientation, Parameter, Parameters, Pose, Term};
use wimu_model::{ParameterSet, STANDARD_GRAVITY_MPS2};

use super::{Calibration, magnitude, median, parameter_id};
use crate::chart::{Chart, Series, Style, broken};
use crate::digits::significant;
use crate::document::Document;
use crate::problem::Outcome;
use crate::recording::Samples;

/// Names of the axes.
pub(super) const AXES: [&str; 3] = ["X", "Y", "Z"];

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

/// The result of a calibration by any method. Its JSON is that of `wimu calibrate --json`, its `Display` the text.
#[derive(Clone, Debug, Default, Serialize)]
pub struct CalibrationReport {
    /// Status and findings.
    #[serde(skip)]
    pub outcome: Outcome,
    /// The data.
    #[serde(skip)]
    pub source: String,
    /// The numbers of the method.
    #[serde(flatten)]
    pub numbers: Value,
    /// The set for a board; `None` without an answer, or when the data's sensitivity is unknown.
    pub parameters: Option<ParameterSet>,
    /// Id of that set.
    pub parameter_id: Option<String>,
    /// The calibration file, if there is an answer.
    #[serde(skip)]
    pub file: Option<Calibration>,
    /// The report as an HTML page, without the samples.
    #[serde(skip)]
    pub page: Document,
    /// What was estimated from poses, if there is an answer.
    #[serde(skip)]
    pub estimate: Option<Estimate>,
    /// How good the estimate is.
    #[serde(skip)]
    pub grade: Option<Grade>,
    /// The static poses that were found or given, m/s² at the nominal sensitivity.
    #[serde(skip)]
    pub poses: Vec<Pose>,
    /// The gyroscope, if it was calibrated with the poses.
    #[serde(skip)]
    pub gyroscope: Option<GyroscopeEstimate>,
    /// Recommended orientations, the most useful first: against a refusal, or to improve the answer.
    #[serde(skip)]
    pub next_poses: Vec<Orientation>,
    #[serde(skip)]
    text: String,
}

impl CalibrationReport {
    /// Of `numbers`, an object with the name of the data as `source`. The text is `head`, a refusal, and `lines`; a page begins
    /// with the refusal or the first of `lines`.
    pub(crate) fn new(
        title: String,
        outcome: Outcome,
        head: String,
        lines: Vec<String>,
        numbers: Value,
        file: Option<Calibration>,
    ) -> Self {
        let parameters = file.as_ref().and_then(|file| file.parameters().ok());
        let refusal = outcome.reason.as_ref().map(|_| outcome.to_string());
        let mut page = Document::new(title);
        page.result(refusal.as_ref().or(lines.first()).map_or("", |line| line));
        let text = [head].into_iter().chain(refusal).chain(lines).filter(|line| !line.is_empty());
        let text = Vec::from_iter(text).join("\n");
        page.printed(&text).findings(&outcome.findings);
        Self {
            outcome,
            source: numbers["source"].as_str().unwrap_or_default().to_owned(),
            numbers,
            parameter_id: parameters.as_ref().map(|set| parameter_id(set).to_string()),
            parameters,
            file,
            page,
            text,
            ..Self::default()
        }
    }

    /// The same with these charts on the page.
    #[must_use]
    pub(super) fn draw(mut self, charts: impl IntoIterator<Item = Chart>) -> Self {
        charts.into_iter().for_each(|chart| {
            self.page.chart(&chart);
        });
        self
    }

    /// Nominal sensitivity, LSB/g; `None` for data in m/s² without a given one.
    pub fn sensitivity_lsb_per_g(&self) -> Option<f64> {
        self.file.as_ref()?.sensor().accelerometer.sensitivity_lsb_per_g
    }

    /// The page with the samples over time and the rests that are poses; without them for pose means.
    pub fn page_with(&self, samples: &Samples<'_>) -> Document {
        let mut page = self.page.clone();
        let Some(last) = samples.len().checked_sub(1).filter(|_| !samples.are_poses()) else {
            return page;
        };
        let times_s = Vec::from_iter((0..=last).map(|index| samples.since_start_s(index)));
        let lines = AXES.into_iter().enumerate().map(|(axis, name)| {
            let values = samples.values().map(|value| value[axis]);
            Series::line(name, broken(times_s.iter().copied().zip(values).collect()))
        });
        let marked = self.poses.iter().map(|pose| {
            let first = pose.first_sample as usize;
            [first, first + pose.samples as usize].map(|index| times_s[index.min(last)]).into()
        });
        let unit = self.numbers["unit"].as_str().unwrap_or_default();
        let lines = lines.collect();
        page.chart(&Chart {
            marked: marked.collect(),
            note: "Grey: the rests that were used as poses.".to_owned(),
            ..Chart::new("Output of the accelerometer", "time, s", unit, lines)
        });
        page
    }
}

impl fmt::Display for CalibrationReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.text)
    }
}

/// A recommended orientation as JSON: the direction that points up, a unit vector in sensor axes, and how to get there.
pub(super) fn orientation_json(next: &Orientation) -> Value {
    json!({
        "up": next.up(),
        "text": next.to_string(),
        "instruction": next.instruction(),
    })
}

/// A recommended orientation as text.
pub(super) fn orientation_text(next: &Orientation) -> String {
    format!("add a pose with {next}: {}", next.instruction())
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
        let noise = median(poses.iter().map(sd)).filter(|sd| *sd > 0.0);
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

/// Names of parameters.
pub(super) fn names(parameters: Parameters) -> Vec<String> {
    parameters.iter().map(|parameter| parameter.to_string()).collect()
}

/// Adds the numbers of an estimate to those of a report. |f| − g is `rms` over all poses, `fitted_rms` over the fitted ones, and
/// `loo_rms` of each under the model fitted without it, or without all visits of its orientation.
pub(super) fn add_estimate(numbers: &mut Value, estimate: &Estimate, grade: &Grade) {
    let mm = |mps2: Option<f64>| mps2.map(|mps2| mps2 * 1e3);
    let unseen = estimate.not_observed();
    let half_width = |p: Parameter| (!unseen.contains(p)).then(|| estimate.half_width_95(p));
    let more = json!({
        "grade": grade,
        "fitted": names(estimate.fitted),
        "not_observed": names(unseen),
        "dof": estimate.dof,
        "rms_mm_s2": estimate.rms_mps2 * 1e3,
        "fitted_rms_mm_s2": estimate.fitted_rms_mps2 * 1e3,
        "max_mm_s2": estimate.max_mps2 * 1e3,
        "loo_rms_mm_s2": mm(estimate.loo_rms_mps2),
        "loo_orientation_rms_mm_s2": mm(estimate.loo_orientation_rms_mps2),
        "orientations": estimate.orientations,
        "condition": estimate.condition(),
        "worst_sd_mm_s2": estimate.worst_sd_mps2 * 1e3,
        "temperature_c": estimate.temperature_c,
        "temperature_range_c": estimate.temperature_range_c,
        "drift": estimate.drift.map(|drift| json!({
            "change_m_s2": drift.change_mps2,
            "sd_m_s2": estimate.term_sd[Term::Drift as usize],
            "span_s": drift.span_s,
        })),
        "placement_sd_deg": estimate.sides.map(|sides| sides.placement_sd_rad.to_degrees()),
        "revisit_sd_mm_s2": mm(estimate.sides.map(|sides| sides.revisit_sd_mps2)),
        "model": estimate.model.terms(),
        "sd": estimate.sd(),
        "half_width_95": Parameter::ALL.map(half_width),
        "covariance": estimate.covariance.matrix(),
    });
    if let (Value::Object(all), Value::Object(more)) = (numbers, more) {
        all.extend(more);
    }
}

/// The upward directions of the poses on the unit sphere in sensor axes, and those of poses to add.
pub(super) fn sphere(poses: &[Pose], rejected: &[usize], next: &[Orientation]) -> Chart {
    let unit = |up: [f64; 3]| up.map(|axis| axis / magnitude(up));
    let held = |name: &str, left_out: bool| {
        let all = poses.iter().enumerate();
        let (labels, up): (Vec<String>, Vec<[f64; 3]>) = all
            .filter(|(k, _)| rejected.contains(k) == left_out)
            .map(|(k, pose)| (k.to_string(), unit(pose.mean_mps2)))
            .unzip();
        Series { labels, ..Series::space(name, Style::Dots, &up) }
    };
    let advised = Vec::from_iter(next.iter().map(|next| unit(next.up())));
    let mut series = vec![
        held("pose held", false),
        held("left out", true),
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
