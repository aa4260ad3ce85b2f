//! The noise of a sensor: an accelerometer or a gyroscope, in the units in which each is shown.

use serde::Serialize;
use wimu_calib::{AllanVariance, AxisNoise, Measured, Refusal};
use wimu_model::STANDARD_GRAVITY_MPS2;

use super::{Figure, PointReport};
use crate::{Code, Problem};

/// Unit of a figure: its name, how many there are in an SI unit, and the decimals that are shown.
#[derive(Debug)]
pub(super) struct Unit {
    pub name: &'static str,
    pub per_si: f64,
    decimals: usize,
}

impl Unit {
    const fn new(name: &'static str, per_si: f64, decimals: usize) -> Self {
        Self { name, per_si, decimals }
    }

    /// An SI value in this unit, without its name.
    pub fn number(&self, value: f64) -> String {
        format!("{:.1$}", value * self.per_si, self.decimals)
    }

    /// The same with its standard deviation.
    pub fn text(&self, Measured { value, sd }: Measured) -> String {
        format!("{} ± {}", self.number(value), self.number(sd))
    }
}

/// A kind of sensor, and how its noise is shown.
#[derive(Debug)]
pub(super) struct Kind {
    pub name: &'static str,
    pub si: &'static str,
    /// Before the name of an axis.
    prefix: &'static str,
    pub density: Unit,
    /// N, and K, with their names.
    pub white: (&'static str, Unit),
    pub walk: (&'static str, Unit),
    pub bias: Unit,
    pub drift: Unit,
    pub deviation: Unit,
}

/// µg of 1 m/s², and degrees of 1 rad.
const UG: f64 = 1e6 / STANDARD_GRAVITY_MPS2;
const DEG: f64 = 180.0 / std::f64::consts::PI;

pub(super) static ACCELEROMETER: Kind = Kind {
    name: "accelerometer",
    si: "m/s²",
    prefix: "",
    density: Unit::new("µg/√Hz", UG, 1),
    white: ("velocity random walk", Unit::new("mm/s/√s", 1e3, 3)),
    walk: ("acceleration random walk", Unit::new("µg/√s", UG, 2)),
    bias: Unit::new("µg", UG, 1),
    drift: Unit::new("µg/min", 60.0 * UG, 1),
    deviation: Unit::new("mm/s²", 1e3, 4),
};

pub(super) static GYROSCOPE: Kind = Kind {
    name: "gyroscope",
    si: "rad/s",
    prefix: "gyroscope ",
    density: Unit::new("°/s/√Hz", DEG, 5),
    white: ("angle random walk", Unit::new("°/√h", 60.0 * DEG, 3)),
    walk: ("rate random walk", Unit::new("°/s/√s", DEG, 6)),
    bias: Unit::new("°/h", 3600.0 * DEG, 2),
    drift: Unit::new("°/h/min", 216_000.0 * DEG, 2),
    deviation: Unit::new("°/s", DEG, 5),
};

/// The noise of a sensor, SI units.
#[derive(Clone, Debug)]
pub struct SensorNoise {
    pub(super) kind: &'static Kind,
    /// X, Y, Z.
    pub axes: [AxisNoise; 3],
    /// The curve.
    pub points: Vec<PointReport>,
}

impl SensorNoise {
    pub(super) fn of(allan: &AllanVariance, kind: &'static Kind) -> Result<Self, Refusal> {
        let points = allan.points().map(PointReport::from).collect();
        Ok(Self { kind, axes: allan.result()?, points })
    }

    /// The axes with their names.
    fn named(&self) -> impl Iterator<Item = (String, &AxisNoise)> {
        let names = ["X", "Y", "Z"].map(|axis| format!("{}{axis}", self.kind.prefix));
        names.into_iter().zip(&self.axes)
    }

    /// What a user should know beside the numbers.
    pub(super) fn findings(&self) -> Vec<Problem> {
        let mut findings = Vec::new();
        let deviation = &self.kind.deviation;
        for (name, axis) in self.named() {
            if axis.is_coarse() {
                let text = format!(
                    "{name}: one step of the output, {:.2} {}, is {:.1} times its noise: the figures are those of the \
                     quantisation",
                    axis.step_mps2 * deviation.per_si,
                    deviation.name,
                    axis.step_mps2 / axis.sample_sd_mps2
                );
                let finding = Code::Quantisation.warning(text);
                findings.push(finding.remedy("choose a smaller range or a higher resolution"));
            } else if !axis.is_noise() {
                findings.push(Code::NotNoise.warning(format!(
                    "{name}: not noise alone (χ² {:.0} times too large): hum or vibration; the numbers are rough, see the \
                     curve",
                    axis.misfit
                )));
            }
            if let Some(tau_s) = axis.white_from_s {
                findings.push(Code::NotNoise.note(format!(
                    "{name}: the output is filtered, or samples repeat: it is white noise from averaging times of \
                     {tau_s:.3} s on, and the figures are from there"
                )));
            }
            if axis.clipped_samples > 0 {
                let text = format!(
                    "{name}: {} samples are clipped at the end of the output: the noise is larger than these figures",
                    axis.clipped_samples
                );
                let remedy = "choose a larger range or rotate the axis away from its end";
                findings.push(Code::Saturated.warning(text).remedy(remedy));
            }
            if axis.is_one_event {
                let finding = Code::NotNoise.warning(format!(
                    "{name}: a single event (warm-up or a jump) dominates long times: bias instability and random walk are \
                     left out"
                ));
                let remedy = "record again with a warm sensor that is not disturbed";
                findings.push(finding.remedy(remedy));
            }
        }
        findings
    }
}

/// The noise of an axis of a gyroscope.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct GyroscopeAxis {
    /// Noise density, one-sided as datasheets give it, °/s/√Hz.
    pub noise_density_deg_s_rthz: Figure,
    /// Angle random walk, °/√h.
    pub angle_random_walk_deg_rth: Figure,
    /// The same, rad/s/√Hz.
    pub angle_random_walk_rad_s_rthz: Figure,
    /// Bias instability, °/h; `None` where the recording is too short to observe it.
    pub bias_instability_deg_h: Option<Figure>,
    /// Rate random walk, °/s/√s, where it is observed.
    pub rate_random_walk_deg_s_rts: Option<Figure>,
    /// The same, rad/s/√s.
    pub rate_random_walk_rad_s_rts: Option<Figure>,
    /// Smallest Allan deviation, °/h.
    pub floor_deg_h: f64,
    /// The same, rad/s.
    pub floor_rad_s: f64,
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
            let factor = factor * DEG;
            Figure::from(Measured { value: measured.value * factor, sd: measured.sd * factor })
        };
        Self {
            noise_density_deg_s_rthz: degrees(noise.noise_density(), 1.0),
            angle_random_walk_deg_rth: degrees(noise.velocity_random_walk, 60.0),
            angle_random_walk_rad_s_rthz: noise.velocity_random_walk.into(),
            bias_instability_deg_h: noise.bias_instability_mps2.map(|b| degrees(b, 3600.0)),
            rate_random_walk_deg_s_rts: noise.acceleration_random_walk.map(|k| degrees(k, 1.0)),
            rate_random_walk_rad_s_rts: noise.acceleration_random_walk.map(Figure::from),
            floor_deg_h: noise.floor_mps2 * DEG * 3600.0,
            floor_rad_s: noise.floor_mps2,
            floor_tau_s: noise.floor_tau_s,
            is_noise: noise.is_noise(),
            is_coarse: noise.is_coarse(),
        }
    }
}
