//! What a sample costs on the wire, everything included: frame, header and packing of raw batches.
//!
//! `cargo run --release -p wimu-link --example wire_budget [FOLDER | FILE.csv[:FROM[:COUNT]] …]`
//!
//! Without files it makes its own signals: a 12-bit sensor at rest, a 16-bit one at rest and in
//! a moving hand. In a FOLDER it looks for the recordings that it knows. A CSV is read by its columns `Accelerometer X (LSB)`, `Y`, `Z`, or
//! `Accelerometer 0 X (LSB)`, …; a negative FROM counts from the end.

use std::error::Error;
use std::f64::consts::TAU;
use std::path::Path;

use wimu_link::batch::{self, Batch};
use wimu_link::{Deframer, MAX_FRAME};
use wimu_model::{Counts, DeviceTimeUs};
use wimu_testkit::{Random, figure};

const BATCH: usize = 16;
/// Recordings that are read from a folder: a sensor at rest, one sensor of an array, the last part of it, which is violent
/// motion, and a sensor turned by hand.
const RECORDINGS: [&str; 4] = [
    "static/mpu6050_449s.csv",
    "array/mimu4444_run1.csv",
    "array/mimu4444_run1.csv:-7500",
    "calibration/six_position_sections.csv",
];
/// 115200 baud, 8N1: ten bits to a byte.
const LINE_BYTES_PER_S: f64 = 11_520.0;

fn main() -> Result<(), Box<dyn Error>> {
    println!("batches of {BATCH}, raw samples of three axes, every byte of the frame counted");
    println!(
        "{:<44} {:>8} {:>9} {:>14}",
        "signal", "samples", "B/sample", "Hz at 115200"
    );
    let mut files: Vec<String> = std::env::args().skip(1).collect();
    let folder = files.pop_if(|file| Path::new(file).is_dir());
    if files.is_empty() {
        for (name, samples) in signals() {
            let cost = report(name, &samples)?;
            record(name, cost, name.contains("hand motion"));
        }
    }
    if let Some(folder) = folder {
        for name in RECORDINGS {
            record(
                name,
                report(name, &read(&format!("{folder}/{name}"))?)?,
                false,
            );
        }
    }
    for file in files {
        report(&file, &read(&file)?)?;
    }
    Ok(())
}

/// Packs all of `samples`, checks that they come back, and prints the cost.
fn report(name: &str, samples: &[Counts]) -> Result<f64, Box<dyn Error>> {
    let mut line = [0; MAX_FRAME];
    let mut deframer = Deframer::new();
    let mut bytes = 0;
    for (number, chunk) in samples.chunks(BATCH).enumerate() {
        let first = (number * BATCH) as u32;
        let time = DeviceTimeUs(u64::from(first) * 10_000);
        let length = batch::encode(first, time, chunk, &mut line)?;
        bytes += length;
        for &byte in line.get(..length).unwrap_or_default() {
            if let Some(frame) = deframer.push(byte) {
                let frame = frame?;
                let back = Batch::decode(frame.kind, frame.body)?;
                assert!(
                    back.counts().eq(chunk.iter().copied()),
                    "packing lost something"
                );
            }
        }
    }
    let cost = bytes as f64 / samples.len() as f64;
    println!(
        "{name:<44} {:>8} {cost:>9.3} {:>14.0}",
        samples.len(),
        LINE_BYTES_PER_S / cost
    );
    Ok(cost)
}

/// Records bytes a sample. The target is that of a hand's motion.
fn record(name: &str, cost: f64, barred: bool) {
    let name = name
        .strip_suffix(".csv")
        .unwrap_or(name)
        .replace(".csv:-7500", ", end");
    let target = if barred { "at most 5" } else { "–" };
    let claim = format!("bytes a sample, frames of {BATCH}: {name}");
    figure(&claim, format!("{cost:.3}"), target, !barred || cost <= 5.0);
}

fn signals() -> [(&'static str, Vec<Counts>); 5] {
    let mut noise = Random::new(1);
    let rest_12 = (0..16_000)
        .map(|_| {
            // 1.5 digits of noise; a digit is 16 counts.
            Counts(
                [30.0, -55.0, 1024.0].map(|mean| (mean + 1.5 * noise.normal()).round() as i16 * 16),
            )
        })
        .collect();
    let rest_16 = (0..16_000)
        .map(|_| {
            Counts(
                [500.0, -900.0, 16384.0].map(|mean| (mean + 24.0 * noise.normal()).round() as i16),
            )
        })
        .collect();
    let mut hand = |rate_hz: f64| {
        // Sines up to 8 Hz with 20 m/s² at their peaks, at ±4 g full scale: 8192 LSB/g.
        let tones: Vec<[f64; 4]> = (0..24)
            .map(|tone| {
                let hz = 0.3 + f64::from(tone) / 3.0;
                [hz, noise.uniform(), noise.uniform(), noise.uniform()]
            })
            .collect();
        (0..16_000)
            .map(|k| {
                let t = f64::from(k) / rate_hz;
                Counts(std::array::from_fn(|axis| {
                    let motion: f64 = tones
                        .iter()
                        .map(|tone| (TAU * (tone[0] * t + tone[axis + 1])).sin() / (1.0 + tone[0]))
                        .sum();
                    let level = [0.0, 0.0, 8192.0][axis];
                    (level + 4500.0 * motion + 12.0 * noise.normal()).round() as i16
                }))
            })
            .collect()
    };
    [
        ("12-bit left-justified, rest, 1.5 digit rms", rest_12),
        ("16-bit, rest, 24 LSB rms", rest_16),
        ("16-bit, hand motion, 100 Hz, 12 LSB rms", hand(100.0)),
        ("16-bit, hand motion, 400 Hz, 12 LSB rms", hand(400.0)),
        ("16-bit, hand motion, 2000 Hz, 12 LSB rms", hand(2000.0)),
    ]
}

fn read(argument: &str) -> Result<Vec<Counts>, Box<dyn Error>> {
    let mut parts = argument.split(':');
    let path = parts.next().unwrap_or_default();
    let from: i64 = parts.next().map_or(Ok(0), str::parse)?;
    let count: usize = parts.next().map_or(Ok(usize::MAX), str::parse)?;
    let text = std::fs::read_to_string(path).map_err(|error| format!("{path}: {error}"))?;
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let mut columns = [0; 3];
    for (column, axis) in columns.iter_mut().zip(["X", "Y", "Z"]) {
        let names = [
            format!("Accelerometer {axis} (LSB)"),
            format!("Accelerometer 0 {axis} (LSB)"),
        ];
        *column = header
            .iter()
            .position(|name| names.iter().any(|wanted| wanted == name))
            .ok_or_else(|| format!("{path}: no column `{}`", names[0]))?;
    }
    let mut samples = Vec::new();
    for (number, line) in lines.enumerate() {
        let fields: Vec<&str> = line.split(',').collect();
        let mut counts = [0; 3];
        for (value, &column) in counts.iter_mut().zip(&columns) {
            *value = fields
                .get(column)
                .and_then(|field| field.parse().ok())
                .ok_or_else(|| format!("{path}:{}: not three 16-bit counts", number + 2))?;
        }
        samples.push(Counts(counts));
    }
    let from = if from < 0 {
        samples.len().saturating_sub(from.unsigned_abs() as usize)
    } else {
        from as usize
    };
    Ok(samples.into_iter().skip(from).take(count).collect())
}
