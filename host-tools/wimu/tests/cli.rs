//! The tool as scripts use it: exit codes, and one JSON object that names the fault, its location and a
//! remedy.

use crate::kit;

use std::fs;
use std::io::Write;
use std::net::TcpListener;
use std::path::Path;
use std::thread;
use std::time::Duration;

use kit::{Background, Simulator, Transcript, folder, in_folder, line_number, verbatim, wimu};

const XYZ: &str = "Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)";

#[test]
fn wrong_usage_ends_with_2_and_one_object() {
    let mut texts = Transcript::default();
    for arguments in [
        &[][..],
        &["bogus"],
        &["monitor"],
        &["calibrate", "a.csv", "--gravity", "much"],
        &["settings", "set", "tcp://127.0.0.1:1"],
        &["simulate", "--motion", "rest", "--replay", "a.csv"],
    ] {
        texts.fails(arguments.join(" "), &wimu(arguments), 2, "usage");
    }
    for (arguments, code) in [
        (&["simulate", "--speed", "0"][..], "usage"),
        (&["simulate", "--motion", "fly"], "usage"),
        (&["simulate", "--faults", "loss=200%"], "usage"),
        (&["simulate", "--faults", "cable:lossy"], "usage"),
        (&["simulate", "--clock-ppm", "1e9"], "usage"),
        (&["simulate", "--sensor-fault", "gyroscope-bends=1s@1s"], "usage"),
        (&["simulate", "--sensor", "lsm6dso", "--replay", "a.csv"], "usage"),
        (&["calibrate", "a.csv", "--model", "12"], "usage"),
        (&["monitor", "tcp://127.0.0.1"], "bad_link"),
        (&["monitor", "carrier-pigeon://coop"], "bad_link"),
        (&["monitor", "ble://wimu"], "link_kind_missing"),
        (&["info", "no-such-file.mcap"], "file_unreadable"),
        (&["calibrate", "no-such-file.csv"], "file_unreadable"),
    ] {
        texts.fails(arguments.join(" "), &wimu(arguments), 2, code);
    }
    let (csv, _folder) = in_folder("means.csv");
    fs::write(&csv, format!("{XYZ}\n0,0,1\n")).unwrap();
    for flags in [&["--push"][..], &["--where", "nonsense"]] {
        let ran = wimu(&[&["calibrate", &csv][..], flags].concat());
        texts.fails(flags.join(" "), &ran, 2, "usage");
    }
    texts.check("wrong_usage");
}

/// The help of a command followed by that of its own commands.
fn help(command: &[&str]) -> String {
    let ran = wimu(&[command, &["--help"]].concat());
    assert_eq!(ran.code, 0, "{ran:?}");
    let command_line = [&["wimu"], command, &["--help"]].concat().join(" ");
    let mut text = format!("$ {command_line}\n{}", ran.stdout);
    if !command.is_empty() {
        for name in commands(&ran.stdout) {
            text += "\n";
            text += &help(&[command, &[name]].concat());
        }
    }
    text
}

/// The commands that a help lists.
fn commands(help: &str) -> Vec<&str> {
    let lines = help.lines().skip_while(|line| *line != "Commands:").skip(1);
    let names = lines.map_while(|line| line.strip_prefix("  ")?.split_whitespace().next());
    names.filter(|name| *name != "help").collect()
}

#[test]
fn help_and_version_end_with_0() {
    assert_eq!(wimu(&["--version"]).code, 0);
    let top = help(&[]);
    verbatim("help", &top);
    let all = commands(&top);
    assert!(all.len() > 10, "{top}");
    for name in all {
        verbatim(&format!("help_{name}"), &help(&[name]));
    }
}

#[test]
fn a_link_that_cannot_be_opened_is_named() {
    let mut texts = Transcript::default();
    // A port that was free a moment ago.
    let free = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = free.local_addr().unwrap();
    drop(free);
    let link = format!("tcp://{address}");
    for command in ["monitor", "info"] {
        let failure = texts.fails(command, &wimu(&[command, &link]), 1, "link_refused");
        assert_eq!(failure["place"]["at"], link);
    }
    wimu(&["params", "get", &link]).fails(1, "link_refused");
    wimu(&["settings", "get", &link]).fails(1, "link_refused");
    let port = "/dev/wimu-has-no-such-port";
    let failure = texts.fails("no such port", &wimu(&["monitor", port]), 1, "link_absent");
    assert_eq!(failure["place"]["at"], port);
    let (file, _folder) = in_folder("out.mcap");
    let ran = wimu(&["record", &link, "-o", &file]);
    texts.fails("record", &ran, 1, "link_refused");
    assert!(!Path::new(&file).exists(), "nothing was recorded");
    texts.check("links_that_cannot_be_opened");
}

/// A TCP server that is no board: repeats `speech`, or stays silent.
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
fn a_peer_that_is_no_wimu_board_is_reported() {
    let mut texts = Transcript::default();
    let cases = [
        ("silence", None),
        ("HTTP", Some(&b"HTTP/1.1 400 Bad Request\r\n\r\n\0"[..])),
        ("zeros", Some(&b"\0\0\0\0\0\0\0\0"[..])),
        ("other bytes", Some(&b"\x01\x02\x03\xff\x80"[..])),
    ];
    // All at once: each waits for its timeout.
    let running = cases.map(|(case, speech)| {
        let link = stranger(speech);
        (case, Background::start(&["info", &link]), link)
    });
    for (case, process, link) in running {
        let failure = texts.fails(case, &process.finish(), 1, "not_a_wimu_board");
        assert_eq!(failure["place"]["at"], link);
    }
    texts.check_live("peers_that_are_no_board");
}

#[test]
fn a_board_of_another_wire_version_is_reported() {
    // Telemetry of version 3, empty.
    let link = stranger(Some(&[6, 0x34, 0xFF, 0x8D, 0x04, 0xA5, 0]));
    let mut texts = Transcript::default();
    let commands = [&["info", &link][..], &["params", "get", &link]];
    for process in commands.map(Background::start) {
        let ran = process.finish();
        let failure = texts.fails("version 3", &ran, 1, "protocol_version");
        assert_eq!(failure["place"]["at"], link);
    }
    texts.check("board_of_another_wire_version");
}

#[test]
fn a_link_or_an_address_in_use_is_reported() {
    let mut texts = Transcript::default();
    let board = Simulator::start(&[]);
    let address = board.cable.strip_prefix("tcp://").unwrap();
    let ran = wimu(&["simulate", "--cable", address, "--wireless", "127.0.0.1:0"]);
    let failure = texts.fails("address", &ran, 1, "link_busy");
    assert_eq!(failure["place"]["at"], address);

    let _first = Background::start(&["monitor", &board.wireless]).after_a_line();
    let ran = wimu(&["info", &board.wireless]);
    let failure = texts.fails("link", &ran, 1, "link_busy");
    assert_eq!(failure["place"]["at"], board.wireless);
    texts.check("links_in_use");
}

#[test]
fn a_csv_that_cannot_be_read_is_reported_with_line_and_cause() {
    let folder = folder();
    let mut texts = Transcript::default();
    for (text, code, line) in [
        (String::new(), "csv_empty", None),
        ("1,2,3\n4,5,6\n".into(), "csv_unknown_unit", Some(1)),
        (
            "Accelerometer X (g),Accelerometer Y (g)\n0,1\n".into(),
            "csv_missing_column",
            Some(1),
        ),
        (
            "Time (s),Range (m)\n0,1\n".into(),
            "csv_missing_column",
            Some(1),
        ),
        (
            format!("Time (s),{XYZ}\n0,0,0,1\n1,0,abc,1\n2,0,abc,1\n"),
            "bad_recording",
            Some(3),
        ),
        (
            "Accelerometer X (g),Accelerometer Y (LSB),Accelerometer Z (g)\n0,0,1\n".into(),
            "csv_mixed_units",
            Some(1),
        ),
        (
            "Accelerometer X (furlong),Accelerometer Y (furlong),Accelerometer Z (furlong)\n0,0,1\n"
                .into(),
            "csv_unknown_unit",
            Some(1),
        ),
        (
            format!("{XYZ}\n0,0,1\n0,1\n1,1\n"),
            "bad_recording",
            Some(3),
        ),
        (format!("{XYZ}\n"), "no_rows", None),
    ] {
        let path = folder.path().join("input.csv");
        fs::write(&path, &text).unwrap();
        let file = path.to_str().unwrap();
        let failure = texts.fails(
            format_args!("{text:?}"),
            &wimu(&["calibrate", file]),
            2,
            code,
        );
        assert!(failure["place"]["at"].as_str().unwrap().starts_with(file));
        assert_eq!(line_number(&failure), line, "{failure}");
        if line.is_some() {
            wimu(&["simulate", "--replay", file]).fails(2, code);
        }
    }
    let path = folder.path().join("bytes.csv");
    fs::write(&path, b"Accelerometer X (g)\xff\n").unwrap();
    let ran = wimu(&["calibrate", path.to_str().unwrap()]);
    texts.fails("not UTF-8", &ran, 2, "csv_no_header");
    texts.check("csv_that_cannot_be_read");
}

#[test]
fn data_that_support_no_answer_end_with_3_and_one_report() {
    let folder = folder();
    let csv = folder.path().join("poses.csv");
    fs::write(&csv, format!("{XYZ}\n0,0,1\n0,1,0\n1,0,0\n")).unwrap();
    let answer = folder.path().join("CAL.json");
    let ran =
        wimu(&["calibrate", csv.to_str().unwrap(), "--poses", "-o", answer.to_str().unwrap()]);
    assert_eq!(ran.code, 3, "{ran:?}");
    let report = ran.object();
    assert!(!kit::reason(&report).is_empty());
    assert_eq!(report["method"], "multi-position");
    assert_eq!(report["poses"], 3);
    assert!(!report["next_poses"].as_array().unwrap().is_empty());
    assert!(!answer.exists(), "a refusal is no calibration");
}

#[test]
fn a_file_that_is_no_recording_or_calibration_is_reported() {
    let mut texts = Transcript::default();
    let folder = folder();
    let file = |name: &str, text: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    for (command, name, bytes, code) in [
        ("info", "empty.mcap", &b""[..], "bad_recording"),
        ("info", "letter.mcap", b"this is a letter", "csv_no_header"),
        ("navigate", "start.mcap", b"\x89MCAP0\r\n\x01", "bad_recording"),
    ] {
        let ran = wimu(&[command, &file(name, bytes)]);
        texts.fails(format_args!("{command} {name}"), &ran, 2, code);
    }
    let link = "tcp://127.0.0.1:1";
    for text in ["{", "[]", "{}", "{\"schema\":\"wimu.error/1\"}"] {
        let cal = file("CAL.json", text.as_bytes());
        let ran = wimu(&["params", "push", link, &cal]);
        let failure = texts.fails(text, &ran, 2, "bad_calibration");
        assert!(failure["place"]["at"].as_str().unwrap().starts_with(&cal));
    }
    texts.check("files_that_are_no_recording_or_calibration");
}

#[test]
fn a_bug_report_has_the_answers_and_bytes_of_both_links_and_no_key() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let user = folder.path().join("user");
    let board = Simulator::start(&["--motion", "rest"]);
    Background::start_as(&user, &["key", "set", &board.cable]).finish().succeeds();
    let key = fs::read_dir(user.join("wimu/keys")).unwrap().next().unwrap().unwrap().path();
    let key = fs::read_to_string(key).unwrap()[..64].to_owned();
    let file = path("report.json");
    let links = [board.wireless.as_str(), "--cable", &board.cable];
    let report = |links: &[&str]| {
        let arguments = [&["report-bug"], links, &["--for", "2", "-o", &file]].concat();
        Background::start_as(&user, &arguments).finish().succeeds();
        let text = fs::read_to_string(&file).unwrap();
        assert!(!text.contains(&key));
        serde_json::from_str::<serde_json::Value>(&text).unwrap()
    };
    let found = report(&links);
    for link in found["links"].as_array().unwrap() {
        assert_eq!(link["device"]["sensor"], "LSM303AGR", "{found}");
        let bytes = link["bytes"].as_u64().unwrap() as usize;
        let received = link["received"].as_array().unwrap().iter();
        let digits: usize = received.map(|entry| entry["hex"].as_str().unwrap().len()).sum();
        assert!(bytes > 200 && digits == 2 * bytes, "{bytes} {digits}");
    }
    drop(board);
    let found = report(&["tcp://127.0.0.1:1"]);
    assert_eq!(found["links"][0]["error"]["code"], "link_refused", "{found}");
}

#[test]
fn every_command_has_a_manual_page_and_completions() {
    let folder = folder();
    let pages = folder.path().join("man1");
    let ran = wimu(&["man", pages.to_str().unwrap()]);
    assert_eq!(ran.code, 0, "{ran:?}");
    let page = fs::read_to_string(pages.join("wimu-navigate.1")).unwrap();
    assert!(page.contains("anchors"), "{page}");
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let ran = wimu(&["completions", shell]);
        assert!(ran.code == 0 && ran.stdout.contains("report-bug"), "{ran:?}");
    }
}
