//! Betaflight, Cleanflight and INAV blackbox logs (`.bbl`, `.BFL`).
//!
//! One inertial sensor, whose values the flight controller filters and corrects by offsets of its
//! own. The accelerations are counts with `acc_1G` LSB per g. The angular rates are counts with
//! `gyro_scale`: degrees per second (rad/µs in Baseflight), a tenth of that with
//! `blackbox_high_resolution`. Axes are those of the flight controller, forward, left, up. Times
//! are µs since its start.
//!
//! A file has a log for each time that the aircraft was armed. The one with most rows is read, or
//! the one that `--topic "log 2"` names. After damage, frames are left out up to the next that
//! does not refer to an earlier one.

mod encoding;
mod frames;
mod header;

use self::frames::{Decoder, Summary};
use self::header::{Header, MARKER};
use super::window::{Window, no_inertial_data};
use super::{ReadOptions, Source};
use crate::plural::counted;
use crate::recording::{Quantity, Sink, Stamped, TrackId, TrackInfo, Unit};
use crate::{Code, Result};

/// m/s² (CODATA; the value that 1 g stands for).
const STANDARD_GRAVITY: f64 = 9.80665;
/// Bytes looked at for the start of a log.
const CHUNK: usize = 1 << 16;
/// Most logs of a file that are found (as blackbox_decode).
const MAX_LOGS: usize = 1000;
/// Most logs that a message names.
const MOST_NAMED: usize = 5;

/// Fields of three axes and what they measure.
const FIELDS: [(&str, Quantity); 4] = [
    ("accSmooth", Quantity::SpecificForce),
    ("gyroADC", Quantity::AngularRate),
    ("gyroUnfilt", Quantity::AngularRate),
    ("magADC", Quantity::MagneticField),
];

/// A log within a file.
struct Log {
    /// Position of its header and its end.
    span: [u64; 2],
    summary: Summary,
}

/// Whether it is a blackbox log.
pub(super) fn detect(source: &Source) -> bool {
    let mut windows = source.start().windows(MARKER.len());
    windows.any(|bytes| bytes == MARKER)
}

/// Reads it: first all logs, to find the one with most rows, then its rows.
pub(super) fn read(source: &Source, options: &ReadOptions, sink: &mut dyn Sink) -> Result<()> {
    let logs = survey(source)?;
    let chosen = choose(&logs, options, source)?;
    let mut window = Window::new(source, logs[chosen].span[0])?;
    let header = Header::read(&mut window)?;
    let fields = fields(&header);
    if fields.iter().all(|(_, quantity)| *quantity == Quantity::MagneticField) {
        let names = header.names('I').into_iter().map(str::to_owned);
        let names: Vec<String> = names.collect();
        return Err(no_inertial_data(source, "accSmooth and gyroADC", &names));
    }
    let decoder = decoder(&header).filter(|_| logs[chosen].summary.rows > 0);
    let decoder = decoder.ok_or_else(|| {
        let message = format!("no frame of log {} can be decoded", chosen + 1);
        let remedy = "copy the file from the device again, or decode it with blackbox_decode";
        Code::BadRecording.error(message, remedy).at(source.name())
    })?;
    report(&logs, chosen, sink);
    let mut tracks: Vec<(TrackId, f64)> = Vec::new();
    for field in &fields {
        let stamps =
            tracks.first().map_or(Stamped::By(Some(1000)), |(first, _)| Stamped::Like(*first));
        tracks.push(track(*field, &header, stamps, sink));
    }
    decoder.decode(&mut window, &mut |time_us, values| {
        for ((track, factor), axes) in tracks.iter().zip(values.chunks_exact(3)) {
            let row = [axes[0], axes[1], axes[2]].map(|count| count as f64 * factor);
            sink.row(*track, time_us.saturating_mul(1000), &row);
        }
    })?;
    Ok(())
}

/// Fields of a log that are read; the first of a quantity only.
fn fields(header: &Header) -> Vec<(&'static str, Quantity)> {
    let names = header.names('I');
    let mut fields: Vec<(&str, Quantity)> = Vec::new();
    for (field, quantity) in FIELDS {
        let has = |axis: &str| names.iter().any(|name| **name == format!("{field}[{axis}]"));
        if ["0", "1", "2"].into_iter().all(has) && fields.iter().all(|(_, of)| *of != quantity) {
            fields.push((field, quantity));
        }
    }
    fields
}

/// Decoder of the fields of a log.
fn decoder(header: &Header) -> Option<Decoder> {
    let fields = fields(header);
    let names =
        fields.iter().flat_map(|(field, _)| (0..3).map(move |axis| format!("{field}[{axis}]")));
    let names: Vec<String> = names.collect();
    Decoder::new(header, &names).filter(|_| header.is_known())
}

/// Finds and decodes all logs of a file.
fn survey(source: &Source) -> Result<Vec<Log>> {
    let mut window = Window::new(source, 0)?;
    let mut logs = Vec::new();
    while logs.len() < MAX_LOGS && find_marker(&mut window)? {
        let start = window.position();
        let header = Header::read(&mut window)?;
        if window.position() == start {
            window.skip(MARKER.len());
        }
        // Without a decoder, the search goes on behind the header.
        let summary = match decoder(&header) {
            Some(decoder) => decoder.decode(&mut window, &mut |_, _| ())?,
            None => Summary::default(),
        };
        logs.push(Log { span: [start, window.position()], summary });
    }
    Ok(logs)
}

/// Moves on to the start of a log.
fn find_marker(window: &mut Window) -> Result<bool> {
    loop {
        let ahead = window.peek(CHUNK)?;
        let found = ahead.windows(MARKER.len()).position(|bytes| bytes == MARKER);
        let (length, is_last) = (ahead.len(), ahead.len() < CHUNK);
        match found {
            Some(offset) => {
                window.skip(offset);
                return Ok(true);
            }
            None if is_last => return Ok(false),
            None => window.skip(length - MARKER.len() + 1),
        }
    }
}

/// Index of the log that is read.
fn choose(logs: &[Log], options: &ReadOptions, source: &Source) -> Result<usize> {
    if let Some(topic) = &options.topic {
        let number: Option<usize> = topic.trim_start_matches("log").trim().parse().ok();
        let index = number.and_then(|number| number.checked_sub(1));
        return index.filter(|index| *index < logs.len()).ok_or_else(|| {
            let remedy = format!("choose `log 1` to `log {}`", logs.len());
            Code::Usage.error(format!("there is no log `{topic}`"), remedy).at(source.name())
        });
    }
    let rows = |index: &usize| (logs[*index].summary.rows, std::cmp::Reverse(*index));
    (0..logs.len()).max_by_key(rows).ok_or_else(|| {
        Code::BadRecording
            .error("there is no start of a blackbox log", "check the file")
            .at(source.name())
    })
}

/// Names the log that is read and the others; damage and lost frames; the clock.
fn report(logs: &[Log], chosen: usize, sink: &mut dyn Sink) {
    let name = |index: usize| {
        let summary = &logs[index].summary;
        let [first, last] = summary.times_us.unwrap_or_default();
        let seconds = (last - first) as f64 * 1e-6;
        format!("log {} ({}, {seconds:.1} s)", index + 1, counted(summary.rows, "row"))
    };
    if logs.len() > 1 {
        let others = (0..logs.len()).filter(|index| *index != chosen);
        let mut names: Vec<String> = others.take(MOST_NAMED).map(name).collect();
        if logs.len() - 1 > MOST_NAMED {
            names.push(format!("{} more", logs.len() - 1 - MOST_NAMED));
        }
        let evidence = format!("read: {}; not read: {}", name(chosen), names.join(", "));
        let finding = Code::TrackChosen.note(evidence);
        sink.finding(finding.remedy("`--topic \"log N\"` reads another"));
    }
    let [start, end] = logs[chosen].span;
    let damage = logs[chosen].summary.damage.findings(start..end);
    damage.into_iter().for_each(|finding| sink.finding(finding));
    let lost = logs[chosen].summary.lost;
    if lost > 0 {
        let frames = counted(lost, "frame");
        let evidence = format!("{frames} refer to damaged ones or have an implausible time");
        let finding = Code::Truncated.warning(evidence);
        sink.finding(finding.remedy("they are left out"));
    }
    let evidence = "times count from the start of the flight controller";
    sink.finding(Code::Clock.note(evidence));
}

/// The track of a field, and the factor of its values.
fn track(
    (field, quantity): (&str, Quantity),
    header: &Header,
    stamps: Stamped,
    sink: &mut dyn Sink,
) -> (TrackId, f64) {
    let positive = |name| header.number(name).filter(|value| *value > 0.0 && value.is_finite());
    let counts = |si_per_lsb| (Unit::Counts { si_per_lsb }, 1.0);
    let (unit, factor) = match (quantity, positive("gyro_scale")) {
        (Quantity::SpecificForce, _) => {
            counts(positive("acc_1G").map(|lsb| STANDARD_GRAVITY / lsb))
        }
        (Quantity::AngularRate, Some(scale)) => {
            let unit = match header.text("Firmware type") {
                Some("Baseflight") => 1e6,
                _ => 1_f64.to_radians(),
            };
            let finer = positive("blackbox_high_resolution").map_or(1.0, |_| 0.1);
            (Unit::Si, scale * unit * finer)
        }
        _ => counts(None),
    };
    let mut info = TrackInfo::new(field, quantity, unit);
    info.corrected = quantity != Quantity::MagneticField;
    info.stamps = Some(stamps);
    (sink.track(info), factor)
}
