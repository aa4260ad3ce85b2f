//! Correctness of the plain error-state filter and of the scores.

use std::path::Path;

use nalgebra::{Matrix3, Rotation3, SVector, Vector3};

use crate::baseline::{
    ACCELEROMETER_BIAS, ATTITUDE, Covariance, Filter, GYROSCOPE_BIAS, POSITION, STATES, VELOCITY,
    transition,
};
use crate::detector::Detector;
use crate::journeys::{Draw as _, Kind, SensorErrors, journey, small_angle};
use crate::methods::{run_zupt_filter, vectors};
use crate::recording;
use crate::score::{
    CHI_SQUARE_95, CHI_SQUARE_MEDIAN, Consistency, Frame, Whole, fraction_below, mean, median,
};
use crate::settings::Settings;
use wimu_testkit::{Lane, Random};

type Error = SVector<f64, STATES>;

/// An aligned filter in the middle of a motion.
fn moving_filter(settings: Settings) -> (Filter, Vector3<f64>, Vector3<f64>) {
    let still = vec![Vector3::new(1.0, -2.0, 9.5); settings.start_samples];
    let mut filter =
        Filter::align(&still, &vec![Vector3::zeros(); settings.start_samples], settings);
    filter.position = Vector3::new(1.0, 2.0, 3.0);
    filter.velocity = Vector3::new(0.5, -0.7, 0.2);
    filter.gyroscope_bias = Vector3::new(0.01, -0.02, 0.03);
    filter.accelerometer_bias = Vector3::new(0.1, 0.2, -0.1);
    (filter, Vector3::new(3.0, -4.0, 8.0), Vector3::new(1.0, 2.0, -1.5))
}

/// The state with an error added, in the filter's convention.
fn with_error(filter: &Filter, error: &Error) -> Filter {
    let part = |block| -> Vector3<f64> { error.fixed_rows::<3>(block).into_owned() };
    let mut changed = filter.clone();
    changed.position += part(POSITION);
    changed.velocity += part(VELOCITY);
    changed.attitude = Rotation3::new(part(ATTITUDE)) * changed.attitude;
    changed.gyroscope_bias += part(GYROSCOPE_BIAS);
    changed.accelerometer_bias += part(ACCELEROMETER_BIAS);
    changed
}

/// The error of a state against another.
fn difference(one: &Filter, other: &Filter) -> Error {
    let mut error = Error::zeros();
    let mut put = |block, value: Vector3<f64>| error.fixed_rows_mut::<3>(block).copy_from(&value);
    put(POSITION, one.position - other.position);
    put(VELOCITY, one.velocity - other.velocity);
    put(ATTITUDE, small_angle(&(one.attitude * other.attitude.inverse())));
    put(GYROSCOPE_BIAS, one.gyroscope_bias - other.gyroscope_bias);
    put(ACCELEROMETER_BIAS, one.accelerometer_bias - other.accelerometer_bias);
    error
}

/// Largest differences between F and central finite differences of the prediction over a step: of all elements, and
/// of those of velocity and position by the gyroscope bias, which F neglects.
fn jacobian_errors(step_s: f64, wrong: f64) -> [f64; 2] {
    let (filter, force, rate) = moving_filter(Settings::HAND);
    let middle = filter.attitude * Rotation3::new(0.5 * step_s * (rate - filter.gyroscope_bias));
    let force_nav = middle * (force - filter.accelerometer_bias);
    let f = transition(middle.matrix(), &(force_nav * (1.0 + wrong)), step_s);
    let predicted = |error: Error| {
        let mut changed = with_error(&filter, &error);
        changed.predict(force, rate, step_s);
        changed
    };
    let h = 1e-5;
    let mut worst = [0.0_f64; 2];
    for column in 0..STATES {
        let mut error = Error::zeros();
        error[column] = h;
        let numeric = difference(&predicted(error), &predicted(-error)) / (2.0 * h);
        for row in 0..STATES {
            let bias = (GYROSCOPE_BIAS..ACCELEROMETER_BIAS).contains(&column);
            let neglected = usize::from(bias && row < ATTITUDE);
            worst[neglected] = worst[neglected].max((numeric[row] - f[(row, column)]).abs());
        }
    }
    worst
}

#[test]
fn the_jacobian_of_the_prediction_equals_finite_differences() {
    let step_s = 0.005;
    let [kept, neglected] = jacobian_errors(step_s, 0.0);
    // The rotation's second-order term, ω² dt³ / 24.
    assert!(kept < 1e-7, "{kept:.1e}");
    // |f| dt² / 2 is 1.2e-4.
    assert!(neglected > 1e-6 && neglected < 1.3e-4, "{neglected:.1e}");
    // A specific force that is wrong by 0.1 % shows.
    let [wrong, _] = jacobian_errors(step_s, 1e-3);
    assert!(wrong > 1e-5, "{wrong:.1e}");
}

fn is_symmetric_and_positive(p: &Covariance) -> bool {
    (p - p.transpose()).amax() <= 1e-12 * p.amax() && p.symmetric_eigenvalues().min() > 0.0
}

#[test]
fn the_covariance_stays_symmetric_and_positive() {
    let (mut filter, force, rate) = moving_filter(Settings::HAND);
    let mut random = Random::new(7);
    for k in 0..3000 {
        filter.predict(force + random.vector(2.0), rate + random.vector(1.0), 0.01);
        if k % 100 < 30 {
            let before = filter.covariance.diagonal().sum();
            assert!(filter.update_zero_velocity().is_finite());
            assert!(filter.covariance.diagonal().sum() < before, "an update adds no variance");
            // A prediction rounds; an update makes it symmetric again.
            assert!(is_symmetric_and_positive(&filter.covariance), "update {k}");
        }
    }
    let mut broken = filter.covariance;
    broken[(0, 0)] = -broken[(0, 0)];
    assert!(!is_symmetric_and_positive(&broken), "the test notices one that is not");
}

/// NEES of position and velocity at the moving samples of stop-and-go journeys, and NIS, where the sensor errors are
/// `larger` times what the filter assumes.
fn stop_and_go(larger: f64) -> Whole {
    let assumed = Settings::HAND;
    let errors = SensorErrors {
        accelerometer_noise: larger * assumed.accelerometer_noise,
        gyroscope_noise: larger * assumed.gyroscope_noise,
        accelerometer_bias: larger * assumed.accelerometer_bias,
        gyroscope_bias: larger * assumed.gyroscope_bias,
        accelerometer_bias_walk: larger * assumed.accelerometer_bias_walk,
        gyroscope_bias_walk: larger * assumed.gyroscope_bias_walk,
        // No state of the filter.
        accelerometer_matrix: [0.0; 2],
        gyroscope_matrix: [0.0; 2],
        ..SensorErrors::TABLE
    };
    let mut whole = Whole::default();
    for number in 0..Lane::current().choose([12, 24, 100]) {
        let recording = journey(Kind::StopAndGo, 3, number, &errors);
        // The true rests: the detector is another matter.
        let rests = |k| recording.velocity(k).is_some_and(|v| v.norm() == 0.0);
        let at_rest: Vec<bool> = (0..recording.moving.len()).map(rests).collect();
        let (track, nis, _) = run_zupt_filter(&recording, &[], &at_rest);
        whole.merge(&Whole { nis, ..Whole::of(&recording, &track, &track) });
    }
    whole
}

#[test]
fn the_filter_is_consistent_on_stop_and_go_journeys() {
    let ratio = |score: &Consistency| median(&score.nees) / CHI_SQUARE_MEDIAN;
    let found = stop_and_go(1.0);
    let (position, velocity) = (ratio(&found.position), ratio(&found.velocity));
    println!("position {position:.2}, velocity {velocity:.2}");
    assert!((0.7..1.4).contains(&position), "position {position:.2}");
    assert!((0.7..1.4).contains(&velocity), "velocity {velocity:.2}");
    let below = fraction_below(&found.nis, CHI_SQUARE_95);
    assert!(below > 0.95, "NIS: the rests are true, and noise of 1 cm/s is assumed: {below:.3}");
    // Errors that are twice as large as assumed show.
    let found = stop_and_go(2.0);
    assert!(ratio(&found.position) > 1.4, "{:.2}", ratio(&found.position));
}

/// End errors of `FIXED` as reference/localization/foot.py prints them: 3-D and horizontal, m.
const FOOT_PY: [(&str, [f64; 2]); 14] = [
    ("2017-11-22-11-22-03", [0.220, 0.076]),
    ("2017-11-22-11-22-46", [0.197, 0.033]),
    ("2017-11-22-11-28-39", [0.525, 0.507]),
    ("2017-11-22-11-35-59", [0.053, 0.053]),
    ("2017-11-22-11-39-47", [0.299, 0.082]),
    ("2017-11-22-11-49-29", [0.271, 0.096]),
    ("2017-11-27-11-12-18", [0.261, 0.215]),
    ("2017-11-27-11-14-03", [0.084, 0.081]),
    ("2017-11-27-11-19-16", [5.179, 4.990]),
    ("2017-12-15-17-59-50", [0.176, 0.158]),
    ("2017-12-15-18-01-51", [0.193, 0.062]),
    ("2017-12-15-18-03-05", [30.274, 29.757]),
    ("2018-02-09-11-22-01", [5.008, 0.925]),
    ("2018-02-22-10-10-56", [0.043, 0.043]),
];

#[test]
fn walks_end_where_those_of_the_python_reference_end() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let (walks, _) = recording::load(&data, |name| name.starts_with("pyshoe_"));
    if walks.is_empty() {
        println!("skipped: {} has no walks", data.display());
        return;
    }
    for walk in &walks {
        let trial = walk.name.trim_start_matches("pyshoe_");
        let (_, expected) = FOOT_PY.iter().find(|(name, _)| *name == trial).expect("a known walk");
        let (force, rate) = vectors(walk);
        let at_rest = walk.settings.detector.detect(&force, &rate);
        let (track, _, _) = run_zupt_filter(walk, &[], &at_rest);
        let frame = Frame::of(walk, &track).expect("walks have truth");
        let last = track.estimates.len() - 1;
        let truth = frame.position(walk, last).expect("truth at the end");
        let error = track.estimates[last].position - truth;
        println!("{trial} {:.3} {:.3}", error.norm(), error.xy().norm());
        for (found, expected) in [error.norm(), error.xy().norm()].into_iter().zip(expected) {
            // Printed to 1 mm there.
            assert!((found - expected).abs() < 0.0006, "{trial}: {found:.4} m, not {expected} m");
        }
    }
}

#[test]
fn the_detector_computes_the_published_statistic() {
    let mut random = Random::new(3);
    let force: Vec<_> = (0..5).map(|_| random.vector(8.0) + Vector3::new(1.0, 2.0, 9.3)).collect();
    let rate: Vec<_> = (0..5).map(|_| random.vector(0.1)).collect();
    let detector = Detector::FOOT;
    let mean = force.iter().sum::<Vector3<f64>>() / 5.0;
    let gravity = mean.normalize() * wimu_model::STANDARD_GRAVITY_MPS2;
    let sum = |v: &[Vector3<f64>], about: Vector3<f64>| -> f64 {
        v.iter().map(|x| (x - about).norm_squared()).sum()
    };
    let published = (sum(&force, gravity) / detector.force_noise.powi(2)
        + sum(&rate, Vector3::zeros()) / detector.rate_noise.powi(2))
        / 5.0;
    let found = detector.statistic(&force, &rate);
    assert!((found / published - 1.0).abs() < 1e-12, "{found} is not {published}");
    assert_eq!(detector.detect(&force, &rate), [false; 5], "this is no rest");
    let still = vec![Vector3::z() * wimu_model::STANDARD_GRAVITY_MPS2; 5];
    let at_rest = detector.detect(&still, &[Vector3::zeros(); 5]);
    assert_eq!(at_rest, [false, false, true, false, false], "only where the window fits");
}

#[test]
fn scores_tell_a_covariance_that_is_too_small_from_one_that_is_too_large() {
    let scored = |assumed: f64| {
        let mut random = Random::new(11);
        let mut score = Consistency::default();
        for _ in 0..20_000 {
            assert!(score.push(&random.vector(2.0), &(Matrix3::identity() * assumed * assumed)));
        }
        (score.below_95(), median(&score.nees), mean(&score.log_density))
    };
    let (below, middle, right) = scored(2.0);
    assert!((below - 0.95).abs() < 0.005, "{below}");
    assert!((middle / CHI_SQUARE_MEDIAN - 1.0).abs() < 0.03, "{middle}");
    // Negative entropy of the Gaussian: -3/2 ln(2 π e σ²).
    let entropy = 1.5 * (std::f64::consts::TAU * std::f64::consts::E * 4.0).ln();
    assert!((right + entropy).abs() < 0.03, "{right}");
    let (small_below, small_middle, small) = scored(1.0);
    let (large_below, large_middle, large) = scored(4.0);
    assert!(small_below < 0.7 && large_below > 0.999, "{small_below} {large_below}");
    assert!(small_middle > 1.4 * CHI_SQUARE_MEDIAN && large_middle < 0.7 * CHI_SQUARE_MEDIAN);
    assert!(small < right - 0.5 && large < right - 0.5, "both cost: {small} {right} {large}");
}

#[test]
fn what_is_not_finite_is_not_scored() {
    let mut score = Consistency::default();
    let nothing = Vector3::new(0.0, f64::NAN, 0.0);
    assert!(!score.push(&nothing, &Matrix3::identity()));
    assert!(!score.push(&Vector3::zeros(), &(Matrix3::identity() * f64::NAN)));
    assert!(!score.push(&Vector3::zeros(), &Matrix3::zeros()), "a covariance of zero");
    assert!(score.nees.is_empty());
    assert!(score.push(&Vector3::zeros(), &Matrix3::identity()));
    assert_eq!(score.nees, [0.0]);
}
