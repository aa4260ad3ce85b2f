//! The pose finder on simulated streams.

use crate::common;

use common::{G, Random, norm, unit};
use proptest::prelude::*;
use wimu_calib::{Pose, PoseFinder, find_poses};
use wimu_testkit::{draws, figure};

/// A stream of holds with hand motion between them.
struct Stream {
    samples: Vec<[f64; 3]>,
    /// First sample, last sample and true output of each hold.
    holds: Vec<(usize, usize, [f64; 3])>,
}

/// `count` holds of `hold_s` at `rate`, noise `sd` (m/s² rms), output rounded to `step`.
fn stream(random: &mut Random, rate: f64, sd: f64, step: f64, count: usize, hold_s: f64) -> Stream {
    let mut out = Stream { samples: Vec::new(), holds: Vec::new() };
    let mut up = random.direction();
    for hold in 0..=count {
        // A turn of 1.5 s to the next orientation, with shaking.
        let next = loop {
            let next = random.direction();
            if next.iter().zip(up).map(|(a, b)| a * b).sum::<f64>() < 0.7 {
                break next;
            }
        };
        let turn = (1.5 * rate) as usize;
        let (f1, f2) = (3.0 + 4.0 * random.uniform(), 1.0 + 2.0 * random.uniform());
        let shake = [random.within(3.0), random.within(3.0), random.within(3.0)];
        for k in 0..turn {
            let t = (k as f64 + 0.5) / turn as f64;
            let ease = t * t * (3.0 - 2.0 * t);
            let swell = (std::f64::consts::PI * t).sin();
            let at = unit([0, 1, 2].map(|i| up[i] * (1.0 - ease) + next[i] * ease + 1e-3));
            let wave = (f1 * t * 9.0).sin() + (f2 * t * 7.0).cos();
            out.samples.push([0, 1, 2].map(|i| at[i] * G + shake[i] * swell * wave));
        }
        up = next;
        if hold < count {
            let first = out.samples.len();
            let length = (hold_s * rate) as usize;
            out.samples.extend((0..length).map(|_| up.map(|c| c * G)));
            out.holds.push((first, first + length - 1, up.map(|c| c * G)));
        }
    }
    for sample in &mut out.samples {
        for y in sample {
            *y += random.normal() * sd;
            if step > 0.0 {
                *y = (*y / step).round() * step;
            }
        }
    }
    out
}

fn poses(samples: &[[f64; 3]], rate: f64) -> Vec<Pose> {
    find_poses(samples.iter().map(|y| (*y, None)), rate)
}

fn streamed(finder: &mut PoseFinder, samples: &[[f64; 3]]) -> Vec<Pose> {
    let mut found: Vec<Pose> = samples.iter().filter_map(|y| finder.push(*y)).collect();
    found.extend(core::iter::from_fn(|| finder.finish()));
    found
}

#[test]
fn any_noise_at_any_rate_is_learnt_live_and_from_a_recording() {
    let rates = [10.0, 25.0, 100.0, 500.0, 2000.0];
    let noises = [0.001, 0.01, 0.03, 0.1, 0.2, 0.3];
    let (mut holds, mut missed, mut false_poses, mut worst) = (0, 0, 0, 0.0_f64);
    for (seed, (rate, sd)) in
        rates.into_iter().flat_map(|rate| noises.map(|sd| (rate, sd))).cycle().take(60).enumerate()
    {
        let mut random = Random::new(1000 + seed as u64);
        let stream = stream(&mut random, rate, sd, 0.0, 10, 3.5);
        let live = streamed(&mut PoseFinder::new(rate), &stream.samples);
        for (way, found) in [("recorded", poses(&stream.samples, rate)), ("live", live)] {
            let (mut here, mut outside) = (0, 0);
            for (first, last, truth) in &stream.holds {
                // A pose of this hold: most of it within, its mean that of the hold.
                let of_it = found.iter().filter(|pose| {
                    let middle = pose.first_sample as usize + pose.samples as usize / 2;
                    (*first..=*last).contains(&middle)
                });
                let mut of_it = of_it.peekable();
                if of_it.peek().is_none() {
                    here += 1;
                }
                for pose in of_it {
                    let apart = norm([0, 1, 2].map(|i| pose.mean_mps2[i] - truth[i]));
                    let sure = sd / f64::from(pose.samples).sqrt();
                    worst = worst.max(apart - 5.0 * sure);
                }
            }
            for pose in &found {
                let middle = pose.first_sample as usize + pose.samples as usize / 2;
                let inside =
                    |(first, last, _): &&(usize, usize, _)| (*first..=*last).contains(&middle);
                if !stream.holds.iter().any(|hold| inside(&hold)) {
                    outside += 1;
                }
            }
            if here + outside > 0 {
                println!("{way}, {rate} Hz, {sd} m/s²: {here} missed, {outside} in motion");
            }
            holds += stream.holds.len();
            missed += here;
            false_poses += outside;
        }
    }
    println!(
        "of {holds} holds {missed} missed, {false_poses} poses in motion; the worst mean is off by \
         {worst:.4} m/s² more than 5 of its standard deviations"
    );
    figure(
        "rests that are missed, poses in motion, any noise and rate",
        format!("{missed}, {false_poses} of {holds}"),
        "none",
        missed + false_poses == 0,
    );
    assert_eq!((missed, false_poses), (0, 0));
    assert!(worst < 0.03);
}

#[test]
fn motion_alone_gives_no_pose() {
    // Seven turns one after the other, never at rest: nothing tells how quiet the sensor can be.
    let (mut turns, mut recorded, mut live, mut long) = (0, 0, 0, 0);
    for rate in [10.0, 25.0, 100.0, 400.0] {
        for noise in [0.001, 0.01, 0.1, 0.3] {
            for seed in 0..draws(100, 7) as u64 {
                let mut random = Random::new(seed);
                let stream = stream(&mut random, rate, noise, 0.0, 6, 0.0);
                let found = streamed(&mut PoseFinder::new(rate), &stream.samples);
                turns += 7;
                recorded += poses(&stream.samples, rate).len();
                live += found.len();
                let longer = |pose: &&Pose| f64::from(pose.samples) > 1.5 * rate;
                long += found.iter().filter(longer).count();
            }
        }
    }
    figure(
        "turns without any rest that pass for one: recorded, live, 1.5 s",
        format!("{recorded}, {live}, {long} of {turns}"),
        "5, 5, 0",
        recorded <= 5 && live <= 5 && long == 0,
    );
    assert!(recorded <= 5 && live <= 5 && long == 0);
}

#[test]
fn a_sensor_that_is_turned_slowly_and_never_rests_has_no_pose() {
    let (mut recorded, mut live) = (0, 0);
    for (seed, (degrees_per_s, noise)) in [2.0_f64, 3.0, 5.0]
        .into_iter()
        .flat_map(|rate| [0.002, 0.01, 0.03].map(|noise| (rate, noise)))
        .enumerate()
    {
        let mut random = Random::new(seed as u64);
        let samples: Vec<[f64; 3]> = (0..20_000)
            .map(|k| {
                // About Z, which is level, while Z leans to and fro as slowly.
                let angle = degrees_per_s.to_radians() * k as f64 / 100.0;
                let lean = 0.5 * (0.37 * angle).sin();
                let force = [angle.cos() * lean.cos(), angle.sin() * lean.cos(), lean.sin()];
                force.map(|f| G * f + noise * random.normal())
            })
            .collect();
        let found = poses(&samples, 100.0);
        recorded += found.len();
        live += streamed(&mut PoseFinder::new(100.0), &samples).len();
        println!("{degrees_per_s}°/s, noise {noise}: {} poses", found.len());
    }
    println!("1800 s of slow turns: {recorded} pass for rests recorded, {live} live");
    assert!(recorded <= 5 && live <= 5);
}

proptest! {
    #![proptest_config(common::config())]

    #[test]
    fn any_samples_pass_without_panic(
        samples in proptest::collection::vec([wild(), wild(), wild()], 0..400),
        rate: f64,
    ) {
        let mut finder = PoseFinder::new(rate);
        for pose in streamed(&mut finder, &samples) {
            prop_assert!(pose.mean_mps2.iter().chain(&pose.sd_mps2).all(|v| v.is_finite()));
        }
        poses(&samples, rate);
    }
}

/// Mostly what a sensor might say, sometimes anything.
fn wild() -> impl Strategy<Value = f64> {
    prop_oneof![200 => -0.1..0.1_f64, 1 => any::<f64>()]
}

#[test]
fn a_knock_does_not_make_two_poses_of_one() {
    let mut random = Random::new(3);
    let mut stream = stream(&mut random, 100.0, 0.02, 0.0, 3, 5.0);
    let (first, _, _) = stream.holds[1];
    for k in 0..8 {
        stream.samples[first + 150 + k][2] += if k % 2 == 0 { 15.0 } else { -12.0 };
    }
    let found = poses(&stream.samples, 100.0);
    assert_eq!(found.len(), 3);
    assert!(found[1].first_sample as usize > first + 150 && found[1].samples > 250);
}

#[test]
fn the_same_orientation_taken_again_is_another_pose() {
    let mut random = Random::new(4);
    let stream = stream(&mut random, 100.0, 0.02, 0.0, 1, 2.0);
    let mut twice = stream.samples.clone();
    twice.extend(&stream.samples);
    assert_eq!(poses(&twice, 100.0).len(), 2);
}

#[test]
fn samples_that_are_no_numbers_end_a_hold_and_harm_nothing_else() {
    let mut random = Random::new(5);
    let mut stream = stream(&mut random, 100.0, 0.02, 0.0, 3, 4.0);
    let middle = stream.holds[1].0 + 200;
    stream.samples[middle] = [f64::NAN; 3];
    let found = poses(&stream.samples, 100.0);
    assert_eq!(found.len(), 3);
    let range = found[1].first_sample..found[1].first_sample + u64::from(found[1].samples);
    assert!(!range.contains(&(middle as u64)));
}

#[test]
fn a_stream_that_hangs_does_not_pass_for_a_quiet_sensor() {
    let mut random = Random::new(6);
    let mut stream = stream(&mut random, 100.0, 0.03, 0.0, 6, 3.0);
    let hang = stream.samples[40];
    for _ in 0..300 {
        stream.samples.insert(40, hang);
    }
    // The six holds, and the hang itself, which nothing tells from a noiseless sensor at rest.
    assert_eq!(poses(&stream.samples, 100.0).len(), 7);
}

#[test]
fn the_temperature_of_a_pose_is_the_mean_while_it_was_held() {
    let mut random = Random::new(7);
    let stream = stream(&mut random, 100.0, 0.02, 0.0, 2, 3.0);
    let samples = stream.samples.iter().enumerate();
    let samples = samples.map(|(k, y)| (*y, Some(20.0 + k as f64 * 0.01)));
    let found = find_poses(samples, 100.0);
    assert_eq!(found.len(), 2);
    let middle = found[0].first_sample as f64 + (f64::from(found[0].samples) - 1.0) / 2.0;
    let celsius = found[0].temperature_c.expect("a temperature");
    assert!((celsius - (20.0 + middle * 0.01)).abs() < 1e-9);
}
