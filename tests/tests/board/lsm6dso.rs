//! Boards whose sensor has six axes, and a gyroscope that can fail.

use wimu_link::LinkRole;
use wimu_link::hello::Capabilities;
use wimu_link::message::{BusFault, EpochReason, Event, Settings};
use wimu_model::AngularRateQ20;
use wimu_sim::board::{BoardConfig, SensorPart};
use wimu_sim::motion;
use wimu_sim::pipe::LinkConfig;
use wimu_sim::scene::{Scene, World};
use wimu_sim::sensor::GyroscopeFault;
use wimu_sim::source::Physics;
use wimu_sim::truth::{Gauge, SensorTruth};
use wimu_tests::{ROLES, Rig, assert_replays, gaps, who_are_you};

/// The navigation flag of a saturated gyroscope, as in docs/reference/protocol.md.
const GYROSCOPE_SATURATED: u8 = 32;

/// A board that is moved as [`motion::named`] says, with a sensor of these errors, and where it is.
fn rig_with(sensor: SensorPart, truth: SensorTruth, names: &str) -> (Rig, Scene) {
    let scene = Scene::new(World::default());
    scene.play(0.0, motion::named(names, 3).expect("a known motion"));
    let config = BoardConfig {
        sensor,
        // 208 Hz of six axes, raw and corrected, exceed 115,200 baud.
        cable: LinkConfig::default(),
        wireless: LinkConfig::default(),
        ..BoardConfig::default()
    };
    let rig = Rig::new(config, Physics::new(truth, scene.clone(), 3));
    (rig, scene)
}

fn rig(names: &str) -> Rig {
    let truth = SensorTruth::random_lsm6dso(3, Gauge::LowerTriangular);
    rig_with(SensorPart::Lsm6dso, truth, names).0
}

/// Those with six axes, each with the largest error of an angular rate, rad/s: half an LSB of 70 m°/s, and the error of a
/// sample's time, 50 µs with a data-ready line and 0.7 ms without one, at a change of up to 50 rad/s².
const SIX_AXES: [(SensorPart, f64); 4] = [
    (SensorPart::Lsm6dso, 0.004),
    (SensorPart::Lsm6ds3trC, 0.004),
    (SensorPart::Mpu6050, 0.004),
    (SensorPart::Icm42688, 0.036),
];

#[test]
fn six_axes_stream_on_both_links_and_replay_bit_for_bit() {
    for (part, _) in SIX_AXES {
        six_axes_stream(part);
    }
}

fn six_axes_stream(part: SensorPart) {
    let truth = part.random_truth(3, Gauge::LowerTriangular);
    let (mut rig, _) = rig_with(part, truth, "rest,hand,rest");
    rig.run(0.5);
    for role in ROLES {
        rig.send(role, &who_are_you());
    }
    rig.run(25.0);
    for role in ROLES {
        rig.link(role).assert_perfect();
        let boot = rig.boot(role);
        let hello = boot.hello.expect("it was asked");
        assert_eq!(hello.sensor.name.as_str(), part.name());
        let polled = hello.capabilities.contains(Capabilities::POLLED);
        assert_eq!(polled, part == SensorPart::Icm42688);
        assert!(hello.capabilities.contains(Capabilities::GYROSCOPE));
        assert!(boot.raw().len() > 2_400 && !boot.attitude.is_empty());
        assert!(boot.raw().iter().all(|sample| sample.rate.is_some()));
        assert_eq!(gaps(boot.raw()), []);
        assert!(!boot.environment.is_empty(), "temperatures");
    }
    assert_eq!(rig.status().sensor.missed, 0);
}

#[test]
fn the_angular_rate_and_the_attitude_are_those_of_the_body() {
    for (part, most) in SIX_AXES {
        angular_rates(part, most);
    }
}

fn angular_rates(part: SensorPart, most: f64) {
    let (mut rig, scene) = rig_with(part, SensorTruth::ideal(), "rest,hand,rest");
    rig.run(25.0);
    let boot = rig.boot(LinkRole::Cable);
    let mut compared = 0;
    for sample in boot.corrected() {
        let truth = scene.state(sample.time.to_seconds()).angular_rate_radps;
        let found = AngularRateQ20(sample.rate.expect("six axes")).to_rad_s();
        for axis in 0..3 {
            let error = (found[axis] - truth[axis]).abs();
            assert!(error < most, "{}: {error} rad/s at {:?}", part.name(), sample.time);
        }
        compared += 1;
    }
    assert!(compared > 2_000);
    // The batch with the sample of the last one may not have been sent yet.
    let known = boot.attitude.iter().rev().find_map(|one| Some((one, boot.time_of(one.sequence)?)));
    let (last, time) = known.expect("attitudes");
    let found = last.quaternion.map(|q| f64::from(q) / (1_u64 << 30) as f64);
    let found = wimu_sim::attitude::Attitude::from_quaternion(found);
    let truth = scene.state(time.to_seconds()).attitude;
    let error = found.angle_to(truth).to_degrees();
    assert!(error < 0.5, "{error}° after 10 s of hand motion");
}

#[test]
fn every_rate_is_sampled_without_loss() {
    for rate_hz in [13, 26, 52, 104, 208, 416, 833] {
        let mut rig = rig("rest,hand");
        rig.run(0.5);
        rig.set(Settings { rate_hz, ..Settings::default() });
        rig.run(12.0);
        let sensor = rig.status().sensor;
        let faults = (sensor.missed, sensor.overruns, sensor.bus_errors);
        assert_eq!(faults, (0, 0, 0), "{rate_hz} Hz");
        assert!(sensor.samples > 10 * u32::from(rate_hz), "{rate_hz} Hz");
        for role in ROLES {
            assert_replays(rig.boot(role));
        }
    }
}

#[test]
fn a_gyroscope_that_stops_is_reported_leaves_a_gap_and_recovers() {
    let mut rig = rig("rest,hand,rest,hand");
    rig.run(12.0);
    rig.board.sensor().set_gyroscope_fault(GyroscopeFault::Stops);
    rig.run(2.0);
    let broken_us = rig.board.now_us();
    for role in ROLES {
        let told = [Event::GyroscopeLost(BusFault::Timeout)];
        assert_eq!(rig.link(role).events(), told);
    }
    rig.board.sensor().set_gyroscope_fault(GyroscopeFault::None);
    rig.run(8.0);
    let status = rig.status();
    assert!(status.sensor.bus_errors > 0, "{status:?}");
    for role in ROLES {
        let told = [Event::GyroscopeLost(BusFault::Timeout), Event::SensorFound];
        assert_eq!(rig.link(role).events(), told);
        let boot = rig.boot(role);
        let holes = gaps(boot.raw());
        let [(_, missing)] = holes[..] else {
            panic!("one gap in the numbers, not {holes:?}");
        };
        assert_eq!(missing, status.sensor.missed);
        assert!((200..=260).contains(&missing), "{missing} of 104 Hz");
        let after = |mark: &&wimu_host::capture::EpochMark| mark.epoch.time_us > broken_us;
        let first = boot.epochs().iter().find(after).expect("epochs");
        assert_eq!(first.epoch.reason, EpochReason::Gap);
        assert_replays(boot);
    }
}

#[test]
fn a_saturated_gyroscope_is_flagged_until_the_next_rest() {
    let mut rig = rig("rest,hand,rest,rest");
    rig.run(12.0);
    let flags = |rig: &Rig| {
        let sent = rig.boot(LinkRole::Cable).navigation.last();
        sent.expect("positions").flags & GYROSCOPE_SATURATED
    };
    assert_eq!(flags(&rig), 0);
    rig.board.sensor().set_gyroscope_fault(GyroscopeFault::Saturates);
    rig.run(0.3);
    rig.board.sensor().set_gyroscope_fault(GyroscopeFault::None);
    rig.run(0.5);
    assert_eq!(flags(&rig), GYROSCOPE_SATURATED);
    rig.run(20.0);
    assert_eq!(flags(&rig), 0);
    for role in ROLES {
        assert_eq!(rig.link(role).events(), []);
        rig.link(role).assert_perfect();
    }
}
