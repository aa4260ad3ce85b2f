//! `wimu navigate A B --relative`: text, keys, files and refusals.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use kit::{Simulator, folder, wimu};

/// Angle of each body about z, rad.
fn angles(t: f64) -> [f64; 2] {
    let first = 0.4 * (2.0 * t).sin() + 0.2 * (3.1 * t).sin();
    [first, first + 0.7 * (4.0 * t).sin() - 0.3]
}

/// Joint, m, x and y: y is up.
fn joint(t: f64) -> [f64; 2] {
    [0.2 * (3.0 * t).sin(), 0.1 * (4.3 * t).cos()]
}

/// Recordings of 15 s of two bodies in a plane, each unit 0.2 m from the joint along its x axis.
fn write(folder: &Path) -> [String; 2] {
    [0, 1].map(|unit| {
        let position = |t: f64| {
            let (sin, cos) = angles(t)[unit].sin_cos();
            [joint(t)[0] - 0.2 * cos, joint(t)[1] - 0.2 * sin]
        };
        let mut text = "Time (s)".to_owned();
        for (name, unit) in [("Accelerometer", "m/s²"), ("Gyroscope", "rad/s")] {
            for axis in ["X", "Y", "Z"] {
                write!(text, ",{name} {axis} ({unit})").unwrap();
            }
        }
        let h = 1e-3;
        for k in 0..750 {
            let t = f64::from(k) * 0.02;
            let [before, now, after] = [t - h, t, t + h].map(position);
            let mut force = [0, 1].map(|k| (before[k] + after[k] - 2.0 * now[k]) / (h * h));
            force[1] += 9.80665;
            let (sin, cos) = angles(t)[unit].sin_cos();
            let [x, y] = [cos * force[0] + sin * force[1], cos * force[1] - sin * force[0]];
            let rate = (angles(t + h)[unit] - angles(t - h)[unit]) / (2.0 * h);
            write!(text, "\n{t},{x},{y},0.01,0.001,0,{rate}").unwrap();
        }
        let file = folder.join(["a.csv", "b.csv"][unit]);
        fs::write(&file, text + "\n").unwrap();
        file.display().to_string()
    })
}

#[test]
fn the_angle_is_printed_and_written_with_its_sigma() {
    let folder = folder();
    let [a, b] = write(folder.path());
    let [csv, page] =
        ["angle.csv", "angle.html"].map(|name| folder.path().join(name).display().to_string());
    let ran = wimu(&["navigate", &a, &b, "--relative", "-o", &csv, "--report", &page]);
    assert!(ran.stderr.starts_with("angle: "), "{}", ran.stderr);
    let found = wimu(&["navigate", &a, &b, "--relative"]).succeeds();
    assert_eq!(found["accurate"], true, "{found}");
    assert_eq!(found["hinge"]["given"], false);
    assert!(found["hinge"]["axes"][0][2].as_f64().unwrap() > 0.98, "{found}");
    let sigma = found["median_sigma_deg"].as_f64().unwrap();
    let end = angles(14.98);
    let off = found["final_angle_deg"].as_f64().unwrap() - (end[1] - end[0]).to_degrees();
    assert!(off.abs() < 4.0 * sigma.max(0.3), "{off} ± {sigma}");
    let rows = fs::read_to_string(csv).unwrap();
    assert!(rows.starts_with("Time (s),Angle (deg),Angle Sigma (deg),Quaternion W,"), "{rows:.99}");
    assert!(rows.lines().count() > 700);
    assert!(fs::read_to_string(page).unwrap().contains("Angle of the hinge"));
    let given = wimu(&["navigate", &a, &b, "--relative", "--setup", "hinge=[0,0,1]"]).succeeds();
    assert_eq!(given["hinge"]["given"], true);
}

#[test]
fn live_units_without_a_joint_are_not_accurate_and_one_board_is_refused() {
    let boards = ["1", "2"].map(|seed| {
        let words = ["--chip", "lsm6dso", "--motion", "hand", "--seed", seed];
        Simulator::start(&words)
    });
    let [a, b] = boards.each_ref().map(|board| board.cable.as_str());
    // Each board is moved by a hand of its own: there is no joint.
    let ran = wimu(&["navigate", a, b, "--relative", "--for", "12"]);
    let objects = ran.objects();
    let (path, angles) = objects.split_last().expect("a result");
    assert!(angles.iter().all(|angle| angle["accurate"] == false));
    assert_eq!(path["accurate"], false);
    let problems = serde_json::Value::from(ran.problems()).to_string();
    assert!(problems.contains("do not fit a common joint"), "{problems}");
    let soon = wimu(&["navigate", a, b, "--relative", "--for", "2"]);
    soon.fails(2, "no_rows");
    let one_board = ["navigate", a, &boards[0].wireless, "--relative"];
    wimu(&one_board).fails(2, "usage");
    let (file, _folder) = kit::in_folder("a.csv");
    fs::write(&file, "Accelerometer X (g)\n").unwrap();
    wimu(&["navigate", a, &file, "--relative"]).fails(2, "usage");
}
