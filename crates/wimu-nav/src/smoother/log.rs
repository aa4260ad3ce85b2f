//! The log of a filter for the smoother.

use nalgebra::{RealField, SMatrix, SVector, Vector3};

use crate::filter::Filter;
use crate::process::Transition;
use crate::rotation::real;
use crate::sensor::Prediction;
use crate::state::{ATTITUDE, State};

/// What a navigator reports to a recorder. `()` records nothing and costs nothing.
pub trait Recorder<R, const N: usize> {
    /// After a prediction, before the updates with the measurements of its time.
    fn predicted(&mut self, _: &Filter<R, N>, _: &Transition<R, N>) {}
    /// After an update with a gain.
    fn corrected<const M: usize>(&mut self, _: &SMatrix<R, N, M>, _: &Prediction<R, N, M>) {}
    /// After all updates of a time, which is a step later than that before, s.
    fn updated(&mut self, _: &Filter<R, N>, _step_s: R) {}
    /// The state or its covariance was replaced: what follows says nothing of what was before.
    fn restarted(&mut self, _: &Filter<R, N>) {}
}

impl<R, const N: usize> Recorder<R, N> for () {}

/// A time in the log: the prediction from the epoch before, and all updates of that time.
#[derive(Clone, Debug)]
pub struct Epoch<R, const N: usize> {
    /// Whether the epoch before is connected with this one.
    pub(super) linked: bool,
    pub(super) considered: [bool; N],
    /// Error before the updates by that after them at the epoch before: F. Once smoothed: gain G of the epoch before.
    pub(super) transition: SMatrix<R, N, N>,
    /// Covariance Q of the noise of the prediction. Once smoothed: (P Fᵀ − G P₋) Θᵀ, see equation (138).
    pub(super) noise: SMatrix<R, N, N>,
    /// Error after the updates by that before them: product Θ of 1 − K H. Once smoothed: Θ F.
    pub(super) update: SMatrix<R, N, N>,
    /// Covariance of K n. Once smoothed: derivative A of the smoothed error by the filtered one.
    pub(super) update_noise: SMatrix<R, N, N>,
    /// Covariance after the updates. Once smoothed: given all measurements.
    pub(super) covariance: SMatrix<R, N, N>,
    /// Error that the updates added to the state.
    pub(super) injected: SVector<R, N>,
    /// Error that the smoother adds to the state after the updates.
    pub(super) correction: SVector<R, N>,
}

/// Records epochs in a collection: at each time with an update, and at least as often as an interval.
#[derive(Clone, Debug)]
pub struct Log<R, const N: usize, S> {
    epochs: S,
    interval_s: R,
    elapsed_s: R,
    changed: bool,
    next: Option<Epoch<R, N>>,
    predicted: Option<State<R, N>>,
}

impl<R: RealField + Copy, const N: usize, S: Extend<Epoch<R, N>>> Log<R, N, S> {
    /// A log into a collection, with the longest interval between epochs, s.
    pub fn new(epochs: S, interval_s: R) -> Self {
        Self {
            epochs,
            interval_s,
            elapsed_s: R::zero(),
            changed: false,
            next: None,
            predicted: None,
        }
    }

    /// The collection. It has grown with a sample if its last epoch is that of the sample.
    pub fn epochs(&self) -> &S {
        &self.epochs
    }

    /// The collection, to take epochs from it: the last one must stay, as the next one refers to it.
    pub fn epochs_mut(&mut self) -> &mut S {
        &mut self.epochs
    }

    /// The collection, at the end.
    pub fn into_epochs(self) -> S {
        self.epochs
    }

    fn push(&mut self, filter: &Filter<R, N>, linked: bool) {
        let next = Epoch {
            linked: true,
            considered: filter.considered,
            transition: SMatrix::identity(),
            noise: SMatrix::zeros(),
            update: SMatrix::identity(),
            update_noise: SMatrix::zeros(),
            covariance: filter.covariance,
            injected: SVector::zeros(),
            correction: SVector::zeros(),
        };
        let mut epoch = self.next.replace(next.clone()).unwrap_or(next);
        epoch.linked = linked;
        epoch.covariance = filter.covariance;
        if let Some(predicted) = self.predicted.replace(filter.state.clone()) {
            epoch.injected = difference(&filter.state, &predicted);
        }
        self.epochs.extend([epoch]);
        self.elapsed_s = R::zero();
        self.changed = false;
    }
}

impl<R, const N: usize, S> Recorder<R, N> for Log<R, N, S>
where
    R: RealField + Copy,
    S: Extend<Epoch<R, N>>,
{
    fn predicted(&mut self, filter: &Filter<R, N>, transition: &Transition<R, N>) {
        if let Some(next) = &mut self.next {
            transition.multiply(&mut next.transition);
            transition.apply(&mut next.noise);
        }
        self.predicted = Some(filter.state.clone());
    }

    fn corrected<const M: usize>(
        &mut self,
        gain: &SMatrix<R, N, M>,
        prediction: &Prediction<R, N, M>,
    ) {
        if let Some(next) = &mut self.next {
            let h = &prediction.jacobian.0;
            next.update -= gain * (h * next.update);
            let left = next.update_noise - gain * (h * next.update_noise);
            next.update_noise =
                left - (left * h.transpose() - gain * prediction.covariance) * gain.transpose();
            self.changed = true;
        }
    }

    fn updated(&mut self, filter: &Filter<R, N>, step_s: R) {
        self.elapsed_s += step_s;
        if self.changed || self.elapsed_s >= self.interval_s {
            self.push(filter, true);
        }
    }

    fn restarted(&mut self, filter: &Filter<R, N>) {
        self.push(filter, false);
    }
}

/// Error of a state against another: the rotation vector between the attitudes, and differences.
fn difference<R: RealField + Copy, const N: usize>(
    state: &State<R, N>,
    from: &State<R, N>,
) -> SVector<R, N> {
    let m = state.attitude * from.attitude.inverse();
    let axis = Vector3::new(m[(2, 1)] - m[(1, 2)], m[(0, 2)] - m[(2, 0)], m[(1, 0)] - m[(0, 1)]);
    // 2 sin and 2 cos of the angle. `Rotation3::scaled_axis` has half the digits for small angles.
    let (sine, cosine) = (axis.norm(), m.matrix().trace() - R::one());
    let factor = if sine > real(1e-6) { sine.atan2(cosine) / sine } else { real(0.5) };
    let mut error = state.vector - from.vector;
    let rotation = axis * factor;
    error.fixed_rows_mut::<3>(ATTITUDE.start()).copy_from(&rotation);
    error
}
