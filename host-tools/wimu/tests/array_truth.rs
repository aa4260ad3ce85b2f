//! `wimu navigate --geometry`: compared with the truth at the file's times, and geometries of another array.

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
    let ran = wimu(&["navigate", &input, "--geometry", &geometry, "-o", &out]);
    let mut texts = Transcript::default();
    let report = texts.findings("constant rate, sensor 5 dead from 5 s on", &ran);
    texts.check("navigate_array_constant_rate");
    assert!(report["nees"]["samples"].as_u64().unwrap() > 400, "{report}");
    let rate = &report["rate_nees"];
    assert!(rate["samples"].as_u64().unwrap() > 400, "{report}");
    assert!(rate["share_below_7_81"].as_f64().unwrap() > 0.7, "{report}");
    assert!(report["velocity_nees"].is_null(), "{report}");
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

/// The warning that the positions have another size, if there is one.
fn size_warning(report: &serde_json::Value) -> Option<String> {
    let problems = report["problems"].as_array()?.iter();
    let warnings = problems.filter(|problem| problem["severity"] == "warning");
    let mut texts = warnings.filter_map(|problem| problem["text"].as_str());
    texts.find(|text| text.contains("times as far apart")).map(str::to_owned)
}

/// Columns of a CSV file by their names.
fn columns(file: &str, names: &[String]) -> Vec<Vec<f64>> {
    let text = fs::read_to_string(file).unwrap();
    let header: Vec<&str> = text.lines().next().unwrap().split(',').collect();
    let places: Vec<usize> =
        names.iter().map(|name| header.iter().position(|one| one == name).expect(name)).collect();
    let row = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        places.iter().map(|place| fields[*place].parse().unwrap_or(f64::NAN)).collect()
    };
    text.lines().skip(1).map(row).collect()
}

/// RMS error of the angular rate in motion above 1 rad/s per axis, deg/s, and the fraction of samples whose NEES is below its
/// 95 % point: a path against the mean of the gyroscopes beside the array less that of the first rest, where none is at its
/// limit.
fn scored(recording: &str, path: &str) -> (f64, f64) {
    let axes = ["X", "Y", "Z"];
    let time = "Time (s)".to_owned();
    let sensors = (0..8).flat_map(|k| axes.map(|axis| format!("Gyroscope {k} {axis} (LSB)")));
    let counts =
        columns(recording, &std::iter::once(time.clone()).chain(sensors).collect::<Vec<_>>());
    let is_clipped: Vec<bool> =
        counts.iter().map(|row| row[1..].iter().any(|count| count.abs() >= 32_760.0)).collect();
    let mean = |row: &Vec<f64>, axis: usize| {
        row[1..].iter().skip(axis).step_by(3).sum::<f64>() / 8.0 / 16.4_f64 * 1_f64.to_radians()
    };
    let bias =
        [0, 1, 2].map(|axis| counts[..300].iter().map(|row| mean(row, axis)).sum::<f64>() / 300.0);
    let rates = axes.map(|axis| format!("Angular Rate {axis} (rad/s)"));
    let sigmas = axes.map(|axis| format!("Angular Rate Sigma {axis} (rad/s)"));
    let found = columns(path, &[&[time], &rates[..], &sigmas[..]].concat());
    let (mut squares, mut below, mut count, mut at) = (0.0, 0.0, 0.0, 0);
    for (k, row) in counts.iter().enumerate() {
        while at + 1 < found.len() && found[at][0] < row[0] - 1e-3 {
            at += 1;
        }
        let truth = [0, 1, 2].map(|axis| mean(row, axis) - bias[axis]);
        let moves = truth.iter().map(|w| w * w).sum::<f64>() > 1.0;
        let is_near = (k.saturating_sub(1)..(k + 2).min(counts.len())).any(|k| is_clipped[k]);
        if (found[at][0] - row[0]).abs() > 1e-3 || !moves || is_near {
            continue;
        }
        let error = [0, 1, 2].map(|axis| found[at][1 + axis] - truth[axis]);
        squares += error.iter().map(|e| e * e).sum::<f64>();
        let nees: f64 = (0..3).map(|axis| (error[axis] / found[at][4 + axis]).powi(2)).sum();
        below += f64::from(u8::from(nees < 7.81));
        count += 1.0;
    }
    assert!(count > 4000.0, "{count}");
    (f64::sqrt(squares / (3.0 * count)).to_degrees(), below / count)
}

#[test]
fn the_rate_of_a_real_array_is_that_of_its_gyroscopes() {
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data/array/");
    let (run, positions) =
        (format!("{data}mimu4444_run1.csv"), format!("{data}mimu4444_positions.csv"));
    if !Path::new(&run).exists() {
        println!("skipped: {run} is absent");
        return;
    }
    let folder = folder();
    let out = folder.path().join("path.csv").display().to_string();
    let report = wimu(&["navigate", &run, "--geometry", &positions, "-o", &out]).succeeds();
    assert_eq!(size_warning(&report), None);
    let (error_deg_s, share) = scored(&run, &out);
    println!("{error_deg_s:.1} deg/s, NEES below 7.81 at {share:.3}");
    assert!(error_deg_s < 136.0 && (0.85..0.98).contains(&share), "{error_deg_s} {share}");
}
