//! Input of `wimu calibrate` and `wimu allan` that would otherwise be ignored silently.

use crate::kit;

use std::fmt::Write;
use std::fs;

use kit::{Transcript, folder, noise, spread, wimu};

/// 600 s/100 of a sensor at rest, each value through `value`.
fn at_rest(value: impl Fn(f64) -> f64, unit: &str) -> String {
    let mut text = String::from("Time (s)");
    for axis in ["X", "Y", "Z"] {
        write!(text, ",Accelerometer {axis} ({unit})").unwrap();
    }
    let mut noise = noise();
    for k in 0..3000 {
        let [x, y, z] = [0.017, -0.02, 9.79].map(|f| value(f + 0.01 * noise()));
        write!(text, "\n{:.2},{x},{y},{z}", f64::from(k) * 0.01).unwrap();
    }
    text
}

#[test]
fn allan_refuses_a_wrong_unit_and_remarks_counts_coarser_than_the_noise() {
    let mut texts = Transcript::default();
    let folder = folder();
    let csv = folder.path().join("rest.csv").display().to_string();
    let run = |text: String| {
        fs::write(&csv, text).unwrap();
        wimu(&["allan", &csv])
    };
    let fine = run(at_rest(|f| f, "m/s²")).succeeds();
    assert_eq!(fine["problems"].as_array().unwrap().len(), 0, "{fine}");
    assert_eq!(fine["accelerometer"]["axes"][0]["is_coarse"], false);

    texts.refuses("g called m/s²", &run(at_rest(|f| f / 9.80665, "m/s²")));
    texts.refuses("m/s² called g", &run(at_rest(|f| f, "g")));

    let ran = run(at_rest(|f| (f / 0.04).round() * 0.04, "m/s²"));
    let coarse = texts.findings("steps of 0.04 m/s²", &ran);
    assert_eq!(coarse["accelerometer"]["axes"][2]["is_coarse"], true, "{coarse}");
    texts.check("allan_units_and_steps");
}

/// Static-pose means of a sensor without errors, `Time (s)` first.
fn means(ups: &[[f64; 3]]) -> String {
    let mut text = String::from(
        "Time (s),Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²)",
    );
    for (k, up) in ups.iter().enumerate() {
        let [x, y, z] = up.map(|u| u * 9.80665);
        let rough = 0.002 * (k as f64 * 2.3).sin();
        write!(text, "\n{k},{},{},{}", x + rough, y - rough, z + rough).unwrap();
    }
    text
}

#[test]
fn what_was_fitted_is_printed_with_its_deviation() {
    let folder = folder();
    let csv = folder.path().join("means.csv").display().to_string();
    fs::write(&csv, means(&spread(20))).unwrap();
    let mut texts = Transcript::default();
    let ran = wimu(&["calibrate", &csv, "--poses", "--model", "9"]);
    ran.succeeds();
    texts.text("calibrate --model 9", &ran);
    texts.check("calibrate");
}

#[test]
fn an_output_that_is_not_linear_is_named_with_the_model_that_fits() {
    let folder = folder();
    let csv = folder.path().join("bent.csv").display().to_string();
    // A quadratic term of 2 · 10⁻⁶ a count at 16384 LSB/g.
    let bent = spread(20).into_iter().map(|up| up.map(|u| u + 0.0328 * u * u));
    fs::write(&csv, means(&bent.collect::<Vec<_>>())).unwrap();
    let mut texts = Transcript::default();
    let calibrate = |model: &str| wimu(&["calibrate", &csv, "--poses", "--model", model]);
    texts.findings("9", &calibrate("9"));
    texts.refuses("auto", &calibrate("auto"));
    for model in ["9+quadratic", "auto+quadratic"] {
        let fit = calibrate(model).succeeds();
        assert!(fit["loo_rms_mm_s2"].as_f64().unwrap() < 10.0, "{model}: {fit}");
    }
    texts.check("calibrate_nonlinear");
}

#[test]
fn the_advice_to_give_a_sensitivity_can_be_followed_with_every_method() {
    let mut texts = Transcript::default();
    let folder = folder();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (csv, cal, c) = (path("means.csv"), path("CAL.json"), path("cal.h"));
    fs::write(&csv, means(&spread(20))).unwrap();
    let two = path("two.csv");
    let mut text = String::from("Time (s)");
    for sensor in [0, 1] {
        for axis in ["X", "Y", "Z"] {
            write!(text, ",Accelerometer {sensor} {axis} (m/s²)").unwrap();
        }
    }
    for k in 0..2000 {
        let t = f64::from(k) * 0.01;
        let f = [4.0 * (2.0 * t).sin(), 4.0 * (3.1 * t).cos(), 9.8 + 4.0 * (4.7 * t).sin()];
        let [x, y, z] = f;
        let [u, v, w] = f.map(|f| 1.02 * f + 0.2 + 0.004 * (f64::from(k) * 7.7).sin());
        write!(text, "\n{t:.2},{x},{y},{z},{u},{v},{w}").unwrap();
    }
    fs::write(&two, text).unwrap();
    for of in [
        &["calibrate", &csv, "--poses", "-o", &cal][..],
        &["calibrate", &two, "--method", "reference", "-o", &cal],
    ] {
        let ran = wimu(of);
        let advised = ran.succeeds();
        assert!(advised["parameters"].is_null(), "{advised}");
        texts.text("without", &ran);
        wimu(&["convert", &cal, "--to", "c", "-o", &c]).succeeds();
        assert!(fs::read_to_string(&c).unwrap().contains("_MPS2 1.0\n"));
        let ran = wimu(&[of, &["--sensitivity", "16384"]].concat());
        assert_eq!(ran.succeeds()["sensitivity_lsb_per_g"], 16384.0);
        texts.text("--sensitivity 16384", &ran);
        wimu(&["convert", &cal, "--to", "c", "-o", &c]).succeeds();
    }
    texts.check("calibrate_without_sensitivity");
}
