//! Replays of a recording of today that was changed: every difference is found, and no loss is one.

use std::path::Path;

use wimu_host::capture::{Boot, Capture, EpochMark};
use wimu_host::decode::TimedSample;
use wimu_host::replay::verify;
use wimu_link::batch::Stream;
use wimu_link::message::EpochReason;

/// The start in a frozen recording of a board with a gyroscope.
fn boot() -> Boot {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/vectors/compat");
    let recording = Capture::load(&folder.join("gyroscope.mcap")).unwrap();
    recording.link(None).unwrap().boots[0].clone()
}

fn samples(boot: &mut Boot, stream: Stream) -> &mut Vec<TimedSample> {
    boot.samples.get_mut(&(0, stream)).expect("samples")
}

fn marks(boot: &mut Boot) -> &mut Vec<EpochMark> {
    boot.marks.get_mut(&0).expect("epochs")
}

/// The first epoch for this reason.
fn epoch(boot: &Boot, reason: EpochReason) -> usize {
    boot.epochs().iter().position(|mark| mark.epoch.reason == reason).expect("such an epoch")
}

#[test]
fn any_difference_is_found_and_located() {
    let intact = boot();
    let report = verify(&intact, 0);
    assert!(report.is_exact() && report.corrected_compared > 1000, "{report:?}");
    let changed = |change: &dyn Fn(&mut Boot)| {
        let mut other = intact.clone();
        change(&mut other);
        let report = verify(&other, 0);
        assert!(!report.is_exact());
        report
    };
    let sample = intact.corrected().len() / 2;
    let report = changed(&|boot| samples(boot, Stream::Corrected)[sample].value[1] += 1);
    let sequence = intact.corrected()[sample].sequence;
    assert_eq!((report.corrected_differ, report.first_difference), (1, Some(sequence)));
    let position = intact.navigation.len() / 2;
    let report = changed(&|boot| boot.navigation[position].position_nm[2] -= 1);
    assert_eq!(report.navigation_differ, 1);
    let report = changed(&|boot| samples(boot, Stream::Raw)[sample].value[0] += 1);
    assert!(report.corrected_differ == 1 && report.states_differ > 0, "{report:?}");
    let report = changed(&|boot| {
        samples(boot, Stream::Corrected)[sample].rate.as_mut().expect("a rate")[2] += 1;
    });
    assert_eq!((report.rates_differ, report.corrected_differ), (1, 0));
    let report = changed(&|boot| boot.attitude[20].quaternion[0] ^= 1);
    assert_eq!(report.attitudes_differ, 1);
    let report = changed(&|boot| {
        samples(boot, Stream::Raw)[sample].rate.as_mut().expect("a rate")[1] += 1;
    });
    assert!(report.rates_differ == 1 && report.states_differ > 0, "{report:?}");
    let mark = epoch(&intact, EpochReason::Periodic);
    let report = changed(&|boot| marks(boot)[mark].epoch.state.rest_mean[0] ^= 1);
    assert_eq!(report.states_differ, 1);
    // By other arithmetic nothing is computed again, and nothing is said to differ; without
    // parameters neither.
    let others: [&dyn Fn(&mut Boot); 2] =
        [&|boot| marks(boot).iter_mut().for_each(|mark| mark.epoch.revision += 1), &|boot| {
            boot.parameters.clear()
        }];
    for change in others {
        let report = changed(change);
        assert_eq!((report.samples, report.epochs_unusable), (0, intact.epochs().len() as u64));
    }
}

#[test]
fn what_is_lost_makes_samples_uncertain_or_a_break_and_not_different() {
    let intact = boot();
    let whole = verify(&intact, 0);
    let mut lossy = intact.clone();
    let middle = lossy.raw().len() / 2;
    samples(&mut lossy, Stream::Raw).drain(middle..middle + 16);
    let report = verify(&lossy, 0);
    assert!(report.is_exact(), "{report:?}");
    assert_eq!(report.breaks, whole.breaks + 1);
    assert!((whole.samples - 200..=whole.samples - 16).contains(&report.samples), "{report:?}");
    // An epoch with which the temperature changed.
    let mut lossy = intact;
    let lost = epoch(&lossy, EpochReason::Temperature);
    marks(&mut lossy).remove(lost);
    marks(&mut lossy)[lost].after_loss = true;
    let report = verify(&lossy, 0);
    assert!(report.is_exact() && report.samples_uncertain > 0, "{report:?}");
}

#[test]
fn numbers_that_wrap_are_replayed_and_their_times_found() {
    let mut boot = boot();
    let whole = verify(&boot, 0);
    let middle = boot.raw().len() / 2;
    let (first, at) = (boot.raw()[0].sequence, boot.time_of(boot.raw()[middle].sequence));
    let ahead = 0_u32.wrapping_sub(boot.raw()[middle].sequence);
    let numbers = (boot.samples.values_mut().flatten().map(|s| &mut s.sequence))
        .chain(boot.navigation.iter_mut().map(|n| &mut n.sequence))
        .chain(boot.attitude.iter_mut().map(|a| &mut a.sequence))
        .chain(boot.marks.values_mut().flatten().map(|mark| &mut mark.epoch.sequence));
    numbers.for_each(|number| *number = number.wrapping_add(ahead));
    assert_eq!(verify(&boot, 0), whole);
    assert_eq!(boot.time_of(0), at);
    assert!(boot.time_of(first.wrapping_add(ahead)).is_some());
}
