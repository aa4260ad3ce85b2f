//! Folders and archives that phones export.

use super::{check, data, has, loaded, text};
use crate::finding::FindingCode;
use crate::formats::{ReadOptions, Source};
use crate::recording::{Quantity, Recording};

#[test]
fn gravity_of_sensor_logger_is_added() {
    let Some(recording) = loaded("formats/sensor_logger", &ReadOptions::default()) else {
        return;
    };
    assert!(
        has(&recording, FindingCode::GravityAdded) && !has(&recording, FindingCode::GravityMissing)
    );
    let force = recording.first(Quantity::SpecificForce).unwrap();
    let [x, y, z] = force.vectors().next().unwrap().1;
    assert!(
        (x + 1.278_503_61).abs() < 1e-6
            && (y + 1.070_806_62).abs() < 1e-6
            && (z + 9.768_940_74).abs() < 1e-6
    );
    assert_eq!(force.valid().count(), 1000);
    check(
        "sensor_logger/Gyroscope.csv",
        "gyroscope",
        recording.first(Quantity::AngularRate).unwrap(),
    );
    // Means over poses average to nothing, and have gravity.
    if let Some(means) = loaded("calibration/innalabs_49_pose_means.csv", &ReadOptions::default()) {
        assert_eq!(means.first(Quantity::SpecificForce).unwrap().len(), 49);
    }
    // In columns of one table, too.
    let both = "Time (s),Linear Acceleration x (m/s^2),Linear Acceleration y (m/s^2),Linear Acceleration z (m/s^2),\
                Gravity x (m/s^2),Gravity y (m/s^2),Gravity z (m/s^2)\n0,1,2,3,0,0,9.8\n0.1,1,2,3,0,0,9.8\n";
    let recording = text(both).unwrap();
    assert_eq!(
        recording.first(Quantity::SpecificForce).unwrap().row(1),
        Some(&[1.0, 2.0, 12.8][..])
    );
}

#[test]
fn archives_of_phones_are_read() {
    use std::io::Write;

    let Some(folder) = data("formats/sensor_logger") else {
        return;
    };
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        writer.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        writer.write_all(&std::fs::read(path).unwrap()).unwrap();
    }
    let bytes = writer.finish().unwrap().into_inner();
    let archive = crate::formats::archive::unpacked(&Source::of_bytes("walk.zip", bytes));
    let mut recording = Recording::new("walk.zip");
    crate::formats::read(&archive.unwrap().unwrap(), &ReadOptions::default(), &mut recording)
        .unwrap();
    assert!(has(&recording, FindingCode::GravityAdded));
    check("sensor_logger/Gravity.csv", "gravity", recording.of(Quantity::Gravity).next().unwrap());
}
