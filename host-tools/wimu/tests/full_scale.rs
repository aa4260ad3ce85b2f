//! Sensors at the end of their range: refused, however coarse.

use crate::kit;

use std::fmt::Write;
use std::fs;

use kit::{Transcript, folder, wimu};

/// Holds of 3 s at 100 Hz, each axis in counts.
fn held(poses: &[[i32; 3]]) -> String {
    let mut text =
        String::from("Time (s),Accelerometer X (LSB),Accelerometer Y (LSB),Accelerometer Z (LSB)");
    let mut k = 0;
    for (p, pose) in poses.iter().enumerate() {
        for _ in 0..300 {
            let [x, y, z] = pose;
            write!(text, "\n{:.2},{x},{y},{z}", f64::from(k) * 0.01).unwrap();
            k += 1;
        }
        // On to the next.
        let next = poses.get(p + 1).unwrap_or(pose);
        for step in 0..100 {
            let at = f64::from(step) / 100.0;
            let turn = |axis: usize| {
                let (from, to) = (f64::from(pose[axis]), f64::from(next[axis]));
                (from + (to - from) * at + 20.0 * (0.5 * f64::from(step)).sin())
                    .clamp(-256.0, 255.0)
            };
            let [x, y, z] = [0, 1, 2].map(|axis| turn(axis).round());
            write!(text, "\n{:.2},{x},{y},{z}", f64::from(k) * 0.01).unwrap();
            k += 1;
        }
    }
    text
}

#[test]
fn counts_too_coarse_for_noise_that_stop_at_full_scale_are_refused() {
    let folder = folder();
    let csv = folder.path().join("six.csv").display().to_string();
    let run = |text: String| {
        fs::write(&csv, text).unwrap();
        let six = ["--method", "six-position", "--sensitivity", "256"];
        wimu(&[&["calibrate", csv.as_str()][..], &six].concat())
    };
    // Nine bits at 1 g: X stops at both ends, Y and Z at one.
    let stuck = run(held(&[
        [255, 12, 5],
        [-256, 1, 7],
        [3, 255, -4],
        [-1, -252, 3],
        [-1, 7, 255],
        [-1, 7, -248],
    ]));
    let mut texts = Transcript::default();
    texts.refuses("nine bits", &stuck);
    texts.check("calibrate_coarse_full_scale");
    // The same sensor a little below.
    let free = run(held(&[
        [251, 12, 5],
        [-253, 1, 7],
        [3, 254, -4],
        [-1, -252, 3],
        [-1, 7, 255],
        [-1, 7, -248],
    ]));
    assert_eq!(free.code, 0, "{free:?}");
}

#[test]
fn axes_that_are_always_at_one_end_or_the_other_are_refused() {
    let folder = folder();
    let csv = folder.path().join("rails.csv").display().to_string();
    let (low, high) = (-32768, 32767);
    let corners: Vec<[i32; 3]> =
        (0..8).map(|k| [0, 1, 2].map(|axis| if k >> axis & 1 == 1 { high } else { low })).collect();
    let mut text =
        String::from("Time (s),Accelerometer X (LSB),Accelerometer Y (LSB),Accelerometer Z (LSB)");
    for k in 0..8 * 300_usize {
        let [x, y, z] = corners[k / 300];
        write!(text, "\n{:.2},{x},{y},{z}", k as f64 * 0.01).unwrap();
    }
    fs::write(&csv, text).unwrap();
    let mut texts = Transcript::default();
    for model in ["auto", "9"] {
        texts.refuses(model, &wimu(&["calibrate", &csv, "--model", model]));
    }
    texts.check("calibrate_always_at_full_scale");
}

#[test]
fn means_of_poses_at_full_scale_are_refused() {
    let folder = folder();
    let csv = folder.path().join("means.csv").display().to_string();
    let mut text =
        String::from("Accelerometer X (LSB),Accelerometer Y (LSB),Accelerometer Z (LSB)");
    for [x, y, z] in [
        [32767, 1335, -1011],
        [-32418, 1348, -1011],
        [1017, 32767, -1001],
        [994, -32416, -1002],
        [998, 1329, 32085],
        [994, 1321, -32768],
    ] {
        write!(text, "\n{x},{y},{z}").unwrap();
    }
    fs::write(&csv, text).unwrap();
    let poses = ["calibrate", &csv, "--poses", "--sensitivity", "32767"];
    let ran = wimu(&[&poses[..], &["--method", "six-position"]].concat());
    let mut texts = Transcript::default();
    texts.refuses("six-position", &ran);
    texts.check("calibrate_means_at_full_scale");
}
