//! `wimu info`.

use std::path::Path;

use serde::Serialize;
use wimu_host::decode::LinkStatistics;
use wimu_host::history::Recording;
use wimu_host::mcap_file::Wholeness;
use wimu_host::mimu4444::{Capture, Summary};
use wimu_host::{ErrorCode, HostError, Input, Result};
use wimu_link::Hello;

use crate::arguments::{Foreign, Info};
use crate::command::connect;
use crate::output::Output;

#[derive(Serialize)]
struct Contents {
    schema: &'static str,
    status: &'static str,
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
    parameter_ids: Vec<String>,
    events: Vec<String>,
    statistics: LinkStatistics,
}

#[derive(Serialize)]
struct Device {
    device_id: String,
    board: String,
    sensor: String,
    firmware: String,
    boot_count: u32,
    reset_reason: String,
    fault: Option<String>,
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
            write_access: hello.access.to_string(),
            parameter_id: hello.parameter_id.to_string(),
        }
    }
}

impl Device {
    fn text(&self) -> String {
        format!(
            "{} with {}, device {}, firmware {}, start {} ({}{}), parameters {}, writing {}",
            self.board,
            self.sensor,
            self.device_id,
            self.firmware,
            self.boot_count,
            self.reset_reason,
            self.fault
                .as_ref()
                .map_or(String::new(), |fault| format!(": {fault}")),
            self.parameter_id,
            self.write_access
        )
    }
}

pub fn run(arguments: &Info, output: Output) -> Result<()> {
    if let Some(Foreign::Mimu4444) = arguments.format {
        return capture(Path::new(&arguments.input), output);
    }
    match Input::parse(&arguments.input)? {
        Input::Recording(path) => recording(&path, output),
        Input::Link(_) => {
            #[derive(Serialize)]
            struct Answer {
                schema: &'static str,
                status: &'static str,
                role: String,
                #[serde(flatten)]
                device: Device,
            }
            let client = connect(&arguments.input)?;
            let device = Device::from(client.hello());
            let role = client.hello().role.to_string();
            output.say(format!("{role} link of {}", device.text()));
            output.object(&Answer {
                schema: "wimu.device/1",
                status: "ok",
                role,
                device,
            });
            Ok(())
        }
        Input::Csv(_) => Err(HostError::new(
            ErrorCode::UnknownFormat,
            "this is no recording",
            "give a file written by `wimu record`, or a LINK",
        )
        .at(&arguments.input)),
    }
}

/// A capture of another maker's stream.
fn capture(path: &Path, output: Output) -> Result<()> {
    #[derive(Serialize)]
    struct Answer {
        schema: &'static str,
        status: &'static str,
        source: String,
        #[serde(flatten)]
        summary: Summary,
    }
    let capture = Capture::read(path)?;
    let summary = capture.summary;
    output.say(format!(
        "{}: {:.1} s, {} packets of 8 accelerometers and gyroscopes; {} lost, {} duplicated, {} damaged, {} other bytes",
        capture.name,
        summary.duration_s,
        summary.packets,
        summary.lost,
        summary.duplicated,
        summary.damaged,
        summary.other_bytes
    ));
    output.say(format!(
        "  {:.5} Hz by its own clock, {:+.2} ppm off the nominal 62.5 Hz, {:.1} µs of jitter; nothing tells times of arrival",
        summary.rate_hz, summary.rate_ppm, summary.jitter_us
    ));
    output.object(&Answer {
        schema: "wimu.capture/1",
        status: "ok",
        source: capture.name,
        summary,
    });
    Ok(())
}

fn recording(path: &Path, output: Output) -> Result<()> {
    let recording = Recording::load(path)?;
    let links: Vec<Link> = recording
        .links
        .iter()
        .map(|link| {
            let boots = &link.boots;
            let mut parameter_ids: Vec<String> = boots
                .iter()
                .flat_map(|boot| &boot.epochs)
                .map(|mark| mark.epoch.parameter_id().to_string())
                .collect();
            parameter_ids.dedup();
            Link {
                role: link.role.to_string(),
                device: boots
                    .iter()
                    .rev()
                    .find_map(|boot| boot.hello.as_ref())
                    .map(Device::from),
                starts: boots.len(),
                raw_samples: boots.iter().map(|boot| boot.raw.len()).sum(),
                corrected_samples: boots.iter().map(|boot| boot.corrected.len()).sum(),
                epochs: boots.iter().map(|boot| boot.epochs.len()).sum(),
                navigation: boots.iter().map(|boot| boot.navigation.len()).sum(),
                parameter_ids,
                events: boots
                    .iter()
                    .flat_map(|boot| &boot.events)
                    .map(|(time, event)| format!("{:.2} s: {event}", time.to_seconds()))
                    .collect(),
                statistics: link.statistics,
            }
        })
        .collect();
    let contents = Contents {
        schema: "wimu.info/1",
        status: "ok",
        source: path.display().to_string(),
        duration_s: recording.duration_ns as f64 * 1e-9,
        wholeness: recording.wholeness,
        links,
    };
    output.say(format!(
        "{}: {:.1} s{}",
        contents.source,
        contents.duration_s,
        if contents.wholeness.truncated {
            ", cut off at the end"
        } else {
            ""
        }
    ));
    if contents.wholeness.damaged_chunks > 0 {
        output.say(format!(
            "  {} damaged chunks were left out",
            contents.wholeness.damaged_chunks
        ));
    }
    for link in &contents.links {
        output.say(format!(
            "{:8} {} raw, {} corrected, {} epochs, {} positions; {} missing, {} damaged frames, {} bytes",
            link.role,
            link.raw_samples,
            link.corrected_samples,
            link.epochs,
            link.navigation,
            link.statistics.raw.missing,
            link.statistics.frames_damaged,
            link.statistics.bytes
        ));
        if let Some(device) = &link.device {
            output.say(format!("         {}", device.text()));
        }
        for event in &link.events {
            output.say(format!("         {event}"));
        }
    }
    output.object(&contents);
    Ok(())
}
