//! Failures of writes to a board, as a user meets them.
#![cfg(unix)]

use crate::kit;

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::thread;
use std::time::Duration;

use kit::{Background, Simulator, Transcript, folder, record_motion_of, wimu};
use serde_json::Value;
use wimu_sim::board::SensorPart;

/// Pose means of a sensor whose bias on X is `bias` LSB, 16384 LSB/g.
fn poses(bias: i32) -> String {
    let mut text = "Accelerometer X (LSB),Accelerometer Y (LSB),Accelerometer Z (LSB)\n".to_owned();
    let axes = [
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.6, 0.8, 0.0],
        [0.0, 0.6, 0.8],
        [0.8, 0.0, 0.6],
        [0.6, -0.8, 0.0],
    ];
    for [x, y, z] in axes {
        for sign in [1.0, -1.0] {
            let lsb = |axis: f64| sign * axis * 16384.0;
            text += &format!("{},{},{}\n", lsb(x) + f64::from(bias), lsb(y), lsb(z));
        }
    }
    text
}

/// A calibration as `wimu calibrate` writes it, and its id.
fn calibration(folder: &Path, bias: i32) -> (String, Value) {
    let path = |name: String| folder.join(name).to_str().expect("text").to_owned();
    let (csv, cal) = (path(format!("{bias}.csv")), path(format!("{bias}.json")));
    fs::write(&csv, poses(bias)).expect("written");
    let flags = ["--poses", "--sensitivity", "16384", "-o", &cal];
    let report = wimu(&[&["calibrate", &csv][..], &flags].concat()).succeeds();
    (cal, report["parameter_id"].clone())
}

#[test]
fn a_file_that_was_edited_by_hand_is_not_pushed() {
    let folder = folder();
    let (cal, id) = calibration(folder.path(), 100);
    let board = Simulator::start(&["--motion", "rest"]);
    wimu(&["device", "params", "push", &board.cable, &cal]).succeeds();
    let held = folder.path().join("held.json");
    let held = held.to_str().expect("text");
    wimu(&["device", "params", "get", &board.cable, "-o", held]).succeeds();
    for file in [&cal, held] {
        let good = fs::read_to_string(file).expect("text");
        // A digit of the bias; the range; the id itself; a set without its id.
        let bias = good.find("\"bias_m").expect("a bias");
        let digit =
            bias + good[bias..].find(|c: char| c.is_ascii_digit() && c != '2').expect("one");
        let mut nudged = good.clone().into_bytes();
        nudged[digit] = b'0' + (nudged[digit] - b'0' + 1) % 10;
        let nudged = String::from_utf8(nudged).expect("text");
        let id = id.as_str().expect("an id");
        for edited in [
            nudged,
            good.replace("\"range_g\": 2", "\"range_g\": 4"),
            good.replace(id, "01234567"),
            good.replace("\"parameter_id\"", "\"was_parameter_id\""),
        ] {
            assert_ne!(edited, good);
            fs::write(file, edited).expect("written");
            wimu(&["device", "params", "push", &board.cable, file]).fails(2, "bad_calibration");
        }
        fs::write(file, good).expect("written");
        let pushed = wimu(&["device", "params", "push", &board.cable, file]).succeeds();
        assert_eq!(pushed["parameter_id"], id);
    }
}

#[test]
fn params_get_of_an_uncalibrated_device_prints_one_object_with_or_without_a_file() {
    let folder = folder();
    let file = folder.path().join("CAL.json");
    let board = Simulator::start(&["--motion", "rest"]);
    let get = ["device", "params", "get", &board.cable];
    assert_eq!(wimu(&get).succeeds()["calibrated"], false);
    let ran = wimu(&[&get[..], &["-o", file.to_str().expect("text")]].concat());
    assert_eq!(ran.stdout.lines().count(), 1);
    ran.fails(3, "data_refused");
    assert!(!file.exists());
}

#[test]
fn a_push_lists_the_changes_and_a_dry_run_changes_nothing() {
    let folder = folder();
    let [(first, a), (second, b)] = [100, 200].map(|bias| calibration(folder.path(), bias));
    let board = Simulator::start(&["--motion", "rest"]);
    wimu(&["device", "params", "push", &board.cable, &first]).succeeds();
    let dry = wimu(&["device", "params", "push", &board.cable, &second, "--dry-run"]);
    assert_eq!(dry.succeeds()["parameter_id"], a);
    let pushed = wimu(&["device", "params", "push", &board.cable, &second]);
    assert_eq!(pushed.succeeds()["parameter_id"], b);
    let mut texts = Transcript::default();
    for (case, ran) in [("--dry-run", &dry), ("push", &pushed)] {
        for id in [&a, &b] {
            assert!(ran.stderr.contains(id.as_str().expect("an id")), "{ran:?}");
        }
        // Biases of 100 and 200 LSB, 16384 LSB/g.
        texts.text(case, ran);
    }
    texts.check("params_push");
}

#[test]
fn a_calibration_of_another_sensor_is_refused() {
    let folder = folder();
    let recording = folder.path().join("adxl.mcap");
    let cal = folder.path().join("adxl.json");
    let [recording, cal] = [&recording, &cal].map(|path| path.to_str().expect("text"));
    record_motion_of(SensorPart::Adxl345, "twelve-poses", 1, recording);
    let report = wimu(&["calibrate", recording, "-o", cal]).succeeds();
    assert_eq!(report["parameters"]["sensor"], 2);
    let ours = Simulator::start(&["--motion", "rest"]);
    let range = report["parameters"]["range_g"].to_string();
    wimu(&["device", "settings", "set", &ours.cable, "--range", &range]).succeeds();
    let ran = wimu(&["device", "params", "push", &ours.cable, cal]);
    let mut texts = Transcript::default();
    texts.fails("ADXL345 to LSM303AGR", &ran, 4, "device_refused");
    texts.check("params_push_of_another_sensor");
}

/// Bytes of a key as somebody might find them.
fn forms_of(digits: &str) -> Vec<Vec<u8>> {
    const ALPHABET: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let raw: Vec<u8> = (0..digits.len() / 2)
        .map(|at| u8::from_str_radix(&digits[2 * at..2 * at + 2], 16).expect("hex"))
        .collect();
    let base64 = raw.chunks_exact(3).flat_map(|three| {
        let bits = u32::from_be_bytes([0, three[0], three[1], three[2]]);
        [18, 12, 6, 0].map(|shift| ALPHABET[(bits >> shift & 63) as usize])
    });
    let listed = raw.iter().map(u8::to_string).collect::<Vec<_>>();
    vec![
        raw[..16].to_vec(),
        base64.collect::<Vec<u8>>()[..20].to_vec(),
        digits.to_lowercase().into_bytes()[..24].to_vec(),
        digits.to_uppercase().into_bytes()[..24].to_vec(),
        listed[..8].join(", ").into_bytes(),
        listed[..8].join(",").into_bytes(),
    ]
}

#[test]
fn a_key_is_in_no_output_and_in_no_recording_and_its_file_is_for_its_owner_alone() {
    let folder = folder();
    let user = folder.path().join("user");
    let run = |arguments: &[&str]| Background::start_as(&user, arguments).finish();
    let board = Simulator::start(&["--motion", "rest"]);
    let mcap = folder.path().join("session.mcap");
    let mcap = mcap.to_str().expect("text");
    let recording =
        Background::start_as(&user, &["record", &board.wireless, "-o", mcap, "--decoded"]);
    let mut outputs = Vec::new();
    let mut keys = Vec::new();
    let mut file = None;
    for action in ["set", "status", "rotate", "status"] {
        let ran = run(&["device", "key", action, &board.cable]);
        let status = ran.succeeds();
        let name = format!("wimu/keys/{}.key", status["device_id"].as_str().expect("text"));
        let path = user.join(name);
        keys.push(fs::read_to_string(&path).expect("a key").trim().to_owned());
        outputs.extend([ran.stdout.into_bytes(), ran.stderr.into_bytes()]);
        file = Some(path);
    }
    let file = file.expect("a key's file");
    assert_ne!(keys[0], keys[2]);
    let set = run(&["device", "settings", "set", &board.cable, "--rate", "200"]);
    set.succeeds();
    // A file that others can read, or that is too long, is refused; its content is not printed.
    let good = fs::read_to_string(&file).expect("a key");
    let mode = |mode| fs::set_permissions(&file, fs::Permissions::from_mode(mode)).expect("set");
    mode(0o640);
    let open = run(&["device", "settings", "set", &board.cable, "--rate", "100"]);
    open.fails(2, "file_unreadable");
    mode(0o600);
    fs::write(&file, format!("00{good}")).expect("written");
    let long = run(&["device", "settings", "set", &board.cable, "--rate", "100"]);
    long.fails(2, "file_unreadable");
    fs::write(&file, good).expect("written");
    let forgotten = run(&["device", "key", "forget", &board.cable]);
    assert_eq!(forgotten.succeeds()["set"], false);
    assert!(!file.exists());
    let recorded = recording.signal("-INT");
    recorded.succeeds();
    for ran in [set, open, long, forgotten, recorded] {
        outputs.extend([ran.stdout.into_bytes(), ran.stderr.into_bytes()]);
    }
    outputs.push(fs::read(mcap).expect("a recording"));
    for key in &keys {
        for form in forms_of(key) {
            for output in &outputs {
                let found = output.windows(form.len()).any(|bytes| bytes == form);
                assert!(!found, "{}", String::from_utf8_lossy(output));
            }
        }
    }
}

#[test]
fn two_hosts_that_push_at_once_get_consistent_answers() {
    let folder = folder();
    let user = folder.path().join("user");
    let board = Simulator::start(&["--motion", "rest"]);
    Background::start_as(&user, &["device", "key", "set", &board.cable]).finish().succeeds();
    let sets = [100, 200].map(|bias| calibration(folder.path(), bias));
    for _ in 0..4 {
        let links = [&board.cable, &board.wireless];
        let pushes: Vec<_> = links
            .iter()
            .zip(&sets)
            .map(|(link, (cal, _))| {
                Background::start_as(&user, &["device", "params", "push", link, cal])
            })
            .collect();
        let outcomes: Vec<_> = pushes.into_iter().map(Background::finish).collect();
        let held =
            wimu(&["device", "params", "get", &board.cable]).succeeds()["parameter_id"].clone();
        let mut reported = Vec::new();
        for (ran, (_, id)) in outcomes.iter().zip(&sets) {
            match ran.code {
                0 => reported.push(id.clone()),
                // The other's set was staged, or is in use now.
                code => assert!([1, 4].contains(&code), "{ran:?}"),
            }
        }
        assert!(reported.contains(&held), "{outcomes:?}");
    }
}

#[test]
fn a_host_or_a_board_that_is_killed_while_it_pushes_leaves_the_old_set_or_the_new() {
    let folder = folder();
    let store = folder.path().join("board.store");
    let arguments = ["--store", store.to_str().expect("text"), "--motion", "rest"];
    let sets = [100, 200].map(|bias| calibration(folder.path(), bias));
    let ids = sets.each_ref().map(|(_, id)| id.clone());
    let mut board = Simulator::start(&arguments);
    wimu(&["device", "params", "push", &board.cable, &sets[0].0]).succeeds();
    for round in 0..8_u64 {
        let (cal, _) = &sets[(round as usize + 1) % 2];
        let push = Background::start(&["device", "params", "push", &board.cable, cal]);
        thread::sleep(Duration::from_millis(20 + 35 * round));
        if round % 2 == 0 {
            push.signal("-KILL");
        } else {
            drop(board);
            push.finish();
            board = Simulator::start(&arguments);
        }
        let held =
            wimu(&["device", "params", "get", &board.wireless]).succeeds()["parameter_id"].clone();
        assert!(ids.contains(&held), "{held} after round {round}");
        // The next push is not blocked.
        let again = wimu(&["device", "params", "push", &board.cable, cal]).succeeds();
        assert_eq!(again["parameter_id"], ids[(round as usize + 1) % 2]);
    }
}
