//! What a recording at rest says about how the bias settles.

use crate::common;

use common::Random;
use wimu_nav::drift::{Drift, DriftError, DriftEstimator};
use wimu_nav::unit::{UnitConfig, UnitFilter, UnitSample};
use wimu_testkit::{Coverage, coverage_figure, figure, rms_ratio_can_be, trials};

const TRUTH: Drift = Drift {
    rise_mps2: [0.08, -0.05, 0.02],
    start_mps2: [0.01, 0.02, 9.79],
    time_s: 120.0,
    rise_sd_mps2: [0.0; 3],
};

/// Twenty minutes at 10 Hz from the switching on, white noise and a slow wander.
fn recording(drift: Drift, seed: u64) -> DriftEstimator {
    let mut random = Random::new(seed);
    let mut estimator = DriftEstimator::new();
    let mut wander = [0.0; 3];
    for k in 0..12_000 {
        let t = f64::from(k) * 0.1;
        let noise = random.normals(0.02);
        let step = random.normals(2e-4);
        let force = std::array::from_fn(|i| {
            wander[i] = wander[i] * 0.99 + step[i];
            drift.at(t)[i] + noise[i] + wander[i]
        });
        estimator.push(t, force);
    }
    estimator
}

#[test]
fn over_many_seeds_the_parameters_lie_within_their_uncertainties() {
    let (mut time, mut rise, mut start) = (Vec::new(), Vec::new(), Vec::new());
    for seed in 0..trials(1000) as u64 {
        let found = recording(TRUTH, seed).fit().unwrap();
        time.push((found.drift.time_s - TRUTH.time_s) / found.time_sd_s);
        for i in 0..3 {
            rise.push(
                (found.drift.rise_mps2[i] - TRUTH.rise_mps2[i]) / found.drift.rise_sd_mps2[i],
            );
            start.push((found.drift.start_mps2[i] - TRUTH.start_mps2[i]) / found.start_sd_mps2[i]);
        }
        assert!(found.time_sd_s < 0.1 * TRUTH.time_s, "{found:?}");
    }
    for (name, errors) in [("T", time), ("C1", rise), ("C2", start)] {
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        let claim = format!("warm-up of a bias, rms errors of {name} over the stated ones");
        let met = (0.6..=1.4).contains(&rms);
        figure(&claim, format!("{rms:.2}"), "0.6 to 1.4", met);
        assert!(
            rms_ratio_can_be(rms, errors.len(), 0.6..=1.4),
            "{name}: {rms}"
        );
    }
}

#[test]
fn what_does_not_drift_or_has_not_settled_or_moves_is_refused() {
    let still = Drift {
        rise_mps2: [0.0; 3],
        ..TRUTH
    };
    let seeds = 0..trials(1000) as u64;
    let refused: Coverage = seeds
        .map(|seed| recording(still, seed).fit() == Err(DriftError::NoDrift))
        .collect();
    coverage_figure("a bias without warm-up: no fit", &[refused], 0.9..=1.0);
    refused.assert_can_be(0.9..=1.0, "no drift");
    let slow = Drift {
        time_s: 1e5,
        rise_mps2: [8.0, 0.0, 0.0],
        ..TRUTH
    };
    assert_eq!(recording(slow, 1).fit(), Err(DriftError::NotSettled));
    let mut moved = DriftEstimator::new();
    for k in 0..1000 {
        let force = if k < 500 {
            [0.0, 0.0, 9.8]
        } else {
            [9.8, 0.0, 0.0]
        };
        moved.push(f64::from(k), force);
    }
    assert!(matches!(moved.fit(), Err(DriftError::Moved(_))));
    let mut short = DriftEstimator::new();
    assert_eq!(short.fit(), Err(DriftError::TooShort));
    for _ in 0..1000 {
        short.push(f64::NAN, [0.0; 3]);
        short.push(1.0, [f64::INFINITY; 3]);
        short.push(1.0, [0.0; 3]);
    }
    assert_eq!(short.fit(), Err(DriftError::TooShort));
}

#[test]
fn a_known_drift_is_taken_out_and_its_doubt_is_left_in_the_covariance() {
    // Level and still: what the drift tilts, east and north, is what is not known of the position.
    let run = |drift: Option<Drift>| {
        let mut random = Random::new(5);
        let mut filter = UnitFilter::new(UnitConfig {
            zupt: wimu_nav::Zupt::Off,
            drift,
            ..UnitConfig::default()
        });
        let truth = Drift {
            start_mps2: [-0.4, 0.0, 0.0],
            rise_mps2: [0.4, 0.0, 0.0],
            time_s: 3.0,
            rise_sd_mps2: [0.0; 3],
        };
        for k in 0..1000 {
            let noise = random.normals(0.02);
            let bias = truth.at(f64::from(k) * 0.01);
            filter
                .push(&UnitSample {
                    step_s: 0.01,
                    force_mps2: [noise[0] + bias[0], noise[1], 9.80665 + noise[2]],
                    field_ut: None,
                    rate_rad_s: Some([0.0; 3]),
                })
                .unwrap();
        }
        let state = filter.state();
        (state.position_m[0].abs(), state.position_sd_m())
    };
    let known = |sd: f64| {
        Drift {
            rise_mps2: [0.4, 0.0, 0.0],
            start_mps2: [0.0; 3],
            time_s: 3.0,
            rise_sd_mps2: [sd; 3],
        }
        .settling()
    };
    let (wrong, _) = run(None);
    let (right, sd) = run(Some(known(0.0)));
    let (_, doubted) = run(Some(known(1.0)));
    assert!(right < 0.3 * wrong, "{right} {wrong}");
    assert!(doubted > 1.02 * sd, "{doubted} {sd}");
}

#[test]
fn a_rise_that_is_wrong_by_its_deviation_is_found_at_rests_with_motion_between() {
    let (rise, sd) = ([0.08, -0.05, 0.06], 0.02);
    let (mut squares, mut count) = (0.0, 0);
    for seed in 0..trials(1000) as u64 {
        let mut random = Random::new(seed);
        let wrong = [0, 1, 2].map(|i| rise[i] + random.normal() * sd);
        let truth = Drift {
            rise_mps2: rise,
            start_mps2: [0.0; 3],
            time_s: 60.0,
            rise_sd_mps2: [0.0; 3],
        }
        .settling();
        let mut filter = UnitFilter::new(UnitConfig {
            drift: Some(Drift {
                rise_mps2: wrong,
                rise_sd_mps2: [sd; 3],
                ..truth
            }),
            ..UnitConfig::default()
        });
        for k in 0..10_000 {
            let t = f64::from(k) * 0.02;
            let noise = random.normals(0.02);
            let bias = truth.at(t);
            // Twenty seconds of rest, ten of motion to and fro.
            let swing = if t % 30.0 < 20.0 {
                0.0
            } else {
                (std::f64::consts::TAU * t).sin()
            };
            filter
                .push(&UnitSample {
                    step_s: 0.02,
                    force_mps2: [
                        noise[0] + bias[0] + swing,
                        noise[1] + bias[1],
                        9.80665 + noise[2] + bias[2],
                    ],
                    field_ut: None,
                    rate_rad_s: Some(random.normals(1e-3)),
                })
                .unwrap();
        }
        for (i, (found, doubt)) in filter.state().rise_mps2.into_iter().enumerate() {
            // A level rise looks like a tilt, but for its curve.
            let most = if i == 2 { 0.2 } else { 0.8 };
            assert!(doubt < most * sd, "axis {i}: ± {doubt}");
            squares += ((found - rise[i]) / doubt).powi(2);
            count += 1;
        }
    }
    let ratio = f64::sqrt(squares / f64::from(count));
    figure(
        "wrong warm-up found at rests: rms error over the stated one",
        format!("{ratio:.2}"),
        "0.5 to 1.5",
        (0.5..=1.5).contains(&ratio),
    );
    assert!(
        rms_ratio_can_be(ratio, count as usize, 0.5..=1.5),
        "{ratio}"
    );
}
