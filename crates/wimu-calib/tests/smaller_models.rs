//! What models that leave parameters out say of sensors that have them, held where the poses show it
//! and where they do not.

use crate::common;

use common::{G, Random, norm, parameters, pose, unit};

use wimu_calib::{
    Estimate, Gravity, Model, MultiPosition, Parameter, Pose, Refusal, Terms, best_model,
    multi_position_with,
};
use wimu_model::{ErrorModel, ErrorTerms, SpecificForceMps2};
use wimu_testkit::{Coverage, coverage_figure, draws};

/// Where poses are held: a name, how many, and any of them.
type Held = (&'static str, usize, fn(&mut Random) -> [f64; 3]);

fn cap(random: &mut Random, least_up: f64) -> [f64; 3] {
    loop {
        let up = random.direction();
        if up[2] >= least_up {
            return up;
        }
    }
}

const HELD: [Held; 6] = [
    ("all in one plane to 0.6°", 18, |random| {
        let up = random.direction();
        unit([up[0], up[1], 0.01 * random.normal()])
    }),
    ("within 30° of Z up", 18, |random| cap(random, 0.866)),
    ("within 60° of Z up", 18, |random| cap(random, 0.5)),
    ("Z up", 24, |random| cap(random, 0.0)),
    ("anywhere", 12, Random::direction),
    ("anywhere", 30, Random::direction),
];

/// Standard deviations of scale factors and of misalignments.
const SENSORS_OF: [(f64, f64); 2] = [(0.02, 0.01), (0.005, 0.003)];

#[derive(Default)]
struct Found {
    answered: Coverage,
    /// Intervals of the bias and of the scale factor.
    held: [Coverage; 2],
    /// |f| − g in unseen orientations and what was said of the worst, squared, m/s².
    unseen: f64,
    said: f64,
}

fn run(
    (_, count, held): Held,
    (scale, misalignment): (f64, f64),
    fit: impl Fn(&[Pose], Gravity) -> Result<Estimate, Refusal>,
) -> Found {
    let gravity = Gravity::new(G, 0.0).expect("gravity");
    let mut found = Found::default();
    for seed in 0..draws(400, 3) as u64 {
        let mut random = Random::new(seed);
        let mut terms = ErrorTerms::default();
        for row in 0..3 {
            terms.bias_mps2[row] = 0.3 * random.normal();
            terms.matrix[row][row] += scale * random.normal();
            for column in 0..row {
                terms.matrix[row][column] = misalignment * random.normal();
            }
        }
        let truth = ErrorModel::new(terms).expect("within bounds");
        let poses: Vec<Pose> = (0..count)
            .map(|_| {
                let mut pose = pose(&truth, G, held(&mut random));
                pose.mean_mps2 = pose.mean_mps2.map(|y| y + 0.001 * random.normal());
                pose
            })
            .collect();
        let answer = fit(&poses, gravity);
        found.answered.count(answer.is_ok());
        let Ok(estimate) = answer else {
            continue;
        };
        let (got, truth_of) = (parameters(&estimate.model), parameters(&truth));
        for parameter in estimate.fitted.iter() {
            let i = parameter.index();
            let group = match i {
                0..3 => 0,
                3 | 7 | 11 => 1,
                _ => continue,
            };
            let holds = (got[i] - truth_of[i]).abs() <= estimate.half_width_95(parameter);
            found.held[group].count(holds);
        }
        for _ in 0..10 {
            let up = random.direction();
            let output = truth.distort(SpecificForceMps2(up.map(|c| c * G)), None);
            let off = norm(estimate.model.correct(output, None).0) - G;
            found.unseen += off * off / 10.0;
        }
        found.said += estimate.worst_sd_mps2 * estimate.worst_sd_mps2;
    }
    found
}

#[test]
fn what_a_smaller_model_leaves_out_is_in_what_it_says_of_the_rest() {
    let (mut bias, mut scale, mut in_a_plane) = (Vec::new(), Vec::new(), Vec::new());
    for sensor in SENSORS_OF {
        println!(
            "scale factors {} %, misalignments {} mrad (1 σ):",
            100.0 * sensor.0,
            1000.0 * sensor.1
        );
        for held in HELD {
            for model in [Some(Model::Bias3), Some(Model::BiasScale6), None] {
                let found = run(held, sensor, |poses, gravity| match model {
                    Some(model) => {
                        let what = MultiPosition { model, ..MultiPosition::default() };
                        multi_position_with(poses, gravity, what)
                    }
                    None => best_model(poses, gravity, Terms::NONE, true),
                });
                let each = found.answered.fraction() * found.answered.total() as f64;
                let [unseen, said] =
                    [found.unseen, found.said].map(|sum| 1e3 * (sum / each).sqrt());
                let name = model.map_or("auto".to_owned(), |model| model.to_string());
                println!(
                    "  {} {}, {name}: answered {}; bias {}, scale factor {}; \
                     unseen orientations {unseen:.0} mm/s² rms, said of the worst {said:.0}",
                    held.1, held.0, found.answered, found.held[0], found.held[1]
                );
                if held.0 == HELD[0].0 {
                    in_a_plane.push(found.answered);
                }
                if found.answered.fraction() < 0.2 {
                    continue;
                }
                for (group, all) in found.held.into_iter().zip([&mut bias, &mut scale]) {
                    if group.total() > 0 {
                        group.assert_can_be(0.93..=1.0, &name);
                        all.push(group);
                    }
                }
                // The rms of fewer than eight sensors is not that of their law.
                assert!(each < 8.0 || unseen <= said, "{name}");
            }
        }
    }
    coverage_figure("smaller models, `auto`: 95 % intervals of bias", &bias, 0.93..=1.0);
    coverage_figure("the same of scale factors", &scale, 0.93..=1.0);
    coverage_figure("poses in a plane are answered", &in_a_plane, 0.0..=0.05);
}

#[test]
fn a_pose_that_alone_shows_what_a_small_model_leaves_out_is_not_taken_for_a_bad_one() {
    let gravity = Gravity::new(G, 0.0).expect("gravity");
    type Fit = fn(&[Pose], Gravity) -> Result<Estimate, Refusal>;
    let three: Fit = |poses, gravity| {
        let what = MultiPosition { model: Model::Bias3, reject: true, ..MultiPosition::default() };
        multi_position_with(poses, gravity, what)
    };
    let six: Fit = |poses, gravity| {
        let what =
            MultiPosition { model: Model::BiasScale6, reject: true, ..MultiPosition::default() };
        multi_position_with(poses, gravity, what)
    };
    let auto: Fit = |poses, gravity| best_model(poses, gravity, Terms::NONE, true);
    // The sides as people hold them: Z down comes once, or all twice; and anywhere.
    let once: &[usize] = &[0, 1, 2, 3, 4, 5, 0, 1, 2, 4];
    let often: &[usize] = &[0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 5];
    let twice: &[usize] = &[0, 1, 2, 3, 4, 5, 0, 1, 2, 3, 4, 5];
    let (mut all_held, mut all_far) = (Vec::new(), Vec::new());
    for (name, sides, fit) in [
        ("ten of six sides, auto", once, auto),
        ("ten of six sides, 3", once, three),
        ("one side once, the others three times, 3", often, three),
        ("six sides twice, auto", twice, auto),
        ("anywhere, 6", &[6; 12], six),
    ] {
        let [mut answered, mut held, mut far] = [Coverage::default(); 3];
        let mut rejected = 0;
        for seed in 0..draws(600, 3) as u64 {
            let mut random = Random::new(seed);
            let mut terms = ErrorTerms::default();
            for row in 0..3 {
                terms.bias_mps2[row] = 0.3 * random.normal();
                terms.matrix[row][row] += 0.02 * random.normal();
                for column in 0..row {
                    terms.matrix[row][column] = 0.01 * random.normal();
                }
            }
            let truth = ErrorModel::new(terms).expect("within bounds");
            let poses: Vec<Pose> = sides
                .iter()
                .map(|&side| {
                    let mut up = random.direction();
                    if side < 6 {
                        let tilt = [0, 1, 2].map(|_| 0.017 * random.normal());
                        up = tilt;
                        up[side / 2] += if side % 2 == 0 { 1.0 } else { -1.0 };
                    }
                    let mut one = pose(&truth, G, unit(up));
                    for y in &mut one.mean_mps2 {
                        *y += 0.001 * random.normal();
                    }
                    one
                })
                .collect();
            let answer = fit(&poses, gravity);
            answered.count(answer.is_ok());
            let Ok(estimate) = answer else {
                continue;
            };
            rejected += estimate.rejected.len();
            for i in 0..3 {
                let parameter = Parameter::ALL[i];
                let off = (parameters(&estimate.model)[i] - parameters(&truth)[i]).abs();
                let half = estimate.half_width_95(parameter);
                held.count(off <= half);
                far.count(off > 2.0 * half);
            }
        }
        println!(
            "{name}: answered {answered}, {rejected} good poses left out, bias held {held}, \
             beyond twice the half width {far}"
        );
        assert_eq!(rejected, 0, "{name}");
        held.assert_can_be(0.93..=1.0, name);
        far.assert_can_be(0.0..=0.01, name);
        all_held.push(held);
        all_far.push(far);
    }
    coverage_figure(
        "a pose alone shows what a model leaves out: bias intervals hold",
        &all_held,
        0.93..=1.0,
    );
    coverage_figure("the same: a bias beyond twice its interval", &all_far, 0.0..=0.01);
}
