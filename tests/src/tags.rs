//! Properties of the authentication of telemetry that hold for any frames and faults: for fuzzing and for tests with
//! seeded input.

use std::collections::BTreeMap;

use wimu_host::decode::{Authenticity, Decoder, Event};
use wimu_link::auth::{DeviceKey, KeyState, Lock};
use wimu_link::frame::{self, Kind};
use wimu_link::message::{Environment, Epoch, Telemetry};
use wimu_link::tag::Tagger;
use wimu_link::{Hello, LinkRole};

use super::{Random, encoded};

const DEVICE: u64 = 0x1234;

/// What happened to an interval on its way.
#[derive(Clone, Copy, Debug, Default)]
struct Fate {
    lost: u32,
    forged: u32,
    /// The device sent two equal frames: one of them could be a repetition.
    has_equal: bool,
    repeated: bool,
    tag_lost: bool,
}

/// Frames of a link that are lost, repeated and forged, tags too: an interval is verified only if all its frames arrived
/// as they were sent, and called forged only if one of its frames was forged.
pub fn fuzz_tags(seeded: &mut Random) {
    let key = DeviceKey::new(core::array::from_fn(|_| seeded.bits() as u8));
    let lock = Lock {
        key: KeyState::Set(key),
        device_id: DEVICE,
        boot_count: Some(seeded.bits() as u32),
        ..Lock::default()
    };
    let mut tagger = Tagger::new(LinkRole::Wireless);
    let [loss, repeats, forgery] = [0, 0, 0].map(|_| [0, 0, 5, 40][seeded.below(4)]);
    let mut line = Vec::new();
    let mut fates: BTreeMap<u32, Fate> = BTreeMap::new();
    let mut number = 1;
    let mut sent = Vec::new();
    for index in 0..1 + seeded.below(150) as u64 {
        let greeting = Hello {
            device_id: DEVICE,
            boot_count: lock.boot_count.unwrap_or_default(),
            ..Hello::new(LinkRole::Wireless)
        };
        let frame = match seeded.below(8) {
            _ if index == 0 => encoded(|line| greeting.encode(line)),
            0 | 1 => {
                let time_us = index * 1000;
                let epoch = Epoch { time_us, ..Epoch::default() };
                encoded(|line| Telemetry::Epoch(epoch).encode(line))
            }
            // Now and then two frames of an interval are equal.
            kind => {
                let environment = Environment {
                    time_us: if kind == 2 { 1_000_000 + u64::from(number) } else { index },
                    ..Environment::default()
                };
                encoded(|line| Telemetry::Environment(environment).encode(line))
            }
        };
        let cut = seeded.below(frame.len());
        assert_eq!(tagger.sent(&frame[..cut], false, || lock), None);
        let tag = tagger.sent(&frame[cut..], true, || lock);
        let fate = fates.entry(number).or_default();
        fate.has_equal |= sent.contains(&frame);
        sent.push(frame.clone());
        let is_greeting = index == 0;
        if !is_greeting && seeded.below(100) < loss {
            fate.lost += 1;
        } else if !is_greeting && seeded.below(100) < forgery {
            fate.forged += 1;
            let body = seeded.bytes(9);
            line.extend(encoded(|line| frame::encode(Kind::Telemetry, &body, line)));
        } else {
            let copies = 1 + usize::from(seeded.below(100) < repeats);
            fate.repeated |= copies > 1;
            (0..copies).for_each(|_| line.extend(&frame));
        }
        if let Some(tag) = tag {
            assert_eq!(tag.number, number);
            fate.tag_lost = seeded.below(100) < loss;
            if !fate.tag_lost {
                line.extend(encoded(|line| Telemetry::Tag(tag).encode(line)));
            }
            number += 1;
            sent.clear();
        }
    }
    assert_judged_rightly(&line, key, &fates);
}

impl Fate {
    /// Whether a host cannot tell a repetition by the link from a frame that was sent twice.
    fn is_ambiguous(&self) -> bool {
        self.has_equal && (self.forged > 0 || self.repeated)
    }
}

fn assert_judged_rightly(line: &[u8], key: DeviceKey, fates: &BTreeMap<u32, Fate>) {
    let mut decoder = Decoder::new();
    decoder.use_keys(vec![DeviceKey::new([0; 32]), key]);
    let mut judged = BTreeMap::new();
    decoder.push(0, line, |arrival| {
        if let Event::Tagged(interval) = arrival.event {
            judged.insert(interval.number, interval.authenticity);
        }
    });
    for (number, fate) in fates {
        let Some(&authenticity) = judged.get(number) else {
            continue;
        };
        let context = format!("interval {number} of {fates:?}: {authenticity:?}");
        let before = fates.get(&(number - 1)).copied();
        let follows = before.is_some_and(|before| !before.tag_lost);
        let is_ambiguous = fate.is_ambiguous();
        match authenticity {
            // The repetition of a frame is as good as an equal one that was lost.
            Authenticity::Verified => {
                assert!(fate.forged == 0 && (fate.lost == 0 || is_ambiguous), "{context}")
            }
            Authenticity::Forged => assert!(fate.forged > 0, "{context}"),
            // A repetition may be among the latest frames of an interval whose beginning is unknown.
            Authenticity::Incomplete => {
                assert!(fate.lost > 0 || !follows || is_ambiguous, "{context}")
            }
            other => panic!("{other:?} {context}"),
        }
        if follows && fate.lost == 0 && !is_ambiguous {
            let expected = match fate.forged {
                0 => Authenticity::Verified,
                _ => Authenticity::Forged,
            };
            assert_eq!(authenticity, expected, "{context}");
        }
    }
}
