//! Stances of a foot at several gaits.

use crate::common;

use common::Random;
use common::travel::Travel;
use nalgebra::Vector3;
use wimu_nav::stance::stances;
use wimu_nav::stationarity::{RestDetector, RestLimits};

/// Statistics at 100 Hz: standing for 3 s, then steps of a swing and a stance.
fn walk(steps: usize, swing: &[f64], stance: &[f64]) -> Vec<f64> {
    let mut statistic = vec![0.002; 300];
    for _ in 0..steps {
        statistic.extend(swing);
        statistic.extend(stance);
    }
    statistic
}

fn found(statistic: &[f64]) -> Vec<Option<f64>> {
    let mut found = vec![None; statistic.len()];
    stances(statistic, 100.0, &mut found);
    found
}

#[test]
fn the_stances_of_running_are_found_from_the_first_step_on() {
    let statistic = walk(20, &[2000.0; 70], &[20.0; 8]);
    let found = found(&statistic);
    for (k, sd) in found.iter().enumerate() {
        assert_eq!(sd.is_some(), statistic[k] < 100.0, "sample {k}");
    }
    // A rolling foot has the velocity of its lever arm.
    let [standing, running] = [found[100], found[370]].map(Option::unwrap);
    assert!((standing - 0.01).abs() < 1e-12);
    assert!((running - 0.01 * 200_f64.sqrt()).abs() < 1e-12, "{running}");
}

#[test]
fn a_short_minimum_in_the_swing_of_a_slow_step_is_no_stance() {
    let mut swing = vec![300.0; 120];
    swing[60..65].fill(0.5);
    let statistic = walk(10, &swing, &[0.01; 60]);
    let found = found(&statistic);
    let last = statistic.len() - 120;
    for k in 300..last {
        assert_eq!(found[k].is_some(), statistic[k] < 0.1, "sample {k}");
    }
}

#[test]
fn an_unknown_statistic_is_no_stance() {
    for unknown in [f64::INFINITY, f64::NAN] {
        let mut statistic = walk(5, &[2000.0; 70], &[20.0; 8]);
        statistic[100..200].fill(unknown);
        let found = found(&statistic);
        assert!(found[100..200].iter().all(Option::is_none));
        assert!(found[..100].iter().all(Option::is_some));
    }
    let mut none = [Some(1.0); 4];
    stances(&[f64::INFINITY; 4], 100.0, &mut none);
    assert_eq!(none, [None; 4]);
    stances(&[], 100.0, &mut none);
}

#[test]
fn a_stance_is_found_between_strides() {
    // A stride of 1.2 m in 0.6 s, 0.6 s of stance.
    let travel = (0..5).fold(Travel::rest(), |travel, k| {
        travel.leg(1.0 + 1.2 * f64::from(k), 0.6, [1.2, 0.0, 0.0], [0.0, 0.8, 0.0])
    });
    let mut detector = RestDetector::new(RestLimits::foot());
    let mut random = Random::new(24);
    let statistic: Vec<f64> = (0..1200)
        .map(|k| {
            let t = f64::from(k) * 0.005;
            let [mut force, mut rate] = travel.sensed(t);
            force += Vector3::from(random.normals(0.05));
            rate += Vector3::from(random.normals(0.004));
            detector.push(&force, Some(&rate), 0.005);
            detector.statistic().unwrap_or(f64::INFINITY)
        })
        .collect();
    let mut found = vec![None; statistic.len()];
    stances(&statistic, 200.0, &mut found);
    for (k, sd) in found.iter().enumerate().skip(200) {
        let phase = (k as f64 * 0.005 - 1.0).rem_euclid(1.2);
        if phase > 0.65 && phase < 1.15 {
            assert!(sd.is_some(), "{k}");
        } else if phase > 0.1 && phase < 0.5 {
            assert!(sd.is_none(), "{k}");
        }
    }
}
