//! What device and host say to each other, beyond who they are and samples.
//!
//! Bodies are `postcard`: fields in order without names; unsigned numbers above 8 bits as varints
//! (7 bits a byte, lowest first), signed ones folded first (0, −1, 1, −2, …); floating point in 8
//! or 4 bytes, lowest first; an enum as the varint of its variant's place, then the variant's fields.
//!
//! **The wire only grows.** A variant keeps its place and its fields for ever; new ones come last. What a
//! device sends may gain fields at the end of the body, and nowhere else: a host that does not know
//! them leaves them, and takes events and refusals that it does not know for [`Event::Other`] and
//! [`Refusal::Other`]. A request is obeyed only by a device that knows all of it.

use core::fmt;

use hmac::digest::Update;
use postcard::ser_flavors::Flavor;
use serde::{Deserialize, Serialize};

use crate::frame::{self, EncodeError, Kind};

mod exchange;
mod fault;
mod parameters;
mod quality;
mod request;
mod settings;
mod state;
mod telemetry;

pub use fault::{ParameterFault, WireMagnetometerFault, WireQualityFault, WireTerm};
pub use parameters::{EncodedParameters, WireParameters, parameter_id};
pub use quality::{WireMagnetometer, WireMagnetometerRotation, WireMethod, WireQuality};
pub(crate) use request::Head;
pub use request::{Answer, Command, Payload, Refusal, Reply, Request, Signature};
pub use settings::{Resolution, Settings, Streams};
pub use state::{ARITHMETIC_REVISION, WirePhase, WireRun, WireSegment, WireState, WireWindow};
pub use telemetry::{
    ActiveParameters, BusFault, Environment, Epoch, EpochReason, Event, LinkStatus, Navigation,
    Record, SensorStatus, Status, Telemetry,
};

macro_rules! framed {
    ($message:ident $(<$parameters:ident>)?, $kind:ident) => {
        impl$(<$parameters: Serialize>)? $message$(<$parameters>)? {
            /// Puts it into a frame; returns the frame's length, bytes.
            ///
            /// # Errors
            /// [`EncodeError::NoRoom`] when the frame does not fit.
            pub fn encode(&self, frame: &mut [u8]) -> Result<usize, EncodeError> {
                encode(Kind::$kind, self, frame)
            }
        }
    };
}

framed!(Telemetry<P>, Telemetry);
framed!(Request, Request);
framed!(Reply<P>, Reply);

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

/// A message that is known to its end.
fn decode<'a, T: Deserialize<'a>>(body: &'a [u8]) -> Result<T, MessageError> {
    match postcard::take_from_bytes(body)? {
        (message, []) => Ok(message),
        (_, rest) => Err(MessageError::TooLong { extra: rest.len() }),
    }
}

/// A message that may have grown since.
fn decode_beginning<'a, T: Deserialize<'a>>(body: &'a [u8]) -> Result<T, MessageError> {
    let (message, _) = postcard::take_from_bytes(body)?;
    Ok(message)
}

/// Gives `message`'s wire form to `mac`.
pub(crate) fn feed<T: Serialize>(message: &T, mac: &mut impl Update) {
    // Neither the sink nor plain numbers can fail.
    let _ = serialize(message, &mut |bytes| {
        mac.update(bytes);
        true
    });
}

/// Gives `message`'s wire form to `sink`, which says whether it has taken it. One sink for all that
/// is done with messages, so that there is one serializer of each.
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
        if (self.0)(data) {
            Ok(())
        } else {
            Err(postcard::Error::SerializeBufferFull)
        }
    }

    fn try_push(&mut self, data: u8) -> postcard::Result<()> {
        self.try_extend(&[data])
    }

    fn finalize(self) -> postcard::Result<()> {
        Ok(())
    }
}

/// Why a body is no message. The frame's CRC has passed, so the sender speaks otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MessageError {
    /// The body ends before the message does.
    TooShort,
    /// The body goes on after the message.
    TooLong {
        /// For so many bytes.
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
        out.write_str("a message cannot be read: ")?;
        match self {
            Self::TooShort => out.write_str("it ends too early")?,
            Self::TooLong { extra } => write!(out, "{extra} bytes follow it")?,
            Self::Malformed => out.write_str("it has a value that is unknown here")?,
        }
        out.write_str("; update the older of firmware and wimu")
    }
}

impl core::error::Error for MessageError {}
