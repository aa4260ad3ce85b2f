//! The Allan deviation against a direct computation, and against noise that is known.

mod common;

use common::Random;
use proptest::prelude::*;
use wimu_calib::{AllanVariance, AxisNoise, NoiseRefusal};

fn run(rate_hz: f64, samples: &[[f64; 3]]) -> AllanVariance {
    let mut allan = AllanVariance::new(rate_hz);
    for sample in samples {
        allan.push(*sample);
    }
    allan
}

/// The definition, from cluster means over stored samples: every start, or every `stride`-th.
fn direct(x: &[f64], m: usize, stride: usize) -> f64 {
    let mean = |from: usize| x[from..from + m].iter().sum::<f64>() / m as f64;
    // The streaming sum begins before the first sample: clusters start at multiples of the stride.
    let starts: Vec<usize> = (0..)
        .step_by(stride)
        .take_while(|k| k + 2 * m <= x.len())
        .collect();
    let squares: f64 = starts
        .iter()
        .map(|&k| (mean(k + m) - mean(k)).powi(2))
        .sum();
    (squares / (2.0 * starts.len() as f64)).sqrt()
}

proptest! {
    #![proptest_config(proptest::test_runner::Config { cases: 24, ..common::config() })]

    #[test]
    fn the_deviation_is_that_of_its_definition(seed: u64, n in 500_usize..3000) {
        let mut random = Random(seed);
        let samples: Vec<[f64; 3]> = (0..n).map(|k| {
            let drift = 1e-4 * k as f64;
            [random.normal() + drift, 5.0 + 0.1 * random.normal(), -9.81 + 0.01 * random.normal()]
        }).collect();
        let allan = run(50.0, &samples);
        let mut lengths = Vec::new();
        for point in allan.points() {
            let m = (point.tau_s * 50.0).round() as usize;
            lengths.push(m);
            let stride = (m / 8).max(1);
            for axis in 0..3 {
                let column: Vec<f64> = samples.iter().map(|s| s[axis]).collect();
                let expected = direct(&column, m, stride);
                let found = point.deviation_mps2[axis];
                prop_assert!((found - expected).abs() < 1e-9 * expected, "{m} {found} {expected}");
            }
        }
        prop_assert!(lengths.starts_with(&[1, 2, 4, 8, 16, 32]));
    }
}

const RATE: f64 = 100.0;

/// White noise, flicker noise, and a random walk.
///
/// Flicker noise is a sum of 20 relaxations with time constants τ_k an octave apart, each of
/// variance v. One has the density 4 v τ / (1 + (2π f τ)²); a sum over octaves of it is flat in
/// ln f: v / (f ln 2) one-sided between the corners. Flicker noise of density h/f has Allan variance
/// 2 ln 2 · h, and B² is π h.
fn noise(random: &mut Random, n: usize, white: f64, bias: f64, walk: f64) -> Vec<f64> {
    let sd = bias * (std::f64::consts::LN_2 / std::f64::consts::PI).sqrt();
    let octaves = if bias > 0.0 { 20 } else { 0 };
    let mut states: Vec<(f64, f64, f64)> = (0..octaves)
        .map(|octave| {
            let keep = (-1.0 / (0.25 * f64::from(1 << octave))).exp();
            (keep, (1.0 - keep * keep).sqrt(), random.normal())
        })
        .collect();
    let mut position = 0.0;
    (0..n)
        .map(|_| {
            let mut sum = white * random.normal();
            if walk > 0.0 {
                position += walk * random.normal();
            }
            for (keep, new, state) in &mut states {
                *state = *keep * *state + *new * random.normal();
                sum += sd * *state;
            }
            sum + position
        })
        .collect()
}

/// Three independent axes of it.
fn of(random: &mut Random, n: usize, white: f64, bias: f64, walk: f64) -> [AxisNoise; 3] {
    let axes = [0; 3].map(|_| noise(random, n, white, bias, walk));
    let mut allan = AllanVariance::new(RATE);
    for k in 0..n {
        allan.push([axes[0][k], axes[1][k], axes[2][k]]);
    }
    allan.result().expect("noise")
}

#[test]
fn white_noise_is_found_within_its_intervals() {
    let (mut held, mut others) = (0, 0);
    for seed in 0..150 {
        for found in of(&mut Random(seed), 8_000, 0.02, 0.0, 0.0) {
            let walk = found.velocity_random_walk;
            held += u32::from((walk.value - 0.002).abs() <= 1.96 * walk.sd);
            let more = [found.bias_instability_mps2, found.acceleration_random_walk];
            others += u32::from(more.iter().any(Option::is_some));
        }
    }
    let percent = 100.0 * f64::from(held) / 450.0;
    println!("white noise: {percent:.1} % held, another noise claimed in {others} of 450");
    assert!((93.0..=97.5).contains(&percent), "{percent}");
    assert!(others <= 22, "{others}");
}

#[test]
fn flicker_noise_and_a_random_walk_are_found_within_their_intervals() {
    let (mut bias, mut seen, mut white) = (0, 0, 0);
    let (mut walk, mut walks) = (0, 0);
    for seed in 0..20 {
        for found in of(&mut Random(seed), 60_000, 0.02, 0.003, 0.0) {
            let n = found.velocity_random_walk;
            white += u32::from((n.value - 0.002).abs() <= 2.1 * n.sd);
            if let Some(b) = found.bias_instability_mps2 {
                seen += 1;
                bias += u32::from((b.value - 0.003).abs() <= 2.1 * b.sd);
            }
        }
        for found in of(&mut Random(seed + 1000), 60_000, 0.02, 0.0, 1e-4) {
            if let Some(k) = found.acceleration_random_walk {
                walks += 1;
                // 10⁻⁴ a sample is 10⁻⁴ · √100 m/s²/√s.
                walk += u32::from((k.value - 1e-3).abs() <= 2.1 * k.sd);
            }
        }
    }
    println!(
        "flicker: seen {seen}, held {bias}; white beside it held {white}; walk: seen {walks}, held {walk}; of 60"
    );
}

#[test]
fn what_is_no_rest_is_refused_with_the_time() {
    let mut random = Random(3);
    let mut rest = |n: usize| -> Vec<[f64; 3]> {
        (0..n)
            .map(|_| [0.0, 0.0, 9.81].map(|f| f + 0.02 * random.normal()))
            .collect()
    };
    let mut tilted = rest(6000);
    for sample in &mut tilted[4000..] {
        sample[0] += 0.3;
    }
    let mut knocked = rest(6000);
    for (k, sample) in knocked[2500..2600].iter_mut().enumerate() {
        sample[1] += 0.5 * (k as f64).sin();
    }
    for (samples, from, to, moved) in [(tilted, 39.0, 61.0, 0), (knocked, 24.0, 27.0, 1)] {
        match run(RATE, &samples).result() {
            Err(NoiseRefusal::NotAtRest { at_s, axis }) => {
                assert_eq!(axis, moved);
                assert!((from..to).contains(&at_s), "{at_s}");
            }
            other => panic!("{other:?}"),
        }
    }
    let short = run(RATE, &rest(100)).result();
    assert_eq!(
        short,
        Err(NoiseRefusal::TooShort {
            have: 100,
            need: 500
        })
    );
    let mut dead = rest(6000);
    for sample in &mut dead {
        sample[2] = 9.81;
    }
    assert_eq!(
        run(RATE, &dead).result(),
        Err(NoiseRefusal::Dead { axis: 2 })
    );
    // Samples that are none are gaps: no cluster spans one.
    let mut gaps = rest(6000);
    for k in (0..6000).step_by(1000) {
        gaps[k] = [f64::NAN; 3];
    }
    let allan = run(RATE, &gaps);
    assert_eq!(allan.samples(), 5994);
    assert!(allan.result().is_ok());
    assert!(allan.points().all(|point| point.tau_s < 3.4));
    assert!(matches!(
        run(0.0, &[]).result(),
        Err(NoiseRefusal::TooShort { have: 0, .. })
    ));
}
