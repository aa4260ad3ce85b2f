//! Real recordings, where they are beside the repository; each figure in README.md is printed here.

use crate::common;

use common::{AUTO, NINE, ROBUST, norm, recording, vector};
use wimu_calib::{
    Estimate, Gravity, MultiPosition, Parameter, Pose, Term, Terms, find_poses, multi_position,
};
use wimu_model::STANDARD_GRAVITY_MPS2;
use wimu_testkit::figure;

/// m/s² per count of a sensor with 2048 LSB/g.
const SCALE_2048: f64 = STANDARD_GRAVITY_MPS2 / 2048.0;

fn array_gravity() -> Gravity {
    Gravity::new(9.818, 0.0).expect("gravity")
}

fn poses(samples: &[[f64; 3]], rate_hz: f64) -> Vec<Pose> {
    find_poses(samples.iter().map(|y| (*y, None)), rate_hz)
}

fn rms_mm(estimate: &Estimate) -> f64 {
    estimate.rms_mps2 * 1e3
}

fn loo_mm(estimate: &Estimate) -> f64 {
    estimate.loo_rms_mps2.expect("multi-position has it") * 1e3
}

/// Records the residuals |f| − g and those of poses left out, mm/s² rms, beside the largest allowed ones.
fn residuals(of: &str, rms_loo: [f64; 2], bars: [Option<f64>; 2]) {
    let claim = format!("{of}: |f| − g, left out, mm/s² rms");
    let [rms, loo] = rms_loo.map(|value| format!("{value:.3}"));
    let words = bars.map(|bar| bar.map_or("–".into(), |bar| format!("{bar}")));
    let met = rms_loo.iter().zip(bars).all(|(value, bar)| bar.is_none_or(|bar| *value <= bar));
    let target = match bars {
        [None, None] => "–".into(),
        _ => format!("at most {} / {}", words[0], words[1]),
    };
    figure(&claim, format!("{rms} / {loo}"), &target, met);
}

#[test]
fn eight_mpu9150_in_four_runs_reach_the_reference() {
    let Some(rows) = recording("calibration/mpu9150_array_pose_means.csv") else {
        return;
    };
    println!("MPU-9150, mean of 8 sensors, nine parameters: rms, leave-one-out (mm/s²), condition");
    for (run, rms_bar, loo_bar) in
        [("1", 2.10, 3.82), ("2", 1.31, 2.29), ("7", 2.07, 3.76), ("8", 1.30, 2.36)]
    {
        let (mut rms, mut loo, mut condition) = (0.0, 0.0, 0.0_f64);
        for imu in 0..8 {
            let poses: Vec<Pose> = rows
                .iter()
                .filter(|row| row[0] == run && row[1] == imu.to_string())
                .map(|row| Pose::from_mean(vector(row, 5, SCALE_2048)))
                .collect();
            let estimate = multi_position(&poses, array_gravity(), NINE).expect("an answer");
            assert_eq!(estimate.dof, poses.len() - 9);
            rms += rms_mm(&estimate) / 8.0;
            loo += loo_mm(&estimate) / 8.0;
            condition = condition.max(estimate.condition());
        }
        println!("  run {run}: {rms:.3} {loo:.3} {condition:.2}");
        let of = format!("8 MPU-9150, run {run}, 9 parameters");
        residuals(&of, [rms, loo], [Some(rms_bar), Some(loo_bar)]);
        assert!(rms <= rms_bar && loo <= loo_bar && condition < 2.6);
    }
}

#[test]
fn twenty_poses_are_found_before_and_none_within_violent_motion() {
    let Some(rows) = recording("array/mimu4444_run1.csv") else {
        return;
    };
    let Some(reference) = recording("calibration/mpu9150_array_pose_means.csv") else {
        return;
    };
    let (mut rms, mut loo) = (0.0, 0.0);
    for imu in 0..8 {
        let samples: Vec<[f64; 3]> =
            rows.iter().map(|row| vector(row, 1 + 6 * imu, SCALE_2048)).collect();
        let poses = poses(&samples, 62.5);
        // Twenty, and the rest after the motion, 20 s before the end.
        assert!(poses.len() == 20 || poses.len() == 21, "IMU {imu}: {}", poses.len());
        assert!(poses.iter().all(|p| p.first_sample < 31_100 || p.first_sample > 37_000));
        // Those that another program found, within its rounding of where a pose ends.
        let known = reference
            .iter()
            .filter(|row| row[0] == "1" && row[1] == imu.to_string())
            .map(|row| norm(vector(row, 5, SCALE_2048)));
        for (k, (known, found)) in known.zip(&poses).enumerate() {
            assert!((known - norm(found.mean_mps2)).abs() < 0.004, "IMU {imu}, pose {k}");
        }
        let twenty = &poses[..20];
        let estimate = multi_position(twenty, array_gravity(), NINE).expect("an answer");
        rms += rms_mm(&estimate) / 8.0;
        loo += loo_mm(&estimate) / 8.0;
    }
    let of = "MIMU4444 run 1, poses found";
    residuals(of, [rms, loo], [Some(2.2), Some(4.0)]);
    assert!(rms <= 2.2 && loo <= 4.0);
}

#[test]
fn a_sensor_at_rest_for_minutes_is_in_one_pose() {
    let Some(rows) = recording("static/mpu6050_449s.csv") else {
        return;
    };
    let scale = STANDARD_GRAVITY_MPS2 / 16384.0;
    let samples: Vec<[f64; 3]> = rows.iter().map(|row| vector(row, 1, scale)).collect();
    assert_eq!(poses(&samples, 100.0).len(), 1);
}

#[test]
fn a_linear_drift_reaches_the_reference_and_priors_predict_as_well() {
    let Some(rows) = recording("calibration/mpu9150_array_pose_means.csv") else {
        return;
    };
    println!("MPU-9150, mean of 8 sensors: with drift, with priors: rms, leave-one-out (mm/s²)");
    for (run, drift_bar) in [("1", 1.17), ("2", 0.79), ("7", 0.75), ("8", 0.76)] {
        let mut sums = [0.0; 4];
        for imu in 0..8 {
            let poses: Vec<Pose> = rows
                .iter()
                .filter(|row| row[0] == run && row[1] == imu.to_string())
                .map(|row| Pose {
                    time_s: row[3].parse().expect("a time"),
                    ..Pose::from_mean(vector(row, 5, SCALE_2048))
                })
                .collect();
            let what = MultiPosition { terms: Terms::NONE.with(Term::Drift), ..ROBUST };
            let drift = multi_position(&poses, array_gravity(), what).expect("an answer");
            let auto = multi_position(&poses, array_gravity(), AUTO).expect("an answer");
            let found = [rms_mm(&drift), loo_mm(&drift), rms_mm(&auto), loo_mm(&auto)];
            for (sum, found) in sums.iter_mut().zip(found) {
                *sum += found / 8.0;
            }
        }
        println!("  run {run}: {sums:.3?}");
        let of = |model| format!("8 MPU-9150, run {run}, {model}");
        residuals(&of("9 and drift"), [sums[0], sums[1]], [Some(drift_bar), None]);
        residuals(&of("`auto`"), [sums[2], sums[3]], [None, Some(1.1 * sums[1])]);
        assert!(sums[0] <= drift_bar && sums[3] <= 1.1 * sums[1], "{sums:?}");
    }
}

/// Thirteen of the poses, drawn four times from each sensor of the runs: errors of the poses held out by `auto`, over
/// their predicted deviation, rms, over what a variance of few residuals and its prior make of it; half width of m_xz, mrad,
/// exceeded by a tenth of the draws.
fn held_out(rows: &[Vec<String>], runs: [&str; 2]) -> [f64; 2] {
    let (mut squares, mut expected, mut widths) = (0.0, 0.0, Vec::new());
    for run in runs {
        let mut random = common::Random::new(100 * run.parse::<u64>().expect("a number"));
        for draw in 0..32 {
            let of_sensor = |row: &&Vec<String>| row[0] == run && row[1] == (draw / 4).to_string();
            let mut poses: Vec<Pose> = (rows.iter().filter(of_sensor))
                .map(|row| Pose {
                    time_s: row[3].parse().expect("a time"),
                    ..Pose::from_mean(vector(row, 5, SCALE_2048))
                })
                .collect();
            for k in (1..poses.len()).rev() {
                poses.swap(k, random.below(k + 1));
            }
            let what = MultiPosition { terms: Terms::NONE.with(Term::Drift), ..ROBUST };
            let all = multi_position(&poses, array_gravity(), what).expect("an answer");
            let scatter = all.fitted_rms_mps2.powi(2) * all.poses as f64 / all.dof as f64;
            let (fitted, held) = poses.split_at(13);
            let auto = multi_position(fitted, array_gravity(), AUTO).expect("an answer");
            let back = |pose: &Pose| Pose { time_s: -pose.time_s, ..*pose };
            let reversed: Vec<Pose> = fitted.iter().map(back).collect();
            let reversed = multi_position(&reversed, array_gravity(), AUTO).expect("an answer");
            widths.push(auto.half_width_95(Parameter::MisalignmentXz) * 1e3);
            let freedom = auto.interval_dof.expect("of residuals");
            for pose in held {
                squares += auto.residual_mps2(pose).powi(2) / variance([&auto, &reversed], pose);
                // The variance that they show, with its prior of 3 mm/s² and one degree of freedom.
                let own: f64 = (1..freedom.round() as usize).map(|_| random.normal().powi(2)).sum();
                expected += freedom * scatter / (own * scatter + 9e-6);
            }
        }
    }
    widths.sort_by(f64::total_cmp);
    [f64::sqrt(squares / expected), widths[widths.len() * 9 / 10]]
}

/// Variance of |f| − g at a pose that was not fitted, by a fit with drift and the same of reversed times: the covariance of
/// an estimate is that at its last pose.
fn variance([estimate, reversed]: [&Estimate; 2], pose: &Pose) -> f64 {
    let size = norm(pose.mean_mps2);
    let up = pose.mean_mps2.map(|y| y / size);
    let by = |i: usize| match i {
        0..3 => up[i],
        i => size * up[(i - 3) / 3] * up[(i - 3) % 3],
    };
    let at_end = |estimate: &Estimate| {
        let matrix = estimate.covariance.matrix();
        (0..144).map(|k| by(k / 12) * by(k % 12) * matrix[k / 12][k % 12]).sum::<f64>()
    };
    let drift = estimate.drift.expect("the poses have times");
    let early = (drift.end_s - pose.time_s) / drift.span_s;
    let of_drift: f64 = (0..3).map(|axis| (up[axis] * estimate.term_sd[0][axis]).powi(2)).sum();
    let of_fit = (1.0 - early) * at_end(estimate) + early * at_end(reversed)
        - early * (1.0 - early) * of_drift;
    estimate.pose_sd_mps2.powi(2) + of_fit
}

#[test]
fn auto_predicts_poses_held_out_without_needless_intervals() {
    let Some(rows) = recording("calibration/mpu9150_array_pose_means.csv") else {
        return;
    };
    for (runs, most) in [(["1", "2"], 5.0), (["7", "8"], 5.0)] {
        let [deviate, width] = held_out(&rows, runs);
        figure(
            &format!(
                "8 MPU-9150, runs {}, `auto` of 13 poses: held out over expected; half width of m_xz, mrad",
                runs.join(" and ")
            ),
            format!("{deviate:.2}; {width:.2}"),
            &format!("0.7 to 1.4; at most {most}"),
            (0.7..1.4).contains(&deviate) && width <= most,
        );
        assert!((0.7..1.4).contains(&deviate) && width <= most, "{deviate}, {width}");
    }
}
