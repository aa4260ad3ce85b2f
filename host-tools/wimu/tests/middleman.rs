//! An attacker between host and board, as a user meets him: none of his answers counts as a write done,
//! and reads report whether the board has authenticated them.
#![cfg(target_os = "linux")]

use crate::kit;

use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::thread;

use kit::{Background, Ran, Simulator, Transcript, folder};
use wimu_link::message::{
    EncodedParameters, Payload, Refusal, Reply, Request, Settings, Signature,
};
use wimu_link::{Answer, Command, Deframer, Kind, MAX_FRAME};
use wimu_model::ParameterId;

/// What the attacker does, who knows no key. He answers unsigned requests himself, as the host expects.
#[derive(Clone, Copy, Debug)]
enum Attack {
    /// The board "has no key".
    NoKey,
    /// Writes that have an effect, and what is asked after them, are "refused": the board has no key.
    Refused,
    /// Lets all pass, and closes the link at a write.
    Cut,
}

/// Listens for one host after the other, for as long as the test runs; returns the link.
fn middleman(board: &str, attack: Attack) -> String {
    let board = board.trim_start_matches("tcp://").to_owned();
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address");
    thread::spawn(move || {
        for host in listener.incoming() {
            // Serves one host at a time, as the board does.
            let (Ok(host), Ok(board)) = (host, TcpStream::connect(&board)) else {
                return;
            };
            let (mut from, mut to) =
                (board.try_clone().expect("a stream"), host.try_clone().expect("a stream"));
            let down = thread::spawn(move || {
                let _ = std::io::copy(&mut from, &mut to);
                let _ = to.shutdown(std::net::Shutdown::Both);
            });
            let _ = carry(host, &board, attack);
            let _ = board.shutdown(std::net::Shutdown::Both);
            let _ = down.join();
        }
    });
    format!("tcp://{address}")
}

/// Forwards the host's requests except those that the attacker keeps.
fn carry(mut host: TcpStream, mut board: &TcpStream, attack: Attack) -> std::io::Result<()> {
    let mut deframer = Deframer::new();
    let (mut set, mut settings, mut begun) = (Vec::new(), Settings::default(), false);
    let (mut bytes, mut frame) = ([0; 4096], Vec::new());
    loop {
        let count = host.read(&mut bytes)?;
        if count == 0 {
            return Ok(());
        }
        for &byte in &bytes[..count] {
            frame.push(byte);
            let heard = match deframer.push(byte) {
                Some(Ok(heard)) if heard.kind == Kind::Request => Request::decode(heard.body).ok(),
                _ => None,
            };
            if byte != 0 {
                continue;
            }
            let whole = std::mem::take(&mut frame);
            let answer = heard.and_then(|request| {
                let effect = request.command.is_write()
                    && !matches!(request.command, Command::StageParameters { .. });
                begun |= effect;
                match request.command {
                    Command::StageParameters { offset, piece, .. } => {
                        set.truncate(offset.into());
                        set.extend(piece.as_bytes());
                    }
                    Command::SetSettings(new) => settings = new,
                    Command::FactoryReset => set.clear(),
                    _ => {}
                }
                let unsigned = request.signature == Signature::NONE;
                let answer = match attack {
                    Attack::Cut => None,
                    _ if unsigned => forged(&request.command, attack, &set, settings),
                    Attack::Refused if begun => Some(Answer::Refused(Refusal::KeyNeeded)),
                    _ => None,
                };
                answer.map(|answer| Reply {
                    session: request.session,
                    id: request.id,
                    signature: Signature::NONE,
                    answer,
                })
            });
            match answer {
                Some(reply) => {
                    let mut room = [0; MAX_FRAME + 1];
                    let length = reply.encode(&mut room[1..]).expect("room");
                    host.write_all(&room[..=length])?;
                }
                None => board.write_all(&whole)?,
            }
            if begun && matches!(attack, Attack::Cut) {
                return Ok(());
            }
        }
    }
}

/// The answer that the host expects.
fn forged(command: &Command, attack: Attack, set: &[u8], settings: Settings) -> Option<Answer> {
    let set = EncodedParameters(set);
    let id = match set.0 {
        [] => ParameterId::UNCALIBRATED,
        _ => set.id(),
    };
    Some(Answer::Accepted(match (command, attack) {
        (Command::GetKeyStatus, Attack::NoKey) => Payload::KeyStatus { key: None },
        (Command::StageParameters { total, .. }, _) if set.0.len() == usize::from(*total) => {
            Payload::Staged { hash: id.0 }
        }
        (Command::StageParameters { .. }, _) => Payload::None,
        (Command::GetParameters { offset }, _) => Payload::Parameters(set.piece(id, *offset)),
        (Command::GetSettings | Command::SetSettings(_), _) => Payload::Settings(settings),
        (Command::CommitParameters { .. } | Command::FactoryReset, _) => Payload::None,
        _ => return None,
    }))
}

fn run_as(user: &Path, arguments: &[&str]) -> Ran {
    Background::start_as(user, arguments).finish()
}

#[test]
fn no_answer_of_an_attacker_counts_as_a_write_done() {
    let mut texts = Transcript::default();
    let folder = folder();
    let user = folder.path().join("user");
    let board = Simulator::start(&["--motion", "rest"]);
    run_as(&user, &["key", "set", &board.cable]).succeeds();
    let held = folder.path().join("cal.json");
    let held = held.to_str().expect("text");
    let poses = folder.path().join("poses.csv");
    let mut text = "Accelerometer X (LSB),Accelerometer Y (LSB),Accelerometer Z (LSB)\n".to_owned();
    for axis in 0..3 {
        for sign in [1, -1] {
            let lsb = |other: i32| if other == axis { sign * 16384 } else { 0 };
            text += &format!("{},{},{}\n", lsb(0) + 100, lsb(1), lsb(2));
        }
    }
    fs::write(&poses, text).expect("written");
    let poses = poses.to_str().expect("text");
    let flags = ["--poses", "--method", "six-position", "--sensitivity", "16384", "-o", held];
    run_as(&user, &[&["calibrate", poses][..], &flags].concat()).succeeds();

    for attack in [Attack::NoKey, Attack::Refused, Attack::Cut] {
        for link in [&board.wireless, &board.cable] {
            let stranger = middleman(link, attack);
            for write in [
                &["params", "push", &stranger, held][..],
                &["settings", "set", &stranger, "--rate", "200"],
                &["params", "factory-reset", &stranger],
            ] {
                let ran = run_as(&user, write);
                let (exit, code) = match attack {
                    Attack::NoKey => (4, "key_needed"),
                    Attack::Refused => (1, "no_answer"),
                    Attack::Cut => (1, "link_lost"),
                };
                // Both links alike.
                if link == &board.wireless {
                    let case = format!("{attack:?}, {} {}", write[0], write[1]);
                    texts.fails(case, &ran, exit, code);
                } else {
                    ran.fails(exit, code);
                }
            }
        }
        if !matches!(attack, Attack::Cut) {
            let got = run_as(&user, &["params", "get", &board.cable]).succeeds();
            assert_eq!(got["calibrated"], false);
            let got = run_as(&user, &["settings", "get", &board.cable]).succeeds();
            assert_ne!(got["rate_hz"], 200);
        }
    }
    texts.check("writes_through_an_attacker");
}

#[test]
fn reads_report_whether_the_board_has_authenticated_them() {
    let mut texts = Transcript::default();
    let folder = folder();
    let [user, other] = ["user", "other"].map(|name| folder.path().join(name));
    let board = Simulator::start(&["--motion", "rest"]);
    run_as(&user, &["key", "set", &board.cable]).succeeds();
    let stranger = middleman(&board.wireless, Attack::NoKey);
    for read in ["params", "settings"] {
        let get = |user: &Path, link: &str| run_as(user, &[read, "get", link]);
        assert_eq!(get(&user, &board.cable).succeeds()["authenticated"], true);
        assert!(get(&other, &board.cable).succeeds()["authenticated"].is_null());
        let ran = get(&user, &stranger);
        assert_eq!(ran.succeeds()["authenticated"], false);
        texts.text(format_args!("{read} get"), &ran);
    }
    let status = |link: &str| run_as(&user, &["key", "status", link]);
    assert_eq!(status(&board.wireless).succeeds()["authenticated"], true);
    let ran = status(&stranger);
    assert_eq!(ran.succeeds()["authenticated"], false);
    texts.text("key status", &ran);
    texts.check("reads_through_an_attacker");
}

#[test]
fn a_key_erased_at_the_board_is_reported_at_the_next_write() {
    let mut texts = Transcript::default();
    let folder = folder();
    let user = folder.path().join("user");
    let store = folder.path().join("board.store");
    let arguments = ["--store", store.to_str().expect("text"), "--motion", "rest"];
    let board = Simulator::start(&arguments);
    run_as(&user, &["key", "set", &board.cable]).succeeds();
    drop(board);
    let board = Simulator::start(&[&arguments[..], &["--forget-key"]].concat());
    for link in [&board.cable, &board.wireless] {
        let ran = run_as(&user, &["settings", "set", link, "--rate", "200"]);
        texts.fails("settings set", &ran, 4, "key_needed");
    }
    texts.check("key_erased_at_the_board");
    run_as(&user, &["key", "set", &board.cable]).succeeds();
    for link in [&board.cable, &board.wireless] {
        let set = run_as(&user, &["settings", "set", link, "--rate", "200"]);
        assert_eq!(set.succeeds()["authenticated"], true);
    }
}

#[test]
fn a_simulator_that_was_started_without_its_store_is_the_first_cause_named() {
    let folder = folder();
    let user = folder.path().join("user");
    run_as(&user, &["key", "set", &Simulator::start(&["--motion", "rest"]).cable]).succeeds();
    let again = Simulator::start(&["--motion", "rest"]);
    let ran = run_as(&user, &["settings", "set", &again.cable, "--rate", "200"]);
    // The causes in their order: `--store`, an erased key, a peer in between.
    let mut texts = Transcript::default();
    texts.fails("settings set", &ran, 4, "key_needed");
    texts.check("key_of_a_simulator_without_store");
    // The remedy works.
    run_as(&user, &["key", "set", &again.cable]).succeeds();
    run_as(&user, &["settings", "set", &again.cable, "--rate", "200"]).succeeds();
}
