//! A board whose sensor is an ADXL345: no magnetometer, no thermometer, an oscillator that is off
//! by percents, and a FIFO.

use wimu_host::calibration::{CalibrateOptions, calibrate, parameter_id};
use wimu_host::recording::{Recording, Selection};
use wimu_link::hello::Capabilities;
use wimu_link::message::{BusFault, Event, Payload, Refusal, Resolution, Settings};
use wimu_link::{Answer, Command, LinkRole};
use wimu_model::{ParameterSet, Sensitivity};
use wimu_sim::board::{BoardConfig, SensorPart};
use wimu_sim::motion;
use wimu_sim::pipe::LinkConfig;
use wimu_sim::scene::{Scene, World};
use wimu_sim::source::Physics;
use wimu_sim::truth::{Gauge, SensorTruth};
use wimu_tests::{ROLES, Rig, assert_replays, compiled, gaps, who_are_you};

fn config() -> BoardConfig {
    BoardConfig { sensor: SensorPart::Adxl345, ..BoardConfig::default() }
}

/// A sensor whose period is longer than nominal by `ppm`.
fn off_by(ppm: f64, names: &str) -> Physics {
    let scene = Scene::new(World::default());
    scene.play(0.0, motion::named(names, 3).expect("a known motion"));
    let mut truth = SensorTruth::random_adxl345(3, Gauge::LowerTriangular);
    truth.period_error_ppm = ppm;
    Physics::new(truth, scene, 3)
}

fn rig() -> Rig {
    Rig::new(config(), off_by(-35_000.0, "rest,slide"))
}

/// Writes a parameter set; returns its id.
fn push(rig: &mut Rig, set: &ParameterSet) -> u32 {
    let answer = rig.ask(LinkRole::Cable, Command::SetParameters(compiled(set)));
    assert_eq!(answer, Answer::Accepted(Payload::None));
    parameter_id(set).0
}

#[test]
fn it_streams_on_both_links_and_replays_bit_for_bit() {
    let mut rig = rig();
    rig.run(15.0);
    for role in ROLES {
        rig.link(role).assert_perfect();
        let boot = rig.boot(role);
        assert!(boot.raw().len() > 1_500 && !boot.navigation.is_empty());
        assert_eq!(gaps(boot.raw()), []);
    }
    assert_eq!(rig.status().sensor.missed, 0);
}

#[test]
fn what_it_does_not_have_is_not_invented() {
    let mut rig = rig();
    rig.run(4.0);
    for role in ROLES {
        rig.send(role, &who_are_you());
        rig.run(0.2);
        let boot = rig.boot(role);
        let hello = boot.hello.expect("it was asked");
        assert!(hello.capabilities.contains(Capabilities::ACCELEROMETER));
        assert!(!hello.capabilities.contains(Capabilities::MAGNETOMETER));
        assert!(!hello.capabilities.contains(Capabilities::TEMPERATURE));
        assert_eq!(hello.sensor.name.as_str(), "ADXL345");
        assert!(boot.environment.is_empty(), "{:?}", boot.environment);
        assert!(boot.epochs().iter().all(|mark| mark.epoch.temperature_centi_c.is_none()));
    }
}

#[test]
fn every_rate_is_sampled_without_loss_with_both_links_shedding_and_a_set_being_written() {
    for rate_hz in [25, 50, 100, 200, 400, 800] {
        for ppm in [-50_000.0, 50_000.0] {
            // Too slow for what is asked of them.
            let slow = LinkConfig { baud: Some(9_600), ..LinkConfig::default() };
            let config = BoardConfig { cable: slow, wireless: slow, ..config() };
            let mut rig = Rig::new(config, off_by(ppm, "rest,slide,rest"));
            rig.run(0.5);
            rig.set(Settings { rate_hz, ..Settings::default() });
            let before = (rig.board.sensor().samples_taken(), rig.status().sensor.samples);
            rig.run(2.0);
            let sensitivity = Sensitivity::from_lsb_per_g(16_384.0).expect("in range");
            push(&mut rig, &ParameterSet::uncalibrated(2, sensitivity));
            rig.run(6.0);
            let status = rig.status();
            let sensor = status.sensor;
            assert_eq!((sensor.missed, sensor.overruns, sensor.bus_errors), (0, 0, 0));
            let taken = rig.board.sensor().samples_taken() - before.0;
            let read = u64::from(sensor.samples - before.1);
            // The slow link brings the status late; what the FIFO held is a part of it.
            let late = 64 + u64::from(rate_hz) / 2;
            assert!(taken.abs_diff(read) <= late, "{rate_hz} Hz: {read} of {taken}");
            let truth_ns = 1e9 / f64::from(rate_hz) * (1.0 + ppm * 1e-6);
            let measured = f64::from(status.measured_period_ns.expect("6 s are enough"));
            assert!((measured / truth_ns - 1.0).abs() < 100e-6, "{measured} ns");
            let shed = [status.cable, status.wireless].map(|link| link.map(|l| l.telemetry_shed));
            assert!(rate_hz < 400 || shed.iter().all(|shed| *shed > Some(0)), "{shed:?}");
            for role in ROLES {
                assert_replays(rig.boot(role));
            }
        }
    }
}

#[test]
fn sample_times_are_those_of_the_data_ready_line() {
    for rate_hz in [100, 400] {
        let mut rig = Rig::new(config(), off_by(21_000.0, "rest,slide,rest"));
        rig.run(0.5);
        rig.set(Settings { rate_hz, ..Settings::default() });
        rig.run(8.0);
        let period_us = 1e6 / f64::from(rate_hz) * 1.021;
        let raw = rig.boot(LinkRole::Cable).raw();
        let settled = &raw[raw.len() - 4 * usize::from(rate_hz)..];
        let first = settled[0];
        for sample in settled {
            let expected = f64::from(sample.sequence - first.sequence) * period_us;
            let late = (sample.time.0 - first.time.0) as f64 - expected;
            // The bar, and the microsecond of each of the times.
            assert!(late.abs() <= 5.0, "{rate_hz} Hz: {late} µs");
        }
    }
}

#[test]
fn what_the_sensor_cannot_do_is_refused_with_the_nearest_that_it_can() {
    let usual = Settings::default();
    for (wanted, nearest) in [
        ((3, 1344, Resolution::High), (2, 800)),
        ((24, 1, Resolution::High), (16, 25)),
        ((2, 800, Resolution::LowPower), (2, 400)),
    ] {
        let mut rig = rig();
        rig.run(0.5);
        let (range_g, rate_hz, resolution) = wanted;
        let asked = Settings { range_g, rate_hz, resolution, ..usual };
        let answer = rig.ask(LinkRole::Cable, Command::SetSettings(asked));
        let (range_g, rate_hz) = nearest;
        let nearest = Settings { range_g, rate_hz, ..asked };
        assert_eq!(answer, Answer::Refused(Refusal::UnsupportedSettings { nearest }));
        assert_eq!(rig.settings(), usual);
        rig.set(nearest);
        assert_eq!(rig.settings(), nearest);
    }
}

#[test]
fn it_is_calibrated_and_keeps_what_was_pushed() {
    let mut rig = Rig::new(config(), off_by(35_000.0, "twelve-poses"));
    rig.run(100.0);
    let recording = rig.recording();
    let link = recording.link(Some(LinkRole::Cable)).expect("it was recorded");
    let data = Recording::of_link(link, "the simulated board").expect("samples");
    let samples = data.samples(Selection::default()).expect("samples");
    let report = calibrate(&samples, &CalibrateOptions::default()).expect("readable");
    let set = report.parameters.unwrap_or_else(|| panic!("{:?}", report.outcome.reason));
    let hash = push(&mut rig, &set);
    rig.restart();
    rig.run(3.0);
    let boot = rig.boot(LinkRole::Cable);
    assert_eq!(boot.epochs()[0].epoch.parameters, hash);
    assert_replays(boot);
}

#[test]
fn a_sensor_that_lost_its_power_unnoticed_is_started_again() {
    let mut rig = rig();
    rig.run(3.0);
    rig.board.sensor().power_cycle();
    rig.run(3.0);
    for role in ROLES {
        let told = [Event::SensorLost(BusFault::Timeout), Event::SensorFound];
        assert_eq!(rig.link(role).events(), told);
        assert_replays(rig.boot(role));
    }
}
