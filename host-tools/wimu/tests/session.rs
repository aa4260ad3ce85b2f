//! From a board to a calibration on it: the whole loop, as a user goes through it.

use crate::kit;

use std::fs;

use kit::{Background, Links, Simulator, Transcript, folder, record_motion, wimu};
use serde_json::Value;

/// Whether an object has these keys, none of them null.
fn has(object: &Value, keys: &[&str]) {
    for key in keys {
        assert!(!object[*key].is_null(), "{key} in {object}");
    }
}

#[cfg(unix)]
#[test]
fn the_whole_loop_from_a_board_to_a_pushed_calibration() {
    let mut texts = Transcript::default();
    let folder = folder();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (session, cal, table) = (path("session.mcap"), path("CAL.json"), path("session.csv"));
    let live = path("live.mcap");
    let board = Simulator::start(&["--motion", "hand"]);

    // Both links at once, byte for byte.
    let recorded = board.record_samples(Links::Both, &live, 400);
    let links = recorded["links"].as_array().unwrap();
    assert_eq!(links.len(), 2);
    for link in links {
        assert!(link["raw"]["received"].as_u64().unwrap() >= 400, "{link}");
        assert_eq!(link["raw"]["missing"], 0, "{link}");
        assert_eq!(link["frames_damaged"], 0, "{link}");
    }
    // A recording is not overwritten.
    let ran = wimu(&["record", &board.wireless, "-o", &live, "--for", "1"]);
    texts.fails("record again", &ran, 2, "file_exists");

    let ran = wimu(&["info", &live]);
    let info = ran.succeeds();
    assert_eq!(info["truncated"], false);
    assert_eq!(info["links"].as_array().unwrap().len(), 2);
    // The samples of both links are equal.
    let against = wimu(&["calibrate", &live, "--method", "reference"]).succeeds();
    assert_eq!(against["method"], "reference");
    for axis in 0..3 {
        assert_eq!(against["model"]["bias_m_s2"][axis], 0.0);
        assert_eq!(against["model"]["matrix"][axis][axis], 1.0);
    }

    // A longer session of the same board.
    record_motion("twelve-poses,slide", 1, &session);
    texts.text("info RECORDING", &wimu(&["info", &session]));
    let ran = wimu(&["convert", &session, "-o", &table]);
    let exported = ran.succeeds();
    texts.text("export", &ran);
    let rows = exported["rows"].as_u64().unwrap();
    let text = fs::read_to_string(&table).unwrap();
    assert_eq!(text.lines().count() as u64, rows + 1);
    assert!(text.starts_with("Time ("), "{}", text.lines().next().unwrap());
    for stream in ["corrected", "navigation"] {
        let out = path(&format!("{stream}.csv"));
        wimu(&["convert", &session, "-o", &out, "--stream", stream]).succeeds();
    }

    let report = wimu(&["calibrate", &session, "-o", &cal]).succeeds();
    has(
        &report,
        &[
            "method",
            "terms",
            "poses",
            "dof",
            "gravity_m_s2",
            "gravity_source",
            "rms_mm_s2",
            "max_mm_s2",
            "loo_rms_mm_s2",
            "condition",
            "model",
            "sd",
            "rejected_poses",
            "next_poses",
            "temperature_c",
        ],
    );
    assert!(report["poses"].as_u64().unwrap() >= 12);
    assert!(report["rms_mm_s2"].as_f64().unwrap() < 5.0);
    // The exported table gives the same calibration as the recording.
    let from_table = wimu(&["calibrate", &table, "--sensitivity", "16384"]).succeeds();
    assert_eq!(from_table["model"], report["model"]);

    // Only the cable writes; a dry run lists the changes.
    let dry = wimu(&["device", "params", "push", &board.cable, &cal, "--dry-run"]);
    assert_eq!(dry.succeeds()["calibrated"], false);
    texts.text("params push --dry-run", &dry);
    let ran = wimu(&["device", "params", "push", &board.wireless, &cal]);
    texts.fails("params push by radio", &ran, 4, "key_needed");
    let held = wimu(&["device", "params", "push", &board.cable, &cal]).succeeds();
    assert_eq!(held["parameter_id"], report["parameter_id"]);
    let again = path("held.json");
    let ran = wimu(&["device", "params", "get", &board.wireless, "-o", &again]);
    let held = ran.succeeds();
    texts.text("params get", &ran);
    assert_eq!(held["parameters"], report["parameters"]);
    // The quality of the calibration is stored with it.
    let quality = &held["parameters"]["quality"];
    assert_eq!(quality["method"], "multi-position");
    assert_eq!(quality["poses"], report["poses"]);
    has(quality, &["utc_s", "temperature", "dof", "loo_rms_mps2", "covariance"]);
    let held = wimu(&["device", "params", "push", &board.cable, &again]).succeeds();
    assert_eq!(held["parameter_id"], report["parameter_id"]);

    let navigated = wimu(&["navigate", &session]).succeeds();
    let replay = &navigated["starts"][0]["replay"];
    assert!(replay["corrected_compared"].as_u64().unwrap() >= 5000, "{replay}");
    for differ in ["corrected_differ", "navigation_differ", "states_differ"] {
        assert_eq!(replay[differ], 0, "{replay}");
    }
    wimu(&["navigate", &session, "--with", &cal, "--zupt", "off"]).succeeds();

    // Settings: refused with the nearest, then taken.
    let ran = wimu(&["device", "settings", "set", &board.cable, "--rate", "333"]);
    texts.fails("settings set --rate 333", &ran, 4, "device_refused");
    wimu(&["device", "settings", "set", &board.wireless, "--rate", "200"]).fails(4, "key_needed");
    let set = wimu(&["device", "settings", "set", &board.cable, "--rate", "200", "--zupt", "off"])
        .succeeds();
    assert_eq!((&set["rate_hz"], &set["zupt"]), (&200.into(), &false.into()));

    let monitored = wimu(&["monitor", &board.cable, "--for", "1"]);
    assert_eq!(monitored.code, 0, "{monitored:?}");
    let lines = monitored.objects();
    assert!(!lines.is_empty());
    for line in &lines {
        has(line, &["sequence", "time_s", "specific_force_m_s2"]);
    }
    assert_eq!(lines[lines.len() - 1]["corrected"], true);

    // By now its rate is measured.
    texts.text("info LINK", &wimu(&["info", &board.cable]));
    let ran = wimu(&["device", "params", "factory-reset", &board.cable]);
    assert_eq!(ran.succeeds()["calibrated"], false);
    texts.text("params factory-reset", &ran);
    let ran = wimu(&["device", "settings", "get", &board.cable]);
    assert_eq!(ran.succeeds()["rate_hz"], 100);
    texts.text("settings get", &ran);
    texts.check_live("session");
}

#[test]
fn a_calibration_is_kept_in_the_store_file_over_a_restart() {
    let folder = folder();
    let store = folder.path().join("board.store");
    let arguments = ["--store", store.to_str().unwrap(), "--motion", "rest"];
    let set = |board: &Simulator| {
        wimu(&["device", "settings", "set", &board.cable, "--range", "8"]).succeeds();
    };
    let board = Simulator::start(&arguments);
    set(&board);
    drop(board);
    let board = Simulator::start(&arguments);
    let settings = wimu(&["device", "settings", "get", &board.wireless]).succeeds();
    assert_eq!(settings["range_g"], 8);
    assert_eq!(wimu(&["info", &board.cable]).succeeds()["boot_count"], 2);
}

/// Six static positions of a sensor of about 2048 LSB/g, with a little of everything wrong.
fn six_positions() -> String {
    let mut text = "Accelerometer X (LSB),Accelerometer Y (LSB),Accelerometer Z (LSB)\n".to_owned();
    for (axis, sign) in [(0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1)] {
        for k in 0..400 {
            let mut counts = [20 + k % 3, -31 + k % 2, 7 - k % 4];
            counts[axis] += sign * (2040 + 7 * axis as i32);
            counts[(axis + 1) % 3] += sign * 9;
            let [x, y, z] = counts;
            text += &format!("{x},{y},{z}\n");
        }
    }
    text
}

#[test]
fn a_replayed_file_calibrates_as_the_file_itself() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let file = path("made.csv");
    fs::write(&file, six_positions()).unwrap();
    let session = path("made.mcap");
    let board = Simulator::start(&["--replay", &file, "--speed", "50", "--exit-when-done"]);
    let wireless = board.wireless.as_str();
    let record = Background::start(&["record", wireless, "-o", &session, "--reconnect", "0.5"]);
    // The board exits when the replay is done.
    record.finish().succeeds();
    let rows = fs::read_to_string(&file).unwrap().lines().count() - 1;
    let info = wimu(&["info", &session]).succeeds();
    assert_eq!(info["links"][0]["raw_samples"], rows);
    let strip = |mut report: Value| {
        let object = report.as_object_mut().unwrap();
        for key in [
            "source",
            "rate_source",
            "parameters",
            "parameter_id",
            "units",
            "problems",
            // A file does not say it.
            "range_g",
            "range_source",
        ] {
            object.remove(key);
        }
        for pose in object["static_poses"].as_array_mut().unwrap() {
            // By the device's clock, and by the file's.
            let micros = pose["time_s"].as_f64().unwrap() * 1e6;
            pose["time_s"] = (micros.round() as i64).into();
        }
        report.to_string()
    };
    let method = ["--method", "six-position"];
    let [ours, theirs] = [&session, &file].map(|input| {
        let arguments = [&["calibrate", input][..], &method[..]].concat();
        strip(wimu(&arguments).succeeds())
    });
    assert_eq!(ours, theirs);
}
