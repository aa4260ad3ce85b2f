//! Error models of an array's sensors: found all at once or one by one, stored, and handed over to another
//! recording.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use kit::{Transcript, findings, folder, wimu};
use serde_json::Value;

const G: f64 = 9.80665;
const POSITIONS_MM: [[f64; 3]; 4] =
    [[50.0, 50.0, 50.0], [50.0, -50.0, -50.0], [-50.0, 50.0, -50.0], [-50.0, -50.0, 50.0]];

/// Bias of a sensor, m/s², and its A, its turn against the others included.
fn errors(sensor: usize) -> ([f64; 3], [[f64; 3]; 3]) {
    let s = sensor as f64;
    let bias = [0.3 - 0.2 * s, -0.25 + 0.1 * s, 0.15 * s - 0.2];
    let (scale, turn) = (0.01 * (s - 1.5), 0.008 * (s - 1.5));
    let matrix = [
        [1.0 + scale, -turn, 0.004],
        [turn, 1.0 - scale, 0.006 * (s - 1.5)],
        [-0.003, 0.002 * s, 1.0 + 0.5 * scale],
    ];
    (bias, matrix)
}

fn noise(k: u32, channel: u32) -> f64 {
    let mut z = u64::from(k) << 32 | u64::from(channel);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) % 2001) as f64 / 1000.0 - 1.0
}

/// A table of what the sensors put out at 100 Hz where the body's force, rate and ω̇ are those of `motion`.
fn table(seconds: f64, motion: impl Fn(f64) -> ([f64; 3], f64, f64), unit: &str) -> String {
    let mut text = String::from("Time (s)");
    for sensor in 0..4 {
        for axis in ["X", "Y", "Z"] {
            write!(text, ",Accelerometer {sensor} {axis} ({unit})").unwrap();
        }
    }
    text.push('\n');
    for k in 0..(seconds * 100.0) as u32 {
        let t = f64::from(k) / 100.0;
        let (force, rate, turn) = motion(t);
        write!(text, "{t:.2}").unwrap();
        for (sensor, position) in POSITIONS_MM.into_iter().enumerate() {
            let [x, y, _] = position.map(|c| c * 1e-3);
            let f = [
                force[0] - turn * y - rate * rate * x,
                force[1] + turn * x - rate * rate * y,
                force[2],
            ];
            let (bias, matrix) = errors(sensor);
            for axis in 0..3 {
                let clean: f64 = (0..3).map(|i| matrix[axis][i] * f[i]).sum();
                let value = clean + bias[axis] + 0.02 * noise(k, (3 * sensor + axis) as u32);
                if unit == "LSB" {
                    // Its true sensitivity is another than the nominal 4096.
                    write!(text, ",{:.0}", value / G * 4150.0).unwrap();
                } else {
                    write!(text, ",{value:.5}").unwrap();
                }
            }
        }
        text.push('\n');
    }
    text
}

/// Rests of 2.5 s in fourteen orientations.
fn poses(t: f64) -> ([f64; 3], f64, f64) {
    let at = |pose: usize| {
        let z = 1.0 - 2.0 * (pose as f64 + 0.5) / 14.0;
        let (s, c) = (2.4 * pose as f64).sin_cos();
        let r = (1.0 - z * z).sqrt();
        [r * c, r * s, z]
    };
    let pose = (t / 2.5) as usize;
    let share = ((t / 2.5 - pose as f64) * 5.0).min(1.0);
    let (from, to) = (at(pose.saturating_sub(1)), at(pose));
    let v: [f64; 3] = std::array::from_fn(|i| from[i] + share * (to[i] - from[i]));
    let size = v.iter().map(|c| c * c).sum::<f64>().sqrt();
    (v.map(|c| c * G / size), 0.0, 0.0)
}

/// Rest, a turn about the vertical at up to 6 rad/s, rest.
fn turn(t: f64) -> ([f64; 3], f64, f64) {
    let smooth = |x: f64| x * x * (3.0 - 2.0 * x);
    let slope = |x: f64| 6.0 * x * (1.0 - x) / 0.8;
    let [up, down] = [3.0, 5.0].map(|from| ((t - from) / 0.8).clamp(0.0, 1.0));
    let (rate, turning) = (smooth(up) - smooth(down), slope(up) - slope(down));
    ([0.0, 0.0, G], 6.0 * rate, 6.0 * turning)
}

fn written(folder: &Path, name: &str, text: &str) -> String {
    let path = folder.join(name);
    fs::write(&path, text).unwrap();
    path.display().to_string()
}

fn positions(folder: &Path) -> String {
    let mut text = "X (mm),Y (mm),Z (mm)\n".to_owned();
    for [x, y, z] in POSITIONS_MM {
        writeln!(text, "{x},{y},{z}").unwrap();
    }
    written(folder, "positions.csv", &text)
}

/// Bias that the navigation allows for, m/s², from the remark that states it.
fn allowed_bias(object: &Value) -> f64 {
    let all = findings(object).join("\n");
    let (_, rest) = all.split_once("Biases of ± ").expect(&all);
    rest.split(' ').next().unwrap().parse().unwrap()
}

#[test]
fn an_array_is_calibrated_at_once_and_its_models_serve_another_recording() {
    let folder = folder();
    let positions = positions(folder.path());
    let rests = written(folder.path(), "rests.csv", &table(35.0, poses, "m/s²"));
    let later = written(folder.path(), "later.csv", &table(9.0, turn, "m/s²"));
    let array = folder.path().join("ARRAY.json").display().to_string();
    let ran =
        wimu(&["calibrate", &rests, "--setup", kit::setup("geometry", &positions), "-o", &array]);
    let found = ran.succeeds();
    let mut texts = Transcript::default();
    texts.text("calibrate --setup", &ran);
    assert!(found["disagreement_m_s2"].as_f64().unwrap() < 0.005, "{found}");
    for sensor in 0..4 {
        let (bias, _) = errors(sensor);
        let model = &found["sensors"][sensor]["model"];
        for (axis, bias) in bias.into_iter().enumerate() {
            let of = model["bias_m_s2"][axis].as_f64().unwrap();
            assert!((of - bias).abs() < 0.01, "{sensor} {axis} {of} {bias}");
        }
    }
    let ran = wimu(&["navigate", &later, "--setup", kit::setup("geometry", &array)]);
    let with = texts.findings("navigate, calibrated", &ran);
    let ran = wimu(&["navigate", &later, "--setup", kit::setup("geometry", &positions)]);
    let without = texts.findings("navigate, not calibrated", &ran);
    assert!(allowed_bias(&with) < 0.2 * allowed_bias(&without));
    texts.check("calibrate_array");
}

#[test]
fn sensors_calibrated_one_by_one_are_handed_over_in_their_order() {
    let folder = folder();
    let positions = positions(folder.path());
    // Counts: each model is by the sensitivity of its own fit.
    let rests = written(folder.path(), "rests.csv", &table(35.0, poses, "LSB"));
    let later = written(folder.path(), "later.csv", &table(9.0, turn, "LSB"));
    let files: Vec<String> = (0..4)
        .map(|k| {
            let file = folder.path().join(format!("CAL{k}.json")).display().to_string();
            let number = k.to_string();
            wimu(&["calibrate", &rests, "--sensor", &number, "-o", &file]).succeeds();
            file
        })
        .collect();
    let navigate = |order: &[usize]| {
        let mut arguments = vec!["navigate", &later, "--setup", kit::setup("geometry", &positions)];
        arguments.extend(["--sensitivity", "4096"]);
        for k in order {
            arguments.extend(["--with", &files[*k]]);
        }
        wimu(&arguments)
    };
    let mut texts = Transcript::default();
    let found = texts.findings("in their order", &navigate(&[0, 1, 2, 3]));
    // Gravity does not show how they are turned against each other: up to 12 mrad, 0.12 m/s².
    assert!(allowed_bias(&found) < 0.15, "{found}");
    texts.findings("two swapped", &navigate(&[3, 1, 2, 0]));
    texts.fails("two of four", &navigate(&[0, 1]), 2, "usage");
    texts.check("navigate_calibrations_one_by_one");
    // Without their positions they are no array.
    wimu(&["navigate", &later, "--with", &files[0]]).fails(2, "csv_missing_column");
}
