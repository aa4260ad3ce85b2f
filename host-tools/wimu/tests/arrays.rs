//! `wimu navigate` with several accelerometers on one body: what it takes, and what it refuses.

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

/// Four sensors at rest for 4 s at 100 Hz; `change` may spoil the values of a sample, or drop it.
fn recording(folder: &Path, change: impl Fn(usize, &mut Vec<String>) -> bool) -> String {
    let mut text = "Time (s)".to_owned();
    for sensor in 0..4 {
        for axis in ["X", "Y", "Z"] {
            write!(text, ",Accelerometer {sensor} {axis} (m/s²)").unwrap();
        }
    }
    text.push('\n');
    for k in 0..400_usize {
        let mut fields = vec![format!("{:.3}", k as f64 * 0.01)];
        for sensor in 0..4 {
            let noise = |s: usize| ((k * 31 + (s + sensor) * 17) % 11) as f64 * 0.004 - 0.02;
            let [x, y, z] = [noise(0), -noise(3), 9.8 + noise(5)];
            fields.extend([x, y, z].map(|v| format!("{v:.4}")));
        }
        if change(k, &mut fields) {
            writeln!(text, "{}", fields.join(",")).unwrap();
        }
    }
    written(folder, "board.csv", &text)
}

fn navigate(recording: &str, geometry: &str) -> Ran {
    wimu(&["navigate", recording, "--geometry", geometry])
}

#[test]
fn an_array_at_rest_is_navigated_with_its_horizon() {
    let folder = folder();
    let positions = geometry(folder.path(), &POSITIONS);
    let board = recording(folder.path(), |_, _| true);
    let path = folder.path().join("path.csv");
    let path = path.to_str().unwrap();
    let geometry = ["--geometry", &positions, "-o", path];
    let ran = wimu(&[&["navigate", &board][..], &geometry].concat());
    let object = ran.succeeds();
    let mut texts = Transcript::default();
    texts.text("navigate --geometry", &ran);
    texts.check("navigate_array");
    assert_eq!(object["method"], "array");
    assert!(object["horizon"]["to_1_m_s"].is_null() && object["valid_share"].as_f64() > Some(0.8));
    let table = fs::read_to_string(path).unwrap();
    assert!(table.starts_with("Time (s),Position E (m)") && table.lines().count() == 401);
    // Without ZUPT the rest at the start gives the alignment, but nothing constrains the velocity.
    let with = |zupt: &str| {
        let arguments = ["navigate", &board, "--zupt", zupt];
        let object = wimu(&[&arguments[..], &geometry[..2]].concat()).succeeds();
        let sigma = |i: usize| object["final_sigma_m"][i].as_f64().unwrap();
        (sigma(0).hypot(sigma(1)), object["rests"] == 0)
    };
    let ((stated, _), (free, no_rests)) = (with("on"), with("off"));
    assert!(free > 3.0 * stated && free > 0.005 && no_rests, "{free} {stated}");
}

#[test]
fn geometries_that_cannot_work_are_refused_with_what_is_missing() {
    let folder = folder();
    let board = recording(folder.path(), |_, _| true);
    let mut texts = Transcript::default();
    let cases: [(&str, &[[f64; 3]], i32, &str); 4] = [
        ("3 of 4", &POSITIONS[..3], 2, "usage"),
        ("one position", &[[0.1, 0.0, 0.0]; 4], 3, "data_refused"),
        (
            "one line",
            &[[0.0; 3], [0.1, 0.0, 0.0], [0.2, 0.0, 0.0], [0.4, 0.0, 0.0]],
            3,
            "data_refused",
        ),
        ("empty", &[], 2, "usage"),
    ];
    for (case, positions, exit, code) in cases {
        let positions = geometry(folder.path(), positions);
        texts.fails(case, &navigate(&board, &positions), exit, code);
    }
    for (text, code) in [
        ("X (m),Y (m),Z (m)\n0.01,zero,0\n", "csv_bad_number"),
        ("X (m),Y (m)\n0.01,0\n", "csv_missing_column"),
        ("{\"schema\":\"wimu.array/9\",\"sensors\":[]}", "bad_calibration"),
        ("{\"schema\":", "bad_calibration"),
        (
            "{\"schema\":\"wimu.array/1\",\"sensors\":[{\"places_m\":[[0,0,0],[0,0,0],[0,0,0]],\
             \"axes\":[[1,0,0],[1,0,0],[0,0,1]]}]}",
            "bad_calibration",
        ),
    ] {
        let wrong = written(folder.path(), "wrong.txt", text);
        texts.fails(format_args!("{text:?}"), &navigate(&board, &wrong), 2, code);
    }
    let positions = geometry(folder.path(), &POSITIONS);
    wimu(&["navigate", &board, &board]).fails(2, "usage");
    let refine = ["--refine", &positions];
    wimu(&[&["navigate", &board, "--geometry", &positions][..], &refine].concat())
        .fails(2, "usage");
    // At rest nothing shows where the sensors are.
    let out = folder.path().join("refined.json");
    let refine = ["--refine", out.to_str().unwrap()];
    let ran = wimu(&[&["navigate", &board, "--geometry", &positions][..], &refine].concat());
    texts.fails("--refine at rest", &ran, 3, "data_refused");
    assert!(!out.exists());
    texts.check("navigate_geometries_that_are_refused");
}

#[test]
fn dead_saturated_and_missing_sensors_are_reported() {
    let mut texts = Transcript::default();
    let folder = folder();
    let positions = geometry(folder.path(), &POSITIONS);
    // Three others are in a plane and suffice for ω̇ and s.
    let board = recording(folder.path(), |_, fields| {
        for field in &mut fields[7..10] {
            *field = "0".to_owned();
        }
        true
    });
    texts.findings("sensor 2 at 0", &navigate(&board, &positions));
    let board = recording(folder.path(), |k, fields| {
        if (200..210).contains(&k) {
            fields[4] = "1000000".to_owned();
        }
        true
    });
    let case = "10 outputs beyond full scale";
    texts.findings(case, &navigate(&board, &positions));
    // In counts the limit is known.
    let counts = fs::read_to_string(&board).unwrap();
    fs::write(&board, counts.replace("(m/s²)", "(LSB)")).unwrap();
    let of_counts = ["--sensitivity", "9.80665"];
    let ran = wimu(&[&["navigate", &board, "--geometry", &positions], &of_counts[..]].concat());
    texts.findings("the same in counts", &ran);
    let board = recording(folder.path(), |_, fields| {
        for field in &mut fields[4..] {
            *field = "0".to_owned();
        }
        true
    });
    let ran = navigate(&board, &positions);
    texts.fails("three of four sensors at 0", &ran, 3, "data_refused");
    texts.check("navigate_array_dead_sensors");
}

#[test]
fn gaps_times_that_jump_and_values_that_are_no_number_are_reported() {
    let mut texts = Transcript::default();
    let folder = folder();
    let positions = geometry(folder.path(), &POSITIONS);
    let board = recording(folder.path(), |k, _| !(150..200).contains(&k));
    texts.findings("gap", &navigate(&board, &positions));
    let board = recording(folder.path(), |k, fields| {
        if k == 100 {
            fields[0] = "0.5".to_owned();
        }
        true
    });
    texts.findings("time goes back", &navigate(&board, &positions));
    let board = recording(folder.path(), |k, fields| {
        if k == 100 {
            fields[5] = "NuN".to_owned();
        }
        true
    });
    texts.findings("no number", &navigate(&board, &positions));
    let board = recording(folder.path(), |k, fields| {
        if k == 100 {
            fields[0] = fields[0].replace("1.000", "0.990");
        }
        true
    });
    texts.findings("a time twice", &navigate(&board, &positions));
    // It never rests.
    let board = recording(folder.path(), |k, fields| {
        for (i, field) in fields[1..].iter_mut().enumerate() {
            *field = format!("{:.3}", 5.0 * ((k * (i + 3)) as f64 * 0.7).sin() + 6.0);
        }
        true
    });
    let ran = navigate(&board, &positions);
    texts.fails("no rest", &ran, 3, "data_refused");
    texts.check("navigate_array_gaps");
}

#[test]
fn wireless_boards_on_one_body_are_brought_together_by_their_clocks() {
    let folder = folder();
    let boards: Vec<Simulator> =
        ["50", "-80"].map(|ppm| Simulator::start(&["--motion", "rest", "--clock-ppm", ppm])).into();
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
    let ran = wimu(&["navigate", a, b, a, b, "--geometry", &positions]);
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
    let calibrate = ["calibrate", a, b, a, b, "--geometry", &positions];
    wimu(&calibrate).fails(3, "data_refused");
    wimu(&["navigate", a, b]).fails(2, "usage");
    wimu(&["navigate", a, b, "--geometry", &positions]).fails(2, "usage");
}

#[test]
fn missing_samples_and_spikes_of_one_sensor_are_left_out() {
    let mut texts = Transcript::default();
    let folder = folder();
    let positions = geometry(folder.path(), &POSITIONS);
    let board = recording(folder.path(), |k, fields| {
        // A bias, which must not make the mean jump where the sensor is absent.
        let y: f64 = fields[5].parse().unwrap();
        fields[5] = format!("{}", y + 0.1);
        if [100, 150, 151, 260].contains(&k) {
            fields[5] = "NaN".to_owned();
        }
        if k >= 300 {
            fields[7..10].fill(String::new());
        }
        true
    });
    texts.findings("missing samples", &navigate(&board, &positions));
    let board = recording(folder.path(), |k, fields| {
        if k % 17 == 3 {
            fields[10 + k % 3] = format!("{}", 40.0 + k as f64);
        }
        true
    });
    let object = texts.findings("spikes", &navigate(&board, &positions));
    assert_eq!(object["final_valid"], true);
    texts.check("navigate_array_missing_samples");
}

#[test]
fn delays_that_the_geometry_gives_are_not_remarked() {
    let folder = folder();
    let board = recording(folder.path(), |_, _| true);
    let sensors: Vec<serde_json::Value> = (0..4)
        .map(|k| serde_json::json!({"places_m": [POSITIONS[k], POSITIONS[k], POSITIONS[k]], "delay_us": 250.0 * k as f64}))
        .collect();
    let known = serde_json::json!({"schema": "wimu.array/1", "sensors": sensors}).to_string();
    let known = written(folder.path(), "known.json", &known);
    let mut texts = Transcript::default();
    let object = texts.findings("delays of 0 to 750 µs", &navigate(&board, &known));
    assert_eq!(object["final_valid"], true);
    texts.check("navigate_array_known_delays");
}

#[test]
fn the_reference_point_of_a_path_and_unchecked_positions_are_remarked() {
    let folder = folder();
    let board = recording(folder.path(), |_, _| true);
    let mut texts = Transcript::default();
    let centred = geometry(folder.path(), &POSITIONS);
    texts.findings("origin at the centre", &navigate(&board, &centred));
    let beside = POSITIONS.map(|[x, y, z]| [x + 0.1, y, z]);
    let beside = geometry(folder.path(), &beside);
    texts.findings("origin 100 mm beside", &navigate(&board, &beside));
    texts.check("navigate_array_reference_point");
}
