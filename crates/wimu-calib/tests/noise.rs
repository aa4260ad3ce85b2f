//! The Allan deviation against a direct computation, and against noise that is known.

use std::ops::RangeInclusive;

use crate::common;

use common::Random;
use wimu_calib::{AllanVariance, Measured, Reason, Refusal, UnitHint};
use wimu_testkit::{Coverage, Lane, coverage_figure, draws};

fn run(rate_hz: f64, samples: &[[f64; 3]]) -> AllanVariance {
    let mut allan = AllanVariance::new(rate_hz);
    for sample in samples {
        allan.push(*sample);
    }
    allan
}

/// What `allantools.oadev` 2024.06 (PyPI), data of frequency, says of the same numbers. Up to eight samples
/// it takes the same differences; beyond it takes all of them, and ours every (m/8)-th.
#[test]
fn the_deviation_is_that_of_allantools() {
    let samples: Vec<[f64; 3]> = (0..4000_u64)
        .map(|k| {
            let x = ((k * k * 7919 + k * 104_729) % 1009) as f64 / 1009.0;
            [x + (k % 1500) as f64 * 1e-4, 0.0, 0.0]
        })
        .collect();
    let expected = [
        (1, 0.301478181434),
        (2, 0.206617597957),
        (4, 0.131566799185),
        (8, 0.107853191289),
        (16, 0.078219350444),
        (32, 0.051999250508),
        (64, 0.030196154117),
        (128, 0.032351890646),
        (256, 0.032122513529),
    ];
    let allan = run(50.0, &samples);
    for (point, (m, deviation)) in allan.points().zip(expected) {
        assert_eq!((point.tau_s * 50.0).round() as u32, m);
        let off = point.deviation_mps2[0] / deviation - 1.0;
        assert!(off.abs() < if m <= 8 { 1e-9 } else { 0.02 }, "{m}: {off}");
    }
}

/// N of `static/mpu6050_449s.csv` by `allantools.oadev` 2024.06: median of σ √τ from 0.01 to 2.56 s, counts √s.
#[test]
fn the_random_walk_of_a_recording_is_that_of_allantools() {
    let Some(rows) = common::recording("static/mpu6050_449s.csv") else {
        return;
    };
    let scale = 9.80665 / 16384.0;
    let samples: Vec<[f64; 3]> = rows.iter().map(|row| common::vector(row, 1, scale)).collect();
    let found = run(RATE, &samples).result().expect("noise");
    for (axis, counts) in found.into_iter().zip([5.319, 4.946, 7.532]) {
        let ratio = axis.velocity_random_walk.value / (counts * scale);
        assert!((ratio - 1.0).abs() < 0.03, "{ratio}");
    }
}

const RATE: f64 = 100.0;

/// What is simulated: σ of white noise a sample, m/s², flicker noise B, m/s², and σ of the steps of a
/// random walk a sample, m/s².
#[derive(Clone, Copy)]
struct Truth {
    white: f64,
    flicker: f64,
    walk: f64,
}

/// A relaxation process of variance 1 with a time constant of `tau` samples, and its mean over each
/// sample period.
struct Relaxation {
    /// What state and mean keep of the state before, and their own noise: the state's, and the mean's
    /// with and without it.
    keep: [f64; 2],
    new: [f64; 3],
    /// Number of samples between movements.
    every: usize,
    state: f64,
    mean: f64,
}

impl Relaxation {
    fn new(tau: f64, random: &mut Random) -> Self {
        // Slow ones move on sixteen times in a time constant.
        let every = (tau / 16.0).max(1.0) as usize;
        let tau = tau / every as f64;
        let rho = (-1.0 / tau).exp();
        let state = (1.0 - rho * rho).sqrt();
        let both = tau * (1.0 - rho) * (1.0 - rho) / state;
        let mean = tau * tau * (2.0 / tau - 3.0 + 4.0 * rho - rho * rho);
        Self {
            keep: [rho, tau * (1.0 - rho)],
            new: [state, both, (mean - both * both).max(0.0).sqrt()],
            every,
            state: random.normal(),
            mean: 0.0,
        }
    }

    fn next(&mut self, k: usize, random: &mut Random) -> f64 {
        if k.is_multiple_of(self.every) {
            let [own, other] = [random.normal(), random.normal()];
            self.mean = self.keep[1] * self.state + self.new[1] * own + self.new[2] * other;
            self.state = self.keep[0] * self.state + self.new[0] * own;
        }
        self.mean
    }
}

/// Flicker noise is a sum of relaxations with time constants τ_k an octave apart, each of variance v,
/// averaged over each sample period as σ(τ) has it. One has the density 4 v τ / (1 + (2π f τ)²); a sum
/// over octaves of it is flat in ln f: v / (f ln 2) one-sided between the corners. Flicker noise of
/// density h/f has Allan variance 2 ln 2 · h, and B² is π h.
fn noise(random: &mut Random, n: usize, truth: Truth) -> Vec<f64> {
    let variance = truth.flicker.powi(2) * std::f64::consts::LN_2 / std::f64::consts::PI;
    let octaves = if truth.flicker > 0.0 { -3..18 } else { 0..0 };
    let mut relaxations: Vec<_> =
        octaves.map(|octave| Relaxation::new(2_f64.powi(octave), random)).collect();
    // The mean of a fast one is white noise of variance 2 τ: here are those of 1/16 and less.
    let white = (truth.white.powi(2) + variance / 4.0).sqrt();
    let mut position = 0.0;
    (0..n)
        .map(|k| {
            if truth.walk > 0.0 {
                position += truth.walk * random.normal();
            }
            let flicker: f64 = relaxations.iter_mut().map(|r| r.next(k, random)).sum();
            white * random.normal() + variance.sqrt() * flicker + position
        })
        .collect()
}

/// How often a term was reported, and how often its 95 % interval then held the truth.
#[derive(Clone, Copy, Default)]
struct Term {
    seen: Coverage,
    held: Coverage,
}

impl Term {
    fn take(&mut self, found: Option<Measured>, truth: f64) {
        self.seen.count(found.is_some());
        if let Some(found) = found {
            let [low, high] = found.interval_95();
            self.held.count((low..=high).contains(&truth));
        }
    }
}

/// Simulated recordings, three axes each: `axes` of them in a campaign. Counts are judged together of four or more kinds.
fn recordings(axes: usize) -> u64 {
    draws(axes.div_ceil(3), 12) as u64
}

/// N, B and K of each axis.
fn coverage(axes: usize, n: usize, truth: Truth) -> [Term; 3] {
    let mut terms = [Term::default(); 3];
    for seed in 0..recordings(axes) {
        let mut random = Random::new(seed + 1_000_003 * n as u64);
        let axes = [0; 3].map(|_| noise(&mut random, n, truth));
        let mut allan = AllanVariance::new(RATE);
        for k in 0..n {
            allan.push([axes[0][k], axes[1][k], 9.81 + axes[2][k]]);
        }
        for found in allan.result().expect("noise") {
            let root = RATE.sqrt();
            terms[0].take(Some(found.velocity_random_walk), truth.white / root);
            terms[1].take(found.bias_instability_mps2, truth.flicker);
            terms[2].take(found.acceleration_random_walk, truth.walk * root);
        }
    }
    let [white, b, k] = terms.map(|term| term.held);
    println!("{:.0} s: N held {white}, B {b}, K {k}", n as f64 / RATE);
    terms
}

const WHITE: Truth = Truth { white: 0.02, flicker: 0.0, walk: 0.0 };
const FLICKER: Truth = Truth { flicker: 0.003, ..WHITE };
const WALK: Truth = Truth { walk: 1e-4, ..WHITE };

/// Asserts a fraction of each kind, and of all of them together, which shows a smaller fault.
fn assert_each_can_be(kinds: Vec<Coverage>, range: RangeInclusive<f64>, what: &str) {
    for kind in &kinds {
        kind.assert_can_be(range.clone(), what);
    }
    kinds.into_iter().sum::<Coverage>().assert_can_be(range, what);
}

/// Whether intervals of terms that are there hold the truth as often as they say, and a term that is
/// not there is hardly ever claimed.
fn assert_consistent(length: &str, axes: usize, kinds: &[(usize, Truth)]) {
    let (mut held, mut claimed) = (Vec::new(), Vec::new());
    for &(n, truth) in kinds {
        let there = [truth.white, truth.flicker, truth.walk].map(|size| size > 0.0);
        for (term, there) in coverage(axes, n, truth).into_iter().zip(there) {
            if there {
                held.push(term.held);
            } else {
                claimed.push(term.seen);
            }
        }
    }
    let claim = format!("95 % intervals of N, B and K hold the truth, {length}");
    coverage_figure(&claim, &held, 0.90..=0.98);
    let claim = format!("a noise term that is not there is claimed, {length}");
    coverage_figure(&claim, &claimed, 0.0..=0.01);
    assert_each_can_be(held, 0.90..=0.98, length);
    assert_each_can_be(claimed, 0.0..=0.01, length);
}

#[test]
fn intervals_hold_the_truth_95_percent_of_the_time() {
    let kinds = [(1_000, WHITE), (8_000, WHITE), (12_000, FLICKER), (12_000, WALK)];
    assert_consistent("10 to 120 s", 1002, &kinds);
}

#[test]
#[ignore = "minutes: cargo xtask campaign calibration"]
fn intervals_of_long_recordings_hold_the_truth() {
    assert_consistent("600 s", 1002, &[WHITE, FLICKER, WALK].map(|t| (60_000, t)));
}

#[test]
fn hum_is_no_noise_and_samples_that_come_twice_are_of_half_the_rate() {
    let mut random = Random::new(11);
    let mut rest = || [0.0, 0.0, 9.81].map(|f| f + 0.02 * random.normal());
    let plain: Vec<_> = (0..20_000).map(|_| rest()).collect();
    let mut hum = plain.clone();
    for (k, sample) in hum.iter_mut().enumerate() {
        sample[0] += 0.1 * (k as f64 * 0.46).sin();
    }
    let twice: Vec<_> = (0..20_000).map(|k| plain[k / 2]).collect();
    let half = 0.02 / (RATE / 2.0).sqrt();
    for (samples, noise, white, filtered) in [
        (plain, [true; 3], 0.02 / RATE.sqrt(), false),
        (hum, [false, true, true], 0.02 / RATE.sqrt(), false),
        (twice, [true; 3], half, true),
    ] {
        let found = run(RATE, &samples).result().expect("noise");
        let misfits = found.map(|axis| axis.misfit);
        assert_eq!(found.map(|axis| axis.is_noise()), noise, "{misfits:?}");
        for axis in found {
            assert_eq!(axis.white_from_s.is_some(), filtered, "{axis:?}");
            let walk = axis.velocity_random_walk;
            assert!(!axis.is_noise() || (walk.value - white).abs() < 4.0 * walk.sd);
        }
    }
}

/// A low-pass filter of equal stages, each with a cut-off of `cut_off` in samples⁻¹; N stays.
fn filtered(random: &mut Random, n: usize, stages: usize, cut_off: f64) -> Vec<f64> {
    let keep = (-std::f64::consts::TAU * cut_off).exp();
    let mut states = vec![0.0; stages];
    let mut next = || {
        let mut value = 0.02 * random.normal();
        for state in &mut states {
            *state = keep * *state + (1.0 - keep) * value;
            value = *state;
        }
        value
    };
    for _ in 0..1000 {
        next();
    }
    (0..n).map(|_| next()).collect()
}

#[test]
fn a_filtered_output_has_the_noise_density_that_it_has_below_its_bandwidth() {
    let n = Lane::current().choose([10_000, 10_000, 30_000]);
    let truth = 0.02 / RATE.sqrt();
    let mut all_held = Vec::new();
    for (stages, cut_off) in [(1, 0.2), (1, 0.1), (1, 0.05), (2, 0.1), (4, 0.1), (4, 0.2)] {
        let (mut white, mut ratios) = (Term::default(), Vec::new());
        let mut reported = Coverage::default();
        for seed in 0..recordings(300) {
            let mut random = Random::new(seed);
            let axes = [0; 3].map(|_| filtered(&mut random, n, stages, cut_off));
            let mut allan = AllanVariance::new(RATE);
            for k in 0..n {
                allan.push([axes[0][k], axes[1][k], 9.81 + axes[2][k]]);
            }
            for found in allan.result().expect("noise") {
                let walk = found.velocity_random_walk;
                white.take(Some(walk), truth);
                ratios.push(walk.value / truth);
                reported.count(found.white_from_s.is_some() && found.is_noise());
            }
        }
        ratios.sort_by(f64::total_cmp);
        let middle = ratios[ratios.len() / 2];
        let name = format!("{stages} stages of {cut_off} of the rate");
        println!("{name}: N {middle:.3} of the true one, held {}, reported {reported}", white.held);
        assert!((0.95..1.05).contains(&middle), "{name}: {middle}");
        reported.assert_can_be(0.9..=1.0, &name);
        all_held.push(white.held);
    }
    let claim = "95 % intervals of N behind low-pass filters hold the truth";
    coverage_figure(claim, &all_held, 0.90..=0.98);
    assert_each_can_be(all_held, 0.90..=0.98, "N");
}

#[test]
fn a_rest_that_is_not_gravity_in_si_is_refused_with_the_unit_it_looks_like() {
    let mut random = Random::new(7);
    let mut rest = |size: f64| {
        let samples: Vec<_> = (0..2000)
            .map(|_| [0.3, -0.2, 0.93].map(|f| size * (f + 0.002 * random.normal())))
            .collect();
        run(RATE, &samples).result()
    };
    for (size, expected) in [
        (1.0, UnitHint::G),
        (9.81 * 9.80665, UnitHint::Mps2TakenForG),
        (1000.0, UnitHint::MilliGOrCounts),
        (16384.0, UnitHint::Counts),
        (0.01, UnitHint::NotGravity),
    ] {
        match rest(size) {
            Err(Refusal { reason: Reason::Unit { hint, .. }, .. }) => assert_eq!(hint, expected),
            other => panic!("{size}: {other:?}"),
        }
    }
    assert!(rest(9.81).is_ok());
}

#[test]
fn counts_coarser_than_the_noise_are_told_from_finer_ones() {
    let mut random = Random::new(8);
    let mut rest = |step: f64| {
        let samples: Vec<_> = (0..5000)
            .map(|_| {
                [0.013, -0.021, 9.81].map(|f| {
                    let y = f + 0.02 * random.normal();
                    if step > 0.0 { (y / step).round() * step } else { y }
                })
            })
            .collect();
        run(RATE, &samples).result().expect("noise")
    };
    for (step, coarse) in [(0.0, false), (0.01, false), (0.06, true)] {
        for axis in rest(step) {
            assert_eq!(axis.is_coarse(), coarse, "{step}: {axis:?}");
            if step > 0.0 {
                assert!((axis.step_mps2 / step - 1.0).abs() < 1e-9, "{axis:?}");
            }
        }
    }
}

#[test]
fn what_is_no_rest_is_refused_with_the_time() {
    let mut random = Random::new(3);
    let mut rest = |n: usize| -> Vec<[f64; 3]> {
        (0..n).map(|_| [0.0, 0.0, 9.81].map(|f| f + 0.02 * random.normal())).collect()
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
            Err(Refusal { reason: Reason::Moved { index }, text }) => {
                assert!(text.contains(["axis X", "axis Y"][moved]), "{text}");
                assert!((from..to).contains(&(index as f64)), "{text}");
            }
            other => panic!("{other:?}"),
        }
    }
    let short = run(RATE, &rest(100)).result();
    assert!(matches!(short, Err(Refusal { reason: Reason::TooFew { have: 100, need: 500 }, .. })));
    let mut dead = rest(6000);
    for sample in &mut dead {
        sample[2] = 9.81;
    }
    assert!(matches!(
        run(RATE, &dead).result(),
        Err(Refusal { reason: Reason::Axis { clipped: false, axis: 2 }, .. })
    ));
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
        Err(Refusal { reason: Reason::TooFew { have: 0, .. }, .. })
    ));
}
