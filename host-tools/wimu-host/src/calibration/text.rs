//! The result of a calibration as text: the answer, the parameters, the numbers behind them.

use std::cmp::Ordering;
use std::fmt;

use wimu_model::STANDARD_GRAVITY_MPS2;

use super::{CalibrationReport, Fit, MethodChoice, Source};
use crate::digits::{signed, signed_with_sd, significant, with_sd};
use crate::plural::counted;
use crate::{Problem, Severity};

/// Suggested poses.
const SUGGESTED: usize = 3;
/// Misalignments by name, row and column of A.
pub(super) const MISALIGNMENTS: [(&str, usize, usize); 6] = [
    ("m_yx", 0, 1),
    ("m_zx", 0, 2),
    ("m_xy", 1, 0),
    ("m_zy", 1, 2),
    ("m_xz", 2, 0),
    ("m_yz", 2, 1),
];

impl fmt::Display for CalibrationReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(fit) = &self.fit else {
            writeln!(out, "{}", self.outcome)?;
            write!(out, "{}", self.given())?;
            for pose in self.next_poses.iter().take(SUGGESTED) {
                write!(out, "\nadd a pose with {}: {}", pose.text, pose.instruction)?;
            }
            return Ok(());
        };
        writeln!(out, "{}", self.answer(fit))?;
        writeln!(out, "{}", self.given())?;
        axes(fit, out)?;
        if let Some(gyroscope) = &self.gyroscope {
            write!(out, "{gyroscope}")?;
        }
        self.quality(fit, out)?;
        write!(out, "{}", self.more_poses())
    }
}

impl CalibrationReport {
    /// Whether it can be used, error before and after, and what is uncertain.
    fn answer(&self, fit: &Fit) -> String {
        let before = significant(self.uncalibrated_rms_mm_s2.unwrap_or_default(), 3);
        let judged = fit.loo_orientation_rms_mm_s2.or(fit.loo_rms_mm_s2);
        let (after, how) = match judged {
            Some(loo) => (loo, "leave-one-out"),
            None => (fit.fitted_rms_mm_s2, "in sample: no pose can be left out"),
        };
        let warned = |finding: &&Problem| finding.severity == Severity::Warning;
        let usable = match self.outcome.findings.iter().filter(warned).count() {
            0 => "usable".to_owned(),
            count => format!("usable with {}", counted(count, "warning")),
        };
        format!(
            "{usable}; |f| − g {before} mm/s² rms before, {} after ({how}); 1 σ in the worst orientation: {} mm/s²",
            significant(after, 3),
            significant(fit.worst_sd_mm_s2, 3)
        )
    }

    /// Data, method and what was taken as known.
    fn given(&self) -> String {
        let uncertain = match self.gravity_sd_m_s2 {
            0.0 => String::new(),
            sd => format!(" ± {sd}"),
        };
        let mut text = format!(
            "{}: {}, {}, g = {}{uncertain} m/s²",
            self.source,
            counted(self.poses, "static pose"),
            self.method,
            self.gravity_m_s2,
        );
        if let (Some(sensitivity), Some(source)) =
            (self.sensitivity_lsb_per_g, self.sensitivity_source)
        {
            let source = match source {
                Source::Fit => "mean of the fit",
                Source::Board => "the board's",
                Source::Given | Source::Default | Source::Latitude | Source::SixteenBits => "given",
            };
            text += &format!(", {sensitivity:.1} LSB/g ({source})");
        }
        text
    }

    /// The numbers by which the fit is judged.
    fn quality(&self, fit: &Fit, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let all = match self.rejected {
            0 => String::new(),
            _ => format!(" ({} over all poses)", significant(fit.rms_mm_s2, 3)),
        };
        let sizes = self.static_poses.iter().map(|pose| pose.residual_mm_s2.map(f64::abs));
        let worst =
            sizes.enumerate().max_by(|a, b| a.1.partial_cmp(&b.1).unwrap_or(Ordering::Equal));
        let at = worst.map_or(String::new(), |(pose, _)| format!(" at pose {pose} (from 0)"));
        writeln!(
            out,
            "in sample {} mm/s² rms{all}, largest {}{at}; condition {:.1}, {} degrees of freedom, {:.0} % of the orientations \
             covered; ± is 1 σ",
            significant(fit.fitted_rms_mm_s2, 3),
            significant(fit.max_mm_s2, 3),
            fit.condition,
            fit.dof,
            fit.coverage * 100.0
        )?;
        if let Some(drift) = &fit.drift {
            let [x, y, z] = drift.change_m_s2.map(|axis| signed(axis * 1e3, 3));
            writeln!(
                out,
                "bias drift over {:.0} s: {x} {y} {z} mm/s²; the bias is that at the end",
                drift.span_s
            )?;
        }
        let terms = &fit.model.temperature;
        let varies = terms.bias_mps2_per_k != [0.0; 3] || terms.scale_per_k != [0.0; 3];
        if let Some([low, high]) = fit.temperature_range_c.filter(|_| varies) {
            let [x, y, z] = terms.bias_mps2_per_k.map(|slope| signed(slope * 1e3, 3));
            writeln!(
                out,
                "temperature coefficients of the bias: {x} {y} {z} mm/s²/K, valid from {low:.1} to {high:.1} °C"
            )?;
        }
        Ok(())
    }

    fn more_poses(&self) -> String {
        match (self.poses_worth_adding, self.next_poses.first()) {
            _ if self.method != MethodChoice::MultiPosition.name() => {
                "place the sensor more accurately rather than adding poses".to_owned()
            }
            (0, _) | (_, None) => "more poses would improve it little".to_owned(),
            (1, Some(next)) => format!("one more pose is worthwhile: {}", next.instruction),
            (more, Some(next)) => {
                let next = &next.instruction;
                format!("{more} more poses are worthwhile; the next: {next}")
            }
        }
    }
}

/// A line for each axis, and one of the misalignments.
fn axes(fit: &Fit, out: &mut fmt::Formatter<'_>) -> fmt::Result {
    for (axis, name) in ["X", "Y", "Z"].into_iter().enumerate() {
        let (bias, sd) = (fit.model.bias_mps2[axis], fit.sd.bias_mps2[axis]);
        match fit.not_observed.contains(&format!("bias {name}")) {
            true => write!(out, "{name}: bias not observed, taken as 0 ± {sd:.1} m/s², ")?,
            false => {
                let mg = signed(bias * 1e3 / STANDARD_GRAVITY_MPS2, 3);
                let bias = signed_with_sd(bias, sd);
                write!(out, "{name}: bias {bias} m/s² ({mg} mg), ")?;
            }
        }
        let (scale, sd) = (fit.model.matrix[axis][axis], fit.sd.matrix[axis][axis]);
        match fit.fitted.contains(&format!("scale factor {name}")) {
            true => writeln!(out, "scale factor {}", with_sd(scale, sd))?,
            false => writeln!(out, "scale factor not observed, taken as 1 ± {sd:.2}")?,
        }
    }
    let misaligned: Vec<String> = MISALIGNMENTS
        .into_iter()
        .filter(|(name, ..)| fit.fitted.contains(&format!("misalignment {name}")))
        .map(|(name, r, c)| {
            let (off, sd) = (fit.model.matrix[r][c] * 1e3, fit.sd.matrix[r][c] * 1e3);
            format!("{name} {}", signed_with_sd(off, sd))
        })
        .collect();
    match misaligned.is_empty() {
        true => Ok(()),
        false => writeln!(out, "misalignment, mrad: {}", misaligned.join(", ")),
    }
}
