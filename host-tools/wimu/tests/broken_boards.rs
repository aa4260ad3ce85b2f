//! Boards with a fault, as a person at the command line sees them.

use crate::kit;

use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::{self, JoinHandle};

use kit::{Background, Transcript, wait_until, wimu};
use wimu_link::hello::{Fault, Part, ResetReason, board, sensor};
use wimu_link::{Hello, LinkRole, MAX_FRAME};
use wimu_model::Counts;
use wimu_sim::board::{Board, BoardConfig};
use wimu_sim::scene::{Scene, World};
use wimu_sim::server::Server;
use wimu_sim::source::{Physics, Replay};
use wimu_sim::truth::SensorTruth;

/// A simulated board that listens for as long as this lives.
struct Serving {
    link: String,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Serving {
    fn start(board: impl FnOnce() -> Board + Send + 'static) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let (sender, receiver) = mpsc::channel();
        let thread = thread::spawn(move || {
            let any = "127.0.0.1:0".parse().expect("an address");
            let server = Server::bind(board(), any, any);
            let Ok(mut server) = server else {
                panic!("cannot listen");
            };
            let address = server.address(LinkRole::Cable).expect("it listens");
            sender.send(format!("tcp://{address}")).expect("somebody waits");
            server.run(|_| stopped.load(Ordering::Relaxed));
        });
        Self { link: receiver.recv().expect("it listens"), stop, thread: Some(thread) }
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// A board at rest that was broken before it had power.
fn broken(break_it: fn(&Board)) -> Serving {
    Serving::start(move || {
        let source = Physics::new(SensorTruth::ideal(), Scene::new(World::default()), 1);
        let board = Board::start(BoardConfig::default(), source);
        break_it(&board);
        board
    })
}

#[test]
fn a_fault_of_the_sensor_is_reported_with_a_remedy_to_everyone_who_connects() {
    let mut texts = Transcript::default();
    let silent = || {
        let samples = (0..20).map(|k| Counts([k, -k, 16_384]));
        Board::start(BoardConfig::default(), Replay::new(samples))
    };
    for (what, board) in [
        ("absent", broken(|board| board.sensor().set_present(false))),
        ("another chip", broken(|board| board.sensor().set_who_am_i(0x44))),
        ("a bus held low", broken(|board| board.bus_faults().set_stuck(true))),
        ("no data", Serving::start(silent)),
    ] {
        let troubles = || {
            let mut info = wimu(&["info", &board.link]).succeeds();
            info["troubles"].take()
        };
        wait_until(what, || troubles().as_array().is_some_and(|list| !list.is_empty()));
        let info = troubles();
        let troubles = info.as_array().expect("a list");
        assert_eq!(troubles.len(), 1, "{what}: {info}");
        let trouble = troubles[0].as_str().expect("text");
        texts.list(what, [trouble]);
        // `monitor` prints it as well.
        Background::start(&["monitor", &board.link]).prints(trouble, 1);
    }
    texts.check("faults_of_a_board");
}

#[test]
fn the_reset_reason_is_reported_with_addresses_after_a_panic() {
    for (reason, fault, expected) in [
        (
            ResetReason::Fault,
            Some(Fault::panic([0x0001_1128, 0x0002_5678])),
            "panic 00025678 at 0x00011128",
        ),
        (
            ResetReason::Fault,
            Some(Fault::processor("hard fault", 0x1018_0000)),
            "hard fault at 0x10180000",
        ),
        (ResetReason::Watchdog, None, "watchdog"),
    ] {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let link = format!("tcp://{}", listener.local_addr().expect("an address"));
        let answering = thread::spawn(move || {
            let (mut host, _) = listener.accept().expect("a host");
            let hello = Hello {
                device_id: 7,
                reset_reason: reason,
                fault,
                board: Part::new(board::PICO, "Pico"),
                sensor: Part::new(sensor::ADXL345, "ADXL345"),
                ..Hello::new(LinkRole::Cable)
            };
            let mut frame = [0; MAX_FRAME];
            let length = hello.encode(&mut frame).expect("room");
            let mut asked = [0; 64];
            // Until it hangs up.
            while host.read(&mut asked).is_ok_and(|count| count > 0) {
                if host.write_all(&frame[..length]).is_err() {
                    break;
                }
            }
        });
        Background::start(&["monitor", &link]).prints(expected, 1);
        answering.join().expect("no panic");
    }
}
