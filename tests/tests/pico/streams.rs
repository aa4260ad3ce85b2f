//! Both UARTs stream, and the sensor is told of.

use wimu_link::auth::DeviceKey;
use wimu_link::hello::{Capabilities, board};
use wimu_link::message::{BusFault, Event};
use wimu_link::{Answer, Command, LinkRole, Settings};
use wimu_testkit::figure;
use wimu_tests::{ROLES, assert_replays, gaps, who_are_you};

use super::run::{CABLE, WIRELESS, happens, request, run, send};

#[test]
#[ignore = "cargo xtask release --only pico"]
fn it_streams_on_both_uarts_with_the_times_at_which_the_sensor_had_its_samples() {
    let faster = Settings { rate_hz: 400, ..Settings::default() };
    let run = run(
        9.0,
        &[
            send(800, CABLE, &who_are_you()),
            send(900, WIRELESS, &who_are_you()),
            send(1_000, CABLE, &request(1, Command::SetSettings(faster))),
        ],
    );
    assert_eq!(run.report["overruns"], 0);
    let taken = run.taken_us();
    for role in ROLES {
        let link = run.link(role);
        link.assert_perfect();
        let boot = &run.boots(role)[0];
        let hello = boot.hello.expect("it was asked");
        assert_eq!(hello.board.number, board::PICO);
        assert_eq!(hello.role, role);
        assert!(!hello.capabilities.contains(Capabilities::MAGNETOMETER));
        assert!(boot.environment.is_empty());
        assert_eq!(gaps(boot.raw()), []);
        assert!(boot.raw().len() > 3_000, "{}", boot.raw().len());
        // The bar, from when the sensor's true rate is known. A smoothed time may be before its sample.
        let settled = &boot.raw()[boot.raw().len() - 600..];
        let late = settled.iter().map(|sample| {
            let time = sample.time.0 as f64;
            let after = taken.partition_point(|taken| *taken < time);
            [after.wrapping_sub(1), after]
                .iter()
                .filter_map(|&index| taken.get(index))
                .map(|taken| time - taken)
                .min_by(|a, b| a.abs().total_cmp(&b.abs()))
                .expect("some sample")
        });
        let (mut least, mut most) = (f64::MAX, f64::MIN);
        for late in late {
            least = least.min(late);
            most = most.max(late);
        }
        figure(
            &format!("Pico, 400 Hz, {role}: sample times after the sensor's, µs"),
            format!("{least:.1} to {most:.1}"),
            "± 5 of a constant",
            most - least <= 10.0,
        );
        assert!(most - least <= 10.0 && least >= -10.0, "{least} to {most} µs");
    }
    let answers: Vec<_> = run.link(LinkRole::Cable).replies().to_vec();
    assert!(matches!(answers[0].answer, Answer::Accepted(_)), "{answers:?}");
}

#[test]
#[ignore = "cargo xtask release --only pico"]
fn a_sensor_that_goes_or_is_exchanged_is_told_and_comes_back() {
    let run = run(
        9.0,
        &[
            happens(3_000, "unplug"),
            happens(4_000, "plug"),
            happens(6_000, "unplug"),
            happens(6_500, "exchange"),
            happens(7_000, "plug"),
        ],
    );
    for role in ROLES {
        let mut told = run.link(role).events();
        told.retain(|event| !matches!(event, Event::Pause { .. }));
        let expected = [
            Event::SensorLost(BusFault::NoAnswer),
            Event::SensorFound,
            Event::SensorLost(BusFault::NoAnswer),
            Event::WrongSensor { expected: 0xE5, found: 0x33 },
        ];
        assert_eq!(told, expected, "{role}");
        assert_replays(&run.boots(role)[0]);
    }
}

#[test]
#[ignore = "cargo xtask release --only pico"]
fn a_bus_held_low_and_a_byte_refused_in_a_burst_are_told_and_the_rest_goes_on() {
    let run = run(
        7.0,
        &[
            happens(2_000, "hold"),
            send(2_600, CABLE, &request(1, Command::GetStatus)),
            happens(3_000, "release"),
            happens(5_000, "nack"),
        ],
    );
    for role in ROLES {
        let mut told = run.link(role).events();
        told.retain(|event| !matches!(event, Event::Pause { .. }));
        let expected = [
            Event::SensorLost(BusFault::Transfer),
            Event::SensorFound,
            Event::SensorLost(BusFault::Transfer),
            Event::SensorFound,
        ];
        assert_eq!(told, expected, "{role}");
        let boot = &run.boots(role)[0];
        assert_eq!(gaps(boot.raw()).len(), 2);
        assert!(boot.raw().len() > 450, "{}", boot.raw().len());
        assert_replays(boot);
    }
    assert_eq!(run.link(LinkRole::Cable).replies().len(), 1);
}

#[test]
#[ignore = "cargo xtask release --only pico"]
fn interrupts_are_never_off_for_long_not_for_keys_either() {
    let open = |id| request(id, Command::OpenSession);
    let run = run(
        3.0,
        &[
            send(1_000, CABLE, &request(1, Command::SetKey(DeviceKey::new([7; 32])))),
            send(1_500, WIRELESS, &open(2)),
            send(1_700, CABLE, &open(3)),
            send(1_900, WIRELESS, &request(4, Command::FactoryReset)),
            send(2_100, WIRELESS, &who_are_you()),
        ],
    );
    let ns = run.report["longest_masked"]["ns"].as_u64().expect("a time");
    println!("until {}", run.report["longest_masked"]["until"]);
    figure(
        "Pico: interrupts masked at most, µs",
        format!("{:.0}", ns as f64 / 1000.0),
        "at most 52",
        ns <= 52_000,
    );
    // The data-ready line's time is taken in one. A frame is queued in 19 µs, a new correction in 40.
    assert!(ns <= 52_000, "{ns} ns");
}
