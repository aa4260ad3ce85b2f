//! The report of a calibration as a page.

use super::{CalibrationReport, magnitude};
use crate::chart::{Chart, Series};
use crate::error::Result;
use crate::html::Report;

impl CalibrationReport {
    /// The report as one HTML page: the text, |f| − g of each pose before and after, and a table of the poses.
    ///
    /// # Errors
    /// `file_failed` when a picture cannot be drawn.
    pub fn page(&self) -> Result<Report> {
        let mut page = Report::new(format!("Calibration of {}", self.source));
        page.printed(&self.to_string())
            .findings(&self.outcome.findings);
        let before =
            |k: usize| (magnitude(self.static_poses[k].mean_m_s2) - self.gravity_m_s2) * 1e3;
        let numbered = |value: &dyn Fn(usize) -> Option<f64>| -> Vec<(f64, f64)> {
            (0..self.static_poses.len())
                .filter_map(|k| Some((k as f64, value(k)?)))
                .collect()
        };
        let after = numbered(&|k| self.static_poses[k].residual_mm_s2);
        let uncorrected = numbered(&|k| Some(before(k)));
        for (title, series) in [
            (
                "|f| − g before correction",
                Series::dots("before", uncorrected),
            ),
            ("|f| − g after correction", Series::dots("after", after)),
        ] {
            if series.points.is_empty() {
                continue;
            }
            page.chart(&Chart {
                title: title.to_owned(),
                x: "pose".to_owned(),
                y: "mm/s²".to_owned(),
                series: vec![series],
                ..Chart::default()
            })?;
        }
        let sky = |up: [f64; 3]| {
            let [x, y, z] = up;
            let size = magnitude(up);
            (size > 0.0).then(|| (y.atan2(x).to_degrees(), (z / size).asin().to_degrees()))
        };
        let held = self.static_poses.iter();
        let held: Vec<_> = held.filter_map(|pose| sky(pose.mean_m_s2)).collect();
        let advised: Vec<_> = self.next_poses.iter().filter_map(|p| sky(p.up)).collect();
        if !held.is_empty() {
            let mut series = vec![Series::dots("held", held)];
            if !advised.is_empty() {
                series.push(Series::dots("add", advised));
            }
            page.chart(&Chart {
                title: "Upward directions of the poses: they should cover the picture".to_owned(),
                x: "azimuth about Z from X towards Y, degrees".to_owned(),
                y: "elevation above the XY plane, degrees".to_owned(),
                y_range: Some((-95.0, 95.0)),
                series,
                ..Chart::default()
            })?;
        }
        let rows: Vec<Vec<String>> = self
            .static_poses
            .iter()
            .enumerate()
            .map(|(k, pose)| {
                let [x, y, z] = pose.mean_m_s2;
                let left_out = self.rejected_poses.contains(&k);
                vec![
                    k.to_string(),
                    format!("{x:+.4} {y:+.4} {z:+.4}"),
                    pose.samples.to_string(),
                    // Unknown for pose means.
                    match magnitude(pose.sd_m_s2) {
                        0.0 => String::new(),
                        noise => format!("{:.2}", noise * 1e3),
                    },
                    pose.temperature_c
                        .map_or(String::new(), |celsius| format!("{celsius:.1}")),
                    pose.residual_mm_s2
                        .map_or(String::new(), |residual| format!("{residual:+.3}")),
                    if left_out { "left out" } else { "" }.to_owned(),
                ]
            })
            .collect();
        page.table(
            &[
                "pose",
                "mean output, m/s²",
                "samples",
                "noise, mm/s²",
                "°C",
                "|f| − g, mm/s²",
                "",
            ],
            &rows,
        );
        Ok(page)
    }
}
