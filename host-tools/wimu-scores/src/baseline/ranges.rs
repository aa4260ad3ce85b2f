//! Positions from ranges: least squares at each time, and an extended Kalman filter of constant velocity.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use crate::command::Point;
use crate::table::{ENU, Result, Table};

/// Standard deviation of a range, m, density of the acceleration, m²/s³, gate, σ, scale of the soft-L1 cost, m, and time of
/// the ranges for the start of the filter, s.
const NOISE_M: f64 = 0.1;
const DENSITY: f64 = 0.3;
const GATE: f64 = 3.5;
const ROBUST_M: f64 = 0.1;
const START_S: f64 = 2.0;

/// Time, position of the anchor, range; in one plane if the anchors have no heights.
pub type Range = (f64, Vector3<f64>, f64);

pub fn read(ranges: &Table, anchors: Table) -> Result<Vec<Range>> {
    let anchors = anchors.or_zero("Position U (m)");
    let (names, places) = (anchors.texts("Anchor")?, anchors.vectors("Position # (m)", ENU)?);
    let place = |name: &str| names.iter().position(|n| *n == name).map(|k| places[k]);
    let rows = ranges.times()?.into_iter().zip(ranges.texts("Anchor")?);
    let rows = rows.zip(ranges.numbers("Range (m)")?);
    let range = |((t, anchor), range): ((f64, &str), f64)| Some((t, place(anchor)?, range));
    let mut all: Vec<Range> = rows.filter_map(range).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(all)
}

/// Best of four starts above and below the anchors, by Gauss and Newton with a soft-L1 cost.
fn solve(ranges: &[Range]) -> Vector3<f64> {
    let centre = ranges.iter().map(|r| r.1).sum::<Vector3<f64>>() / ranges.len() as f64;
    let from = |up: f64| {
        let (mut position, mut cost) = (centre + Vector3::z() * up, f64::INFINITY);
        for _ in 0..20 {
            let (mut information, mut gradient) = (Matrix3::identity() * 1e-3, Vector3::zeros());
            cost = 0.0;
            for (_, anchor, range) in ranges {
                let direction = (position - anchor).normalize();
                let residual = range - (position - anchor).norm();
                let root = residual.hypot(ROBUST_M) / ROBUST_M;
                information += direction * direction.transpose() / root;
                gradient += direction * residual / root;
                cost += root;
            }
            position += information.try_inverse().unwrap_or_default() * gradient;
        }
        (cost, position)
    };
    let best = [0.5, -0.5, 1.5, -1.5].map(from).into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
    best.map_or(centre, |best| best.1)
}

/// A position at each time with four ranges and more.
pub fn least_squares(ranges: &[Range]) -> Vec<Point> {
    let epochs = ranges.chunk_by(|a, b| a.0 == b.0).filter(|epoch| epoch.len() >= 4);
    epochs.map(|epoch| Point::new(epoch[0].0, solve(epoch))).collect()
}

pub fn constant_velocity(ranges: &[Range]) -> Vec<Point> {
    let Some(&(mut now_s, ..)) = ranges.first() else { return Vec::new() };
    let first = ranges.partition_point(|range| range.0 < now_s + START_S);
    // In a plane height and climb are known to be zero.
    let level = if ranges.iter().all(|range| range.1.z == 0.0) { 0.0 } else { 1.0 };
    let axes = Vector3::new(1.0, 1.0, level);
    let (mut state, mut covariance) = (Vector6::zeros(), Matrix6::zeros());
    state.fixed_rows_mut::<3>(0).copy_from(&solve(&ranges[..first]).component_mul(&axes));
    covariance.fixed_view_mut::<3, 3>(0, 0).set_diagonal(&axes);
    covariance.fixed_view_mut::<3, 3>(3, 3).set_diagonal(&axes);
    let mut points = Vec::new();
    for (time_s, anchor, range) in ranges {
        let dt = time_s - now_s;
        now_s = *time_s;
        let mut change = Matrix6::identity();
        change.fixed_view_mut::<3, 3>(0, 3).fill_diagonal(dt);
        state = change * state;
        covariance = change * covariance * change.transpose();
        let noise = Matrix3::from_diagonal(&axes) * DENSITY * dt;
        for (row, column, factor) in
            [(0, 0, dt * dt / 3.0), (0, 3, dt / 2.0), (3, 0, dt / 2.0), (3, 3, 1.0)]
        {
            let mut block = covariance.fixed_view_mut::<3, 3>(row, column);
            block += noise * factor;
        }
        let difference = state.fixed_rows::<3>(0) - anchor;
        let mut direction = Vector6::zeros();
        direction.fixed_rows_mut::<3>(0).copy_from(&difference.normalize());
        let variance = direction.dot(&(covariance * direction)) + NOISE_M * NOISE_M;
        let innovation = range - difference.norm();
        if innovation * innovation < GATE * GATE * variance {
            let gain = covariance * direction / variance;
            state += gain * innovation;
            covariance -= gain * gain.transpose() * variance;
        }
        let sigma = Vector3::from_fn(|k, _| covariance[(k, k)].max(0.0).sqrt());
        points.push(Point { sigma, ..Point::new(*time_s, state.fixed_rows::<3>(0).into()) });
    }
    points
}
