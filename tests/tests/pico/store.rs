//! What the flash keeps.

use wimu_host::calibration::parameter_id;
use wimu_link::message::{Event, Payload, Status};
use wimu_link::{Answer, Command, LinkRole, Settings};
use wimu_model::{ParameterId, ParameterSet, Sensitivity};
use wimu_testkit::figure;
use wimu_tests::{ROLES, compiled, who_are_you};

use super::run::{CABLE, Run, WIRELESS, cut, happens, rate, request, run, send};

/// What the image needs beside its static memory, bytes: storing and reading a set.
const MOST_STACK: u64 = 10_240;

fn set(lsb_per_g: f64) -> ParameterSet {
    let sensitivity = Sensitivity::from_lsb_per_g(lsb_per_g).expect("in range");
    ParameterSet::uncalibrated(2, sensitivity)
}

/// The frame that pushes a set, under an id.
fn push(set: &ParameterSet, id: u32) -> Vec<u8> {
    request(id, Command::SetParameters(compiled(set)))
}

#[test]
#[ignore = "cargo xtask release --only pico"]
fn a_set_that_was_pushed_is_in_use_after_the_power_was_off() {
    let set = set(16_500.0);
    let push = push(&set, 1);
    let run = run(
        4.0,
        &[
            send(1_300, CABLE, &push),
            happens(2_500, "power"),
            send(3_300, CABLE, &request(1, Command::GetParameters)),
        ],
    );
    let stack = run.report["stack_bytes"].as_u64().expect("a number");
    let claim = "Pico: stack while a set is stored and read, bytes";
    let target = format!("at most {MOST_STACK}");
    figure(claim, stack, &target, stack <= MOST_STACK);
    assert!(stack <= MOST_STACK, "{stack}");
    for role in ROLES {
        let ids: Vec<_> =
            run.boots(role).iter().map(|boot| boot.hello.expect("a hello").parameter_id).collect();
        assert_eq!(ids, [ParameterId::UNCALIBRATED, parameter_id(&set)]);
        let last = run.boots(role).last().expect("a start");
        let epoch = last.epochs().last().expect("an epoch").epoch;
        assert_eq!(epoch.parameter_id(), parameter_id(&set));
    }
}

#[test]
#[ignore = "cargo xtask release --only pico"]
fn power_that_fails_in_the_middle_of_any_write_leaves_the_old_set_or_the_new_one() {
    let [old, new] = [16_500.0, 16_200.0].map(set);
    let mut outcomes = Vec::new();
    for count in 1.. {
        let (push_old, push_new) = (push(&old, 1), push(&new, 3));
        let run = run(
            3.2,
            &[send(1_000, CABLE, &push_old), cut(1_700, count), send(1_800, CABLE, &push_new)],
        );
        if run.report["resets"] == 0 {
            break;
        }
        let boot = run.boots(LinkRole::Cable).last().expect("a start");
        let hello = boot.hello.expect("a hello");
        assert_eq!(hello.boot_count, 2, "cut {count}");
        let unreadable = boot.events.iter().any(|(_, event)| *event == Event::StoreUnreadable);
        assert!(!unreadable, "cut {count}: {:?}", boot.events);
        outcomes.push(hello.parameter_id);
    }
    assert!(outcomes.len() >= 3, "{outcomes:?}");
    let (old, new) = (parameter_id(&old), parameter_id(&new));
    assert!(outcomes.iter().all(|id| [old, new].contains(id)), "{outcomes:?}");
    figure(
        "Pico: power cut within a write of a set: neither old nor new",
        format!("0 of {}", outcomes.len()),
        "none",
        true,
    );
    assert!(outcomes.is_sorted_by_key(|id| *id == new), "{outcomes:?}");
}

/// When [`pushed_at`] starts the board with its settings, ms.
const STARTED_MS: u32 = 2_000;

/// A run at `rate_hz` in which the wireless link is too slow for what is asked of it and `pushes` sets are pushed, one a
/// second, on a flash that erases in the time `flash` says.
fn pushed_at(rate_hz: u16, pushes: u32, flash: &str) -> Run {
    let settings = Settings { rate_hz, ..Settings::default() };
    let mut script = vec![
        happens(0, flash),
        send(700, CABLE, &request(1, Command::SetLineRate { baud: 9600 })),
        send(1_000, CABLE, &request(2, Command::SetSettings(settings))),
        happens(STARTED_MS, "power"),
        rate(STARTED_MS, WIRELESS, 9600),
        send(3_000, CABLE, &who_are_you()),
    ];
    for k in 0..pushes {
        let push = push(&set(16_000.0 + f64::from(k)), 10 + k);
        script.push(send(5_500 + k * 1_000, CABLE, &push));
    }
    let asked_ms = asked_ms(pushes);
    script.push(send(asked_ms, CABLE, &request(900, Command::GetStatus)));
    run(f64::from(asked_ms) / 1_000.0 + 1.0, &script)
}

/// When the status is asked for, after `pushes` of [`pushed_at`], ms.
fn asked_ms(pushes: u32) -> u32 {
    7_000 + pushes * 1_000
}

/// Its last status, after everything was accepted and the wireless link has shed.
fn status(run: &Run) -> Status {
    let replies = run.link(LinkRole::Cable).replies();
    for reply in replies {
        assert!(matches!(reply.answer, Answer::Accepted(_)), "{reply:?}");
    }
    let Some(Answer::Accepted(Payload::Status(status))) = replies.last().map(|last| last.answer)
    else {
        panic!("{:?}", replies.last());
    };
    let wireless = status.wireless.expect("two links");
    assert!(wireless.telemetry_shed > 0, "{wireless:?}");
    status
}

#[test]
#[ignore = "cargo xtask release --only pico"]
fn what_the_fifo_cannot_hold_while_the_flash_is_erased_is_counted_to_the_sample() {
    // Each change erases a sector: 45 ms, or the flash's worst, 400 ms. The FIFO holds 32 samples, at most 16 of which
    // are not read yet; eight more are given up after an overrun.
    let pushes = 10;
    for (rate_hz, flash) in [(200, ""), (800, ""), (400, "slow_flash")] {
        let run = pushed_at(rate_hz, pushes, flash);
        let sensor = status(&run).sensor;
        let overwritten = run.report["overruns"].as_u64().expect("a number") as u32;
        let since_power_on = STARTED_MS..asked_ms(pushes);
        let mut taken = run.taken_us();
        taken.retain(|us| since_power_on.contains(&((us / 1e3) as u32)));
        let unaccounted = taken.len() as u32 - sensor.samples - sensor.missed;
        figure(
            &format!(
                "Pico, {rate_hz} Hz, {flash}: samples missed of those overwritten; neither sent nor counted"
            ),
            format!("{} of {overwritten}; {unaccounted}", sensor.missed),
            "at most 16 not counted",
            unaccounted <= 16,
        );
        assert!(unaccounted <= 16, "{sensor:?}, {unaccounted}");
        assert_eq!(sensor.missed == 0, rate_hz == 200, "{sensor:?}");
        let given_up = sensor.missed - overwritten.min(sensor.missed);
        assert!(given_up <= 8 * pushes + 2, "{sensor:?}, {overwritten}");
    }
}
