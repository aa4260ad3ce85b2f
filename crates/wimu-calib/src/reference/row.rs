//! What an axis of the output makes of all axes of the reference: equation (50).

use core::array::from_fn;

use nalgebra::{Matrix3, Matrix4, SymmetricEigen, Vector3, Vector4};

use super::sums::{Central, LAGS, Pair, Sums};
use crate::terms::USUAL_ACROSS;

/// Neighbouring samples show the same motion where they are correlated at least this much as each
/// is with itself.
const LEAST_SHARED: f64 = 0.9;
/// What is left counts as white when its correlation with that some samples away is below this, or
/// so many standard deviations of that of white noise.
const WHITE: f64 = 0.05;
const WHITE_DEVIATIONS: f64 = 3.0;
/// Half the way from bound to bound in standard deviations, for a 95 % interval of 15 degrees of freedom.
const BOUND: f64 = 0.25;
/// Most steps to the noise; they converge quadratically.
const STEPS: usize = 60;

/// b, then what is seen of each axis of the reference, less 1 of its own.
pub(super) type Row = Vector4<f64>;

/// One axis of the output, and which of the reference it is fitted to.
#[derive(Clone, Copy)]
pub(super) struct Fitting {
    pub axis: usize,
    /// What sums are about: reference, output.
    pub origins: Pair,
    pub with: [bool; 3],
}

/// How a row is found.
#[derive(Clone, Copy)]
pub(super) enum How {
    /// By the variance of the output's noise per that of the reference's.
    Deming(f64),
    /// From samples a lag of [`LAGS`] apart.
    Neighbours(usize),
    /// The middle between all noise on one side and on the other.
    Bounds,
}

impl Fitting {
    /// To the axes that move by `least` or more on their own, without what goes along with those
    /// that are in; to its own alone if they are `parallel`.
    pub fn new(axis: usize, origins: Pair, spread: &Central, least: f64, parallel: bool) -> Self {
        let mut fitting = Self {
            axis,
            origins,
            with: from_fn(|other| other == axis),
        };
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

    /// How much `other`, which is not in, goes along with each that is.
    fn along(&self, spread: &Central, other: usize) -> Option<Vector3<f64>> {
        self.solve(spread, [0.0; 3], |i| spread.xx[(i, other)])
    }

    /// (xx − diag `noise`)⁻¹ `right` over the axes that are in.
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

    /// Covariance of the reference with output less reference.
    fn apart(&self, spread: &Central, i: usize) -> f64 {
        spread.xy[(i, self.axis)] - spread.xx[(i, self.axis)]
    }

    /// What these leave of the output, squared.
    pub fn left(&self, spread: &Central, sees: &Vector3<f64>) -> f64 {
        let own = self.axis;
        let apart = spread.yy[own] - 2.0 * spread.xy[(own, own)] + spread.xx[(own, own)];
        let with = Vector3::from_fn(|i, _| self.apart(spread, i));
        apart - 2.0 * sees.dot(&with) + sees.dot(&(spread.xx * sees))
    }

    /// Least squares whose residual's variance is told apart as δ to the output and `shares` to the
    /// axes of the reference, Newton's rule for their common factor.
    fn deming(&self, spread: &Central, delta: f64, shares: [f64; 3]) -> Option<Vector3<f64>> {
        let own = Vector3::from_fn(|i, _| f64::from(u8::from(i == self.axis)));
        let (mut last, mut factor) = (0.0, 0.0_f64);
        let mut best = None;
        for _ in 0..STEPS {
            let noise = shares.map(|share| share * factor);
            let found = self.solve(spread, noise, |i| self.apart(spread, i) + noise[i] * own[i]);
            let Some(sees) = found else {
                // Beyond all that moves.
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

    /// With b: the line goes through the means.
    fn row(&self, spread: &Central, sees: Vector3<f64>) -> Row {
        let [x, y] = self.origins.map(|origin| origin[self.axis]);
        let apart = (y - x) + (spread.y[self.axis] - spread.x[self.axis]);
        Vector4::new(
            apart - sees.dot(&self.means(spread)),
            sees[0],
            sees[1],
            sees[2],
        )
    }

    /// Of the reference.
    fn means(&self, spread: &Central) -> Vector3<f64> {
        self.origins[0] + spread.x
    }

    /// From all noise on the output to all on the axis of the reference.
    fn bounds(&self, spread: &Central) -> Option<[Row; 2]> {
        let low = self.deming(spread, 1.0, [0.0; 3])?;
        let own = from_fn(|i| f64::from(u8::from(i == self.axis)));
        let high = self.deming(spread, 0.0, own)?;
        Some([low, high].map(|sees| self.row(spread, sees)))
    }

    /// The row.
    pub fn find(&self, sums: &Sums, how: How) -> Option<Row> {
        let spread = sums.central();
        let shares = self.with.map(|with| f64::from(u8::from(with)));
        let row = match how {
            How::Deming(delta) => self.row(&spread, self.deming(&spread, delta, shares)?),
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

    /// By the farthest neighbours that share the motion and not what is left of it.
    pub fn how(&self, sums: &Sums) -> How {
        let (spread, own) = (sums.central(), self.axis);
        let white = WHITE.max(WHITE_DEVIATIONS / libm::sqrt(spread.n));
        let told = |lag: &usize| {
            let shared = sums.lagged(*lag)?;
            if shared.xy[(own, own)] < LEAST_SHARED * spread.xy[(own, own)] {
                return None;
            }
            let shares = self.with.map(|with| f64::from(u8::from(with)));
            let sees = self.deming(&shared, 1.0, shares)?;
            let left = self.left(&spread, &sees).max(f64::MIN_POSITIVE);
            (self.left(&shared, &sees).abs() <= white * left).then_some(())
        };
        let lag = (0..LAGS.len()).rev().find(|lag| told(lag).is_some());
        lag.map_or(How::Bounds, How::Neighbours)
    }

    /// Covariance from the scatter of the blocks, each with the row found without it, and degrees of
    /// freedom of each of its variances: equation (51).
    pub fn scatter(
        &self,
        row: &Row,
        all: &Sums,
        blocks: impl Iterator<Item = (Sums, Option<Row>)>,
    ) -> Option<(Matrix4<f64>, [f64; 4])> {
        // In coordinates in which all samples tell as much of each direction.
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
                let told = column.dot(&(share * column)) / column.norm_squared();
                *square += told * told;
            }
            // What a block tells is in the whole, too, and what is left of it there as much less.
            let own = SymmetricEigen::new(share);
            let of = own.eigenvectors.transpose() * off;
            let less = own
                .eigenvalues
                .map(|told| libm::sqrt((1.0 - told).clamp(0.0, 1.0)));
            let off = root
                .transpose()
                .solve_upper_triangular(&(own.eigenvectors * of.component_mul(&less)))?;
            covariance += off * off.transpose();
        }
        // As few blocks as tell most, one for the mean.
        Some((
            covariance,
            squares.map(|square| (1.0 / square - 1.0).max(1.0)),
        ))
    }

    /// What samples tell of a row, per variance of one: sums of products of 1 and the axes that are in.
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

    /// Adds what is no scatter from block to block: of the way the row was found, and of the axes of the
    /// reference that are not in.
    pub fn add_unseen(
        &self,
        covariance: &mut Matrix4<f64>,
        sums: &Sums,
        how: How,
        parallel: bool,
    ) -> Option<()> {
        let spread = sums.central();
        match how {
            How::Deming(_) => {}
            How::Neighbours(lag) => {
                // What they share of the noise is the output's, or its axis's.
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
                // The truth may be at one of them, and its noise comes on top.
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
            // Its mean passes for bias, and what goes along for what is seen of the others.
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
