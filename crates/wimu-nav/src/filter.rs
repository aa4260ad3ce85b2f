//! Error-state Schmidt–Kalman filter: prediction, update and test, for any process and sensor. Equations (117) to (121) of
//! docs/reference/equations.

use alloc::boxed::Box;
use alloc::vec::Vec;

use nalgebra::{DMatrix, DVector, Rotation3, SMatrix};

use crate::process::{Process, Transition};
use crate::rotation::orthonormal;
use crate::sensor::{Measurement, Prediction};
use crate::smoother::Log;
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
pub struct Innovation {
    /// Measured minus predicted value; of several values the length of their vector.
    pub value: f64,
    /// Normalised innovation squared: χ² distributed if the filter is consistent. Not a number where the covariance is
    /// not positive definite.
    pub statistic: f64,
    /// Degrees of freedom.
    pub dof: usize,
    /// Logarithm of the Gaussian density of the measurement.
    pub log_likelihood: f64,
    /// Whether the state was updated.
    pub accepted: bool,
}

/// P Hᵀ and the gain of an update.
struct Solved {
    cross: DMatrix<f64>,
    gain: DMatrix<f64>,
}

/// The filter: nominal state, and covariance of its error.
#[derive(Clone, Debug)]
pub struct Filter {
    /// Nominal state.
    pub state: State,
    pub(crate) covariance: DMatrix<f64>,
    pub(crate) considered: Vec<bool>,
    /// Steps since the attitude was made orthonormal.
    steps: u8,
    log: Option<Box<Log>>,
}

impl Filter {
    /// At an attitude, with all other states zero and the standard deviations of the layout.
    pub fn new(layout: &Layout, attitude: Rotation3<f64>) -> Self {
        let variance = DVector::from_iterator(layout.len(), layout.deviation.iter().map(|d| d * d));
        Self {
            state: State { attitude, vector: DVector::zeros(layout.len()) },
            covariance: DMatrix::from_diagonal(&variance),
            considered: layout.considered.clone(),
            steps: 0,
            log: None,
        }
    }

    /// Adds the states that a layout has claimed since, with their standard deviations.
    pub(crate) fn extend(&mut self, layout: &Layout) {
        let (from, to) = (self.considered.len(), layout.len());
        let none = DMatrix::zeros(0, 0);
        self.covariance = core::mem::replace(&mut self.covariance, none).resize(to, to, 0.0);
        let vector = core::mem::replace(&mut self.state.vector, DVector::zeros(0));
        self.state.vector = vector.resize_vertically(to, 0.0);
        for (k, deviation) in layout.deviation.iter().enumerate().skip(from) {
            self.covariance[(k, k)] = deviation * deviation;
        }
        self.considered.clone_from(&layout.considered);
        self.restart_log();
    }

    /// Number of states.
    pub fn states(&self) -> usize {
        self.considered.len()
    }

    /// Records all that follows, for a smoother.
    pub fn record(&mut self, log: Log) {
        self.log = Some(Box::new(log));
        self.restart_log();
    }

    /// What was recorded.
    pub fn log_mut(&mut self) -> Option<&mut Log> {
        self.log.as_deref_mut()
    }

    pub(crate) fn take_log(&mut self) -> Option<Box<Log>> {
        self.log.take()
    }

    pub(crate) fn put_log(&mut self, log: Option<Box<Log>>) {
        self.log = log;
    }

    /// Ends the updates of a time, which is a step later than that before, s.
    pub fn end_step(&mut self, step_s: f64) {
        if let Some(log) = &mut self.log {
            log.updated(&self.state, &self.covariance, &self.considered, step_s);
        }
    }

    /// The state or its covariance was replaced: what follows says nothing of what was before.
    pub fn restart_log(&mut self) {
        if let Some(log) = &mut self.log {
            log.restarted(&self.state, &self.covariance, &self.considered);
        }
    }

    /// Covariance of a block.
    pub fn covariance<const W: usize>(&self, block: Block<W>) -> SMatrix<f64, W, W> {
        self.cross_covariance(block, block)
    }

    /// Covariance between two blocks.
    pub fn cross_covariance<const V: usize, const W: usize>(
        &self,
        rows: Block<V>,
        columns: Block<W>,
    ) -> SMatrix<f64, V, W> {
        self.covariance.fixed_view::<V, W>(rows.start(), columns.start()).into_owned()
    }

    /// Replaces the covariance of a block by a given one, without correlation to other blocks: for a prior that is
    /// known, such as the covariance of a calibration.
    pub fn set_covariance<const W: usize>(
        &mut self,
        block: Block<W>,
        covariance: &SMatrix<f64, W, W>,
    ) {
        let start = block.start();
        self.covariance.fixed_rows_mut::<W>(start).fill(0.0);
        self.covariance.fixed_columns_mut::<W>(start).fill(0.0);
        self.covariance.fixed_view_mut::<W, W>(start, start).copy_from(covariance);
    }

    /// Replaces the covariance between two different blocks.
    pub fn set_cross_covariance<const V: usize, const W: usize>(
        &mut self,
        rows: Block<V>,
        columns: Block<W>,
        covariance: &SMatrix<f64, V, W>,
    ) {
        let (row, column) = (rows.start(), columns.start());
        self.covariance.fixed_view_mut::<V, W>(row, column).copy_from(covariance);
        self.covariance.fixed_view_mut::<W, V>(column, row).copy_from(&covariance.transpose());
    }

    /// Whether state and variances are finite and no variance is negative.
    pub fn is_sound(&self) -> bool {
        let variances = self.covariance.diagonal();
        self.state.is_finite() && variances.iter().all(|v| v.is_finite() && *v >= 0.0)
    }

    /// Prediction: state and covariance after a step of the process, P ← F P Fᵀ + Q.
    pub fn predict(&mut self, process: &impl Process) {
        let mut transition = Transition::new(self.states());
        process.propagate(&mut self.state, &mut transition);
        transition.apply(&mut self.covariance);
        self.steps = self.steps.wrapping_add(1);
        if self.steps == 0 {
            self.state.attitude = orthonormal(&self.state.attitude);
        }
        if let Some(log) = &mut self.log {
            log.predicted(&self.state, &transition);
        }
    }

    /// Test of a measurement, without an update.
    pub fn test(&self, measurement: &impl Measurement) -> Innovation {
        self.solve(&measurement.predict(self)).0
    }

    /// Update with a measurement: the optimal gain, with the rows of considered states set to zero, in Joseph's form
    /// (P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems", 2nd ed. 2013, 3.4.3).
    pub fn update(&mut self, measurement: &impl Measurement, gate: Gate) -> Innovation {
        self.update_if(measurement, |innovation| match gate {
            Gate::Open => innovation.statistic.is_finite(),
            Gate::ChiSquare => innovation.statistic <= chi_square_quantile(innovation.dof),
        })
    }

    /// Update of some states only: the others are considered meanwhile.
    pub(crate) fn update_only(
        &mut self,
        estimated: impl Fn(usize) -> bool,
        measurement: &impl Measurement,
    ) -> Innovation {
        let considered = self.considered.clone();
        for (state, is_considered) in self.considered.iter_mut().enumerate() {
            *is_considered |= !estimated(state);
        }
        let innovation = self.update(measurement, Gate::ChiSquare);
        self.considered = considered;
        innovation
    }

    /// Update where a condition on the innovation holds.
    pub(crate) fn update_if(
        &mut self,
        measurement: &impl Measurement,
        accept: impl FnOnce(&Innovation) -> bool,
    ) -> Innovation {
        let prediction = measurement.predict(self);
        let (mut innovation, solved) = self.solve(&prediction);
        innovation.accepted = accept(&innovation);
        let Some(Solved { cross, gain }) = solved.filter(|_| innovation.accepted) else {
            innovation.accepted = false;
            return innovation;
        };
        // (1 − K H) P (1 − K H)ᵀ + K R Kᵀ, without products of N × N matrices: P Hᵀ is known.
        let left = &cross - &gain * prediction.by_h(&cross) - &gain * &prediction.r;
        self.covariance.gemm(-1.0, &gain, &cross.transpose(), 1.0);
        self.covariance.gemm(-1.0, &left, &gain.transpose(), 1.0);
        symmetrise(&mut self.covariance);
        self.state.correct(&gain * &prediction.z);
        if let Some(log) = &mut self.log {
            log.corrected(&gain, &prediction);
        }
        innovation
    }

    /// Covariance of an innovation: H P Hᵀ + R.
    pub(crate) fn variance_of(&self, prediction: &Prediction) -> DMatrix<f64> {
        prediction.by_h(&prediction.times_ht(&self.covariance)) + &prediction.r
    }

    /// Innovation, P Hᵀ and gain. No gain where the covariance of the innovation is not positive definite.
    fn solve(&self, prediction: &Prediction) -> (Innovation, Option<Solved>) {
        let dof = prediction.dof;
        let cross = prediction.times_ht(&self.covariance);
        let value = if prediction.z.len() == 1 { prediction.z[0] } else { prediction.z.norm() };
        let Some(factor) = (prediction.by_h(&cross) + &prediction.r).cholesky() else {
            let (statistic, log_likelihood) = (f64::NAN, f64::NAN);
            let innovation = Innovation { value, statistic, dof, log_likelihood, accepted: false };
            return (innovation, None);
        };
        let statistic = prediction.z.dot(&factor.solve(&prediction.z));
        let log_determinant = 2.0 * factor.l_dirty().diagonal().map(libm::log).sum();
        let normalisation = dof as f64 * libm::log(core::f64::consts::TAU);
        let innovation = Innovation {
            value,
            statistic,
            dof,
            log_likelihood: -0.5 * (statistic + log_determinant + normalisation),
            accepted: statistic <= chi_square_quantile(dof),
        };
        let mut gain = &cross * factor.inverse();
        for (row, _) in self.considered.iter().enumerate().filter(|(_, considered)| **considered) {
            gain.row_mut(row).fill(0.0);
        }
        (innovation, Some(Solved { cross, gain }))
    }

    /// Squared difference of a block to that of another filter, over the mean of both covariances. Infinite where that is
    /// not positive definite.
    pub(crate) fn distance<const W: usize>(&self, other: &Self, block: Block<W>) -> f64 {
        let difference = other.state.get(block) - self.state.get(block);
        let covariance = (self.covariance(block) + other.covariance(block)) * 0.5;
        let factor = covariance.cholesky();
        factor.map_or(f64::INFINITY, |factor| difference.dot(&factor.solve(&difference)))
    }

    /// Mean and covariance of this and another filter, the other with probability `fraction`.
    pub(crate) fn moments(&self, other: &Self, fraction: f64) -> Self {
        let mut joined = self.clone();
        let difference = self.state.difference(&other.state);
        joined.state.correct(&difference * fraction);
        let rest = 1.0 - fraction;
        joined.covariance = &self.covariance * rest + &other.covariance * fraction;
        joined.covariance.ger(fraction * rest, &difference, &difference, 1.0);
        joined
    }

    /// Adds variances to the states of a block.
    pub(crate) fn add_variance<const W: usize>(&mut self, block: Block<W>, variance: [f64; W]) {
        for (k, variance) in variance.into_iter().enumerate() {
            let at = block.start() + k;
            self.covariance[(at, at)] += variance;
        }
    }

    /// Rotates a block whose vector is in the navigation frame: its values, covariance and correlations.
    pub(crate) fn rotate(&mut self, block: Block<3>, rotation: &Rotation3<f64>) {
        let values = rotation * self.state.get(block);
        self.state.set(block, values);
        let start = block.start();
        let rows = rotation.matrix() * self.covariance.fixed_rows::<3>(start);
        self.covariance.fixed_rows_mut::<3>(start).copy_from(&rows);
        let columns = self.covariance.fixed_columns::<3>(start) * rotation.matrix().transpose();
        self.covariance.fixed_columns_mut::<3>(start).copy_from(&columns);
    }

    /// Scales the covariance of some states, with all correlations kept.
    pub(crate) fn scale_covariance(&mut self, states: impl Fn(usize) -> bool, factor: f64) {
        let root = libm::sqrt(factor);
        for k in (0..self.states()).filter(|k| states(*k)) {
            self.covariance.row_mut(k).scale_mut(root);
            self.covariance.column_mut(k).scale_mut(root);
        }
    }
}

/// The mean of a matrix and its transpose.
pub(crate) fn symmetrise(matrix: &mut DMatrix<f64>) {
    for column in 1..matrix.ncols() {
        for row in 0..column {
            let mean = 0.5 * (matrix[(row, column)] + matrix[(column, row)]);
            matrix[(row, column)] = mean;
            matrix[(column, row)] = mean;
        }
    }
}
