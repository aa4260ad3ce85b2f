//! Gyroscopes of real recordings, before and after calibration.

use crate::common;

use common::{ROBUST, cross, norm, recording, unit, vector};
use wimu_calib::{
    AccelerometerCalibration, Gravity, GyroscopeEstimate, GyroscopeSession, MagneticPose, Pose,
    Reason, Refusal, SixAxisSample, find_poses, magnetometer, multi_position,
};
use wimu_model::{GyroscopeModel, GyroscopeTerms, SpecificForceMps2};
use wimu_testkit::{Lane, figure};

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Samples of the rows: accelerometer and gyroscope from these columns on, in these units.
fn samples(rows: &[Vec<String>], [force, rate]: [usize; 2], units: [f64; 2]) -> Vec<SixAxisSample> {
    let mut last = 0.0;
    let of_row = |row: &Vec<String>| {
        let time: f64 = row[0].parse().expect("a time");
        SixAxisSample {
            step_s: time - std::mem::replace(&mut last, time),
            rate_rad_s: vector(row, rate, units[1]),
            output_mps2: vector(row, force, units[0]),
        }
    };
    rows.iter().map(of_row).collect()
}

fn rests(samples: &[SixAxisSample], rate_hz: f64) -> Vec<Pose> {
    find_poses(samples.iter().map(|s| (s.output_mps2, None)), rate_hz)
}

/// Hamilton product of W, X, Y, Z.
fn product(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    let [v, w] = [[a[1], a[2], a[3]], [b[1], b[2], b[3]]];
    let (dot, c) = ((0..3).map(|i| v[i] * w[i]).sum::<f64>(), cross(v, w));
    let xyz = [0, 1, 2].map(|i| a[0] * w[i] + b[0] * v[i] + c[i]);
    [a[0] * b[0] - dot, xyz[0], xyz[1], xyz[2]]
}

/// The rotation over the step between two samples.
fn step(
    model: &GyroscopeModel,
    pair: &[SixAxisSample],
    force: impl Fn([f64; 3]) -> [f64; 3],
) -> [f64; 4] {
    let [a, b] = [0, 1].map(|k| {
        let sample: &SixAxisSample = &pair[k];
        model.correct(sample.rate_rad_s, force(sample.output_mps2), None)
    });
    let vector = [0, 1, 2].map(|i| 0.5 * (a[i] + b[i]) * pair[1].step_s);
    let (sin, cos) = (0.5 * norm(vector)).sin_cos();
    let axis = if norm(vector) > 0.0 { unit(vector) } else { [0.0; 3] };
    [cos, sin * axis[0], sin * axis[1], sin * axis[2]]
}

/// Angle between the direction of gravity at `to` and that predicted from `from`, rad.
fn prediction(
    model: &GyroscopeModel,
    accelerometer: &AccelerometerCalibration,
    samples: &[SixAxisSample],
    [from, to]: [&Pose; 2],
) -> f64 {
    let force = |output| accelerometer.model.correct(SpecificForceMps2(output), None).0;
    let start = (from.first_sample + u64::from(from.samples)) as usize - 1;
    let turn = &samples[start..=to.first_sample as usize];
    let q =
        turn.windows(2).fold([1.0, 0.0, 0.0, 0.0], |q, pair| product(q, step(model, pair, force)));
    let up = unit(force(from.mean_mps2));
    let inverse = [q[0], -q[1], -q[2], -q[3]];
    let [_, x, y, z] = product(product(inverse, [0.0, up[0], up[1], up[2]]), q);
    let found = unit(force(to.mean_mps2));
    norm(cross([x, y, z], found)).atan2((0..3).map(|i| [x, y, z][i] * found[i]).sum())
}

fn estimate(
    samples: &[SixAxisSample],
    poses: &[Pose],
    accelerometer: &AccelerometerCalibration,
    full_scale: Option<f64>,
) -> GyroscopeEstimate {
    let session = GyroscopeSession { poses, samples, accelerometer, full_scale_rad_s: full_scale };
    session.estimate().expect("an estimate")
}

fn rms(angles: &[f64]) -> f64 {
    (angles.iter().map(|a| a * a).sum::<f64>() / angles.len() as f64).sqrt() / DEGREE
}

#[test]
fn gyroscopes_of_eight_mpu9150_predict_gravity_better_than_before() {
    let Some(rows) = recording("array/mimu4444_run1.csv") else {
        return;
    };
    let full_scale = Some(32_700.0 / 16.4 * DEGREE);
    let (mut before, mut bias, mut after, mut left_out) = (vec![], vec![], vec![], vec![]);
    for chip in 0..Lane::current().choose([1, 2, 8]) {
        let column = 1 + 6 * chip;
        let units = [9.80665 / 2048.0, DEGREE / 16.4];
        let samples = samples(&rows, [column, column + 3], units);
        let poses = rests(&samples, 62.5);
        let fitted =
            multi_position(&poses, Gravity::new(9.818, 0.001).unwrap(), ROBUST).expect("poses");
        let accelerometer = AccelerometerCalibration::from(&fitted);
        let all = estimate(&samples, &poses, &accelerometer, full_scale);
        println!(
            "chip {chip}: {} rests, {} turns, {:.2}° before, {:.3}° after; scale {:.4?} ± {:.4}; left out {:?}; {}",
            poses.len(),
            all.turns,
            all.before_rad / DEGREE,
            all.rms_rad / DEGREE,
            [0, 1, 2].map(|i| all.model.terms().matrix[i][i]),
            all.sd(3),
            all.left_out,
            all.advice().unwrap_or_default(),
        );
        let used = |k: &usize| all.left_out.iter().all(|(turn, _)| *turn != *k);
        for k in (0..poses.len() - 1).filter(used) {
            let pair = [&poses[k], &poses[k + 1]];
            // A step of a minute is a gap: the turn is not used.
            let mut without = samples.clone();
            without[pair[1].first_sample as usize - 1].step_s = 60.0;
            let found = estimate(&without, &poses, &accelerometer, full_scale);
            let predicted =
                |model: &GyroscopeModel| prediction(model, &accelerometer, &samples, pair);
            before.push(predicted(&GyroscopeModel::default()));
            let bias_rad_s = all.model.terms().bias_rad_s;
            let alone = GyroscopeTerms { bias_rad_s, ..GyroscopeTerms::default() };
            bias.push(predicted(&GyroscopeModel::new(alone).unwrap()));
            after.push(predicted(&all.model));
            left_out.push(predicted(&found.model));
        }
    }
    let [before, bias, after, left_out] =
        [before, bias, after, left_out].map(|angles| rms(&angles));
    figure(
        "8 gyroscopes, gravity predicted: uncalibrated, bias, calibrated, left out, ° rms",
        format!("{before:.2}, {bias:.3}, {after:.3}, {left_out:.3}"),
        "leave-one-out below before",
        left_out < before,
    );
    assert!(left_out < before / 2.0);
}

#[test]
fn the_orientation_of_broad_is_not_worse_after_calibration() {
    let Some(rows) = recording("motion/broad_slow_translation_A.csv") else {
        return;
    };
    let samples = samples(&rows, [1, 4], [1.0, 1.0]);
    let poses = rests(&samples, 142.9);
    let accelerometer = AccelerometerCalibration::uncalibrated();
    let found = estimate(&samples, &poses, &accelerometer, None);
    let truth = |k: usize| [0, 1, 2, 3].map(|i| rows[k][13 + i].parse::<f64>().unwrap_or(f64::NAN));
    let error = |model: &GyroscopeModel| {
        let mut q = truth(0);
        let mut angles = vec![];
        for (k, pair) in samples.windows(2).enumerate() {
            q = product(q, step(model, pair, |f| f));
            let [w, x, y, z] = truth(k + 1);
            let [_, a, b, c] = product([w, -x, -y, -z], q);
            let angle = 2.0 * norm([a, b, c]).min(1.0).asin();
            angles.extend(angle.is_finite().then_some(angle));
        }
        rms(&angles)
    };
    let [before, after] = [GyroscopeModel::default(), found.model].map(|model| error(&model));
    let observed = (0..21).filter(|i| found.observed(*i)).count();
    println!(
        "{} rests, {} turns, {observed} of 21 observed, bias {:?}",
        poses.len(),
        found.turns,
        found.model.terms().bias_rad_s
    );
    figure(
        "BROAD slow A: orientation from the gyroscope alone, before and after calibration, ° rms",
        format!("{before:.2}, {after:.2}"),
        "not larger",
        after <= before,
    );
    assert!(after <= before, "{before} {after}");
}

#[test]
fn a_magnetometer_that_was_only_translated_is_not_calibrated() {
    let Some(rows) = recording("motion/broad_slow_translation_A.csv") else {
        return;
    };
    // Ten times a second: true attitude, and field, nT.
    let all: Vec<([f64; 4], [f64; 3])> = (rows.iter().step_by(14))
        .map(|row| {
            let q = [0, 1, 2, 3].map(|i| row[13 + i].parse().unwrap_or(f64::NAN));
            (q, vector(row, 7, 1e3))
        })
        .filter(|(q, _)| q[0].is_finite())
        .collect();
    let inverse = |q: [f64; 4]| [q[0], -q[1], -q[2], -q[3]];
    let level = all.iter().map(|(q, [x, y, z])| {
        let [_, e, n, _] = product(product(*q, [0.0, *x, *y, *z]), inverse(*q));
        [e / e.hypot(n), n / e.hypot(n)]
    });
    let [e, n] = (level.clone()).fold([0.0; 2], |sum, v| [sum[0] + v[0], sum[1] + v[1]]);
    let off: Vec<f64> = level.map(|v| (e * v[1] - n * v[0]).atan2(e * v[0] + n * v[1])).collect();
    let poses: Vec<MagneticPose> = (all.iter().step_by(all.len() / 100))
        .map(|(q, output_nt)| {
            let [_, x, y, z] = product(product(inverse(*q), [0.0, 0.0, 0.0, 1.0]), *q);
            let (output_nt, up) = (*output_nt, [x, y, z]);
            MagneticPose { output_nt, up }
        })
        .collect();
    let refused = magnetometer(&poses, None);
    figure(
        "BROAD slow A: heading of the uncalibrated magnetometer, ° rms; calibration",
        format!("{:.2}, {}", rms(&off), if refused.is_ok() { "made" } else { "refused" }),
        "refused: no pose is upside down",
        refused.is_err(),
    );
    assert!(matches!(refused, Err(Refusal { reason: Reason::NotObservable, .. })), "{refused:?}");
}
