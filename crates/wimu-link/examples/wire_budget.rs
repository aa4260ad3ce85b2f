//! What a sample costs on the wire, everything included: frame, header and packing of raw batches.
//!
//! `cargo run --release -p wimu-link --example wire_budget [FOLDER | FILE.csv[:FROM[:COUNT]] …]`
//!
//! Without files it makes its own signals: a 12-bit sensor at rest, a 16-bit one at rest and in
//! a moving hand. In a FOLDER it looks for the recordings that it knows. A CSV is read by its columns `Accelerometer X (LSB)`, `Y`, `Z`, or
//! `Accelerometer 0 X (LSB)`, …, for six axes also `Gyroscope X (LSB)`, …; a negative FROM counts from the end.
//! Recordings in m/s² and rad/s are quantised at the sensitivities of an LSM6DSO, 0.061 mg and 17.5 mdps
//! per LSB (±2 *g*, ±500 °/s).

use std::error::Error;
use std::f64::consts::TAU;
use std::path::Path;

use wimu_link::batch::{self, Batch, Sample};
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
/// Recordings of six axes, and the most bytes a sample: sensors at rest, an array in poses and then in violent motion,
/// translations by hand.
const SIX_AXES: [(&str, Option<f64>); 7] = [
    ("static/mpu6050_449s.csv", Some(REST)),
    ("calibration/six_position_sections.csv", Some(REST)),
    ("array/mimu4444_run1.csv", None),
    ("array/mimu4444_run1.csv:-7500", None),
    ("motion/broad_slow_translation_A.csv", Some(HAND)),
    ("motion/broad_slow_translation_breaks_B.csv", Some(HAND)),
    ("motion/broad_fast_translation_A.csv", Some(HAND)),
];
/// Most bytes a sample of six axes, at rest and in hand motion.
const REST: f64 = 7.5;
const HAND: f64 = 10.0;
/// Units of columns, and LSB of an LSM6DSO in one unit.
const UNITS: [[(&str, f64); 3]; 2] = [
    [("LSB", 1.0), ("m/s²", 1.0 / (0.061e-3 * 9.80665)), ("g", 1.0 / 0.061e-3)],
    [("LSB", 1.0), ("rad/s", 360.0 / TAU / 17.5e-3), ("deg/s", 1.0 / 17.5e-3)],
];
/// 115200 baud, 8N1: ten bits to a byte.
const LINE_BYTES_PER_S: f64 = 11_520.0;

fn main() -> Result<(), Box<dyn Error>> {
    println!("batches of {BATCH}, raw samples of three axes, every byte of the frame counted");
    println!("{:<44} {:>8} {:>9} {:>14}", "signal", "samples", "B/sample", "Hz at 115200");
    let mut files: Vec<String> = std::env::args().skip(1).collect();
    let folder = files.pop_if(|file| Path::new(file).is_dir());
    if files.is_empty() {
        for (name, samples) in signals() {
            let cost = report(name, &samples)?;
            record("", name, cost, name.contains("hand motion").then_some(5.0));
        }
    }
    if let Some(folder) = &folder {
        for name in RECORDINGS {
            let samples = three_axes(&format!("{folder}/{name}"))?;
            record("", name, report(name, &samples)?, None);
        }
    }
    for file in &files {
        report(file, &three_axes(file)?)?;
    }
    println!("\nraw samples of six axes");
    if let Some(folder) = folder {
        for (name, most) in SIX_AXES {
            let samples = six_axes(&format!("{folder}/{name}"))?;
            record(" of six axes", name, report(name, &samples)?, most);
        }
    }
    for file in files {
        match six_axes(&file) {
            Ok(samples) => report(&file, &samples).map(|_| ())?,
            Err(why) => println!("{why}"),
        }
    }
    Ok(())
}

/// Packs all of `samples`, checks that they come back, and prints the cost.
fn report<S: Sample>(name: &str, samples: &[S]) -> Result<f64, Box<dyn Error>> {
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
                let found = [back.samples(), back.angular_rates()];
                let lost = (0..S::AXES).any(|axis| {
                    let found = found[axis / 3].iter().map(|axes| axes[axis % 3]);
                    !found.eq(chunk.iter().map(|sample| sample.axis(axis)))
                });
                assert!(!lost, "packing lost something");
            }
        }
    }
    let cost = bytes as f64 / samples.len() as f64;
    println!("{name:<44} {:>8} {cost:>9.3} {:>14.0}", samples.len(), LINE_BYTES_PER_S / cost);
    Ok(cost)
}

/// Records bytes a sample, and whether they are few enough.
fn record(axes: &str, name: &str, cost: f64, most: Option<f64>) {
    let name = name.strip_suffix(".csv").unwrap_or(name).replace(".csv:-7500", ", end");
    let target = most.map_or("–".to_owned(), |most| format!("at most {most}"));
    let claim = format!("bytes a sample{axes}, frames of {BATCH}: {name}");
    let met = most.is_none_or(|most| cost <= most);
    figure(&claim, format!("{cost:.3}"), &target, met);
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

fn three_axes(argument: &str) -> Result<Vec<Counts>, Box<dyn Error>> {
    Ok(read::<3>(argument)?.into_iter().map(Counts).collect())
}

fn six_axes(argument: &str) -> Result<Vec<(Counts, Counts)>, Box<dyn Error>> {
    let pair = |[x, y, z, p, q, r]: [i16; 6]| (Counts([x, y, z]), Counts([p, q, r]));
    Ok(read(argument)?.into_iter().map(pair).collect())
}

/// The first axes of the accelerometer and the gyroscope.
fn read<const AXES: usize>(argument: &str) -> Result<Vec<[i16; AXES]>, Box<dyn Error>> {
    let mut parts = argument.split(':');
    let path = parts.next().unwrap_or_default();
    let from: i64 = parts.next().map_or(Ok(0), str::parse)?;
    let count: usize = parts.next().map_or(Ok(usize::MAX), str::parse)?;
    let text = std::fs::read_to_string(path).map_err(|error| format!("{path}: {error}"))?;
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let mut columns = [(0, 1.0); AXES];
    for (index, column) in columns.iter_mut().enumerate() {
        let (sensor, axis) =
            (["Accelerometer", "Gyroscope"][index / 3], ["X", "Y", "Z"][index % 3]);
        *column = UNITS[index / 3]
            .iter()
            .find_map(|(unit, lsb)| {
                let names =
                    [format!("{sensor} {axis} ({unit})"), format!("{sensor} 0 {axis} ({unit})")];
                let place =
                    header.iter().position(|name| names.iter().any(|wanted| wanted == name))?;
                Some((place, *lsb))
            })
            .ok_or_else(|| format!("{path}: no column `{sensor} {axis} (LSB)`"))?;
    }
    let mut samples = Vec::new();
    for (number, line) in lines.enumerate() {
        let fields: Vec<&str> = line.split(',').collect();
        let mut counts = [0; AXES];
        for (value, &(column, lsb)) in counts.iter_mut().zip(&columns) {
            let field: f64 = fields
                .get(column)
                .and_then(|field| field.parse().ok())
                .ok_or_else(|| format!("{path}:{}: not {AXES} numbers", number + 2))?;
            // Saturates at the ends of the range.
            *value = (field * lsb).round() as i16;
        }
        samples.push(counts);
    }
    let from = if from < 0 {
        samples.len().saturating_sub(from.unsigned_abs() as usize)
    } else {
        from as usize
    };
    Ok(samples.into_iter().skip(from).take(count).collect())
}
