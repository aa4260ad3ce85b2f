//! What a calibration cannot know, and says: bad poses, temperature, turns off level, stuck and clipped axes.

use crate::kit;

use std::fmt::Write;
use std::fs;

use kit::{Ran, folder, noise, spread, wimu};

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
    [
        0.2 + 1.012 * x,
        -0.15 + 0.01 * x + 0.991 * y,
        0.3 - 0.004 * x + 0.008 * y + 1.006 * z,
    ]
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

fn reason(text: &str, flags: &[&str]) -> String {
    let ran = run(text, flags);
    assert_eq!(ran.code, 3, "{ran:?}");
    ran.object()["reason"].as_str().unwrap().to_owned()
}

#[test]
fn one_bad_pose_of_twelve_is_named_and_of_twenty_left_out() {
    let bad = |k: usize, mean: [f64; 3]| {
        if k == 5 { mean.map(|y| 1.05 * y) } else { mean }
    };
    for model in ["9", "auto"] {
        let flags = ["--poses", "--model", model];
        let ran = run(&means(&spread(12), bad), &flags);
        assert_eq!(ran.code, 3, "{ran:?}");
        let report = ran.object();
        let said = report["reason"].as_str().unwrap();
        assert!(
            said.contains("pose 5 (from 0) is 4") || said.contains("pose 5 (from 0) is 5"),
            "{said}"
        );
        assert_eq!(
            report["next_poses"].as_array().unwrap().len(),
            2,
            "{report}"
        );
        let report = run(&means(&spread(20), bad), &flags).succeeds();
        assert_eq!(report["rejected_poses"], serde_json::json!([5]));
        run(&means(&spread(12), |_, mean| mean), &flags).succeeds();
    }
}

#[test]
fn a_sensor_that_moves_with_temperature_is_answered_or_the_refusal_says_how() {
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
    let terms = report["terms"].to_string();
    assert!(terms.contains("bias_temperature"), "{terms}");
    let slope = report["model"]["temperature"]["bias_mps2_per_k"][0]
        .as_f64()
        .unwrap();
    assert!((slope - 0.02).abs() < 0.001, "{slope}");
    let said = reason(&text, &["--poses", "--model", "9"]);
    assert!(
        said.contains("from 10 to 40 °C") && said.contains("--model auto+temperature"),
        "{said}"
    );

    // A thermometer that shows its own noise only tells of nothing.
    for row in &mut rows {
        row.2 = Some(25.0 + 0.2 * noise());
    }
    let said = reason(
        &csv("m/s²", rows.into_iter()),
        &["--poses", "--model", "9+temperature"],
    );
    assert!(said.contains("within 1 K"), "{said}");
}

#[test]
fn what_a_single_turn_hides_is_said_and_more_than_a_bias_can_be_is_refused() {
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
        let tilted = run(&turn(steps, 9.0), &flags).succeeds();
        let remarks = tilted["remarks"].to_string();
        assert!(remarks.contains("an axis 9° from level"), "{remarks}");
        assert_eq!(
            steps == 3,
            remarks.contains("leave no redundancy"),
            "{remarks}"
        );
        let scale = |report: &serde_json::Value| {
            let half = report["half_width_95"][3].as_f64().unwrap();
            (report["model"]["matrix"][0][0].as_f64().unwrap(), half)
        };
        let ((truth, _), (found, half)) = (scale(&level), scale(&tilted));
        assert!(
            (found - truth).abs() <= half,
            "{found} ± {half} for {truth}"
        );
        let said = reason(&turn(steps, 14.0), &flags);
        assert!(said.contains("it is 14° from level"), "{said}");
    }
}

#[test]
fn a_turn_that_comes_back_to_its_beginning_counts_and_misalignment_leaves_no_doubt() {
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
            let closed = run(&turn(steps, poses), &flags).succeeds();
            assert_eq!(closed["poses"], poses - 1);
            let remarks = closed["remarks"].to_string();
            assert!(remarks.contains("returned to its first step"), "{remarks}");
            assert!(!remarks.contains("the residuals"), "{remarks}");
            let bias = |report: &serde_json::Value| report["model"]["bias_m_s2"][0].as_f64();
            let apart = bias(&closed).unwrap() - bias(&once).unwrap();
            assert!(apart.abs() < 0.01, "{apart}");
        }
        let said = reason(&turn(steps, steps + 2), &flags);
        let named = format!("poses {steps} to {} (from 0) are 2 instead of", steps + 1);
        assert!(said.contains(&named), "{said}");
    }
}

#[test]
fn a_bias_that_moves_in_no_straight_line_is_told_beside_a_drift() {
    // In an order that does not go with the time.
    let ups: Vec<[f64; 3]> = (0..40).map(|k| spread(40)[17 * k % 40]).collect();
    let remarks = |course: &dyn Fn(f64) -> f64| {
        let moved =
            |k: usize, force: [f64; 3]| force.map(|axis| axis + 0.05 * course(k as f64 / 39.0));
        let report = run(&means(&ups, moved), &["--poses", "--model", "9+drift"]).succeeds();
        report["remarks"].to_string()
    };
    let bent = remarks(&|s| 1.0 - (-5.0 * s).exp());
    assert!(bent.contains("not linear"), "{bent}");
    let straight = remarks(&|s| s);
    assert!(!straight.contains("not linear"), "{straight}");
}

#[test]
fn poses_that_were_divided_by_their_length_are_told_so() {
    let normal = |_: usize, force: [f64; 3]| {
        let size = force.iter().map(|axis| axis * axis).sum::<f64>().sqrt();
        force.map(|axis| G * axis / size)
    };
    let remarks = |text: &str| run(text, &["--poses"]).succeeds()["remarks"].to_string();
    let divided = remarks(&means(&spread(20), normal));
    assert!(divided.contains("look normalised"), "{divided}");
    let plain = remarks(&means(&spread(20), |_, force| force));
    assert!(!plain.contains("look normalised"), "{plain}");
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
    for flags in [
        &["--sensitivity", "16384"][..],
        &["--sensitivity", "16384", "--model", "auto"],
        &[],
    ] {
        let said = reason(&stuck, flags);
        assert!(
            said.contains("axis X reads the same in every pose"),
            "{said}"
        );
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
    let said = reason(
        &means(&sides, |_, mean| mean.map(|y| y.clamp(-9.3, 9.3))),
        &six,
    );
    assert!(said.contains("stops at one reading"), "{said}");
}

#[test]
fn two_poses_in_g_are_left_out_and_said_to_be_in_g() {
    let text = means(
        &spread(24),
        |k, mean| if k < 2 { mean.map(|y| y / G) } else { mean },
    );
    let report = run(&text, &["--poses"]).succeeds();
    let remarks = report["remarks"].to_string();
    assert!(
        remarks.contains("appear to be in g, the others in m/s²"),
        "{remarks}"
    );
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
fn a_board_in_counts_that_was_turned_while_its_noise_was_taken_is_said_to_have_moved() {
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
    let ran = wimu(&["allan", &path]);
    assert_eq!(ran.code, 3, "{ran:?}");
    let report = ran.object();
    let said = report["reason"].as_str().unwrap();
    assert!(
        said.contains("moved about") && !said.contains("looks like"),
        "{said}"
    );
}

#[test]
fn a_sensor_that_is_turned_slowly_all_the_time_is_told_to_rest() {
    let mut noise = noise();
    let rows = (0..6000).map(|k| {
        let time = f64::from(k) * 0.02;
        // 3° in a second, about an axis that wanders.
        let (along, angle) = (0.4 * (0.05 * time).sin(), (3.0 * time).to_radians());
        let flat = (1.0 - along * along).sqrt();
        let mean = output([flat * angle.cos(), flat * angle.sin(), along]);
        (time, mean.map(|y| y + 0.005 * noise()), None)
    });
    let said = reason(&csv("m/s²", rows), &[]);
    assert!(said.contains("rotated all the time, at 3°/s"), "{said}");
}
