//! Logs of flight controllers: what they say of themselves, and what is left of damaged ones.

use wimu_host::formats::{self, ReadOptions, Source};
use wimu_host::recording::{Origin, Quantity, Recording};
use wimu_host::{Code, Result};

use crate::common::public;

/// Reads bytes.
fn read_bytes(bytes: &[u8], topic: Option<&str>) -> Result<Recording> {
    let source = Source::of_bytes("file", bytes);
    let mut options = ReadOptions::default();
    options.topic = topic.map(str::to_owned);
    let mut recording = Recording::new(source.name());
    recording.format = formats::read(&source, &options, &mut recording)?;
    Ok(recording)
}

const BETAFLIGHT: &str = "formats/betaflight_omnibus.BFL";

const BETAFLIGHT_DAMAGED: &str = "formats/betaflight_damaged.bbl";

fn bytes(name: &str) -> Option<Vec<u8>> {
    Some(std::fs::read(public::file(name)?).expect("the file"))
}

/// A gap that may hide a frame: frames are left out up to the next I frame.
#[test]
fn frames_that_refer_to_a_lost_one_are_left_out() {
    let Some(bytes) = bytes(BETAFLIGHT) else { return };
    let whole = read_bytes(&bytes, None).unwrap();
    let whole: Vec<_> = whole.first(Quantity::SpecificForce).unwrap().vectors().collect();
    let mut damaged = bytes.clone();
    damaged[6000..6040].fill(0xAA);
    let recording = read_bytes(&damaged, None).unwrap();
    let rows: Vec<_> = recording.first(Quantity::SpecificForce).unwrap().vectors().collect();
    assert!((760..797).contains(&rows.len()), "{}", rows.len());
    assert!(rows.iter().all(|row| whole.contains(row)));
    let lost = recording.findings.iter().filter(|found| found.code == Code::Truncated);
    assert_eq!(lost.count(), 2, "{:?}", recording.findings);
}

#[test]
fn the_longest_log_is_read_unless_another_is_asked_for() {
    let (Some(long), Some(short)) = (bytes(BETAFLIGHT), bytes(BETAFLIGHT_DAMAGED)) else {
        return;
    };
    let file = [&short[..], &long, &short].concat();
    let rows = |topic| {
        let recording = read_bytes(&file, topic).unwrap();
        let rows = recording.first(Quantity::SpecificForce).unwrap().len();
        (rows, recording.findings[0].to_string())
    };
    let found = "read: log 2 (798 rows, 0.8 s); not read: log 1 (7 rows, 0.0 s), log 3 (7 rows, 0.0 s); \
                 `--topic \"log N\"` reads another";
    assert_eq!(rows(None), (798, found.to_owned()));
    assert_eq!(rows(Some("log 3")).0, 7);
    assert_eq!(rows(Some("1")).0, 7);
    let error = read_bytes(&file, Some("log 4")).unwrap_err();
    assert_eq!(error.code, Code::Usage);
}

/// A download of the whole memory ends with erased bytes.
#[test]
fn erased_memory_behind_a_log_is_left_out() {
    let Some(bytes) = bytes(BETAFLIGHT) else { return };
    let unfinished = [&bytes[..bytes.len() - 20], &[0xFF; 50_000]].concat();
    let recording = read_bytes(&unfinished, None).unwrap();
    let rows = recording.first(Quantity::SpecificForce).unwrap().len();
    assert_eq!(rows, 797, "{:?}", recording.findings);
}

/// At rest, the attitude rotates the specific force upwards.
#[test]
fn estimates_are_east_north_up() {
    let Some(bytes) = bytes("formats/px4_cubeorange.ulg") else { return };
    let recording = read_bytes(&bytes, None).unwrap();
    let attitude = recording.of(Quantity::Attitude).next().unwrap();
    assert_eq!(attitude.info.origin, Origin::Estimate);
    let (_, row) = attitude.valid().next().unwrap();
    let q = nalgebra::Quaternion::new(row[0], row[1], row[2], row[3]);
    let force = recording.first(Quantity::SpecificForce).unwrap();
    let (_, force) = force.vectors().next().unwrap();
    let up = nalgebra::UnitQuaternion::from_quaternion(q) * nalgebra::Vector3::from(force);
    assert!(up.z > 9.0, "{up}");
    // The filter has no horizontal position: those rows are invalid.
    let position = recording.of(Quantity::Position).next().unwrap();
    assert_eq!((position.len(), position.valid().count()), (636, 0));
}

#[test]
fn nested_formats_and_damage_are_passed_over() {
    let message = |kind: u8, content: &[u8]| {
        let mut bytes = (content.len() as u16).to_le_bytes().to_vec();
        bytes.push(kind);
        bytes.extend(content);
        bytes
    };
    let mut bytes = [b"ULog\x01\x12\x35".as_slice(), &[1; 9]].concat();
    bytes.extend(message(b'F', b"pair:float a;float[2] b;"));
    bytes.extend(message(
        b'F',
        b"sensor_accel:uint64_t timestamp;pair[2] p;float x;float y;float z;uint8_t[4] _padding0;",
    ));
    bytes.extend(message(b'F', b"endless:endless e;"));
    bytes.extend(message(b'A', b"\0\x05\0sensor_accel"));
    bytes.extend(message(b'A', b"\0\x06\0endless"));
    let data = |time_us: u64| {
        let mut content = 5_u16.to_le_bytes().to_vec();
        content.extend(time_us.to_le_bytes());
        content.extend([0; 24]);
        [1.0_f32, 2.0, 3.0].iter().for_each(|value| content.extend(value.to_le_bytes()));
        message(b'D', &content)
    };
    bytes.extend(data(1));
    bytes.extend(data(2));
    bytes.extend(&data(3)[..20]);
    bytes.extend(data(4));
    bytes.extend(&data(5)[..9]);
    let recording = read_bytes(&bytes, None).unwrap();
    let force = recording.first(Quantity::SpecificForce).unwrap();
    let rows: Vec<_> = force.vectors().collect();
    assert_eq!(rows, [1000, 2000, 4000].map(|time| (time, [1.0, 2.0, 3.0])));
    let found = recording.findings[0].to_string();
    assert!(
        found.starts_with("29 of ") && found.contains("in 2 places, the last at the end"),
        "{found}"
    );
}

/// A log of FMT messages and others.
#[derive(Default)]
struct Log(Vec<u8>);

impl Log {
    fn format(&mut self, id: u8, length: u8, name: &str, codes: &str, labels: &str) {
        let mut content = vec![id, length];
        for (text, width) in [(name, 4), (codes, 16), (labels, 64)] {
            content.extend(text.bytes().chain(std::iter::repeat(0)).take(width));
        }
        self.message(128, &content);
    }

    fn message(&mut self, id: u8, content: &[u8]) {
        self.0.extend([0xA3, 0x95, id]);
        self.0.extend(content);
    }

    fn read(&self, topic: Option<&str>) -> Result<Recording> {
        read_bytes(&self.0, topic)
    }
}

/// Newer logs: the field I has the instance, FMTU the units.
#[test]
fn instances_and_units_are_those_of_the_log() {
    let mut log = Log::default();
    log.format(1, 44, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds");
    log.format(2, 76, "UNIT", "QbZ", "TimeUS,Id,Label");
    log.format(3, 20, "MULT", "Qbd", "TimeUS,Id,Mult");
    log.format(4, 24, "GYR", "QBfff", "TimeUS,I,GyrX,GyrY,GyrZ");
    log.format(5, 18, "MAG", "QBhhh", "TimeUS,I,MagX,MagY,MagZ");
    let with_time = |time_us: u64, rest: &[u8]| [&time_us.to_le_bytes(), rest].concat();
    let text = |text: &str, width| -> Vec<u8> {
        text.bytes().chain(std::iter::repeat(0)).take(width).collect()
    };
    for (id, label) in [(b'k', "deg/s"), (b'G', "Gauss")] {
        log.message(2, &with_time(0, &[vec![id], text(label, 64)].concat()));
    }
    log.message(3, &with_time(0, &[&b"C"[..], &1e-3_f64.to_le_bytes()].concat()));
    for (of, units, multipliers) in [(4, "s#kkk", "F----"), (5, "s#GGG", "F-CCC")] {
        log.message(1, &with_time(0, &[vec![of], text(units, 16), text(multipliers, 16)].concat()));
    }
    let rates: Vec<u8> =
        [90_f32, 0.0, -180.0].iter().flat_map(|value| value.to_le_bytes()).collect();
    log.message(4, &with_time(7, &[&[2][..], &rates].concat()));
    let field: Vec<u8> = [200_i16, 0, -400].iter().flat_map(|value| value.to_le_bytes()).collect();
    log.message(5, &with_time(8, &[&[0][..], &field].concat()));

    let recording = log.read(None).unwrap();
    let rate = recording.first(Quantity::AngularRate).unwrap();
    let pi = std::f64::consts::PI;
    assert_eq!((rate.info.sensor, rate.info.name.as_str()), (2, "GYR[2]"));
    assert_eq!(rate.vectors().collect::<Vec<_>>(), [(7000, [pi / 2.0, 0.0, -pi])]);
    let field = recording.first(Quantity::MagneticField).unwrap();
    let (time_ns, [x, y, z]) = field.vectors().next().unwrap();
    assert_eq!(time_ns, 8000);
    assert!((x - 20e-6).abs() < 1e-12 && y == 0.0 && (z + 40e-6).abs() < 1e-12, "{x} {z}");
}

/// With more rows than IMU, ACC is read.
#[test]
fn the_message_with_more_rows_is_read() {
    let mut log = Log::default();
    log.format(4, 31, "ACC1", "QQfff", "TimeUS,SampleUS,AccX,AccY,AccZ");
    log.format(5, 19, "IMU", "Ifff", "TimeMS,AccX,AccY,AccZ");
    let axes: Vec<u8> = [0_f32, 0.0, -9.8].iter().flat_map(|value| value.to_le_bytes()).collect();
    for time in 0..3_u64 {
        let times = [(time + 10).to_le_bytes(), time.to_le_bytes()].concat();
        log.message(4, &[times, axes.clone()].concat());
    }
    log.message(5, &[&7_u32.to_le_bytes(), &axes[..]].concat());
    let recording = log.read(None).unwrap();
    let force = recording.first(Quantity::SpecificForce).unwrap();
    assert_eq!((force.times_ns(), force.info.name.as_str()), (&[0, 1000, 2000][..], "ACC1"));
    let found = recording.findings[0].to_string();
    assert_eq!(found, "read: ACC (3 rows); not read: IMU (1 row); `--topic IMU` reads IMU instead");
    let other = log.read(Some("IMU")).unwrap();
    assert_eq!(other.first(Quantity::SpecificForce).unwrap().times_ns(), [7_000_000]);
    assert_eq!(read_bytes(&log.0[..89], None).unwrap_err().code, Code::NoRows);
}
