//! What people give `wimu calibrate --method reference`.

use crate::kit;

use std::fmt::Write;
use std::fs;

use kit::{in_folder, wimu};
use serde_json::Value;

/// Two accelerometers at 100 Hz, both said to be in m/s²: what the reference shows at time t, and what
/// becomes of it in the other.
fn report(
    rows: u32,
    reference: impl Fn(f64) -> [f64; 3],
    output: impl Fn([f64; 3]) -> [f64; 3],
) -> (i32, Value, String) {
    let mut text = String::from("Time (s)");
    for sensor in [0, 1] {
        for axis in ["X", "Y", "Z"] {
            write!(text, ",Accelerometer {sensor} {axis} (m/s²)").unwrap();
        }
    }
    for k in 0..rows {
        let t = f64::from(k) * 0.01;
        // Noise of 5 mm/s², the same in every run.
        let rough = |i: usize| 0.007 * (f64::from(k) * (12.3 + 1.7 * i as f64)).sin();
        let force = reference(t);
        let [x, y, z]: [f64; 3] = std::array::from_fn(|i| force[i] + rough(i));
        let other = output(force);
        let [u, v, w]: [f64; 3] = std::array::from_fn(|i| other[i] + rough(i + 3));
        write!(text, "\n{t:.2},{x},{y},{z},{u},{v},{w}").unwrap();
    }
    let (csv, _folder) = in_folder("two.csv");
    fs::write(&csv, text).unwrap();
    let ran = wimu(&["calibrate", &csv, "--method", "reference"]);
    (ran.code, ran.object(), ran.stderr)
}

fn moving(t: f64) -> [f64; 3] {
    [
        3.0 * (2.0 * t).sin(),
        3.0 * (3.1 * t).cos(),
        9.81 + 2.0 * (4.7 * t).sin(),
    ]
}

#[test]
fn at_one_pose_the_offset_alone_is_told_and_that_it_is() {
    let (code, report, said) = report(2000, |_| [0.1, -0.2, 9.8], |f| f.map(|f| 1.02 * f + 0.3));
    assert_eq!(code, 0, "{report}");
    assert_eq!(report["terms"], serde_json::json!(["offset"]));
    for (axis, offset) in [0.302, 0.296, 0.496].into_iter().enumerate() {
        let found = &report["axes"][axis];
        assert_eq!(found["separated"], false);
        let off = found["offset_m_s2"].as_f64().unwrap() - offset;
        assert!(off.abs() < 0.002, "{report}");
        assert_eq!(report["model"]["matrix"][axis][axis], 1.0);
    }
    assert!(
        said.contains("bias and scale factor not separable"),
        "{said}"
    );
}

#[test]
fn what_tells_nothing_about_a_stream_is_refused_with_the_reason() {
    let same = |force: [f64; 3]| force;
    let short = |t: f64| match t {
        ..0.5 => moving(6.0 * t).map(|f| 3.0 * f),
        _ => [0.0, 0.0, 9.8],
    };
    let (_, good, _) = report(2000, moving, same);
    assert_eq!(good["status"], "ok", "{good}");
    type Output = fn([f64; 3]) -> [f64; 3];
    let mirrored: Output = |[x, y, z]| [x, -y, z];
    let in_g: Output = |force| force.map(|f| f / 9.80665);
    let dead: Output = |[x, _, z]| [x, 1.0, z];
    for (rows, output, reason) in [
        (4, same as Output, "8 are needed"),
        (
            2000,
            mirrored,
            "axis Y of one stream is that of the other negated",
        ),
        (2000, in_g, "looks like g"),
        (2000, dead, "different motions"),
    ] {
        let (code, report, _) = report(rows, moving, output);
        let told = report["reason"].as_str().unwrap_or_default();
        assert!(code == 3 && told.contains(reason), "{reason}: {report}");
        assert!(report["model"].is_null());
    }
    let (code, report, _) = report(2000, short, same);
    let told = report["reason"].as_str().unwrap_or_default();
    assert!(code == 3 && told.contains("one short part"), "{report}");
}

#[test]
fn streams_in_another_unit_are_told_so() {
    let (code, found, said) = report(
        2000,
        |t| moving(t).map(|f| f / 9.80665),
        |f| f.map(|f| 1.02 * f),
    );
    assert_eq!(code, 3, "{found}");
    assert!(
        said.contains("the reference is") && said.contains("looks like g"),
        "{said}"
    );
    let (code, found, said) = report(2000, moving, |f| f.map(|f| 1671.0 * f));
    assert_eq!(code, 3, "{found}");
    assert!(
        said.contains("the output is") && said.contains("looks like counts"),
        "{said}"
    );
}

#[test]
fn a_reference_of_another_sensitivity_is_said_by_its_own_flag() {
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
        let ran = with(flags);
        assert_eq!(ran.code, 3, "{ran:?}");
        let told = ran.object()["reason"].to_string();
        assert!(told.contains("--reference-sensitivity"), "{told}");
    }
    let both = ["--sensitivity", "4096", "--reference-sensitivity", "16384"];
    let found = with(&both).succeeds();
    for axis in 0..3 {
        let scale = found["model"]["matrix"][axis][axis].as_f64().unwrap();
        let bias = found["model"]["bias_m_s2"][axis].as_f64().unwrap();
        assert!((scale - 1.01).abs() < 1e-3, "{found}");
        assert!((bias - 0.02 * 9.80665).abs() < 5e-3, "{found}");
    }
    assert_eq!(found["range_source"], "sixteen_bits");
    let at = [&both[..], &["--range", "4"]].concat();
    let found = with(&at).succeeds();
    assert_eq!(found["parameters"]["range_g"], 4);
    assert_eq!(found["range_source"], "given");
    with(&["--reference-sensitivity", "16384"]).fails(2, "usage");
    with(&["--sensitivity", "4096", "--reference-sensitivity", "0"]).fails(2, "usage");
}
