//! The report of a calibration as a page.

use std::f64::consts::{FRAC_PI_6, PI};

use super::{CalibrationReport, StaticPose, magnitude};
use crate::chart::{Chart, Series, Style};
use crate::digits::significant;
use crate::html::Report;
use crate::plural::counted;

/// Smallest residual on the logarithmic axis, mm/s².
const LEAST_SHOWN_MM_S2: f64 = 1e-3;

impl CalibrationReport {
    /// The report as one HTML page: the result, |f| − g of each pose before and after, the poses on a sphere, their table,
    /// and the text.
    pub fn page(&self) -> Report {
        let mut page = Report::new(format!("Calibration of {}", self.source));
        self.key_figures(&mut page);
        page.printed(&self.to_string()).findings(&self.outcome.findings);
        if !self.static_poses.is_empty() {
            page.chart(&self.residuals()).chart(&self.sphere());
        }
        self.table(&mut page);
        page
    }

    fn key_figures(&self, page: &mut Report) {
        let (Some(fit), None) = (&self.fit, &self.outcome.reason) else {
            page.result(&self.outcome.to_string());
            return;
        };
        page.result(&format!(
            "{} fitted to {}: {}.",
            counted(fit.fitted.len(), "parameter"),
            counted(self.poses, "static pose"),
            self.terms.join(", ")
        ));
        let mm_s2 = |value: f64| format!("{} mm/s²", significant(value, 3));
        let before = self.uncalibrated_rms_mm_s2;
        let before = before.map_or(String::new(), |rms| format!("{} → ", significant(rms, 3)));
        page.key("|f| − g, rms, before and after", &(before + &mm_s2(fit.rms_mm_s2)));
        let left_out = fit.loo_orientation_rms_mm_s2.or(fit.loo_rms_mm_s2);
        if let Some(rms) = left_out {
            page.key("at poses left out of the fit, rms", &mm_s2(rms));
        }
        let name = "expected in the worst orientation, 1 σ";
        page.key(name, &mm_s2(fit.worst_sd_mm_s2));
    }

    fn table(&self, page: &mut Report) {
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
                    pose.temperature_c.map_or(String::new(), |celsius| format!("{celsius:.1}")),
                    pose.residual_mm_s2.map_or(String::new(), |residual| format!("{residual:+.3}")),
                    if left_out { "left out" } else { "" }.to_owned(),
                ]
            })
            .collect();
        page.table(
            "Static poses",
            &["pose", "mean output, m/s²", "samples", "noise, mm/s²", "°C", "|f| − g, mm/s²", ""],
            &rows,
        );
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
        let series = vec![
            dots("before correction", &|pose| Some(before(pose))),
            dots("after correction", &|pose| pose.residual_mm_s2),
        ];
        Chart {
            log: true, ..Chart::new("Size of |f| − g in each pose", "pose", "mm/s²", series)
        }
    }

    /// The upward directions of the poses on the unit sphere in sensor axes.
    fn sphere(&self) -> Chart {
        let unit = |up: [f64; 3]| up.map(|axis| axis / magnitude(up));
        let indices = |left_out: bool| {
            let all = 0..self.static_poses.len();
            all.filter(move |k| self.rejected_poses.contains(k) == left_out)
        };
        let poses = |name: &str, left_out: bool| {
            let up = indices(left_out).map(|k| unit(self.static_poses[k].mean_m_s2));
            Series {
                labels: indices(left_out).map(|k| k.to_string()).collect(),
                ..Series::space(name, Style::Dots, &up.collect::<Vec<_>>())
            }
        };
        let mut series = vec![poses("pose held", false), poses("left out", true)];
        let advised: Vec<_> = self.next_poses.iter().map(|pose| unit(pose.up)).collect();
        series.push(Series::space("pose to add", Style::Dots, &advised));
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
