//! Exported ROS 2 topics, as other programs read them.

use std::collections::BTreeMap;
use std::process::Command;

use serde_json::Value;
use wimu_host::apply::CorrectedRecording;
use wimu_host::calibration::Calibration;
use wimu_host::imu::{Imu, Sample};
use wimu_host::inertial::{Choice, navigate};
use wimu_host::recording::{Quantity, Recording, Sink, TrackInfo, Unit};
use wimu_host::series::Ns;
use wimu_model::{ParameterSet, Sensitivity};

/// Messages of each topic, flat lists of their values, as both Python packages `rosbags` and `mcap-ros2-support` read
/// them; `None` without them. `WIMU_PYTHON` may name a Python that has them.
fn read(path: &std::path::Path) -> Option<BTreeMap<String, Vec<Vec<Value>>>> {
    let python = std::env::var("WIMU_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/ros_topics.py");
    let Ok(ran) = Command::new(python).arg(script).arg(path).output() else {
        println!("skipped: there is no Python");
        return None;
    };
    let errors = String::from_utf8_lossy(&ran.stderr);
    if errors.contains("No module named") {
        println!("skipped: {errors}");
        return None;
    }
    assert!(ran.status.success(), "{errors}");
    let [first, second]: [BTreeMap<String, Vec<Vec<Value>>>; 2] =
        serde_json::from_slice(&ran.stdout).unwrap();
    assert_eq!(first, second);
    Some(first)
}

fn numbers(message: &[Value]) -> Vec<f64> {
    message.iter().filter_map(Value::as_f64).collect()
}

#[test]
fn a_path_is_read_with_odometry_and_transforms() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("path.mcap");
    let mut recording = Imu::default();
    for k in 0..2500 {
        let force_mps2 = [0.0, 0.0, if k % 2 == 0 { 9.80 } else { 9.81 }].into();
        recording.push(Ns::from_s(f64::from(k) * 0.01), Sample { force_mps2, ..Sample::default() });
    }
    let choice = Choice::default();
    let mut path = navigate(&recording, &choice).unwrap();
    // A quarter of a turn about the vertical: body X points north.
    let half = 0.5_f64.sqrt();
    for (k, point) in path.points.iter_mut().enumerate() {
        let east = k as f64 * 0.01;
        (point.position_m, point.velocity_mps) = ([east, 2.0, 3.0], [1.0, 2.0, 0.5]);
        (point.quaternion, point.valid) = ([half, 0.0, 0.0, half], k >= 100);
        point.covariance_m2 = [[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.16]];
        point.velocity_sd_mps = [0.1, 0.2, 0.3];
    }
    path.write(&file).unwrap();
    let Some(topics) = read(&file) else { return };
    let names: Vec<_> = topics.keys().map(String::as_str).collect();
    assert_eq!(names, ["/odom", "/path", "/tf", "/tf_static"]);
    let odometry = &topics["/odom"];
    assert_eq!(odometry.len(), 2400);
    let first = numbers(&odometry[0]);
    let near = |found: &[f64], expected: &[f64]| {
        let off = found.iter().zip(expected).map(|(a, b)| (a - b).abs());
        assert!(off.fold(0.0, f64::max) < 1e-12, "{found:?} {expected:?}");
    };
    near(&first[..9], &[1.0, 0.0, 1.0, 2.0, 3.0, 0.0, 0.0, half, half]);
    near(&first[9..18], &[0.04, 0.01, 0.0, 0.0, 0.0, 0.0, 0.01, 0.09, 0.0]);
    // Velocity in body axes: north, west, up.
    near(&first[45..48], &[2.0, -1.0, 0.5]);
    let variance = |k: usize| first[51 + 7 * k];
    near(&[variance(0), variance(1), variance(2)], &[0.04, 0.01, 0.09]);
    assert_eq!(odometry[0][2], "map");
    assert_eq!(odometry[0][3], "base_link");
    // One pose a second, in one message.
    assert_eq!(topics["/path"].len(), 1);
    let poses = numbers(&topics["/path"][0]);
    assert_eq!(poses.len(), 2 + 24 * 9);
    near(&poses[2 + 23 * 9..][..5], &[24.0, 0.0, 24.0, 2.0, 3.0]);
    assert_eq!(topics["/tf"].len(), 2400);
    near(&numbers(&topics["/tf"][0])[2..5], &[1.0, 2.0, 3.0]);
    assert_eq!(topics["/tf_static"][0][3], "imu_link");
}

#[test]
fn corrected_samples_are_read_with_covariances() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("imu.mcap");
    let set = ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(1000.0).unwrap());
    let mut recording = Recording::new("a");
    let counts = Unit::Counts { si_per_lsb: None };
    let force = recording.track(TrackInfo::new("acc", Quantity::SpecificForce, counts));
    let rate = recording.track(TrackInfo::new("gyr", Quantity::AngularRate, Unit::Si));
    let field = recording.track(TrackInfo::new("mag", Quantity::MagneticField, Unit::Si));
    for k in 0..50 {
        let time_ns = 1_795_222_920_000_000_000 + k * 10_000_000;
        recording.row(force, time_ns, &[100.0, 0.0, 1000.0]);
        recording.row(rate, time_ns, &[0.1, 0.2, 0.3]);
        if k % 10 == 0 {
            recording.row(field, time_ns, &[2e-5, k as f64 * 1e-6, 4e-5]);
        }
    }
    let calibration = Calibration::held(&set);
    let corrected = CorrectedRecording::new(calibration.sensor(), &recording).unwrap();
    assert_eq!(corrected.write(&file).unwrap(), 50);
    let Some(topics) = read(&file) else { return };
    assert_eq!((topics["/imu/data"].len(), topics["/imu/mag"].len()), (50, 5));
    let imu = numbers(&topics["/imu/data"][49]);
    assert_eq!(imu[..2], [1_795_222_920.0, 490_000_000.0]);
    // No orientation.
    assert_eq!((imu[5], imu[6]), (1.0, -1.0));
    assert_eq!(imu[15..18], [0.1, 0.2, 0.3]);
    assert!((imu[27] - 0.980665).abs() < 1e-12 && (imu[29] - 9.80665).abs() < 1e-12);
    let field = numbers(&topics["/imu/mag"][1]);
    let off = |(b, expected): (&f64, f64)| (b - expected).abs() < 1e-18;
    assert!(field[2..5].iter().zip([2e-5, 1e-5, 4e-5]).all(off));
}
