//! Sensor of a node.

use core::fmt;

use embedded_hal_async::i2c::{self, ErrorKind, NoAcknowledgeSource};
use wimu_link::message::Settings;
use wimu_model::{CentiCelsius, Counts, DeviceTimeUs, MagneticFieldNt, PeriodNs, Sensitivity};

/// The operation of a sensor under given settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Plan {
    /// The settings.
    pub settings: Settings,
    /// Nominal time between samples.
    pub period: PeriodNs,
    /// Nominal sensitivity of the 16-bit counts.
    pub sensitivity: Sensitivity,
    /// Positive full scale, LSB: at or beyond it an axis is saturated.
    pub full_scale: i16,
}

/// Result of [`Accelerometer::next`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Batch {
    /// Number of samples, at least one.
    pub count: usize,
    /// Time of the newest sample, device clock.
    pub last_time: DeviceTimeUs,
    /// Whether the sensor reports that earlier samples were lost.
    pub overrun: bool,
    /// Whether the sensor queues its samples, so that without an overrun no sample is missing, however late
    /// the read.
    pub queued: bool,
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

/// A three-axis accelerometer.
///
/// Counts are 16-bit and left-justified, in right-handed axes: the sensor's, or the board's after
/// [`Mounting`](crate::Mounting).
#[allow(async_fn_in_trait)] // Nodes are polled where they are built; nothing needs `Send`.
pub trait Accelerometer {
    /// Whether it can measure the magnetic field. If not, the code for headings is left out.
    const MAGNETOMETER: bool = true;

    /// The plan for `wanted`.
    ///
    /// # Errors
    /// The nearest supported settings.
    fn plan(wanted: &Settings) -> Result<Plan, Settings>;

    /// Starts or restarts the sensor under `plan`.
    ///
    /// # Errors
    /// [`SensorFault`]; the sensor's state is undefined then, and `configure` is called again.
    async fn configure(&mut self, plan: &Plan) -> Result<(), SensorFault>;

    /// Waits for samples and writes them to `counts`, oldest first. Returns within a few sample periods even
    /// without samples.
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

/// A failure of a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
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
        }
    }
}

impl core::error::Error for SensorFault {}

impl SensorFault {
    /// The fault that a bus error means.
    pub(crate) fn of_bus(error: &impl i2c::Error) -> Self {
        match error.kind() {
            ErrorKind::NoAcknowledge(
                NoAcknowledgeSource::Address | NoAcknowledgeSource::Unknown,
            ) => Self::NotAnswering,
            _ => Self::Transfer,
        }
    }
}
