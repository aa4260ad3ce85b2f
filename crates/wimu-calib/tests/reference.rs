//! One stream against another, with known truth.

use crate::common;

use common::Random;
use proptest::prelude::*;
use wimu_calib::{NoiseFrom, Reason, ReferenceTransfer, Refusal};
use wimu_testkit::{Coverage, Lane, coverage_figure, draws};

/// A hand's motion about a tilted gravity, m/s².
fn motion(k: usize) -> [f64; 3] {
    let t = k as f64 * 0.01;
    [
        2.0 * (1.3 * t).sin() + 1.5 * (2.9 * t + 1.0).cos() + 1.0,
        2.5 * (0.9 * t + 0.3).sin() - 3.0,
        2.0 * (1.7 * t).cos() + 1.0 * (4.1 * t).sin() + 9.0,
    ]
}

/// Noise with a memory of `memory` samples or none, standard deviation 1.
struct Noise {
    keep: f64,
    last: f64,
}

impl Noise {
    fn new(memory: f64) -> Self {
        let keep = if memory > 0.0 { (-1.0 / memory).exp() } else { 0.0 };
        Self { keep, last: 0.0 }
    }

    fn next(&mut self, random: &mut Random) -> f64 {
        self.last = self.keep * self.last + (1.0 - self.keep * self.keep).sqrt() * random.normal();
        self.last
    }
}

/// Sensors of which two streams are compared.
#[derive(Clone, Copy)]
struct Trial {
    /// Noise of the reference and of the output, m/s², and for how many samples it lasts.
    sd: [f64; 2],
    memory: f64,
    /// What the output's axes see of the reference's others, 1 σ, above the diagonal and below.
    across: [f64; 2],
    /// Held in ten orientations, or moved all the time.
    rests: bool,
}

const PARALLEL: Trial = Trial { sd: [0.03, 0.03], memory: 0.0, across: [0.0; 2], rests: false };

/// Samples of a sensor, at 20 Hz.
const SAMPLES: usize = 640;

/// Simulated sensors of three axes each: `axes` of them in a campaign.
fn sensors(axes: usize) -> u64 {
    draws(axes.div_ceil(3), 3) as u64
}

/// Ten orientations anywhere, 2.2 s in each, 1 s from each to the next.
fn held(random: &mut Random) -> Vec<[f64; 3]> {
    let ups: Vec<[f64; 3]> = (0..11).map(|_| random.direction()).collect();
    (0..SAMPLES)
        .map(|k| {
            let (from, to) = (ups[k / 64], ups[k / 64 + 1]);
            let moved = ((k % 64) as f64 - 44.0).max(0.0) / 20.0;
            let mix: [f64; 3] = std::array::from_fn(|i| from[i] * (1.0 - moved) + to[i] * moved);
            let size = mix.iter().map(|c| c * c).sum::<f64>().sqrt().max(0.1);
            mix.map(|c| 9.81 * c / size)
        })
        .collect()
}

/// How often the 95 % intervals of bias and scale factor hold the truth, and how often an axis is
/// said not to be parallel.
fn coverage(trial: Trial) -> [Coverage; 3] {
    let mut inside = [Coverage::default(); 3];
    for seed in 0..sensors(3000) {
        let mut random = Random::new(seed);
        let mut noises: [_; 6] = std::array::from_fn(|_| Noise::new(trial.memory));
        let matrix: [[f64; 3]; 3] = std::array::from_fn(|row| {
            std::array::from_fn(|column| match column.cmp(&row) {
                std::cmp::Ordering::Equal => 1.0 + random.within(0.04),
                std::cmp::Ordering::Greater => trial.across[0] * random.normal(),
                std::cmp::Ordering::Less => trial.across[1] * random.normal(),
            })
        });
        let bias: [f64; 3] = std::array::from_fn(|_| random.within(0.8));
        let forces: Vec<[f64; 3]> = if trial.rests {
            held(&mut random)
        } else {
            (0..SAMPLES).map(|k| motion(5 * k)).collect()
        };
        let mut transfer = ReferenceTransfer::new();
        for force in forces {
            let mut of = |k: usize| trial.sd[k / 3] * noises[k].next(&mut random);
            let reference = [0, 1, 2].map(|axis| force[axis] + of(axis));
            let output = [0, 1, 2].map(|axis: usize| {
                let seen: f64 = (0..3).map(|other| matrix[axis][other] * force[other]).sum();
                bias[axis] + seen + of(3 + axis)
            });
            transfer.push(reference, output);
        }
        let found = transfer.result().expect("sums");
        for (axis, transfer) in found.axes.iter().enumerate() {
            let line = transfer.line.expect("it moved");
            let [b, s] = line.half_widths_95();
            inside[0].count((line.bias_mps2 - bias[axis]).abs() <= b);
            inside[1].count((line.scale - matrix[axis][axis]).abs() <= s);
            inside[2].count(transfer.cross_axis != [0.0; 3]);
        }
    }
    inside
}

#[test]
fn intervals_hold_the_truth_of_a_thousand_sensors_be_the_axes_parallel_or_not() {
    let (mut held, mut detected, mut falsely) = (Vec::new(), Vec::new(), Vec::new());
    for rests in [false, true] {
        for across in [[0.0, 0.0], [0.0, 5e-4], [0.02, 0.02], [0.05, 0.05]] {
            let trial = Trial { across, rests, ..PARALLEL };
            let [bias, scale, seen] = coverage(trial);
            let kind = format!("sees {across:?} of others, rests {rests}");
            println!("{kind}: bias {bias}, scale factor {scale}, said of {seen}");
            bias.assert_can_be(0.93..=0.97, &kind);
            scale.assert_can_be(0.93..=0.97, &kind);
            held.extend([bias, scale]);
            if across[1] == 0.0 {
                seen.assert_can_be(0.0..=0.02, &kind);
                falsely.push(seen);
            } else if across[0] >= 0.02 {
                seen.assert_can_be(0.96..=1.0, &kind);
                detected.push(seen);
            }
        }
    }
    coverage_figure("95 % intervals against a reference, axes parallel or not", &held, 0.93..=0.97);
    coverage_figure("axes that are not parallel are reported", &detected, 0.96..=1.0);
    coverage_figure("parallel axes are reported as not parallel", &falsely, 0.0..=0.02);
}

/// The same with an unknown ratio of the noises, for a motion of several tones up to `hz` at 100 Hz; and how
/// often the neighbours method was chosen.
fn coverage_of_unknown_noise(hz: f64, amplitude: f64, sd: [f64; 2], memory: f64) -> [Coverage; 3] {
    let mut held = [Coverage::default(); 3];
    for seed in 0..sensors(1002) {
        let mut random = Random::new(seed);
        let mut noises: [_; 6] = std::array::from_fn(|_| Noise::new(memory));
        let truth: [_; 3] =
            std::array::from_fn(|_| (random.within(0.8), 1.0 + random.within(0.04)));
        let tones: [[(f64, f64); 6]; 3] = std::array::from_fn(|_| {
            std::array::from_fn(|_| {
                let rate = std::f64::consts::TAU * (0.1 + (hz - 0.1) * random.uniform());
                (0.01 * rate, random.within(std::f64::consts::PI))
            })
        });
        let mut transfer = ReferenceTransfer::new();
        for k in 0..3200 {
            let force: [f64; 3] = std::array::from_fn(|axis| {
                let swing = |(rate, phase): (f64, f64)| (rate * f64::from(k) + phase).sin();
                let sum: f64 = tones[axis].into_iter().map(swing).sum();
                amplitude * sum + if axis == 2 { 9.81 } else { 0.0 }
            });
            let mut of = |axis: usize| noises[axis].next(&mut random);
            let reference = [0, 1, 2].map(|axis| force[axis] + sd[0] * of(axis));
            let output = [0, 1, 2]
                .map(|axis| truth[axis].0 + truth[axis].1 * force[axis] + sd[1] * of(3 + axis));
            transfer.push(reference, output);
        }
        for (axis, (bias, scale)) in transfer.result().expect("sums").axes.iter().zip(truth) {
            let line = axis.line.expect("it moved");
            let [b, s] = line.half_widths_95();
            held[0].count((line.bias_mps2 - bias).abs() <= b);
            held[1].count((line.scale - scale).abs() <= s);
            held[2].count(line.noise_from == NoiseFrom::Neighbours);
        }
    }
    held
}

#[test]
fn intervals_hold_the_truth_where_the_source_of_the_noise_is_unknown() {
    let mut held = Vec::new();
    for (amplitude, sd) in [
        (2.0, [0.02, 0.02]),
        (2.0, [0.02, 0.2]),
        (2.0, [0.2, 0.02]),
        (0.8, [0.02, 0.4]),
        (0.8, [0.4, 0.02]),
    ] {
        let [bias, scale, neighbours] = coverage_of_unknown_noise(2.0, amplitude, sd, 0.0);
        let kind = format!("noise {sd:?}");
        println!("{kind}: bias {bias}, scale factor {scale}, neighbours {neighbours}");
        bias.assert_can_be(0.93..=0.97, &kind);
        scale.assert_can_be(0.93..=0.97, &kind);
        neighbours.assert_can_be(0.95..=1.0, &kind);
        held.extend([bias, scale]);
    }
    let claim = "95 % intervals against a reference of unknown noise";
    coverage_figure(claim, &held, 0.93..=0.97);
}

#[test]
fn where_neighbours_do_not_tell_the_interval_reaches_from_bound_to_bound() {
    let mut held = Vec::new();
    // Motion as fast as the samples, and noise with a longer memory than neighbours are apart.
    for (hz, memory) in [(40.0, 0.0), (2.0, 10.0)] {
        for sd in [[0.02, 0.4], [0.4, 0.02], [0.3, 0.3]] {
            let [bias, scale, neighbours] = coverage_of_unknown_noise(hz, 0.8, sd, memory);
            let kind = format!("{hz} Hz, memory {memory}, noise {sd:?}");
            println!("{kind}: bias {bias}, scale factor {scale}, neighbours {neighbours}");
            bias.assert_can_be(0.93..=1.0, &kind);
            scale.assert_can_be(0.93..=1.0, &kind);
            held.extend([bias, scale]);
        }
    }
    let claim = "95 % intervals where neighbouring samples cannot tell the noise";
    coverage_figure(claim, &held, 0.93..=1.0);
}

/// A transfer of hand motion with noise, what is sensed by each side changed by `changed`.
fn transfer_of(
    seed: u64,
    noise: f64,
    changed: impl Fn([f64; 3], [f64; 3]) -> [[f64; 3]; 2],
) -> Result<wimu_calib::Transfer, Refusal> {
    let mut random = Random::new(seed);
    let slow = 0.2 + random.uniform();
    let bias: [f64; 3] = std::array::from_fn(|_| random.within(0.5));
    let mut transfer = ReferenceTransfer::new();
    for k in 0..6000 {
        let tilt = 1.4 * (slow * 0.01 * f64::from(k)).sin();
        let heading = 0.007 * f64::from(k);
        let force = [
            9.81 * tilt.sin() * heading.cos(),
            9.81 * tilt.sin() * heading.sin(),
            9.81 * tilt.cos(),
        ];
        let reference = force.map(|f| f + noise * random.normal());
        let output =
            [0, 1, 2].map(|axis| 1.01 * force[axis] + bias[axis] + noise * random.normal());
        let [reference, output] = changed(reference, output);
        transfer.push(reference, output);
    }
    transfer.result()
}

#[test]
fn a_stream_that_stops_while_the_other_goes_on_is_refused() {
    let clip = |most: f64| move |y: f64| y.clamp(-most, most);
    let counts = |step: f64| move |y: f64| (y / step).round() * step;
    for step in [1e-9, 0.005, 0.15] {
        for most in [8.0, 9.0, 9.5] {
            for seed in 0..Lane::current().choose([2, 3, 10]) {
                let output = transfer_of(seed, 0.02, |x, y| {
                    [x.map(counts(step)), y.map(counts(step)).map(clip(counts(step)(most)))]
                });
                let reference = transfer_of(seed, 0.02, |x, y| {
                    [x.map(counts(step)).map(clip(counts(step)(most))), y.map(counts(step))]
                });
                for (found, is_reference) in [(output, false), (reference, true)] {
                    let side = ["of the output stops", "of the reference stops"];
                    let side = side[usize::from(is_reference)];
                    let named = found.as_ref().is_err_and(|r| r.text.contains(side));
                    // Coarse counts may have both sides at it.
                    let refused = matches!(
                        found,
                        Err(Refusal { reason: Reason::Axis { clipped: true, .. }, .. })
                    );
                    assert!(named || (step > 0.1 && refused), "{step} {most} {seed} {found:?}");
                }
            }
        }
    }
}

#[test]
fn counts_however_coarse_that_stop_nowhere_are_not_taken_for_saturated() {
    for step in [1e-9, 0.005, 0.04, 0.15, 0.6] {
        for noise in [0.002, 0.02, 0.1] {
            for seed in 0..Lane::current().choose([2, 3, 10]) {
                let counts = |y: f64| (y / step).round() * step;
                for factor in [1.0, 3.0] {
                    let fine = |x: f64| (x / step * factor).round() * step / factor;
                    let found = transfer_of(seed, noise, |x, y| [x.map(fine), y.map(counts)]);
                    assert!(found.is_ok(), "{step} {noise} {seed} {found:?}");
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(common::config())]

    #[test]
    fn a_stream_against_itself_is_exact(seed: u64, n in 40_usize..5000) {
        let mut random = Random::new(seed);
        let mut transfer = ReferenceTransfer::new();
        for k in 0..n {
            let force = motion(13 * k).map(|f| f + random.normal());
            transfer.push(force, force);
        }
        let found = transfer.result().unwrap();
        prop_assert_eq!(found.samples, n as u64);
        for axis in found.axes {
            let line = axis.line.unwrap();
            prop_assert_eq!((axis.offset_mps2, axis.rms_mps2), (0.0, 0.0));
            prop_assert_eq!((line.bias_mps2, line.scale), (0.0, 1.0));
            prop_assert!(line.covariance.iter().flatten().all(|c| c.abs() < 1e-18), "{:?}", line.covariance);
        }
    }
}

#[test]
fn at_one_static_pose_the_offset_alone_is_known() {
    let mut held = Coverage::default();
    for seed in 0..sensors(1500) {
        let mut random = Random::new(seed);
        let mut transfer = ReferenceTransfer::new();
        for k in 0..3200 {
            // Both drift by the same 30 mm/s² as they warm up.
            let drift = 0.03 * f64::from(k) / 3200.0;
            let noisy = |random: &mut Random, y: f64| y + drift + 0.05 * random.normal();
            let reference = [0.1, 0.2, 9.8].map(|y| noisy(&mut random, y));
            let output = [0.3, 0.2, 9.9].map(|y| noisy(&mut random, y));
            transfer.push(reference, output);
        }
        let found = transfer.result().expect("an answer");
        for (axis, offset) in found.axes.iter().zip([0.2, 0.0, 0.1]) {
            assert_eq!(axis.line, None);
            let error = (axis.offset_mps2 - offset).abs();
            held.count(error <= 2.064 * axis.offset_sd_mps2);
        }
        let model = found.model().expect("a model");
        assert_eq!(model.terms().matrix, wimu_model::ErrorTerms::default().matrix);
    }
    coverage_figure(
        "95 % intervals of the offset at one pose hold the truth",
        &[held],
        0.93..=0.97,
    );
    held.assert_can_be(0.93..=0.97, "offsets");
}

#[test]
fn bad_input_is_refused_or_left_out() {
    let mut transfer = ReferenceTransfer::new();
    assert!(matches!(
        transfer.result(),
        Err(Refusal { reason: Reason::TooFew { have: 0, .. }, .. })
    ));
    transfer.push([f64::NAN; 3], [0.0; 3]);
    transfer.push([0.0; 3], [f64::INFINITY; 3]);
    for k in 0..1000 {
        transfer.push(motion(k), motion(k).map(|f| 1.01 * f));
    }
    let found = transfer.result().expect("an answer");
    assert_eq!((found.samples, found.not_finite), (1000, 2));

    // Different motions, a mirrored axis, and a motion in one short part only.
    let mut other = ReferenceTransfer::new();
    let mut mirrored = ReferenceTransfer::new();
    let mut short = ReferenceTransfer::new();
    for k in 0..3200 {
        let [x, y, z] = motion(k);
        other.push([x, y, z], motion(k + 137));
        mirrored.push([x, y, z], [x, -y, z]);
        let force = if k < 90 { motion(50 * k).map(|f| 3.0 * f) } else { [0.0, 0.0, 9.8] };
        short.push(force, force);
    }
    for (transfer, axes) in [(&other, 0..1), (&mirrored, 1..2)] {
        match transfer.result() {
            Err(Refusal { reason: Reason::PoorFit { index, .. }, .. }) => {
                assert!(axes.contains(&index));
            }
            Err(Refusal { reason: Reason::Axes, text }) => {
                assert!(axes.contains(&1) && text.contains("negated"), "{text}");
            }
            other => panic!("{other:?}"),
        }
    }
    assert!(matches!(short.result(), Err(Refusal { reason: Reason::NotObservable, .. })));
}
