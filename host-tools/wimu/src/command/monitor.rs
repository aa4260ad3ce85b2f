//! `wimu monitor`.

use std::cmp::Reverse;
use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::json;
use wimu_host::authentication::Authentication;
use wimu_host::decode::{Decoder, Event, LinkStatistics};
use wimu_host::keys::KeyFolder;
use wimu_host::mcap_file::RecordingReader;
use wimu_host::monitor::{Reading, Readings};
use wimu_host::{Code, Input, Result};
use wimu_link::Hello;
use wimu_link::message::Status;
use wimu_model::ParameterId;

use crate::arguments::Monitor;
use crate::command::info::{SAFE_MODE, Sampling};
use crate::command::record::left_out_text;
use crate::command::{connect, deadline, interrupted, is_over};
use crate::output::Output;
use crate::text_view::TextView;

/// One reading as JSON.
#[derive(Clone, Debug, Serialize)]
pub struct Line {
    pub sequence: u32,
    pub time_s: f64,
    pub raw_lsb: Option<[i32; 3]>,
    pub raw_angular_rate_lsb: Option<[i32; 3]>,
    pub specific_force_m_s2: [f64; 3],
    pub angular_rate_rad_s: Option<[f64; 3]>,
    pub corrected: bool,
    /// Parameters in use; "00000000" on an uncalibrated device.
    pub parameter_id: Option<String>,
    pub magnetic_field_ut: Option<[f64; 3]>,
    /// Whether the field is corrected and in body axes.
    pub magnetic_field_calibrated: Option<bool>,
    /// Heading of body x, clockwise from magnetic north, 0 to 360. Without a standard deviation it is uncalibrated:
    /// 90 (east) at the first rest, by definition.
    pub heading_deg: Option<f64>,
    pub heading_sd_deg: Option<f64>,
    pub temperature_c: Option<f64>,
    pub phase: Option<String>,
    pub velocity_m_s: Option<[f64; 3]>,
    pub position_m: Option<[f64; 3]>,
    pub since_rest_s: Option<f64>,
    pub valid: Option<bool>,
    /// Attitude W, X, Y, Z, body axes to east-north-up.
    pub quaternion: Option<[f64; 4]>,
}

impl From<&Reading> for Line {
    fn from(reading: &Reading) -> Self {
        let environment = reading.environment;
        let navigation = reading.navigation;
        let scaled = |nm: [i64; 3]| nm.map(|nm| nm as f64 / 1e9);
        Self {
            sequence: reading.sequence,
            // The nearest number, which has no more digits than the microseconds.
            time_s: reading.time.0 as f64 / 1e6,
            raw_lsb: reading.raw.map(|sample| sample.value),
            raw_angular_rate_lsb: reading.raw.and_then(|sample| sample.rate),
            specific_force_m_s2: reading.specific_force.0,
            angular_rate_rad_s: reading.angular_rate,
            corrected: reading.corrected,
            parameter_id: reading.parameters.map(|id| id.to_string()),
            magnetic_field_ut: reading.field.map(|field| field.nt.map(|nt| nt * 1e-3)),
            magnetic_field_calibrated: reading.field.map(|field| field.calibrated),
            heading_deg: reading.heading.map(|heading| heading.rad.to_degrees().rem_euclid(360.0)),
            heading_sd_deg: reading.heading.and_then(|heading| heading.sd_rad).map(f64::to_degrees),
            temperature_c: environment
                .and_then(|e| e.temperature_centi_c)
                .map(|centi| f64::from(centi) / 100.0),
            phase: navigation.map(|n| format!("{:?}", n.phase).to_lowercase()),
            velocity_m_s: navigation.map(|n| scaled(n.velocity_nmps)),
            position_m: navigation.map(|n| scaled(n.position_nm)),
            since_rest_s: navigation.map(|n| f64::from(n.since_rest_ms) / 1000.0),
            valid: navigation.map(|n| n.flags == 0),
            quaternion: reading.attitude.map(|attitude| attitude.to_quaternion()),
        }
    }
}

impl Line {
    /// Whether the device has a calibration.
    pub fn is_calibrated(&self) -> bool {
        let uncalibrated = ParameterId::UNCALIBRATED.to_string();
        self.parameter_id.as_ref().is_some_and(|id| *id != uncalibrated)
    }

    /// The parts as rows with their names.
    fn rows(&self) -> Vec<String> {
        let parts = self.parts().into_iter();
        let mut rows: Vec<String> =
            parts.map(|(_, name, text)| format!("{name:12} {}", text.trim())).collect();
        let corrected = self.corrected && self.is_calibrated();
        let state = if corrected { "corrected" } else { "nominal sensitivity" };
        let id = self.parameter_id.as_deref().filter(|_| self.is_calibrated());
        rows.push(format!("{:12} {} ({state})", "parameters", id.unwrap_or("none: uncalibrated")));
        rows
    }

    /// The most important parts that fit into `width` characters.
    fn text(&self, width: Option<usize>) -> String {
        let parts = self.parts();
        let mut room = width.unwrap_or(usize::MAX);
        let mut kept: Vec<usize> = (0..parts.len()).collect();
        kept.sort_by_key(|&at| Reverse(parts[at].0));
        kept.retain(|&at| {
            let left = room.checked_sub(parts[at].2.chars().count());
            room = left.unwrap_or(room);
            left.is_some()
        });
        kept.sort();
        kept.into_iter().map(|at| parts[at].2.as_str()).collect()
    }

    /// The parts of a line in order, each with its importance and name.
    fn parts(&self) -> Vec<(u8, &'static str, String)> {
        let [x, y, z] = self.specific_force_m_s2;
        let norm = (x * x + y * y + z * z).sqrt();
        let mut parts = vec![
            (9, "time", format!("{:7.2} s", self.time_s)),
            (8, "force", format!("  f {x:+7.3} {y:+7.3} {z:+7.3} m/s²")),
            (3, "magnitude", format!("  |f| {norm:7.3}")),
        ];
        if let Some([x, y, z]) = self.angular_rate_rad_s {
            parts.push((5, "rate", format!("  ω {x:+7.3} {y:+7.3} {z:+7.3} rad/s")));
        }
        if let Some(quaternion) = self.quaternion {
            let [roll, pitch, yaw] = euler_deg(quaternion);
            let text = format!("  roll {roll:+4.0}° pitch {pitch:+3.0}° yaw {yaw:+4.0}°");
            parts.push((5, "attitude", text));
        }
        if let Some([x, y, z]) = self.magnetic_field_ut {
            let calibrated = self.magnetic_field_calibrated == Some(true);
            let note = if calibrated { "" } else { " uncalibrated" };
            parts.push((1, "field", format!("  B {x:+6.1} {y:+6.1} {z:+6.1} µT{note}")));
        }
        if let Some(heading) = self.heading_deg {
            let sd = self.heading_sd_deg;
            let sd = sd.map_or("° uncalibrated".to_owned(), |sd| format!(" ± {sd:.0}°"));
            parts.push((4, "heading", format!("  heading {heading:3.0}{sd}")));
        }
        if let Some(celsius) = self.temperature_c {
            parts.push((2, "temperature", format!("  {celsius:.1} °C")));
        }
        if let Some(phase) = &self.phase {
            let invalid = self.valid == Some(false);
            let note = if invalid { " (invalid)" } else { "" };
            parts.push((7, "motion", format!("  {phase}{note}")));
            if let Some([e, n, u]) = self.position_m.filter(|_| phase != "searching") {
                parts.push((6, "position", format!("  p {e:+.3} {n:+.3} {u:+.3} m")));
            }
        }
        parts
    }
}

/// Roll, pitch and yaw of a quaternion W, X, Y, Z, degrees: rotations about x, then y, then z.
pub fn euler_deg([w, x, y, z]: [f64; 4]) -> [f64; 3] {
    let roll = (2.0 * (w * x + y * z)).atan2(1.0 - 2.0 * (x * x + y * y));
    let pitch = (2.0 * (w * y - x * z)).clamp(-1.0, 1.0).asin();
    let yaw = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    [roll, pitch, yaw].map(f64::to_degrees)
}

pub fn run(arguments: &Monitor, output: &Output) -> Result<()> {
    match Input::parse(&arguments.input)? {
        Input::Link(_) => live(arguments, output),
        Input::Recording(path) => recorded(&path, arguments.rate, output),
        Input::File(_) => Err(Code::UnknownFormat.error("monitor does not read files of other programs",
            "give a LINK or a recording of wimu; `wimu simulate --replay` streams counts of a table",
        )
        .at(&arguments.input)),
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
            going &= match self.output.is_json() {
                true => self.output.object(&line),
                false => self.output.line(line.text(self.output.width())),
            };
        });
        going
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// With all that a line can hold, at its longest.
    fn longest() -> Line {
        Line {
            sequence: 1,
            time_s: 12_345.67,
            raw_lsb: None,
            raw_angular_rate_lsb: None,
            specific_force_m_s2: [-19.123, 19.123, -9.807],
            angular_rate_rad_s: Some([-34.123, 34.123, -10.001]),
            corrected: true,
            parameter_id: None,
            magnetic_field_ut: Some([-120.5, 20.5, 43.0]),
            magnetic_field_calibrated: Some(false),
            heading_deg: Some(359.0),
            heading_sd_deg: None,
            temperature_c: Some(25.4),
            phase: Some("moving".to_owned()),
            velocity_m_s: Some([0.0; 3]),
            position_m: Some([-1234.567, 1234.567, -12.345]),
            since_rest_s: Some(1.0),
            valid: Some(false),
            quaternion: Some([0.5, -0.5, -0.5, 0.5]),
        }
    }

    #[test]
    fn a_line_fits_its_terminal_and_loses_the_least_important_first() {
        let line = longest();
        let whole = line.text(None);
        let length = whole.chars().count();
        assert!(length > 160, "{length}");
        assert_eq!(line.text(Some(length)), whole);
        assert!(!line.text(Some(length - 1)).contains("µT"));
        for width in 10..length {
            let text = line.text(Some(width));
            assert!(text.chars().count() <= width, "{width}: {text}");
            assert!(text.starts_with("12345.67 s"), "{width}: {text}");
        }
        let has = |width, parts: &[&str]| {
            let text = line.text(Some(width));
            assert!(parts.iter().all(|part| text.contains(part)), "{width}: {text}");
        };
        has(65, &["f -19.123", "(invalid)"]);
        has(119, &["f -19.123", "moving (invalid)", "p -1234.567", "|f|"]);
        let usual = Line {
            time_s: 12.34,
            position_m: Some([-1.234, 12.345, -0.012]),
            valid: Some(true),
            ..line
        };
        let text = usual.text(Some(79));
        assert!(text.contains("moving") && text.contains("p -1.234"), "{text}");
    }
}
