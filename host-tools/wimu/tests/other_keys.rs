//! Keys that board and host do not share, as a user meets them. An attacker between both is tested with the library's client.
#![cfg(target_os = "linux")]

use crate::kit;

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::thread;

use kit::{Background, Ran, Simulator, Transcript, folder, wimu};
use wimu_link::{Deframer, Kind, Telemetry};

fn run_as(user: &Path, arguments: &[&str]) -> Ran {
    Background::start_as(user, arguments).finish()
}

#[test]
fn reads_report_whether_the_board_has_authenticated_them() {
    let folder = folder();
    let [user, other] = ["user", "other"].map(|name| folder.path().join(name));
    let board = Simulator::start(&["--motion", "rest"]);
    run_as(&user, &["device", "key", "set", &board.cable]).succeeds();
    for read in
        [["device", "params", "get"], ["device", "settings", "get"], ["device", "key", "status"]]
    {
        let of = |user: &Path| run_as(user, &[&read[..], &[&board.cable]].concat()).succeeds();
        assert_eq!(of(&user)["authenticated"], true);
        assert!(of(&other)["authenticated"].is_null());
    }
}

/// A board of which all tags are removed on the way; returns the link.
fn without_tags(board: &str) -> String {
    let board = board.trim_start_matches("tcp://").to_owned();
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address");
    thread::spawn(move || {
        for host in listener.incoming().flatten() {
            let Ok(device) = TcpStream::connect(&board) else {
                return;
            };
            let (mut up, mut down) = (host.try_clone().unwrap(), device.try_clone().unwrap());
            thread::spawn(move || std::io::copy(&mut up, &mut down));
            thread::spawn(move || strip_tags(device, host));
        }
    });
    format!("tcp://{address}")
}

fn strip_tags(mut device: TcpStream, mut host: TcpStream) -> Option<()> {
    let (mut deframer, mut frame, mut bytes) = (Deframer::new(), Vec::new(), [0; 4096]);
    while let Ok(count @ 1..) = device.read(&mut bytes) {
        for &byte in &bytes[..count] {
            frame.push(byte);
            let heard = deframer.push(byte).and_then(Result::ok);
            let is_tag = heard.is_some_and(|frame| {
                frame.kind == Kind::Telemetry
                    && matches!(Telemetry::decode(frame.body), Ok(Telemetry::Tag(_)))
            });
            if byte == 0 {
                let whole = std::mem::take(&mut frame);
                if !is_tag {
                    host.write_all(&whole).ok()?;
                }
            }
        }
    }
    None
}

#[test]
fn data_without_the_tags_of_a_device_whose_key_is_here_are_reported() {
    let folder = folder();
    let user = folder.path().join("user");
    let board = Simulator::start(&["--motion", "rest"]);
    run_as(&user, &["device", "key", "set", &board.cable]).succeeds();
    let stripped = without_tags(&board.wireless);
    for (link, is_authentic) in [(&board.wireless, true), (&stripped, false)] {
        let file = folder.path().join(format!("{is_authentic}.mcap"));
        let file = file.to_str().expect("text");
        let recorded = run_as(&user, &["record", link, "-o", file, "--for", "5"]);
        let info = run_as(&user, &["info", file]);
        let live = run_as(&user, &["monitor", link, "--for", "5"]);
        let read = run_as(&user, &["monitor", file]);
        for ran in [&recorded, &info, &live, &read] {
            assert_eq!(ran.code, 0, "{ran:?}");
            let warns = ran.problems().iter().any(|problem| {
                let text = problem["text"].as_str().expect("text");
                problem["code"] == "not_authentic"
                    && problem["severity"] == "warning"
                    && text.starts_with("authentic: 0.0 of ")
            });
            assert_eq!(warns, !is_authentic, "{ran:?}");
            assert_eq!(ran.stderr.contains("warning: authentic: 0.0 of "), !is_authentic);
        }
        let link = info.object()["links"][0]["authentication"].clone();
        assert_eq!(
            (&link["key_known"], link["verified"].as_u64() > Some(0)),
            (&true.into(), is_authentic)
        );
        // Without a key there is nothing to expect.
        assert!(!wimu(&["info", file]).stderr.contains("authentic: "));
    }
}

#[test]
fn a_key_erased_at_the_board_is_reported_at_the_next_write() {
    let mut texts = Transcript::default();
    let folder = folder();
    let user = folder.path().join("user");
    let store = folder.path().join("board.store");
    let arguments = ["--store", store.to_str().expect("text"), "--motion", "rest"];
    let board = Simulator::start(&arguments);
    run_as(&user, &["device", "key", "set", &board.cable]).succeeds();
    drop(board);
    let board = Simulator::start(&[&arguments[..], &["--forget-key"]].concat());
    for link in [&board.cable, &board.wireless] {
        let ran = run_as(&user, &["device", "settings", "set", link, "--rate", "200"]);
        texts.fails("settings set", &ran, 4, "key_needed");
    }
    texts.check("key_erased_at_the_board");
    run_as(&user, &["device", "key", "set", &board.cable]).succeeds();
    for link in [&board.cable, &board.wireless] {
        let set = run_as(&user, &["device", "settings", "set", link, "--rate", "200"]);
        assert_eq!(set.succeeds()["authenticated"], true);
    }
}

#[test]
fn a_simulator_that_was_started_without_its_store_is_the_first_cause_named() {
    let folder = folder();
    let user = folder.path().join("user");
    run_as(&user, &["device", "key", "set", &Simulator::start(&["--motion", "rest"]).cable])
        .succeeds();
    let again = Simulator::start(&["--motion", "rest"]);
    let ran = run_as(&user, &["device", "settings", "set", &again.cable, "--rate", "200"]);
    // The causes in their order: `--store`, an erased key, a peer in between.
    let mut texts = Transcript::default();
    texts.fails("settings set", &ran, 4, "key_needed");
    let read = run_as(&user, &["device", "params", "get", &again.cable]).succeeds();
    assert_eq!(read["authenticated"], false);
    texts.check("key_of_a_simulator_without_store");
    // The remedy works.
    run_as(&user, &["device", "key", "set", &again.cable]).succeeds();
    run_as(&user, &["device", "settings", "set", &again.cable, "--rate", "200"]).succeeds();
}
