//! Tables of known programs, and damaged ones.

use std::path::Path;

use super::*;
use crate::formats::load;
use crate::recording::{Origin, Recording, Track};

/// Real files, which are not part of the project; `None` where they are missing.
fn data(name: &str) -> Option<std::path::PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/data")
        .join(name);
    if !path.exists() {
        eprintln!("skipped: {} is not there", path.display());
    }
    path.exists().then_some(path)
}

fn loaded(name: &str, options: &ReadOptions) -> Option<Recording> {
    Some(load(&data(name)?, options).unwrap_or_else(|error| panic!("{name}: {error}")))
}

fn text(text: &str) -> Result<Recording> {
    named("table.csv", text, &ReadOptions::default())
}

fn named(name: &str, text: &str, options: &ReadOptions) -> Result<Recording> {
    let source = Source::of_bytes(name, text.as_bytes());
    let mut recording = Recording::new(name);
    recording.format = crate::formats::read(&source, options, &mut recording)?;
    Ok(recording)
}

fn has(recording: &Recording, code: FindingCode) -> bool {
    recording
        .findings
        .iter()
        .any(|finding| finding.code == code)
}

/// Compares with a row of checks.csv.
fn check(file: &str, channel: &str, track: &Track) {
    let checks = std::fs::read_to_string(data("formats/checks.csv").unwrap()).unwrap();
    let line = checks
        .lines()
        .find(|line| line.starts_with(&format!("{file},{channel},")))
        .unwrap();
    let expected: Vec<f64> = line
        .split(',')
        .skip(3)
        .take(10)
        .map(|text| text.parse().unwrap())
        .collect();
    let rows: Vec<(i64, [f64; 3])> = track.vectors().collect();
    let (first, last) = (rows[0], rows[rows.len() - 1]);
    let mean = rows
        .iter()
        .map(|(_, v)| v.iter().map(|c| c * c).sum::<f64>().sqrt())
        .sum::<f64>()
        / rows.len() as f64;
    let found = [
        rows.len() as f64,
        first.0 as f64 * 1e-9,
        (last.0 - first.0) as f64 * 1e-9,
        first.1[0],
        first.1[1],
        first.1[2],
        last.1[0],
        last.1[1],
        last.1[2],
        mean,
    ];
    for (found, expected) in found.iter().zip(&expected) {
        assert!(
            (found - expected).abs() <= 1e-6 * expected.abs().max(1e-3),
            "{file}: {found} {expected}"
        );
    }
}

#[test]
fn files_of_other_programs_have_their_check_figures() {
    for (file, channel, quantity) in [
        ("euroc_imu0.csv", "accelerometer", Quantity::SpecificForce),
        (
            "euroc_imu0_excel.csv",
            "accelerometer",
            Quantity::SpecificForce,
        ),
        (
            "phyphox_raw_data.csv",
            "accelerometer",
            Quantity::LinearAcceleration,
        ),
        (
            "sensor_logger/Accelerometer.csv",
            "accelerometer",
            Quantity::LinearAcceleration,
        ),
        (
            "sensor_logger/Gyroscope.csv",
            "gyroscope",
            Quantity::AngularRate,
        ),
        ("sensor_logger/Gravity.csv", "gravity", Quantity::Gravity),
        (
            "xsens_mt_manager_old.txt",
            "accelerometer",
            Quantity::SpecificForce,
        ),
        (
            "xsens_mt_manager_2022.txt",
            "accelerometer",
            Quantity::SpecificForce,
        ),
    ] {
        let Some(recording) = loaded(&format!("formats/{file}"), &ReadOptions::default()) else {
            return;
        };
        let track = recording
            .of(quantity)
            .next()
            .unwrap_or_else(|| panic!("{file}: {:?}", recording.findings));
        assert_eq!(track.info.unit, Unit::Si, "{file}");
        check(file, channel, track);
        eprintln!("{file}: {:?}", recording.findings);
        let without_gravity = quantity == Quantity::LinearAcceleration;
        assert_eq!(
            has(&recording, FindingCode::GravityMissing),
            without_gravity,
            "{file}"
        );
    }
}

#[test]
fn own_tables_keep_every_column() {
    let recording = text(
        "Time (ms),Accelerometer 0 X (LSB),Accelerometer 0 Y (LSB),Accelerometer 0 Z (LSB),Accelerometer 1 X (LSB),\
         Accelerometer 1 Y (LSB),Accelerometer 1 Z (LSB),Sensitivity (LSB/g),Magnetometer X (µT),Magnetometer Y (µT),\
         Magnetometer Z (µT),Temperature (C),Field Calibrated,Truth Position E (m),Truth Position N (m),Truth Position U (m),\
         Truth Quaternion W,Truth Quaternion X,Truth Quaternion Y,Truth Quaternion Z,Note\n\
         0,1,2,256,3,4,255,256,10,0,0,20.5,1,0,0,1,1,0,0,0,start\n\
         10,1,2,256,3,,255,256,,,,,0,,,,,,,,\n\
         20,1,2,512,3,4,511,512,,,,,0,,,,,,,,\n\
         30,1,2,512,3,4,511,,,,,,0,,,,,,,,\n",
    )
    .unwrap();
    let unit = |lsb: f64| Unit::Counts {
        si_per_lsb: Some(G / lsb),
    };
    let force: Vec<&Track> = recording.of(Quantity::SpecificForce).collect();
    let of = |k: usize| (force[k].info.sensor, force[k].info.unit, force[k].len());
    assert_eq!(
        [0, 1, 2, 3].map(of),
        [
            (0, unit(256.0), 2),
            (1, unit(256.0), 2),
            (0, unit(512.0), 1),
            (1, unit(512.0), 1)
        ]
    );
    assert_eq!(force[1].mask(), [true, false]);
    assert_eq!(force[0].info.name, "Accelerometer 0");
    let field = recording.first(Quantity::MagneticField).unwrap();
    assert!((field.row(0).unwrap()[0] - 1e-5).abs() < 1e-18);
    assert_eq!(field.len(), 1);
    assert_eq!(
        recording.first(Quantity::Temperature).unwrap().row(0),
        Some(&[20.5][..])
    );
    let attitude = recording.of(Quantity::Attitude).next().unwrap();
    assert_eq!(
        (attitude.info.origin, attitude.row(0)),
        (Origin::Truth, Some(&[1.0, 0.0, 0.0, 0.0][..]))
    );
    assert_eq!(
        recording.of(Quantity::Position).next().unwrap().row(0),
        Some(&[0.0, 0.0, 1.0][..])
    );
    let scalars: Vec<_> = recording
        .of(Quantity::Scalar)
        .map(|t| (t.info.name.as_str(), t.len()))
        .collect();
    assert_eq!(scalars, [("Field Calibrated", 4)]);
    let axes =
        text("Time (s),Accelerometer 0 (m/s²),Accelerometer 1 (m/s²)\n0,1,2\n1,1,2\n").unwrap();
    let names: Vec<_> = axes.tracks().iter().map(|t| t.info.name.as_str()).collect();
    assert_eq!(names, ["Accelerometer 0 (m/s²)", "Accelerometer 1 (m/s²)"]);
}
