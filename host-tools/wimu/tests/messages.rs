//! Messages to users who give a command the wrong input.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use kit::{Transcript, folder, noise, spread, wimu};

const XYZ: &str = "Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²)";

#[test]
fn files_of_other_programs_are_named_with_the_export_that_works() {
    let folder = folder();
    let starts: [(&[u8], &str); 12] = [
        (b"PK\x03\x04\x14\0", "ZIP"),
        (b"\x1f\x8b\x08\0", "gzip"),
        (b"\x28\xb5\x2f\xfd", "zstd"),
        (b"\x04\x22\x4d\x18", "lz4"),
        (b"PAR1\x15\0", "Parquet"),
        (b"#ROSBAG V2.0\nE\0", "ROS 1 bag"),
        (b"SQLite format 3\0", "ROS 2 bag"),
        (b"MATLAB 5.0 MAT-file, \xff", "MATLAB"),
        (b"\x89HDF\r\n\x1a\n", "HDF5"),
        (b"ULog\x01\x12\x35\x01", "PX4"),
        (b"\xa3\x95\x80\x80YFMT", "ArduPilot"),
        (b"H Product:Blackbox flight", "Betaflight"),
    ];
    let mut texts = Transcript::default();
    for (start, name) in starts {
        let path = folder.path().join("log.csv");
        fs::write(&path, [start, &[0xff, 0, b'\n', 0xfe]].concat()).unwrap();
        let path = path.to_str().unwrap();
        let ran = wimu(&["calibrate", path]);
        let failure = ran.error();
        let code = failure["code"].as_str().unwrap().to_owned();
        texts.fails(name, &ran, 2, &code);
        for command in ["allan", "navigate"] {
            assert_eq!(wimu(&[command, path]).error(), failure);
        }
    }
    texts.check("files_of_other_programs");
    // Real files, where they are present.
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/formats");
    for (file, name) in [
        ("ros1_imu_uwb.bag", "ROS 1"),
        ("px4_cubeorange.ulg", "PX4"),
        ("ardupilot_plane.BIN", "ArduPilot"),
        ("betaflight_omnibus.BFL", "Betaflight"),
    ] {
        let path = data.join(file);
        if !path.is_file() {
            eprintln!("skipped: {} is not there", path.display());
            continue;
        }
        let found = wimu(&["info", path.to_str().unwrap()]).succeeds();
        assert!(found["format"].as_str().unwrap().contains(name), "{found}");
    }
}

#[test]
fn poses_of_a_continuous_recording_are_refused() {
    let folder = folder();
    let path = folder.path().join("raw.csv");
    let mut noise = noise();
    let mut table = |rows: u32, step_s: f64| {
        let mut text = format!("Time (s),{XYZ}\n");
        for (k, up) in (0..rows).zip(spread(20).iter().cycle()) {
            let [x, y, z] = up.map(|f| 9.8 * f + 0.01 * noise());
            writeln!(text, "{:.3},{x},{y},{z}", f64::from(k) * step_s).unwrap();
        }
        fs::write(&path, text).unwrap();
        wimu(&["calibrate", path.to_str().unwrap(), "--poses"])
    };
    let mut texts = Transcript::default();
    for (rows, step_s) in [(101, 0.01), (101, 0.19)] {
        let case = format!("{rows} rows, {step_s} s apart");
        texts.fails(case, &table(rows, step_s), 2, "usage");
    }
    texts.check("calibrate_poses_of_a_recording");
    for (rows, step_s) in [(100, 0.01), (101, 0.21), (1001, 5.0)] {
        let ran = table(rows, step_s);
        assert!(ran.code != 2, "{rows} {step_s}: {ran:?}");
    }
}

#[test]
fn a_magnetometer_that_is_not_calibrated_is_not_called_absent() {
    let folder = folder();
    let path = folder.path().join("walk.csv");
    let mut noise = noise();
    let field = "Magnetometer X (µT),Magnetometer Y (µT),Magnetometer Z (µT)";
    let mut texts = Transcript::default();
    for (calibrated, case) in
        [("0", "not calibrated"), ("1", "calibrated"), ("", "no magnetometer")]
    {
        let mut text = format!("Time (s),{XYZ},{field},Field Calibrated\n");
        for k in 0..600 {
            let mut n = || 0.01 * noise();
            let [x, y, z] = [n(), n(), 9.80665 + n()];
            let field = match calibrated {
                "" => ",,".to_owned(),
                _ => format!("{},{},{}", 20.0 + n(), n(), -40.0 + n()),
            };
            writeln!(text, "{:.2},{x},{y},{z},{field},{calibrated}", f64::from(k) * 0.01).unwrap();
        }
        fs::write(&path, text).unwrap();
        let ran = wimu(&["navigate", path.to_str().unwrap()]);
        texts.findings(case, &ran);
    }
    texts.check("navigate_magnetometer");
}
