//! `wimu navigate --anchors`: ranges alone and with odometry.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use kit::{folder, wimu};

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
fn ranges_give_a_path_with_sigma_and_calibration() {
    let folder = folder();
    write(folder.path());
    let at = |name: &str| folder.path().join(name).display().to_string();
    let (ranges, anchors, out) = (at("ranges.csv"), at("anchors.csv"), at("path.csv"));
    let run = wimu(&["--json", "navigate", &ranges, "--anchors", &anchors, "-o", &out]);
    let found = run.succeeds();
    assert_eq!(found["method"], "ranges");
    let position = &found["final_position_m"];
    let truth = path(19.9);
    for axis in 0..3 {
        let error = position[axis].as_f64().unwrap() - truth[axis];
        assert!(error.abs() < 0.3, "{axis}: {error}");
    }
    assert_eq!(found["anchors"].as_array().unwrap().len(), 5);
    assert!(found["anchors"][0]["bias_m"]["sigma"].as_f64().unwrap() > 0.0);
    let written = fs::read_to_string(out).unwrap();
    assert_eq!(written.lines().count(), 201);
}

#[test]
fn odometry_without_anchors_or_a_vehicle_is_refused() {
    let run = wimu(&["navigate", "a.csv", "--odometry", "b.csv"]);
    assert_eq!(run.code, 2);
    assert!(run.stderr.contains("--anchors"), "{}", run.stderr);
    assert!(run.stderr.contains("--profile vehicle"), "{}", run.stderr);
}
