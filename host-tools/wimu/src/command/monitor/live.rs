//! The screen of `wimu monitor`: state, keys and links.

use std::path::{Path, PathBuf};
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant};

use clap::Parser;
use wimu_host::calibration;
use wimu_host::clock::Pace;
use wimu_host::decode::Event;
use wimu_host::live::{Heard, LiveLinks, Tap};
use wimu_host::mcap_file::{ClockAnchor, RecordingWriter};
use wimu_host::monitor::{LinkHealth, Reading, Readings, Traffic};
use wimu_host::{LinkUrl, Result, recorder, transport};
use wimu_model::ParameterId;

use super::{Line, notice};
use crate::arguments::{Arguments, Command, Monitor};
use crate::command::navigate::Beside;
use crate::command::{calibrate, connect, deadline, interrupted, is_over};
use crate::output::{Output, usage};
use crate::screen::monitor::{MonitorView, draw};
use crate::screen::{Key, Screen};

/// Longest wait for data before keys are read.
const GLANCE: Duration = Duration::from_millis(20);
/// Duration of a message. Chosen: two lines are read twice.
const MESSAGE: Duration = Duration::from_secs(10);
/// Interval between the points of a curve, s of the device's clock, and between the positions that are shown.
const POINT_S: f64 = 0.1;
/// Samples are missing after more than so many of the latest intervals between them.
const GAP: f64 = 1.5;

/// What a person does after the screen.
enum Next {
    Quit,
    Calibrate,
}

pub fn run(arguments: &Monitor, output: &Output) -> Result<()> {
    let stop = interrupted()?;
    let end = deadline(arguments.seconds);
    loop {
        let links = connected(arguments)?;
        let mut live = Live::new(&links);
        if arguments.navigate {
            live.navigator = Some(Beside::new(&arguments.aids, &arguments.input)?);
        }
        let live_links = LiveLinks::start(
            links.into_iter().map(|(url, client)| (url, client.map_transport(Tap::on))).collect(),
            Pace::sparse,
        );
        let screen = Screen::open()?;
        let mut shown = live.show(screen, &live_links, || is_over(end, &stop));
        live_links.finish(|index, heard| {
            if let (Ok(_), Err(error)) = (&shown, live.take(index, heard)) {
                shown = Err(error);
            }
        });
        let next = shown.and_then(|next| live.stop_recording().map(|()| next))?;
        live.ended.extend(live.view.links.iter().filter_map(|link| link.unverified.clone()));
        for line in &live.ended {
            output.print(line);
        }
        match next {
            Next::Quit => return Ok(()),
            Next::Calibrate => {
                let link = arguments.cable.as_ref().unwrap_or(&arguments.input);
                let words = ["wimu", "calibrate", link];
                if let Ok(Arguments { command: Command::Calibrate(calibrate), .. }) =
                    Arguments::try_parse_from(words)
                {
                    calibrate::run(&calibrate, output)?;
                }
            }
        }
        if is_over(end, &stop) {
            return Ok(());
        }
    }
}

/// The links, which must be of one board.
fn connected(arguments: &Monitor) -> Result<Vec<(LinkUrl, crate::command::Connection)>> {
    let mut links: Vec<(LinkUrl, crate::command::Connection)> = Vec::new();
    for link in std::iter::once(&arguments.input).chain(&arguments.cable) {
        let client = connect(link)?;
        links.push((client.name().parse()?, client));
    }
    let mut ids = links.iter().map(|(_, client)| (client.hello().device_id, client.hello().role));
    if let (Some(first), Some(second)) = (ids.next(), ids.next())
        && (first.0 != second.0 || first.1 == second.1)
    {
        return Err(usage(
            "--cable is not the other link of this board",
            "give the wireless link and the cable of one board",
        ));
    }
    Ok(links)
}

struct Live {
    readings: Readings,
    traffic: Vec<Traffic>,
    view: MonitorView,
    latest: Option<Reading>,
    /// The filter of `wimu navigate`.
    navigator: Option<Beside>,
    position: Instant,
    /// Device time at which the present point of the curves begins, and the latest interval between samples, s.
    point_s: f64,
    interval_s: f64,
    /// The message that is shown, and since when.
    shown: (String, Instant),
    writer: Option<(PathBuf, RecordingWriter<std::fs::File>)>,
    /// What is printed after the screen.
    ended: Vec<String>,
}

impl Live {
    fn new(links: &[(LinkUrl, crate::command::Connection)]) -> Self {
        let name = |(_, client): &(_, crate::command::Connection)| LinkHealth {
            name: client.hello().role.to_string(),
            ..LinkHealth::default()
        };
        let device = links.first().map(|(_, client)| {
            let hello = client.hello();
            format!("{}, {}, {:016x}", hello.board.name, hello.sensor.name, hello.device_id)
        });
        Self {
            readings: Readings::new(),
            traffic: links.iter().map(|_| Traffic::default()).collect(),
            view: MonitorView {
                device: device.unwrap_or_default(),
                links: links.iter().map(name).collect(),
                ..MonitorView::default()
            },
            latest: None,
            navigator: None,
            position: Instant::now(),
            point_s: 0.0,
            interval_s: f64::INFINITY,
            shown: (String::new(), Instant::now()),
            writer: None,
            ended: Vec::new(),
        }
    }

    /// Shows the screen until the person leaves it, or it is `over`.
    fn show(
        &mut self,
        mut screen: Screen,
        links: &LiveLinks,
        over: impl Fn() -> bool,
    ) -> Result<Next> {
        while !over() {
            match links.next(GLANCE) {
                Ok((index, heard)) => self.take(index, &heard)?,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            while let Some(key) = screen.key() {
                if let Some(next) = self.press(key, links) {
                    return Ok(next);
                }
            }
            if !self.view.paused {
                self.refresh();
            }
            self.clear_message();
            screen.draw(|frame| draw(&self.view, frame))?;
        }
        Ok(Next::Quit)
    }

    /// Clears a message that was shown for [`MESSAGE`].
    fn clear_message(&mut self) {
        let (message, since) = &mut self.shown;
        if *message != self.view.message {
            (*message, *since) = (self.view.message.clone(), Instant::now());
        } else if since.elapsed() >= MESSAGE {
            self.view.message.clear();
        }
    }

    fn take(&mut self, index: usize, heard: &Heard) -> Result<()> {
        if let Some((_, writer)) = &mut self.writer {
            heard.entries.iter().try_for_each(|entry| writer.record(entry))?;
        }
        self.traffic[index].take(heard);
        if index == 0 {
            let navigator = self.navigator.as_mut();
            let taken = navigator.map(|n| heard.arrivals.iter().try_for_each(|a| n.take(a)));
            if let Some(Err(error)) = taken {
                self.navigator = None;
                self.view.message = format!("not navigated: {}", error.text);
            }
            heard.arrivals.iter().for_each(|arrival| self.event(&arrival.event));
        }
        Ok(())
    }

    fn event(&mut self, event: &Event) {
        notice(event, &mut self.view.message);
        match event {
            Event::Restart { .. } => self.view.origin_m = [0.0; 3],
            Event::Parameters(parameters) => {
                if let Some((_, writer)) = &mut self.writer {
                    // A recording without it has the board's integers.
                    let _ = writer.keep_calibration(ParameterId(parameters.id));
                }
                let set = parameters.calibration(None).ok().flatten();
                self.view.force_sd_mps2 = set.as_ref().and_then(calibration::force_sd_mps2);
            }
            _ => {}
        }
        let Self { readings, latest, view, point_s, interval_s, .. } = self;
        readings.push(event, |reading| {
            let now_s = reading.time.to_seconds();
            let before_s = latest.replace(reading).map_or(now_s, |before| before.time.to_seconds());
            let step_s = now_s - before_s;
            let missing = if step_s > GAP * *interval_s { step_s / POINT_S } else { 0.0 };
            *interval_s = step_s;
            if !view.paused {
                if missing > 0.0 || !(0.0..POINT_S).contains(&(now_s - *point_s)) {
                    *point_s = now_s;
                    view.curves().for_each(|curve| curve.step(missing as usize));
                }
                let f = reading.specific_force.0;
                let norm = f.iter().map(|axis| axis * axis).sum::<f64>().sqrt();
                let all = [norm, f[0], f[1], f[2]]
                    .into_iter()
                    .chain(reading.angular_rate.into_iter().flatten());
                view.curves().zip(all).for_each(|(curve, value)| curve.add(value));
            }
        });
    }

    /// Brings the view up to date.
    fn refresh(&mut self) {
        let view = &mut self.view;
        if self.position.elapsed().as_secs_f64() >= POINT_S {
            self.position = Instant::now();
            view.navigated = self.navigator.as_ref().and_then(Beside::now);
        }
        for (link, traffic) in view.links.iter_mut().zip(&self.traffic) {
            traffic.show(link);
        }
        if let (true, Some(warning)) =
            (view.message.is_empty(), view.links.iter().find_map(|link| link.unverified.clone()))
        {
            view.message = warning;
        }
        view.line = self.latest.as_ref().map(Line::from);
    }

    /// Handles a key; returns what is next if the person leaves the screen.
    fn press(&mut self, key: Key, links: &LiveLinks) -> Option<Next> {
        match key {
            Key::Quit | Key::Char('q') => return Some(Next::Quit),
            Key::Char('c') => return Some(Next::Calibrate),
            Key::Char('p') => self.view.paused = !self.view.paused,
            Key::Char('u') => self.view.other_units = !self.view.other_units,
            Key::Char('z') => {
                let sent = self.latest.and_then(|reading| reading.navigation);
                let sent = sent.map(|sent| sent.position_nm.map(|nm| nm as f64 * 1e-9));
                let found = self.view.navigated.map(|(point, _)| point.position_m);
                self.view.origin_m = found.or(sent).unwrap_or_default();
                self.view.message = "the position counts from here".to_owned();
            }
            Key::Char('r') => {
                let done = match self.writer.is_some() {
                    true => self.stop_recording(),
                    false => self.record(links),
                };
                if let Err(error) = done {
                    self.view.message = format!("not recorded: {}", error.text);
                }
            }
            _ => {}
        }
        None
    }

    /// Records everything from now on, in a new file in the current folder.
    fn record(&mut self, links: &LiveLinks) -> Result<()> {
        let path = recorder::free_name(Path::new(""));
        let writer = RecordingWriter::create(&path, ClockAnchor::now(transport::now()))?;
        self.view.recording = Some(path.display().to_string());
        self.view.message = format!("recording all links to {}", path.display());
        self.writer = Some((path, writer));
        links.introduce();
        Ok(())
    }

    fn stop_recording(&mut self) -> Result<()> {
        if let Some((path, writer)) = self.writer.take() {
            self.view.recording = None;
            writer.finish()?;
            self.view.message = format!("recorded: {}", path.display());
            self.ended.push(self.view.message.clone());
        }
        Ok(())
    }
}
