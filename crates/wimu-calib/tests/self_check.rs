//! A stored calibration against later rests.

mod common;

use common::{Random, norm, parameters, pose, twelve};
use proptest::prelude::*;
use wimu_calib::{
    Ageing, Gravity, Model, MultiPosition, Parameter, Pose, SelfCheck, multi_position,
    multi_position_with,
};
use wimu_model::{ErrorModel, ErrorTerms};

const G: f64 = 9.80665;

fn noisy(random: &mut Random, model: &ErrorModel, up: [f64; 3], sd: f64) -> Pose {
    let mut pose = pose(model, G, up);
    // Along the force: what a pose error is.
    let error = random.normal() * sd / norm(pose.mean_mps2);
    for y in &mut pose.mean_mps2 {
        *y += *y * error;
    }
    pose
}

fn shifted(random: &mut Random, model: &ErrorModel, sd: f64) -> ErrorModel {
    let mut terms: ErrorTerms = (*model).into();
    for bias in &mut terms.bias_mps2 {
        *bias += random.normal() * sd;
    }
    ErrorModel::new(terms).expect("within bounds")
}

#[test]
fn intervals_of_an_updated_calibration_cover_the_truth_of_the_next_run() {
    let ageing = Ageing::default();
    let gravity = Gravity::new(G, 0.0).expect("gravity");
    let (mut covered, mut held, mut poses) = ([0_u32; 9], 0, 0);
    let fitted: Vec<Parameter> = Model::Full9.fitted().iter().collect();
    const RUNS: u32 = 1000;
    for seed in 0..RUNS {
        let mut random = Random(u64::from(seed));
        let truth = random.model(true);
        let first: Vec<Pose> = twelve()
            .into_iter()
            .chain((0..8).map(|_| random.direction()).collect::<Vec<_>>())
            .map(|up| noisy(&mut random, &truth, up, ageing.pose_mps2))
            .collect();
        let stored = multi_position(&first, gravity, Model::Full9).expect("an answer");
        let today = shifted(&mut random, &truth, ageing.turn_on_mps2);
        // Of a known pose error the covariance is the one that it makes.
        let known = {
            let squares: f64 = first.iter().map(|p| stored.residual_mps2(p).powi(2)).sum();
            let factor = ageing.pose_mps2.powi(2) * f64::from(stored.dof as u32) / squares;
            stored
                .covariance
                .matrix()
                .map(|row| row.map(|value| value * factor))
        };
        let mut check = SelfCheck::new(&stored.model, &known, gravity, ageing);
        for _ in 0..12 {
            let up = random.direction();
            let rest = noisy(&mut random, &today, up, ageing.pose_mps2);
            held += u32::from(check.push(&rest).expect("a pose").holds);
            poses += 1;
        }
        let updated = parameters(&check.model().expect("a model"));
        let sd = check.covariance();
        for (k, parameter) in fitted.iter().enumerate() {
            let i = parameter.index();
            let error = updated[i] - parameters(&today)[i];
            covered[k] += u32::from(error.abs() < 1.96 * sd.sd(*parameter));
        }
    }
    let all = f64::from(covered.iter().sum::<u32>()) / f64::from(9 * RUNS);
    println!("recursive: 95 % intervals cover {:.1} %", 100.0 * all);
    println!("contradicted by chance: {} of {poses}", poses - held);
    for (parameter, covered) in fitted.iter().zip(covered) {
        let share = f64::from(covered) / f64::from(RUNS);
        assert!((0.93..=0.97).contains(&share), "{parameter} {share}");
    }
    assert!(poses - held < poses / 250);
}

#[test]
fn a_calibration_that_no_longer_holds_is_found_out_and_left_alone() {
    let gravity = Gravity::new(G, 0.0).expect("gravity");
    let mut random = Random(3);
    let truth = random.model(true);
    let poses: Vec<Pose> = twelve().into_iter().map(|up| pose(&truth, G, up)).collect();
    let stored = multi_position_with(&poses, gravity, MultiPosition::default()).expect("answer");
    let mut check = SelfCheck::new(
        &stored.model,
        stored.covariance.matrix(),
        gravity,
        Ageing::default(),
    );
    let mut terms: ErrorTerms = stored.model.into();
    terms.bias_mps2[2] += 0.2;
    let broken = ErrorModel::new(terms).expect("within bounds");
    let before = check.model();
    let outcome = check
        .push(&pose(&broken, G, [0.0, 0.0, 1.0]))
        .expect("a pose");
    assert!(
        !outcome.holds && (outcome.residual_mps2 - 0.2).abs() < 0.02,
        "{outcome:?}"
    );
    assert_eq!((check.poses(), check.contradictions()), (1, 1));
    assert_eq!(check.model(), before);
    // The same sensor as it was holds.
    assert!(check.push(&poses[0]).expect("a pose").holds);
}

#[test]
fn warmth_makes_room_for_a_bias_that_moved() {
    let gravity = Gravity::new(G, 0.0).expect("gravity");
    let perfect = ErrorModel::default();
    let known = [[0.0; 12]; 12];
    let rest = |celsius: f64, extra: f64| Pose {
        temperature_c: Some(celsius),
        ..Pose::from_mean([0.0, 0.0, G + extra])
    };
    for (celsius, holds) in [(25.0, false), (50.0, true)] {
        let mut check = SelfCheck::new(&perfect, &known, gravity, Ageing::default());
        assert!(check.push(&rest(25.0, 0.0)).expect("a pose").holds);
        assert_eq!(
            check.push(&rest(celsius, 0.1)).expect("a pose").holds,
            holds
        );
    }
}

proptest! {
    #![proptest_config(common::config())]

    #[test]
    fn no_pose_makes_it_panic(
        values in proptest::collection::vec((any::<f64>(), -20.0..20.0_f64, -20.0..20.0_f64), 0..10),
        celsius: f64,
    ) {
        let known = [[1e-6; 12]; 12];
        let mut check = SelfCheck::new(
            &ErrorModel::default(),
            &known,
            Gravity::UNKNOWN_PLACE,
            Ageing::default(),
        );
        for (x, y, z) in values {
            let pose = Pose { temperature_c: Some(celsius), ..Pose::from_mean([x, y, z]) };
            if let Some(outcome) = check.push(&pose) {
                prop_assert!(outcome.residual_mps2.is_finite());
            }
        }
    }
}
