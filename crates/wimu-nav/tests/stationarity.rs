//! The detector of rests.

use crate::common;

use common::Random;
use common::travel::Travel;
use nalgebra::Vector3;
use wimu_nav::GRAVITY_MPS2;
use wimu_nav::stationarity::{RestDetector, RestLimits};

fn force(travel: &Travel, t: f64, random: &mut Random) -> (Vector3<f64>, Vector3<f64>) {
    let [force, rate] = travel.sensed(t);
    (force + Vector3::from(random.normals(0.01)), rate + Vector3::from(random.normals(0.001)))
}

/// Decision at each sample of a motion.
fn decisions(travel: &Travel, rate_hz: f64, until_s: f64, seed: u64) -> Vec<(f64, bool)> {
    let mut random = Random::new(seed);
    let mut detector = RestDetector::new(RestLimits::default());
    (0..=(until_s * rate_hz) as usize)
        .map(|k| {
            let t = k as f64 / rate_hz;
            let (force, rate) = force(travel, t, &mut random);
            (t, detector.push(&force, Some(&rate), 1.0 / rate_hz))
        })
        .collect()
}

#[test]
fn at_rest_the_statistic_has_its_expectation() {
    let mut random = Random::new(21);
    let settings = RestLimits::default();
    for (rate_hz, gyroscope) in [(100.0, true), (400.0, true), (100.0, false)] {
        let (mut sum, windows) = (0.0, 2000);
        for _ in 0..windows {
            let mut detector = RestDetector::new(settings);
            let gravity = Vector3::from(random.direction()) * GRAVITY_MPS2;
            let offset = Vector3::from(random.normals(settings.force_offset_mps2));
            let turn =
                Vector3::from(random.direction()) * (settings.rate_offset_rad_s * random.normal());
            while detector.statistic().is_none() {
                let force = gravity + offset + Vector3::from(random.normals(settings.force_mps2));
                let rate = turn + Vector3::from(random.normals(settings.rate_rad_s));
                detector.push(&force, gyroscope.then_some(&rate), 1.0 / rate_hz);
            }
            sum += detector.statistic().unwrap();
        }
        // For each sensor three axes about their mean, and one deviation of the mean. The detector divides by the count.
        let samples = 0.25 * rate_hz;
        let sensors = if gyroscope { 2.0 } else { 1.0 };
        let expected = sensors * (3.0 * (1.0 - 1.0 / samples) + 1.0);
        let mean = sum / f64::from(windows);
        assert!((mean / expected - 1.0).abs() < 0.06, "{rate_hz} Hz: {mean}, expected {expected}");
        let threshold = if gyroscope {
            settings.threshold
        } else {
            settings.without_gyroscope(settings.force_mps2).threshold
        };
        assert!(expected < threshold, "{expected} of {threshold}");
    }
}

/// Fraction of the samples between two times that are taken for a rest.
fn rests(found: &[(f64, bool)], from_s: f64, to_s: f64) -> f64 {
    let part = || found.iter().filter(|(t, _)| *t > from_s && *t < to_s);
    part().filter(|(_, rest)| *rest).count() as f64 / part().count() as f64
}

#[test]
fn motion_is_found_and_rest_is_too() {
    let mut random = Random::new(22);
    let brisk = Travel::rest().leg(3.0, 1.5, [1.0, 0.0, 0.0], [0.0; 3]);
    let swing = Travel::oscillation(&mut random, [3.0, 6.0], 0.2, 0.2);
    let turn = Travel::rest().leg(3.0, 1.5, [0.0; 3], [0.0, 0.0, 0.4]);
    for (travel, moving_s) in [(brisk, [3.25, 4.5]), (swing, [3.7, 5.5]), (turn, [3.4, 4.2])] {
        let found = decisions(&travel, 100.0, 8.0, 1);
        assert_eq!(rests(&found, 0.3, 2.9), 1.0, "before");
        let moving = rests(&found, moving_s[0], moving_s[1]);
        assert!(moving < 0.15, "{moving}");
        assert_eq!(rests(&found, 6.5, 8.0), 1.0, "after");
    }
}

#[test]
fn a_bias_beyond_the_mean_s_deviation_hides_every_rest() {
    let still = Vector3::new(0.0, 0.0, GRAVITY_MPS2);
    let found = |offset_mps2: f64, bias_rad_s: f64| {
        let mut detector = RestDetector::new(RestLimits::default());
        let force = still + Vector3::z() * offset_mps2;
        let rate = Vector3::x() * bias_rad_s;
        (0..100).filter(|_| detector.push(&force, Some(&rate), 0.01)).count() > 0
    };
    // √12 deviations.
    assert!(found(0.38, 0.0) && !found(0.40, 0.0));
    assert!(found(0.0, 0.070) && !found(0.0, 0.071));
}

#[test]
fn without_a_gyroscope_a_known_noise_makes_the_detector_sharper() {
    let found = |noise| RestLimits::default().without_gyroscope(noise).force_mps2;
    assert!((found(0.02) - 0.03).abs() < 1e-12);
    assert_eq!((found(0.1), found(0.0)), (0.06, 0.06));
}

#[test]
fn a_gap_or_a_number_that_is_not_finite_ends_the_rest() {
    let still = Vector3::new(0.0, 0.0, GRAVITY_MPS2);
    let zero = Vector3::zeros();
    let bad = Vector3::new(0.0, f64::NAN, GRAVITY_MPS2);
    for (force, rate, step_s) in [
        (bad, zero, 0.01),
        (still, bad, 0.01),
        (still * f64::INFINITY, zero, 0.01),
        (still, zero, 0.3),
    ] {
        let mut detector = RestDetector::new(RestLimits::default());
        let mut rests = 0;
        for _ in 0..100 {
            rests += usize::from(detector.push(&still, Some(&zero), 0.01));
        }
        assert_eq!(rests, 100 - 24, "from the first full window on");
        assert!(!detector.push(&force, Some(&rate), step_s));
        assert!(!detector.is_at_rest() && detector.statistic().is_none());
        let again = (0..100).position(|_| detector.push(&still, Some(&zero), 0.01));
        assert_eq!(again, Some(24), "a whole window later");
    }
}

#[test]
fn every_rate_gives_the_same_decision() {
    let travel = Travel::rest().leg(3.0, 1.5, [0.3, 0.0, 0.1], [0.2, 0.0, 0.0]).leg(
        7.0,
        2.0,
        [0.0, -1.0, 0.0],
        [0.0, 0.0, 1.5],
    );
    for rate_hz in
        [20.0, 25.0, 30.0, 52.0, 100.0, 104.0, 200.0, 400.0, 416.0, 1000.0, 1666.0, 2000.0]
    {
        for (t, rest) in decisions(&travel, rate_hz, 12.0, 3) {
            // The window, and a part of it that is not yet full.
            let away = |from: f64, to: f64| t > from + 0.2 && t < to - 0.2;
            let rests = [[0.2, 3.2], [4.6, 7.2], [9.1, 12.2]];
            let moves = [[3.15, 4.45], [7.2, 8.9]];
            if rests.iter().any(|[from, to]| away(*from, *to)) {
                assert!(rest, "{rate_hz} Hz, {t} s: at rest");
            }
            if moves.iter().any(|[from, to]| away(*from, *to)) {
                assert!(!rest, "{rate_hz} Hz, {t} s: moves");
            }
        }
    }
}
