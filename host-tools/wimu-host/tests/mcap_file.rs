//! Recordings on a disk that fills up, cut, damaged, and as other programs read them.

use std::collections::BTreeMap;
use std::io::{self, Cursor, Seek, Write};
use std::time::Duration;

use wimu_host::mcap_file::{
    ClockAnchor, Received, Recorded, RecordingReader, RecordingWriter, Wholeness,
};
use wimu_host::{Code, Result};
use wimu_link::LinkRole;

const ANCHOR: ClockAnchor = ClockAnchor { monotonic_ns: 5_000, utc_ns: 1_795_222_920_123_456_789 };

fn entry(index: u64) -> Received {
    Received {
        role: [LinkRole::Cable, LinkRole::Wireless][usize::from(index.is_multiple_of(3))],
        host_ns: 7_000 + index * 100_000_000,
        bytes: (0..index % 50).map(|b| b as u8).collect(),
    }
}

/// A recording of `count` entries at 10 Hz; closed or left as it is after the last flush.
fn record(count: u64, close: bool) -> Vec<u8> {
    let mut bytes = Vec::new();
    let sink = Cursor::new(&mut bytes);
    let mut writer = RecordingWriter::new(sink, "a.mcap", ANCHOR).unwrap();
    for index in 0..count {
        let entry = entry(index);
        writer.append(entry.role, entry.host_ns, &entry.bytes).unwrap();
    }
    if close {
        writer.finish().unwrap();
    } else {
        writer.flush().unwrap();
        // As a killed program leaves it.
        std::mem::forget(writer);
    }
    bytes
}

fn read(bytes: &[u8]) -> Result<(Vec<Received>, Wholeness)> {
    let mut reader = RecordingReader::new(bytes, "a.mcap")?;
    let mut received = Vec::new();
    while let Some(entry) = reader.next_received()? {
        received.push(entry);
    }
    Ok((received, reader.wholeness()))
}

#[test]
fn what_is_recorded_reads_back_the_same() {
    let bytes = record(95, true);
    let mut reader = RecordingReader::new(&bytes[..], "a.mcap").unwrap();
    assert_eq!(reader.anchor().unwrap(), Some(ANCHOR));
    let received: Vec<_> = reader.by_ref().map(Result::unwrap).collect();
    assert_eq!(received, (0..95).map(entry).collect::<Vec<_>>());
    assert_eq!(reader.wholeness(), Wholeness::default());
    assert_eq!(ANCHOR.to_utc_ns(5_001), 1_795_222_920_123_456_790);
}

#[test]
fn other_readers_find_every_message_by_the_index_and_without_it() {
    // More chunks than are indexed at a time, with times that do not rise.
    let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), "a.mcap", ANCHOR).unwrap();
    let mut times = Vec::new();
    for index in 0..1500_u64 {
        let host_ns = 7_000 + (index ^ 3) * 400_000_000;
        writer.append(LinkRole::Cable, host_ns, &[7; 30]).unwrap();
        times.push(ANCHOR.to_utc_ns(host_ns));
        if index % 3 == 0 {
            writer.flush().unwrap();
        }
    }
    let bytes = writer.finish().unwrap().into_inner();
    let linear: Vec<_> = (mcap::MessageStream::new(&bytes).unwrap())
        .map(|message| message.unwrap().log_time)
        .collect();
    assert_eq!(linear, times);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let statistics = summary.stats.as_ref().unwrap();
    assert_eq!(statistics.message_count, 1500);
    assert_eq!(statistics.chunk_count as usize, summary.chunk_indexes.len());
    assert_eq!(summary.metadata_indexes.len(), 1);
    let (mut found, mut messages) = (0, 0);
    for chunk in &summary.chunk_indexes {
        found += summary.stream_chunk(&bytes, chunk).unwrap().count();
        // That of schemas and channels.
        if chunk.message_index_offsets.is_empty() {
            continue;
        }
        let by_channel = summary.read_message_indexes(&bytes, chunk).unwrap();
        for (channel, entries) in by_channel {
            messages += entries.len();
            for entry in entries {
                let message = summary.seek_message(&bytes, chunk, &entry).unwrap();
                assert_eq!(message.log_time, entry.log_time);
                assert_eq!(message.channel.id, channel.id);
                let within = chunk.message_start_time..=chunk.message_end_time;
                assert!(within.contains(&entry.log_time));
            }
        }
    }
    assert_eq!((found, messages), (1500, 1500));
    let (first, last) = (times.iter().min(), times.iter().max());
    assert_eq!(Some(&statistics.message_start_time), first);
    assert_eq!(Some(&statistics.message_end_time), last);
    // The footer's CRC is that of the summary.
    let footer = bytes.len() - mcap::MAGIC.len() - 4;
    let summary_start = u64::from_le_bytes(bytes[footer - 16..footer - 8].try_into().unwrap());
    let crc = crc32fast::hash(&bytes[summary_start as usize..footer]);
    assert_eq!(bytes[footer..footer + 4], crc.to_le_bytes());
}

/// A file on a full disk, from some byte on.
struct Full(Cursor<Vec<u8>>, u64);

impl Write for Full {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let room = self.1.saturating_sub(self.0.position()) as usize;
        match bytes.len().min(room) {
            0 => Err(io::Error::other("full")),
            some => self.0.write(&bytes[..some]),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Full {
    fn seek(&mut self, to: io::SeekFrom) -> io::Result<u64> {
        self.0.seek(to)
    }
}

#[test]
fn a_full_disk_is_told_wherever_it_fills_up() {
    let all = record(40, true);
    for room in (0..all.len() as u64).step_by(37) {
        let sink = Full(Cursor::new(Vec::new()), room);
        let recorded = RecordingWriter::new(sink, "a.mcap", ANCHOR).and_then(|mut writer| {
            for index in 0..40 {
                let entry = entry(index);
                writer.append(entry.role, entry.host_ns, &entry.bytes)?;
            }
            writer.finish()
        });
        let error = recorded.err().unwrap();
        assert_eq!(error.code, Code::FileFailed, "at {room}");
    }
}

#[test]
fn a_recording_cut_at_any_byte_reads_what_was_flushed_before() {
    let bytes = record(40, true);
    // Where the file ends after each flush, one a second, with the entries that are in it.
    let flushed: Vec<_> = (1..=40)
        .map(|count| (record(count, false), count as usize))
        .filter(|(copy, _)| bytes.starts_with(copy))
        .map(|(copy, count)| (copy.len(), count))
        .collect();
    assert!(flushed.len() >= 3, "{flushed:?}");
    let expected: Vec<_> = (0..40).map(entry).collect();
    let mut started = false;
    for cut in 0..bytes.len() {
        match read(&bytes[..cut]) {
            Ok((received, wholeness)) => {
                started = true;
                let certain = flushed.iter().rev().find(|(end, _)| *end <= cut);
                assert!(received.len() >= certain.map_or(0, |(_, count)| *count), "at {cut}");
                assert_eq!(received, expected[..received.len()], "at {cut}");
                assert!(wholeness.truncated, "at {cut}");
            }
            Err(error) => {
                assert!(!started, "at {cut}: {error}");
                assert_eq!(error.exit_code(), 2);
            }
        }
    }
}

#[test]
fn a_flipped_bit_costs_a_chunk_at_most_and_never_passes() {
    let bytes = record(40, true);
    let expected: Vec<_> = (0..40).map(entry).collect();
    for at in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[at] ^= 1 << (at % 8);
        if let Ok((received, _)) = read(&damaged) {
            // Times follow the anchor, which has no CRC of its own.
            let mut rest = expected.iter();
            for entry in received {
                assert!(rest.any(|e| e.role == entry.role && e.bytes == entry.bytes), "at {at}");
            }
        }
    }
}

#[test]
fn what_is_no_recording_says_so() {
    for (bytes, code) in [
        (&b""[..], Code::BadRecording),
        (b"Time (s),Accelerometer X (g)\n1,2\n", Code::BadRecording),
        (mcap::MAGIC, Code::BadRecording),
    ] {
        let error = read(bytes).unwrap_err();
        assert_eq!(error.code, code, "{error}");
        assert_eq!(error.place.at.as_deref(), Some("a.mcap"));
    }
    let mut foreign = mcap::WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
    let channel = foreign.add_channel(0, "/other", "json", &BTreeMap::new()).unwrap();
    let header = mcap::records::MessageHeader {
        channel_id: channel,
        sequence: 0,
        log_time: 1,
        publish_time: 1,
    };
    foreign.write_to_known_channel(&header, b"{}").unwrap();
    foreign.finish().unwrap();
    let error = read(&foreign.into_inner().into_inner()).unwrap_err();
    assert_eq!(error.code, Code::NoWimuTopics);
}

#[test]
fn a_file_that_exists_is_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let anchor = ClockAnchor::now(Duration::from_secs(3));
    let mut writer = RecordingWriter::create(&path, anchor).unwrap();
    writer.append(LinkRole::Cable, 3_000_000_007, &[1]).unwrap();
    writer.finish().unwrap();
    let error = RecordingWriter::create(&path, anchor).err().unwrap();
    assert_eq!(error.code, Code::FileExists);
    let received: Vec<_> = RecordingReader::open(&path).unwrap().collect();
    assert_eq!(received.len(), 1);
    assert_eq!(received[0].as_ref().unwrap().host_ns, 3_000_000_007);
}

#[test]
fn what_was_sent_and_where_a_link_was_lost_reads_back_too() {
    let (role, host_ns) = (LinkRole::Wireless, 9_000);
    let entries = [
        Recorded::Sent { role, host_ns, bytes: vec![0, 7, 0] },
        Recorded::Received(entry(5)),
        Recorded::Lost { role: LinkRole::Cable, host_ns, reason: "pulled out, µ".to_owned() },
        Recorded::Connected { role, host_ns },
    ];
    let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), "a.mcap", ANCHOR).unwrap();
    for entry in &entries {
        writer.record(entry).unwrap();
    }
    let bytes = writer.finish().unwrap().into_inner();
    let mut reader = RecordingReader::new(&bytes[..], "a.mcap").unwrap();
    let mut read = Vec::new();
    while let Some(entry) = reader.next_entry().unwrap() {
        read.push(entry);
    }
    assert_eq!(read, entries);
}
