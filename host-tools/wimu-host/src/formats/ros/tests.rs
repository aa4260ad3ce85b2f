use std::path::{Path, PathBuf};

use super::*;
use crate::formats::read;
use crate::recording::{Recording, Track};

const CRATE: &str = env!("CARGO_MANIFEST_DIR");
/// Of the bags that `tests/data/ros/make.py` writes.
const START_NS: i64 = 1_700_000_000_000_000_000;

/// A file of the public recordings; `None` where they are absent.
fn public(name: &str) -> Option<PathBuf> {
    let folder = Path::new(CRATE).join("../../../shared/data/formats");
    let path = folder.join(name);
    if !path.exists() {
        println!("skipped: {name} of the public recordings, ../shared/data, is absent");
    }
    path.exists().then_some(path)
}

fn made(name: &str) -> Source {
    Source::open(&Path::new(CRATE).join("tests/data/ros").join(name)).unwrap()
}

fn load(source: &Source, options: &ReadOptions) -> Result<Recording> {
    let mut recording = Recording::new(source.name());
    recording.format = read(source, options, &mut recording)?;
    Ok(recording)
}

fn track<'a>(recording: &'a Recording, name: &str, quantity: Quantity) -> &'a Track {
    let named = |track: &&Track| track.info.name == name && track.info.quantity == quantity;
    recording.tracks().iter().find(named).unwrap()
}

fn is_near(value: f64, expected: f64) -> bool {
    (value - expected).abs() <= 1e-6 * expected.abs()
}

/// Compares the specific force with the figures of another reader.
fn check(name: &str) {
    let (Some(path), Some(checks)) = (public(name), public("checks.csv")) else {
        return;
    };
    let checks = std::fs::read_to_string(checks).unwrap();
    let line = checks.lines().find(|line| line.starts_with(&format!("{name},")));
    let fields: Vec<&str> = line.unwrap().split(',').collect();
    let expected: Vec<f64> = fields[3..13].iter().map(|field| field.parse().unwrap()).collect();
    let recording = load(&Source::open(&path).unwrap(), &ReadOptions::default()).unwrap();
    let force = recording.first(Quantity::SpecificForce).unwrap();
    let rows: Vec<(i64, [f64; 3])> = force.vectors().collect();
    let (first, last) = (rows[0], rows[rows.len() - 1]);
    let norm = |row: &(i64, [f64; 3])| row.1.iter().map(|v| v * v).sum::<f64>().sqrt();
    let mean = rows.iter().map(norm).sum::<f64>() / rows.len() as f64;
    let figures = [
        rows.len() as f64,
        (first.0 % 1_000_000_000) as f64 * 1e-9,
        // Rounded there to 1 µs.
        ((last.0 - first.0 + 500) / 1000) as f64 * 1e-6,
    ];
    let figures = figures.iter().chain(&first.1).chain(&last.1).chain([&mean]);
    for (figure, expected) in figures.zip(expected) {
        assert!(is_near(*figure, expected), "{name}: {figure} for {expected}");
    }
    assert_eq!((force.info.name.as_str(), force.info.unit), (fields[1], Unit::Si));
    assert!(recording.first(Quantity::AngularRate).is_some());
    assert!(recording.of(Quantity::Attitude).count() > 0);
    assert_eq!(recording.findings, []);
}

#[test]
fn figures_of_another_reader() {
    check("ros1_imu_uwb.bag");
    check("ros2_all_types");
}

#[test]
fn a_bag_without_imu_messages_is_refused_with_its_topics() {
    let Some(path) = public("ros1_no_imu.bag") else {
        return;
    };
    let error = load(&Source::open(&path).unwrap(), &ReadOptions::default()).unwrap_err();
    assert_eq!(error.code(), ErrorCode::NoRows);
    assert_eq!(
        error.message(),
        "no inertial data in sensor_msgs/Imu can be read among /tf (tf2_msgs/TFMessage, 517 messages), /tf_static \
         (tf2_msgs/TFMessage, 1 message)"
    );
    #[cfg(feature = "sqlite")]
    {
        let path = path.with_file_name("ros2_no_imu");
        let again = load(&Source::open(&path).unwrap(), &ReadOptions::default());
        assert_eq!(again.unwrap_err().message(), error.message());
    }
}

#[test]
#[cfg(feature = "sqlite")]
fn a_bag_in_sqlite_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bag_0.db3");
    let bag = rusqlite::Connection::open(&path).unwrap();
    bag.execute_batch(
        "CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, offered_qos_profiles TEXT);
         CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
         INSERT INTO topics VALUES (1, '/imu/data', 'sensor_msgs/msg/Imu', 'cdr', '')",
    )
    .unwrap();
    for k in 0..50 {
        let stamp_ns = START_NS + 10_000_000 * k;
        let fields = crate::ros::imu([0.125 * k as f64, -0.5, 9.75], Some([0.25, 0.0, 0.5]), None);
        let message =
            crate::ros::message::Message::new().header(stamp_ns as u64, "imu").numbers(&fields);
        let row = rusqlite::params![stamp_ns, message.bytes()];
        bag.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?1, ?2)", row)
            .unwrap();
    }
    drop(bag);
    let recording = load(&Source::open(&path).unwrap(), &ReadOptions::default()).unwrap();
    assert_eq!(recording.format, "ROS 2 sqlite");
    let rows: Vec<_> = track(&recording, "/imu/data", Quantity::SpecificForce).vectors().collect();
    assert_eq!(rows.len(), 50);
    assert_eq!(rows[49], (START_NS + 490_000_000, [0.125 * 49.0, -0.5, 9.75]));
    let rate = track(&recording, "/imu/data", Quantity::AngularRate);
    assert_eq!(rate.row(7), Some(&[0.25, 0.0, 0.5][..]));
    check("ros2_all_types_db3");
}

#[test]
#[cfg(not(feature = "sqlite"))]
fn a_bag_in_sqlite_is_refused_with_the_conversion() {
    let source = Source::of_bytes("bag.db3", *b"SQLite format 3\0");
    let error = load(&source, &ReadOptions::default()).unwrap_err();
    assert_eq!(error.code(), ErrorCode::FeatureMissing);
    assert!(error.remedy().contains("rosbags-convert"), "{error}");
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
    let codes: Vec<FindingCode> = recording.findings.iter().map(|found| found.code).collect();
    assert_eq!(codes, [FindingCode::TrackChosen]);
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

#[test]
fn a_topic_is_selected() {
    let select = |topic: &str| {
        let options = ReadOptions { topic: Some(topic.to_owned()), ..ReadOptions::default() };
        load(&made("lz4.bag"), &options)
    };
    let recording = select("/front/imu").unwrap();
    assert_eq!(recording.of(Quantity::SpecificForce).count(), 1);
    let force = recording.first(Quantity::SpecificForce).unwrap();
    assert_eq!((force.info.name.as_str(), force.info.sensor), ("/front/imu", 0));
    let error = select("/imu/mag").unwrap_err();
    assert_eq!(error.code(), ErrorCode::Usage);
    assert!(error.remedy().contains("/imu/data (sensor_msgs/Imu, 80 messages)"), "{error}");
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
    let mut file = ::mcap::MAGIC.to_vec();
    file.push(::mcap::records::op::CHUNK);
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
        assert_eq!(error.code(), ErrorCode::BadRecording);
        assert!(error.message().contains(reason), "{error}");
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
    let count = FIRST_MESSAGES as u32 + 8;
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
        let found: Vec<FindingCode> = recording.findings.iter().map(|f| f.code).collect();
        // The index is missing.
        assert_eq!(found[0], FindingCode::Truncated);
        assert_eq!(found[1..].contains(&FindingCode::Clock), by_log);
    }
    let both = [bag_with_stamps("/a", &[5, 6]), bag_with_stamps("/bb", &[900, 901])];
    let bytes = [&b"#ROSBAG V2.0\n"[..], &both[0], &both[1]].concat();
    let recording = load(&Source::of_bytes("b.bag", bytes), &ReadOptions::default()).unwrap();
    let clock = recording.findings.last().unwrap();
    assert_eq!(clock.evidence, "the clocks of /a and /bb differ by 895 s");
}

/// Files of all containers, and how often to damage each.
fn fuzzed() -> Vec<Vec<u8>> {
    let mut files: Vec<PathBuf> = ["lz4.bag", "bz2.bag", "lz4_0.mcap", "zstd_1.mcap"]
        .map(|name| Path::new(CRATE).join("tests/data/ros").join(name))
        .into();
    files.extend(public("ros1_imu_uwb.bag"));
    files.extend(public("ros1_no_imu.bag"));
    files.extend(public("ros2_all_types/test_bag_mcap.mcap"));
    #[cfg(feature = "sqlite")]
    files.extend(public("ros2_all_types_db3/test_bag_sqlite3.db3"));
    files.iter().map(|path| std::fs::read(path).unwrap()).collect()
}

#[test]
fn truncated_files_are_read_as_far_as_possible() {
    for file in fuzzed() {
        let rows_of = |bytes: &[u8]| {
            let recording = load(&Source::of_bytes("cut", bytes), &ReadOptions::default()).ok()?;
            let cut = |found: &Finding| found.code == FindingCode::Truncated;
            let rows = recording.first(Quantity::SpecificForce)?.len();
            Some((rows, recording.findings.iter().any(cut)))
        };
        let whole = rows_of(&file);
        let mut previous = 0;
        for k in 0..100 {
            let rows = rows_of(&file[..file.len() * k / 100]);
            if let (Some((rows, cut)), Some((all, _))) = (rows, whole) {
                assert!(previous <= rows && rows <= all && (cut || rows == all), "{k}: {rows}");
                previous = rows;
            }
        }
        assert!(whole.is_none() || 2 * previous > whole.unwrap().0, "{previous}");
    }
}

#[test]
fn big_endian_messages_and_times_before_1970() {
    let mut data = vec![0, 0, 0, 0];
    data.extend((-2_i32).to_be_bytes());
    data.extend(500_000_000_u32.to_be_bytes());
    // An empty name, its terminator, and padding to a multiple of 8 bytes.
    data.extend([0, 0, 0, 1, 0, 0, 0, 0]);
    data.resize(4 + 16, 0);
    data.extend(21.5_f64.to_be_bytes());
    data.extend(0.25_f64.to_be_bytes());
    let kind = message::kind("sensor_msgs/Temperature").unwrap();
    let decoded = message::decode(kind, Encoding::Cdr, &data).unwrap();
    assert_eq!(decoded, (-1_500_000_000, vec![21.5, 0.25]));
    assert!(message::decode(kind, Encoding::Cdr, &data[..data.len() - 1]).is_none());
}

#[test]
fn flipped_bits_do_no_harm() {
    let mut random = 1_u64;
    for file in fuzzed() {
        for _ in 0..200 {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let bit = (random >> 33) as usize % (8 * file.len());
            let mut damaged = file.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            let _ = load(&Source::of_bytes("flipped", damaged), &ReadOptions::default());
        }
    }
}

#[test]
fn rows_lost_by_a_flipped_bit_are_reported() {
    let Some(path) = public("ros1_imu_uwb.bag") else {
        return;
    };
    let file = std::fs::read(path).unwrap();
    let load_flipped = |bit: usize| {
        let mut damaged = file.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        let source = Source::of_bytes("flipped", damaged);
        let recording = load(&source, &ReadOptions::default()).ok()?;
        let rows = recording.first(Quantity::SpecificForce)?.len();
        let severe = |found: &Finding| found.severity != crate::finding::Severity::Note;
        Some((rows, recording.findings.iter().any(severe)))
    };
    // The length of a record of another topic.
    assert_eq!(load_flipped(8 * 200_188 + 4), Some((727, true)));
    let mut random = 1_u64;
    let random = std::iter::repeat_with(|| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (random >> 33) as usize % (8 * file.len())
    });
    // Every bit of some records and of the end of the index.
    let all = |bytes: std::ops::Range<usize>| 8 * bytes.start..8 * bytes.end;
    let bits = all(200_150..200_200).chain(all(file.len() - 100..file.len()));
    let (mut refused, mut fewest) = (0, 727);
    for bit in random.take(200).chain(bits) {
        match load_flipped(bit) {
            Some((rows, found)) => {
                assert!(rows == 727 || found, "bit {bit}: {rows}");
                fewest = fewest.min(rows);
            }
            None => refused += 1,
        }
    }
    // A length that ends at a later record by chance hides those between.
    assert!(refused == 0 && fewest >= 600, "{refused}, {fewest}");
}

#[test]
fn an_empty_file_is_refused() {
    for read in [bag::read, mcap::read] {
        let mut sink = Recording::new("empty");
        let empty = Source::of_bytes("empty", []);
        assert!(read(&empty, &ReadOptions::default(), &mut sink).is_err());
        assert!(load(&empty, &ReadOptions::default()).is_err());
    }
}
