//! Sensors that are absent, lost, stuck, or not the ones they should be.

use wimu_link::message::{BusFault, EpochReason, Event, Settings};
use wimu_link::{Answer, Command, LinkRole};
use wimu_sim::board::{Board, BoardConfig};
use wimu_sim::scene::World;
use wimu_sim::source::Physics;
use wimu_tests::{ROLES, Rig, assert_replays, gaps, sensor, who_are_you};

fn is_lost(event: &Event) -> bool {
    matches!(event, Event::SensorLost(_))
}

/// How many events of this kind the cable brought.
fn count(rig: &Rig, is: impl Fn(&Event) -> bool) -> usize {
    let events = rig.link(LinkRole::Cable).events();
    events.iter().filter(|event| is(event)).count()
}

fn still_answers(rig: &mut Rig) {
    for role in ROLES {
        let answer = rig.ask(role, Command::GetStatus);
        assert!(matches!(answer, Answer::Accepted(_)), "{answer:?}");
    }
}

/// Breaks a running board for a second in one way, mends it in another.
fn survives(what: &str, expected: BusFault, break_it: fn(&Board), mend: fn(&Board)) {
    let mut rig = Rig::usual();
    rig.run(3.0);
    let taken_before = rig.boot(LinkRole::Cable).raw().len();
    break_it(&rig.board);
    rig.run(0.5);
    still_answers(&mut rig);
    rig.run(0.5);
    let broken_us = rig.board.now_us();
    mend(&rig.board);
    rig.run(4.0);

    let status = rig.status();
    assert!(status.sensor.bus_errors > 0, "{what}: {status:?}");
    for role in ROLES {
        let events = rig.link(role).events();
        let told = [Event::SensorLost(expected), Event::SensorFound];
        assert_eq!(events, told, "{what}");
        let boot = rig.boot(role);
        assert!(boot.raw().len() > taken_before + 350, "{what}: sampling resumes");
        let holes = gaps(boot.raw());
        let [(_, missing)] = holes[..] else {
            panic!("{what}: one gap in the numbers, not {holes:?}");
        };
        assert_eq!(missing, status.sensor.missed, "{what}");
        assert!((90..=140).contains(&missing), "{what}: {missing} of 100 Hz");
        // Numbers and times tell the same story, also across the gap.
        let [first, .., last] = boot.raw() else {
            panic!("{what}: no samples");
        };
        let passed = (last.time.0 - first.time.0) as f64 * 1e-4;
        let counted = f64::from(last.sequence - first.sequence);
        assert!((passed - counted).abs() < 4.0, "{what}: {passed} periods, {counted} numbers");
        let after: Vec<_> =
            boot.epochs().iter().filter(|mark| mark.epoch.time_us > broken_us).collect();
        assert_eq!(after[0].epoch.reason, EpochReason::Gap, "{what}");
        assert_replays(boot);
        assert!(
            boot.environment.last().is_some_and(|last| {
                last.time_us > broken_us + 2_000_000 && last.magnetic_field_nt.is_some()
            }),
            "{what}: magnetic field and temperature resume"
        );
    }
}

#[test]
fn a_sensor_that_goes_and_comes_back_leaves_a_gap_in_the_numbers() {
    survives(
        "sensor unplugged",
        BusFault::NoAnswer,
        |board| board.sensor().set_present(false),
        |board| board.sensor().set_present(true),
    );
}

#[test]
fn a_stuck_bus_leaves_a_gap_in_the_numbers() {
    survives(
        "stuck bus",
        BusFault::Transfer,
        |board| board.bus_faults().set_stuck(true),
        |board| board.bus_faults().clear(),
    );
}

#[test]
fn a_bus_that_fails_at_any_transfer_leaves_a_gap_in_the_numbers() {
    let breaks: [fn(&Board); 6] = [
        |board| board.bus_faults().refuse_after(0),
        |board| board.bus_faults().refuse_after(1),
        |board| board.bus_faults().refuse_after(2),
        |board| board.bus_faults().refuse_after(3),
        |board| board.bus_faults().refuse_after(4),
        |board| board.bus_faults().refuse_after(5),
    ];
    for break_it in breaks {
        survives("refused transfers", BusFault::NoAnswer, break_it, |board| {
            board.bus_faults().clear();
        });
    }
}

#[test]
fn one_failed_transfer_never_makes_what_follows_another_than_is_replayed() {
    for rate_hz in [1, 10, 100, 400] {
        let mut rig = Rig::usual();
        rig.run(0.5);
        rig.set(Settings { rate_hz, ..Settings::default() });
        for _ in 0..4 {
            rig.run(4.0);
            let before = rig.status().sensor.bus_errors;
            rig.board.bus_faults().refuse_after(0);
            while rig.status().sensor.bus_errors == before {
                rig.run(0.001);
            }
            rig.board.bus_faults().clear();
        }
        rig.run(6.0);
        for role in ROLES {
            assert_replays(rig.boot(role));
        }
    }
}

#[test]
fn a_host_that_comes_later_is_told_what_is_wrong() {
    let mut rig = Rig::usual();
    rig.board.sensor().set_present(false);
    for role in ROLES {
        rig.listen(role, false);
    }
    rig.run(5.0);
    for role in ROLES {
        rig.board.link(role).pull();
        rig.listen(role, true);
        rig.send(role, &who_are_you());
    }
    rig.run(0.2);
    for role in ROLES {
        let told = rig.link(role).events();
        assert_eq!(told, [Event::SensorLost(BusFault::NoAnswer)]);
    }
    rig.board.sensor().set_present(true);
    rig.run(2.0);
    for role in ROLES {
        rig.send(role, &who_are_you());
    }
    rig.run(0.5);
    let told = rig.link(LinkRole::Cable).events();
    assert_eq!(told, [Event::SensorLost(BusFault::NoAnswer), Event::SensorFound]);
}

#[test]
fn a_sensor_that_fails_again_at_every_transfer_of_its_start_comes_back_in_the_end() {
    let mut rig = Rig::usual();
    rig.run(1.0);
    rig.board.sensor().set_present(false);
    rig.run(0.3);
    rig.board.sensor().set_present(true);
    for transfers in 0..30 {
        rig.board.bus_faults().refuse_after(transfers);
        rig.run(0.25);
    }
    rig.board.bus_faults().clear();
    rig.run(3.0);
    assert_eq!(rig.link(LinkRole::Cable).events().last(), Some(&Event::SensorFound));
    let raw = rig.boot(LinkRole::Cable).raw();
    assert_eq!(gaps(&raw[raw.len() - 200..]), []);
    assert_replays(rig.boot(LinkRole::Cable));
}

#[test]
fn a_board_without_its_sensor_says_so_and_starts_when_it_comes() {
    let mut rig = Rig::usual();
    rig.board.sensor().set_present(false);
    rig.run(2.0);
    for role in ROLES {
        assert_eq!(rig.link(role).events(), [Event::SensorLost(BusFault::NoAnswer)]);
        rig.send(role, &who_are_you());
    }
    still_answers(&mut rig);
    for role in ROLES {
        assert!(rig.boot(role).hello.is_some());
        assert!(rig.boot(role).raw().is_empty());
    }
    rig.board.sensor().set_present(true);
    rig.run(4.0);
    for role in ROLES {
        assert_eq!(
            rig.link(role).events(),
            [Event::SensorLost(BusFault::NoAnswer), Event::SensorFound]
        );
        assert!(rig.boot(role).raw().len() > 300);
        rig.link(role).assert_perfect();
        assert_eq!(rig.boot(role).epochs()[0].epoch.reason, EpochReason::Start);
    }
}

#[test]
fn settings_are_refused_while_the_sensor_is_away_and_taken_when_it_is_back() {
    use wimu_link::message::Refusal;
    let mut rig = Rig::usual();
    rig.run(1.0);
    rig.board.sensor().set_present(false);
    rig.run(0.5);
    let before = rig.settings();
    let faster = Settings { rate_hz: 200, ..before };
    let answer = rig.ask(LinkRole::Cable, Command::SetSettings(faster));
    assert_eq!(answer, Answer::Refused(Refusal::SensorFailed));
    assert_eq!(rig.settings(), before);
    rig.board.sensor().set_present(true);
    rig.run(1.0);
    assert_eq!(count(&rig, is_lost), 1);
    rig.set(faster);
    rig.run(2.0);
    let epochs = rig.boot(LinkRole::Cable).epochs();
    let period = epochs[epochs.len() - 1].epoch.period_ns;
    assert!(period.abs_diff(5_000_000) < 25_000, "{period} ns");
    assert_replays(rig.boot(LinkRole::Cable));
}

#[test]
fn another_chip_is_named_and_never_sampled() {
    let mut rig = Rig::usual();
    rig.board.sensor().set_who_am_i(0x44);
    rig.run(2.0);
    still_answers(&mut rig);
    let told = Event::WrongSensor { expected: 0x33, found: 0x44 };
    for role in ROLES {
        assert_eq!(rig.link(role).events(), [told]);
        assert!(rig.boot(role).raw().is_empty());
    }
    rig.board.sensor().set_who_am_i(0x33);
    rig.run(2.0);
    assert_eq!(rig.link(LinkRole::Cable).events(), [told, Event::SensorFound]);
    assert!(rig.boot(LinkRole::Cable).raw().len() > 150);
}

#[test]
fn a_sensor_that_is_exchanged_for_another_chip_while_running_is_named() {
    let mut rig = Rig::usual();
    rig.run(2.0);
    rig.board.sensor().set_present(false);
    rig.run(1.0);
    rig.board.sensor().set_who_am_i(0x44);
    rig.board.sensor().set_present(true);
    rig.run(2.0);
    let told =
        [Event::SensorLost(BusFault::NoAnswer), Event::WrongSensor { expected: 0x33, found: 0x44 }];
    assert_eq!(rig.link(LinkRole::Cable).events(), told);
}

#[test]
fn a_sensor_that_answers_but_gives_no_data_is_lost_once_and_not_found() {
    use wimu_model::Counts;
    use wimu_sim::source::Replay;
    let samples = (0..300).map(|k| Counts([k, -k, 16384]));
    let mut rig = Rig::new(BoardConfig::default(), Replay::new(samples));
    rig.run(8.0);
    assert_eq!(rig.link(LinkRole::Cable).events(), [Event::SensorLost(BusFault::Timeout)]);
    still_answers(&mut rig);
}

/// A sensor whose period is longer than nominal by this much.
fn off_by(ppm: f64, names: &str) -> Physics {
    let mut physics = sensor(names, World::default(), 5);
    physics.truth.period_error_ppm = ppm;
    physics
}

#[test]
fn a_sensor_clock_that_is_off_by_0_3_percent_is_measured_and_no_sample_is_taken_for_missing() {
    for ppm in [3000.0, -3000.0] {
        let mut rig = Rig::new(BoardConfig::default(), off_by(ppm, "rest,slide,rest"));
        rig.run(25.0);
        let status = rig.status();
        let truth_ns = 1e7 * (1.0 + ppm * 1e-6);
        let measured = f64::from(status.measured_period_ns.expect("25 s are enough"));
        assert!((measured / truth_ns - 1.0).abs() < 20e-6, "{measured} ns");
        let jitter = status.jitter_ns.expect("25 s are enough");
        assert!(jitter <= 1_500, "{jitter} ns");
        assert_eq!((status.sensor.missed, status.sensor.overruns), (0, 0));
        // The FIFO's line tells of four.
        let unread = rig.board.sensor().samples_taken() - u64::from(status.sensor.samples);
        assert!(unread <= 4, "{unread}");
        for role in ROLES {
            rig.link(role).assert_perfect();
            let epochs = rig.boot(role).epochs();
            let used = f64::from(epochs[epochs.len() - 1].epoch.period_ns);
            assert!((used / truth_ns - 1.0).abs() < 60e-6, "{used} ns in use");
        }
    }
}

#[test]
fn every_sample_has_its_number_at_every_rate_of_the_sensor() {
    for rate_hz in [1, 10, 25, 50, 100, 200, 400, 1344] {
        let mut rig = Rig::new(BoardConfig::default(), off_by(-2500.0, "rest,slide,rest"));
        rig.run(0.5);
        rig.set(Settings { rate_hz, ..Settings::default() });
        rig.run(0.01);
        let before = rig.board.sensor().samples_taken();
        let status_before = rig.status().sensor.samples;
        rig.run(6.0);
        let status = rig.status().sensor;
        assert_eq!((status.missed, status.overruns), (0, 0), "{rate_hz} Hz");
        let (taken, read) = (
            rig.board.sensor().samples_taken() - before,
            u64::from(status.samples - status_before),
        );
        assert!(taken.abs_diff(read) <= 30, "{rate_hz} Hz: {read} of {taken}");
        assert!(read as f64 > 5.0 * f64::from(rate_hz), "{rate_hz} Hz");
        for role in ROLES {
            assert_replays(rig.boot(role));
        }
    }
}

/// A board that samples at `rate_hz` while `happens` to it; how many samples were missed.
fn missed_at(rate_hz: u16, after_s: f64, happens: impl Fn(&mut Rig)) -> u32 {
    let mut rig = Rig::new(BoardConfig::default(), off_by(2500.0, "rest,slide,rest"));
    rig.run(0.5);
    rig.set(Settings { rate_hz, ..Settings::default() });
    let taken_before = rig.board.sensor().samples_taken();
    rig.run(after_s);
    let before = rig.status().sensor;
    let begun = rig.boot(LinkRole::Cable).raw().len() - 1;
    happens(&mut rig);
    rig.run(3.0);
    let sensor = rig.status().sensor;
    // What was neither read nor counted as missed waits in the FIFO.
    let taken = rig.board.sensor().samples_taken() - taken_before;
    let counted = sensor.samples - before.samples + sensor.missed;
    // Numbers and times tell the same story.
    let raw = rig.boot(LinkRole::Cable).raw();
    let of = |at: usize| (raw[at].time.0, raw[at].sequence);
    let ((start, first), (end, last)) = (of(begun), of(raw.len() - 1));
    let periods = (end - start) as f64 * f64::from(rate_hz) * 1e-6 / 1.0025;
    assert!(
        (periods - f64::from(last - first)).abs() < 0.8,
        "{rate_hz} Hz: {periods} periods, {} numbers",
        last - first
    );
    assert!(u64::from(counted) <= taken, "{counted} of {taken}");
    for role in ROLES {
        assert_replays(rig.boot(role));
    }
    sensor.missed
}

/// Phases of the FIFO in which something may begin, s; the period is known by then.
const PHASES: [f64; 5] = [4.0, 4.007, 4.016, 4.025, 4.034];

#[test]
fn a_flash_that_is_erased_in_small_steps_costs_no_sample_at_any_rate() {
    for rate_hz in [100, 200, 400, 1344] {
        for phase in PHASES {
            let missed = missed_at(rate_hz, phase, |rig| {
                // As the micro:bit does it.
                for _ in 0..22 {
                    rig.board.stall(5_100);
                    rig.run(0.003);
                }
            });
            assert_eq!(missed, 0, "{rate_hz} Hz");
        }
    }
}

#[test]
fn a_flash_that_is_erased_at_once_costs_no_sample_up_to_200_hz_and_each_one_is_counted_above() {
    for phase in PHASES {
        let missed = |rate_hz| missed_at(rate_hz, phase, |rig| rig.board.stall(87_000));
        for rate_hz in [25, 50, 100, 200] {
            assert_eq!(missed(rate_hz), 0, "{rate_hz} Hz");
        }
        // 35 and 117 are taken meanwhile; 31 and what the FIFO had room for are left, or none of them if the erase
        // interrupts a read.
        assert!((1..=20).contains(&missed(400)), "{}", missed(400));
        assert!((86..=117).contains(&missed(1344)), "{}", missed(1344));
    }
}
