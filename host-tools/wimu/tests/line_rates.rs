//! `wimu device settings set LINK --wireless-baud N` on a serial port: a pseudo-terminal with the cable of a simulated board behind
//! it.
#![cfg(target_os = "linux")]

use crate::kit;

use std::io::{Read, Write};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use kit::wimu;
use serialport::{SerialPort, TTYPort};
use wimu_link::LinkRole;
use wimu_sim::board::{Board, BoardConfig};
use wimu_sim::motion;
use wimu_sim::scene::{Scene, World};
use wimu_sim::source::Physics;
use wimu_sim::truth::{Gauge, SensorTruth};

/// The board's cable on a serial port; runs until the test ends; returns the port.
fn port() -> String {
    let (sender, receiver) = mpsc::channel();
    thread::spawn(move || {
        let (mut ours, theirs) = TTYPort::pair().expect("a pseudo-terminal");
        ours.set_timeout(Duration::ZERO).expect("ours");
        let _ = sender.send(theirs.name().expect("a name"));
        drop(theirs);
        let scene = Scene::new(World::default());
        scene.play(0.0, motion::named("rest", 1).expect("a known motion"));
        let truth = SensorTruth::random(1, Gauge::LowerTriangular);
        let mut board = Board::start(BoardConfig::default(), Physics::new(truth, scene, 1));
        let start = Instant::now();
        loop {
            let mut bytes = [0; 1024];
            if let Ok(count @ 1..) = ours.read(&mut bytes) {
                board.link(LinkRole::Cable).push(&bytes[..count]);
            }
            board.run_until(start.elapsed().as_micros() as u64);
            // Nobody may have opened the port.
            let _ = ours.write_all(&board.link(LinkRole::Cable).pull());
            thread::sleep(Duration::from_millis(1));
        }
    });
    receiver.recv().expect("a port")
}

#[test]
fn the_rate_of_the_wireless_line_is_set_or_refused_with_the_nearest() {
    let port = port();
    let set = |baud| wimu(&["device", "settings", "set", &port, "--wireless-baud", baud]);
    let ran = set("57600");
    ran.succeeds();
    assert!(ran.stderr.contains("from the board's next start on"), "{ran:?}");
    let refused = set("100").fails(4, "device_refused");
    assert_eq!(refused["remedy"], "the nearest is 300 baud");
}
