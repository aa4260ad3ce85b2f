//! Merged accelerometers of different full scale.

use wimu_nav::nalgebra::{Matrix3, Vector3};
use wimu_nav::sensor::{Reading, Transfer};
use wimu_testkit::Random;

fn measured(reading: Reading) -> (f64, f64) {
    match reading {
        Reading::Measured(value, variance) => (value, variance),
        other => panic!("{other:?}"),
    }
}

#[test]
fn noise_of_both_is_less_than_that_of_the_finer() {
    let (fine, coarse) = (Reading::Measured(1.0, 0.01), Reading::Measured(2.0, 0.09));
    let (value, variance) = measured(fine.merge(coarse));
    assert!((value - 1.1).abs() < 1e-12 && (variance - 0.009).abs() < 1e-12);
    assert_eq!(fine.merge(coarse), coarse.merge(fine));
}

#[test]
fn the_rail_saturates_and_the_sample_before_it_does_not() {
    assert_eq!(Reading::new(19.6, 0.01, 19.6), Reading::AtLeast(19.6));
    assert_eq!(Reading::new(-25.0, 0.01, 19.6), Reading::AtMost(-19.6));
    assert_eq!(Reading::new(19.59, 0.01, 19.6), Reading::Measured(19.59, 0.01));
    for (value, variance) in [(f64::NAN, 0.01), (1.0, 0.0), (1.0, f64::NAN), (f64::INFINITY, 1.0)] {
        assert_eq!(Reading::new(value, variance, 19.6), Reading::Missing);
    }
}

/// Mean and variance by numerical integration.
fn truncated(value: f64, variance: f64, bound: f64) -> (f64, f64) {
    let deviation = variance.sqrt();
    let steps = (0..400_000).map(|k| bound + deviation * 2e-5 * (f64::from(k) + 0.5));
    let weight = |x: f64| (-0.5 * (x - value).powi(2) / variance).exp();
    let sum = |power: i32| steps.clone().map(|x| weight(x) * (x - bound).powi(power)).sum::<f64>();
    let [mass, first, second] = [0, 1, 2].map(sum);
    let mean = first / mass;
    (bound + mean, second / mass - mean * mean)
}

#[test]
fn a_saturated_reading_has_the_moments_of_a_truncated_distribution() {
    for value in [15.0, 19.0, 19.6, 19.7, 20.5, 40.0] {
        let coarse = Reading::Measured(value, 0.04);
        let (mean, variance) = measured(coarse.merge(Reading::AtLeast(19.6)));
        if value < 18.0 {
            // 23 σ below: at the bound.
            assert!((19.6..19.65).contains(&mean) && variance < 0.04);
            continue;
        }
        let expected = truncated(value, 0.04, 19.6);
        let most = (value + 1.6 - 19.6).max(0.0);
        if value < 25.0 {
            assert!((mean - expected.0).abs() < 2e-3, "{value}: {mean} {expected:?} {most}");
            assert!((variance / expected.1 - 1.0).abs() < 0.02, "{value}: {variance} {expected:?}");
        } else {
            assert!((mean - value).abs() < 1e-9 && (variance - 0.04).abs() < 1e-9);
        }
        // The other side is the mirror image.
        let (below, same) = measured(Reading::Measured(-value, 0.04).merge(Reading::AtMost(-19.6)));
        assert!((below + mean).abs() < 1e-12 && (same - variance).abs() < 1e-12);
    }
}

#[test]
fn two_saturated_readings_keep_the_stronger_limit_and_contradictions_are_missing() {
    let (low, high) = (Reading::AtLeast(19.6), Reading::AtLeast(157.0));
    assert_eq!(low.merge(high), high);
    assert_eq!(low.merge(Reading::AtMost(-19.6)), Reading::Missing);
    assert_eq!(Reading::Missing.merge(low), low);
}

/// A coarse accelerometer with known errors beside a fine one: the largest error of 300 m/s² over σ, in `draws`.
fn beyond(motion_mps2: f64, draws: u64) -> f64 {
    let mut squares = 0.0;
    for draw in 0..draws {
        let mut random = Random::new(draw);
        let bias = Vector3::from(random.normals(0.8));
        let matrix = Matrix3::identity() + Matrix3::from_fn(|_, _| 0.03 * random.normal());
        let mut transfer = Transfer::new(1.5, 0.05);
        for _ in 0..500 {
            let force = Vector3::new(0.0, 0.0, 9.8) + Vector3::from(random.normals(motion_mps2));
            let coarse = bias + matrix * force + Vector3::from(random.normals(0.1));
            transfer.push(&force, &coarse, 0.01, 0.0);
        }
        let model = transfer.model().expect("finite");
        let force = Vector3::new(300.0, 0.0, 0.0);
        let (found, variance) = model.to_fine(&(bias + matrix * force), 0.0);
        squares += (found.x - 300.0).powi(2) / variance.x;
    }
    (squares / draws as f64).sqrt()
}

#[test]
fn the_covariance_of_the_calibration_holds_far_beyond_its_range() {
    // Observed: the data decide. Not observed: the prior of 5 % does, which is wider than 3 %.
    let [moving, still] = [3.0, 1e-6].map(|motion_mps2| beyond(motion_mps2, 200));
    assert!((0.85..1.15).contains(&moving), "{moving}");
    assert!((0.4..0.8).contains(&still), "{still}");
}

#[test]
fn noise_of_the_finer_one_is_no_motion() {
    // At rest a regression would take it for one, and end at a scale factor of 0.
    let mut random = Random::new(5);
    let mut transfer = Transfer::new(1.5, 0.05);
    for _ in 0..5000 {
        let fine = Vector3::new(0.0, 0.0, 9.8) + Vector3::from(random.normals(0.03));
        let coarse = Vector3::new(0.0, 0.0, 9.8) + Vector3::from(random.normals(0.06));
        transfer.push(&fine, &coarse, 0.0045, 0.0009);
    }
    let model = transfer.model().expect("finite");
    let deviation = model.covariance[(1, 1)].sqrt();
    for axis in 0..2 {
        let scale = model.matrix[(axis, axis)];
        assert!((scale - 1.0).abs() < 0.25, "{scale}");
    }
    assert!((0.03..0.07).contains(&deviation), "{deviation}");
}

#[test]
fn numbers_that_are_not_finite_give_no_model() {
    let mut transfer = Transfer::new(1.5, 0.05);
    let prior = transfer.model().expect("the prior");
    assert!((prior.matrix - Matrix3::identity()).amax() < 1e-12);
    transfer.push(&Vector3::repeat(f64::NAN), &Vector3::zeros(), 0.01, 0.0);
    assert!(transfer.model().is_none());
}
