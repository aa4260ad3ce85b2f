//! Sensitivities of `wimu calibrate --method reference`.

use crate::kit;

use std::fmt::Write;
use std::fs;

use kit::{Transcript, in_folder, wimu};

fn moving(t: f64) -> [f64; 3] {
    [3.0 * (2.0 * t).sin(), 3.0 * (3.1 * t).cos(), 9.81 + 2.0 * (4.7 * t).sin()]
}

#[test]
fn a_reference_of_another_sensitivity_is_refused() {
    let mut texts = Transcript::default();
    let (csv, _folder) = in_folder("counts.csv");
    let mut text = String::from("Time (s)");
    for sensor in [0, 1] {
        for axis in ["X", "Y", "Z"] {
            write!(text, ",Accelerometer {sensor} {axis} (LSB)").unwrap();
        }
    }
    for k in 0..2000 {
        let t = f64::from(k) * 0.01;
        let [x, y, z] = moving(t).map(|f| f / 9.80665);
        let [a, b, c] = [x, y, z].map(|f| (16384.0 * f).round());
        let [u, v, w] = [x, y, z].map(|f| (4096.0 * (1.01 * f + 0.02)).round());
        write!(text, "\n{t:.2},{a},{b},{c},{u},{v},{w}").unwrap();
    }
    fs::write(&csv, text).unwrap();
    let of = ["calibrate", &csv, "--method", "reference"];
    let with = |flags: &[&str]| wimu(&[&of[..], flags].concat());
    for flags in [&[][..], &["--sensitivity", "16384"]] {
        texts.refuses(format_args!("{flags:?}"), &with(flags));
    }
    texts.check("calibrate_reference_sensitivity");
}
