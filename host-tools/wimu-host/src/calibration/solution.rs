//! The report of a calibration with static poses.

use serde_json::{Value, json};
use wimu_calib::{Estimate, Face, Guide, Orientation, Pose, Reason, Refusal, Term};
use wimu_model::{CalibratedTemperature, CalibrationMethod, GyroscopeParameters};

use super::describe::{gravity_text, parameter_lines, temperature_line};
use super::file::Quality;
use super::poses::{Fitting, Scale, rms};
use super::report::{Grade, add_estimate, orientation_json, orientation_text, sphere};
use super::{
    AccelerometerCalibration, CalibrateOptions, Calibration, CalibrationReport, DatasheetReport,
    SensorCalibration, Session, Source, checks, gyroscope, magnitude,
};
use crate::chart::{Chart, Series};
use crate::csv::AccelerationUnit;
use crate::digits::{signed, significant};
use crate::plural::counted;
use crate::problem::{Outcome, Severity};
use crate::recording::{OutputUnit, Samples};
use crate::{Code, Problem};

/// Largest number of poses that a report lists.
const MAX_POSES: usize = 1000;
/// Smallest residual on a logarithmic axis, mm/s².
const LEAST_SHOWN_MM_S2: f64 = 1e-3;
/// Suggested poses in the text of a refusal.
const SUGGESTED: usize = 3;
/// Largest number of orientations recommended at once.
const MAX_ADVISED: usize = 6;
/// Up to this many poses, three more than parameters, are planned together: chosen one by one they would not be the best set.
const PLANNED: usize = 12;

/// A fit, and what its report rests on.
pub(super) struct Solution<'a> {
    pub data: &'a Samples<'a>,
    pub options: &'a CalibrateOptions,
    pub fitting: Fitting<'a>,
    pub scale: Scale,
    /// Full-scale range, ± *g*.
    pub range: Option<(u8, Source)>,
    pub poses: Vec<Pose>,
    pub fit: Result<Estimate, Refusal>,
}

impl Solution<'_> {
    /// `repeated` says which poses were removed before the fit.
    pub fn report(self, repeated: Option<Problem>) -> CalibrationReport {
        let (data, options) = (self.data, self.options);
        let estimate = self.fit.as_ref().ok();
        let mut of_gyroscope = Vec::new();
        let all_orientations =
            estimate.filter(|_| options.method == CalibrationMethod::MultiPosition);
        let gyroscope = all_orientations.and_then(|estimate| {
            gyroscope::calibrate(data, self.scale.mps2, &self.poses, estimate, &mut of_gyroscope)
        });
        let (gyroscope, parameters) = gyroscope.unzip();
        let shows_axes =
            gyroscope.is_some() || of_gyroscope.iter().any(|problem| problem.code == Code::Axes);
        let findings = self.problems(estimate, shows_axes);
        let mut outcome = Outcome { findings, ..Outcome::default() };
        outcome.findings.extend(repeated);
        outcome.findings.append(&mut of_gyroscope);
        let (next_poses, worthwhile) = self.advice();
        let mut numbers = self.numbers();
        numbers["next_poses"] = Value::from_iter(next_poses.iter().map(orientation_json));
        numbers["poses_worth_adding"] = json!(worthwhile);
        let (mut grade, mut file, mut lines) = (None, None, Vec::new());
        match &self.fit {
            Err(refusal) => {
                outcome.refuse(self.reason(refusal));
                lines.push(self.given());
                lines.extend(next_poses.iter().take(SUGGESTED).map(orientation_text));
            }
            Ok(estimate) => {
                let found = Grade::new(estimate, &self.poses, options.target_mps2);
                let limits = self.limits(estimate);
                outcome.findings.extend(limits.iter().map(DatasheetReport::finding));
                outcome.findings.extend(checks::target(&found));
                add_estimate(&mut numbers, estimate, &found);
                numbers["datasheet"] = json!(limits);
                numbers["gyroscope"] = json!(gyroscope.as_ref().map(gyroscope::json));
                lines.extend([self.answer(estimate, &found, &outcome), self.given()]);
                let terms = (estimate.model.terms(), &estimate.sd());
                lines.extend(parameter_lines(terms, estimate.fitted, estimate.not_observed()));
                lines.extend(gyroscope.iter().flat_map(gyroscope::lines));
                lines.extend(self.quality(estimate));
                lines.push(self.more_poses(worthwhile, next_poses.first()));
                grade = Some(found);
                file = Some(self.file(estimate, parameters.flatten()));
            }
        }
        let title = format!("Calibration of {}", data.name);
        let charts = [self.residual_chart(), sphere(&self.poses, &self.rejected(), &next_poses)];
        let charts = charts.into_iter().filter(|_| !self.poses.is_empty());
        let report = CalibrationReport::new(title, outcome, String::new(), lines, numbers, file);
        let mut report = report.draw(charts);
        (report.grade, report.next_poses, report.gyroscope) = (grade, next_poses, gyroscope);
        (report.poses, report.estimate) = (self.poses, self.fit.ok());
        report
    }

    /// The numbers that there are without an estimate.
    fn numbers(&self) -> Value {
        let (data, gravity, Scale { lsb_per_g, source, .. }) =
            (self.data, self.fitting.gravity, self.scale);
        let estimate = self.fit.as_ref().ok();
        let rejected = self.rejected();
        let before = self.poses.iter().map(|pose| magnitude(pose.mean_mps2) - gravity.mps2());
        let listed = if self.poses.len() > MAX_POSES { &[] } else { &self.poses[..] };
        let pose = |pose: &Pose| {
            json!({
                "mean_m_s2": pose.mean_mps2,
                "sd_m_s2": pose.sd_mps2,
                "samples": pose.samples,
                "first_sample": pose.first_sample,
                "time_s": pose.time_s,
                "temperature_c": pose.temperature_c,
                "residual_mm_s2": estimate.map(|estimate| estimate.residual_mps2(pose) * 1e3),
            })
        };
        json!({
            "source": data.name,
            "method": self.options.method,
            "terms": self.terms(),
            "poses": self.poses.len(),
            "rate_hz": (!data.poses).then_some(data.rate_hz),
            "rate_source": (!data.poses).then_some(data.rate_source),
            "gravity_m_s2": gravity.mps2(),
            "gravity_sd_m_s2": gravity.sd_mps2(),
            "gravity_source": self.fitting.gravity_source,
            "unit": self.unit().as_str(),
            "sensitivity_lsb_per_g": lsb_per_g,
            "sensitivity_source": source.filter(|_| lsb_per_g.is_some()),
            "range_g": self.range.map(|(g, _)| g),
            "range_source": self.range.map(|(_, source)| source),
            "uncalibrated_rms_mm_s2": rms(before).map(|rms| rms * 1e3),
            "rejected": estimate.map_or(0, |estimate| estimate.rejected.len().max(rejected.len())),
            "rejected_poses": rejected,
            "static_poses": Value::from_iter(listed.iter().map(pose)),
        })
    }

    /// Error before and after, and how good that is.
    fn answer(&self, estimate: &Estimate, grade: &Grade, outcome: &Outcome) -> String {
        let g = self.fitting.gravity.mps2();
        let before = rms(self.poses.iter().map(|pose| magnitude(pose.mean_mps2) - g));
        let (after, how) = match estimate.loo_orientation_rms_mps2.or(estimate.loo_rms_mps2) {
            Some(loo) => (loo, "leave-one-out"),
            None => (estimate.fitted_rms_mps2, "in sample: no pose can be left out"),
        };
        let [before, after] =
            [before.unwrap_or_default(), after].map(|mps2| significant(mps2 * 1e3, 3));
        let is_warning = |problem: &&Problem| problem.severity == Severity::Warning;
        let warnings = match outcome.findings.iter().filter(is_warning).count() {
            0 => String::new(),
            count => format!("; {}", counted(count, "warning")),
        };
        format!("|f| − g {before} mm/s² rms before, {after} after ({how}); {grade}{warnings}")
    }

    /// Data, method and what was taken as known.
    fn given(&self) -> String {
        let (name, method) = (self.data.name, self.options.method);
        let (poses, g) = (counted(self.poses.len(), "static pose"), self.fitting.gravity);
        let text = format!("{name}: {poses}, {method}, {}", gravity_text(g));
        let Some(lsb_per_g) = self.scale.lsb_per_g else { return text };
        let source = match self.scale.source {
            Some(Source::Fit) => "mean of the fit",
            Some(Source::Board) => "as recorded",
            _ => "given",
        };
        format!("{text}, {lsb_per_g:.1} LSB/g ({source})")
    }

    /// The numbers by which the fit is judged.
    fn quality(&self, estimate: &Estimate) -> Vec<String> {
        let [rms, fitted, largest] =
            [estimate.rms_mps2, estimate.fitted_rms_mps2, estimate.max_mps2]
                .map(|mps2| significant(mps2 * 1e3, 3));
        let all = match self.rejected()[..] {
            [] => String::new(),
            _ => format!(" ({rms} over all poses)"),
        };
        let mut lines = vec![format!(
            "in sample {fitted} mm/s² rms{all}, largest {largest} at pose {} (from 0); condition {:.1}, {} degrees of \
             freedom; ± is 1 σ of this session",
            estimate.worst_pose,
            estimate.condition(),
            estimate.dof
        )];
        if let Some(drift) = &estimate.drift {
            let [x, y, z] = drift.change_mps2.map(|axis| signed(axis * 1e3, 3));
            lines.push(format!(
                "bias drift over {:.0} s: {x} {y} {z} mm/s²; the bias is that at the end",
                drift.span_s
            ));
        }
        let terms = estimate.model.terms();
        let valid = estimate.temperature_range_c.map(|[low, high]| CalibratedTemperature {
            mean_c: terms.temperature.reference_c as f32,
            lowest_c: low as f32,
            highest_c: high as f32,
        });
        lines.extend(temperature_line((terms, &estimate.sd()), valid));
        lines
    }

    fn more_poses(&self, worthwhile: usize, next: Option<&Orientation>) -> String {
        if self.options.method != CalibrationMethod::MultiPosition {
            return "place the sensor more accurately rather than adding poses".to_owned();
        }
        match (worthwhile, next) {
            (0, _) | (_, None) => "more poses would improve it little".to_owned(),
            (1, Some(next)) => format!("one more pose is worthwhile: {}", next.instruction()),
            (more, Some(next)) => {
                format!("{more} more poses are worthwhile; the next: {}", next.instruction())
            }
        }
    }

    /// Size of |f| − g in each pose before and after correction, on a logarithmic axis.
    fn residual_chart(&self) -> Chart {
        let g = self.fitting.gravity.mps2();
        let series = |name: &str, residual: &dyn Fn(&Pose) -> f64| {
            let sizes = self.poses.iter().map(|pose| residual(pose).abs() * 1e3);
            let sizes = sizes.map(|size| size.max(LEAST_SHOWN_MM_S2));
            Series::dots(name, (0_u32..).map(f64::from).zip(sizes).collect())
        };
        let before = |pose: &Pose| magnitude(pose.mean_mps2) - g;
        let mut all = vec![series("before correction", &before)];
        if let Ok(estimate) = &self.fit {
            all.push(series("after correction", &|pose| estimate.residual_mps2(pose)));
        }
        Chart { log: true, ..Chart::new("Size of |f| − g in each pose", "pose", "mm/s²", all) }
    }

    /// The estimate against the limits of the sensor's datasheet.
    fn limits(&self, estimate: &Estimate) -> Option<DatasheetReport> {
        let datasheet = self.options.datasheet.or(self.data.datasheet())?;
        Some(DatasheetReport::new(datasheet, estimate, self.used_lsb_per_g()))
    }

    /// The sensitivity that converted the data, LSB/*g*; `None` for data in m/s².
    pub fn used_lsb_per_g(&self) -> Option<f64> {
        self.scale.lsb_per_g.filter(|_| self.unit() == AccelerationUnit::Lsb)
    }

    fn unit(&self) -> AccelerationUnit {
        match self.data.unit {
            OutputUnit::Counts { .. } => AccelerationUnit::Lsb,
            OutputUnit::Mps2 => AccelerationUnit::Mps2,
        }
    }

    /// The calibration as a file.
    fn file(&self, estimate: &Estimate, gyroscope: Option<GyroscopeParameters>) -> Calibration {
        let utc_s = self.options.utc_s;
        let quality = estimate.quality(utc_s, &self.poses);
        let poses = quality.map_or(0, |quality| quality.terms().poses);
        let accelerometer = AccelerometerCalibration {
            unit: self.unit(),
            range_g: self.range.map(|(g, _)| g),
            range_source: self.range.map(|(_, source)| source),
            sensitivity_lsb_per_g: self.scale.lsb_per_g,
            zero_count: self.data.info().zero_count,
            model: estimate.model,
            quality: quality.as_ref().map(Quality::from),
            sessions: vec![Session { utc_s, file: Some(self.data.name.to_owned()), poses }],
        };
        let mut sensor = SensorCalibration::new(self.data.sensor, accelerometer);
        sensor.gyroscope = gyroscope;
        Calibration::of(sensor).of_device(self.data.info().device_id)
    }

    /// Indices of the poses left out of the fit.
    pub fn rejected(&self) -> Vec<usize> {
        let Ok(estimate) = &self.fit else { return Vec::new() };
        if self.options.method != CalibrationMethod::SixPosition {
            return estimate.rejected.clone();
        }
        let poses = self.poses.iter().enumerate();
        poses.filter(|(_, pose)| Face::of(pose).is_none()).map(|(k, _)| k).collect()
    }

    /// The poses that would resolve a refusal or improve the fit, and the number of worthwhile ones.
    fn advice(&self) -> (Vec<Orientation>, usize) {
        if self.options.method != CalibrationMethod::MultiPosition {
            return (self.missing_sides(), 0);
        }
        let mut guide = Guide::after(&self.poses);
        let worthwhile = guide.worth(|_| true);
        let least = match self.fit.as_ref().map_err(|refusal| refusal.reason) {
            Ok(_) => 0,
            // A repeated orientation adds little: its error may be the same.
            Err(Reason::NotObservable | Reason::PoorPrediction { .. }) => 1,
            // One that replaces the disturbed pose, and one that identifies it.
            Err(Reason::Contradicted { .. }) => 2,
            Err(Reason::TooFew { have, need }) => need.saturating_sub(have),
            Err(_) => return (Vec::new(), worthwhile),
        };
        let count = worthwhile.min(MAX_ADVISED).max(least);
        let planned = count.max(PLANNED.saturating_sub(self.poses.len()));
        let next = |remaining| {
            let next = guide.next_of(remaining, |_| true)?;
            guide.take(next.up());
            Some(next)
        };
        (((planned - count + 1)..=planned).rev().map_while(next).collect(), worthwhile)
    }

    /// The sides that six positions lack.
    fn missing_sides(&self) -> Vec<Orientation> {
        let is_too_few = |refusal: &Refusal| matches!(refusal.reason, Reason::TooFew { .. });
        if self.options.method != CalibrationMethod::SixPosition
            || !self.fit.as_ref().is_err_and(is_too_few)
        {
            return Vec::new();
        }
        let held = Vec::from_iter(self.poses.iter().filter_map(Face::of));
        let missing = Face::ALL.into_iter().filter(|face| !held.contains(face));
        missing.map(Orientation::from).collect()
    }

    /// The terms that were fitted, or were requested.
    fn terms(&self) -> Vec<&'static str> {
        let mut terms = match self.options.method {
            CalibrationMethod::SixPosition => vec!["bias", "scale", "misalignment_6"],
            CalibrationMethod::FourAngle | CalibrationMethod::ThreeAngle => vec!["bias", "scale"],
            _ => vec!["bias", "scale", "misalignment_3"],
        };
        let more = self.fit.as_ref().map_or(self.options.model.terms, |estimate| estimate.terms);
        terms.extend(more.iter().map(|term| match term {
            Term::Drift => "drift",
            Term::BiasTemperature => "bias_temperature",
            Term::ScaleTemperature => "scale_temperature",
            Term::Quadratic => "quadratic",
        }));
        terms
    }
}
