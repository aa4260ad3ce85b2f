//! Input of `wimu calibrate --method reference`.

use crate::kit;

use std::fmt::Write;
use std::fs;

use kit::{Ran, Transcript, in_folder, wimu};

/// Calibrates two accelerometers at 100 Hz, both in columns of m/s²: the force on the reference at time t,
/// and the other's output for it.
fn run(
    rows: u32,
    reference: impl Fn(f64) -> [f64; 3],
    output: impl Fn([f64; 3]) -> [f64; 3],
) -> Ran {
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
    wimu(&["calibrate", &csv, "--method", "reference"])
}

fn moving(t: f64) -> [f64; 3] {
    [3.0 * (2.0 * t).sin(), 3.0 * (3.1 * t).cos(), 9.81 + 2.0 * (4.7 * t).sin()]
}

#[test]
fn at_one_pose_only_the_offset_is_reported() {
    let ran = run(2000, |_| [0.1, -0.2, 9.8], |f| f.map(|f| 1.02 * f + 0.3));
    let report = ran.succeeds();
    assert_eq!(report["terms"], serde_json::json!(["offset"]));
    for (axis, offset) in [0.302, 0.296, 0.496].into_iter().enumerate() {
        let found = &report["axes"][axis];
        assert_eq!(found["separated"], false);
        let off = found["offset_m_s2"].as_f64().unwrap() - offset;
        assert!(off.abs() < 0.002, "{report}");
        assert_eq!(report["model"]["matrix"][axis][axis], 1.0);
    }
    let mut texts = Transcript::default();
    texts.text("calibrate --method reference at one pose", &ran);
    texts.check("calibrate_reference_one_pose");
}

#[test]
fn streams_that_determine_nothing_are_refused_with_the_reason() {
    let same = |force: [f64; 3]| force;
    let short = |t: f64| match t {
        ..0.5 => moving(6.0 * t).map(|f| 3.0 * f),
        _ => [0.0, 0.0, 9.8],
    };
    run(2000, moving, same).succeeds();
    let mut texts = Transcript::default();
    type Output = fn([f64; 3]) -> [f64; 3];
    let mirrored: Output = |[x, y, z]| [x, -y, z];
    let in_g: Output = |force| force.map(|f| f / 9.80665);
    let dead: Output = |[x, _, z]| [x, 1.0, z];
    for (case, rows, output) in [
        ("4 rows", 4, same as Output),
        ("Y negated", 2000, mirrored),
        ("output in g", 2000, in_g),
        ("Y constant", 2000, dead),
    ] {
        let report = texts.refuses(case, &run(rows, moving, output));
        assert!(report["model"].is_null());
    }
    texts.refuses("motion of 0.5 s", &run(2000, short, same));
    let in_g = |t: f64| moving(t).map(|f| f / 9.80665);
    let ran = run(2000, in_g, |f| f.map(|f| 1.02 * f));
    texts.refuses("both in g", &ran);
    let ran = run(2000, moving, |f| f.map(|f| 1671.0 * f));
    texts.refuses("output in counts", &ran);
    texts.check("calibrate_reference_refusals");
}

#[test]
fn a_reference_of_another_sensitivity_has_its_own_option() {
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
