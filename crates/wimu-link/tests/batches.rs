//! Packing loses nothing and never blows up.

use proptest::prelude::*;
use wimu_link::batch::{self, Batch, BatchError, Layout, MAX_BATCH, Stream};
use wimu_link::frame::{Deframer, EncodeError, Kind, MAX_FRAME};
use wimu_model::{Counts, DeviceTimeUs, SpecificForceQ16};
use wimu_testkit::trials;

fn pack<S: batch::Sample>(samples: &[S]) -> Vec<u8> {
    let mut line = [0; MAX_FRAME];
    let length = batch::encode(
        0xabcd_1234,
        DeviceTimeUs(0xff_5678_9abc),
        samples,
        &mut line,
    )
    .unwrap();
    body(&line[..length])
}

fn body(line: &[u8]) -> Vec<u8> {
    let mut deframer = Deframer::new();
    line.iter()
        .find_map(|&byte| {
            let frame = deframer.push(byte)?.unwrap();
            assert_eq!(frame.kind, Kind::Batch);
            Some(frame.body.to_vec())
        })
        .unwrap()
}

fn assert_lossless_raw(samples: &[Counts]) {
    let body = pack(samples);
    let batch = Batch::decode(Kind::Batch, &body).unwrap();
    assert_eq!(batch.stream(), Stream::Raw);
    assert_eq!(batch.len(), samples.len());
    assert_eq!(
        (batch.sequence_low(), batch.time_low()),
        (0x1234, 0x78_9abc)
    );
    assert!(batch.counts().eq(samples.iter().copied()));
    assert_eq!(batch.specific_forces().count(), 0);
    // Header, and every sample as it is with its axis's coding and length, and the shift.
    assert!(body.len() <= 6 + (22 + samples.len() * 48).div_ceil(8));
}

fn assert_lossless_corrected(samples: &[SpecificForceQ16]) {
    let body = pack(samples);
    let batch = Batch::decode(Kind::Batch, &body).unwrap();
    assert_eq!(batch.stream(), Stream::Corrected);
    assert!(batch.specific_forces().eq(samples.iter().copied()));
    assert_eq!(batch.counts().count(), 0);
    assert!(body.len() <= 6 + (26 + samples.len() * 96).div_ceil(8));
}

/// Samples around a course with a slope, and noise of all sizes.
fn around_a_course() -> impl Strategy<Value = Vec<[i32; 3]>> {
    let axis = || (any::<i32>(), -5000..5000_i32, 0..=32_u32);
    (
        [axis(), axis(), axis()],
        0..16_u32,
        prop::collection::vec(any::<[i32; 3]>(), 1..=MAX_BATCH),
    )
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
    fn decimated_samples_come_back(
        samples in prop::collection::vec(any::<[i32; 3]>(), 1..=MAX_BATCH),
        every in 1_u8..,
    ) {
        let every = std::num::NonZeroU8::new(every).unwrap();
        let forces: Vec<_> = samples.iter().copied().map(SpecificForceQ16).collect();
        let counts: Vec<_> = samples.iter().map(|axes| Counts(axes.map(|v| v as i16))).collect();
        let mut line = [0; MAX_FRAME];
        let length = batch::encode_with(Layout { sensor: 0, every }, 7, DeviceTimeUs(9), &forces, &mut line).unwrap();
        let batch = Batch::decode(Kind::Batch, &body(&line[..length])).unwrap();
        prop_assert_eq!(batch.every(), every.get());
        prop_assert!(batch.specific_forces().eq(forces));
        let length = batch::encode_with(Layout { sensor: 0, every }, 7, DeviceTimeUs(9), &counts, &mut line).unwrap();
        let batch = Batch::decode(Kind::Batch, &body(&line[..length])).unwrap();
        prop_assert_eq!((batch.every(), batch.sequence_low(), batch.time_low()), (every.get(), 7, 9));
        prop_assert!(batch.counts().eq(counts));
    }

    #[test]
    fn any_counts_come_back(samples in prop::collection::vec(any::<[i16; 3]>(), 1..=MAX_BATCH)) {
        assert_lossless_raw(&samples.into_iter().map(Counts).collect::<Vec<_>>());
    }

    #[test]
    fn any_specific_forces_come_back(samples in prop::collection::vec(any::<[i32; 3]>(), 1..=MAX_BATCH)) {
        assert_lossless_corrected(&samples.into_iter().map(SpecificForceQ16).collect::<Vec<_>>());
    }

    #[test]
    fn any_course_comes_back(samples in around_a_course()) {
        assert_lossless_raw(&samples.iter().map(|s| Counts(s.map(|v| v as i16))).collect::<Vec<_>>());
        assert_lossless_corrected(&samples.into_iter().map(SpecificForceQ16).collect::<Vec<_>>());
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
        let mut body = pack(&samples.iter().map(|s| Counts(s.map(|v| v as i16))).collect::<Vec<_>>());
        for cut in 0..body.len() {
            prop_assert!(Batch::decode(Kind::Batch, &body[..cut]).is_err());
        }
        body.push(extra);
        prop_assert_eq!(Batch::decode(Kind::Batch, &body).unwrap_err(), BatchError::TooLong);
    }
}

#[test]
fn extremes_come_back() {
    for [a, b] in [
        [i32::MIN, i32::MAX],
        [i32::MIN, 0],
        [-1, 0],
        [0, 0],
        [i32::MIN; 2],
        [1, -1],
    ] {
        for count in 1..=MAX_BATCH {
            let samples: Vec<_> = (0..count)
                .map(|k| if k % 3 == 0 { [a, b, a] } else { [b, a, a] })
                .collect();
            assert_lossless_corrected(
                &samples
                    .iter()
                    .map(|&s| SpecificForceQ16(s))
                    .collect::<Vec<_>>(),
            );
            let raw = samples.iter().map(|s| Counts(s.map(|v| (v >> 16) as i16)));
            assert_lossless_raw(&raw.collect::<Vec<_>>());
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
}

#[test]
fn low_bits_that_are_all_zero_cost_nothing() {
    let noisy: Vec<_> = (0..16_i16)
        .map(|k| Counts([k * 7 % 5, 3 - k % 3, 1024 + k * 3 % 7]))
        .collect();
    let justified: Vec<_> = noisy.iter().map(|c| Counts(c.0.map(|v| v << 4))).collect();
    assert!(pack(&justified).len() <= pack(&noisy).len() + 1);
}

#[test]
fn time_before_the_start_is_not_guessed() {
    assert_eq!(
        batch::extend_time(0xff_ffff, DeviceTimeUs(3)),
        DeviceTimeUs(0xff_ffff)
    );
}

#[test]
fn impossible_values_are_refused() {
    // Decimated by 0 and by 1.
    for every in [0, 1] {
        let body = [&[0x80, 0, 0, 0, 0, 0, every], &[0; 5][..]].concat();
        assert_eq!(
            Batch::decode(Kind::Batch, &body).unwrap_err(),
            BatchError::Decimation
        );
    }
    assert_eq!(
        Batch::decode(Kind::Batch, &[0x80, 0, 0, 0, 0, 0]).unwrap_err(),
        BatchError::TooShort
    );
    // Two raw samples; X: mean, k = 15, first value 0, two ones: a residual of 2·2¹⁵ or more.
    let bits = [0b0111_1100, 0b0001_1000, 0, 0, 0];
    let body = [&[1, 0, 0, 0, 0, 0], &bits[..]].concat();
    assert_eq!(
        Batch::decode(Kind::Batch, &body).unwrap_err(),
        BatchError::Value
    );
    // And no batch at all.
    assert_eq!(
        Batch::decode(Kind::Batch, &[]).unwrap_err(),
        BatchError::TooShort
    );
}

#[test]
fn a_coding_that_no_sender_makes_is_an_error() {
    // Three raw samples. X: coding 10, which stands for nothing. Y and Z of fixed width.
    let bits = [0b1000_0000, 0b0001_1010, 0, 0, 0];
    let body = [&[2, 0, 0, 0, 0, 0], &bits[..]].concat();
    assert_eq!(
        Batch::decode(Kind::Batch, &body).unwrap_err(),
        BatchError::Value
    );
}
