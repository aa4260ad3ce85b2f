//! `wimu navigate` on input with faults: wrong units, dead axes, no rest.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use kit::{Transcript, findings, folder, record_motion, wimu};
use serde_json::Value;
use wimu_testkit::trials;

const G: f64 = 9.80665;

/// Noise without a pattern, -0.5 to 0.5.
fn noise(k: u32) -> f64 {
    let mut x = u64::from(k).wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((x ^ (x >> 31)) >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
}

/// A sample: time, force, angular rate, position along x.
#[derive(Clone, Copy)]
struct Sample {
    t: f64,
    force: [f64; 3],
    rate: [f64; 3],
    x: f64,
}

/// Moves of `length_m` along x in `last` s each, to and fro, with rests of 1.5 s between, from 2 s on, at 100 Hz.
fn moves(length_m: f64, last: f64) -> Vec<Sample> {
    let period = last + 1.5;
    let count = ((2.0 + 3.0 * period) * 100.0) as u32;
    let sample = |k: u32| {
        let t = f64::from(k) * 0.01;
        let (mut x, mut acceleration) = (0.0, 0.0);
        for n in 0..3 {
            let tau = ((t - 2.0 - f64::from(n) * period) / last).clamp(0.0, 1.0);
            let sign = if n % 2 == 0 { length_m } else { -length_m };
            x += sign * tau.powi(3) * (10.0 - 15.0 * tau + 6.0 * tau * tau);
            acceleration += sign * 60.0 * tau * (1.0 - tau) * (1.0 - 2.0 * tau) / (last * last);
        }
        let n = |i: u32| 0.08 * noise(6 * k + i);
        Sample {
            t,
            force: [0.03 + acceleration + n(0), -0.02 + n(1), G + n(2)],
            rate: [3, 4, 5].map(|i| 0.004 + 0.1 * n(i)),
            x,
        }
    };
    (0..count).map(sample).collect()
}

const FORCE: &str = "Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²)";
const RATE: &str = ",Gyroscope X (rad/s),Gyroscope Y (rad/s),Gyroscope Z (rad/s)";
/// Methods, and the columns that a file needs besides [`FORCE`].
const SENSORS: [(&str, &str); 2] = [("strapdown", RATE), ("tilt", "")];
const TRUTH: &str = ",Truth Position E (m),Truth Position N (m),Truth Position U (m),\
                     Truth Quaternion W,Truth Quaternion X,Truth Quaternion Y,Truth Quaternion Z";

fn write(folder: &Path, header: &str, samples: &[Sample]) -> String {
    let mut text = format!("Time (s),{header}\n");
    for Sample { t, force, rate, x } in samples {
        write!(text, "{t:.3},{},{},{}", force[0], force[1], force[2]).unwrap();
        if header.contains("Gyroscope") || header.contains("Gyro ") {
            write!(text, ",{},{},{}", rate[0], rate[1], rate[2]).unwrap();
        }
        if header.contains("Truth") {
            write!(text, ",{x},0,0,1,0,0,0").unwrap();
        }
        text.push('\n');
    }
    let path = folder.join("in.csv");
    fs::write(&path, text).unwrap();
    path.display().to_string()
}

fn number(value: &Value, pointer: &str) -> f64 {
    let found = value.pointer(pointer).and_then(Value::as_f64);
    found.unwrap_or_else(|| panic!("{pointer} of {value}"))
}

#[test]
fn a_dead_axis_is_reported_and_invalidates_what_depends_on_it() {
    let mut texts = Transcript::default();
    let folder = folder();
    let header = format!("{FORCE}{RATE}{TRUTH}");
    let mut samples = moves(0.4, 1.0);
    for sample in &mut samples[250..] {
        sample.force[1] = 0.1;
    }
    for (method, rate) in SENSORS {
        let csv = write(folder.path(), &format!("{FORCE}{rate}{TRUTH}"), &samples);
        let ran = wimu(&["navigate", &csv]);
        let report = texts.findings(format_args!("accelerometer Y, {method}"), &ran);
        assert!(number(&report, "/valid_share") < 0.4, "{report}");
    }
    // Shaken about y from the first move on, the gyroscope's z stuck.
    let mut samples = moves(0.4, 1.0);
    for sample in &mut samples[250..] {
        let t = sample.t;
        sample.rate[1] += 0.5 * (9.0 * t).sin();
        sample.rate[2] = 0.7;
    }
    let csv = write(folder.path(), &header, &samples);
    let ran = wimu(&["navigate", &csv]);
    let report = texts.findings("gyroscope Z", &ran);
    assert!(number(&report, "/nees/share_below_7_81") > 0.9, "{report}");
    // Laid on its side at the end, and all of the gyroscope silent.
    let mut samples = moves(0.4, 1.0);
    let from = samples.len() - 250;
    for (k, sample) in samples.iter_mut().enumerate() {
        sample.rate = [0.0; 3];
        if k >= from {
            let [x, y, z] = sample.force;
            sample.force = [x, -z, y];
        }
    }
    let csv = write(folder.path(), &header, &samples);
    texts.findings("gyroscope, all axes", &wimu(&["navigate", &csv]));
    texts.check("navigate_dead_axes");
}

#[test]
fn a_frozen_accelerometer_is_invalid_and_coarse_steps_and_held_samples_are_not_frozen() {
    let mut texts = Transcript::default();
    let folder = folder();
    let header = format!("{FORCE}{RATE}{TRUTH}");
    let ran = |samples: &[Sample]| {
        let csv = write(folder.path(), &header, samples);
        wimu(&["navigate", &csv])
    };
    // In the middle of the first move.
    let mut samples = moves(0.4, 1.0);
    let last = samples[240].force;
    for sample in &mut samples[241..] {
        sample.force = last;
    }
    let report = texts.findings("frozen", &ran(&samples));
    assert!(number(&report, "/valid_share") < 242.0 / 950.0, "{report}");
    assert!(number(&report, "/nees/share_below_7_81") > 0.9, "{report}");
    // Steps larger than the noise at rest.
    let mut samples = moves(0.4, 1.0);
    for sample in &mut samples {
        sample.force = sample.force.map(|f| (f / 0.15).round() * 0.15);
    }
    texts.findings("coarse steps", &ran(&samples));
    // A fifth of the rate.
    let mut samples = moves(0.4, 1.0);
    for k in 0..samples.len() {
        samples[k].force = samples[k - k % 5].force;
    }
    texts.findings("held samples", &ran(&samples));
    texts.check("navigate_frozen_accelerometer");
}

#[test]
fn columns_that_are_nearly_right_are_refused_or_remarked() {
    let mut texts = Transcript::default();
    let folder = folder();
    let samples = moves(0.4, 1.0);
    let ran = |rate: &str, truth: &str| {
        let header = format!("{FORCE}{rate}{truth}");
        wimu(&["navigate", &write(folder.path(), &header, &samples)])
    };
    let missing = ran(&RATE.replace("Gyroscope Y (rad/s)", "Other"), "");
    texts.fails("no Gyroscope Y", &missing, 2, "csv_missing_column");
    let mm = ran(RATE, &TRUTH.replace("Position E (m)", "Position E (mm)"));
    texts.findings("truth in mm", &mm);
    let rpm = ran(&RATE.replace("Z (rad/s)", "Z (rpm)"), "");
    texts.fails("rpm", &rpm, 2, "csv_missing_column");
    let gyro = ran(&RATE.replace("Gyroscope", "Gyro "), "");
    assert_eq!(gyro.succeeds()["method"], "strapdown");
    texts.check("navigate_columns");
    // Each axis has its own unit.
    let mut samples = samples.clone();
    for sample in &mut samples {
        sample.rate[0] = sample.rate[0].to_degrees();
    }
    let header = format!("{FORCE}{}{TRUTH}", RATE.replace("X (rad/s)", "X (deg/s)"));
    let report = wimu(&["navigate", &write(folder.path(), &header, &samples)]).succeeds();
    assert!(number(&report, "/nees/share_below_7_81") > 0.9, "{report}");
}

#[test]
fn a_recording_and_the_table_exported_from_it_give_the_same_path() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (session, table) = (path("s.mcap"), path("s.csv"));
    record_motion("slide", 4, &session);
    wimu(&["convert", &session, "--stream", "corrected", "-o", &table]).succeeds();
    let tilt = |input: &str| wimu(&["navigate", input]).succeeds();
    let (session, of_table) = (tilt(&session), tilt(&table));
    let of_session = &session["path"];
    for key in ["/duration_s", "/distance_m", "/valid_share", "/final_position_m/0"] {
        let (a, b) = (number(of_session, key), number(&of_table, key));
        assert!((a - b).abs() < 1e-3 + 1e-3 * a.abs(), "{key}: {a} {b}");
    }
    // The board's magnetometer is not calibrated: both leave it out.
    let mut texts = Transcript::default();
    texts.list("recording", findings(&session));
    texts.list("table", findings(&of_table));
    texts.check("navigate_recording_and_table");
}

#[test]
fn cautious_updates_cover_an_undetected_velocity_and_clipped_samples_are_not_used() {
    let folder = folder();
    let header = format!("{FORCE}{RATE}{TRUTH}");
    // Pushed to 0.02 m/s within 1 s, then 20 s evenly: no rest ends, and nothing shows it.
    let mut samples = moves(0.0, 8.0);
    let mut x = 0.0;
    for sample in &mut samples {
        let tau = (sample.t - 4.0).clamp(0.0, 1.0);
        sample.force[0] += 0.04 * (std::f64::consts::PI * tau).sin().powi(2);
        x += 0.01 * 0.02 * (tau - (std::f64::consts::TAU * tau).sin() / std::f64::consts::TAU);
        sample.x = x;
    }
    for (_, rate) in SENSORS {
        let csv = write(folder.path(), &format!("{FORCE}{rate}{TRUTH}"), &samples);
        // Slower than what else counts as moving.
        let text = fs::read_to_string(&csv).unwrap();
        let mut lines = text.lines();
        let mut text = format!("{},Moving\n", lines.next().unwrap());
        for (line, sample) in lines.zip(&samples) {
            writeln!(text, "{line},{}", u8::from(sample.t > 4.0)).unwrap();
        }
        fs::write(&csv, text).unwrap();
        let with = |zupt: &str| wimu(&["navigate", &csv, "--zupt", zupt]).succeeds();
        let (cautious, stated) = (with("cautious"), with("on"));
        let below = |report: &Value| number(report, "/nees/share_below_7_81");
        assert!(below(&cautious) > 0.97, "{cautious}");
        assert!(below(&stated) < 0.5, "{stated}");
        assert_eq!(with("off")["rests"], 0);
    }
    // A knock beyond 2 g.
    let mut samples = moves(0.4, 1.0);
    for sample in &mut samples[250..256] {
        sample.force[0] = 2.0 * G;
    }
    let ran = wimu(&["navigate", &write(folder.path(), &header, &samples)]);
    let mut texts = Transcript::default();
    texts.findings("6 samples at 2 g", &ran);
    texts.check("navigate_clipped");
}

#[test]
fn a_short_failure_of_the_gyroscope_is_bridged_and_reported() {
    let folder = folder();
    let samples = moves(0.4, 1.0);
    let csv = write(folder.path(), &format!("{FORCE}{RATE}{TRUTH}"), &samples);
    let text = fs::read_to_string(&csv).unwrap();
    let cut = |(k, line): (usize, &str)| {
        let mut cells: Vec<&str> = line.split(',').collect();
        if (241..261).contains(&k) {
            cells[4..7].fill("");
        }
        cells.join(",") + "\n"
    };
    fs::write(&csv, text.lines().enumerate().map(cut).collect::<String>()).unwrap();
    let mut texts = Transcript::default();
    let ran = wimu(&["navigate", &csv, "--zupt", "on"]);
    let report = texts.findings("20 samples missing", &ran);
    texts.check("navigate_gyroscope_fails");
    assert!(number(&report, "/nees/share_below_7_81") > 0.9, "{report}");
    assert!(number(&report, "/valid_share") > 0.8, "{report}");
}

#[test]
fn samples_that_are_no_numbers_count_as_missing_and_many_of_them_are_refused() {
    let mut texts = Transcript::default();
    let folder = folder();
    let samples = moves(0.4, 1.0);
    let run = |spoil: &dyn Fn(usize) -> bool, rate: &str| {
        let mut samples = samples.clone();
        for (k, sample) in samples.iter_mut().enumerate() {
            if spoil(k) {
                sample.force[1] = f64::NAN;
            }
        }
        let header = format!("{FORCE}{rate}{TRUTH}");
        wimu(&["navigate", &write(folder.path(), &header, &samples)])
    };
    for (method, rate) in SENSORS {
        // Single samples, as if their lines were missing.
        let ran = run(&|k| k % 97 == 50, rate);
        let report = texts.findings(format_args!("one of 97, {method}"), &ran);
        assert!(number(&report, "/valid_share") > 0.5, "{report}");
        assert!(number(&report, "/nees/share_below_7_81") > 0.9, "{method} {report}");
        // From then on none: it is not valid there.
        let cut = run(&|k| k > 600, rate).succeeds();
        assert_eq!(cut["final_valid"], false, "{cut}");
        // Too long to be bridged.
        let ran = run(&|k| (230..270).contains(&k), rate);
        let gap = texts.findings(format_args!("0.4 s, {method}"), &ran);
        let end = |report: &Value| number(report, "/final_sigma_m/0");
        assert!(end(&gap) > end(&report), "{gap}");
        assert!(number(&gap, "/nees/share_below_7_81") > 0.9, "{gap}");
    }
    let ran = run(&|k| k > 300, "");
    texts.fails("from 3.01 s on", &ran, 3, "data_refused");
    texts.check("navigate_no_numbers");
}

#[test]
fn outliers_are_left_out_and_a_recording_of_outliers_is_refused() {
    let mut texts = Transcript::default();
    let folder = folder();
    let run = |wild: &dyn Fn(usize) -> bool, value: f64, rate: &str| {
        let mut samples = moves(0.4, 1.0);
        for (k, sample) in samples.iter_mut().enumerate() {
            if wild(k) {
                sample.force[1] = value;
            }
        }
        let header = format!("{FORCE}{rate}{TRUTH}");
        wimu(&["navigate", &write(folder.path(), &header, &samples)])
    };
    for (method, rate) in SENSORS {
        for value in [65_536.0, 1e308] {
            let ran = run(&|k| k == 300, value, rate);
            let report = texts.findings(format_args!("{value:e}, {method}"), &ran);
            assert!(number(&report, "/distance_m") < 5.0, "{report}");
            assert!(number(&report, "/nees/share_below_7_81") > 0.9, "{report}");
        }
        let ran = run(&|k| k % 3 != 0, 3000.0, rate);
        texts.fails(format_args!("two of three, {method}"), &ran, 3, "data_refused");
    }
    texts.check("navigate_outliers");
}

#[test]
fn a_coarse_axis_that_repeats_itself_is_not_dead() {
    let folder = folder();
    let step = 0.08;
    let mut expected = None;
    for seed in 0..trials(30) as u32 {
        let mut samples = moves(0.4, 1.0);
        for (k, sample) in samples.iter_mut().enumerate() {
            for (axis, force) in sample.force.iter_mut().enumerate() {
                let lies = step * noise(90_000 + 3 * seed + axis as u32);
                let fine = 0.3 * noise(9 * (k as u32 + 1000 * seed) + axis as u32) * step;
                *force = ((*force + lies + fine) / step).round() * step;
            }
        }
        let report = wimu(&["navigate", &write(folder.path(), FORCE, &samples)]).succeeds();
        // A dead axis would be a remark more.
        let count = findings(&report).len();
        assert_eq!(*expected.get_or_insert(count), count, "{seed}: {report}");
        assert!(number(&report, "/valid_share") > 0.0, "{seed}: {report}");
    }
}

#[test]
fn a_constant_magnetometer_of_a_tilting_unit_is_left_out_and_reported() {
    let folder = folder();
    let mut text =
        format!("Time (s),{FORCE},Magnetometer X (µT),Magnetometer Y (µT),Magnetometer Z (µT)\n");
    for k in 0..1200_u32 {
        // Tilted by 60° about x within 2 s, from 5 s on.
        let tau = ((f64::from(k) * 0.01 - 5.0) / 2.0).clamp(0.0, 1.0);
        let (sin, cos) = (1.047 * tau * tau * (3.0 - 2.0 * tau)).sin_cos();
        let n = |i: u32| 0.05 * noise(3 * k + i);
        let (x, y, z) = (n(0), G * sin + n(1), G * cos + n(2));
        writeln!(text, "{:.2},{x},{y},{z},1.5,20,-44.25", f64::from(k) * 0.01).unwrap();
    }
    let path = folder.path().join("dead.csv").display().to_string();
    fs::write(&path, text).unwrap();
    let mut texts = Transcript::default();
    texts.findings("constant magnetometer", &wimu(&["navigate", &path]));
    texts.check("navigate_constant_magnetometer");
}

#[test]
fn a_gyroscope_that_warms_up_over_a_long_first_rest_is_navigated() {
    let folder = folder();
    let mut texts = Transcript::default();
    for (rest_s, warms) in [(60_u32, 0.1_f64), (120, 1.0)] {
        let mut samples = moves(0.4, 1.0);
        let still: Vec<Sample> = samples[..150].to_vec();
        let count = 100 * rest_s;
        let mut all: Vec<Sample> = (0..count).map(|k| still[(k % 150) as usize]).collect();
        all.append(&mut samples);
        for (k, sample) in all.iter_mut().enumerate() {
            sample.t = k as f64 * 0.01;
            let bias = warms.to_radians() * (-sample.t / 60.0).exp();
            let n = |i: usize| 0.01 * noise((3 * k + i) as u32);
            sample.rate = [0, 1, 2].map(|i| 0.004 + bias + n(i));
            sample.force[1] += 0.02 * noise(7 * k as u32);
        }
        let csv = write(folder.path(), &format!("{FORCE}{RATE}{TRUTH}"), &all);
        let ran = wimu(&["navigate", &csv]);
        let case = format!("{warms} °/s, rest of {rest_s} s");
        let report = texts.findings(case, &ran);
        assert!(number(&report, "/nees/share_below_7_81") > 0.9, "{rest_s} {warms} {report}");
        assert!(number(&report, "/valid_share") > 0.9, "{rest_s} {warms} {report}");
    }
    texts.check("navigate_gyroscope_warms_up");
}
