//! The pose of a camera as text and as a page.

use std::fmt;

use super::HandEye;
use crate::chart::{Chart, Series};
use crate::digits::{signed_with_sd, significant};
use crate::document::Document;

impl fmt::Display for HandEye {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "camera: {}, body: {}", self.sources[0], self.sources[1])?;
        if let (Some(q), Some(sd)) = (self.quaternion, self.rotation_sd_rad) {
            let q = q.map(|c| format!("{c:.5}")).join(", ");
            let sd = sd.map(|sd| significant(sd.to_degrees(), 2)).join(", ");
            writeln!(out, "rotation, camera to body:  {q} (w, x, y, z)")?;
            writeln!(out, "                           ± {sd} deg about the camera's axes")?;
        }
        match (self.translation_m, self.translation_sd_m) {
            (Some(t), Some(sd)) => {
                let of = |k: usize| signed_with_sd(1e3 * t[k], 1e3 * sd[k]);
                let t = [of(0), of(1), of(2)].join(", ");
                writeln!(out, "camera in the body:        {t} mm, body axes")?;
            }
            _ if self.quaternion.is_some() => {
                writeln!(out, "camera in the body:        not shown by the motion")?;
            }
            _ => {}
        }
        if let Some([offset, sd]) = self.offset_s {
            let offset = signed_with_sd(1e3 * offset, 1e3 * sd);
            writeln!(out, "body clock − camera clock: {offset} ms")?;
        }
        if let (Some([rotation, position]), Some(birge)) = (self.noise, self.birge_ratio) {
            writeln!(
                out,
                "based on {} poses; noise {}° and {} mm; blocks scatter {} times as white noise would",
                self.poses[0],
                significant(rotation.to_degrees(), 2),
                significant(1e3 * position, 2),
                significant(birge.max(0.0).sqrt(), 2)
            )?;
        }
        write!(out, "{}", self.outcome)
    }
}

/// A page with the key figures and both residuals over time.
pub(super) fn page(report: &HandEye, text: &str) -> Document {
    let mut page = Document::new("Pose of a camera in the body");
    match &report.outcome.reason {
        Some(reason) => page.result(&format!("No result: {reason}")),
        None => page.result("The camera's rotation in the body is known."),
    };
    if let Some(sd) = report.rotation_sd_rad {
        let worst = sd.iter().copied().fold(0.0, f64::max);
        let worst = significant(worst.to_degrees(), 2);
        page.key("rotation, largest σ of an axis", &format!("{worst}°"));
    }
    if let Some(sd) = report.translation_sd_m {
        let worst = sd.iter().copied().fold(0.0, f64::max);
        page.key(
            "translation, largest σ of an axis",
            &format!("{} mm", significant(1e3 * worst, 2)),
        );
    }
    if let Some([offset, sd]) = report.offset_s {
        page.key("clock offset", &format!("{} ms", signed_with_sd(1e3 * offset, 1e3 * sd)));
    }
    let chart = |title: &str, unit: &str, of: &dyn Fn(&super::Residual) -> f64| {
        let points = report.residuals.iter().map(|r| (r.time_s, of(r)));
        let dots = Series::dots("pose", points.collect());
        Chart::new(title, "time, s", unit, vec![dots])
    };
    if !report.residuals.is_empty() {
        page.chart(&chart("Residual of the rotation", "°", &|r| r.rotation_rad.to_degrees()));
        page.chart(&chart("Residual of the position", "mm", &|r| 1e3 * r.position_m));
    }
    page.printed(text);
    page.findings(&report.outcome.findings);
    page
}
