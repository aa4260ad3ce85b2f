//! Sessions of `wimu record` in virtual time, on a simulated board whose clock and faults are known.

#![allow(dead_code, reason = "each test file uses its own part of it")]

use std::cell::RefCell;
use std::io::Cursor;
use std::time::Duration;

use wimu_host::capture;
use wimu_host::client::{Client, ConnectOptions};
use wimu_host::clock::{ClockEstimator, ClockModel, Pace};
use wimu_host::compare::{Comparison, compare};
use wimu_host::decode::{Arrival, Event};
use wimu_host::mcap_file::{ClockAnchor, Recorded, RecordingReader, RecordingWriter};
use wimu_host::transport::Transport;
use wimu_host::{Problem, Result};
use wimu_link::LinkRole;
use wimu_sim::board::{Board, BoardConfig, SimLink};
use wimu_sim::motion;
use wimu_sim::scene::{Scene, World};
use wimu_sim::source::Physics;
use wimu_sim::truth::{Gauge, SensorTruth};

/// 2 % of the bytes lost in runs, 10⁻⁴ of the bits flipped, 50 ms of jitter, a stall of 3 s.
pub const BAD: &str =
    "baud=115200,loss=2%,burst=20,bits=1e-4,latency=15ms,jitter=50ms,stall=3s@30s";
pub const ROLES: [LinkRole; 2] = [LinkRole::Cable, LinkRole::Wireless];

/// How often the host looks.
const LOOK: Duration = Duration::from_micros(100);

pub struct Session {
    pub wireless: &'static str,
    pub clock_ppm: f64,
    pub seconds: f64,
    pub seed: u64,
    pub restart_at: Option<f64>,
    pub links: &'static [LinkRole],
    pub device_id: u64,
    /// The wireless link carries every so many samples.
    pub every: u8,
}

impl Default for Session {
    fn default() -> Self {
        Self {
            wireless: BAD,
            clock_ppm: 35.0,
            seconds: 60.0,
            seed: 1,
            restart_at: None,
            links: &ROLES,
            device_id: 0x5157_0001,
            every: 1,
        }
    }
}

type LinkClient<'a> = Client<SimLink<'a>>;

fn client(board: &RefCell<Board>, role: LinkRole) -> LinkClient<'_> {
    let patience = Duration::from_secs(20);
    let options = ConnectOptions { session: Some(7), patience, keep_data: true };
    Client::connect(SimLink::new(board, role), "the link", options).unwrap()
}

/// As `wimu record` does: asks at the pace that the answers tell.
fn listen(
    (pace, clock): &mut (Pace, ClockEstimator),
    role: LinkRole,
    now_us: u64,
    arrival: &Arrival,
) {
    if let Event::Status(status) = &arrival.event {
        pace.report_status(role, status);
    }
    if let Some(trip) = clock.heard(role, arrival) {
        pace.answered(Duration::from_micros(now_us), trip);
    }
}

impl Session {
    /// A hand moves the board, `wimu record` listens; the file.
    pub fn record(&self) -> Vec<u8> {
        let scene = Scene::new(World::default());
        scene.play(0.0, motion::named("hand", self.seed).unwrap());
        let truth = SensorTruth::random(self.seed, Gauge::LowerTriangular);
        let config = BoardConfig {
            wireless_faults: self.wireless.parse().unwrap(),
            fault_seed: self.seed,
            device_id: self.device_id,
            clock_error_ppb: (self.clock_ppm * 1e3) as i32,
            ..BoardConfig::default()
        };
        let board = RefCell::new(Board::start(config, Physics::new(truth, scene, self.seed)));
        let mut entries = Vec::new();
        let restart_us = self.restart_at.map(|s| (s * 1e6) as u64);
        let end_us = (self.seconds * 1e6) as u64;
        for until_us in restart_us.into_iter().chain([end_us]) {
            if board.borrow().now_us() > 0 {
                board.borrow_mut().restart();
            }
            let mut clients: Vec<_> = self.links.iter().map(|role| client(&board, *role)).collect();
            if self.every > 1 {
                let mut settings = clients[0].settings().unwrap();
                settings.wireless.every = self.every;
                clients[0].set_settings(settings).unwrap();
            }
            let mut listeners = vec![(Pace::default(), ClockEstimator::new()); clients.len()];
            while board.borrow().now_us() < until_us {
                clients[0].next_event(LOOK).unwrap().inspect(|arrival| {
                    listen(&mut listeners[0], self.links[0], board.borrow().now_us(), arrival);
                });
                for ((client, role), listener) in
                    clients.iter_mut().zip(self.links).zip(&mut listeners)
                {
                    while let Some(arrival) = client.next_event(Duration::ZERO).unwrap() {
                        listen(listener, *role, board.borrow().now_us(), &arrival);
                    }
                    let now = client.transport().now();
                    let mut passed = client.take_data();
                    if listener.0.is_due(now) {
                        client.ask_time().unwrap();
                        listener.0.asked(now);
                        passed.extend(client.take_data());
                    }
                    for entry in &passed {
                        if let Recorded::Sent { host_ns, bytes, .. } = entry {
                            listener.1.asked(*host_ns, bytes);
                        }
                    }
                    entries.extend(passed);
                }
            }
        }
        entries.sort_by_key(Recorded::host_ns);
        file(&entries)
    }

    /// Host time of a device time since the last start, ns.
    pub fn truth_ns(&self, device_us: f64) -> f64 {
        device_us * 1e3 / (1.0 + self.clock_ppm * 1e-6)
    }
}

pub fn file(entries: &[Recorded]) -> Vec<u8> {
    let anchor = ClockAnchor { monotonic_ns: 0, utc_ns: 1_795_222_920_000_000_000 };
    let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), "a.mcap", anchor).unwrap();
    for entry in entries {
        writer.record(entry).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

pub fn entries(file: &[u8]) -> Vec<Recorded> {
    let mut reader = RecordingReader::new(file, "a.mcap").unwrap();
    std::iter::from_fn(|| reader.next_entry().unwrap()).collect()
}

pub fn compared(file: &[u8]) -> Result<Comparison, Problem> {
    compare(|| RecordingReader::new(file, "a.mcap"), "a.mcap")
}

/// By both links, and by the wireless one alone.
pub fn clocks(file: &[u8]) -> [ClockModel; 2] {
    let reader = RecordingReader::new(file, "a.mcap").unwrap();
    let overview = capture::Capture::survey_of(reader, "a.mcap", |_, _, _| {}).unwrap();
    let wireless = overview.link(Some(LinkRole::Wireless)).unwrap();
    let (_, start) = overview.starts.last_key_value().unwrap();
    [start.clock().cloned().unwrap(), wireless.clock().unwrap().clone()]
}
