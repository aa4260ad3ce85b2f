//! What models that leave parameters out say of sensors that have them, held where the poses show it
//! and where they do not.

mod common;

use common::{Random, norm, parameters, pose, unit};
use wimu_calib::multi_position_with;
use wimu_calib::{Estimate, Gravity, Model, MultiPosition, Pose, Refusal, Terms, best_model};
use wimu_model::{ErrorModel, ErrorTerms, SpecificForceMps2};

const G: f64 = 9.80665;
const SENSORS: u64 = 100;

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

struct Found {
    answered: usize,
    /// Intervals of the bias and of the scale factor that hold, and all.
    held: [[f64; 2]; 2],
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
    let mut found = Found {
        answered: 0,
        held: [[0.0; 2]; 2],
        unseen: 0.0,
        said: 0.0,
    };
    for seed in 0..SENSORS {
        let mut random = Random(seed);
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
        let Ok(estimate) = fit(&poses, gravity) else {
            continue;
        };
        found.answered += 1;
        let (got, truth_of) = (parameters(&estimate.model), parameters(&truth));
        for parameter in estimate.fitted.iter() {
            let i = parameter.index();
            let group = match i {
                0..3 => 0,
                3 | 7 | 11 => 1,
                _ => continue,
            };
            let holds = (got[i] - truth_of[i]).abs() <= estimate.half_width_95(parameter);
            found.held[group][0] += f64::from(holds);
            found.held[group][1] += 1.0;
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
                        let what = MultiPosition {
                            model,
                            ..MultiPosition::default()
                        };
                        multi_position_with(poses, gravity, what)
                    }
                    None => best_model(poses, gravity, Terms::NONE, true),
                });
                let percent = found.held.map(|[held, all]| 100.0 * held / all);
                let each = found.answered as f64;
                let [unseen, said] =
                    [found.unseen, found.said].map(|sum| 1e3 * (sum / each).sqrt());
                let name = model.map_or("auto".to_owned(), |model| model.to_string());
                println!(
                    "  {} {}, {name}: {} of {SENSORS} answered; bias {:.0} %, scale factor {:.0} %; \
                     unseen orientations {unseen:.0} mm/s² rms, said of the worst {said:.0}",
                    held.1, held.0, found.answered, percent[0], percent[1]
                );
                if found.answered >= 20 {
                    assert!(percent.iter().all(|held| held.is_nan() || *held >= 88.0));
                    assert!(unseen <= said);
                }
            }
        }
    }
}
