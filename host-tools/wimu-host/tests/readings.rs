//! Readings of a link: one for each sample, in either stream.

use wimu_host::decode::{Event, Samples};
use wimu_host::monitor::Readings;
use wimu_link::Settings;
use wimu_link::batch::Stream;
use wimu_model::{DeviceTimeUs, PeriodNs};

use crate::common::frames;

fn epoch() -> Event {
    Event::Epoch { epoch: frames::epoch(0, 0), after_loss: false }
}

fn samples(stream: Stream, first: u32) -> Event {
    Event::Samples(Samples {
        sensor: 0,
        rates: Vec::new(),
        stream,
        first_sequence: first,
        first_time: DeviceTimeUs(u64::from(first) * 10_000),
        period: PeriodNs(10_000_000),
        every: 1,
        values: vec![[0, 0, 16384]; 16],
    })
}

fn settings(corrected: bool) -> Event {
    let mut settings = Settings::default();
    settings.cable.corrected = corrected;
    settings.wireless.corrected = corrected;
    Event::Settings(settings)
}

/// Number, whether it is corrected, whether the raw sample is there.
fn read(events: &[Event]) -> Vec<(u32, bool, bool)> {
    let mut readings = Readings::new();
    let mut found = Vec::new();
    for event in events {
        readings.push(event, |reading| {
            found.push((reading.sequence, reading.corrected, reading.raw.is_some()));
        });
    }
    found
}

fn expected(numbers: std::ops::Range<u32>, corrected: bool) -> Vec<(u32, bool, bool)> {
    numbers.map(|number| (number, corrected, true)).collect()
}

#[test]
fn a_sample_is_read_once_where_its_raw_twin_comes_before_the_settings_are_known() {
    let (raw, corrected) = (Stream::Raw, Stream::Corrected);
    // A board that was asked who it is a moment ago does not tell its settings again.
    let without =
        [epoch(), samples(raw, 0), samples(corrected, 0), samples(raw, 16), samples(corrected, 16)];
    assert_eq!(read(&without), expected(0..32, true));
    let with = [epoch(), samples(raw, 0), settings(true), samples(corrected, 0)];
    assert_eq!(read(&with), expected(0..16, true));
}

#[test]
fn raw_samples_are_read_once_nothing_corrected_comes() {
    let raw = |count: u32| (0..count).map(|batch| samples(Stream::Raw, 16 * batch));
    let told: Vec<_> = [epoch(), settings(false)].into_iter().chain(raw(1)).collect();
    assert_eq!(read(&told), expected(0..16, false));
    // Held until the settings tell.
    let later: Vec<_> = [epoch()].into_iter().chain(raw(1)).chain([settings(false)]).collect();
    assert_eq!(read(&later), expected(0..16, false));
    // Nothing tells: two of the longest batches are waited for.
    let untold = |count| read(&[epoch()].into_iter().chain(raw(count)).collect::<Vec<_>>());
    assert_eq!(untold(3), []);
    assert_eq!(untold(5), expected(0..80, false));
}

#[test]
fn raw_twins_are_found_where_numbers_wrap() {
    let mut events = vec![epoch()];
    let mut numbers = Vec::new();
    for batch in 0..40 {
        let first = 0_u32.wrapping_sub(320).wrapping_add(16 * batch);
        // The corrected twins of two batches in three are lost.
        events.push(samples(Stream::Raw, first));
        if batch % 3 == 2 {
            events.push(samples(Stream::Corrected, first));
            numbers.extend((0..16).map(|s| (first.wrapping_add(s), true, true)));
        }
    }
    assert_eq!(read(&events), numbers);
}
