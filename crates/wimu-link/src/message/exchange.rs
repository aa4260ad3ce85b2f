//! The layout of large messages. One function per message serves encoding and decoding, so that the code
//! exists once: each field is exchanged with the bytes on the wire.

use super::MessageError;
use crate::checksum::Digest;

/// One end of an exchange.
pub(super) trait Wire {
    /// Whether this end decodes.
    fn reads(&self) -> bool {
        false
    }

    /// A reader overwrites `bytes` with the next bytes; a writer appends them.
    fn exchange(&mut self, bytes: &mut [u8]) -> Result<(), MessageError>;
}

/// Bytes to decode.
pub(super) struct Reader<'a>(pub(super) &'a [u8]);

impl Wire for Reader<'_> {
    fn reads(&self) -> bool {
        true
    }

    fn exchange(&mut self, bytes: &mut [u8]) -> Result<(), MessageError> {
        let (read, rest) = self.0.split_at_checked(bytes.len()).ok_or(MessageError::TooShort)?;
        bytes.copy_from_slice(read);
        self.0 = rest;
        Ok(())
    }
}

/// A buffer to encode into, and the length written.
pub(super) struct Writer<'a>(pub(super) &'a mut [u8], pub(super) usize);

impl Wire for Writer<'_> {
    fn exchange(&mut self, bytes: &mut [u8]) -> Result<(), MessageError> {
        let end = self.1 + bytes.len();
        let room = self.0.get_mut(self.1..end).ok_or(MessageError::TooShort)?;
        room.copy_from_slice(bytes);
        self.1 = end;
        Ok(())
    }
}

impl Wire for Digest {
    fn exchange(&mut self, bytes: &mut [u8]) -> Result<(), MessageError> {
        self.update(bytes);
        Ok(())
    }
}

pub(super) fn byte(wire: &mut dyn Wire, value: &mut u8) -> Result<(), MessageError> {
    wire.exchange(core::slice::from_mut(value))
}

/// A varint.
pub(super) fn number(wire: &mut dyn Wire, value: &mut u64) -> Result<(), MessageError> {
    let mut rest = *value;
    let mut read = 0;
    for shift in (0..64).step_by(7) {
        let more = if rest > 127 { 128 } else { 0 };
        let mut part = (rest & 127) as u8 | more;
        rest >>= 7;
        byte(wire, &mut part)?;
        let bits = u64::from(part & 127);
        read |= bits << shift;
        if part < 128 {
            if read >> shift != bits {
                break;
            }
            *value = read;
            return Ok(());
        }
    }
    Err(MessageError::Malformed)
}

pub(super) fn number_32(wire: &mut dyn Wire, value: &mut u32) -> Result<(), MessageError> {
    let mut wide = u64::from(*value);
    number(wire, &mut wide)?;
    *value = u32::try_from(wide).map_err(|_| MessageError::Malformed)?;
    Ok(())
}

pub(super) fn doubles(wire: &mut dyn Wire, values: &mut [f64]) -> Result<(), MessageError> {
    for value in values {
        let mut bytes = value.to_le_bytes();
        wire.exchange(&mut bytes)?;
        *value = f64::from_le_bytes(bytes);
    }
    Ok(())
}

pub(super) fn floats(wire: &mut dyn Wire, values: &mut [f32]) -> Result<(), MessageError> {
    for value in values {
        let mut bytes = value.to_le_bytes();
        wire.exchange(&mut bytes)?;
        *value = f32::from_le_bytes(bytes);
    }
    Ok(())
}

pub(super) fn float(wire: &mut dyn Wire, value: &mut f32) -> Result<(), MessageError> {
    floats(wire, core::slice::from_mut(value))
}

/// A flag, and the value if it is set. A reader decodes into `blank`.
pub(super) fn option<T>(
    wire: &mut dyn Wire,
    value: &mut Option<T>,
    blank: T,
    content: fn(&mut dyn Wire, &mut T) -> Result<(), MessageError>,
) -> Result<(), MessageError> {
    let mut flag = u8::from(value.is_some());
    byte(wire, &mut flag)?;
    match flag {
        0 => *value = None,
        1 => return content(wire, value.get_or_insert(blank)),
        _ => return Err(MessageError::Malformed),
    }
    Ok(())
}

/// The first byte of fields that a message may end before; returns whether they follow. A writer writes
/// them if `present`.
pub(super) fn begins(
    wire: &mut dyn Wire,
    present: bool,
    first: &mut u8,
) -> Result<bool, MessageError> {
    if !present && !wire.reads() {
        return Ok(false);
    }
    match byte(wire, first) {
        Err(MessageError::TooShort) if wire.reads() => Ok(false),
        outcome => outcome.map(|()| true),
    }
}
