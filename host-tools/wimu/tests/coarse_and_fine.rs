//! Counts of few bits and of many: calibrated alike.

use crate::kit;

use std::fmt::Write;
use std::fs;

use kit::{Ran, Transcript, folder, noise, wimu};

const SIDES: [[f64; 3]; 6] = [
    [1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, 0.0, 1.0],
    [0.0, 0.0, -1.0],
];

/// Six sides held 3 s each at 100 Hz, with a shaky way from one to the next, in counts of `per_g`; all
/// readings through `count`.
fn six_sides(per_g: f64, bias: [f64; 3], count: impl Fn(f64) -> f64) -> String {
    let mut text = String::from("Time (s)");
    for axis in ["X", "Y", "Z"] {
        write!(text, ",Accelerometer {axis} (LSB)").unwrap();
    }
    let mut normal = noise();
    let mut row = 0;
    for (index, side) in SIDES.iter().enumerate() {
        let next = SIDES.get(index + 1).unwrap_or(side);
        for k in 0..420 {
            let part = f64::from((k - 300).max(0)) / 120.0;
            let angle = part * part * (3.0 - 2.0 * part) * std::f64::consts::PI;
            // By way of the next axis where the next side is the opposite.
            let opposite = (0..3).all(|i| side[i] == -next[i]);
            let force: [f64; 3] = std::array::from_fn(|i| {
                let shake = 0.1 * (part * std::f64::consts::PI).sin().powi(2);
                let shake = shake * (0.2 * f64::from(k) + 2.0 * i as f64 + index as f64).sin();
                let across = side[(i + 2) % 3].abs();
                let turned = if opposite {
                    side[i] * angle.cos() + across * angle.sin()
                } else {
                    side[i] * (0.5 * angle).cos() + next[i] * (0.5 * angle).sin()
                };
                let rough = 0.0005 * normal();
                count(per_g * (turned * 1.01 + shake + rough + bias[i] / 9.80665))
            });
            let [x, y, z] = force;
            write!(text, "\n{:.2},{x},{y},{z}", f64::from(row) * 0.01).unwrap();
            row += 1;
        }
    }
    text
}

fn calibrated(text: &str, more: &[&str]) -> Ran {
    let folder = folder();
    let csv = folder.path().join("six.csv").display().to_string();
    fs::write(&csv, text).unwrap();
    wimu(&[&["calibrate", &csv, "--gravity", "9.80665"], more].concat())
}

#[test]
fn coarse_counts_that_stop_nowhere_are_calibrated() {
    let biases = [[0.0; 3], [0.1, -0.12, 0.05], [0.02, 0.03, -0.04], [-0.2, 0.3, 0.25]];
    for per_g in [16.0, 64.0, 256.0, 1024.0] {
        for bias in biases {
            let text = six_sides(per_g, bias, f64::round);
            let per_g = per_g.to_string();
            let flags = ["--method", "six-position", "--sensitivity", &per_g];
            calibrated(&text, &flags).succeeds();
        }
    }
}

#[test]
fn a_sensor_of_20_bits_is_calibrated_for_its_board() {
    let text = six_sides(256_000.0, [0.1, -0.12, 0.05], f64::round);
    let flags = ["--method", "six-position", "--sensitivity", "256000"];
    let mut texts = Transcript::default();
    let report = texts.findings("256000 LSB/g", &calibrated(&text, &flags));
    assert!(report["parameters"].is_object(), "{report}");
    let ran = calibrated(&text, &["--sensitivity", "1e12"]);
    texts.fails("1e12 LSB/g", &ran, 2, "usage");
    texts.check("calibrate_sensitivity_beyond_a_boards");
}
