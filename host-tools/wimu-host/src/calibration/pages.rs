//! Reports as pages: several sessions, one stream against another, and a stored calibration against later rests.

use wimu_model::{ErrorModel, SpecificForceMps2};

use super::{Paired, ReferenceReport, RestReport, SessionReport, SeveralReport, UpdateReport};
use crate::chart::{Band, Chart, Series};
use crate::digits::significant;
use crate::html::Report;
use crate::problem::Outcome;

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
    pub fn page(&self) -> Report {
        let names: Vec<String> = self.sessions.iter().map(|s| s.source.clone()).collect();
        let title = format!("Calibration of {}", names.join(", "));
        let mut page = page(title, &self.outcome, &self.to_string(), 0);
        let Some(fit) = &self.fit else {
            return page;
        };
        let [before, after] = [fit.uncalibrated_rms_mm_s2, fit.rms_mm_s2]
            .map(|rms| significant(rms.unwrap_or_default(), 3));
        let name = "|f| − g over all poses, rms, before and after";
        page.key(name, &format!("{before} → {after} mm/s²"));
        let repeats = fit.between_sd;
        page.key("bias between sessions, 1 σ", &mm_s2(repeats.bias_m_s2 * 1e3));
        let scale = significant(repeats.scale * 1e6, 3);
        page.key("scale factor between sessions, 1 σ", &format!("{scale} ppm"));
        let warm = self.sessions.iter().all(|s| s.temperature_c.is_some());
        let dots = |name: &str, labels: &[String], of: &dyn Fn(&SessionReport) -> f64| {
            let point = |(k, session): (usize, &SessionReport)| {
                let celsius = session.temperature_c.filter(|_| warm);
                (celsius.unwrap_or(k as f64), of(session))
            };
            Series {
                labels: labels.to_vec(),
                ..Series::dots(name, self.sessions.iter().enumerate().map(point).collect())
            }
        };
        let x = if warm { "temperature, °C" } else { "session" };
        let bias = |axis: usize| {
            let labels = if axis == 0 { &names[..] } else { &[] };
            dots(AXES[axis], labels, &|s| s.bias_difference_m_s2[axis] * 1e3)
        };
        let title = "Bias of each session less that of the combination";
        page.chart(&Chart::new(title, x, "mm/s²", [0, 1, 2].map(bias).into()));
        let own = |session: &SessionReport| session.own_rms_mm_s2.max(LEAST_MM_S2);
        let combined = |session: &SessionReport| {
            let rms = session.rms_mm_s2;
            rms.map_or(f64::NAN, |rms| rms.max(LEAST_MM_S2))
        };
        let series = vec![
            dots("its own calibration", &[], &own),
            dots("combined calibration", &names, &combined),
        ];
        page.chart(&Chart {
            log: true,
            ..Chart::new("Size of |f| − g in each session, rms", x, "mm/s²", series)
        });
        page
    }
}

impl ReferenceReport {
    /// A page: the difference of each axis from the reference in `data`, before and after correction.
    pub fn page(&self, data: &Paired) -> Report {
        let title = format!("{} against {}", self.output, self.reference);
        let mut page = page(title, &self.outcome, &self.to_string(), 1);
        let model = self.model.and_then(|terms| ErrorModel::new(terms).ok());
        let (Some(axes), Some(model)) = (&self.axes, model) else {
            return page;
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
            let series = vec![
                Series::line("before correction", over_time(&|output| output)),
                Series::line("after correction", over_time(&after)),
            ];
            let title = format!("{name}: output less reference");
            page.chart(&Chart::new(title, "time, s", "mm/s²", series));
        }
        page
    }
}

impl UpdateReport {
    /// A page: |f| − g of each rest beside what the stored calibration explains.
    pub fn page(&self) -> Report {
        let title = format!("Calibration {} against {}", self.stored_id, self.source);
        let mut page = page(title, &self.outcome, &self.to_string(), 1);
        page.key("rests", &self.poses.to_string());
        page.key("of them contradict it", &self.contradictions.to_string());
        if let Some(change) = self.bias_change_m_s2 {
            let largest = change.map(f64::abs).into_iter().fold(0.0, f64::max);
            page.key("largest change of the bias", &mm_s2(largest * 1e3));
        }
        if self.rests.is_empty() {
            return page;
        }
        let over = |of: &dyn Fn(&RestReport) -> f64| -> Vec<(f64, f64)> {
            let numbered = (0_u32..).map(f64::from).zip(&self.rests);
            numbered.map(|(k, rest)| (k, of(rest))).collect()
        };
        let sd = over(&|rest| rest.expected_sd_mm_s2);
        // Symmetric, and wide enough for all.
        let sizes = (self.rests.iter()).flat_map(|r| [r.residual_mm_s2.abs(), r.expected_sd_mm_s2]);
        let half = 1.1 * sizes.fold(0.0, f64::max);
        let series = vec![
            Series::line("expected, ± 1 σ", over(&|_| 0.0)),
            Series::dots("rest", over(&|rest| rest.residual_mm_s2)),
        ];
        let title = "|f| − g of each rest under the stored calibration";
        page.chart(&Chart {
            y_range: Some((-half, half)),
            bands: vec![Band {
                series: 0,
                points: sd.into_iter().map(|(k, sd)| (k, -sd, sd)).collect(),
            }],
            ..Chart::new(title, "rest", "mm/s²", series)
        });
        page
    }
}
