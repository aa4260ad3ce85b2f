//! Words of the FIFO: pairing, faults, overrun, arbitrary bytes.

use embedded_hal_async::i2c::ErrorKind;
use embedded_hal_mock::eh1::i2c::{Mock, Transaction};
use proptest::prelude::*;
use wimu_lsm6dso::{Batch, Error, FifoFault, I2cBus, Lsm6dso, Sample};

use crate::registers::{on_bus, read};

const GYROSCOPE: u8 = 1;
const ACCELEROMETER: u8 = 2;

/// A word of `sensor` in sample `slot`, with the slot's number on every axis.
fn word(sensor: u8, slot: i16) -> [u8; 7] {
    let tag = sensor << 3 | ((slot & 3) as u8) << 1;
    let tag = tag | (tag.count_ones() % 2) as u8;
    let [low, high] = slot.to_le_bytes();
    [tag, low, high, low, high, low, high]
}

fn status(words: usize, overrun: bool) -> Transaction {
    let [low, high] = (words as u16).to_le_bytes();
    read(0x3A, &[low, high | u8::from(overrun) << 3])
}

/// A burst in which the FIFO holds exactly `words`.
fn burst(words: &[[u8; 7]]) -> [Transaction; 3] {
    [status(words.len(), false), read(0x78, words.as_flattened()), status(0, false)]
}

type Sensor = Lsm6dso<I2cBus<Mock>>;

/// Reads `batches` times; returns the batches with their samples.
async fn read_batches(sensor: &mut Sensor, batches: usize) -> Vec<(Batch, Vec<Sample>)> {
    let mut read = Vec::new();
    for _ in 0..batches {
        let mut samples = [Sample::default(); 16];
        let batch = sensor.read(&mut samples).await.expect("the bus works");
        read.push((batch, samples[..batch.count].to_vec()));
    }
    read
}

/// The batches that come of bursts of these words.
fn batches(bursts: &[&[[u8; 7]]]) -> Vec<(Batch, Vec<Sample>)> {
    let expected: Vec<_> = bursts.iter().flat_map(|words| burst(words)).collect();
    on_bus(&expected, async |sensor| read_batches(sensor, bursts.len()).await)
}

fn sample(slot: i16) -> Sample {
    Sample { acceleration: [slot; 3], angular_rate: [slot; 3] }
}

#[test]
fn pairs_are_joined_in_either_order_and_across_bursts() {
    let read = batches(&[
        &[word(GYROSCOPE, 0), word(ACCELEROMETER, 0), word(GYROSCOPE, 1)],
        &[word(ACCELEROMETER, 1), word(ACCELEROMETER, 2), word(GYROSCOPE, 2)],
    ]);
    assert_eq!(read[0].1, [sample(0)]);
    // A driver that did not start the chip does not know what came before.
    assert!(read[0].0.gap && !read[1].0.gap);
    assert_eq!(read[1].1, [sample(1), sample(2)]);
}

#[test]
fn faults_are_named_and_the_samples_after_them_are_delivered() {
    let good =
        [word(GYROSCOPE, 7), word(ACCELEROMETER, 7), word(GYROSCOPE, 8), word(ACCELEROMETER, 8)];
    let mut parity = word(GYROSCOPE, 6);
    parity[0] ^= 1;
    for (bad, fault) in [
        (parity, FifoFault::Parity { tag: parity[0] }),
        ([0; 7], FifoFault::UnknownTag { tag: 0 }),
        ([0xFF; 7], FifoFault::UnknownTag { tag: 0xFF }),
        (word(GYROSCOPE, 6), FifoFault::AccelerometerMissing),
        (word(ACCELEROMETER, 6), FifoFault::GyroscopeMissing),
        // A word of sample 11, four samples away from sample 7.
        (word(GYROSCOPE, 11), FifoFault::AccelerometerMissing),
    ] {
        let words: Vec<_> =
            [word(GYROSCOPE, 5), word(ACCELEROMETER, 5), bad].into_iter().chain(good).collect();
        let (batch, samples) = &batches(&[&words])[0];
        assert_eq!(batch.fault, Some(fault), "{fault}");
        assert!(batch.gap);
        assert_eq!(*samples, [sample(7), sample(8)], "{fault}");
    }
}

#[test]
fn a_skipped_tag_counter_is_a_gap() {
    let pair = |slot| [word(GYROSCOPE, slot), word(ACCELEROMETER, slot)];
    let words = [pair(0), pair(1), pair(3)].concat();
    let (batch, samples) = &batches(&[&words])[0];
    assert_eq!(batch.fault, Some(FifoFault::SamplesMissing));
    assert_eq!(*samples, [sample(3)]);
}

#[test]
fn a_half_pair_does_not_survive_an_overrun() {
    // The accelerometer word is of a sample four later, with the same counter.
    let expected = [
        status(1, false),
        read(0x78, &word(GYROSCOPE, 0)),
        status(0, false),
        status(1, true),
        read(0x78, &word(ACCELEROMETER, 4)),
        status(0, false),
    ];
    let read = on_bus(&expected, async |sensor| read_batches(sensor, 2).await);
    let (batch, samples) = &read[1];
    assert!(batch.overrun && batch.gap && samples.is_empty());
}

#[test]
fn nothing_is_delivered_from_a_burst_with_an_overrun() {
    let words = [word(GYROSCOPE, 0), word(ACCELEROMETER, 4), word(GYROSCOPE, 5)];
    let expected = [
        status(3, false),
        read(0x78, words.as_flattened()),
        status(512, true),
        status(1, false),
        read(0x78, &word(ACCELEROMETER, 5)),
        status(510, false),
    ];
    let read = on_bus(&expected, async |sensor| read_batches(sensor, 2).await);
    assert!(read[0].0.overrun && read[0].1.is_empty());
    assert_eq!(read[0].0.samples_left, 256);
    assert!(read[1].1.is_empty());
}

#[test]
fn a_failed_transfer_ends_the_pairing_and_reports_a_gap() {
    let expected = [
        status(1, false),
        read(0x78, &word(GYROSCOPE, 0)),
        status(0, false),
        status(8, false),
        read(0x78, &[0; 56]).with_error(ErrorKind::Bus),
        status(3, false),
        read(
            0x78,
            [word(ACCELEROMETER, 4), word(GYROSCOPE, 5), word(ACCELEROMETER, 5)].as_flattened(),
        ),
        status(0, false),
    ];
    on_bus(&expected, async |sensor| {
        let mut samples = [Sample::default(); 16];
        assert_eq!(read_batches(sensor, 1).await[0].0.count, 0);
        let failed = sensor.read(&mut samples).await;
        assert_eq!(failed, Err(Error::Bus(ErrorKind::Bus)));
        let (batch, samples) = &read_batches(sensor, 1).await[0];
        assert!(batch.gap);
        assert_eq!(batch.fault, Some(FifoFault::GyroscopeMissing));
        assert_eq!(*samples, [sample(5)]);
    });
}

#[test]
fn a_burst_has_at_most_32_words_and_what_the_buffer_holds() {
    let words: Vec<_> =
        (0..16).flat_map(|slot| [word(GYROSCOPE, slot), word(ACCELEROMETER, slot)]).collect();
    let expected = [
        status(512, false),
        read(0x78, words.as_flattened()),
        status(480, false),
        status(480, false),
        read(0x78, [word(GYROSCOPE, 16), word(ACCELEROMETER, 16)].as_flattened()),
        status(478, false),
        status(478, false),
    ];
    on_bus(&expected, async |sensor| {
        let (batch, samples) = &read_batches(sensor, 1).await[0];
        assert_eq!((batch.count, batch.samples_left), (16, 240));
        assert_eq!(samples[15], sample(15));
        let mut one = [Sample::default()];
        assert_eq!(sensor.read(&mut one).await.map(|batch| batch.count), Ok(1));
        assert_eq!(one, [sample(16)]);
        assert_eq!(sensor.read(&mut []).await.map(|batch| batch.samples_left), Ok(239));
    });
}

/// What a disturbed FIFO delivers in place of the next sample's words.
#[derive(Clone, Debug)]
enum Disturbance {
    None,
    Swapped,
    GyroscopeLost,
    AccelerometerLost,
    /// This number of whole samples and then one word.
    Lost(i16),
    /// A bit of the first tag is inverted.
    Flipped(u8),
    Noise([u8; 7]),
}

fn disturbances() -> impl Strategy<Value = Disturbance> {
    use Disturbance::*;
    prop_oneof![
        6 => Just(None),
        2 => Just(Swapped),
        1 => Just(GyroscopeLost),
        1 => Just(AccelerometerLost),
        1 => (1..3_i16).prop_map(Lost),
        1 => (0..8_u8).prop_map(Flipped),
        // A tag of a word that could be a sample's would be one to any reader.
        1 => any::<[u8; 7]>()
            .prop_filter("no sample's tag", |word| !matches!(word[0] >> 3, 1..=4))
            .prop_map(Noise),
    ]
}

proptest! {
    /// Each burst holds arbitrary bytes; the status claims arbitrary levels.
    #[test]
    fn no_bytes_make_the_driver_panic(
        bursts in prop::collection::vec((any::<[u8; 2]>(), any::<[u8; 224]>(), any::<[u8; 2]>()), 1..8),
    ) {
        let mut expected = Vec::new();
        let mut reads = 0;
        for (before, bytes, after) in &bursts {
            expected.push(read(0x3A, before));
            reads += 1;
            let words = usize::from(u16::from_le_bytes([before[0], before[1] & 3]));
            if before[1] == 0xFF || words == 0 {
                continue;
            }
            expected.push(read(0x78, &bytes[..7 * words.min(32)]));
            expected.push(read(0x3A, after));
        }
        on_bus(&expected, async |sensor| {
            for _ in 0..reads {
                let mut samples = [Sample::default(); 16];
                if let Ok(batch) = sensor.read(&mut samples).await {
                    assert!(batch.count <= 16);
                }
            }
        });
    }

    /// Words are swapped, lost, damaged and inserted; fewer than four samples are lost at once
    /// without a report, which is what the tag counter can show.
    #[test]
    fn no_disturbance_pairs_words_of_different_samples(
        disturbances in prop::collection::vec(disturbances(), 1..60),
        lengths in prop::collection::vec(1..33_usize, 60),
    ) {
        let mut words = Vec::new();
        let mut slot = 0;
        for disturbance in disturbances {
            let (mut first, second) = (word(GYROSCOPE, slot), word(ACCELEROMETER, slot));
            match disturbance {
                Disturbance::None => words.extend([first, second]),
                Disturbance::Swapped => words.extend([second, first]),
                Disturbance::GyroscopeLost => words.push(second),
                Disturbance::AccelerometerLost => words.push(first),
                Disturbance::Lost(samples) => {
                    slot += samples;
                    words.push(word(ACCELEROMETER, slot));
                }
                Disturbance::Flipped(bit) => {
                    first[0] ^= 1 << bit;
                    words.extend([first, second]);
                }
                Disturbance::Noise(noise) => words.extend([first, noise, second]),
            }
            slot += 1;
        }
        let mut rest = words.as_slice();
        let mut bursts = Vec::new();
        for length in lengths {
            let (now, later) = rest.split_at(length.min(rest.len()));
            rest = later;
            if !now.is_empty() {
                bursts.push(now);
            }
        }
        let mut last = None;
        for (batch, samples) in batches(&bursts) {
            if batch.gap {
                last = None;
            }
            for sample in samples {
                let slot = sample.acceleration[0];
                prop_assert_eq!(sample.angular_rate[0], slot, "of one sample");
                prop_assert!(last.is_none_or(|last| slot == last + 1), "{last:?}, {slot}");
                last = Some(slot);
            }
        }
    }
}
