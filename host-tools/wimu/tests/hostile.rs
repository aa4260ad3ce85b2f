//! Input from a broken or hostile link: `monitor` and `record` take it in bounded memory.
#![cfg(target_os = "linux")]

use crate::kit;

use std::fs;
use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener};
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use kit::folder;
use wimu_link::message::{
    Environment, Epoch, EpochReason, Event, Navigation, Payload, Reply, SetBytes, Signature,
};
use wimu_link::{Answer, Hello, LinkRole, MAX_FRAME, Telemetry, batch, frame::EncodeError};
use wimu_model::{CompiledSet, Counts, DeviceTimeUs, ParameterId, ParameterSet, Sensitivity};
use wimu_testkit::trials;

/// Bytes that a line of 921 600 baud carries in a second.
const LINE_BYTES: usize = 92_160;
/// Sample period, µs: the samples of a minute fill such a line.
const PERIOD_US: u64 = 100;
/// What a command may take at most, KiB.
const MOST_KIB: u64 = 100_000;
const TIME_LIMIT: Duration = Duration::from_secs(300);

/// Appends step `n` of the input to `out`.
type Step = fn(n: u64, out: &mut Vec<u8>);

const INPUTS: [(&str, Step); 10] = [
    ("a pause without end", |n, out| {
        event(out, 0, Event::Pause { longest_ms: u16::MAX });
        telemetry(n, out);
    }),
    ("pauses one after the other", |n, out| {
        event(out, n, Event::Pause { longest_ms: 200 });
        telemetry(n, out);
    }),
    ("random bytes", |n, out| {
        out.extend((0..128).flat_map(|k| any(128 * n + k).to_le_bytes()));
    }),
    ("a frame without end", |_, out| out.extend([0x55; 1024])),
    ("numbers that no device reaches", |n, out| {
        telemetry(n, out);
        put_message(
            out,
            &Telemetry::Environment(Environment { time_us: any(n), ..Environment::default() }),
        );
        let state = wimu_integrator::Navigation::default();
        put_message(out, &Telemetry::Navigation(Navigation::new(any(n) as u32, &state)));
        epoch(out, any(n) as u32, any(n + 1), any(n + 2) as u32);
    }),
    ("greetings of ever new devices", |n, out| hello(out, any(n))),
    ("events while a restart is in doubt", |n, out| match n {
        0..100 => telemetry(n + 1000, out),
        100 => epoch(out, 0, 0, 1000 * PERIOD_US as u32),
        _ => event(out, n, Event::SensorFound),
    }),
    ("epochs that jump", |n, out| {
        let at = any(n) % 1_000_000_000;
        epoch(out, at as u32, at * PERIOD_US, 1000 * PERIOD_US as u32);
        samples(out, at as u32);
    }),
    ("ever new parameters", |n, out| {
        telemetry(n, out);
        put_message(out, &Telemetry::Parameters(set(n)));
    }),
    ("answers that nobody asked for", |n, out| {
        let reply = Reply {
            session: any(n) as u32,
            id: n as u32,
            signature: Signature::NONE,
            answer: Answer::Accepted(Payload::Parameters(set(n))),
        };
        put(out, |frame| reply.encode(frame));
    }),
];

fn put(out: &mut Vec<u8>, encode: impl FnOnce(&mut [u8]) -> Result<usize, EncodeError>) {
    let mut frame = [0; MAX_FRAME];
    let length = encode(&mut frame).expect("room");
    out.extend(&frame[..length]);
}

fn put_message(out: &mut Vec<u8>, message: &Telemetry) {
    put(out, |frame| message.encode(frame));
}

fn event(out: &mut Vec<u8>, time_us: u64, event: Event) {
    put_message(out, &Telemetry::Event { time_us, event });
}

fn hello(out: &mut Vec<u8>, device_id: u64) {
    let hello = Hello { device_id, ..Hello::new(LinkRole::Cable) };
    put(out, |frame| hello.encode(frame));
}

fn epoch(out: &mut Vec<u8>, sequence: u32, time_us: u64, period_ns: u32) {
    put_message(
        out,
        &Telemetry::Epoch(Epoch {
            reason: EpochReason::Periodic,
            number: (sequence / 96) as u8,
            sequence,
            time_us,
            period_ns,
            range_g: 2,
            sensitivity_lsb_per_g: 16384.0,
            full_scale: 32752,
            parameters: 0,
            temperature_centi_c: None,
            ..Epoch::default()
        }),
    );
}

fn samples(out: &mut Vec<u8>, first: u32) {
    let counts: Vec<_> = (0..16).map(|k| Counts([k, (first >> 4) as i16, 16384])).collect();
    let time = DeviceTimeUs(u64::from(first) * PERIOD_US);
    put(out, |frame| batch::encode(first, time, &counts, frame));
}

/// What a board sends in step `n`.
fn telemetry(n: u64, out: &mut Vec<u8>) {
    let first = 16 * n as u32;
    if n.is_multiple_of(6) {
        epoch(out, first, u64::from(first) * PERIOD_US, 1000 * PERIOD_US as u32);
    }
    samples(out, first);
}

fn set(n: u64) -> SetBytes {
    let sensitivity = Sensitivity::from_lsb_per_g(16384.0).expect("one");
    let set = ParameterSet::uncalibrated(2, sensitivity);
    let set = CompiledSet::compile(&set, ParameterId(n as u32 + 1), n);
    SetBytes::from(&set.expect("compiled"))
}

/// Some number, the same in every run.
fn any(n: u64) -> u64 {
    let mixed = (n + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    (mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9)
}

/// Sends `bytes` bytes, made by `step`, to the host that connects: at once, or at `rate` bytes a second.
fn send(listener: TcpListener, step: Step, bytes: usize, rate: Option<usize>) {
    let (mut host, _) = listener.accept().expect("a host");
    // Nobody is there when it comes back.
    drop(listener);
    host.set_nodelay(true).expect("a stream");
    let mut heard = host.try_clone().expect("a stream");
    let ears =
        thread::spawn(move || while heard.read(&mut [0; 4096]).is_ok_and(|count| count > 0) {});
    let mut out = Vec::new();
    hello(&mut out, 1);
    let start = Instant::now();
    let mut sent = 0;
    for n in 0.. {
        step(n, &mut out);
        if out.len() >= 1000 {
            if host.write_all(&out).is_err() {
                break;
            }
            sent += out.len();
            out.clear();
            if let Some(rate) = rate {
                let due = start + Duration::from_secs_f64(sent as f64 / rate as f64);
                thread::sleep(due.saturating_duration_since(Instant::now()));
            }
        }
        if sent >= bytes {
            break;
        }
    }
    let _ = host.shutdown(Shutdown::Write);
    let _ = ears.join();
}

/// The most memory that the command took until its end, KiB.
fn peak_kib(name: &str, arguments: &[&str]) -> u64 {
    let mut child = Command::new(env!("CARGO_BIN_EXE_wimu"))
        .args(arguments)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("wimu was built");
    let until = Instant::now() + TIME_LIMIT;
    let mut peak = 0;
    while child.try_wait().expect("a child").is_none() {
        let status = fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kib = line.and_then(|line| line.split_whitespace().next()?.parse().ok());
        // It has none in its last moment.
        peak = kib.unwrap_or(peak);
        if peak > 10 * MOST_KIB || Instant::now() > until {
            child.kill().expect("a child");
            child.wait().expect("a child");
            panic!("{name}: {} has taken {peak} KiB and does not end", arguments[0]);
        }
        thread::sleep(Duration::from_millis(2));
    }
    peak
}

/// Peak memory, KiB, of `command` on a link that sends `bytes` bytes made by `step`.
fn survives(command: &str, name: &str, step: Step, bytes: usize, rate: Option<usize>) -> u64 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let link = format!("tcp://{}", listener.local_addr().expect("an address"));
    let folder = folder();
    let file = folder.path().join("hostile.mcap");
    let file = file.to_str().expect("text");
    let far = thread::spawn(move || send(listener, step, bytes, rate));
    let peak = match command {
        "record" => peak_kib(name, &["record", &link, "-o", file, "--reconnect", "0"]),
        _ => peak_kib(name, &[command, &link]),
    };
    far.join().expect("no panic");
    if command == "record" {
        let size = fs::metadata(file).expect("a recording").len() as usize;
        assert!(size > bytes / 1000, "{name}: {size} bytes recorded");
    }
    assert!(peak > 1000, "{name}: measured");
    peak
}

fn all_stay_small(command: &str, rate: Option<usize>) {
    // A minute of a line in a campaign.
    let bytes = trials(60) * LINE_BYTES;
    let peaks: Vec<_> = match rate {
        None => INPUTS
            .iter()
            .map(|(name, step)| (*name, survives(command, name, *step, bytes, rate)))
            .collect(),
        Some(_) => thread::scope(|scope| {
            let all = INPUTS.map(|(name, step)| {
                (name, scope.spawn(move || survives(command, name, step, bytes, rate)))
            });
            all.into_iter().map(|(name, peak)| (name, peak.join().expect("no panic"))).collect()
        }),
    };
    for (name, peak) in &peaks {
        println!("{command:8} {:6.1} MB  {name}", *peak as f64 * 1.024e-3);
    }
    for (name, peak) in peaks {
        assert!(peak < MOST_KIB, "{command}, {name}: {peak} KiB");
    }
}

#[test]
fn monitor_stays_small_whatever_a_link_brings() {
    all_stay_small("monitor", None);
}

#[test]
fn record_stays_small_whatever_a_link_brings() {
    all_stay_small("record", None);
}

#[test]
#[ignore = "a minute in real time: cargo test -p wimu --test all hostile -- --ignored"]
fn both_stay_small_for_a_minute_at_line_rate() {
    thread::scope(|scope| {
        for command in ["monitor", "record"] {
            scope.spawn(move || all_stay_small(command, Some(LINE_BYTES)));
        }
    });
}

#[test]
#[ignore = "half a minute in real time: cargo test -p wimu --test all hostile -- --ignored"]
fn a_pause_without_end_does_not_hold_up_a_question() {
    let start = Instant::now();
    // Nobody answers; the telemetry goes on for as long as somebody listens.
    let peak = survives("info", INPUTS[0].0, INPUTS[0].1, 90 * LINE_BYTES, Some(LINE_BYTES));
    let took = start.elapsed();
    println!("info     {:6.1} MB, {took:?}", peak as f64 * 1.024e-3);
    assert!(peak < MOST_KIB && took < Duration::from_secs(60), "{peak} KiB, {took:?}");
}
