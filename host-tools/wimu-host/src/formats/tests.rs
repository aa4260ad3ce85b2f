//! For tests: the files of ../shared/data/formats, the figures that independent readers give for
//! them, and damage.

use std::path::{Path, PathBuf};

use super::{ReadOptions, Source, read};
use crate::recording::{Quantity, Recording, Track};

/// Largest relative difference to a figure; they have nine digits.
const TOLERANCE: f64 = 1e-6;

/// A file, if the public recordings are there.
pub(super) fn file(name: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/formats");
    let path = folder.join(name);
    if !path.exists() {
        println!("skipped: {name} of the public recordings, ../shared/data/formats, is absent");
    }
    path.exists().then_some(path)
}

/// Reads bytes.
pub(super) fn read_bytes(bytes: &[u8], topic: Option<&str>) -> crate::Result<Recording> {
    let source = Source::of_bytes("file", bytes);
    let options = ReadOptions { topic: topic.map(str::to_owned), ..ReadOptions::default() };
    let mut recording = Recording::new(source.name());
    recording.format = read(&source, &options, &mut recording)?;
    Ok(recording)
}

/// Compares the specific forces of a sensor with the row of checks.csv for a file and a channel.
pub(super) fn assert_figures(recording: &Recording, name: &str, channel: &str, sensor: u8) {
    let checks = file("checks.csv").expect("the figures are next to the files");
    let checks = std::fs::read_to_string(checks).expect("a text file");
    let row = checks.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let row = row.into_iter().find(|row| row[0] == name && row[1] == channel);
    let row = row.unwrap_or_else(|| panic!("no figures of {name}, {channel}"));
    let expected: Vec<f64> = row[3..13].iter().map(|text| text.parse().unwrap()).collect();
    let track = recording
        .of(Quantity::SpecificForce)
        .find(|track| track.info.sensor == sensor)
        .expect("a track");
    for (found, expected) in figures(track).into_iter().zip(expected) {
        let near = (found - expected).abs() <= TOLERANCE * expected.abs().max(1e-3);
        assert!(near, "{name}, {channel}: {found} instead of {expected}");
    }
}

/// Samples, first time, duration, first and last vector, mean norm.
fn figures(track: &Track) -> Vec<f64> {
    let rows: Vec<(i64, [f64; 3])> = track.vectors().collect();
    let (first, last) = (rows[0], rows[rows.len() - 1]);
    let norms: f64 = rows.iter().map(|(_, [x, y, z])| (x * x + y * y + z * z).sqrt()).sum();
    let times = [first.0 as f64 * 1e-9, (last.0 - first.0) as f64 * 1e-9];
    let mut figures = vec![rows.len() as f64];
    figures.extend(times.iter().chain(&first.1).chain(&last.1));
    figures.push(norms / rows.len() as f64);
    figures
}

/// Reads a file truncated at 100 places, with 200 bit flips and with 50 pieces left out: each
/// time there are rows or a typed refusal.
pub(super) fn assert_robust(name: &str) {
    let Some(path) = file(name) else { return };
    let bytes = std::fs::read(path).expect("the file");
    for place in 0..100 {
        drop(read_bytes(&bytes[..bytes.len() * place / 100], None));
    }
    let mut random = 1_u64;
    let mut next = |below: usize| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (random >> 33) as usize % below
    };
    let mut read = 0;
    for place in 0..200 {
        let mut damaged = bytes.clone();
        damaged[next(bytes.len())] ^= 1 << next(8);
        read += usize::from(read_bytes(&damaged, None).is_ok());
        if place % 4 > 0 {
            continue;
        }
        let start = next(bytes.len());
        damaged.drain(start..(start + next(1000)).min(bytes.len()));
        drop(read_bytes(&damaged, None));
    }
    assert!(read >= 150, "{name}: {read} of 200 files with a flipped bit are read");
}

/// A format that was named for other content refuses it.
#[test]
fn other_content_is_refused() {
    for format in ["PX4 ULog", "ArduPilot DataFlash", "Betaflight blackbox", "unsupported"] {
        for bytes in [&b""[..], b"a,b,c\n1,2,3\n", &[0xA3; 3000]] {
            let source = Source::of_bytes("file", bytes);
            let options = ReadOptions { format: Some(format.to_owned()), ..ReadOptions::default() };
            let result = read(&source, &options, &mut Recording::new("file"));
            assert!(result.is_err(), "{format}");
        }
    }
}
