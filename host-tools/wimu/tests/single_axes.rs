//! Arrays of single axes, and named geometries.

use crate::kit;

use std::fmt::Write;
use std::fs;

use kit::{Transcript, folder, noise, wimu};
use serde_json::{Value, json};

const G: f64 = 9.80665;

/// Place (50 mm) and direction of each axis of a cube after Chen, Lee & DeBra.
const CUBE: [([f64; 3], [f64; 3]); 6] = [
    ([0.0, 0.0, -1.0], [1.0, 1.0, 0.0]),
    ([0.0, -1.0, 0.0], [1.0, 0.0, 1.0]),
    ([-1.0, 0.0, 0.0], [0.0, 1.0, 1.0]),
    ([1.0, 0.0, 0.0], [0.0, 1.0, -1.0]),
    ([0.0, 1.0, 0.0], [1.0, 0.0, -1.0]),
    ([0.0, 0.0, 1.0], [1.0, -1.0, 0.0]),
];

/// Heading, rad, its rate and ω̇ at a time: a quarter turn and half of one, rests before, between and after.
fn turn(t: f64) -> [f64; 3] {
    let quarter = std::f64::consts::FRAC_PI_2;
    let mut all = [0.0; 3];
    for (begin, seconds, by) in [(3.0, 1.0, quarter), (6.0, 1.5, 2.0 * quarter)] {
        let x = ((t - begin) / seconds).clamp(0.0, 1.0);
        all[0] += by * x * x * x * (10.0 - 15.0 * x + 6.0 * x * x);
        all[1] += by / seconds * 30.0 * x * x * (1.0 - x) * (1.0 - x);
        all[2] += by / (seconds * seconds) * 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x);
    }
    all
}

/// What a point feels along a direction: gravity, ω̇ and centripetal acceleration.
fn felt([x, y, _]: [f64; 3], d: [f64; 3], [_, rate, turning]: [f64; 3]) -> f64 {
    let f = [-turning * y - rate * rate * x, turning * x - rate * rate * y, G];
    let size = d.iter().map(|c| c * c).sum::<f64>().sqrt();
    d.iter().zip(f).map(|(d, f)| d * f).sum::<f64>() / size
}

/// A table at 100 Hz of axes at these positions, with the truth.
fn table(columns: &[String], axes: &[([f64; 3], [f64; 3])]) -> String {
    let mut text = format!("Time (s),{}", columns.join(","));
    text.push_str(",Truth Position E (m),Truth Position N (m),Truth Position U (m)");
    text.push_str(",Truth Quaternion W,Truth Quaternion X,Truth Quaternion Y,Truth Quaternion Z\n");
    let mut noise = noise();
    for k in 0..1000 {
        let t = f64::from(k) / 100.0;
        write!(text, "{t:.2}").unwrap();
        for (position, direction) in axes {
            let value = felt(*position, *direction, turn(t)) + 0.01 * noise();
            write!(text, ",{value:.5}").unwrap();
        }
        let (sin, cos) = (turn(t)[0] / 2.0).sin_cos();
        writeln!(text, ",0,0,0,{cos:.9},0,0,{sin:.9}").unwrap();
    }
    text
}

fn cube() -> Vec<([f64; 3], [f64; 3])> {
    CUBE.map(|(position, direction)| (position.map(|c| 0.05 * c), direction)).to_vec()
}

fn numbered() -> Vec<String> {
    (0..6).map(|k| format!("Accelerometer {k} (m/s²)")).collect()
}

/// The heading at the end of a path, rad from that at the start.
fn heading(path: &std::path::Path) -> f64 {
    let text = fs::read_to_string(path).unwrap();
    let last: Vec<f64> =
        text.lines().last().unwrap().split(',').map(|v| v.parse().unwrap()).collect();
    let [w, x, y, z] = [7, 8, 9, 10].map(|column| last[column]);
    (2.0 * (x * y + w * z)).atan2(1.0 - 2.0 * (y * y + z * z))
}

fn apart(a: f64, b: f64) -> f64 {
    let turns = (a - b) / std::f64::consts::TAU;
    (turns - turns.round()).abs() * std::f64::consts::TAU
}

#[test]
fn a_cube_of_six_single_axes_is_navigated_by_its_name_and_by_its_axes() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name).display().to_string();
    fs::write(at("cube.csv"), table(&numbered(), &cube())).unwrap();
    let out = folder.path().join("path.csv");
    let ran = wimu(&[
        "navigate",
        &at("cube.csv"),
        "--geometry",
        "cube:100mm",
        "--zupt",
        "on",
        "-o",
        &out.display().to_string(),
    ]);
    let mut texts = Transcript::default();
    let found = texts.findings("cube:100mm", &ran);
    let turned = heading(&out);
    println!("turned by {turned:.3} rad of {:.3}", turn(10.0)[0]);
    assert!(apart(turned, turn(10.0)[0]) < 0.05, "{turned}");
    assert!(found["nees"]["share"].as_f64().is_none_or(|share| share > 0.9), "{found}");
    // The same as JSON, with columns of other names, in g and in another order.
    let axes: Vec<Value> = cube()
        .iter()
        .enumerate()
        .map(|(k, (position, direction))| json!({"place_m": position, "direction": direction, "column": format!("Face {k}")}))
        .collect();
    let geometry = json!({"schema": "wimu.array/1", "axes": axes});
    fs::write(at("cube.json"), geometry.to_string()).unwrap();
    let faces: Vec<String> = (0..6).rev().map(|k| format!("Face {k} (m/s²)")).collect();
    let mut reversed = cube();
    reversed.reverse();
    fs::write(at("faces.csv"), table(&faces, &reversed)).unwrap();
    wimu(&[
        "navigate",
        &at("faces.csv"),
        "--geometry",
        &at("cube.json"),
        "--zupt",
        "on",
        "-o",
        &out.display().to_string(),
    ])
    .succeeds();
    assert!(apart(heading(&out), turn(10.0)[0]) < 0.05);
    let ran = wimu(&["navigate", &at("faces.csv"), "--geometry", "cube:100mm"]);
    texts.fails("other columns", &ran, 2, "csv_missing_column");
    for wrong in ["cube:100", "cube:-1mm", "board:9.5mm", "four:", "hexagon:3mm"] {
        let ran = wimu(&["navigate", &at("cube.csv"), "--geometry", wrong]);
        texts.fails(wrong, &ran, 2, "usage");
    }
    texts.check("navigate_single_axes");
}

#[test]
fn triads_of_a_preset_are_those_at_the_same_places() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let p = 0.05;
    let positions = [[p, p, p], [p, -p, -p], [-p, p, -p], [-p, -p, p]];
    let units = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let axes: Vec<([f64; 3], [f64; 3])> =
        positions.iter().flat_map(|position| units.map(|unit| (*position, unit))).collect();
    let columns: Vec<String> = (0..12)
        .map(|k| format!("Accelerometer {} {} (m/s²)", k / 3, ["X", "Y", "Z"][k % 3]))
        .collect();
    fs::write(at("four.csv"), table(&columns, &axes)).unwrap();
    let mut text = "X (m),Y (m),Z (m)\n".to_owned();
    for [x, y, z] in positions {
        writeln!(text, "{x},{y},{z}").unwrap();
    }
    fs::write(at("positions.csv"), text).unwrap();
    let run = |geometry: &str| {
        wimu(&[
            "navigate",
            &at("four.csv"),
            "--geometry",
            geometry,
            "--zupt",
            "on",
            "-o",
            &at("path.csv"),
        ])
        .succeeds();
        fs::read_to_string(at("path.csv")).unwrap()
    };
    let (named, tabled) = (run("four:86.60254037844386mm"), run(&at("positions.csv")));
    assert_eq!(named, tabled);
    assert!(apart(heading(&folder.path().join("path.csv")), turn(10.0)[0]) < 0.05);
}

#[test]
fn an_axis_that_never_moves_is_named() {
    let folder = folder();
    let file = folder.path().join("cube.csv").display().to_string();
    let text = table(&numbered(), &cube());
    let dead = |(k, line): (usize, &str)| {
        let mut fields: Vec<&str> = line.split(',').collect();
        if k > 0 {
            fields[3] = "0.0";
        }
        fields.join(",")
    };
    let lines: Vec<String> = text.lines().enumerate().map(dead).collect();
    fs::write(&file, lines.join("\n")).unwrap();
    let ran = wimu(&["navigate", &file, "--geometry", "cube:100mm"]);
    let mut texts = Transcript::default();
    texts.fails("constant axis", &ran, 3, "data_refused");
    texts.check("navigate_single_axes_dead");
}
