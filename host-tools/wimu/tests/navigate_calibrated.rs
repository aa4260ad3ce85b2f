//! From a calibration to a path: the calibration of a table corrects the tables that `wimu navigate` reads.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use kit::{Transcript, folder, noise, spread, wimu};
use serde_json::Value;

const G: f64 = 9.80665;
const LSB_PER_G: f64 = 4096.0;

/// What the sensor makes of a force, m/s²: biases of 0.3 m/s², scale factors and axes 2 % off.
fn output(force: [f64; 3]) -> [f64; 3] {
    let [x, y, z] = force;
    [0.31 + 1.02 * x, -0.28 + 0.015 * x + 0.985 * y, 0.25 - 0.01 * x + 0.012 * y + 1.01 * z]
}

/// Rests of 2 s in 14 orientations, a shake between them, 100 Hz.
fn rests() -> Vec<[f64; 3]> {
    let mut forces = Vec::new();
    for up in spread(14) {
        for k in 0..240 {
            let shake = if k < 40 { 4.0 * f64::from(k).sin() } else { 0.0 };
            forces.push(up.map(|u| G * u + shake));
        }
    }
    forces
}

/// Level for 2 s, then 0.4 m along x within 1 s, and 2 s level again.
fn slide() -> Vec<[f64; 3]> {
    let force = |k: u32| {
        let tau = ((f64::from(k) * 0.01) - 2.0).clamp(0.0, 1.0);
        [24.0 * tau * (1.0 - tau) * (1.0 - 2.0 * tau), 0.0, G]
    };
    (0..500).map(force).collect()
}

/// Writes what the sensor puts out, in this unit.
fn write(folder: &Path, name: &str, unit: &str, forces: &[[f64; 3]]) -> String {
    let path = folder.join(name);
    let mut noise = noise();
    let axes = ["X", "Y", "Z"].map(|axis| format!("Accelerometer {axis} ({unit})"));
    let mut text = format!("Time (s),{}\n", axes.join(","));
    for (k, force) in forces.iter().enumerate() {
        let seen = output(*force).map(|a| a + 0.02 * noise());
        let [x, y, z] = match unit {
            "LSB" => seen.map(|a| (a * LSB_PER_G / G).round()),
            "g" => seen.map(|a| a / G),
            _ => seen,
        };
        writeln!(text, "{:.2},{x},{y},{z}", k as f64 * 0.01).unwrap();
    }
    fs::write(&path, text).unwrap();
    path.display().to_string()
}

#[test]
fn a_calibration_from_a_table_corrects_the_tables_of_its_unit() {
    let mut texts = Transcript::default();
    let folder = folder();
    for (unit, other) in [("LSB", "LSB"), ("m/s²", "g"), ("g", "m/s²")] {
        let model = folder.path().join("CAL.json").display().to_string();
        let poses = write(folder.path(), "rests.csv", unit, &rests());
        wimu(&["calibrate", &poses, "-o", &model]).succeeds();
        let csv = write(folder.path(), "slide.csv", other, &slide());
        let run = ["navigate", &csv, "--with", &model];
        let case = format!("{other}, calibrated in {unit}");
        let report = texts.findings(case, &wimu(&run));
        let length = report["moves"][0]["length_m"].as_f64().unwrap();
        assert!((length - 0.4).abs() < 0.003, "{unit} {other}: {length}");
    }
    // Without it the scale factor is 2 % off, and gravity 2.5 %.
    let csv = write(folder.path(), "slide.csv", "m/s²", &slide());
    let ran = wimu(&["navigate", &csv]);
    let report = texts.findings("not calibrated", &ran);
    let length = report["moves"][0]["length_m"].as_f64().unwrap();
    assert!((length - 0.4).abs() > 0.006, "{length}");
    texts.check("navigate_calibrated");
}

#[test]
fn a_calibration_of_another_unit_is_refused_and_each_remedy_works() {
    let mut texts = Transcript::default();
    let folder = folder();
    let calibrated = |unit: &str, name: &str| {
        let model = folder.path().join(name).display().to_string();
        let poses = write(folder.path(), "rests.csv", unit, &rests());
        wimu(&["calibrate", &poses, "-o", &model]).succeeds();
        model
    };
    let (of_counts, of_si) = (calibrated("LSB", "LSB.json"), calibrated("m/s²", "SI.json"));
    let counts = write(folder.path(), "counts.csv", "LSB", &slide());
    let si = write(folder.path(), "si.csv", "m/s²", &slide());
    let run = |csv: &str, more: &[&str]| wimu(&[&["navigate", csv], more].concat());
    let other = ["--with", &of_counts, "--sensitivity", "8192"];
    for (case, csv, more) in [
        ("m/s² by counts", &si, &["--with", &of_counts][..]),
        ("counts by m/s²", &counts, &["--with", &of_si]),
        ("counts, not calibrated", &counts, &[]),
        ("another sensitivity", &counts, &other),
    ] {
        texts.fails(case, &run(csv, more), 2, "unknown_format");
    }
    run(&counts, &["--with", &of_counts]).succeeds();
    run(&counts, &["--with", &of_si, "--sensitivity", "4096"]).succeeds();
    let ran = run(&counts, &["--sensitivity", "4096"]);
    texts.findings("counts, sensitivity alone", &ran);
    let twice = ["--with", &of_si, "--with", &of_si];
    texts.fails("two calibrations", &run(&si, &twice), 2, "usage");
    texts.check("navigate_calibration_of_another_unit");
}

#[test]
fn what_a_calibration_leaves_unknown_is_in_the_paths_deviation() {
    let folder = folder();
    let model = folder.path().join("CAL.json").display().to_string();
    let poses = write(folder.path(), "rests.csv", "m/s²", &rests());
    wimu(&["calibrate", &poses, "-o", &model]).succeeds();
    let csv = write(folder.path(), "slide.csv", "m/s²", &slide());
    // With a gyroscope: no rotation.
    let text = fs::read_to_string(&csv).unwrap();
    let mut lines = text.lines();
    let mut text = lines.next().unwrap().to_owned();
    text += ",Gyroscope X (rad/s),Gyroscope Y (rad/s),Gyroscope Z (rad/s)\n";
    for (k, line) in lines.enumerate() {
        let rate = if k % 2 == 0 { 1e-4 } else { -1e-4 };
        writeln!(text, "{line},{rate},{rate},{rate}").unwrap();
    }
    fs::write(&csv, text).unwrap();
    let sigma = || {
        let run = ["navigate", &csv, "--with", &model];
        let report = wimu(&run).succeeds();
        assert_eq!(report["method"], "strapdown");
        report["final_sigma_m"][0].as_f64().unwrap()
    };
    let known = sigma();
    // The same model from a worse session.
    let mut file: Value = serde_json::from_str(&fs::read_to_string(&model).unwrap()).unwrap();
    let quality = &mut file["sensors"][0]["accelerometer"]["quality"];
    for place in 0..12 {
        let sd = if place < 3 { 0.3 } else { 0.05 };
        quality["covariance"]["cholesky"][place][place] = serde_json::json!(sd);
    }
    fs::write(&model, file.to_string()).unwrap();
    let vague = sigma();
    assert!(vague > 2.0 * known, "{vague} {known}");
}
