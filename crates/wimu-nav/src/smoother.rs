//! Fixed-interval smoother: the state at each time given the measurements before and after it. Equations (134) to (139)
//! of docs/EQUATIONS.md.
//!
//! A [`Log`] records a navigator as [`Epoch`]s, which the caller owns. [`Smoothed`] goes backward over them. Considered
//! states stay as they are: their uncertainty is in the smoothed covariance.

mod log;

pub use log::{Epoch, Log, Recorder};

use nalgebra::{Cholesky, Const, RealField, SMatrix, SVector};

use crate::rotation::real;
use crate::state::{ATTITUDE, Block, VELOCITY};

/// Epochs after the backward pass.
#[derive(Clone, Copy, Debug)]
pub struct Smoothed<'a, R, const N: usize> {
    epochs: &'a [Epoch<R, N>],
    contradictions: usize,
}

impl<'a, R: RealField + Copy, const N: usize> Smoothed<'a, R, N> {
    /// Smooths epochs in place. The last one keeps the result of the filter.
    pub fn of(epochs: &'a mut [Epoch<R, N>]) -> Self {
        let (mut error, mut contradictions) = (Error::filtered(), 0);
        for k in (1..epochs.len()).rev() {
            let (before, after) = epochs.split_at_mut(k);
            let (epoch, next) = (&mut before[k - 1], &mut after[0]);
            let smoothed = match next.linked {
                true => error.smooth(epoch, next),
                false => None,
            };
            contradictions += usize::from(next.linked && smoothed.is_none());
            next.linked = smoothed.is_some();
            next.update_noise = error.kept;
            error = smoothed.unwrap_or_else(Error::filtered);
        }
        if let Some(first) = epochs.first_mut() {
            first.update_noise = error.kept;
        }
        Self { epochs, contradictions }
    }

    /// Epochs whose correction of attitude or velocity contradicts its covariance (χ² test, probability of false alarm
    /// 10⁻⁶) or is not finite: the model failed at an unknown time before. Nothing after such an epoch is used for the
    /// epochs before it.
    pub fn contradictions(&self) -> usize {
        self.contradictions
    }

    /// Error to add to the state of the filter at an epoch: before its updates, and after them.
    pub fn corrections(&self, epoch: usize) -> [SVector<R, N>; 2] {
        let epoch = &self.epochs[epoch];
        [epoch.correction + epoch.injected, epoch.correction]
    }

    /// Whether the epoch before is connected with this one.
    pub fn is_linked(&self, epoch: usize) -> bool {
        self.epochs[epoch].linked
    }

    /// Covariance of a block at an epoch.
    pub fn covariance<const W: usize>(&self, epoch: usize, block: Block<W>) -> SMatrix<R, W, W> {
        let at = block.start();
        let view = self.epochs[epoch].covariance.fixed_view::<W, W>(at, at);
        view.into_owned()
    }

    /// Covariance of the change of a block between two epochs: an error that both have in common is not in it. `None`
    /// if a restart is between them.
    pub fn covariance_of_change<const W: usize>(
        &self,
        from: usize,
        to: usize,
        block: Block<W>,
    ) -> Option<SMatrix<R, W, W>> {
        let (at, last) = (block.start(), &self.epochs[to]);
        // Covariances with the smoothed error of the block at the last epoch: of the smoothed error, and the derivative
        // of the block's smoothed error by the filtered one.
        let mut cross = last.covariance.fixed_columns::<W>(at).into_owned();
        let mut derivative = last.update_noise.fixed_rows::<W>(at).transpose();
        for epoch in self.epochs[from + 1..=to].iter().rev() {
            if !epoch.linked {
                return None;
            }
            cross = epoch.transition * cross + epoch.noise * derivative;
            derivative = epoch.update.transpose() * derivative;
        }
        let cross = cross.fixed_rows::<W>(at).into_owned();
        Some(self.covariance(from, block) + self.covariance(to, block) - cross - cross.transpose())
    }
}

/// Smoothed error of an epoch: A times the filtered error, plus what is independent of it.
struct Error<R, const N: usize> {
    kept: SMatrix<R, N, N>,
    independent: SMatrix<R, N, N>,
}

impl<R: RealField + Copy, const N: usize> Error<R, N> {
    fn filtered() -> Self {
        Self { kept: SMatrix::identity(), independent: SMatrix::zeros() }
    }

    /// Smooths an epoch with the next one, whose smoothed error this is. `None`, and no change, if it contradicts.
    fn smooth(&self, epoch: &mut Epoch<R, N>, next: &mut Epoch<R, N>) -> Option<Self> {
        let one = SMatrix::<R, N, N>::identity();
        let a = &self.kept;
        let (f, p) = (next.transition, epoch.covariance);
        // The correction before the updates is L e + what is independent of e, with the covariance U.
        let rest = one - a * next.update;
        let l = rest * f;
        let independent = rest * next.noise * rest.transpose()
            + a * next.update_noise * a.transpose()
            + self.independent;
        let lp = l * p;
        let variance = lp * l.transpose() + independent;
        let later = next.correction + next.injected;
        let fits = |block| fits(&later, &variance, block);
        if !fits(ATTITUDE) || !fits(VELOCITY) {
            return None;
        }
        let mut gain = Correlation::of(&variance)?.solve(&lp).transpose();
        for row in (0..N).filter(|row| epoch.considered[*row]) {
            gain.row_mut(row).fill(R::zero());
        }
        let kept = one - gain * l;
        let independent = gain * independent * gain.transpose();
        let covariance = kept * p * kept.transpose() + independent;
        let correction = gain * later;
        let fp = f * p;
        let residual = fp.transpose() - gain * (fp * f.transpose() + next.noise);
        if !covariance.sum().is_finite() || !correction.sum().is_finite() {
            return None;
        }
        epoch.covariance = (covariance + covariance.transpose()) * real::<R>(0.5);
        epoch.correction = correction;
        next.noise = residual * next.update.transpose();
        next.update *= f;
        next.transition = gain;
        Some(Self { kept, independent })
    }
}

/// Variance that is added to the correlations of a correction, which are singular where few measurements follow. Results
/// on recordings and simulations are the same from 1e-6 to 1e-2.
const LEAST_CORRELATION: f64 = 1e-4;
/// Quantile of χ² with 3 degrees of freedom at a probability of 1 − 10⁻⁶: many epochs test the same error.
const CHI_SQUARE_3: f64 = 30.66;

/// A covariance scaled to correlations, factored.
struct Correlation<R: RealField, const N: usize> {
    scale: SVector<R, N>,
    factor: Cholesky<R, Const<N>>,
}

impl<R: RealField + Copy, const N: usize> Correlation<R, N> {
    fn of(covariance: &SMatrix<R, N, N>) -> Option<Self> {
        // A state without variance, such as a considered one, has no correlation and no gain.
        let scale = covariance.diagonal().map(|variance| {
            if variance > R::zero() { R::one() / variance.sqrt() } else { R::zero() }
        });
        let correlation = SMatrix::<R, N, N>::from_fn(|r, c| {
            if r == c {
                real(1.0 + LEAST_CORRELATION)
            } else {
                covariance[(r, c)] * scale[r] * scale[c]
            }
        });
        let factor = correlation.cholesky()?;
        Some(Self { scale, factor })
    }

    /// The inverse of the covariance times a matrix.
    fn solve<const C: usize>(&self, matrix: &SMatrix<R, N, C>) -> SMatrix<R, N, C> {
        let scaled = |mut matrix: SMatrix<R, N, C>| {
            for (mut row, scale) in matrix.row_iter_mut().zip(&self.scale) {
                row *= *scale;
            }
            matrix
        };
        scaled(self.factor.solve(&scaled(*matrix)))
    }
}

/// Whether a correction of a block fits its covariance.
fn fits<R: RealField + Copy, const N: usize>(
    correction: &SVector<R, N>,
    covariance: &SMatrix<R, N, N>,
    block: Block<3>,
) -> bool {
    let at = block.start();
    let error = correction.fixed_rows::<3>(at).into_owned();
    let covariance = covariance.fixed_view::<3, 3>(at, at).into_owned();
    Correlation::of(&covariance).is_some_and(|c| error.dot(&c.solve(&error)) <= real(CHI_SQUARE_3))
}
