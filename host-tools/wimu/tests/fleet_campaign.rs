//! A thousand replayed boards through Mosquitto, with faults of every part. It prints its figures beside a plain gateway of
//! one JSON message a sample.
//!
//! `WIMU_FLEET_BOARDS` and `WIMU_FLEET_SECONDS` change its size.

use crate::kit;

use std::collections::HashMap;
use std::fs;
use std::process::Command;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use kit::fleet::{
    Boards, Found, Gateway, Mosquitto, SlowLine, Tape, client, files, name, threads_usage, usage,
};
use kit::{folder, wait_until};
use serde_json::json;
use wimu_host::decode::{Decoder, Event};
use wimu_host::fleet::Batch;
use wimu_host::fleet::mqtt::{Heard, Mqtt, MqttConfig};
use wimu_testkit::figure;

/// Faults of every fifth board's line, and delay of the line to the broker.
const FAULTS: &str = "loss=5%,latency=200ms";
const BROKER_DELAY: Duration = Duration::from_millis(200);
/// Name of the threads of the plain gateway, and number of its boards.
const PLAIN: &str = "plain";
const PLAIN_BOARDS: usize = 200;
const CONFIG: &str = "metrics = \"127.0.0.1:0\"\nrecordings = \"recordings\"\nspool = \"spool\"\n";

fn number(variable: &str, default: usize) -> usize {
    std::env::var(variable).map_or(default, |text| text.parse().expect("a number"))
}

/// A client of the broker that follows all boards: what it has found of each, and the bytes that the broker has received.
#[derive(Default)]
struct Reader {
    boards: HashMap<String, Followed>,
    broker_bytes: f64,
}

#[derive(Default)]
struct Followed {
    decoder: Decoder,
    latest: Option<(u64, u32)>,
    missing_batches: u64,
    wrong: u64,
    bounds: Option<(u32, u32)>,
}

impl Followed {
    fn take(&mut self, tape: &Tape, payload: &[u8]) {
        let batch = Batch::decode(payload).expect("a batch");
        if let Some((session, number)) =
            self.latest.filter(|(session, _)| *session == batch.session)
        {
            let ahead = batch.number.wrapping_sub(number) as i32;
            if ahead <= 0 {
                return;
            }
            self.missing_batches += ahead as u64 - 1;
            assert_eq!(session, batch.session);
        }
        self.latest = Some((batch.session, batch.number));
        let Self { decoder, wrong, bounds, .. } = self;
        for (at, bytes) in batch.pieces {
            decoder.push(at, &bytes, |arrival| {
                if let Event::Samples(batch) | Event::Late(batch) = &arrival.event {
                    for sample in batch.iter() {
                        *wrong += u64::from(!tape.has(&sample));
                        let (first, last) =
                            bounds.get_or_insert((sample.sequence, sample.sequence));
                        (*first, *last) =
                            ((*first).min(sample.sequence), (*last).max(sample.sequence));
                    }
                }
            });
        }
    }

    /// Whether every sample was right and every gap was counted.
    fn is_exact(&self) -> bool {
        let raw = self.decoder.statistics().raw;
        let span = self.bounds.map_or(0, |(first, last)| u64::from(last - first) + 1);
        self.wrong == 0 && span > 0 && span == raw.received + raw.missing
    }
}

fn follow(broker: &Mosquitto, tape: &Arc<Tape>) -> (Mqtt, Arc<Mutex<Reader>>) {
    let reader = Arc::new(Mutex::new(Reader::default()));
    let (shared, tape) = (reader.clone(), tape.clone());
    let filters = vec!["wimu/hall/+/up".to_owned(), "$SYS/broker/bytes/received".to_owned()];
    let mqtt = Mqtt::start(
        MqttConfig::new(&broker.url().parse().expect("a broker"), filters),
        move |heard| {
            let Heard::Message { topic, payload, .. } = heard else {
                return;
            };
            let mut reader = shared.lock().expect("no panic");
            match topic.strip_prefix("wimu/hall/").and_then(|rest| rest.strip_suffix("/up")) {
                Some(board) => {
                    reader.boards.entry(board.to_owned()).or_default().take(&tape, payload)
                }
                None => {
                    reader.broker_bytes = String::from_utf8_lossy(payload).parse().unwrap_or(0.0)
                }
            }
        },
    );
    (mqtt.expect("a client"), reader)
}

/// Figures of an interval without faults.
#[derive(Debug)]
struct Load {
    memory: f64,
    /// Cores that the gateway and the broker use.
    gateway: f64,
    broker: f64,
    samples: f64,
    seconds: f64,
    broker_bytes: f64,
}

fn load(gateway: &Gateway, broker: &Mosquitto, reader: &Mutex<Reader>, time: Duration) -> Load {
    let bytes = || reader.lock().expect("no panic").broker_bytes;
    let at = Instant::now();
    let (_, gateway_s) = usage(gateway.pid());
    let (_, broker_s) = usage(broker.pid());
    let (samples, received) = (gateway.metric("wimu_board_samples"), bytes());
    thread::sleep(time);
    let seconds = at.elapsed().as_secs_f64();
    let (memory, gateway_end) = usage(gateway.pid());
    let (_, broker_end) = usage(broker.pid());
    Load {
        memory,
        gateway: (gateway_end - gateway_s) / seconds,
        broker: (broker_end - broker_s) / seconds,
        samples: gateway.metric("wimu_board_samples") - samples,
        seconds,
        broker_bytes: bytes() - received,
    }
}

/// Limits the size of the gateway's files, as a full disk does; `unlimited` ends it.
fn limit_files(pid: u32, limit: &str) {
    let set = Command::new("prlimit")
        .args(["--pid", &pid.to_string(), &format!("--fsize={limit}:unlimited")])
        .status();
    assert!(set.is_ok_and(|status| status.success()), "prlimit");
}

/// A gateway that publishes each sample as a JSON message, and neither records nor keeps clocks: processor time of it and of
/// the broker, and bytes, a sample.
fn plain(broker: &Mosquitto, reader: &Mutex<Reader>, boards: &Boards) -> [f64; 3] {
    let samples = Arc::new(AtomicU64::new(0));
    let stop = Arc::new(AtomicBool::new(false));
    let (links, count, stopped) = (boards.links.clone(), samples.clone(), stop.clone());
    let address = broker.url().parse().expect("a broker");
    // All threads that it starts have its name.
    let gateway = thread::Builder::new().name(PLAIN.to_owned());
    let gateway = gateway.spawn(move || {
        let mqtt = Mqtt::start(MqttConfig::new(&address, Vec::new()), |_| {}).expect("a client");
        mqtt.wait_connected().expect("a broker");
        thread::scope(|scope| {
            for (index, link) in links.iter().enumerate() {
                let (mqtt, count, stopped) = (&mqtt, &count, &stopped);
                scope.spawn(move || publish_plain(link, &name(index), mqtt, count, stopped));
            }
        });
    });
    let gateway = gateway.expect("a thread");
    thread::sleep(Duration::from_secs(10));
    let bytes = || reader.lock().expect("no panic").broker_bytes;
    let sums = || {
        let (own, brokers) = (threads_usage(PLAIN), usage(broker.pid()).1);
        [own, brokers, bytes(), samples.load(Ordering::Relaxed) as f64]
    };
    let before = sums();
    thread::sleep(Duration::from_secs(20));
    let after = sums();
    stop.store(true, Ordering::Relaxed);
    gateway.join().expect("no panic");
    let published = after[3] - before[3];
    assert!(published > 15.0 * 100.0 * boards.links.len() as f64);
    [0, 1, 2].map(|of| (after[of] - before[of]) / published)
}

fn publish_plain(link: &str, board: &str, mqtt: &Mqtt, count: &AtomicU64, stop: &AtomicBool) {
    let mut client = client(link).expect("a board");
    let topic = format!("plain/hall/{board}/sample");
    while !stop.load(Ordering::Relaxed) {
        let arrival = client.next_event(Duration::from_millis(250));
        let Some(arrival) = arrival.expect("a link") else {
            continue;
        };
        if let Event::Samples(batch) = &arrival.event {
            for sample in batch.iter() {
                let [x, y, z] = sample.value;
                let json = json!({"board": board, "sequence": sample.sequence,
                    "time_us": sample.time.0, "x": x, "y": y, "z": z});
                mqtt.publish(topic.clone(), json.to_string().into_bytes());
                count.fetch_add(1, Ordering::Relaxed);
            }
        }
    }
}

#[test]
#[ignore = "takes minutes: `cargo xtask campaign fleet`"]
fn a_thousand_boards_through_a_real_broker() {
    let mut broker = Mosquitto::start();
    let (count, seconds) = (number("WIMU_FLEET_BOARDS", 1000), number("WIMU_FLEET_SECONDS", 600));
    let part = |percent: usize| Duration::from_secs_f64(seconds as f64 * percent as f64 / 100.0);
    let tape = Tape::record(seconds as f64 * 1.5 + 120.0);
    let folder = folder();
    let few = {
        let home = folder.path().join("few");
        fs::create_dir(&home).expect("a folder");
        let boards = Boards::start(&tape, 10, None);
        let (_mqtt, reader) = follow(&broker, &tape);
        let gateway = Gateway::start(&home, &boards.config(&broker.url(), CONFIG));
        wait_until("ten boards", || gateway.metric("wimu_board_alive") == 10.0);
        thread::sleep(Duration::from_secs(5));
        let few = load(&gateway, &broker, &reader, part(5).max(Duration::from_secs(10)));
        gateway.stop();
        few
    };
    println!("10 boards: {few:?}");

    let boards = Boards::start(&tape, count, Some(FAULTS));
    let line = SlowLine::to(broker.port, BROKER_DELAY);
    let (mqtt, reader) = follow(&broker, &tape);
    let config = boards.config(&format!("mqtt://127.0.0.1:{}", line.port), CONFIG);
    let began = Instant::now();
    let gateway = Gateway::start(folder.path(), &config);
    let all = count as f64;
    wait_until("all boards", || gateway.metric("wimu_board_alive") == all);
    println!("all boards after {:.1} s", began.elapsed().as_secs_f64());
    thread::sleep(part(10));
    let many = load(&gateway, &broker, &reader, part(20));
    println!("{count} boards: {many:?}");

    broker.kill();
    thread::sleep(part(5));
    broker.restart();
    let broker_recovery = recovery(|| {
        gateway.metric("wimu_gateway_broker") == 1.0
            && gateway.metric("wimu_gateway_waiting") < 2.0 * all
    });
    thread::sleep(part(10));
    line.cut();
    thread::sleep(part(10));
    let dropped = gateway.metric("wimu_gateway_dropped");
    gateway.kill();
    let gateway = Gateway::start(folder.path(), &config);
    let gateway_recovery = recovery(|| gateway.metric("wimu_board_alive") == all);
    thread::sleep(part(10));
    limit_files(gateway.pid(), "1");
    thread::sleep(part(5));
    let unrecorded = gateway.metric("wimu_board_unrecorded_bytes");
    limit_files(gateway.pid(), "unlimited");
    thread::sleep(part(15));
    let (memory, _) = usage(gateway.pid());
    let dropped = dropped + gateway.metric("wimu_gateway_dropped");
    let sums = gateway.stop();
    println!("{sums}");
    drop(boards);
    wait_until("the reader", || mqtt.is_connected());
    thread::sleep(Duration::from_secs(2));

    let recordings = folder.path().join("recordings");
    let found: Vec<Found> =
        (0..count).map(|index| tape.verify(&files(&recordings, &name(index)))).collect();
    let sum = |of: fn(&Found) -> u64| found.iter().map(of).sum::<u64>();
    let (received, missing) = (sum(|found| found.received), sum(|found| found.missing));
    // `verify` asserts that every sample is right and every gap counted.
    figure(
        "recordings of the gateway exact, gaps counted to the sample",
        format!("{} of {count}", found.len()),
        "all",
        found.len() == count,
    );
    figure(
        "samples recorded, missing and counted",
        format!("{received}, {missing}"),
        "reported",
        true,
    );
    let reader = reader.lock().expect("no panic");
    let exact = reader.boards.values().filter(|board| board.is_exact()).count();
    figure(
        "streams through the broker exact, gaps counted to the sample",
        format!("{exact} of {count}"),
        "all",
        exact == count,
    );
    let through = |of: fn(&Followed) -> u64| reader.boards.values().map(of).sum::<u64>();
    let lost = through(|board| board.decoder.statistics().raw.missing);
    let got = through(|board| board.decoder.statistics().raw.received);
    figure(
        "samples through the broker, missing and counted",
        format!("{got}, {lost}"),
        "reported",
        true,
    );
    let batches = through(|board| board.missing_batches);
    figure(
        "batches lost by the broker, dropped by the full spool",
        format!("{batches}, {dropped}"),
        "reported",
        true,
    );
    figure(
        "bytes not recorded while the disk was full",
        format!("{unrecorded}"),
        "above 0",
        unrecorded > 0.0,
    );
    figure(
        "recovery after the broker was killed",
        format!("{broker_recovery:.1} s"),
        "reported",
        true,
    );
    figure(
        "recovery after the gateway was killed",
        format!("{gateway_recovery:.1} s"),
        "reported",
        true,
    );
    costs(&few, &many, memory, count, &tape);
    drop(reader);
    against_plain(&broker, &many, &tape);
    assert_eq!(exact, count);
}

fn recovery(holds: impl FnMut() -> bool) -> f64 {
    let at = Instant::now();
    wait_until("the recovery", holds);
    at.elapsed().as_secs_f64()
}

fn costs(few: &Load, many: &Load, memory_end: f64, count: usize, tape: &Tape) {
    let rate = many.samples / many.seconds;
    let expected = 100.0 * count as f64;
    figure(
        "samples per second",
        format!("{rate:.0}"),
        "100 per board",
        (0.9..1.02).contains(&(rate / expected)),
    );
    figure("gateway, cores", format!("{:.2}", many.gateway), "below 1", many.gateway < 1.0);
    figure("broker, cores", format!("{:.2}", many.broker), "reported", true);
    let kilobytes = many.memory / count as f64 / 1024.0;
    let grown = (memory_end - many.memory) / 1024.0 / count as f64;
    figure(
        "gateway, memory per board",
        format!("{kilobytes:.0} KiB, {grown:+.0} KiB later"),
        "reported",
        true,
    );
    figure(
        "bytes of a sample on the board's link",
        format!("{:.2}", tape.bytes_a_sample()),
        "at most 5",
        tape.bytes_a_sample() <= 5.0,
    );
    let bytes = many.broker_bytes / many.samples;
    figure(
        "bytes of a sample at the broker, with acknowledgements",
        format!("{bytes:.2}"),
        "at most 6",
        bytes <= 6.0,
    );
    let boards = count as f64 / 10.0;
    let growth = [many.gateway / few.gateway, many.memory / few.memory].map(|ratio| ratio / boards);
    figure(
        "growth from 10 boards, per board: processor, memory",
        format!("{:.2}, {:.2}", growth[0], growth[1]),
        "at most 1",
        growth.iter().all(|ratio| *ratio <= 1.0),
    );
}

fn against_plain(broker: &Mosquitto, many: &Load, tape: &Arc<Tape>) {
    let (_mqtt, reader) = follow(broker, tape);
    let boards = Boards::start(tape, PLAIN_BOARDS, None);
    let [own, brokers, bytes] = plain(broker, &reader, &boards);
    let rate = many.samples / many.seconds;
    for (what, plain, ours) in [
        ("processor of the gateway", own, many.gateway / rate),
        ("processor of the broker", brokers, many.broker / rate),
        ("bytes at the broker", bytes, many.broker_bytes / many.samples),
    ] {
        figure(
            &format!("one JSON message a sample: {what}, ratio to ours"),
            format!("{:.1}", plain / ours),
            "above 1",
            plain > ours,
        );
    }
}
