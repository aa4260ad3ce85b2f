//! What a device sends unasked.

use core::fmt;

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use wimu_model::ParameterId;

use super::MessageError;
use super::fault::ParameterFault;
use super::parameters::{EncodedParameters, WireParameters};
use super::settings::Settings;
use super::state::{WirePhase, WireState};
use crate::frame::{Kind, WIRE_VERSION};

/// Everything that a device sends unasked besides samples. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(clippy::large_enum_variant, reason = "there is no heap to box on")]
pub enum Telemetry<P = WireParameters> {
    /// From here on samples can be replayed.
    Epoch(Epoch),
    /// Magnetic field and temperature, at their own rate.
    Environment(Environment),
    /// Velocity and position.
    Navigation(Navigation),
    /// The parameters in use.
    Parameters(ActiveParameters<P>),
    /// The settings in use.
    Settings(Settings),
    /// How the device is.
    Status(Status),
    /// Something happened.
    Event {
        /// When, device time, µs.
        time_us: u64,
        /// What.
        event: Event,
    },
}

/// The messages that a device also stores, so that its store needs no layout of its own; later
/// firmware reads them for ever.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Record<'a> {
    /// [`Telemetry::Parameters`] with a set.
    Parameters(EncodedParameters<'a>),
    /// [`Telemetry::Settings`].
    Settings(Settings),
}

impl<'a> Record<'a> {
    /// Reads what has been [opened](crate::frame::open): of this wire version or an earlier one.
    ///
    /// # Errors
    /// [`MessageError`] when it is not exactly one of these messages.
    pub fn decode(opened: &'a [u8]) -> Result<Self, MessageError> {
        const TELEMETRY: u8 = Kind::Telemetry as u8;
        const V0: u8 = TELEMETRY;
        const V1: u8 = (WIRE_VERSION << 4) | TELEMETRY;
        match opened {
            // The places of the variants, and a set that is there.
            [V1, 3, rest @ ..] => match postcard::take_from_bytes::<u32>(rest)? {
                (_, [1, set @ ..]) => {
                    let parameters = EncodedParameters(set);
                    parameters.decode()?;
                    Ok(Self::Parameters(parameters))
                }
                _ => Err(MessageError::Malformed),
            },
            // The set's id was behind it.
            [V0, 3, 1, rest @ ..] => {
                let (parameters, id) = EncodedParameters::split_off_v0(rest)?;
                super::decode::<u32>(id)?;
                Ok(Self::Parameters(parameters))
            }
            [V0 | V1, 4, settings @ ..] => super::decode(settings).map(Self::Settings),
            _ => Err(MessageError::Malformed),
        }
    }
}

impl Telemetry {
    /// Reads the body of a frame of kind [`Kind::Telemetry`](crate::Kind::Telemetry). It may go on
    /// behind what is known here; an event that is not known is [`Event::Other`].
    ///
    /// # Errors
    /// [`MessageError`] when it is none, or one of a kind that this version does not know.
    pub fn decode(body: &[u8]) -> Result<Self, MessageError> {
        const EVENT: u32 = 6;
        super::decode_beginning(body).or_else(|error| {
            match (error, super::decode_beginning::<(u32, u64, u32)>(body)) {
                (MessageError::Malformed, Ok((EVENT, time_us, number))) => Ok(Self::Event {
                    time_us,
                    event: Event::Other { number },
                }),
                _ => Err(error),
            }
        })
    }
}

/// Why an epoch begins. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum EpochReason {
    /// The device has started.
    Start,
    /// A second has passed.
    Periodic,
    /// Samples were missed.
    Gap,
    /// The integrator found a rest, or the end of one.
    Stillness,
    /// The latched temperature has moved by a step.
    Temperature,
    /// The settings have changed.
    Settings,
    /// The parameters have changed.
    Parameters,
    /// The magnetometer has told the heading.
    Heading,
    /// A number that this version does not know.
    Other(u32),
}

impl EpochReason {
    const KNOWN: [Self; 8] = [
        Self::Start,
        Self::Periodic,
        Self::Gap,
        Self::Stillness,
        Self::Temperature,
        Self::Settings,
        Self::Parameters,
        Self::Heading,
    ];
}

impl Serialize for EpochReason {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let place = Self::KNOWN.iter().position(|known| known == self);
        serializer.serialize_u32(match (place, self) {
            (None, Self::Other(number)) => *number,
            (place, _) => place.unwrap_or(0) as u32,
        })
    }
}

impl<'de> Deserialize<'de> for EpochReason {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let number = u32::deserialize(deserializer)?;
        let known = Self::KNOWN.get(number as usize);
        Ok(known.copied().unwrap_or(Self::Other(number)))
    }
}

/// All that decides the device's corrected samples, velocities and positions from a sample on: a
/// host that runs the same crates over the raw samples from there gets them bit for bit, until the
/// next epoch or missing sample. Never shed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Epoch {
    /// Why it begins.
    pub reason: EpochReason,
    /// Counts the epochs that a device sends on its links, modulo 256: a number left out is an epoch
    /// that was lost. One that is sent to a new listener alone bears the number of the one before.
    pub number: u8,
    /// Sequence number of the first sample that it holds for.
    pub sequence: u32,
    /// When that sample is expected, device time, µs.
    pub time_us: u64,
    /// Sample period, ns.
    pub period_ns: u32,
    /// Full-scale range, ± *g*.
    pub range_g: u8,
    /// Nominal sensitivity of the sensor at that range, LSB/*g*: with id 0, all there is.
    pub sensitivity_lsb_per_g: f64,
    /// Positive full scale of the counts, LSB: at or beyond it an axis is saturated.
    pub full_scale: i16,
    /// The parameters in use: their id, 0 if uncalibrated.
    pub parameters: u32,
    /// Temperature that the corrector is compiled at, 0.01 °C; `None` without a thermometer.
    pub temperature_centi_c: Option<i16>,
    /// The integrator before that sample.
    pub state: WireState,
}

impl Epoch {
    /// The parameters in use.
    pub fn parameter_id(&self) -> ParameterId {
        ParameterId(self.parameters)
    }
}

/// What the slow sensors say. A device without one sends `None`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Environment {
    /// When, device time, µs.
    pub time_us: u64,
    /// Magnetic flux density, nT, magnetometer axes.
    pub magnetic_field_nt: Option<[i32; 3]>,
    /// Temperature, 0.01 °C.
    pub temperature_centi_c: Option<i16>,
}

/// The integrator's output after a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Navigation {
    /// The sample's sequence number.
    pub sequence: u32,
    /// Position, nm, east-north-up.
    pub position_nm: [i64; 3],
    /// Velocity, nm/s, east-north-up.
    pub velocity_nmps: [i64; 3],
    /// Time since velocity was last known to be zero, ms.
    pub since_rest_ms: u32,
    /// Where the integrator stands; while searching, the numbers mean nothing.
    pub phase: WirePhase,
    /// What is wrong with the numbers: the bits of [`wimu_integrator::Flags`].
    pub flags: u8,
    /// Standard deviation of the heading against magnetic north, mrad; `None`: uncalibrated, north
    /// is where the first rest had it or the magnetometer told last.
    pub heading_sd_mrad: Option<u16>,
}

impl Navigation {
    /// The integrator's output after sample `sequence`.
    pub fn new(sequence: u32, navigation: &wimu_integrator::Navigation) -> Self {
        Self {
            sequence,
            position_nm: navigation.position.0,
            velocity_nmps: navigation.velocity.0,
            since_rest_ms: navigation.since_rest_ms,
            phase: navigation.phase.into(),
            flags: navigation.flags.0,
            heading_sd_mrad: navigation.heading_sd_mrad,
        }
    }
}

/// The parameters in use. Sent at start and whenever they change.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ActiveParameters<P = WireParameters> {
    /// The id of the committed set, 0 without one.
    pub id: u32,
    /// The set; `None` if the device is uncalibrated.
    pub active: Option<P>,
}

/// How a device is. Counts start with the device and wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Status {
    /// Time since start, µs.
    pub uptime_us: u64,
    /// The cable; `None` on a board without one.
    pub cable: Option<LinkStatus>,
    /// The wireless link; `None` on a board without one.
    pub wireless: Option<LinkStatus>,
    /// The accelerometer.
    pub sensor: SensorStatus,
    /// Sample period as measured against the device's clock, ns; `None` until it is known.
    pub measured_period_ns: Option<u32>,
    /// Jitter of the data-ready times, ns: how far the time from one to the next is from the
    /// measured period, the mean of the latest (equation (95)); `None` until it is known.
    pub jitter_ns: Option<u32>,
}

/// How a link is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LinkStatus {
    /// Frames sent.
    pub frames_sent: u32,
    /// Bytes sent.
    pub bytes_sent: u64,
    /// Frames of telemetry and samples dropped because the link was too slow.
    pub telemetry_shed: u32,
    /// Damaged frames received.
    pub frames_damaged: u32,
    /// Requests that came again: the host had not got the answer.
    pub requests_repeated: u32,
}

/// How the accelerometer is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SensorStatus {
    /// Samples read.
    pub samples: u32,
    /// Samples that the sensor took and nobody read.
    pub missed: u32,
    /// Times that the sensor said it overwrote data.
    pub overruns: u32,
    /// Bus transfers that failed.
    pub bus_errors: u32,
}

/// How a sensor's bus failed. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BusFault {
    /// Nobody answers at the sensor's address.
    NoAnswer,
    /// The transfer failed.
    Transfer,
    /// No data came in time.
    Timeout,
}

/// Something that happened to a device. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Event {
    /// The accelerometer is gone; the device goes on trying.
    SensorLost(BusFault),
    /// The accelerometer is there again.
    SensorFound,
    /// Another chip answers at the accelerometer's address.
    WrongSensor {
        /// The identification that the driver expects.
        expected: u8,
        /// The one that it read.
        found: u8,
    },
    /// Stored parameters or settings cannot be read; defaults are used.
    StoreUnreadable,
    /// Stored parameters are not used.
    ModelRejected(ParameterFault),
    /// The stored settings do not fit the sensor; the nearest that do are used.
    SettingsAdjusted,
    /// The device is about to write its flash and hears nothing meanwhile.
    Pause {
        /// For how long at most, ms.
        longest_ms: u16,
    },
    /// The button at the device was pressed: a position is taken, the next one follows.
    Marked {
        /// How often since the device's start, this time included.
        count: u16,
    },
    /// At rest |f| is not g as the calibration promises: it no longer holds. Said at the second
    /// rest in a row.
    CalibrationContradicted {
        /// |f| − g, µm/s².
        residual_um_s2: i32,
        /// Its standard deviation if the calibration held, µm/s².
        expected_um_s2: u32,
    },
    /// Something that this version does not know; never sent. Keep it last.
    #[serde(skip)]
    Other {
        /// Its number.
        number: u32,
    },
}

impl fmt::Display for Event {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SensorLost(BusFault::NoAnswer) => out.write_str(
                "the accelerometer does not answer on its bus; check its wiring and supply; the device goes on trying",
            ),
            Self::SensorLost(BusFault::Transfer) => out.write_str(
                "transfers on the accelerometer's bus fail; check its wiring; the device goes on trying",
            ),
            Self::SensorLost(BusFault::Timeout) => out.write_str(
                "the accelerometer has no new data in time; check its wiring; the device goes on trying",
            ),
            Self::SensorFound => out.write_str("the accelerometer answers"),
            Self::WrongSensor { expected, found } => write!(
                out,
                "the chip at the accelerometer's address says it is 0x{found:02x}, expected 0x{expected:02x}; check that the firmware is for this board"
            ),
            Self::StoreUnreadable => out.write_str(
                "stored parameters or settings cannot be read, the device runs on defaults; push them again",
            ),
            Self::ModelRejected(fault) => write!(
                out,
                "the stored calibration is not used: {fault}; calibrate again"
            ),
            Self::SettingsAdjusted => out.write_str(
                "the stored settings do not fit the sensor, the nearest that do are used; see `wimu settings get`",
            ),
            Self::Marked { count } => write!(out, "the button was pressed: mark {count}"),
            Self::CalibrationContradicted {
                residual_um_s2,
                expected_um_s2,
            } => write!(
                out,
                "the calibration no longer holds: at rest |f| is off g by {:.1} mm/s², with a standard deviation of {:.1}; calibrate again",
                f64::from(*residual_um_s2) * 1e-3,
                f64::from(*expected_um_s2) * 1e-3
            ),
            Self::Other { number } => write!(
                out,
                "something happened that this version does not know (event {number}); update this end"
            ),
            Self::Pause { longest_ms } => {
                write!(out, "the device writes its flash for up to {longest_ms} ms")
            }
        }
    }
}
