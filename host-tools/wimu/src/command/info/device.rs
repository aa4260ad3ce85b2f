//! What a board reports of itself.

use std::time::Duration;

use serde::Serialize;
use wimu_host::Result;
use wimu_host::decode;
use wimu_link::Hello;
use wimu_link::message::{SensorStatus, Status};

use crate::command::Connection;
use crate::command::key::access_text;

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

/// What a device reports of itself.
#[derive(Serialize)]
pub struct Device {
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
    pub fn text(&self) -> String {
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
