//! Noise of a gyroscope.

use std::fmt;

use serde::Serialize;
use wimu_calib::{AllanVariance, AxisNoise, Measured};

use super::Figure;
use crate::finding::{Finding, FindingCode};

/// The noise of an axis of a gyroscope.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct GyroscopeAxis {
    /// Noise density, one-sided as datasheets give it, °/s/√Hz.
    pub noise_density_deg_s_rthz: Figure,
    /// Angle random walk, °/√h.
    pub angle_random_walk_deg_rth: Figure,
    /// Bias instability, °/h; `None` where the recording is too short to observe it.
    pub bias_instability_deg_h: Option<Figure>,
    /// Rate random walk, °/s/√s, where it is observed.
    pub rate_random_walk_deg_s_rts: Option<Figure>,
    /// Smallest Allan deviation, °/h.
    pub floor_deg_h: f64,
    /// Averaging time of the smallest deviation, s.
    pub floor_tau_s: f64,
    /// False where hum or vibration is present.
    pub is_noise: bool,
    /// Whether the step of the output is larger than the noise.
    pub is_coarse: bool,
}

impl From<AxisNoise> for GyroscopeAxis {
    fn from(noise: AxisNoise) -> Self {
        let degrees = |measured: Measured, factor: f64| {
            let factor = factor.to_degrees();
            Figure::from(Measured { value: measured.value * factor, sd: measured.sd * factor })
        };
        Self {
            noise_density_deg_s_rthz: degrees(noise.noise_density(), 1.0),
            angle_random_walk_deg_rth: degrees(noise.velocity_random_walk, 60.0),
            bias_instability_deg_h: noise.bias_instability_mps2.map(|b| degrees(b, 3600.0)),
            rate_random_walk_deg_s_rts: noise.acceleration_random_walk.map(|k| degrees(k, 1.0)),
            floor_deg_h: noise.floor_mps2.to_degrees() * 3600.0,
            floor_tau_s: noise.floor_tau_s,
            is_noise: noise.is_noise(),
            is_coarse: noise.is_coarse(),
        }
    }
}

impl fmt::Display for GyroscopeAxis {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (density, walk) = (self.noise_density_deg_s_rthz, self.angle_random_walk_deg_rth);
        write!(
            out,
            "noise density (one-sided) {:.5} ± {:.5} °/s/√Hz, angle random walk {:.3} ± {:.3} °/√h, bias instability ",
            density.value, density.sd, walk.value, walk.sd
        )?;
        match self.bias_instability_deg_h {
            Some(b) => write!(out, "{:.2} ± {:.2} °/h", b.value, b.sd),
            None => write!(
                out,
                "not observed; σ falls to {:.2} °/h at {:.0} s",
                self.floor_deg_h, self.floor_tau_s
            ),
        }
    }
}

/// The axes of a gyroscope whose output, rad/s, was measured, or a finding why not, and what to know of them.
pub(super) fn measured(
    allan: &AllanVariance,
    findings: &mut Vec<Finding>,
) -> Option<[GyroscopeAxis; 3]> {
    let axes = match allan.result() {
        Ok(axes) => axes.map(GyroscopeAxis::from),
        Err(refusal) => {
            let text = format!("the gyroscope's noise is not measured: {refusal}");
            findings.push(FindingCode::NotNoise.warning(text));
            return None;
        }
    };
    for (name, axis) in ["X", "Y", "Z"].into_iter().zip(&axes) {
        if axis.is_coarse {
            let text = format!(
                "gyroscope {name}: the step of the output is larger than its noise: the figures are those of the quantisation"
            );
            findings.push(FindingCode::Quantisation.warning(text));
        } else if !axis.is_noise {
            let text = format!(
                "gyroscope {name}: not noise alone: hum or vibration; the numbers are rough"
            );
            findings.push(FindingCode::NotNoise.warning(text));
        }
    }
    Some(axes)
}
