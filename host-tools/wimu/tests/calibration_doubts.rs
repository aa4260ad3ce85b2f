//! Findings of a calibration: bad poses, temperature, rotations off level, stuck and clipped axes.

use crate::kit;

use std::fmt::Write;
use std::fs;

use kit::{Ran, Transcript, folder, noise, spread, wimu};

const G: f64 = 9.80665;

/// `Time (s)`, three axes and perhaps a temperature, by row.
fn csv(unit: &str, rows: impl Iterator<Item = (f64, [f64; 3], Option<f64>)>) -> String {
    let mut text = String::from("Time (s)");
    for axis in ["X", "Y", "Z"] {
        write!(text, ",Accelerometer {axis} ({unit})").unwrap();
    }
    for (k, (time, [x, y, z], celsius)) in rows.enumerate() {
        if let Some(celsius) = celsius {
            if k == 0 {
                text += ",Temperature (°C)";
            }
            write!(text, "\n{time},{x},{y},{z},{celsius}").unwrap();
        } else {
            write!(text, "\n{time},{x},{y},{z}").unwrap();
        }
    }
    text
}

/// What a usual sensor reads with `up` upward.
fn output(up: [f64; 3]) -> [f64; 3] {
    let [x, y, z] = up.map(|u| u * G);
    [0.2 + 1.012 * x, -0.15 + 0.01 * x + 0.991 * y, 0.3 - 0.004 * x + 0.008 * y + 1.006 * z]
}

/// Means of poses, each through `change`.
fn means(ups: &[[f64; 3]], mut change: impl FnMut(usize, [f64; 3]) -> [f64; 3]) -> String {
    let mut noise = noise();
    let mut rows = Vec::new();
    for (k, up) in ups.iter().enumerate() {
        let mean = output(*up).map(|y| y + 0.003 * noise());
        rows.push((k as f64, change(k, mean), None));
    }
    csv("m/s²", rows.into_iter())
}

fn run(text: &str, flags: &[&str]) -> Ran {
    let folder = folder();
    let path = folder.path().join("data.csv").display().to_string();
    fs::write(&path, text).unwrap();
    wimu(&[&["calibrate", &path][..], flags].concat())
}

#[test]
fn one_bad_pose_of_twelve_is_named_and_of_twenty_left_out() {
    let bad = |k: usize, mean: [f64; 3]| {
        if k == 5 { mean.map(|y| 1.05 * y) } else { mean }
    };
    let mut texts = Transcript::default();
    for model in ["9", "auto"] {
        let flags = ["--poses", "--model", model];
        let ran = run(&means(&spread(12), bad), &flags);
        let report = texts.refuses(format_args!("pose 5 of 12, {model}"), &ran);
        assert_eq!(report["next_poses"].as_array().unwrap().len(), 2, "{report}");
        let report = run(&means(&spread(20), bad), &flags).succeeds();
        assert_eq!(report["rejected_poses"], serde_json::json!([5]));
        run(&means(&spread(12), |_, mean| mean), &flags).succeeds();
    }
    texts.check("calibrate_one_bad_pose");
}

#[test]
fn a_bias_that_depends_on_temperature_is_fitted_or_the_refusal_names_the_model() {
    let mut noise = noise();
    let mut rows = Vec::new();
    for (k, up) in spread(24).into_iter().enumerate() {
        let celsius = 25.0 + 15.0 * (0.9 * k as f64).sin();
        let warmer = celsius - 25.0;
        let mean = output(up).map(|y| y + 0.002 * noise() + 0.02 * warmer);
        rows.push((60.0 * k as f64, mean, Some(celsius)));
    }
    let text = csv("m/s²", rows.iter().copied());
    let report = run(&text, &["--poses", "--model", "auto"]).succeeds();
    let terms = report["terms"].as_array().unwrap();
    assert!(terms.contains(&"bias_temperature".into()), "{report}");
    let slope = report["model"]["temperature"]["bias_mps2_per_k"][0].as_f64().unwrap();
    assert!((slope - 0.02).abs() < 0.001, "{slope}");
    let mut texts = Transcript::default();
    let ran = run(&text, &["--poses", "--model", "9"]);
    texts.refuses("10 to 40 °C, --model 9", &ran);

    // A thermometer that shows nothing but its own noise.
    for row in &mut rows {
        row.2 = Some(25.0 + 0.2 * noise());
    }
    let text = csv("m/s²", rows.into_iter());
    let ran = run(&text, &["--poses", "--model", "9+temperature"]);
    texts.refuses("25 °C, --model 9+temperature", &ran);
    texts.check("calibrate_temperature");
}

#[test]
fn an_axle_off_level_is_remarked_and_beyond_a_possible_bias_refused() {
    let mut texts = Transcript::default();
    let turn = |steps: u32, level_deg: f64| -> String {
        let (along, flat) = level_deg.to_radians().sin_cos();
        let ups: Vec<[f64; 3]> = (0..steps)
            .map(|k| {
                let angle = std::f64::consts::TAU * f64::from(k) / f64::from(steps);
                [flat * angle.cos(), flat * angle.sin(), along]
            })
            .collect();
        // Without the bias of Z.
        means(&ups, |_, [x, y, z]| [x, y, z - 0.3])
    };
    for (steps, method) in [(4, "four-angle"), (3, "three-angle")] {
        let flags = ["--poses", "--method", method];
        let level = run(&turn(steps, 0.0), &flags).succeeds();
        let ran = run(&turn(steps, 9.0), &flags);
        let tilted = texts.findings(format_args!("{method}, 9° from level"), &ran);
        let scale = |report: &serde_json::Value| {
            let half = report["half_width_95"][3].as_f64().unwrap();
            (report["model"]["matrix"][0][0].as_f64().unwrap(), half)
        };
        let ((truth, _), (found, half)) = (scale(&level), scale(&tilted));
        assert!((found - truth).abs() <= half, "{found} ± {half} for {truth}");
        let ran = run(&turn(steps, 14.0), &flags);
        texts.refuses(format_args!("{method}, 14° from level"), &ran);
    }
    texts.check("calibrate_axle_off_level");
}

#[test]
fn a_rotation_that_returns_to_its_start_counts_and_misalignment_is_no_error() {
    let mut texts = Transcript::default();
    let turn = |steps: u32, poses: u32| -> String {
        let ups: Vec<[f64; 3]> = (0..poses)
            .map(|k| {
                let angle = 0.6 + std::f64::consts::TAU * f64::from(k) / f64::from(steps);
                [angle.cos(), angle.sin(), 0.0]
            })
            .collect();
        // X and Y lean towards each other by 1.2 % each.
        means(&ups, |_, [x, y, z]| [x + 0.012 * y, y + 0.012 * x, z])
    };
    for (steps, method) in [(4, "four-angle"), (3, "three-angle")] {
        let flags = ["--poses", "--method", method];
        let once = run(&turn(steps, steps), &flags).succeeds();
        for poses in [steps + 1, 2 * steps + 1] {
            let ran = run(&turn(steps, poses), &flags);
            let closed = texts.findings(format_args!("{method}, {poses} poses"), &ran);
            assert_eq!(closed["poses"], poses - 1);
            let bias = |report: &serde_json::Value| report["model"]["bias_m_s2"][0].as_f64();
            let apart = bias(&closed).unwrap() - bias(&once).unwrap();
            assert!(apart.abs() < 0.01, "{apart}");
        }
        let ran = run(&turn(steps, steps + 2), &flags);
        texts.refuses(format_args!("{method}, two poses more"), &ran);
    }
    texts.check("calibrate_closed_rotation");
}

#[test]
fn a_bias_that_does_not_drift_linearly_is_remarked() {
    // In an order that does not go with the time.
    let ups: Vec<[f64; 3]> = (0..40).map(|k| spread(40)[17 * k % 40]).collect();
    let drifting = |course: &dyn Fn(f64) -> f64| {
        let moved =
            |k: usize, force: [f64; 3]| force.map(|axis| axis + 0.05 * course(k as f64 / 39.0));
        run(&means(&ups, moved), &["--poses", "--model", "9+drift"])
    };
    let mut texts = Transcript::default();
    texts.findings("exponential", &drifting(&|s| 1.0 - (-5.0 * s).exp()));
    texts.findings("linear", &drifting(&|s| s));
    texts.check("calibrate_drift");
}

#[test]
fn poses_that_were_divided_by_their_length_are_refused() {
    let normal = |_: usize, force: [f64; 3]| {
        let size = force.iter().map(|axis| axis * axis).sum::<f64>().sqrt();
        force.map(|axis| G * axis / size)
    };
    let mut texts = Transcript::default();
    let divided = means(&spread(20), normal);
    texts.refuses("divided", &run(&divided, &["--poses"]));
    let plain = means(&spread(20), |_, force| force);
    texts.findings("plain", &run(&plain, &["--poses"]));
    texts.check("calibrate_normalised_poses");
}

#[test]
fn an_axis_at_full_scale_and_one_limit_of_several_are_named() {
    let mut noise = noise();
    let mut rows = Vec::new();
    for (k, up) in spread(20).into_iter().enumerate() {
        for i in 0..150 {
            let [_, y, z] = output(up).map(|y| (16384.0 / G * (y + 0.02 * noise())).round());
            rows.push(((k * 150 + i) as f64 * 0.02, [32767.0, y, z], None));
        }
    }
    let stuck = csv("LSB", rows.into_iter());
    let mut texts = Transcript::default();
    for flags in
        [&["--sensitivity", "16384"][..], &["--sensitivity", "16384", "--model", "auto"], &[]]
    {
        texts.refuses(format_args!("X stuck {}", flags.join(" ")), &run(&stuck, flags));
    }

    let mut sides = Vec::new();
    for axis in 0..3 {
        for sign in [1.0, -1.0] {
            let mut up = [0.02, -0.01, 0.015];
            up[axis] = sign;
            sides.push(up);
        }
    }
    let six = ["--poses", "--method", "six-position"];
    run(&means(&sides, |_, mean| mean), &six).succeeds();
    let clipped = means(&sides, |_, mean| mean.map(|y| y.clamp(-9.3, 9.3)));
    texts.refuses("clipped at 9.3 m/s²", &run(&clipped, &six));
    texts.check("calibrate_stuck_and_clipped_axes");
}

#[test]
fn two_poses_in_g_are_left_out_and_remarked() {
    let text = means(&spread(24), |k, mean| if k < 2 { mean.map(|y| y / G) } else { mean });
    let mut texts = Transcript::default();
    let report = texts.findings("2 of 24", &run(&text, &["--poses"]));
    texts.check("calibrate_two_poses_in_g");
    let mut left_out: Vec<u64> = report["rejected_poses"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(serde_json::Value::as_u64)
        .collect();
    left_out.sort_unstable();
    assert_eq!(left_out, [0, 1]);
}

#[test]
fn a_board_that_was_rotated_during_an_allan_measurement_is_refused_as_moving() {
    let mut noise = noise();
    let rows = (0..6000).map(|k| {
        let angle = if k < 3000 { 0.0 } else { 2.6 };
        let force = [G * f64::sin(angle), 0.0, G * f64::cos(angle)];
        let counts = force.map(|f| (16384.0 / G * (f + 0.02 * noise())).round());
        (f64::from(k) * 0.01, counts, None)
    });
    let folder = folder();
    let path = folder.path().join("data.csv").display().to_string();
    fs::write(&path, csv("LSB", rows)).unwrap();
    let mut texts = Transcript::default();
    texts.refuses("rotated in the middle", &wimu(&["allan", &path]));
    texts.check("allan_in_motion");
}

#[test]
fn a_sensor_that_is_rotated_slowly_all_the_time_is_refused() {
    let mut noise = noise();
    let rows = (0..6000).map(|k| {
        let time = f64::from(k) * 0.02;
        // 3° in a second, about an axis that wanders.
        let (along, angle) = (0.4 * (0.05 * time).sin(), (3.0 * time).to_radians());
        let flat = (1.0 - along * along).sqrt();
        let mean = output([flat * angle.cos(), flat * angle.sin(), along]);
        (time, mean.map(|y| y + 0.005 * noise()), None)
    });
    let mut texts = Transcript::default();
    texts.refuses("3 °/s", &run(&csv("m/s²", rows), &[]));
    texts.check("calibrate_slow_rotation");
}
