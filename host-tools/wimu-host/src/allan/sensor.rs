//! The noise of a sensor, an accelerometer or a gyroscope: in SI units as data, in those of datasheets as text and picture.

use serde::Serialize;
use wimu_calib::{AllanPoint, AllanVariance, Measured, Refusal};
use wimu_model::STANDARD_GRAVITY_MPS2;

use crate::digits::significant;
use crate::{Code, Problem};

/// A number and its standard deviation, 1 σ.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Figure {
    /// The number.
    pub value: f64,
    /// Its standard deviation.
    pub sd: f64,
    /// 95 % confidence interval.
    pub interval_95: [f64; 2],
    /// Their unit.
    pub unit: &'static str,
}

impl Figure {
    fn new(measured: Measured, unit: &'static str) -> Self {
        let Measured { value, sd } = measured;
        Self { value, sd, interval_95: measured.interval_95(), unit }
    }
}

/// The noise of an axis. u is the unit of the sensor, m/s² or rad/s.
#[derive(Clone, Copy, Debug, Serialize)]
#[non_exhaustive]
pub struct AxisNoise {
    /// Noise density, one-sided as datasheets give it, u/√Hz.
    pub noise_density: Figure,
    /// Velocity or angle random walk, the noise density / √2, u √s.
    pub random_walk: Figure,
    /// Bias instability, u; `None` where the recording is too short to observe it.
    pub bias_instability: Option<Figure>,
    /// Acceleration or rate random walk, u/√s, where it is observed.
    pub bias_random_walk: Option<Figure>,
    /// Smallest Allan deviation, u.
    pub floor: f64,
    /// Averaging time of the smallest deviation, s.
    pub floor_tau_s: f64,
    /// χ² per degree of freedom of the curve's residuals under the noise terms; 1 for noise.
    pub misfit: f64,
    /// False where hum, vibration or a drift is present.
    pub is_noise: bool,
    /// Averaging time from which a filtered output is white, s; the terms are estimated from there. `None` where it is not
    /// filtered.
    pub white_from_s: Option<f64>,
    /// Standard deviation from one sample to the next, u.
    pub sample_sd: f64,
    /// Smallest step of the output, u: one count for counts.
    pub step: f64,
    /// Whether that step is larger than the noise: then the figures are those of the quantisation.
    pub is_coarse: bool,
}

/// One averaging time.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Point {
    /// τ, s.
    pub tau_s: f64,
    /// Allan deviation of X, Y, Z, in the unit of the sensor.
    pub deviation: [f64; 3],
    /// Standard deviation of each, relative.
    pub relative_sd: f64,
}

impl From<AllanPoint> for Point {
    fn from(point: AllanPoint) -> Self {
        Self {
            tau_s: point.tau_s,
            deviation: point.deviation_mps2,
            relative_sd: point.relative_sd(),
        }
    }
}

/// Unit in which a figure is shown: its name, how many there are in an SI unit, and the decimals.
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
    pub fn text(&self, Figure { value, sd, .. }: Figure) -> String {
        format!("{} ± {}", self.number(value), self.number(sd))
    }
}

/// A kind of sensor: SI units of its figures, and how they are shown.
#[derive(Debug)]
pub(super) struct Kind {
    pub name: &'static str,
    /// u.
    pub si: &'static str,
    /// Of noise density, random walk and random walk of the bias.
    si_terms: [&'static str; 3],
    /// Before the name of an axis.
    prefix: &'static str,
    pub density: Unit,
    /// Random walk, and that of the bias, with their names.
    pub white: (&'static str, Unit),
    pub walk: (&'static str, Unit),
    pub bias: Unit,
    pub deviation: Unit,
}

/// µg of 1 m/s², and degrees of 1 rad.
const UG: f64 = 1e6 / STANDARD_GRAVITY_MPS2;
const DEG: f64 = 180.0 / std::f64::consts::PI;

pub(super) static ACCELEROMETER: Kind = Kind {
    name: "accelerometer",
    si: "m/s²",
    si_terms: ["m/s²/√Hz", "m/s/√s", "m/s²/√s"],
    prefix: "",
    density: Unit::new("µg/√Hz", UG, 1),
    white: ("velocity random walk", Unit::new("mm/s/√s", 1e3, 3)),
    walk: ("acceleration random walk", Unit::new("µg/√s", UG, 2)),
    bias: Unit::new("µg", UG, 1),
    deviation: Unit::new("mm/s²", 1e3, 4),
};

pub(super) static GYROSCOPE: Kind = Kind {
    name: "gyroscope",
    si: "rad/s",
    si_terms: ["rad/s/√Hz", "rad/√s", "rad/s/√s"],
    prefix: "gyroscope ",
    density: Unit::new("°/s/√Hz", DEG, 5),
    white: ("angle random walk", Unit::new("°/√h", 60.0 * DEG, 3)),
    walk: ("rate random walk", Unit::new("°/s/√s", DEG, 6)),
    bias: Unit::new("°/h", 3600.0 * DEG, 2),
    deviation: Unit::new("°/s", DEG, 5),
};

/// The noise of a sensor.
#[derive(Clone, Debug, Serialize)]
pub struct SensorNoise {
    #[serde(skip)]
    pub(super) kind: &'static Kind,
    /// X, Y, Z.
    pub axes: [AxisNoise; 3],
    /// The Allan deviation.
    pub points: Vec<Point>,
}

impl SensorNoise {
    pub(super) fn of(allan: &AllanVariance, kind: &'static Kind) -> Result<Self, Refusal> {
        let [density, white, walk] = kind.si_terms;
        let figure =
            |measured: Option<Measured>, unit| measured.map(|measured| Figure::new(measured, unit));
        let axes = allan.result()?.map(|axis| AxisNoise {
            noise_density: Figure::new(axis.noise_density(), density),
            random_walk: Figure::new(axis.velocity_random_walk, white),
            bias_instability: figure(axis.bias_instability_mps2, kind.si),
            bias_random_walk: figure(axis.acceleration_random_walk, walk),
            floor: axis.floor_mps2,
            floor_tau_s: axis.floor_tau_s,
            misfit: axis.misfit,
            is_noise: axis.is_noise(),
            white_from_s: axis.white_from_s,
            sample_sd: axis.sample_sd_mps2,
            step: axis.step_mps2,
            is_coarse: axis.is_coarse(),
        });
        Ok(Self { kind, axes, points: allan.points().map(Point::from).collect() })
    }

    /// What a user should know beside the numbers.
    pub(super) fn problems(&self) -> Vec<Problem> {
        let names = ["X", "Y", "Z"].map(|axis| format!("{}{axis}", self.kind.prefix));
        let axes = names.iter().zip(&self.axes);
        axes.flat_map(|(name, axis)| axis.problems(name, &self.kind.deviation)).collect()
    }
}

impl AxisNoise {
    fn problems(&self, name: &str, deviation: &Unit) -> Vec<Problem> {
        let mut problems = Vec::new();
        if self.is_coarse {
            let text = format!(
                "{name}: the quantisation step, {} {}, is {} times the noise: the noise terms are those of the quantisation",
                significant(self.step * deviation.per_si, 3),
                deviation.name,
                significant(self.step / self.sample_sd, 3)
            );
            let problem = Code::Quantisation.warning(text);
            problems.push(problem.remedy("choose a smaller range or a higher resolution"));
        } else if !self.is_noise {
            let problem = Code::NotNoise.warning(format!(
                "{name}: vibration or drift beside the noise: χ² per degree of freedom is {} (1 for noise)",
                significant(self.misfit, 3)
            ));
            problems.push(problem.remedy("record again with a warm sensor on a firm floor"));
        }
        if let Some(tau_s) = self.white_from_s {
            problems.push(Code::NotNoise.note(format!(
                "{name}: low-pass filtered or repeated samples: the noise terms are fitted from {} s on",
                significant(tau_s, 3)
            )));
        }
        problems
    }
}
