//! Check of a stored calibration against later rests, and its update.

use std::fmt;

use super::{CalibrateOptions, Calibration, parameter_id};
use serde::Serialize;
use wimu_calib::{Ageing, Parameter, Pose, SelfCheck};
use wimu_model::{
    CalibrationQuality, ErrorModel, ErrorTerms, ModelCovariance, ParameterSet, QualityTerms,
};

use super::poses::Poses;
use crate::chart::{Band, Chart, Series};
use crate::digits::signed_with_sd;
use crate::document::Document;
use crate::problem::Outcome;
use crate::recording::Samples;
use crate::{Code, Problem, Result};

/// A rest compared with the stored calibration.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct RestReport {
    /// Its first row or sample, from 0.
    pub first_sample: u64,
    /// |f| − g before the rest was used, mm/s².
    pub residual_mm_s2: f64,
    /// Its standard deviation if the calibration is still valid, mm/s².
    pub expected_sd_mm_s2: f64,
    /// Whether it agrees with the calibration: a valid one is contradicted once in 1000 rests.
    pub holds: bool,
}

/// The report of `wimu calibrate --method update`.
#[derive(Clone, Debug, Default, Serialize)]
pub struct UpdateReport {
    /// Status and findings.
    #[serde(skip)]
    pub outcome: Outcome,
    /// The data.
    pub source: String,
    /// `update`.
    pub method: &'static str,
    /// Id of the stored calibration.
    pub stored_id: String,
    /// Gravity, m/s².
    pub gravity_m_s2: f64,
    /// Number of rests found or given.
    pub poses: usize,
    /// Number of rests that contradict the calibration; they are not used.
    pub contradictions: u32,
    /// The rests, in order.
    pub rests: Vec<RestReport>,
    /// Change of the bias, m/s².
    pub bias_change_m_s2: Option<[f64; 3]>,
    /// The updated error model.
    pub model: Option<ErrorTerms>,
    /// Standard deviations of the bias, then A row by row.
    pub sd: Option<[f64; Parameter::COUNT]>,
    /// The set for a board.
    pub parameters: Option<ParameterSet>,
    /// Id of that set.
    pub parameter_id: Option<String>,
}

/// Checks a calibration with every rest in the data, at least one, in any orientations, and updates it. Its bias may have
/// drifted by [`Ageing`] since it was made.
///
/// # Errors
/// `usage` when gravity is out of bounds; `data_refused` when the calibration has no quality information; those of
/// [`SensorCalibration::compile`](super::SensorCalibration::compile).
pub fn update(
    data: &Samples<'_>,
    calibration: &Calibration,
    gravity_mps2: Option<f64>,
    utc_s: Option<u64>,
) -> Result<UpdateReport> {
    let (gravity, _) =
        CalibrateOptions { gravity_mps2, ..CalibrateOptions::default() }.gravity()?;
    let stored = &calibration.parameters()?;
    let check = SelfCheck::of(stored, gravity, Ageing::default());
    let (Some(mut check), Some(quality)) = (check, &stored.quality) else {
        return Err(Code::DataRefused.error(
            "the stored calibration has no standard deviations",
            "give one that was written by `wimu calibrate … -o CAL.json`, with --with CAL.json",
        ));
    };
    let correction = calibration.sensor().compile(data.info());
    let scale = correction.map_err(|error| error.at(data.name))?.mps2_per_unit();
    let found = Poses::find(data, scale).poses;
    let rest = |pose: &Pose| {
        let check = check.push(pose)?;
        Some(RestReport {
            first_sample: pose.first_sample,
            residual_mm_s2: check.residual_mps2 * 1e3,
            expected_sd_mm_s2: check.expected_sd_mps2 * 1e3,
            holds: check.holds,
        })
    };
    let rests: Vec<RestReport> = found.iter().filter_map(rest).collect();
    let mut report = UpdateReport {
        outcome: Outcome { findings: contradicting(&rests), ..Outcome::default() },
        source: data.name.to_owned(),
        method: "update",
        stored_id: parameter_id(stored).to_string(),
        gravity_m_s2: gravity.mps2(),
        poses: found.len(),
        contradictions: check.contradictions(),
        rests,
        ..UpdateReport::default()
    };
    match (report.refusal(), check.model()) {
        (Some(reason), _) => report.outcome.refuse(reason),
        (None, Ok(model)) => report.complete(stored, quality, &check, model, utc_s),
        (None, Err(error)) => {
            let reason = format!("the update is not possible for an accelerometer: {error}");
            report.outcome.refuse(reason);
        }
    }
    Ok(report)
}

impl UpdateReport {
    /// Why the rests do not support an update.
    fn refusal(&self) -> Option<String> {
        let Self { poses, contradictions, .. } = *self;
        let unusable = poses - self.rests.len();
        // One of ten may be disturbed.
        let allowed = poses / 10;
        if poses == 0 {
            return Some(
                "no rest was found: hold the sensor still for two seconds or more".to_owned(),
            );
        }
        if unusable > allowed {
            return Some(format!(
                "{unusable} of {poses} rests differ too much from gravity: check that it is this sensor, and the unit"
            ));
        }
        if let (Some(alone), true) = (lone(&self.rests), allowed == 0) {
            let rest = &self.rests[alone];
            return Some(format!(
                "rest {alone} (from 0, at sample {}) is the only one of {poses} that contradicts the calibration, by {:+.0} \
                 mm/s²: repeat that position, and calibrate again if it still does",
                rest.first_sample, rest.residual_mm_s2
            ));
        }
        (contradictions as usize > allowed).then(|| {
            format!(
                "the calibration is no longer valid: {contradictions} of {poses} rests contradict it; calibrate again"
            )
        })
    }

    /// Fills in the updated calibration.
    fn complete(
        &mut self,
        stored: &ParameterSet,
        quality: &CalibrationQuality,
        check: &SelfCheck,
        model: ErrorModel,
        utc_s: Option<u64>,
    ) {
        let covariance = check.covariance();
        let squares: f64 = self.rests.iter().map(|r| r.residual_mm_s2.powi(2)).sum();
        let rms_mps2 = (squares / self.rests.len() as f64).sqrt() * 1e-3;
        let terms = QualityTerms {
            utc_s: utc_s.or(quality.terms().utc_s),
            poses: quality.terms().poses.saturating_add(check.poses()),
            rms_mps2: rms_mps2 as f32,
            loo_rms_mps2: None,
            covariance: ModelCovariance::from_matrix(covariance.matrix())
                .unwrap_or(quality.terms().covariance),
            ..*quality.terms()
        };
        let set = ParameterSet { model, quality: CalibrationQuality::new(terms).ok(), ..*stored };
        let [before, now] = [&stored.model, &model].map(|model| model.terms().bias_mps2);
        self.bias_change_m_s2 = Some([0, 1, 2].map(|axis| now[axis] - before[axis]));
        self.model = Some(*model.terms());
        self.sd = Some(Parameter::ALL.map(|parameter| covariance.sd(parameter)));
        self.parameter_id = Some(parameter_id(&set).to_string());
        self.parameters = Some(set);
    }
}

/// The rests that contradict the calibration.
fn contradicting(rests: &[RestReport]) -> Vec<Problem> {
    let bad = (0..).zip(rests).filter(|(_, rest)| !rest.holds);
    let finding = |(k, rest): (usize, &RestReport)| {
        Code::PosesLeftOut.warning(format!(
            "rest {k} (from 0) contradicts the calibration: |f| − g {:+.2} mm/s², {:.2} expected (1 σ)",
            rest.residual_mm_s2, rest.expected_sd_mm_s2
        ))
    };
    bad.map(finding).collect()
}

/// The rest that contradicts, if it is the only one of three or more.
fn lone(rests: &[RestReport]) -> Option<usize> {
    let mut bad = (0..).zip(rests).filter(|(_, rest)| !rest.holds);
    let (alone, _) = bad.next()?;
    (bad.next().is_none() && rests.len() > 2).then_some(alone)
}

impl fmt::Display for UpdateReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "{}: {} rests against calibration {}, g = {} m/s²",
            self.source, self.poses, self.stored_id, self.gravity_m_s2
        )?;
        let Some(change) = &self.bias_change_m_s2 else {
            return write!(out, "{}", self.outcome);
        };
        let sd = self.sd.unwrap_or_default();
        let axis = |k: usize| signed_with_sd(change[k] * 1e3, sd[k] * 1e3);
        let significant = (0..3).any(|k| change[k].abs() > 2.0 * sd[k]);
        write!(
            out,
            "the calibration is still valid; change of the bias, mm/s² (1 σ): X {}, Y {}, Z {}{}",
            axis(0),
            axis(1),
            axis(2),
            if significant { "; it is significant (2 σ): use the updated file (-o)" } else { "" }
        )
    }
}

impl UpdateReport {
    /// A page: |f| − g of each rest beside what the stored calibration explains.
    pub fn page(&self) -> Document {
        let title = format!("Calibration {} against {}", self.stored_id, self.source);
        let mut page = super::report::page(title, &self.outcome, &self.to_string(), 1);
        if self.rests.is_empty() {
            return page;
        }
        let numbered = (0_u32..).map(f64::from).zip(&self.rests);
        let residuals = numbered.clone().map(|(k, rest)| (k, rest.residual_mm_s2)).collect();
        let expected = numbered.map(|(k, rest)| (k, rest.expected_sd_mm_s2));
        let points: Vec<_> = expected.map(|(k, sd)| (k, -sd, sd)).collect();
        // Symmetric, and wide enough for all.
        let sizes = (self.rests.iter()).flat_map(|r| [r.residual_mm_s2.abs(), r.expected_sd_mm_s2]);
        let half = 1.1 * sizes.fold(0.0, f64::max);
        let zero = points.iter().map(|(k, ..)| (*k, 0.0)).collect();
        let series = vec![Series::line("expected, ± 1 σ", zero), Series::dots("rest", residuals)];
        let title = "|f| − g of each rest under the stored calibration";
        page.chart(&Chart {
            y_range: Some((-half, half)),
            bands: vec![Band { series: 0, points }],
            ..Chart::new(title, "rest", "mm/s²", series)
        });
        page
    }
}
