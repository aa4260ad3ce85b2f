//! Words of the LSM6DSO's FIFO: pairing, faults, overrun, arbitrary bytes.

use embedded_hal_async::i2c::ErrorKind;
use embedded_hal_mock::eh1::i2c::Transaction;
use proptest::prelude::*;
use wimu_model::Counts;
use wimu_node::sensor::SensorFault;
use wimu_node::{FifoChip, FifoRead};

use crate::lsm6dso::{Chip, on_bus, read};

type Sample = (Counts, Counts);

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

/// Reads all that the FIFO holds, up to 16 samples, `times` times; what an overrun has lost is in `lost`.
async fn read_bursts(chip: &mut Chip, times: usize) -> Vec<(FifoRead, Vec<Sample>)> {
    let mut bursts = Vec::new();
    for _ in 0..times {
        let level = chip.level().await.expect("the bus works");
        let mut samples = [Sample::default(); 16];
        let most = usize::from(level.samples).min(16);
        let read = match chip.read(&mut samples[..most]).await {
            Ok(read) => read,
            Err(SensorFault::GyroscopeStopped) => FifoRead { count: 0, lost: true },
            Err(fault) => panic!("{fault}"),
        };
        let lost = read.lost || level.overrun;
        bursts.push((FifoRead { lost, ..read }, samples[..read.count].to_vec()));
    }
    bursts
}

/// What comes of bursts of these words, an even number each.
fn bursts(words: &[&[[u8; 7]]]) -> Vec<(FifoRead, Vec<Sample>)> {
    let expected: Vec<_> = words.iter().flat_map(|words| burst(words)).collect();
    on_bus(&expected, async |chip| read_bursts(chip, words.len()).await)
}

fn sample(slot: i16) -> Sample {
    (Counts([slot; 3]), Counts([slot; 3]))
}

fn pair(slot: i16) -> [[u8; 7]; 2] {
    [word(GYROSCOPE, slot), word(ACCELEROMETER, slot)]
}

#[test]
fn pairs_are_joined_in_either_order_and_across_bursts() {
    let read = bursts(&[
        // The end of an earlier sample.
        &[word(ACCELEROMETER, 3), word(GYROSCOPE, 0), word(ACCELEROMETER, 0), word(GYROSCOPE, 1)],
        &[word(ACCELEROMETER, 1), word(ACCELEROMETER, 2), word(GYROSCOPE, 2), word(GYROSCOPE, 3)],
    ]);
    assert_eq!(read[0].1, [sample(0)]);
    // A driver that did not start the chip does not know what came before.
    assert!(read[0].0.lost && !read[1].0.lost);
    assert_eq!(read[1].1, [sample(1), sample(2)]);
}

#[test]
fn samples_after_a_fault_are_delivered_and_those_before_it_are_not() {
    let good = [pair(7), pair(8)].concat();
    let mut parity = word(GYROSCOPE, 6);
    parity[0] ^= 1;
    for bad in [
        parity,
        [0; 7],
        [0xFF; 7],
        word(GYROSCOPE, 6),
        word(ACCELEROMETER, 6),
        // A word of sample 11, four samples away from sample 7.
        word(GYROSCOPE, 11),
    ] {
        let words = [&pair(5)[..], &[bad], &good, &[word(GYROSCOPE, 9)]].concat();
        let (read, samples) = &bursts(&[&pair(4), &words])[1];
        assert!(read.lost, "{bad:?}");
        assert_eq!(*samples, [sample(7), sample(8)], "{bad:?}");
    }
    // A skipped tag counter.
    let words = [pair(0), pair(1), pair(3)].concat();
    let (read, samples) = &bursts(&[&words])[0];
    assert!(read.lost);
    assert_eq!(*samples, [sample(3)]);
}

#[test]
fn a_gyroscope_without_words_in_two_reads_has_stopped() {
    let words = [word(ACCELEROMETER, 0), word(ACCELEROMETER, 1)];
    let expected = [burst(&words), burst(&words)].concat();
    on_bus(&expected, async |chip| {
        let mut samples = [Sample::default()];
        chip.level().await.expect("the bus works");
        let first = chip.read(&mut samples).await;
        assert_eq!(first, Ok(FifoRead { count: 0, lost: true }));
        chip.level().await.expect("the bus works");
        assert_eq!(chip.read(&mut samples).await, Err(SensorFault::GyroscopeStopped));
    });
}

#[test]
fn a_half_pair_does_not_survive_an_overrun() {
    // The accelerometer word is of a sample four later, with the same counter.
    let expected = [
        status(2, false),
        read(0x78, [word(ACCELEROMETER, 3), word(GYROSCOPE, 0)].as_flattened()),
        status(0, false),
        status(2, true),
        read(0x78, [word(ACCELEROMETER, 4), word(GYROSCOPE, 5)].as_flattened()),
        status(0, false),
    ];
    let read = on_bus(&expected, async |chip| read_bursts(chip, 2).await);
    let (read, samples) = &read[1];
    assert!(read.lost && samples.is_empty());
}

#[test]
fn nothing_is_delivered_from_a_burst_with_an_overrun() {
    let words = [pair(0), pair(5)].concat();
    let later = [word(ACCELEROMETER, 5), word(GYROSCOPE, 6)];
    let expected = [
        status(4, false),
        read(0x78, words.as_flattened()),
        status(512, true),
        status(2, false),
        read(0x78, later.as_flattened()),
        status(510, false),
    ];
    let read = on_bus(&expected, async |chip| read_bursts(chip, 2).await);
    assert_eq!(read[0], (FifoRead { count: 0, lost: true }, vec![]));
    assert!(read[1].1.is_empty());
}

#[test]
fn a_failed_transfer_ends_the_pairing_and_counts_as_lost_samples() {
    let expected = [
        status(2, false),
        read(0x78, [word(ACCELEROMETER, 3), word(GYROSCOPE, 0)].as_flattened()),
        status(0, false),
        status(8, false),
        read(0x78, &[0; 56]).with_error(ErrorKind::Bus),
        status(4, false),
        read(0x78, [pair(5)[1], pair(6)[0], pair(6)[1], pair(7)[0]].as_flattened()),
        status(0, false),
    ];
    on_bus(&expected, async |chip| {
        assert_eq!(read_bursts(chip, 1).await[0].0.count, 0);
        let level = chip.level().await.expect("the bus works");
        let mut samples = [Sample::default(); 4];
        assert_eq!(level.samples, 4);
        assert_eq!(chip.read(&mut samples).await, Err(SensorFault::Transfer));
        let (read, samples) = &read_bursts(chip, 1).await[0];
        assert!(read.lost);
        assert_eq!(*samples, [sample(6)]);
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
        for (before, bytes, after) in &bursts {
            expected.push(read(0x3A, before));
            let words = usize::from(u16::from_le_bytes([before[0], before[1] & 3])) & !1;
            if before[1] != 0xFF && words != 0 {
                expected.push(read(0x78, &bytes[..7 * words.min(32)]));
                expected.push(read(0x3A, after));
            }
        }
        on_bus(&expected, async |chip| {
            for _ in &bursts {
                let mut samples = [Sample::default(); 16];
                let Ok(level) = chip.level().await else { continue };
                let most = usize::from(level.samples).min(16);
                if most > 0 && let Ok(read) = chip.read(&mut samples[..most]).await {
                    assert!(read.count <= most);
                }
            }
        });
    }

    /// Words are swapped, lost, damaged and inserted; fewer than four samples are lost at once
    /// without a report, which is what the tag counter can show.
    #[test]
    fn no_disturbance_pairs_words_of_different_samples(
        disturbances in prop::collection::vec(disturbances(), 1..60),
        lengths in prop::collection::vec(1..17_usize, 60),
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
        let mut read = Vec::new();
        for length in lengths {
            let (now, later) = rest.split_at((2 * length).min(rest.len() & !1));
            rest = later;
            if !now.is_empty() {
                read.push(now);
            }
        }
        let mut last = None;
        for (burst, samples) in bursts(&read) {
            if burst.lost {
                last = None;
            }
            for (acceleration, angular_rate) in samples {
                let slot = acceleration.0[0];
                prop_assert_eq!(angular_rate.0[0], slot, "of one sample");
                prop_assert!(last.is_none_or(|last| slot == last + 1), "{last:?}, {slot}");
                last = Some(slot);
            }
        }
    }
}
