//! A broker, many replayed boards, and a slow line to the broker.
//!
//! A replayed board sends what one simulated board has sent: real frames with its sequence numbers and times. It has an own
//! device id and answers who it is and what time it has, and nothing else.

use std::collections::{HashMap, VecDeque};
use std::fmt::Write as _;
use std::fs;
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use wimu_host::client::{Client, ConnectOptions};
use wimu_host::decode::{Decoder, Event, TimedSample};
use wimu_host::mcap_file::{Recorded, RecordingReader};
use wimu_link::message::{Answer, Payload, Reply, Signature};
use wimu_link::{Deframer, Hello, Kind, LinkRole, MAX_FRAME, Request};
use wimu_sim::board::{Board, BoardConfig, SensorPart};
use wimu_sim::faults::{Channel, LinkFaults};
use wimu_sim::pipe::LinkConfig;
use wimu_sim::scenario::Host;
use wimu_sim::scene::{Scene, World};
use wimu_sim::source::Physics;
use wimu_sim::truth::Gauge;

use super::{Background, wait_until};
use serde_json::Value;

/// A Mosquitto of Debian on a free port of this machine.
pub struct Mosquitto {
    pub port: u16,
    folder: tempfile::TempDir,
    child: Option<Child>,
}

impl Mosquitto {
    /// Starts it; `None`, with the reason printed, where it is not installed. In CI it has to be.
    pub fn start() -> Option<Self> {
        let found = ["/usr/sbin/mosquitto", "/usr/bin/mosquitto"]
            .into_iter()
            .find(|path| Path::new(path).exists());
        if found.is_none() {
            assert!(
                std::env::var_os("CI").is_none(),
                "Mosquitto is missing: run `cargo xtask setup`"
            );
            println!("skipped: Mosquitto is missing; `cargo xtask setup` installs it");
            return None;
        }
        let mut broker = Self {
            port: free_port(),
            folder: super::folder(),
            child: None,
        };
        broker.restart();
        Some(broker)
    }

    pub fn url(&self) -> String {
        format!("mqtt://127.0.0.1:{}", self.port)
    }

    fn log(&self) -> PathBuf {
        self.folder.path().join("log")
    }

    /// Ids of the clients that have connected, in their order.
    pub fn clients(&self) -> Vec<String> {
        let log = fs::read_to_string(self.log()).expect("a log");
        let ids = log.lines().filter_map(|line| {
            let (_, rest) = line.split_once("New client connected from ")?;
            Some(
                rest.split_once(" as ")?
                    .1
                    .split_whitespace()
                    .next()?
                    .to_owned(),
            )
        });
        ids.collect()
    }

    pub fn pid(&self) -> u32 {
        self.child.as_ref().expect("it runs").id()
    }

    /// Kills it, without notice to its clients.
    pub fn kill(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }

    /// Starts it again, with nothing of before.
    pub fn restart(&mut self) {
        self.kill();
        let file = self.folder.path().join("mosquitto.conf");
        let text = format!(
            "listener {} 127.0.0.1\nallow_anonymous true\npersistence false\nsys_interval 1\n\
             max_inflight_messages 1000\nmax_queued_messages 100000\nset_tcp_nodelay true\n",
            self.port
        );
        fs::write(&file, text).expect("written");
        let binary = ["/usr/sbin/mosquitto", "/usr/bin/mosquitto"]
            .into_iter()
            .find(|path| Path::new(path).exists());
        let log = fs::File::create(self.log()).expect("a file");
        let child = Command::new(binary.expect("installed"))
            .arg("-c")
            .arg(&file)
            .stdout(Stdio::null())
            .stderr(log)
            .spawn();
        self.child = Some(child.expect("mosquitto"));
        let address = SocketAddr::from(([127, 0, 0, 1], self.port));
        wait_until("the broker", || TcpStream::connect(address).is_ok());
    }
}

impl Drop for Mosquitto {
    fn drop(&mut self) {
        self.kill();
    }
}

pub fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0")
        .and_then(|listener| listener.local_addr())
        .expect("a port")
        .port()
}

/// What one board sent: frames with their times, and its samples.
pub struct Tape {
    /// Time since the tape's begin, µs, and the bytes of whole frames.
    frames: Vec<(u64, Vec<u8>)>,
    hello: Hello,
    /// Device time at the begin.
    begin_us: u64,
    /// Value of each raw sample by its number.
    samples: HashMap<u32, [i32; 3]>,
    pub bytes: u64,
}

impl Tape {
    /// `seconds` of the raw samples of three axes at 100 Hz of a board in a hand.
    pub fn record(seconds: f64) -> Arc<Self> {
        let scene = Scene::new(World::default());
        let part = SensorPart::default();
        let source = Physics::new(
            part.random_truth(1, Gauge::LowerTriangular),
            scene.clone(),
            1,
        );
        let config = BoardConfig {
            cable: LinkConfig::default(),
            wireless: LinkConfig::default(),
            ..BoardConfig::default()
        };
        let board = std::cell::RefCell::new(Board::start(config, source));
        let hello = {
            let mut host = Host::connect(&board, scene).expect("a board");
            let mut settings = host.cable.settings().expect("settings");
            settings.cable = wimu_link::message::Streams {
                corrected: false,
                navigation: false,
                environment: false,
                ..settings.cable
            };
            settings.wireless = wimu_link::message::Streams {
                raw: false,
                ..settings.cable
            };
            host.cable.set_settings(settings).expect("settings");
            *host.cable.hello()
        };
        let mut board = board.into_inner();
        board.link(LinkRole::Cable).pull();
        let begin_us = board.now_us();
        let (mut frames, mut open, mut bytes) = (Vec::new(), Vec::new(), 0);
        while board.now_us() < begin_us + (seconds * 1e6) as u64 {
            board.run_until(board.now_us() + 10_000);
            board.link(LinkRole::Wireless).pull();
            open.extend(board.link(LinkRole::Cable).pull());
            if let Some(end) = open.iter().rposition(|byte| *byte == 0) {
                let rest = open.split_off(end + 1);
                bytes += open.len() as u64;
                frames.push((
                    board.now_us() - begin_us,
                    std::mem::replace(&mut open, rest),
                ));
            }
        }
        let mut samples = HashMap::new();
        let mut decoder = Decoder::new();
        for (at, piece) in &frames {
            decoder.push(at * 1000, piece, |arrival| {
                if let Event::Samples(batch) = &arrival.event {
                    samples.extend(batch.iter().map(|sample| (sample.sequence, sample.value)));
                }
            });
        }
        Arc::new(Self {
            frames,
            hello,
            begin_us,
            samples,
            bytes,
        })
    }

    /// Bytes of frames a sample.
    pub fn bytes_a_sample(&self) -> f64 {
        self.bytes as f64 / self.samples.len() as f64
    }
}

/// Replayed boards, each at a TCP port of this machine.
pub struct Boards {
    pub links: Vec<String>,
    /// Bytes that a board wrote to its link.
    pub sent: Arc<AtomicU64>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Boards {
    /// `count` boards; every fifth has `faults` on its line.
    pub fn start(tape: &Arc<Tape>, count: usize, faults: Option<&str>) -> Self {
        let listeners: Vec<_> = (0..count)
            .map(|_| TcpListener::bind("127.0.0.1:0").expect("a port"))
            .collect();
        let links = listeners
            .iter()
            .map(|listener| format!("tcp://{}", listener.local_addr().expect("bound")))
            .collect();
        let faults: Option<LinkFaults> = faults.map(|text| text.parse().expect("faults"));
        let (stop, sent) = (
            Arc::new(AtomicBool::new(false)),
            Arc::new(AtomicU64::new(0)),
        );
        let begun = Instant::now();
        let mut boards: Vec<_> = listeners
            .into_iter()
            .enumerate()
            .map(|(index, listener)| {
                listener.set_nonblocking(true).expect("a listener");
                let channel = faults
                    .as_ref()
                    .filter(|_| index % 5 == 4)
                    .map(|faults| Channel::new(faults, index as u64));
                Replayed::new(tape.clone(), index, listener, channel)
            })
            .collect();
        let second = boards.split_off(count / 2);
        let threads = [boards, second].into_iter().map(|mut boards| {
            let (stop, sent) = (stop.clone(), sent.clone());
            thread::spawn(move || {
                let mut tick = 0u32;
                while !stop.load(Ordering::Relaxed) {
                    let at = Instant::now();
                    for board in &mut boards {
                        sent.fetch_add(board.tick(begun.elapsed(), tick) as u64, Ordering::Relaxed);
                    }
                    tick += 1;
                    thread::sleep(Duration::from_millis(20).saturating_sub(at.elapsed()));
                }
            })
        });
        let threads = threads.collect();
        Self {
            links,
            sent,
            stop,
            threads,
        }
    }

    /// The configuration of a gateway of these boards.
    pub fn config(&self, broker: &str, more: &str) -> String {
        let mut text = format!("fleet = \"hall\"\nbroker = \"{broker}\"\n{more}\n[boards]\n");
        for (index, link) in self.links.iter().enumerate() {
            let _ = writeln!(text, "{} = \"{link}\"", name(index));
        }
        text
    }
}

impl Drop for Boards {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.threads
            .drain(..)
            .for_each(|thread| drop(thread.join()));
    }
}

pub fn name(index: usize) -> String {
    format!("board-{index:04}")
}

/// One replayed board.
struct Replayed {
    tape: Arc<Tape>,
    id: u64,
    /// Delay of its begin, so that not all send at once.
    phase: Duration,
    listener: TcpListener,
    client: Option<TcpStream>,
    channel: Option<Channel>,
    next: usize,
    outgoing: VecDeque<u8>,
    deframer: Deframer,
}

impl Replayed {
    fn new(tape: Arc<Tape>, index: usize, listener: TcpListener, channel: Option<Channel>) -> Self {
        Self {
            tape,
            id: 0xf1ee_7000_0000 + index as u64,
            phase: Duration::from_micros(index as u64 * 7919 % 160_000),
            listener,
            client: None,
            channel,
            next: 0,
            outgoing: VecDeque::new(),
            deframer: Deframer::new(),
        }
    }

    /// Runs up to the present; returns the bytes written.
    fn tick(&mut self, time: Duration, tick: u32) -> usize {
        let time = time.saturating_sub(self.phase);
        if self.client.is_none() && tick.is_multiple_of(5) {
            self.accept();
        }
        let mut line = Vec::new();
        self.receive(time, &mut line);
        while let Some((at_us, bytes)) = self
            .tape
            .frames
            .get(self.next)
            .filter(|(at_us, _)| u128::from(*at_us) <= time.as_micros())
        {
            let _ = at_us;
            line.extend(bytes);
            self.next += 1;
        }
        if self.client.is_none() {
            self.outgoing.clear();
            return 0;
        }
        match &mut self.channel {
            Some(channel) => {
                let now_ns = time.as_nanos() as u64;
                channel.push(now_ns, &line);
                self.outgoing.extend(channel.pull(now_ns, usize::MAX));
            }
            None => self.outgoing.extend(line),
        }
        self.send()
    }

    fn accept(&mut self) {
        if let Ok((stream, _)) = self.listener.accept()
            && stream.set_nonblocking(true).is_ok()
            && stream.set_nodelay(true).is_ok()
        {
            self.client = Some(stream);
            self.deframer = Deframer::new();
        }
    }

    fn receive(&mut self, time: Duration, line: &mut Vec<u8>) {
        let mut room = [0; 1024];
        let Some(client) = &mut self.client else {
            return;
        };
        match client.read(&mut room) {
            Ok(0) => self.client = None,
            Ok(count) => {
                let uptime_us = self.tape.begin_us + time.as_micros() as u64;
                for &byte in &room[..count] {
                    let Some(Ok(frame)) = self.deframer.push(byte) else {
                        continue;
                    };
                    let mut answer = [0; MAX_FRAME];
                    let length = match frame.kind {
                        Kind::WhoAreYou => Hello {
                            device_id: self.id,
                            uptime_us,
                            ..self.tape.hello
                        }
                        .encode(&mut answer)
                        .expect("room"),
                        Kind::Request => match Request::decode(frame.body) {
                            Ok(Request {
                                session,
                                id,
                                command: wimu_link::Command::GetTime,
                                ..
                            }) => {
                                let answer_of: Answer =
                                    Answer::Accepted(Payload::Time { uptime_us });
                                Reply {
                                    session,
                                    id,
                                    signature: Signature::NONE,
                                    answer: answer_of,
                                }
                                .encode(&mut answer)
                                .expect("room")
                            }
                            _ => 0,
                        },
                        _ => 0,
                    };
                    line.extend(&answer[..length]);
                }
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(_) => self.client = None,
        }
    }

    fn send(&mut self) -> usize {
        let mut written = 0;
        while let Some(client) = self.client.as_mut().filter(|_| !self.outgoing.is_empty()) {
            match client.write(self.outgoing.as_slices().0) {
                Ok(count) => {
                    written += count;
                    self.outgoing.drain(..count);
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(_) => self.client = None,
            }
        }
        // A slow client is like a full buffer of a board: whole frames are lost, which the numbers show.
        if self.outgoing.len() > 1 << 16 {
            self.client = None;
        }
        written
    }
}

/// What the files of a board hold.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Found {
    pub received: u64,
    pub missing: u64,
    pub files: usize,
    pub frames_damaged: u64,
    pub first: u32,
    pub last: u32,
}

impl Tape {
    /// Whether it has this sample.
    pub fn has(&self, sample: &TimedSample) -> bool {
        self.samples.get(&sample.sequence) == Some(&sample.value)
    }

    /// Decodes recordings in their order, and asserts that every sample is the tape's and every gap is counted to the sample.
    pub fn verify(&self, files: &[std::path::PathBuf]) -> Found {
        let mut decoder = Decoder::new();
        let mut found = Found {
            files: files.len(),
            first: u32::MAX,
            ..Found::default()
        };
        let mut seen = 0;
        for file in files {
            let mut reader = RecordingReader::open(file).expect("a recording");
            while let Some(entry) = reader.next_entry().expect("readable") {
                match entry {
                    Recorded::Received(received) => {
                        decoder.push(received.host_ns, &received.bytes, |arrival| {
                            if let Event::Samples(batch) | Event::Late(batch) = &arrival.event {
                                for sample in batch.iter() {
                                    assert!(self.has(&sample), "{file:?}: {sample:?}");
                                    found.first = found.first.min(sample.sequence);
                                    found.last = found.last.max(sample.sequence);
                                    seen += 1;
                                }
                            }
                        })
                    }
                    Recorded::Lost { .. } => decoder.interrupt(),
                    _ => {}
                }
            }
        }
        let statistics = decoder.statistics();
        found.received = statistics.raw.received;
        found.missing = statistics.raw.missing;
        found.frames_damaged = statistics.frames_damaged;
        assert_eq!(seen, found.received + statistics.raw.late, "{statistics:?}");
        assert_eq!(
            u64::from(found.last - found.first) + 1,
            found.received + found.missing,
            "{statistics:?}"
        );
        found
    }
}

/// The files of a board in their order.
pub fn files(recordings: &Path, board: &str) -> Vec<std::path::PathBuf> {
    let Ok(entries) = fs::read_dir(recordings.join(board)) else {
        return Vec::new();
    };
    let mut files: Vec<_> = entries
        .map(|entry| entry.expect("readable").path())
        .collect();
    files.sort();
    files
}

/// A line to a server that delays both directions, and can be cut.
pub struct SlowLine {
    pub port: u16,
    cuts: Arc<AtomicU64>,
}

impl SlowLine {
    pub fn to(port: u16, delay: Duration) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let own = listener.local_addr().expect("bound").port();
        let cuts = Arc::new(AtomicU64::new(0));
        let shared = cuts.clone();
        thread::spawn(move || {
            for client in listener.incoming() {
                let (Ok(client), Ok(server)) = (client, TcpStream::connect(("127.0.0.1", port)))
                else {
                    continue;
                };
                for (from, to) in [(&client, &server), (&server, &client)] {
                    let (from, to) = (
                        from.try_clone().expect("a stream"),
                        to.try_clone().expect("a stream"),
                    );
                    let _ = to.set_nodelay(true);
                    let cuts = shared.clone();
                    thread::spawn(move || delayed(from, to, delay, &cuts));
                }
            }
        });
        Self { port: own, cuts }
    }

    /// Cuts all connections.
    pub fn cut(&self) {
        self.cuts.fetch_add(1, Ordering::Relaxed);
    }
}

fn delayed(mut from: TcpStream, mut to: TcpStream, delay: Duration, cuts: &AtomicU64) {
    let before = cuts.load(Ordering::Relaxed);
    let mut under_way: VecDeque<(Instant, Vec<u8>)> = VecDeque::new();
    let _ = from.set_read_timeout(Some(Duration::from_millis(5)));
    let mut room = vec![0; 1 << 16];
    let mut ended = false;
    while cuts.load(Ordering::Relaxed) == before && !(ended && under_way.is_empty()) {
        match from.read(&mut room) {
            Ok(0) => ended = true,
            Ok(count) => under_way.push_back((Instant::now() + delay, room[..count].to_vec())),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_) => ended = true,
        }
        while under_way
            .front()
            .is_some_and(|(due, _)| *due <= Instant::now())
        {
            let (_, bytes) = under_way.pop_front().expect("there is one");
            if to.write_all(&bytes).is_err() {
                ended = true;
                under_way.clear();
            }
        }
    }
    let _ = from.shutdown(Shutdown::Both);
    let _ = to.shutdown(Shutdown::Both);
}

/// A connection to the broker as a foreign client with an id.
pub struct Foreign(TcpStream);

impl Foreign {
    pub fn connect(port: u16, id: &str) -> Self {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("the broker");
        let connect = [&field("MQTT")[..], &[4, 2, 0, 60], &field(id)].concat();
        stream
            .write_all(&packet(0x10, &connect))
            .expect("connected");
        stream.read_exact(&mut [0; 4]).expect("accepted");
        Self(stream)
    }

    /// Publishes a retained message of any length.
    pub fn publish(&mut self, topic: &str, payload: &[u8]) {
        let publish = packet(0x31, &[&field(topic), payload].concat());
        self.0.write_all(&publish).expect("published");
        // It has read all when it answers a ping.
        self.0.write_all(&[0xc0, 0]).expect("a ping");
        self.0.read_exact(&mut [0; 2]).expect("an answer");
    }

    /// Whether the broker ends the connection within a time.
    pub fn is_ended_within(&mut self, time: Duration) -> bool {
        self.0.set_read_timeout(Some(time)).expect("a socket");
        matches!(self.0.read(&mut [0; 16]), Ok(0))
    }
}

fn field(text: &str) -> Vec<u8> {
    [&(text.len() as u16).to_be_bytes()[..], text.as_bytes()].concat()
}

fn packet(kind: u8, content: &[u8]) -> Vec<u8> {
    let mut out = vec![kind];
    let mut length = content.len();
    while length >= 128 {
        out.push(length as u8 | 128);
        length >>= 7;
    }
    out.push(length as u8);
    [&out[..], content].concat()
}

/// Resident memory of a process, bytes, and the processor time it has used, s.
pub fn usage(pid: u32) -> (f64, f64) {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let resident = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))
        .unwrap_or_default();
    let kilobytes: f64 = resident
        .split_whitespace()
        .next()
        .and_then(|text| text.parse().ok())
        .unwrap_or_default();
    (kilobytes * 1024.0, processor_time(&format!("/proc/{pid}")))
}

/// Processor time of the threads of this process that have a name, s.
pub fn threads_usage(name: &str) -> f64 {
    let threads = fs::read_dir("/proc/self/task").expect("Linux").flatten();
    let named = threads.map(|thread| thread.path()).filter(|path| {
        fs::read_to_string(path.join("comm")).is_ok_and(|found| found.trim() == name)
    });
    named
        .map(|path| processor_time(&path.display().to_string()))
        .sum()
}

fn processor_time(folder: &str) -> f64 {
    let stat = fs::read_to_string(format!("{folder}/stat")).unwrap_or_default();
    let fields: Vec<f64> = stat
        .rsplit(')')
        .next()
        .unwrap_or_default()
        .split_whitespace()
        .map(|text| text.parse().unwrap_or(0.0))
        .collect();
    // utime and stime in ticks of 10 ms, the 14th and 15th field of all.
    let ticks = fields.get(11).unwrap_or(&0.0) + fields.get(12).unwrap_or(&0.0);
    ticks * 0.01
}

/// A gateway in a process of its own.
pub struct Gateway {
    process: Background,
    metrics: String,
}

impl Gateway {
    pub fn start(folder: &Path, config: &str) -> Self {
        Self::start_in(folder, config, "")
    }

    /// With variables of its environment.
    pub fn start_in(folder: &Path, config: &str, variables: &str) -> Self {
        let file = folder.join("fleet.toml");
        fs::write(&file, config).expect("written");
        // A file that may not grow is an error and not the end.
        let script = format!("trap '' XFSZ; {variables} exec \"$0\" \"$@\"");
        let program = ["sh", "-c", &script];
        let mut process = Background::start_by(
            &program,
            Path::new("/nonexistent"),
            &["gateway", "--config", file.to_str().expect("text")],
        );
        let line = process.line();
        let Ok(started) = serde_json::from_str::<Value>(&line) else {
            panic!("{line} {:?}", process.finish());
        };
        Self {
            process,
            metrics: started["metrics"].as_str().unwrap_or_default().to_owned(),
        }
    }

    /// Sum of a metric over the boards.
    pub fn metric(&self, name: &str) -> f64 {
        let mut text = String::new();
        let mut stream = TcpStream::connect(&self.metrics).expect("metrics");
        write!(stream, "GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n").expect("a request");
        stream.read_to_string(&mut text).expect("an answer");
        assert!(text.starts_with("HTTP/1.1 200 OK"), "{text}");
        let values = text
            .lines()
            .filter(|line| !line.starts_with('#') && line.split(['{', ' ']).next() == Some(name));
        let values: Vec<f64> = values
            .map(|line| {
                line.rsplit(' ')
                    .next()
                    .expect("a value")
                    .parse()
                    .expect("a number")
            })
            .collect();
        assert!(!values.is_empty(), "{name} in {text}");
        values.iter().sum()
    }

    /// Stops it as Ctrl-C does; returns its sums.
    pub fn stop(self) -> Value {
        let ran = self.process.signal("-INT");
        assert_eq!(ran.code, 0, "{ran:?}");
        ran.objects().pop().expect("an object")
    }

    /// Kills it.
    pub fn kill(self) {
        self.process.signal("-KILL");
    }

    pub fn pid(&self) -> u32 {
        self.process.id()
    }
}

/// A client of the board at a LINK.
pub fn client(
    link: &str,
) -> wimu_host::Result<Client<Box<dyn wimu_host::transport::Transport + Send>>> {
    let transport = wimu_host::transport::open(&link.parse()?)?;
    Client::connect(transport, link, ConnectOptions::default())
}
