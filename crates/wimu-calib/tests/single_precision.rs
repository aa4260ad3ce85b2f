//! f32 against f64 on the same data: what runs on a device for as long as it is on.

mod common;

use common::Random;
use wimu_calib::{
    Ageing, Gravity, Model, Parameter, Phase, Pose, PoseFinder, SelfCheck, Session, multi_position,
};
use wimu_model::{ErrorModel, SpecificForceMps2};

const G: f64 = 9.80665;

/// A sensor that is held in `count` orientations for 2.5 s each, half a second of motion between.
fn held(
    random: &mut Random,
    model: &ErrorModel,
    rate: f64,
    noise: f64,
    count: usize,
) -> Vec<[f32; 3]> {
    let mut samples = Vec::new();
    for _ in 0..count {
        let up = random.direction();
        for k in 0..(3.0 * rate) as usize {
            let moving = if (k as f64) < 0.5 * rate { 4.0 } else { 0.0 };
            let force = SpecificForceMps2(up.map(|c| c * G + moving * random.normal()));
            let output = model.distort(force, None).0;
            samples.push(output.map(|y| (y + noise * random.normal()) as f32));
        }
    }
    samples
}

fn double(sample: [f32; 3]) -> [f64; 3] {
    sample.map(f64::from)
}

#[test]
fn the_finder_finds_the_same_poses() {
    let mut random = Random(31);
    let mut poses = 0;
    let mut worst: f64 = 0.0;
    for (rate, noise) in [(10.0, 0.05), (100.0, 0.002), (100.0, 0.1), (1000.0, 0.05)] {
        let model = random.model(true);
        let samples = held(&mut random, &model, rate, noise, 30);
        let (mut long, mut short) = (PoseFinder::new(rate), PoseFinder::new_f32(rate));
        let mut found: [Vec<Pose>; 2] = Default::default();
        for sample in &samples {
            found[0].extend(long.push(double(*sample)));
            found[1].extend(short.push(*sample));
        }
        found[0].extend(std::iter::from_fn(|| long.finish()));
        found[1].extend(std::iter::from_fn(|| short.finish()));
        let [long, short] = &found;
        assert_eq!(long.len(), short.len(), "{rate} Hz");
        assert!(long.len() >= 25, "{} at {rate} Hz", long.len());
        for (a, b) in long.iter().zip(short) {
            assert_eq!((a.first_sample, a.samples), (b.first_sample, b.samples));
            for axis in 0..3 {
                worst = worst.max((a.mean_mps2[axis] - b.mean_mps2[axis]).abs());
                assert!((a.sd_mps2[axis] / b.sd_mps2[axis] - 1.0).abs() < 1e-3);
            }
        }
        poses += long.len();
    }
    println!("means of {poses} poses: {worst:.1e} m/s² apart at most");
    assert!(worst < 1e-5);
}

#[test]
fn a_session_in_f32_says_the_same_at_every_sample() {
    let mut random = Random(32);
    let truth = random.model(true);
    let samples = held(&mut random, &truth, 100.0, 0.02, 16);
    let mut long = Session::<16>::new(100.0, Model::Full9, 12);
    let mut short = Session::<16, f32>::new_f32(100.0, Model::Full9, 12);
    for sample in samples {
        let (a, b) = (long.push(double(sample)), short.push(sample));
        assert_eq!(a, b);
        if let Phase::Captured { .. } = a {
            assert_eq!(long.next(), short.next());
        }
    }
    let fit = |poses: &[Pose]| multi_position(poses, Gravity::UNKNOWN_PLACE, Model::Full9);
    let (a, b) = (
        fit(long.poses()).expect("a fit"),
        fit(short.poses()).expect("a fit"),
    );
    for axis in 0..3 {
        let off = a.model.terms().bias_mps2[axis] - b.model.terms().bias_mps2[axis];
        assert!(off.abs() < 2e-5, "{off}");
    }
}

#[test]
fn a_self_check_in_f32_comes_to_the_same_verdicts() {
    let (mut rests, mut contradicted, mut other) = (0, 0, 0);
    let mut worst: f64 = 0.0;
    for seed in 0..200 {
        let mut random = Random(seed);
        let truth = random.model(true);
        let poses: Vec<Pose> = (0..20)
            .map(|_| {
                let up = random.direction();
                let force = SpecificForceMps2(up.map(|c| c * G));
                Pose::from_mean(
                    truth
                        .distort(force, None)
                        .0
                        .map(|y| y + 0.002 * random.normal()),
                )
            })
            .collect();
        let gravity = Gravity::UNKNOWN_PLACE;
        let Ok(stored) = multi_position(&poses, gravity, Model::Full9) else {
            continue;
        };
        let known = stored.covariance.matrix();
        let mut long = SelfCheck::new(&stored.model, known, gravity, Ageing::default());
        let mut short = SelfCheck::new_f32(&stored.model, known, gravity, Ageing::default());
        // The bias has moved by what a run may, or by far more.
        let moved = if seed % 2 == 0 { 0.015 } else { 0.06 };
        let shift = [0; 3].map(|_| moved * random.normal());
        for _ in 0..300 {
            let up = random.direction();
            let force = SpecificForceMps2(up.map(|c| c * G));
            let output = truth.distort(force, None).0;
            let mean: [f64; 3] =
                std::array::from_fn(|i| output[i] + shift[i] + 0.003 * random.normal());
            let pose = Pose::from_mean(mean);
            let (a, b) = (
                long.push(&pose).expect("a rest"),
                short.push(&pose).expect("a rest"),
            );
            rests += 1;
            contradicted += u32::from(!a.holds);
            other += u32::from(a.holds != b.holds);
            if a.holds == b.holds {
                let off = (a.residual_mps2 - b.residual_mps2).abs() / a.expected_sd_mps2;
                worst = worst.max(off);
            } else {
                // What one took and the other left parts them from here on.
                break;
            }
        }
        let (a, b) = (long.covariance(), short.covariance());
        for parameter in Parameter::ALL {
            let (a, b) = (a.sd(parameter), b.sd(parameter));
            assert!(
                b.is_finite() && (a - b).abs() <= 0.02 * a + 1e-7,
                "{parameter}: {a} {b}"
            );
        }
    }
    println!(
        "{rests} rests, {contradicted} of them contradicted, {other} judged otherwise in f32; residuals \
         {worst:.1e} standard deviations apart at most"
    );
    assert!(contradicted > 100 && other <= 2);
    assert!(worst < 0.02);
}
