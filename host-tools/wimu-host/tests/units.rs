//! Units of raw samples where epochs are lost, repeated and out of order.

use proptest::prelude::*;
use wimu_host::units::RawUnits;
use wimu_link::message::{Epoch, EpochReason};

use crate::common::frames;

/// At 100 Hz: epochs every 90 samples or so.
fn epoch(number: u8, sequence: u32, range_g: u8, reason: EpochReason) -> Epoch {
    let sensitivity_lsb_per_g = 32_768.0 / f64::from(range_g);
    let epoch = frames::epoch(sequence, u64::from(sequence) * frames::PERIOD_US);
    Epoch { reason, number, range_g, sensitivity_lsb_per_g, ..epoch }
}

/// Range 2 from 0, 16 from 250, 2 again from 500; what is told by all epochs whose index is not
/// named here.
fn changing(lost: &[usize]) -> RawUnits {
    use EpochReason::{Periodic, Settings, Start};
    let epochs = [
        (0, 2, Start),
        (90, 2, Periodic),
        (180, 2, Periodic),
        (250, 16, Settings),
        (340, 16, Periodic),
        (430, 16, Periodic),
        (500, 2, Settings),
        (590, 2, Periodic),
    ];
    let mut units = RawUnits::default();
    for (index, (sequence, range_g, reason)) in epochs.into_iter().enumerate() {
        if !lost.contains(&index) {
            units.see(&epoch(index as u8, sequence, range_g, reason));
        }
    }
    units
}

fn range(units: &RawUnits, sequence: u32) -> Option<f64> {
    let unit = units.of(sequence)?;
    Some(32_768.0 / unit.sensitivity.lsb_per_g())
}

fn truth(sequence: u32) -> f64 {
    if (250..500).contains(&sequence) { 16.0 } else { 2.0 }
}

#[test]
fn every_sample_has_the_unit_of_its_epoch_and_none_where_a_change_may_be_lost() {
    type Ranges = [(u32, Option<f64>)];
    // What is lost, and samples with their ranges.
    let cases: [(&[usize], &Ranges); 5] = [
        // The next epoch would have come by then.
        (&[], &[(700, None)]),
        (&[3], &[(180, Some(2.0)), (181, None), (339, None), (340, Some(16.0)), (499, Some(16.0))]),
        (&[1, 4, 7], &[]),
        (&[3, 4, 5], &[(300, None)]),
        (&[3, 4, 5, 6], &[(300, None), (595, Some(2.0))]),
    ];
    for (lost, expected) in cases {
        let units = changing(lost);
        for (sequence, expected) in expected {
            assert_eq!(range(&units, *sequence), *expected, "{lost:?} {sequence}");
        }
    }
    // Where no change is lost, nothing is unknown.
    for lost in [&[][..], &[1, 4, 7]] {
        let units = changing(lost);
        assert!((0..600).all(|sequence| range(&units, sequence) == Some(truth(sequence))));
    }
    // Sent again for a new listener: the change before it is not hidden.
    let mut units = changing(&[3, 4, 5, 6, 7]);
    units.see(&epoch(3, 300, 16, EpochReason::Periodic));
    assert_eq!([260, 300].map(|sequence| range(&units, sequence)), [None, Some(16.0)]);
}

#[test]
fn samples_on_their_way_when_listening_began_have_the_unit_of_the_first_epoch() {
    let mut units = RawUnits::default();
    units.see(&epoch(9, 1000, 4, EpochReason::Periodic));
    assert_eq!(range(&units, 952), Some(4.0));
    assert_eq!(range(&units, 800), None);
    // Not where that is the one with which the range changed.
    let mut units = RawUnits::default();
    units.see(&epoch(9, 1000, 4, EpochReason::Settings));
    assert_eq!(range(&units, 952), None);
}

#[test]
fn numbers_that_ran_around_in_a_long_silence_join_nothing() {
    let mut units = RawUnits::default();
    units.see(&epoch(7, 0, 2, EpochReason::Periodic));
    units.see(&epoch(8, 257 * 90, 2, EpochReason::Periodic));
    assert_eq!(range(&units, 120 * 90), None);
}

proptest! {
    #[test]
    fn no_loss_order_or_repetition_of_epochs_makes_a_wrong_unit(
        changes in prop::collection::vec((1_u32..=95, prop::option::weighted(0.3, 0..3_u8)), 1..60),
        kept in prop::collection::vec((any::<bool>(), any::<u32>()), 120),
    ) {
        // By sequence number: where an epoch begins, and its range.
        let (mut sequence, mut range_g) = (0, 2);
        let mut epochs = vec![epoch(0, 0, 2, EpochReason::Start)];
        for (index, (after, change)) in changes.into_iter().enumerate() {
            sequence += after;
            let wanted = change.map_or(range_g, |power| 2 << power);
            let reason = match change {
                Some(_) => EpochReason::Settings,
                None => EpochReason::Periodic,
            };
            range_g = wanted;
            epochs.push(epoch(index as u8 + 1, sequence, range_g, reason));
        }
        let mut arrived: Vec<_> = epochs
            .iter()
            .chain(&epochs)
            .zip(&kept)
            .filter_map(|(epoch, (kept, order))| kept.then_some((order, epoch)))
            .collect();
        arrived.sort_by_key(|(order, epoch)| (*order, epoch.sequence));
        let mut units = RawUnits::default();
        for (_, epoch) in arrived {
            units.see(epoch);
        }
        // Within a second before the first that arrived and after the last, none need have been lost.
        let arrived = epochs.iter().enumerate().filter(|(index, _)| {
            let again = kept.get(epochs.len() + index).is_some_and(|(kept, _)| *kept);
            again || kept.get(*index).is_some_and(|(kept, _)| *kept)
        });
        let arrived: Vec<u32> = arrived.map(|(_, epoch)| epoch.sequence).collect();
        let (Some(first), Some(last)) = (arrived.first(), arrived.last()) else {
            return Ok(());
        };
        for sequence in *first..=*last {
            let after = epochs.partition_point(|epoch| epoch.sequence <= sequence);
            let truth = f64::from(epochs[after - 1].range_g);
            let found = range(&units, sequence);
            prop_assert!(found.is_none_or(|range| range == truth), "{sequence}: {found:?}, {truth}");
        }
    }
}

#[test]
fn the_units_hold_where_numbers_wrap() {
    use EpochReason::{Periodic, Settings};
    let start = 0_u32.wrapping_sub(200);
    let mut units = RawUnits::default();
    let epochs = [(0, 2, Periodic), (90, 2, Periodic), (180, 2, Periodic), (250, 16, Settings)];
    for (number, (step, range_g, reason)) in (0..).zip(epochs) {
        units.see(&epoch(number, start.wrapping_add(step), range_g, reason));
    }
    for step in 0..330 {
        let expected = if step < 250 { 2.0 } else { 16.0 };
        assert_eq!(range(&units, start.wrapping_add(step)), Some(expected), "{step}");
    }
    let before = start.wrapping_sub(50);
    assert_eq!(range(&units, before), Some(2.0));
}
