//! Commands that read a LINK like a file.

use crate::kit;

use std::fs;
use std::io::Write as _;
use std::net::TcpListener;
use std::path::Path;
use std::thread;
use std::time::Duration;

use kit::{Background, Simulator, folder, record_motion, wimu};
use serde_json::Value;
use wimu_host::calibration::read_parameters;

const SEED: u64 = 5;

/// The calibration of the simulated accelerometer of [`SEED`].
fn calibrated(to: &str) {
    let recording = format!("{to}.mcap");
    record_motion("twelve-poses", SEED, &recording);
    wimu(&["calibrate", &recording, "-o", to]).succeeds();
}

#[test]
fn allan_listens_to_a_board_for_a_time_or_until_ctrl_c() {
    let seed = SEED.to_string();
    let board = Simulator::start(&["--motion", "rest", "--seed", &seed, "--speed", "20"]);
    let timed = wimu(&["allan", &board.cable, "--for", "3"]).succeeds();
    // 220 µg/√Hz and what rounding to 12 bits adds.
    for axis in timed["accelerometer"]["axes"].as_array().unwrap() {
        let density = &axis["noise_density"];
        let [value, sd] = ["value", "sd"].map(|key| density[key].as_f64().unwrap());
        assert!((value - 220e-6 * 9.80665).abs() < 0.15 * value + 4.0 * sd, "{timed}");
        let interval = density["interval_95"].as_array().unwrap();
        assert!(interval[0].as_f64().unwrap() < value && value < interval[1].as_f64().unwrap());
    }
    // Interrupted after its first line: refused if there is too little.
    let listening = Background::start(&["allan", &board.cable]).prints("\n", 1);
    std::thread::sleep(std::time::Duration::from_millis(500));
    #[cfg(unix)]
    {
        let ran = listening.signal("-INT");
        assert!(ran.code == 0 || ran.code == 3, "{ran:?}");
    }
    let absent = wimu(&["allan", "tcp://127.0.0.1:1", "--for", "1"]);
    assert_eq!(absent.code, 1, "{absent:?}");
    let (file, _folder) = kit::in_folder("rest.csv");
    fs::write(&file, "Accelerometer X (g)\n").unwrap();
    wimu(&["allan", &file, "--for", "1"]).fails(2, "usage");
}

#[test]
fn align_listens_until_the_alignment_is_found_and_pushes_it() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (accelerometer, aligned) = (path("A.json"), path("ALIGNED.json"));
    calibrated(&accelerometer);
    let seed = SEED.to_string();
    let motion = ["--motion", "six-positions", "--seed", &seed, "--speed", "4"];
    let idle = Simulator::start(&motion);
    wimu(&["align", &idle.cable, "--up", "z,x"]).fails(2, "usage");
    // It waits for somebody to listen.
    let board = Simulator::start(&[&motion[..], &["--exit-when-done"]].concat());
    // The sensor's x is the body's z, its y the body's −x: x up, x down, y up, …
    let of = ["align", &board.cable, "--up", "z,-z,-x", "--push", "-o", &aligned];
    let report = wimu(&[&of[..], &["--with", &accelerometer]].concat()).succeeds();
    assert!(report["sd_deg"][0].as_f64().unwrap() < 2.0, "{report}");
    let [before, after] =
        [&accelerometer, &aligned].map(|p| read_parameters(Path::new(p)).unwrap());
    assert_eq!(before.model, after.model);
    for (sensor, body) in [([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]), ([0.0, 1.0, 0.0], [-1.0, 0.0, 0.0])]
    {
        let found = after.alignment.rotate(sensor);
        let off = (0..3).map(|k| (found[k] - body[k]).abs()).fold(0.0, f64::max);
        assert!(off < 0.1, "{found:?}");
    }
    // What it sends is in the body's axes now.
    let lines = wimu(&["monitor", &board.cable, "--for", "1"]);
    let objects = lines.objects();
    let last = objects.last().unwrap();
    assert_eq!(last["parameter_id"], report["parameter_id"]);
    assert!(last["corrected"].as_bool().unwrap());
    let force = [0, 1, 2].map(|k| last["specific_force_m_s2"][k].as_f64().unwrap());
    let counts = [0, 1, 2].map(|k| last["raw_lsb"][k].as_f64().unwrap());
    let own = [counts[0], counts[1], counts[2]].map(|lsb| lsb / 16384.0 * 9.80665);
    // z of the body is x of the sensor and x of the body −y, up to its errors.
    assert!((force[2] - own[0]).abs() < 1.5 && (force[0] + own[1]).abs() < 1.5, "{last}");
}

/// Objects of `wimu navigate LINK`: poses, and the path.
fn navigated(arguments: &[&str]) -> (Vec<Value>, Value) {
    let ran = wimu(arguments);
    let mut lines = ran.objects();
    let mut path = lines.pop().unwrap_or_else(|| panic!("{ran:?}"));
    path["problems"] = ran.problems().into();
    let warnings = ran.stderr.lines().filter(|line| line.contains("warning"));
    let warnings: Vec<&str> = warnings.collect();
    let different: std::collections::HashSet<_> = warnings.iter().collect();
    assert_eq!(different.len(), warnings.len(), "each once: {warnings:?}");
    (lines, path)
}

fn near(pose: &Value, [e, n, u]: [f64; 3]) -> f64 {
    let p = [0, 1, 2].map(|k| pose["position_m"][k].as_f64().unwrap());
    (p[0] - e).hypot(p[1] - n).hypot(p[2] - u)
}

/// A unit at rest, and anchors.
const AT_M: [f64; 3] = [2.0, 3.0, 1.0];
const ANCHORS: &str =
    "Anchor,Position E (m),Position N (m),Position U (m)\nA,0,0,0\nB,8,0,2\nC,8,6,0\nD,0,6,2.5\n";

/// Ranges of it, one anchor after the other.
fn range_m(anchor: usize) -> f64 {
    let [e, n, u] = [[0.0, 0.0, 0.0], [8.0, 0.0, 2.0], [8.0, 6.0, 0.0], [0.0, 6.0, 2.5]][anchor];
    (AT_M[0] - e).hypot(AT_M[1] - n).hypot(AT_M[2] - u)
}

#[test]
fn ranges_over_a_link_or_from_a_file_move_a_board_to_the_frame_of_the_anchors() {
    let board = Simulator::start(&["--chip", "lsm6dso", "--motion", "rest"]);
    let folder = folder();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (anchors, file) = (path("anchors.csv"), path("ranges.csv"));
    fs::write(&anchors, ANCHORS).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let link = format!("tcp://{}", listener.local_addr().unwrap());
    thread::spawn(move || {
        let (mut client, _) = listener.accept().unwrap();
        writeln!(client, "Anchor,Range (m)\nX,1\nA,-1").unwrap();
        for k in 0.. {
            let id = ["A", "B", "C", "D"][k % 4];
            if writeln!(client, "{id},{:.3}", range_m(k % 4)).is_err() {
                return;
            }
            thread::sleep(Duration::from_millis(25));
        }
    });
    let of = [
        "navigate",
        &board.cable,
        "--setup",
        kit::setup("anchors", &anchors),
        "--for",
        "7",
        "--ranges",
    ];
    let (poses, found) = navigated(&[&of[..], &[&link]].concat());
    let last = poses.last().unwrap();
    assert!(near(last, AT_M) < 0.2 && last["valid"] == true, "{last}");
    let used = found["aids"]["range"]["used"].as_u64().unwrap();
    assert!((60..400).contains(&used), "{found}");
    // Those that arrived before the first sample.
    assert!(found["aids"]["range"]["late"].is_u64(), "{found}");
    assert_eq!(found["aids"]["position"], Value::Null);
    let text = found["problems"].to_string();
    assert!(text.contains("2 lines of the ranges cannot be read"), "{text}");

    // By the device's clock.
    let row = |k: usize| {
        format!("{:.3},{},{:.3}\n", k as f64 * 0.025, ["A", "B", "C", "D"][k % 4], range_m(k % 4))
    };
    let rows: String = (0..4000).map(row).collect();
    fs::write(&file, format!("Time (s),Anchor,Range (m)\n{rows}")).unwrap();
    let (poses, found) = navigated(&[&of[..], &[&file]].concat());
    let last = poses.last().unwrap();
    assert!(near(last, AT_M) < 0.2, "{last}");
    assert!(found["aids"]["range"]["used"].as_u64().unwrap() > 60, "{found}");
    wimu(&of[..6]).fails(2, "usage");
}

#[test]
fn a_board_is_navigated_live_and_fixes_over_a_link_move_it_to_their_frame() {
    let board = Simulator::start(&["--chip", "lsm6dso", "--motion", "rest"]);
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let fixes = format!("tcp://{}", listener.local_addr().unwrap());
    thread::spawn(move || {
        let (mut client, _) = listener.accept().unwrap();
        let header = "Position E (m),Position N (m),Height (m),Position Sigma E (m),Position Sigma N (m),Height Sigma (m)";
        writeln!(client, "{header}\nno,fix,,,,").unwrap();
        while writeln!(client, "10,-5,1,0.1,0.1,0.1").is_ok() {
            thread::sleep(Duration::from_millis(100));
        }
    });
    let folder = folder();
    let file = folder.path().join("path.csv");
    let arguments = ["navigate", &board.cable, "--for", "8", "--fixes", &fixes, "-o"];
    let (poses, path) = navigated(&[&arguments[..], &[file.to_str().unwrap()]].concat());
    let last = poses.last().unwrap();
    assert!(near(last, [10.0, -5.0, 1.0]) < 0.2, "{last}");
    assert!(path["aids"]["position"]["used"].as_u64().unwrap() > 20, "{path}");
    let rows = fs::read_to_string(file).unwrap().lines().count();
    assert_eq!(rows, poses.len() + 1, "a header, and a row for each position");
    let said = |text: &str| {
        let findings = path["problems"].as_array().unwrap();
        findings.iter().any(|f| f["text"].as_str().unwrap().contains(text))
    };
    assert!(said("moved to the frame of the fixes"), "{path}");
    assert!(said("1 line of the fixes cannot be read"), "{path}");
}
