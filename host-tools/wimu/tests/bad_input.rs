//! `wimu calibrate` on data that support no answer: a refusal with its exit code or a correct answer,
//! never a panic, never a wrong answer without a remark.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use kit::{Ran, Transcript, folder, wimu};
use serde_json::Value;
use wimu_testkit::Random;

const G: f64 = 9.80665;
const BIAS: [f64; 3] = [0.3, -0.5, 0.7];
const MATRIX: [[f64; 3]; 3] = [[1.03, 0.0, 0.0], [0.02, 0.97, 0.0], [-0.01, 0.03, 1.01]];

fn unit(v: [f64; 3]) -> [f64; 3] {
    let norm = v.iter().map(|c| c * c).sum::<f64>().sqrt();
    v.map(|c| c / norm)
}

/// What the sensor puts out with `up` upward, m/s².
fn output(up: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| BIAS[i] + G * (0..3).map(|j| MATRIX[i][j] * up[j]).sum::<f64>())
}

/// Twelve edges and random directions, to `count`, with 3 mm/s² from pose to pose.
fn poses(count: usize) -> Vec<[f64; 3]> {
    let mut random = Random::new(count as u64);
    let mut ups = Vec::new();
    for (a, b) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
        ups.extend([[a, b, 0.05], [a, 0.05, b], [0.05, a, b]].map(unit));
    }
    ups.resize_with(count.max(12), || random.direction());
    ups.truncate(count);
    let noisy = |up| output(up).map(|y| y + 0.003 * random.normal());
    ups.into_iter().map(noisy).collect()
}

fn changed(count: usize, change: impl Fn(usize, [f64; 3]) -> [f64; 3]) -> Vec<[f64; 3]> {
    let all = poses(count).into_iter().enumerate();
    all.map(|(k, y)| change(k, y)).collect()
}

fn table(unit: &str, rows: &[[f64; 3]]) -> String {
    let mut text = ["X", "Y", "Z"].map(|axis| format!("Accelerometer {axis} ({unit})")).join(",");
    for [x, y, z] in rows {
        write!(text, "\n{x},{y},{z}").unwrap();
    }
    text + "\n"
}

/// Runs `calibrate` on this text.
fn calibrate(text: &str, flags: &[&str]) -> Ran {
    let folder = folder();
    let path = folder.path().join("data.csv");
    fs::write(&path, text).unwrap();
    let file = path.to_str().unwrap();
    let ran = wimu(&[&["calibrate", file][..], flags].concat());
    assert!(!ran.stderr.contains("panicked"), "{ran:?}");
    ran
}

/// Adds a refusal to `texts`; nothing is written.
fn refused(texts: &mut Transcript, case: &str, text: &str, flags: &[&str]) -> Value {
    let folder = folder();
    let cal = folder.path().join("CAL.json");
    let cal = cal.to_str().unwrap();
    let ran = calibrate(text, &[flags, &["-o", cal]].concat());
    let object = texts.refuses(case, &ran);
    assert!(!Path::new(cal).exists(), "a refusal writes no calibration");
    object
}

fn near_truth(object: &Value, most: f64) {
    for axis in 0..3 {
        let bias = object["model"]["bias_m_s2"][axis].as_f64().unwrap();
        assert!((bias - BIAS[axis]).abs() < most, "{axis}: {bias}");
    }
}

#[test]
fn wrong_and_mixed_units_are_named() {
    let mut texts = Transcript::default();
    let mut refused = |case: &str, text: &str, flags: &[&str]| {
        refused(&mut texts, case, text, flags);
    };
    let in_g = changed(20, |_, y| y.map(|c| c / G));
    refused("g called m/s²", &table("m/s²", &in_g), &["--poses"]);
    refused("m/s² called g", &table("g", &poses(20)), &["--poses"]);
    let counts = changed(20, |_, y| y.map(|c| (c * 16384.0 / G).round()));
    refused("counts called m/s²", &table("m/s²", &counts), &["--poses"]);
    let flags = ["--poses", "--sensitivity", "2048"];
    refused("wrong sensitivity", &table("LSB", &counts), &flags);
    // Half of them in g; one alone is left out, or refused.
    let half = changed(20, |k, y| if k % 2 == 0 { y } else { y.map(|c| c / G) });
    for model in ["9", "6", "auto"] {
        let flags = ["--poses", "--model", model];
        let case = format!("half of them in g, {model}");
        refused(&case, &table("m/s²", &half), &flags);
    }
    let one = changed(20, |k, y| if k == 7 { y.map(|c| c / G) } else { y });
    let object = calibrate(&table("m/s²", &one), &["--poses"]).succeeds();
    assert_eq!(object["rejected_poses"], serde_json::json!([7]));
    near_truth(&object, 0.02);
    // One axis in another unit than its header; a header of mixed units.
    let axis = changed(20, |_, [x, y, z]| [x, y, z / G]);
    refused("Z in g", &table("m/s²", &axis), &["--poses"]);
    let mixed = table("g", &in_g).replacen("(g)", "(m/s²)", 1);
    // Each axis has its own unit.
    refused("X in g called m/s²", &mixed, &["--poses"]);
    texts.check("calibrate_wrong_units");
}

/// A recording of a hand that turns the sensor through `poses`, 100 Hz; `shake` m/s² while held.
fn recording(poses: &[[f64; 3]], shake: f64) -> String {
    let mut random = Random::new(99);
    let mut text = String::from("Time (s),");
    text += &table("m/s²", &[]);
    let mut t = 0.0_f64;
    for pose in poses {
        for k in 0..300 {
            t += 0.01;
            let moving = if k < 80 { 4.0 } else { shake };
            let swing = moving * (8.0 * t).sin();
            let [x, y, z] = pose.map(|c| c + 0.01 * random.normal() + swing * (3.0 * t).cos());
            writeln!(text, "{t:.2},{x},{y},{z}").unwrap();
        }
    }
    text
}

#[test]
fn recordings_in_motion_and_broken_files_are_reported() {
    let mut texts = Transcript::default();
    let good = recording(&poses(20), 0.0);
    let object = calibrate(&good, &[]).succeeds();
    near_truth(&object, 0.01);
    let shaken = recording(&poses(20), 3.0);
    refused(&mut texts, "in motion", &shaken, &[]);
    // mg in a column of g: another unit, not motion.
    let in_mg = changed(20, |_, y| y.map(|c| c * 1000.0 / G));
    let in_mg = recording(&in_mg, 0.0).replace("(m/s²)", "(g)");
    refused(&mut texts, "mg called g", &in_mg, &[]);
    // Poses that were not still, as means.
    let moving = {
        let mut random = Random::new(5);
        let all = poses(30).into_iter();
        all.map(|y| y.map(|c| c + 1.5 * random.normal())).collect::<Vec<_>>()
    };
    for model in ["6", "9", "auto"] {
        let ran = calibrate(&table("m/s²", &moving), &["--poses", "--model", model]);
        assert_eq!(ran.code, 3, "{ran:?}");
    }
    calibrate("", &[]).fails(2, "csv_empty");
    calibrate(&table("m/s²", &[]), &[]).fails(2, "no_rows");
    calibrate(&good.replacen("Accelerometer Z (m/s²)", "Something", 1), &[])
        .fails(2, "csv_missing_column");
    let rows: Vec<&str> = good.lines().collect();
    let nan = format!("{}\n{}\n1,NaN,2,3\n2,NaN,2,3\n", rows[0], rows[1]);
    texts.fails("mostly no numbers", &calibrate(&nan, &[]), 3, "data_refused");
    // Times in another unit than the header's give no sampling rate.
    let scaled: String = good
        .lines()
        .enumerate()
        .map(|(k, line)| match line.split_once(',') {
            Some((time, rest)) if k > 0 => format!("{}e6,{rest}\n", time),
            _ => format!("{line}\n"),
        })
        .collect();
    texts.findings("times in µs called s", &calibrate(&scaled, &[]));
    texts.check("calibrate_recordings_in_motion");
}

#[test]
fn many_poses_are_answered_and_bad_ones_left_out_in_few_lines() {
    let long = |k: usize, y: [f64; 3]| {
        if k % 100 == 19 { y.map(|c| 1.02 * c) } else { y }
    };
    let text = table("m/s²", &changed(5000, long));
    let ran = calibrate(&text, &["--poses", "--model", "9"]);
    let object = ran.succeeds();
    assert_eq!((&object["poses"], &object["rejected"]), (&5000.into(), &50.into()));
    // Not a line for each.
    assert!(ran.stderr.lines().count() < 60, "{}", ran.stderr);
    near_truth(&object, 0.004);
    assert_eq!(object["static_poses"].as_array().unwrap().len(), 0);
}

#[test]
#[ignore = "a million poses: cargo test --release -p wimu --test all bad_input -- --ignored"]
fn a_million_poses_are_answered() {
    for (every, bad) in [(1, 0), (1000, 1000), (20, 50_000)] {
        let long = |k: usize, y: [f64; 3]| {
            if bad > 0 && k % every == 19 { y.map(|c| 1.02 * c) } else { y }
        };
        let text = table("m/s²", &changed(1_000_000, long));
        for model in ["9", "auto"] {
            let object = calibrate(&text, &["--poses", "--model", model]).succeeds();
            assert_eq!(object["rejected"], bad);
            assert_eq!(object["poses"], 1_000_000);
            near_truth(&object, 0.001);
        }
    }
}

#[test]
fn each_parameter_stands_beside_its_datasheets_limit() {
    let flags = ["--poses", "--sensor-model", "mpu-6050"];
    let ran = calibrate(&table("m/s²", &poses(20)), &flags);
    let object = ran.succeeds();
    let datasheet = &object["datasheet"];
    assert_eq!(datasheet["sensor"], "MPU-6050");
    let limits = datasheet["limits"].as_array().unwrap();
    assert_eq!(limits.len(), 9);
    // −0.5 m/s² is −51 mg of 50, but within what is not known of it; 71 mg of 80 on Z.
    assert_eq!(limits[0]["verdict"], "within");
    assert!((limits[1]["value"].as_f64().unwrap() + 51.0).abs() < 0.5);
    assert_eq!(limits[2]["limit"], 80.0);
    let mut texts = Transcript::default();
    texts.text("calibrate --sensor-model mpu-6050", &ran);
    texts.check("calibrate_beside_a_datasheet");
    calibrate(&table("m/s²", &poses(20)), &["--poses", "--sensor-model", "abacus"])
        .fails(2, "usage");
    let none = calibrate(&table("m/s²", &poses(20)), &["--poses"]).succeeds();
    assert!(none["datasheet"].is_null());
}
