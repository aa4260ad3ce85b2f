//! What people are told who give a command the wrong thing.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use kit::{folder, noise, spread, wimu};

const XYZ: &str = "Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²)";

#[test]
fn files_of_other_programs_are_named_with_the_export_that_works() {
    let folder = folder();
    let starts: [(&[u8], &str, &str); 12] = [
        (b"PK\x03\x04\x14\0", "ZIP", "unpack"),
        (b"\x1f\x8b\x08\0", "gzip", "gunzip"),
        (b"\x28\xb5\x2f\xfd", "zstd", "zstd -d"),
        (b"\x04\x22\x4d\x18", "lz4", "lz4 -d"),
        (b"PAR1\x15\0", "Parquet", "read_parquet"),
        (b"#ROSBAG V2.0\nE\0", "ROS 1 bag", "rostopic"),
        (b"SQLite format 3\0", "ROS 2 bag", "Imu topic"),
        (b"MATLAB 5.0 MAT-file, \xff", "MATLAB", "writetable"),
        (b"\x89HDF\r\n\x1a\n", "HDF5", "to_csv"),
        (b"ULog\x01\x12\x35\x01", "PX4", "ulog2csv"),
        (b"\xa3\x95\x80\x80YFMT", "ArduPilot", "mavlogdump"),
        (
            b"H Product:Blackbox flight",
            "Betaflight",
            "blackbox_decode",
        ),
    ];
    for (start, name, export) in starts {
        let path = folder.path().join("log.csv");
        fs::write(&path, [start, &[0xff, 0, b'\n', 0xfe]].concat()).unwrap();
        let path = path.to_str().unwrap();
        for command in ["calibrate", "allan", "navigate"] {
            let failure = wimu(&[command, path]).fails(2, "unknown_format");
            let said = failure["message"].as_str().unwrap();
            assert!(said.contains(name), "{command}: {failure}");
            let remedy = failure["remedy"].as_str().unwrap();
            assert!(remedy.contains(export), "{command}: {failure}");
        }
    }
    // By their own names, where the recordings are there.
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/formats");
    for (file, name) in [
        ("ros1_imu_uwb.bag", "ROS 1 bag"),
        ("px4_cubeorange.ulg", "PX4"),
        ("ardupilot_plane.BIN", "ArduPilot"),
        ("betaflight_omnibus.BFL", "Betaflight"),
    ] {
        let path = data.join(file);
        if !path.is_file() {
            eprintln!("skipped: {} is not there", path.display());
            continue;
        }
        for command in ["calibrate", "navigate"] {
            let failure = wimu(&[command, path.to_str().unwrap()]).fails(2, "unknown_format");
            let said = failure["message"].as_str().unwrap();
            assert!(said.contains(name), "{command}: {failure}");
        }
    }
}

#[test]
fn several_sensors_or_runs_in_a_file_ask_for_where() {
    let folder = folder();
    let path = folder.path().join("all.csv");
    let file = path.to_str().unwrap();
    let mut text = format!("Run,IMU,Time (s),{XYZ}\n");
    let mut noise = noise();
    for run in [1, 2] {
        for k in 0..500 {
            for imu in [0, 1] {
                let z = 9.8 + 0.01 * noise();
                writeln!(text, "{run},{imu},{:.2},0,0,{z}", f64::from(k) * 0.01).unwrap();
            }
        }
    }
    fs::write(&path, text).unwrap();
    for command in ["calibrate", "allan", "navigate"] {
        let failure = wimu(&[command, file]).fails(2, "usage");
        let said = failure["message"].as_str().unwrap();
        assert!(said.contains("`Run` is 1, 2; `IMU` is 0, 1"), "{failure}");
        let remedy = failure["remedy"].as_str().unwrap();
        assert!(remedy.contains("--where \"Run=1,IMU=0\""), "{failure}");
    }
    // Half of it is not enough, all of it is.
    let failure = wimu(&["allan", file, "--where", "IMU=1"]).fails(2, "usage");
    let said = failure["message"].as_str().unwrap();
    assert!(said.contains("`Run` is 1, 2") && !said.contains("IMU"));
    let ran = wimu(&["allan", file, "--where", "IMU=1,Run=2"]);
    assert!(!ran.stderr.contains("--where"), "{ran:?}");

    // Means over poses of several runs of one sensor are one calibration; those of two sensors are none.
    let poses = |imus: &[u32]| {
        let mut text = format!("Run,IMU,Pose,{XYZ}\n");
        for (k, up) in spread(20).iter().enumerate() {
            for imu in imus {
                let [x, y, z] = up.map(|f| 9.8 * f + 0.1 * f64::from(*imu));
                writeln!(text, "{},{imu},{k},{x},{y},{z}", k / 10).unwrap();
            }
        }
        fs::write(&path, text).unwrap();
        wimu(&["calibrate", file, "--poses"])
    };
    poses(&[3]).succeeds();
    let failure = poses(&[3, 4]).fails(2, "usage");
    assert!(
        failure["message"]
            .as_str()
            .unwrap()
            .contains("`IMU` is 3, 4")
    );
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
    for (rows, step_s) in [(101, 0.01), (101, 0.19)] {
        let failure = table(rows, step_s).fails(2, "usage");
        let said = failure["message"].as_str().unwrap();
        assert!(said.contains("continuous recording"), "{failure}");
        assert!(
            failure["remedy"]
                .as_str()
                .unwrap()
                .contains("leave out --poses")
        );
    }
    for (rows, step_s) in [(100, 0.01), (101, 0.21), (1001, 5.0)] {
        let ran = table(rows, step_s);
        assert!(
            !ran.stderr.contains("continuous"),
            "{rows} {step_s}: {ran:?}"
        );
    }
}

#[test]
fn navigate_says_that_a_link_is_recorded_first() {
    let failure = wimu(&["navigate", "tcp://127.0.0.1:7100"]).fails(2, "usage");
    let remedy = failure["remedy"].as_str().unwrap();
    assert!(
        remedy.contains("`wimu record tcp://127.0.0.1:7100 -o FILE.mcap`"),
        "{failure}"
    );
    wimu(&["navigate", "no/such/file.mcap"]).fails(2, "file_unreadable");
}

#[test]
fn a_magnetometer_that_is_not_calibrated_is_not_called_absent() {
    let folder = folder();
    let path = folder.path().join("walk.csv");
    let mut noise = noise();
    let field = "Magnetometer X (µT),Magnetometer Y (µT),Magnetometer Z (µT)";
    for (calibrated, expected, not) in [
        ("0", "it is not calibrated", "no magnetometer"),
        ("1", "", "calibrated"),
        ("", "no magnetometer", "not calibrated"),
    ] {
        let mut text = format!("Time (s),{XYZ},{field},Field Calibrated\n");
        for k in 0..600 {
            let mut n = || 0.01 * noise();
            let [x, y, z] = [n(), n(), 9.80665 + n()];
            let field = match calibrated {
                "" => ",,".to_owned(),
                _ => format!("{},{},{}", 20.0 + n(), n(), -40.0 + n()),
            };
            writeln!(
                text,
                "{:.2},{x},{y},{z},{field},{calibrated}",
                f64::from(k) * 0.01
            )
            .unwrap();
        }
        fs::write(&path, text).unwrap();
        let said = wimu(&["navigate", path.to_str().unwrap(), "--method", "tilt"]).succeeds();
        let remarks = said["remarks"].to_string();
        assert!(remarks.contains(expected), "{calibrated}: {remarks}");
        assert!(!remarks.contains(not), "{calibrated}: {remarks}");
        if calibrated == "0" {
            assert!(remarks.contains("--sensor magnetometer"), "{remarks}");
        }
    }
}
