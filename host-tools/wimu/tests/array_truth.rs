//! `wimu navigate --setup geometry=…`: compared with the truth at the file's times, and geometries of another array.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use kit::{Transcript, folder, wimu};

const G: f64 = 9.80665;
const POSITIONS: [[f64; 3]; 6] = [
    [30.0, 0.0, 0.0],
    [-30.0, 0.0, 0.0],
    [0.0, 30.0, 0.0],
    [0.0, -30.0, 0.0],
    [0.0, 0.0, 30.0],
    [0.0, 0.0, -30.0],
];

/// Six sensors on an octahedron, arms of 3 cm, 200 Hz from 100 s on: rest, two rotations about the vertical
/// in 4 s, mostly at constant rate, rest. Sensor 5 gives zeros from 5 s on.
fn table() -> String {
    let mut text = String::from("Time (s)");
    for sensor in 0..6 {
        for axis in ["X", "Y", "Z"] {
            write!(text, ",Accelerometer {sensor} {axis} (m/s²)").unwrap();
        }
    }
    for axis in ["E", "N", "U"] {
        write!(text, ",Truth Position {axis} (m)").unwrap();
    }
    for axis in ["X", "Y", "Z"] {
        write!(text, ",Truth Angular Rate {axis} (rad/s)").unwrap();
    }
    text.push('\n');
    for k in 0..2000_u32 {
        let t = f64::from(k) / 200.0;
        // Up in 0.5 s from 3 s on, down again from 6.5 s on.
        let share = |from: f64| ((t - from) / 0.5).clamp(0.0, 1.0);
        let smooth = |x: f64| x * x * (3.0 - 2.0 * x);
        let slope = |x: f64| 6.0 * x * (1.0 - x) / 0.5;
        let rate = 8.0 * (smooth(share(3.0)) - smooth(share(6.5)));
        let turn = 8.0 * (slope(share(3.0)) - slope(share(6.5)));
        write!(text, "{}", 100.0 + t).unwrap();
        for (sensor, [x, y, _]) in POSITIONS.into_iter().enumerate() {
            let (x, y) = (x * 1e-3, y * 1e-3);
            let force = [-turn * y - rate * rate * x, turn * x - rate * rate * y, G];
            for (axis, value) in force.into_iter().enumerate() {
                let step = k.wrapping_mul(2_654_435_761) >> 7;
                let step = (step ^ ((axis as u32 * 7 + sensor as u32) * 40_503)) % 1999;
                let noise = (f64::from(step) / 1000.0 - 1.0) * 0.015;
                let dead = sensor == 5 && t >= 5.0;
                write!(text, ",{:.5}", if dead { 0.0 } else { value + noise }).unwrap();
            }
        }
        writeln!(text, ",0,0,0,0,0,{rate:.5}").unwrap();
    }
    text
}

fn positions(unit: &str, scale: f64) -> String {
    let mut text = format!("X ({unit}),Y ({unit}),Z ({unit})\n");
    for [x, y, z] in POSITIONS {
        writeln!(text, "{},{},{}", x * scale, y * scale, z * scale).unwrap();
    }
    text
}

fn write(folder: &Path, name: &str, text: &str) -> String {
    let path = folder.join(name);
    fs::write(&path, text).unwrap();
    path.display().to_string()
}

#[test]
fn an_array_at_a_constant_rate_is_compared_with_its_truth_at_the_files_times() {
    let folder = folder();
    let input = write(folder.path(), "array.csv", &table());
    let geometry = write(folder.path(), "positions.csv", &positions("mm", 1.0));
    let out = folder.path().join("path.csv").display().to_string();
    let ran = wimu(&["navigate", &input, "--setup", kit::setup("geometry", &geometry), "-o", &out]);
    let mut texts = Transcript::default();
    let report = texts.findings("constant rate, sensor 5 dead from 5 s on", &ran);
    texts.check("navigate_array_constant_rate");
    assert!(report["nees"]["samples"].as_u64().unwrap() > 400, "{report}");
    let rate = &report["rate_nees"];
    assert!(rate["samples"].as_u64().unwrap() > 400, "{report}");
    assert!(rate["share_below_7_81"].as_f64().unwrap() > 0.7, "{report}");
    let path = fs::read_to_string(&out).unwrap();
    let row = |k: usize| -> Vec<f64> {
        let row = path.lines().nth(k + 1).unwrap();
        row.split(',').map(|v| v.parse().unwrap_or(f64::NAN)).collect()
    };
    assert_eq!(row(0)[0], 100.0);
    let middle = row(1100);
    assert!((middle[0] - 105.5).abs() < 1e-9, "{middle:?}");
    // Angular rate about z at the constant rate.
    assert!((middle[13] - 8.0).abs() < 0.3, "{middle:?}");
}
