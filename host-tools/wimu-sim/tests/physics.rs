//! The physics behind the registers: noise, quantisation, truth.

use proptest::prelude::*;
use wimu_model::{Counts, STANDARD_GRAVITY_MPS2, SpecificForceMps2};
use wimu_sim::motion::{Motion, Poses, sphere};
use wimu_sim::scene::{Scene, Temperature, World};
use wimu_sim::source::{Conversion, Physics, Source, quantise};
use wimu_sim::truth::{Gauge, SensorTruth};

/// rms of |y| − g, m/s², without noise at the reference temperature, over upward directions of length 1.
fn uncalibrated_rms_mps2(truth: &SensorTruth, up: &[[f64; 3]]) -> f64 {
    let squares = up.iter().map(|direction| {
        let force = SpecificForceMps2(direction.map(|u| u * STANDARD_GRAVITY_MPS2));
        (truth.model.distort(force, None).norm() - STANDARD_GRAVITY_MPS2).powi(2)
    });
    (squares.sum::<f64>() / up.len() as f64).sqrt()
}

fn sample(physics: &mut Physics, index: u64, rate_hz: f64, bits: u32) -> [i16; 3] {
    let conversion =
        Conversion { index, time_s: index as f64 / rate_hz, rate_hz, lsb_per_g: 16384.0, bits };
    let Counts(counts) = physics.acceleration(&conversion).unwrap();
    counts
}

#[test]
fn noise_is_its_density_times_the_root_of_half_the_rate() {
    for rate_hz in [10.0, 100.0, 1344.0] {
        let truth = SensorTruth { noise_mps2_per_rthz: 0.05, ..SensorTruth::ideal() };
        let mut physics = Physics::new(truth, Scene::new(World::default()), 11);
        let n = 20_000;
        let (mut sum, mut squares) = ([0.0; 3], [0.0; 3]);
        for index in 0..n {
            for (axis, count) in sample(&mut physics, index, rate_hz, 16).into_iter().enumerate() {
                let mps2 = f64::from(count) / 16384.0 * STANDARD_GRAVITY_MPS2;
                sum[axis] += mps2;
                squares[axis] += mps2 * mps2;
            }
        }
        let expected = 0.05 * (rate_hz / 2.0).sqrt();
        for axis in 0..2 {
            let mean = sum[axis] / n as f64;
            let rms = (squares[axis] / n as f64 - mean * mean).sqrt();
            assert!((rms / expected - 1.0).abs() < 0.03, "{rms} of {expected}");
        }
    }
}

#[test]
fn the_noise_of_the_random_sensor_is_that_of_the_lsm303agr() {
    // 220 µg/√Hz at 100 Hz and the rounding of 12 bits, in quadrature.
    let truth = SensorTruth { model: Default::default(), ..SensorTruth::random(1, Gauge::Full) };
    let mut physics = Physics::new(truth, Scene::new(World::default()), 5);
    let n = 20_000;
    let squares: f64 = (0..n)
        .map(|index| f64::from(sample(&mut physics, index, 100.0, 12)[0]) / 16384.0)
        .map(|g| g * g)
        .sum();
    let rms = (squares / n as f64).sqrt();
    let expected = (220e-6_f64.powi(2) * 50.0 + (1.0 / 1024.0_f64).powi(2) / 12.0).sqrt();
    assert!((rms / expected - 1.0).abs() < 0.03, "{rms} of {expected}");
}

#[test]
fn full_scale_is_exact_at_every_resolution() {
    for (bits, top) in [(8, 0x7F00), (10, 0x7FC0), (12, 0x7FF0), (16, 0x7FFF)] {
        assert_eq!(quantise(1e9, bits), top);
        assert_eq!(quantise(-1e9, bits), i16::MIN);
    }
}

proptest! {
    #[test]
    fn quantisation_is_to_the_nearest_step_and_left_justified(
        lsb in -32768.0..32767.0_f64, bits in prop::sample::select(vec![8_u32, 10, 12, 16]),
    ) {
        let step = f64::from(1 << (16 - bits));
        let value = f64::from(quantise(lsb, bits));
        prop_assert_eq!(value % step, 0.0);
        let top = 32768.0 - step;
        prop_assert!((value - lsb.min(top)).abs() <= step / 2.0);
    }

    #[test]
    fn random_truth_keeps_its_promises(seed: u64, triangular: bool) {
        let gauge = if triangular { Gauge::LowerTriangular } else { Gauge::Full };
        let truth = SensorTruth::random(seed, gauge);
        let terms = truth.model.terms();
        for row in 0..3 {
            let mg = terms.bias_mps2[row].abs() / STANDARD_GRAVITY_MPS2 * 1e3;
            prop_assert!((50.0..=80.0).contains(&mg));
            for column in 0..3 {
                let value = terms.matrix[row][column];
                if row == column {
                    prop_assert!((value - 1.0).abs() <= 0.04);
                } else {
                    prop_assert!(value.abs() <= 0.0349);
                    prop_assert!(!(triangular && column > row && value != 0.0));
                }
            }
        }
        // Over the sphere, and over the poses that calibrations and their checks use.
        prop_assert!(uncalibrated_rms_mps2(&truth, &sphere(500)) >= 0.4);
        for poses in [
            Poses::six_positions(1.0),
            Poses::twelve_by_hand(seed, 2.0, 1.0),
            Poses::tilts(seed, 1.0),
        ] {
            let up: Vec<_> = poses
                .holds()
                .iter()
                .map(|hold| hold.attitude.to_body([0.0, 0.0, 1.0]))
                .collect();
            prop_assert!(uncalibrated_rms_mps2(&truth, &up) >= 0.4);
        }
    }
}

#[test]
fn samples_follow_the_error_model_at_the_true_temperature() {
    let world = World {
        temperature: Temperature::Step { before_c: 25.0, after_c: 45.0, at_s: 10.0 },
        ..World::default()
    };
    let scene = Scene::new(world);
    scene.play(0.0, std::rc::Rc::new(Poses::tilts(8, 1.0)));
    let truth = SensorTruth { noise_mps2_per_rthz: 0.0, ..SensorTruth::random(8, Gauge::Full) };
    let mut physics = Physics::new(truth, scene.clone(), 8);
    for index in 0..200 {
        let state = scene.state(index as f64 / 10.0);
        let force = wimu_model::SpecificForceMps2(state.specific_force_mps2);
        let celsius = if index < 100 { 2500 } else { 4500 };
        let temperature = Some(wimu_model::CentiCelsius(celsius));
        let expected = truth.model.distort(force, temperature).0;
        for (count, expected) in sample(&mut physics, index, 10.0, 16).into_iter().zip(expected) {
            let lsb = expected / STANDARD_GRAVITY_MPS2 * 16384.0;
            assert!((f64::from(count) - lsb).abs() <= 0.5 + 1e-6);
        }
    }
}

#[test]
fn the_tilts_are_none_of_the_fitted_poses() {
    for seed in 0..100 {
        let up = |poses: &Poses| -> Vec<[f64; 3]> {
            let holds = poses.holds().iter();
            holds.map(|h| h.attitude.to_body([0.0, 0.0, 1.0])).collect()
        };
        let tilts = Poses::tilts(seed, 1.0);
        assert_eq!(tilts.duration(), 19.0);
        let fitted = up(&Poses::six_positions(1.0));
        let near = up(&tilts)
            .iter()
            .filter(|t| fitted.iter().any(|f| (0..3).map(|i| f[i] * t[i]).sum::<f64>() > 0.999))
            .count();
        assert!(near <= 2, "seed {seed}: {near} tilts within 2.6° of a squared position");
    }
}
