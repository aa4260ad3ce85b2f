//! One board, or a recording of it: a thread that takes its data, shows them to pages and does what pages ask.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use serde::Serialize;
use serde_json::json;
use wimu_host::allan::NoiseMeter;
use wimu_host::clock::Pace;
use wimu_host::decode::Event;
use wimu_host::guided::Guided;
use wimu_host::live::{LinkUpdate, LiveClient, LiveLinks};
use wimu_host::mcap_file::{ClockAnchor, RecordingWriter};
use wimu_host::monitor::{LinkHealth, Reading, Readings, Traffic};
use wimu_host::{LinkUrl, Result, calibration, transport};
use wimu_link::Hello;
use wimu_model::{ParameterId, ParameterSet};

use super::actions::{Job, Next};
use super::folder::Folder;
use super::hub::Hub;
use super::path::Path3;
use super::replay::{Player, ReplayView};
use super::samples::Samples;
use crate::command::monitor::{Line, notice};
use crate::command::navigate::Beside;

/// Interval between frames, 30 Hz.
pub const TICK: Duration = Duration::from_millis(33);
/// Frames between two states, two points of the path, and two curves of the noise.
const STATE: u64 = 3;
const PATH: u64 = 15;
const NOISE: u64 = 30;
/// Frames between two requests for the parameters of a board that has not reported them.
const ASK: u64 = 100;

/// Where the data come from.
pub enum Feed {
    Live(LiveLinks),
    Replay(Box<Player>),
}

impl Feed {
    fn next(
        &mut self,
        timeout: Duration,
    ) -> std::result::Result<(usize, LinkUpdate), RecvTimeoutError> {
        match self {
            Self::Live(links) => links.next(timeout),
            Self::Replay(player) => player.next(timeout),
        }
    }

    fn replay(&self) -> Option<&ReplayView> {
        match self {
            Self::Live(_) => None,
            Self::Replay(player) => Some(&player.view),
        }
    }
}

/// What a board's thread knows.
#[derive(Default)]
pub struct Board {
    pub index: usize,
    pub hub: Arc<Hub>,
    pub folder: Arc<Folder>,
    pub name: String,
    pub hello: Option<Hello>,
    pub message: String,
    /// The parameters that the device holds, once it has reported them; `None` within: uncalibrated.
    pub held: Option<Option<(ParameterId, ParameterSet)>>,
    pub guided: Option<Guided>,
    pub noise: Option<NoiseMeter>,
    pub navigator: Option<Beside>,
    pub path: Path3,
    writer: Option<(PathBuf, RecordingWriter<std::fs::File>)>,
    /// The link that is shown.
    shown: usize,
    readings: Readings,
    latest: Option<Reading>,
    latest_ns: u64,
    samples: Samples,
    traffic: Vec<Traffic>,
    links: Vec<LinkHealth>,
    joined: usize,
    ticks: u64,
}

impl Board {
    pub fn new(index: usize, name: &str, hub: Arc<Hub>, folder: Arc<Folder>) -> Self {
        Self { index, hub, folder, name: name.to_owned(), ..Self::default() }
    }

    /// Shows the links of a board until a page closes it.
    pub fn live(mut self, link: LinkUrl, client: LiveClient, jobs: &Receiver<Job>) {
        self.hello = Some(*client.hello());
        let (mut urls, mut clients) = (vec![link], vec![client]);
        loop {
            let role = |client: &LiveClient| client.hello().role.to_string();
            self.name_links(clients.iter().map(role).collect());
            let links = urls.iter().cloned().zip(clients).collect();
            let links = LiveLinks::start(links, Pace::sparse);
            // The parameters are sent again.
            links.introduce();
            let mut feed = Feed::Live(links);
            let next = self.watch(&mut feed, jobs);
            let Feed::Live(links) = feed else { break };
            clients = links.finish(|index, heard| self.take(index, heard));
            match next {
                Next::Close => break,
                Next::Join(url, client) => {
                    urls.push(url);
                    clients.push(*client);
                }
                Next::Push(set, asker) => asker.answer(self.push(&mut clients, set.as_deref())),
            }
        }
        self.end();
    }

    /// Shows a recording as if it arrived now.
    pub fn replay(mut self, player: Player, jobs: &Receiver<Job>) {
        let mut feed = Feed::Replay(Box::new(player));
        // A recording takes no pushes and has no further links.
        while !matches!(self.watch(&mut feed, jobs), Next::Close) {}
        self.end();
    }

    fn end(mut self) {
        let _ = self.stop_recording();
        self.hub.withdraw(&format!("board/{}/", self.index));
    }

    fn name_links(&mut self, names: Vec<String>) {
        self.traffic.resize_with(names.len(), Traffic::default);
        let link = |name| LinkHealth { name, ..LinkHealth::default() };
        self.links = names.into_iter().map(link).collect();
    }

    pub fn publish(&self, topic: &str, value: &impl Serialize) {
        self.hub.publish(&format!("board/{}/{topic}", self.index), value);
    }

    /// Takes data and does jobs until one needs the clients.
    fn watch(&mut self, feed: &mut Feed, jobs: &Receiver<Job>) -> Next {
        let mut due = Instant::now();
        loop {
            let wait = due.saturating_duration_since(Instant::now());
            match feed.next(wait) {
                Ok((index, heard)) => {
                    if let (Feed::Replay(player), true) = (&*feed, index >= self.traffic.len()) {
                        self.name_links(player.roles().map(|role| role.to_string()).collect());
                    }
                    self.take(index, &heard);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => std::thread::sleep(wait),
            }
            while let Ok(job) = jobs.try_recv() {
                if let Some(next) = self.act(job, feed) {
                    return next;
                }
            }
            if Instant::now() >= due {
                due = Instant::now() + TICK;
                self.tick(feed);
            }
        }
    }

    fn take(&mut self, index: usize, heard: &LinkUpdate) {
        if let Some((_, writer)) = &mut self.writer {
            let written = heard.entries.iter().try_for_each(|entry| writer.record(entry));
            if let Err(error) = written {
                self.message = format!("not recorded: {error}");
                self.writer = None;
            }
        }
        self.traffic[index].take(heard);
        self.traffic[index].show(&mut self.links[index]);
        if let Some(warning) =
            self.links[index].unverified.as_ref().filter(|_| self.message.is_empty())
        {
            self.message = warning.clone();
        }
        // Another link is shown while the first is lost.
        let is_up = |link: &LinkHealth| link.lost.is_none();
        let shown = self.links.iter().position(is_up).unwrap_or(self.shown);
        if std::mem::replace(&mut self.shown, shown) != shown {
            self.readings = Readings::new();
        }
        if let Some(guided) = self.guided.as_mut().filter(|_| index == 0) {
            guided.take(heard);
        }
        if index != self.shown {
            return;
        }
        for arrival in &heard.arrivals {
            if let Some(Err(error)) = self.navigator.as_mut().map(|n| n.take(arrival)) {
                self.navigator = None;
                self.message = format!("not navigated: {error}");
            }
            if let Some(Err(error)) = self.noise.as_mut().map(|meter| meter.take(&arrival.event)) {
                self.noise = None;
                self.message = format!("noise is not measured: {error}");
            }
            self.event(&arrival.event, arrival.host_ns);
        }
    }

    /// The data continue none before.
    pub fn begin_again(&mut self) {
        self.readings = Readings::new();
        self.samples.restart();
        self.path = Path3::default();
    }

    fn event(&mut self, event: &Event, host_ns: u64) {
        notice(event, &mut self.message);
        match event {
            Event::Restart { .. } => self.begin_again(),
            Event::Hello(hello) => self.hello = Some(*hello),
            Event::Parameters(parameters) => {
                let id = ParameterId(parameters.id);
                if let Some((_, writer)) = &mut self.writer {
                    // A recording without it has the board's integers.
                    let _ = writer.keep_calibration(id);
                }
                let set = parameters.calibration(None).ok().flatten();
                self.held = Some(set.map(|set| (id, set)));
                self.show_parameters();
            }
            _ => {}
        }
        let (latest, samples) = (&mut self.latest, &mut self.samples);
        self.readings.push(event, |reading| {
            samples.push(&reading);
            *latest = Some(reading);
            self.latest_ns = host_ns;
        });
    }

    fn show_parameters(&self) {
        let Some(held) = &self.held else { return };
        let set = held.as_ref().map(|(_, set)| set);
        let rows = set.into_iter().flat_map(calibration::parameter_figures);
        let rows = rows.map(|(name, values)| [name.to_owned(), calibration::values_text(&values)]);
        let id = held.map_or(ParameterId::UNCALIBRATED, |(id, _)| id);
        let value = json!({
            "calibrated": held.is_some(),
            "id": id.to_string(),
            "rows": Vec::from_iter(rows),
            "remarks": set.map(calibration::describe).unwrap_or_default(),
        });
        self.publish("parameters", &value);
    }

    /// Writes a set to the board, or that of the guided calibration.
    fn push(&mut self, clients: &mut [LiveClient], set: Option<&ParameterSet>) -> Result<String> {
        // The cable needs no key.
        let is_cable = |client: &LiveClient| client.hello().role == wimu_link::LinkRole::Cable;
        let on_cable =
            (0..clients.len()).find(|k| is_cable(&clients[*k]) && self.links[*k].lost.is_none());
        let client = &mut clients[on_cable.unwrap_or(0)];
        match (set, &mut self.guided) {
            (Some(set), _) => wimu_host::guided::push(client, set).map(|id| format!("pushed {id}")),
            (None, Some(guided)) => {
                guided.push(client);
                Ok(guided.view.message.clone())
            }
            (None, None) => Ok("there is no calibration to push".to_owned()),
        }
    }

    fn tick(&mut self, feed: &Feed) {
        self.ticks += 1;
        let joined = self.hub.joined();
        let is_new = std::mem::replace(&mut self.joined, joined) != joined;
        if let Some(points) = self.samples.take(is_new) {
            let attitude = self.latest.and_then(|latest| latest.attitude);
            // `q` is W, X, Y, Z, body axes to east-north-up; `at_ms` since 1970.
            self.hub.stream(&json!({
                "board": self.index,
                "t": points.t,
                "v": points.v,
                "whole": points.whole,
                "restarted": points.restarted,
                "q": attitude.map(|attitude| attitude.to_quaternion()),
                "up": self.latest.map(|latest| latest.specific_force.0),
                "at_ms": arrived_ms(self.latest_ns),
            }));
        }
        if let (Feed::Live(links), None, true) = (feed, &self.held, self.ticks.is_multiple_of(ASK))
        {
            links.introduce();
        }
        if let Some(guided) = &mut self.guided {
            if guided.is_due() {
                // The view shows why there is no result.
                let _ = guided.calibrate();
            }
            guided.refresh();
        }
        if let Some(guided) = self.guided.as_ref().filter(|_| self.ticks.is_multiple_of(2)) {
            self.publish("guided", &guided.view);
        }
        if self.ticks.is_multiple_of(STATE) {
            self.show_state(feed.replay());
        }
        if self.ticks.is_multiple_of(PATH)
            && let Some(chart) = self.path.chart()
        {
            self.publish("path", &chart);
        }
        if let Some(meter) = self.noise.as_ref().filter(|_| self.ticks.is_multiple_of(NOISE)) {
            let chart = meter.report().ok().and_then(|report| Some(report.chart()?.json()));
            self.publish("noise", &json!({"text": meter.progress(), "chart": chart}));
        }
    }

    fn show_state(&mut self, replay: Option<&ReplayView>) {
        let navigated = self.navigator.as_ref().and_then(Beside::now);
        let sent = self.latest.and_then(|latest| latest.navigation);
        match (&navigated, sent) {
            (Some((point, _)), _) => self.path.filtered(point),
            (None, Some(sent)) if self.navigator.is_none() => self.path.sent(&sent),
            _ => {}
        }
        let is_recording = self.writer.as_ref().map(|(path, _)| path.display().to_string());
        let held = self.held.as_ref().and_then(Option::as_ref).map(|(_, set)| set);
        let hello = self.hello.as_ref();
        let device = hello.map(|hello| format!("{} with {}", hello.board.name, hello.sensor.name));
        for (link, traffic) in self.links.iter_mut().zip(&self.traffic) {
            traffic.show(link);
        }
        let navigated = navigated.map(|(point, aids)| {
            let speed = point.velocity_mps.iter().map(|v| v * v).sum::<f64>();
            json!({
                "position_m": point.position_m,
                "sigma_m": point.sigma_m(),
                "speed_m_s": speed.sqrt(),
                "resting": point.resting,
                "valid": point.valid,
                "aids": aids,
            })
        });
        let state = json!({
            "device": device.as_deref().unwrap_or(&self.name),
            "id": hello.map_or(String::new(), |hello| format!("{:016x}", hello.device_id)),
            "source": self.name,
            "links": self.links,
            "line": self.latest.as_ref().map(Line::from),
            "force_sd_m_s2": held.and_then(calibration::force_sd_mps2),
            "message": self.message,
            "recording": is_recording,
            "measuring": self.noise.is_some(),
            "navigating": self.navigator.is_some(),
            "navigated": navigated,
            "replay": replay,
        });
        self.publish("state", &state);
    }

    /// Records everything from now on in a new file of the folder, or ends that.
    pub fn record(&mut self, feed: &Feed) -> Result<()> {
        if self.writer.is_some() {
            return self.stop_recording();
        }
        let Feed::Live(links) = feed else {
            return Err(crate::output::usage("this is a recording already", "record a board"));
        };
        let path = wimu_host::recorder::free_name(self.folder.path());
        let writer = RecordingWriter::create(&path, ClockAnchor::now(transport::now()))?;
        self.message = format!("recording all links to {}", path.display());
        self.writer = Some((path, writer));
        links.introduce();
        Ok(())
    }

    fn stop_recording(&mut self) -> Result<()> {
        if let Some((path, writer)) = self.writer.take() {
            writer.finish()?;
            self.message = format!("recorded: {}", path.display());
            self.hub.publish("files", &self.folder.list());
        }
        Ok(())
    }
}

/// A time of the host's monotonic clock, ms since 1970.
fn arrived_ms(host_ns: u64) -> f64 {
    let ago = transport::now().saturating_sub(Duration::from_nanos(host_ns));
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    now.saturating_sub(ago).as_secs_f64() * 1e3
}
