//! The demo does the main job, and README shows its output.

use crate::kit;

use std::fs;
use std::path::Path;

use kit::{Transcript, folder, snapshot, wimu};

#[test]
fn six_axes_give_attitude_and_position_bit_for_bit() {
    let folder = folder();
    let report = folder.path().join("demo.html");
    let ran = wimu(&["demo", "--chip", "lsm6dso", "--report", report.to_str().unwrap()]);
    let object = ran.succeeds();
    assert_eq!(object["replay_exact"], true);
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let degrees = [1, 2].map(|k| number(&object["attitude_deg"][k]));
    assert!(degrees.iter().all(|error| *error < 0.3), "{degrees:?}");
    let metres = ["slide_calibrated_m", "slide_zupt_m"].map(|key| number(&object[key]));
    assert!(metres.iter().all(|error| *error < 0.15), "{metres:?}");
    let mut texts = Transcript::default();
    texts.text("demo --chip lsm6dso", &ran);
    // The run time.
    let time = [(r"\d+(\.\d+)? s\b", "# s")];
    snapshot("demo_six_axes", texts.as_str(), &time);
}

#[test]
fn other_sensors_of_six_axes_give_the_same() {
    for chip in ["lsm6ds3tr-c", "mpu6050", "icm42688"] {
        let object = wimu(&["demo", "--chip", chip]).succeeds();
        assert_eq!(object["replay_exact"], true, "{chip}");
        for key in ["slide_calibrated_m", "slide_zupt_m"] {
            let error_m = object[key].as_f64().unwrap();
            assert!(error_m < 0.15, "{chip}: {key} {error_m}");
        }
    }
}

#[test]
fn readme_shows_what_the_demo_prints_and_draws() {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let folder = folder();
    let folder = folder.path();
    let report = folder.join("demo.html");
    let ran = wimu(&[
        "demo",
        "--report",
        report.to_str().unwrap(),
        "--pictures",
        folder.to_str().unwrap(),
    ]);
    let object = ran.succeeds();
    assert_eq!(object["replay_exact"], true);
    let readme = fs::read_to_string(repository.join("README.md")).unwrap();
    // The last line gives the run time.
    let lines: Vec<&str> = ran.stderr.lines().collect();
    let (_, story) = lines.split_last().unwrap();
    assert!(story.len() > 10, "{ran:?}");
    for line in story {
        assert!(readme.contains(line), "README lacks this line of `wimu demo`: {line}");
    }
    let mut texts = Transcript::default();
    texts.text("demo", &ran);
    // The command that the demo advises finds the two slides of 1 m in its recording.
    let recording = report.with_extension("mcap");
    let found = wimu(&["navigate", recording.to_str().unwrap()]);
    let report = found.succeeds();
    let moves = report["path"]["moves"].as_array().unwrap();
    let known: Vec<_> = moves.iter().filter(|one| !one["length_m"].is_null()).collect();
    for one in &known {
        let [length, sd] = ["length_m", "length_sd_m"].map(|key| one[key].as_f64().unwrap());
        assert!((length - 1.0).abs() < 2.0 * sd && sd < 0.05, "{one}");
    }
    assert_eq!(known.len(), 2, "{report}");
    // The run time.
    let time = [(r"\d+(\.\d+)? s\b", "# s")];
    snapshot("demo", texts.as_str(), &time);
    for picture in ["tilts.svg", "slide.svg"] {
        let drawn = fs::read_to_string(folder.join(picture)).unwrap();
        let shown = fs::read_to_string(repository.join("docs/pictures").join(picture)).unwrap();
        assert!(
            drawn == shown,
            "docs/pictures/{picture} is another: draw it by `cargo wimu demo --pictures docs/pictures`"
        );
    }
}

#[test]
fn calibrated_ranges_give_a_smaller_error_and_a_sigma_that_holds_it() {
    let folder = folder();
    let folder = folder.path();
    let at = |name: &str| folder.join(name).display().to_string();
    let (report, files) = (at("demo.html"), at(""));
    let ran = wimu(&["demo", "--localize", &files, "--report", &report, "--pictures", &files]);
    let found = ran.succeeds();
    let number = |pointer: &str| found.pointer(pointer).unwrap().as_f64().unwrap();
    let within = |pointer: &str, range: std::ops::Range<f64>| {
        let value = number(pointer);
        assert!(range.contains(&value), "{pointer}: {value}");
    };
    // The biases are 0.1 m, 1 σ; three independent errors of 2 to 7 cm remain.
    within("/before/rmse_m", 0.25..0.5);
    within("/before/nees_below_95", 0.0..0.5);
    within("/after/rmse_m", 0.07..0.18);
    within("/after/sigma_m", 0.07..0.18);
    within("/after/nees_below_95", 0.85..0.99);
    let biases = found["biases"].as_array().unwrap();
    let squares = biases.iter().map(|bias| {
        let [truth, value, sigma] =
            ["true_m", "value_m", "sigma_m"].map(|key| bias[key].as_f64().unwrap());
        ((value - truth) / sigma).powi(2)
    });
    let mean = squares.sum::<f64>() / 6.0;
    assert!((0.1..2.5).contains(&mean) && biases.len() == 6, "{mean}");
    assert!((number("/blocked/0") - number("/blocked/1")).abs() < 0.01);
    let [error, sigma] = [0, 1].map(|k| number(&format!("/foot_end_m/{k}")));
    assert!((0.1..3.0).contains(&(error / sigma)), "{error} {sigma}");
    within("/foot_integrated_m", 100.0..f64::INFINITY);
    within("/fixes_rmse_m/0", 0.3..1.0);
    within("/fixes_rmse_m/1", 0.05..0.3);
    // The files are those of the guides, and give the same biases.
    let [ranges, anchors] = ["ranges.csv", "anchors.csv"].map(at);
    let again = wimu(&["navigate", &ranges, "--setup", kit::setup("anchors", &anchors)]).succeeds();
    for (anchor, bias) in again["anchors"].as_array().unwrap().iter().zip(biases) {
        let [a, b] = [&anchor["bias_m"]["value"], &bias["value_m"]].map(|v| v.as_f64().unwrap());
        assert!((a - b).abs() < 1e-3, "{anchor} {bias}");
    }
    assert!(fs::metadata(&report).unwrap().len() > 10_000);
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    for picture in ["ranges.svg", "feet.svg", "fixes.svg"] {
        let shown = fs::read_to_string(repository.join("docs/pictures").join(picture)).unwrap();
        assert!(
            fs::read_to_string(at(picture)).unwrap() == shown,
            "docs/pictures/{picture} is another: draw it by `cargo wimu demo --localize --pictures docs/pictures`"
        );
    }
}
