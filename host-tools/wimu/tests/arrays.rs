//! `wimu navigate` with several accelerometers on one body: what it takes, and what it refuses.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use kit::{Background, Ran, Simulator, folder, record_until, wimu};

const PLACES: [[f64; 3]; 4] = [
    [0.05, 0.05, 0.05],
    [0.05, -0.05, -0.05],
    [-0.05, 0.05, -0.05],
    [-0.05, -0.05, 0.05],
];

/// A table of places.
fn geometry(folder: &Path, places: &[[f64; 3]]) -> String {
    let mut text = "X (m),Y (m),Z (m)\n".to_owned();
    for [x, y, z] in places {
        writeln!(text, "{x},{y},{z}").unwrap();
    }
    written(folder, "places.csv", &text)
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

fn remarks(ran: &Ran) -> String {
    let object = ran.succeeds();
    let all = object["remarks"].as_array().unwrap();
    let texts: Vec<&str> = all.iter().map(|r| r.as_str().unwrap()).collect();
    texts.join("; ")
}

#[test]
fn an_array_at_rest_is_navigated_with_its_horizon() {
    let folder = folder();
    let places = geometry(folder.path(), &PLACES);
    let board = recording(folder.path(), |_, _| true);
    let path = folder.path().join("path.csv");
    let path = path.to_str().unwrap();
    let geometry = ["--geometry", &places, "-o", path];
    let ran = wimu(&[&["navigate", &board, "--method", "array"][..], &geometry].concat());
    let object = ran.succeeds();
    assert_eq!(object["method"], "array");
    assert!(object["horizon"]["to_1_m_s"].is_null() && object["valid_share"].as_f64() > Some(0.8));
    assert!(remarks(&ran).contains("not calibrated"), "{ran:?}");
    let table = fs::read_to_string(path).unwrap();
    assert!(table.starts_with("Time (s),Position E (m)") && table.lines().count() == 401);
    // Without ZUPT the stillness at the start is the alignment, but nothing holds velocity.
    let with = |zupt: &str| {
        let arguments = ["navigate", &board, "--zupt", zupt];
        let object = wimu(&[&arguments[..], &geometry[..2]].concat()).succeeds();
        let sigma = |i: usize| object["final_sigma_m"][i].as_f64().unwrap();
        (sigma(0).hypot(sigma(1)), object["stillness"].is_null())
    };
    let ((stated, _), (free, no_rests)) = (with("on"), with("off"));
    assert!(
        free > 3.0 * stated && free > 0.005 && no_rests,
        "{free} {stated}"
    );
}

#[test]
fn geometries_that_cannot_work_are_refused_with_what_is_missing() {
    let folder = folder();
    let board = recording(folder.path(), |_, _| true);
    let cases: [(&[[f64; 3]], i32, &str, &str); 4] = [
        (&PLACES[..3], 2, "usage", "3 sensors, the recording 4"),
        (
            &[[0.1, 0.0, 0.0]; 4],
            3,
            "data_refused",
            "all sensors are at one place",
        ),
        (
            &[[0.0; 3], [0.1, 0.0, 0.0], [0.2, 0.0, 0.0], [0.4, 0.0, 0.0]],
            3,
            "data_refused",
            "one line; add one off it",
        ),
        (&[], 2, "usage", "the geometry has 0 sensors"),
    ];
    for (places, exit, code, message) in cases {
        let places = geometry(folder.path(), places);
        let object = navigate(&board, &places).fails(exit, code);
        let text = object["message"].as_str().unwrap();
        assert!(text.contains(message), "{text}");
    }
    for (text, code) in [
        ("X (m),Y (m),Z (m)\n0.01,zero,0\n", "csv_bad_number"),
        ("X (m),Y (m)\n0.01,0\n", "csv_missing_column"),
        (
            "{\"schema\":\"wimu.array/9\",\"sensors\":[]}",
            "bad_calibration",
        ),
        ("{\"schema\":", "bad_calibration"),
        (
            "{\"schema\":\"wimu.array/1\",\"sensors\":[{\"places_m\":[[0,0,0],[0,0,0],[0,0,0]],\
             \"axes\":[[1,0,0],[1,0,0],[0,0,1]]}]}",
            "bad_calibration",
        ),
    ] {
        let wrong = written(folder.path(), "wrong.txt", text);
        navigate(&board, &wrong).fails(2, code);
    }
    let places = geometry(folder.path(), &PLACES);
    wimu(&["navigate", &board, "--method", "array"]).fails(2, "usage");
    wimu(&["navigate", &board, &board]).fails(2, "usage");
    wimu(&[
        "navigate",
        &board,
        "--geometry",
        &places,
        "--method",
        "tilt",
    ])
    .fails(2, "usage");
    let refine = ["--refine", &places];
    wimu(&[&["navigate", &board, "--geometry", &places][..], &refine].concat()).fails(2, "usage");
    // At rest nothing shows where the sensors are.
    let out = folder.path().join("refined.json");
    let refine = ["--refine", out.to_str().unwrap()];
    let ran = wimu(&[&["navigate", &board, "--geometry", &places][..], &refine].concat());
    let object = ran.fails(3, "data_refused");
    assert!(
        object["message"]
            .as_str()
            .unwrap()
            .contains("0 samples only"),
        "{object}"
    );
    assert!(!out.exists());
}

#[test]
fn dead_saturated_and_missing_sensors_are_said() {
    let folder = folder();
    let places = geometry(folder.path(), &PLACES);
    // Three others are in a plane and suffice for ω̇ and s.
    let board = recording(folder.path(), |_, fields| {
        for field in &mut fields[7..10] {
            *field = "0".to_owned();
        }
        true
    });
    let said = remarks(&navigate(&board, &places));
    assert!(
        said.contains("sensor 2 (from 0) is left out: its output never moves"),
        "{said}"
    );
    let board = recording(folder.path(), |k, fields| {
        if (200..210).contains(&k) {
            fields[4] = "1000000".to_owned();
        }
        true
    });
    let said = remarks(&navigate(&board, &places));
    assert!(
        said.contains("full scale, 2000 m/s², in 10 outputs, first at 2.00 s (line 202)")
            && said.contains("10 of sensor 1"),
        "{said}"
    );
    // In counts it is known that it is the limit.
    let counts = fs::read_to_string(&board).unwrap();
    fs::write(&board, counts.replace("(m/s²)", "(LSB)")).unwrap();
    let of_counts = ["--sensitivity", "9.80665"];
    let ran = wimu(&[&["navigate", &board, "--geometry", &places], &of_counts[..]].concat());
    let said = remarks(&ran);
    assert!(
        said.contains("10 samples without the sensors that were at their limit"),
        "{said}"
    );
    assert!(!said.contains("full scale"), "{said}");
    let board = recording(folder.path(), |_, fields| {
        for field in &mut fields[4..] {
            *field = "0".to_owned();
        }
        true
    });
    let object = navigate(&board, &places).fails(3, "data_refused");
    assert!(
        object["message"]
            .as_str()
            .unwrap()
            .contains("3 usable axes, 6 are needed"),
        "{object}"
    );
}

#[test]
fn gaps_times_that_jump_and_what_is_no_number_are_said() {
    let folder = folder();
    let places = geometry(folder.path(), &PLACES);
    let board = recording(folder.path(), |k, _| !(150..200).contains(&k));
    let said = remarks(&navigate(&board, &places));
    assert!(said.contains("1 gap longer than 0.25 s"), "{said}");
    let board = recording(folder.path(), |k, fields| {
        if k == 100 {
            fields[0] = "0.5".to_owned();
        }
        true
    });
    let object = navigate(&board, &places).fails(2, "csv_time_backwards");
    assert!(
        object["where"].as_str().unwrap().contains("line 102"),
        "{object}"
    );
    let board = recording(folder.path(), |k, fields| {
        if k == 100 {
            fields[5] = "NuN".to_owned();
        }
        true
    });
    let object = navigate(&board, &places).fails(2, "csv_bad_number");
    assert!(
        object["where"].as_str().unwrap().contains("line 102"),
        "{object}"
    );
    let board = recording(folder.path(), |k, fields| {
        if k == 100 {
            fields[0] = fields[0].replace("1.000", "0.990");
        }
        true
    });
    let said = remarks(&navigate(&board, &places));
    assert!(said.contains("1 sample whose time stood still"), "{said}");
    // It never rests.
    let board = recording(folder.path(), |k, fields| {
        for (i, field) in fields[1..].iter_mut().enumerate() {
            *field = format!("{:.3}", 5.0 * ((k * (i + 3)) as f64 * 0.7).sin() + 6.0);
        }
        true
    });
    let object = navigate(&board, &places).fails(3, "data_refused");
    assert!(
        object["message"].as_str().unwrap().contains("no rest"),
        "{object}"
    );
}

#[test]
fn wireless_boards_on_one_body_are_brought_together_by_their_clocks() {
    let folder = folder();
    let boards: Vec<Simulator> = ["50", "-80"]
        .map(|ppm| Simulator::start(&["--motion", "rest", "--clock-ppm", ppm]))
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
        record_until(recorder, file, |link| {
            link["raw_samples"].as_u64() > Some(450)
        });
    }
    let places = geometry(folder.path(), &PLACES);
    let (a, b) = (files[0].as_str(), files[1].as_str());
    let ran = wimu(&["navigate", a, b, a, b, "--geometry", &places]);
    let object = ran.succeeds();
    assert_eq!(object["method"], "array");
    assert!(object["duration_s"].as_f64().unwrap() > 3.0, "{object}");
    assert!(object["valid_share"].as_f64().unwrap() > 0.6, "{object}");
    let said = remarks(&ran);
    assert!(
        said.contains("b.mcap: ") && said.contains("its clock known to"),
        "{said}"
    );
    assert!(said.contains("interpolated to common times"), "{said}");
    // Raw samples of both are what a calibration of them as one array reads; one side up does not suffice.
    let calibrate = ["calibrate", a, b, a, b, "--geometry", &places];
    let refused = wimu(&calibrate).fails(3, "data_refused");
    assert!(
        refused["message"].as_str().unwrap().contains("static pose"),
        "{refused}"
    );
    wimu(&["navigate", a, b]).fails(2, "usage");
    wimu(&["navigate", a, b, "--geometry", &places]).fails(2, "usage");
}

#[test]
fn what_one_sensor_does_not_give_or_gives_as_spikes_is_left_out_and_the_rest_is_found() {
    let folder = folder();
    let places = geometry(folder.path(), &PLACES);
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
    let said = remarks(&navigate(&board, &places));
    assert!(
        said.contains("4 samples of sensor 1 (from 0), first at 1.00 s"),
        "{said}"
    );
    assert!(said.contains("sensor 2 (from 0) from 3.00 s on"), "{said}");
    assert!(!said.contains("no rest"), "{said}");
    let board = recording(folder.path(), |k, fields| {
        if k % 17 == 3 {
            fields[10 + k % 3] = format!("{}", 40.0 + k as f64);
        }
        true
    });
    let ran = navigate(&board, &places);
    let said = remarks(&ran);
    assert!(said.contains("24 of sensor 3 (from 0)"), "{said}");
    assert_eq!(ran.succeeds()["final_valid"], true);
}

#[test]
fn delays_that_the_geometry_knows_are_nothing_to_remark() {
    let folder = folder();
    let board = recording(folder.path(), |_, _| true);
    let sensors: Vec<serde_json::Value> = (0..4)
        .map(|k| serde_json::json!({"places_m": [PLACES[k], PLACES[k], PLACES[k]], "delay_us": 250.0 * k as f64}))
        .collect();
    let known = serde_json::json!({"schema": "wimu.array/1", "sensors": sensors}).to_string();
    let known = written(folder.path(), "known.json", &known);
    let ran = navigate(&board, &known);
    let said = remarks(&ran);
    assert!(!said.contains("no rest at the start"), "{said}");
    assert!(
        !said.contains("did not give") && !said.contains("missing"),
        "{said}"
    );
    assert_eq!(ran.succeeds()["final_valid"], true);
}

#[test]
fn a_path_says_whose_it_is_where_that_is_not_the_origin_and_that_places_were_not_checked() {
    let folder = folder();
    let board = recording(folder.path(), |_, _| true);
    let centred = remarks(&navigate(&board, &geometry(folder.path(), &PLACES)));
    assert!(!centred.contains("centre of the sensors"), "{centred}");
    assert!(centred.contains("was not checked"), "{centred}");
    let beside = PLACES.map(|[x, y, z]| [x + 0.1, y, z]);
    let beside = remarks(&navigate(&board, &geometry(folder.path(), &beside)));
    assert!(beside.contains("at 100.0 0.0 0.0 mm"), "{beside}");
}
