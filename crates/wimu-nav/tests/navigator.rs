//! The navigator of one unit.

use crate::common;

use common::Random;
use common::navigated::{Navigated, Point, deviation, navigate, without_gyroscope};
use common::travel::{Errors, Travel};
use nalgebra::Vector3;
use wimu_nav::filter::Gate;
use wimu_nav::navigator::{Navigator, Profile, Rests, Sample, SampleFault, Settings, Start};
use wimu_nav::process::ImuErrors;
use wimu_nav::sensor::{Anchor, CorrelatedErrors, Heading, Position, Range, RangeErrors};
use wimu_nav::state::{ATTITUDE, POSITION};
use wimu_testkit::{Coverage, assert_median_can_be, draws};

/// Errors within those that the navigator assumes, with biases below those that hide rests from the detector: 0.05 rad/s
/// and 0.25 m/s².
fn drawn(seed: u64) -> (Random, Errors) {
    let mut random = Random::new(seed + 310);
    let mut assumed = ImuErrors::default();
    assumed.gyroscope_bias = 0.01;
    assumed.accelerometer_bias = 0.05;
    let errors = Errors::drawn(&assumed, &mut random);
    (random, errors)
}

fn last(points: &[Point]) -> &Point {
    points.last().unwrap()
}

fn at(points: &[Point], t: f64) -> &Point {
    points.iter().find(|p| p.time_s >= t).unwrap()
}

#[test]
fn at_rest_the_position_stays_and_its_deviation_is_small() {
    for gyroscope in [true, false] {
        for seed in 0..5 {
            let (_, errors) = drawn(seed);
            let how = Navigated { until_s: 30.0, gyroscope, ..Navigated::default() };
            let points = navigate(&Travel::rest(), &errors, how, seed);
            let end = last(&points);
            println!("gyroscope {gyroscope}: {}", end.row());
            assert!(end.position_error.norm() < 3.0 * end.position_sd());
            assert!(end.position_error.norm() < 0.05);
            // Between the 1 cm/s of each update and what a rest does not show.
            let most = if gyroscope { 0.1 } else { 0.25 };
            assert!((0.014..most).contains(&end.position_sd()), "{}", end.row());
            assert!(deviation(&end.solution.velocity_covariance) < 0.02);
            assert_eq!((end.recoveries, end.divergences), (0, 0));
        }
    }
}

#[test]
fn moves_between_rests_are_within_their_deviation_and_that_is_not_wide() {
    for (count, most) in [(1, 0.1), (4, 0.2)] {
        let (mut inside, mut nees) = (Coverage::default(), Vec::new());
        for seed in 0..draws(300, 6) as u64 {
            let (mut random, errors) = drawn(seed);
            let travel = Travel::stop_and_go(&mut random, count, 1.0, 1.0);
            let how = Navigated {
                until_s: 4.0 + 3.5 * count as f64,
                detector: seed % 2 == 0,
                ..Navigated::default()
            };
            let points = navigate(&travel, &errors, how, seed);
            let end = last(&points);
            inside.count(end.nees() < 14.16);
            nees.push(end.nees());
            assert!((0.01..most).contains(&end.position_sd()), "{}", end.row());
            assert!(end.tilt_error.to_degrees() < 2.0, "{}", end.row());
        }
        println!("{count} moves: within 3 σ {inside}");
        inside.assert_can_be(0.97..=1.0, "within 3 σ of three components");
        assert_median_can_be(&nees, 0.3..=4.0, "NEES");
    }
}

#[test]
fn a_slow_move_that_looks_like_a_rest_is_not_taken_for_one() {
    // The detector finds no motion: 0.4 m/s². The velocity that the filter knows rejects the rests.
    let travel = Travel::rest().leg(4.0, 1.5, [0.15, 0.0, 0.0], [0.0; 3]);
    for seed in 0..5 {
        let (_, errors) = drawn(seed);
        let how = Navigated { until_s: 8.0, ..Navigated::default() };
        let points = navigate(&travel, &errors, how, seed);
        let end = last(&points);
        println!("{}", end.row());
        assert!(end.nees() < 21.0 && end.position_error.norm() < 0.1, "{}", end.row());
    }
}

#[test]
fn a_better_calibration_gives_a_smaller_deviation_of_the_position() {
    let mut random = Random::new(33);
    // A rotation of a right angle shows what the scale factors and misalignments make of gravity.
    let travel = Travel::rest().leg(4.0, 2.0, [2.0, 1.0, 0.5], [1.5, 0.0, 0.0]);
    let mut before = f64::INFINITY;
    let mut deviations = Vec::new();
    for scale in [4.0, 1.0, 0.25] {
        let mut settings = Settings::default();
        settings.errors.accelerometer_bias = 0.02;
        settings.errors.accelerometer_matrix = [0.005 * scale, 0.003 * scale];
        let errors = Errors::drawn(&settings.errors, &mut random);
        let how = Navigated { settings, until_s: 8.0, detector: false, ..Navigated::default() };
        let points = navigate(&travel, &errors, how, 1);
        let sd = at(&points, 5.9).position_sd();
        println!("matrix {scale}: moving {sd:.4} m, end {}", last(&points).row());
        assert!(sd < before);
        assert!(last(&points).nees() < 16.3);
        before = sd;
        deviations.push(last(&points).position_sd());
    }
    assert!(deviations[0] > 1.3 * deviations[1] && deviations[1] > 1.02 * deviations[2]);
}

#[test]
fn less_known_of_rests_is_a_larger_deviation() {
    let (mut random, errors) = drawn(34);
    let travel = Travel::stop_and_go(&mut random, 3, 0.7, 0.7);
    for gyroscope in [true, false] {
        let run = |rests, profile| {
            let mut how = Navigated { until_s: 15.0, gyroscope, ..Navigated::default() };
            how.settings.rests = rests;
            how.settings.profile = profile;
            let points = navigate(&travel, &errors, how, 34);
            println!("{rests:?} {profile:?}: {}", last(&points).row());
            [at(&points, 8.0).position_sd(), last(&points).position_sd()]
        };
        let zero = run(Rests::ZeroVelocity, Profile::Hand);
        let constant = run(Rests::ConstantVelocity, Profile::Hand);
        assert!(constant[1] > zero[1] && constant[0] > zero[0]);
        let ignored = run(Rests::Ignored, Profile::Free);
        assert!(ignored[1] > constant[1]);
        if gyroscope {
            // 0.1 m/s a component for 11 s and more, the same at all rests.
            assert!((1.5..4.0).contains(&constant[1]), "{}", constant[1]);
            // And it grows faster than in proportion to time.
            assert!(ignored[1] > 2.5 * ignored[0] && ignored[1] > 20.0);
        }
    }
}

#[test]
fn a_stance_of_a_foot_is_certain() {
    // Strides of 1.2 m in 0.6 s with stances of 0.6 s.
    let travel = (0..15).fold(Travel::rest(), |travel, k| {
        let pitch = if k % 2 == 0 { 0.8 } else { -0.8 };
        travel.leg(2.0 + 1.2 * f64::from(k), 0.6, [1.2, 0.0, 0.0], [0.0, pitch, 0.0])
    });
    for seed in 0..5 {
        let (_, errors) = drawn(seed);
        let how = Navigated {
            settings: Settings::of(Profile::Foot),
            rate_hz: 200.0,
            until_s: 21.0,
            // Stances of minimum-jerk strides end softly, those of feet do not: the true ones.
            detector: false,
            field: false,
            ..Navigated::default()
        };
        let points = navigate(&travel, &errors, how, seed);
        let end = last(&points);
        println!("{}", end.row());
        assert!(end.nees() < 16.3, "{}", end.row());
        // Of 18 m.
        assert!(end.position_error.norm() < 1.5, "{}", end.row());
        assert!((0.3..2.5).contains(&end.position_sd()), "{}", end.row());
        assert_eq!((end.recoveries, end.divergences), (0, 0));
    }
}

#[test]
fn a_foot_s_stance_is_never_gated_and_a_hand_s_rest_is_until_it_is_certain() {
    let start = Start::align(&[still(0.0); 10], true).unwrap();
    // A shock that the sensor reports wrongly: 5 m/s.
    let shock = Sample { force_mps2: Vector3::new(100.0, 0.0, 9.8), ..still(0.005) };
    let speed = |profile, rest_s: f64| {
        let settings = Settings::of(profile);
        let mut navigator = Navigator::new(settings, &start);
        for k in 0..1000 {
            navigator.push(&still(0.005), k < 500).unwrap();
        }
        for _ in 0..10 {
            navigator.push(&shock, false).unwrap();
        }
        let foot = profile == Profile::Foot;
        for _ in 0..(rest_s / 0.005) as usize {
            navigator.push(&still(0.005), !foot).unwrap();
            if foot {
                navigator.stance(0.01);
            }
        }
        let velocity = Vector3::from(navigator.solution().velocity_mps);
        (velocity.norm(), navigator.recoveries())
    };
    let foot = speed(Profile::Foot, 0.2);
    assert!(foot.0 < 0.5 && foot.1 == 0, "{foot:?}");
    let gated = speed(Profile::Hand, 1.0);
    assert!((4.5..5.5).contains(&gated.0) && gated.1 == 0, "{gated:?}");
    // The first recovery takes the velocity for the effect of a tilt. Further updates of the same rest correct that.
    for rest_s in [2.5, 20.0] {
        let certain = speed(Profile::Hand, rest_s);
        assert!(certain.0 < 0.1 && (1..=3).contains(&certain.1), "{certain:?}");
    }
}

#[test]
fn a_rest_of_one_sample_tells_no_angular_rate() {
    let start = Start::align(&[still(0.0); 10], false).unwrap();
    let turning = Sample { rate_rad_s: Some(Vector3::new(0.0, 0.0, 0.04)), ..still(0.01) };
    let rate = |rest: usize| {
        let mut navigator = Navigator::new(Settings::default(), &start);
        for k in 0..1000 {
            navigator.push(&turning, k >= 1000 - rest).unwrap();
        }
        navigator.angular_rate().z
    };
    assert!(rate(1) > 0.039, "{}", rate(1));
    assert!(rate(100) < 0.01, "{}", rate(100));
}

#[test]
fn each_profile_bounds_the_speed_as_it_says() {
    let start = Start::align(&[still(0.0); 10], true).unwrap();
    let sd = |profile| {
        let mut navigator = Navigator::new(Settings::of(profile), &start);
        for _ in 0..6000 {
            navigator.push(&still(0.01), false).unwrap();
        }
        assert!(!navigator.is_at_rest());
        navigator.push(&still(0.01), true).unwrap();
        assert!(navigator.is_at_rest());
        navigator.push(&still(0.01), false).unwrap();
        assert!(!navigator.is_at_rest());
        let mut free = Navigator::new(Settings::of(profile), &start);
        for _ in 0..6000 {
            free.push(&still(0.01), false).unwrap();
        }
        deviation(&free.solution().velocity_covariance)
    };
    let [hand, slide, vehicle, free] =
        [Profile::Hand, Profile::Slide, Profile::Vehicle, Profile::Free].map(sd);
    println!("{hand} {slide} {vehicle} {free}");
    assert!(hand < 3.5 && slide < 3.5);
    assert!(vehicle < 52.0 && vehicle > 2.0 * hand);
    assert!(free > vehicle);
}

#[test]
fn an_origin_is_where_the_unit_is_with_the_heading_that_it_has() {
    let start = Start::align(&[still(0.0); 10], false).unwrap();
    let mut navigator = Navigator::new(Settings::default(), &start);
    for _ in 0..300 {
        navigator.push(&still(0.01), false).unwrap();
    }
    assert!(deviation(&navigator.solution().position_covariance) > 1.0);
    navigator.set_origin();
    let solution = navigator.solution();
    assert_eq!(solution.position_m, [0.0; 3]);
    assert!(deviation(&solution.position_covariance) < 1e-3);
    assert!(solution.attitude_covariance[2][2].sqrt() < 2e-3);
    navigator.set_position(Vector3::new(1.0, 2.0, 3.0));
    assert_eq!(navigator.solution().position_m, [1.0, 2.0, 3.0]);
    assert_eq!(navigator.angular_rate(), Vector3::zeros());
}

#[test]
fn a_gap_widens_the_deviation_and_the_next_rest_finds_the_velocity() {
    for (gyroscope, seed) in [(true, 1), (true, 2), (false, 3)] {
        let (mut random, errors) = drawn(seed);
        let travel = Travel::stop_and_go(&mut random, 2, 0.4, 0.4);
        for gap_s in [[4.5, 4.8], [4.4, 5.4]] {
            let how = Navigated { until_s: 14.0, gyroscope, gap_s, ..Navigated::default() };
            let points = navigate(&travel, &errors, how, seed);
            let lasts = gap_s[1] - gap_s[0];
            let (before, after) = (at(&points, gap_s[0] - 0.02), at(&points, gap_s[1]));
            let grown = after.position_sd() / (0.5 * 5.0 * 3_f64.sqrt() * lasts * lasts);
            assert!(after.position_sd() > before.position_sd());
            assert!((0.9..1.6).contains(&grown), "{grown}: {}", after.row());
            let end = last(&points);
            println!("{} | {} | {}", before.row(), after.row(), end.row());
            assert!(deviation(&end.solution.velocity_covariance) < 0.02);
            assert!(end.velocity_error.norm() < 0.03);
            assert!(end.nees() < 16.3 && end.tilt_error.to_degrees() < 2.5);
        }
    }
}

#[test]
fn a_gap_without_a_gyroscope_includes_the_samples_of_an_unfinished_step() {
    let start = Start::align(&[still(0.0); 10], true).unwrap();
    let new = || Navigator::new(without_gyroscope(), &start);
    // Steps of the model have 20 ms.
    let (mut unfinished, mut whole) = (new(), new());
    unfinished.push(&still(0.008), true).unwrap();
    unfinished.interrupt(0.5);
    whole.interrupt(0.508);
    assert_eq!(unfinished.solution(), whole.solution());
}

#[test]
fn an_alignment_leaves_out_numbers_that_are_not_finite() {
    let field_ut = Some(Vector3::new(0.0, 20.0, -44.0));
    let good = Sample { field_ut, ..still(0.01) };
    let bad = Vector3::new(f64::NAN, 0.0, 0.0);
    let no_force = Sample { force_mps2: bad, ..good };
    let no_field = Sample { field_ut: Some(bad), ..good };
    let expected = Start::align(&[good], true).unwrap();
    let found = Start::align(&[no_force, good, no_field], true).unwrap();
    assert_eq!(found.attitude, expected.attitude);
    assert_eq!(found.field_ut, expected.field_ut);
    assert!((found.force_mps2 - wimu_nav::GRAVITY_MPS2).abs() < 1e-12);
    let huge = Sample { force_mps2: bad.map(|_| f64::MAX), ..good };
    for none in [&[][..], &[no_force], &[huge, huge]] {
        assert!(Start::align(none, true).is_none());
    }
}

fn still(step_s: f64) -> Sample {
    Sample {
        step_s,
        force_mps2: Vector3::new(0.0, 0.0, wimu_nav::GRAVITY_MPS2),
        rate_rad_s: Some(Vector3::zeros()),
        field_ut: None,
    }
}

#[test]
fn a_sample_that_is_not_finite_is_a_fault_and_no_state_is_spoilt() {
    let start = Start::align(&[still(0.01); 10], true).unwrap();
    let mut with = Navigator::new(Settings::default(), &start);
    let mut without = Navigator::new(without_gyroscope(), &start);
    let bad = Vector3::new(0.0, f64::NAN, 0.0);
    let faults = [
        (Sample { force_mps2: bad, ..still(0.01) }, SampleFault::NotFinite),
        (Sample { rate_rad_s: Some(bad), ..still(0.01) }, SampleFault::NotFinite),
        (Sample { field_ut: Some(bad), ..still(0.01) }, SampleFault::NotFinite),
        (still(-0.01), SampleFault::NoTime),
        (still(f64::NAN), SampleFault::NoTime),
    ];
    for (sample, fault) in faults {
        for _ in 0..50 {
            with.push(&still(0.01), true).unwrap();
            without.push(&still(0.01), true).unwrap();
        }
        let before = with.solution();
        assert_eq!(with.push(&sample, true), Err(fault));
        assert_eq!(without.push(&sample, true), Err(fault));
        assert!(with.filter().is_sound() && without.filter().is_sound());
        let grows = deviation(&with.solution().velocity_covariance)
            > deviation(&before.velocity_covariance);
        assert_eq!(grows, fault == SampleFault::NotFinite, "a missing sample is time");
        assert_eq!(with.solution().position_m, before.position_m);
    }
    assert_eq!((with.divergences(), without.divergences()), (0, 0));
    assert!(SampleFault::NoTime.to_string().contains("time"));
    assert!(SampleFault::NotFinite.to_string().contains("finite"));
    assert!(Start::align(&[Sample { force_mps2: Vector3::zeros(), ..still(0.0) }], true).is_none());
}

#[test]
fn an_attitude_that_was_kicked_recovers_at_the_next_rest() {
    for seed in 0..10 {
        let mut random = Random::new(seed + 36);
        let mut settings = Settings::default();
        settings.errors.accelerometer_bias = 0.02;
        let errors = Errors::drawn(&settings.errors, &mut random);
        // Two degrees of tilt within 50 ms that the gyroscope reports and no unit makes, at the start of a long move.
        let travel = Travel::rest().leg(4.0, 4.0, [1.0, 0.5, 0.0], [0.0; 3]);
        let angle = std::f64::consts::TAU * random.uniform();
        let kick = Vector3::new(angle.cos(), angle.sin(), 0.0) * (2_f64.to_radians() / 0.05);
        let how = Navigated {
            settings,
            until_s: 12.0,
            detector: false,
            field: false,
            kick: (4.2, 4.25, kick),
            ..Navigated::default()
        };
        let points = navigate(&travel, &errors, how, seed);
        let end = last(&points);
        println!("{} | {} {}", at(&points, 7.9).row(), end.row(), end.recoveries);
        let tilt = at(&points, 4.3).tilt_error.to_degrees();
        assert!((1.5..2.7).contains(&tilt), "{tilt}");
        assert_eq!((end.recoveries, end.divergences), (1, 0));
        assert!(end.tilt_error.to_degrees() < 0.5, "{}", end.row());
        assert!(end.velocity_error.norm() < 0.05 && end.position_sd() > 0.2, "{}", end.row());
        assert!(end.nees() < 30.0, "{}", end.nees());
    }
}

#[test]
fn an_impossible_speed_is_a_divergence_and_the_navigator_begins_again() {
    let start = Start::align(&[still(0.01); 10], true).unwrap();
    let mut navigator = Navigator::new(Settings::default(), &start);
    let fast = Sample { force_mps2: Vector3::new(2000.0, 0.0, 9.8), ..still(0.01) };
    let mut pushes = 0;
    while navigator.divergences() == 0 {
        navigator.push(&fast, false).unwrap();
        pushes += 1;
        assert!(pushes < 100);
    }
    assert!((10..=20).contains(&pushes), "{pushes}: 300 m/s at 2000 m/s²");
    let lost = navigator.solution();
    assert!(deviation(&lost.position_covariance) > 1e3);
    assert_eq!(lost.velocity_mps, [0.0; 3]);
    for _ in 0..300 {
        navigator.push(&still(0.01), true).unwrap();
    }
    let found = navigator.solution();
    assert!(deviation(&found.velocity_covariance) < 0.02);
    assert!(deviation(&found.position_covariance) > 1e3, "it is still lost");
    assert_eq!(navigator.divergences(), 1);
}

#[test]
fn a_start_in_motion_is_aligned_by_the_first_rest() {
    let mut inside = Coverage::default();
    for seed in 0..20 {
        let (mut random, errors) = drawn(seed);
        // Up to a third of gravity; at rest from 6 s on.
        let travel = Travel::oscillation(&mut random, [-2.0, 6.0], 0.04, 0.2);
        let how = Navigated { until_s: 9.0, starts_at_rest: false, ..Navigated::default() };
        let points = navigate(&travel, &errors, how, seed);
        let (begin, end) = (&points[0], last(&points));
        println!("{} | {}", begin.row(), end.row());
        let tilt = deviation(&begin.solution.attitude_covariance);
        assert!((0.4..0.6).contains(&tilt), "{tilt}");
        assert!(deviation(&begin.solution.velocity_covariance) > 2.0);
        inside.count(end.tilt_error.to_degrees() < 2.5 && end.velocity_error.norm() < 0.05);
        assert!(end.position_error.norm() < 5.0 * end.position_sd(), "{}", end.row());
    }
    inside.assert_can_be(0.95..=1.0, "aligned");
}

#[test]
fn without_a_gyroscope_a_hand_s_motion_stays_bounded() {
    for seed in 0..5 {
        let (mut random, errors) = drawn(seed);
        let travel = Travel::oscillation(&mut random, [4.0, 64.0], 0.1, 0.2);
        let how = Navigated { until_s: 68.0, gyroscope: false, ..Navigated::default() };
        let points = navigate(&travel, &errors, how, seed);
        let most = points.iter().map(|p| p.position_error.norm()).fold(0.0, f64::max);
        let end = last(&points);
        println!("most {most:.3} m, {}", end.row());
        assert!(most < 2.5, "{most}");
        assert!((0.3..10.0).contains(&end.position_sd()), "{}", end.row());
        assert!(end.velocity_error.norm() < 0.05, "{}", end.row());
        assert!(end.tilt_error.to_degrees() < 3.0, "{}", end.row());
        let outside = points.iter().filter(|p| p.nees() > 16.3).count();
        assert!(outside < points.len() / 10, "{outside} of {}", points.len());
        assert_eq!(end.divergences, 0);
    }
}

#[test]
fn a_pose_from_outside_rotates_all_that_is_known() {
    let (mut random, errors) = drawn(37);
    let travel = Travel::stop_and_go(&mut random, 2, 0.7, 0.7);
    let mut samples = travel.samples(100.0, 9.0, &errors, &mut random);
    for sample in &mut samples {
        sample.field_ut = None;
    }
    let start = Start::align(&samples[..50], true).unwrap();
    let run = |heading: f64| {
        let mut navigator = Navigator::new(Settings::default(), &start);
        navigator.set_heading(heading);
        for (k, sample) in samples.iter().enumerate() {
            if k == 700 {
                let zero = Vector3::zeros();
                navigator.set_pose(zero, zero, 0.3, [0.01, 0.02, 0.03]);
                assert!((navigator.heading() - 0.3).abs() < 1e-9);
            }
            navigator.push(sample, travel.at_rest(k as f64 * 0.01)).unwrap();
        }
        navigator
    };
    // The same motion in two frames, until the pose makes them one.
    let (a, b) = (run(0.0), run(2.0));
    let off = a.filter().state.get(POSITION) - b.filter().state.get(POSITION);
    let tilt = a.filter().covariance(ATTITUDE) - b.filter().covariance(ATTITUDE);
    let position = a.filter().covariance(POSITION) - b.filter().covariance(POSITION);
    assert!(off.norm() < 1e-6, "{off}");
    assert!(tilt.norm() < 1e-4 * a.filter().covariance(ATTITUDE).norm(), "{tilt}");
    assert!(position.norm() < 1e-4 * a.filter().covariance(POSITION).norm(), "{position}");
}

#[test]
fn a_position_from_outside_finds_a_lost_unit() {
    let start = Start::align(&[still(0.01); 10], true).unwrap();
    let mut navigator = Navigator::new(Settings::default(), &start);
    navigator.interrupt(2.0);
    assert!(deviation(&navigator.solution().position_covariance) > 10.0);
    let fix = Position {
        position_m: Vector3::new(3.0, -1.0, 0.5),
        deviation_m: Vector3::repeat(0.1),
        lever_arm_m: Vector3::zeros(),
    };
    assert!(navigator.update(&fix, Gate::ChiSquare).accepted);
    let found = navigator.solution();
    assert!((Vector3::from(found.position_m) - fix.position_m).norm() < 0.01);
    let sd = deviation(&found.position_covariance);
    assert!((0.16..0.18).contains(&sd), "{sd}");
    let elsewhere = Position { position_m: Vector3::zeros(), ..fix };
    assert!(!navigator.update(&elsewhere, Gate::ChiSquare).accepted);
}

#[test]
fn a_height_alone_leaves_the_horizontal_position() {
    let start = Start::align(&[still(0.01); 10], true).unwrap();
    let mut navigator = Navigator::new(Settings::default(), &start);
    navigator.interrupt(2.0);
    let before = navigator.solution();
    let height = Position {
        position_m: Vector3::new(f64::NAN, f64::NAN, 2.0),
        deviation_m: Vector3::new(f64::INFINITY, f64::INFINITY, 0.1),
        lever_arm_m: Vector3::zeros(),
    };
    assert!(navigator.update(&height, Gate::ChiSquare).accepted);
    let after = navigator.solution();
    assert!((after.position_m[2] - 2.0).abs() < 0.01);
    assert!(after.position_covariance[2][2].sqrt() < 0.11);
    for k in 0..2 {
        assert!((after.position_m[k] - before.position_m[k]).abs() < 1e-6);
        assert!(after.position_covariance[k][k] > 0.99 * before.position_covariance[k][k]);
    }
}

#[test]
fn a_heading_from_outside_rotates_the_unit_the_short_way() {
    let start = Start::align(&[still(0.01); 10], true).unwrap();
    let mut navigator = Navigator::new(Settings::default(), &start);
    let zero = Vector3::zeros();
    navigator.set_pose(zero, zero, 3.0, [1.0, 1.0, 0.5]);
    let heading = Heading { heading_rad: -3.0, deviation_rad: 0.01 };
    assert!(navigator.update(&heading, Gate::ChiSquare).accepted);
    // From 3 rad through π: 0.28 rad.
    let off = (navigator.heading() + 3.0).rem_euclid(std::f64::consts::TAU);
    assert!(off.min(std::f64::consts::TAU - off) < 1e-3, "{off}");
    let sd = navigator.solution().attitude_covariance[2][2].sqrt();
    assert!((0.0095..0.0105).contains(&sd), "{sd}");
}

#[test]
fn covariances_are_symmetric_and_no_variance_is_negative() {
    let (mut random, errors) = drawn(38);
    let travel = Travel::stop_and_go(&mut random, 3, 1.0, 1.0);
    for gyroscope in [true, false] {
        let how = Navigated { until_s: 15.0, gyroscope, ..Navigated::default() };
        for point in navigate(&travel, &errors, how, 38) {
            let s = &point.solution;
            for p in [s.position_covariance, s.velocity_covariance, s.attitude_covariance] {
                for i in 0..3 {
                    assert!(p[i][i] >= 0.0);
                    for j in 0..i {
                        assert!((p[i][j] - p[j][i]).abs() < 1e-12 * (p[i][i] + p[j][j]));
                        assert!(p[i][j] * p[i][j] <= p[i][i] * p[j][j] * (1.0 + 1e-9));
                    }
                }
            }
        }
    }
}

#[test]
fn a_sensor_s_own_states_are_estimated_and_begin_again_with_the_filter() {
    let start = Start::align(&[still(0.0); 10], true).unwrap();
    let mut navigator = Navigator::new(Settings::default(), &start);
    let mut errors = RangeErrors::default();
    (errors.bias_m, errors.correlated_m) = (0.5, 0.05);
    let at = Vector3::new(5.0, 0.0, 0.0);
    let anchor = navigator.claim(|layout| Anchor::claim(layout, at, &errors));
    let bias = anchor.bias.unwrap();
    let sd = |navigator: &Navigator| navigator.filter().covariance(bias).x.sqrt();
    assert!((sd(&navigator) - 0.5).abs() < 1e-12);
    for _ in 0..500 {
        navigator.push(&still(0.01), true).unwrap();
        navigator.predict(&CorrelatedErrors { anchors: &[anchor], errors: &errors, step_s: 0.01 });
        let range = Range {
            anchor: &anchor,
            range_m: 5.3,
            deviation_m: 0.03,
            lever_arm_m: Vector3::zeros(),
            delay: None,
            age_s: 0.0,
        };
        navigator.update(&range, Gate::ChiSquare);
    }
    let found = navigator.filter().state.get(bias).x;
    assert!(
        (found - 0.3).abs() < 0.03 && (0.01..0.06).contains(&sd(&navigator)),
        "{found} ± {}",
        sd(&navigator)
    );
    let blow = Sample { force_mps2: Vector3::new(1e6, 0.0, 0.0), ..still(0.01) };
    navigator.push(&blow, false).unwrap();
    assert_eq!(navigator.divergences(), 1);
    assert!((sd(&navigator) - 0.5).abs() < 1e-12);
    assert_eq!(navigator.filter().state.get(bias).x, 0.0);
}
