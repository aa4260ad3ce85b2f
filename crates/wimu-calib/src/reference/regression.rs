//! Regression of an axis of the output on axes of the reference with instruments: equations (50) and (51).
//!
//! y − x = c + a (x − x̄) + e is linear, but x has noise, which shrinks a of ordinary least squares. Instruments z without
//! that noise, the neighbouring samples of the reference, give Σ z e = 0 instead. Errors of a block of samples are
//! correlated, so the covariance is that of the sums of z e over blocks (sandwich).

use alloc::vec::Vec;

use nalgebra::{Matrix4, Vector3, Vector4};

use crate::terms::USUAL_ACROSS;

/// Distances of the neighbours, samples.
const LAGS: [usize; 5] = [1, 2, 4, 8, 16];
/// Largest number of blocks.
const BLOCKS: usize = 32;
/// Largest part of the motion in one block.
const MOST_OF_A_BLOCK: f64 = 0.9;
/// Smallest lagged over unlagged covariance for samples with common motion.
const LEAST_SHARED: f64 = 0.9;
/// Largest autocorrelation of white residuals: absolute, and in standard deviations of that of
/// white noise.
const WHITE: f64 = 0.05;
const WHITE_DEVIATIONS: f64 = 3.0;
/// Standard deviation of the mean of the bounds relative to their difference, for a 95 % interval
/// with 15 degrees of freedom.
const BOUND: f64 = 0.25;

/// A sample of the reference and of the output, m/s².
pub(super) type Pair = [Vector3<f64>; 2];
/// b, then the row of A − I.
type Row = Vector4<f64>;

/// Length of the blocks of `count` samples: a power of two.
pub(super) fn block_length(count: usize) -> usize {
    count.div_ceil(BLOCKS).next_power_of_two()
}

/// What the instruments are.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum How {
    /// The mean of both samples of the reference at this distance.
    Neighbours(usize),
    /// The reference: all noise is in the output.
    Low,
    /// The output instead of its axis of the reference: all noise is in that one.
    High,
    /// The mean of the last two.
    Bounds,
}

/// One axis of the output, and the axes of the reference that it is fitted to.
pub(super) struct Regression<'a> {
    samples: &'a [Pair],
    axis: usize,
    pub with: [bool; 3],
    /// Of the reference, and of the axis of the output.
    mean: Vector3<f64>,
    mean_output: f64,
}

/// A fitted row.
pub(super) struct Found {
    pub row: Row,
    /// What each block changes in the row.
    changes: Vec<Row>,
    /// (Σ z hᵀ)⁻¹, about the mean.
    inverse: Matrix4<f64>,
    residuals: Vec<f64>,
}

impl Found {
    /// Covariance from the differences between blocks: equation (51).
    pub fn scatter(&self) -> Matrix4<f64> {
        self.changes.iter().map(|change| change * change.transpose()).sum()
    }

    pub fn residual_variance(&self) -> f64 {
        let n = self.residuals.len() as f64;
        let mean = self.residuals.iter().sum::<f64>() / n;
        self.residuals.iter().map(|e| (e - mean) * (e - mean)).sum::<f64>() / n
    }
}

/// Mean product of samples that are `lag` apart.
fn lagged(a: &[f64], b: &[f64], lag: usize) -> f64 {
    let products = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let both = products(&a[lag..], b) + products(a, &b[lag..]);
    both / (2 * (a.len() - lag)) as f64
}

impl<'a> Regression<'a> {
    pub fn new(samples: &'a [Pair], axis: usize, with: [bool; 3]) -> Self {
        let n = samples.len() as f64;
        let mean = samples.iter().map(|pair| pair[0]).sum::<Vector3<f64>>() / n;
        let mean_output = samples.iter().map(|pair| pair[1][axis]).sum::<f64>() / n;
        Self { samples, axis, with, mean, mean_output }
    }

    /// Fits the own axis and, without `parallel`, those whose motion, without the part that is correlated with the axes
    /// already fitted, has a variance of at least `least`.
    pub fn with_motion(samples: &'a [Pair], axis: usize, least: f64, parallel: bool) -> Self {
        let mut fitting = Self::new(samples, axis, [0, 1, 2].map(|other| other == axis));
        if parallel {
            return fitting;
        }
        loop {
            let others = (0..3).filter(|other| !fitting.with[*other]);
            let alone = others.map(|other| (fitting.apart_from(other), other));
            match alone.max_by(|a, b| a.0.total_cmp(&b.0)) {
                Some((alone, other)) if alone >= least => fitting.with[other] = true,
                _ => break,
            }
        }
        fitting
    }

    /// 1 and the fitted axes about their means.
    fn regressors(&self, pair: &Pair) -> Vector4<f64> {
        let off = pair[0] - self.mean;
        let of = |i: usize| if self.with[i] { off[i] } else { 0.0 };
        Vector4::new(1.0, of(0), of(1), of(2))
    }

    fn instruments(&self, k: usize, how: How) -> Vector4<f64> {
        let at = |k: Option<usize>| {
            k.and_then(|k| self.samples.get(k))
                .map_or(Vector4::zeros(), |pair| self.regressors(pair))
        };
        match how {
            How::Neighbours(lag) => (at(k.checked_sub(lag)) + at(Some(k + lag))) * 0.5,
            How::Low | How::Bounds => at(Some(k)),
            How::High => {
                let mut found = at(Some(k));
                found[1 + self.axis] = self.samples[k][1][self.axis] - self.mean_output;
                found
            }
        }
    }

    /// Σ z hᵀ over the samples from `first` on, with 1 for axes that are not fitted.
    fn information(&self, first: usize, count: usize, how: How) -> Matrix4<f64> {
        let mut sum = Matrix4::zeros();
        for k in first..(first + count).min(self.samples.len()) {
            sum += self.instruments(k, how) * self.regressors(&self.samples[k]).transpose();
        }
        sum
    }

    /// The inverse of an information matrix in the fitted axes.
    fn invert(&self, mut information: Matrix4<f64>) -> Option<Matrix4<f64>> {
        for i in (0..3).filter(|i| !self.with[*i]) {
            information[(1 + i, 1 + i)] = 1.0;
        }
        information.try_inverse()
    }

    /// From c at the mean to b, of a row in the fitted axes.
    fn at_zero(&self, mut row: Row) -> Row {
        row[0] -= row.fixed_rows::<3>(1).dot(&self.mean);
        row
    }

    /// The row of A − I with instruments of one kind.
    fn fit(&self, how: How) -> Option<Found> {
        let n = self.samples.len();
        let whole = self.information(0, n, how);
        let inverse = self.invert(whole)?;
        let apart = |pair: &Pair| pair[1][self.axis] - pair[0][self.axis];
        let pulls = (0..n).map(|k| self.instruments(k, how) * apart(&self.samples[k]));
        let about_mean = inverse * pulls.sum::<Vector4<f64>>();
        let left = |pair: &Pair| apart(pair) - self.regressors(pair).dot(&about_mean);
        let residuals: Vec<f64> = self.samples.iter().map(left).collect();
        let length = block_length(n);
        let mut changes = Vec::new();
        for first in (0..n).step_by(length) {
            let block = first..(first + length).min(n);
            let pull: Vector4<f64> = block.map(|k| self.instruments(k, how) * residuals[k]).sum();
            // A block has pulled the row to itself: the mean of its influence, and of that where it is left out.
            let without = self.invert(whole - self.information(first, length, how))?;
            changes.push(self.at_zero((inverse + without) * pull * 0.5));
        }
        let row = self.at_zero(about_mean);
        row.iter().all(|value| value.is_finite()).then_some(Found {
            row,
            changes,
            inverse,
            residuals,
        })
    }

    pub fn ordinary(&self) -> Option<Found> {
        self.fit(How::Low)
    }

    /// The row by neighbours at the longest distance at which the motion is correlated and the residual is white, else
    /// the mean of its bounds.
    pub fn find(&self) -> Option<(Found, How)> {
        let n = self.samples.len();
        let of = |side: usize, mean: f64| -> Vec<f64> {
            self.samples.iter().map(|pair| pair[side][self.axis] - mean).collect()
        };
        let (x, y) = (of(0, self.mean[self.axis]), of(1, self.mean_output));
        let white = WHITE.max(WHITE_DEVIATIONS / libm::sqrt(n as f64));
        for lag in LAGS.into_iter().rev().filter(|lag| *lag < n) {
            if lagged(&x, &y, lag) < LEAST_SHARED * lagged(&x, &y, 0) {
                continue;
            }
            let how = How::Neighbours(lag);
            let Some(found) = self.fit(how) else { continue };
            let alike = lagged(&found.residuals, &found.residuals, lag);
            if alike.abs() <= white * found.residual_variance().max(f64::MIN_POSITIVE) {
                return Some((found, how));
            }
        }
        let (mut low, high) = (self.fit(How::Low)?, self.fit(How::High)?);
        low.row = (low.row + high.row) * 0.5;
        for (change, other) in low.changes.iter_mut().zip(&high.changes) {
            *change = (*change + other) * 0.5;
        }
        for (residual, other) in low.residuals.iter_mut().zip(&high.residuals) {
            *residual = (*residual + other) * 0.5;
        }
        Some((low, How::Bounds))
    }

    /// Degrees of freedom of the variances of b and of the scale factor: the effective number of blocks less one for the
    /// mean. `None` if one block decides.
    pub fn dof(&self) -> Option<[f64; 2]> {
        let n = self.samples.len();
        let inverse = self.invert(self.information(0, n, How::Low))?;
        let means = Vector3::from_fn(|i, _| if self.with[i] { self.mean[i] } else { 0.0 });
        let bias = Vector4::new(1.0, -means.x, -means.y, -means.z);
        let scale = Vector4::ith(1 + self.axis, 1.0);
        let along = [bias, scale].map(|of| inverse * of);
        let variances = [along[0].dot(&bias), along[1].dot(&scale)];
        let mut squares = [0.0; 2];
        let length = block_length(n);
        for first in (0..n).step_by(length) {
            let block = self.information(first, length, How::Low);
            let shares = [0, 1].map(|i: usize| along[i].dot(&(block * along[i])) / variances[i]);
            if shares[1] > MOST_OF_A_BLOCK {
                return None;
            }
            squares = [0, 1].map(|i: usize| squares[i] + shares[i] * shares[i]);
        }
        Some(squares.map(|square| (1.0 / square - 1.0).max(1.0)))
    }

    /// Regression of an axis of the reference that is not fitted on those that are, about the means.
    fn along(&self, other: usize) -> Option<Row> {
        let inverse = self.invert(self.information(0, self.samples.len(), How::Low))?;
        let product = |pair: &Pair| self.regressors(pair) * (pair[0][other] - self.mean[other]);
        Some(inverse * self.samples.iter().map(product).sum::<Row>())
    }

    /// Variance of the motion of an axis of the reference that is not fitted, beside that of the fitted ones.
    fn apart_from(&self, other: usize) -> f64 {
        let along = self.along(other).unwrap_or_default();
        let off = self
            .samples
            .iter()
            .map(|pair| pair[0][other] - self.mean[other] - self.regressors(pair).dot(&along));
        off.map(|off| off * off).sum::<f64>() / self.samples.len() as f64
    }

    /// The covariance that does not show between blocks: from the method, and from the axes of the reference that are not
    /// fitted.
    pub fn unseen(&self, found: &Found, how: How, parallel: bool) -> Option<Matrix4<f64>> {
        let own = 1 + self.axis;
        let mut unseen = Matrix4::zeros();
        if let How::Neighbours(lag) = how {
            // Correlated noise belongs to the output or to its axis.
            let alike = lagged(&found.residuals, &found.residuals, lag);
            let column = found.inverse.column(own) * (alike * self.samples.len() as f64);
            let off = self.at_zero(column);
            unseen += off * off.transpose();
        } else {
            // The true value may be at one of the bounds, with noise in addition.
            let [low, high] = [self.fit(How::Low)?, self.fit(How::High)?];
            let off = (high.row - low.row) * BOUND;
            let size = off[own].abs();
            let scatter = libm::sqrt(found.scatter()[(own, own)]);
            if size > 0.0 {
                unseen += off * off.transpose() * (1.0 + 2.0 * scatter / size);
            }
        }
        for other in (0..3).filter(|other| !parallel && !self.with[*other]) {
            // Its mean appears as bias, the correlated part as sensitivity to other axes.
            let mut off = self.along(other)?;
            off[0] += self.mean[other];
            off = self.at_zero(off);
            off[1 + other] = -1.0;
            unseen += off * off.transpose() * (USUAL_ACROSS * USUAL_ACROSS);
        }
        Some(unseen)
    }
}
