//! A path against the true one.

use super::{InertialPath, PathPoint};
use crate::motion::{Truth, nees};

/// Median NEES of three components and the share below 7.81 (95 % of a right covariance); `None` of none.
pub fn consistency(nees: &[f64]) -> Option<(f64, f64)> {
    let mut all = nees.to_vec();
    all.sort_by(f64::total_cmp);
    let below = all.iter().filter(|n| **n < 7.81).count();
    Some((*all.get(all.len() / 2)?, below as f64 / all.len() as f64))
}

/// Direction of body x from east to north, rad.
pub(super) fn heading_rad([w, x, y, z]: [f64; 4]) -> f64 {
    (2.0 * (x * y + w * z)).atan2(1.0 - 2.0 * (y * y + z * z))
}

/// The truth is right to this, m.
const TRUTH_M: f64 = 0.001;

/// NEES where there is truth: both paths begin at the origin, at the same heading, or at that
/// which fits best where the truth has none.
pub(super) fn compare(path: &mut InertialPath, truth: &[Option<Truth>]) {
    let usable = |k: &usize| path.points[*k].valid && truth.get(*k).is_some_and(Option::is_some);
    let usable: Vec<usize> = (0..path.points.len()).filter(usable).collect();
    let of_sample = |k: &usize| Some((&path.points[*k], truth[*k]?));
    let both: Vec<(&PathPoint, Truth)> = usable.iter().filter_map(of_sample).collect();
    let begins = usable.partition_point(|k| *k < path.origin);
    let Some((first, start)) = both.get(begins).or(both.first()) else {
        return;
    };
    let ways = |(point, truth): &(&PathPoint, Truth)| {
        let found: [f64; 3] = std::array::from_fn(|i| point.position_m[i] - first.position_m[i]);
        let real: [f64; 3] = std::array::from_fn(|i| truth.position_m[i] - start.position_m[i]);
        (found, real)
    };
    let by = start.heading_rad() - heading_rad(first.quaternion);
    let fitted = !by.is_finite();
    let (sin, cos) = if fitted {
        let (mut sine, mut cosine) = (0.0, 0.0);
        for (found, real) in both.iter().map(ways) {
            sine += real[1] * found[0] - real[0] * found[1];
            cosine += real[0] * found[0] + real[1] * found[1];
        }
        f64::atan2(sine, cosine).sin_cos()
    } else {
        by.sin_cos()
    };
    let in_path = |truth: &Truth| -> [f64; 3] {
        let way: [f64; 3] = std::array::from_fn(|i| truth.position_m[i] - start.position_m[i]);
        let turned = [
            cos * way[0] + sin * way[1],
            cos * way[1] - sin * way[0],
            way[2],
        ];
        std::array::from_fn(|i| first.position_m[i] + turned[i])
    };
    let of = |(point, truth): &(&PathPoint, Truth)| {
        let expected = in_path(truth);
        let mut p = point.covariance_m2;
        for (i, row) in p.iter_mut().enumerate() {
            row[i] += TRUTH_M * TRUTH_M;
        }
        nees(
            std::array::from_fn(|i| point.position_m[i] - expected[i]),
            p,
        )
    };
    let all = both.iter().map(of).collect();
    let truth_m = truth.iter().map(|t| Some(in_path(t.as_ref()?))).collect();
    path.heading_fitted = fitted;
    path.truth_m = truth_m;
    path.nees = all;
}
