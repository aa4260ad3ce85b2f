//! The minimal fit against the full one.

use crate::common;

use common::{DrawModel as _, G, Random, exact, parameters, pose, ups};
use wimu_calib::{
    Gravity, Model, Parameter, Pose, Refusal, minimal_fit, multi_position, multi_position_f32,
};

/// Poses with noise of `sd` m/s²; with a noise figure of their own where `known`.
fn poses(seed: u64, more: usize, sd: f64, known: bool) -> Vec<Pose> {
    let mut random = Random::new(seed);
    let truth = random.model(true);
    let ups = ups(&mut random, more);
    let drawn = ups.into_iter().enumerate().map(|(k, up)| {
        let mut pose = pose(&truth, G, up);
        for y in &mut pose.mean_mps2 {
            *y += random.normal() * sd;
        }
        pose.samples = 100;
        pose.sd_mps2 = [if known { 0.02 * (1 + k % 3) as f64 } else { 0.0 }; 3];
        pose
    });
    drawn.collect()
}

#[test]
fn the_minimal_fit_is_the_full_one() {
    let gravity = Gravity::new(G, 0.002).expect("gravity");
    let (mut fits, mut off, mut off_covariance, mut off_f32) = (0, 0.0_f64, 0.0_f64, 0.0_f64);
    for seed in 0..100 {
        let poses = poses(seed, (seed % 20) as usize, 0.003, seed % 2 == 1);
        let Ok(full) = multi_position(&poses, gravity, Model::Full9) else {
            continue;
        };
        if full.orientations < full.poses {
            continue;
        }
        let minimal = minimal_fit::<f64>(&poses, gravity).expect("a fit");
        let single = minimal_fit::<f32>(&poses, gravity).expect("a fit");
        let known = parameters(&full.model);
        for (k, (minimal, full)) in parameters(&minimal.model).iter().zip(known).enumerate() {
            off = off.max((minimal - full).abs());
            off_f32 = off_f32.max((parameters(&single.model)[k] - full).abs());
        }
        for a in Parameter::ALL {
            for b in Parameter::ALL {
                let size = full.covariance.sd(a) * full.covariance.sd(b);
                let apart = minimal.covariance.get(a, b) - full.covariance.get(a, b);
                off_covariance = off_covariance.max(apart.abs() / size.max(1e-30));
            }
        }
        assert_eq!(Some(minimal.interval_dof), full.interval_dof);
        assert!((minimal.rms_mps2 - full.rms_mps2).abs() < 1e-9);
        assert_eq!(minimal.worst_pose, full.worst_pose);
        fits += 1;
    }
    assert!(fits > 30, "{fits}");
    // The covariance is that before the last step, which is smaller than 1e-6 m/s² of 9.8.
    assert!(off < 1e-9 && off_covariance < 1e-6, "{off} {off_covariance}");
    assert!(off_f32 < 1e-5, "{off_f32}");
}

#[test]
fn poses_of_repeated_orientations_are_not_counted_as_independent() {
    let once = poses(7, 0, 0.003, false);
    let twice: Vec<Pose> = once
        .iter()
        .flat_map(|pose| [*pose, Pose { mean_mps2: pose.mean_mps2.map(|y| y + 1e-6), ..*pose }])
        .collect();
    let [once, twice] =
        [once, twice].map(|poses| minimal_fit::<f64>(&poses, exact()).expect("a fit"));
    assert_eq!(once.interval_dof, twice.interval_dof);
    let [once, twice] = [once, twice].map(|fit| fit.covariance.sd(Parameter::BiasX));
    assert!((twice / once - 1.0).abs() < 1e-3, "{once} {twice}");
}

#[test]
fn the_minimal_fit_refuses_what_the_full_one_refuses() {
    let good = poses(3, 8, 0.003, false);
    let with = |change: &dyn Fn(usize, &mut Pose)| {
        let mut poses = good.clone();
        poses.iter_mut().enumerate().for_each(|(k, pose)| change(k, pose));
        poses
    };
    let scaled =
        |factor: f64| move |_, pose: &mut Pose| pose.mean_mps2 = pose.mean_mps2.map(|y| factor * y);
    let refused = [
        good[..9].to_vec(),
        with(&|k, pose| pose.mean_mps2[0] = if k == 4 { f64::NAN } else { 1.0 }),
        with(&scaled(0.1)),
        with(&scaled(1.9)),
        with(&|_, pose| pose.mean_mps2[2] = 0.3),
        with(&|k, pose| pose.mean_mps2[1] += if k % 2 == 0 { 1.0 } else { 0.0 }),
        with(&|_, pose| pose.mean_mps2[0] = pose.mean_mps2[0].clamp(-5.0, 5.0)),
        with(&|k, pose| {
            if k == 3 {
                scaled(0.1)(k, pose)
            }
        }),
        // Rotated about one axis only.
        (0..16)
            .map(|k| 0.4 * f64::from(k))
            .map(|t: f64| Pose::from_mean([G * t.cos(), G * t.sin(), 0.01 * (3.0 * t).cos()]))
            .collect(),
    ];
    let full_f32 = |poses: &[Pose]| multi_position_f32(poses, exact(), Model::Full9).err();
    for (k, poses) in refused.iter().enumerate() {
        let full = multi_position(poses, exact(), Model::Full9).expect_err("refused");
        let minimal = minimal_fit::<f64>(poses, exact()).expect_err("refused");
        let single = minimal_fit::<f32>(poses, exact()).expect_err("refused");
        let kind = core::mem::discriminant::<Refusal>;
        assert!(kind(&minimal) == kind(&full), "{k}: {minimal:?} {full:?}");
        assert!(
            full_f32(poses).is_some_and(|full| kind(&single) == kind(&full)),
            "{k}: {single:?}"
        );
    }
    assert!(minimal_fit::<f64>(&good, exact()).is_ok());
}
