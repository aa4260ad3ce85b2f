//! Requests of a host, and their answers.

use core::fmt;

use serde::{Deserialize, Serialize};

use super::MessageError;
use super::bytes::{SetBytes, Signature};
use super::settings::Settings;
use super::telemetry::Status;
use crate::auth::{DeviceKey, KeyId, Nonce};
use wimu_model::SetError;

/// A request of a host. [`Requester`](crate::Requester) makes requests and
/// [`Responder`](crate::Responder) processes them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Request {
    /// Unsigned: a random number of the host. Signed: the session's number, assigned by the device.
    pub session: u32,
    /// Incremented with each request of a session; unchanged when a request is repeated.
    pub id: u32,
    /// Authenticates the request ([`auth`](crate::auth)).
    pub signature: Signature,
    /// The command.
    pub command: Command,
}

impl Request {
    /// Reads the body of a frame of kind [`Kind::Request`](crate::Kind::Request).
    ///
    /// # Errors
    /// [`MessageError`] when it is not exactly one known request.
    pub fn decode(body: &[u8]) -> Result<Self, MessageError> {
        super::decode(body)
    }
}

impl Command {
    /// Decodes the part of a request after its head.
    pub(crate) fn decode(bytes: &[u8]) -> Result<Self, MessageError> {
        super::decode(bytes)
    }
}

/// The fields before the command of a [`Request`], and before the answer of a [`Reply`].
#[derive(Serialize, Deserialize)]
pub(crate) struct Head {
    pub(crate) session: u32,
    pub(crate) id: u32,
    pub(crate) signature: Signature,
}

impl Head {
    /// The head of a body, and the rest: a command or an answer, which may be unknown.
    pub(crate) fn split(body: &[u8]) -> Result<(Self, &[u8]), MessageError> {
        postcard::take_from_bytes(body).map_err(MessageError::from)
    }
}

/// A command, and the payload that it returns. Commands set absolute values, so that repeating one has no
/// further effect. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(clippy::large_enum_variant, reason = "there is no heap to box on")]
pub enum Command {
    /// The parameters in use: [`Payload::Parameters`].
    GetParameters,
    /// Store these parameters, and use them: [`Payload::None`].
    SetParameters(SetBytes),
    /// Forget parameters and settings: [`Payload::None`].
    FactoryReset,
    /// The settings in use: [`Payload::Settings`].
    GetSettings,
    /// Store these settings and use them: [`Payload::Settings`].
    SetSettings(Settings),
    /// The device's status: [`Payload::Status`].
    GetStatus,
    /// Run the wireless link's serial line at another rate from the next start on: [`Payload::None`].
    SetLineRate {
        /// The rate, bit/s.
        baud: u32,
    },
    /// Begin a session with signed requests: [`Payload::Session`]. Not signed.
    OpenSession,
    /// The id of the device's key: [`Payload::KeyStatus`].
    GetKeyStatus,
    /// Replace the key, on the cable only: [`Payload::KeyStatus`].
    SetKey(DeviceKey),
    /// Forget the key, on the cable only: [`Payload::KeyStatus`].
    ForgetKey,
    /// The time on the device's clock: [`Payload::Time`].
    GetTime,
}

impl Command {
    /// Whether it changes the device's state.
    pub fn is_write(&self) -> bool {
        match self {
            Self::GetParameters
            | Self::GetSettings
            | Self::GetStatus
            | Self::OpenSession
            | Self::GetKeyStatus
            | Self::GetTime => false,
            Self::SetParameters(_)
            | Self::FactoryReset
            | Self::SetSettings(_)
            | Self::SetLineRate { .. }
            | Self::SetKey(_)
            | Self::ForgetKey => true,
        }
    }

    pub(crate) fn is_key_change(&self) -> bool {
        matches!(self, Self::SetKey(_) | Self::ForgetKey)
    }
}

/// A device's answer to a request.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Reply {
    /// The request's.
    pub session: u32,
    /// The request's.
    pub id: u32,
    /// Authenticates the reply, if the request was signed with the right key.
    pub signature: Signature,
    /// The answer.
    pub answer: Answer,
}

impl Reply {
    /// Reads the body of a frame of kind [`Kind::Reply`](crate::Kind::Reply). Additional fields at
    /// the end are ignored; an unknown refusal is [`Refusal::Other`].
    ///
    /// # Errors
    /// [`MessageError`] when it is not a known reply.
    pub fn decode(body: &[u8]) -> Result<Self, MessageError> {
        let (head, answer) = Head::split(body)?;
        Ok(Self {
            session: head.session,
            id: head.id,
            signature: head.signature,
            answer: Answer::decode(answer)?,
        })
    }
}

impl Answer {
    /// Decodes the part of a reply after its head.
    pub(crate) fn decode(bytes: &[u8]) -> Result<Self, MessageError> {
        const REFUSED: u32 = 1;
        super::decode_beginning(bytes).or_else(|error| {
            match (error, super::decode_beginning::<(u32, u32)>(bytes)) {
                (MessageError::Malformed, Ok((REFUSED, number))) => {
                    Ok(Self::Refused(Refusal::Other { number }))
                }
                _ => Err(error),
            }
        })
    }
}

/// The result of a request. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(clippy::large_enum_variant, reason = "there is no heap to box on")]
pub enum Answer {
    /// It was executed.
    Accepted(Payload),
    /// It was not executed.
    Refused(Refusal),
    /// The device does not know this command.
    Unknown,
}

/// The payload of an accepted request. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(clippy::large_enum_variant, reason = "there is no heap to box on")]
pub enum Payload {
    /// Nothing.
    None,
    /// The parameters in use.
    Parameters(SetBytes),
    /// The settings in use.
    Settings(Settings),
    /// The device's status.
    Status(Status),
    /// A session for signed requests.
    Session {
        /// Its number, the session of signed requests.
        number: u32,
        /// The nonce for their signatures.
        nonce: Nonce,
    },
    /// The device's key.
    KeyStatus {
        /// Its id; `None` if the device has no key.
        key: Option<KeyId>,
    },
    /// The device's clock when it executed the request.
    Time {
        /// µs since the device's start.
        uptime_us: u64,
    },
}

/// Why a request was refused. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refusal {
    /// Writes on this link need a key, and the device has none.
    KeyNeeded,
    /// Writes on this link are locked: the device cannot read its key or boot count.
    Locked,
    /// The parameters are not a set for this device.
    InvalidParameters(SetError),
    /// The parameters are for another full-scale range than the device's.
    WrongRange {
        /// That of the parameters, ± *g*.
        parameters_g: u8,
        /// The device's, ± *g*.
        device_g: u8,
    },
    /// The device does not support these settings.
    UnsupportedSettings {
        /// The nearest supported settings.
        nearest: Settings,
    },
    /// The store could not be written; the device is unchanged.
    StoreFailed,
    /// The sensor does not answer.
    SensorFailed,
    /// The request is older than an answered one, or its id was used for another request.
    Stale,
    /// The device's wireless link has no serial line whose rate can be set.
    FixedLineRate,
    /// The line does not support this rate.
    UnsupportedLineRate {
        /// The nearest supported rate, bit/s.
        nearest: u32,
    },
    /// The device has a key, and the request is not signed.
    SignatureNeeded,
    /// The signature does not match the device's key.
    WrongSignature,
    /// The session has ended: the device has restarted, or newer sessions have replaced it.
    SessionEnded,
    /// Keys are set and forgotten over the cable only.
    CableOnly,
    /// The device's firmware was built without this function ([`Capabilities`](crate::hello::Capabilities)).
    NotSupported,
    /// A reason that is unknown to this version; never sent. Keep it last.
    #[serde(skip)]
    Other {
        /// Its number.
        number: u32,
    },
}

impl fmt::Display for Refusal {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::KeyNeeded => out.write_str(
                "writing on this link takes a key, and the device has none; run `wimu device key set` once over the cable",
            ),
            Self::Locked => out.write_str(
                "writes are locked: the device cannot read its key or boot count; run `wimu device key rotate` over the cable; if refused, see docs/reference/security.md (lost key)",
            ),
            Self::InvalidParameters(fault) => fault.fmt(out),
            Self::WrongRange {
                parameters_g,
                device_g,
            } => write!(
                out,
                "the parameters are for ±{parameters_g} g, the device is set to ±{device_g} g; set its range or calibrate at this one"
            ),
            Self::UnsupportedSettings { nearest } => write!(
                out,
                "the device does not support these settings; nearest: ±{} g at {} Hz, {} resolution, batch cable {} / wireless {}, every {} / {}, gravity {} m/s²",
                nearest.range_g,
                nearest.rate_hz,
                nearest.resolution,
                nearest.cable.batch,
                nearest.wireless.batch,
                nearest.cable.every,
                nearest.wireless.every,
                f64::from(nearest.gravity_um_s2) / 1e6
            ),
            Self::StoreFailed => out.write_str(
                "the device could not write its store and is unchanged; try again, then replace the device",
            ),
            Self::SensorFailed => {
                out.write_str("the accelerometer does not answer; check its wiring")
            }
            Self::Stale => out.write_str(
                "the request is older than one already answered; ask again in a new session",
            ),
            Self::SignatureNeeded => out.write_str(
                "the device accepts only requests signed with its key; use the computer that has the key, or erase the key at the board",
            ),
            Self::WrongSignature => out.write_str(
                "this is not the device's key; use the computer that has the key, or erase the key at the board",
            ),
            Self::SessionEnded => {
                out.write_str("the session has ended because the device restarted or other sessions replaced it; try again")
            }
            Self::CableOnly => {
                out.write_str("keys are changed over the cable only; connect the cable")
            }
            Self::NotSupported => out.write_str(
                "the device's firmware was built without this function; flash a firmware that has it",
            ),
            Self::Other { number } => write!(
                out,
                "the device refuses for a reason unknown to this version (refusal {number}); update this end"
            ),
            Self::FixedLineRate => out.write_str(
                "the rate of the device's wireless link cannot be set; use its present rate",
            ),
            Self::UnsupportedLineRate { nearest } => {
                write!(out, "the line does not support this rate; the nearest is {nearest} baud")
            }
        }
    }
}

impl core::error::Error for Refusal {}
