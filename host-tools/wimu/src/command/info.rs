//! `wimu info`.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use serde::Serialize;
use wimu_host::authentication::Authentication;
use wimu_host::capture::{self, Capture, Counts};
use wimu_host::decode::{self, LinkStatistics};
use wimu_host::document::{Document, ToDocument};
use wimu_host::formats::{Source, Summary};
use wimu_host::keys::KeyFolder;
use wimu_host::mcap_file::Wholeness;
use wimu_host::units::RawUnit;
use wimu_host::{Input, Problem, Result};
use wimu_link::Hello;
use wimu_link::batch::Stream;
use wimu_link::message::{SensorStatus, Status};

use crate::arguments::Info;
use crate::command::key::access_text;
use crate::command::record::left_out_text;
use crate::command::{Connection, connect};
use crate::output::Output;

#[derive(Serialize)]
struct Contents {
    source: String,
    duration_s: f64,
    #[serde(flatten)]
    wholeness: Wholeness,
    links: Vec<Link>,
}

#[derive(Serialize)]
struct Link {
    role: String,
    device: Option<Device>,
    starts: usize,
    raw_samples: usize,
    corrected_samples: usize,
    epochs: usize,
    navigation: usize,
    attitudes: usize,
    sensors: Vec<Sensor>,
    parameter_ids: Vec<String>,
    events: Vec<String>,
    sampling: Option<Sampling>,
    more_events: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    authentication: Option<Authentication>,
    statistics: LinkStatistics,
}

impl ToDocument for Contents {
    fn document(&self) -> Document {
        let mut document = Document::new(&self.source);
        document.result(&format!("{}: {:.1} s", self.source, self.duration_s));
        for link in &self.links {
            document.key(&link.role, &link.contents());
            link.details(&mut document);
        }
        document
    }
}

impl Link {
    fn contents(&self) -> String {
        let statistics = &self.statistics;
        let mut text = format!(
            "{} raw, {} corrected, {} epochs, {} positions; {} missing, {} damaged frames{}, {} bytes",
            self.raw_samples,
            self.corrected_samples,
            self.epochs,
            self.navigation,
            statistics.raw.missing,
            statistics.frames_damaged,
            left_out_text(statistics.batches_unplaced, statistics.frames_rejected),
            statistics.bytes,
        );
        if self.starts > 1 {
            text += &format!("; {} starts of the board", self.starts);
        }
        text
    }

    fn details(&self, document: &mut Document) {
        let mut add = |what: &str, text: String| {
            document.key(&format!("{} {what}", self.role), &text);
        };
        // One sensor of three axes is described by the line of its link.
        let is_usual = |sensor: &Sensor| sensor.index == 0 && sensor.angular_rates == 0;
        if !self.sensors.iter().all(is_usual) {
            self.sensors.iter().for_each(|sensor| add("stream", sensor.text()));
        }
        if let Some(device) = &self.device {
            add("device", device.text());
        }
        if let Some(sampling) = &self.sampling {
            add("sampling", sampling.text());
        }
        if let Some(text) = self.authentication.as_ref().and_then(Authentication::text) {
            add("tags", text);
        }
        self.events.iter().for_each(|event| add("event", event.clone()));
        if self.more_events > 0 {
            add("events", format!("and {} more", self.more_events));
        }
    }
}

/// A sensor of a board.
#[derive(Serialize)]
struct Sensor {
    index: u8,
    raw_samples: usize,
    /// Raw and corrected samples with an angular rate.
    angular_rates: usize,
    /// By the latest sample period.
    rate_hz: Option<f64>,
    /// Latest full-scale ranges.
    range_m_s2: Option<f64>,
    gyroscope_range_dps: Option<f64>,
}

impl Sensor {
    fn of_link(link: &capture::Link) -> Vec<Self> {
        let boots = || link.boots.iter();
        let sensors = boots().flat_map(|boot| boot.counts.rates.keys().chain(boot.marks.keys()));
        let sensor = |index: u8| {
            let latest = boots().rev().find_map(|boot| Some(&boot.epochs_of(index).last()?.epoch));
            let unit = latest.and_then(RawUnit::of);
            Self {
                index,
                raw_samples: link.count(index, Stream::Raw),
                angular_rates: boots().map(|boot| boot.counts.rates_of(index)).sum(),
                rate_hz: latest.map(|epoch| 1e9 / f64::from(epoch.period_ns.max(1))),
                range_m_s2: unit.map(|unit| unit.range_mps2()),
                gyroscope_range_dps: unit.and_then(|unit| unit.range_rad_s()).map(f64::to_degrees),
            }
        };
        BTreeSet::from_iter(sensors.copied()).into_iter().map(sensor).collect()
    }

    fn text(&self) -> String {
        let mut text = format!("sensor {}: {} raw", self.index, self.raw_samples);
        if self.angular_rates > 0 {
            text += " with angular rates";
        }
        if let Some(rate) = self.rate_hz {
            text += &format!(", {rate:.1} Hz");
        }
        if let Some(range) = self.range_m_s2 {
            text += &format!(", ±{range:.1} m/s²");
        }
        if let Some(range) = self.gyroscope_range_dps {
            text += &format!(", ±{range:.0} °/s");
        }
        text
    }
}

/// Sampling statistics of a device.
#[derive(Serialize)]
pub struct Sampling {
    /// By the device's clock.
    rate_hz: Option<f64>,
    /// Jitter of the data-ready times, equation (95).
    jitter_us: Option<f64>,
    samples: u32,
    missed: u32,
    overruns: u32,
    bus_errors: u32,
    /// Bytes of the device's stack: size, and most used since its start.
    #[serde(skip_serializing_if = "Option::is_none")]
    stack_bytes: Option<[u32; 2]>,
}

impl From<&Status> for Sampling {
    fn from(status: &Status) -> Self {
        let SensorStatus { samples, missed, overruns, bus_errors } = status.sensor;
        Self {
            rate_hz: status.measured_period_ns.map(|ns| 1e9 / f64::from(ns)),
            jitter_us: status.jitter_ns.map(|ns| f64::from(ns) * 1e-3),
            samples,
            missed,
            overruns,
            bus_errors,
            stack_bytes: status.stack.map(|stack| [stack.size, stack.used]),
        }
    }
}

impl Sampling {
    pub fn text(&self) -> String {
        let mut text = format!(
            "sensor: {} samples, {} missed, {} overruns, {} bus errors",
            self.samples, self.missed, self.overruns, self.bus_errors
        );
        if let Some(rate) = self.rate_hz {
            text += &format!("; {rate:.2} Hz by the device's clock");
        }
        if let Some(jitter) = self.jitter_us {
            text += &format!(", jitter {jitter:.1} µs");
        }
        if let Some([size, used]) = self.stack_bytes {
            text += &format!("; stack: at most {used} of {size} bytes used");
        }
        text
    }
}

/// What safe mode means, after the cause of the start.
pub const SAFE_MODE: &str = "; safe mode after three failed starts: stored parameters and settings are not used until the next reset";

#[derive(Serialize)]
struct Device {
    device_id: String,
    board: String,
    sensor: String,
    firmware: String,
    boot_count: u32,
    reset_reason: String,
    fault: Option<String>,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    safe_mode: bool,
    write_access: String,
    parameter_id: String,
}

impl From<&Hello> for Device {
    fn from(hello: &Hello) -> Self {
        let [major, minor, patch] = hello.firmware;
        Self {
            device_id: format!("{:016x}", hello.device_id),
            board: hello.board.name.to_string(),
            sensor: hello.sensor.name.to_string(),
            firmware: format!("{major}.{minor}.{patch}"),
            boot_count: hello.boot_count,
            reset_reason: hello.reset_reason.to_string(),
            fault: hello.fault.map(|fault| fault.to_string()),
            safe_mode: hello.safe_mode,
            write_access: hello.access.to_string(),
            parameter_id: hello.parameter_id.to_string(),
        }
    }
}

impl Device {
    fn text(&self) -> String {
        format!(
            "{} with {}, device {}, firmware {}, start {} ({}{}{}), parameters {}, write access: {}",
            self.board,
            self.sensor,
            self.device_id,
            self.firmware,
            self.boot_count,
            self.reset_reason,
            self.fault.as_ref().map_or(String::new(), |fault| format!(": {fault}")),
            if self.safe_mode { SAFE_MODE } else { "" },
            self.parameter_id,
            access_text(&self.write_access)
        )
    }
}

/// What a board tells of itself.
#[derive(Serialize)]
pub struct Live {
    role: String,
    #[serde(flatten)]
    device: Device,
    /// Events that the device reports.
    troubles: Vec<String>,
    sampling: Sampling,
}

impl Live {
    /// Asks a board.
    ///
    /// # Errors
    /// Those of the link.
    pub fn of(client: &mut Connection) -> Result<Self> {
        let sampling = Sampling::from(&client.status()?);
        let mut troubles = Vec::new();
        while let Some(arrival) = client.next_event(Duration::ZERO)? {
            if let decode::Event::Device { event, .. } = arrival.event {
                troubles.push(event.to_string());
            }
        }
        Ok(Self {
            role: client.hello().role.to_string(),
            device: Device::from(client.hello()),
            troubles,
            sampling,
        })
    }

    pub fn text(&self) -> String {
        let mut text = format!("{} link of {}\n", self.role, self.device.text());
        for trouble in &self.troubles {
            text += &format!("  {trouble}\n");
        }
        text + "  " + &self.sampling.text()
    }
}

pub fn run(arguments: &Info, output: &Output) -> Result<()> {
    match Input::parse(&arguments.input)? {
        Input::Recording(path) => recording(&path, output),
        Input::Link(_) => board(&arguments.input, output),
        Input::File(path) => {
            let options = arguments.reading.options(false);
            let summary = Summary::read(&Source::open(&path)?, &options)?;
            print(&summary, &summary.findings, output);
            Ok(())
        }
    }
}

/// Shows which board is on a link.
pub fn board(link: &str, output: &Output) -> Result<()> {
    let live = Live::of(&mut connect(link)?)?;
    output.print(live.text());
    output.object(&live);
    Ok(())
}

/// Prints what a file holds.
fn print(contents: &impl ToDocument, findings: &[Problem], output: &Output) {
    output.print(contents.document().to_string());
    output.findings(findings);
    output.object(contents);
}

/// Largest number of events of a link that are listed.
const MAX_EVENTS: usize = 500;

/// The first events of the device with their times, and the number of further ones.
fn events(link: &capture::Link) -> (Vec<String>, usize) {
    let mut all: Vec<String> = Vec::new();
    for (time, event) in link.boots.iter().flat_map(|boot| &boot.events) {
        let text = format!("{:.2} s: {event}", time.to_seconds());
        // Persistent faults are reported again to each new listener.
        if !all.contains(&text) {
            all.push(text);
        }
    }
    let more = all.len().saturating_sub(MAX_EVENTS);
    all.truncate(MAX_EVENTS);
    (all, more)
}

fn recording(path: &Path, output: &Output) -> Result<()> {
    // Without usable keys tags are not verified, and that is reported where there are tags.
    let keys = KeyFolder::of_user().and_then(|folder| folder.all());
    let mut recording = Capture::survey(path, keys.unwrap_or_default())?;
    for link in recording.links.values_mut() {
        let device_id = link.hello().map(|hello| hello.device_id);
        link.authentication.key_known = device_id.is_some_and(|id| !KeyFolder::own(id).is_empty());
    }
    let wholeness = recording.wholeness;
    let tags = recording.links.values().flat_map(|link| link.authentication.findings());
    let findings = Vec::from_iter(wholeness.finding().into_iter().chain(tags));
    let links: Vec<Link> = recording
        .links
        .into_values()
        .map(|link| {
            let counts = link.boots.iter().map(|boot| &boot.counts);
            let sum = |of: fn(&Counts) -> usize| counts.clone().map(of).sum();
            let (events, more_events) = events(&link);
            Link {
                role: link.role.to_string(),
                device: link.hello().map(Device::from),
                starts: link.boots.len(),
                raw_samples: link.count(0, Stream::Raw),
                corrected_samples: link.count(0, Stream::Corrected),
                epochs: sum(|counts| counts.epochs),
                navigation: sum(|counts| counts.navigation),
                attitudes: sum(|counts| counts.attitudes),
                sensors: Sensor::of_link(&link),
                parameter_ids: link.parameter_ids.iter().map(ToString::to_string).collect(),
                events,
                more_events,
                sampling: link.status().map(Sampling::from),
                statistics: link.statistics,
                authentication: Some(link.authentication).filter(Authentication::is_known),
            }
        })
        .collect();
    let contents = Contents {
        source: wimu_host::untrusted::name(path),
        duration_s: recording.duration_ns as f64 * 1e-9,
        wholeness,
        links,
    };
    print(&contents, &findings, output);
    Ok(())
}
