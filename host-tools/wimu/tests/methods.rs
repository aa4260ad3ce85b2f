//! The calibrations beside that from gravity, as scripts use them.

mod kit;

use std::fmt::Write;
use std::fs;

use kit::{in_folder, wimu};

/// Two accelerometers in m/s², the second 2 % and 0.3 m/s² off, X and Y moving.
fn two_accelerometers() -> String {
    let mut text = String::from("Time (s)");
    for sensor in [0, 1] {
        for axis in ["X", "Y", "Z"] {
            write!(text, ",Accelerometer {sensor} {axis} (m/s²)").unwrap();
        }
    }
    text.push('\n');
    for k in 0..2000 {
        let t = f64::from(k) * 0.01;
        let force = [3.0 * (2.0 * t).sin(), 3.0 * (3.1 * t).cos(), 9.81];
        let output = force.map(|f| 1.02 * f + 0.3);
        let [x, y, z] = force;
        let [u, v, w] = output;
        writeln!(text, "{t},{x},{y},{z},{u},{v},{w}").unwrap();
    }
    text
}

#[test]
fn a_stream_against_a_reference_has_bias_and_scale_where_it_moves() {
    let (csv, folder) = in_folder("two.csv");
    fs::write(&csv, two_accelerometers()).unwrap();
    let cal = folder.path().join("CAL.json").display().to_string();
    let reference = ["calibrate", &csv, "--method", "reference"];
    let report = wimu(&[&reference[..], &["-o", &cal]].concat()).succeeds();
    let number = |pointer: &str| report.pointer(pointer).unwrap().as_f64().unwrap();
    for axis in 0..2 {
        assert!((number(&format!("/model/bias_m_s2/{axis}")) - 0.3).abs() < 1e-9);
        assert!((number(&format!("/model/matrix/{axis}/{axis}")) - 1.02).abs() < 1e-9);
    }
    // Z saw gravity only: its offset there is 0.3 + 0.02 · 9.81.
    assert_eq!(report["axes"][2]["separated"], false);
    assert!((number("/model/bias_m_s2/2") - 0.4962).abs() < 1e-9);
    assert_eq!(number("/model/matrix/2/2"), 1.0);
    assert!(
        fs::read_to_string(&cal)
            .unwrap()
            .contains("wimu.calibration/1")
    );

    // The other way round.
    let swapped = wimu(&[&reference[..], &["--reference", "1"]].concat()).succeeds();
    let scale = swapped["model"]["matrix"][0][0].as_f64().unwrap();
    assert!((scale - 1.0 / 1.02).abs() < 1e-9);

    wimu(
        &[
            &reference[..],
            &["--reference", "1", "--accelerometer", "1"],
        ]
        .concat(),
    )
    .fails(2, "usage");
    wimu(&[&reference[..], &["--model", "9"]].concat()).fails(2, "usage");
    wimu(&[
        "calibrate",
        &csv,
        "--accelerometer",
        "0",
        "--reference",
        "1",
    ])
    .fails(2, "usage");
    let (one, _folder) = in_folder("one.csv");
    fs::write(
        &one,
        "Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)\n0,0,1\n",
    )
    .unwrap();
    wimu(&["calibrate", &one, "--method", "reference"]).fails(2, "usage");

    // Different motions are refused.
    let text = fs::read_to_string(&csv)
        .unwrap()
        .replace("Accelerometer 1 X", "Accelerometer 1 W");
    let text = text
        .replace("Accelerometer 1 Y", "Accelerometer 1 X")
        .replace("Accelerometer 1 W", "Accelerometer 1 Y");
    fs::write(&csv, text).unwrap();
    let refused = wimu(&reference);
    assert_eq!(refused.code, 3, "{refused:?}");
    let report = refused.object();
    assert_eq!(report["status"], "refused");
    assert!(
        report["reason"]
            .as_str()
            .unwrap()
            .contains("different motions")
    );
}
