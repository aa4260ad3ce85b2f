//! Positions from the first ranges alone: robust least squares from several points, with the bias that all ranges have in
//! common.

use nalgebra::{Matrix3, Matrix4, SymmetricEigen, Vector3, Vector4};

use super::model::Model;
use crate::inertial::aids::Aid;

/// Time whose ranges are used, s, and the least number of ranges.
pub(super) const LENGTH_S: f64 = 1.0;
pub(super) const LEAST: usize = 12;
/// Standard deviations of a range in successive rounds, m: the cost function of the first one has few local minima. The
/// last one holds what the unit moves within the time.
const ROUNDS_M: [f64; 5] = [3.0, 1.0, 0.5, 0.3, 0.3];
const ITERATIONS: usize = 8;
/// Two positions closer than this, m, are one.
const DISTINCT_M: f64 = 0.6;
/// Logarithm of the odds beyond which a position is not a candidate.
const ODDS: f64 = 30.0;
/// Standard deviation of the distance from the mean anchor, m: it only regularises.
const FAR_M: f64 = 1e3;

/// Standard deviation of the common bias, m: antenna delays that are not calibrated, 0.75 m in public reports of DW1000 users
/// (thotro/arduino-dw1000, issues 6 and 121).
const BIAS_M: f64 = 1.0;
/// Information of a direction that no range has: a dilution of ten.
const LEAST_INFORMATION: f64 = 0.01;
/// Candidates, at most.
const MOST: usize = 4;

/// A position that explains ranges.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    pub position_m: Vector3<f64>,
    /// Largest standard deviation of a component, m.
    pub deviation_m: f64,
    pub log_likelihood: f64,
}

/// Positions that explain the first ranges, the most probable first.
pub(super) fn candidates(anchors: &[Vector3<f64>], ranges: &[Aid], model: &Model) -> Vec<Found> {
    let Some(first) = ranges.first() else {
        return Vec::new();
    };
    let count = ranges.partition_point(|r| r.time_s < first.time_s + LENGTH_S);
    let used = &ranges[..count.max(LEAST).min(ranges.len())];
    let centre = anchors.iter().sum::<Vector3<f64>>() / anchors.len() as f64;
    let mean_m = used.iter().map(|r| r.value[0]).sum::<f64>() / used.len() as f64;
    let axes = principal_axes(anchors, &centre);
    let from = axes.column_iter().flat_map(|axis| {
        let step = axis.into_owned() * (0.5 * mean_m);
        [centre + step, centre - step]
    });
    let mut found: Vec<Found> = Vec::new();
    for mut position in from {
        if model.planar {
            position.z = centre.z;
        }
        let problem =
            Problem { anchors, used, model, centre, systematic_m: systematic_m(mean_m, model) };
        let Some(new) = problem.solve(position) else {
            continue;
        };
        let near = |known: &&mut Found| (known.position_m - new.position_m).norm() < DISTINCT_M;
        match found.iter_mut().find(near) {
            Some(known) if known.log_likelihood < new.log_likelihood => *known = new,
            Some(_) => {}
            None => found.push(new),
        }
    }
    found.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
    let most = found.first().map_or(0.0, |best| best.log_likelihood);
    found.retain(|one| most - one.log_likelihood < ODDS);
    found.truncate(MOST);
    found
}

/// Principal axes of the anchors, the longest first; in a plane or line the last ones are its normals.
pub(super) fn principal_axes(anchors: &[Vector3<f64>], centre: &Vector3<f64>) -> Matrix3<f64> {
    let outer = |a: &Vector3<f64>| (a - centre) * (a - centre).transpose();
    let eigen = SymmetricEigen::new(anchors.iter().map(outer).sum::<Matrix3<f64>>());
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    Matrix3::from_columns(&order.map(|k| eigen.eigenvectors.column(k).into_owned()))
}

struct Problem<'a> {
    anchors: &'a [Vector3<f64>],
    used: &'a [Aid],
    model: &'a Model,
    centre: Vector3<f64>,
    systematic_m: f64,
}

/// Standard deviation of a range, m, from the bias of its anchor and its scale error.
fn systematic_m(range_m: f64, model: &Model) -> f64 {
    model.ranges.bias_m.hypot(model.ranges.scale.hypot(model.common[1]) * range_m)
}

impl Problem<'_> {
    /// Gauss–Newton with the weights of the mixture.
    fn solve(&self, mut position_m: Vector3<f64>) -> Option<Found> {
        let (mut log_likelihood, mut noise_m, mut bias_m) = (0.0, 0.0, 0.0);
        let prior = Vector4::new(FAR_M, FAR_M, FAR_M, BIAS_M).map(|sd| sd.powi(-2));
        for round_m in ROUNDS_M {
            for _ in 0..ITERATIONS {
                let mut information = Matrix4::from_diagonal(&prior);
                let from = self.centre - position_m;
                let mut gradient = prior.component_mul(&from.push(-bias_m));
                log_likelihood = 0.0;
                for range in self.used {
                    let difference = position_m - self.anchors[range.source];
                    let distance = difference.norm();
                    let mut direction = difference / distance.max(1e-6);
                    if self.model.planar {
                        direction.z = 0.0;
                    }
                    let variance = round_m.max(self.systematic_m).powi(2);
                    let innovation_m = range.value[0] - bias_m - distance;
                    let found = self.model.line_of_sight.weigh(innovation_m, variance);
                    let weight = found.weight / variance;
                    let direction = direction.push(1.0);
                    information += direction * direction.transpose() * weight;
                    gradient += direction * (found.innovation_m * weight);
                    log_likelihood += found.log_likelihood;
                }
                let factor = information.cholesky()?;
                let step = factor.solve(&gradient);
                position_m += step.xyz();
                bias_m += step.w;
                noise_m = self.largest(&factor.inverse().fixed_view::<3, 3>(0, 0).into_owned());
            }
        }
        let deviation_m = noise_m.hypot(self.systematic_m * self.dilution(&position_m)?);
        Some(Found { position_m, deviation_m, log_likelihood })
    }

    /// Largest standard deviation of a component.
    fn largest(&self, covariance: &Matrix3<f64>) -> f64 {
        let axes = if self.model.planar { 2 } else { 3 };
        covariance.diagonal().rows(0, axes).max().sqrt()
    }

    /// Dilution of precision: the deviation of the position over that of a range, with one range to each anchor.
    fn dilution(&self, position_m: &Vector3<f64>) -> Option<f64> {
        let mut seen: Vec<usize> = self.used.iter().map(|range| range.source).collect();
        seen.sort_unstable();
        seen.dedup();
        let mut information = Matrix3::identity() * LEAST_INFORMATION;
        for anchor in seen {
            let difference = position_m - self.anchors[anchor];
            let direction = difference / difference.norm().max(1e-6);
            information += direction * direction.transpose();
        }
        Some(self.largest(&information.try_inverse()?))
    }
}
