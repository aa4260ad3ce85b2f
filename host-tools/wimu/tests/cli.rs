//! The tool as scripts use it: exit codes, and one JSON object that says what went wrong, where,
//! and what to do.

use crate::kit;

use std::fs;
use std::io::Write;
use std::net::TcpListener;
use std::path::Path;
use std::thread;
use std::time::Duration;

use kit::{Background, Simulator, folder, in_folder, wimu};

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
        (None, "no answer"),
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
