//! How probable poses are under a model: equation (49).

use nalgebra::{SMatrix, SVector};

use crate::least_squares::Fit;
use crate::linear::{Cholesky, Real, double};
use crate::terms::{PERFECT, Slot, Term};
use crate::weights::Rejected;

/// ln of how likely a term is there, per not there, before the poses are seen: one in four; of the
/// quadratic one, which 1 g hardly shows, one in fifty.
const fn beforehand(term: Term) -> f64 {
    match term {
        Term::Drift | Term::BiasTemperature | Term::ScaleTemperature => -1.4,
        Term::Quadratic => -3.9,
    }
}
/// ln of the probability of a pose that is bad, per m/s².
const BAD_POSE: f64 = -4.6;
/// Residuals below, (m/s²)², are rounding.
const LEAST_SQUARE: f64 = 1e-12;

/// ln p(y | model) with the usual spread of its parameters as what is known beforehand.
pub(crate) fn evidence<R: Real, const N: usize>(
    fit: &Fit<R, N>,
    free: &[Slot; N],
    kept: f64,
    telling: f64,
    rejected: Rejected,
) -> f64 {
    // Visits of one orientation that share their error are less than as many poses.
    let share = telling / kept;
    let half_dof = 0.5 * (telling - N as f64).max(1.0);
    let cost = share * fit.cost.max(LEAST_SQUARE);
    let variance = 0.5 * cost / half_dof;
    let inverse = fit.inverse.map(double) / share;
    // About a perfect sensor; what is not known beforehand has no part in it.
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
    let (Some((volume, _)), Some((spread, square))) = (
        factored(&inverse, &SVector::zeros()),
        factored(&known, &off),
    ) else {
        return f64::NEG_INFINITY;
    };
    let terms = free.iter().filter_map(|slot| slot.term());
    let terms: f64 = terms.map(|term| beforehand(term) / 3.0).sum();
    let bad = rejected.count() as f64 * BAD_POSE;
    libm::lgamma(half_dof) - half_dof * libm::log(core::f64::consts::PI * cost)
        + 0.5 * (volume - constants - spread - square)
        + bad
        + terms
}

/// ln det m and xᵀ m⁻¹ x of a positive definite matrix.
fn factored<const N: usize>(m: &SMatrix<f64, N, N>, x: &SVector<f64, N>) -> Option<(f64, f64)> {
    let unit = m.diagonal().map(|d| 1.0 / libm::sqrt(d));
    let scaled = SMatrix::from_fn(|r, c| m[(r, c)] * unit[r] * unit[c]);
    let factor = Cholesky::new(&scaled)?;
    let x = x.component_mul(&unit);
    let ln_det = factor.ln_det() - 2.0 * unit.map(libm::log).sum();
    Some((ln_det, x.dot(&factor.solve(&x))))
}
