//! No filter reports a number that is not finite as usable, whatever samples it is given.

use nalgebra::Vector3;
use proptest::prelude::*;
use wimu_nav::array::{ArrayConfig, ArrayFilter};
use wimu_nav::navigator::{Motion, Navigator, Profile, Rests, Sample, Settings, Start};
use wimu_nav::stationarity::{RestDetector, RestLimits};
use wimu_testkit::{Lane, Random};

/// A stretch of motion, in which every sample has a direction of its own.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    samples: usize,
    step_s: f64,
    /// Acceleration, m/s², angular rate, rad/s, and what the magnetic field departs by, µT.
    push_mps2: f64,
    rate_rad_s: Option<f64>,
    field_ut: Option<f64>,
}

/// From 10^low to 10^high, each magnitude as often.
fn magnitude(low: f64, high: f64) -> impl Strategy<Value = f64> {
    prop_oneof![
        2 => Just(0.0),
        8 => (low..high).prop_map(|exponent| 10_f64.powf(exponent)),
        1 => prop::sample::select(vec![1e100, 1e308, f64::INFINITY, f64::NAN]),
    ]
}

fn stretch() -> impl Strategy<Value = Stretch> {
    let step = prop_oneof![8 => Just(0.01), 2 => (-6.0..1.0).prop_map(|e: f64| 10_f64.powf(e))];
    let optional = |high| prop::option::of(magnitude(-3.0, high));
    (1..150_usize, step, magnitude(-2.0, 6.0), optional(6.0), optional(6.0)).prop_map(
        |(samples, step_s, push_mps2, rate_rad_s, field_ut)| Stretch {
            samples,
            step_s,
            push_mps2,
            rate_rad_s,
            field_ut,
        },
    )
}

fn stretches() -> impl Strategy<Value = (u64, Vec<Stretch>)> {
    // A rest first, or nothing is ever valid.
    (any::<u64>(), prop::collection::vec(stretch(), 1..8)).prop_map(|(seed, mut all)| {
        all.insert(
            0,
            Stretch {
                samples: 150,
                step_s: 0.01,
                push_mps2: 0.01,
                rate_rad_s: all[0].rate_rad_s.map(|_| 1e-3),
                field_ut: all[0].field_ut.map(|_| 0.1),
            },
        );
        (seed, all)
    })
}

fn samples(seed: u64, all: &[Stretch]) -> Vec<Sample> {
    let mut random = Random::new(seed);
    let mut samples = Vec::new();
    for stretch in all {
        for _ in 0..stretch.samples {
            let mut vector = |size: f64| Vector3::from([0; 3].map(|_| random.within(size)));
            let force = vector(stretch.push_mps2);
            let field = stretch.field_ut.map(&mut vector);
            samples.push(Sample {
                step_s: stretch.step_s,
                force_mps2: force + Vector3::new(0.0, 0.0, 9.80665),
                field_ut: field.map(|field| field + Vector3::new(0.0, 20.0, -44.0)),
                rate_rad_s: stretch.rate_rad_s.map(&mut vector),
            });
        }
    }
    samples
}

/// Pushes all samples: every solution is finite, and after a divergence the position is unknown to more than 1 km.
fn of_unit(settings: Settings, samples: &[Sample]) -> Result<u32, TestCaseError> {
    let start = Start::align(&samples[..50], true).expect("the first stretch is a rest");
    let mut navigator = Navigator::new(settings, &start);
    let mut detector = RestDetector::new(RestLimits::default());
    for sample in samples {
        let rate = sample.rate_rad_s.as_ref();
        let rest = detector.push(&sample.force_mps2, rate, sample.step_s);
        let before = navigator.divergences();
        let _ = navigator.push(sample, rest);
        prop_assert!(navigator.filter().is_sound());
        let state = navigator.solution();
        let vectors = [state.position_m, state.velocity_mps];
        let covariances =
            [state.position_covariance, state.velocity_covariance, state.attitude_covariance];
        let numbers = vectors.iter().flatten().chain(&state.quaternion);
        let mut numbers = numbers.chain(covariances.iter().flatten().flatten());
        prop_assert!(numbers.all(|v| v.is_finite()), "{state:?}");
        let norm: f64 = state.quaternion.iter().map(|q| q * q).sum();
        prop_assert!((norm - 1.0).abs() < 1e-3, "{state:?}");
        for p in &covariances {
            prop_assert!((0..3).all(|i| p[i][i] >= 0.0), "{state:?}");
        }
        if navigator.divergences() > before {
            let p = state.position_covariance;
            prop_assert!((0..3).all(|i| p[i][i] > 1e6), "{state:?}");
        }
    }
    Ok(navigator.divergences())
}

/// With a gyroscope, and without.
fn of_units(profile: Profile, rests: Rests, samples: &[Sample]) -> Result<u32, TestCaseError> {
    let mut settings = Settings::of(profile);
    settings.rests = rests;
    let with = of_unit(settings, samples)?;
    settings.motion = Motion::NoGyroscope;
    Ok(with + of_unit(settings, samples)?)
}

fn of_array(rests: Rests, samples: &[Sample]) -> Result<(), TestCaseError> {
    let board = crate::common::board(0.005, 0.01);
    let config = ArrayConfig { rests, ..ArrayConfig::default() };
    let mut filter = ArrayFilter::new(board, config).unwrap();
    for sample in samples {
        let turn = sample.rate_rad_s.unwrap_or_default();
        // What all sensors feel, and what each feels besides.
        let output: [f64; 24] = core::array::from_fn(|k| {
            sample.force_mps2[k % 3] + turn[(k / 3) % 3] * (k as f64 - 12.0)
        });
        let _ = filter.push(sample.step_s, &output);
        let state = filter.state();
        let numbers = state.position_m.iter().chain(&state.velocity_mps);
        let mut numbers = numbers
            .chain(&state.rate_rad_s)
            .chain(&state.quaternion)
            .chain(state.position_covariance.iter().flatten());
        let finite = numbers.all(|v| v.is_finite());
        prop_assert!(finite || !state.valid, "{state:?}");
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: Lane::current().choose([3, 5, 1000]), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_solution_of_a_navigator_is_finite((seed, all) in stretches()) {
        let samples = samples(seed, &all);
        for (profile, rests) in [
            (Profile::Hand, Rests::ZeroVelocity),
            (Profile::Foot, Rests::ConstantVelocity),
            (Profile::Free, Rests::Ignored),
        ] {
            of_units(profile, rests, &samples)?;
        }
    }

    #[test]
    fn no_state_of_an_array_that_is_not_finite_is_valid((seed, all) in stretches()) {
        let samples = samples(seed, &all);
        for rests in [Rests::ConstantVelocity, Rests::ZeroVelocity, Rests::Ignored] {
            of_array(rests, &samples)?;
        }
    }
}

#[test]
fn huge_rates_and_forces_are_a_divergence() {
    let seeds = Lane::current().choose([2, 5, 50]);
    let mut found = 0;
    for (push_mps2, rate_rad_s) in [(1e4, 1e3), (1e6, 1e6), (20.0, 1e150), (1e150, 1.0)] {
        let wild = Stretch {
            samples: 400,
            step_s: 0.01,
            push_mps2,
            rate_rad_s: Some(rate_rad_s),
            field_ut: Some(60.0),
        };
        let at_rest = Stretch {
            samples: 150,
            push_mps2: 0.01,
            rate_rad_s: Some(1e-3),
            field_ut: Some(0.1),
            ..wild
        };
        for seed in 0..seeds {
            let samples = samples(seed, &[at_rest, wild, at_rest]);
            found += of_units(Profile::Hand, Rests::ZeroVelocity, &samples).unwrap();
            found += of_units(Profile::Free, Rests::ZeroVelocity, &samples).unwrap();
        }
    }
    // Eight runs of each seed.
    assert!(u64::from(found) > 2 * seeds, "{found}");
}
