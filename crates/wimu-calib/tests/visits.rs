//! Orientations that come again: what a second visit tells, and what it does not.

use crate::common;

use common::{DrawModel as _, G, Random, exact, misplaced, parameters, pose};
use wimu_calib::{
    Estimate, Model, MultiPosition, Orientation, Pose, Refusal, Terms, best_model, multi_position,
    multi_position_with,
};
use wimu_model::{ErrorModel, ErrorTerms, SpecificForceMps2};
use wimu_testkit::{Coverage, coverage_figure, draws, trials};

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// `orientations` well spread ones, each held `visits` times: an error of `stays` m/s² that belongs to the
/// orientation, and of `new` with each visit.
fn session(
    random: &mut Random,
    truth: &ErrorModel,
    orientations: usize,
    visits: usize,
    [stays, new]: [f64; 2],
) -> Vec<Pose> {
    let ups: Vec<_> = Orientation::BY_EASE
        .into_iter()
        .take(orientations)
        .map(|orientation| misplaced(random, orientation.up(), 6.0 * DEGREE))
        .collect();
    let common: Vec<[f64; 3]> =
        ups.iter().map(|_| [0; 3].map(|_| stays * random.normal())).collect();
    let mut poses = Vec::new();
    for _ in 0..visits {
        for (up, common) in ups.iter().zip(&common) {
            let mut one = pose(truth, G, misplaced(random, *up, DEGREE));
            for (y, common) in one.mean_mps2.iter_mut().zip(common) {
                *y += common + new * random.normal();
            }
            poses.push(one);
        }
    }
    poses
}

/// A sensor as nine parameters have it.
fn sensor(random: &mut Random) -> ErrorModel {
    let terms: ErrorTerms = random.model(true).into();
    ErrorModel::new(terms).expect("within bounds")
}

type Fit = fn(&[Pose]) -> Result<Estimate, Refusal>;

/// Records how often 95 % intervals hold the truth, and asserts it of every kind of session.
fn assert_intervals_hold(claim: &str, fits: &[(&str, Fit)]) {
    let mut kinds = Vec::new();
    for (orientations, visits) in [(12, 1), (12, 3), (18, 3), (20, 2), (26, 4)] {
        for errors in [[0.005, 0.001], [0.0, 0.005], [0.003, 0.003]] {
            for (name, fit) in fits {
                let mut held = Coverage::default();
                for seed in 0..draws(400, 9) as u64 {
                    let mut random = Random::new(seed);
                    let truth = sensor(&mut random);
                    let poses = session(&mut random, &truth, orientations, visits, errors);
                    let estimate = fit(&poses).expect("an answer");
                    let (found, truth) = (parameters(&estimate.model), parameters(&truth));
                    for parameter in estimate.fitted.iter() {
                        let i = parameter.index();
                        let half_width = estimate.half_width_95(parameter);
                        held.count((found[i] - truth[i]).abs() <= half_width);
                    }
                }
                let kind = format!(
                    "{orientations} orientations, {visits} visits, {errors:?} m/s², {name}"
                );
                println!("{kind}: {held}");
                kinds.push((kind, held));
            }
        }
    }
    let held: Vec<_> = kinds.iter().map(|kind| kind.1).collect();
    coverage_figure(claim, &held, 0.93..=0.97);
    for (kind, held) in kinds {
        // Few orientations without an error of their own: what they could have is in the interval.
        held.assert_can_be(0.925..=0.985, &kind);
    }
}

#[test]
fn intervals_hold_where_an_error_comes_back_with_its_orientation_and_where_it_is_new() {
    assert_intervals_hold(
        "95 % intervals, an error that returns with its orientation",
        &[
            ("nine parameters", |poses| multi_position(poses, exact(), Model::Full9)),
            ("bad poses left out", |poses| {
                let what = MultiPosition { reject: true, ..MultiPosition::default() };
                multi_position_with(poses, exact(), what)
            }),
            ("auto", |poses| best_model(poses, exact(), Terms::NONE, true)),
        ],
    );
}

type Matrix = Vec<Vec<f64>>;

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    let of = |row: &Vec<f64>, c: usize| row.iter().zip(b).map(|(x, b)| x * b[c]).sum();
    a.iter().map(|row| (0..b[0].len()).map(|c| of(row, c)).collect()).collect()
}

fn transposed(a: &Matrix) -> Matrix {
    (0..a[0].len()).map(|c| a.iter().map(|row| row[c]).collect()).collect()
}

fn trace(a: &Matrix) -> f64 {
    (0..a.len()).map(|i| a[i][i]).sum()
}

/// a x + b y.
fn sum(x: f64, a: &Matrix, y: f64, b: &Matrix) -> Matrix {
    let add =
        |(a, b): (&Vec<f64>, &Vec<f64>)| a.iter().zip(b).map(|(a, b)| x * a + y * b).collect();
    a.iter().zip(b).map(add).collect()
}

/// By Gauss and Jordan.
fn inverse(a: &Matrix) -> Matrix {
    let n = a.len();
    let mut a = a.clone();
    for (r, row) in a.iter_mut().enumerate() {
        row.extend((0..n).map(|c| f64::from(c == r)));
    }
    for c in 0..n {
        let pivot = (c..n).max_by(|&i, &j| a[i][c].abs().total_cmp(&a[j][c].abs()));
        a.swap(c, pivot.expect("a row"));
        let row: Vec<f64> = a[c].iter().map(|x| x / a[c][c]).collect();
        for r in 0..n {
            let by = a[r][c];
            if r == c {
                a[r] = row.clone();
            } else {
                for (x, y) in a[r].iter_mut().zip(&row) {
                    *x -= by * y;
                }
            }
        }
    }
    a.into_iter().map(|row| row[n..].to_vec()).collect()
}

#[test]
fn the_covariance_is_that_of_the_two_variances_that_dense_matrices_give() {
    let mut shared = 0;
    for seed in 0..20 {
        let mut random = Random::new(seed);
        let truth = sensor(&mut random);
        let visits = 1 + seed as usize % 4;
        let mut poses = session(&mut random, &truth, 16, visits, [0.004, 0.002]);
        // Some orientations came more often than others.
        for k in 0..10 {
            let mut again = poses[k % 5];
            for y in &mut again.mean_mps2 {
                *y += 0.002 * random.normal();
            }
            poses.push(again);
        }
        let estimate = multi_position(&poses, exact(), Model::Full9).expect("an answer");
        let parameters: Vec<_> = estimate.fitted.iter().collect();
        let (n, p) = (poses.len(), parameters.len());

        // Derivatives by differences.
        let residual = |shift: Option<(usize, f64)>, pose: &Pose| {
            let mut terms: ErrorTerms = estimate.model.into();
            if let Some((i, by)) = shift {
                match i {
                    0..3 => terms.bias_mps2[i] += by,
                    _ => terms.matrix[(i - 3) / 3][(i - 3) % 3] += by,
                }
            }
            let model = ErrorModel::new(terms).expect("within bounds");
            model.correct(SpecificForceMps2(pose.mean_mps2), None).norm() - G
        };
        let r: Matrix = poses.iter().map(|pose| vec![residual(None, pose)]).collect();
        let derivative = |pose: &Pose, i: usize| {
            (residual(Some((i, 1e-5)), pose) - residual(Some((i, -1e-5)), pose)) / 2e-5
        };
        let row = |pose: &Pose| parameters.iter().map(|q| derivative(pose, q.index())).collect();
        let j: Matrix = poses.iter().map(row).collect();

        // The group of each pose: the first that points within 10° of it.
        let up = |pose: &Pose| common::unit(pose.mean_mps2);
        let mut first: Vec<[f64; 3]> = Vec::new();
        let group = |pose: &Pose| {
            let alike = |f: &[f64; 3]| (0..3).map(|i| f[i] * up(pose)[i]).sum::<f64>() > 0.9848;
            first.iter().position(alike).unwrap_or_else(|| {
                first.push(up(pose));
                first.len() - 1
            })
        };
        let groups: Vec<usize> = poses.iter().map(group).collect();
        assert_eq!(estimate.orientations, first.len());

        let unit: Matrix = (0..n).map(|a| (0..n).map(|b| f64::from(a == b)).collect()).collect();
        let same: Matrix =
            (0..n).map(|a| (0..n).map(|b| f64::from(groups[a] == groups[b])).collect()).collect();
        let b = inverse(&product(&transposed(&j), &j));
        let by_y = product(&b, &transposed(&j));
        let m = sum(1.0, &unit, -1.0, &product(&j, &by_y));
        let s = product(&transposed(&r), &r)[0][0];
        let t = product(&transposed(&r), &product(&same, &r))[0][0];
        let zm = product(&same, &m);
        let (a, k) = (trace(&zm), trace(&product(&zm, &zm)));
        let dof = (n - p) as f64;
        let beta = (dof * t - a * s) / (dof * k - a * a);
        let beta = if beta.is_nan() { 0.0 } else { beta.clamp(0.0, t / k) };
        let alpha = ((s - beta * a) / dof).max(0.0);
        let v = sum(alpha, &unit, beta, &same);
        let covariance = product(&product(&by_y, &v), &transposed(&by_y));
        shared += u32::from(beta > 0.0);
        for (i, one) in parameters.iter().enumerate() {
            for (l, other) in parameters.iter().enumerate() {
                let found = estimate.covariance.get(*one, *other);
                let size = (covariance[i][i] * covariance[l][l]).sqrt();
                let off = (found - covariance[i][l]).abs();
                assert!(off < 1e-4 * size, "{seed}: {found} {}", covariance[i][l]);
            }
        }
        // Freedoms of the sum between orientations by Satterthwaite: as many as orientations beyond the
        // parameters where each came as often.
        let freedoms = if beta > 0.0 { a * a / k } else { dof };
        let found = estimate.interval_dof.expect("from residuals");
        assert!((found / freedoms - 1.0).abs() < 1e-4, "{found} {freedoms}");

        // Without an orientation: fitted anew.
        let mut squares = 0.0;
        for out in 0..first.len() {
            let kept = |k: &usize| groups[*k] != out;
            let rest: Vec<Pose> = (0..n).filter(kept).map(|k| poses[k]).collect();
            let without = multi_position(&rest, exact(), Model::Full9).expect("an answer");
            for k in (0..n).filter(|&k| groups[k] == out) {
                squares += without.residual_mps2(&poses[k]).powi(2);
            }
        }
        let fresh = (squares / n as f64).sqrt();
        let reported = estimate.loo_orientation_rms_mps2.expect("some came again");
        assert!((reported / fresh - 1.0).abs() < 2e-3, "{reported} {fresh}");
    }
    assert!(shared >= 15, "{shared}");
}

#[test]
fn a_second_visit_does_not_replace_an_orientation() {
    // Ten orientations are too few to be left out one at a time; held twice, they still are.
    let mut refused = [Coverage::default(); 2];
    for seed in 0..trials(1000) as u64 {
        for visits in [1, 2] {
            let mut random = Random::new(seed);
            let truth = sensor(&mut random);
            let ups: Vec<_> = (0..10).map(|_| random.direction()).collect();
            let mut poses = Vec::new();
            for up in ups {
                let stays = [0; 3].map(|_| 0.005 * random.normal());
                for _ in 0..visits {
                    let mut one = pose(&truth, G, up);
                    for (y, stays) in one.mean_mps2.iter_mut().zip(stays) {
                        *y += stays + 0.001 * random.normal();
                    }
                    poses.push(one);
                }
            }
            let answer = multi_position(&poses, exact(), Model::Full9);
            refused[visits - 1].count(answer.is_err());
        }
    }
    let claim = "ten orientations, held once or twice, are refused";
    coverage_figure(claim, &refused, 0.7..=1.0);
    for (refused, visits) in refused.into_iter().zip(["once", "twice"]) {
        refused.assert_can_be(0.7..=1.0, visits);
    }
}
