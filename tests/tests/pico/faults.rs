//! What stops the processor, and what is told of it afterwards.

use wimu_link::LinkRole;
use wimu_link::hello::{Fault, ResetReason};
use wimu_tests::{ROLES, assert_replays};

use super::image::Image;
use super::run::{Run, call, happens, run};

/// Why each start was, as both links tell it.
fn starts(run: &Run) -> Vec<(ResetReason, Option<Fault>)> {
    let of = |role| {
        let boots = run.boots(role).iter();
        boots
            .filter_map(|boot| boot.hello)
            .map(|hello| (hello.reset_reason, hello.fault))
            .collect::<Vec<_>>()
    };
    let [cable, wireless] = ROLES.map(of);
    assert_eq!(cable, wireless);
    cable
}

/// That the last start samples as the first did.
fn assert_samples_again(run: &Run, least: usize) {
    for role in ROLES {
        let boot = run.boots(role).last().expect("a start");
        assert!(boot.raw().len() > least, "{role}: {}", boot.raw().len());
        assert_replays(boot);
    }
}

#[test]
#[ignore = "cargo xtask release --only pico"]
fn a_fault_is_told_with_its_place_in_the_hello_after_the_reset() {
    let run = run(4.0, &[happens(1_500, "fault"), happens(3_000, "reset")]);
    assert_eq!(
        starts(&run),
        [
            (ResetReason::PowerOn, None),
            (ResetReason::Fault, Some(Fault::processor("hard fault", 0x1018_0000))),
            // Once.
            (ResetReason::Pin, None),
        ]
    );
    assert_samples_again(&run, 40);
}

#[test]
#[ignore = "cargo xtask release --only pico"]
fn a_panic_is_told_with_its_address_in_the_hello_after_the_reset() {
    // What a copy between slices of different lengths would do.
    let panics = Image::read().function("17len_mismatch_fail");
    let run = run(4.0, &[call(1_500, panics, 0), happens(3_000, "reset")]);
    let starts = starts(&run);
    let reasons: Vec<_> = starts.iter().map(|start| start.0).collect();
    assert_eq!(reasons, [ResetReason::PowerOn, ResetReason::Fault, ResetReason::Pin]);
    let fault = starts[1].1.expect("a fault");
    assert!(fault.to_string().starts_with("panic "), "{fault}");
    assert!((panics..panics + 16).contains(&fault.address), "{fault}");
    assert_samples_again(&run, 40);
}

#[test]
#[ignore = "cargo xtask release --only pico"]
fn a_processor_that_hangs_is_started_anew_by_its_watchdog_which_the_hello_tells() {
    let run = run(5.0, &[happens(1_500, "hang")]);
    assert_eq!(starts(&run), [(ResetReason::PowerOn, None), (ResetReason::Watchdog, None),]);
    // Two seconds at most without it.
    assert_samples_again(&run, 100);
}

#[test]
#[ignore = "cargo xtask release --only pico"]
fn three_starts_that_fail_lead_to_safe_mode_until_the_next_reset() {
    let faults = [500, 1_500, 2_500].map(|at_ms| happens(at_ms, "fault"));
    let [first, second, third] = faults;
    let run = run(7.0, &[first, second, third, happens(6_000, "reset")]);
    for role in ROLES {
        let hellos = run.boots(role).iter().filter_map(|boot| boot.hello);
        let hellos: Vec<_> = hellos.collect();
        let modes: Vec<bool> = hellos.iter().map(|hello| hello.safe_mode).collect();
        assert_eq!(modes, [false, false, false, true, false]);
        assert_eq!(hellos[3].reset_reason, ResetReason::Fault);
        assert!(hellos[3].fault.is_some());
        let safe = &run.boots(role)[3];
        assert!(safe.raw().len() > 150 && safe.corrected().is_empty());
    }
    assert_samples_again(&run, 40);
}

#[test]
#[ignore = "cargo xtask release --only pico"]
fn an_image_that_differs_from_its_crc_starts_in_safe_mode() {
    let run = run(5.0, &[happens(1_500, "damage"), happens(2_500, "reset")]);
    for role in ROLES {
        let hellos = run.boots(role).iter().filter_map(|boot| boot.hello);
        let hellos: Vec<_> = hellos.collect();
        assert_eq!((hellos[0].safe_mode, hellos[0].fault), (false, None));
        assert!(hellos[1].safe_mode);
        let fault = hellos[1].fault.expect("a fault").to_string();
        assert!(fault.starts_with("image CRC at 0x"), "{fault}");
        let raw = run.boots(role)[1].raw().len();
        assert!(raw > 100, "{raw}");
    }
}

#[test]
#[ignore = "cargo xtask release --only pico"]
fn starts_are_counted_in_the_flash_and_power_is_told_from_the_reset_button() {
    let run =
        run(4.0, &[happens(1_000, "reset"), happens(2_000, "power"), happens(3_000, "reset")]);
    let expected = [ResetReason::PowerOn, ResetReason::Pin, ResetReason::PowerOn, ResetReason::Pin];
    let reasons: Vec<_> = starts(&run).iter().map(|start| start.0).collect();
    assert_eq!(reasons, expected);
    let boots = run.boots(LinkRole::Cable).iter();
    let counts: Vec<u32> = boots.filter_map(|b| Some(b.hello?.boot_count)).collect();
    assert_eq!(counts, [1, 2, 3, 4]);
}
