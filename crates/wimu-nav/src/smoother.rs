//! Fixed-interval smoother: the state at each time given the measurements before and after it. Equations (134) to (139)
//! of docs/reference/equations.
//!
//! A [`Log`] in a filter records it as [`Epoch`]s. [`Smoothed`] goes backward over them. Considered states stay as they are:
//! their uncertainty is in the smoothed covariance.

mod log;

pub use log::{Epoch, Log};

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, SMatrix};

use crate::filter::symmetrise;
use crate::state::{ATTITUDE, Block, VELOCITY};

/// Epochs after the backward pass.
#[derive(Clone, Copy, Debug)]
pub struct Smoothed<'a> {
    epochs: &'a [Epoch],
    contradictions: usize,
}

impl<'a> Smoothed<'a> {
    /// Smooths epochs in place. The last one keeps the result of the filter.
    pub fn of(epochs: &'a mut [Epoch]) -> Self {
        let states = |epoch: &Epoch| epoch.injected.len();
        let mut error = Error::filtered(epochs.last().map_or(0, states));
        let mut contradictions = 0;
        for k in (1..epochs.len()).rev() {
            let (before, after) = epochs.split_at_mut(k);
            let (epoch, next) = (&mut before[k - 1], &mut after[0]);
            let smoothed = if next.linked { error.smooth(epoch, next) } else { None };
            contradictions += usize::from(next.linked && smoothed.is_none());
            next.linked = smoothed.is_some();
            next.update_noise = error.kept;
            error = smoothed.unwrap_or_else(|| Error::filtered(states(epoch)));
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

    /// Error to add to a block of the state of the filter at an epoch: before its updates, and after them.
    pub fn corrections<const W: usize>(
        &self,
        epoch: usize,
        block: Block<W>,
    ) -> [SMatrix<f64, W, 1>; 2] {
        let epoch = &self.epochs[epoch];
        let of = |error: &DVector<f64>| error.fixed_rows::<W>(block.start()).into_owned();
        let after = of(&epoch.correction);
        [after + of(&epoch.injected), after]
    }

    /// Whether the epoch before is connected with this one.
    pub fn is_linked(&self, epoch: usize) -> bool {
        self.epochs[epoch].linked
    }

    /// Covariance of a block at an epoch.
    pub fn covariance<const W: usize>(&self, epoch: usize, block: Block<W>) -> SMatrix<f64, W, W> {
        let at = block.start();
        self.epochs[epoch].covariance.fixed_view::<W, W>(at, at).into_owned()
    }

    /// Covariance of the change of a block between two epochs: an error that both have in common is not in it. `None`
    /// if a restart is between them.
    pub fn covariance_of_change<const W: usize>(
        &self,
        from: usize,
        to: usize,
        block: Block<W>,
    ) -> Option<SMatrix<f64, W, W>> {
        let (at, last) = (block.start(), &self.epochs[to]);
        // Covariances with the smoothed error of the block at the last epoch: of the smoothed error, and the derivative
        // of the block's smoothed error by the filtered one.
        let mut cross = last.covariance.columns(at, W).into_owned();
        let mut derivative = last.update_noise.rows(at, W).transpose();
        for epoch in self.epochs[from + 1..=to].iter().rev() {
            if !epoch.linked {
                return None;
            }
            cross = &epoch.transition * cross + &epoch.noise * &derivative;
            derivative = epoch.update.transpose() * derivative;
        }
        let cross = cross.fixed_view::<W, W>(at, 0).into_owned();
        Some(self.covariance(from, block) + self.covariance(to, block) - cross - cross.transpose())
    }
}

/// Smoothed error of an epoch: A times the filtered error, plus what is independent of it.
struct Error {
    kept: DMatrix<f64>,
    independent: DMatrix<f64>,
}

impl Error {
    fn filtered(states: usize) -> Self {
        let kept = DMatrix::identity(states, states);
        Self { kept, independent: DMatrix::zeros(states, states) }
    }

    /// Smooths an epoch with the next one, whose smoothed error this is. `None`, and no change, if it contradicts.
    fn smooth(&self, epoch: &mut Epoch, next: &mut Epoch) -> Option<Self> {
        let states = self.kept.nrows();
        let one = DMatrix::<f64>::identity(states, states);
        let a = &self.kept;
        let (f, p) = (&next.transition, &epoch.covariance);
        // The correction before the updates is L e + what is independent of e, with the covariance U.
        let rest = &one - a * &next.update;
        let l = &rest * f;
        let independent = &rest * &next.noise * rest.transpose()
            + a * &next.update_noise * a.transpose()
            + &self.independent;
        let lp = &l * p;
        let variance = &lp * l.transpose() + &independent;
        let later = &next.correction + &next.injected;
        let fits = |block| fits(&later, &variance, block);
        if !fits(ATTITUDE) || !fits(VELOCITY) {
            return None;
        }
        let mut gain = Correlation::of(&variance)?.solve(&lp).transpose();
        for row in (0..states).filter(|row| epoch.considered[*row]) {
            gain.row_mut(row).fill(0.0);
        }
        let kept = &one - &gain * l;
        let independent = &gain * independent * gain.transpose();
        let mut covariance = &kept * p * kept.transpose() + &independent;
        let correction = &gain * later;
        let fp = f * p;
        let residual = fp.transpose() - &gain * (&fp * f.transpose() + &next.noise);
        if !covariance.sum().is_finite() || !correction.sum().is_finite() {
            return None;
        }
        symmetrise(&mut covariance);
        epoch.covariance = covariance;
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
struct Correlation {
    scale: DVector<f64>,
    factor: Cholesky<f64, Dyn>,
}

impl Correlation {
    fn of(covariance: &DMatrix<f64>) -> Option<Self> {
        // A state without variance, such as a considered one, has no correlation and no gain.
        let inverse_root =
            |variance: f64| if variance > 0.0 { 1.0 / libm::sqrt(variance) } else { 0.0 };
        let scale = covariance.diagonal().map(inverse_root);
        let mut correlation = covariance.clone();
        for c in 0..scale.len() {
            for r in 0..scale.len() {
                correlation[(r, c)] *= scale[r] * scale[c];
            }
            correlation[(c, c)] = 1.0 + LEAST_CORRELATION;
        }
        Some(Self { scale, factor: correlation.cholesky()? })
    }

    /// The inverse of the covariance times a matrix.
    fn solve(&self, matrix: &DMatrix<f64>) -> DMatrix<f64> {
        let mut solved = matrix.clone();
        self.scale_rows(&mut solved);
        self.factor.solve_mut(&mut solved);
        self.scale_rows(&mut solved);
        solved
    }

    fn scale_rows(&self, matrix: &mut DMatrix<f64>) {
        for mut column in matrix.column_iter_mut() {
            column.component_mul_assign(&self.scale);
        }
    }
}

/// Whether a correction of a block fits its covariance.
fn fits(correction: &DVector<f64>, covariance: &DMatrix<f64>, block: Block<3>) -> bool {
    let at = block.start();
    let error = DMatrix::from_column_slice(3, 1, correction.rows(at, 3).as_slice());
    let covariance = covariance.view((at, at), (3, 3)).into_owned();
    Correlation::of(&covariance).is_some_and(|c| error.dot(&c.solve(&error)) <= CHI_SQUARE_3)
}
