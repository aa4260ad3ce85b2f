//! A stored calibration against later rests.

use crate::common;

use common::{DrawModel as _, G, NINE, Random, norm, parameters, pose, twelve};
use proptest::prelude::*;
use wimu_calib::{
    Ageing, Gravity, MultiPosition, Parameter, Pose, SelfCheck, Term, Terms, multi_position,
};
use wimu_model::{
    CentiCelsius, ErrorModel, ErrorTerms, ParameterSet, Sensitivity, SpecificForceMps2,
};
use wimu_testkit::{Coverage, coverage_figure, trials};

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
    let (mut covered, mut contradicted) = ([Coverage::default(); 9], Coverage::default());
    let mut fitted: Vec<Parameter> = Vec::new();
    for seed in 0..trials(2000) as u64 {
        let mut random = Random::new(seed);
        let truth = random.model(true);
        let first: Vec<Pose> = twelve()
            .into_iter()
            .chain((0..8).map(|_| random.direction()).collect::<Vec<_>>())
            .map(|up| noisy(&mut random, &truth, up, ageing.pose_mps2))
            .collect();
        let stored = multi_position(&first, gravity, NINE).expect("an answer");
        fitted = stored.fitted.iter().collect();
        let today = shifted(&mut random, &truth, ageing.turn_on_mps2);
        // Of a known pose error the covariance is the one that it makes.
        let known = {
            let squares: f64 = first.iter().map(|p| stored.residual_mps2(p).powi(2)).sum();
            let factor = ageing.pose_mps2.powi(2) * f64::from(stored.dof as u32) / squares;
            stored.covariance.matrix().map(|row| row.map(|value| value * factor))
        };
        let mut check = SelfCheck::new(&stored.model, &known, gravity, ageing);
        for _ in 0..12 {
            let up = random.direction();
            let rest = noisy(&mut random, &today, up, ageing.pose_mps2);
            contradicted.count(!check.push(&rest).expect("a pose").holds);
        }
        let updated = parameters(&check.model().expect("a model"));
        let sd = check.covariance();
        for (k, parameter) in fitted.iter().enumerate() {
            let i = parameter.index();
            let error = updated[i] - parameters(&today)[i];
            covered[k].count(error.abs() < 1.96 * sd.sd(*parameter));
        }
    }
    coverage_figure(
        "95 % intervals of a stored calibration updated in the next run",
        &covered,
        0.93..=0.97,
    );
    coverage_figure("good rests that the self-check contradicts", &[contradicted], 0.0..=0.002);
    for (parameter, covered) in fitted.iter().zip(covered) {
        covered.assert_can_be(0.93..=0.97, &parameter.to_string());
    }
    // One rest in a thousand by its threshold.
    contradicted.assert_can_be(0.0..=0.002, "contradicted by chance");
}

/// Detections of a bias jump of `jump_mps2` after the sixth of twelve rests, by turn-ons within the ageing:
/// at one rest, and at two consecutive ones as on a device.
fn detected(jump_mps2: f64) -> [Coverage; 2] {
    let ageing = Ageing::default();
    let gravity = Gravity::new(G, 0.0).expect("gravity");
    let mut counts = [Coverage::default(); 2];
    for seed in 0..trials(2000) as u64 {
        let mut random = Random::new(seed + 77_000);
        let stored = random.model(true);
        let mut known = [[0.0; 12]; 12];
        for (k, row) in known.iter_mut().enumerate() {
            // What is left of 20 poses of 3 mm/s²: 2 mm/s² and 200 ppm.
            row[k] = if k < 3 { 4e-6 } else { 4e-8 };
        }
        let mut today = shifted(&mut random, &stored, ageing.turn_on_mps2);
        let mut check = SelfCheck::new(&stored, &known, gravity, ageing);
        let (mut once, mut twice, mut row) = (false, false, 0);
        for rest in 0..12 {
            if rest == 6 {
                let along = random.direction();
                let mut terms: ErrorTerms = today.into();
                for (bias, along) in terms.bias_mps2.iter_mut().zip(along) {
                    *bias += jump_mps2 * along;
                }
                today = ErrorModel::new(terms).expect("within bounds");
            }
            let up = random.direction();
            let pose = noisy(&mut random, &today, up, ageing.pose_mps2);
            let holds = check.push(&pose).expect("a pose").holds;
            row = if holds { 0 } else { row + 1 };
            once |= row == 1;
            twice |= row == 2;
        }
        counts[0].count(once);
        counts[1].count(twice);
    }
    counts
}

#[test]
fn alarms_are_as_rare_and_jumps_of_the_bias_as_well_seen_as_stated() {
    for (jump, once, twice) in [
        // Twelve rests at one in a thousand each.
        (0.0, 0.0..=0.02, 0.0..=0.002),
        (0.01, 0.0..=1.0, 0.0..=1.0),
        (0.02, 0.6..=1.0, 0.0..=1.0),
        (0.03, 0.9..=1.0, 0.5..=1.0),
        (0.05, 0.98..=1.0, 0.85..=1.0),
        (0.1, 0.99..=1.0, 0.95..=1.0),
    ] {
        let kind = match jump {
            0.0 => "self-check: false alarms in 12 rests".into(),
            _ => format!("self-check: a bias jump of {:.0} mm/s² is seen", 1e3 * jump),
        };
        let found = detected(jump);
        coverage_figure(&format!("{kind}, at one"), &found[..1], once.clone());
        coverage_figure(&format!("{kind}, two in a row"), &found[1..], twice.clone());
        found[0].assert_can_be(once, &kind);
        found[1].assert_can_be(twice, &kind);
    }
}

#[test]
fn a_calibration_that_no_longer_holds_is_found_out_and_left_alone() {
    let gravity = Gravity::new(G, 0.0).expect("gravity");
    let mut random = Random::new(3);
    let truth = random.model(true);
    let poses: Vec<Pose> = twelve().into_iter().map(|up| pose(&truth, G, up)).collect();
    let stored = multi_position(&poses, gravity, MultiPosition::default()).expect("answer");
    let mut check =
        SelfCheck::new(&stored.model, stored.covariance.matrix(), gravity, Ageing::default());
    let mut terms: ErrorTerms = stored.model.into();
    terms.bias_mps2[2] += 0.2;
    let broken = ErrorModel::new(terms).expect("within bounds");
    let before = check.model();
    let outcome = check.push(&pose(&broken, G, [0.0, 0.0, 1.0])).expect("a pose");
    assert!(!outcome.holds && (outcome.residual_mps2 - 0.2).abs() < 0.02, "{outcome:?}");
    assert_eq!((check.poses(), check.contradictions()), (1, 1));
    assert_eq!(check.model(), before);
    // The same sensor as it was holds.
    assert!(check.push(&poses[0]).expect("a pose").holds);
}

#[test]
fn a_bias_whose_temperature_term_is_known_ages_by_what_that_term_may_be_off_only() {
    let gravity = Gravity::new(G, 0.0).expect("gravity");
    let mut random = Random::new(12);
    let mut terms: ErrorTerms = random.model(true).into();
    terms.temperature.reference_c = 25.0;
    terms.temperature.bias_mps2_per_k = [0.008, -0.006, 0.01];
    let truth = ErrorModel::new(terms).expect("within bounds");
    let mut hold = |up: [f64; 3], celsius: f64, extra: f64| {
        let force = SpecificForceMps2(up.map(|c| c * G));
        let temperature = CentiCelsius::from_celsius(celsius);
        let mut mean = truth.distort(force, Some(temperature)).0;
        for axis in &mut mean {
            *axis += 0.002 * random.normal() + extra;
        }
        Pose { temperature_c: Some(celsius), ..Pose::from_mean(mean) }
    };
    let ups: Vec<[f64; 3]> = twelve().into_iter().cycle().take(36).collect();
    let poses: Vec<Pose> = ups
        .iter()
        .enumerate()
        .map(|(k, up)| hold(*up, 15.0 + ((7 * k) % 36) as f64, 0.0))
        .collect();
    let what = MultiPosition {
        terms: Terms::NONE.with(Term::BiasTemperature),
        ..MultiPosition::default()
    };
    let estimate = multi_position(&poses, gravity, what).expect("an answer");
    let set = ParameterSet {
        model: estimate.model,
        quality: estimate.quality(None, &poses),
        ..ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16384.0).expect("sound"))
    };
    let no_turn_on = Ageing { turn_on_mps2: 0.0, ..Ageing::default() };
    // Over what was seen the rests are as well known as at the mean, and a jump is found out.
    let check = || SelfCheck::of(&set, gravity, no_turn_on).expect("a quality");
    for celsius in [16.0, 33.0, 49.0] {
        let said = check().push(&hold([0.0, 0.6, 0.8], celsius, 0.0)).expect("a pose");
        assert!(said.holds && said.expected_sd_mps2 < 0.006, "{celsius}: {said:?}");
        let jumped = check().push(&hold([0.0, 0.6, 0.8], celsius, 0.04)).expect("a pose");
        assert!(!jumped.holds, "{celsius}: {jumped:?}");
    }
    // 20 K beyond it the temperature effect is unknown, whatever the number of steps.
    let far = check().push(&hold([0.0, 0.6, 0.8], 70.0, 0.04)).expect("a pose");
    assert!(far.holds && far.expected_sd_mps2 > 0.05, "{far:?}");
    let flat = ErrorModel::default();
    let known = [[0.0; 12]; 12];
    let mut at_once = SelfCheck::new(&flat, &known, gravity, no_turn_on);
    let mut by_steps = at_once.clone();
    let upright =
        |celsius: f64| Pose { temperature_c: Some(celsius), ..Pose::from_mean([0.0, 0.0, G]) };
    at_once.push(&upright(20.0)).expect("a pose");
    at_once.push(&upright(40.0)).expect("a pose");
    for step in 0..=20 {
        by_steps.push(&upright(20.0 + f64::from(step))).expect("a pose");
    }
    // An axis that no rest tells of is as uncertain either way.
    let [one, other] = [&at_once, &by_steps].map(|c| c.covariance().sd(Parameter::BiasX));
    assert!((one - 0.1).abs() < 1e-9 && (other - one).abs() < 1e-9, "{one} {other}");
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
