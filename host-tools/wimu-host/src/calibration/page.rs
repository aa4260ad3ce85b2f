//! The report of a calibration as a page.

use super::{CalibrationReport, StaticPose, magnitude};
use crate::chart::{Chart, Series};
use crate::error::Result;
use crate::html::Report;

/// Smallest residual on the logarithmic axis, mm/s².
const LEAST_SHOWN_MM_S2: f64 = 1e-3;

impl CalibrationReport {
    /// The report as one HTML page: the text, |f| − g of each pose before and after, the poses on a sphere, and their
    /// table.
    ///
    /// # Errors
    /// `file_failed` when a picture cannot be drawn.
    pub fn page(&self) -> Result<Report> {
        let mut page = Report::new(format!("Calibration of {}", self.source));
        page.printed(&self.to_string())
            .findings(&self.outcome.findings);
        if !self.static_poses.is_empty() {
            page.chart(&self.residuals())?.chart(&self.sphere())?;
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

    /// |f| − g of each pose before and after correction.
    fn residuals(&self) -> Chart {
        let dots = |name: &str, of: &dyn Fn(&StaticPose) -> Option<f64>| {
            let poses = self.static_poses.iter().zip(0_u32..);
            let points = poses.filter_map(|(pose, k)| {
                Some((f64::from(k), of(pose)?.abs().max(LEAST_SHOWN_MM_S2)))
            });
            Series::dots(name, points.collect())
        };
        let before = |pose: &StaticPose| (magnitude(pose.mean_m_s2) - self.gravity_m_s2) * 1e3;
        Chart {
            title: "Size of |f| − g in each pose".to_owned(),
            x: "pose".to_owned(),
            y: "mm/s²".to_owned(),
            log: true,
            series: vec![
                dots("before correction", &|pose| Some(before(pose))),
                dots("after correction", &|pose| pose.residual_mm_s2),
            ],
            ..Chart::default()
        }
    }

    /// The upward directions of the poses on the sphere: its upper half as seen from above, and its lower half.
    fn sphere(&self) -> Chart {
        const APART: f64 = 1.2;
        let seen = |up: [f64; 3]| {
            let [x, y, z] = up.map(|axis| axis / magnitude(up));
            (x + if z < 0.0 { APART } else { -APART }, y)
        };
        let circle = |middle: f64| {
            let angles = (0..=72).map(|k| f64::from(k) * std::f64::consts::PI / 36.0);
            angles.map(move |angle| (middle + angle.cos(), angle.sin()))
        };
        let outline = circle(-APART)
            .chain([(0.0, f64::NAN)])
            .chain(circle(APART))
            .collect();
        let held = self.static_poses.iter().map(|pose| seen(pose.mean_m_s2));
        let mut series = vec![
            Series::dots("pose held", held.collect()),
            Series::line("left: Z up, right: Z down", outline),
        ];
        if !self.next_poses.is_empty() {
            let advised = self.next_poses.iter().map(|pose| seen(pose.up));
            series.push(Series::dots("pose to add", advised.collect()));
        }
        Chart {
            title: "Upward directions of the poses on a sphere: they should cover it".to_owned(),
            x: "X".to_owned(),
            y: "Y".to_owned(),
            equal: true,
            series,
            ..Chart::default()
        }
    }
}
