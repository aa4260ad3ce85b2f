//! Six-position on simulated sensors whose truth is known.

use crate::common;

use common::{DrawModel as _, G, Random, exact, misplaced, parameters, pose};
use proptest::prelude::*;
use wimu_calib::{Estimate, Face, Orientation, Placement, Pose, Reason, Refusal, six_position};
use wimu_model::ErrorModel;

const DEGREE: f64 = std::f64::consts::PI / 180.0;

fn squared() -> Placement {
    Placement::new(0.0).expect("placement")
}

fn six(truth: &ErrorModel) -> Vec<(Face, Pose)> {
    Face::ALL.into_iter().map(|face| (face, pose(truth, G, Orientation::from(face).up()))).collect()
}

fn unlabelled(poses: &[(Face, Pose)]) -> Vec<Pose> {
    poses.iter().map(|(_, pose)| *pose).collect()
}

fn labelled(poses: &[(Face, Pose)]) -> Result<Estimate, Refusal> {
    let sides: Vec<Face> = poses.iter().map(|(face, _)| *face).collect();
    six_position(&unlabelled(poses), Some(&sides), exact(), squared())
}

proptest! {
    #![proptest_config(common::config())]

    #[test]
    fn all_twelve_parameters_are_recovered_from_squared_poses(seed: u64, turn in 0_usize..6) {
        let truth = Random::new(seed).model(false);
        let mut poses = six(&truth);
        poses.rotate_left(turn);
        for estimate in [
            six_position(&unlabelled(&poses), None, exact(), squared()).expect("an answer"),
            labelled(&poses).expect("an answer"),
        ] {
            for (found, truth) in parameters(&estimate.model).iter().zip(parameters(&truth)) {
                prop_assert!((found - truth).abs() < 1e-9, "{found} {truth}");
            }
            // The poses do not show how visits of a side differ.
            prop_assert!(estimate.rms_mps2 < 1e-9 && (1e-3..3e-3).contains(&estimate.worst_sd_mps2));
            prop_assert_eq!((estimate.poses, estimate.dof), (6, 6));
            prop_assert_eq!(estimate.loo_rms_mps2, None);
        }
    }
}

#[test]
fn poses_of_one_side_are_averaged_by_their_samples() {
    let truth = Random::new(1).model(false);
    let mut poses = unlabelled(&six(&truth));
    let (mut light, mut heavy) = (poses[0], poses[0]);
    light.mean_mps2[1] += 0.03;
    light.samples = 100;
    heavy.mean_mps2[1] -= 0.01;
    heavy.samples = 300;
    poses[0] = light;
    poses.push(heavy);
    let estimate = six_position(&poses, None, exact(), squared()).expect("an answer");
    for (found, truth) in parameters(&estimate.model).iter().zip(parameters(&truth)) {
        assert!((found - truth).abs() < 1e-9);
    }
    assert_eq!((estimate.poses, estimate.dof), (7, 9));
}

#[test]
fn a_worse_placement_than_declared_is_seen() {
    let mut random = Random::new(4);
    let truth = random.model(false);
    let poses: Vec<Pose> = Face::ALL
        .into_iter()
        .map(|face| {
            let up = misplaced(&mut random, Orientation::from(face).up(), 3.0 * DEGREE);
            pose(&truth, G, up)
        })
        .collect();
    let estimate = six_position(&poses, None, exact(), squared()).expect("an answer");
    let placed = estimate.sides.expect("sides");
    assert!((1.5..5.0).contains(&(placed.placement_sd_rad / DEGREE)));
    assert!(estimate.sd().matrix[0][1] > 0.015);
}

#[test]
fn a_missing_side_is_named() {
    let truth = Random::new(5).model(false);
    for missing in 0..6 {
        let mut poses = unlabelled(&six(&truth));
        poses.remove(missing);
        let refused = six_position(&poses, None, exact(), squared());
        let refusal = refused.expect_err("a side is missing");
        assert_eq!(refusal.reason, Reason::TooFew { have: 5, need: 6 });
        assert!(refusal.text.contains(&format!("no pose has {}", Face::ALL[missing])), "{refusal}");
    }
    let refused = six_position(&[], None, exact(), squared());
    assert!(matches!(refused, Err(Refusal { reason: Reason::TooFew { have: 0, need: 6 }, .. })));
}

#[test]
fn a_tilted_pose_is_left_out_of_the_fit_and_not_of_its_residuals() {
    let truth = Random::new(6).model(false);
    let mut poses = unlabelled(&six(&truth));
    poses.push(pose(&truth, G, [0.6, 0.8, 0.0]));
    poses[6].mean_mps2[0] += 0.1;
    let estimate = six_position(&poses, None, exact(), squared()).expect("an answer");
    assert_eq!((estimate.poses, estimate.worst_pose), (6, 6));
    assert!((0.05..0.07).contains(&estimate.max_mps2));
}

#[test]
fn labels_that_do_not_go_with_the_sensor_are_told_apart() {
    let truth = Random::new(7).model(false);
    let good = six(&truth);
    let relabelled = |change: fn([f64; 3]) -> [f64; 3]| -> Result<_, Refusal> {
        let poses: Vec<(Face, Pose)> =
            good.iter().map(|&(face, p)| (face, Pose::from_mean(change(p.mean_mps2)))).collect();
        labelled(&poses)
    };
    assert!(relabelled(|y| y).is_ok());
    assert!(matches!(
        relabelled(|[x, y, z]| [-x, -y, -z]),
        Err(Refusal { reason: Reason::Axes, .. })
    ));
    assert!(matches!(
        relabelled(|[x, y, z]| [x, y, -z]),
        Err(Refusal { reason: Reason::Axes, .. })
    ));
    assert!(matches!(relabelled(|[x, y, z]| [y, x, z]), Err(Refusal { reason: Reason::Axes, .. })));
    let turned = relabelled(|[x, y, z]| [y, z, x]);
    assert!(matches!(turned, Err(Refusal { reason: Reason::Axes, .. })), "{turned:?}");

    let mut swapped = good.clone();
    swapped[0].0 = Face::YDown;
    let refused = labelled(&swapped);
    assert!(matches!(refused, Err(Refusal { reason: Reason::Axes, .. })));

    let mut tilted = good.clone();
    tilted[2].1 = pose(&truth, G, [0.0, 0.8, 0.6]);
    let refused = labelled(&tilted);
    assert!(matches!(refused, Err(Refusal { reason: Reason::Placement { .. }, .. })));
}

#[test]
fn sides_that_are_not_square_are_refused() {
    let truth = ErrorModel::default();
    let lean = (12.0 * DEGREE).tan();
    let poses: Vec<Pose> = Face::ALL
        .into_iter()
        .map(|face| {
            let mut up = Orientation::from(face).up();
            up[(face.axis() + 1) % 3] = lean;
            pose(&truth, G, common::unit(up))
        })
        .collect();
    let refused = six_position(&poses, None, exact(), squared());
    assert!(
        matches!(refused, Err(Refusal { reason: Reason::Placement { .. }, .. })),
        "{refused:?}"
    );
}
