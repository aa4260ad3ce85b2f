//! Bags of ROS: compression, clocks, and chunks that are not what they say.

use std::collections::BTreeMap;
use std::io::{Cursor, Read};
use std::path::Path;

#[cfg(feature = "sqlite")]
use crate::common::public;
use wimu_host::formats::{self, ReadOptions, Source};
use wimu_host::recording::{Quantity, Recording, Track};
use wimu_host::{Code, Result};

const CRATE: &str = env!("CARGO_MANIFEST_DIR");

/// Of the bags that `tests/data/ros/make.py` writes.
const START_NS: i64 = 1_700_000_000_000_000_000;

fn made(name: &str) -> Source {
    Source::open(&Path::new(CRATE).join("tests/data/ros").join(name)).unwrap()
}

fn load(source: &Source, options: &ReadOptions) -> Result<Recording> {
    let mut recording = Recording::new(source.name());
    recording.format = formats::read(source, options, &mut recording)?;
    Ok(recording)
}

fn track<'a>(recording: &'a Recording, name: &str, quantity: Quantity) -> &'a Track {
    let named = |track: &&Track| track.info.name == name && track.info.quantity == quantity;
    recording.tracks().iter().find(named).unwrap()
}

fn is_near(value: f64, expected: f64) -> bool {
    (value - expected).abs() <= 1e-6 * expected.abs()
}

/// Compares with what `make.py` writes.
fn check_made(recording: &Recording, count: usize) {
    let rows = |name, quantity| {
        let track = track(recording, name, quantity);
        assert_eq!(track.len(), count, "{name} {quantity:?}");
        track.valid().enumerate()
    };
    for (sensor, name) in ["/imu/data", "/front/imu"].into_iter().enumerate() {
        for (k, (time_ns, force)) in rows(name, Quantity::SpecificForce) {
            assert_eq!(time_ns, START_NS + 10_000_000 * k as i64);
            assert_eq!(force, [0.125 * k as f64, -0.5, 9.75]);
        }
        let info = &track(recording, name, Quantity::SpecificForce).info;
        assert_eq!(usize::from(info.sensor), sensor);
    }
    for (k, (_, rate)) in rows("/imu/data", Quantity::AngularRate) {
        assert_eq!(rate, [0.25, -0.0625 * k as f64, 0.5]);
    }
    for (_, (_, attitude)) in rows("/imu/data", Quantity::Attitude) {
        assert_eq!(attitude, [0.8, 0.6, 0.0, 0.0]);
    }
    for (k, (_, field)) in rows("/imu/mag", Quantity::MagneticField) {
        assert!(is_near(field[1], -1e-6 * k as f64));
    }
    for (k, (_, temperature)) in rows("/imu/temperature", Quantity::Temperature) {
        assert_eq!(temperature, [20.0 + 0.5 * k as f64]);
    }
    // The other Imu topic marks angular velocity and orientation as absent.
    assert_eq!(recording.tracks().len(), 6);
    let codes: Vec<Code> = recording.findings.iter().map(|found| found.code).collect();
    assert_eq!(codes, [Code::TrackChosen]);
}

#[test]
fn compressed_ros1_bags() {
    for name in ["lz4.bag", "bz2.bag"] {
        check_made(&load(&made(name), &ReadOptions::default()).unwrap(), 80);
    }
}

#[test]
fn a_folder_of_compressed_mcap_files_is_one_recording() {
    let metadata = Source::of_bytes("metadata.yaml", *b"rosbag2_bagfile_information:");
    let split = [made("zstd_1.mcap"), metadata, made("lz4_0.mcap")];
    // Names differ in length only by the number of the file.
    let file = |name: &str, source: &Source| {
        let mut bytes = Vec::new();
        source.reader().unwrap().read_to_end(&mut bytes).unwrap();
        Source::of_bytes(name, bytes)
    };
    let split =
        vec![file("imu_10.mcap", &split[0]), split[1].clone(), file("imu_9.mcap", &split[2])];
    let folder = Source::of_members("imu", split);
    check_made(&load(&folder, &ReadOptions::default()).unwrap(), 80);
}

/// An MCAP file of one chunk whose stored records are `stored`.
fn mcap_of_chunk(compression: &str, size: u64, stored: &[u8]) -> Source {
    let mut chunk = vec![0; 16];
    chunk.extend(size.to_le_bytes());
    chunk.extend([0; 4]);
    chunk.extend((compression.len() as u32).to_le_bytes());
    chunk.extend(compression.as_bytes());
    chunk.extend((stored.len() as u64).to_le_bytes());
    chunk.extend(stored);
    let mut file = mcap::MAGIC.to_vec();
    file.push(mcap::records::op::CHUNK);
    file.extend((chunk.len() as u64).to_le_bytes());
    file.extend(chunk);
    Source::of_bytes("chunk.mcap", file)
}

#[test]
fn chunks_of_wrong_sizes_are_refused() {
    let level = ruzstd::encoding::CompressionLevel::Fastest;
    let bomb = ruzstd::encoding::compress_to_vec(&[0_u8; 1 << 20][..], level);
    for (compression, size, reason) in [
        ("zstd", u64::MAX, "is above 256 MB"),
        ("zstd", 1000, "does not decompress to its 1000 bytes"),
        ("zstd", 1 << 21, "does not decompress to its 2097152 bytes"),
        ("lz4", 1 << 20, "its compression is damaged"),
        ("xz", 1 << 20, "its compression `xz` is not known"),
    ] {
        let source = mcap_of_chunk(compression, size, &bomb);
        let error = load(&source, &ReadOptions::default()).unwrap_err();
        assert_eq!(error.code, Code::BadRecording);
        assert!(error.text.contains(reason), "{error}");
    }
}

/// A bag of ROS 1 with Imu messages of these header stamps, logged every 10 ms, whose index is missing.
fn bag_with_stamps(topic: &str, stamps_s: &[u32]) -> Vec<u8> {
    fn sized(out: &mut Vec<u8>, bytes: &[u8]) {
        out.extend((bytes.len() as u32).to_le_bytes());
        out.extend(bytes);
    }
    fn record(out: &mut Vec<u8>, fields: &[(&str, &[u8])], data: &[u8]) {
        let mut header = Vec::new();
        for (name, value) in fields {
            sized(&mut header, &[name.as_bytes(), b"=", value].concat());
        }
        sized(out, &header);
        sized(out, data);
    }
    let mut bag = Vec::new();
    let mut kind = Vec::new();
    sized(&mut kind, b"type=sensor_msgs/Imu");
    let conn = (topic.len() as u32).to_le_bytes();
    let head: [(&str, &[u8]); 3] = [("op", &[7]), ("conn", &conn), ("topic", topic.as_bytes())];
    record(&mut bag, &head, &kind);
    for (k, stamp) in stamps_s.iter().enumerate() {
        let mut message = vec![0; 4];
        message.extend(stamp.to_le_bytes());
        message.extend([0; 8]);
        message.extend([0; 37 * 8]);
        let time = [1000_u32.to_le_bytes(), (k as u32 * 10_000_000).to_le_bytes()].concat();
        record(&mut bag, &[("op", &[2]), ("conn", &conn), ("time", &time)], &message);
    }
    bag
}

#[test]
fn unusable_header_stamps_are_replaced_by_log_times() {
    // More than decide which times are used.
    let count = 32 + 8;
    for (stamps, by_log) in [
        (vec![0; count as usize], true),
        (vec![7; count as usize], true),
        ((1..=count).collect::<Vec<u32>>(), false),
        (vec![5, 6], false),
    ] {
        let bytes = [b"#ROSBAG V2.0\n".to_vec(), bag_with_stamps("/a", &stamps)].concat();
        let recording = load(&Source::of_bytes("a.bag", bytes), &ReadOptions::default()).unwrap();
        let force = recording.first(Quantity::SpecificForce).unwrap();
        assert_eq!(force.len(), stamps.len());
        // The quaternion is zero.
        assert_eq!(recording.of(Quantity::Attitude).count(), 0);
        let first = if by_log { 1000 } else { i64::from(stamps[0]) };
        assert_eq!(force.times_ns()[0], first * 1_000_000_000);
        let found: Vec<Code> = recording.findings.iter().map(|f| f.code).collect();
        // The index is missing.
        assert_eq!(found[0], Code::Truncated);
        assert_eq!(found[1..].contains(&Code::Clock), by_log);
    }
    let both = [bag_with_stamps("/a", &[5, 6]), bag_with_stamps("/bb", &[900, 901])];
    let bytes = [&b"#ROSBAG V2.0\n"[..], &both[0], &both[1]].concat();
    let recording = load(&Source::of_bytes("b.bag", bytes), &ReadOptions::default()).unwrap();
    let clock = recording.findings.last().unwrap();
    assert_eq!(clock.text, "the clocks of /a and /bb differ by 895 s");
}

#[test]
fn big_endian_messages_and_times_before_1970() {
    let mut file =
        mcap::WriteOptions::new().profile("ros2").create(Cursor::new(Vec::new())).unwrap();
    let schema = file.add_schema("sensor_msgs/msg/Imu", "ros2msg", b"").unwrap();
    let channel = file.add_channel(schema, "/imu", "cdr", &BTreeMap::new()).unwrap();
    for sequence in 0..4_u32 {
        let mut data = vec![0, 0, 0, 0];
        data.extend((-2_i32).to_be_bytes());
        data.extend((500_000_000 + 10_000_000 * sequence).to_be_bytes());
        // An empty name, its terminator, and padding to a multiple of 8 bytes.
        data.extend([0, 0, 0, 1, 0, 0, 0, 0]);
        data.resize(4 + 16, 0);
        // Orientation, angular velocity and acceleration with their covariances.
        let numbers = (0..37).map(|k| if k >= 25 { 0.25 * f64::from(k) } else { 0.0 });
        numbers.for_each(|number| data.extend(number.to_be_bytes()));
        let time = u64::from(sequence);
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence,
            log_time: time,
            publish_time: time,
        };
        file.write_to_known_channel(&header, &data).unwrap();
    }
    file.finish().unwrap();
    let source = Source::of_bytes("a.mcap", file.into_inner().into_inner());
    let recording = load(&source, &ReadOptions::default()).unwrap();
    let force = recording.first(Quantity::SpecificForce).unwrap();
    assert_eq!(force.vectors().next(), Some((-1_500_000_000, [6.25, 6.5, 6.75])));
}

#[test]
#[cfg(feature = "sqlite")]
fn a_bag_in_sqlite_has_the_rows_of_the_same_one_in_mcap() {
    let names = ["formats/ros2_all_types", "formats/ros2_all_types_db3"];
    let [Some(mcap), Some(sqlite)] = names.map(public::file) else { return };
    let rows = [mcap, sqlite].map(|path| {
        let recording = formats::load(&path, &ReadOptions::default()).unwrap();
        let force = recording.first(Quantity::SpecificForce).unwrap();
        force.vectors().map(|(_, force)| force).collect::<Vec<_>>()
    });
    assert_eq!(rows[0], rows[1]);
}
