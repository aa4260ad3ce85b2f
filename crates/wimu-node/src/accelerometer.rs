//! What the node asks of a sensor.

use core::fmt;

use embedded_hal_async::i2c::{self, ErrorKind, NoAcknowledgeSource};
use wimu_link::message::Settings;
use wimu_model::{CentiCelsius, Counts, DeviceTimeUs, MagneticFieldNt, PeriodNs, Sensitivity};

/// How a sensor will run under some settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Plan {
    /// The settings it follows from.
    pub settings: Settings,
    /// Nominal time between samples.
    pub period: PeriodNs,
    /// Nominal sensitivity of the 16-bit counts.
    pub sensitivity: Sensitivity,
    /// Positive full scale, LSB: at or beyond it an axis is saturated.
    pub full_scale: i16,
}

/// Samples that [`Accelerometer::next`] gave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Batch {
    /// How many counts were written, at least one.
    pub count: usize,
    /// When the newest of them was ready, device clock.
    pub last_time: DeviceTimeUs,
    /// Whether the sensor says that samples before these were lost.
    pub overrun: bool,
    /// Whether the sensor queues its samples: without an overrun none is missing before these,
    /// however late they were read.
    pub queued: bool,
}

/// What a sensor measures beside acceleration; `None` for what it does not have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Surroundings {
    /// Magnetic field, magnetometer axes.
    pub magnetic_field: Option<MagneticFieldNt>,
    /// Temperature of the sensor.
    pub temperature: Option<CentiCelsius>,
}

/// A three-axis accelerometer as the node drives it.
///
/// Counts are 16-bit, sensor axes; a sensor of fewer bits gives them left-justified.
#[allow(async_fn_in_trait)] // Nodes are polled where they are built; nothing needs `Send`.
pub trait Accelerometer {
    /// Whether there can be a magnetic field among its surroundings: without one, a node has no code
    /// for headings.
    const MAGNETOMETER: bool = true;

    /// How the sensor would run under `wanted`, or the nearest settings that it can do.
    ///
    /// # Errors
    /// The nearest possible settings.
    fn plan(wanted: &Settings) -> Result<Plan, Settings>;

    /// Starts the sensor, or starts it anew, under `plan`.
    ///
    /// # Errors
    /// [`SensorFault`]; the sensor's state is unknown then and `configure` is called again.
    async fn configure(&mut self, plan: &Plan) -> Result<(), SensorFault>;

    /// Waits for samples and writes the oldest first; returns within a few sample periods even if
    /// none come.
    ///
    /// # Errors
    /// [`SensorFault`] when the sensor does not answer or has no data.
    async fn next(&mut self, counts: &mut [Counts]) -> Result<Batch, SensorFault>;

    /// Reads magnetic field and temperature.
    ///
    /// # Errors
    /// [`SensorFault`] when the sensor does not answer.
    async fn surroundings(&mut self) -> Result<Surroundings, SensorFault>;
}

/// Why a sensor gave nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SensorFault {
    /// Nobody acknowledges its address.
    NotAnswering,
    /// The bus does not work, or a transfer broke off.
    Transfer,
    /// Another sensor is at its address.
    WrongIdentity {
        /// What it should answer.
        expected: u8,
        /// What it answered.
        found: u8,
    },
    /// It answers, but no sample became ready.
    NoData,
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
                "another sensor is at this address: it calls itself {found:#04x}, not {expected:#04x}"
            ),
            Self::NoData => out.write_str("the sensor answers but has no new data"),
        }
    }
}

impl core::error::Error for SensorFault {}

impl SensorFault {
    /// What a bus's error means.
    pub(crate) fn of_bus(error: &impl i2c::Error) -> Self {
        match error.kind() {
            ErrorKind::NoAcknowledge(
                NoAcknowledgeSource::Address | NoAcknowledgeSource::Unknown,
            ) => Self::NotAnswering,
            _ => Self::Transfer,
        }
    }
}
