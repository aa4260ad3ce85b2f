//! Marginal likelihood of a model: equation (49).

use crate::least_squares::{Fit, Magnitude};
use crate::symmetric::{MOST, Scaled, Symmetric, dot};
use crate::terms::{PERFECT, Term};
use crate::weights::{POSE_SCATTER_DOF, POSE_SCATTER_MPS2};

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
pub(crate) fn evidence(fit: &Fit, problem: &Magnitude, telling: f64) -> f64 {
    let (free, rejected) = (&problem.free, problem.rejected);
    let (kept, noise) = (problem.poses.len() - rejected.count(), problem.mean_noise());
    // Poses of one orientation with a common error count as fewer poses.
    let share = telling / kept as f64;
    let prior_dof = POSE_SCATTER_DOF as f64;
    let half_dof = 0.5 * ((telling - free.len() as f64).max(1.0) + prior_dof);
    let expected = POSE_SCATTER_MPS2 * POSE_SCATTER_MPS2 + noise;
    let cost = share * fit.cost + prior_dof * expected;
    let variance = 0.5 * cost / half_dof;
    let n = free.len();
    let inverse = Symmetric::from_fn(n, |r, c| fit.inverse.at(r, c) / share);
    // About a perfect sensor. Parameters with a flat prior do not contribute.
    let known = Symmetric::from_fn(n, |r, c| match (free[r].usual_sd(), free[c].usual_sd()) {
        (Some(usual), Some(_)) => {
            let prior = if r == c { usual * usual } else { 0.0 };
            variance * inverse.at(r, c) + prior
        }
        _ if r == c => 1.0,
        _ => 0.0,
    });
    let mut off = [0.0; MOST];
    let mut constants = 0.0;
    for (off, slot) in off.iter_mut().zip(free) {
        if slot.usual_sd().is_some() {
            *off = fit.theta[slot.index()] - PERFECT[slot.index()];
            constants += libm::log(core::f64::consts::TAU);
        }
    }
    let (Some(posterior), Some(prior)) = (Scaled::new(&inverse, 0.0), Scaled::new(&known, 0.0))
    else {
        return f64::NEG_INFINITY;
    };
    let square = dot(&off, &prior.solve(&off).0);
    let terms = free.iter().filter_map(|slot| slot.term());
    let terms: f64 = terms.map(|term| beforehand(term) / 3.0).sum();
    let bad = rejected.count() as f64 * BAD_POSE;
    libm::lgamma(half_dof) - half_dof * libm::log(core::f64::consts::PI * cost)
        + 0.5 * (posterior.ln_det() - constants - prior.ln_det() - square)
        + bad
        + terms
}
