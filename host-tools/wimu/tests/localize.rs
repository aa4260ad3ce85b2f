//! `wimu navigate --setup anchors=…`: ranges alone and with odometry.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use kit::{folder, record_calibrated, record_motion, record_motion_of, wimu};
use wimu_sim::board::SensorPart;

const ANCHORS: [[f64; 3]; 5] =
    [[0.0, 0.0, 0.2], [8.0, 0.0, 2.5], [8.0, 6.0, 0.3], [0.0, 6.0, 2.6], [4.0, 3.0, 3.0]];

/// Position, m.
fn path(t: f64) -> [f64; 3] {
    [4.0 + 2.0 * (0.3 * t).sin(), 3.0 + 2.0 * (0.3 * t).cos(), 1.0]
}

/// Ranges of 20 s without noise, with a bias of 5 cm, and their anchors.
pub fn write(folder: &Path) {
    let (mut ranges, mut anchors) = (
        "Time (s),Anchor,Range (m)\n".to_owned(),
        "Anchor,Position E (m),Position N (m),Position U (m)\n".to_owned(),
    );
    for (id, [e, n, u]) in ANCHORS.iter().enumerate() {
        writeln!(anchors, "{id},{e},{n},{u}").unwrap();
    }
    for k in 0..200 {
        let t = f64::from(k) * 0.1;
        for (id, anchor) in ANCHORS.iter().enumerate() {
            let square: f64 = path(t).iter().zip(anchor).map(|(a, b)| (a - b) * (a - b)).sum();
            writeln!(ranges, "{t},{id},{}", square.sqrt() + 0.05).unwrap();
        }
    }
    fs::write(folder.join("ranges.csv"), ranges).unwrap();
    fs::write(folder.join("anchors.csv"), anchors).unwrap();
}

#[test]
fn odometry_without_anchors_or_a_vehicle_is_refused() {
    let run = wimu(&["navigate", "a.csv", "--odometry", "b.csv"]);
    assert_eq!(run.code, 2);
    assert!(run.stderr.contains("anchors="), "{}", run.stderr);
    assert!(run.stderr.contains("--profile vehicle"), "{}", run.stderr);
}

/// Inertial samples of [`path`] at 50 Hz, axes to east, north and up, with the acceleration of sample 300 as given; with a
/// gyroscope or without.
fn write_inertial(folder: &Path, acceleration: &str, gyroscope: bool) -> String {
    let mut text =
        "Time (s),Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²)".to_owned();
    text += if gyroscope {
        ",Gyroscope X (rad/s),Gyroscope Y (rad/s),Gyroscope Z (rad/s)\n"
    } else {
        "\n"
    };
    let mut noise = kit::noise();
    for k in 0..1000 {
        let t = f64::from(k) * 0.02;
        let force =
            [-0.18 * (0.3 * t).sin(), -0.18 * (0.3 * t).cos(), 9.80665].map(|f| f + 0.02 * noise());
        let force = if k == 300 {
            acceleration.to_owned()
        } else {
            format!("{},{},{}", force[0], force[1], force[2])
        };
        write!(text, "{t},{force}").unwrap();
        for _ in 0..3 * u8::from(gyroscope) {
            write!(text, ",{}", 0.001 * noise()).unwrap();
        }
        text.push('\n');
    }
    let file = folder.join("imu.csv");
    fs::write(&file, text).unwrap();
    file.display().to_string()
}

/// The warnings among the problems.
fn warnings(found: &serde_json::Value) -> Vec<&str> {
    let problems = found["problems"].as_array().unwrap().iter();
    let warnings = problems.filter(|problem| problem["severity"] == "warning");
    warnings.map(|problem| problem["text"].as_str().unwrap()).collect()
}

#[test]
fn accelerations_that_are_no_numbers_are_left_out_of_a_path_with_ranges() {
    let folder = folder();
    write(folder.path());
    let at = |name: &str| folder.path().join(name).display().to_string();
    for acceleration in [",,", "nan,nan,nan", "0.1,,9.8", "inf,0,9.8"] {
        let imu = write_inertial(folder.path(), acceleration, true);
        let arguments = [
            "navigate",
            &imu,
            "--ranges",
            &at("ranges.csv"),
            "--setup",
            kit::setup("anchors", at("anchors.csv")),
        ];
        let found = wimu(&arguments).succeeds();
        assert_eq!(found["method"], "ranges_inertial", "{acceleration}: {found}");
        let said = warnings(&found);
        assert!(
            said.iter().any(|text| text.contains("no number in 1 of 1000 samples")),
            "{said:?}"
        );
        let truth = path(19.98);
        for axis in 0..3 {
            let error = found["final_position_m"][axis].as_f64().unwrap() - truth[axis];
            assert!(error.abs() < 0.3, "{acceleration} {axis}: {error}");
        }
    }
}

#[test]
fn why_inertial_samples_are_not_used_beside_ranges_is_said() {
    let folder = folder();
    write(folder.path());
    let at = |name: &str| folder.path().join(name).display().to_string();
    let imu = write_inertial(folder.path(), "0,0,9.8", false);
    let board = at("board.mcap");
    record_motion("slide", 4, &board);
    for input in [&imu, &board] {
        let arguments = [
            "navigate",
            input,
            "--ranges",
            &at("ranges.csv"),
            "--setup",
            kit::setup("anchors", at("anchors.csv")),
        ];
        let found = wimu(&arguments).succeeds();
        let said = warnings(&found);
        let reason = "the inertial samples are not used: without a gyroscope the direction of the acceleration is not known";
        assert!(said.contains(&reason), "{input}: {said:?}");
    }
}

#[test]
fn a_boards_recording_beside_ranges_is_corrected_with_its_own_calibration() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let (poses, calibration, board) = (at("poses.mcap"), at("CAL.json"), at("board.mcap"));
    record_motion_of(SensorPart::Lsm6dso, "twelve-poses", 4, &poses);
    wimu(&["calibrate", &poses, "-o", &calibration]).succeeds();
    record_calibrated(SensorPart::Lsm6dso, &calibration, "rest,rest", 4, &board);
    // Ranges of a board at rest, by its clock.
    let alone = at("alone.csv");
    wimu(&["navigate", &board, "-o", &alone]).succeeds();
    let times = |file: &str| -> Vec<f64> {
        let text = fs::read_to_string(file).unwrap();
        text.lines().skip(1).map(|row| row.split(',').next().unwrap().parse().unwrap()).collect()
    };
    let known = times(&alone);
    write(folder.path());
    let mut ranges = "Time (s),Anchor,Range (m)\n".to_owned();
    for t in known.iter().step_by(10) {
        for (id, anchor) in ANCHORS.iter().enumerate() {
            let square: f64 =
                [4.0, 3.0, 1.0].iter().zip(anchor).map(|(a, b)| (a - b) * (a - b)).sum();
            writeln!(ranges, "{t},{id},{}", square.sqrt()).unwrap();
        }
    }
    fs::write(at("ranges.csv"), ranges).unwrap();
    let (own, given) = (at("own.csv"), at("given.csv"));
    let fixed =
        ["--ranges", &at("ranges.csv"), "--setup", kit::setup("anchors", at("anchors.csv"))];
    let found = wimu(&[&["navigate", &board, "-o", &own], &fixed[..]].concat()).succeeds();
    assert_eq!(found["method"], "ranges_inertial", "{found}");
    let with = ["navigate", &board, "-o", &given, "--with", &calibration];
    wimu(&[&with[..], &fixed[..]].concat()).succeeds();
    assert_eq!(times(&own)[0], known[0]);
    let rows = [own, given].map(|file| fs::read_to_string(file).unwrap());
    for (own, given) in rows[0].lines().zip(rows[1].lines()).skip(1) {
        let number =
            |row: &str, column: usize| row.split(',').nth(column).unwrap().parse::<f64>().unwrap();
        for column in 1..7 {
            let apart = number(own, column) - number(given, column);
            assert!(apart.abs() < 1e-3, "column {column}: {own} and {given}");
        }
    }
}
