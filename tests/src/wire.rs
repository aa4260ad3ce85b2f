//! Properties of `wimu-link` that hold for any input bytes: for fuzzing and for tests with seeded
//! input. Each function panics when the property is violated.

use std::num::NonZeroU8;

use wimu_model::{
    AngularRateQ20, CentiCelsius, CompiledSet, Counts, DeviceTimeUs, SpecificForceQ16, WideCounts,
};

use wimu_link::auth::{DeviceKey, KeyState, Lock, Session};
use wimu_link::batch::{self, Batch, Layout, Sample, Stream};
use wimu_link::frame::{self, Deframer, Frame, Kind, MAX_BODY, MAX_FRAME};
use wimu_link::hello::{self, Hello, LinkRole, WhoAreYou};
use wimu_link::message::{
    Answer, Command, Event, Payload, Refusal, Reply, Request, Settings, Signature, Telemetry,
};
use wimu_link::responder::{Decision, Responder};

/// Checks all properties.
pub fn all(data: &[u8]) {
    deframe(data);
    damage(data);
    batch_samples(data);
    bodies(data);
    parameters(data);
    requests(data);
    signed_requests(data);
}

/// Bytes on a line: decoding does not panic, finds the next intact frame, and gives the same result
/// byte by byte and in pieces.
pub fn deframe(data: &[u8]) {
    let mut deframer = Deframer::new();
    let mut in_pieces = Deframer::new();
    let (first, second) = data.split_at(data.len() / 3);
    let mut rest = first;
    for (index, &byte) in data.iter().enumerate() {
        if index == first.len() {
            assert_eq!(in_pieces.next(&mut rest), None);
            rest = second;
        }
        if let Some(received) = deframer.push(byte) {
            assert_eq!(in_pieces.next(&mut rest), Some(received));
            if let Ok(frame) = received {
                body(&frame);
            }
        }
    }
    assert_eq!(in_pieces.next(&mut rest), None);
    deframer.push(0);
    let mut line = [0; MAX_FRAME];
    let length = Hello::new(LinkRole::Cable).encode(&mut line).expect("room");
    let mut found = None;
    for &byte in &line[..length] {
        assert!(found.is_none());
        found = deframer.push(byte).map(|frame| frame.map(|frame| frame.kind));
    }
    assert_eq!(found, Some(Ok(Kind::Hello)));
}

/// Two frames with flipped bits and lost, repeated and moved bytes: every accepted frame is one of
/// the two.
pub fn damage(data: &[u8]) {
    let mut source = Source(data);
    let bodies = [source.slice(), source.slice()];
    let mut line = [0; 2 * MAX_FRAME];
    let mut length = 0;
    for body in bodies {
        length += frame::encode(Kind::Batch, body, &mut line[length..]).expect("room");
    }
    for _ in 0..1 + source.below(4) {
        let at = source.below(length);
        let run = source.below(length - at + 1).min(source.below(64));
        match source.byte() % 4 {
            0 => line[at] ^= 1 << (source.byte() % 8),
            1 => {
                line.copy_within(at + run..length, at);
                length -= run;
            }
            2 => {
                let to = source.below(length - run + 1);
                line.copy_within(at..at + run, to);
            }
            _ => line[at] = source.byte(),
        }
        if length == 0 {
            return;
        }
    }
    let mut deframer = Deframer::new();
    for &byte in &line[..length] {
        if let Some(Ok(frame)) = deframer.push(byte) {
            assert_eq!(frame.kind, Kind::Batch);
            assert!(bodies.contains(&frame.body), "a damaged frame was accepted");
        }
    }
}

/// Any body of any kind: decoding does not panic, and a decoded message encodes to an equal one.
pub fn bodies(data: &[u8]) {
    for kind in [
        Kind::Hello,
        Kind::WhoAreYou,
        Kind::Batch,
        Kind::Telemetry,
        Kind::Request,
        Kind::Reply,
        Kind::Inertial,
    ] {
        body(&Frame { version: frame::WIRE_VERSION, kind, body: data });
    }
}

fn body(frame: &Frame<'_>) {
    let mut line = [0; MAX_FRAME];
    match frame.kind {
        Kind::Hello => {
            if let Ok(hello) = Hello::decode(frame.body) {
                let length = hello.encode(&mut line).expect("room");
                with_body(&line[..length], |body| {
                    assert_eq!(Hello::decode(body), Ok(hello));
                });
            }
            assert!(hello::extensions(frame.body).count() <= frame.body.len());
        }
        Kind::WhoAreYou => {
            let _ = WhoAreYou::decode(frame.body);
        }
        Kind::Batch | Kind::Inertial => batch_body(frame.kind, frame.body),
        // Compared as bytes, because NaN differs from itself.
        Kind::Telemetry => {
            if let Ok(telemetry) = Telemetry::decode(frame.body)
                && !matches!(telemetry, Telemetry::Event { event: Event::Other { .. }, .. })
            {
                let length = telemetry.encode(&mut line).expect("room");
                with_body(&line[..length], |body| {
                    let mut again = [0; MAX_FRAME];
                    let telemetry = Telemetry::decode(body).expect("own frame");
                    assert_eq!(telemetry.encode(&mut again), Ok(length));
                    assert_eq!(line, again);
                });
            }
        }
        Kind::Request => {
            if let Ok(request) = Request::decode(frame.body) {
                let length = request.encode(&mut line).expect("room");
                with_body(&line[..length], |body| {
                    let mut again = [0; MAX_FRAME];
                    let request = Request::decode(body).expect("own frame");
                    assert_eq!(request.encode(&mut again), Ok(length));
                    assert_eq!(line, again);
                });
            }
        }
        Kind::Reply => {
            if let Ok(reply) = Reply::decode(frame.body)
                && !matches!(reply.answer, Answer::Refused(Refusal::Other { .. }))
            {
                let length = reply.encode(&mut line).expect("room");
                with_body(&line[..length], |body| {
                    let mut again = [0; MAX_FRAME];
                    let reply = Reply::decode(body).expect("own frame");
                    assert_eq!(reply.encode(&mut again), Ok(length));
                    assert_eq!(line, again);
                });
            }
        }
        kind => unreachable!("{kind:?} is not in `bodies`"),
    }
}

fn with_body(line: &[u8], check: impl FnOnce(&[u8])) {
    let mut deframer = Deframer::new();
    for &byte in line {
        if let Some(frame) = deframer.push(byte) {
            return check(frame.expect("own frame").body);
        }
    }
    panic!("a frame did not end");
}

/// Any bytes of a parameter set: what is read is written again with the same values, and validating it does
/// not panic.
pub fn parameters(data: &[u8]) {
    let Ok(set) = CompiledSet::from_bytes(data) else {
        return;
    };
    let mut bytes = [0; CompiledSet::MAX_BYTES];
    let length = set.to_bytes(&mut bytes);
    assert_eq!(&bytes[..length], data);
    for temperature in [None, Some(CentiCelsius(i16::MIN)), Some(CentiCelsius(i16::MAX))] {
        let force = set.corrector(temperature).correct(Counts([i16::MIN; 3]));
        if let Some(gyroscope) = set.gyroscope(temperature) {
            gyroscope.correct(Counts([i16::MAX; 3]), force);
        }
    }
}

/// Any body of a batch: a decoded batch is packed again without loss.
pub fn batch_body(kind: Kind, data: &[u8]) {
    let Ok(batch) = Batch::decode(kind, data) else {
        return;
    };
    match (batch.stream(), batch.is_wide()) {
        (Stream::Raw, false) => packed_again(&batch, counts, counts),
        (Stream::Raw, true) => packed_again(&batch, WideCounts, WideCounts),
        (Stream::Corrected, _) => packed_again(&batch, SpecificForceQ16, AngularRateQ20),
    }
}

fn counts(axes: [i32; 3]) -> Counts {
    Counts(axes.map(|value| value as i16))
}

fn packed_again<F: Sample, R>(
    batch: &Batch,
    force: impl Fn([i32; 3]) -> F,
    rate: impl Fn([i32; 3]) -> R,
) where
    (F, R): Sample,
{
    let forces: Vec<F> = batch.samples().iter().map(|&axes| force(axes)).collect();
    let rates = batch.angular_rates().iter().map(|&axes| rate(axes));
    let pairs: Vec<(F, R)> = forces.iter().copied().zip(rates).collect();
    let layout = Layout {
        sensor: batch.sensor(),
        every: NonZeroU8::new(batch.every()).expect("at least 1"),
    };
    let (sequence, time) = (batch.sequence_low().into(), DeviceTimeUs(batch.time_low().into()));
    let mut line = [0; MAX_FRAME];
    let length = if pairs.is_empty() {
        batch::encode_with(layout, sequence, time, &forces, &mut line)
    } else {
        batch::encode_with(layout, sequence, time, &pairs, &mut line)
    };
    with_batch(&line[..length.expect("room")], |again| {
        assert_eq!(again.stream(), batch.stream());
        assert_eq!(again.is_wide(), batch.is_wide());
        assert_eq!(again.sensor(), batch.sensor());
        assert_eq!(again.every(), batch.every());
        assert_eq!(again.samples(), batch.samples());
        assert_eq!(again.angular_rates(), batch.angular_rates());
        assert_eq!(again.sequence_low(), batch.sequence_low());
        assert_eq!(again.time_low(), batch.time_low());
    });
}

fn with_batch(line: &[u8], check: impl FnOnce(Batch)) {
    let mut deframer = Deframer::new();
    let frame = deframer.next(&mut &*line).expect("a frame");
    let frame = frame.expect("own frame");
    check(Batch::decode(frame.kind, frame.body).expect("own batch"));
}

/// Any samples of any sensor: packing and unpacking is lossless.
pub fn batch_samples(data: &[u8]) {
    let mut source = Source(data);
    let count = 1 + source.below(batch::MAX_BATCH);
    let start: [u32; 6] = std::array::from_fn(|_| source.word());
    let narrow = source.below(33) as u32;
    let layout = Layout { sensor: source.byte() % 8, every: NonZeroU8::MIN };
    let sequence = source.word();
    let time = DeviceTimeUs(source.word().into());
    let mut near = || {
        start.map(|start| start.wrapping_add(source.word().checked_shr(narrow).unwrap_or(0)) as i32)
    };
    let samples: Vec<[[i32; 3]; 2]> = (0..count)
        .map(|_| {
            let [x, y, z, p, q, r] = near();
            [[x, y, z], [p, q, r]]
        })
        .collect();
    let raw: Vec<_> = samples.iter().map(|s| counts(s[0])).collect();
    lossless(layout, sequence, time, &raw);
    let corrected: Vec<_> = samples.iter().map(|s| SpecificForceQ16(s[0])).collect();
    lossless(layout, sequence, time, &corrected);
    let wide: Vec<_> = samples.iter().map(|s| WideCounts(s[0])).collect();
    lossless(layout, sequence, time, &wide);
    let six: Vec<_> = samples.iter().map(|s| (counts(s[0]), counts(s[1]))).collect();
    lossless(layout, sequence, time, &six);
    let six = samples.iter().map(|s| s.map(WideCounts).into());
    lossless::<(_, _)>(layout, sequence, time, &six.collect::<Vec<_>>());
    let six = samples.iter().map(|s| (SpecificForceQ16(s[0]), AngularRateQ20(s[1])));
    lossless(layout, sequence, time, &six.collect::<Vec<_>>());
}

fn lossless<S: Sample>(layout: Layout, sequence: u32, time: DeviceTimeUs, samples: &[S]) {
    let samples = &samples[..samples.len().min(S::MOST)];
    let mut line = [0; MAX_FRAME];
    let length = batch::encode_with(layout, sequence, time, samples, &mut line).expect("room");
    with_batch(&line[..length], |batch| {
        let found = [batch.samples(), batch.angular_rates()];
        for axis in 0..S::AXES {
            let found = found[axis / 3].iter().map(|axes| axes[axis % 3]);
            assert!(found.eq(samples.iter().map(|sample| sample.axis(axis))));
        }
        assert_eq!(batch::extend_sequence(batch.sequence_low(), sequence), sequence);
        assert_eq!(batch::extend_time(batch.time_low(), time), time);
    });
}

const UNKNOWN: Answer = Answer::Unknown;

const NO_KEY: Lock =
    Lock { key: KeyState::None, device_id: 1, boot_count: Some(1), entropy: [0; 16] };

/// Unsigned requests of three sessions, repeated and reordered, mixed with other bytes: each write is
/// executed at most once, repeats get the same reply, and no write is accepted over the wireless link.
pub fn requests(data: &[u8]) {
    let mut source = Source(data);
    let role = if source.byte() % 2 == 0 { LinkRole::Cable } else { LinkRole::Wireless };
    let mut responder = Responder::new(role);
    // By session and id.
    let mut executed = [[false; 8]; 3];
    let mut replied = [const { [const { None::<Vec<u8>> }; 8] }; 3];
    let mut pending: Option<(usize, usize)> = None;
    while !source.0.is_empty() {
        if source.byte() % 4 == 0
            && let Some((session, id)) = pending.take()
        {
            let answer: Answer = Answer::Accepted(Payload::None);
            let mut frame = [0; MAX_FRAME];
            let frame = responder.reply(&answer, &mut frame);
            assert!(!frame.is_empty());
            replied[session][id] = Some(frame.to_vec());
        }
        if source.byte() % 16 == 0 {
            let garbage = source.slice();
            if Request::decode(garbage).is_err() {
                assert!(!matches!(responder.accept(garbage, &NO_KEY), Decision::Execute(_)));
            }
            // Random bytes may hold a valid head of one of the sessions.
            return;
        }
        let (session, id) = (source.below(3), source.below(8));
        let request = Request {
            session: session as u32,
            id: id as u32,
            signature: Signature::NONE,
            command: if id % 2 == 0 {
                Command::SetSettings(Settings::default())
            } else {
                Command::GetStatus
            },
        };
        let mut line = [0; MAX_FRAME];
        let length = request.encode(&mut line).expect("room");
        with_body(&line[..length], |body| {
            match responder.accept(body, &NO_KEY) {
                Decision::Execute(command) => {
                    // Reads may be executed again.
                    let again = executed[session][id] && command.is_write();
                    assert!(!again, "a request had two effects");
                    assert!(role == LinkRole::Cable || !command.is_write());
                    assert_eq!(pending, None);
                    executed[session][id] = true;
                    pending = Some((session, id));
                }
                Decision::Send(frame) => {
                    let stale = {
                        let mut reply = None;
                        with_body(frame, |body| reply = Reply::decode(body).ok());
                        let reply = reply.expect("own reply");
                        assert_eq!((reply.session, reply.id), (request.session, request.id));
                        reply.answer == Answer::Refused(Refusal::Stale)
                    };
                    if let Some(before) = &replied[session][id] {
                        assert!(stale || before == frame, "two answers to one request");
                    }
                }
                Decision::Ignore => assert!(pending.is_some()),
            }
        });
    }
}

/// Signed requests sent at most.
const SENT: usize = 6;

/// A device with a key on the wireless link, and two sessions of its owner.
struct Signing {
    lock: Lock,
    responder: Responder,
    sessions: [Option<(Session, u32)>; 2],
    /// Bodies of the requests sent, and whether each was executed.
    sent: Vec<(Vec<u8>, bool)>,
}

impl Signing {
    /// Opening a session takes no signature.
    fn open(&mut self, which: usize, number: u32) {
        let (signature, command) = (Signature::NONE, Command::OpenSession);
        let request = Request { session: number, id: 1, signature, command };
        let body = body_of(&request);
        let Decision::Send(frame) = self.responder.accept(&body, &self.lock) else { return };
        let mut reply = None;
        with_body(frame, |body| reply = Some(Reply::decode(body).expect("own reply")));
        if let Some(Reply { answer: Answer::Accepted(Payload::Session { number, nonce }), .. }) =
            reply
            && let KeyState::Set(key) = self.lock.key
        {
            let (role, device_id) = (LinkRole::Wireless, self.lock.device_id);
            let session = Session { key, role, device_id, number, nonce };
            let id = self.sessions[which].map_or(u32::MAX - 1, |(_, id)| id);
            self.sessions[which] = Some((session, id));
        }
    }

    /// Signs the next request of a session, whose command tells its number.
    fn sign(&mut self, which: usize) {
        let Some((session, id)) = &mut self.sessions[which] else { return };
        *id = id.wrapping_add(1);
        let command = Command::SetLineRate { baud: self.sent.len() as u32 };
        let signature = session.sign(*id, &command);
        let request = Request { session: session.number, id: *id, signature, command };
        self.sent.push((body_of(&request), false));
    }

    /// Sends a request with `flip` at one byte.
    fn send(&mut self, chosen: usize, (at, flip): (usize, u8)) {
        let (sent, executed) = &mut self.sent[chosen];
        let mut body = sent.clone();
        body[at] ^= flip;
        let Decision::Execute(command) = self.responder.accept(&body, &self.lock) else { return };
        if command.is_write() {
            assert!(flip == 0, "an unsigned write was executed");
            assert_eq!(command, Command::SetLineRate { baud: chosen as u32 });
            assert!(!*executed, "a request had two effects");
            *executed = true;
        }
        assert!(!self.responder.reply(&UNKNOWN, &mut [0; MAX_FRAME]).is_empty());
    }
}

fn body_of(request: &Request) -> Vec<u8> {
    let mut line = [0; MAX_FRAME];
    let length = request.encode(&mut line).expect("room");
    let mut body = Vec::new();
    with_body(&line[..length], |bytes| body.extend_from_slice(bytes));
    body
}

/// Signed requests, damaged, repeated and reordered, mixed with other bytes: only intact signed writes
/// are executed, each once.
pub fn signed_requests(data: &[u8]) {
    let mut source = Source(data);
    let key = DeviceKey::new([source.byte(); 32]);
    let mut device = Signing {
        lock: Lock { key: KeyState::Set(key), ..NO_KEY },
        responder: Responder::new(LinkRole::Wireless),
        sessions: [None; 2],
        sent: Vec::new(),
    };
    while !source.0.is_empty() {
        let which = source.below(2);
        match source.byte() % 4 {
            0 => device.open(which, source.word()),
            1 if device.sent.len() < SENT && device.sessions[which].is_some() => device.sign(which),
            choice if !device.sent.is_empty() => {
                let chosen = source.below(device.sent.len());
                let length = device.sent[chosen].0.len();
                let change = (choice == 2).then(|| (source.below(length), source.byte()));
                device.send(chosen, change.unwrap_or((0, 0)));
            }
            _ => {
                let garbage = source.slice();
                if let Decision::Execute(command) = device.responder.accept(garbage, &device.lock) {
                    assert!(!command.is_write(), "an unsigned write was executed");
                    device.responder.reply(&UNKNOWN, &mut [0; MAX_FRAME]);
                }
            }
        }
    }
}

/// Numbers taken from bytes; zeros after the last byte.
struct Source<'a>(&'a [u8]);

impl<'a> Source<'a> {
    fn byte(&mut self) -> u8 {
        match self.0.split_first() {
            Some((&byte, rest)) => {
                self.0 = rest;
                byte
            }
            None => 0,
        }
    }

    fn word(&mut self) -> u32 {
        u32::from_le_bytes(std::array::from_fn(|_| self.byte()))
    }

    /// A number below `limit`; 0 for a limit of 0.
    fn below(&mut self, limit: usize) -> usize {
        usize::from(u16::from_le_bytes([self.byte(), self.byte()])) % limit.max(1)
    }

    fn slice(&mut self) -> &'a [u8] {
        let length = self.below(MAX_BODY + 1).min(self.0.len());
        let (slice, rest) = self.0.split_at(length);
        self.0 = rest;
        slice
    }
}
