//! `wimu calibrate A B …`: sessions of one sensor, and gravity from latitude and height.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use kit::{Transcript, folder, noise, spread, wimu};
use wimu_host::calibration::Calibration;
use wimu_host::formats::{ReadOptions, load};
use wimu_host::imu::{Imu, ImuOptions};

/// Pose means of a session, m/s², bias X and temperature as given.
fn session(folder: &Path, name: &str, celsius: f64, bias: f64, poses: u32) -> String {
    let mut text = String::from(
        "Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²),Temperature (°C)",
    );
    let mut noise = noise();
    for up in spread(poses) {
        let [x, y, z] = up.map(|u| 9.80665 * u);
        let seen = [bias + 1.02 * x, 0.015 * x + 0.985 * y - 0.28, 0.25 + 1.01 * z];
        let [x, y, z] = seen.map(|a| a + 0.001 * noise());
        write!(text, "\n{x},{y},{z},{celsius}").unwrap();
    }
    let path = folder.join(name);
    fs::write(&path, text).unwrap();
    path.display().to_string()
}

/// Turn-on bias that navigation adds to a calibration, m/s².
fn turn_on_added(csv: &str, cal: &str) -> f64 {
    let options = ImuOptions {
        calibration: Some(Calibration::read(Path::new(cal)).unwrap().sensor().clone()),
        ..ImuOptions::default()
    };
    let axes = ["X", "Y", "Z"].map(|axis| format!("Accelerometer {axis} (m/s²)"));
    let text = format!("Time (s),{}\n0.00,0,0,9.8\n0.01,0,0,9.8\n", axes.join(","));
    fs::write(csv, text).unwrap();
    let motion =
        Imu::of(&load(Path::new(csv), &ReadOptions::default()).unwrap(), &options).unwrap();
    let known = motion.covariance.unwrap();
    let used = motion.calibration_covariance().unwrap();
    (used[0][0] - known[0][0]).sqrt()
}

#[test]
fn sessions_are_combined_and_navigation_uses_their_change() {
    let folder = folder();
    let session = |name, celsius, bias, poses| session(folder.path(), name, celsius, bias, poses);
    let cold = session("cold.csv", 5.0, 0.21, 20);
    let room = session("room.csv", 25.0, 0.33, 20);
    let warm = session("warm.csv", 45.0, 0.40, 20);
    let few = session("few.csv", 45.0, 0.40, 5);
    let cal = folder.path().join("CAL.json").display().to_string();
    let rest = folder.path().join("rest.csv").display().to_string();
    let mut texts = Transcript::default();
    let run = |more: &[&str]| wimu(&[&["calibrate", "--poses", &cold], more].concat());

    let ran = run(&[&room, &warm, "--latitude", "45,120", "-o", &cal]);
    texts.text("three sessions", &ran);
    let report = ran.succeeds();
    assert_eq!(report["gravity_source"], "latitude");
    let slope = &report["model"]["temperature"]["bias_mps2_per_k"][0];
    assert!((slope.as_f64().unwrap() - 0.00475).abs() < 0.002, "{slope}");
    let file: serde_json::Value = serde_json::from_str(&fs::read_to_string(&cal).unwrap()).unwrap();
    let stored = &file["sensors"][0]["accelerometer"]["sessions"];
    assert_eq!(stored.as_array().unwrap().len(), 3);
    assert_eq!(stored[2]["file"], warm.as_str());
    assert_eq!(turn_on_added(&rest, &cal), 0.0);
    let single = folder.path().join("single.json").display().to_string();
    run(&["-o", &single]).succeeds();
    assert!((turn_on_added(&rest, &single) - 0.05).abs() < 1e-6);

    texts.text("two sessions", &run(&[&room]));
    texts.refuses("a session with five poses", &run(&[&room, &few]));
    texts.refuses("one session twice", &run(&[&cold]));
    for (case, more) in [
        ("four-angle", &[room.as_str(), "--method", "four-angle"][..]),
        ("magnetometer", &[&room, "--method", "magnetometer"]),
        ("a link", &["tcp://127.0.0.1:7100"]),
        ("latitude and gravity", &["--latitude", "45", "--gravity", "9.81"]),
        ("latitude beyond the pole", &["--latitude", "91"]),
        ("height above all mountains", &["--latitude", "45,9001"]),
        ("update by latitude", &["--method", "update", "--with", &cal, "--latitude", "45"]),
    ] {
        texts.fails(case, &run(more), 2, "usage");
    }
    texts.check("calibrate_sessions");
}
