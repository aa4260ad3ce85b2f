use super::super::tests::{assert_figures, assert_robust, file, read_bytes};
use crate::error::ErrorCode;
use crate::finding::FindingCode;
use crate::recording::{Origin, Quantity, Recording};

const FILE: &str = "px4_cubeorange.ulg";

fn codes(recording: &Recording) -> Vec<FindingCode> {
    recording.findings.iter().map(|finding| finding.code).collect()
}

#[test]
fn figures_agree_with_pyulog() {
    let Some(path) = file(FILE) else { return };
    let bytes = std::fs::read(path).unwrap();
    let recording = read_bytes(&bytes, None).unwrap();
    assert_figures(&recording, FILE, "sensor_combined", 0);
    let expected =
        [FindingCode::Rate, FindingCode::TrackChosen, FindingCode::TrackChosen, FindingCode::Clock];
    assert_eq!(codes(&recording), expected);
    let rates = recording.first(Quantity::AngularRate).unwrap();
    assert_eq!(rates.len(), 1298);
    let field = recording.first(Quantity::MagneticField).unwrap();
    let (_, [x, y, z]) = field.vectors().next().unwrap();
    let norm = (x * x + y * y + z * z).sqrt();
    assert!((20e-6..80e-6).contains(&norm), "{norm} T, {}", field.len());

    let raw = read_bytes(&bytes, Some("sensor_accel")).unwrap();
    for sensor in 0..3 {
        assert_figures(&raw, FILE, &format!("sensor_accel[{sensor}]"), sensor);
    }
    assert_eq!(raw.of(Quantity::AngularRate).count(), 3);
    assert_eq!(raw.of(Quantity::Temperature).count(), 3);
    let one = read_bytes(&bytes, Some("sensor_accel[1]")).unwrap();
    assert_figures(&one, FILE, "sensor_accel[1]", 1);
    assert_eq!(one.of(Quantity::SpecificForce).count(), 1);
    let error = read_bytes(&bytes, Some("sensor_accel[7]")).unwrap_err();
    assert_eq!(error.code(), ErrorCode::Usage);
    assert!(error.remedy().contains("sensor_accel (3 instances, 6 rows)"), "{error}");
}

/// At rest, the attitude rotates the specific force upwards.
#[test]
fn estimates_are_east_north_up() {
    let Some(path) = file(FILE) else { return };
    let recording = read_bytes(&std::fs::read(path).unwrap(), None).unwrap();
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
fn damaged_files_are_read_or_refused() {
    assert_robust(FILE);
}

#[test]
fn nested_formats_and_damage_are_passed_over() {
    let message = |kind: u8, content: &[u8]| {
        let mut bytes = (content.len() as u16).to_le_bytes().to_vec();
        bytes.push(kind);
        bytes.extend(content);
        bytes
    };
    let mut bytes = [super::ulog::MAGIC.as_slice(), &[1; 9]].concat();
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

#[test]
fn a_file_without_inertial_data_names_its_topics() {
    let bytes = [super::ulog::MAGIC.as_slice(), &[1; 9]].concat();
    let error = read_bytes(&bytes, None).unwrap_err();
    assert_eq!(error.code(), ErrorCode::NoRows);
    assert_eq!(read_bytes(&[], None).unwrap_err().code(), ErrorCode::CsvEmpty);
}
