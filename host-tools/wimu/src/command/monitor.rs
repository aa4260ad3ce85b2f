//! `wimu monitor`.

use std::time::{Duration, Instant};

use serde::Serialize;
use wimu_host::decode::{Decoder, Event};
use wimu_host::mcap_file::RecordingReader;
use wimu_host::monitor::{Reading, Readings};
use wimu_host::{ErrorCode, HostError, Input, Result};
use wimu_link::Hello;
use wimu_link::message::Status;

use crate::arguments::Monitor;
use crate::command::info::Sampling;
use crate::command::{connect, deadline, interrupted, is_over};
use crate::output::Output;

/// A person reads no more lines a second than this.
const REFRESH: Duration = Duration::from_millis(50);

/// One reading as JSON.
#[derive(Serialize)]
struct Line {
    schema: &'static str,
    sequence: u32,
    time_s: f64,
    raw_lsb: Option<[i16; 3]>,
    specific_force_m_s2: [f64; 3],
    corrected: bool,
    /// Of the parameters in use; "00000000" on an uncalibrated device.
    parameter_id: Option<String>,
    magnetic_field_ut: Option<[f64; 3]>,
    /// In body axes and without hard and soft iron; else as the magnetometer put it out.
    magnetic_field_calibrated: Option<bool>,
    /// Of body x, clockwise from magnetic north, 0 to 360; uncalibrated without a standard
    /// deviation: body x pointed east (90) at the first rest.
    heading_deg: Option<f64>,
    heading_sd_deg: Option<f64>,
    temperature_c: Option<f64>,
    phase: Option<String>,
    velocity_m_s: Option<[f64; 3]>,
    position_m: Option<[f64; 3]>,
    since_rest_s: Option<f64>,
    valid: Option<bool>,
}

impl From<&Reading> for Line {
    fn from(reading: &Reading) -> Self {
        let environment = reading.environment;
        let navigation = reading.navigation;
        let scaled = |nm: [i64; 3]| nm.map(|nm| nm as f64 * 1e-9);
        Self {
            schema: "wimu.reading/1",
            sequence: reading.sequence,
            time_s: reading.time.to_seconds(),
            raw_lsb: reading.raw.map(|counts| counts.0),
            specific_force_m_s2: reading.specific_force.0,
            corrected: reading.corrected,
            parameter_id: reading.parameters.map(|id| id.to_string()),
            magnetic_field_ut: reading.field.map(|field| field.nt.map(|nt| nt * 1e-3)),
            magnetic_field_calibrated: reading.field.map(|field| field.calibrated),
            heading_deg: reading
                .heading
                .map(|heading| heading.rad.to_degrees().rem_euclid(360.0)),
            heading_sd_deg: reading
                .heading
                .and_then(|heading| heading.sd_rad)
                .map(f64::to_degrees),
            temperature_c: environment
                .and_then(|e| e.temperature_centi_c)
                .map(|centi| f64::from(centi) / 100.0),
            phase: navigation.map(|n| format!("{:?}", n.phase).to_lowercase()),
            velocity_m_s: navigation.map(|n| scaled(n.velocity_nmps)),
            position_m: navigation.map(|n| scaled(n.position_nm)),
            since_rest_s: navigation.map(|n| f64::from(n.since_rest_ms) / 1000.0),
            valid: navigation.map(|n| n.flags == 0),
        }
    }
}

impl Line {
    fn text(&self) -> String {
        let [x, y, z] = self.specific_force_m_s2;
        let norm = (x * x + y * y + z * z).sqrt();
        let mut text = format!(
            "{:8.2} s  f {x:+8.3} {y:+8.3} {z:+8.3} m/s²  |f| {norm:7.3}",
            self.time_s
        );
        if let Some([x, y, z]) = self.magnetic_field_ut {
            text += &format!("  B {x:+6.1} {y:+6.1} {z:+6.1} µT");
            if self.magnetic_field_calibrated == Some(false) {
                text += " uncalibrated";
            }
        }
        match (self.heading_deg, self.heading_sd_deg) {
            (Some(heading), Some(sd)) => text += &format!("  heading {heading:3.0} ± {sd:.0}°"),
            (Some(heading), None) => text += &format!("  heading {heading:3.0}° uncalibrated"),
            _ => {}
        }
        if let Some(celsius) = self.temperature_c {
            text += &format!("  {celsius:.1} °C");
        }
        match (&self.phase, self.position_m) {
            (Some(phase), Some([e, n, u])) if phase != "searching" => {
                text += &format!("  {phase}  p {e:+.3} {n:+.3} {u:+.3} m");
            }
            (Some(phase), _) => text += &format!("  {phase}"),
            _ => {}
        }
        if self.valid == Some(false) {
            text += " (invalid)";
        }
        text
    }
}

pub fn run(arguments: &Monitor, output: Output) -> Result<()> {
    match Input::parse(&arguments.input)? {
        Input::Link(_) => live(arguments, output),
        Input::Recording(path) => recorded(&path, output),
        Input::Csv(_) => Err(HostError::new(
            ErrorCode::UnknownFormat,
            "a CSV file has nothing to watch",
            "give a LINK or a recording; `wimu simulate --replay` makes a board of a CSV file",
        )
        .at(&arguments.input)),
    }
}

fn live(arguments: &Monitor, output: Output) -> Result<()> {
    let end = deadline(arguments.seconds)?;
    let stop = interrupted()?;
    let mut client = connect(&arguments.input)?;
    let hello = *client.hello();
    output.say(format!(
        "{} with {}, device {:016x}, {} link, parameters {}, last start: {}",
        hello.board.name,
        hello.sensor.name,
        hello.device_id,
        hello.role,
        hello.parameter_id,
        cause(&hello)
    ));
    let mut readings = Readings::new();
    let mut screen = Screen::new(output);
    while !is_over(end, &stop) {
        let Some(arrival) = client.next_event(Duration::from_millis(100))? else {
            continue;
        };
        if !screen.show(&arrival.event, &mut readings) {
            break;
        }
    }
    output.end_refresh();
    let statistics = client.statistics();
    output.say(format!(
        "{} frames, {} damaged; {} samples missing",
        statistics.frames,
        statistics.frames_damaged,
        statistics.raw.missing.max(statistics.corrected.missing)
    ));
    if let Some(status) = &screen.status {
        output.say(Sampling::from(status).text());
    }
    Ok(())
}

fn recorded(path: &std::path::Path, output: Output) -> Result<()> {
    let mut reader = RecordingReader::open(path)?;
    let mut decoder = Decoder::new();
    let mut readings = Readings::new();
    let mut screen = Screen::new(output);
    let mut role = None;
    let mut going = true;
    while let Some(received) = reader.next_received()? {
        // One link is enough to look at: the first that was heard.
        if *role.get_or_insert(received.role) != received.role {
            continue;
        }
        decoder.push(received.host_ns, &received.bytes, |arrival| {
            going = going && screen.show(&arrival.event, &mut readings);
        });
        if !going {
            break;
        }
    }
    output.end_refresh();
    Ok(())
}

/// Why a device has started.
fn cause(hello: &Hello) -> String {
    match hello.fault {
        Some(fault) => format!("{}, {fault}", hello.reset_reason),
        None => hello.reset_reason.to_string(),
    }
}

/// Shows readings and what happens to the device.
struct Screen {
    output: Output,
    last: Option<Instant>,
    refreshes: bool,
    /// As the device said it last.
    status: Option<Status>,
    /// The device has started anew and has not said yet why.
    restarted: bool,
}

impl Screen {
    fn new(output: Output) -> Self {
        use std::io::IsTerminal;
        Self {
            output,
            last: None,
            status: None,
            restarted: false,
            refreshes: std::io::stderr().is_terminal() && !output.is_json(),
        }
    }

    /// Returns false when nobody looks any more.
    fn show(&mut self, event: &Event, readings: &mut Readings) -> bool {
        match event {
            Event::Device { time, event } => {
                self.output.end_refresh();
                self.output
                    .say(format!("{:8.2} s  {event}", time.to_seconds()));
            }
            Event::Status(status) => self.status = Some(*status),
            Event::Restart { .. } => self.restarted = true,
            Event::Hello(hello) if core::mem::take(&mut self.restarted) => {
                self.output.end_refresh();
                self.output
                    .say(format!("the device has started anew: {}", cause(hello)));
            }
            _ => {}
        }
        let mut going = true;
        readings.push(event, |reading| {
            let line = Line::from(&reading);
            if self.output.is_json() {
                going = going && self.output.object(&line);
            } else if !self.refreshes {
                self.output.say(line.text());
            } else if self.last.is_none_or(|last| last.elapsed() >= REFRESH) {
                self.last = Some(Instant::now());
                self.output.refresh(&line.text());
            }
        });
        going
    }
}
