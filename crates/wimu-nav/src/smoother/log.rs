//! The log of a filter for the smoother.

use alloc::vec::Vec;

use nalgebra::{DMatrix, DVector};

use crate::process::Transition;
use crate::sensor::Prediction;
use crate::state::State;

/// A time in the log: the prediction from the epoch before, and all updates of that time.
#[derive(Clone, Debug)]
pub struct Epoch {
    /// Whether the epoch before is connected with this one.
    pub(super) linked: bool,
    pub(super) considered: Vec<bool>,
    /// Error before the updates by that after them at the epoch before: F. Once smoothed: gain G of the epoch before.
    pub(super) transition: DMatrix<f64>,
    /// Covariance Q of the noise of the prediction. Once smoothed: (P Fᵀ − G P₋) Θᵀ, see equation (138).
    pub(super) noise: DMatrix<f64>,
    /// Error after the updates by that before them: product Θ of 1 − K H. Once smoothed: Θ F.
    pub(super) update: DMatrix<f64>,
    /// Covariance of K n. Once smoothed: derivative A of the smoothed error by the filtered one.
    pub(super) update_noise: DMatrix<f64>,
    /// Covariance after the updates. Once smoothed: given all measurements.
    pub(super) covariance: DMatrix<f64>,
    /// Error that the updates added to the state.
    pub(super) injected: DVector<f64>,
    /// Error that the smoother adds to the state after the updates.
    pub(super) correction: DVector<f64>,
}

impl Epoch {
    /// Memory of an epoch with `states` states, bytes.
    pub fn bytes(states: usize) -> usize {
        size_of::<f64>() * states * (5 * states + 2)
    }

    fn empty(states: usize) -> Self {
        let (none, identity) = (DMatrix::zeros(states, states), DMatrix::identity(states, states));
        Self {
            linked: true,
            considered: Vec::new(),
            transition: identity.clone(),
            noise: none.clone(),
            update: identity,
            update_noise: none.clone(),
            covariance: none,
            injected: DVector::zeros(states),
            correction: DVector::zeros(states),
        }
    }
}

/// Records epochs: at each time with an update, and at least as often as an interval.
#[derive(Clone, Debug)]
pub struct Log {
    /// The epochs. They have grown with a sample if the last one is that of the sample; the last one must stay, as the next
    /// one refers to it.
    pub epochs: Vec<Epoch>,
    interval_s: f64,
    elapsed_s: f64,
    changed: bool,
    next: Option<Epoch>,
    predicted: Option<State>,
}

impl Log {
    /// A log with the longest interval between epochs, s.
    pub fn new(interval_s: f64) -> Self {
        let epochs = Vec::new();
        Self { epochs, interval_s, elapsed_s: 0.0, changed: false, next: None, predicted: None }
    }

    fn push(
        &mut self,
        state: &State,
        covariance: &DMatrix<f64>,
        considered: &[bool],
        linked: bool,
    ) {
        let states = considered.len();
        let next = self.next.replace(Epoch::empty(states));
        // After a claim of states nothing before it is linked.
        let next = next.filter(|next| next.injected.len() == states);
        let mut epoch = next.unwrap_or_else(|| Epoch::empty(states));
        epoch.linked = linked;
        epoch.considered = considered.to_vec();
        epoch.covariance.copy_from(covariance);
        let predicted = self.predicted.replace(state.clone());
        if let Some(predicted) = predicted.filter(|p| p.vector.len() == states) {
            epoch.injected = predicted.difference(state);
        }
        self.epochs.push(epoch);
        self.elapsed_s = 0.0;
        self.changed = false;
    }

    /// After a prediction, before the updates with the measurements of its time.
    pub(crate) fn predicted(&mut self, state: &State, transition: &Transition) {
        if let Some(next) = &mut self.next {
            transition.multiply(&mut next.transition);
            transition.apply(&mut next.noise);
        }
        self.predicted = Some(state.clone());
    }

    /// After an update with a gain.
    pub(crate) fn corrected(&mut self, gain: &DMatrix<f64>, prediction: &Prediction) {
        let Some(next) = &mut self.next else {
            return;
        };
        for matrix in [&mut next.update, &mut next.update_noise] {
            let by_h = prediction.by_h(matrix);
            matrix.gemm(-1.0, gain, &by_h, 1.0);
        }
        let left = prediction.times_ht(&next.update_noise) - gain * &prediction.r;
        next.update_noise.gemm(-1.0, &left, &gain.transpose(), 1.0);
        self.changed = true;
    }

    /// After all updates of a time, which is a step later than that before, s.
    pub(crate) fn updated(
        &mut self,
        state: &State,
        covariance: &DMatrix<f64>,
        considered: &[bool],
        step_s: f64,
    ) {
        self.elapsed_s += step_s;
        if self.changed || self.elapsed_s >= self.interval_s {
            self.push(state, covariance, considered, true);
        }
    }

    /// The state or its covariance was replaced: what follows says nothing of what was before.
    pub(crate) fn restarted(
        &mut self,
        state: &State,
        covariance: &DMatrix<f64>,
        considered: &[bool],
    ) {
        self.push(state, covariance, considered, false);
    }
}
