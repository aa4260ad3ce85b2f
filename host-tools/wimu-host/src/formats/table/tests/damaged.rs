//! Damaged tables: findings or typed errors, no panic.

use super::{data, has, named};
use crate::error::ErrorCode;
use crate::finding::FindingCode;
use crate::formats::{ReadOptions, Source};
use crate::recording::{Quantity, Recording};

fn read(name: &str, bytes: Vec<u8>) -> crate::Result<Recording> {
    let source = Source::of_bytes(name, bytes);
    let mut recording = Recording::new(name);
    crate::formats::read(&source, &ReadOptions::default(), &mut recording)?;
    Ok(recording)
}

#[test]
fn damaged_files_never_panic() {
    let files = [
        "euroc_imu0.csv",
        "euroc_imu0_excel.csv",
        "phyphox_raw_data.csv",
        "xsens_mt_manager_old.txt",
        "sensor_logger/Gyroscope.csv",
    ];
    for file in files {
        let Some(path) = data(&format!("formats/{file}")) else {
            return;
        };
        let mut whole = std::fs::read(path).unwrap();
        // Enough to be of the same form, and quick.
        whole.truncate(20_000);
        for part in 0..100 {
            let _ = read(file, whole[..whole.len() * part / 100].to_vec());
        }
        let mut state = 1_u64;
        for _ in 0..200 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let bit = (state >> 20) as usize % (8 * whole.len());
            let mut flipped = whole.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            // A header may lose its meaning.
            let outcome = read(file, flipped);
            assert!(outcome.is_ok() || bit < 8 * 1000, "{file}, bit {bit}: {outcome:?}");
        }
    }
}

#[test]
fn bad_rows_are_counted_with_the_first_line() {
    let text = "Time (s),Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)\n\
                0,0,0,1\n1,0,0,nan\n2,0,0\n3,0,zero,1\n# a comment\nrestarted,0,0,1\n5,0,0,1\n4,0,0,1\n6,0,0,1\n7,0,0,1\n8,0,0";
    let recording = named("a.csv", text, &ReadOptions::default()).unwrap();
    let force = recording.first(Quantity::SpecificForce).unwrap();
    assert_eq!((force.len(), force.valid().count()), (9, 5), "{:?}", recording.findings);
    let evidence =
        |code| recording.findings.iter().find(|f| f.code == code).map(|f| f.evidence.clone());
    let bad = evidence(FindingCode::RowsMasked).unwrap();
    assert!(bad.contains("4 of 10") && bad.contains("line 4: 3 fields"), "{bad}");
    assert!(has(&recording, FindingCode::Truncated));
    let wrong =
        "Time (s),Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)\n0,0,0\n1,0,0\n";
    let error = named("a.csv", wrong, &ReadOptions::default()).unwrap_err();
    assert_eq!((error.code(), error.location()), (ErrorCode::BadRecording, Some("a.csv line 2")));
}

#[test]
fn texts_that_are_no_tables_of_sensors_say_what_is_there() {
    for (text, code) in [
        ("", ErrorCode::CsvEmpty),
        ("\n\n", ErrorCode::CsvEmpty),
        (
            "Call me Ishmael. Some years ago, never mind how long precisely, I went to sea.\n",
            ErrorCode::CsvNoHeader,
        ),
        (
            "Time (s),Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)\n",
            ErrorCode::NoRows,
        ),
        ("Time (s),Range (m)\n1,2\n2,3\n", ErrorCode::CsvMissingColumn),
        ("Accelerometer X (g),Accelerometer Y (g)\n1,2\n", ErrorCode::CsvMissingColumn),
        (
            "Accelerometer X (g),Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)\n0,1,2,3\n",
            ErrorCode::CsvDuplicateColumn,
        ),
        (
            "Accelerometer X (stone),Accelerometer Y (stone),Accelerometer Z (stone)\n0,1,2\n",
            ErrorCode::CsvUnknownUnit,
        ),
        (
            "Accelerometer X (g),Accelerometer Y (LSB),Accelerometer Z (g)\n0,1,2\n",
            ErrorCode::CsvMixedUnits,
        ),
    ] {
        let error = named("a.csv", text, &ReadOptions::default()).unwrap_err();
        assert_eq!(error.code(), code, "{text}: {error}");
    }
}

#[test]
fn long_texts_and_binary_junk_are_refused() {
    let prose = "It was a dark and stormy night; the rain fell in torrents, except at occasional intervals. ".repeat(120_000);
    let junk: Vec<u8> =
        (0..10_000_000_u32).map(|k| (k.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    let numbers = "1 2 3 4 5\n".repeat(100_000);
    for bytes in [prose.into_bytes(), junk, numbers.into_bytes()] {
        assert!(read("a.csv", bytes).is_err());
    }
}
