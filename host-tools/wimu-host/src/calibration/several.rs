//! Several calibration sessions of one sensor.

use std::fmt;

use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF};
use wimu_calib::{Combined, Estimate, Gravity, Parameter, combine};
use wimu_model::{
    CalibratedTemperature, CalibrationMethod, CalibrationQuality, CentiCelsius, ErrorModel,
    ErrorTerms, ModelCovariance, ParameterSet, QualityTerms, SpecificForceMps2, TermDeviations,
};

use super::file::Quality;
use super::poses::rms;
use super::report::{AXES, deviations, page, parameters, sizes, temperature};
use super::{
    CalibrateOptions, Calibration, CalibrationReport, MethodChoice, Session, Source, calibrate,
    checks, magnitude, parameter_id,
};
use crate::chart::{Chart, Series};
use crate::digits::{significant, with_sd};
use crate::document::Document;
use crate::plural::counted;
use crate::problem::{Outcome, Severity};
use crate::recording::{OutputUnit, Samples};
use crate::untrusted::printable;
use crate::{Code, Result};

/// Standard deviations of one kind of parameters.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Repeatability {
    /// Of the biases, m/s².
    pub bias_m_s2: f64,
    /// Of the scale factors.
    pub scale: f64,
    /// Of the misalignments, rad.
    pub misalignment_rad: f64,
}

impl From<[f64; 3]> for Repeatability {
    fn from([bias_m_s2, scale, misalignment_rad]: [f64; 3]) -> Self {
        Self { bias_m_s2, scale, misalignment_rad }
    }
}

/// One of several sessions.
#[derive(Clone, Debug, Serialize)]
pub struct SessionReport {
    /// The data.
    pub source: String,
    /// Number of static poses.
    pub poses: usize,
    /// Mean temperature, °C.
    pub temperature_c: Option<f64>,
    /// |f| − g under the combined calibration, mm/s² rms.
    pub rms_mm_s2: Option<f64>,
    /// Bias minus that of the combined calibration at the session's temperature, m/s².
    pub bias_difference_m_s2: [f64; 3],
}

/// Result of a calibration from several sessions: the JSON of `wimu calibrate A B … --json`.
#[derive(Clone, Debug, Default, Serialize)]
pub struct SeveralReport {
    /// Status and findings.
    #[serde(skip)]
    pub outcome: Outcome,
    /// `multi-position` or `six-position`.
    pub method: &'static str,
    /// Gravity, m/s².
    pub gravity_m_s2: f64,
    /// Its standard deviation, m/s².
    pub gravity_sd_m_s2: f64,
    /// Source of gravity.
    pub gravity_source: Source,
    /// Nominal sensitivity of all sessions, LSB/g.
    pub sensitivity_lsb_per_g: Option<f64>,
    /// The sessions.
    pub sessions: Vec<SessionReport>,
    /// The combination; absent in a refusal.
    #[serde(flatten)]
    pub fit: Option<SeveralFit>,
    /// The set for a board; `None` without a sensitivity.
    pub parameters: Option<ParameterSet>,
    /// Id of that set.
    pub parameter_id: Option<String>,
    /// The calibration file.
    #[serde(skip)]
    pub file: Option<Calibration>,
}

/// The numbers of a combination.
#[derive(Clone, Debug, Serialize)]
pub struct SeveralFit {
    /// The fitted parameters by name.
    pub fitted: Vec<String>,
    /// |y| − g over all poses before correction, mm/s² rms.
    pub uncalibrated_rms_mm_s2: Option<f64>,
    /// |f| − g over all poses, mm/s² rms.
    pub rms_mm_s2: Option<f64>,
    /// Standard deviations between sessions.
    pub between_sd: Repeatability,
    /// Degrees of freedom of those between sessions: bias, scale factor, misalignment.
    pub between_dof: [f64; 3],
    /// 95 % intervals of those between sessions; `None` where none is seen.
    pub between_95: [Option<[f64; 2]>; 3],
    /// Temperatures of the sessions, °C.
    pub temperature: Option<CalibratedTemperature>,
    /// The error model.
    pub model: ErrorTerms,
    /// Standard deviations of the parameters of a new session, in the model's shape.
    pub sd: ErrorTerms,
    /// Covariance of the parameters of a new session: the bias, then A row by row.
    pub covariance: [[f64; Parameter::COUNT]; Parameter::COUNT],
}

/// Calibrates each of several sessions of one sensor, and combines them: a refused session refuses all.
///
/// # Errors
/// `usage` for another method than multi-position and six-position, and for data of different units or sensors.
pub fn calibrate_several(
    data: &[Samples<'_>],
    options: &CalibrateOptions,
) -> Result<SeveralReport> {
    check(data, options)?;
    let (gravity, gravity_source) = options.gravity()?;
    let mut each = options.clone();
    (each.gravity_mps2, each.place) = (Some(gravity.mps2()), None);
    let mut report = SeveralReport {
        method: options.method.name(),
        gravity_m_s2: gravity.mps2(),
        gravity_sd_m_s2: gravity.sd_mps2(),
        gravity_source,
        ..SeveralReport::default()
    };
    let mut singles: Vec<CalibrationReport> = Vec::new();
    for samples in data {
        let single = calibrate(samples, &each)?;
        if let Some(reason) = &single.outcome.reason {
            report.outcome.refuse(format!("{}: {reason}", samples.name));
            return Ok(report);
        }
        let means = |report: &CalibrationReport| -> Vec<[f64; 3]> {
            report.static_poses.iter().map(|p| p.mean_m_s2).collect()
        };
        let same = |before: &&CalibrationReport| {
            !before.static_poses.is_empty() && means(before) == means(&single)
        };
        if let Some(before) = singles.iter().find(same) {
            let text = format!("{} and {} hold the same data", before.source, samples.name);
            report.outcome.refuse(text + ": give each session once");
            return Ok(report);
        }
        each.sensitivity_lsb_per_g = single.sensitivity_lsb_per_g;
        singles.push(single);
    }
    let estimates: Vec<Estimate> = singles.iter().filter_map(|s| s.estimate.clone()).collect();
    match combine(&estimates, gravity) {
        Ok(found) => report.complete(&found, &singles, &estimates, options, gravity),
        Err(refusal) => {
            let names: Vec<&str> = data.iter().map(|samples| samples.name).collect();
            let text = format!("{refusal} (sessions from 0: {})", names.join(", "));
            report.outcome.refuse(text);
        }
    }
    Ok(report)
}

fn check(data: &[Samples<'_>], options: &CalibrateOptions) -> Result<()> {
    let usage = |message: String, remedy: &str| Err(Code::Usage.error(message, remedy));
    if !matches!(options.method, MethodChoice::MultiPosition | MethodChoice::SixPosition) {
        let message = format!("--method {} takes one session", options.method.name());
        return usage(message, "use multi-position or six-position, or give one file");
    }
    let counts = |samples: &Samples<'_>| matches!(samples.unit, OutputUnit::Counts { .. });
    for (before, after) in data.iter().zip(data.iter().skip(1)) {
        let names = format!("{} and {}", before.name, after.name);
        if counts(before) != counts(after) {
            let message = format!("{names} differ in their unit");
            return usage(message, "give sessions that are all in counts, or none");
        }
        if let (Some(one), Some(other)) = (before.sensor, after.sensor)
            && one != other
        {
            return usage(
                format!("{names} are of different sensors"),
                "give sessions of one sensor",
            );
        }
    }
    Ok(())
}

/// |f| − g over the poses of sessions, corrected by `model` at their temperatures, mm/s² rms.
fn residual_mm_s2(model: &ErrorModel, of: &[CalibrationReport], gravity: Gravity) -> Option<f64> {
    let poses = of.iter().flat_map(|report| &report.static_poses);
    let residual = poses.map(|pose| {
        let at = pose.temperature_c.map(CentiCelsius::from_celsius);
        let force = model.correct(SpecificForceMps2(pose.mean_m_s2), at);
        magnitude(force.0) - gravity.mps2()
    });
    rms(residual).map(|rms| rms * 1e3)
}

impl SeveralReport {
    fn complete(
        &mut self,
        found: &Combined,
        singles: &[CalibrationReport],
        estimates: &[Estimate],
        options: &CalibrateOptions,
        gravity: Gravity,
    ) {
        let terms = *found.model.terms();
        for (single, estimate) in singles.iter().zip(estimates) {
            let dt = match (estimate.temperature_c, found.temperature) {
                (Some(celsius), Some(_)) => celsius - terms.temperature.reference_c,
                _ => 0.0,
            };
            let own = estimate.model.terms().bias_mps2;
            let slope = terms.temperature.bias_mps2_per_k;
            self.sessions.push(SessionReport {
                source: single.source.clone(),
                poses: single.poses,
                temperature_c: estimate.temperature_c,
                rms_mm_s2: residual_mm_s2(&found.model, std::slice::from_ref(single), gravity),
                bias_difference_m_s2: [0, 1, 2]
                    .map(|axis| own[axis] - terms.bias_mps2[axis] - slope[axis] * dt),
            });
        }
        let rms_mm_s2 = residual_mm_s2(&found.model, singles, gravity);
        let sd = Parameter::ALL.map(|parameter| found.covariance.sd(parameter));
        let fit = SeveralFit {
            fitted: found.fitted.iter().map(|p| p.to_string()).collect(),
            uncalibrated_rms_mm_s2: residual_mm_s2(&ErrorModel::default(), singles, gravity),
            rms_mm_s2,
            between_sd: found.between_sd.into(),
            between_dof: found.dof,
            between_95: [0, 1, 2].map(|k| interval_95(found.between_sd[k], found.dof[k])),
            temperature: found.temperature,
            model: terms,
            sd: deviations(
                |place| sd[place],
                [found.slope_sd.bias_mps2_per_k, found.slope_sd.scale_per_k],
            ),
            covariance: *found.covariance.matrix(),
        };
        self.find(&fit, found, singles, gravity);
        self.fit = Some(fit);
        self.sensitivity_lsb_per_g = singles[0].sensitivity_lsb_per_g;
        let quality = quality(found, estimates, options, rms_mm_s2);
        self.parameters =
            singles[0].parameters.map(|set| ParameterSet { model: found.model, quality, ..set });
        self.parameter_id = (self.parameters.as_ref()).map(|set| parameter_id(set).to_string());
        let sessions: Vec<Session> = singles
            .iter()
            .zip(estimates)
            .map(|(single, estimate)| Session {
                utc_s: options.utc_s,
                file: Some(single.source.clone()),
                poses: u32::try_from(estimate.poses).unwrap_or(u32::MAX),
            })
            .collect();
        self.file.clone_from(&singles[0].file);
        if let Some(file) = &mut self.file {
            let accelerometer = &mut file.sensor_mut().accelerometer;
            accelerometer.model = found.model;
            accelerometer.quality = quality.as_ref().map(Quality::from);
            accelerometer.sessions = sessions;
        }
    }

    /// Warnings of the sessions, and what their combination shows.
    fn find(
        &mut self,
        fit: &SeveralFit,
        found: &Combined,
        singles: &[CalibrationReport],
        gravity: Gravity,
    ) {
        let findings = &mut self.outcome.findings;
        for (k, single) in singles.iter().enumerate() {
            for finding in &single.outcome.findings {
                let equal = |other: &CalibrationReport| {
                    let others = &mut other.outcome.findings.iter();
                    others.any(|f| f.code == finding.code && f.text == finding.text)
                };
                // What holds for all sessions is said once.
                if singles.iter().all(equal) || finding.severity <= Severity::Note {
                    findings.extend((k == 0).then(|| finding.clone()));
                } else {
                    let mut finding = finding.clone();
                    finding.text = format!("{}: {}", printable(&single.source), finding.text);
                    findings.push(finding);
                }
            }
        }
        if fit.temperature.is_none() && singles.len() > 2 {
            let text = "not all sessions have temperatures: no temperature coefficients";
            findings.push(Code::Temperature.note(text));
        }
        let (model, source) = (found.model.terms(), self.gravity_source);
        let of_gravity = checks::gravity(model, &found.covariance, found.fitted, gravity, source);
        findings.extend(of_gravity);
    }
}

/// 95 % interval of a standard deviation with `dof` degrees of freedom, by χ².
fn interval_95(sd: f64, dof: f64) -> Option<[f64; 2]> {
    let chi_squared = ChiSquared::new(dof).ok().filter(|_| sd > 0.0)?;
    Some([0.975, 0.025].map(|p| sd * (dof / chi_squared.inverse_cdf(p)).sqrt()))
}

/// Quality record of a combination.
fn quality(
    found: &Combined,
    estimates: &[Estimate],
    options: &CalibrateOptions,
    rms_mm_s2: Option<f64>,
) -> Option<CalibrationQuality> {
    let total = |of: fn(&Estimate) -> usize| {
        let sum: usize = estimates.iter().map(of).sum();
        u32::try_from(sum).unwrap_or(u32::MAX)
    };
    let condition = estimates.iter().map(|e| e.condition).fold(1.0, f64::max);
    let slopes = found.slope_sd;
    CalibrationQuality::new(QualityTerms {
        method: match options.method {
            MethodChoice::SixPosition => CalibrationMethod::SixPosition,
            _ => CalibrationMethod::MultiPosition,
        },
        utc_s: options.utc_s,
        temperature: found.temperature,
        poses: total(|estimate| estimate.poses),
        dof: total(|estimate| estimate.dof),
        rms_mps2: (rms_mm_s2.unwrap_or_default() * 1e-3) as f32,
        loo_rms_mps2: None,
        condition: Some(condition as f32),
        covariance: ModelCovariance::from_matrix(found.covariance.matrix()).ok()?,
        other_sd: TermDeviations {
            bias_mps2_per_k: slopes.bias_mps2_per_k.map(|sd| sd as f32),
            scale_per_k: slopes.scale_per_k.map(|sd| sd as f32),
            ..TermDeviations::default()
        },
    })
    .ok()
}

impl fmt::Display for SeveralReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(fit) = &self.fit else {
            return write!(out, "{}", self.outcome);
        };
        let of = |value: f64, unit: f64| significant(value * unit, 3);
        let between = &fit.between_sd;
        let change = |between: f64, interval: Option<[f64; 2]>, unit: f64, name: &str| {
            let Some([low, high]) = interval else { return "no change seen".to_owned() };
            let (sd, low, high) = (of(between, unit), of(low, unit), of(high, unit));
            format!("± {sd} {name} (95 % {low} to {high})")
        };
        writeln!(
            out,
            "{}, change between them: bias {}, scale factor {}, misalignment {}\n\
             |f| − g over all poses: {} mm/s² rms before, {} after",
            counted(self.sessions.len(), "session"),
            change(between.bias_m_s2, fit.between_95[0], 1e3, "mm/s²"),
            change(between.scale, fit.between_95[1], 1e6, "ppm"),
            change(between.misalignment_rad, fit.between_95[2], 1e3, "mrad"),
            significant(fit.uncalibrated_rms_mm_s2.unwrap_or_default(), 3),
            significant(fit.rms_mm_s2.unwrap_or_default(), 3),
        )?;
        parameters(&fit.model, &fit.sd, &fit.fitted, &[], out)?;
        temperature(&fit.model, &fit.sd, fit.temperature, out)?;
        for session in &self.sessions {
            let sizes = session.bias_difference_m_s2.map(f64::abs);
            let at = session.temperature_c;
            let at = at.map_or(String::new(), |celsius| format!("{celsius:.1} °C, "));
            writeln!(
                out,
                "{}: {}, {at}{} mm/s² rms, bias differs by up to {} mm/s²",
                session.source,
                counted(session.poses, "pose"),
                significant(session.rms_mm_s2.unwrap_or_default(), 3),
                of(sizes.into_iter().fold(0.0, f64::max), 1e3),
            )?;
        }
        let gravity = match self.gravity_sd_m_s2 {
            0.0 => self.gravity_m_s2.to_string(),
            sd => with_sd(self.gravity_m_s2, sd),
        };
        write!(out, "{}, g = {gravity} m/s²; ± is 1 σ of a new session", self.method)
    }
}

impl SeveralReport {
    /// A page: the difference of each session's bias from the combination, and the residuals of each session.
    pub fn page(&self) -> Document {
        let names: Vec<String> = self.sessions.iter().map(|s| s.source.clone()).collect();
        let title = format!("Calibration of {}", names.join(", "));
        let mut page = page(title, &self.outcome, &self.to_string(), 0);
        if self.fit.is_none() {
            return page;
        }
        let is_warm = self.sessions.iter().all(|session| session.temperature_c.is_some());
        let x = if is_warm { "temperature, °C" } else { "session" };
        let placed = |mut series: Series, labels: &[String]| {
            for (point, session) in series.points.iter_mut().zip(&self.sessions) {
                point.0 = session.temperature_c.filter(|_| is_warm).unwrap_or(point.0);
            }
            Series { labels: labels.to_vec(), ..series }
        };
        let bias = |axis: usize| {
            let of = |session: &SessionReport| session.bias_difference_m_s2[axis] * 1e3;
            let points = self.sessions.iter().enumerate().map(|(k, s)| (k as f64, of(s)));
            let labels = if axis == 0 { &names[..] } else { &[] };
            placed(Series::dots(AXES[axis], points.collect()), labels)
        };
        let title = "Bias of each session less that of the combination";
        page.chart(&Chart::new(title, x, "mm/s²", [0, 1, 2].map(bias).into()));
        let combined = self.sessions.iter().map(|session| session.rms_mm_s2);
        let series = vec![placed(sizes("combined calibration", combined), &names)];
        let title = "Size of |f| − g in each session, rms";
        page.chart(&Chart { log: true, ..Chart::new(title, x, "mm/s²", series) });
        page
    }
}
