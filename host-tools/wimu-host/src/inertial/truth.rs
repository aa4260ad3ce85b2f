//! A path against the true one.

use nalgebra::{Matrix3, Vector3};
use serde::ser::{Serialize, SerializeMap, Serializer};

use super::{InertialPath, PathPoint};
use crate::imu::Truth;
use crate::stats::median;

/// Normalised estimation errors squared, as JSON their median and their share below 7.81; null of none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Nees {
    /// Of each sample.
    pub all: Vec<f64>,
    /// Whether the truth has no heading, and the one was taken that fits the path best: they then say nothing of it.
    pub is_heading_fitted: bool,
}

impl Serialize for Nees {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let Some((median, below)) = consistency(&self.all) else {
            return to.serialize_none();
        };
        let mut map = to.serialize_map(Some(4))?;
        map.serialize_entry("samples", &self.all.len())?;
        map.serialize_entry("median", &median)?;
        map.serialize_entry("share_below_7_81", &below)?;
        let heading = if self.is_heading_fitted { "fitted" } else { "truth" };
        map.serialize_entry("heading", heading)?;
        map.end()
    }
}

/// Median NEES of three components and the share below 7.81 (95 % of a right covariance); `None` of none.
pub fn consistency(nees: &[f64]) -> Option<(f64, f64)> {
    let below = nees.iter().filter(|n| **n < 7.81).count();
    let median = median(nees.iter().copied())?;
    Some((median, below as f64 / nees.len() as f64))
}

/// Heading of the rotation from body to navigation axes: angle of body x from east towards north, rad.
fn heading_rad([w, x, y, z]: [f64; 4]) -> f64 {
    (2.0 * (x * y + w * z)).atan2(1.0 - 2.0 * (y * y + z * z))
}

/// eᵀ P⁻¹ e of an error with covariance P; infinite where P is not positive definite.
pub fn nees(error: [f64; 3], covariance: [[f64; 3]; 3]) -> f64 {
    let error = Vector3::from(error);
    let factor = Matrix3::from(covariance).cholesky();
    factor.map_or(f64::INFINITY, |factor| error.dot(&factor.solve(&error)))
}

/// The truth is right to this, m.
const TRUTH_M: f64 = 0.001;

/// A truth that is faster than this moves, m/s over [`OVER_S`].
const MOVING_MPS: f64 = 0.05;
const OVER_S: f64 = 0.2;
/// An array that truly turns faster than this moves, rad/s.
const TURNING_RAD_S: f64 = 1.0;

/// Which samples move, as the file's column `Moving` says, else by the true positions and angular rates. At rest the
/// error is that of the last motion, or zero by definition: NEES there says nothing new.
pub(super) fn moving(
    times_s: &[f64],
    column: Option<&[f64]>,
    truth: &[Option<Truth>],
    rate_rad_s: &[Option<[f64; 3]>],
) -> Vec<bool> {
    if let Some(column) = column {
        return column.iter().map(|moving| *moving > 0.5).collect();
    }
    let square = |v: [f64; 3]| v.iter().map(|c| c * c).sum::<f64>();
    let turns =
        |k| rate_rad_s.get(k).copied().flatten().map_or(0.0, square) > TURNING_RAD_S.powi(2);
    let mut all: Vec<bool> = (0..times_s.len()).map(turns).collect();
    let known = (0..times_s.len()).filter_map(|k| Some((k, (*truth.get(k)?)?.position_m)));
    let known: Vec<(usize, [f64; 3])> = known.collect();
    for (j, (k, _)) in known.iter().enumerate() {
        let until = |at_s: f64| known.partition_point(|(k, _)| times_s[*k] < at_s);
        let from = until(times_s[*k] - 0.5 * OVER_S).min(j.saturating_sub(1));
        let to = until(times_s[*k] + 0.5 * OVER_S).max(j + 1);
        let ((a, before), (b, after)) = (known[from], known[to.min(known.len() - 1)]);
        let apart = std::array::from_fn(|i| after[i] - before[i]);
        all[*k] |= square(apart).sqrt() > MOVING_MPS * (times_s[b] - times_s[a]);
    }
    all
}

/// NEES where there is truth and the unit moves: both paths begin at the origin, at the same heading, or at that
/// which fits best where the truth has none.
pub(super) fn compare(path: &mut InertialPath, truth: &[Option<Truth>], moving: &[bool]) {
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
    let by = heading_rad(start.quaternion) - heading_rad(first.quaternion);
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
        let turned = [cos * way[0] + sin * way[1], cos * way[1] - sin * way[0], way[2]];
        std::array::from_fn(|i| first.position_m[i] + turned[i])
    };
    let of = |(point, truth): &(&PathPoint, Truth)| {
        let expected = in_path(truth);
        let mut p = point.covariance_m2;
        for (i, row) in p.iter_mut().enumerate() {
            row[i] += TRUTH_M * TRUTH_M;
        }
        nees(std::array::from_fn(|i| point.position_m[i] - expected[i]), p)
    };
    let moves = |(k, _): &(&usize, _)| moving.get(**k).is_some_and(|moves| *moves);
    let moved = usable.iter().zip(&both).filter(moves);
    let all = moved.map(|(_, both)| of(both)).collect();
    let truth_m = truth.iter().map(|t| Some(in_path(t.as_ref()?))).collect();
    path.truth_m = truth_m;
    path.nees = Nees { all, is_heading_fitted: fitted };
}
