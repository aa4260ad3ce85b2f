//! `wimu navigate` with several accelerometers on one body: the point that a path is of.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use kit::{Ran, Transcript, folder, wimu};

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
