//! Multi-position on simulated sensors whose truth is known.

use crate::common;

use common::{
    AUTO, DrawModel as _, G, NINE, ROBUST, Random, exact, norm, parameters, pose, twelve,
};
use nalgebra::Matrix3;
use proptest::prelude::*;
use wimu_calib::{Gravity, Pose, Reason, Refusal, UnitHint, multi_position};
use wimu_model::{ErrorModel, ErrorTerms};
use wimu_testkit::{Lane, figure, rms_ratio_can_be, trials};

/// Poses in `count` random directions, after twelve well spread ones.
fn spread(random: &mut Random, model: &ErrorModel, more: usize) -> Vec<Pose> {
    let mut ups = twelve().to_vec();
    ups.extend((0..more).map(|_| random.direction()));
    ups.into_iter().map(|up| pose(model, G, up)).collect()
}

fn add_noise(random: &mut Random, poses: &mut [Pose], sd: f64) {
    for pose in poses {
        for y in &mut pose.mean_mps2 {
            *y += random.normal() * sd;
        }
    }
}

proptest! {
    #![proptest_config(common::config())]

    #[test]
    fn truth_is_recovered_from_noiseless_poses(seed: u64, more in 0_usize..20) {
        let mut random = Random::new(seed);
        let truth = random.model(true);
        let poses = spread(&mut random, &truth, more);
        let estimate = multi_position(&poses, exact(), NINE).expect("an answer");
        for (found, truth) in parameters(&estimate.model).iter().zip(parameters(&truth)) {
            prop_assert!((found - truth).abs() < 1e-9, "{found} {truth}");
        }
        prop_assert!(estimate.rms_mps2 < 1e-9 && estimate.max_mps2 < 1e-9);
        prop_assert_eq!(estimate.dof, 12 + more - 9);
    }

    #[test]
    fn truth_is_recovered_wherever_an_error_model_may_lie(seed: u64) {
        let mut random = Random::new(seed);
        let mut terms = ErrorTerms::default();
        for row in 0..3 {
            terms.bias_mps2[row] = random.within(4.0);
            for column in 0..=row {
                terms.matrix[row][column] = if row == column {
                    1.0 + random.within(0.4)
                } else {
                    random.within(0.25)
                };
            }
        }
        let truth = ErrorModel::new(terms).expect("within bounds");
        let poses = spread(&mut random, &truth, 4);
        let estimate = multi_position(&poses, exact(), NINE).expect("an answer");
        for (found, truth) in parameters(&estimate.model).iter().zip(parameters(&truth)) {
            prop_assert!((found - truth).abs() < 1e-8, "{found} {truth}");
        }
    }

    #[test]
    fn a_rotation_of_the_whole_sensor_changes_no_magnitude(seed: u64) {
        let mut random = Random::new(seed);
        let truth = random.model(false);
        let poses = spread(&mut random, &truth, 5);
        let estimate = multi_position(&poses, exact(), NINE).expect("an answer");
        for _ in 0..20 {
            let unseen = pose(&truth, G, random.direction());
            prop_assert!(estimate.residual_mps2(&unseen).abs() < 1e-8);
        }
    }
}

#[test]
fn the_worst_orientation_is_predicted_as_badly_as_said() {
    let mut random = Random::new(8);
    let truth = random.model(true);
    let clean = spread(&mut random, &truth, 0);
    let checks: Vec<Pose> = (0..200).map(|_| pose(&truth, G, random.direction())).collect();
    let mut squares = vec![0.0; checks.len()];
    let mut said = 0.0;
    let draws = trials(1000);
    for _ in 0..draws {
        let mut poses = clean.clone();
        add_noise(&mut random, &mut poses, 0.005);
        let estimate = multi_position(&poses, exact(), NINE).expect("an answer");
        said += estimate.worst_sd_mps2.powi(2);
        for (square, check) in squares.iter_mut().zip(&checks) {
            *square += estimate.residual_mps2(check).powi(2);
        }
    }
    let worst = squares.into_iter().fold(0.0, f64::max);
    let ratio = (worst / said).sqrt();
    figure(
        "error in the worst orientation over the stated one",
        format!("{ratio:.3}"),
        "0.9 to 1.1",
        (0.9..=1.1).contains(&ratio),
    );
    // The worst of many orientations is above its own expectation.
    assert!(rms_ratio_can_be(ratio, draws, 0.95..=1.05), "{ratio}");
}

#[test]
fn too_few_poses_are_refused() {
    let mut random = Random::new(10);
    let truth = random.model(true);
    let poses = spread(&mut random, &truth, 0);
    for (what, need) in [(AUTO, 4), (NINE, 10)] {
        let refused = multi_position(&poses[..need - 1], exact(), what);
        let reason = Reason::TooFew { have: need - 1, need };
        assert_eq!(refused.map_err(|refusal| refusal.reason), Err(reason));
    }
    assert!(multi_position(&[], exact(), AUTO).is_err());
}

#[test]
fn poses_that_do_not_determine_the_model_are_refused_with_its_parameters() {
    let perfect = ErrorModel::default();
    let same = vec![pose(&perfect, G, [0.0, 0.0, 1.0]); 20];
    let plane: Vec<Pose> = (0..24)
        .map(|k| {
            let angle = f64::from(k) * 0.26;
            pose(&perfect, G, [angle.cos(), angle.sin(), 0.0])
        })
        .collect();
    let faces: Vec<Pose> = [1.0, -1.0]
        .into_iter()
        .flat_map(|s| [[s, 0.0, 0.0], [0.0, s, 0.0], [0.0, 0.0, s]])
        .cycle()
        .take(18)
        .enumerate()
        .map(|(k, up)| {
            // No sensor repeats itself to the last digit.
            let mut visit = pose(&perfect, G, up);
            visit.mean_mps2[0] += 1e-7 * k as f64;
            visit
        })
        .collect();
    for (poses, have) in [(&same, Some(1)), (&plane, None), (&faces, None)] {
        let Err(refusal) = multi_position(poses, exact(), NINE) else {
            panic!("answered");
        };
        println!("{refusal}");
        // What is equal to the last digit is the same again.
        match refusal.reason {
            Reason::TooFew { have: found, .. } => assert_eq!(Some(found), have),
            reason => assert_eq!(reason, Reason::NotObservable),
        }
    }
    let refused = |poses| multi_position(poses, exact(), NINE).expect_err("refused").text;
    let text = refused(&plane);
    assert!(text.contains("Z up") && text.contains("Z down"), "{text}");
    let text = refused(&faces);
    assert!(text.contains("condition number") && text.contains("45°"), "{text}");
    multi_position(&faces, exact(), AUTO).expect("the bias is determined");
    // The same of a sensor whose axes are not square, and with noise: no fit converges.
    let mut random = Random::new(18);
    let truth = random.model(true);
    let mut faces: Vec<Pose> =
        faces.iter().map(|face| pose(&truth, G, face.mean_mps2.map(|y| y / G))).collect();
    add_noise(&mut random, &mut faces, 0.002);
    for what in [NINE, ROBUST] {
        let refusal = multi_position(&faces, exact(), what).expect_err("a refusal");
        assert!(matches!(refusal, Refusal { reason: Reason::NotObservable, .. }), "{refusal:?}");
    }
}

#[test]
fn a_pose_that_decides_alone_is_named() {
    let mut random = Random::new(11);
    let truth = random.model(true);
    // Six sides and four edges: ten poses for nine parameters.
    let mut ups = vec![[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]];
    ups.extend([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]);
    ups.extend(
        [[0.7, 0.7, 0.0], [0.7, 0.0, 0.7], [-0.7, 0.7, 0.0], [0.0, 0.7, 0.7]].map(common::unit),
    );
    let mut poses: Vec<Pose> = ups.into_iter().map(|up| pose(&truth, G, up)).collect();
    add_noise(&mut random, &mut poses, 0.003);
    let refused = multi_position(&poses, exact(), NINE);
    assert!(
        matches!(refused, Err(Refusal { reason: Reason::PoorPrediction { .. }, .. })),
        "{refused:?}"
    );
}

#[test]
fn wrong_units_are_recognised() {
    let mut random = Random::new(12);
    let truth = random.model(true);
    let poses = spread(&mut random, &truth, 0);
    for (factor, expected) in [
        (1.0 / G, UnitHint::G),
        (G, UnitHint::Mps2TakenForG),
        (1000.0 / G, UnitHint::MilliGOrCounts),
        (16384.0 / G, UnitHint::Counts),
        (0.01, UnitHint::NotGravity),
        (0.0, UnitHint::NotGravity),
    ] {
        let scaled: Vec<Pose> =
            poses.iter().map(|p| Pose::from_mean(p.mean_mps2.map(|y| y * factor))).collect();
        match multi_position(&scaled, exact(), NINE) {
            Err(Refusal { reason: Reason::Unit { hint, .. }, .. }) => assert_eq!(hint, expected),
            other => panic!("{other:?}"),
        }
    }
    assert!(Gravity::new(1.0, 0.0).is_none() && Gravity::new(f64::NAN, 0.0).is_none());
    assert!(Gravity::new(G, -1.0).is_none() && Gravity::new(G, f64::NAN).is_none());
}

#[test]
fn a_pose_with_a_value_that_is_no_number_is_named() {
    let mut random = Random::new(13);
    let truth = random.model(true);
    for bad in [f64::NAN, f64::INFINITY] {
        let mut poses = spread(&mut random, &truth, 3);
        poses[6].mean_mps2[1] = bad;
        let refused = multi_position(&poses, exact(), NINE);
        assert!(matches!(refused, Err(Refusal { reason: Reason::Input { index: 6 }, .. })));
    }
}

#[test]
fn a_dead_axis_and_poses_in_motion_are_refused() {
    let mut random = Random::new(14);
    let truth = random.model(true);
    let mut dead = spread(&mut random, &truth, 12);
    for pose in &mut dead {
        pose.mean_mps2[1] = 0.4;
    }
    let mut moving = spread(&mut random, &truth, 12);
    add_noise(&mut random, &mut moving, 3.0);
    for poses in [dead, moving] {
        for what in [NINE, AUTO] {
            let refused = multi_position(&poses, exact(), what).expect_err("a refusal");
            println!("{refused}");
        }
    }
    // Dead, and not merely never turned.
    let mut dead = spread(&mut random, &truth, 12);
    for pose in &mut dead {
        pose.mean_mps2[1] = 0.0;
    }
    let refused = multi_position(&dead, exact(), NINE);
    assert!(matches!(
        refused,
        Err(Refusal { reason: Reason::Axis { clipped: false, axis: 1 }, .. })
    ));
}

#[test]
fn a_pose_in_another_unit_is_left_out() {
    let mut random = Random::new(16);
    let truth = random.model(true);
    let mut one = spread(&mut random, &truth, 12);
    add_noise(&mut random, &mut one, 0.003);
    one[7].mean_mps2 = one[7].mean_mps2.map(|y| y / G);
    let estimate = multi_position(&one, exact(), ROBUST).expect("an answer");
    assert_eq!(estimate.rejected, [7]);
    assert!((estimate.model.terms().bias_mps2[0] - truth.terms().bias_mps2[0]).abs() < 0.01);
}

#[test]
fn very_many_poses_are_answered() {
    let mut random = Random::new(15);
    let truth = random.model(true);
    let count = Lane::current().choose([20_000, 50_000, 1_000_000]);
    let mut poses = spread(&mut random, &truth, count);
    add_noise(&mut random, &mut poses, 0.01);
    for pose in &mut poses {
        pose.samples = u32::MAX;
    }
    let estimate = multi_position(&poses, exact(), NINE).expect("an answer");
    for (found, truth) in parameters(&estimate.model).iter().zip(parameters(&truth)) {
        // Six standard deviations.
        assert!((found - truth).abs() < 0.1 / (count as f64).sqrt());
    }
    // The noise is that of the output: the force has A⁻¹ of it.
    let inverse = Matrix3::from(truth.terms().matrix).try_inverse().expect("regular");
    let noise = 0.01 * inverse.norm() / 3.0_f64.sqrt();
    assert!(rms_ratio_can_be(estimate.rms_mps2 / noise, count, 1.0..=1.0), "{}", estimate.rms_mps2);
    let worst = norm(poses[estimate.worst_pose].mean_mps2);
    assert!(worst.is_finite() && estimate.max_mps2 > 0.04);
}

#[test]
fn bad_poses_among_very_many_are_left_out() {
    for (count, share) in [(400, 0.05), (3000, 0.02), (20_000, 0.005)] {
        for seed in 0..Lane::current().choose([1, 1, 4]) {
            let mut random = Random::new(seed);
            let truth = random.model(true);
            let mut poses = spread(&mut random, &truth, count);
            add_noise(&mut random, &mut poses, 0.003);
            // Where Z is up, 2 % long: they agree with each other.
            let mut bad = 0;
            for pose in poses.iter_mut().filter(|pose| pose.mean_mps2[2] > 6.0) {
                if bad < (share * count as f64) as usize {
                    pose.mean_mps2 = pose.mean_mps2.map(|y| 1.02 * y);
                    bad += 1;
                }
            }
            let estimate = multi_position(&poses, exact(), ROBUST).expect("an answer");
            assert_eq!(estimate.rejected.len(), bad, "{count} {share}");
            assert_eq!(estimate.poses, poses.len() - bad);
            let (found, truth) = (parameters(&estimate.model), parameters(&truth));
            for parameter in estimate.fitted.iter() {
                let i = parameter.index();
                let off = (found[i] - truth[i]).abs();
                assert!(off <= 2.2 * estimate.half_width_95(parameter), "{count} {parameter}");
            }
        }
    }
}
