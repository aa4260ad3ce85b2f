//! Clients that leave, flood, stop reading or speak another version; a sensor's bridge that is
//! silent. In real time: what is asserted are counts and sequence numbers, never times.

use std::collections::VecDeque;
use std::io::{ErrorKind, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use wimu_host::capture::Link;
use wimu_host::client::{Client, ConnectOptions};
use wimu_host::decode::Event;
use wimu_host::transport::{self, Transport};
use wimu_host::{Code, LinkUrl, Problem, Result, replay};
use wimu_link::message::Event as DeviceEvent;
use wimu_link::{Deframer, Kind, LinkRole, WIRE_VERSION};
use wimu_sim::scene::World;
use wimu_tests::qemu::{FreeRunning, Listen};
use wimu_tests::{Random, frame_of, who_are_you};

use super::{folder, machine, sensor};

/// Time enough for whatever comes at all: something comes at least once a second.
const PATIENCE: Duration = Duration::from_secs(20);

/// Ports that are free now.
fn free_ports() -> [SocketAddr; 2] {
    let listeners = [(); 2].map(|()| TcpListener::bind((Ipv4Addr::LOCALHOST, 0)));
    listeners.map(|listener| {
        let address = listener.and_then(|listener| listener.local_addr());
        address.expect("a free port")
    })
}

fn start(folder: &Path, cable: SocketAddr, wireless: impl Into<Listen>) -> FreeRunning {
    let (source, _scene) = sensor("rest", World::default(), 1);
    let board = FreeRunning::start(&machine(folder), source, cable, wireless);
    board.unwrap_or_else(|error| panic!("{error}"))
}

/// Plays the sensor of `board` while `host` does its work.
fn while_it_runs(mut board: FreeRunning, host: impl FnOnce() + Send) {
    thread::scope(|scope| {
        let host = scope.spawn(host);
        let ran = board.run(|| host.is_finished());
        ran.unwrap_or_else(|error| panic!("{error}"));
    });
}

type Line = Box<dyn Transport + Send>;

fn tcp(address: SocketAddr) -> Line {
    let url: LinkUrl = format!("tcp://{address}").parse().expect("a link");
    transport::open(&url).expect("it listens")
}

fn connect(line: Line) -> Listener {
    Listener::on(greeted(line).expect("a board"))
}

fn greeted(line: Line) -> Result<Client<Line>> {
    let options = ConnectOptions { patience: PATIENCE, ..ConnectOptions::default() };
    Client::connect(line, "a link", options)
}

/// A client that keeps what it hears.
struct Listener {
    client: Client<Line>,
    heard: Link,
    greetings: usize,
}

impl Listener {
    fn on(client: Client<Line>) -> Self {
        let role = client.hello().role;
        Self { client, heard: Link::new(role), greetings: 0 }
    }

    /// Listens until `wanted` has seen what it waits for; as long as that takes, within reason.
    fn until(&mut self, mut wanted: impl FnMut(&Event) -> bool) {
        for _ in 0..5_000 {
            let arrival = self.client.next_event(PATIENCE).expect("a link");
            let arrival = arrival.expect("the board is silent");
            self.heard.take(&arrival);
            self.greetings += usize::from(matches!(arrival.event, Event::Hello(_)));
            if wanted(&arrival.event) {
                return;
            }
        }
        panic!("it never came");
    }

    /// Listens until the device has said that something of this kind has happened.
    fn until_told(&mut self, kind: impl Fn(DeviceEvent) -> bool) {
        self.until(|event| matches!(event, Event::Device { event, .. } if kind(*event)));
    }

    /// Listens until `count` more samples have come.
    fn hear(&mut self, count: usize) {
        let mut heard = 0;
        self.until(|event| {
            if let Event::Samples(samples) = event {
                heard += samples.values.len();
            }
            heard >= count
        });
    }

    /// Listens until it has heard the raw sample of this number or a later one.
    fn catch_up(&mut self, sequence: u32) {
        while self.latest() < sequence {
            self.hear(1);
        }
    }

    /// Number of the latest raw sample.
    fn latest(&mut self) -> u32 {
        let raw = self.heard.latest().raw();
        raw.last().map_or(0, |sample| sample.sequence)
    }
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn a_board_whose_sensor_bridge_is_silent_says_so_and_goes_on_when_it_speaks() {
    let folder = folder();
    let [cable, wireless] = free_ports();
    let mut board = start(folder.path(), cable, wireless);
    let speaks = AtomicBool::new(false);
    thread::scope(|scope| {
        let host = scope.spawn(|| {
            let mut cable = connect(tcp(cable));
            cable.until_told(|event| matches!(event, DeviceEvent::SensorLost(_)));
            speaks.store(true, Ordering::Relaxed);
            cable.until_told(|event| event == DeviceEvent::SensorFound);
            cable.hear(100);
        });
        while !speaks.load(Ordering::Relaxed) && !host.is_finished() {
            thread::sleep(Duration::from_millis(10));
        }
        let ran = board.run(|| host.is_finished());
        ran.unwrap_or_else(|error| panic!("{error}"));
    });
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn a_bridge_that_falls_silent_for_seconds_is_understood_again() {
    let folder = folder();
    let [cable, wireless] = free_ports();
    let mut board = start(folder.path(), cable, wireless);
    let speaks = AtomicBool::new(true);
    thread::scope(|scope| {
        let host = scope.spawn(|| {
            let mut cable = connect(tcp(cable));
            cable.hear(100);
            for _ in 0..2 {
                speaks.store(false, Ordering::Relaxed);
                cable.until_told(|event| matches!(event, DeviceEvent::SensorLost(_)));
                // The board goes on asking, and all that is answered late.
                thread::sleep(Duration::from_secs(4));
                speaks.store(true, Ordering::Relaxed);
                cable.until_told(|event| event == DeviceEvent::SensorFound);
                cable.hear(100);
            }
        });
        while !host.is_finished() {
            let ran = board.run(|| host.is_finished() || !speaks.load(Ordering::Relaxed));
            ran.unwrap_or_else(|error| panic!("{error}"));
            thread::sleep(Duration::from_millis(10));
        }
    });
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn a_client_that_floods_or_leaves_stops_no_sampling() {
    let folder = folder();
    let [cable, wireless] = free_ports();
    while_it_runs(start(folder.path(), cable, wireless), || {
        let mut cable = connect(tcp(cable));
        let mut flooding = connect(tcp(wireless));
        let boots = flooding.client.hello().boot_count;
        // Frames' ends among them, so that there is something to be damaged.
        let noise = Random::new(1).bytes(100_000);
        let sent = flooding.client.transport().write_all(&noise);
        sent.expect("sent");
        cable.hear(300);
        drop(flooding);
        cable.hear(100);
        let mut again = connect(tcp(wireless));
        let hello = again.client.hello();
        assert_eq!(hello.boot_count, boots, "it has not started anew");
        again.hear(100);
        let status = again.client.status().expect("answered");
        let damaged = status.wireless.map(|link| link.frames_damaged);
        assert!(damaged > Some(0), "{status:?}");
        assert_eq!(status.cable.map(|link| link.frames_damaged), Some(0));
    });
}

/// A line that holds a few hundred bytes that nobody reads, as a serial port does.
struct Narrow(UnixStream);

impl Narrow {
    fn open(path: &Path) -> Line {
        Box::new(Self(UnixStream::connect(path).expect("it listens")))
    }
}

fn lost(error: &std::io::Error) -> Problem {
    Code::LinkLost.error(error.to_string(), "connect again")
}

impl Transport for Narrow {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize> {
        let timeout = timeout.max(Duration::from_millis(1));
        let outcome = self.0.set_read_timeout(Some(timeout));
        match outcome.and_then(|()| self.0.read(buffer)) {
            Ok(0) => Err(lost(&ErrorKind::UnexpectedEof.into())),
            Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(0),
            outcome => outcome.map_err(|error| lost(&error)),
        }
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        self.0.write_all(bytes).map_err(|error| lost(&error))
    }
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn a_client_that_stops_reading_costs_only_what_is_counted_and_hears_on_when_it_reads_again() {
    let folder = folder();
    let [cable, _] = free_ports();
    let socket = folder.path().join("wireless");
    let board = start(folder.path(), cable, Listen::Unix(socket.clone()));
    while_it_runs(board, || {
        let mut cable = connect(tcp(cable));
        let mut stalled = connect(Narrow::open(&socket));
        let boots = stalled.client.hello().boot_count;
        stalled.hear(100);
        // From here on nobody reads the wireless link. Who is there is asked on it all the same:
        // the answers may not be shed, so that they fill even the room for those.
        let mut asked = 0;
        let shed = loop {
            cable.hear(60);
            let question = stalled.client.transport().write_all(&who_are_you());
            question.expect("it takes a few bytes");
            asked += 1;
            let status = cable.client.status().expect("answered");
            let [on_cable, on_wireless] = [status.cable, status.wireless].map(|link| {
                let link = link.expect("there are two links");
                link.telemetry_shed
            });
            assert_eq!(on_cable, 0, "the other link is none the slower");
            assert!(asked < 200, "nothing is shed: {status:?}");
            if on_wireless > 60 && asked > 12 {
                break on_wireless;
            }
        };
        let sampled = cable.latest();
        let heard_before = stalled.latest();
        let asked_before = stalled.greetings;

        stalled.catch_up(sampled + 100);
        cable.catch_up(stalled.latest());
        let answered = stalled.greetings - asked_before;
        println!(
            "read up to {heard_before}, again at {sampled}; {shed} frames shed, \
             {answered} of {asked} questions answered"
        );
        assert!(answered < asked, "even what is kept had no room");
        assert_eq!(stalled.client.hello().boot_count, boots);

        // The board has sampled on: the cable misses what the sensor's late bridge made it miss.
        let status = stalled.client.status().expect("answered");
        let missing = cable.client.statistics().raw.missing;
        assert!(missing <= u64::from(status.sensor.missed), "{status:?}");
        // Whole frames are shed, and the rest is what the cable has.
        let statistics = stalled.client.statistics();
        assert_eq!(statistics.frames_damaged, 0, "{statistics:?}");
        assert!(statistics.raw.missing > missing, "{statistics:?}");
        let reference = cable.heard.latest().raw();
        let heard = stalled.heard.latest();
        for sample in heard.raw() {
            let same = reference.binary_search_by_key(&sample.sequence, |s| s.sequence);
            // Times are completed by the period of the latest epoch, which may not have arrived on both.
            if let Ok(index) = same {
                assert_eq!(reference[index].value, sample.value);
            }
        }
        // An epoch comes with the first samples after what was lost.
        let replay = replay::verify(heard, 0);
        println!("{replay:?}");
        assert!(replay.is_exact() && replay.breaks > 0, "{replay:?}");
        let last = heard.epochs().last().expect("an epoch").epoch.sequence;
        assert!(last > sampled, "{last}");
    });
}

/// A line on which the board speaks another version of the wire.
struct OtherVersion {
    line: Line,
    version: u8,
    /// Since the last zero.
    part: Vec<u8>,
    said: VecDeque<u8>,
}

impl OtherVersion {
    fn translate(&mut self, byte: u8) {
        self.part.push(byte);
        if byte != 0 {
            return;
        }
        let mut deframer = Deframer::new();
        for byte in self.part.drain(..) {
            if let Some(Ok(frame)) = deframer.push(byte) {
                let mut body = frame.body.to_vec();
                if frame.kind == Kind::Hello {
                    body[5] = self.version;
                }
                let frame = frame_of(self.version, frame.kind as u8, &body);
                self.said.extend(frame);
            }
        }
    }
}

impl Transport for OtherVersion {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize> {
        let count = self.line.read(buffer, timeout)?;
        for &byte in &buffer[..count] {
            self.translate(byte);
        }
        let count = self.said.len().min(buffer.len());
        for (place, byte) in buffer.iter_mut().zip(self.said.drain(..count)) {
            *place = byte;
        }
        Ok(count)
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        self.line.write_all(bytes)
    }
}

#[test]
#[ignore = "needs QEMU: cargo xtask release --only heavy"]
fn an_image_of_another_wire_version_is_named_with_what_to_do() {
    let folder = folder();
    let [cable, wireless] = free_ports();
    while_it_runs(start(folder.path(), cable, wireless), || {
        for (version, older) in [
            (WIRE_VERSION.checked_sub(1), "firmware"),
            (WIRE_VERSION.checked_add(1), "wimu on this computer"),
        ] {
            let Some(version) = version else { continue };
            let line = Box::new(OtherVersion {
                line: tcp(wireless),
                version,
                part: Vec::new(),
                said: VecDeque::new(),
            });
            let error = greeted(line).err().expect("refused");
            assert_eq!(error.code, Code::ProtocolVersion, "{error}");
            let says =
                format!("version {version} of the protocol, this wimu version {WIRE_VERSION}");
            let text = error.to_string();
            assert!(text.contains(&says) && text.contains(older), "{text}");
        }
        // The board is none the worse for it.
        let mut wireless = connect(tcp(wireless));
        assert_eq!(wireless.client.hello().role, LinkRole::Wireless);
        wireless.hear(50);
    });
}
