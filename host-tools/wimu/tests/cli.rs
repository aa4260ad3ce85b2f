//! The tool as scripts use it: exit codes, and one JSON object that names the fault, its location and a
//! remedy.

use crate::kit;

use std::fs;
use std::io::Write;
use std::net::TcpListener;
use std::thread;
use std::time::Duration;

use kit::{Background, Simulator, Transcript, folder, wimu};

/// Every command and those of its own commands answer `--help`; returns how many there are.
fn helped(command: &[&str]) -> usize {
    let ran = wimu(&[command, &["--help"]].concat());
    assert!(ran.code == 0 && ran.stdout.contains("Usage:"), "{ran:?}");
    let inner = commands(&ran.stdout);
    1 + inner.iter().map(|name| helped(&[command, &[*name]].concat())).sum::<usize>()
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
    assert!(helped(&[]) > 25);
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
fn a_bug_report_has_the_answers_and_bytes_of_both_links_and_no_key() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let user = folder.path().join("user");
    let board = Simulator::start(&["--motion", "rest"]);
    Background::start_as(&user, &["device", "key", "set", &board.cable]).finish().succeeds();
    let key = fs::read_dir(user.join("wimu/keys")).unwrap().next().unwrap().unwrap().path();
    let key = fs::read_to_string(key).unwrap()[..64].to_owned();
    let file = path("report.json");
    let links = [board.wireless.as_str(), &board.cable];
    let report = |links: &[&str]| {
        let arguments = [&["device", "report-bug"], links, &["--for", "2", "-o", &file]].concat();
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
