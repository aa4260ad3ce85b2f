//! Packing loses nothing and never blows up.

use std::num::NonZeroU8;

use proptest::prelude::*;
use wimu_link::batch::{self, Batch, BatchError, Layout, MAX_BATCH, MAX_SENSOR, Sample, Stream};
use wimu_link::frame::{Deframer, EncodeError, Kind, MAX_FRAME};
use wimu_model::{AngularRateQ20, Counts, DeviceTimeUs, SpecificForceQ16, WideCounts};
use wimu_testkit::trials;

/// Kind and body.
fn pack_with<S: Sample>(layout: Layout, samples: &[S]) -> (Kind, Vec<u8>) {
    let mut line = [0; MAX_FRAME];
    let (sequence, time) = (0xabcd_1234, DeviceTimeUs(0xff_5678_9abc));
    let length = batch::encode_with(layout, sequence, time, samples, &mut line).unwrap();
    let mut deframer = Deframer::new();
    let frame = deframer.next(&mut &line[..length]).unwrap().unwrap();
    (frame.kind, frame.body.to_vec())
}

fn pack<S: Sample>(samples: &[S]) -> Vec<u8> {
    pack_with(Layout::default(), samples).1
}

/// As many samples as a batch can hold come back, and cost at most what they have at full width.
fn assert_lossless_in<S: Sample>(layout: Layout, samples: &[S]) -> Batch {
    let samples = &samples[..samples.len().min(S::MOST)];
    let (kind, body) = pack_with(layout, samples);
    let is_plain = layout.sensor == 0 && S::AXES == 3 && !S::WIDE;
    assert_eq!(kind == Kind::Batch, is_plain);
    let batch = Batch::decode(kind, &body).unwrap();
    assert_eq!((batch.stream(), batch.is_wide()), (S::STREAM, S::WIDE));
    assert_eq!((batch.sensor(), batch.every()), (layout.sensor, layout.every.get()));
    assert_eq!(batch.len(), samples.len());
    assert_eq!((batch.sequence_low(), batch.time_low()), (0x1234, 0x78_9abc));
    let axes = |sample: &S| [0, 1, 2].map(|axis| sample.axis(axis));
    assert!(batch.samples().iter().copied().eq(samples.iter().map(axes)));
    if S::AXES == 6 {
        let axes = |sample: &S| [3, 4, 5].map(|axis| sample.axis(axis));
        assert!(batch.angular_rates().iter().copied().eq(samples.iter().map(axes)));
    } else {
        assert_eq!(batch.angular_rates().len(), 0);
    }
    let (width, field) = match (S::STREAM, S::WIDE) {
        (Stream::Raw, false) => (16, 4),
        (Stream::Raw, true) => (20, 5),
        (Stream::Corrected, _) => (32, 5),
    };
    let shifts = S::AXES / 3 * field;
    let bits = shifts + S::AXES * (2 + field + width * samples.len());
    assert!(body.len() <= 6 + usize::from(!is_plain) + 1 + bits.div_ceil(8));
    batch
}

fn assert_lossless<S: Sample>(samples: &[S]) -> Batch {
    assert_lossless_in(Layout::default(), samples)
}

fn counts(axes: [i32; 3]) -> Counts {
    Counts(axes.map(|value| value as i16))
}

/// In the range of 20 bits.
fn wide(axes: [i32; 3]) -> WideCounts {
    WideCounts(axes.map(|value| value << 12 >> 12))
}

/// All types of samples, made of the same numbers.
fn assert_lossless_as_all_types(layout: Layout, samples: &[[i32; 3]]) {
    // A gyroscope with other numbers than the accelerometer.
    let rate = |axes: [i32; 3]| [axes[2] >> 3, axes[0] << 2, axes[1].wrapping_sub(axes[0])];
    let raw: Vec<_> = samples.iter().map(|&s| counts(s)).collect();
    let batch = assert_lossless_in(layout, &raw);
    assert!(batch.counts().eq(raw));
    assert_eq!(batch.specific_forces().count(), 0);
    let forces: Vec<_> = samples.iter().map(|&s| SpecificForceQ16(s)).collect();
    let batch = assert_lossless_in(layout, &forces);
    assert!(batch.specific_forces().eq(forces));
    assert_eq!(batch.counts().count(), 0);
    let of_20_bits: Vec<_> = samples.iter().map(|&s| wide(s)).collect();
    let batch = assert_lossless_in(layout, &of_20_bits);
    assert_eq!(batch.counts().count(), 0);
    let six = samples.iter().map(|&s| (counts(s), counts(rate(s))));
    assert_lossless_in(layout, &six.collect::<Vec<_>>());
    let six = samples.iter().map(|&s| (wide(s), wide(rate(s))));
    assert_lossless_in(layout, &six.collect::<Vec<_>>());
    let six = samples.iter().map(|&s| (SpecificForceQ16(s), AngularRateQ20(rate(s))));
    assert_lossless_in(layout, &six.collect::<Vec<_>>());
}

/// Samples around a course with a slope, and noise of all sizes.
fn around_a_course() -> impl Strategy<Value = Vec<[i32; 3]>> {
    let axis = || (any::<i32>(), -5000..5000_i32, 0..=32_u32);
    ([axis(), axis(), axis()], 0..16_u32, prop::collection::vec(any::<[i32; 3]>(), 1..=MAX_BATCH))
        .prop_map(|(axes, shift, noise)| {
            (0_i32..)
                .zip(noise)
                .map(|(k, noise)| {
                    core::array::from_fn(|axis| {
                        let (start, slope, quiet) = axes[axis];
                        start
                            .wrapping_add(slope.wrapping_mul(k))
                            .wrapping_add(noise[axis].checked_shr(quiet).unwrap_or(0))
                            << shift
                    })
                })
                .collect()
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(trials(20_000) as u32))]

    #[test]
    fn any_samples_come_back_of_any_sensor(
        samples in prop::collection::vec(any::<[i32; 3]>(), 1..=MAX_BATCH),
        sensor in 0..=MAX_SENSOR,
        every in 1_u8..,
    ) {
        let every = NonZeroU8::new(every).unwrap();
        assert_lossless_as_all_types(Layout { sensor, every }, &samples);
    }

    #[test]
    fn any_course_comes_back(samples in around_a_course()) {
        assert_lossless_as_all_types(Layout::default(), &samples);
    }

    #[test]
    fn counts_beyond_20_bits_arrive_at_the_limit(samples in prop::collection::vec(any::<[i32; 3]>(), 1..=MAX_BATCH)) {
        let samples: Vec<_> = samples.into_iter().map(WideCounts).collect();
        let batch = assert_lossless(&samples);
        for (sample, found) in samples.iter().zip(batch.samples()) {
            prop_assert_eq!(WideCounts(*found), sample.clamped());
        }
    }

    #[test]
    fn numbers_are_completed_from_nearby(sequence: u32, ahead in -32768..32768_i32, time: u64, later in -(1_i64 << 23)..1 << 23) {
        let near = sequence.wrapping_sub(ahead as u32);
        prop_assert_eq!(batch::extend_sequence(sequence as u16, near), sequence);
        let near = DeviceTimeUs((time >> 1).saturating_sub_signed(later));
        if (time >> 1).abs_diff(near.0) < 1 << 23 {
            let time = DeviceTimeUs(time >> 1);
            prop_assert_eq!(batch::extend_time(time.0 as u32 & 0xff_ffff, near), time);
        }
    }

    #[test]
    fn a_cut_or_longer_batch_is_refused(samples in around_a_course(), extra: u8) {
        let samples = &samples[..samples.len().min(MAX_BATCH / 2)];
        let six: Vec<_> = samples.iter().map(|&s| (wide(s), wide(s))).collect();
        for (kind, mut body) in [
            pack_with(Layout::default(), &samples.iter().map(|&s| counts(s)).collect::<Vec<_>>()),
            pack_with(Layout::default(), &six),
        ] {
            for cut in 0..body.len() {
                prop_assert!(Batch::decode(kind, &body[..cut]).is_err());
            }
            body.push(extra);
            prop_assert_eq!(Batch::decode(kind, &body).unwrap_err(), BatchError::TooLong);
        }
    }
}

#[test]
fn extremes_come_back() {
    for [a, b] in [[i32::MIN, i32::MAX], [i32::MIN, 0], [-1, 0], [0, 0], [i32::MIN; 2], [1, -1]] {
        for count in 1..=MAX_BATCH {
            let samples: Vec<_> =
                (0..count).map(|k| if k % 3 == 0 { [a, b, a] } else { [b, a, a] }).collect();
            assert_lossless_as_all_types(Layout::default(), &samples);
            let high: Vec<_> = samples.iter().map(|s| s.map(|v| v >> 16)).collect();
            assert_lossless_as_all_types(Layout::default(), &high);
            let high: Vec<_> = samples.iter().map(|s| s.map(|v| v >> 12)).collect();
            assert_lossless_as_all_types(Layout::default(), &high);
        }
    }
}

#[test]
fn a_batch_of_none_or_too_many_is_refused() {
    let mut line = [0; MAX_FRAME];
    let samples = [Counts::default(); MAX_BATCH + 1];
    for samples in [&samples[..0], &samples[..]] {
        assert_eq!(
            batch::encode(0, DeviceTimeUs(0), samples, &mut line),
            Err(EncodeError::BatchLength { most: MAX_BATCH })
        );
    }
    let six = samples.map(|counts| (counts, counts));
    assert_eq!(
        batch::encode(0, DeviceTimeUs(0), &six[..17], &mut line),
        Err(EncodeError::BatchLength { most: 16 })
    );
    let layout = Layout { sensor: 8, ..Layout::default() };
    let refused = batch::encode_with(layout, 0, DeviceTimeUs(0), &samples[..1], &mut line);
    assert_eq!(refused, Err(EncodeError::Sensor { most: 7 }));
}

#[test]
fn low_bits_that_are_all_zero_cost_nothing() {
    let noisy: Vec<_> =
        (0..16_i16).map(|k| Counts([k * 7 % 5, 3 - k % 3, 1024 + k * 3 % 7])).collect();
    let justified: Vec<_> = noisy.iter().map(|c| Counts(c.0.map(|v| v << 4))).collect();
    assert!(pack(&justified).len() <= pack(&noisy).len() + 1);
}

#[test]
fn time_before_the_start_is_not_guessed() {
    assert_eq!(batch::extend_time(0xff_ffff, DeviceTimeUs(3)), DeviceTimeUs(0xff_ffff));
}

#[test]
fn impossible_values_are_refused() {
    // Decimated by 0 and by 1.
    for every in [0, 1] {
        let body = [&[0x80, 0, 0, 0, 0, 0, every], &[0; 5][..]].concat();
        assert_eq!(Batch::decode(Kind::Batch, &body).unwrap_err(), BatchError::Decimation);
    }
    assert_eq!(
        Batch::decode(Kind::Batch, &[0x80, 0, 0, 0, 0, 0]).unwrap_err(),
        BatchError::TooShort
    );
    // Two raw samples; X: mean, k = 15, first value 0, two ones: a residual of 2·2¹⁵ or more.
    let bits = [0b0111_1100, 0b0001_1000, 0, 0, 0];
    let body = [&[1, 0, 0, 0, 0, 0], &bits[..]].concat();
    assert_eq!(Batch::decode(Kind::Batch, &body).unwrap_err(), BatchError::Value);
    // And no batch at all.
    assert_eq!(Batch::decode(Kind::Batch, &[]).unwrap_err(), BatchError::TooShort);
}

#[test]
fn a_coding_that_no_sender_makes_is_an_error() {
    // Three raw samples. X: coding 10, which stands for nothing. Y and Z of fixed width.
    let bits = [0b1000_0000, 0b0001_1010, 0, 0, 0];
    let body = [&[2, 0, 0, 0, 0, 0], &bits[..]].concat();
    assert_eq!(Batch::decode(Kind::Batch, &body).unwrap_err(), BatchError::Value);
}

#[test]
fn an_extension_that_no_sender_makes_is_an_error() {
    let samples = [(Counts([1, 2, 3]), Counts([4, 5, 6])); 2];
    let (kind, body) = pack_with(Layout::default(), &samples);
    let decode = |extension: u8, first: u8| {
        let mut body = body.clone();
        (body[0], body[1]) = (extension, first);
        Batch::decode(kind, &body).map(|_| ()).unwrap_err()
    };
    for bit in [5, 6, 7] {
        assert_eq!(decode(body[0] | 1 << bit, body[1]), BatchError::Extension);
    }
    // Corrected samples are not counts of 20 bits.
    let corrected = body[1] | 1 << 5;
    assert_eq!(decode(body[0] | 1 << 4, corrected), BatchError::Extension);
    // 17 samples of six axes, and no samples at all.
    assert_eq!(decode(body[0], 16), BatchError::Length);
    assert_eq!(Batch::decode(kind, &[]).unwrap_err(), BatchError::TooShort);
    assert_eq!(Batch::decode(kind, &body[..1]).unwrap_err(), BatchError::TooShort);
    for other in [Kind::Hello, Kind::Telemetry, Kind::Reply] {
        assert_eq!(Batch::decode(other, &body).unwrap_err(), BatchError::Kind);
    }
}

#[test]
fn numbers_beyond_20_bits_are_errors() {
    let decode = |first: u8, bits: u32| {
        let mut body = vec![1 << 4, first, 0, 0, 0, 0, 0];
        body.extend(bits.to_be_bytes());
        body.extend([0; 40]);
        Batch::decode(Kind::Inertial, &body).map(|_| ()).unwrap_err()
    };
    // A shift of 20; X of fixed width 21; k = 20; a first value of 20 bits without its sign.
    assert_eq!(decode(1 << 6, 20 << 27), BatchError::Value);
    assert_eq!(decode(0, 20 << 25), BatchError::Value);
    assert_eq!(decode(0, 0b01 << 30 | 20 << 25), BatchError::Value);
    assert_eq!(decode(0, 0b01 << 30 | 20 << 20), BatchError::Value);
}
