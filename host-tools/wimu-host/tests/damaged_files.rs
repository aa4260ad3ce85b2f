//! Files of other programs that are cut or damaged, and archives: rows or a typed refusal, and what was lost is said.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use wimu_host::formats::{self, ReadOptions, Source};
use wimu_host::recording::{Quantity, Recording};
use wimu_host::{Code, Result, Severity};

use crate::common::Random;
use crate::common::public;

/// Reads bytes.
fn read(name: &str, bytes: &[u8], topic: Option<&str>) -> Result<Recording> {
    let source = Source::of_bytes(name, bytes);
    let mut options = ReadOptions::default();
    options.topic = topic.map(str::to_owned);
    let mut recording = Recording::new(source.name());
    recording.format = formats::read(&source, &options, &mut recording)?;
    Ok(recording)
}

/// Of each format; of a table the first rows are enough.
fn files() -> Vec<(String, Vec<u8>)> {
    let public = [
        "px4_cubeorange.ulg",
        "ardupilot_plane.BIN",
        "betaflight_omnibus.BFL",
        "betaflight_damaged.bbl",
        "ros1_imu_uwb.bag",
        "ros2_all_types/test_bag_mcap.mcap",
        "euroc_imu0.csv",
        "xsens_mt_manager_old.txt",
        "sensor_logger/Gyroscope.csv",
    ];
    let public = public.into_iter().filter_map(|name| public::file(&format!("formats/{name}")));
    let made = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/ros");
    let made = ["lz4.bag", "bz2.bag", "lz4_0.mcap", "zstd_1.mcap"].map(|name| made.join(name));
    let read = |path: PathBuf| {
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        let mut bytes = fs::read(path).unwrap();
        if name.ends_with(".csv") || name.ends_with(".txt") {
            bytes.truncate(20_000);
        }
        (name, bytes)
    };
    public.chain(made).map(read).collect()
}

#[test]
fn truncated_files_are_read_as_far_as_possible_and_flipped_bits_do_no_harm() {
    let mut random = Random::new(1);
    for (name, bytes) in files() {
        let rows = |bytes: &[u8]| {
            let recording = read(&name, bytes, None).ok()?;
            let track = recording.tracks().iter().map(|track| track.len()).max()?;
            Some(track)
        };
        let whole = rows(&bytes).unwrap();
        for part in 0..20 {
            let found = rows(&bytes[..bytes.len() * part / 20]);
            assert!(found.is_none_or(|found| found <= whole), "{name}, {part}");
        }
        for _ in 0..30 {
            let mut damaged = bytes.clone();
            damaged[random.below(bytes.len())] ^= 1 << random.below(8);
            let _ = read(&name, &damaged, None);
            let start = random.below(bytes.len());
            damaged.drain(start..(start + random.below(1000)).min(bytes.len()));
            let _ = read(&name, &damaged, None);
        }
    }
}

#[test]
fn rows_lost_by_a_flipped_bit_are_reported() {
    let Some(path) = public::file("formats/ros1_imu_uwb.bag") else { return };
    let file = fs::read(path).unwrap();
    let load_flipped = |bit: usize| {
        let mut damaged = file.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        let recording = read("flipped", &damaged, None).unwrap();
        let rows = recording.first(Quantity::SpecificForce).unwrap().len();
        (rows, recording.findings.iter().any(|found| found.severity != Severity::Note))
    };
    // The length of a record of another topic.
    assert_eq!(load_flipped(8 * 200_188 + 4), (727, true));
    // Some bits of some records and of the end of the index.
    let all = |bytes: std::ops::Range<usize>| (8 * bytes.start..8 * bytes.end).step_by(7);
    for bit in all(200_150..200_200).chain(all(file.len() - 100..file.len())) {
        let (rows, found) = load_flipped(bit);
        assert!(rows == 727 || found, "bit {bit}: {rows}");
        assert!(rows >= 600, "bit {bit}: {rows}");
    }
}

/// The table of a sensor, with one row.
const TABLE: &str =
    "Time (s),Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)\n0,0,0,1\n1,0,0,1\n";

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// Reads a file with this name and these bytes.
fn load(name: &str, bytes: &[u8]) -> Result<Recording> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    formats::load(&path, &ReadOptions::default())
}

#[test]
fn archives_are_folders_and_gzip_is_its_file() {
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, text) in [("b/Accelerometer.csv", TABLE), ("__MACOSX/._b", "z")] {
        writer.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        writer.write_all(text.as_bytes()).unwrap();
    }
    let bytes = writer.finish().unwrap().into_inner();
    for (name, bytes) in [("a.zip", &bytes), ("a.csv.gz", &gzip(TABLE.as_bytes()))] {
        let recording = load(name, bytes).unwrap();
        assert_eq!(recording.first(Quantity::SpecificForce).unwrap().len(), 2, "{name}");
    }
    for cut in [5, 40, bytes.len() - 3] {
        assert_eq!(load("a.zip", &bytes[..cut]).unwrap_err().code, Code::BadRecording);
    }
    // A bomb, of many equal parts.
    let bomb = gzip(&vec![0; 1 << 20]).repeat(257);
    let error = load("bomb.gz", &bomb).unwrap_err();
    assert!(error.text.contains("256 MB"), "{error}");
}
