//! Fields of records in MCAP files. A length is checked against the bytes that are there before memory is reserved.
//! Format: <https://mcap.dev/spec>.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, Read};

/// The next `N` bytes.
pub fn number<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    let (number, rest) = bytes.split_first_chunk::<N>()?;
    *bytes = rest;
    Some(*number)
}

/// The next bytes after their length in four bytes.
pub fn sized<'a>(bytes: &mut &'a [u8]) -> Option<&'a [u8]> {
    let length = u32::from_le_bytes(number(bytes)?);
    let (block, rest) = bytes.split_at_checked(usize::try_from(length).ok()?)?;
    *bytes = rest;
    Some(block)
}

/// The next text, likewise.
pub fn text<'a>(bytes: &mut &'a [u8]) -> Option<Cow<'a, str>> {
    sized(bytes).map(String::from_utf8_lossy)
}

/// Reads at most `length` bytes into `buffer`; returns whether all were there. Memory is that of the bytes read.
pub fn fill(reader: impl Read, length: u64, buffer: &mut Vec<u8>) -> io::Result<bool> {
    buffer.clear();
    Ok(reader.take(length).read_to_end(buffer)? as u64 == length)
}

/// Reads a record of at most `most` bytes and returns its code; `None` where the file is cut off or the record is longer.
pub fn next(mut reader: impl Read, most: u64, record: &mut Vec<u8>) -> io::Result<Option<u8>> {
    fill(&mut reader, 9, record)?;
    let Some((&[code, ref length @ ..], _)) = record.split_first_chunk::<9>() else {
        return Ok(None);
    };
    let length = u64::from_le_bytes(*length);
    Ok((length <= most && fill(reader, length, record)?).then_some(code))
}

/// Hands code and bytes of a chunk's records on. Returns the number of bytes after the last one that is whole.
pub fn each(mut records: &[u8], mut see: impl FnMut(u8, &[u8])) -> usize {
    loop {
        let left = records.len();
        let Some([code]) = number(&mut records) else {
            return left;
        };
        let length = number(&mut records).map(u64::from_le_bytes);
        let length = length.and_then(|length| usize::try_from(length).ok());
        let Some((record, rest)) = length.and_then(|length| records.split_at_checked(length))
        else {
            return left;
        };
        see(code, record);
        records = rest;
    }
}

/// A chunk's own fields and its records as stored.
pub struct Chunk<'a> {
    pub size: u64,
    /// CRC-32 of the records; 0 is none.
    pub crc: u32,
    pub compression: &'a [u8],
    pub stored: &'a [u8],
    /// Whether stored records are missing.
    pub short: bool,
}

impl<'a> Chunk<'a> {
    pub fn parse(mut record: &'a [u8]) -> Option<Self> {
        // First and last log time.
        number::<16>(&mut record)?;
        let size = u64::from_le_bytes(number(&mut record)?);
        let crc = u32::from_le_bytes(number(&mut record)?);
        let compression = sized(&mut record)?;
        let length = u64::from_le_bytes(number(&mut record)?);
        let stored = usize::try_from(length).ok().and_then(|n| record.get(..n));
        Some(Self {
            size,
            crc,
            compression,
            stored: stored.unwrap_or(record),
            short: stored.is_none(),
        })
    }

    /// Whether these are its records, decompressed.
    pub fn holds(&self, records: &[u8]) -> bool {
        self.crc == 0 || self.crc == crc32fast::hash(records)
    }
}

/// A channel: a topic with its type.
pub struct Channel<'a> {
    pub id: u16,
    pub schema: u16,
    pub topic: Cow<'a, str>,
    pub encoding: &'a [u8],
}

impl<'a> Channel<'a> {
    pub fn parse(mut record: &'a [u8]) -> Option<Self> {
        Some(Self {
            id: u16::from_le_bytes(number(&mut record)?),
            schema: u16::from_le_bytes(number(&mut record)?),
            topic: text(&mut record)?,
            encoding: sized(&mut record)?,
        })
    }
}

/// A message of a channel.
pub struct Message<'a> {
    pub channel: u16,
    pub sequence: u32,
    pub log_ns: u64,
    pub data: &'a [u8],
}

impl<'a> Message<'a> {
    pub fn parse(mut record: &'a [u8]) -> Option<Self> {
        let channel = u16::from_le_bytes(number(&mut record)?);
        let sequence = u32::from_le_bytes(number(&mut record)?);
        let log_ns = u64::from_le_bytes(number(&mut record)?);
        // Time of publication.
        number::<8>(&mut record)?;
        Some(Self { channel, sequence, log_ns, data: record })
    }
}

/// A metadata record.
pub struct Metadata<'a> {
    pub name: Cow<'a, str>,
    pub values: BTreeMap<Cow<'a, str>, Cow<'a, str>>,
}

impl<'a> Metadata<'a> {
    pub fn parse(mut record: &'a [u8]) -> Option<Self> {
        let name = text(&mut record)?;
        let mut pairs = sized(&mut record)?;
        let mut values = BTreeMap::new();
        while !pairs.is_empty() {
            values.insert(text(&mut pairs)?, text(&mut pairs)?);
        }
        Some(Self { name, values })
    }
}
