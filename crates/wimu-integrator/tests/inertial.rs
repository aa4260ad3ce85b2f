//! What the integrator promises with a gyroscope.

use proptest::prelude::*;
use wimu_integrator::{
    Config, Flags, Integrator, MagneticHeading, Phase, RotationState, Saturation, StateError,
};
use wimu_model::{AngularRateQ20, PeriodNs, SpecificForceQ16};
use wimu_testkit::{Random, figure};

use crate::hand::{Errors, G, HZ, Hand, PERIOD, REST_S, Rule, angle_between, distance, times};

const LEVEL: SpecificForceQ16 = SpecificForceQ16([0, 0, 642_689]);

fn integrator(zupt: bool) -> Integrator {
    Integrator::new(Config { zupt, ..Config::new(PERIOD).unwrap() })
}

fn deg_s(rate: [f64; 3]) -> AngularRateQ20 {
    AngularRateQ20::from_rad_s(rate.map(f64::to_radians))
}

/// Level, at a constant rate about the vertical.
fn spin(unit: &mut Integrator, about_z_deg_s: f64, seconds: f64) {
    for _ in 0..(seconds * HZ) as u32 {
        let rate = deg_s([0.0, 0.0, about_z_deg_s]);
        unit.step_inertial(LEVEL, rate, Saturation::default());
    }
}

fn heading_deg(unit: &Integrator) -> f64 {
    unit.heading_rad().unwrap().to_degrees()
}

fn walked(hand: Hand, errors: &Errors, with_gyroscope: bool, seed: u64) -> Integrator {
    let mut unit = integrator(true);
    let mut random = Random::new(seed);
    for (force, rate, saturated) in hand.samples(HZ, errors, || random.normal()) {
        if with_gyroscope {
            unit.step_inertial(force, rate, saturated);
        } else {
            unit.step(force, false);
        }
    }
    unit
}

#[test]
fn a_hand_motion_with_rotation_ends_where_the_hand_does() {
    let hand = Hand { motion_s: 10.0 };
    let error = |with_gyroscope, errors: &Errors, seed| {
        let unit = walked(hand, errors, with_gyroscope, seed);
        distance(unit.navigation().position.to_m(), hand.position(hand.total_s()))
    };
    let exact = error(true, &Errors::default(), 1);
    // The trapezoid between samples 5 ms apart.
    assert!(exact < 0.02, "{exact}");
    let rms = |with| {
        ((1..=8).map(|seed| error(with, &Errors::lsm6dso(), seed).powi(2)).sum::<f64>() / 8.0)
            .sqrt()
    };
    let (six, three) = (rms(true), rms(false));
    assert!(six < 0.1 && three > 100.0 * six, "{six} {three}");
}

#[test]
fn a_leg_with_rotation_is_valid_and_its_attitude_that_of_the_hand() {
    let hand = Hand { motion_s: 10.0 };
    let now = walked(hand, &Errors::lsm6dso(), true, 1).navigation();
    assert_eq!((now.phase, now.flags), (Phase::Resting, Flags::default()));
    let found = now.attitude.unwrap().map(|q| f64::from(q) / f64::from(1 << 30));
    let error = angle_between(found, hand.attitude(hand.total_s())).to_degrees();
    assert!(error < 0.5, "{error}");
    assert!(walked(hand, &Errors::lsm6dso(), false, 1).navigation().attitude.is_none());
}

#[test]
fn position_and_attitude_follow_the_same_rule_in_f64() {
    let hand = Hand { motion_s: 60.0 };
    let mut unit = integrator(false);
    let mut rule: Option<Rule> = None;
    let (mut worst_m, mut worst_deg) = (0.0_f64, 0.0_f64);
    for (force, rate, saturated) in hand.samples(HZ, &Errors::default(), || 0.0) {
        let was = unit.navigation().phase;
        unit.step_inertial(force, rate, saturated);
        let now = unit.navigation();
        if was != Phase::Moving {
            // From the sample on at which the leg starts.
            let moving = now.phase == Phase::Moving;
            rule = moving.then(|| Rule::continued(&now, &unit.state(), force, G, 1.0 / HZ));
        } else if let Some(rule) = &mut rule {
            let bias = unit.state().rotation.unwrap().bias;
            let rate = AngularRateQ20([0, 1, 2].map(|i| rate.0[i] - bias[i]));
            rule.step(force.to_mps2().0, rate.to_rad_s());
            worst_m = worst_m.max(distance(now.position.to_m(), rule.position));
            let found = now.attitude.unwrap().map(|q| f64::from(q) / f64::from(1 << 30));
            worst_deg = worst_deg.max(angle_between(found, rule.attitude).to_degrees());
        }
    }
    figure(
        "six axes, 60 s with rotation, position against the same rule in f64, mm",
        format!("{:.2}", worst_m * 1e3),
        "below 2",
        worst_m < 2e-3,
    );
    assert!(worst_m > 0.0 && worst_m < 2e-3 && worst_deg < 1e-4, "{worst_m} {worst_deg}");
}

#[test]
fn an_uncalibrated_bias_is_learned_at_the_first_rest_and_a_larger_one_is_motion() {
    let mut unit = integrator(true);
    spin(&mut unit, 5.0, 2.0);
    assert_eq!(unit.navigation().phase, Phase::Resting);
    let bias = unit.state().rotation.unwrap().bias;
    assert_eq!(bias, deg_s([0.0, 0.0, 5.0]).0);
    let held = heading_deg(&unit);
    spin(&mut unit, 5.0, 60.0);
    assert!((heading_deg(&unit) - held).abs() < 0.01);
    let mut turning = integrator(true);
    spin(&mut turning, 7.0, 60.0);
    assert_eq!(turning.navigation().phase, Phase::Searching);
}

#[test]
fn a_slow_rotation_about_the_vertical_is_no_rest_but_for_16_s_of_it() {
    let mut unit = integrator(true);
    spin(&mut unit, 0.0, 2.0);
    spin(&mut unit, 3.0, 10.0);
    assert_eq!(unit.navigation().phase, Phase::Moving);
    assert!((heading_deg(&unit) - (90.0 - 30.0)).abs() < 0.1, "{}", heading_deg(&unit));
    spin(&mut unit, 0.0, 2.0);
    assert_eq!(unit.navigation().phase, Phase::Resting);
    assert!((heading_deg(&unit) - 60.0).abs() < 0.1);
    // A bias that changed, or was measured in rotation, is replaced.
    spin(&mut unit, 3.0, 20.0);
    assert_eq!(unit.navigation().phase, Phase::Resting);
    assert_eq!(unit.state().rotation.unwrap().bias, deg_s([0.0, 0.0, 3.0]).0);
}

#[test]
fn a_gap_holds_the_attitude_and_flags_the_leg() {
    let mut unit = integrator(true);
    spin(&mut unit, 0.0, 2.0);
    spin(&mut unit, 90.0, 1.0);
    let before = unit.navigation();
    unit.gap();
    spin(&mut unit, 90.0, 1.0 / HZ);
    let after = unit.navigation();
    assert_eq!(before.attitude, after.attitude);
    assert!(after.flags.contains(Flags::GAP));
    spin(&mut unit, 90.0, 1.0);
    assert!((heading_deg(&unit) + 90.0).abs() < 1.0, "{}", heading_deg(&unit));
}

#[test]
fn saturation_of_either_sensor_is_flagged_as_its_own() {
    let flags = |saturated, rate: f64| {
        let mut unit = integrator(true);
        spin(&mut unit, 0.0, 2.0);
        unit.step_inertial(LEVEL, AngularRateQ20([0, 0, rate as i32]), saturated);
        unit.navigation().flags
    };
    let [none, mut force, mut rate] = [Saturation::default(); 3];
    force.accelerometer = true;
    rate.gyroscope = true;
    assert_eq!(flags(none, 0.0), Flags::default());
    assert_eq!(flags(force, 0.0), Flags::SATURATED);
    assert_eq!(flags(rate, 0.0), Flags::GYROSCOPE_SATURATED);
    assert_eq!(flags(none, 2e9), Flags::GYROSCOPE_SATURATED);
}

#[test]
fn a_heading_is_taken_in_the_axes_of_the_body_after_its_rotation() {
    let mut unit = integrator(true);
    spin(&mut unit, 0.0, 2.0);
    spin(&mut unit, 90.0, 1.0);
    spin(&mut unit, 0.0, 2.0);
    assert!(heading_deg(&unit).abs() < 1.0);
    assert!(distance(unit.rest_force().map(|f| f as f64 / 4_294_967_296.0), [0.0, 0.0, G]) < 1e-3);
    // Body x points 40° clockwise from north.
    let (sin, cos) = 40_f64.to_radians().sin_cos();
    let east = [sin, -cos, 0.0].map(|x| (x * f64::from(1 << 30)) as i32);
    let mut replay = unit.clone();
    assert!(unit.set_heading(MagneticHeading { east, sd_mrad: 20 }));
    assert!((heading_deg(&unit) - 40.0).abs() < 1e-3);
    assert!(replay.adopt_heading(&unit.state()));
    assert_eq!(replay, unit);
}

#[test]
fn the_first_rest_in_any_attitude_gives_tilt() {
    let mut unit = integrator(true);
    for _ in 0..400 {
        let nose_up = SpecificForceQ16([642_689, 0, 0]);
        unit.step_inertial(nose_up, AngularRateQ20::default(), Saturation::default());
    }
    let q = unit.navigation().attitude.unwrap().map(|q| f64::from(q) / f64::from(1 << 30));
    let up = crate::hand::rotated(q, [1.0, 0.0, 0.0]);
    assert!(distance(up, [0.0, 0.0, 1.0]) < 1e-6, "{up:?}");
    assert!((times(q, crate::hand::conjugate(q))[0] - 1.0).abs() < 1e-8);
}

#[test]
fn a_rotation_that_no_integrator_has_is_refused() {
    let mut unit = integrator(true);
    spin(&mut unit, 1.0, REST_S);
    let good = unit.state();
    assert_eq!(Integrator::from_state(good).as_ref(), Ok(&unit));
    let faults: [fn(&mut RotationState); 6] = [
        |rotation| rotation.quaternion = [0; 4],
        |rotation| rotation.quaternion = [i64::MIN; 4],
        |rotation| rotation.quaternion[0] += 1 << 52,
        |rotation| rotation.bias[1] = 200_000,
        |rotation| rotation.window[2] = i64::MIN,
        |rotation| rotation.sum[0] = 1 << 50,
    ];
    for fault in faults {
        let mut state = good;
        fault(state.rotation.as_mut().unwrap());
        assert_eq!(Integrator::from_state(state), Err(StateError::Rotation));
    }
}

type Step = (SpecificForceQ16, AngularRateQ20);

fn steps() -> impl Strategy<Value = Vec<(Step, u8)>> {
    let rate = || {
        prop_oneof![
            3 => Just([5_000, -3_000, 20_000]),
            1 => prop::array::uniform3(-3_000_000..3_000_000),
            1 => prop::array::uniform3(any::<i32>()),
        ]
    };
    let force = prop_oneof![
        3 => Just(LEVEL.0),
        1 => prop::array::uniform3(-(1 << 29)..(1 << 29)),
        1 => prop::array::uniform3(-642_689..642_689),
    ];
    let step = (force, rate()).prop_map(|(f, r)| (SpecificForceQ16(f), AngularRateQ20(r)));
    prop::collection::vec((step, any::<u8>()), 1..40)
}

proptest! {
    #[test]
    fn from_any_state_the_outputs_are_the_same_bit_for_bit(
        runs in steps(), cut in 0_usize..2000, zupt: bool, gap: bool, period in 100_000..20_000_000_u32,
    ) {
        let samples: Vec<_> = (runs.iter())
            .flat_map(|&(step, times)| std::iter::repeat_n(step, usize::from(times)))
            .collect();
        let cut = cut.min(samples.len());
        let mut device = integrator(zupt);
        for &(force, rate) in &samples[..cut] {
            device.step_inertial(force, rate, Saturation::default());
        }
        let mut host = Integrator::from_state(device.state()).unwrap();
        prop_assert_eq!(&device, &host);
        for unit in [&mut device, &mut host] {
            if gap {
                unit.gap();
            }
            unit.set_period(PeriodNs(period)).unwrap();
        }
        for &(force, rate) in &samples[cut..] {
            let none = Saturation::default();
            prop_assert_eq!(device.step_inertial(force, rate, none), host.step_inertial(force, rate, none));
            prop_assert_eq!(device.navigation(), host.navigation());
        }
        prop_assert!(Integrator::from_state(host.state()).is_ok());
    }

    #[test]
    fn no_rotation_makes_it_panic(
        words in prop::array::uniform16(any::<i64>()), length in 0..4_usize, steps in steps(),
    ) {
        let mut state = integrator(true).state();
        state.phase = Phase::Moving;
        state.rest_mean = [0, 0, 42_119_196_999];
        let three = |i: usize| [words[i], words[i + 1], words[i + 2]];
        let mut quaternion = [0; 4];
        quaternion[length] = 1 << 59;
        state.rotation = Some(RotationState {
            quaternion,
            previous: Some(three(0).map(|w| w as i32)),
            remainder: three(3).map(|w| w as u32),
            bias: three(6).map(|w| (w >> 48) as i32),
            window: three(9).map(|w| w >> 16),
            sum: three(12).map(|w| w >> 16),
            latest: three(13).map(|w| w >> 16),
        });
        if let Ok(mut unit) = Integrator::from_state(state) {
            for &((force, rate), times) in &steps {
                for _ in 0..times {
                    unit.step_inertial(force, rate, Saturation::default());
                }
                unit.navigation();
            }
        }
    }
}
