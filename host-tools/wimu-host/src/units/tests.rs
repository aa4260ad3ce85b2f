use proptest::prelude::*;

use super::*;

/// At 100 Hz: epochs every 90 samples or so.
fn epoch(number: u8, sequence: u32, range_g: u8, reason: EpochReason) -> Epoch {
    Epoch {
        reason,
        number,
        sequence,
        time_us: u64::from(sequence) * 10_000,
        period_ns: 10_000_000,
        range_g,
        sensitivity_lsb_per_g: 32_768.0 / f64::from(range_g),
        full_scale: 32_752,
        parameters: 0,
        temperature_centi_c: None,
        ..Epoch::default()
    }
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
fn every_sample_has_the_unit_of_the_epoch_that_holds_for_its_number() {
    let units = changing(&[]);
    for sequence in 0..690 {
        assert_eq!(range(&units, sequence), Some(truth(sequence)), "{sequence}");
    }
    // The next epoch would have come by then.
    assert_eq!(range(&units, 700), None);
}

#[test]
fn where_a_changes_epoch_is_lost_the_unit_is_unknown_until_the_next() {
    let units = changing(&[3]);
    assert_eq!(range(&units, 180), Some(2.0));
    assert_eq!(range(&units, 181), None);
    assert_eq!(range(&units, 339), None);
    assert_eq!(range(&units, 340), Some(16.0));
    assert_eq!(range(&units, 499), Some(16.0));
}

#[test]
fn where_an_epoch_without_a_change_is_lost_nothing_is_unknown() {
    let units = changing(&[1, 4, 7]);
    for sequence in 0..600 {
        assert_eq!(range(&units, sequence), Some(truth(sequence)), "{sequence}");
    }
}

#[test]
fn a_range_set_there_and_back_in_a_loss_leaves_no_wrong_unit() {
    let units = changing(&[3, 4, 5]);
    assert_eq!(range(&units, 300), None);
    let units = changing(&[3, 4, 5, 6]);
    assert_eq!(range(&units, 300), None);
    assert_eq!(range(&units, 595), Some(2.0));
}

#[test]
fn an_epoch_sent_again_for_a_new_listener_does_not_hide_the_change_before_it() {
    let mut units = changing(&[3, 4, 5, 6, 7]);
    units.see(&epoch(3, 300, 16, EpochReason::Periodic));
    assert_eq!(range(&units, 260), None);
    assert_eq!(range(&units, 300), Some(16.0));
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

#[test]
fn a_day_of_epochs_is_one_entry() {
    let mut units = RawUnits::default();
    for number in 0..86_400_u32 {
        units.see(&epoch(number as u8, number * 90, 2, EpochReason::Periodic));
    }
    assert_eq!(units.runs.len(), 1);
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
