//! Regression of an axis of the output on all axes of the reference: equation (50).

use core::array::from_fn;

use nalgebra::{Matrix3, Matrix4, SymmetricEigen, Vector3, Vector4};

use super::sums::{Central, LAGS, Pair, Sums};
use crate::terms::USUAL_ACROSS;

/// Smallest lagged over unlagged covariance for samples with common motion.
const LEAST_SHARED: f64 = 0.9;
/// Largest autocorrelation of white residuals: absolute, and in standard deviations of that of
/// white noise.
const WHITE: f64 = 0.05;
const WHITE_DEVIATIONS: f64 = 3.0;
/// Standard deviation of the mean of the bounds relative to their difference, for a 95 % interval
/// with 15 degrees of freedom.
const BOUND: f64 = 0.25;
/// Largest number of iterations; convergence is quadratic.
const STEPS: usize = 60;

/// b, then the row of A − I.
pub(super) type Row = Vector4<f64>;

/// A regression: one axis of the output, and the axes of the reference that it is fitted to.
#[derive(Clone, Copy)]
pub(super) struct Fitting {
    pub axis: usize,
    /// Origins of the sums: reference, output.
    pub origins: Pair,
    pub with: [bool; 3],
}

/// Method of a regression.
#[derive(Clone, Copy)]
pub(super) enum How {
    /// From lagged products, index into [`LAGS`].
    Neighbours(usize),
    /// The mean of the bounds: all noise in one stream or in the other.
    Bounds,
}

impl Fitting {
    /// Selects the axes whose motion, without the part that is correlated with the axes already
    /// selected, is at least `least` rms. With `parallel`, only the own axis.
    pub fn new(axis: usize, origins: Pair, spread: &Central, least: f64, parallel: bool) -> Self {
        let mut fitting = Self { axis, origins, with: from_fn(|other| other == axis) };
        for _ in 0..if parallel { 0 } else { 2 } {
            let alone = (0..3).filter(|&other| !fitting.with[other]).map(|other| {
                let along = fitting.along(spread, other).unwrap_or_default();
                let all = spread.xx.column(other);
                (spread.xx[(other, other)] - along.dot(&all), other)
            });
            match alone.max_by(|a, b| a.0.total_cmp(&b.0)) {
                Some((alone, other)) if alone >= least * least => fitting.with[other] = true,
                _ => break,
            }
        }
        fitting
    }

    /// Regression of `other`, which is not fitted, on the fitted axes.
    fn along(&self, spread: &Central, other: usize) -> Option<Vector3<f64>> {
        self.solve(spread, [0.0; 3], |i| spread.xx[(i, other)])
    }

    /// (xx − diag `noise`)⁻¹ `right`, restricted to the fitted axes.
    fn solve(
        &self,
        spread: &Central,
        noise: [f64; 3],
        right: impl Fn(usize) -> f64,
    ) -> Option<Vector3<f64>> {
        let matrix = Matrix3::from_fn(|i, j| match (self.with[i] && self.with[j], i == j) {
            (true, true) => spread.xx[(i, i)] - noise[i],
            (true, false) => spread.xx[(i, j)],
            (false, same) => f64::from(u8::from(same)),
        });
        let right = Vector3::from_fn(|i, _| if self.with[i] { right(i) } else { 0.0 });
        Some(matrix.cholesky()?.solve(&right))
    }

    /// Covariance of the reference with output minus reference.
    fn apart(&self, spread: &Central, i: usize) -> f64 {
        spread.xy[(i, self.axis)] - spread.xx[(i, self.axis)]
    }

    /// Residual variance of the output.
    pub fn left(&self, spread: &Central, sees: &Vector3<f64>) -> f64 {
        let own = self.axis;
        let apart = spread.yy[own] - 2.0 * spread.xy[(own, own)] + spread.xx[(own, own)];
        let with = Vector3::from_fn(|i, _| self.apart(spread, i));
        apart - 2.0 * sees.dot(&with) + sees.dot(&(spread.xx * sees))
    }

    /// Errors-in-variables regression: the residual variance is divided in the ratio δ for the
    /// output and `shares` for the axes of the reference. Newton iteration for their common factor.
    fn deming(&self, spread: &Central, delta: f64, shares: [f64; 3]) -> Option<Vector3<f64>> {
        let own = Vector3::from_fn(|i, _| f64::from(u8::from(i == self.axis)));
        let (mut last, mut factor) = (0.0, 0.0_f64);
        let mut best = None;
        for _ in 0..STEPS {
            let noise = shares.map(|share| share * factor);
            let found = self.solve(spread, noise, |i| self.apart(spread, i) + noise[i] * own[i]);
            let Some(sees) = found else {
                // The noise exceeds the motion.
                best?;
                factor = 0.5 * (last + factor);
                continue;
            };
            let all = sees + own;
            let of_noise: f64 = (0..3).map(|i| shares[i] * all[i] * all[i]).sum();
            (last, best) = (factor, Some(sees));
            factor = self.left(spread, &sees) / (delta + of_noise);
            if (factor - last).abs() <= 1e-15 * spread.xx.trace() {
                break;
            }
        }
        best
    }

    /// Adds b: the regression passes through the means.
    fn row(&self, spread: &Central, sees: Vector3<f64>) -> Row {
        let [x, y] = self.origins.map(|origin| origin[self.axis]);
        let apart = (y - x) + (spread.y[self.axis] - spread.x[self.axis]);
        Vector4::new(apart - sees.dot(&self.means(spread)), sees[0], sees[1], sees[2])
    }

    /// Means of the reference.
    fn means(&self, spread: &Central) -> Vector3<f64> {
        self.origins[0] + spread.x
    }

    /// Bounds: all noise in the output, all in the own axis of the reference.
    fn bounds(&self, spread: &Central) -> Option<[Row; 2]> {
        let low = self.deming(spread, 1.0, [0.0; 3])?;
        let own = from_fn(|i| f64::from(u8::from(i == self.axis)));
        let high = self.deming(spread, 0.0, own)?;
        Some([low, high].map(|sees| self.row(spread, sees)))
    }

    /// The row by the given method.
    pub fn find(&self, sums: &Sums, how: How) -> Option<Row> {
        let spread = sums.central();
        let shares = self.with.map(|with| f64::from(u8::from(with)));
        let row = match how {
            How::Neighbours(lag) => {
                self.row(&spread, self.deming(&sums.lagged(lag)?, 1.0, shares)?)
            }
            How::Bounds => {
                let [low, high] = self.bounds(&spread)?;
                0.5 * (low + high)
            }
        };
        row.iter().all(|value| value.is_finite()).then_some(row)
    }

    /// The method with the longest lag at which the motion is correlated and the residual is white.
    pub fn how(&self, sums: &Sums) -> How {
        let (spread, own) = (sums.central(), self.axis);
        let white = WHITE.max(WHITE_DEVIATIONS / libm::sqrt(spread.n));
        let is_white = |lag: &usize| {
            let shared = sums.lagged(*lag)?;
            if shared.xy[(own, own)] < LEAST_SHARED * spread.xy[(own, own)] {
                return None;
            }
            let shares = self.with.map(|with| f64::from(u8::from(with)));
            let sees = self.deming(&shared, 1.0, shares)?;
            let left = self.left(&spread, &sees).max(f64::MIN_POSITIVE);
            (self.left(&shared, &sees).abs() <= white * left).then_some(())
        };
        let lag = (0..LAGS.len()).rev().find(|lag| is_white(lag).is_some());
        lag.map_or(How::Bounds, How::Neighbours)
    }

    /// Covariance from the differences between blocks, each with the row fitted without it, and the
    /// degrees of freedom of each variance: equation (51).
    pub fn scatter(
        &self,
        row: &Row,
        all: &Sums,
        blocks: impl Iterator<Item = (Sums, Option<Row>)>,
    ) -> Option<(Matrix4<f64>, [f64; 4])> {
        // In coordinates with unit information.
        let whole = self.information(all).cholesky()?;
        let root = whole.l();
        let inverse = root.solve_lower_triangular(&Matrix4::identity())?;
        let mut covariance = Matrix4::zeros();
        let mut squares = [0.0; 4];
        for (block, without) in blocks {
            let off = root.transpose() * (without? - row);
            let share = root.solve_lower_triangular(&self.information(&block))?;
            let share = root.solve_lower_triangular(&share.transpose())?;
            for (square, column) in squares.iter_mut().zip(inverse.column_iter()) {
                let fraction = column.dot(&(share * column)) / column.norm_squared();
                *square += fraction * fraction;
            }
            // A block is part of the whole, which reduces the difference accordingly.
            let own = SymmetricEigen::new(share);
            let of = own.eigenvectors.transpose() * off;
            let less = own.eigenvalues.map(|fraction| libm::sqrt((1.0 - fraction).clamp(0.0, 1.0)));
            let off = root
                .transpose()
                .solve_upper_triangular(&(own.eigenvectors * of.component_mul(&less)))?;
            covariance += off * off.transpose();
        }
        // Effective number of blocks, minus one for the mean.
        Some((covariance, squares.map(|square| (1.0 / square - 1.0).max(1.0))))
    }

    /// Information on a row for unit variance of a sample: sums of products of 1 and the fitted
    /// axes.
    fn information(&self, sums: &Sums) -> Matrix4<f64> {
        let spread = sums.central();
        let mean = self.means(&spread);
        let with = |i: usize| i == 0 || self.with[i - 1];
        Matrix4::from_fn(|i, j| match (i, j) {
            _ if !with(i) || !with(j) => 0.0,
            (0, 0) => spread.n,
            (0, k) | (k, 0) => spread.n * mean[k - 1],
            _ => spread.n * (spread.xx[(i - 1, j - 1)] + mean[i - 1] * mean[j - 1]),
        }) + Matrix4::from_fn(|i, j| f64::from(u8::from(i == j && !with(i))))
    }

    /// Adds the covariance that does not show between blocks: from the method, and from the axes of
    /// the reference that are not fitted.
    pub fn add_unseen(
        &self,
        covariance: &mut Matrix4<f64>,
        sums: &Sums,
        how: How,
        parallel: bool,
    ) -> Option<()> {
        let spread = sums.central();
        match how {
            How::Neighbours(lag) => {
                // Correlated noise belongs to the output or to its axis.
                let shared = sums.lagged(lag)?;
                let sees = self.find(sums, how)?.fixed_rows::<3>(1).into_owned();
                let alike = self.left(&shared, &sees);
                let own = |i: usize| if i == self.axis { alike } else { 0.0 };
                let off = self.solve(&shared, [0.0; 3], own)?;
                let bias = -off.dot(&self.means(&spread));
                let off = Vector4::new(bias, off[0], off[1], off[2]);
                *covariance += off * off.transpose();
            }
            How::Bounds => {
                // The true value may be at one of the bounds, with noise in addition.
                let [low, high] = self.bounds(&spread)?;
                let off = BOUND * (high - low);
                let size = off[1 + self.axis].abs();
                let own = libm::sqrt(covariance[(1 + self.axis, 1 + self.axis)].max(0.0));
                if size > 0.0 {
                    *covariance += off * off.transpose() * (1.0 + 2.0 * own / size);
                }
            }
        }
        let out = |other: &usize| !parallel && !self.with[*other];
        for other in (0..3).filter(out) {
            // Its mean appears as bias, the correlated part as sensitivity to other axes.
            let along = self.along(&spread, other)?;
            let means = self.means(&spread);
            let mean = means[other] - along.dot(&means);
            let mut off = Vector4::new(mean, along[0], along[1], along[2]);
            off[1 + other] = -1.0;
            *covariance += USUAL_ACROSS * USUAL_ACROSS * off * off.transpose();
        }
        Some(())
    }
}
