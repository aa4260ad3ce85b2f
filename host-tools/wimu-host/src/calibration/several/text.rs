//! The report on several sessions as text.

use std::fmt;

use super::super::text::MISALIGNMENTS;
use super::{SessionReport, SeveralFit, SeveralReport};
use crate::digits::{signed_with_sd, significant, with_sd};
use crate::plural::counted;

impl fmt::Display for SeveralReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(fit) = &self.fit else {
            return write!(out, "{}", self.outcome);
        };
        let of = |value: f64, unit: f64| significant(value * unit, 3);
        let (between, within) = (&fit.between_sd, &fit.within_sd);
        let changes = |between: f64, within: f64, unit: f64, name: &str| match between > 0.0 {
            true => format!("± {} {name} (± {})", of(between, unit), of(within, unit)),
            false => format!("no change seen (± {} {name})", of(within, unit)),
        };
        writeln!(
            out,
            "{}: bias repeats within ± {} mm/s² between sessions (± {} within one)",
            counted(self.sessions.len(), "session"),
            of(between.bias_m_s2, 1e3),
            of(within.bias_m_s2, 1e3),
        )?;
        writeln!(
            out,
            "scale factor {}, misalignment {}",
            changes(between.scale, within.scale, 1e6, "ppm"),
            changes(between.misalignment_rad, within.misalignment_rad, 1e3, "mrad"),
        )?;
        writeln!(
            out,
            "|f| − g over all poses: {} mm/s² rms before, {} after",
            significant(fit.uncalibrated_rms_mm_s2.unwrap_or_default(), 3),
            significant(fit.rms_mm_s2.unwrap_or_default(), 3),
        )?;
        fit.parameters(out)?;
        for session in &self.sessions {
            session.line(out)?;
        }
        let gravity = match self.gravity_sd_m_s2 {
            0.0 => self.gravity_m_s2.to_string(),
            sd => with_sd(self.gravity_m_s2, sd),
        };
        let method = self.method;
        write!(out, "{method}, g = {gravity} m/s²; ± is 1 σ of a new session")
    }
}

impl SeveralFit {
    fn parameters(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (model, sd) = (&self.model, &self.sd);
        for (axis, name) in ["X", "Y", "Z"].into_iter().enumerate() {
            writeln!(
                out,
                "{name}: bias {} m/s², scale factor {}",
                signed_with_sd(model.bias_mps2[axis], sd.bias_mps2[axis]),
                with_sd(model.matrix[axis][axis], sd.matrix[axis][axis]),
            )?;
        }
        let misaligned: Vec<String> = MISALIGNMENTS
            .into_iter()
            .filter(|(name, ..)| self.fitted.contains(&format!("misalignment {name}")))
            .map(|(name, r, c)| {
                let known = signed_with_sd(model.matrix[r][c] * 1e3, sd.matrix[r][c] * 1e3);
                format!("{name} {known}")
            })
            .collect();
        if !misaligned.is_empty() {
            writeln!(out, "misalignment, mrad: {}", misaligned.join(", "))?;
        }
        let (slopes, slopes_sd) = (&model.temperature, &sd.temperature);
        if let Some(range) = self.temperature.filter(|_| slopes_sd.bias_mps2_per_k[0] > 0.0) {
            let of = |value: [f64; 3], sd: [f64; 3], unit: f64| {
                [0, 1, 2].map(|k| signed_with_sd(value[k] * unit, sd[k] * unit)).join(", ")
            };
            writeln!(
                out,
                "per K from {:.1} °C, valid from {:.1} to {:.1} °C: bias {} mm/s², scale factor {} ppm",
                slopes.reference_c,
                range.lowest_c,
                range.highest_c,
                of(slopes.bias_mps2_per_k, slopes_sd.bias_mps2_per_k, 1e3),
                of(slopes.scale_per_k, slopes_sd.scale_per_k, 1e6),
            )?;
        }
        Ok(())
    }
}

impl SessionReport {
    fn line(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let largest = self.bias_difference_m_s2.map(f64::abs);
        let largest = largest.into_iter().fold(0.0, f64::max);
        let at = self.temperature_c;
        let at = at.map_or(String::new(), |celsius| format!("{celsius:.1} °C, "));
        writeln!(
            out,
            "{}: {}, {at}{} mm/s² rms, bias differs by up to {} mm/s²",
            self.source,
            counted(self.poses, "pose"),
            significant(self.rms_mm_s2.unwrap_or_default(), 3),
            significant(largest * 1e3, 3),
        )
    }
}
