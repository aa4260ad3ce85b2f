//! Marginal likelihood of a model: equation (49).

use nalgebra::{SMatrix, SVector};

use crate::least_squares::Fit;
use crate::linear::{Real, Scaled, double};
use crate::terms::{PERFECT, Slot, Term};
use crate::weights::{POSE_SCATTER_DOF, POSE_SCATTER_MPS2, Rejected};

/// ln of the prior odds of a term: one in four; one in fifty for the quadratic term, which is
/// hardly observable at 1 g.
const fn beforehand(term: Term) -> f64 {
    match term {
        Term::Drift | Term::BiasTemperature | Term::ScaleTemperature => -1.4,
        Term::Quadratic => -3.9,
    }
}
/// ln of the probability density of an outlier, per m/s².
const BAD_POSE: f64 = -4.6;

/// ln p(y | model), with the prior of the parameters from typical datasheets, and an inverse gamma
/// prior of the residuals' variance about that of [`POSE_SCATTER_MPS2`] and of the poses' mean
/// noise, (m/s²)².
pub(crate) fn evidence<R: Real, const N: usize>(
    fit: &Fit<R, N>,
    free: &[Slot; N],
    kept: f64,
    telling: f64,
    rejected: Rejected,
    noise: f64,
) -> f64 {
    // Poses of one orientation with a common error count as fewer poses.
    let share = telling / kept;
    let prior_dof = POSE_SCATTER_DOF as f64;
    let half_dof = 0.5 * ((telling - N as f64).max(1.0) + prior_dof);
    let expected = POSE_SCATTER_MPS2 * POSE_SCATTER_MPS2 + noise;
    let cost = share * fit.cost + prior_dof * expected;
    let variance = 0.5 * cost / half_dof;
    let inverse = fit.inverse.map(double) / share;
    // About a perfect sensor. Parameters with a flat prior do not contribute.
    let mut known = SMatrix::<f64, N, N>::identity();
    let mut off = SVector::<f64, N>::zeros();
    let mut constants = 0.0;
    for (i, a) in free.iter().enumerate() {
        let Some(usual) = a.usual_sd() else { continue };
        off[i] = double(fit.theta[a.index()]) - PERFECT[a.index()];
        constants += libm::log(core::f64::consts::TAU);
        for (j, b) in free.iter().enumerate() {
            if b.usual_sd().is_some() {
                known[(i, j)] = variance * inverse[(i, j)];
            }
        }
        known[(i, i)] += usual * usual;
    }
    let (Some(posterior), Some(prior)) = (Scaled::new(&inverse, 0.0), Scaled::new(&known, 0.0))
    else {
        return f64::NEG_INFINITY;
    };
    let square = off.dot(&prior.solve(&off).0);
    let terms = free.iter().filter_map(|slot| slot.term());
    let terms: f64 = terms.map(|term| beforehand(term) / 3.0).sum();
    let bad = rejected.count() as f64 * BAD_POSE;
    libm::lgamma(half_dof) - half_dof * libm::log(core::f64::consts::PI * cost)
        + 0.5 * (posterior.ln_det() - constants - prior.ln_det() - square)
        + bad
        + terms
}
