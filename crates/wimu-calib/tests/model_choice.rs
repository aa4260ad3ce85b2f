//! What `best_model` says of its uncertainty, though it chose the model by the data: on simulated
//! sensors whose truth is known.

use crate::common;

use common::{G, Random, parameters, pose};
use wimu_calib::{Gravity, Pose, Terms, best_model};
use wimu_model::{ErrorModel, ErrorTerms};
use wimu_testkit::{Coverage, coverage_figure, draws};

/// Sensors of a kind, and how they are held.
#[derive(Clone, Copy)]
struct Kind {
    poses: usize,
    /// Standard deviations: of a pose, m/s², of a misalignment, and of the drift of an axis over the
    /// session, m/s².
    noise: f64,
    misalignment: f64,
    drift: f64,
    /// Whether there is a thermometer.
    warms: bool,
}

const KIND: Kind = Kind { poses: 12, noise: 0.005, misalignment: 0.01, drift: 0.0, warms: false };

#[derive(Clone, Copy, Default)]
struct Found {
    /// Of the intervals of bias, scale factor and misalignment.
    held: [Coverage; 3],
    /// Of how many a bias is off by more than twice the half width.
    far: Coverage,
    /// How often with a term.
    terms: usize,
}

impl std::fmt::Display for Found {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [bias, scale, misalignment] = self.held;
        write!(
            out,
            "{bias}, {scale}, {misalignment}; beyond twice the half width {}, {} with terms",
            self.far, self.terms
        )
    }
}

fn run(kind: Kind, sensors: usize) -> Found {
    let gravity = Gravity::new(G, 0.0).expect("gravity");
    let mut found = Found::default();
    for seed in 0..sensors as u64 {
        let mut random = Random::new(seed * 1000 + kind.poses as u64);
        let mut terms = ErrorTerms::default();
        let mut drift = [0.0; 3];
        for row in 0..3 {
            terms.bias_mps2[row] = 0.3 * random.normal();
            drift[row] = kind.drift * random.normal();
            terms.matrix[row][row] += 0.02 * random.normal();
            for column in 0..row {
                terms.matrix[row][column] = kind.misalignment * random.normal();
            }
        }
        let truth = ErrorModel::new(terms).expect("within bounds");
        let last = (kind.poses - 1) as f64;
        let mut celsius = 25.0;
        let poses: Vec<Pose> = (0..kind.poses)
            .map(|k| {
                let mut pose = pose(&truth, G, random.direction());
                let progress = k as f64 / last - 1.0;
                for axis in 0..3 {
                    pose.mean_mps2[axis] += drift[axis] * progress + kind.noise * random.normal();
                }
                celsius += 0.3 * random.normal();
                Pose {
                    time_s: 5.0 * k as f64,
                    temperature_c: kind.warms.then_some(celsius),
                    ..pose
                }
            })
            .collect();
        let Ok(estimate) = best_model(&poses, gravity, Terms::NONE, true) else {
            continue;
        };
        found.terms += usize::from(estimate.terms != Terms::NONE);
        let (got, truth) = (parameters(&estimate.model), parameters(&truth));
        let mut far = false;
        for parameter in estimate.fitted.iter() {
            let i = parameter.index();
            let error = (got[i] - truth[i]).abs();
            let half = estimate.half_width_95(parameter);
            assert!(half > 0.0);
            let group = match i {
                0..3 => 0,
                3 | 7 | 11 => 1,
                _ => 2,
            };
            found.held[group].count(error <= half);
            far |= group == 0 && error > 2.0 * half;
        }
        found.far.count(far);
    }
    found
}

#[test]
fn intervals_of_the_chosen_model_hold_the_truth_though_the_data_chose_it() {
    let still = KIND;
    let drifting = Kind { drift: 0.02, ..KIND };
    // As many with as without drift; the bias is that at the end.
    let (mut each, mut both) = (Vec::new(), Vec::new());
    for poses in [12, 15, 20, 30] {
        let mut all = [Coverage::default(); 3];
        println!("{poses} poses, held by bias, scale factor, misalignment:");
        for (name, kind) in [("no drift", still), ("drift of 20 mm/s²", drifting)] {
            let found = run(Kind { poses, ..kind }, draws(1000, 3));
            println!("  {name}: {found}");
            for (all, held) in all.iter_mut().zip(found.held) {
                *all += held;
            }
            each.extend(found.held);
        }
        let [bias, scale, misalignment] = all;
        println!("  both: {bias}, {scale}, {misalignment}");
        both.extend(all);
    }
    coverage_figure(
        "`auto`: 95 % intervals hold the truth, half the sensors drift",
        &both,
        0.93..=0.97,
    );
    coverage_figure("`auto`: the same, those that drift and the others apart", &each, 0.93..=0.97);
    for held in both {
        held.assert_can_be(0.93..=0.975, "both");
    }
    // Where the data cannot tell the one from the other, one is a little wide and the other a little narrow.
    for held in each {
        held.assert_can_be(0.91..=0.995, "each kind");
    }
}

#[test]
fn intervals_of_the_chosen_model_hold_the_truth_with_few_poses_and_other_sensors() {
    let (mut held, mut far) = (Vec::new(), Vec::new());
    for (name, kind) in [
        ("noise beyond misalignment", Kind { misalignment: 0.003, noise: 0.02, ..KIND }),
        ("no misalignment", Kind { misalignment: 0.0, ..KIND }),
        ("a thermometer", Kind { warms: true, ..KIND }),
    ] {
        for poses in [8, 10, 24] {
            let found = run(Kind { poses, ..kind }, draws(400, 3));
            println!("{name}, {poses} poses: {found}");
            held.extend([found.held[0], found.held[1]]);
            far.push(found.far);
        }
    }
    let claim = "`auto`, other sensors: 95 % intervals of bias and scale factor";
    coverage_figure(claim, &held, 0.93..=0.97);
    let claim = "`auto`, other sensors: a bias beyond twice its interval";
    coverage_figure(claim, &far, 0.0..=0.05);
    for held in held {
        held.assert_can_be(0.9..=1.0, "bias or scale factor");
    }
    for far in far {
        far.assert_can_be(0.0..=0.05, "beyond twice the half width");
    }
}

#[test]
fn what_the_chosen_model_leaves_out_is_as_uncertain_as_larger_models_or_datasheets_have_it() {
    let gravity = Gravity::new(G, 0.0).expect("gravity");
    let (mut few, mut chosen) = (0, 0);
    let sensors = draws(200, 5);
    for seed in 0..sensors as u64 {
        let mut random = Random::new(seed);
        let mut terms = ErrorTerms { bias_mps2: [0.1, -0.2, 0.3], ..ErrorTerms::default() };
        terms.matrix[1][1] = 1.01;
        let truth = ErrorModel::new(terms).expect("within bounds");
        let count = if seed % 2 == 0 { 5 } else { 20 };
        let poses: Vec<Pose> = (0..count)
            .map(|_| {
                let mut pose = pose(&truth, G, random.direction());
                pose.mean_mps2 = pose.mean_mps2.map(|y| y + 0.01 * random.normal());
                pose
            })
            .collect();
        let Ok(estimate) = best_model(&poses, gravity, Terms::NONE, true) else {
            continue;
        };
        for parameter in estimate.not_observed().iter() {
            let sd = estimate.covariance.sd(parameter);
            if count == 5 {
                assert!(sd > 0.019, "{parameter}: {sd}");
                few += 1;
            } else {
                assert!((1e-4..0.01).contains(&sd), "{parameter}: {sd}");
                chosen += 1;
            }
        }
    }
    println!("left out: {few} of few poses, {chosen} of many");
    assert!(3 * few > sensors && 3 * chosen > sensors);
}
