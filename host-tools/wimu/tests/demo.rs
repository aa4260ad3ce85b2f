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
