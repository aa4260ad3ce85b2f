//! Authenticated telemetry: what the tags of a board show about bytes that were lost, repeated, forged and replayed.

use std::num::NonZeroU8;

use wimu_host::authentication::Authentication;
use wimu_host::capture::Capture;
use wimu_host::decode::{Authenticity, Decoder, Event, Interval};
use wimu_host::mcap_file::{ClockAnchor, RecordingWriter};
use wimu_link::auth::DeviceKey;
use wimu_link::batch::{self, Batch, Layout, Stream};
use wimu_link::frame::{Deframer, Kind};
use wimu_link::message::Telemetry;
use wimu_link::{Answer, Command, LinkRole};
use wimu_model::{Counts, DeviceTimeUs};
use wimu_sim::board::BoardConfig;
use wimu_sim::scene::World;
use wimu_testkit::{Lane, figure};
use wimu_tests::tags::fuzz_tags;
use wimu_tests::{ROLES, Random, Rig, encoded, sensor, who_are_you};

const KEY: DeviceKey = DeviceKey::new([0x5a; 32]);
const OTHER: DeviceKey = DeviceKey::new([0x5b; 32]);
const CABLE: LinkRole = LinkRole::Cable;
const WIRELESS: LinkRole = LinkRole::Wireless;

/// A board with the key that has restarted, so that everything since is tagged.
fn rig() -> Rig {
    let source = sensor("rest,hand", World::default(), 5);
    let mut rig = Rig::new(BoardConfig::default(), source);
    rig.run(1.0);
    let answer = rig.ask(CABLE, Command::SetKey(KEY));
    assert!(matches!(answer, Answer::Accepted(_)), "{answer:?}");
    restart(&mut rig);
    rig
}

fn restart(rig: &mut Rig) {
    rig.restart();
    rig.run(0.2);
    rig.send(WIRELESS, &who_are_you());
}

/// What a link brings in this time, whole frames.
fn frames(rig: &mut Rig, role: LinkRole, seconds: f64) -> Vec<Vec<u8>> {
    let before = rig.link(role).bytes().len();
    rig.run(seconds);
    let bytes = rig.link(role).bytes();
    let frames = bytes[before..].split_inclusive(|&byte| byte == 0);
    frames.map(<[u8]>::to_vec).collect()
}

fn judged_with(keys: &[DeviceKey], frames: &[Vec<u8>]) -> Vec<(usize, Interval)> {
    let mut decoder = Decoder::new();
    decoder.use_keys(keys.to_vec());
    let mut intervals = Vec::new();
    for (index, frame) in frames.iter().enumerate() {
        decoder.push(index as u64 * 10_000_000, frame, |arrival| {
            if let Event::Tagged(interval) = arrival.event {
                intervals.push((index, interval));
            }
        });
    }
    intervals
}

fn judged(frames: &[Vec<u8>]) -> Vec<(usize, Interval)> {
    judged_with(&[OTHER, KEY], frames)
}

fn count(intervals: &[(usize, Interval)], authenticity: Authenticity) -> usize {
    let same = |(_, interval): &&(usize, Interval)| interval.authenticity == authenticity;
    intervals.iter().filter(same).count()
}

fn opened<R>(frame: &[u8], read: impl FnOnce(Kind, &[u8]) -> R) -> Option<R> {
    let mut bytes = frame;
    let mut deframer = Deframer::new();
    let frame = deframer.next(&mut bytes)?.ok()?;
    Some(read(frame.kind, frame.body))
}

fn is_tag(frame: &[u8]) -> bool {
    let tag = |kind, body: &[u8]| {
        kind == Kind::Telemetry && matches!(Telemetry::decode(body), Ok(Telemetry::Tag(_)))
    };
    opened(frame, tag) == Some(true)
}

/// The frame of a batch of raw samples with another first sample.
fn forged(frame: &[u8]) -> Option<Vec<u8>> {
    let batch = opened(frame, |kind, body| Batch::decode(kind, body).ok())??;
    let mut counts: Vec<Counts> = batch.counts().collect();
    counts.first_mut()?.0[2] ^= 1;
    let every = NonZeroU8::new(batch.every())?;
    let layout = Layout { sensor: 0, every };
    let (sequence, time) = (batch.sequence_low().into(), u64::from(batch.time_low()));
    let time = DeviceTimeUs(time);
    let is_raw = batch.stream() == Stream::Raw;
    is_raw.then(|| encoded(|line| batch::encode_with(layout, sequence, time, &counts, line)))
}

#[test]
fn what_a_board_with_a_key_sends_is_verified_on_both_links_and_without_a_key_has_no_tags() {
    let mut rig = rig();
    let before = rig.link(WIRELESS).bytes().len();
    let cable = frames(&mut rig, CABLE, 12.0);
    let wireless = rig.link(WIRELESS).bytes()[before..].to_vec();
    let wireless = wireless.split_inclusive(|&byte| byte == 0);
    let intervals = judged(&wireless.map(<[u8]>::to_vec).collect::<Vec<_>>());
    assert!(intervals.len() >= 11, "{intervals:?}");
    assert_eq!(count(&intervals[1..], Authenticity::Verified), intervals.len() - 1);
    // Another link's tags are made with another key; without a greeting nothing can be verified.
    assert_eq!(count(&judged(&cable), Authenticity::Verified), 0);
    let unknown = judged_with(&[OTHER], &frames(&mut rig, CABLE, 3.0));
    let key = Authenticity::UnknownKey(KEY.id());
    assert!(unknown.len() >= 2 && count(&unknown, key) == unknown.len());

    // Before it is known which keys there are, no tag is judged.
    let mut decoder = Decoder::new();
    for frame in &cable {
        decoder.push(0, frame, |arrival| {
            assert!(!matches!(arrival.event, Event::Tagged(_)), "{arrival:?}");
        });
    }

    let mut without = Rig::usual();
    without.run(5.0);
    for role in ROLES {
        assert_eq!(without.link(role).record().authentication.text(), None);
    }
}

#[test]
fn a_forged_sample_is_detected_by_the_next_epoch() {
    let sent = frames(&mut rig(), WIRELESS, 8.0);
    let tags: Vec<usize> = (0..sent.len()).filter(|&at| is_tag(&sent[at])).collect();
    let mut tried = 0;
    for at in tags[1] + 1..tags[tags.len() - 1] {
        let Some(other) = forged(&sent[at]) else {
            continue;
        };
        let mut frames = sent.clone();
        frames[at] = other.clone();
        let detected = |frames: &[Vec<u8>]| {
            let intervals = judged(frames);
            assert_eq!(count(&intervals, Authenticity::Forged), 1);
            let forged =
                |(_, interval): &&(usize, Interval)| interval.authenticity == Authenticity::Forged;
            let at = intervals.iter().find(forged).map(|(at, _)| *at);
            // All others are verified.
            assert_eq!(count(&intervals[1..], Authenticity::Verified), intervals.len() - 2);
            at
        };
        let next = tags.iter().copied().find(|&tag| tag > at);
        assert_eq!(detected(&frames), next, "replaced");
        // One more beside the genuine one, and right after a tag.
        for at in [at, tags[1] + 1] {
            let mut frames = sent.clone();
            frames.insert(at, other.clone());
            let next = tags.iter().find(|&&tag| tag >= at).map(|tag| tag + 1);
            assert_eq!(detected(&frames), next, "inserted");
        }
        tried += 1;
    }
    figure("forged samples that the next tag does not show", format!("0 of {tried}"), "none", true);
    assert!(tried > 20, "{tried}");
}

#[test]
fn a_lost_or_repeated_frame_is_not_called_forged() {
    let sent = frames(&mut rig(), WIRELESS, 6.0);
    let tags = judged(&sent).len();
    for at in 1..sent.len() {
        let mut frames = sent.clone();
        frames.remove(at);
        let intervals = judged(&frames);
        assert_eq!(count(&intervals, Authenticity::Forged), 0, "{at}");
        assert!(count(&intervals, Authenticity::Verified) >= tags - 3, "{at}");
        let mut frames = sent.clone();
        frames.insert(at, sent[at].clone());
        assert!(count(&judged(&frames), Authenticity::Verified) >= tags - 1, "{at}");
    }
    // Delayed past the tag of its interval: that one cannot be verified, the next one can.
    let late =
        (1..sent.len()).rfind(|&at| opened(&sent[at], |kind, _| kind.is_batch()) == Some(true));
    let tag = (0..late.expect("a batch")).rfind(|&at| is_tag(&sent[at])).expect("a tag");
    let batch = (0..tag).rfind(|&at| forged(&sent[at]).is_some()).expect("a batch");
    let mut frames = sent.clone();
    let delayed = frames.remove(batch);
    frames.insert(tag + 1, delayed);
    let intervals = judged(&frames);
    assert_eq!(count(&intervals, Authenticity::Forged), 0);
}

#[test]
fn a_replayed_interval_of_an_earlier_start_is_refused() {
    let mut rig = rig();
    let old = frames(&mut rig, WIRELESS, 5.0);
    restart(&mut rig);
    let new = frames(&mut rig, WIRELESS, 5.0);
    let whole = judged(&new);
    assert!(count(&whole, Authenticity::Verified) >= 4, "{whole:?}");
    // Intervals of the old start after one of the new: in place of those that follow, and between them.
    let old_tags: Vec<usize> = judged(&old).iter().map(|(at, _)| *at).collect();
    let interval = &old[old_tags[1] + 1..=old_tags[2]];
    let at = whole[1].0 + 1;
    for rest in [&new[at..], &[]] {
        let mixed = [&new[..at], interval, rest].concat();
        let intervals = judged(&mixed);
        assert_eq!(count(&intervals, Authenticity::Replayed), 1, "{intervals:?}");
        // What was replayed is not part of the interval that it came in.
        let forged = usize::from(!rest.is_empty());
        assert_eq!(count(&intervals, Authenticity::Forged), forged);
    }
    // An interval of the same start again, later.
    let again = &new[whole[0].0 + 1..=whole[1].0];
    let at = whole[2].0 + 1;
    let intervals = judged(&[&new[..at], again, &new[at..]].concat());
    assert_eq!(count(&intervals, Authenticity::Replayed), 1, "{intervals:?}");
    assert_eq!(count(&intervals, Authenticity::Forged), 1, "{intervals:?}");
}

/// What `wimu info` sees of a recording of these frames.
fn surveyed(frames: &[Vec<u8>], keys: Vec<DeviceKey>) -> Authentication {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("session.mcap");
    let anchor = ClockAnchor { monotonic_ns: 0, utc_ns: 1_700_000_000_000_000_000 };
    let mut writer = RecordingWriter::create(&path, anchor).expect("a file");
    for (index, frame) in frames.iter().enumerate() {
        let host_ns = index as u64 * 10_000_000;
        writer.append(WIRELESS, host_ns, frame).expect("room");
    }
    writer.finish().expect("room");
    let recording = Capture::survey(&path, keys).expect("own file");
    recording.links.first_key_value().expect("a link").1.authentication.clone()
}

#[test]
fn a_recording_is_verified_afterwards_and_its_forged_second_is_named() {
    let mut sent = frames(&mut rig(), WIRELESS, 8.0);
    let genuine = surveyed(&sent, vec![KEY]);
    assert!(genuine.verified >= 6, "{genuine:?}");
    assert!(genuine.findings().next().is_none(), "{genuine:?}");
    assert!(genuine.verified_s > 0.8 * genuine.total_s, "{genuine:?}");
    let at = (sent.len() / 2..sent.len()).find(|&at| forged(&sent[at]).is_some());
    let at = at.expect("a batch");
    sent[at] = forged(&sent[at]).expect("a batch");
    let changed = surveyed(&sent, vec![KEY]);
    assert_eq!((changed.forged, changed.findings().count()), (1, 1));
    assert_eq!(changed.verified, genuine.verified - 1);
    let [from_s, to_s] =
        changed.findings().next().and_then(|finding| finding.place.span_s).expect("a time");
    assert!(from_s > 1.0 && to_s < 9.0 && to_s - from_s < 1.2, "{changed:?}");
    let text = surveyed(&sent, Vec::new()).text().expect("tags");
    assert!(text.contains("lacks the key"), "{text}");
}

#[test]
fn no_faults_of_a_link_make_an_interval_forged_and_no_forgery_is_verified() {
    let mut seeded = Random::new(0x7a6);
    for _ in 0..Lane::current().choose([100, 1000, 50_000]) {
        fuzz_tags(&mut seeded);
    }
}
