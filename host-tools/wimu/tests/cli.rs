//! The tool as scripts use it: exit codes, and one JSON object that says what went wrong, where,
//! and what to do.

mod kit;

use std::fs;
use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::thread;
use std::time::Duration;

use kit::{Background, Simulator, folder, in_folder, wimu};
use serde_json::Value;

const XYZ: &str = "Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)";

#[test]
fn wrong_usage_ends_with_2_and_one_object() {
    for arguments in [
        &[][..],
        &["bogus"],
        &["monitor"],
        &["calibrate", "a.csv", "--gravity", "much"],
        &["settings", "set", "tcp://127.0.0.1:1"],
        &["simulate", "--motion", "rest", "--replay", "a.csv"],
    ] {
        wimu(arguments).fails(2, "usage");
    }
    for (arguments, code) in [
        (&["simulate", "--speed", "0"][..], "usage"),
        (&["simulate", "--motion", "fly"], "usage"),
        (&["simulate", "--faults", "loss=200%"], "usage"),
        (&["simulate", "--faults", "cable:lossy"], "usage"),
        (&["simulate", "--clock-ppm", "1e9"], "usage"),
        (&["calibrate", "a.csv", "--model", "12"], "usage"),
        (&["monitor", "tcp://127.0.0.1"], "bad_link"),
        (&["monitor", "carrier-pigeon://coop"], "bad_link"),
        (&["monitor", "ble://wimu"], "link_kind_missing"),
        (&["info", "no-such-file.mcap"], "file_unreadable"),
        (&["calibrate", "no-such-file.csv"], "file_unreadable"),
    ] {
        wimu(arguments).fails(2, code);
    }
    let (csv, _folder) = in_folder("means.csv");
    fs::write(&csv, format!("{XYZ}\n0,0,1\n")).unwrap();
    for flags in [&["--push"][..], &["--where", "nonsense"]] {
        wimu(&[&["calibrate", &csv][..], flags].concat()).fails(2, "usage");
    }
}

#[test]
fn help_and_version_are_no_failure() {
    for arguments in [&["--help"][..], &["--version"], &["calibrate", "--help"]] {
        let ran = wimu(arguments);
        assert_eq!(ran.code, 0, "{ran:?}");
        assert!(ran.stdout.contains("wimu"));
    }
}

#[test]
fn a_link_that_is_not_there_says_so() {
    // A port that was free a moment ago.
    let free = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = free.local_addr().unwrap();
    drop(free);
    let link = format!("tcp://{address}");
    for command in ["monitor", "info"] {
        let failure = wimu(&[command, &link]).fails(1, "link_refused");
        assert_eq!(failure["where"], link);
    }
    wimu(&["params", "get", &link]).fails(1, "link_refused");
    wimu(&["settings", "get", &link]).fails(1, "link_refused");
    let port = "/dev/wimu-has-no-such-port";
    let failure = wimu(&["monitor", port]).fails(1, "link_absent");
    assert_eq!(failure["where"], port);
    let (file, _folder) = in_folder("out.mcap");
    wimu(&["record", &link, "-o", &file]).fails(1, "link_refused");
    assert!(!Path::new(&file).exists(), "nothing was recorded");
}

/// A TCP server that is no board: says `speech` over and over, or nothing.
fn stranger(speech: Option<&'static [u8]>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    thread::spawn(move || {
        while let Ok((mut client, _)) = listener.accept() {
            thread::spawn(move || {
                loop {
                    if let Some(speech) = speech
                        && client.write_all(speech).is_err()
                    {
                        return;
                    }
                    thread::sleep(Duration::from_millis(20));
                }
            });
        }
    });
    format!("tcp://{address}")
}

#[test]
fn what_is_no_wimu_board_is_called_so() {
    for (speech, tell_tale) in [
        (None, "nothing answers"),
        (
            Some(&b"HTTP/1.1 400 Bad Request\r\n\r\n\0"[..]),
            "bytes arrived",
        ),
        (Some(&b"\0\0\0\0\0\0\0\0"[..]), "bytes arrived"),
        (Some(&b"\x01\x02\x03\xff\x80"[..]), "bytes arrived"),
    ] {
        let link = stranger(speech);
        let failure = wimu(&["info", &link]).fails(1, "not_a_wimu_board");
        let message = failure["message"].as_str().unwrap();
        assert!(message.contains(tell_tale), "{message}");
        assert_eq!(failure["where"], link);
    }
}

#[test]
fn a_board_of_another_wire_version_is_called_so() {
    // Telemetry of version 3, empty.
    let link = stranger(Some(&[6, 0x34, 0xFF, 0x8D, 0x04, 0xA5, 0]));
    for command in [&["info", &link][..], &["params", "get", &link]] {
        let failure = wimu(command).fails(1, "protocol_version");
        let message = failure["message"].as_str().unwrap();
        assert!(message.contains("version 3"), "{message}");
        assert_eq!(failure["where"], link);
    }
}

#[test]
fn a_link_or_an_address_in_use_says_so() {
    let board = Simulator::start(&[]);
    let address = board.cable.strip_prefix("tcp://").unwrap();
    let failure =
        wimu(&["simulate", "--cable", address, "--wireless", "127.0.0.1:0"]).fails(1, "link_busy");
    assert_eq!(failure["where"], address);

    let _first = Background::start(&["monitor", &board.wireless]).after_a_line();
    let failure = wimu(&["info", &board.wireless]).fails(1, "link_busy");
    assert_eq!(failure["where"], board.wireless);
}

#[test]
fn a_csv_that_cannot_be_read_says_where_and_why() {
    let folder = folder();
    for (text, code, place) in [
        (String::new(), "csv_empty", ""),
        ("1,2,3\n4,5,6\n".into(), "csv_no_header", "line 1"),
        (
            "Accelerometer X (g),Accelerometer Y (g)\n0,1\n".into(),
            "csv_missing_column",
            "line 1",
        ),
        (
            "Time (s),Range (m)\n0,1\n".into(),
            "csv_missing_column",
            "line 1",
        ),
        (
            format!("Time (s),{XYZ}\n0,0,0,1\n1,0,abc,1\n"),
            "csv_bad_number",
            "line 3",
        ),
        (
            format!("Time (s),{XYZ}\n0,0,0,1\n1,0,0,1\n2,0,0,NaN\n"),
            "csv_bad_number",
            "line 4",
        ),
        (
            "Accelerometer X (g),Accelerometer Y (LSB),Accelerometer Z (g)\n0,0,1\n".into(),
            "csv_mixed_units",
            "line 1",
        ),
        (
            "Accelerometer X (furlong),Accelerometer Y (g),Accelerometer Z (g)\n0,0,1\n".into(),
            "csv_unknown_unit",
            "line 1",
        ),
        (
            format!("Time (s),{XYZ}\n0,0,0,1\n1,0,0,1\n0.5,0,0,1\n"),
            "csv_time_backwards",
            "line 4",
        ),
        (format!("{XYZ}\n0,0,1\n0,1\n"), "csv_field_count", "line 3"),
        (format!("{XYZ}\n"), "no_rows", ""),
    ] {
        let path = folder.path().join("input.csv");
        fs::write(&path, &text).unwrap();
        let file = path.to_str().unwrap();
        let failure = wimu(&["calibrate", file]).fails(2, code);
        let found = failure["where"].as_str().unwrap();
        assert!(
            found.contains("input.csv") && found.contains(place),
            "{code}: {found}"
        );
        if !place.is_empty() {
            wimu(&["simulate", "--replay", file]).fails(2, code);
        }
    }
    let path = folder.path().join("bytes.csv");
    fs::write(&path, b"Accelerometer X (g)\xff\n").unwrap();
    wimu(&["calibrate", path.to_str().unwrap()]).fails(2, "csv_not_utf8");
}

#[test]
fn data_that_support_no_answer_end_with_3_and_one_report() {
    let folder = folder();
    let csv = folder.path().join("poses.csv");
    fs::write(&csv, format!("{XYZ}\n0,0,1\n0,1,0\n1,0,0\n")).unwrap();
    let answer = folder.path().join("CAL.json");
    let ran = wimu(&[
        "calibrate",
        csv.to_str().unwrap(),
        "--poses",
        "-o",
        answer.to_str().unwrap(),
    ]);
    assert_eq!(ran.code, 3, "{ran:?}");
    let report = ran.object();
    assert_eq!(report["schema"], "wimu.calibration/1");
    assert_eq!(report["status"], "refused");
    assert!(report["reason"].as_str().is_some_and(|r| !r.is_empty()));
    assert_eq!(report["method"], "multi-position");
    assert_eq!(report["poses"], 3);
    assert!(!report["next_poses"].as_array().unwrap().is_empty());
    assert!(!answer.exists(), "a refusal is no calibration");
}

#[test]
fn a_file_that_is_no_recording_or_calibration_says_so() {
    let folder = folder();
    let file = |name: &str, text: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    wimu(&["info", &file("a.mcap", b"")]).fails(2, "bad_recording");
    wimu(&["info", &file("b.mcap", b"this is a letter")]).fails(2, "bad_recording");
    wimu(&["navigate", &file("c.mcap", b"\x89MCAP0\r\n\x01")]).fails(2, "bad_recording");
    let link = "tcp://127.0.0.1:1";
    for text in [&b"{"[..], b"[]", b"{}", b"{\"schema\":\"wimu.error/1\"}"] {
        let cal = file("CAL.json", text);
        let failure = wimu(&["params", "push", link, &cal]).fails(2, "bad_calibration");
        assert!(failure["where"].as_str().unwrap().contains("CAL.json"));
    }
}

/// Whether an object has these keys, none of them null.
fn has(object: &Value, keys: &[&str]) {
    for key in keys {
        assert!(!object[*key].is_null(), "{key} in {object}");
    }
}

#[test]
fn the_whole_loop_from_a_board_to_a_pushed_calibration() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (session, cal, table) = (path("session.mcap"), path("CAL.json"), path("session.csv"));
    let board = Simulator::start(&["--motion", "twelve-poses,slide", "--speed", "15"]);

    // Both links at once, byte for byte.
    let recorded = wimu(&[
        "record",
        &board.wireless,
        "--cable",
        &board.cable,
        "-o",
        &session,
        "--for",
        "6",
    ])
    .succeeds();
    assert_eq!(recorded["schema"], "wimu.record/1");
    let links = recorded["links"].as_array().unwrap();
    assert_eq!(links.len(), 2);
    for link in links {
        assert!(link["raw"]["received"].as_u64().unwrap() > 7000, "{link}");
        assert_eq!(link["raw"]["missing"], 0, "{link}");
        assert_eq!(link["frames_damaged"], 0, "{link}");
    }
    // A recording is not overwritten.
    wimu(&["record", &board.wireless, "-o", &session, "--for", "1"]).fails(2, "file_exists");

    let info = wimu(&["info", &session]).succeeds();
    assert_eq!(info["schema"], "wimu.info/1");
    assert_eq!(info["truncated"], false);
    assert_eq!(info["links"].as_array().unwrap().len(), 2);

    let exported = wimu(&["export", &session, "-o", &table]).succeeds();
    let rows = exported["rows"].as_u64().unwrap();
    let text = fs::read_to_string(&table).unwrap();
    assert_eq!(text.lines().count() as u64, rows + 1);
    assert!(
        text.starts_with("Time ("),
        "{}",
        text.lines().next().unwrap()
    );
    for stream in ["corrected", "navigation"] {
        let out = path(&format!("{stream}.csv"));
        wimu(&["export", &session, "-o", &out, "--stream", stream]).succeeds();
    }

    // What came over both links is the same, sample by sample.
    let against = wimu(&["calibrate", &session, "--method", "reference"]).succeeds();
    assert_eq!(against["method"], "reference");
    for axis in 0..3 {
        assert_eq!(against["model"]["bias_m_s2"][axis], 0.0);
        assert_eq!(against["model"]["matrix"][axis][axis], 1.0);
    }

    let report = wimu(&["calibrate", &session, "-o", &cal]).succeeds();
    assert_eq!(report["schema"], "wimu.calibration/1");
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
    // The exported table says the same as the recording.
    let from_table = wimu(&["calibrate", &table, "--sensitivity", "16384"]).succeeds();
    assert_eq!(from_table["model"], report["model"]);

    // Only the cable writes, and says what it would change.
    let dry = wimu(&["params", "push", &board.cable, &cal, "--dry-run"]);
    assert_eq!(dry.succeeds()["calibrated"], false);
    assert!(dry.stderr.contains("nothing was written"), "{dry:?}");
    let failure = wimu(&["params", "push", &board.wireless, &cal]).fails(4, "key_needed");
    assert!(failure["remedy"].as_str().unwrap().contains("cable"));
    let held = wimu(&["params", "push", &board.cable, &cal]).succeeds();
    assert_eq!(held["parameter_id"], report["parameter_id"]);
    let again = path("held.json");
    let held = wimu(&["params", "get", &board.wireless, "-o", &again]).succeeds();
    assert_eq!(held["parameters"], report["parameters"]);
    // All that the calibration says of itself is there.
    let quality = &held["parameters"]["quality"];
    assert_eq!(quality["method"], "multi-position");
    assert_eq!(quality["poses"], report["poses"]);
    has(
        quality,
        &["utc_s", "temperature", "dof", "loo_rms_mps2", "covariance"],
    );
    let held = wimu(&["params", "push", &board.cable, &again]).succeeds();
    assert_eq!(held["parameter_id"], report["parameter_id"]);

    let navigated = wimu(&["navigate", &session]).succeeds();
    let replay = &navigated["starts"][0]["replay"];
    assert!(
        replay["corrected_compared"].as_u64().unwrap() > 7000,
        "{replay}"
    );
    for differ in ["corrected_differ", "navigation_differ", "states_differ"] {
        assert_eq!(replay[differ], 0, "{replay}");
    }
    wimu(&["navigate", &session, "--calibration", &cal, "--zupt", "off"]).succeeds();

    // Settings: refused with the nearest, then taken.
    let failure =
        wimu(&["settings", "set", &board.cable, "--rate", "333"]).fails(4, "device_refused");
    assert!(failure["remedy"].as_str().unwrap().contains("400 Hz"));
    wimu(&["settings", "set", &board.wireless, "--rate", "200"]).fails(4, "key_needed");
    let set = wimu(&[
        "settings",
        "set",
        &board.cable,
        "--rate",
        "200",
        "--zupt",
        "off",
    ])
    .succeeds();
    assert_eq!(
        (&set["rate_hz"], &set["zupt"]),
        (&200.into(), &false.into())
    );

    let monitored = wimu(&["monitor", &board.cable, "--for", "1"]);
    assert_eq!(monitored.code, 0, "{monitored:?}");
    let lines = monitored.objects();
    assert!(lines.len() > 500, "{} readings", lines.len());
    for line in &lines {
        assert_eq!(line["schema"], "wimu.reading/1");
        has(line, &["sequence", "time_s", "specific_force_m_s2"]);
    }
    assert_eq!(lines[lines.len() - 1]["corrected"], true);

    let held = wimu(&["params", "factory-reset", &board.cable]).succeeds();
    assert_eq!(held["calibrated"], false);
    let settings = wimu(&["settings", "get", &board.cable]).succeeds();
    assert_eq!(settings["rate_hz"], 100);
}

#[cfg(target_os = "linux")]
#[test]
fn a_key_lets_its_owner_write_over_the_wireless_link_and_nobody_else() {
    use std::os::unix::fs::PermissionsExt;

    let folder = folder();
    let store = folder.path().join("board.store");
    let arguments = ["--store", store.to_str().unwrap(), "--motion", "rest"];
    let [owner, other] = ["owner", "other"].map(|name| folder.path().join(name));
    let run_as = |user: &Path, arguments: &[&str]| Background::start_as(user, arguments).finish();
    let board = Simulator::start(&arguments);
    let set = |user: &Path, link: &str, rate: &str| {
        run_as(user, &["settings", "set", link, "--rate", rate])
    };
    set(&owner, &board.wireless, "50").fails(4, "key_needed");
    // A key never travels over the radio.
    run_as(&owner, &["key", "set", &board.wireless]).fails(4, "key_needed");
    let status = run_as(&owner, &["key", "status", &board.cable]).succeeds();
    assert_eq!(
        (&status["set"], &status["ours"]),
        (&false.into(), &false.into())
    );

    let ran = run_as(&owner, &["key", "set", &board.cable]);
    let status = ran.succeeds();
    assert_eq!(
        (&status["set"], &status["ours"]),
        (&true.into(), &true.into())
    );
    let keys = owner.join("wimu/keys");
    let file = keys.join(format!("{}.key", status["device_id"].as_str().unwrap()));
    assert_eq!(
        fs::metadata(&file).unwrap().permissions().mode() & 0o777,
        0o600
    );
    assert_eq!(fs::read_dir(&keys).unwrap().count(), 1);
    let key = fs::read_to_string(&file).unwrap();
    for said in [&ran.stdout, &ran.stderr] {
        assert!(!said.contains(key.trim()), "the key is told");
    }
    for link in [&board.wireless, &board.cable] {
        assert_eq!(set(&owner, link, "200").succeeds()["rate_hz"], 200);
        set(&other, link, "50").fails(4, "key_needed");
    }
    run_as(&other, &["key", "set", &board.cable]).fails(4, "key_needed");
    run_as(&other, &["key", "rotate", &board.cable]).fails(4, "key_needed");
    run_as(&other, &["key", "forget", &board.cable]).fails(4, "key_needed");
    let status = run_as(&other, &["key", "status", &board.wireless]).succeeds();
    assert_eq!(
        (&status["set"], &status["ours"]),
        (&true.into(), &false.into())
    );

    // It outlives a restart, and is exchanged for another.
    drop(board);
    let board = Simulator::start(&arguments);
    assert_eq!(
        set(&owner, &board.wireless, "100").succeeds()["rate_hz"],
        100
    );
    run_as(&owner, &["key", "rotate", &board.cable]).succeeds();
    assert_ne!(fs::read_to_string(&file).unwrap(), key);
    assert_eq!(set(&owner, &board.wireless, "50").succeeds()["rate_hz"], 50);
    // The old one is worth nothing.
    fs::create_dir_all(other.join("wimu/keys")).unwrap();
    let copy = other.join("wimu/keys").join(file.file_name().unwrap());
    fs::write(&copy, &key).unwrap();
    fs::set_permissions(&copy, fs::Permissions::from_mode(0o600)).unwrap();
    set(&other, &board.wireless, "100").fails(4, "key_needed");
    // A file that holds no key is named.
    fs::write(&copy, &key[1..]).unwrap();
    let failure = set(&other, &board.wireless, "100").fails(2, "file_unreadable");
    assert!(failure["where"].as_str().unwrap().ends_with(".key"));

    let status = run_as(&owner, &["key", "forget", &board.cable]).succeeds();
    assert_eq!(status["set"], false);
    assert!(!file.exists());
    set(&other, &board.cable, "100").fails(2, "file_unreadable");
    fs::remove_file(&copy).unwrap();
    set(&other, &board.cable, "100").succeeds();
}

#[test]
fn a_calibration_is_kept_in_the_store_file_over_a_restart() {
    let folder = folder();
    let store = folder.path().join("board.store");
    let arguments = ["--store", store.to_str().unwrap(), "--motion", "rest"];
    let set = |board: &Simulator| {
        wimu(&["settings", "set", &board.cable, "--range", "8"]).succeeds();
    };
    let board = Simulator::start(&arguments);
    set(&board);
    drop(board);
    let board = Simulator::start(&arguments);
    let settings = wimu(&["settings", "get", &board.wireless]).succeeds();
    assert_eq!(settings["range_g"], 8);
    assert_eq!(wimu(&["info", &board.cable]).succeeds()["boot_count"], 2);
    drop(board);
    // The count of starts is the latest record in the flash, before the directory of 112 bytes.
    let mut bytes = fs::read(&store).unwrap();
    let end = bytes.iter().rposition(|&byte| byte != 0xFF).unwrap();
    bytes[end - 112 - 4] ^= 0x10;
    fs::write(&store, &bytes).unwrap();
    let board = Simulator::start(&arguments);
    let settings = wimu(&["settings", "get", &board.wireless]).succeeds();
    assert_eq!(settings["range_g"], 8);
    assert_eq!(wimu(&["info", &board.cable]).succeeds()["boot_count"], 0);
}

#[cfg(unix)]
#[test]
fn ctrl_c_closes_a_recording_and_a_kill_loses_a_second_at_most() {
    let folder = folder();
    let board = Simulator::start(&["--motion", "rest"]);
    for (name, signal, truncated) in [("whole.mcap", "-INT", false), ("cut.mcap", "-KILL", true)] {
        let path = folder.path().join(name);
        let file = path.to_str().unwrap();
        let record = Background::start(&["record", &board.wireless, "-o", file]);
        let enough = || fs::metadata(&path).is_ok_and(|data| data.len() > 20_000);
        kit::wait_until("the recording grows", enough);
        let ran = record.signal(signal);
        if !truncated {
            assert_eq!(ran.code, 0, "{ran:?}");
            assert_eq!(ran.object()["schema"], "wimu.record/1");
        }
        let info = wimu(&["info", file]).succeeds();
        assert_eq!(info["truncated"], truncated, "{name}");
        assert!(info["links"][0]["raw_samples"].as_u64().unwrap() > 100);
    }
    // Cut off anywhere behind its head, it reads up to the cut.
    let whole = fs::read(folder.path().join("whole.mcap")).unwrap();
    let cut = folder.path().join("cut-again.mcap");
    for tenths in [3, 5, 7, 9] {
        fs::write(&cut, &whole[..whole.len() * tenths / 10]).unwrap();
        let info = wimu(&["info", cut.to_str().unwrap()]).succeeds();
        assert_eq!(info["truncated"], true);
        let table = folder.path().join(format!("{tenths}.csv"));
        let exported = wimu(&[
            "export",
            cut.to_str().unwrap(),
            "-o",
            table.to_str().unwrap(),
        ]);
        assert!([0, 2].contains(&exported.code), "{exported:?}");
        if exported.code == 2 {
            exported.fails(2, "no_rows");
        }
    }
}

#[test]
fn a_link_that_ends_while_recording_keeps_what_it_brought() {
    let folder = folder();
    let path = folder.path().join("lost.mcap");
    let file = path.to_str().unwrap();
    let board = Simulator::start(&["--motion", "rest"]);
    let record = Background::start(&["record", &board.wireless, "-o", file, "--reconnect", "1"]);
    let enough = || fs::metadata(&path).is_ok_and(|data| data.len() > 20_000);
    kit::wait_until("the recording grows", enough);
    drop(board);
    let recorded = record.finish().succeeds();
    assert_eq!(recorded["ended"]["code"], "link_refused", "{recorded}");
    let info = wimu(&["info", file]).succeeds();
    assert_eq!(info["truncated"], false);
    assert!(info["links"][0]["raw_samples"].as_u64().unwrap() > 100);
}

/// A relay to a board's link that hangs up once, after so many bytes; its LINK.
fn hangs_up_once(link: &str, after: usize) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let relay = format!("tcp://{}", listener.local_addr().unwrap());
    let target = link.trim_start_matches("tcp://").to_owned();
    std::thread::spawn(move || {
        for (number, client) in listener.incoming().enumerate() {
            let client = client.unwrap();
            let Ok(board) = TcpStream::connect(&target) else {
                return;
            };
            let (mut up_in, mut up_out) = (client.try_clone().unwrap(), board.try_clone().unwrap());
            let up = std::thread::spawn(move || std::io::copy(&mut up_in, &mut up_out));
            let (mut from, mut to) = (board.try_clone().unwrap(), client.try_clone().unwrap());
            let (mut buffer, mut carried) = ([0; 512], 0);
            while let Ok(count @ 1..) = from.read(&mut buffer) {
                carried += count;
                if to.write_all(&buffer[..count]).is_err() || (number == 0 && carried > after) {
                    break;
                }
            }
            let _ = client.shutdown(Shutdown::Both);
            let _ = board.shutdown(Shutdown::Both);
            let _ = up.join();
        }
    });
    relay
}

#[test]
fn a_link_that_is_lost_comes_back_without_the_other_or_the_file_being_lost() {
    let folder = folder();
    let path = folder.path().join("gap.mcap");
    let file = path.to_str().unwrap();
    let board = Simulator::start(&["--motion", "hand"]);
    let relay = hangs_up_once(&board.wireless, 4000);
    let arguments = ["record", &relay, "--cable", &board.cable, "-o", file];
    let recorded = wimu(&[&arguments[..], &["--for", "7"]].concat()).succeeds();
    let info = wimu(&["info", file]).succeeds();
    for links in [&recorded["links"], &info["links"]] {
        for link in links.as_array().unwrap() {
            let statistics = link.get("statistics").unwrap_or(link);
            let (missing, damaged) = match link["role"].as_str() {
                Some("wireless") => (10..200, 1),
                _ => (0..1, 0),
            };
            let lost = u64::from(link["role"] == "wireless");
            assert_eq!(statistics["interruptions"], lost, "{statistics}");
            let count = |value: &Value| value.as_u64().unwrap();
            assert!(
                missing.contains(&count(&statistics["raw"]["missing"])),
                "{statistics}"
            );
            assert!(
                count(&statistics["frames_damaged"]) <= damaged,
                "{statistics}"
            );
            // It brought more afterwards than before.
            assert!(count(&statistics["raw"]["received"]) > 400, "{statistics}");
        }
    }
    for link in recorded["links"].as_array().unwrap() {
        // Simulated time is host time.
        let clock = &link["clock"];
        assert!(clock["exchanges"].as_u64().unwrap() > 10, "{clock}");
        let rate = clock["rate_ppm"].as_f64().unwrap();
        let sd = clock["rate_sd_ppm"].as_f64().unwrap();
        assert!(rate.abs() < 5.0 * sd + 100.0, "{clock}");
    }
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
    let real = Path::new(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../../shared/data/calibration/six_position_sections.csv"
    ));
    let made = path("made.csv");
    fs::write(&made, six_positions()).unwrap();
    let mut files = vec![made];
    if real.exists() {
        files.push(real.to_str().unwrap().to_owned());
    } else {
        println!("skipped: {} is absent", real.display());
    }
    for (number, file) in files.iter().enumerate() {
        let session = path(&format!("{number}.mcap"));
        let board = Simulator::start(&["--replay", file, "--speed", "50", "--exit-when-done"]);
        let wireless = board.wireless.as_str();
        let record = Background::start(&["record", wireless, "-o", &session, "--reconnect", "0.5"]);
        // The board goes when it is done; what came is in the file.
        record.finish().succeeds();
        let rows = fs::read_to_string(file).unwrap().lines().count() - 1;
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
            ] {
                object.remove(key);
            }
            report.to_string()
        };
        let method = ["--method", "six-position"];
        let [ours, theirs] = [&session, file].map(|input| {
            let arguments = [&["calibrate", input][..], &method[..]].concat();
            strip(wimu(&arguments).succeeds())
        });
        assert_eq!(ours, theirs);
    }
}

/// A Python with `rosbags` in it, kept for the next run; `None`, with the reason said, without one.
fn python_with_rosbags() -> Option<std::path::PathBuf> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("rosbags");
    let python = folder.join("bin/python");
    let works = |command: &mut std::process::Command| {
        let ran = command.output();
        ran.is_ok_and(|ran| ran.status.success())
    };
    let mut import = std::process::Command::new(&python);
    if works(import.args(["-c", "import rosbags"])) {
        return Some(python);
    }
    let mut make = std::process::Command::new("python3");
    let mut install = std::process::Command::new(&python);
    let made = works(make.args(["-m", "venv"]).arg(&folder))
        && works(install.args(["-m", "pip", "install", "--quiet", "rosbags"]));
    if !made {
        println!("skipped: python3 with venv, pip and a network is needed for `rosbags`");
    }
    made.then_some(python)
}

/// Reads every message with `rosbags`, which knows ROS's message types by itself, and prints a line
/// a topic.
const READ_WITH_ROSBAGS: &str = r#"
import sys, math
from pathlib import Path
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

with AnyReader([Path(sys.argv[1])], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
    topics = {}
    for connection, received, raw in reader.messages():
        message = reader.deserialize(raw, connection.msgtype)
        count, first, last, norm = topics.get(connection.topic, (0, None, 0, 0.0))
        if "/imu/" in connection.topic:
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            assert message.header.frame_id == "imu_link"
            assert -2_000_000 < received - stamp < 2_000_000_000, (received, stamp)
            assert stamp > last, (connection.topic, stamp, last)
            first, last = first or stamp, stamp
        if connection.msgtype == "sensor_msgs/msg/Imu":
            assert message.orientation_covariance[0] == -1
            assert message.angular_velocity_covariance[0] == -1
            assert message.linear_acceleration_covariance[0] == 0
            a = message.linear_acceleration
            norm += math.sqrt(a.x * a.x + a.y * a.y + a.z * a.z)
        if connection.msgtype == "sensor_msgs/msg/MagneticField":
            b = message.magnetic_field
            field = math.sqrt(b.x * b.x + b.y * b.y + b.z * b.z)
            # The simulated magnetometer is read once before its first conversion.
            assert count == 0 or 1e-6 < field < 1e-3, field
        if connection.msgtype == "sensor_msgs/msg/Temperature":
            assert -40 < message.temperature < 85
        topics[connection.topic] = (count + 1, first, last, norm)
    for topic, (count, first, last, norm) in sorted(topics.items()):
        print(topic, count, (last - (first or last)) / 1e9, norm / count)
"#;

#[test]
fn rosbags_reads_the_decoded_topics_of_both_links() {
    let folder = folder();
    let path = folder.path().join("decoded.mcap");
    let file = path.to_str().unwrap();
    let board = Simulator::start(&["--motion", "rest"]);
    let arguments = [
        "record",
        &board.wireless,
        "--cable",
        &board.cable,
        "-o",
        file,
    ];
    wimu(&[&arguments[..], &["--for", "6", "--decoded"]].concat()).succeeds();
    // It is still a recording, and decodes again to the same.
    let info = wimu(&["info", file]).succeeds();
    let raw = info["links"][0]["raw_samples"].as_u64().unwrap();
    let again = folder.path().join("again.mcap");
    let arguments = [
        "export",
        file,
        "--format",
        "mcap",
        "-o",
        again.to_str().unwrap(),
    ];
    let exported = wimu(&arguments).succeeds();
    assert_eq!(exported["messages"]["/cable/imu/data_raw"], raw);

    let Some(python) = python_with_rosbags() else {
        return;
    };
    let read = std::process::Command::new(python)
        .args(["-c", READ_WITH_ROSBAGS, file])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&read.stdout).into_owned();
    assert!(
        read.status.success(),
        "{}",
        String::from_utf8_lossy(&read.stderr)
    );
    for topic in ["data_raw", "data", "mag", "temperature"] {
        for role in ["cable", "wireless"] {
            let topic = format!("/{role}/imu/{topic} ");
            let line = text.lines().find(|line| line.starts_with(&topic));
            let line = line.unwrap_or_else(|| panic!("{topic}: {text}"));
            let numbers: Vec<f64> = line[topic.len()..]
                .split(' ')
                .map(|number| number.parse().unwrap())
                .collect();
            let [count, seconds, norm] = numbers[..] else {
                panic!("{line}");
            };
            assert!(count >= 4.0 && (3.0..8.0).contains(&seconds), "{line}");
            if topic.contains("data") {
                assert!((norm - 9.8).abs() < 1.0, "{line}");
            }
        }
    }
    assert!(
        text.contains(&format!("/cable/imu/data_raw {raw} ")),
        "{text}"
    );
}
