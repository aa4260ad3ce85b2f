//! What every method says of its uncertainty, on a thousand simulated sensors whose truth is known:
//! lower triangular, put down by hand to 1°.

use crate::common;

use common::{
    AUTO, DrawModel as _, G, NINE, ROBUST, Random, exact, jitter, misplaced, parameters, pose,
    twelve,
};
use wimu_calib::{
    Estimate, Face, Gravity, MultiPosition, Orientation, Parameter, Placement, Pose, Term, Terms,
    four_angle, multi_position, six_position, three_angle,
};
use wimu_model::{CentiCelsius, ErrorModel, ErrorTerms, SpecificForceMps2};
use wimu_testkit::{Coverage, coverage_figure, draws};

const DEGREE: f64 = std::f64::consts::PI / 180.0;
/// Of a sample, m/s², and how many make a pose.
const NOISE: f64 = 0.03;
const SAMPLES: u32 = 100;

/// A pose put down by hand with `up` upward, at `time` −1..=0 of a session that drifts.
struct Sensor {
    model: ErrorModel,
    drift: [f64; 3],
    random: Random,
}

impl Sensor {
    fn hold(&mut self, up: [f64; 3], time: f64, celsius: f64) -> Pose {
        let up = misplaced(&mut self.random, up, DEGREE);
        let temperature = CentiCelsius((celsius * 100.0) as i16);
        let force = SpecificForceMps2(up.map(|c| c * G));
        let mut mean = self.model.distort(force, Some(temperature)).0;
        for axis in 0..3 {
            let noise = NOISE / f64::from(SAMPLES).sqrt();
            mean[axis] += self.drift[axis] * time + self.random.normal() * noise;
        }
        Pose {
            sd_mps2: [NOISE; 3],
            samples: SAMPLES,
            temperature_c: Some(f64::from(temperature.0) / 100.0),
            time_s: 600.0 * (1.0 + time),
            ..Pose::from_mean(mean)
        }
    }

    /// Twelve well spread poses and eight more anywhere.
    fn session(&mut self) -> Vec<Pose> {
        let mut ups = twelve().to_vec();
        ups.extend((0..8).map(|_| self.random.direction()));
        let last = (ups.len() - 1) as f64;
        // Time and temperature in different orders.
        (0..ups.len())
            .map(|k| {
                let celsius = 25.0 + ((k * 7) % 20) as f64;
                self.hold(ups[k], k as f64 / last - 1.0, celsius)
            })
            .collect()
    }
}

fn sensors() -> u64 {
    draws(1000, 3) as u64
}

/// Counts whether an interval holds the truth.
fn add(held: &mut Coverage, error: f64, half_width: f64) {
    assert!(half_width > 0.0, "what was fitted has an uncertainty");
    held.count(error.abs() <= half_width);
}

/// Records, as the figure of a claim, how often the 95 % intervals of each kind hold the truth.
fn assert_consistent(claim: &str, kinds: &[(String, Coverage)]) {
    let held: Vec<Coverage> = kinds.iter().map(|kind| kind.1).collect();
    coverage_figure(claim, &held, 0.93..=0.97);
    for (kind, held) in kinds {
        println!("{kind}: {held}");
        held.assert_can_be(0.93..=0.97, kind);
    }
}

/// Of each kind of parameter.
#[derive(Default)]
struct Kinds {
    bias: Coverage,
    scale: Coverage,
    misalignment: Coverage,
}

impl Kinds {
    fn count(&mut self, estimate: &Estimate, truth: &ErrorModel) {
        let (found, truth) = (parameters(&estimate.model), parameters(truth));
        for parameter in estimate.fitted.iter() {
            let i = parameter.index();
            let coverage = match i {
                0..3 => &mut self.bias,
                3 | 7 | 11 => &mut self.scale,
                _ => &mut self.misalignment,
            };
            let error = found[i] - truth[i];
            add(coverage, error, estimate.half_width_95(parameter));
        }
    }

    fn named(&self, what: &str) -> [(String, Coverage); 3] {
        [
            (format!("{what}, bias"), self.bias),
            (format!("{what}, scale factor"), self.scale),
            (format!("{what}, misalignment"), self.misalignment),
        ]
    }
}

fn sensor(seed: u64, mut shape: impl FnMut(&mut Random, &mut ErrorTerms)) -> Sensor {
    let mut random = Random::new(seed);
    let mut terms: ErrorTerms = random.model(true).into();
    shape(&mut random, &mut terms);
    Sensor { model: ErrorModel::new(terms).expect("within bounds"), drift: [0.0; 3], random }
}

fn count(coverage: &mut Coverage, estimate: &Estimate, truth: &ErrorModel) {
    let (found, truth) = (parameters(&estimate.model), parameters(truth));
    for parameter in estimate.fitted.iter() {
        let i = parameter.index();
        let error = found[i] - truth[i];
        add(coverage, error, estimate.half_width_95(parameter));
    }
}

#[test]
fn intervals_of_multi_position_cover_the_truth() {
    let mut kinds = Vec::new();
    for (name, what) in [("nine", NINE), ("bad poses left out", ROBUST), ("with priors", AUTO)] {
        let mut coverage = Coverage::default();
        for seed in 0..sensors() {
            let mut sensor = sensor(seed, |random, terms| {
                // Of sensors that drift and warm as the priors have it.
                if what.priors {
                    terms.temperature.bias_mps2_per_k = random.normals(0.005);
                    terms.temperature.scale_per_k = random.normals(2e-4);
                }
            });
            if what.priors {
                sensor.drift = sensor.random.normals(0.02);
            }
            let mut poses = sensor.session();
            if what.priors {
                poses.iter_mut().for_each(|pose| jitter(&mut sensor.random, pose, 0.003));
            }
            let estimate = multi_position(&poses, exact(), what).expect("an answer");
            let about = about(&sensor.model, estimate.model.terms().temperature.reference_c);
            count(&mut coverage, &estimate, &about);
        }
        kinds.push((format!("multi-position, {name}"), coverage));
    }
    assert_consistent("95 % intervals of nine parameters of one sensor hold the truth", &kinds);
}

#[test]
fn intervals_include_a_gravity_that_is_not_known() {
    let mut all = Vec::new();
    for count in [12, 13, 16, 30] {
        let mut kinds = Kinds::default();
        for seed in 0..sensors() {
            let mut sensor = sensor(seed, |_, _| {});
            let gravity = Gravity::UNKNOWN_PLACE;
            let local = gravity.mps2() + gravity.sd_mps2() * sensor.random.normal();
            let mut ups = twelve().to_vec();
            ups.extend((12..count).map(|_| sensor.random.direction()));
            let poses: Vec<Pose> = ups
                .into_iter()
                .map(|up| {
                    let mut pose = pose(&sensor.model, local, up);
                    for axis in &mut pose.mean_mps2 {
                        *axis += 0.003 * sensor.random.normal();
                    }
                    pose
                })
                .collect();
            let estimate = multi_position(&poses, gravity, ROBUST).expect("an answer");
            kinds.count(&estimate, &sensor.model);
        }
        all.extend(kinds.named(&format!("{count} poses, gravity not known")));
    }
    assert_consistent("95 % intervals, gravity known to ± 0.015 m/s²", &all);
}

#[test]
fn intervals_of_the_terms_cover_the_truth() {
    let mut kinds = Vec::new();
    for term in Term::ALL {
        let (mut basic, mut own) = (Coverage::default(), Coverage::default());
        for seed in 0..sensors() {
            let mut drift = [0.0; 3];
            let mut sensor = sensor(seed, |random, terms| {
                terms.temperature.reference_c = 34.5;
                for axis in 0..3 {
                    match term {
                        Term::Drift => drift[axis] = 0.05,
                        Term::BiasTemperature => {
                            terms.temperature.bias_mps2_per_k[axis] = random.within(0.01);
                        }
                        Term::ScaleTemperature => {
                            terms.temperature.scale_per_k[axis] = random.within(5e-4);
                        }
                        Term::Quadratic => terms.nonlinearity[axis] = random.within(1e-4),
                    }
                }
            });
            sensor.drift = drift;
            let what = MultiPosition { terms: Terms::NONE.with(term), ..MultiPosition::default() };
            let poses = sensor.session();
            let estimate = multi_position(&poses, exact(), what).expect("an answer");
            // The model is about the mean temperature of the poses.
            let truth = about(&sensor.model, estimate.model.terms().temperature.reference_c);
            count(&mut basic, &estimate, &truth);
            let (found, truth, sd) = own_values(&estimate, &truth, term, sensor.drift);
            for axis in 0..3 {
                let half_width = student(estimate.dof) * sd[axis];
                add(&mut own, found[axis] - truth[axis], half_width);
            }
        }
        kinds.push((format!("nine parameters beside {term}"), basic));
        kinds.push((format!("{term}"), own));
    }
    assert_consistent("95 % intervals with drift, temperature, quadratic terms", &kinds);
}

/// The same model about another reference temperature.
fn about(model: &ErrorModel, reference_c: f64) -> ErrorModel {
    let mut terms: ErrorTerms = (*model).into();
    let warmer = reference_c - terms.temperature.reference_c;
    for axis in 0..3 {
        terms.bias_mps2[axis] += terms.temperature.bias_mps2_per_k[axis] * warmer;
        let grown = 1.0 + terms.temperature.scale_per_k[axis] * warmer;
        terms.matrix[axis][axis] *= grown;
        terms.temperature.scale_per_k[axis] /= grown;
    }
    terms.temperature.reference_c = reference_c;
    ErrorModel::new(terms).expect("within bounds")
}

fn own_values(
    estimate: &Estimate,
    truth: &ErrorModel,
    term: Term,
    drift: [f64; 3],
) -> ([f64; 3], [f64; 3], [f64; 3]) {
    let (found, truth, sd) = (estimate.model.terms(), truth.terms(), estimate.term_sd);
    match term {
        Term::Drift => (estimate.drift.expect("it was fitted").change_mps2, drift, sd[0]),
        Term::BiasTemperature => {
            (found.temperature.bias_mps2_per_k, truth.temperature.bias_mps2_per_k, sd[1])
        }
        Term::ScaleTemperature => {
            (found.temperature.scale_per_k, truth.temperature.scale_per_k, sd[2])
        }
        Term::Quadratic => (found.nonlinearity, truth.nonlinearity, sd[3]),
    }
}

/// 97.5 % point of Student's t for the 8 degrees of freedom of twelve parameters and twenty poses.
fn student(dof: usize) -> f64 {
    assert_eq!(dof, 8);
    2.306
}

#[test]
fn intervals_of_six_positions_cover_the_truth() {
    let mut kinds = Kinds::default();
    for seed in 0..sensors() {
        let mut sensor = sensor(seed, |_, _| {});
        let poses: Vec<Pose> = Face::ALL
            .into_iter()
            .map(|face| sensor.hold(Orientation::from(face).up(), 0.0, 25.0))
            .collect();
        let estimate = six_position(&poses, None, exact(), Placement::BY_HAND).expect("an answer");
        kinds.count(&estimate, &sensor.model);
    }
    let kinds = kinds.named("six-position");
    assert_consistent("95 % intervals of six positions placed to 1°", &kinds);
}

#[test]
fn intervals_of_six_positions_include_what_differs_from_visit_to_visit() {
    // Placed to 0.1°, which hides nothing; positions come back to 2 and 5 mm/s².
    let placement = Placement::new(0.1 * DEGREE).expect("placement");
    let (mut again, mut once) = (Vec::new(), Vec::new());
    for (visits, differs, range) in [
        (3, 0.002, 0.93..=0.97),
        (3, 0.005, 0.93..=0.97),
        (2, 0.005, 0.93..=0.97),
        // Once: what is taken for granted is wide enough for most.
        (1, 0.002, 0.93..=1.0),
        (1, 0.005, 0.88..=1.0),
    ] {
        let (mut bias, mut scale) = (Coverage::default(), Coverage::default());
        for seed in 0..sensors() {
            let mut sensor = sensor(seed, |_, _| {});
            let mut poses = Vec::new();
            for face in (0..visits).flat_map(|_| Face::ALL) {
                let up = misplaced(&mut sensor.random, Orientation::from(face).up(), 0.1 * DEGREE);
                let mut pose = pose(&sensor.model, G, up);
                jitter(&mut sensor.random, &mut pose, differs);
                jitter(&mut sensor.random, &mut pose, 0.0005);
                pose.sd_mps2 = [0.01; 3];
                pose.samples = 400;
                poses.push(pose);
            }
            let estimate = six_position(&poses, None, exact(), placement).expect("an answer");
            let (found, truth) = (parameters(&estimate.model), parameters(&sensor.model));
            for axis in 0..3 {
                let (b, s) = (axis, 3 + 4 * axis);
                add(&mut bias, found[b] - truth[b], estimate.half_width_95(Parameter::ALL[b]));
                add(&mut scale, found[s] - truth[s], estimate.half_width_95(Parameter::ALL[s]));
            }
        }
        let kind = format!("{visits} visits that differ by {differs} m/s²");
        println!("{kind}: bias {bias}, scale factor {scale}");
        bias.assert_can_be(range.clone(), &kind);
        scale.assert_can_be(range, &kind);
        if visits == 1 { &mut once } else { &mut again }.extend([bias, scale]);
    }
    coverage_figure(
        "95 % intervals of six positions visited twice or three times",
        &again,
        0.93..=0.97,
    );
    coverage_figure("95 % intervals of six positions visited once", &once, 0.93..=1.0);
}

/// Poses of one turn about `axis` in `steps`, begun at `begin` rad.
fn turn(sensor: &mut Sensor, axis: usize, steps: usize, begin: f64) -> Vec<Pose> {
    let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
    (0..steps)
        .map(|k| {
            let angle = begin + std::f64::consts::TAU * k as f64 / steps as f64;
            let mut up = [0.0; 3];
            (up[a], up[b]) = (angle.cos(), angle.sin());
            sensor.hold(up, 0.0, 25.0)
        })
        .collect()
}

#[test]
fn intervals_of_four_and_three_angles_cover_the_truth() {
    let mut kinds = Vec::new();
    for (name, steps) in [("four-angle", 4), ("three-angle", 3)] {
        // From a side that is up, where step errors enter the scale factor in second order only,
        // and from anywhere.
        for anywhere in [false, true] {
            let (mut bias, mut scale) = (Coverage::default(), Coverage::default());
            for seed in 0..sensors() {
                let mut sensor = sensor(seed, |_, _| {});
                let begin = if anywhere { sensor.random.within(std::f64::consts::PI) } else { 0.0 };
                let axis = (seed % 3) as usize;
                let poses = turn(&mut sensor, axis, steps, begin);
                let method = if steps == 4 { four_angle } else { three_angle };
                let estimate = method(&poses, exact(), Placement::BY_HAND).expect("an answer");
                let terms = *sensor.model.terms();
                for in_plane in (0..3).filter(|&other| other != axis) {
                    let found = estimate.model.terms();
                    let row = terms.matrix[in_plane];
                    let norm =
                        (0..3).filter(|&c| c != axis).map(|c| row[c] * row[c]).sum::<f64>().sqrt();
                    add(
                        &mut bias,
                        found.bias_mps2[in_plane] - terms.bias_mps2[in_plane],
                        estimate.half_width_95(Parameter::ALL[in_plane]),
                    );
                    add(
                        &mut scale,
                        found.matrix[in_plane][in_plane] - norm,
                        estimate.half_width_95(Parameter::ALL[3 + 4 * in_plane]),
                    );
                }
            }
            let from = if anywhere { "anywhere" } else { "a side up" };
            kinds.push((format!("{name} from {from}, bias"), bias));
            kinds.push((format!("{name} from {from}, scale factor"), scale));
        }
    }
    assert_consistent("95 % intervals of four and three angles hold the truth", &kinds);
}
