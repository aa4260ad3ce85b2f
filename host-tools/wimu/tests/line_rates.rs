//! `wimu settings set LINK --baud N` and `LINK?baud=auto` on a serial port: a pseudo-terminal with a
//! simulated board behind it, whose line garbles what comes at another rate than its own.
#![cfg(target_os = "linux")]

use crate::kit;

use std::io::{Read, Write};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use kit::{Transcript, snapshot, wimu};
use serialport::{SerialPort, TTYPort};
use wimu_link::LinkRole;
use wimu_sim::board::{Board, BoardConfig};
use wimu_sim::motion;
use wimu_sim::scene::{Scene, World};
use wimu_sim::source::Physics;
use wimu_sim::truth::{Gauge, SensorTruth};

/// A board's link on a serial port; it hears nothing at the rates that `deaf` names. Runs until the
/// test ends; returns the port.
fn port(role: LinkRole, deaf: fn(u32) -> bool) -> String {
    let (sender, receiver) = mpsc::channel();
    thread::spawn(move || {
        let (mut ours, theirs) = TTYPort::pair().expect("a pseudo-terminal");
        ours.set_timeout(Duration::ZERO).expect("ours");
        let _ = sender.send(theirs.name().expect("a name"));
        drop(theirs);
        let scene = Scene::new(World::default());
        scene.play(0.0, motion::named("rest", 1).expect("a known motion"));
        let truth = SensorTruth::random(1, Gauge::LowerTriangular);
        let source = Physics::new(truth, scene, 1);
        let mut board = Board::start(BoardConfig::default(), source);
        let start = Instant::now();
        loop {
            let baud = ours.baud_rate().unwrap_or(115_200);
            let link = board.link(role);
            if link.baud() != Some(baud) {
                link.set_baud(baud);
            }
            let mut bytes = [0; 1024];
            if let Ok(count @ 1..) = ours.read(&mut bytes)
                && !deaf(baud)
            {
                link.push(&bytes[..count]);
            }
            board.run_until(start.elapsed().as_micros() as u64);
            let bytes = board.link(role).pull();
            // Nobody may have opened the port.
            let _ = ours.write_all(&bytes);
            thread::sleep(Duration::from_millis(1));
        }
    });
    receiver.recv().expect("a port")
}

/// Pseudo-terminals are numbered.
const PORTS: &[(&str, &str)] = &[(r"/dev/pts/\d+", "/dev/pts/N")];

fn at(port: &str, baud: &str) -> String {
    format!("serial://{port}?baud={baud}")
}

#[test]
fn both_ends_change_their_rate_and_a_host_that_does_not_know_it_finds_it() {
    let port = port(LinkRole::Cable, |_| false);
    let set = ["settings", "set", &at(&port, "115200"), "--baud", "57600"];
    let ran = wimu(&set);
    ran.succeeds();
    // The text gives the link by which the board is reached from now on.
    let link = at(&port, "57600");
    let (_, query) = link.split_once('?').unwrap();
    assert!(ran.stderr.contains(query), "{ran:?}");
    let known = wimu(&["info", &at(&port, "57600")]).succeeds();
    assert_eq!(known["role"], "cable");
    wimu(&["info", &at(&port, "115200")]).fails(1, "not_a_wimu_board");
    let found = wimu(&["info", &at(&port, "auto")]).succeeds();
    assert_eq!(found["device_id"], known["device_id"]);
}

#[test]
fn a_rate_at_which_the_host_is_not_heard_is_gone_back_from_at_both_ends() {
    let port = port(LinkRole::Cable, |baud| baud == 460_800);
    let set = ["settings", "set", &at(&port, "115200"), "--baud", "460800"];
    let mut texts = Transcript::default();
    texts.fails("--baud 460800", &wimu(&set), 1, "no_answer");
    snapshot("settings_baud_not_heard", texts.as_str(), PORTS);
    wimu(&["settings", "get", &at(&port, "115200")]).succeeds();
}

#[test]
fn the_rate_behind_a_radio_adapter_is_refused_with_the_adapters_own_recipe() {
    // By the board's word, and by the port's name before anything is opened.
    let port = at(&port(LinkRole::Wireless, |_| false), "115200");
    let mut texts = Transcript::default();
    for link in [port.as_str(), "/dev/rfcomm7"] {
        let ran = wimu(&["settings", "set", link, "--baud", "9600"]);
        let failure = texts.fails(link, &ran, 2, "usage");
        assert_eq!(failure["place"]["at"], link);
    }
    snapshot("settings_baud_behind_an_adapter", texts.as_str(), PORTS);
}
