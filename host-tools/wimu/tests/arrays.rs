//! `wimu navigate` with several accelerometers on one body: clocks of boards and the point that a path is of.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use kit::{Background, Ran, Simulator, Transcript, findings, folder, record_until, wimu};

const POSITIONS: [[f64; 3]; 4] =
    [[0.05, 0.05, 0.05], [0.05, -0.05, -0.05], [-0.05, 0.05, -0.05], [-0.05, -0.05, 0.05]];

/// A table of positions.
fn geometry(folder: &Path, positions: &[[f64; 3]]) -> String {
    let mut text = "X (m),Y (m),Z (m)\n".to_owned();
    for [x, y, z] in positions {
        writeln!(text, "{x},{y},{z}").unwrap();
    }
    written(folder, "positions.csv", &text)
}

fn written(folder: &Path, name: &str, text: &str) -> String {
    let path = folder.join(name);
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

/// Four sensors at rest for 4 s at 100 Hz.
fn recording(folder: &Path) -> String {
    let mut text = "Time (s)".to_owned();
    for sensor in 0..4 {
        for axis in ["X", "Y", "Z"] {
            write!(text, ",Accelerometer {sensor} {axis} (m/s²)").unwrap();
        }
    }
    text.push('\n');
    for k in 0..400_usize {
        write!(text, "{:.3}", k as f64 * 0.01).unwrap();
        for sensor in 0..4 {
            let noise = |s: usize| ((k * 31 + (s + sensor) * 17) % 11) as f64 * 0.004 - 0.02;
            write!(text, ",{:.4},{:.4},{:.4}", noise(0), -noise(3), 9.8 + noise(5)).unwrap();
        }
        text.push('\n');
    }
    written(folder, "board.csv", &text)
}

fn navigate(recording: &str, geometry: &str) -> Ran {
    wimu(&["navigate", recording, "--setup", kit::setup("geometry", geometry)])
}

#[test]
fn wireless_boards_on_one_body_are_brought_together_by_their_clocks() {
    let folder = folder();
    let boards: Vec<Simulator> = ["clock=50ppm", "clock=-80ppm"]
        .map(|clock| Simulator::start(&["--motion", "rest", "--faults", clock]))
        .into();
    let files: Vec<String> = ["a.mcap", "b.mcap"]
        .map(|name| folder.path().join(name).to_str().unwrap().to_owned())
        .into();
    let recorders: Vec<Background> = boards
        .iter()
        .zip(&files)
        .map(|(board, file)| Background::start(&["record", &board.wireless, "-o", file]))
        .collect();
    for (recorder, file) in recorders.into_iter().zip(&files) {
        record_until(recorder, file, |link| link["raw_samples"].as_u64() > Some(450));
    }
    let positions = geometry(folder.path(), &POSITIONS);
    let (a, b) = (files[0].as_str(), files[1].as_str());
    let ran = wimu(&["navigate", a, b, a, b, "--setup", kit::setup("geometry", &positions)]);
    let object = ran.succeeds();
    assert_eq!(object["method"], "array");
    assert!(object["duration_s"].as_f64().unwrap() > 3.0, "{object}");
    assert!(object["valid_share"].as_f64().unwrap() > 0.6, "{object}");
    // Each board's clock is reported under the name of its recording.
    for name in &files {
        let clocks = findings(&object).into_iter();
        let clocks = clocks.filter(|text| text.contains(&format!(": {name}")));
        assert_eq!(clocks.count(), 2, "{object}");
    }
    // A calibration of them as one array reads the raw samples of both; one side up does not suffice.
    let calibrate = ["calibrate", a, b, a, b, "--setup", kit::setup("geometry", &positions)];
    wimu(&calibrate).fails(3, "data_refused");
    wimu(&["navigate", a, b]).fails(2, "usage");
    wimu(&["navigate", a, b, "--setup", kit::setup("geometry", &positions)]).fails(2, "usage");
}

#[test]
fn the_reference_point_of_a_path_and_unchecked_positions_are_remarked() {
    let folder = folder();
    let board = recording(folder.path());
    let mut texts = Transcript::default();
    let centred = geometry(folder.path(), &POSITIONS);
    texts.findings("origin at the centre", &navigate(&board, &centred));
    let beside = POSITIONS.map(|[x, y, z]| [x + 0.1, y, z]);
    let beside = geometry(folder.path(), &beside);
    texts.findings("origin 100 mm beside", &navigate(&board, &beside));
    texts.check("navigate_array_reference_point");
}
