//! Marginal likelihood of a model: equation (49).

use nalgebra::{DMatrix, DVector};

use crate::least_squares::Scaled;
use crate::magnitude::{Fit, Magnitude};
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
    let free = &problem.free;
    // Poses of one orientation with a common error count as fewer poses.
    let share = telling / problem.count() as f64;
    let prior_dof = POSE_SCATTER_DOF as f64;
    let half_dof = 0.5 * ((telling - free.len() as f64).max(1.0) + prior_dof);
    let expected = POSE_SCATTER_MPS2 * POSE_SCATTER_MPS2 + problem.mean_noise();
    let cost = share * fit.cost + prior_dof * expected;
    let variance = 0.5 * cost / half_dof;
    let inverse = &fit.inverse / share;
    // About a perfect sensor. Parameters with a flat prior do not contribute.
    let n = free.len();
    let known = DMatrix::from_fn(n, n, |r, c| match (free[r].usual_sd(), free[c].usual_sd()) {
        (Some(usual), Some(_)) => {
            let prior = if r == c { usual * usual } else { 0.0 };
            variance * inverse[(r, c)] + prior
        }
        _ if r == c => 1.0,
        _ => 0.0,
    });
    let off = DVector::from_fn(n, |i, _| match free[i].usual_sd() {
        Some(_) => fit.at[free[i].index()] - PERFECT[free[i].index()],
        None => 0.0,
    });
    let proper = free.iter().filter(|slot| slot.usual_sd().is_some()).count();
    let constants = proper as f64 * libm::log(core::f64::consts::TAU);
    let (Some(posterior), Some(prior)) = (Scaled::new(&inverse, 0.0), Scaled::new(&known, 0.0))
    else {
        return f64::NEG_INFINITY;
    };
    let square = off.dot(&prior.solve(&off).0);
    let terms = free.iter().filter_map(|slot| slot.term());
    let terms: f64 = terms.map(|term| beforehand(term) / 3.0).sum();
    let bad = problem.rejected.len() as f64 * BAD_POSE;
    libm::lgamma(half_dof) - half_dof * libm::log(core::f64::consts::PI * cost)
        + 0.5 * (posterior.ln_det() - constants - prior.ln_det() - square)
        + bad
        + terms
}
