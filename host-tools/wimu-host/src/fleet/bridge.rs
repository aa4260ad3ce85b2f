//! One board of a gateway: its link, its recording, its batches and its state.

use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use wimu_link::LinkRole;
use wimu_link::message::Event as DeviceEvent;
use wimu_model::ParameterId;

use super::commands::{self, Asks};
use super::gateway::Shared;
use super::recording::Recording;
use super::state::{self, BoardState};
use super::topics::{Content, Name, topic};
use super::{Batch, lock};
use crate::client::{Client, ConnectOptions, nanoseconds};
use crate::clock::ClockEstimator;
use crate::decode::{Arrival, Event};
use crate::live::LiveClient;
use crate::mcap_file::Recorded;
use crate::transport::{self, now};
use crate::{LinkUrl, Problem, Result};

/// Longest wait for data before commands and the stop flag are checked; and while a client waits for answers.
const GLANCE: Duration = Duration::from_millis(250);
const GLANCE_ASKED: Duration = Duration::from_millis(10);
/// Time after a command in which whole frames are published at once.
const ASKED_FOR: Duration = Duration::from_secs(2);
/// Intervals of time requests: at first for [`CLOCK_SETTLES`], then.
const ASK_TIME: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(10)];
const CLOCK_SETTLES: Duration = Duration::from_secs(30);
/// Interval of estimates of the clock, which take some ms; the first ones of many boards are spread over it.
const CLOCK: Duration = Duration::from_secs(300);
/// Interval of requests for the identification, which has the parameters in use.
const ASK_WHO: Duration = Duration::from_secs(60);
/// Interval between reports of the state to the broker, and to the metrics.
const REPORT: Duration = Duration::from_secs(30);
const COUNT: Duration = Duration::from_secs(1);
/// Shortest and longest interval between attempts to open a lost link.
const RETRY: [Duration; 2] = [Duration::from_millis(250), Duration::from_secs(5)];
/// A batch is published at this size, bytes; without the end of a frame at the second one.
const ENOUGH: usize = 16 << 10;
const MOST: usize = 64 << 10;

/// What the gateway's threads know of a board.
pub type Shown = Mutex<BoardState>;

/// The board, in a thread of its own.
pub struct Bridge {
    pub name: Name,
    link: LinkUrl,
    shared: Arc<Shared>,
    shown: Arc<Shown>,
    down: Receiver<Vec<u8>>,
    batch: Outgoing,
    recording: Option<Recording>,
    clock: ClockEstimator,
    state: BoardState,
    /// What was reported last, and when.
    reported: Option<(BoardState, Duration)>,
    counted: Duration,
    asked: Option<Duration>,
    /// When the clock is estimated next.
    clock_at: Duration,
    /// When the board is asked for its identification next.
    who_at: Duration,
}

impl Bridge {
    pub fn new(
        name: Name,
        link: LinkUrl,
        shared: Arc<Shared>,
        shown: Arc<Shown>,
        down: Receiver<Vec<u8>>,
    ) -> Self {
        let folder = shared.config.recordings.as_ref();
        let state = lock(&shown).clone();
        Self {
            batch: Outgoing::new(topic(&shared.config.fleet, &name, Content::Up)),
            recording: folder.map(|folder| Recording::new(folder.join(name.as_str()))),
            state,
            clock: ClockEstimator::new(),
            reported: None,
            counted: Duration::ZERO,
            asked: None,
            clock_at: Duration::ZERO,
            who_at: Duration::ZERO,
            name,
            link,
            shared,
            shown,
            down,
        }
    }

    /// Runs until the gateway stops.
    pub fn run(mut self) {
        let mut client = None;
        let mut retry = RETRY[0];
        while !self.shared.stopped() {
            let outcome = self.open(&mut client).and_then(|()| {
                retry = RETRY[0];
                client.as_mut().map_or(Ok(()), |client| self.serve(client))
            });
            let mut role = LinkRole::Cable;
            if let Some(client) = &mut client {
                role = client.hello().role;
                self.keep(client);
                self.count(client);
            }
            self.batch.flush(&self.shared, true);
            if let Err(error) = outcome {
                self.lose(role, &error);
                let until = now() + retry;
                while !self.shared.stopped() && now() < until {
                    std::thread::sleep(GLANCE.min(retry));
                }
                // Commands for a board that is away are not delivered late.
                self.state.commands_refused += self.down.try_iter().count() as u64;
                retry = (retry * 2).min(RETRY[1]);
            }
        }
        if let Some(recording) = &mut self.recording {
            recording.close();
        }
        self.report(true);
    }

    /// Opens the link and greets the board.
    fn open(&mut self, client: &mut Option<LiveClient>) -> Result<()> {
        let transport = transport::open(&self.link)?;
        match client {
            Some(client) => {
                client.resume(transport)?;
                self.state.reconnections += 1;
                self.shared.note(format!("{}: connected again", self.name));
            }
            None => {
                let options = ConnectOptions { keep_data: true, ..ConnectOptions::default() };
                *client = Some(Client::connect(transport, &self.link.to_string(), options)?);
            }
        }
        if let Some(client) = client {
            let share = Duration::from_secs(client.hello().device_id % CLOCK.as_secs());
            self.clock_at = now() + CLOCK_SETTLES + share;
            self.state.identify(client.hello());
            self.record(&[Recorded::Connected {
                role: client.hello().role,
                host_ns: nanoseconds(now()),
            }]);
        }
        self.state.alive = true;
        self.state.lost = None;
        self.report(true);
        Ok(())
    }

    /// Serves the link until it is lost.
    fn serve(&mut self, client: &mut LiveClient) -> Result<()> {
        let began = now();
        let mut time_at = began;
        while !self.shared.stopped() {
            self.forward(client)?;
            let at = now();
            if at >= time_at {
                time_at = at + ASK_TIME[usize::from(at > began + CLOCK_SETTLES)];
                if let Some((host_ns, question)) = client.ask_time()? {
                    self.clock.asked(host_ns, &question);
                }
            }
            if at >= self.who_at {
                self.who_at = at + ASK_WHO;
                client.ask_who()?;
            }
            let is_asked = self.asked.is_some_and(|asked| at < asked + ASKED_FOR);
            // The time-out stays the same: a socket is told of each new one.
            let glance = if is_asked { GLANCE_ASKED } else { GLANCE };
            let until = at + glance;
            while let Some(arrival) = client.next_event(glance)? {
                self.take(client.hello().role, &arrival);
                if now() >= until {
                    break;
                }
            }
            self.keep(client);
            let due =
                self.batch.since.is_some_and(|since| now() >= since + self.shared.config.batch);
            if due || is_asked || self.batch.bytes >= ENOUGH {
                self.batch.flush(&self.shared, false);
            }
            if now() >= self.counted + COUNT {
                self.count(client);
            }
        }
        Ok(())
    }

    /// Sends the broker's commands to the board, unless they are not allowed.
    fn forward(&mut self, client: &mut LiveClient) -> Result<()> {
        while let Ok(message) = self.down.try_recv() {
            match commands::check(&message) {
                Ok(asks) => {
                    if asks == Asks::Answer {
                        self.asked = Some(now());
                    }
                    self.state.commands += 1;
                    client.send(&message)?;
                }
                Err(_) => self.state.commands_refused += 1,
            }
        }
        Ok(())
    }

    fn take(&mut self, role: LinkRole, arrival: &Arrival) {
        match &arrival.event {
            Event::Restart { .. } => self.clock = ClockEstimator::new(),
            Event::Hello(hello) => self.state.identify(hello),
            Event::Parameters(held) => {
                let id = Some(ParameterId(held.id).to_string());
                self.state.contradicted &= self.state.parameter_id == id;
                self.state.parameter_id = id;
                self.state.calibrated_utc_s =
                    held.active.and_then(|set| set.utc_s()).map(u64::from);
            }
            Event::Device { event: DeviceEvent::CalibrationContradicted { .. }, .. } => {
                self.state.contradicted = true
            }
            _ => {}
        }
        self.clock.heard(role, arrival);
    }

    /// Records and batches what passed over the link.
    fn keep(&mut self, client: &mut LiveClient) {
        let entries = client.take_data();
        for entry in &entries {
            if let Recorded::Received(received) = entry {
                self.state.last_seen_utc_s = Some(self.shared.utc_s(received.host_ns));
                self.batch.push(received.host_ns, &received.bytes);
            }
        }
        self.record(&entries);
    }

    fn record(&mut self, entries: &[Recorded]) {
        if let Some(recording) = &mut self.recording {
            for entry in entries {
                self.state.unrecorded_bytes += recording.write(entry, &self.shared);
            }
            if std::mem::take(&mut recording.began) {
                self.who_at = Duration::ZERO;
            }
        }
    }

    fn lose(&mut self, role: LinkRole, error: &Problem) {
        let reason = error.text.as_str();
        if self.state.alive {
            self.record(&[Recorded::Lost {
                role,
                host_ns: nanoseconds(now()),
                reason: reason.to_owned(),
            }]);
            self.shared.note(format!("{}: lost: {reason}", self.name));
        } else if self.state.lost.as_deref() != Some(reason) {
            self.shared.note(format!("{}: {reason}", self.name));
        }
        self.state.alive = false;
        self.state.lost = Some(reason.to_owned());
        self.report(true);
    }

    /// Takes the figures of the link.
    fn count(&mut self, client: &LiveClient) {
        self.counted = now();
        let statistics = client.statistics();
        self.state.samples = statistics.raw.received;
        self.state.missing = statistics.raw.missing;
        self.state.frames_damaged = statistics.frames_damaged;
        self.state.bytes = statistics.bytes;
        self.report(false);
    }

    /// Reports the state to the metrics and, when it has changed or is due, to the broker.
    fn report(&mut self, at_once: bool) {
        let at = now();
        let last = self.reported.as_ref();
        let due =
            last.is_none_or(|(last, since)| at >= *since + REPORT || last.differs(&self.state));
        if due || at_once {
            if at >= self.clock_at {
                self.clock_at = at + CLOCK;
                let clock = self.clock.model().map(|model| model.summary());
                self.state.clock_rate_ppm = clock.map(|clock| clock.rate_ppm);
                self.state.clock_sd_ms = clock.map(|clock| clock.offset_sd_ms);
            }
            self.state.reported_utc_s = self.shared.utc_s(nanoseconds(at));
            let topic = topic(&self.shared.config.fleet, &self.name, Content::State);
            let mqtt = self.shared.mqtt();
            mqtt.retain(topic, state::message(&self.state));
            self.reported = Some((self.state.clone(), at));
        }
        lock(&self.shown).clone_from(&self.state);
    }
}

/// Received bytes that wait for the next batch.
struct Outgoing {
    topic: String,
    pending: Vec<(u64, Vec<u8>)>,
    bytes: usize,
    number: u32,
    /// When the first of them arrived.
    since: Option<Duration>,
}

impl Outgoing {
    fn new(topic: String) -> Self {
        Self { topic, pending: Vec::new(), bytes: 0, number: 0, since: None }
    }

    fn push(&mut self, host_ns: u64, bytes: &[u8]) {
        self.since.get_or_insert_with(now);
        self.bytes += bytes.len();
        self.pending.push((host_ns, bytes.to_vec()));
    }

    /// Publishes whole frames; with `all` everything.
    fn flush(&mut self, shared: &Shared, all: bool) {
        let mut rest = Vec::new();
        if !all && self.bytes < MOST {
            let ends = |bytes: &[u8]| bytes.iter().rposition(|byte| *byte == 0);
            let last = self.pending.iter().enumerate().rev();
            let Some((index, end)) =
                last.clone().find_map(|(index, (_, bytes))| Some((index, ends(bytes)? + 1)))
            else {
                return;
            };
            rest = self.pending.split_off(index + 1);
            if let Some((host_ns, bytes)) = self.pending.last_mut() {
                let cut = bytes.split_off(end);
                if !cut.is_empty() {
                    rest.insert(0, (*host_ns, cut));
                }
            }
        }
        if self.pending.is_empty() {
            return;
        }
        let mut batch = Batch::new(shared.session, self.number);
        self.number = self.number.wrapping_add(1);
        for (host_ns, bytes) in self.pending.drain(..) {
            batch.push(shared.utc_ns(host_ns), &bytes);
        }
        let message = batch.encode(shared.utc_ns(nanoseconds(now())));
        shared.mqtt().publish(self.topic.clone(), message);
        self.since = (!rest.is_empty()).then(now);
        self.bytes = rest.iter().map(|(_, bytes)| bytes.len()).sum();
        self.pending = rest;
    }
}
