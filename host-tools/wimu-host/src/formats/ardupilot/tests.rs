use super::super::tests::{assert_figures, assert_robust, file, read_bytes};
use crate::error::ErrorCode;
use crate::finding::FindingCode;
use crate::recording::{Quantity, Recording};

const FILE: &str = "ardupilot_plane.BIN";

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

    fn read(&self, topic: Option<&str>) -> crate::Result<Recording> {
        read_bytes(&self.0, topic)
    }
}

#[test]
fn figures_agree_with_pymavlink() {
    let Some(path) = file(FILE) else { return };
    let recording = super::super::load(&path, &Default::default()).unwrap();
    assert_figures(&recording, FILE, "IMU", 0);
    assert_figures(&recording, FILE, "IMU2", 1);
    let truncated = &recording.findings[0];
    assert_eq!(truncated.code, FindingCode::Truncated);
    let text = truncated.to_string();
    assert!(text.contains("24 of 65536 bytes") && text.contains("the end of the file"), "{text}");
    let field = recording.first(Quantity::MagneticField).unwrap();
    let (_, [x, y, z]) = field.vectors().next().unwrap();
    let norm = (x * x + y * y + z * z).sqrt();
    assert!((20e-6..80e-6).contains(&norm), "{norm} T");
    assert_eq!(recording.of(Quantity::MagneticField).count(), 3);
    // On the ground, the attitude rotates the specific force upwards.
    let attitude = recording.of(Quantity::Attitude).next().unwrap();
    let (_, q) = attitude.valid().next().unwrap();
    let q = nalgebra::Quaternion::new(q[0], q[1], q[2], q[3]);
    let (_, force) = recording.first(Quantity::SpecificForce).unwrap().vectors().next().unwrap();
    let up = nalgebra::UnitQuaternion::from_quaternion(q) * nalgebra::Vector3::from(force);
    assert!(up.z > 9.7, "{up}");
    assert_eq!(recording.of(Quantity::Position).next().unwrap().valid().count(), 24);

    let bytes = std::fs::read(&path).unwrap();
    let one = read_bytes(&bytes, Some("IMU2")).unwrap();
    assert_eq!(one.of(Quantity::SpecificForce).count(), 1);
    assert_figures(&one, FILE, "IMU2", 1);
    let error = read_bytes(&bytes, Some("ACC")).unwrap_err();
    assert!(error.remedy().contains("IMU (2 instances, 45 rows)"), "{error}");
}

#[test]
fn damaged_files_are_read_or_refused() {
    assert_robust(FILE);
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
    assert_eq!(read_bytes(&log.0[..89], None).unwrap_err().code(), ErrorCode::NoRows);
}
