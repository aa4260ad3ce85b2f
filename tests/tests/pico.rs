//! The Pico's own image on an emulated RP2040 with an ADXL345 on its bus: `cargo xtask test --only
//! pico`. Both UARTs take their time at 115,200 baud.

use std::path::Path;
use std::process::Command as Process;

use serde_json::{Value, json};
use wimu_host::history::Boot;
use wimu_link::hello::{Capabilities, board};
use wimu_link::message::{BusFault, Event};
use wimu_link::{Answer, Command, LinkRole, Request, Settings};
use wimu_tests::{Listener, ROLES, assert_replays, encoded, gaps, who_are_you};

const CABLE: u8 = 1;
const WIRELESS: u8 = 0;
/// A byte of 8N1 at 115,200 baud, bytes a second.
const LINE_RATE: f64 = 11_520.0;

/// What came of a run.
struct Run {
    links: [Listener; 2],
    report: Value,
}

impl Run {
    fn link(&self, role: LinkRole) -> &Listener {
        &self.links[usize::from(role != LinkRole::Cable)]
    }

    fn boots(&self, role: LinkRole) -> &[Boot] {
        self.link(role).boots()
    }

    /// When the sensor took its samples, µs since the start.
    fn taken_us(&self) -> Vec<f64> {
        let taken = self.report["taken_at_ns"].as_array().expect("times");
        taken
            .iter()
            .map(|time| time.as_f64().expect("a number") / 1000.0)
            .collect()
    }
}

/// Runs the image for `seconds` of its time while `script` happens.
fn run(seconds: f64, script: &[Value]) -> Run {
    let image =
        std::env::var("WIMU_PICO_FIRMWARE").expect("`cargo xtask test --only pico` says it");
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
        .status()
        .expect("node runs");
    assert!(status.success());
    let bytes = |name: &str| std::fs::read(folder.path().join(name)).expect("it was written");
    for name in ["cable.bin", "wireless.bin"] {
        let rate = bytes(name).len() as f64 / seconds;
        assert!(rate <= LINE_RATE, "{name}: {rate} bytes a second");
    }
    Run {
        links: [
            Listener::heard(LinkRole::Cable, &bytes("cable.bin")),
            Listener::heard(LinkRole::Wireless, &bytes("wireless.bin")),
        ],
        report: serde_json::from_slice(&bytes("report.json")).expect("JSON"),
    }
}

fn send(at_ms: u32, uart: u8, bytes: &[u8]) -> Value {
    let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    json!({"at_ms": at_ms, "uart": uart, "hex": hex})
}

fn happens(at_ms: u32, what: &str) -> Value {
    json!({"at_ms": at_ms, "do": what})
}

fn request(id: u32, command: Command) -> Vec<u8> {
    let request = Request {
        session: 0x7e57,
        id,
        signature: Default::default(),
        command,
    };
    encoded(|frame| request.encode(frame))
}

#[test]
#[ignore = "`cargo xtask test --only pico` builds the image and runs it"]
fn it_streams_on_both_uarts_with_the_times_at_which_the_sensor_had_its_samples() {
    let faster = Settings {
        rate_hz: 400,
        ..Settings::default()
    };
    let run = run(
        9.0,
        &[
            send(800, CABLE, &who_are_you()),
            send(900, WIRELESS, &who_are_you()),
            send(1_000, CABLE, &request(1, Command::SetSettings(faster))),
        ],
    );
    assert_eq!(run.report["overruns"], 0);
    let taken = run.taken_us();
    for role in ROLES {
        let link = run.link(role);
        link.assert_perfect();
        let boot = &run.boots(role)[0];
        let hello = boot.hello.expect("it was asked");
        assert_eq!(hello.board.number, board::PICO_ADXL345);
        assert_eq!(hello.role, role);
        assert!(!hello.capabilities.contains(Capabilities::MAGNETOMETER));
        assert!(boot.environment.is_empty());
        assert_eq!(gaps(&boot.raw), []);
        assert!(boot.raw.len() > 3_000, "{}", boot.raw.len());
        // The bar, from when the sensor's true rate is known.
        let settled = &boot.raw[boot.raw.len() - 600..];
        let late = settled.iter().map(|sample| {
            let time = sample.time.0 as f64;
            let after = taken.partition_point(|taken| *taken < time);
            [after.wrapping_sub(1), after]
                .iter()
                .filter_map(|&index| taken.get(index))
                .map(|taken| time - taken)
                .min_by(|a, b| a.abs().total_cmp(&b.abs()))
                .expect("some sample")
        });
        let (mut least, mut most) = (f64::MAX, f64::MIN);
        for late in late {
            least = least.min(late);
            most = most.max(late);
        }
        println!("{role}: sample times {least:.1} to {most:.1} µs after the sensor took them");
        assert!(
            most - least <= 10.0 && least >= -5.0,
            "{least} to {most} µs"
        );
    }
    let answers: Vec<_> = run.link(LinkRole::Cable).replies().to_vec();
    assert!(
        matches!(answers[0].answer, Answer::Accepted(_)),
        "{answers:?}"
    );
}

#[test]
#[ignore = "`cargo xtask test --only pico` builds the image and runs it"]
fn a_sensor_that_goes_or_is_exchanged_is_told_and_comes_back() {
    let run = run(
        9.0,
        &[
            happens(3_000, "unplug"),
            happens(4_000, "plug"),
            happens(6_000, "unplug"),
            happens(6_500, "exchange"),
            happens(7_000, "plug"),
        ],
    );
    for role in ROLES {
        let mut told = run.link(role).events();
        told.retain(|event| !matches!(event, Event::Pause { .. }));
        let expected = [
            Event::SensorLost(BusFault::NoAnswer),
            Event::SensorFound,
            Event::SensorLost(BusFault::NoAnswer),
            Event::WrongSensor {
                expected: 0xE5,
                found: 0x33,
            },
        ];
        assert_eq!(told, expected, "{role}");
        assert_replays(&run.boots(role)[0]);
    }
}
