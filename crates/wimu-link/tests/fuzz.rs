//! The fuzz bodies on seeded bytes: random ones, and frames with faults.

use wimu_link::frame::{self, Deframer};
use wimu_link::hello::{Hello, LinkRole, WhoAreYou};
use wimu_link::message::{Command, Environment, Request, Settings, Status, Telemetry};
use wimu_link::{MAX_FRAME, batch, fuzz};
use wimu_model::{Counts, DeviceTimeUs};
use wimu_testkit::{Random, trials};

/// Up to `longest` bytes. Small numbers look more like messages than even ones do.
fn message_like(random: &mut Random, longest: usize) -> Vec<u8> {
    let length = random.below(longest + 1);
    let mask = [0xff, 0x7f, 0x0f, 0x03][random.below(4)];
    (0..length).map(|_| random.bits() as u8 & mask).collect()
}

/// One of each frame that a session has.
fn frames() -> Vec<Vec<u8>> {
    let mut frames = Vec::new();
    let mut keep = |encode: &dyn Fn(&mut [u8]) -> Result<usize, frame::EncodeError>| {
        let mut line = [0; MAX_FRAME];
        let length = encode(&mut line).unwrap();
        frames.push(line[..length].to_vec());
    };
    let samples: Vec<_> = (0..20)
        .map(|k| Counts([k, -k * k, 16384 + 3 * k]))
        .collect();
    keep(&|line| Hello::new(LinkRole::Wireless).encode(line));
    keep(&|line| WhoAreYou::default().encode(line));
    keep(&|line| batch::encode(1, DeviceTimeUs(2), &samples, line));
    keep(&|line| <Telemetry>::Environment(Environment::default()).encode(line));
    keep(&|line| <Telemetry>::Status(Status::default()).encode(line));
    keep(&|line| {
        Request {
            session: 1,
            id: 2,
            signature: Default::default(),
            command: Command::SetSettings(Settings::default()),
        }
        .encode(line)
    });
    frames
}

#[test]
fn random_bytes_find_no_fault() {
    let mut seeded = Random::new(1);
    for _ in 0..trials(200_000) {
        fuzz::all(&message_like(&mut seeded, 600));
    }
}

#[test]
fn damaged_messages_find_no_fault() {
    let mut seeded = Random::new(2);
    let frames = frames();
    for _ in 0..trials(200_000) {
        let mut line: Vec<u8> = (0..1 + seeded.below(3))
            .flat_map(|_| frames[seeded.below(frames.len())].clone())
            .collect();
        for _ in 0..seeded.below(3) {
            let at = seeded.below(line.len());
            line[at] = seeded.bits() as u8;
        }
        fuzz::deframe(&line);
        // Damage below the frame, as a faulty sender would do it.
        let mut deframer = Deframer::new();
        let frame = &frames[seeded.below(frames.len())];
        let Some(Ok(frame)) = frame.iter().find_map(|&byte| {
            deframer
                .push(byte)
                .map(|frame| frame.map(|frame| frame.body.to_vec()))
        }) else {
            panic!("an own frame was refused");
        };
        let mut body = frame;
        for _ in 0..seeded.below(4) {
            let at = seeded.below(body.len());
            body[at] = seeded.bits() as u8;
        }
        body.truncate(body.len() - seeded.below(3).min(body.len()));
        fuzz::bodies(&body);
    }
}
