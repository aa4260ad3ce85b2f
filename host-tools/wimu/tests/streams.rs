//! `-` as standard input and output, and `wimu convert --with`.

use std::fmt::Write as _;
use std::fs;
use std::io::Write as _;
use std::process::{Command, Output, Stdio};

use crate::kit::{folder, wimu};

/// Runs `wimu` with this standard input.
fn piped(arguments: &[&str], input: &[u8]) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_wimu"))
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // A command that refuses its arguments does not read.
    let _ = child.stdin.take().unwrap().write_all(input);
    child.wait_with_output().unwrap()
}

/// 20 poses in m/s², with a bias of 0.2 m/s² on X.
fn poses() -> String {
    let mut text = String::from(
        "Time (s),Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²)\n",
    );
    for k in 0..20 {
        let (height, angle) = (1.0 - (f64::from(k) + 0.5) / 10.0, f64::from(k) * 2.4);
        let radius = (1.0 - height * height).sqrt();
        let [x, y, z] = [radius * angle.cos(), radius * angle.sin(), height].map(|u| 9.80665 * u);
        writeln!(text, "{k},{},{y},{z}", x + 0.2).unwrap();
    }
    text
}

fn rest() -> String {
    let mut text = String::from(
        "Time (s),Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²)\n",
    );
    for k in 0..500 {
        let noise = 0.005 * f64::from(k * 37 % 100 - 50) / 50.0;
        writeln!(text, "{},{},{},{}", f64::from(k) / 100.0, 0.2 + noise, noise, 9.80665 - noise)
            .unwrap();
    }
    text
}

#[test]
fn a_calibration_goes_through_pipes() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (csv, cal) = (path("poses.csv"), path("CAL.json"));
    fs::write(&csv, poses()).unwrap();
    wimu(&["calibrate", &csv, "--poses", "-o", &cal]).succeeds();
    let piped_cal = piped(&["calibrate", "-", "--poses", "-o", "-"], poses().as_bytes());
    assert!(piped_cal.status.success(), "{piped_cal:?}");
    // The report goes to stderr; the files differ in the name of their source.
    assert!(String::from_utf8_lossy(&piped_cal.stderr).contains("poses"));
    let file: serde_json::Value = serde_json::from_slice(&piped_cal.stdout).unwrap();
    let expected: serde_json::Value = serde_json::from_slice(&fs::read(&cal).unwrap()).unwrap();
    let model = |file: &serde_json::Value| file["sensors"][0]["accelerometer"]["model"].clone();
    assert_eq!(model(&file), model(&expected));
    for format in ["c", "numpy", "matlab", "kalibr", "ros"] {
        let named = path(format);
        wimu(&["convert", &cal, "--to", format, "-o", &named]).succeeds();
        let text = piped(&["convert", "-", "--to", format, "-o", "-"], &piped_cal.stdout);
        assert!(text.status.success(), "{text:?}");
        assert_eq!(text.stdout, fs::read(&named).unwrap(), "{format}");
    }
}

#[test]
fn a_path_goes_through_pipes_and_into_ros_topics() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (csv, table, topics) = (path("rest.csv"), path("path.csv"), path("path.mcap"));
    fs::write(&csv, rest()).unwrap();
    wimu(&["navigate", &csv, "-o", &table]).succeeds();
    let through = piped(&["navigate", "-", "-o", "-"], rest().as_bytes());
    assert!(through.status.success(), "{through:?}");
    assert_eq!(through.stdout, fs::read(&table).unwrap());
    wimu(&["navigate", &csv, "-o", &topics]).succeeds();
    let bytes = fs::read(&topics).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let mut names: Vec<_> = summary.channels.values().map(|c| c.topic.clone()).collect();
    names.sort();
    assert_eq!(names, ["/odom", "/path", "/tf", "/tf_static"]);
    let info = piped(&["info", "-"], rest().as_bytes());
    assert_eq!(info.status.code(), Some(0), "{info:?}");
}

#[test]
fn one_stream_serves_one_purpose() {
    for arguments in [
        &["convert", "-", "--with", "-", "-o", "out.csv"][..],
        &["navigate", "rest.csv", "-o", "-", "--json"],
    ] {
        let ran = piped(arguments, b"");
        assert_eq!(ran.status.code(), Some(2), "{ran:?}");
    }
}

#[test]
fn a_table_is_corrected_and_refused_where_units_do_not_fit() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (csv, cal, counts) = (path("rest.csv"), path("CAL.json"), path("COUNTS.json"));
    fs::write(path("poses.csv"), poses()).unwrap();
    wimu(&["calibrate", &path("poses.csv"), "--poses", "-o", &cal]).succeeds();
    fs::write(&csv, rest()).unwrap();
    let out = path("out.csv");
    let applied = wimu(&["convert", &csv, "--with", &cal, "-o", &out]).succeeds();
    assert_eq!(applied["rows"], 500, "{applied}");
    let through = piped(&["convert", "-", "--with", &cal, "-o", "-"], rest().as_bytes());
    assert_eq!(through.stdout, fs::read(&out).unwrap());
    let text = fs::read_to_string(&out).unwrap();
    let x = text.lines().skip(1).map(|line| line.split(',').nth(1).unwrap());
    let x: Vec<f64> = x.map(|x| x.parse().unwrap()).collect();
    let mean = x.iter().sum::<f64>() / x.len() as f64;
    assert!(mean.abs() < 0.01, "{mean}");
    // Counts.
    fs::write(path("poses.csv"), poses().replace("m/s²", "LSB")).unwrap();
    let of = ["calibrate", &path("poses.csv"), "--poses", "-o", &counts];
    wimu(&of).succeeds();
    wimu(&["convert", &csv, "--with", &counts, "-o", &out]).fails(2, "unknown_format");
}
