//! A run of the image on the emulator.

use std::path::Path;
use std::process::Command as Process;

use serde_json::{Value, json};
use wimu_host::capture::Boot;
use wimu_link::{Command, LinkRole, Request};
use wimu_tests::{Listener, encoded};

/// The UARTs by their numbers.
pub const CABLE: u8 = 1;
/// UART0.
pub const WIRELESS: u8 = 0;

/// What came of a run.
pub struct Run {
    links: [Listener; 2],
    pub report: Value,
}

impl Run {
    pub fn link(&self, role: LinkRole) -> &Listener {
        &self.links[usize::from(role != LinkRole::Cable)]
    }

    pub fn boots(&self, role: LinkRole) -> &[Boot] {
        self.link(role).boots()
    }

    /// When the sensor took its samples, µs since the start.
    pub fn taken_us(&self) -> Vec<f64> {
        let taken = self.report["taken_at_ns"].as_array().expect("times");
        taken.iter().map(|time| time.as_f64().expect("a number") / 1000.0).collect()
    }
}

/// Runs the image for `seconds` of its time while `script` happens.
pub fn run(seconds: f64, script: &[Value]) -> Run {
    run_with("adxl345", seconds, script)
}

/// The same with another sensor.
pub fn run_with(sensor: &str, seconds: f64, script: &[Value]) -> Run {
    let image =
        std::env::var("WIMU_PICO_FIRMWARE").expect("`cargo xtask release --only pico` says it");
    let emulator = Path::new(env!("CARGO_MANIFEST_DIR")).join("pico/run.mjs");
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("script.json");
    std::fs::write(&file, json!(script).to_string()).expect("writable");
    let status = Process::new("node")
        .arg(emulator)
        .arg(image)
        .arg(seconds.to_string())
        .arg(folder.path())
        .arg(file)
        .env("WIMU_PICO_SENSOR", sensor)
        .status()
        .expect("node runs");
    assert!(status.success());
    let bytes = |name: &str| std::fs::read(folder.path().join(name)).expect("it was written");
    Run {
        links: [
            Listener::heard(LinkRole::Cable, &bytes("cable.bin")),
            Listener::heard(LinkRole::Wireless, &bytes("wireless.bin")),
        ],
        report: serde_json::from_slice(&bytes("report.json")).expect("JSON"),
    }
}

/// Sends bytes to a UART.
pub fn send(at_ms: u32, uart: u8, bytes: &[u8]) -> Value {
    let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    json!({"at_ms": at_ms, "uart": uart, "hex": hex})
}

/// The other end of a UART has this rate from then on, bits/s.
pub fn rate(at_ms: u32, uart: u8, baud: u32) -> Value {
    json!({"at_ms": at_ms, "uart": uart, "baud": baud})
}

/// The power fails in the middle of the `count`th change of the flash from then on.
pub fn cut(at_ms: u32, count: u32) -> Value {
    json!({"at_ms": at_ms, "do": "cut", "count": count})
}

/// Does something to the machine: see `tests/pico/run.mjs`.
pub fn happens(at_ms: u32, what: &str) -> Value {
    json!({"at_ms": at_ms, "do": what})
}

/// The processor goes on in the function at `address`, with this argument.
pub fn call(at_ms: u32, address: u32, argument: u32) -> Value {
    json!({"at_ms": at_ms, "do": "call", "address": address, "argument": argument})
}

/// A request without a signature.
pub fn request(id: u32, command: Command) -> Vec<u8> {
    let request = Request { session: 0x7e57, id, signature: Default::default(), command };
    encoded(|frame| request.encode(frame))
}
