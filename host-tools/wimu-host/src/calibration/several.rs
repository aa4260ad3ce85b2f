//! Several calibration sessions of one sensor.

use serde_json::{Value, json};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use wimu_calib::{Combined, Estimate, Gravity, Parameters, combine};
use wimu_model::{
    CalibrationMethod, CalibrationQuality, CentiCelsius, ErrorModel, ErrorTerms, ModelCovariance,
    QualityTerms, SpecificForceMps2, TermDeviations,
};

use super::describe::{gravity_text, parameter_lines, temperature_line};
use super::file::Quality;
use super::poses::rms;
use super::report::AXES;
use super::{
    CalibrateOptions, Calibration, CalibrationReport, Session, calibrate, checks, magnitude,
};
use crate::chart::{Chart, Series};
use crate::digits::significant;
use crate::plural::counted;
use crate::problem::{Outcome, Problem, Severity};
use crate::recording::{OutputUnit, Samples};
use crate::untrusted::printable;
use crate::{Code, Result};

/// Calibrates each of several sessions of one sensor, and combines them: a refused session refuses all.
///
/// # Errors
/// `usage` for another method than multi-position and six-position, and for data of different units or sensors.
pub fn calibrate_several(
    data: &[Samples<'_>],
    options: &CalibrateOptions,
) -> Result<CalibrationReport> {
    check(data, options)?;
    let (gravity, gravity_source) = options.gravity()?;
    let mut json = json!({
        "method": options.method,
        "gravity_m_s2": gravity.mps2(),
        "gravity_sd_m_s2": gravity.sd_mps2(),
        "gravity_source": gravity_source,
    });
    let names = Vec::from_iter(data.iter().map(|samples| samples.name)).join(", ");
    let sessions = each(data, options, gravity)?.and_then(|singles| {
        let estimates = Vec::from_iter(singles.iter().filter_map(|single| single.estimate.clone()));
        match combine(&estimates, gravity) {
            Ok(combined) => Ok(Sessions { singles, estimates, combined, gravity }),
            Err(refusal) => Err(format!("{refusal} (sessions from 0: {names})")),
        }
    });
    let (mut outcome, mut lines, mut file) = (Outcome::default(), Vec::new(), None);
    let mut chart = None;
    match sessions {
        Ok(sessions) => {
            let Combined { model, covariance, fitted, .. } = &sessions.combined;
            let (terms, source) = (model.terms(), gravity_source);
            outcome.findings = sessions.findings();
            let of_gravity = checks::gravity(terms, covariance, *fitted, gravity, source);
            outcome.findings.extend(of_gravity);
            sessions.fill(&mut json);
            lines = sessions.lines();
            let (method, g) = (options.method, gravity_text(gravity));
            lines.push(format!("{method}, {g}; ± is 1 σ of a new session"));
            file = sessions.file(options.utc_s);
            chart = Some(sessions.chart());
        }
        Err(reason) => outcome.refuse(reason),
    }
    let title = format!("Calibration of {names}");
    let report = CalibrationReport::new(title, outcome, String::new(), lines, json, file);
    Ok(report.draw(chart))
}

fn check(data: &[Samples<'_>], options: &CalibrateOptions) -> Result<()> {
    let usage = |message: String, remedy: &str| Err(Code::Usage.error(message, remedy));
    if !matches!(options.method, CalibrationMethod::MultiPosition | CalibrationMethod::SixPosition)
    {
        let message = format!("--method {} takes one session", options.method);
        return usage(message, "use multi-position or six-position, or give one file");
    }
    let counts = |samples: &Samples<'_>| matches!(samples.unit, OutputUnit::Counts { .. });
    for (before, after) in data.iter().zip(data.iter().skip(1)) {
        let names = format!("{} and {}", before.name, after.name);
        if counts(before) != counts(after) {
            let message = format!("{names} differ in their unit");
            return usage(message, "give sessions that are all in counts, or none");
        }
        if before.sensor.zip(after.sensor).is_some_and(|(one, other)| one != other) {
            let message = format!("{names} are of different sensors");
            return usage(message, "give sessions of one sensor");
        }
    }
    Ok(())
}

/// The calibration of each session with common gravity and sensitivity; the refusal of the first session that has none.
fn each(
    data: &[Samples<'_>],
    options: &CalibrateOptions,
    gravity: Gravity,
) -> Result<Result<Vec<CalibrationReport>, String>> {
    let mut options =
        CalibrateOptions { gravity_mps2: Some(gravity.mps2()), place: None, ..options.clone() };
    let mut singles: Vec<CalibrationReport> = Vec::new();
    for samples in data {
        let single = calibrate(samples, &options)?;
        if let Some(reason) = &single.outcome.reason {
            return Ok(Err(format!("{}: {reason}", samples.name)));
        }
        let is_same = |before: &&CalibrationReport| {
            let means = [*before, &single].map(|report| report.poses.iter().map(|p| p.mean_mps2));
            let [before, after] = means;
            before.eq(after)
        };
        if let Some(before) = singles.iter().find(is_same) {
            let names = format!("{} and {}", before.source, samples.name);
            return Ok(Err(format!("{names} hold the same data: give each session once")));
        }
        options.sensitivity_lsb_per_g = single.sensitivity_lsb_per_g();
        singles.push(single);
    }
    Ok(Ok(singles))
}

/// Sessions and their combination.
struct Sessions {
    singles: Vec<CalibrationReport>,
    estimates: Vec<Estimate>,
    combined: Combined,
    gravity: Gravity,
}

impl Sessions {
    /// |f| − g over all poses, corrected by `model` at their temperatures, mm/s² rms.
    fn rms_mm_s2(&self, model: &ErrorModel) -> f64 {
        let residual = self.singles.iter().flat_map(|report| &report.poses).map(|pose| {
            let at = pose.temperature_c.map(CentiCelsius::from_celsius);
            let force = model.correct(SpecificForceMps2(pose.mean_mps2), at);
            magnitude(force.0) - self.gravity.mps2()
        });
        rms(residual).unwrap_or_default() * 1e3
    }

    /// Bias of each session minus that of the combined calibration at the session's temperature, m/s².
    fn bias_differences(&self) -> Vec<[f64; 3]> {
        let terms = self.combined.model.terms();
        let difference = |estimate: &Estimate| {
            let warmer = match (estimate.temperature_c, self.combined.temperature) {
                (Some(celsius), Some(_)) => celsius - terms.temperature.reference_c,
                _ => 0.0,
            };
            let own = estimate.model.terms().bias_mps2;
            let slope = terms.temperature.bias_mps2_per_k;
            [0, 1, 2].map(|axis| own[axis] - terms.bias_mps2[axis] - slope[axis] * warmer)
        };
        self.estimates.iter().map(difference).collect()
    }

    /// 95 % intervals of the standard deviations between sessions, by χ²: bias, scale factor, misalignment; `None` where no
    /// change is seen.
    fn between_95(&self) -> [Option<[f64; 2]>; 3] {
        [0, 1, 2].map(|k| {
            let (sd, dof) = (self.combined.between_sd[k], self.combined.dof[k]);
            let chi_squared = ChiSquared::new(dof).ok().filter(|_| sd > 0.0)?;
            Some([0.975, 0.025].map(|p| sd * (dof / chi_squared.inverse_cdf(p)).sqrt()))
        })
    }

    /// Standard deviations of the parameters of a new session, in the model's shape.
    fn sd(&self) -> ErrorTerms {
        self.combined.covariance.deviations(&self.combined.term_sd)
    }

    /// Adds the sessions and their combination to the report's JSON.
    fn fill(&self, json: &mut Value) {
        let sessions = self.singles.iter().zip(&self.estimates).zip(self.bias_differences());
        json["sessions"] = Value::from_iter(sessions.map(|((single, estimate), bias)| {
            json!({
                "source": single.source,
                "poses": single.poses.len(),
                "temperature_c": estimate.temperature_c,
                "bias_difference_m_s2": bias,
            })
        }));
        let found = &self.combined;
        let [bias_m_s2, scale, misalignment_rad] = found.between_sd;
        let fitted = Vec::from_iter(found.fitted.iter().map(|parameter| parameter.to_string()));
        json["sensitivity_lsb_per_g"] = json!(self.singles[0].sensitivity_lsb_per_g());
        json["fitted"] = json!(fitted);
        json["uncalibrated_rms_mm_s2"] = json!(self.rms_mm_s2(&ErrorModel::default()));
        json["rms_mm_s2"] = json!(self.rms_mm_s2(&found.model));
        json["between_sd"] = json!({
            "bias_m_s2": bias_m_s2, "scale": scale, "misalignment_rad": misalignment_rad,
        });
        json["between_dof"] = json!(found.dof);
        json["between_95"] = json!(self.between_95());
        json["temperature"] = json!(found.temperature);
        json["model"] = json!(found.model.terms());
        json["sd"] = json!(self.sd());
        json["covariance"] = json!(found.covariance.matrix());
    }

    /// Findings of the sessions: what holds for all is said once.
    fn findings(&self) -> Vec<Problem> {
        let mut findings = Vec::new();
        for (k, single) in self.singles.iter().enumerate() {
            for finding in &single.outcome.findings {
                let equal = |other: &CalibrationReport| {
                    let others = &mut other.outcome.findings.iter();
                    others.any(|f| f.code == finding.code && f.text == finding.text)
                };
                let mut finding = finding.clone();
                if finding.severity > Severity::Note && !self.singles.iter().all(equal) {
                    finding.text = format!("{}: {}", printable(&single.source), finding.text);
                } else if k > 0 {
                    continue;
                }
                findings.push(finding);
            }
        }
        if self.combined.temperature.is_none() && self.singles.len() > 2 {
            let text = "not all sessions have temperatures: no temperature coefficients";
            findings.push(Code::Temperature.note(text));
        }
        findings
    }

    /// The calibration file: that of the first session with the combined model.
    fn file(&self, utc_s: Option<u64>) -> Option<Calibration> {
        let mut file = self.singles[0].file.clone()?;
        let accelerometer = &mut file.sensor_mut().accelerometer;
        accelerometer.model = self.combined.model;
        accelerometer.quality = self.quality(utc_s).as_ref().map(Quality::from);
        accelerometer.sessions = (self.singles.iter().zip(&self.estimates))
            .map(|(single, estimate)| Session {
                utc_s,
                file: Some(single.source.clone()),
                poses: u32::try_from(estimate.poses).unwrap_or(u32::MAX),
            })
            .collect();
        Some(file)
    }

    fn quality(&self, utc_s: Option<u64>) -> Option<CalibrationQuality> {
        let total = |of: fn(&Estimate) -> usize| {
            let sum: usize = self.estimates.iter().map(of).sum();
            u32::try_from(sum).unwrap_or(u32::MAX)
        };
        let condition = self.estimates.iter().map(|e| e.condition()).fold(1.0, f64::max);
        let found = &self.combined;
        let first = self.estimates[0].quality(utc_s, &self.singles[0].poses)?;
        let [_, bias, scale, _] = found.term_sd;
        CalibrationQuality::new(QualityTerms {
            temperature: found.temperature,
            poses: total(|estimate| estimate.poses),
            dof: total(|estimate| estimate.dof),
            rms_mps2: (self.rms_mm_s2(&found.model) * 1e-3) as f32,
            loo_rms_mps2: None,
            condition: Some(condition as f32),
            covariance: ModelCovariance::from_matrix(found.covariance.matrix()).ok()?,
            other_sd: TermDeviations {
                bias_mps2_per_k: bias.map(|sd| sd as f32),
                scale_per_k: scale.map(|sd| sd as f32),
                ..TermDeviations::default()
            },
            ..*first.terms()
        })
        .ok()
    }

    fn lines(&self) -> Vec<String> {
        let found = &self.combined;
        let of = |value: f64, unit: f64| significant(value * unit, 3);
        let intervals = self.between_95();
        let change = |k: usize, unit: f64, name: &str| {
            let Some([low, high]) = intervals[k] else { return "no change seen".to_owned() };
            let [sd, low, high] = [found.between_sd[k], low, high].map(|value| of(value, unit));
            format!("± {sd} {name} (95 % {low} to {high})")
        };
        let [before, after] = [&ErrorModel::default(), &found.model]
            .map(|model| significant(self.rms_mm_s2(model), 3));
        let mut lines = vec![
            format!(
                "{}, change between them: bias {}, scale factor {}, misalignment {}",
                counted(self.singles.len(), "session"),
                change(0, 1e3, "mm/s²"),
                change(1, 1e6, "ppm"),
                change(2, 1e3, "mrad"),
            ),
            format!("|f| − g over all poses: {before} mm/s² rms before, {after} after"),
        ];
        let terms = found.model.terms();
        let terms = (terms, &self.sd());
        lines.extend(parameter_lines(terms, found.fitted, Parameters::default()));
        lines.extend(temperature_line(terms, found.temperature));
        let sessions = self.singles.iter().zip(&self.estimates);
        for ((single, estimate), bias) in sessions.zip(self.bias_differences()) {
            let at = estimate.temperature_c;
            let at = at.map_or(String::new(), |celsius| format!("{celsius:.1} °C, "));
            let largest = bias.map(f64::abs).into_iter().fold(0.0, f64::max);
            lines.push(format!(
                "{}: {}, {at}bias differs by up to {} mm/s²",
                single.source,
                counted(single.poses.len(), "pose"),
                of(largest, 1e3),
            ));
        }
        lines
    }

    /// The difference of each session's bias from the combination.
    fn chart(&self) -> Chart {
        let temperatures = self.estimates.iter().map(|estimate| estimate.temperature_c);
        let temperatures: Option<Vec<f64>> = temperatures.collect();
        let x = if temperatures.is_some() { "temperature, °C" } else { "session" };
        let places =
            temperatures.unwrap_or((0_u32..).map(f64::from).take(self.singles.len()).collect());
        let differences = self.bias_differences();
        let bias = |axis: usize| {
            let values = places.iter().copied().zip(differences.iter().map(|d| d[axis] * 1e3));
            Series {
                labels: self.singles.iter().map(|single| single.source.clone()).collect(),
                ..Series::dots(AXES[axis], values.collect())
            }
        };
        let title = "Bias of each session less that of the combination";
        Chart::new(title, x, "mm/s²", [0, 1, 2].map(bias).into())
    }
}
