//! The decoder: numbers and times that no device sends.

use proptest::prelude::*;
use wimu_host::capture::Link;
use wimu_host::decode::{Decoder, Event};
use wimu_host::monitor::Readings;
use wimu_host::replay::verify;
use wimu_link::message::{Environment, Epoch, Event as DeviceEvent};
use wimu_link::{LinkRole, Telemetry, batch};
use wimu_model::{Counts, DeviceTimeUs};

use crate::common::frames::{self, PERIOD_US, framed, telemetry};
use crate::decode::{
    course, decode, decode_timed, epoch, hello_at, navigation, numbered_epoch, positions, restarts,
    samples, sequences, time,
};

/// Largest lead of a device time that is believed, µs.
const MAX_AHEAD_US: u64 = 120_000_000;

fn environment(time_us: u64) -> Vec<u8> {
    telemetry(&Telemetry::Environment(Environment { time_us, ..Environment::default() }))
}

fn fields(events: &[Event]) -> usize {
    let is_field = |event: &&Event| matches!(event, Event::Environment(_));
    events.iter().filter(is_field).count()
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
        // What no epoch judges is believed until one comes.
        let expected = if before_the_first_epoch { (51, 0) } else { (50, 2) };
        assert_eq!((fields(&events), rejected), expected);
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
fn what_is_held_is_bounded_whatever_comes() {
    let mut decoder = Decoder::new();
    let mut frames = course(1_000, 1_600, 0);
    // Back by far: late, or a new start.
    frames.push((time(1_600), epoch(0, time(0))));
    decode_timed(&mut decoder, &frames);
    assert!(decoder.is_in_doubt());
    let event = DeviceEvent::SensorFound;
    let event = telemetry(&Telemetry::Event { time_us: 0, event });
    let (mut handed_on, sent) = (0, 5_000);
    for _ in 0..sent {
        decoder.push(time(1_600) * 1000, &event, |_| handed_on += 1);
    }
    assert!(handed_on >= sent - 2048, "{handed_on}");
    // Of batches without an epoch the latest wait for one.
    let mut decoder = Decoder::new();
    for sequence in 0..1_000 {
        decoder.push(0, &samples(sequence, 1), |_| {});
    }
    let events = decode(&mut decoder, &[epoch(1_000, time(1_000))]);
    assert_eq!(sequences(&events), (1_000 - 512..1_000).collect::<Vec<_>>());
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
                let period_ns = u32::from(values[0]) << (small % 17);
                let epoch = frames::epoch(one as u32, two);
                telemetry(&Telemetry::Epoch(Epoch { number: small, period_ns, ..epoch }))
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
    #![proptest_config(ProptestConfig::with_cases(wimu_testkit::cases(256) / 8))]
    #[test]
    fn no_frames_with_absurd_numbers_panic(
        frames in prop::collection::vec((absurd(), 0..3_000_000_000_u64), 0..300),
    ) {
        let mut decoder = Decoder::new();
        let mut readings = Readings::new();
        let mut history = Link::new(LinkRole::Cable);
        let mut host_ns = 0_u64;
        for (frame, later_ns) in frames {
            host_ns += later_ns;
            decoder.push(host_ns, &frame, |arrival| {
                history.take(&arrival);
                readings.push(&arrival.event, |_| {});
            });
        }
        for boot in &history.boots {
            for mark in boot.epochs() {
                boot.time_of(mark.epoch.sequence);
            }
            for index in 0..boot.epochs().len() {
                verify(boot, index);
            }
        }
    }
}
