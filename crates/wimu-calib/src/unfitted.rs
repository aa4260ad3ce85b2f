//! Effect of parameters that a smaller model leaves out: equation (42a).

use nalgebra::Vector3;

use crate::force::Evaluated;
use crate::least_squares::{Fit, Magnitude};
use crate::shared::Shared;
use crate::symmetric::{self, Symmetric, Vector, dot};
use crate::terms::{Slot, USUAL_BIAS_MPS2};
use crate::{Model, MultiPosition, Orientation, Parameters, Refusal, Terms};

/// Largest number of parameters left out: three scale factors and three misalignments.
const MOST: usize = 6;
/// A parameter is undetermined if its standard deviation exceeds this fraction of the prior: with
/// the residuals taken into account, and from the prior alone.
const LEAST_KNOWN: f64 = 0.5;
const LEAST_KNOWN_BEFORE: f64 = 1.0;

/// Effect of scale factors and misalignments that are assumed perfect: as far as the poses do not
/// show them, they bias the fitted parameters.
pub(crate) struct Unfitted {
    /// Their contribution to the covariance of the fitted parameters.
    pub covariance: Symmetric,
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
        let mut slots = [None; MOST];
        for (place, parameter) in slots.iter_mut().zip(left_out.iter()) {
            *place = Some(Slot::of(parameter));
        }
        if left_out.is_empty() {
            return None;
        }
        let n = problem.free.len();
        // Prior variances.
        let usual: [f64; MOST] = slots.map(|slot| {
            let sd = slot.and_then(Slot::usual_sd).unwrap_or(0.0);
            sd * sd
        });
        let at = Evaluated::new(&fit.theta, problem.terms)?;
        let pick = |all: &crate::terms::Theta| {
            slots.map(|slot: Option<Slot>| slot.map_or(0.0, |slot| all[slot.index()]))
        };
        let mut both = [[0.0; symmetric::MOST]; MOST];
        let mut own = Symmetric::zero(MOST);
        for (row, all, weight) in problem.rows(&at) {
            let others = pick(&all);
            for (both, other) in both.iter_mut().zip(others) {
                symmetric::add(both, weight * other, &row);
            }
            own.add_outer(&others, weight);
        }
        // Change of the fitted parameters per unit of a parameter left out, and what remains of it
        // in the residuals.
        let gain: [Vector; MOST] = core::array::from_fn(|j| fit.inverse.times(&both[j]));
        let left = |i: usize, j: usize| own.at(i, j) - dot(&both[i], &gain[j]);
        let (variance, dof) = (shared.variance, shared.dof);
        let own_variance = |i: usize| variance * shared.spread.at(i, i);
        let (mut trace, mut square) = (0.0, 0.0);
        for i in 0..MOST {
            trace += usual[i] * left(i, i).max(0.0);
            for j in 0..MOST {
                square += usual[i] * left(i, j) * usual[j] * left(j, i);
            }
        }
        // Variance factor: the prior, or less if all residuals came from these parameters and are
        // smaller.
        let share = if seen && trace > fit.cost { fit.cost / trace } else { 1.0 };
        let share_dof =
            if share < 1.0 && square > 0.0 { trace * trace / square } else { f64::INFINITY };
        let added = |i: usize| {
            let squares = (0..MOST).map(|j| gain[j][i] * gain[j][i] * usual[j]);
            share * squares.sum::<f64>()
        };
        let ratio = |i: usize| added(i) / own_variance(i);
        let most = (0..n).map(ratio).fold(0.0, f64::max);
        // An effect below that of the residual variance is included there already.
        let weight = match seen {
            true if most > 1.0 => 1.0 - 1.0 / most,
            true => 0.0,
            false => 1.0,
        };
        let least_known = if seen { LEAST_KNOWN } else { LEAST_KNOWN_BEFORE };
        let counted = weight * share;

        let mut found = Self {
            covariance: Symmetric::from_fn(n, |r, c| {
                let products = (0..MOST).map(|j| gain[j][r] * gain[j][c] * usual[j]);
                counted * products.sum::<f64>()
            }),
            worst_sd_mps2: 0.0,
            dof,
            parameters: Parameters::default(),
            terms: Terms::NONE,
            poorest: Orientation::ALL[0],
        };
        for (i, slot) in problem.free.iter().enumerate() {
            let (noise, more) = (own_variance(i), found.covariance.at(i, i));
            let freedom =
                (noise + more) * (noise + more) / (noise * noise / dof + more * more / share_dof);
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
            let applied = at.at(Vector3::from(up));
            let row = problem.derivatives(&at, &applied);
            let others = pick(&at.derivatives(&applied));
            let noise = variance * shared.spread.form(&row);
            let more: f64 = (0..MOST)
                .map(|j| {
                    let passed = dot(&row, &gain[j]);
                    let off = others[j] - passed;
                    off * off * usual[j]
                })
                .sum();
            let all = noise + share * more;
            if all > worst {
                worst = all;
                found.poorest = orientation;
            }
        }
        found.worst_sd_mps2 = libm::sqrt(worst);
        Some(found)
    }

    /// The refusal, if parameters are undetermined.
    pub fn refusal(&self, model: Model) -> Option<Refusal> {
        let sound = self.parameters.is_empty() && self.terms == Terms::NONE;
        (!sound).then_some(Refusal::Confounded {
            model,
            parameters: self.parameters,
            terms: self.terms,
            add: self.poorest,
            instead: None,
        })
    }
}
