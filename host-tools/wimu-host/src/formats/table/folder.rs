//! Folders and archives of tables: one file for each sensor of a phone, or one for each packet.

use std::path::Path;

use super::{is_text, names, quantity_of, read_table, times};
use crate::formats::{ReadOptions, Source};
use crate::recording::Sink;
use crate::{Code, Problem, Result};

/// Ends of names of tables.
const ENDINGS: [&str; 3] = ["csv", "txt", "tsv"];
/// Bytes of packets that are put together, at most.
const MAX_PACKETS: usize = 1 << 28;
/// Fields of a packet of KITTI's oxts.
const OXTS_FIELDS: usize = 30;

/// Whether a folder or archive has tables.
pub fn detect(source: &Source) -> bool {
    source.members().iter().any(is_table)
}

fn is_table(member: &Source) -> bool {
    let ending = Path::new(member.name()).extension().unwrap_or_default();
    let is_known = ENDINGS.iter().any(|known| ending.eq_ignore_ascii_case(known));
    is_known && is_text(member.start())
}

/// The last part of a member's name.
fn file_name(member: &Source) -> String {
    let name = Path::new(member.name()).file_name();
    name.unwrap_or_default().to_string_lossy().into_owned()
}

/// Reads the tables of a folder or archive.
///
/// # Errors
/// `unknown_format` if none is a table of an inertial sensor, with the reason for each.
pub fn read(source: &Source, options: &ReadOptions, sink: &mut dyn Sink) -> Result<()> {
    if let Some((packets, times)) = packets(source)? {
        return read_table(&packets, options, sink, times);
    }
    let tables = source.members().iter().filter(|member| is_table(member));
    let tables: Vec<&Source> = tables.collect();
    let is_uncalibrated = |member: &Source| names::key(&file_name(member)).contains("uncalibrated");
    let has_calibrated =
        tables.iter().any(|member| !is_uncalibrated(member) && quantity_of(member).is_some());
    let (mut read, mut refused) = (0, Vec::new());
    for member in &tables {
        let name = file_name(member);
        if has_calibrated && is_uncalibrated(member) {
            let text = format!("`{name}` is not read: the folder has calibrated values");
            sink.finding(Code::TrackChosen.note(text));
            continue;
        }
        match read_table(member, options, sink, Vec::new()) {
            Ok(()) => read += 1,
            Err(error) => refused.push((name, error)),
        }
    }
    if let ([_], [(_, error)]) = (tables.as_slice(), refused.as_slice()) {
        return Err(error.clone());
    }
    if read == 0 {
        let reason = |(name, error): &(String, Problem)| format!("{name}: {}", error.text);
        let reasons: Vec<String> = refused.iter().take(8).map(reason).collect();
        let reasons = reasons.join("; ");
        let message = format!("none of its tables is of an inertial sensor: {reasons}");
        return Err(Code::UnknownFormat
            .error(message, "see docs/reference/formats.md, or give one file")
            .at(source.name()));
    }
    for (name, error) in refused {
        let text = format!("`{name}` is not read: {}", error.text);
        sink.finding(Code::TrackChosen.note(text));
    }
    Ok(())
}

/// Files of one packet each, put together, and their times; `None` for other folders.
fn packets(source: &Source) -> Result<Option<(Source, Vec<i64>)>> {
    let is_times = |member: &&Source| file_name(member) == "timestamps.txt";
    let is_packet = |member: &&Source| {
        let text = String::from_utf8_lossy(member.start());
        let mut lines = text.lines();
        let is_first = lines.next().is_some_and(|line| {
            let fields: Vec<&str> = line.split_whitespace().collect();
            fields.len() == OXTS_FIELDS && fields.iter().all(|field| field.parse::<f64>().is_ok())
        });
        is_first && lines.next().is_none()
    };
    let files: Vec<&Source> = source.members().iter().filter(is_packet).collect();
    if files.len() < 2 {
        return Ok(None);
    }
    let mut bytes = Vec::new();
    for file in &files {
        // A packet is shorter than the start of a file.
        bytes.extend_from_slice(file.start());
        if !bytes.ends_with(b"\n") {
            bytes.push(b'\n');
        }
        if bytes.len() > MAX_PACKETS {
            break;
        }
    }
    let mut stamps = Vec::new();
    if let Some(file) = source.members().iter().find(is_times) {
        let mut lines = super::text::Lines::of(file)?;
        while let Some(line) = lines.next_line()? {
            stamps.extend(times::date(None, &line));
        }
    }
    Ok(Some((Source::of_bytes(source.name(), bytes), stamps)))
}
