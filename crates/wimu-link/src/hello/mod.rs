//! The identity of a device: the one message that every host can read from every firmware.
//!
//! `Hello` and `WhoAreYou` are laid out by hand at fixed offsets. All numbers are little-endian. A
//! length field gives the end of the fixed part. Later versions may add fields before that end and
//! extensions after it, and change nothing else. A reader decodes the fields it knows, skips the rest, and
//! keeps unknown numbers.
//!
//! | offset | size | field of `Hello` (frame kind 1) |
//! |---|---|---|
//! | 0 | 4 | `WIMU` in ASCII |
//! | 4 | 1 | length of the fixed part, bytes, from offset 0: 80 or more |
//! | 5 | 1 | wire version of the device |
//! | 6 | 1 | role of this link: [`LinkRole`] |
//! | 7 | 1 | write access on this link: [`WriteAccess`] |
//! | 8 | 8 | device id |
//! | 16 | 4 | boot count |
//! | 20 | 4 | capabilities: [`Capabilities`] |
//! | 24 | 4 | id of the parameters in use, 0 if uncalibrated |
//! | 28 | 8 | uptime, µs |
//! | 36 | 2, 2, 2 | firmware version: major, minor, patch |
//! | 42 | 1 | why the device last started: [`ResetReason`] |
//! | 43 | 1 | flags: bit 0, the sensor's nominal sensitivity is known; bit 1, safe mode; the others 0 |
//! | 44 | 2 | board, a number of [`board`] |
//! | 46 | 2 | sensor, a number of [`sensor`] |
//! | 48 | 1, 15 | length of the board's name, the name in ASCII |
//! | 64 | 1, 15 | length of the sensor's name, the name in ASCII |
//! | 80 | – | (at the length of the fixed part) extensions: number (1), length (1), content |
//!
//! | extension | size | content |
//! |---|---|---|
//! | 1 | 4, 0–15 | where the firmware stopped before this start, [`Fault`]: address, kind in ASCII |
//!
//! | offset | size | field of `WhoAreYou` (frame kind 2) |
//! |---|---|---|
//! | 0 | 4 | `WIMU` in ASCII |
//! | 4 | 1 | length of the fixed part, bytes, from offset 0: 6 or more |
//! | 5 | 1 | wire version of the host |

use core::fmt;

use wimu_model::ParameterId;

use crate::frame::{self, EncodeError, Kind, WIRE_VERSION};

mod ids;

use ids::NAME_LENGTH;
pub use ids::{Capabilities, Fault, LinkRole, Name, Part, ResetReason, WriteAccess, board, sensor};

const MAGIC: [u8; 4] = *b"WIMU";
const HELLO_LENGTH: usize = 80;
const WHO_LENGTH: usize = 6;
const SENSITIVITY_KNOWN: u8 = 1;
const SAFE_MODE: u8 = 1 << 1;
const FAULT: u8 = 1;

/// Identity, capabilities and state of a device. Sent at start and on request.
///
/// ```
/// use wimu_link::hello::{Capabilities, Hello, LinkRole, Part, board, sensor};
/// use wimu_link::{Deframer, MAX_FRAME};
///
/// let hello = Hello {
///     device_id: 0x1234,
///     board: Part::new(board::MICROBIT_V2, "micro:bit v2"),
///     sensor: Part::new(sensor::LSM303AGR, "LSM303AGR"),
///     capabilities: Capabilities::ACCELEROMETER.with(Capabilities::TEMPERATURE),
///     ..Hello::new(LinkRole::Cable)
/// };
/// let mut line = [0; MAX_FRAME];
/// let length = hello.encode(&mut line)?;
///
/// let mut deframer = Deframer::new();
/// for byte in &line[..length] {
///     let Some(frame) = deframer.push(*byte) else { continue };
///     assert_eq!(Hello::decode(frame?.body)?, hello);
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Hello {
    /// Wire version of the device.
    pub wire_version: u8,
    /// Role of this link.
    pub role: LinkRole,
    /// Who may write on this link.
    pub access: WriteAccess,
    /// Identifies the device; usually the chip's serial number.
    pub device_id: u64,
    /// Number of starts.
    pub boot_count: u32,
    /// Its capabilities.
    pub capabilities: Capabilities,
    /// The parameters in use.
    pub parameter_id: ParameterId,
    /// Time since its start, µs.
    pub uptime_us: u64,
    /// Its firmware: major, minor, patch.
    pub firmware: [u16; 3],
    /// Why it last started.
    pub reset_reason: ResetReason,
    /// Where its firmware stopped before that start, if the device has recorded it.
    pub fault: Option<Fault>,
    /// Whether the sensor's nominal sensitivity is known; false for a replayed recording.
    pub sensitivity_known: bool,
    /// Safe mode: its last starts have failed, and it uses neither stored parameters nor stored settings.
    pub safe_mode: bool,
    /// Its board.
    pub board: Part,
    /// Its accelerometer.
    pub sensor: Part,
}

impl Hello {
    /// A device of which only the role of this link is known; writes are locked.
    pub const fn new(role: LinkRole) -> Self {
        Self {
            wire_version: WIRE_VERSION,
            role,
            access: WriteAccess::Locked,
            device_id: 0,
            boot_count: 0,
            capabilities: Capabilities(0),
            parameter_id: ParameterId::UNCALIBRATED,
            uptime_us: 0,
            firmware: [0; 3],
            reset_reason: ResetReason::Unknown,
            fault: None,
            sensitivity_known: false,
            safe_mode: false,
            board: Part::new(0, ""),
            sensor: Part::new(0, ""),
        }
    }

    /// Encodes it into a frame; returns the frame's length, bytes.
    ///
    /// # Errors
    /// [`EncodeError::NoRoom`] when the frame does not fit.
    pub fn encode(&self, frame: &mut [u8]) -> Result<usize, EncodeError> {
        let [major, minor, patch] = self.firmware.map(u16::to_le_bytes);
        let flag = |on, flag| if on { flag } else { 0 };
        let flags =
            flag(self.sensitivity_known, SENSITIVITY_KNOWN) | flag(self.safe_mode, SAFE_MODE);
        // The pieces have the sizes of the table above.
        frame::build(Kind::Hello, frame, &mut |body| {
            body.push(&MAGIC)?;
            body.push(&[
                HELLO_LENGTH as u8,
                self.wire_version,
                self.role.number(),
                self.access.number(),
            ])?;
            body.push(&self.device_id.to_le_bytes())?;
            body.push(&self.boot_count.to_le_bytes())?;
            body.push(&self.capabilities.0.to_le_bytes())?;
            body.push(&self.parameter_id.0.to_le_bytes())?;
            body.push(&self.uptime_us.to_le_bytes())?;
            for number in [major, minor, patch] {
                body.push(&number)?;
            }
            body.push(&[self.reset_reason.number(), flags])?;
            body.push(&self.board.number.to_le_bytes())?;
            body.push(&self.sensor.number.to_le_bytes())?;
            for part in [&self.board, &self.sensor] {
                body.push(&[part.name.length])?;
                body.push(&part.name.bytes)?;
            }
            if let Some(Fault { address, kind }) = &self.fault {
                let kind = kind.as_bytes();
                body.push(&[FAULT, 4 + kind.len() as u8])?;
                body.push(&address.to_le_bytes())?;
                body.push(kind)?;
            }
            Ok(())
        })
    }

    /// Reads the body of a frame of kind [`Kind::Hello`], of this wire version or any other.
    ///
    /// # Errors
    /// [`HelloError`] when it is not a `Hello` or too short.
    pub fn decode(body: &[u8]) -> Result<Self, HelloError> {
        let fixed = fixed_part(body, HELLO_LENGTH)?;
        let mut fields = Fields(fixed);
        fields.take::<5>()?;
        let [wire_version, role, access] = fields.take()?;
        let device_id = u64::from_le_bytes(fields.take()?);
        let boot_count = u32::from_le_bytes(fields.take()?);
        let capabilities = Capabilities(u32::from_le_bytes(fields.take()?));
        let parameter_id = ParameterId(u32::from_le_bytes(fields.take()?));
        let uptime_us = u64::from_le_bytes(fields.take()?);
        let mut firmware = [0; 3];
        for number in &mut firmware {
            *number = u16::from_le_bytes(fields.take()?);
        }
        let [reset_reason, flags] = fields.take()?;
        let numbers = [u16::from_le_bytes(fields.take()?), u16::from_le_bytes(fields.take()?)];
        let mut parts = [Part::default(); 2];
        for (part, number) in parts.iter_mut().zip(numbers) {
            let [length] = fields.take()?;
            let name = fields.take::<NAME_LENGTH>()?;
            *part = Part {
                number,
                name: Name::from_bytes(name.get(..usize::from(length)).unwrap_or(&name)),
            };
        }
        let [board, sensor] = parts;
        Ok(Self {
            wire_version,
            role: LinkRole::from_number(role),
            access: WriteAccess::from_number(access),
            device_id,
            boot_count,
            capabilities,
            parameter_id,
            uptime_us,
            firmware,
            reset_reason: ResetReason::from_number(reset_reason),
            fault: extensions(body).find_map(|(number, content)| {
                let (address, kind) = content.split_first_chunk()?;
                (number == FAULT).then(|| Fault {
                    address: u32::from_le_bytes(*address),
                    kind: Name::from_bytes(kind),
                })
            }),
            sensitivity_known: flags & SENSITIVITY_KNOWN != 0,
            safe_mode: flags & SAFE_MODE != 0,
            board,
            sensor,
        })
    }
}

/// Number and content of the extensions of a [`Hello`]'s body, including unknown ones, up to the first
/// truncated one.
pub fn extensions(body: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    let fixed = fixed_part(body, HELLO_LENGTH).map_or(body.len(), <[u8]>::len);
    let mut rest = body.get(fixed..).unwrap_or_default();
    core::iter::from_fn(move || {
        let (&[number, length], tail) = rest.split_first_chunk()?;
        let (content, tail) = tail.split_at_checked(usize::from(length))?;
        rest = tail;
        Some((number, content))
    })
}

/// A host asks a device for its [`Hello`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WhoAreYou {
    /// Wire version of the host.
    pub wire_version: u8,
}

impl WhoAreYou {
    /// Encodes it into a frame; returns the frame's length, bytes.
    ///
    /// # Errors
    /// [`EncodeError::NoRoom`] when the frame does not fit.
    pub fn encode(&self, frame: &mut [u8]) -> Result<usize, EncodeError> {
        frame::build(Kind::WhoAreYou, frame, &mut |body| {
            body.push(&MAGIC)?;
            body.push(&[WHO_LENGTH as u8, self.wire_version])
        })
    }

    /// Reads the body of a frame of kind [`Kind::WhoAreYou`], of this wire version or any other.
    ///
    /// # Errors
    /// [`HelloError`] when it is not a `WhoAreYou` or too short.
    pub fn decode(body: &[u8]) -> Result<Self, HelloError> {
        let mut fields = Fields(fixed_part(body, WHO_LENGTH)?);
        fields.take::<5>()?;
        let [wire_version] = fields.take()?;
        Ok(Self { wire_version })
    }
}

impl Default for WhoAreYou {
    /// A host with this crate's wire version.
    fn default() -> Self {
        Self { wire_version: WIRE_VERSION }
    }
}

/// The fixed part of `body`, if it begins with `WIMU` and has at least `least` bytes.
fn fixed_part(body: &[u8], least: usize) -> Result<&[u8], HelloError> {
    let rest = body.strip_prefix(&MAGIC).ok_or(HelloError::NotWimu)?;
    let length = usize::from(*rest.first().ok_or(HelloError::TooShort)?);
    if length < least {
        return Err(HelloError::TooShort);
    }
    body.get(..length).ok_or(HelloError::TooShort)
}

/// Reads fields in sequence.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], HelloError> {
        let (field, rest) = self.0.split_first_chunk::<N>().ok_or(HelloError::TooShort)?;
        self.0 = rest;
        Ok(*field)
    }
}

/// Why a body is not a [`Hello`] or [`WhoAreYou`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HelloError {
    /// It does not begin with `WIMU`.
    NotWimu,
    /// It is shorter than the fields of every version.
    TooShort,
}

impl fmt::Display for HelloError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::NotWimu => {
                "the other end is not a wimu device: its Hello does not begin with WIMU; check the port"
            }
            Self::TooShort => {
                "the other end's Hello is truncated; update that end"
            }
        })
    }
}

impl core::error::Error for HelloError {}

#[cfg(test)]
mod tests;
