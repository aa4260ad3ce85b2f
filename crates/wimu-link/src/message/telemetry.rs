//! Messages that a device sends without a request.

use core::fmt;

use serde::{Deserialize, Serialize};

use super::MessageError;
use super::bytes::SetBytes;
use super::epoch::Epoch;
use super::settings::Settings;
#[cfg(feature = "auth")]
use crate::tag::Tag;
use wimu_integrator::Phase;
use wimu_model::SetError;

/// Messages that a device sends without a request, other than samples. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(clippy::large_enum_variant, reason = "there is no heap to box on")]
pub enum Telemetry {
    /// A start point for replaying samples.
    Epoch(Epoch),
    /// Magnetic field and temperature, at their own rate.
    Environment(Environment),
    /// Velocity and position.
    Navigation(Navigation),
    /// The parameters in use. Sent at the start and whenever they change.
    Parameters(SetBytes),
    /// The settings in use.
    Settings(Settings),
    /// The device's status.
    Status(Status),
    /// An event.
    Event {
        /// Device time, µs.
        time_us: u64,
        /// The event.
        event: Event,
    },
    /// The attitude, with [`Navigation`] where there is a gyroscope.
    Attitude(Attitude),
    /// The authentication of the frames before it. Sent by devices with a key.
    #[cfg(feature = "auth")]
    Tag(Tag),
}

impl Telemetry {
    /// Reads the body of a frame of kind [`Kind::Telemetry`](crate::Kind::Telemetry). Additional
    /// fields at the end are ignored; an unknown event is [`Event::Other`].
    ///
    /// # Errors
    /// [`MessageError`] when it is not a known message.
    pub fn decode(body: &[u8]) -> Result<Self, MessageError> {
        super::decode_beginning(body).or_else(|error| match *body {
            [0, ref epoch @ ..] => {
                Epoch::of_another_revision(epoch).map(Self::Epoch).map_err(|_| error)
            }
            [6, ref event @ ..] if error == MessageError::Malformed => {
                let (time_us, number) = super::decode_beginning(event).map_err(|_| error)?;
                Ok(Self::Event { time_us, event: Event::Other { number } })
            }
            _ => Err(error),
        })
    }
}

/// Magnetic field and temperature; `None` without the sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Environment {
    /// Device time, µs.
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
    /// Phase of the integrator; while searching, position and velocity are undefined.
    pub phase: Phase,
    /// The bits of [`wimu_integrator::Flags`].
    pub flags: u8,
    /// Standard deviation of the heading against magnetic north, mrad; `None`:
    /// uncalibrated, north is that of the first rest or of the latest magnetometer heading.
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
            phase: navigation.phase,
            flags: navigation.flags.0,
            heading_sd_mrad: navigation.heading_sd_mrad,
        }
    }
}

/// The attitude after a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Attitude {
    /// The sample's sequence number.
    pub sequence: u32,
    /// Rotation from body to navigation axes (east-north-up): unit quaternion W, X, Y, Z, 2⁻³⁰.
    pub quaternion: [i32; 4],
}

impl Attitude {
    /// The unit quaternion W, X, Y, Z.
    pub fn to_quaternion(&self) -> [f64; 4] {
        self.quaternion.map(|part| f64::from(part) / (1 << 30) as f64)
    }
}

/// Status of a device. Counts begin at its start and wrap.
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
    /// Jitter of the data-ready times, ns: running mean of the deviation of their intervals from the measured
    /// period (equation (95)); `None` until it is known.
    pub jitter_ns: Option<u32>,
    /// The stack; `None` on a board that does not measure it.
    pub stack: Option<StackStatus>,
}

/// Use of a device's stack, bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct StackStatus {
    /// Size.
    pub size: u32,
    /// The most that has been in use since the start.
    pub used: u32,
}

/// Status of a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LinkStatus {
    /// Frames sent.
    pub frames_sent: u32,
    /// Bytes sent.
    pub bytes_sent: u64,
    /// Frames dropped because the link was too slow; after a stall, kept frames too.
    pub telemetry_shed: u32,
    /// Damaged frames received.
    pub frames_damaged: u32,
    /// Repeated requests: the host had not received the answer.
    pub requests_repeated: u32,
}

/// Status of the accelerometer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SensorStatus {
    /// Samples read.
    pub samples: u32,
    /// Samples lost before they were read.
    pub missed: u32,
    /// Overruns reported by the sensor.
    pub overruns: u32,
    /// Bus transfers that failed.
    pub bus_errors: u32,
}

/// Fault of a sensor's bus. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BusFault {
    /// No acknowledgement at the sensor's address.
    NoAnswer,
    /// The transfer failed.
    Transfer,
    /// No data in time.
    Timeout,
}

/// An event on a device. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Event {
    /// The accelerometer has failed; the device keeps trying to restart it.
    SensorLost(BusFault),
    /// The accelerometer works again.
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
    ParametersRejected(SetError),
    /// The sensor does not support the stored settings; the nearest ones are used.
    SettingsAdjusted,
    /// The device is about to write its flash and receives nothing meanwhile.
    Pause {
        /// Longest duration, ms.
        longest_ms: u16,
    },
    /// The button at the device was pressed, to mark a position.
    Marked {
        /// Number of presses since the device's start.
        count: u16,
    },
    /// |f| at rest contradicts the calibration, which no longer holds. Reported at the second consecutive
    /// such rest.
    CalibrationContradicted {
        /// |f| − g, µm/s².
        residual_um_s2: i32,
        /// Standard deviation of that residual under the calibration, µm/s².
        expected_um_s2: u32,
    },
    /// The gyroscope has failed; the device keeps trying to restart the sensor. [`SensorFound`](Self::SensorFound)
    /// reports that it works again.
    GyroscopeLost(BusFault),
    /// An event that is unknown to this version; never sent. Keep it last.
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
                "the accelerometer does not answer on its bus; check its wiring and supply; the device keeps trying",
            ),
            Self::SensorLost(BusFault::Transfer) => out.write_str(
                "transfers on the accelerometer's bus fail; check its wiring; the device keeps trying",
            ),
            Self::SensorLost(BusFault::Timeout) => out.write_str(
                "the accelerometer has no new data in time; check its wiring; the device keeps trying",
            ),
            Self::GyroscopeLost(BusFault::NoAnswer | BusFault::Transfer) => out.write_str(
                "the gyroscope cannot be read; check its wiring; the device keeps trying",
            ),
            Self::GyroscopeLost(BusFault::Timeout) => out.write_str(
                "the gyroscope has no new data in time; the device keeps trying",
            ),
            Self::SensorFound => out.write_str("the accelerometer answers"),
            Self::WrongSensor { expected, found } => write!(
                out,
                "the chip at the accelerometer's address identifies itself as 0x{found:02x}, expected 0x{expected:02x}; check that the firmware is for this board"
            ),
            Self::StoreUnreadable => out.write_str(
                "stored parameters or settings cannot be read, the device runs on defaults; push them again",
            ),
            Self::ParametersRejected(fault) => {
                write!(out, "the stored calibration is not used: {fault}; push it again")
            }
            Self::SettingsAdjusted => out.write_str(
                "the sensor does not support the stored settings and uses the nearest ones; see `wimu device settings get`",
            ),
            Self::Marked { count } => write!(out, "the button was pressed: mark {count}"),
            Self::CalibrationContradicted {
                residual_um_s2,
                expected_um_s2,
            } => write!(
                out,
                "the calibration no longer holds: at rest |f| − g is {:.1} mm/s², expected standard deviation {:.1} mm/s²; calibrate again",
                f64::from(*residual_um_s2) * 1e-3,
                f64::from(*expected_um_s2) * 1e-3
            ),
            Self::Other { number } => write!(
                out,
                "an event unknown to this version occurred (event {number}); update this end"
            ),
            Self::Pause { longest_ms } => {
                write!(out, "the device writes its flash for up to {longest_ms} ms")
            }
        }
    }
}
