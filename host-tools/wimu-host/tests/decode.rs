//! The decoder: numbers and times of samples, and what is counted as lost, repeated and late.

use wimu_host::decode::{Decoder, Event, StreamStatistics};
use wimu_link::message::{Epoch, Navigation};
use wimu_link::{LinkRole, Telemetry, batch};
use wimu_model::{Counts, DeviceTimeUs};

use crate::common::frames::{self, PERIOD_US, framed, raw, telemetry};

/// The sample of a sequence number: tells which one it is.
fn value(sequence: u32) -> [i32; 3] {
    [sequence as i16, (sequence >> 16) as i16, 16384].map(i32::from)
}

pub fn hello(boot_count: u32) -> Vec<u8> {
    hello_at(boot_count, 0)
}

pub fn hello_at(boot_count: u32, uptime_us: u64) -> Vec<u8> {
    frames::hello(LinkRole::Wireless, boot_count, uptime_us)
}

pub fn epoch(sequence: u32, time_us: u64) -> Vec<u8> {
    numbered_epoch(0, sequence, time_us)
}

pub fn numbered_epoch(number: u8, sequence: u32, time_us: u64) -> Vec<u8> {
    telemetry(&Telemetry::Epoch(Epoch { number, ..frames::epoch(sequence, time_us) }))
}

/// Samples from a device whose sample 0 was at 1 s.
pub fn samples(first: u32, count: u32) -> Vec<u8> {
    samples_of(0, first, count)
}

/// The same of a start, which Z tells.
pub fn samples_of(start: i16, first: u32, count: u32) -> Vec<u8> {
    let counts: Vec<_> = (first..first + count)
        .map(|s| {
            let [x, y, z] = value(s).map(|v| v as i16);
            Counts([x, y, z + start])
        })
        .collect();
    raw(first, time(first), &counts)
}

pub fn navigation(sequence: u32) -> Vec<u8> {
    let state = wimu_integrator::Navigation::default();
    telemetry(&Telemetry::Navigation(Navigation::new(sequence, &state)))
}

pub fn positions(events: &[Event]) -> Vec<u32> {
    let position = |event: &Event| match event {
        Event::Navigation(navigation) => Some(navigation.sequence),
        _ => None,
    };
    events.iter().filter_map(position).collect()
}

pub fn time(sequence: u32) -> u64 {
    1_000_000 + u64::from(sequence) * PERIOD_US
}

pub fn decode(decoder: &mut Decoder, frames: &[Vec<u8>]) -> Vec<Event> {
    let mut events = Vec::new();
    for frame in frames {
        decoder.push(0, frame, |arrival| events.push(arrival.event));
    }
    events
}

pub fn sequences(events: &[Event]) -> Vec<u32> {
    let mut found = Vec::new();
    for event in events {
        if let Event::Samples(samples) = event
            && samples.sensor == 0
        {
            for sample in samples.iter() {
                assert_eq!(sample.value[..2], value(sample.sequence)[..2]);
                assert_eq!(sample.time.0, time(sample.sequence));
                found.push(sample.sequence);
            }
        }
    }
    found
}

pub fn restarts(events: &[Event]) -> Vec<Option<u32>> {
    let restart = |event: &Event| match event {
        Event::Restart { boot_count } => Some(*boot_count),
        _ => None,
    };
    events.iter().filter_map(restart).collect()
}

/// What a device sends of samples `from` to `to`: an epoch a second, batches of 16; with the times at
/// which it does, of a device that started at `started_us` of the host.
pub fn course(from: u32, to: u32, started_us: u64) -> Vec<(u64, Vec<u8>)> {
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

pub fn decode_timed(decoder: &mut Decoder, frames: &[(u64, Vec<u8>)]) -> Vec<Event> {
    let mut events = Vec::new();
    for (host_us, frame) in frames {
        decoder.push(host_us * 1000, frame, |arrival| events.push(arrival.event));
    }
    events
}

/// Sensor 1 with its own numbers: `ahead` of those of sensor 0 at the same times.
fn further_epoch(ahead: u32, sequence: u32) -> Vec<u8> {
    let epoch = frames::epoch(sequence + ahead, time(sequence));
    let (range_g, sensitivity_lsb_per_g, full_scale) = (200, 160.0, 32767);
    telemetry(&Telemetry::Epoch(Epoch {
        range_g,
        sensitivity_lsb_per_g,
        full_scale,
        sensor: 1,
        ..epoch
    }))
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
            let (found, samples) = match event {
                Event::Samples(samples) if samples.sensor == 1 => (&mut heard, samples),
                Event::Late(samples) if samples.sensor == 1 => (&mut late, samples),
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
        frames.push(raw(first, at(step), &counts));
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
