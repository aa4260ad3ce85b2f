//! Terms, choice of the model, bad poses, weights, axes that are stuck or clipped, on simulated sensors.

use crate::common;

use common::{AUTO, DrawModel as _, G, NINE, ROBUST, Random, exact, jitter, parameters, pose, ups};
use proptest::prelude::*;
use wimu_calib::{
    MultiPosition, Placement, Pose, Reason, Refusal, Term, Terms, four_angle, multi_position,
    six_position, three_angle,
};
use wimu_model::{CentiCelsius, ErrorModel, ErrorTerms, SpecificForceMps2};
use wimu_testkit::{Coverage, coverage_figure, trials};

fn with(terms: Terms) -> MultiPosition {
    MultiPosition { terms, ..MultiPosition::default() }
}

proptest! {
    #![proptest_config(common::config())]

    #[test]
    fn every_term_is_recovered_from_noiseless_poses(seed: u64) {
        let mut random = Random::new(seed);
        let mut terms: ErrorTerms = random.model(true).into();
        terms.temperature.reference_c = 30.0;
        for axis in 0..3 {
            terms.temperature.bias_mps2_per_k[axis] = random.within(0.01);
            terms.temperature.scale_per_k[axis] = random.within(3e-4);
            // The device's correction is exact to first order in q only.
            terms.nonlinearity[axis] = random.within(1e-6);
        }
        let drift = [0, 1, 2].map(|_| random.within(0.1));
        let truth = ErrorModel::new(terms).expect("within bounds");
        let poses: Vec<Pose> = ups(&mut random, 48)
            .into_iter()
            .enumerate()
            .map(|(k, up)| {
                let progress = k as f64 / 59.0 - 1.0;
                let celsius = CentiCelsius(2000 + (k as i16 * 73) % 2000);
                let force = SpecificForceMps2(up.map(|c| c * G));
                let mut mean = truth.distort(force, Some(celsius)).0;
                for axis in 0..3 {
                    mean[axis] += drift[axis] * progress;
                }
                Pose {
                    time_s: 100.0 * progress,
                    temperature_c: Some(celsius.to_celsius()),
                    ..Pose::from_mean(mean)
                }
            })
            .collect();
        let all: Terms = Term::ALL.into_iter().collect();
        let estimate = multi_position(&poses, exact(), with(all)).expect("an answer");
        prop_assert!(estimate.rms_mps2 < 1e-7, "{}", estimate.rms_mps2);
        let found = estimate.model.terms();
        let warmer = found.temperature.reference_c - 30.0;
        let change = estimate.drift.expect("it was fitted").change_mps2;
        for axis in 0..3 {
            let slope = terms.temperature.bias_mps2_per_k[axis];
            prop_assert!((change[axis] - drift[axis]).abs() < 1e-5);
            prop_assert!((found.temperature.bias_mps2_per_k[axis] - slope).abs() < 1e-6);
            let bias = terms.bias_mps2[axis] + slope * warmer;
            prop_assert!((found.bias_mps2[axis] - bias).abs() < 1e-5);
            prop_assert!((found.nonlinearity[axis] - terms.nonlinearity[axis]).abs() < 1e-7);
        }
        for pose in &poses {
            prop_assert!(estimate.residual_mps2(pose).abs() < 1e-4);
        }
    }

    #[test]
    fn any_garbage_is_refused_or_answered_with_every_term(
        values in proptest::collection::vec(
            ((-12.0..12.0_f64, -12.0..12.0_f64, -12.0..12.0_f64), any::<f64>(), any::<f64>()),
            0..30,
        ),
        wild: bool,
        terms in 0_usize..16,
    ) {
        let poses: Vec<Pose> = values
            .into_iter()
            .map(|((x, y, z), time, celsius)| Pose {
                time_s: if wild { time } else { x },
                temperature_c: (wild || y > -11.0).then_some(if wild { celsius } else { y }),
                ..Pose::from_mean([x, y, z])
            })
            .collect();
        let terms: Terms = Term::ALL
            .into_iter()
            .enumerate()
            .filter(|(k, _)| terms >> k & 1 == 1)
            .map(|(_, term)| term)
            .collect();
        for what in [NINE, ROBUST, AUTO] {
            match multi_position(&poses, exact(), MultiPosition { terms, ..what }) {
                Ok(estimate) => {
                    let known = estimate.covariance.matrix();
                    prop_assert!(known.iter().flatten().all(|c| c.is_finite()));
                    prop_assert!(estimate.rms_mps2.is_finite());
                }
                Err(refusal) => prop_assert!(!refusal.to_string().is_empty()),
            }
        }
        let six: fn(&[Pose], wimu_calib::Gravity, Placement) -> _ = |p, g, sd| six_position(p, None, g, sd);
        for method in [four_angle, three_angle, six] {
            match method(&poses, exact(), Placement::BY_HAND) {
                Ok(estimate) => prop_assert!(estimate.rms_mps2.is_finite()),
                Err(refusal) => prop_assert!(!refusal.to_string().is_empty()),
            }
        }
    }
}

#[test]
fn bad_poses_are_named_and_left_out_and_good_ones_are_not() {
    let [mut found, mut wrongly, mut answered, mut good] = [Coverage::default(); 4];
    for seed in 0..trials(1000) as u64 {
        let mut random = Random::new(seed);
        let truth = random.model(true);
        let mut poses: Vec<Pose> =
            ups(&mut random, 18).into_iter().map(|up| pose(&truth, G, up)).collect();
        for pose in &mut poses {
            jitter(&mut random, pose, 0.003);
        }
        // 0 to 3 of them moved, saturated or knocked.
        let bad: Vec<usize> = (0..seed as usize % 4).map(|k| 3 + 9 * k).collect();
        for &k in &bad {
            let longer = 1.0 + 0.02 * (1.0 + random.uniform());
            poses[k].mean_mps2 = poses[k].mean_mps2.map(|y| y * longer);
        }
        let answer = multi_position(&poses, exact(), ROBUST);
        answered.count(answer.is_ok());
        let Ok(estimate) = answer else {
            continue;
        };
        for k in 0..poses.len() {
            let counted = if bad.contains(&k) { &mut found } else { &mut wrongly };
            counted.count(estimate.rejected.contains(&k));
        }
        if !bad.is_empty() {
            // All residuals are reported, that of the bad ones too; the answer is a good one.
            let worst = estimate.max_mps2 > 0.15 && bad.contains(&estimate.worst_pose);
            let unseen = pose(&truth, G, random.direction());
            good.count(worst && estimate.residual_mps2(&unseen).abs() < 0.02);
        }
        assert_eq!(estimate.poses, poses.len() - estimate.rejected.len());
    }
    coverage_figure("bad poses, 0 to 3 of 30, are left out", &[found], 0.995..=1.0);
    coverage_figure("good poses of 30 are left out", &[wrongly], 0.0..=0.001);
    coverage_figure("sessions with 0 to 3 bad of 30 poses are answered", &[answered], 0.99..=1.0);
    answered.assert_can_be(0.99..=1.0, "answered");
    let claim = "bad poses left out: unseen orientation within 20 mm/s², worst pose named";
    coverage_figure(claim, &[good], 0.99..=1.0);
    good.assert_can_be(0.99..=1.0, claim);
    found.assert_can_be(0.995..=1.0, "bad poses");
    wrongly.assert_can_be(0.0..=0.001, "good poses");
}

#[test]
fn no_bad_poses_however_many_or_alike_cost_more_than_the_data_can_spare() {
    let [mut answered, mut consistent] = [Coverage::default(); 2];
    for seed in 0..trials(1200) as u64 {
        let mut random = Random::new(seed);
        let truth = random.model(true);
        let count = 12 + (seed as usize * 7) % 30;
        let mut poses: Vec<Pose> =
            ups(&mut random, count - 12).into_iter().map(|up| pose(&truth, G, up)).collect();
        for pose in &mut poses {
            jitter(&mut random, pose, 0.003);
        }
        // From one to half of them: alike, each otherwise, grossly, or mirrored.
        let bad = 1 + (seed as usize / 4) % (count / 2);
        for k in 0..bad {
            let pose = &mut poses[(k * 5 + 2) % count];
            pose.mean_mps2 = match seed % 4 {
                0 => pose.mean_mps2.map(|y| 1.05 * y),
                1 => pose.mean_mps2.map(|y| y + random.normal()),
                2 => pose.mean_mps2.map(|y| y * (20.0 * random.uniform())),
                _ => {
                    let [x, y, z] = pose.mean_mps2;
                    [x, y, -z]
                }
            };
        }
        for what in [ROBUST, AUTO] {
            let answer = multi_position(&poses, exact(), what);
            if what == ROBUST {
                answered.count(answer.is_ok());
            }
            let Ok(estimate) = answer else {
                continue;
            };
            let rejected = &estimate.rejected;
            let spare = (count / 5).min(count - 3).min(16);
            assert!(rejected.len() <= spare, "{seed}: {rejected:?} of {count}");
            assert_eq!(estimate.poses + rejected.len(), count);
            assert!(estimate.worst_sd_mps2.is_finite() && estimate.condition().is_finite());
            let mut once = rejected.to_vec();
            once.sort_unstable();
            once.dedup();
            assert_eq!(once.len(), rejected.len());
            if what == ROBUST {
                // Truth within five standard deviations of unseen orientations, or within figures that
                // say so.
                let error = (0..20)
                    .map(|_| estimate.residual_mps2(&pose(&truth, G, random.direction())).abs())
                    .fold(0.0, f64::max);
                let said = (5.0 * estimate.worst_sd_mps2).max(estimate.rms_mps2);
                consistent.count(error <= said);
            }
        }
    }
    coverage_figure(
        "sessions with up to half of the poses bad are answered",
        &[answered],
        0.3..=1.0,
    );
    coverage_figure(
        "many bad poses: errors of the answers are within what they state",
        &[consistent],
        0.97..=1.0,
    );
    answered.assert_can_be(0.3..=1.0, "answered");
    consistent.assert_can_be(0.97..=1.0, "within what is stated");
}

#[test]
fn noisy_and_short_poses_count_less() {
    let (mut weighted, mut plain) = (0.0, 0.0);
    for seed in 0..trials(1000) as u64 {
        let mut random = Random::new(seed);
        let truth = random.model(true);
        let poses: Vec<Pose> = ups(&mut random, 12)
            .into_iter()
            .enumerate()
            .map(|(k, up)| {
                let (sd, samples) = if k % 3 == 0 { (0.5, 100) } else { (0.05, 400) };
                let mut pose = pose(&truth, G, up);
                jitter(&mut random, &mut pose, sd / f64::from(samples).sqrt());
                pose.sd_mps2 = [sd; 3];
                pose.samples = samples;
                pose
            })
            .collect();
        let equal: Vec<Pose> = poses.iter().map(|pose| Pose::from_mean(pose.mean_mps2)).collect();
        let error = |poses: &[Pose]| {
            let estimate = multi_position(poses, exact(), NINE).expect("an answer");
            let found = parameters(&estimate.model);
            (0..3).map(|i| (found[i] - parameters(&truth)[i]).powi(2)).sum::<f64>()
        };
        weighted += error(&poses);
        plain += error(&equal);
    }
    println!("bias error, weighted / not: {:.2}", (weighted / plain).sqrt());
    assert!(weighted < 0.2 * plain);
}

#[test]
fn terms_that_nothing_shows_are_refused() {
    let mut random = Random::new(9);
    let truth = random.model(true);
    let poses: Vec<Pose> = ups(&mut random, 10).into_iter().map(|up| pose(&truth, G, up)).collect();
    for term in [Term::Drift, Term::BiasTemperature, Term::ScaleTemperature] {
        let refused = multi_position(&poses, exact(), with(Terms::NONE.with(term)));
        assert!(matches!(refused, Err(Refusal { reason: Reason::NotObservable, .. })));
    }
}
