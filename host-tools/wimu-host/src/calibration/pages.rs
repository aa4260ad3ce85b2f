//! Reports as pages: several sessions, one stream against another, and a stored calibration against later rests.

use wimu_model::{ErrorModel, SpecificForceMps2};

use super::{Paired, ReferenceReport, SeveralReport, UpdateReport};
use crate::chart::{Band, Chart, Series};
use crate::digits::significant;
use crate::error::Result;
use crate::finding::Outcome;
use crate::html::Report;

const AXES: [&str; 3] = ["X", "Y", "Z"];
/// Smallest residual on a logarithmic axis, mm/s².
const LEAST_MM_S2: f64 = 1e-3;

fn mm_s2(value: f64) -> String {
    format!("{} mm/s²", significant(value, 3))
}

/// A page with the refusal, or line `result` of the text of the command as its result.
fn page(title: String, outcome: &Outcome, text: &str, result: usize) -> Report {
    let mut page = Report::new(title);
    match &outcome.reason {
        Some(_) => page.result(&outcome.to_string()),
        None => page.result(text.lines().nth(result).unwrap_or_default()),
    };
    page.printed(text).findings(&outcome.findings);
    page
}

impl SeveralReport {
    /// A page: the difference of each session's bias from the combination, and the residuals of each session.
    ///
    /// # Errors
    /// `file_failed` when a picture cannot be drawn.
    pub fn page(&self) -> Result<Report> {
        let names: Vec<String> = self.sessions.iter().map(|s| s.source.clone()).collect();
        let title = format!("Calibration of {}", names.join(", "));
        let mut page = page(title, &self.outcome, &self.to_string(), 0);
        let Some(fit) = &self.fit else {
            return Ok(page);
        };
        let [before, after] = [fit.uncalibrated_rms_mm_s2, fit.rms_mm_s2]
            .map(|rms| significant(rms.unwrap_or_default(), 3));
        let name = "|f| − g over all poses, rms, before and after";
        page.key(name, &format!("{before} → {after} mm/s²"));
        let repeats = fit.between_sd;
        page.key(
            "bias between sessions, 1 σ",
            &mm_s2(repeats.bias_m_s2 * 1e3),
        );
        let scale = significant(repeats.scale * 1e6, 3);
        page.key(
            "scale factor between sessions, 1 σ",
            &format!("{scale} ppm"),
        );
        let warm = self.sessions.iter().all(|s| s.temperature_c.is_some());
        let at = |k: usize| match self.sessions[k].temperature_c {
            Some(celsius) if warm => celsius,
            _ => k as f64,
        };
        let dots = |name: &str, of: &dyn Fn(usize) -> Option<f64>| Series {
            labels: names.clone(),
            ..Series::dots(
                name,
                (0..names.len())
                    .map(|k| (at(k), of(k).unwrap_or(f64::NAN)))
                    .collect(),
            )
        };
        let x = if warm { "temperature, °C" } else { "session" };
        let bias = |axis: usize| {
            dots(AXES[axis], &|k| {
                Some(self.sessions[k].bias_difference_m_s2[axis] * 1e3)
            })
        };
        page.chart(&Chart {
            title: "Bias of each session less that of the combination".to_owned(),
            x: x.to_owned(),
            y: "mm/s²".to_owned(),
            series: [0, 1, 2].map(bias).into(),
            ..Chart::default()
        })?;
        let least = |rms: f64| rms.max(LEAST_MM_S2);
        page.chart(&Chart {
            title: "Size of |f| − g in each session, rms".to_owned(),
            x: x.to_owned(),
            y: "mm/s²".to_owned(),
            log: true,
            series: vec![
                dots("its own calibration", &|k| {
                    Some(least(self.sessions[k].own_rms_mm_s2))
                }),
                dots("combined calibration", &|k| {
                    self.sessions[k].rms_mm_s2.map(least)
                }),
            ],
            ..Chart::default()
        })?;
        Ok(page)
    }
}

impl ReferenceReport {
    /// A page: the difference of each axis from the reference in `data`, before and after correction.
    ///
    /// # Errors
    /// `file_failed` when a picture cannot be drawn.
    pub fn page(&self, data: &Paired) -> Result<Report> {
        let title = format!("{} against {}", self.output, self.reference);
        let mut page = page(title, &self.outcome, &self.to_string(), 1);
        let model = self.model.and_then(|terms| ErrorModel::new(terms).ok());
        let (Some(axes), Some(model)) = (&self.axes, model) else {
            return Ok(page);
        };
        for (axis, name) in axes.iter().zip(AXES) {
            page.key(&format!("residual of {name}, rms"), &mm_s2(axis.rms_mm_s2));
        }
        for (axis, name) in AXES.into_iter().enumerate() {
            let over_time = |of: &dyn Fn([f64; 3]) -> [f64; 3]| {
                let pairs = data.pairs.iter().enumerate();
                let point = |(k, [reference, output]): (usize, &[[f64; 3]; 2])| {
                    let difference = of(*output)[axis] - reference[axis];
                    (k as f64 / data.rate_hz, difference * 1e3)
                };
                pairs.map(point).collect()
            };
            let after = |output| model.correct(SpecificForceMps2(output), None).0;
            page.chart(&Chart {
                title: format!("{name}: output less reference"),
                x: "time, s".to_owned(),
                y: "mm/s²".to_owned(),
                series: vec![
                    Series::line("before correction", over_time(&|output| output)),
                    Series::line("after correction", over_time(&after)),
                ],
                ..Chart::default()
            })?;
        }
        Ok(page)
    }
}

impl UpdateReport {
    /// A page: |f| − g of each rest beside what the stored calibration explains.
    ///
    /// # Errors
    /// `file_failed` when a picture cannot be drawn.
    pub fn page(&self) -> Result<Report> {
        let title = format!("Calibration {} against {}", self.stored_id, self.source);
        let mut page = page(title, &self.outcome, &self.to_string(), 1);
        page.key("rests", &self.poses.to_string());
        page.key("of them contradict it", &self.contradictions.to_string());
        if let Some(change) = self.bias_change_m_s2 {
            let largest = change.map(f64::abs).into_iter().fold(0.0, f64::max);
            page.key("largest change of the bias", &mm_s2(largest * 1e3));
        }
        if self.rests.is_empty() {
            return Ok(page);
        }
        let rests = || (0_u32..).map(f64::from).zip(&self.rests);
        // Symmetric, and wide enough for both.
        let half = rests().map(|(_, rest)| rest.residual_mm_s2.abs().max(rest.expected_sd_mm_s2));
        let half = 1.1 * half.fold(0.0, f64::max);
        let expected =
            rests().map(|(k, rest)| (k, -rest.expected_sd_mm_s2, rest.expected_sd_mm_s2));
        page.chart(&Chart {
            title: "|f| − g of each rest under the stored calibration".to_owned(),
            x: "rest".to_owned(),
            y: "mm/s²".to_owned(),
            y_range: Some((-half, half)),
            series: vec![
                Series::line("expected, ± 1 σ", rests().map(|(k, _)| (k, 0.0)).collect()),
                Series::dots(
                    "rest",
                    rests().map(|(k, rest)| (k, rest.residual_mm_s2)).collect(),
                ),
            ],
            bands: vec![Band {
                series: 0,
                points: expected.collect(),
            }],
            ..Chart::default()
        })?;
        Ok(page)
    }
}
