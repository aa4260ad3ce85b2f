//! `wimu monitor`.

mod line;

use std::time::{Duration, Instant};

use serde_json::json;
use wimu_host::authentication::Authentication;
use wimu_host::decode::{Decoder, Event, LinkStatistics};
use wimu_host::keys::KeyFolder;
use wimu_host::mcap_file::RecordingReader;
use wimu_host::monitor::Readings;
use wimu_host::{Code, Input, Result};
use wimu_link::Hello;
use wimu_link::message::Status;

pub use self::line::Line;
use crate::arguments::Monitor;
use crate::command::info::{SAFE_MODE, Sampling};
use crate::command::record::left_out_text;
use crate::command::{connect, deadline, interrupted, is_over};
use crate::output::Output;
use crate::text_view::TextView;

pub fn run(arguments: &Monitor, output: &Output) -> Result<()> {
    match Input::parse(&arguments.input)? {
        Input::Link(_) => live(arguments, output),
        Input::Recording(path) => recorded(&path, arguments.rate, output),
        Input::File(_) => {
            let message = "monitor does not read files of other programs";
            let remedy = "give a LINK or a recording of wimu; `wimu simulate --replay` streams counts of a table";
            Err(Code::UnknownFormat.error(message, remedy).at(&arguments.input))
        }
    }
}

/// Shows a board until Ctrl-C: rows at a terminal, lines elsewhere and with `--rate`.
fn live(arguments: &Monitor, output: &Output) -> Result<()> {
    let mut client = connect(&arguments.input)?;
    let hello = *client.hello();
    let mut authentication = Authentication::new(client.verify());
    let device = format!(
        "{} with {}, device {:016x}, {} link, parameters {}, last start: {}",
        hello.board.name,
        hello.sensor.name,
        hello.device_id,
        hello.role,
        hello.parameter_id,
        cause(&hello)
    );
    output.print(&device);
    let mut view = if arguments.rate.is_none() { TextView::open(output) } else { None };
    let mut readings = Readings::new();
    let mut lines = Lines::new(arguments.rate, output);
    let (mut latest, mut message) = (None, String::new());
    let (stop, end, began) = (interrupted()?, deadline(arguments.seconds), Instant::now());
    while !is_over(end, &stop) {
        let arrival = client.next_event(Duration::from_millis(100))?;
        let finding = arrival.as_ref().and_then(|arrival| authentication.see(arrival));
        let Some(view) = &mut view else {
            output.findings(finding.map(std::slice::from_ref).unwrap_or_default());
            if arrival.is_some_and(|arrival| !lines.show(&arrival.event, &mut readings)) {
                break;
            }
            continue;
        };
        if let Some(finding) = finding {
            message = finding.to_string();
        }
        if let Some(arrival) = arrival {
            notice(&arrival.event, &mut message);
            readings.push(&arrival.event, |reading| latest = Some(reading));
        }
        let drawn = || {
            let traffic = traffic(&client.statistics(), began.elapsed());
            let rows = latest.as_ref().map(|reading| Line::from(reading).rows());
            let rows = rows.unwrap_or(vec!["waiting for samples".to_owned()]);
            let ends = [traffic, String::new(), message.clone(), "Ctrl-C quits".to_owned()];
            [vec![device.clone(), String::new()], rows, ends.to_vec()].concat()
        };
        if !view.draw(drawn) {
            break;
        }
    }
    drop(view);
    let statistics = client.statistics();
    output.print(format!(
        "{} frames, {} damaged{}; {} samples missing",
        statistics.frames,
        statistics.frames_damaged,
        left_out_text(0, statistics.frames_rejected),
        statistics.raw.missing.max(statistics.corrected.missing)
    ));
    if let Some(status) = &lines.status {
        output.print(Sampling::from(status).text());
    }
    lines.end(&authentication);
    Ok(())
}

/// Rate and loss of a link since it was opened.
fn traffic(statistics: &LinkStatistics, open: Duration) -> String {
    let stream = match statistics.raw.received {
        0 => statistics.corrected,
        _ => statistics.raw,
    };
    let lost = stream.missing as f64 / (stream.received + stream.missing).max(1) as f64;
    format!(
        "link         {:.1} samples/s, {:.2} % lost, {} damaged frames, {:.1} kB/s",
        stream.received as f64 / open.as_secs_f64(),
        100.0 * lost,
        statistics.frames_damaged,
        statistics.bytes as f64 / 1e3 / open.as_secs_f64()
    )
}

fn recorded(path: &std::path::Path, rate: Option<f64>, output: &Output) -> Result<()> {
    let mut reader = RecordingReader::open(path)?;
    let mut decoder = Decoder::new();
    // Without usable keys tags are not verified, and that is reported where there are tags.
    decoder.use_keys(KeyFolder::of_user().and_then(|folder| folder.all()).unwrap_or_default());
    let mut authentication = Authentication::default();
    let mut readings = Readings::new();
    let mut lines = Lines::new(rate, output);
    let mut role = None;
    let mut going = true;
    while let Some(received) = reader.next_received()? {
        // Shows the first link of the recording only.
        if *role.get_or_insert(received.role) != received.role {
            continue;
        }
        decoder.push(received.host_ns, &received.bytes, |arrival| {
            if let Event::Hello(hello) = &arrival.event {
                authentication.key_known |= !KeyFolder::own(hello.device_id).is_empty();
            }
            if let Some(finding) = authentication.see(&arrival) {
                output.findings(std::slice::from_ref(finding));
            }
            going = going && lines.show(&arrival.event, &mut readings);
        });
        if !going {
            break;
        }
    }
    lines.end(&authentication);
    Ok(())
}

/// Sets the message of a view to the device event or restart that an event reports.
pub fn notice(event: &Event, message: &mut String) {
    const RESTARTED: &str = "the device has restarted";
    match event {
        Event::Device { time, event } => *message = format!("{:.2} s  {event}", time.to_seconds()),
        Event::Restart { .. } => RESTARTED.clone_into(message),
        Event::Hello(hello) if message == RESTARTED => {
            *message = format!("{RESTARTED}: {}", cause(hello));
        }
        _ => {}
    }
}

/// Cause of the last start.
fn cause(hello: &Hello) -> String {
    let mut cause = hello.reset_reason.to_string();
    if let Some(fault) = hello.fault {
        cause += &format!(", {fault}");
    }
    if hello.safe_mode {
        cause += SAFE_MODE;
    }
    cause
}

/// Prints readings and device events.
struct Lines<'a> {
    output: &'a Output,
    /// Device time between two lines, s.
    every_s: f64,
    /// Device time of the latest line, s.
    shown_s: Option<f64>,
    /// Latest status of the device.
    status: Option<Status>,
    /// The device has restarted; the cause is not known yet.
    restarted: bool,
}

impl<'a> Lines<'a> {
    fn new(rate: Option<f64>, output: &'a Output) -> Self {
        let usual_hz = if output.is_json() { f64::INFINITY } else { 1.0 };
        Self {
            output,
            status: None,
            restarted: false,
            every_s: rate.unwrap_or(usual_hz).recip(),
            shown_s: None,
        }
    }

    /// Prints what the device's tags have shown.
    fn end(&self, authentication: &Authentication) {
        if let Some(text) = authentication.text() {
            self.output.print(text);
        }
        self.output.findings(&Vec::from_iter(authentication.finding()));
        if authentication.is_known() {
            self.output.object(&json!({ "authentication": authentication }));
        }
    }

    /// Returns false when the output is closed.
    fn show(&mut self, event: &Event, readings: &mut Readings) -> bool {
        match event {
            Event::Device { time, event } => {
                self.output.print(format!("{:8.2} s  {event}", time.to_seconds()));
            }
            Event::Status(status) => self.status = Some(*status),
            Event::Restart { .. } => {
                self.restarted = true;
                self.shown_s = None;
            }
            Event::Hello(hello) if core::mem::take(&mut self.restarted) => {
                self.output.print(format!("the device has restarted: {}", cause(hello)));
            }
            _ => {}
        }
        let mut going = true;
        readings.push(event, |reading| {
            let line = Line::from(&reading);
            // 1 µs of tolerance for rounded sample times.
            let due = |shown_s| line.time_s - shown_s >= self.every_s - 1e-6;
            if !self.shown_s.is_none_or(due) {
                return;
            }
            self.shown_s = Some(line.time_s);
            going &= if self.output.is_json() {
                self.output.object(&line)
            } else {
                self.output.line(line.text())
            };
        });
        going
    }
}
