//! Magnetometers with known iron and mounting.

use crate::common;

use common::{DIP, FIELD, Random, magnetometer as sensor};
use wimu_calib::{MagneticPose, Reason, Refusal, magnetometer};
use wimu_testkit::{Coverage, coverage_figure, draws, trials};

#[test]
fn intervals_hold_the_truth_95_percent_of_the_time() {
    // Student's t of 31, 9 and 3 degrees of freedom for the iron; of few poses many are refused.
    let (mut all_held, mut all_lost) = (Vec::new(), Vec::new());
    for (poses, least_answers) in [(40, 0.99), (18, 0.8), (12, 0.2)] {
        let [mut hard_held, mut soft_held, mut turned] = [Coverage::default(); 3];
        let [mut answered, mut lost] = [Coverage::default(); 2];
        let seeds = draws(1000, 3) as u64;
        for seed in 0..seeds {
            let mut random = Random::new(seed);
            let (soft, hard, rotation, poses) = sensor(&mut random, poses, 150.0);
            let answer = magnetometer(&poses, None);
            answered.count(answer.is_ok());
            let Ok(found) = answer else {
                continue;
            };
            (0..poses.len()).for_each(|pose| lost.count(found.rejected.contains(&pose)));
            let model = found.model;
            let t = model.terms();
            for (k, half_width) in found.hard_iron_half_width_95_nt().into_iter().enumerate() {
                let off = (f64::from(t.hard_iron_nt[k]) - hard[k]).abs();
                hard_held.count(off <= half_width);
            }
            for (k, half_width) in found.soft_iron_half_width_95().into_iter().enumerate() {
                let off = (f64::from(t.soft_iron[k]) - soft[k]).abs();
                soft_held.count(off <= half_width);
            }
            let mounting = t.to_accelerometer.expect("a rotation");
            let mut e = [0.0; 3];
            for axis in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] {
                let c = common::cross(rotation.rotate(axis), mounting.rotation.rotate(axis));
                for k in 0..3 {
                    e[k] += c[k] / 2.0;
                }
            }
            let half_width = found.rotation_half_width_95_rad().expect("a rotation");
            for k in 0..3 {
                turned.count(e[k].abs() <= half_width[k]);
            }
            if poses.len() == 40 {
                assert!((f64::from(t.field_nt) - FIELD).abs() < 300.0);
                assert!((f64::from(mounting.dip_rad) - DIP).abs() < 0.01);
            }
        }
        println!(
            "{poses} poses: answered {answered}, good poses left out {lost}; held: hard iron {hard_held}, soft iron \
             {soft_held}, rotation {turned}"
        );
        let kind = format!("{poses} poses");
        lost.assert_can_be(0.0..=0.003, &kind);
        answered.assert_can_be(least_answers..=1.0, &kind);
        for held in [hard_held, soft_held, turned] {
            held.assert_can_be(0.93..=0.97, &kind);
            all_held.push(held);
        }
        all_lost.push(lost);
    }
    let claim = "95 % intervals of a magnetometer's iron and rotation hold";
    coverage_figure(claim, &all_held, 0.93..=0.97);
    let claim = "good poses of a magnetometer are left out";
    coverage_figure(claim, &all_lost, 0.0..=0.003);
}

#[test]
fn what_tells_no_magnetometer_is_refused() {
    let mut random = Random::new(7);
    let (.., poses) = sensor(&mut random, 40, 100.0);
    assert!(magnetometer(&poses, None).is_ok());
    let few = magnetometer(&poses[..8], None);
    assert!(matches!(few, Err(Refusal { reason: Reason::TooFew { have: 8, need: 12 }, .. })));
    let mut bad = poses.clone();
    bad[3].output_nt[1] = f64::NAN;
    assert!(matches!(
        magnetometer(&bad, None),
        Err(Refusal { reason: Reason::Input { index: 3 }, .. })
    ));
    let same = vec![poses[0]; 40];
    assert!(matches!(
        magnetometer(&same, None),
        Err(Refusal { reason: Reason::NotObservable, .. })
    ));
    let mirrored: Vec<_> = poses
        .iter()
        .map(|p| MagneticPose {
            output_nt: [p.output_nt[0], p.output_nt[1], -p.output_nt[2]],
            ..*p
        })
        .collect();
    // It passes for a right one turned over, in a field of the opposite dip: the place tells.
    let refused = magnetometer(&mirrored, None);
    assert!(matches!(refused, Err(Refusal { reason: Reason::Axes, .. })), "{refused:?}");
    let model = magnetometer(&mirrored, Some(-DIP)).expect("a model").model;
    let dip = model.terms().to_accelerometer.expect("a rotation").dip_rad;
    assert!((f64::from(dip) + DIP).abs() < 0.01, "{dip}");
    assert!(magnetometer(&poses, Some(-DIP)).is_err());
    assert!(magnetometer(&poses, Some(0.5 * DIP)).is_ok());
    let others: Vec<_> =
        (0..40).map(|k| MagneticPose { up: poses[(k + 1) % 40].up, ..poses[k] }).collect();
    let refused = magnetometer(&others, None);
    assert!(matches!(refused, Err(Refusal { reason: Reason::PoorFit { .. }, .. })), "{refused:?}");
    let mut disturbed = poses.clone();
    for (k, pose) in disturbed.iter_mut().enumerate() {
        pose.output_nt[k % 3] += 30_000.0 * (k as f64).sin();
    }
    assert!(magnetometer(&disturbed, None).is_err());
}

/// A chip whose axes are parallel to the accelerometer's, in `count` orientations, after `change`.
fn parallel(count: u32, change: impl Fn([f64; 3]) -> [f64; 3]) -> Vec<MagneticPose> {
    let mut random = Random::new(21);
    (0..count)
        .map(|_| {
            let up = random.direction();
            let side = common::unit(common::cross(up, random.direction()));
            let output = std::array::from_fn(|i| {
                FIELD * (DIP.cos() * side[i] - DIP.sin() * up[i])
                    + [9_000.0, -4_000.0, 12_000.0][i]
                    + 100.0 * random.normal()
            });
            MagneticPose { output_nt: change(output), up }
        })
        .collect()
}

#[test]
fn a_negated_or_exchanged_axis_is_named() {
    type Change = fn([f64; 3]) -> [f64; 3];
    let changes: [(Change, &str); 6] = [
        (|[x, y, z]| [-x, y, z], "axis X is negated"),
        (|[x, y, z]| [x, -y, z], "axis Y is negated"),
        (|[x, y, z]| [x, y, -z], "axis Z is negated"),
        (|[x, y, z]| [-x, -y, -z], "all axes of the magnetometer are negated"),
        (|[x, y, z]| [y, x, z], "axes X and Y are exchanged"),
        (|[x, y, z]| [x, z, y], "axes Y and Z are exchanged"),
    ];
    for (change, expected) in changes {
        let refusal = magnetometer(&parallel(30, change), None).expect_err(expected);
        assert!(refusal.reason == Reason::Axes && refusal.text.contains(expected), "{refusal}");
    }
    // Turned by quarters or over, as boards mount it, it is right.
    let turns: [Change; 3] = [|m| m, |[x, y, z]| [y, -x, z], |[x, y, z]| [-x, -y, z]];
    for turned in turns {
        assert!(magnetometer(&parallel(30, turned), None).is_ok());
    }
}

/// What a magnet or iron that stays beside the board adds in the first poses.
#[test]
fn many_disturbed_poses_are_left_out_or_named_as_such() {
    let [mut left_out, mut named, mut wrong] = [Coverage::default(); 3];
    for seed in 0..trials(300) as u64 {
        let mut random = Random::new(seed);
        let (_, hard, _, clean) = sensor(&mut random, 40, 150.0);
        let push = common::unit([0; 3].map(|_| random.normal())).map(|p| 15_000.0 * p);
        let disturbed = |count: usize| {
            let mut poses = clean.clone();
            for pose in &mut poses[..count] {
                for (axis, push) in pose.output_nt.iter_mut().zip(push) {
                    *axis += push;
                }
            }
            magnetometer(&poses, None)
        };
        let mut off = |found: &wimu_calib::MagneticEstimate| {
            let terms = found.model.terms();
            wrong.count((0..3).any(|k| {
                let off = f64::from(terms.hard_iron_nt[k]) - hard[k];
                off.abs() > 5.0 * f64::from(terms.hard_iron_sd_nt[k])
            }));
        };
        // As many as may be left out.
        let answer = disturbed(6);
        left_out.count(answer.is_ok());
        match answer {
            Ok(found) => off(&found),
            Err(Refusal { reason: Reason::PoorFit { .. }, .. }) => {}
            other => panic!("seed {seed}: {other:?}"),
        }
        // More than that: named, unless some of them hardly show.
        let mut is_named = false;
        match disturbed(10) {
            Ok(found) => off(&found),
            Err(refusal) => {
                assert!(matches!(refusal.reason, Reason::PoorFit { .. }), "seed {seed}: {refusal}");
                let poses = refusal.text.split_once("disturbed in poses ").map_or("", |at| at.1);
                let poses = poses.split(" (from 0)").next().unwrap_or("");
                let poses: Vec<usize> =
                    poses.split(", ").filter_map(|pose| pose.parse().ok()).collect();
                let right = poses.iter().filter(|pose| **pose < 10).count();
                is_named = right >= 7 && right == poses.len();
            }
        }
        named.count(is_named);
    }
    coverage_figure("6 disturbed of 40 poses are left out", &[left_out], 0.9..=1.0);
    coverage_figure("10 disturbed of 40 poses are named", &[named], 0.67..=1.0);
    coverage_figure("hard iron beyond 5 σ where poses are disturbed", &[wrong], 0.0..=0.03);
    left_out.assert_can_be(0.9..=1.0, "left out");
    named.assert_can_be(0.67..=1.0, "named");
    wrong.assert_can_be(0.0..=0.03, "wrong");
}

#[test]
fn other_units_dead_and_clipped_axes_and_a_turn_about_one_axis_are_named() {
    let (.., poses) = sensor(&mut Random::new(9), 40, 100.0);
    let changed = |change: &dyn Fn(usize, &mut [f64; 3])| {
        let mut poses = poses.clone();
        for (k, pose) in poses.iter_mut().enumerate() {
            change(k, &mut pose.output_nt);
        }
        magnetometer(&poses, None).unwrap_err()
    };
    // µT taken for T, G for µT, mG for µT, T for µT, and a motor's field.
    for factor in [1e6, 0.01, 10.0, 1e-6, 100.0] {
        let refused = changed(&|_, m| *m = m.map(|axis| factor * axis));
        assert!(
            matches!(refused, Refusal { reason: Reason::Unit { .. }, .. }),
            "{factor}: {refused:?}"
        );
    }
    assert!(matches!(
        changed(&|_, m| m[1] = 7_000.0),
        Refusal { reason: Reason::Axis { clipped: false, axis: 1 }, .. }
    ));
    let highest = poses.iter().map(|p| p.output_nt[2]).fold(f64::MIN, f64::max);
    let limit = highest - 15_000.0;
    assert!(matches!(
        changed(&|_, m| m[2] = m[2].min(limit)),
        Refusal { reason: Reason::Axis { clipped: true, axis: 2 }, .. }
    ));
    // All poses level, turned about the vertical: a circle.
    let level: Vec<MagneticPose> = (0..40)
        .map(|k| {
            let (sin, cos) = (f64::from(k) * 0.3).sin_cos();
            let jitter = f64::from(k % 5) * 40.0;
            MagneticPose {
                output_nt: [20_000.0 * sin + jitter, 20_000.0 * cos, -44_000.0 + 20.0 * jitter],
                up: [0.0, 0.0, 9.81],
            }
        })
        .collect();
    let refused = magnetometer(&level, None);
    assert!(matches!(refused, Err(Refusal { reason: Reason::NotObservable, .. })), "{refused:?}");
}
