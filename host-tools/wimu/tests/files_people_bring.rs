//! Recordings of other loggers: pauses, ranges, weights, column names and separators.

use crate::kit;

use std::fmt::Write;
use std::fs;

use kit::{Transcript, in_folder, noise, snapshot, spread, wimu};
use serde_json::Value;

const G: f64 = 9.80665;
const NAMES: &str = "Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²)";

/// A sensor held still for three seconds each way up at 50 Hz, its bias drifting by `drift` over the whole
/// time; the logger pauses for so long half-way.
fn turned(ups: &[[f64; 3]], drift: [f64; 3], pause_s: f64) -> String {
    let mut rough = noise();
    let mut text = format!("Time (s),{NAMES}");
    let rows = ups.len() * 200;
    let time = |k: usize| k as f64 * 0.02 + if k < rows / 2 { 0.0 } else { pause_s };
    let whole = time(rows - 1);
    for k in 0..rows {
        let (pose, within) = (k / 200, k % 200);
        let next = ups[(pose + 1) % ups.len()];
        // A second on the way to the next.
        let way = (within as f64 - 150.0).max(0.0) / 50.0;
        let mut up = [0, 1, 2].map(|i| ups[pose][i] * (1.0 - way) + next[i] * way);
        up[0] += 0.3 * (way * std::f64::consts::PI).sin();
        let length = up.iter().map(|u| u * u).sum::<f64>().sqrt();
        let t = time(k);
        write!(text, "\n{t:.2}").unwrap();
        for i in 0..3 {
            let value = G * up[i] / length + drift[i] * t / whole + 0.005 * rough();
            write!(text, ",{value:.5}").unwrap();
        }
    }
    text
}

#[test]
fn a_pause_of_the_logger_is_part_of_the_time_that_a_drift_takes() {
    let (csv, _folder) = in_folder("turned.csv");
    let drift = [0.04, -0.03, 0.03];
    let of = ["calibrate", &csv, "--gravity", "9.80665", "--model", "9+drift"];
    let mut texts = Transcript::default();
    // In no order, so that the drift is not taken for the sensor's.
    let even = spread(24);
    let ups: Vec<_> = (0..24).map(|k| even[7 * k % 24]).collect();
    for pause_s in [0.0, 1200.0] {
        fs::write(&csv, turned(&ups, drift, pause_s)).unwrap();
        let ran = wimu(&of);
        let report = texts.findings(format_args!("pause of {pause_s} s"), &ran);
        assert_eq!(report["poses"], 24, "{report}");
        let span = report["drift"]["span_s"].as_f64().unwrap();
        let poses = report["static_poses"].as_array().unwrap();
        let time = |k: usize| poses[k]["time_s"].as_f64().unwrap();
        // 23 poses of four seconds.
        assert!((span - 92.0 - pause_s).abs() < 1.0, "{span}");
        assert!((time(23) - time(0) - 92.0 - pause_s).abs() < 1.0);
        assert!((time(11) - time(0) - 44.0).abs() < 1.0);
        let whole = 96.0 + pause_s;
        for axis in 0..3 {
            let change = report["drift"]["change_m_s2"][axis].as_f64().unwrap();
            let truth = drift[axis] * span / whole;
            assert!((change - truth).abs() < 0.004, "{change} {truth} {pause_s}");
        }
        assert!(report["rms_mm_s2"].as_f64().unwrap() < 2.0, "{report}");
        let first = poses[12]["first_sample"].as_u64().unwrap();
        assert!((2400..2430).contains(&first), "{first}");
    }
    texts.check("calibrate_pause");
}

#[test]
fn the_noise_is_not_taken_across_a_pause() {
    let (csv, _folder) = in_folder("rest.csv");
    let run = |step: f64| {
        let mut rough = noise();
        let mut text = format!("Time (s),{NAMES}");
        for k in 0..6000 {
            let (t, off) = match k {
                ..3000 => (0.0, 0.0),
                _ => (100.0, step),
            };
            let [x, y, z] = [0.1, 0.2, G].map(|f| f + off + 0.02 * rough());
            write!(text, "\n{:.2},{x:.6},{y:.6},{z:.6}", t + f64::from(k) * 0.01).unwrap();
        }
        fs::write(&csv, text).unwrap();
        wimu(&["allan", &csv])
    };
    // The change of bias within the pause does not show.
    let mut texts = Transcript::default();
    let still = run(0.0).succeeds();
    let moved = texts.findings("pause of 100 s", &run(0.05));
    texts.check("allan_pause");
    let curve = |report: &Value| -> Vec<f64> {
        let points = report["accelerometer"]["points"].as_array().unwrap().iter();
        points
            .flat_map(|point| [0, 1, 2].map(|axis| point["deviation"][axis].as_f64().unwrap()))
            .collect()
    };
    assert!(curve(&still).len() > 20);
    for (a, b) in curve(&still).into_iter().zip(curve(&moved)) {
        assert!((a - b).abs() < 1e-6, "{a} {b}");
    }
    assert!((moved["rate_hz"].as_f64().unwrap() - 100.0).abs() < 1e-6);
}

/// Means of poses of a sensor with a bias of 1 mg, by `per_g` counts.
fn counts(per_g: f64) -> String {
    let mut text =
        String::from("Accelerometer X (LSB),Accelerometer Y (LSB),Accelerometer Z (LSB)");
    for up in spread(24) {
        let [x, y, z] = up.map(|u| (u + 0.001) * per_g);
        write!(text, "\n{x:.2},{y:.2},{z:.2}").unwrap();
    }
    text
}

#[test]
fn a_range_that_is_not_given_is_remarked_as_assumed() {
    let mut texts = Transcript::default();
    let (csv, folder) = in_folder("counts.csv");
    fs::write(&csv, counts(256.0)).unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (cal, header) = (path("CAL.json"), path("cal.h"));
    let of = ["calibrate", &csv, "--poses", "--sensitivity", "256", "-o", &cal];
    let guessed = texts.findings("no range", &wimu(&of));
    assert_eq!(guessed["range_source"], "sixteen_bits");
    let export = ["convert", &cal, "--to", "c", "-o", &header];
    texts.findings("no range, exported", &wimu(&export));

    let ran = wimu(&[&of[..], &["--range", "2"]].concat());
    let given = texts.findings("--range 2", &ran);
    assert_eq!(given["parameters"]["range_g"], 2);
    assert_eq!((&given["range_g"], &given["range_source"]), (&2.into(), &"given".into()));
    assert_eq!(wimu(&export).succeeds()["problems"], serde_json::json!([]));
    for wrong in ["0", "128", "-2", "two"] {
        assert_eq!(wimu(&[&of[..], &["--range", wrong]].concat()).code, 2);
    }
    // A board reports its own range.
    let link = wimu(&["calibrate", "tcp://127.0.0.1:1", "--range", "2"]);
    texts.fails("--range with a LINK", &link, 2, "usage");
    texts.check("calibrate_range");
    let text = fs::read_to_string(&header).unwrap();
    snapshot("export_c", &text, &[]);
}

#[test]
fn a_coarse_sensor_is_calibrated_and_cannot_be_pushed() {
    let (csv, _folder) = in_folder("counts.csv");
    fs::write(&csv, counts(64.0)).unwrap();
    let of = ["calibrate", &csv, "--poses", "--sensitivity"];
    let report = wimu(&[&of[..], &["64"]].concat()).succeeds();
    assert_eq!(report["sensitivity_lsb_per_g"], 64.0);
    assert!(report["parameters"].is_null());
    let bias = report["model"]["bias_m_s2"][0].as_f64().unwrap();
    assert!(bias.abs() < 0.01, "{report}");
    for wrong in ["0", "-5", "NaN", "1e9"] {
        wimu(&[&of[..], &[wrong]].concat()).fails(2, "usage");
    }
}

#[test]
fn a_column_of_samples_in_each_pose_has_counts() {
    let (csv, _folder) = in_folder("means.csv");
    let of = ["calibrate", &csv, "--poses", "--gravity", "9.80665"];
    let table = |one: &str| {
        let mut text = format!("{NAMES},Samples");
        for (k, up) in spread(24).into_iter().enumerate() {
            let [x, y, z] = up.map(|u| u * G);
            write!(text, "\n{x},{y},{z},{}", if k == 12 { one } else { "1000" }).unwrap();
        }
        text
    };
    let mut texts = Transcript::default();
    for wrong in ["0", "-5", "100.5", "many", ""] {
        fs::write(&csv, table(wrong)).unwrap();
        texts.fails(format_args!("{wrong:?}"), &wimu(&of), 2, "csv_bad_number");
    }
    texts.check("calibrate_column_samples");
}

#[test]
fn the_count_at_zero_is_stored_with_the_calibration() {
    let (csv, folder) = in_folder("counts.csv");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (cal, rest, out) = (path("CAL.json"), path("rest.csv"), path("out.csv"));
    let names = "Accelerometer X (LSB),Accelerometer Y (LSB),Accelerometer Z (LSB)";
    let mut text = names.to_owned();
    for up in spread(24) {
        let [x, y, z] = up.map(|u| (30_000.0 + 8000.0 * u).round());
        write!(text, "\n{x},{y},{z}").unwrap();
    }
    fs::write(&csv, text).unwrap();
    let calibrate =
        ["calibrate", &csv, "--poses", "--sensitivity", "8000", "--units", "@30000", "-o", &cal];
    wimu(&calibrate).succeeds();
    // One orientation does not show the count at zero.
    let row = "30000,30000,38000";
    fs::write(&rest, format!("Time (s),{names}\n0,{row}\n0.01,{row}\n")).unwrap();
    wimu(&["convert", &rest, "--with", &cal, "-o", &out]).succeeds();
    let corrected = fs::read_to_string(&out).unwrap();
    let z: f64 = (corrected.lines().nth(1).unwrap().split(',').nth(3).unwrap()).parse().unwrap();
    assert!((z - G).abs() < 0.01, "{corrected}");
}
