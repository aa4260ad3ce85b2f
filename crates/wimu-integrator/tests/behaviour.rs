//! What the integrator promises.

use proptest::prelude::*;
use wimu_integrator::{
    Config, FieldMean, Flags, Integrator, MagneticHeading, Phase, Run, Segment, State, Transition,
};
use wimu_model::{MagneticFieldNt, PeriodNs, SpecificForceQ16};
use wimu_testkit::{Lane, Random, figure};

const G: i32 = 642_689;
const HZ_100: PeriodNs = PeriodNs(10_000_000);

fn integrator(zupt: bool) -> Integrator {
    Integrator::new(Config { zupt, ..Config::new(HZ_100).unwrap() })
}

fn q16(mps2: f64) -> i32 {
    (mps2 * 65536.0).round() as i32
}

/// A level slide of `distance` m along x in `duration` s, minimum jerk, m/s² at time t.
fn slide(t: f64, distance: f64, duration: f64) -> f64 {
    let s = (t / duration).clamp(0.0, 1.0);
    distance / (duration * duration) * (60.0 * s - 180.0 * s * s + 120.0 * s * s * s)
}

fn feed(integrator: &mut Integrator, forces: impl Iterator<Item = [i32; 3]>) {
    for force in forces {
        integrator.step(SpecificForceQ16(force), false);
    }
}

fn rest(samples: usize) -> impl Iterator<Item = [i32; 3]> {
    std::iter::repeat_n([0, 0, G], samples)
}

fn a_slide() -> impl Iterator<Item = [i32; 3]> {
    (0..=300).map(|k| [q16(slide(f64::from(k) * 0.01, 1.0, 3.0)), 0, G])
}

#[test]
fn an_hour_at_1_khz_is_within_10_um_of_the_same_rule_in_exact_arithmetic() {
    // A minute suffices to see an overflow or a wrong shift; a drift of rounding needs the hour.
    let samples = match Lane::current() {
        Lane::Check => 60_000,
        Lane::Test | Lane::Campaign => 3_600_000,
    };
    let period = PeriodNs(1_000_000);
    let remainder = 31_234;
    let mut segment = Segment::default();
    // Exact rational arithmetic in i128, per sample, with gravity's remainder: 2⁻³⁴ Δt² m.
    let (mut velocity, mut position, mut previous) = (0_i128, 0_i128, None);
    for k in 0..=samples {
        let force = (65536.0 * (2.0 * (k as f64 * 0.001).sin() + 0.001)).round() as i32 + G;
        segment.step(SpecificForceQ16([0, 0, force]), [0, 0, G]);
        let exact = (i128::from(force - G) << 16) - i128::from(remainder);
        if let Some(before) = previous.replace(exact) {
            let next = velocity + before + exact;
            position += velocity + next;
            velocity = next;
        }
    }
    let expected_m = position as f64 * 1e-6 / (1_u64 << 34) as f64;
    let ours_m = segment.position_nm([0, 0, remainder], period)[2] as f64 * 1e-9;
    let off_um = (ours_m - expected_m).abs() * 1e6;
    figure(
        "integrator, 1 h at 1 kHz, against exact integers, µm",
        format!("{off_um:.4} at {:.0} m", expected_m.abs()),
        "below 10",
        off_um < 10.0,
    );
    assert!(samples < 3_600_000 || expected_m.abs() > 1000.0);
    assert!(off_um < 10.0, "{ours_m} {expected_m}");
}

#[test]
fn a_slide_between_two_rests_is_measured_to_a_millimetre() {
    for zupt in [true, false] {
        let mut ins = integrator(zupt);
        feed(&mut ins, rest(200).chain(a_slide()).chain(rest(100)));
        let navigation = ins.navigation();
        assert!((navigation.position.to_m()[0] - 1.0).abs() < 1e-3, "{navigation:?}");
        assert!(navigation.flags.is_valid());
        assert_eq!(navigation.phase == Phase::Resting, zupt);
    }
}

#[test]
fn with_zupt_a_constant_bias_since_the_rest_is_taken_out_of_the_leg() {
    let biased = |force: [i32; 3]| [force[0] + q16(0.02), force[1], force[2]];
    let mut ins = integrator(true);
    feed(&mut ins, rest(200).chain(a_slide().map(biased)).chain(rest(100)));
    let error = ins.navigation().position.to_m()[0] - 1.0;
    // Uncorrected, 0.02 m/s² for 3 s are 90 mm, and 10 mm more for every further 0.17 s.
    assert!(error.abs() < 0.02, "{error}");
}

#[test]
fn velocity_is_zero_at_rest_and_the_position_stays() {
    let mut ins = integrator(true);
    feed(&mut ins, rest(200).chain(a_slide()).chain(rest(100)));
    let stopped = ins.navigation();
    feed(&mut ins, rest(5000));
    let later = ins.navigation();
    assert_eq!(later.velocity.0, [0; 3]);
    assert_eq!(later.position, stopped.position);
    assert_eq!(later.since_rest_ms, 0);
}

#[test]
fn a_tilted_unit_reports_in_the_level_frame() {
    // Pitched by 30°: the same level slide seen from body axes.
    let (sin, cos) = (0.5_f64, 0.75_f64.sqrt());
    let tilt = |t: f64| {
        let a = slide(t, 1.0, 3.0);
        [q16(a * cos + 9.80665 * sin), 0, q16(-a * sin + 9.80665 * cos)]
    };
    let mut ins = integrator(true);
    feed(&mut ins, (0..700).map(|k| tilt((f64::from(k) * 0.01 - 2.0).clamp(0.0, 3.0))));
    let [east, north, up] = ins.navigation().position.to_m();
    assert!((east - 1.0).abs() < 1e-3 && north.abs() < 1e-6 && up.abs() < 1e-3);
}

#[test]
fn a_gap_in_a_leg_is_flagged_and_the_position_after_it_too() {
    let mut ins = integrator(true);
    feed(&mut ins, rest(200).chain(a_slide().take(150)));
    ins.gap();
    feed(&mut ins, a_slide().skip(160));
    assert!(ins.navigation().flags.contains(Flags::GAP));
    feed(&mut ins, rest(100));
    assert_eq!(ins.navigation().flags, Flags::POSITION_LOST);
}

#[test]
fn saturation_and_turning_are_flagged() {
    let mut ins = integrator(true);
    feed(&mut ins, rest(200).chain(a_slide().take(150)));
    ins.step(SpecificForceQ16([20 * G, 0, G]), true);
    assert!(ins.navigation().flags.contains(Flags::SATURATED));

    let mut ins = integrator(false);
    feed(&mut ins, rest(200).chain(a_slide()));
    // Comes to rest rolled by 3°.
    let rolled = [0, q16(9.80665 * 0.0523), q16(9.80665 * 0.9986)];
    feed(&mut ins, std::iter::repeat_n(rolled, 300));
    assert!(ins.navigation().flags.contains(Flags::TURNED));
}

#[test]
fn a_dead_sensor_and_free_fall_are_no_rest() {
    let mut ins = integrator(true);
    feed(&mut ins, std::iter::repeat_n([0, 0, 0], 1000));
    assert_eq!(ins.navigation().phase, Phase::Searching);
}

#[test]
fn a_rest_is_announced_once_and_so_is_motion() {
    let mut ins = integrator(true);
    let mut seen = Vec::new();
    for force in rest(200).chain(a_slide()).chain(rest(100)) {
        match ins.step(SpecificForceQ16(force), false) {
            Transition::None | Transition::Window => {}
            change => seen.push(change),
        }
    }
    assert_eq!(seen, [Transition::Rest, Transition::Motion, Transition::Rest]);
}

#[test]
fn a_change_of_period_or_a_gap_at_rest_is_no_motion() {
    for zupt in [true, false] {
        let mut ins = integrator(zupt);
        feed(&mut ins, rest(200));
        ins.set_period(PeriodNs(10_024_000)).unwrap();
        feed(&mut ins, rest(200));
        ins.gap();
        feed(&mut ins, rest(200));
        let navigation = ins.navigation();
        assert_eq!(navigation.phase, Phase::Resting);
        assert!(navigation.flags.is_valid());
    }
}

#[test]
fn a_change_of_period_goes_on_from_the_same_velocity_and_position() {
    let mut ins = integrator(false);
    feed(&mut ins, rest(200).chain(a_slide().take(151)));
    let before = ins.navigation();
    ins.set_period(PeriodNs(5_000_000)).unwrap();
    let after = ins.navigation();
    assert_eq!(before.velocity, after.velocity);
    assert_eq!(before.position, after.position);
    assert_eq!(before.since_rest_ms, after.since_rest_ms);
}

#[test]
fn noise_of_a_cheap_sensor_does_not_hide_a_rest() {
    // Uniform noise of ±0.05 m/s² an axis, 0.03 rms.
    let mut random = Random::new(1);
    let mut noise = || random.within(3277.0) as i32;
    let mut ins = integrator(true);
    for _ in 0..1000 {
        ins.step(SpecificForceQ16([noise(), noise(), G + noise()]), false);
    }
    assert_eq!(ins.navigation().phase, Phase::Resting);
}

fn forces() -> impl Strategy<Value = Vec<([i32; 3], u8)>> {
    let force = prop_oneof![
        3 => Just([0, 0, G]),
        1 => proptest::array::uniform3(-(1 << 29)..(1 << 29)),
        1 => proptest::array::uniform3(-G..G),
    ];
    proptest::collection::vec((force, any::<u8>()), 1..40)
}

/// East when body x points `degrees` clockwise from north, level.
fn headed(degrees: f64) -> MagneticHeading {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let direction = |x: f64| (x * f64::from(1 << 30)).round() as i32;
    MagneticHeading { east: [direction(sin), direction(-cos), 0], sd_mrad: 20 }
}

#[test]
fn a_heading_is_taken_at_rest_held_in_motion_and_uncalibrated_at_the_next_rest() {
    let mut unit = integrator(true);
    assert!(!unit.set_heading(headed(40.0)) && unit.heading_rad().is_none());
    feed(&mut unit, rest(100));
    // Body x points east.
    assert!((unit.heading_rad().unwrap().to_degrees() - 90.0).abs() < 1e-6);
    assert_eq!(unit.navigation().heading_sd_mrad, None);
    assert!(unit.set_heading(headed(40.0)));
    let heading = |unit: &Integrator| unit.heading_rad().unwrap().to_degrees();
    feed(&mut unit, a_slide());
    assert_eq!(unit.navigation().phase, Phase::Moving);
    assert!((heading(&unit) - 40.0).abs() < 0.1);
    assert_eq!(unit.navigation().heading_sd_mrad, Some(20));
    // Not while it moves.
    assert!(!unit.set_heading(headed(50.0)));
    feed(&mut unit, rest(100));
    assert_eq!(unit.navigation().heading_sd_mrad, None);
    let [east, north, _] = unit.navigation().position.to_m();
    let along = 40.0_f64.to_radians();
    assert!((east - along.sin()).abs() < 0.01 && (north - along.cos()).abs() < 0.01);
    // A small change is noise; a large one is an undetected rotation.
    assert!(unit.set_heading(headed(47.0)));
    assert!(unit.navigation().flags.is_valid());
    assert!(unit.set_heading(headed(70.0)));
    assert!(unit.navigation().flags.contains(Flags::POSITION_LOST));
    // From its state another goes on with it.
    let other = Integrator::from_state(unit.state()).unwrap();
    assert_eq!(other, unit);
}

#[test]
fn one_reading_of_another_field_is_left_out_and_two_begin_anew() {
    let [here, there] = [[20_000, 0, -44_000], [0, 20_000, -44_000]].map(MagneticFieldNt);
    let mut field = FieldMean::default();
    let worth = [here, here, here, there, here].map(|output| field.push(output));
    assert_eq!(worth, [true, true, false, false, true]);
    let mut four = FieldMean::default();
    for _ in 0..4 {
        four.push(here);
    }
    assert_eq!(field, four);
    assert_eq!([there, there].map(|output| field.push(output)), [false, true]);
    let mut anew = FieldMean::default();
    anew.push(there);
    assert_eq!(field, anew);
}

proptest! {
    #[test]
    fn from_any_state_the_outputs_are_the_same_bit_for_bit(
        runs in forces(), cut in 0_usize..2000, zupt in any::<bool>()
    ) {
        let samples: Vec<_> = runs
            .iter()
            .flat_map(|&(force, times)| std::iter::repeat_n(force, usize::from(times)))
            .collect();
        let cut = cut.min(samples.len());
        let mut device = integrator(zupt);
        feed(&mut device, samples[..cut].iter().copied());
        let mut host = Integrator::from_state(device.state()).unwrap();
        prop_assert_eq!(&device, &host);
        for force in &samples[cut..] {
            let force = SpecificForceQ16(*force);
            prop_assert_eq!(device.step(force, false), host.step(force, false));
            prop_assert_eq!(device.navigation(), host.navigation());
        }
    }

    #[test]
    fn no_state_and_no_samples_make_it_panic(
        words in proptest::array::uniform32(any::<i64>()), samples in forces()
    ) {
        let w = |i: usize| words[i];
        let three = |i: usize| [w(i), w(i + 1), w(i + 2)];
        let small = |i: usize| three(i).map(|v| v as i32);
        let mut state: State = integrator(true).state();
        state.phase = [Phase::Searching, Phase::Resting, Phase::Moving][(w(0) & 1) as usize + 1];
        state.rest_mean = three(1).map(|mean| mean >> 26);
        state.east = small(4);
        state.base_position_nm = three(7);
        state.base_velocity_nmps = three(10);
        state.base_since_rest_ns = w(13) as u64;
        state.segment.steps = u32::MAX - (w(14) as u32 >> 20);
        state.segment.velocity_sum = three(15);
        state.segment.position_sum = three(18);
        state.segment.previous = Some(small(21));
        state.window.start.velocity_sum = three(24);
        state.window.reference = small(27);
        state.run = Some(Run {
            windows: w(30) as u16,
            sum: three(29).map(|v| v >> 16),
            ..Run::default()
        });
        if let Ok(mut ins) = Integrator::from_state(state) {
            for &(force, times) in &samples {
                for _ in 0..times {
                    ins.step(SpecificForceQ16(force), false);
                }
                ins.navigation();
            }
        }
    }
}
