//! What is claimed of the fit of an array at rests: errors are found within their posterior deviations, which are consistent
//! from both sides; what is not observed keeps its prior; no input panics.

use proptest::prelude::*;
use wimu_calib::{ArrayPrior, Pose, Reason, calibrate_array};
use wimu_testkit::{Coverage, Lane, Random, coverage_figure, draws};

use crate::common::{G, config};

const NOISE: f64 = 0.03;
const SAMPLES: u32 = 90;
const RESTS: usize = 12;

/// Bias and matrix of each sensor.
type Truth = Vec<([f64; 3], [[f64; 3]; 3])>;

fn drawn(sensors: usize, prior: &ArrayPrior, random: &mut Random) -> Truth {
    let mut one = || {
        let mut matrix = [0, 1, 2].map(|_| random.normals(prior.matrix));
        for (axis, row) in matrix.iter_mut().enumerate() {
            row[axis] += 1.0;
        }
        (random.normals(prior.bias_mps2), matrix)
    };
    (0..sensors).map(|_| one()).collect()
}

/// Rests in twelve orientations spread over the sphere.
fn rests(truth: &Truth, prior: &ArrayPrior, random: &mut Random) -> Vec<Vec<Option<Pose>>> {
    let noise = NOISE / f64::from(SAMPLES).sqrt();
    let of_rest = |rest: usize| {
        let z = 1.0 - 2.0 * (rest as f64 + 0.5) / RESTS as f64;
        let ((s, c), r) = ((2.4 * rest as f64).sin_cos(), (1.0 - z * z).sqrt());
        let force = [r * c * G, r * s * G, z * G];
        let poses = truth.iter().map(|(bias, matrix)| {
            let mean_mps2 = [0, 1, 2].map(|i| {
                let clean: f64 = (0..3).map(|j| matrix[i][j] * force[j]).sum();
                bias[i] + clean + (noise + prior.repeatability_mps2) * random.normal()
            });
            Some(Pose { sd_mps2: [NOISE; 3], samples: SAMPLES, ..Pose::from_mean(mean_mps2) })
        });
        poses.collect()
    };
    (0..RESTS).map(of_rest).collect()
}

fn prior() -> ArrayPrior {
    ArrayPrior { gravity_mps2: G, gravity_sd_mps2: 0.0, ..ArrayPrior::default() }
}

#[test]
fn posterior_deviations_are_consistent_from_both_sides() {
    let prior = ArrayPrior { repeatability_mps2: 0.0, ..prior() };
    let mut kinds = [Coverage::default(); 2];
    for seed in 1..=draws(100, 25) as u64 {
        let mut random = Random::new(seed);
        let truth = drawn(4, &prior, &mut random);
        let found = calibrate_array(&rests(&truth, &prior, &mut random), &prior).unwrap();
        for ((bias, matrix), sensor) in truth.iter().zip(&found.sensors) {
            let Some(model) = sensor.model else { continue };
            let mut count = |kind: usize, error: f64, sd: f64| {
                kinds[kind].count(error.abs() < 1.96 * sd);
            };
            for i in 0..3 {
                count(0, model.terms().bias_mps2[i] - bias[i], sensor.bias_sd_mps2[i]);
                for j in 0..3 {
                    let error = model.terms().matrix[i][j] - matrix[i][j];
                    count(1, error, sensor.matrix_sd[i][j]);
                }
            }
        }
    }
    coverage_figure("array: 95 % intervals of bias and matrix at rests", &kinds, 0.93..=0.97);
    kinds.iter().for_each(|kind| kind.assert_can_be(0.93..=0.97, "array"));
}

#[test]
fn a_sensor_without_a_rest_keeps_its_prior() {
    let mut random = Random::new(5);
    let truth = drawn(8, &prior(), &mut random);
    let mut all = rests(&truth, &prior(), &mut random);
    all.iter_mut().for_each(|rest| rest[2] = None);
    let found = calibrate_array(&all, &prior()).unwrap();
    let absent = &found.sensors[2];
    assert_eq!(absent.model, Some(wimu_model::ErrorModel::default()));
    assert!((absent.bias_sd_mps2[0] - 0.5).abs() < 1e-9, "{absent:?}");
    assert!(found.matrix_sd < 2e-3, "{}", found.matrix_sd);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: Lane::current().choose([4, 16, 100]), ..config() })]

    #[test]
    fn garbage_is_an_error_or_finite(
        values in prop::collection::vec(prop_oneof![any::<f64>(), -20.0..20.0_f64], 0..60),
        noise in prop_oneof![any::<f64>(), Just(0.01)],
    ) {
        let pose = |v: &[f64]| Some(Pose { sd_mps2: [noise; 3], ..Pose::from_mean([v[0], v[1], v[2]]) });
        let rests: Vec<_> = values.chunks_exact(6).map(|v| vec![pose(&v[..3]), pose(&v[3..])]).collect();
        if let Ok(found) = calibrate_array(&rests, &prior()) {
            prop_assert!(found.sensors.iter().all(|s| s.bias_sd_mps2.iter().all(|sd| sd.is_finite())));
        }
    }
}

#[test]
fn what_cannot_be_fitted_is_refused_with_its_reason() {
    let rest = vec![Some(Pose::from_mean([0.0, 0.0, G])); 2];
    let refused = |rests: &[Vec<Option<Pose>>], prior: &ArrayPrior| {
        calibrate_array(rests, prior).unwrap_err().reason
    };
    let none = ArrayPrior { matrix: f64::NAN, ..prior() };
    assert_eq!(refused(std::slice::from_ref(&rest), &none), Reason::Input { index: 0 });
    assert_eq!(refused(&[], &prior()), Reason::TooFew { have: 0, need: 1 });
    assert_eq!(refused(&[vec![None; 2]], &prior()), Reason::TooFew { have: 0, need: 1 });
    assert_eq!(refused(&[rest, vec![None]], &prior()), Reason::Input { index: 1 });
}
