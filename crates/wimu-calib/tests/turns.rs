//! Three and four angles: what a turn about a level axle shows, and what it does not.

use crate::common;

use common::{DrawModel as _, G, NINE, Random, exact, jitter, pose, unit, ups};
use proptest::prelude::*;
use wimu_calib::{
    Gravity, Parameter, Placement, Pose, Reason, Refusal, four_angle, multi_position, three_angle,
};
use wimu_model::{ErrorModel, ErrorTerms};
use wimu_testkit::{Coverage, coverage_figure, trials};

proptest! {
    #![proptest_config(common::config())]

    #[test]
    fn turns_recover_bias_and_the_in_plane_norm_wherever_they_begin(
        seed: u64,
        begin in -3.0..3.0_f64,
        backwards: bool,
    ) {
        let mut random = Random::new(seed);
        let truth = random.model(false);
        let matrix = truth.terms().matrix;
        for steps in [3_usize, 4] {
            let mut poses = Vec::new();
            for k in 0..steps {
                let way = if backwards { -1.0 } else { 1.0 };
                let angle = begin + way * std::f64::consts::TAU * k as f64 / steps as f64;
                poses.push(pose(&truth, G, [0.0, angle.cos(), angle.sin()]));
            }
            let placement = Placement::new(0.0).expect("placement");
            let method = if steps == 4 { four_angle } else { three_angle };
            let estimate = method(&poses, exact(), placement).expect("an answer");
            let found = estimate.model.terms();
            for axis in [1, 2] {
                let norm = matrix[axis][1].hypot(matrix[axis][2]);
                prop_assert!((found.bias_mps2[axis] - truth.terms().bias_mps2[axis]).abs() < 1e-9);
                prop_assert!((found.matrix[axis][axis] - norm).abs() < 1e-9);
            }
            // X was turned about: nothing is said of it.
            prop_assert!(!estimate.fitted.contains(Parameter::BiasX));
            prop_assert_eq!(found.bias_mps2[0], 0.0);
        }
    }
}

#[test]
fn what_is_no_turn_is_refused() {
    let perfect = ErrorModel::default();
    let at = |up: [f64; 3]| pose(&perfect, G, unit(up));
    let turn = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]].map(at);
    let refused = |poses: &[Pose]| four_angle(poses, exact(), Placement::BY_HAND).expect_err("no");
    let out_of_order = [turn[0], turn[2], turn[1], turn[3]];
    for poses in [&turn[..3], &[turn, turn].concat()[..6], &[turn[0]; 4], &out_of_order, &[]] {
        let refusal = refused(poses);
        assert!(
            matches!(refusal, Refusal { reason: Reason::Placement { steps: 4, .. }, .. }),
            "{refusal}"
        );
    }
    assert!(four_angle(&turn, exact(), Placement::BY_HAND).is_ok());
    let steps_off = [turn[0], turn[1], turn[2], at([0.1, -1.0, 0.0])];
    let said = four_angle(&steps_off, exact(), Placement::new(0.002).expect("placement"));
    // What the readings contradict is not believed.
    assert!(said.is_ok_and(|e| e.interval_dof.is_some() && e.sd().bias_mps2[0] > 0.05));
}

/// Turns of a sensor with errors: `steps` of `step`°, its own axis `lean`° from the axis of rotation
/// and that `tilt`° from level.
fn turned(steps: usize, step: f64, lean: f64, tilt: f64, begin: f64) -> Vec<Pose> {
    let mut random = Random::new(77);
    let truth = random.model(true);
    (0..steps)
        .map(|k| {
            let angle = begin + (step * k as f64).to_radians();
            let (lean, tilt) = (lean.to_radians(), tilt.to_radians());
            // In axes of the rotation, then of the sensor, which leans about its Y axis.
            let [x, y, z] = [angle.cos() * tilt.cos(), angle.sin() * tilt.cos(), tilt.sin()];
            let (sin, cos) = lean.sin_cos();
            pose(&truth, G, [cos * x - sin * z, y, sin * x + cos * z])
        })
        .collect()
}

#[test]
fn turns_that_are_none_are_refused_with_the_reason_and_the_remedy() {
    for begin in [0.0, 0.4, 1.1, 2.0, 3.9] {
        for (steps, method) in
            [(4, four_angle as fn(&[Pose], Gravity, Placement) -> _), (3, three_angle)]
        {
            let whole = 360.0 / steps as f64;
            let ask = |step, lean, tilt| {
                method(&turned(steps, step, lean, tilt, begin), exact(), Placement::BY_HAND)
            };
            for (step, lean, tilt) in [(whole, 0.0, 0.0), (whole, 2.0, 2.0), (whole, -1.0, 1.0)] {
                let answer: Result<wimu_calib::Estimate, Refusal> = ask(step, lean, tilt);
                assert!(answer.is_ok(), "{step} {lean} {tilt}: {answer:?}");
            }
            for wrong in [whole - 10.0, whole + 10.0, whole - 30.0] {
                let refusal = ask(wrong, 0.0, 0.0).expect_err("unequal steps");
                assert!(
                    matches!(refusal, Refusal { reason: Reason::Placement { .. }, .. }),
                    "{wrong}: {refusal}"
                );
                assert!(refusal.to_string().contains("turn"), "{refusal}");
            }
            for (lean, tilt) in [(17.0, 0.0), (0.0, 17.0), (0.0, -20.0), (12.0, 12.0), (40.0, 0.0)]
            {
                let refusal = ask(whole, lean, tilt).expect_err("no level axis");
                assert!(
                    matches!(refusal, Refusal { reason: Reason::Placement { .. }, .. }),
                    "{lean} {tilt}: {refusal}"
                );
            }
        }
    }
}

#[test]
fn what_a_turn_does_not_show_is_said_and_not_taken_for_known() {
    let estimate = four_angle(&turned(4, 90.0, 0.0, 0.0, 0.3), exact(), Placement::BY_HAND)
        .expect("an answer");
    let unseen = estimate.not_observed();
    for parameter in Parameter::ALL {
        assert_ne!(unseen.contains(parameter), estimate.fitted.contains(parameter));
        assert!(estimate.covariance.sd(parameter) > 0.0, "{parameter}");
    }
    assert!(unseen.contains(Parameter::BiasZ) && unseen.contains(Parameter::ScaleZ));
    assert!(estimate.sd().bias_mps2[2] >= 0.3 && estimate.sd().matrix[2][2] >= 0.02);
    let mut random = Random::new(7);
    let truth = random.model(true);
    let poses: Vec<Pose> = ups(&mut random, 8).into_iter().map(|up| pose(&truth, G, up)).collect();
    let nine = multi_position(&poses, exact(), NINE).expect("an answer");
    assert!(nine.not_observed().is_empty());
}

/// What is off in a turn: the axle from level, rad, and each of its steps.
struct TurnOff {
    axle: f64,
    steps: [f64; 4],
}

/// Turns of a sensor about Z whose steps and level are off, and 1 mm/s² of noise.
fn turn_off(random: &mut Random, truth: &ErrorModel, count: usize, off: &TurnOff) -> Vec<Pose> {
    (0..count)
        .map(|k| {
            let angle = std::f64::consts::TAU * k as f64 / count as f64 + off.steps[k];
            let (level, along) = (off.axle.cos(), off.axle.sin());
            let mut pose = pose(truth, G, [level * angle.cos(), level * angle.sin(), along]);
            jitter(random, &mut pose, 0.001);
            pose
        })
        .collect()
}

#[test]
fn a_turn_off_level_or_of_unequal_steps_is_refused_or_its_interval_says_so() {
    let degree = std::f64::consts::PI / 180.0;
    let (mut all_answered, mut all_held) = (Vec::new(), Vec::new());
    for (name, axle, step) in [
        ("axle 6° off", 6.0, 0.0),
        ("axle 10° off", 10.0, 0.0),
        ("axle 12° off", 12.0, 0.0),
        ("axle 15° off", 15.0, 0.0),
        ("axle -12° off", -12.0, 0.0),
        ("a step 8° off", 0.0, 8.0),
        ("a step 12° off", 0.0, 12.0),
    ] {
        for steps in [4, 3] {
            // Three steps leave no redundancy for an unequal one, which the command says.
            if steps == 3 && step > 0.0 {
                continue;
            }
            let (mut answered, mut held) = (Coverage::default(), Coverage::default());
            let mut worst = 0.0_f64;
            for seed in 0..trials(1000) as u64 {
                let mut random = Random::new(seed);
                let mut terms = ErrorTerms::default();
                for axis in 0..3 {
                    terms.bias_mps2[axis] = 0.3 * random.normal();
                    terms.matrix[axis][axis] += 0.02 * random.normal();
                }
                let truth = ErrorModel::new(terms).expect("within bounds");
                let mut off = TurnOff {
                    axle: (axle + random.normal()) * degree,
                    steps: [0; 4].map(|_| random.normal() * degree),
                };
                off.steps[1] += step * degree;
                let poses = turn_off(&mut random, &truth, steps, &off);
                let method = if steps == 4 { four_angle } else { three_angle };
                let answer = method(&poses, exact(), Placement::BY_HAND);
                answered.count(answer.is_ok());
                let Ok(estimate) = answer else {
                    continue;
                };
                for axis in 0..2 {
                    let found = estimate.model.terms().matrix[axis][axis];
                    let error = (found - terms.matrix[axis][axis]).abs();
                    let said = estimate.half_width_95(Parameter::ALL[3 + 4 * axis]);
                    held.count(error <= said);
                    worst = worst.max(error / said);
                }
            }
            println!(
                "{name}, {steps} steps: answered {answered}, scale factors held {held}, at the worst \
                 {worst:.1} half widths off"
            );
            // Of a turn alone a bias may hide the tilt, and what little is answered is where it does.
            let (most, least) = if axle.abs() > 11.0 {
                (0.27, 0.0)
            } else if axle > 7.0 || step > 0.0 {
                (0.97, 0.65)
            } else {
                (1.0, 0.4)
            };
            answered.assert_can_be(0.0..=most, name);
            if held.total() > 0 {
                held.assert_can_be(least..=1.0, name);
                all_held.push(held);
            }
            if axle.abs() > 11.0 {
                all_answered.push(answered);
            }
        }
    }
    coverage_figure(
        "a turn about an axle 12 or 15° off level is answered",
        &all_answered,
        0.0..=0.27,
    );
    coverage_figure(
        "turns 6 to 15° off level, steps off: scale factor intervals hold",
        &all_held,
        0.93..=1.0,
    );
}
