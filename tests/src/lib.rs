//! The kit of wimu's end-to-end tests (`tests/`): a simulated board with a host on both links, in
//! virtual time, that can also lie, mumble and look away. Golden wire vectors are in `vectors/`.

pub mod behind_faults;
pub mod campaign;
#[cfg(unix)]
pub mod qemu;
pub mod tags;
pub mod wire;

use std::collections::HashSet;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use embassy_futures::block_on;
use wimu_host::calibration::parameter_id;
use wimu_host::capture::{Boot, Capture, Link};
use wimu_host::decode::{Decoder, Event, TimedSample};
use wimu_host::mcap_file::{ClockAnchor, Received, RecordingReader, RecordingWriter};
use wimu_host::replay;
use wimu_link::batch;
use wimu_link::frame::EncodeError;
use wimu_link::message::{Event as DeviceEvent, Payload, SetBytes, Status};
use wimu_link::{
    Answer, Command, Deframer, Hello, Kind, LinkRole, MAX_FRAME, Reply, Request, Settings,
    WIRE_VERSION, WhoAreYou,
};
use wimu_model::{CompiledSet, Counts, DeviceTimeUs, ParameterSet};
use wimu_node::{FlashLayout, FlashStore, Key, MAX_RECORD, Store, StoreFault};
use wimu_sim::board::{Board, BoardConfig};
use wimu_sim::motion;
use wimu_sim::scene::{Scene, World};
use wimu_sim::source::{Physics, Source};
use wimu_sim::storage::Storage;
use wimu_sim::truth::{Gauge, SensorTruth};
pub use wimu_testkit::Random;

/// Both links, the cable first.
pub const ROLES: [LinkRole; 2] = [LinkRole::Cable, LinkRole::Wireless];

/// How long an answer may take, s of virtual time.
const PATIENCE_S: f64 = 4.0;
/// Bytes are carried this often, µs.
const TICK_US: u64 = 5_000;

/// A bad but believable sensor in `world`, moved as [`motion::named`] says.
pub fn sensor(names: &str, world: World, seed: u64) -> Physics {
    let scene = Scene::new(world);
    let motion = motion::named(names, seed).expect("a known motion");
    assert!(motion.duration() > 0.0);
    scene.play(0.0, motion);
    Physics::new(SensorTruth::random(seed, Gauge::LowerTriangular), scene, seed)
}

/// A board and a host that listens on both its links, in virtual time.
pub struct Rig {
    /// The board, to break.
    pub board: Board,
    links: [Listener; 2],
    requests: u32,
}

impl Rig {
    /// A board of `config` with a sensor that takes its samples from `source`; no time has passed.
    pub fn new(config: BoardConfig, source: impl Source + 'static) -> Self {
        Self { board: Board::start(config, source), links: ROLES.map(Listener::new), requests: 0 }
    }

    /// A usual board whose sensor is at rest for 10 s, then slides, then rests.
    pub fn usual() -> Self {
        Self::new(BoardConfig::default(), sensor("rest,slide", World::default(), 3))
    }

    /// Lets time pass while the host listens.
    pub fn run(&mut self, seconds: f64) {
        let end = self.board.now_us() + (seconds * 1e6) as u64;
        while self.board.now_us() < end {
            self.board.run_until((self.board.now_us() + TICK_US).min(end));
            let host_ns = self.board.now_us() * 1000;
            for link in &mut self.links {
                if link.listens {
                    link.take(host_ns, &self.board.link(link.role).pull());
                }
            }
        }
    }

    /// Takes power off and puts it back; the host goes on listening.
    pub fn restart(&mut self) {
        self.board.restart();
    }

    /// Sends bytes to the board.
    pub fn send(&mut self, role: LinkRole, bytes: &[u8]) {
        self.board.link(role).push(bytes);
    }

    /// Makes the host listen on a link, or look away: without a baud rate, that stalls the board's
    /// sender.
    pub fn listen(&mut self, role: LinkRole, listens: bool) {
        self.links[place(role)].listens = listens;
    }

    /// What a link has brought.
    pub fn link(&self, role: LinkRole) -> &Listener {
        &self.links[place(role)]
    }

    /// What the device sent on a link since it started last.
    pub fn boot(&self, role: LinkRole) -> &Boot {
        self.link(role).boots().last().expect("at least one")
    }

    /// The frame of a new request.
    pub fn frame_of(&mut self, command: Command) -> Vec<u8> {
        self.requests += 1;
        let request =
            Request { session: 0x7e57, id: self.requests, signature: Default::default(), command };
        encoded(|frame| request.encode(frame))
    }

    /// Asks the board something and waits for the answer.
    ///
    /// # Panics
    /// When none comes in time.
    pub fn ask(&mut self, role: LinkRole, command: Command) -> Answer {
        let frame = self.frame_of(command);
        let id = self.requests;
        self.send(role, &frame);
        let end = self.board.now_us() + (PATIENCE_S * 1e6) as u64;
        while self.board.now_us() < end {
            self.run(0.01);
            let mut replies = self.link(role).replies.iter().rev();
            if let Some(reply) = replies.find(|reply| reply.id == id) {
                return reply.answer;
            }
        }
        panic!("no answer on the {role} link to {command:?}");
    }

    /// The board's settings.
    pub fn settings(&mut self) -> Settings {
        match self.ask(LinkRole::Cable, Command::GetSettings) {
            Answer::Accepted(Payload::Settings(settings)) => settings,
            other => panic!("{other:?}"),
        }
    }

    /// Sets the board over the cable.
    ///
    /// # Panics
    /// When it refuses.
    pub fn set(&mut self, settings: Settings) {
        let answer = self.ask(LinkRole::Cable, Command::SetSettings(settings));
        assert_eq!(answer, Answer::Accepted(Payload::Settings(settings)));
    }

    /// How the board is.
    pub fn status(&mut self) -> Status {
        match self.ask(LinkRole::Cable, Command::GetStatus) {
            Answer::Accepted(Payload::Status(status)) => status,
            other => panic!("{other:?}"),
        }
    }

    /// All that was heard, written as a recording and read back.
    pub fn recording(&self) -> Capture {
        let name = "the recording";
        let anchor = ClockAnchor { monotonic_ns: 0, utc_ns: 1_700_000_000_000_000_000 };
        let mut writer =
            RecordingWriter::new(Cursor::new(Vec::new()), name, anchor).expect("memory");
        let mut heard: Vec<&Received> = self.links.iter().flat_map(|link| &link.heard).collect();
        heard.sort_by_key(|received| received.host_ns);
        for received in heard {
            writer.append(received.role, received.host_ns, &received.bytes).expect("memory");
        }
        let file = writer.finish().expect("memory").into_inner();
        let reader = RecordingReader::new(Cursor::new(file), name).expect("own file");
        Capture::read(reader, name).expect("own file")
    }
}

fn place(role: LinkRole) -> usize {
    usize::from(role != LinkRole::Cable)
}

/// The host's end of one link, with the real decoder behind it.
pub struct Listener {
    role: LinkRole,
    listens: bool,
    decoder: Decoder,
    record: Link,
    heard: Vec<Received>,
    replies: Vec<Reply>,
}

impl Listener {
    fn new(role: LinkRole) -> Self {
        Self {
            role,
            listens: true,
            decoder: Decoder::new(),
            record: Link::new(role),
            heard: Vec::new(),
            replies: Vec::new(),
        }
    }

    /// A link that has brought `bytes`.
    pub fn heard(role: LinkRole, bytes: &[u8]) -> Self {
        let mut listener = Self::new(role);
        listener.take(0, bytes);
        listener
    }

    fn take(&mut self, host_ns: u64, bytes: &[u8]) {
        if bytes.is_empty() {
            return;
        }
        let (record, replies) = (&mut self.record, &mut self.replies);
        self.decoder.push(host_ns, bytes, |arrival| {
            if let Event::Reply { reply, .. } = &arrival.event {
                replies.push(*reply);
            }
            record.take(&arrival);
        });
        record.statistics = self.decoder.statistics();
        self.heard.push(Received { role: self.role, host_ns, bytes: bytes.to_vec() });
    }

    /// What it has brought, sorted.
    pub fn record(&self) -> &Link {
        &self.record
    }

    /// What it has brought, for each start of the device.
    pub fn boots(&self) -> &[Boot] {
        &self.record.boots
    }

    /// Takes what it has brought, for each start of the device.
    pub fn take_boots(&mut self) -> Vec<Boot> {
        std::mem::take(&mut self.record.boots)
    }

    /// The bytes, as they came.
    pub fn bytes(&self) -> Vec<u8> {
        self.heard.iter().flat_map(|received| received.bytes.iter().copied()).collect()
    }

    /// Every reply in answer order.
    pub fn replies(&self) -> &[Reply] {
        &self.replies
    }

    /// What happened on the device since it started last.
    pub fn events(&self) -> Vec<DeviceEvent> {
        let boot = self.record.boots.last().expect("at least one");
        boot.events.iter().map(|(_, event)| *event).collect()
    }

    /// That nothing got lost or damaged on the way, and that the device missed no sample.
    ///
    /// # Panics
    /// When something did.
    pub fn assert_perfect(&self) {
        let statistics = self.record.statistics;
        assert_eq!(statistics.frames_damaged, 0, "{statistics:?}");
        assert_eq!(statistics.frames_unreadable, 0, "{statistics:?}");
        assert_eq!(statistics.batches_unplaced, 0, "{statistics:?}");
        for stream in [statistics.raw, statistics.corrected] {
            assert!(stream.received > 0, "{statistics:?}");
            assert_eq!(stream.missing + stream.duplicated, 0, "{statistics:?}");
        }
        for boot in self.boots() {
            assert_replays(boot);
        }
    }
}

/// That a boot's samples, velocities, positions and states are computed again bit for bit, from
/// whichever epoch one begins.
///
/// # Panics
/// When one bit differs, or there was nothing to compare.
pub fn assert_replays(boot: &Boot) {
    for epoch in 0..boot.epochs().len() {
        let report = replay::verify(boot, epoch);
        let mark = &boot.epochs()[epoch].epoch;
        assert_eq!(report.first_difference, None, "from epoch {epoch}, {mark:?}: {report:?}");
        assert_eq!(report.epochs_unusable, 0, "from epoch {epoch}: {report:?}");
    }
    let report = replay::verify(boot, 0);
    assert!(report.is_exact(), "{report:?}");
    assert!(report.corrected_compared > 0, "{report:?}");
}

/// Where samples are missing: the number of the first that is, and how many are.
pub fn gaps(samples: &[TimedSample]) -> Vec<(u32, u32)> {
    samples
        .windows(2)
        .filter(|pair| pair[1].sequence != pair[0].sequence + 1)
        .map(|pair| {
            let first = pair[0].sequence + 1;
            (first, pair[1].sequence.wrapping_sub(first))
        })
        .collect()
}

/// The frame that `encode` writes.
pub fn encoded<E: std::fmt::Debug>(encode: impl FnOnce(&mut [u8]) -> Result<usize, E>) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let length = encode(&mut frame).expect("room");
    frame[..length].to_vec()
}

/// A calibration as any board takes it.
///
/// # Panics
/// When it cannot be compiled.
pub fn compiled(set: &ParameterSet) -> SetBytes {
    let set = CompiledSet::compile(set, parameter_id(set), 0);
    SetBytes::from(&set.expect("compiled"))
}

/// The question who is there.
pub fn who_are_you() -> Vec<u8> {
    encoded(|frame| WhoAreYou::default().encode(frame))
}

/// The frames in `bytes` that are replies, as they came.
pub fn reply_frames(bytes: &[u8]) -> Vec<Vec<u8>> {
    let mut deframer = Deframer::new();
    let is_reply = |frame: &&[u8]| {
        frame.iter().any(
            |&byte| matches!(deframer.push(byte), Some(Ok(frame)) if frame.kind == Kind::Reply),
        )
    };
    bytes.split_inclusive(|&byte| byte == 0).filter(is_reply).map(<[u8]>::to_vec).collect()
}

/// A frame of any kind and version, intact by its CRC, made without the crate under test.
pub fn frame_of(version: u8, kind: u8, body: &[u8]) -> Vec<u8> {
    let mut plain = vec![version << 4 | kind & 0x0F];
    plain.extend_from_slice(body);
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISCSI).checksum(&plain);
    plain.extend_from_slice(&crc.to_le_bytes());
    let mut frame = vec![0; cobs::max_encoding_length(plain.len())];
    let length = cobs::encode(&plain, &mut frame);
    frame.truncate(length);
    frame.push(0);
    frame
}

/// A record for a store.
fn record(random: &mut Random) -> Vec<u8> {
    let length = 1 + random.below(MAX_RECORD);
    random.bytes(length)
}

/// Damages `bytes`: a flipped bit, a piece lost, a piece doubled, or a piece of noise.
pub fn damage(random: &mut Random, bytes: &mut Vec<u8>) {
    let at = random.below(bytes.len());
    let run = random.below((bytes.len() - at).min(32));
    match random.below(4) {
        _ if bytes.is_empty() => {}
        0 => bytes[at] ^= 1 << random.below(8),
        1 => drop(bytes.drain(at..at + run)),
        2 => {
            let piece = bytes[at..at + run].to_vec();
            let to = random.below(bytes.len());
            bytes.splice(to..to, piece);
        }
        _ => {
            let noise = random.bytes(run);
            bytes.splice(at..at + run, noise);
        }
    }
}

/// One execution of all fuzz bodies, and of the host's decoder, on bytes of any length: random ones,
/// and frames that were damaged.
///
/// # Panics
/// When a body finds a fault.
pub fn fuzz_once(seeded: &mut Random) {
    let length = seeded.below(700);
    let mut data = seeded.bytes(length);
    // Small numbers look more like messages than even ones do.
    let mask = [0xff, 0x7f, 0x0f, 0x03][seeded.below(4)];
    data.iter_mut().for_each(|byte| *byte &= mask);
    wire::all(&data);

    let mut line = Vec::new();
    let mut rest = data.as_slice();
    while let [kind, most, after @ ..] = rest {
        let (body, after) = after.split_at(usize::from(*most).min(after.len()));
        line.extend(frame_of(WIRE_VERSION, kind % 8, body));
        rest = after;
    }
    for _ in 0..seeded.below(3) {
        damage(seeded, &mut line);
    }
    let mut decoder = Decoder::new();
    let piece = 1 + seeded.below(100);
    for piece in line.chunks(piece) {
        decoder.push(0, piece, |_| {});
    }
    let statistics = decoder.statistics();
    assert_eq!(statistics.bytes, line.len() as u64);
    fuzz_order(seeded);
    tags::fuzz_tags(seeded);
}

/// One to three starts of a device whose frames are lost, repeated, exchanged, damaged and held up, each
/// decoded when it comes: no sample has another number, time or value than it was sent with, and none is
/// handed on twice, though it comes again behind the next start.
///
/// # Panics
/// When one is.
fn fuzz_order(seeded: &mut Random) {
    const PERIOD_US: u64 = 20_000;
    const BATCH: u32 = 4;
    const DOWN_US: u64 = 700_000;
    let time_us = |sequence: u32| 300_000 + u64::from(sequence) * PERIOD_US;
    // Its value tells its number.
    let value = |start: u32, sequence: u32| [start as i16, sequence as i16, 1000];
    let framed = |encode: &dyn Fn(&mut [u8]) -> Result<usize, EncodeError>| {
        let mut frame = [0; MAX_FRAME];
        let length = encode(&mut frame).expect("room");
        frame[..length].to_vec()
    };
    // Of which start, when it comes, and what.
    let mut frames: Vec<(u32, u64, Vec<u8>)> = Vec::new();
    let mut began_us = 1_000_000;
    for start in 1..=1 + seeded.below(3) as u32 {
        let hello = Hello { boot_count: start, uptime_us: 1000, ..Hello::new(LinkRole::Wireless) };
        let hello = framed(&|frame| hello.encode(frame));
        frames.push((start, began_us, hello));
        let batches = 1 + seeded.below(90) as u32;
        for sequence in (0..batches).map(|batch| batch * BATCH) {
            let now_us = began_us + time_us(sequence + BATCH);
            if sequence % 48 == 0 {
                let epoch = campaign::epoch_at(sequence, time_us(sequence), PERIOD_US, 48);
                frames.push((start, now_us, framed(&|frame| epoch.encode(frame))));
            }
            let counts: Vec<_> = (sequence..sequence + BATCH)
                .map(|sequence| Counts(value(start, sequence)))
                .collect();
            let time = DeviceTimeUs(time_us(sequence));
            let batch = framed(&|frame| batch::encode(sequence, time, &counts, frame));
            frames.push((start, now_us, batch));
        }
        began_us += time_us(batches * BATCH) + DOWN_US;
    }
    for _ in 0..seeded.below(6) {
        if frames.len() < 2 {
            break;
        }
        let at = seeded.below(frames.len() - 1);
        let of_next = |(start, ..): &(u32, u64, Vec<u8>)| *start != frames[at].0;
        let next = frames.iter().skip(at).position(of_next);
        let end = next.map_or(frames.len(), |next| at + next);
        let count = (1 + seeded.below(30)).min(end - at);
        match seeded.below(5) {
            0 => drop(frames.drain(at..at + count)),
            1 => {
                let again = frames[at..at + count].to_vec();
                let behind = (at + count + seeded.below(40)).min(frames.len());
                frames.splice(behind..behind, again);
            }
            2 if count > 1 => frames.swap(at, at + 1),
            3 => damage(seeded, &mut frames[at].2),
            // A stall.
            _ => {
                let held_us = seeded.below(8_000_000) as u64;
                frames[at].1 += held_us;
            }
        }
    }
    let mut decoder = Decoder::new();
    let mut now_us = 0;
    let mut heard = HashSet::new();
    for (_, at_us, bytes) in frames {
        // One after the other.
        now_us = at_us.max(now_us);
        decoder.push(now_us * 1000, &bytes, |arrival| {
            let (Event::Samples(samples) | Event::Late(samples)) = arrival.event else {
                return;
            };
            for TimedSample { sequence, time, value: [start, number, _], .. } in samples.iter() {
                assert_eq!((number as u32, time.0), (sequence, time_us(sequence)));
                let is_first = heard.insert((start, number));
                assert!(is_first, "sample {number} of start {start} twice");
            }
        });
    }
}

/// A store of two pages in a flash whose image was good and has been overwritten in places, eight times
/// from the same good one. Nothing panics, what is found under a key was once saved under it, and what
/// is saved into the damaged flash is found after a restart and makes no other record an older one. Every
/// image can be written. Returns how often that was.
///
/// # Panics
/// When it finds a fault.
pub fn fuzz_store(seeded: &mut Random) -> u64 {
    const EACH: u64 = 8;
    let storage = Storage::in_memory();
    let mut saved = Saved::default();
    let mut store = FlashStore::new(storage.clone(), STORE, 0);
    for _ in 0..1 + seeded.below(12) {
        let (which, record) = (seeded.below(4), record(seeded));
        if block_on(store.save(STORED[which], &record)).is_ok() {
            saved[which].push(record);
        }
    }
    let image = storage.image();
    for _ in 0..EACH {
        damaged_store(seeded, &image, saved.clone());
    }
    EACH
}

const STORE: FlashLayout<Storage> = FlashLayout::new(0..0x2000);
const STORED: [Key; 4] =
    [Key::Parameters { range_g: 2 }, Key::Settings, Key::LineRate, Key::DeviceKey];

/// All that was ever saved under each key, the oldest first.
type Saved = [Vec<Vec<u8>>; STORED.len()];

/// How new each record is that a restart finds: its place in what was saved, the last if there are
/// several; 0 is none. An error is `None`.
fn ages(storage: &Storage, saved: &Saved) -> [Option<usize>; STORED.len()] {
    let mut store = FlashStore::new(storage.clone(), STORE, 0);
    let mut buffer = [0; MAX_RECORD];
    std::array::from_fn(|which| {
        let found = match store.load(STORED[which], &mut buffer) {
            Err(StoreFault) => return None,
            Ok(None) => return Some(0),
            Ok(Some(length)) => &buffer[..length],
        };
        let place = saved[which].iter().rposition(|record| record == found);
        Some(1 + place.unwrap_or_else(|| panic!("{:?} was never saved so", STORED[which])))
    })
}

fn damaged_store(seeded: &mut Random, image: &[u8], mut saved: Saved) {
    let mut image = image.to_vec();
    let range = 0x2000;
    for _ in 0..seeded.below(6) {
        let at = seeded.below(range);
        let run = (1 + seeded.below(40)).min(range - at);
        match seeded.below(4) {
            0 => image[at] ^= 1 << seeded.below(8),
            1 => image[at..at + run].fill(0xFF),
            2 => image[at..at + run].fill(0),
            _ => {
                let from = seeded.below(range - run);
                image.copy_within(from..from + run, at);
            }
        }
    }
    let storage = Storage::from_image(&image);
    let mut before = ages(&storage, &saved);
    let mut store = FlashStore::new(storage.clone(), STORE, 0);
    for _ in 0..1 + seeded.below(2) {
        let (changed, record) = (seeded.below(4), record(seeded));
        let is_saved = block_on(store.save(STORED[changed], &record)).is_ok();
        saved[changed].push(record);
        let after = ages(&storage, &saved);
        assert!(is_saved, "this flash cannot be written any more");
        assert_eq!(after[changed], Some(saved[changed].len()));
        for (which, (before, after)) in before.iter().zip(after).enumerate() {
            let is_older = before.zip(after).is_some_and(|(old, now)| now < old);
            assert!(!is_older, "{:?} became an older one", STORED[which]);
        }
        before = after;
    }
}

/// A file of the recordings that tests use but the project does not hold; `None`, saying so, where
/// they are absent.
pub fn data(file: &str) -> Option<PathBuf> {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data")).join(file);
    if path.exists() {
        Some(path)
    } else {
        println!("skipped: {} is absent", path.display());
        None
    }
}
