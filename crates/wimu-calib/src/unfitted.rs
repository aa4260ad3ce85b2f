//! Effect of parameters that a smaller model leaves out: equation (42a).

use alloc::format;
use alloc::vec::Vec;

use nalgebra::{DMatrix, DVector, Vector3};

use crate::force::Evaluated;
use crate::magnitude::{Fit, Magnitude, Shared, add_poses};
use crate::terms::{Slot, Theta, USUAL_BIAS_MPS2};
use crate::{Model, MultiPosition, Orientation, Parameters, Reason, Refusal, Terms};

/// A parameter is undetermined if its standard deviation exceeds this fraction of the prior: with
/// the residuals taken into account, and from the prior alone.
const LEAST_KNOWN: f64 = 0.5;
const LEAST_KNOWN_BEFORE: f64 = 1.0;

/// Effect of scale factors and misalignments that are assumed perfect: as far as the poses do not
/// show them, they bias the fitted parameters.
pub(crate) struct Unfitted {
    /// Their contribution to the covariance of the fitted parameters.
    pub covariance: DMatrix<f64>,
    /// Standard deviation of |f| − g in the worst of 26 orientations from noise and these
    /// parameters, m/s².
    pub worst_sd_mps2: f64,
    /// Smallest degrees of freedom of a fitted parameter.
    pub dof: f64,
    /// Parameters and terms that are undetermined because of them, and the worst orientation.
    parameters: Parameters,
    terms: Terms,
    poorest: Orientation,
}

impl Unfitted {
    /// `None` for a model that leaves nothing out. If `seen`, the residuals limit the size of the
    /// parameters left out; otherwise the prior alone does.
    pub fn of(
        problem: &Magnitude,
        fit: &Fit,
        shared: &Shared,
        what: MultiPosition,
        seen: bool,
    ) -> Option<Self> {
        let left_out = Model::Full9.fitted().without(what.model.fitted());
        let slots: Vec<Slot> = left_out.iter().map(Slot::of).collect();
        if slots.is_empty() {
            return None;
        }
        let usual_sd = slots.iter().map(|slot| slot.usual_sd().unwrap_or(0.0));
        let usual_sd = DVector::from_iterator(slots.len(), usual_sd);
        let at = Evaluated::new(&fit.at)?;
        let pick = |all: &Theta| slots.iter().map(|slot| all[slot.index()]).collect::<Vec<_>>();
        // Products of the derivatives by the parameters left out, in units of their priors.
        let (n, m) = (problem.free.len(), slots.len());
        let (mut both, mut own) = (DMatrix::zeros(n, m), DMatrix::zeros(m, m));
        for k in problem.kept() {
            let pose = &problem.poses[k];
            let all = at.derivatives(&at.pose(pose, &problem.conditions));
            let others = DVector::from_vec(pick(&all)).component_mul(&usual_sd);
            let weight = problem.weighting.of(pose);
            both.ger(weight, &problem.fitted(&all), &others, 1.0);
            own.ger(weight, &others, &others, 1.0);
        }
        // Change of the fitted parameters per prior deviation of a parameter left out, and what remains of it in the
        // residuals.
        let gain = &fit.inverse * &both;
        let left = own - both.tr_mul(&gain);
        let (trace, square) = (left.trace(), left.norm_squared());
        // Variance factor: the prior, or less if all residuals came from these parameters and are
        // smaller.
        let share = if seen && trace > fit.cost { fit.cost / trace } else { 1.0 };
        let share_dof =
            if share < 1.0 && square > 0.0 { trace * trace / square } else { f64::INFINITY };
        let added = &gain * gain.transpose();
        let own_variance = |i: usize| shared.variance * shared.spread[(i, i)];
        let most = (0..n).map(|i| share * added[(i, i)] / own_variance(i)).fold(0.0, f64::max);
        // An effect below that of the residual variance is included there already.
        let weight = if !seen {
            1.0
        } else if most > 1.0 {
            1.0 - 1.0 / most
        } else {
            0.0
        };
        let mut found = Self {
            covariance: added * (weight * share),
            worst_sd_mps2: 0.0,
            dof: shared.dof,
            parameters: Parameters::default(),
            terms: Terms::NONE,
            poorest: Orientation::ALL[0],
        };
        let least_known = if seen { LEAST_KNOWN } else { LEAST_KNOWN_BEFORE };
        for (i, slot) in problem.free.iter().enumerate() {
            let (noise, more) = (own_variance(i), found.covariance[(i, i)]);
            let freedom = (noise + more) * (noise + more)
                / (noise * noise / shared.dof + more * more / share_dof);
            if freedom.is_finite() {
                found.dof = found.dof.min(freedom.max(1.0));
            }
            let usual_sd = slot.usual_sd().unwrap_or(USUAL_BIAS_MPS2);
            if libm::sqrt(more) > least_known * usual_sd {
                found.parameters = found.parameters.iter().chain(slot.parameter()).collect();
                found.terms = found.terms.iter().chain(slot.term()).collect();
            }
        }
        let mut worst = 0.0;
        for orientation in Orientation::ALL {
            let up = orientation.up().map(|c| c * problem.gravity_mps2);
            let all = at.derivatives(&at.at(Vector3::from(up)));
            let row = problem.fitted(&all);
            let off = DVector::from_vec(pick(&all)).component_mul(&usual_sd) - gain.tr_mul(&row);
            let noise = shared.variance * row.dot(&(&shared.spread * &row));
            let variance = noise + share * off.norm_squared();
            if variance > worst {
                (worst, found.poorest) = (variance, orientation);
            }
        }
        found.worst_sd_mps2 = libm::sqrt(worst);
        Some(found)
    }

    /// The refusal, if parameters are undetermined.
    pub fn refusal(&self, model: Model) -> Option<Refusal> {
        let sound = self.parameters.is_empty() && self.terms == Terms::NONE;
        let refusal = || {
            let text = format!(
                "These poses do not determine the {model}: typical scale factors and misalignments, which it leaves out, \
                 bias it. {}",
                add_poses(self.poorest)
            );
            Refusal::new(Reason::NotObservable, text)
        };
        (!sound).then(refusal)
    }
}
