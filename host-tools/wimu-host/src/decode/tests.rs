use proptest::prelude::*;
use wimu_link::hello::LinkRole;
use wimu_link::message::EpochReason;
use wimu_link::{MAX_FRAME, Telemetry};
use wimu_model::Counts;

use super::anchor::MAX_AHEAD_US;
use super::batches::MAX_UNPLACED;
use super::gaps::Gaps;
use super::*;

const PERIOD_US: u64 = 10_000;

fn framed(
    encode: impl FnOnce(&mut [u8]) -> Result<usize, wimu_link::frame::EncodeError>,
) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let length = encode(&mut frame).unwrap();
    frame[..length].to_vec()
}

fn hello(boot_count: u32) -> Vec<u8> {
    hello_at(boot_count, 0)
}

fn hello_at(boot_count: u32, uptime_us: u64) -> Vec<u8> {
    let hello = Hello { boot_count, uptime_us, ..Hello::new(LinkRole::Wireless) };
    framed(|frame| hello.encode(frame))
}

fn epoch(sequence: u32, time_us: u64) -> Vec<u8> {
    numbered_epoch(0, sequence, time_us)
}

fn numbered_epoch(number: u8, sequence: u32, time_us: u64) -> Vec<u8> {
    let epoch = <Telemetry>::Epoch(Epoch {
        reason: EpochReason::Periodic,
        number,
        sequence,
        time_us,
        period_ns: PERIOD_US as u32 * 1000,
        range_g: 2,
        sensitivity_lsb_per_g: 16384.0,
        full_scale: 32752,
        parameters: 0,
        temperature_centi_c: None,
        ..Epoch::default()
    });
    framed(|frame| epoch.encode(frame))
}

/// The sample of a sequence number: tells which one it is.
fn value(sequence: u32) -> [i32; 3] {
    [sequence as i16, (sequence >> 16) as i16, 16384].map(i32::from)
}

/// Samples from a device whose sample 0 was at 1 s.
fn samples(first: u32, count: u32) -> Vec<u8> {
    samples_of(0, first, count)
}

/// The same of a start, which Z tells.
fn samples_of(start: i16, first: u32, count: u32) -> Vec<u8> {
    let counts: Vec<_> = (first..first + count)
        .map(|s| {
            let [x, y, z] = value(s).map(|v| v as i16);
            Counts([x, y, z + start])
        })
        .collect();
    framed(|frame| batch::encode(first, DeviceTimeUs(time(first)), &counts, frame))
}

fn navigation(sequence: u32) -> Vec<u8> {
    let state = wimu_integrator::Navigation::default();
    let navigation = <Telemetry>::Navigation(Navigation::new(sequence, &state));
    framed(|frame| navigation.encode(frame))
}

fn environment(time_us: u64) -> Vec<u8> {
    let environment = <Telemetry>::Environment(Environment { time_us, ..Environment::default() });
    framed(|frame| environment.encode(frame))
}

fn positions(events: &[Event]) -> Vec<u32> {
    let position = |event: &Event| match event {
        Event::Navigation(navigation) => Some(navigation.sequence),
        _ => None,
    };
    events.iter().filter_map(position).collect()
}

fn fields(events: &[Event]) -> usize {
    let is_field = |event: &&Event| matches!(event, Event::Environment(_));
    events.iter().filter(is_field).count()
}

fn time(sequence: u32) -> u64 {
    1_000_000 + u64::from(sequence) * PERIOD_US
}

fn decode(decoder: &mut Decoder, frames: &[Vec<u8>]) -> Vec<Event> {
    let mut events = Vec::new();
    for frame in frames {
        decoder.push(0, frame, |arrival| events.push(arrival.event));
    }
    events
}

fn sequences(events: &[Event]) -> Vec<u32> {
    let mut found = Vec::new();
    for event in events {
        if let Event::Samples(samples) = event {
            for sample in samples.iter() {
                assert_eq!(sample.value[..2], value(sample.sequence)[..2]);
                assert_eq!(sample.time.0, time(sample.sequence));
                found.push(sample.sequence);
            }
        }
    }
    found
}

/// Sensor 1 with its own numbers: `ahead` of those of sensor 0 at the same times.
fn further_epoch(ahead: u32, sequence: u32) -> Vec<u8> {
    let epoch = <Telemetry>::Epoch(Epoch {
        sequence: sequence + ahead,
        time_us: time(sequence),
        period_ns: PERIOD_US as u32 * 1000,
        range_g: 200,
        sensitivity_lsb_per_g: 160.0,
        full_scale: 32767,
        sensor: 1,
        ..Epoch::default()
    });
    framed(|frame| epoch.encode(frame))
}

fn further(ahead: u32, first: u32, count: u32) -> Vec<u8> {
    let pair = |s| (Counts([s as i16; 3]), Counts([-(s as i16); 3]));
    let samples: Vec<_> = (first..first + count).map(pair).collect();
    let layout = batch::Layout { sensor: 1, every: std::num::NonZeroU8::MIN };
    let at = DeviceTimeUs(time(first));
    framed(|frame| batch::encode_with(layout, first + ahead, at, &samples, frame))
}

#[test]
fn a_further_sensor_has_its_own_numbers_gaps_and_repeats() {
    let mut decoder = Decoder::new();
    let mut heard = Vec::new();
    let mut late = Vec::new();
    for (boot, ahead) in [(1, 70_000), (2, 5)] {
        let frames = [
            hello(boot),
            further(ahead, 0, 8),
            epoch(0, time(0)),
            samples_of(boot as i16, 0, 16),
            further_epoch(ahead, 0),
            further(ahead, 16, 8),
            samples_of(boot as i16, 16, 16),
            further(ahead, 8, 8),
            further(ahead, 16, 8),
            further_epoch(ahead, 100),
        ];
        let events = decode(&mut decoder, &frames);
        assert_eq!(sequences(&events), (0..32).collect::<Vec<_>>());
        for event in events {
            let Event::Further(event) = event else {
                continue;
            };
            assert_eq!(event.sensor(), Some(1));
            let (found, samples) = match *event {
                Event::Samples(samples) => (&mut heard, samples),
                Event::Late(samples) => (&mut late, samples),
                _ => continue,
            };
            for sample in samples.iter() {
                let number = sample.sequence - ahead;
                assert_eq!(sample.time.0, time(number));
                assert_eq!(sample.value, [number as i32; 3]);
                assert_eq!(sample.rate, Some([-(number as i32); 3]));
                found.push(number);
            }
        }
    }
    let once: Vec<_> = (0..8).chain(16..24).collect();
    assert_eq!(heard, once.repeat(2));
    assert_eq!(late, (8..16).collect::<Vec<_>>().repeat(2));
    let statistics = decoder.statistics();
    let further = StreamStatistics { received: 32, missing: 0, duplicated: 16, late: 16 };
    assert_eq!(statistics.further, further);
    assert_eq!((statistics.raw.received, statistics.raw.missing), (64, 0));
    assert_eq!(statistics.frames_rejected, 0);
}

#[test]
fn an_epoch_of_an_impossible_sensor_is_unreadable() {
    let mut decoder = Decoder::new();
    let epoch = <Telemetry>::Epoch(Epoch { sensor: 8, ..Epoch::default() });
    let events = decode(&mut decoder, &[framed(|frame| epoch.encode(frame))]);
    assert!(matches!(events[..], [Event::Unreadable(_)]), "{events:?}");
}

#[test]
fn samples_before_the_first_epoch_wait_for_it_and_are_not_lost() {
    let mut decoder = Decoder::new();
    let events = decode(&mut decoder, &[samples(200_000, 16), samples(200_016, 16)]);
    assert!(events.is_empty());
    assert_eq!(decoder.statistics().batches_unplaced, 2);
    let events = decode(&mut decoder, &[epoch(200_032, time(200_032))]);
    assert_eq!(sequences(&events), (200_000..200_032).collect::<Vec<_>>());
    assert!(matches!(events.last(), Some(Event::Epoch { .. })));
    assert_eq!(decoder.statistics().batches_unplaced, 0);
}

#[test]
fn short_numbers_are_completed_for_hours_and_over_their_wraps() {
    let mut decoder = Decoder::new();
    let mut expected = Vec::new();
    for first in (65_000..140_000).step_by(32) {
        let mut frames = vec![samples(first, 32)];
        // One epoch a second at first, then none: the samples themselves lead on.
        if first < 70_000 {
            frames.insert(0, epoch(first, time(first)));
        }
        expected.extend(first..first + 32);
        let events = decode(&mut decoder, &frames);
        assert_eq!(sequences(&events), (first..first + 32).collect::<Vec<_>>());
    }
    assert_eq!(decoder.statistics().raw.received, expected.len() as u64);
    assert_eq!(decoder.statistics().raw.missing, 0);
}

#[test]
fn losses_damage_and_repeats_are_counted() {
    let mut decoder = Decoder::new();
    let mut damaged = samples(16, 16);
    damaged[9] ^= 0x40;
    let frames = [
        // Listening begins within a frame: not counted.
        epoch(0, time(0))[20..].to_vec(),
        epoch(0, time(0)),
        samples(0, 16),
        damaged,
        samples(32, 16),
        samples(32, 16),
        samples(40, 16),
        epoch(56, time(56)),
        epoch(57, time(57)),
    ];
    let events = decode(&mut decoder, &frames);
    let expected: Vec<_> = (0..16).chain(32..56).collect();
    assert_eq!(sequences(&events), expected);
    let statistics = decoder.statistics();
    assert_eq!(statistics.frames_damaged, 1);
    assert_eq!(
        statistics.raw,
        StreamStatistics { received: 40, missing: 16, duplicated: 24, late: 0 }
    );
}

#[test]
fn an_epoch_that_did_not_arrive_is_known_by_its_number() {
    let mut decoder = Decoder::new();
    // The first may have any; one that a new listener asked for has that of the one before.
    let numbers = [254, 255, 0, 0, 2, 3, 3, 2];
    let frames = (0..).zip(numbers).map(|(sequence, number)| {
        let sequence = sequence * 100;
        numbered_epoch(number, sequence, time(sequence))
    });
    let events = decode(&mut decoder, &frames.collect::<Vec<_>>());
    let after_loss: Vec<_> = events
        .iter()
        .filter_map(|event| match event {
            Event::Epoch { after_loss, .. } => Some(*after_loss),
            _ => None,
        })
        .collect();
    assert_eq!(after_loss, [false, false, false, false, true, false, false, true]);
}

#[test]
fn an_epoch_may_overtake_the_samples_before_a_long_gap() {
    let mut decoder = Decoder::new();
    let events = decode(
        &mut decoder,
        &[
            epoch(0, time(0)),
            samples(0, 16),
            epoch(6_000, time(6_000)),
            samples(16, 16),
            samples(6_000, 16),
        ],
    );
    let expected: Vec<_> = (0..32).chain(6_000..6_016).collect();
    assert_eq!(sequences(&events), expected);
    assert_eq!(decoder.statistics().raw.missing, 6_000 - 32);
}

#[test]
fn after_a_long_silence_samples_wait_for_an_epoch() {
    let mut decoder = Decoder::new();
    decode(&mut decoder, &[epoch(0, time(0)), samples(0, 16)]);
    // 20 s later: the time's low bits have wrapped.
    let events = decode(&mut decoder, &[samples(2_000, 16)]);
    assert!(sequences(&events).is_empty());
    let events = decode(&mut decoder, &[epoch(2_010, time(2_010))]);
    assert_eq!(sequences(&events), (2_000..2_016).collect::<Vec<_>>());
}

fn restarts(events: &[Event]) -> Vec<Option<u32>> {
    let restart = |event: &Event| match event {
        Event::Restart { boot_count } => Some(*boot_count),
        _ => None,
    };
    events.iter().filter_map(restart).collect()
}

/// What a device sends of samples `from` to `to`: an epoch a second, batches of 16; with the times at
/// which it does, of a device that started at `started_us` of the host.
fn course(from: u32, to: u32, started_us: u64) -> Vec<(u64, Vec<u8>)> {
    let start = (started_us / 1_000_000) as i16;
    let mut frames = Vec::new();
    for first in (from..to).step_by(16) {
        if (first - from).is_multiple_of(96) {
            let number = (first / 96) as u8;
            let frame = numbered_epoch(number, first, time(first));
            frames.push((started_us + time(first), frame));
        }
        frames.push((started_us + time(first + 15), samples_of(start, first, 16)));
    }
    frames
}

fn decode_timed(decoder: &mut Decoder, frames: &[(u64, Vec<u8>)]) -> Vec<Event> {
    let mut events = Vec::new();
    for (host_us, frame) in frames {
        decoder.push(host_us * 1000, frame, |arrival| events.push(arrival.event));
    }
    events
}

#[test]
fn a_restart_begins_numbers_anew() {
    let mut decoder = Decoder::new();
    let before = [hello(1), epoch(5_000, time(5_000)), samples(5_000, 16)];
    let events = decode(&mut decoder, &before);
    assert_eq!(restarts(&events), []);
    let again = [hello(1), hello(2), samples(0, 16), epoch(16, time(16))];
    let events = decode(&mut decoder, &again);
    assert_eq!(restarts(&events), [Some(2)]);
    assert_eq!(sequences(&events), (0..16).collect::<Vec<_>>());
    // What the start before sent comes again: it was another one all the same.
    let events = decode(&mut decoder, &[hello(1), samples(16, 16)]);
    assert_eq!(restarts(&events), []);
    assert_eq!(sequences(&events), (16..32).collect::<Vec<_>>());
}

#[test]
fn a_restart_without_a_greeting_is_known_by_what_follows_and_its_samples_are_kept() {
    for lost_frames in [0, 1, 3] {
        let mut decoder = Decoder::new();
        let mut frames = vec![(0, hello(1))];
        frames.extend(course(0, 2_000, 0));
        // Up again after 0.7 s.
        let started_us = time(2_000) + 700_000;
        frames.extend(course(0, 1_600, started_us).split_off(lost_frames));
        let events = decode_timed(&mut decoder, &frames);
        assert_eq!(restarts(&events), [None]);
        // Without its first epoch the new start is known from the second on.
        let heard = if lost_frames == 0 { 0 } else { 96 };
        let expected: Vec<_> = (0..2_000).chain(heard..1_600).collect();
        assert!(sequences(&events) == expected, "{lost_frames} lost");
        // The greeting comes when it is asked for, and tells of no other start.
        let now_us = time(1_600);
        let asked = [
            (started_us + now_us, hello_at(2, now_us)),
            (started_us + time(1_615), samples_of(1, 1_600, 16)),
        ];
        let events = decode_timed(&mut decoder, &asked);
        assert_eq!(restarts(&events), []);
        assert_eq!(sequences(&events), (1_600..1_616).collect::<Vec<_>>());
        // One more start, of which the greeting does arrive.
        let again = [(started_us + 30_000_000, hello_at(3, 1_000))];
        let events = decode_timed(&mut decoder, &again);
        assert_eq!(restarts(&events), [Some(3)]);
        let raw = decoder.statistics().raw;
        assert_eq!((raw.missing, raw.duplicated, raw.late), (0, 0, 0));
    }
}

#[test]
fn a_restart_within_a_silence_is_found_though_its_numbers_pass_the_old_ones() {
    let old = course(0, 576, 0);
    // Up again at 12 s; heard from 15 s on, when it is at number 192.
    let new = course(0, 1_600, 12_000_000).split_off(14);
    let mut decoder = Decoder::new();
    let events = decode_timed(&mut decoder, &[old.clone(), new.clone()].concat());
    assert_eq!(restarts(&events), [None]);
    let expected: Vec<_> = (0..576).chain(192..1_600).collect();
    assert!(sequences(&events) == expected);
    // Asked, it tells at once; so does one that has not started anew.
    let mut decoder = Decoder::new();
    decode_timed(&mut decoder, &[vec![(0, hello(1))], old].concat());
    assert!(decode_timed(&mut decoder, &new[..3]).is_empty() && decoder.is_in_doubt());
    let answer = (new[2].0, hello_at(2, new[2].0 - 12_000_000));
    let events = decode_timed(&mut decoder, &[answer]);
    assert_eq!(restarts(&events), [Some(2)]);
    assert_eq!(sequences(&events), (192..224).collect::<Vec<_>>());
    assert!(decode_timed(&mut decoder, &[(15_100_000, epoch(0, time(0)))]).is_empty());
    assert!(decoder.is_in_doubt());
    let events = decode_timed(&mut decoder, &[(15_200_000, hello_at(2, 3_250_000))]);
    assert!(restarts(&events).is_empty() && !decoder.is_in_doubt());
}

#[test]
fn the_first_greeting_that_is_heard_tells_whether_it_is_of_this_start() {
    let mut decoder = Decoder::new();
    let mut frames = course(0, 2_000, 0);
    let started_us = time(2_000) + 700_000;
    frames.push((started_us + 1_000, hello_at(8, 1_000)));
    frames.extend(course(0, 160, started_us));
    let events = decode_timed(&mut decoder, &frames);
    assert_eq!(restarts(&events), [Some(8)]);
    assert_eq!(sequences(&events).len(), 2_160);
}

#[test]
fn a_late_or_repeated_stretch_is_no_restart_and_nothing_in_it_counts_twice() {
    let clean = course(0, 3_200, 0);
    let numbers: Vec<_> = (0..3_200).collect();
    // An epoch of long ago; the last 2 s once more; both, and then nothing for 4 s and all at once.
    let stale = |at: usize, from: usize, length: usize| {
        let mut frames = clean.clone();
        let (now, _) = frames[at];
        let again = clean[from..from + length].to_vec();
        frames.splice(at..at, again.into_iter().map(|(_, frame)| (now, frame)));
        frames
    };
    let held_up = |mut frames: Vec<(u64, Vec<u8>)>, from: usize| {
        let until = frames[from].0 + 4_000_000;
        for (host_us, _) in &mut frames[from..] {
            *host_us = until.max(*host_us);
        }
        frames
    };
    let cases = [
        (stale(140, 14, 1), 0),
        (stale(140, 126, 14), 192),
        (held_up(stale(140, 126, 14), 154), 192),
        (held_up(stale(140, 14, 1), 141), 0),
    ];
    for (frames, duplicated) in cases {
        let mut decoder = Decoder::new();
        let events = decode_timed(&mut decoder, &frames);
        assert_eq!(restarts(&events), []);
        assert!(sequences(&events) == numbers);
        let raw = decoder.statistics().raw;
        assert_eq!((raw.missing, raw.duplicated), (0, duplicated));
    }
}

#[test]
fn what_comes_again_behind_a_restart_is_not_the_new_starts() {
    let started_us = time(320) + 700_000;
    let old = course(0, 320, 0);
    let new = course(0, 1_600, started_us);
    // Of each seven frames the first is an epoch.
    let batches = (0..).zip(&old).filter(|(at, _)| at % 7 != 0);
    let again: Vec<_> = batches.map(|(_, (_, frame))| frame).collect();
    let again = &again[again.len() - 8..];
    for at in [0, 5, 12, 14, 20, 26] {
        let now_us = new[at].0;
        let again = again.iter().map(|&frame| (now_us, frame.clone()));
        let mut frames = vec![(0, hello(1))];
        frames.extend(old.iter().cloned());
        frames.push((started_us, hello_at(2, 0)));
        frames.extend(new[..at].iter().cloned());
        frames.extend(again);
        frames.extend(new[at..].iter().cloned());
        let mut decoder = Decoder::new();
        let events = decode_timed(&mut decoder, &frames);
        assert_eq!(restarts(&events), [Some(2)]);
        let expected: Vec<_> = (0..320).chain(0..1_600).collect();
        assert!(sequences(&events) == expected, "at {at}");
        let raw = decoder.statistics().raw;
        assert_eq!((raw.missing, raw.duplicated, raw.late), (0, 128, 0));
    }
}

#[test]
fn a_start_like_the_one_before_is_another_where_the_link_was_opened_anew() {
    let started_us = time(320) + 700_000;
    let course = course(0, 320, 0);
    let mut decoder = Decoder::new();
    for (start, at_us) in [(1, 0), (2, started_us)] {
        let mut frames = vec![(at_us, hello_at(start, 0))];
        let later = |(us, frame): &(u64, Vec<u8>)| (at_us + us, frame.clone());
        frames.extend(course.iter().map(later));
        let events = decode_timed(&mut decoder, &frames);
        assert_eq!(sequences(&events), (0..320).collect::<Vec<_>>());
        decoder.interrupt();
    }
    let raw = decoder.statistics().raw;
    assert_eq!((raw.received, raw.missing, raw.duplicated), (640, 0, 0));
}

#[test]
fn a_sensor_that_is_stuck_gives_the_same_at_each_start_and_none_of_it_is_left_out() {
    let stuck = |first| {
        let counts = [Counts([0, 0, 32767]); 16];
        framed(|frame| batch::encode(first, DeviceTimeUs(time(first)), &counts, frame))
    };
    let mut decoder = Decoder::new();
    for start in 1..4 {
        let mut frames = vec![hello(start), epoch(0, time(0))];
        frames.extend((0..10).map(|batch| stuck(16 * batch)));
        decode(&mut decoder, &frames);
    }
    let raw = decoder.statistics().raw;
    assert_eq!((raw.received, raw.duplicated), (480, 0));
}

#[test]
fn samples_that_come_after_later_ones_are_late_not_lost_and_not_duplicated() {
    let mut frames = course(0, 1_600, 0);
    let mut swapped = 0;
    // Of each seven frames the first is an epoch.
    for at in (22..100).step_by(14) {
        let [(_, one), (_, two)] = &mut frames[at..at + 2] else { unreachable!() };
        std::mem::swap(one, two);
        swapped += 1;
    }
    // One of them comes twice.
    let again = frames[23].clone();
    frames.insert(24, again);
    let mut decoder = Decoder::new();
    let events = decode_timed(&mut decoder, &frames);
    assert_eq!(restarts(&events), []);
    assert_eq!(sequences(&events).len() as u64, 1_600 - 16 * swapped);
    let raw = decoder.statistics().raw;
    assert_eq!((raw.missing, raw.duplicated, raw.late), (0, 16, 16 * swapped));
}

#[test]
fn strangers_are_told_from_damage() {
    let mut decoder = Decoder::new();
    let mut frames = vec![hello(1)];
    frames.push(framed(|frame| {
        wimu_link::frame::encode(wimu_link::Kind::Telemetry, &[0xff; 9], frame)
    }));
    frames.push(framed(|frame| wimu_link::WhoAreYou::default().encode(frame)));
    let events = decode(&mut decoder, &frames);
    assert!(matches!(events[1], Event::Unreadable(_)));
    assert!(matches!(events[2], Event::Unreadable(_)));
    let statistics = decoder.statistics();
    assert_eq!((statistics.frames_unreadable, statistics.frames_damaged), (2, 0));
}

proptest! {
    #[test]
    fn noise_between_frames_costs_no_sample_twice_and_panics_nowhere(
        noise in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..40), 30),
        cuts in prop::collection::vec(0..60_usize, 30),
        splits in 1..50_usize,
    ) {
        let mut bytes = Vec::new();
        for (index, (noise, cut)) in noise.iter().zip(cuts).enumerate() {
            let first = index as u32 * 16;
            bytes.extend(epoch(first, time(first)));
            let frame = samples(first, 16);
            bytes.extend(&frame[..frame.len().min(cut)]);
            bytes.extend(noise);
            bytes.push(0);
        }
        let mut decoder = Decoder::new();
        let mut events = Vec::new();
        for piece in bytes.chunks(splits) {
            decoder.push(0, piece, |arrival| events.push(arrival.event));
        }
        let found = sequences(&events);
        prop_assert!(found.is_sorted_by(|a, b| a < b));
        prop_assert!(found.iter().all(|s| *s < 480));
    }

    #[test]
    fn no_bytes_panic(bytes: Vec<u8>) {
        Decoder::new().push(0, &bytes, |_| {});
    }
}

/// Samples first, first + every, … of that device.
fn decimated(first: u32, count: u32, every: u8) -> Vec<u8> {
    let counts: Vec<_> =
        (0..count).map(|s| Counts(value(first + s * u32::from(every)).map(|v| v as i16))).collect();
    let every = std::num::NonZeroU8::new(every).unwrap();
    framed(|frame| {
        batch::encode_with(
            batch::Layout { sensor: 0, every },
            first,
            DeviceTimeUs(time(first)),
            &counts,
            frame,
        )
    })
}

#[test]
fn decimated_samples_keep_number_and_time_and_only_their_losses_count() {
    let mut decoder = Decoder::new();
    let frames = [
        epoch(0, time(0)),
        samples(0, 10),
        decimated(12, 5, 4),
        // Two of them are lost; then one comes again with one that is new.
        decimated(40, 2, 4),
        decimated(44, 2, 4),
        // And every sample again.
        samples(50, 3),
        samples(55, 1),
    ];
    let events = decode(&mut decoder, &frames);
    let expected: Vec<u32> =
        (0..10).chain([12, 16, 20, 24, 28, 40, 44, 48, 50, 51, 52, 55]).collect();
    assert_eq!(sequences(&events), expected);
    let raw = decoder.statistics().raw;
    assert_eq!((raw.missing, raw.duplicated), (2 + 2, 1));
}

#[test]
fn positions_and_samples_go_on_where_their_numbers_wrap() {
    // 2³² samples are 37 days at 1344 Hz.
    let mut decoder = Decoder::new();
    let mut events = Vec::new();
    let mut expected = Vec::new();
    let start = 0_u32.wrapping_sub(400);
    for step in (0..800).step_by(16) {
        let first = start.wrapping_add(step);
        let at = |step: u32| u64::from(step) * PERIOD_US;
        let counts: Vec<_> = (step..step + 16).map(|s| Counts([s as i16, 0, 16384])).collect();
        let mut frames = Vec::new();
        if step % 96 == 0 {
            frames.push(numbered_epoch((step / 96) as u8, first, at(step)));
        }
        // The batch over the wrap comes after the next: it fills its gap.
        let batch = framed(|frame| batch::encode(first, DeviceTimeUs(at(step)), &counts, frame));
        frames.push(batch);
        frames.push(navigation(first));
        expected.push(first);
        for frame in frames {
            decoder.push(at(step) * 1000, &frame, |arrival| events.push(arrival.event));
        }
    }
    assert_eq!(positions(&events), expected);
    let statistics = decoder.statistics();
    assert_eq!((statistics.raw.received, statistics.raw.missing), (800, 0));
    assert_eq!(statistics.readings_repeated + statistics.frames_rejected, 0);
    // Again, and late: nothing twice.
    decoder.push(8_000_000_000, &navigation(383), |_| unreachable!());
    decoder.push(8_000_000_000, &navigation(u32::MAX), |_| unreachable!());
    assert_eq!(decoder.statistics().readings_repeated, 2);
}

#[test]
fn a_late_batch_fills_a_gap_over_the_wrap() {
    let start = 0_u32.wrapping_sub(40);
    let mut gaps = Gaps::default();
    let mut statistics = StreamStatistics::default();
    gaps.add(start, start.wrapping_add(80));
    let samples = Samples {
        sensor: 0,
        rates: Vec::new(),
        stream: batch::Stream::Raw,
        first_sequence: start.wrapping_add(32),
        first_time: DeviceTimeUs(0),
        period: PeriodNs(10_000_000),
        every: 1,
        values: vec![[0; 3]; 16],
    };
    assert_eq!(gaps.take(&samples, 16, &mut statistics).len(), 1);
    assert_eq!((statistics.late, statistics.duplicated), (16, 0));
    // Once each.
    gaps.take(&samples, 16, &mut statistics);
    assert_eq!((statistics.late, statistics.duplicated), (16, 16));
}

#[test]
fn one_forged_number_hides_no_position_and_no_field() {
    let forged = [1 << 30, u32::MAX].map(navigation);
    let forged = [&forged[..], &[environment(u64::MAX)]].concat();
    for before_the_first_epoch in [true, false] {
        let mut decoder = Decoder::new();
        let mut events = Vec::new();
        if before_the_first_epoch {
            events.extend(decode(&mut decoder, &forged));
        }
        for second in 0..5_u32 {
            let host_us = time(100 * second);
            let mut frames = vec![(host_us, numbered_epoch(second as u8, 100 * second, host_us))];
            for number in (100 * second..100 * (second + 1)).step_by(10) {
                frames.push((host_us, navigation(number)));
                frames.push((host_us, environment(time(number))));
            }
            if second == 2 && !before_the_first_epoch {
                frames.extend(forged.iter().map(|frame| (host_us, frame.clone())));
            }
            events.extend(decode_timed(&mut decoder, &frames));
        }
        let genuine: Vec<_> = (0..500).step_by(10).collect();
        let mut found = positions(&events);
        found.retain(|number| *number < 1 << 30);
        assert_eq!(found, genuine);
        let rejected = decoder.statistics().frames_rejected;
        // 2³² − 1 is the number before 0: late.
        assert_eq!(decoder.statistics().readings_repeated, 1);
        match before_the_first_epoch {
            // What no epoch judges is believed until one comes.
            true => assert_eq!((fields(&events), rejected), (51, 0)),
            false => assert_eq!((fields(&events), rejected), (50, 2)),
        }
    }
}

#[test]
fn what_a_stalled_link_brings_is_believed_and_what_is_farther_ahead_is_not() {
    let ahead = (MAX_AHEAD_US / PERIOD_US) as u32;
    for (number, rejected) in [(ahead, 0), (ahead * 5 / 4, 0), (ahead * 5 / 4 + 200, 1)] {
        let mut decoder = Decoder::new();
        decode(&mut decoder, &[epoch(0, time(0)), navigation(number)]);
        assert_eq!(decoder.statistics().frames_rejected, rejected, "{number}");
    }
    for (late_us, rejected) in [(0, 0), (1, 1)] {
        let mut decoder = Decoder::new();
        let late = environment(time(0) + MAX_AHEAD_US + late_us);
        decode(&mut decoder, &[epoch(0, time(0)), late]);
        assert_eq!(decoder.statistics().frames_rejected, rejected, "{late_us}");
    }
    // A position that may have been sent, but for the epoch after it: it hides none for long.
    let mut decoder = Decoder::new();
    let second = [epoch(100, time(100)), navigation(100)];
    decode(&mut decoder, &[epoch(0, time(0)), navigation(ahead)]);
    assert_eq!(positions(&decode(&mut decoder, &second)), [100]);
}

#[test]
fn an_epoch_that_jumps_is_rejected_and_a_second_one_that_goes_on_from_it_believed() {
    for (jump_us, jump_samples) in [(1 << 62, 0), (0, 1 << 30), (1 << 40, 1 << 30)] {
        let mut decoder = Decoder::new();
        let mut frames = course(0, 960, 0);
        let forged = |step: u32| {
            let number = step + jump_samples;
            numbered_epoch(7, number, time(step) + jump_us)
        };
        frames.insert(30, (time(480), forged(480)));
        let events = decode_timed(&mut decoder, &frames);
        assert_eq!(sequences(&events), (0..960).collect::<Vec<_>>());
        assert_eq!(restarts(&events), []);
        assert_eq!(decoder.statistics().frames_rejected, 1);
        // A host that slept meanwhile: the second epoch is believed.
        let slept = [(time(1000), forged(1000)), (time(1096), forged(1096))];
        let events = decode_timed(&mut decoder, &slept);
        assert!(matches!(events[..], [Event::Epoch { .. }]), "{events:?}");
        assert_eq!(decoder.statistics().frames_rejected, 2);
    }
}

#[test]
fn a_first_epoch_from_the_end_of_time_is_survived_within_seconds() {
    let mut decoder = Decoder::new();
    let mut frames = course(0, 1_600, 0);
    frames.insert(0, (0, numbered_epoch(9, 5, u64::MAX)));
    let events = decode_timed(&mut decoder, &frames);
    assert_eq!(sequences(&events), (0..1_600).collect::<Vec<_>>());
    assert_eq!(restarts(&events), [None]);
}

#[test]
fn what_is_held_in_doubt_is_bounded_whatever_comes() {
    let mut decoder = Decoder::new();
    let mut frames = course(1_000, 1_600, 0);
    // Back by far: late, or a new start.
    frames.push((time(1_600), epoch(0, time(0))));
    decode_timed(&mut decoder, &frames);
    assert!(decoder.is_in_doubt());
    let event: Telemetry =
        Telemetry::Event { time_us: 0, event: wimu_link::message::Event::SensorFound };
    let event = framed(|frame| event.encode(frame));
    let (mut handed_on, sent) = (0, 10_000);
    for _ in 0..sent {
        decoder.push(time(1_600) * 1000, &event, |_| handed_on += 1);
    }
    assert!(decoder.start.order.held().len() <= 2048);
    assert!(handed_on >= sent - 2048, "{handed_on}");
    let unplaced = samples(40_000, 16);
    for _ in 0..sent {
        decoder.push(time(1_600) * 1000, &unplaced, |_| {});
    }
    assert!(decoder.start.order.held().len() <= 2048 && decoder.start.unplaced() <= MAX_UNPLACED);
}

/// A frame of a device, or of none, with any numbers.
fn absurd() -> impl Strategy<Value = Vec<u8>> {
    let extreme = prop_oneof![
        Just(0),
        Just(u64::MAX),
        Just(1 << 63),
        Just(u64::from(u32::MAX)),
        0..100_000_000_u64,
        any::<u64>()
    ];
    (0..7, extreme.clone(), extreme, any::<[u16; 3]>(), any::<u8>()).prop_map(
        |(kind, one, two, values, small)| match kind {
            0 => hello_at(one as u32, two),
            1 | 2 => {
                let epoch = <Telemetry>::Epoch(Epoch {
                    reason: EpochReason::Periodic,
                    number: small,
                    sequence: one as u32,
                    time_us: two,
                    period_ns: u32::from(values[0]) << (small % 17),
                    range_g: 2,
                    sensitivity_lsb_per_g: 16384.0,
                    full_scale: 32752,
                    parameters: 0,
                    temperature_centi_c: None,
                    ..Epoch::default()
                });
                framed(|frame| epoch.encode(frame))
            }
            3 => navigation(one as u32),
            4 => environment(one),
            _ => {
                let counts: Vec<_> = (0..1 + small % 32)
                    .map(|k| Counts(values.map(|v| v.wrapping_add(k.into()) as i16)))
                    .collect();
                let every =
                    std::num::NonZeroU8::new(values[1] as u8).unwrap_or(std::num::NonZeroU8::MIN);
                let time = DeviceTimeUs(two);
                framed(|frame| {
                    batch::encode_with(
                        batch::Layout { sensor: 0, every },
                        one as u32,
                        time,
                        &counts,
                        frame,
                    )
                })
            }
        },
    )
}

proptest! {
    #[test]
    fn no_frames_with_absurd_numbers_panic_and_what_is_kept_is_bounded(
        frames in prop::collection::vec((absurd(), 0..3_000_000_000_u64), 0..300),
    ) {
        let mut decoder = Decoder::new();
        let mut readings = crate::monitor::Readings::new();
        let mut history = crate::history::LinkHistory::new(LinkRole::Cable);
        let mut host_ns = 0_u64;
        for (frame, later_ns) in frames {
            host_ns += later_ns;
            decoder.push(host_ns, &frame, |arrival| {
                history.take(&arrival);
                readings.push(&arrival.event, |_| {});
            });
            prop_assert!(decoder.start.order.held().len() <= 2049);
            prop_assert!(decoder.start.unplaced() <= MAX_UNPLACED);
        }
        for boot in &history.boots {
            for mark in &boot.epochs {
                boot.time_of(mark.epoch.sequence);
            }
            for index in 0..boot.epochs.len() {
                crate::replay::verify(boot, index);
            }
        }
    }
}
