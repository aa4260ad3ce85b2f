//! Messages between device and host, other than `Hello` and batches of samples.
//!
//! Bodies are `postcard`: fields in order without names; unsigned numbers above 8 bits as varints
//! (7 bits a byte, least significant first), signed ones zigzag-coded (0, −1, 1, −2, …); floating point in
//! 8 or 4 bytes, little-endian; an enum as the varint of its variant's index, then the variant's fields.
//!
//! **Compatibility.** A variant keeps its index and its fields; new variants are appended. Messages of a
//! device may gain fields at the end of the body only. A host ignores unknown fields, and decodes unknown
//! events and refusals as [`Event::Other`] and [`Refusal::Other`]. A device executes a request only if it
//! knows all of it.

use core::fmt;

#[cfg(feature = "auth")]
use hmac::digest::Update;
use postcard::ser_flavors::Flavor;
use serde::{Deserialize, Serialize};

use crate::frame::{self, EncodeError, Kind};

mod bytes;
mod epoch;
mod request;
mod settings;
mod telemetry;

pub use bytes::{SetBytes, Signature};
pub use epoch::{ARITHMETIC_REVISION, Epoch, EpochGyroscope, EpochReason};
pub(crate) use request::Head;
pub use request::{Answer, Command, Payload, Refusal, Reply, Request};
pub use settings::{Resolution, Settings, Streams};
pub use telemetry::{
    Attitude, BusFault, Environment, Event, LinkStatus, Navigation, SensorStatus, StackStatus,
    Status, Telemetry,
};

macro_rules! framed {
    ($message:ident) => {
        impl $message {
            /// Encodes it into a frame; returns the frame's length, bytes.
            ///
            /// # Errors
            /// [`EncodeError::NoRoom`] when the frame does not fit.
            pub fn encode(&self, frame: &mut [u8]) -> Result<usize, EncodeError> {
                encode(Kind::$message, self, frame)
            }
        }
    };
}

framed!(Telemetry);
framed!(Request);
framed!(Reply);

fn encode<T: Serialize>(kind: Kind, message: &T, frame: &mut [u8]) -> Result<usize, EncodeError> {
    frame::build(kind, frame, &mut |body| {
        let mut outcome = Ok(());
        let written = serialize(message, &mut |bytes| {
            outcome = body.push(bytes);
            outcome.is_ok()
        });
        outcome.and(written.map_err(|_| EncodeError::BodyTooLong))
    })
}

/// A message without additional fields.
fn decode<'a, T: Deserialize<'a>>(body: &'a [u8]) -> Result<T, MessageError> {
    match postcard::take_from_bytes(body)? {
        (message, []) => Ok(message),
        (_, rest) => Err(MessageError::TooLong { extra: rest.len() }),
    }
}

/// A message that may have additional fields at its end.
fn decode_beginning<'a, T: Deserialize<'a>>(body: &'a [u8]) -> Result<T, MessageError> {
    let (message, _) = postcard::take_from_bytes(body)?;
    Ok(message)
}

/// Updates `mac` with the wire form of `message`.
#[cfg(feature = "auth")]
pub(crate) fn feed<T: Serialize>(message: &T, mac: &mut impl Update) {
    // Neither the sink nor the serialization of numbers can fail.
    let _ = serialize(message, &mut |bytes| {
        mac.update(bytes);
        true
    });
}

/// Passes the wire form of `message` to `sink`, which returns whether it accepted the bytes. All uses share
/// this sink type, so that each message has one serializer.
fn serialize<T: Serialize>(
    message: &T,
    sink: &mut dyn FnMut(&[u8]) -> bool,
) -> postcard::Result<()> {
    postcard::serialize_with_flavor(message, Sink(sink))
}

struct Sink<'a>(&'a mut dyn FnMut(&[u8]) -> bool);

impl Flavor for Sink<'_> {
    type Output = ();

    fn try_extend(&mut self, data: &[u8]) -> postcard::Result<()> {
        if (self.0)(data) { Ok(()) } else { Err(postcard::Error::SerializeBufferFull) }
    }

    fn try_push(&mut self, data: u8) -> postcard::Result<()> {
        self.try_extend(&[data])
    }

    fn finalize(self) -> postcard::Result<()> {
        Ok(())
    }
}

/// Why a body is not a message. The frame's CRC was valid, so the sender uses another version.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MessageError {
    /// The body ends before the message does.
    TooShort,
    /// The body is longer than the message.
    TooLong {
        /// Bytes after the message.
        extra: usize,
    },
    /// A variant or value that this version does not have.
    Malformed,
}

impl From<postcard::Error> for MessageError {
    fn from(error: postcard::Error) -> Self {
        match error {
            postcard::Error::DeserializeUnexpectedEnd => Self::TooShort,
            _ => Self::Malformed,
        }
    }
}

impl fmt::Display for MessageError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("a message cannot be decoded: ")?;
        match self {
            Self::TooShort => out.write_str("it ends too early")?,
            Self::TooLong { extra } => write!(out, "{extra} bytes follow it")?,
            Self::Malformed => out.write_str("it contains an unknown value")?,
        }
        out.write_str("; update the older of firmware and wimu")
    }
}

impl core::error::Error for MessageError {}
