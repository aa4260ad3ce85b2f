//! The properties of `wimu_tests::wire` on damaged frames of every kind.

use wimu_link::frame::{self, Deframer};
use wimu_link::hello::{Hello, LinkRole, WhoAreYou};
use wimu_link::message::{Command, Environment, Request, Settings, Status, Telemetry};
use wimu_link::{MAX_FRAME, batch};
use wimu_model::{Counts, DeviceTimeUs};
use wimu_testkit::{Random, trials};
use wimu_tests::wire;

/// One of each frame that a session has.
fn frames() -> Vec<Vec<u8>> {
    let mut frames = Vec::new();
    let mut keep = |encode: &dyn Fn(&mut [u8]) -> Result<usize, frame::EncodeError>| {
        let mut line = [0; MAX_FRAME];
        let length = encode(&mut line).unwrap();
        frames.push(line[..length].to_vec());
    };
    let samples: Vec<_> = (0..20).map(|k| Counts([k, -k * k, 16384 + 3 * k])).collect();
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
        wire::deframe(&line);
        // Damage inside an intact frame, as a faulty sender produces it.
        let mut deframer = Deframer::new();
        let frame = &frames[seeded.below(frames.len())];
        let Some(Ok(frame)) = frame.iter().find_map(|&byte| {
            deframer.push(byte).map(|frame| frame.map(|frame| frame.body.to_vec()))
        }) else {
            panic!("an own frame was refused");
        };
        let mut body = frame;
        for _ in 0..seeded.below(4) {
            let at = seeded.below(body.len());
            body[at] = seeded.bits() as u8;
        }
        body.truncate(body.len() - seeded.below(3).min(body.len()));
        wire::bodies(&body);
    }
}
