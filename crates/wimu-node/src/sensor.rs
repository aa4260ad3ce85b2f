//! Sensors of a node.

use core::fmt;

use embedded_hal_async::i2c::{self, ErrorKind, NoAcknowledgeSource};
use wimu_link::hello::{Capabilities, Part};
use wimu_link::message::Settings;
use wimu_model::{
    CentiCelsius, Corrector, DeviceTimeUs, GyroscopeCorrector, MagneticFieldNt, PeriodNs,
    Sensitivity,
};

pub use crate::sample::RawSample;
use crate::secondary::Secondary;

/// Operation of a sensor under given settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Plan {
    /// The settings.
    pub settings: Settings,
    /// Sensor 0, which is corrected and integrated on the device.
    pub sensor: SensorPlan,
}

impl Plan {
    /// Sensor 0 operates as `sensor` says under `settings`.
    pub fn new(settings: Settings, sensor: SensorPlan) -> Self {
        Self { settings, sensor }
    }
}

/// Operation of one sensor: its rate, and the scales of its counts.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct SensorPlan {
    /// Nominal time between samples.
    pub period: PeriodNs,
    /// Nominal scale of the accelerometer's counts.
    pub accelerometer: &'static AccelerometerScale,
    /// Positive full scale of the accelerometer, LSB: at or beyond it, in either direction, an axis is
    /// saturated.
    pub full_scale: i32,
    /// The gyroscope; `None` without one.
    pub gyroscope: Option<&'static GyroscopePlan>,
}

impl SensorPlan {
    /// An accelerometer with a sample every `period`, saturated at ±`full_scale` LSB.
    pub const fn new(
        period: PeriodNs,
        accelerometer: &'static AccelerometerScale,
        full_scale: i32,
    ) -> Self {
        Self { period, accelerometer, full_scale, gyroscope: None }
    }

    /// Adds a gyroscope, sampled together with the accelerometer.
    #[must_use]
    pub const fn with_gyroscope(self, gyroscope: &'static GyroscopePlan) -> Self {
        Self { gyroscope: Some(gyroscope), ..self }
    }
}

/// Nominal scale of an accelerometer's counts. Made in a constant, it leaves no floating point in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AccelerometerScale {
    sensitivity: Sensitivity,
    ideal: Corrector,
}

impl AccelerometerScale {
    /// Counts of `sensitivity`.
    pub const fn new(sensitivity: Sensitivity) -> Self {
        Self { sensitivity, ideal: Corrector::ideal(sensitivity) }
    }

    /// Counts of `lsb_per_g` LSB/*g*.
    ///
    /// # Panics
    /// Outside 160..=1048576 LSB/*g*: call it in a constant.
    pub const fn of(lsb_per_g: f64) -> Self {
        match Sensitivity::from_lsb_per_g(lsb_per_g) {
            Ok(sensitivity) => Self::new(sensitivity),
            Err(_) => panic!("a sensitivity of 160 to 1048576 LSB/g"),
        }
    }

    /// The sensitivity.
    pub const fn sensitivity(&self) -> Sensitivity {
        self.sensitivity
    }

    pub(crate) const fn ideal(&self) -> Corrector {
        self.ideal
    }
}

/// Scale of a gyroscope's counts. Made in a constant, it leaves no floating point in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GyroscopePlan {
    rad_s_per_lsb: f64,
    ideal: GyroscopeCorrector,
    full_scale: i32,
}

impl GyroscopePlan {
    /// Counts of `rad_s_per_lsb`, rad/s, at most 0.0039, saturated at ±`full_scale` LSB.
    pub const fn new(rad_s_per_lsb: f64, full_scale: i32) -> Self {
        Self { rad_s_per_lsb, ideal: GyroscopeCorrector::ideal(rad_s_per_lsb), full_scale }
    }

    /// Nominal size of a count, rad/s.
    pub const fn rad_s_per_lsb(&self) -> f64 {
        self.rad_s_per_lsb
    }

    /// Positive full scale, LSB: at or beyond it, in either direction, an axis is saturated.
    pub const fn full_scale(&self) -> i32 {
        self.full_scale
    }

    pub(crate) const fn ideal(&self) -> GyroscopeCorrector {
        self.ideal
    }
}

/// Result of [`InertialSensor::next`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Batch {
    /// Number of samples, at least one.
    pub count: usize,
    /// Time of the newest sample, device clock.
    pub last_time: DeviceTimeUs,
    /// Index of the sensor that took them, 0..=7.
    pub sensor: u8,
    /// Whether the sensor reports that earlier samples were lost.
    pub overrun: bool,
    /// Whether the sensor queues its samples, so that without an overrun no sample is missing, however late
    /// the read.
    pub queued: bool,
}

impl Batch {
    /// `count` samples of sensor 0, the newest at `last_time`, without an overrun and not queued.
    pub fn new(count: usize, last_time: DeviceTimeUs) -> Self {
        Self { count, last_time, sensor: 0, overrun: false, queued: false }
    }

    /// The samples are those of the sensor with this index.
    #[must_use]
    pub fn of_sensor(self, sensor: u8) -> Self {
        Self { sensor, ..self }
    }

    /// Whether the sensor reports that earlier samples were lost.
    #[must_use]
    pub fn with_overrun(self, overrun: bool) -> Self {
        Self { overrun, ..self }
    }

    /// The sensor queues its samples.
    #[must_use]
    pub fn queued(self) -> Self {
        let queued = true;
        Self { queued, ..self }
    }
}

/// Measurements other than acceleration; `None` if the sensor has no such measurement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Surroundings {
    /// Magnetic field, magnetometer axes.
    pub magnetic_field: Option<MagneticFieldNt>,
    /// Temperature of the sensor.
    pub temperature: Option<CentiCelsius>,
}

/// An inertial sensor: an accelerometer, with or without a gyroscope, magnetometer and thermometer; or several
/// of them on one board.
///
/// Counts are in right-handed axes: the sensor's, or the board's after [`Mounting`](crate::Mounting).
#[allow(async_fn_in_trait)] // Nodes are polled where they are built; nothing needs `Send`.
pub trait InertialSensor {
    /// Counts of one sample. A node of three-axis samples contains no code for gyroscopes.
    type Sample: RawSample;

    /// Type of [`planner`](Self::planner).
    type Planner: Planner;

    /// Whether it can measure the magnetic field. If not, the code for headings is left out.
    const MAGNETOMETER: bool = true;

    /// Its number, 0 without one, and its name.
    const PART: Part = Part::new(0, "");

    /// What it measures, and how its samples are timed if not by its data-ready line.
    const CAPABILITIES: Capabilities = Capabilities::ACCELEROMETER;

    /// What knows the supported settings. The control task asks it; the sampler has the sensor.
    fn planner(&self) -> Self::Planner;

    /// The sensors with index 1 and up, at most 7. Their samples are sent without correction, and are corrected on
    /// the host.
    fn secondary(&mut self) -> &mut [Secondary] {
        &mut []
    }

    /// Starts or restarts the sensor under `plan`.
    ///
    /// # Errors
    /// [`SensorFault`]; the sensor's state is undefined then, and `configure` is called again.
    async fn configure(&mut self, plan: &Plan) -> Result<(), SensorFault>;

    /// Waits for samples of one sensor and writes them to `samples`, oldest first. Returns within a few sample
    /// periods even without samples.
    ///
    /// # Errors
    /// [`SensorFault`] when the sensor does not answer or has no data.
    async fn next(&mut self, samples: &mut [Self::Sample]) -> Result<Batch, SensorFault>;

    /// Reads magnetic field and temperature.
    ///
    /// # Errors
    /// [`SensorFault`] when the sensor does not answer.
    async fn surroundings(&mut self) -> Result<Surroundings, SensorFault>;
}

/// The settings that a sensor supports. Implemented for functions and closures, so that
/// `type Planner = fn(&Settings) -> Result<Plan, Settings>` serves for a sensor whose settings depend on
/// its type only.
pub trait Planner {
    /// The plan for `wanted`.
    ///
    /// # Errors
    /// The nearest supported settings.
    fn plan(&self, wanted: &Settings) -> Result<Plan, Settings>;
}

impl<F: Fn(&Settings) -> Result<Plan, Settings>> Planner for F {
    fn plan(&self, wanted: &Settings) -> Result<Plan, Settings> {
        self(wanted)
    }
}

/// A failure of a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SensorFault {
    /// Its address is not acknowledged.
    NotAnswering,
    /// The bus or a transfer failed.
    Transfer,
    /// Another chip is at its address.
    WrongIdentity {
        /// The expected identification.
        expected: u8,
        /// The identification read.
        found: u8,
    },
    /// It answers, but has no new sample.
    NoData,
    /// Its accelerometer has new samples, its gyroscope has none.
    GyroscopeStopped,
}

impl fmt::Display for SensorFault {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotAnswering => out.write_str(
                "the sensor does not answer: check its power, its wiring and its address",
            ),
            Self::Transfer => out
                .write_str("transfers on the sensor's bus fail: check its wiring and its pull-ups"),
            Self::WrongIdentity { expected, found } => write!(
                out,
                "another chip is at this address: it identifies itself as {found:#04x}, expected {expected:#04x}"
            ),
            Self::NoData => out.write_str("the sensor answers but has no new data"),
            Self::GyroscopeStopped => out.write_str(
                "the gyroscope has stopped, the accelerometer has not: check the sensor's supply; replace it if this repeats",
            ),
        }
    }
}

impl core::error::Error for SensorFault {}

impl SensorFault {
    /// The fault that an error of an I²C bus means: an address without acknowledgement is
    /// [`NotAnswering`](Self::NotAnswering), everything else [`Transfer`](Self::Transfer).
    pub fn of_bus(error: &impl i2c::Error) -> Self {
        match error.kind() {
            ErrorKind::NoAcknowledge(
                NoAcknowledgeSource::Address | NoAcknowledgeSource::Unknown,
            ) => Self::NotAnswering,
            _ => Self::Transfer,
        }
    }
}
