//! No filter says that a state is valid which is not a number, whatever it is given.

use proptest::prelude::*;
use wimu_nav::array::{ArrayConfig, ArrayFilter, Geometry};
use wimu_nav::slide::{Rest, Slide, SlideConfig};
use wimu_nav::unit::{UnitConfig, UnitFilter, UnitSample};
use wimu_nav::{Real, Zupt};
use wimu_testkit::{Lane, Random, trials};

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
    (
        1..150_usize,
        step,
        magnitude(-2.0, 6.0),
        optional(6.0),
        optional(6.0),
    )
        .prop_map(
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

fn samples(seed: u64, all: &[Stretch]) -> Vec<UnitSample> {
    let mut random = Random::new(seed);
    let mut samples = Vec::new();
    for stretch in all {
        for _ in 0..stretch.samples {
            let mut vector = |size: f64| [0; 3].map(|_| random.within(size));
            let [x, y, z] = vector(stretch.push_mps2);
            let field = stretch.field_ut.map(&mut vector);
            samples.push(UnitSample {
                step_s: stretch.step_s,
                force_mps2: [x, y, 9.80665 + z],
                field_ut: field.map(|[x, y, z]| [x, 20.0 + y, z - 44.0]),
                rate_rad_s: stretch.rate_rad_s.map(&mut vector),
            });
        }
    }
    samples
}

fn narrow<R: Real>(v: [f64; 3]) -> [R; 3] {
    v.map(R::from_f64)
}

fn of_unit<R: Real>(config: UnitConfig, samples: &[UnitSample]) -> Result<(), TestCaseError> {
    let mut filter = UnitFilter::<R>::new(config);
    for sample in samples {
        let _ = filter.push(&UnitSample {
            step_s: R::from_f64(sample.step_s),
            force_mps2: narrow(sample.force_mps2),
            field_ut: sample.field_ut.map(narrow),
            rate_rad_s: sample.rate_rad_s.map(narrow),
        });
        let state = filter.state();
        let variances = [0, 1, 2].map(|i| state.position_covariance[i][i]);
        let numbers = state.position_m.iter().chain(&state.velocity_mps);
        let mut numbers = numbers.chain(&state.quaternion).chain(&variances);
        let finite = numbers.all(|v| v.is_finite());
        prop_assert!(finite || !(state.valid || state.at_origin), "{state:?}");
        let sd = state.position_sd_m();
        let known = variances.iter().all(|v| v.is_finite());
        prop_assert!(known || !sd.is_finite(), "{variances:?} is no {sd:?}");
    }
    Ok(())
}

fn of_array<R: Real>(zupt: Zupt, samples: &[UnitSample]) -> Result<(), TestCaseError> {
    let board = Geometry::<24>::eight_triads_board(0.02, 0.005, 0.01).unwrap();
    let config = ArrayConfig {
        zupt,
        range_mps2: 1e6,
        ..ArrayConfig::default()
    };
    let mut filter = ArrayFilter::<R, 24>::new(board, config).unwrap();
    for sample in samples {
        let turn = sample.rate_rad_s.unwrap_or_default();
        // What all sensors feel, and what each feels besides.
        let output = core::array::from_fn(|k| {
            R::from_f64(sample.force_mps2[k % 3] + turn[(k / 3) % 3] * (k as f64 - 12.0))
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

/// Cases of each property.
fn cases() -> u32 {
    if Lane::current() == Lane::Campaign {
        1000
    } else {
        trials(64) as u32
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_state_of_a_unit_that_is_not_finite_is_valid((seed, all) in stretches()) {
        let samples = samples(seed, &all);
        for zupt in [Zupt::Assumed, Zupt::Stated, Zupt::Off] {
            let config = UnitConfig { zupt, ..UnitConfig::default() };
            of_unit::<f64>(config, &samples)?;
            of_unit::<f32>(config, &samples)?;
        }
    }

    #[test]
    fn no_state_of_an_array_that_is_not_finite_is_valid((seed, all) in stretches()) {
        let samples = samples(seed, &all);
        for zupt in [Zupt::Assumed, Zupt::Stated, Zupt::Off] {
            of_array::<f64>(zupt, &samples)?;
        }
        of_array::<f32>(Zupt::Assumed, &samples)?;
    }

    #[test]
    fn a_slide_takes_no_sample_that_makes_its_numbers_none((seed, all) in stretches()) {
        let rest = |rate: Option<f64>| Rest {
            force_mps2: [0.0, 0.0, 9.80665],
            sd_mps2: 0.01,
            rate_rad_s: rate.map(|_| [0.0; 3]),
        };
        let rest = rest(all[0].rate_rad_s);
        let mut slide = Slide::new(SlideConfig::default(), rest);
        for sample in samples(seed, &all) {
            slide.push(sample.step_s, sample.force_mps2, sample.rate_rad_s);
        }
        let done = slide.finish(rest);
        let mut numbers = done.displacement_m.iter().chain([&done.length_m, &done.length_sd_m]);
        prop_assert!(numbers.all(|v| v.is_finite()), "{done:?}");
    }
}

#[test]
fn a_filter_that_diverged_says_so_and_its_deviation_is_not_zero() {
    // Violently shaken, with a magnetic field of any direction: what nothing explains drives the rate away.
    let shaken = Stretch {
        samples: 4000,
        step_s: 0.0091,
        push_mps2: 20.0,
        rate_rad_s: None,
        field_ut: Some(60.0),
    };
    let at_rest = Stretch {
        samples: 150,
        push_mps2: 0.01,
        field_ut: Some(0.1),
        ..shaken
    };
    let config = UnitConfig {
        zupt: Zupt::Stated,
        ..UnitConfig::default()
    };
    for seed in 0..trials(1000) as u64 {
        let samples = samples(seed, &[at_rest, shaken]);
        of_unit::<f32>(config, &samples).unwrap();
        of_unit::<f64>(config, &samples).unwrap();
    }
}
