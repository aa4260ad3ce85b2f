//! Error-state Schmidt–Kalman filter: prediction, update and test, for any process and sensor. Equations (117) to (121) of
//! docs/EQUATIONS.md.

use nalgebra::{RealField, Rotation3, SMatrix, SVector};

use crate::process::{Process, Transition};
use crate::rotation::{orthonormal, real};
use crate::sensor::{Measurement, Prediction};
use crate::smoother::Recorder;
use crate::state::{Block, Layout, State};

/// Which measurements an update accepts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gate {
    /// Every one.
    Open,
    /// Those that pass the χ² test with a probability of false alarm of [`FALSE_ALARM`].
    ChiSquare,
}

/// Probability that a test rejects a measurement that fits.
pub const FALSE_ALARM: f64 = 1e-3;
/// Quantile of the standard normal distribution at 1 − [`FALSE_ALARM`].
const NORMAL_QUANTILE: f64 = 3.0902;

/// Quantile of χ² at 1 − [`FALSE_ALARM`] (E. B. Wilson and M. M. Hilferty, "The distribution of chi-square", 1931): 3.1 %
/// too large for one degree of freedom, less for more.
pub fn chi_square_quantile(dof: usize) -> f64 {
    let spread = 2.0 / (9.0 * dof as f64);
    let root = 1.0 - spread + NORMAL_QUANTILE * libm::sqrt(spread);
    dof as f64 * root * root * root
}

/// Test of a measurement against its prediction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Innovation<R> {
    /// Normalised innovation squared: χ² distributed if the filter is consistent. Not a number where the covariance is
    /// not positive definite.
    pub statistic: R,
    /// Degrees of freedom.
    pub dof: usize,
    /// Logarithm of the Gaussian density of the measurement.
    pub log_likelihood: R,
    /// Whether the state was updated.
    pub accepted: bool,
}

/// The filter: nominal state, and covariance of its error.
#[derive(Clone, Debug)]
pub struct Filter<R, const N: usize> {
    /// Nominal state.
    pub state: State<R, N>,
    pub(crate) covariance: SMatrix<R, N, N>,
    pub(crate) considered: [bool; N],
    /// Steps since the attitude was made orthonormal.
    steps: u8,
}

impl<R: RealField + Copy, const N: usize> Filter<R, N> {
    /// At an attitude, with all other states zero and the standard deviations of the layout.
    pub fn new(layout: &Layout<R, N>, attitude: Rotation3<R>) -> Self {
        let variance = layout.deviation.map(|deviation| deviation * deviation);
        Self {
            state: State { attitude, vector: SVector::zeros() },
            covariance: SMatrix::from_diagonal(&variance),
            considered: layout.considered,
            steps: 0,
        }
    }

    /// Adds the states of a layout from the index `first` on, with their standard deviations.
    pub(crate) fn extend(&mut self, layout: &Layout<R, N>, first: usize) {
        for k in first..layout.used {
            self.covariance[(k, k)] = layout.deviation[k] * layout.deviation[k];
            self.considered[k] = layout.considered[k];
        }
    }

    /// Covariance of a block.
    pub fn covariance<const W: usize>(&self, block: Block<W>) -> SMatrix<R, W, W> {
        self.cross_covariance(block, block)
    }

    /// Covariance between two blocks.
    pub fn cross_covariance<const V: usize, const W: usize>(
        &self,
        rows: Block<V>,
        columns: Block<W>,
    ) -> SMatrix<R, V, W> {
        let view = self.covariance.fixed_view::<V, W>(rows.start(), columns.start());
        view.into_owned()
    }

    /// Replaces the covariance of a block by a given one, without correlation to other blocks: for a prior that is
    /// known, such as the covariance of a calibration.
    pub fn set_covariance<const W: usize>(
        &mut self,
        block: Block<W>,
        covariance: &SMatrix<R, W, W>,
    ) {
        let start = block.start();
        self.covariance.fixed_rows_mut::<W>(start).fill(R::zero());
        self.covariance.fixed_columns_mut::<W>(start).fill(R::zero());
        self.covariance.fixed_view_mut::<W, W>(start, start).copy_from(covariance);
    }

    /// Replaces the covariance between two different blocks.
    pub fn set_cross_covariance<const V: usize, const W: usize>(
        &mut self,
        rows: Block<V>,
        columns: Block<W>,
        covariance: &SMatrix<R, V, W>,
    ) {
        self.covariance.fixed_view_mut::<V, W>(rows.start(), columns.start()).copy_from(covariance);
        self.covariance
            .fixed_view_mut::<W, V>(columns.start(), rows.start())
            .copy_from(&covariance.transpose());
    }

    /// Whether state and variances are finite and no variance is negative.
    pub fn is_sound(&self) -> bool {
        let variances = self.covariance.diagonal();
        self.state.is_finite() && variances.iter().all(|v| v.is_finite() && *v >= R::zero())
    }

    /// Prediction: state and covariance after a step of the process, P ← F P Fᵀ + Q.
    pub fn predict(&mut self, process: &impl Process<R, N>) {
        self.predict_recorded(process, &mut ());
    }

    /// Prediction that is recorded for a smoother.
    pub fn predict_recorded(
        &mut self,
        process: &impl Process<R, N>,
        recorder: &mut impl Recorder<R, N>,
    ) {
        let mut transition = Transition::new();
        process.propagate(&mut self.state, &mut transition);
        transition.apply(&mut self.covariance);
        self.steps = self.steps.wrapping_add(1);
        if self.steps == 0 {
            self.state.attitude = orthonormal(&self.state.attitude);
        }
        recorder.predicted(self, &transition);
    }

    /// Test of a measurement, without an update.
    pub fn test<const M: usize>(&self, measurement: &impl Measurement<R, N, M>) -> Innovation<R> {
        let prediction = measurement.predict(self);
        self.solve(&prediction).0
    }

    /// Update with a measurement: the optimal gain, with the rows of considered states set to zero, in Joseph's form
    /// (P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems", 2nd ed. 2013, 3.4.3).
    pub fn update<const M: usize>(
        &mut self,
        measurement: &impl Measurement<R, N, M>,
        gate: Gate,
    ) -> Innovation<R> {
        self.update_recorded(measurement, gate, &mut ())
    }

    /// Update that is recorded for a smoother.
    pub fn update_recorded<const M: usize>(
        &mut self,
        measurement: &impl Measurement<R, N, M>,
        gate: Gate,
        recorder: &mut impl Recorder<R, N>,
    ) -> Innovation<R> {
        let accept = |innovation: &Innovation<R>| match gate {
            Gate::Open => innovation.statistic.is_finite(),
            Gate::ChiSquare => innovation.statistic <= real(chi_square_quantile(M)),
        };
        self.update_if(measurement, accept, recorder)
    }

    /// Update of some states only: the others are considered meanwhile.
    pub(crate) fn update_only<const M: usize>(
        &mut self,
        estimated: impl Fn(usize) -> bool,
        measurement: &impl Measurement<R, N, M>,
        recorder: &mut impl Recorder<R, N>,
    ) -> Innovation<R> {
        let considered = self.considered;
        self.considered = core::array::from_fn(|state| considered[state] || !estimated(state));
        let innovation = self.update_recorded(measurement, Gate::ChiSquare, recorder);
        self.considered = considered;
        innovation
    }

    /// Update where a condition on the innovation holds.
    pub(crate) fn update_if<const M: usize>(
        &mut self,
        measurement: &impl Measurement<R, N, M>,
        accept: impl FnOnce(&Innovation<R>) -> bool,
        recorder: &mut impl Recorder<R, N>,
    ) -> Innovation<R> {
        let prediction = measurement.predict(self);
        let (mut innovation, solved) = self.solve(&prediction);
        innovation.accepted = accept(&innovation);
        let Some((cross, gain)) = solved.filter(|_| innovation.accepted) else {
            innovation.accepted = false;
            return innovation;
        };
        // (1 − K H) P (1 − K H)ᵀ + K R Kᵀ, without products of N × N matrices: P Hᵀ is known.
        let left = cross - gain * (prediction.jacobian.0 * cross) - gain * prediction.covariance;
        self.covariance -= gain * cross.transpose() + left * gain.transpose();
        let transposed = self.covariance.transpose();
        self.covariance = (self.covariance + transposed) * real::<R>(0.5);
        self.state.correct(gain * prediction.innovation);
        recorder.corrected(&gain, &prediction);
        innovation
    }

    /// P Hᵀ. Most columns of H are zero.
    fn cross<const M: usize>(&self, h: &SMatrix<R, M, N>) -> SMatrix<R, N, M> {
        let mut cross = SMatrix::<R, N, M>::zeros();
        for k in 0..N {
            let column = h.column(k);
            if column.iter().any(|x| *x != R::zero()) {
                cross.ger(R::one(), &self.covariance.column(k), &column, R::one());
            }
        }
        cross
    }

    /// Covariance of an innovation: H P Hᵀ + R.
    pub(crate) fn variance_of<const M: usize>(
        &self,
        prediction: &Prediction<R, N, M>,
    ) -> SMatrix<R, M, M> {
        let h = &prediction.jacobian.0;
        h * self.cross(h) + prediction.covariance
    }

    /// Innovation, P Hᵀ and gain. No gain where the covariance of the innovation is not positive definite.
    #[allow(clippy::type_complexity)]
    fn solve<const M: usize>(
        &self,
        prediction: &Prediction<R, N, M>,
    ) -> (Innovation<R>, Option<(SMatrix<R, N, M>, SMatrix<R, N, M>)>) {
        let h = &prediction.jacobian.0;
        let cross = self.cross(h);
        let Some(factor) = (h * cross + prediction.covariance).cholesky() else {
            let statistic = R::zero() / R::zero();
            let innovation =
                Innovation { statistic, dof: M, log_likelihood: statistic, accepted: false };
            return (innovation, None);
        };
        let weighted = factor.solve(&prediction.innovation);
        let statistic = prediction.innovation.dot(&weighted);
        let log_determinant = factor.l_dirty().diagonal().map(|d| d.ln()).sum() * real::<R>(2.0);
        let normalisation = real::<R>(M as f64 * libm::log(core::f64::consts::TAU));
        let innovation = Innovation {
            statistic,
            dof: M,
            log_likelihood: (statistic + log_determinant + normalisation) * real::<R>(-0.5),
            accepted: statistic <= real(chi_square_quantile(M)),
        };
        let mut gain = cross * factor.inverse();
        for (row, _) in self.considered.iter().enumerate().filter(|(_, considered)| **considered) {
            gain.row_mut(row).fill(R::zero());
        }
        (innovation, Some((cross, gain)))
    }

    /// Squared difference of a block to that of another filter, over the mean of both covariances. Infinite where that is
    /// not positive definite.
    pub(crate) fn distance<const W: usize>(&self, other: &Self, block: Block<W>) -> R {
        let difference = other.state.get(block) - self.state.get(block);
        let covariance = (self.covariance(block) + other.covariance(block)) * real::<R>(0.5);
        covariance
            .cholesky()
            .map_or(R::one() / R::zero(), |factor| difference.dot(&factor.solve(&difference)))
    }

    /// Mean and covariance of this and another filter, the other with probability `fraction`.
    pub(crate) fn moments(&self, other: &Self, fraction: R) -> Self {
        let mut joined = self.clone();
        let difference = self.state.difference(&other.state);
        joined.state.correct(difference * fraction);
        let rest = R::one() - fraction;
        joined.covariance = self.covariance * rest + other.covariance * fraction;
        joined.covariance.ger(fraction * rest, &difference, &difference, R::one());
        joined
    }

    /// Adds variances to the states of a block.
    pub(crate) fn add_variance<const W: usize>(&mut self, block: Block<W>, variance: [R; W]) {
        for (k, variance) in variance.into_iter().enumerate() {
            let at = block.start() + k;
            self.covariance[(at, at)] += variance;
        }
    }

    /// Rotates a block whose vector is in the navigation frame: its values, covariance and correlations.
    pub(crate) fn rotate(&mut self, block: Block<3>, rotation: &Rotation3<R>) {
        let values = rotation * self.state.get(block);
        self.state.set(block, values);
        let start = block.start();
        let rows = rotation.matrix() * self.covariance.fixed_rows::<3>(start);
        self.covariance.fixed_rows_mut::<3>(start).copy_from(&rows);
        let columns = self.covariance.fixed_columns::<3>(start) * rotation.matrix().transpose();
        self.covariance.fixed_columns_mut::<3>(start).copy_from(&columns);
    }

    /// Scales the covariance of some states, with all correlations kept.
    pub(crate) fn scale_covariance(&mut self, states: impl Fn(usize) -> bool, factor: R) {
        let root = factor.sqrt();
        for k in (0..N).filter(|k| states(*k)) {
            self.covariance.row_mut(k).scale_mut(root);
            self.covariance.column_mut(k).scale_mut(root);
        }
    }
}
