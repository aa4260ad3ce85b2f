//! f32 against f64 on the same data.

use crate::common;

use common::{DrawModel as _, G, Random};
use wimu_calib::{
    Ageing, AllanVariance, Estimate, Face, Gravity, KnownDirection, Measured, Model, Parameter,
    Phase, Placement, Pose, PoseFinder, ReferenceTransfer, SelfCheck, Session, align, align_f32,
    four_angle, four_angle_f32, magnetometer, magnetometer_f32, multi_position, six_position,
    six_position_f32, six_position_labelled, six_position_labelled_f32, straight_move,
    straight_move_f32, three_angle, three_angle_f32,
};
use wimu_model::{Alignment, ErrorModel, SpecificForceMps2};

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
    let mut random = Random::new(31);
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
    let mut random = Random::new(32);
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
        let mut random = Random::new(seed);
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

/// By how many of its standard deviations any parameter is apart, and any standard deviation, as a
/// share of itself.
fn apart(long: &Estimate, short: &Estimate) -> [f64; 2] {
    let (a, b) = (
        common::parameters(&long.model),
        common::parameters(&short.model),
    );
    let mut worst = [0.0_f64; 2];
    for parameter in long.fitted.iter() {
        let (sd, other) = (
            long.covariance.sd(parameter),
            short.covariance.sd(parameter),
        );
        let k = parameter.index();
        worst[0] = worst[0].max((a[k] - b[k]).abs() / sd);
        worst[1] = worst[1].max((other / sd - 1.0).abs());
    }
    assert_eq!(
        (long.fitted, long.rejected, long.poses),
        (short.fitted, short.rejected, short.poses)
    );
    worst
}

fn larger(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0].max(b[0]), a[1].max(b[1])]
}

#[test]
fn known_orientations_give_the_same_in_f32() {
    let (mut six, mut turns) = ([0.0; 2], [0.0; 2]);
    let gravity = Gravity::new(G, 0.001).expect("gravity");
    for seed in 0..300 {
        let mut random = Random::new(seed);
        let model = random.model(false);
        let placement_rad = [0.001, 0.0175][seed as usize % 2];
        let placement = Placement::new(placement_rad).expect("a placement");
        let seen = |random: &mut Random, up: [f64; 3]| {
            let up = common::misplaced(random, up, placement_rad);
            let exact = common::pose(&model, G, up).mean_mps2;
            let mean_mps2 = exact.map(|y| y + 0.002 * random.normal());
            Pose {
                sd_mps2: [0.02; 3],
                samples: 100 + (random.uniform() * 1000.0) as u32,
                ..Pose::from_mean(mean_mps2)
            }
        };
        let labelled: Vec<(Face, Pose)> = (0..2)
            .flat_map(|_| Face::ALL)
            .map(|face| {
                let mut up = [0.0; 3];
                up[face.axis()] = face.sign();
                (face, seen(&mut random, up))
            })
            .collect();
        let poses: Vec<Pose> = labelled.iter().map(|(_, pose)| *pose).collect();
        let long = six_position(&poses, gravity, placement).expect("six");
        let short = six_position_f32(&poses, gravity, placement).expect("six");
        six = larger(six, apart(&long, &short));
        let off = (long.loo_rms_mps2.expect("two visits") - short.loo_rms_mps2.expect("two")).abs();
        assert!(off < 5e-6 && (long.rms_mps2 - short.rms_mps2).abs() < 5e-6);
        let long = six_position_labelled(&labelled, gravity, placement).expect("six");
        let short = six_position_labelled_f32(&labelled, gravity, placement).expect("six");
        six = larger(six, apart(&long, &short));

        let mut turn = |steps: u32| -> Vec<Pose> {
            let from = random.within(3.0);
            let angles =
                (0..steps).map(|k| from + std::f64::consts::TAU * f64::from(k) / f64::from(steps));
            let about_z: Vec<f64> = angles.collect();
            let ups = about_z.iter().map(|a| [a.cos(), a.sin(), 0.0]);
            let ups = ups.chain(about_z.iter().map(|a| [0.0, a.cos(), a.sin()]));
            ups.map(|up| seen(&mut random, up)).collect()
        };
        let (four, three) = (turn(4), turn(3));
        let long = four_angle(&four, gravity, placement).expect("a turn");
        let short = four_angle_f32(&four, gravity, placement).expect("a turn");
        turns = larger(turns, apart(&long, &short));
        let long = three_angle(&three, gravity, placement).expect("a turn");
        let short = three_angle_f32(&three, gravity, placement).expect("a turn");
        turns = larger(turns, apart(&long, &short));
    }
    println!(
        "six positions {:.1e} standard deviations apart at most, those {:.1e} of themselves; turns {:.1e} \
         and {:.1e}",
        six[0], six[1], turns[0], turns[1]
    );
    assert!(six[0] < 2e-3 && turns[0] < 2e-3);
    assert!(six[1] < 1e-3 && turns[1] < 1e-3);
}

#[test]
fn an_alignment_is_the_same_in_f32() {
    let mut worst = [0.0_f64; 2];
    for seed in 0..300 {
        let mut random = Random::new(seed);
        let sd_rad = 0.0017 * (1.0 + random.uniform());
        let body = [
            [0.0, 0.0, 1.0],
            common::unit([1.0, 0.1, 0.4]),
            random.direction(),
        ];
        let q = [0; 4].map(|_| random.normal());
        let size = q.iter().map(|x| x * x).sum::<f64>().sqrt();
        let back = Alignment::from_quaternion(q.map(|x| x / size)).expect("a rotation");
        let known = body.map(|up| KnownDirection {
            sensor: back
                .rotate(common::misplaced(&mut random, up, sd_rad))
                .map(|c| 9.81 * c),
            body: up,
            sd_rad,
        });
        let (long, short) = (
            align(&known).expect("a rotation"),
            align_f32(&known).expect("one"),
        );
        // A rotation by δ turns the axes by about as much.
        for axis in 0..3 {
            let mut along = [0.0; 3];
            along[axis] = 1.0;
            let (a, b) = (long.alignment.rotate(along), short.alignment.rotate(along));
            let least = long.covariance.sd(0).min(long.covariance.sd(1));
            worst[0] = worst[0].max(common::norm(common::cross(a, b)) / least);
            let ratio = short.covariance.sd(axis) / long.covariance.sd(axis);
            worst[1] = worst[1].max((ratio - 1.0).abs());
        }
        // A push of half a metre in a second, along any direction.
        let ahead = random.direction();
        let push: Vec<[f32; 3]> = (0..200)
            .map(|k| {
                let a = 3.0 * (std::f64::consts::TAU * f64::from(k) / 200.0).sin();
                std::array::from_fn(|i| {
                    let rest = if i == 2 { G } else { 0.0 };
                    (rest + a * ahead[i] + 0.02 * random.normal()) as f32
                })
            })
            .collect();
        let rest = [0.0, 0.0, G as f32];
        let short = straight_move_f32(rest, rest, push.iter().copied(), 200.0).expect("a move");
        let rest = rest.map(f64::from);
        let long = straight_move(rest, rest, push.iter().map(|p| p.map(f64::from)), 200.0)
            .expect("a move");
        assert!(common::norm(common::cross(long.0, short.0)) < 1e-5);
        assert!((short.1 / long.1 - 1.0).abs() < 1e-2);
    }
    println!(
        "rotations {:.1e} standard deviations apart, those {:.1e} of themselves",
        worst[0], worst[1]
    );
    assert!(worst[0] < 1e-3 && worst[1] < 1e-4);
}

#[test]
fn a_magnetometer_is_the_same_in_f32() {
    let mut worst = [0.0_f64; 4];
    let (mut compared, mut refused) = (0, 0);
    for seed in 0..100 {
        let mut random = Random::new(seed);
        let (_, _, _, mut poses) = common::magnetometer(&mut random, 30, 150.0);
        if seed % 4 == 1 {
            poses[7].output_nt[1] += 9_000.0;
        }
        if seed % 10 == 2 {
            for pose in &mut poses {
                pose.output_nt[2] = -pose.output_nt[2];
            }
        }
        let (long, short) = match (magnetometer(&poses, None), magnetometer_f32(&poses, None)) {
            (Ok(long), Ok(short)) => (long, short),
            (long, short) => {
                let [long, short] = [long, short].map(|found| found.expect_err("as the other"));
                assert_eq!(
                    std::mem::discriminant(&long),
                    std::mem::discriminant(&short)
                );
                refused += 1;
                continue;
            }
        };
        compared += 1;
        assert_eq!(long.rejected, short.rejected, "{seed}");
        let (a, b) = (long.model.terms(), short.model.terms());
        let off = |a: f32, b: f32, sd: f32| f64::from((a - b).abs() / sd);
        for k in 0..3 {
            worst[0] = worst[0].max(off(
                a.hard_iron_nt[k],
                b.hard_iron_nt[k],
                a.hard_iron_sd_nt[k],
            ));
        }
        for k in 0..6 {
            worst[1] = worst[1].max(off(a.soft_iron[k], b.soft_iron[k], a.soft_iron_sd[k]));
            let ratio = f64::from(b.soft_iron_sd[k] / a.soft_iron_sd[k]);
            worst[3] = worst[3].max((ratio - 1.0).abs());
        }
        let (Some(r), Some(s)) = (a.to_accelerometer, b.to_accelerometer) else {
            panic!("a rotation");
        };
        for axis in 0..3 {
            let mut along = [0.0; 3];
            along[axis] = 1.0;
            let turned = common::cross(r.rotation.rotate(along), s.rotation.rotate(along));
            worst[2] = worst[2].max(common::norm(turned) / r.covariance.sd(0));
        }
    }
    println!(
        "{compared} sensors, {refused} refused by both: hard iron {:.1e}, soft iron {:.1e}, rotation {:.1e} \
         standard deviations apart at most, those {:.1e} of themselves",
        worst[0], worst[1], worst[2], worst[3]
    );
    assert!(compared >= 80 && refused >= 5);
    assert!(worst.iter().all(|off| *off < 1e-3));
}

#[test]
fn a_reference_tells_the_same_in_f32_however_long_it_is() {
    let mut worst = [0.0_f64; 2];
    for (seed, samples) in [(1, 3000), (2, 30_000), (3, 300_000)] {
        let mut random = Random::new(seed);
        let mut long = ReferenceTransfer::of_unknown_noise();
        let mut short = ReferenceTransfer::of_unknown_noise_f32();
        for k in 0..samples {
            let t = f64::from(k) * 0.01;
            let force = [
                2.0 * (1.3 * t).sin() + 1.0,
                2.5 * (0.9 * t + 0.3).sin() - 3.0,
                2.0 * (1.7 * t).cos() + 9.0,
            ];
            let mut noisy = |scale: f64, bias: f64| {
                force.map(|f| (bias + scale * f + 0.02 * random.normal()) as f32)
            };
            let (reference, output) = (noisy(1.0, 0.0), noisy(1.02, 0.3));
            long.push(double(reference), double(output));
            short.push(reference, output);
        }
        let (long, short) = (
            long.result().expect("a line"),
            short.result().expect("a line"),
        );
        for (a, b) in long.axes.iter().zip(&short.axes) {
            let (a, b) = (a.line.expect("it moved"), b.line.expect("it moved"));
            assert_eq!(a.noise_from, b.noise_from);
            for (k, off) in [a.bias_mps2 - b.bias_mps2, a.scale - b.scale]
                .into_iter()
                .enumerate()
            {
                let sd = a.covariance[k][k].sqrt();
                worst[0] = worst[0].max(off.abs() / sd);
                worst[1] = worst[1].max((b.covariance[k][k].sqrt() / sd - 1.0).abs());
            }
        }
    }
    println!(
        "lines {:.1e} standard deviations apart, those {:.1e} of themselves",
        worst[0], worst[1]
    );
    assert!(worst[0] < 1e-3 && worst[1] < 1e-3);
}

#[test]
fn noise_is_the_same_in_f32_however_long_it_is() {
    let mut worst = 0.0_f64;
    for (seed, samples) in [(1, 2000), (2, 300_000)] {
        let mut random = Random::new(seed);
        let (mut long, mut short) = (AllanVariance::new(100.0), AllanVariance::new_f32(100.0));
        let mut walk = [0.0; 3];
        for _ in 0..samples {
            let sample: [f32; 3] = std::array::from_fn(|axis| {
                walk[axis] += 2e-5 * random.normal();
                let rest = if axis == 2 { G } else { 0.3 };
                (rest + walk[axis] + 0.005 * random.normal()) as f32
            });
            long.push(double(sample));
            short.push(sample);
        }
        for (a, b) in long.points().zip(short.points()) {
            assert_eq!((a.tau_s, a.edf), (b.tau_s, b.edf));
            for axis in 0..3 {
                let ratio = b.deviation_mps2[axis] / a.deviation_mps2[axis];
                assert!((ratio - 1.0).abs() < 1e-4, "{} {ratio}", a.tau_s);
            }
        }
        let (long, short) = (
            long.result().expect("noise"),
            short.result().expect("noise"),
        );
        for (a, b) in long.iter().zip(&short) {
            let off = |a: Measured, b: Measured| (a.value - b.value).abs() / a.sd;
            worst = worst.max(off(a.velocity_random_walk, b.velocity_random_walk));
            assert_eq!(
                a.bias_instability_mps2.is_some(),
                b.bias_instability_mps2.is_some()
            );
            if let (Some(a), Some(b)) = (a.acceleration_random_walk, b.acceleration_random_walk) {
                worst = worst.max(off(a, b));
            }
        }
    }
    println!("noise {worst:.1e} standard deviations apart at most");
    assert!(worst < 1e-3);
}
