//! The demo does the main job, and README shows what it shows.

use crate::kit;

use std::fs;
use std::path::Path;

use kit::{folder, wimu};

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
    // The last line says how long it took.
    let story = ran
        .stderr
        .lines()
        .take_while(|line| !line.contains("of board time in"));
    let mut lines = 0;
    for line in story {
        assert!(
            readme.contains(line),
            "README lacks what `wimu demo` prints now: {line}"
        );
        lines += 1;
    }
    assert_eq!(lines, 12);
    // What it tells to try finds the two slides of 1 m at which it is calibrated.
    let last = ran.stderr.lines().last().unwrap();
    assert!(last.contains("`wimu navigate --method slide`"), "{last}");
    let recording = report.with_extension("mcap");
    let found = wimu(&["navigate", recording.to_str().unwrap(), "--method", "slide"]);
    let moves = &found.succeeds()["path"]["moves"];
    for one in moves.as_array().unwrap() {
        let [length, sd] = ["length_m", "length_sd_m"].map(|key| one[key].as_f64().unwrap());
        assert_eq!(one["valid"], true);
        assert!((length - 1.0).abs() < 2.0 * sd && sd < 0.05, "{one}");
    }
    let headline = found.stderr.lines().next().unwrap();
    assert!(headline.starts_with("2 moves, "), "{headline}");
    for picture in ["tilts.svg", "slide.svg"] {
        let drawn = fs::read_to_string(folder.join(picture)).unwrap();
        let shown = fs::read_to_string(repository.join("docs/pictures").join(picture)).unwrap();
        assert!(
            drawn == shown,
            "docs/pictures/{picture} is another: draw it by `cargo wimu demo --pictures docs/pictures`"
        );
    }
}
