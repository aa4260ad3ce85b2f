//! Observability of the parameters: equation (17).

use nalgebra::Vector3;

use crate::force::Evaluated;
use crate::least_squares::{Fit, Magnitude};
use crate::linear::eigenvalue_range;
use crate::shared::Shared;
use crate::symmetric::{MOST, Scaled, Symmetric, Vector};
use crate::terms::{Slot, Theta};
use crate::weights::Weighting;
use crate::{MultiPosition, Orientation, Refusal};

/// Largest amplification of an error from the poses to other orientations. Twelve well distributed
/// poses give 1 to 2, twelve random ones 4.
const MOST_AMPLIFICATION: f64 = 10.0;
/// Largest number of attempts to invert a singular information matrix, each with four times the
/// diagonal.
const MOST_REGULARISATIONS: usize = 10;

/// Condition number of a problem with this inverse of the information matrix.
pub(crate) type Condition = fn(&Magnitude, &Symmetric) -> f64;

/// Observability of the fitted parameters.
pub(crate) struct Knowledge {
    /// Condition number of the Jacobian, with its parameters scaled to m/s² at 1 g.
    pub condition: f64,
    /// Standard deviation of |f| − g in the worst of 26 orientations, relative to that of the
    /// residuals.
    pub amplification: f64,
    /// That orientation: a pose there adds most information.
    pub poorest: Orientation,
    /// Variance of each parameter for residuals of unit variance, in terms of the error at 1 g.
    pub variance: Vector,
}

impl Knowledge {
    pub(crate) fn suffices(&self) -> bool {
        self.amplification < MOST_AMPLIFICATION
    }

    pub(crate) fn refusal(&self, what: MultiPosition, free: &[Slot]) -> Refusal {
        let largest = self.variance.iter().copied();
        let largest = largest.fold(0.0, f64::max);
        let poor = || {
            free.iter()
                .zip(self.variance.iter())
                .filter(|&(_, &variance)| variance >= 0.1 * largest)
                .map(|(&slot, _)| slot)
        };
        Refusal::NotObservable {
            model: what.model,
            parameters: poor().filter_map(Slot::parameter).collect(),
            terms: poor().filter_map(Slot::term).collect(),
            condition: self.condition,
            amplification: self.amplification,
            add: self.poorest,
            instead: None,
        }
    }
}

impl Magnitude<'_> {
    /// Standard deviation of |f| − g in the worst orientation, m/s².
    pub fn worst_sd(&self, fit: &Fit, knowledge: &Knowledge, shared: &Shared) -> f64 {
        let amplification = if shared.spread == fit.inverse {
            knowledge.amplification
        } else {
            Evaluated::new(&fit.theta, self.terms).map_or(f64::INFINITY, |at| {
                self.with_inverse(&at, |_, _| f64::NAN, &shared.spread).amplification
            })
        };
        amplification * libm::sqrt(shared.variance)
    }

    /// Observability of the fitted parameters, with equal weights.
    pub fn knowledge(&self, fit: &Fit, condition: Condition) -> Option<Knowledge> {
        let at = Evaluated::new(&fit.theta, self.terms)?;
        if self.weighting.is_equal() {
            return Some(self.with_inverse(&at, condition, &fit.inverse));
        }
        let information = self.information(&fit.theta, &Weighting::EQUAL)?;
        Some(self.with_inverse(&at, condition, &information.inverse()?))
    }

    /// Observability at `theta`, which need not be a solution; the parameters may be undetermined.
    pub fn knowledge_at(&self, theta: &Theta) -> Option<Knowledge> {
        let at = Evaluated::new(theta, self.terms)?;
        let information = self.information(theta, &Weighting::EQUAL)?;
        // Where singular, the smallest addition to the diagonal at the level of rounding that makes it
        // invertible.
        let squares = self.units().map(|unit| unit * unit);
        let scaled = information.diagonal().zip(squares);
        let largest = scaled.fold(0.0_f64, |most, (d, square)| most.max(d * square));
        let mut rounding = largest * f64::EPSILON;
        let regular = || {
            (0..MOST_REGULARISATIONS).find_map(|_| {
                let mut regular = information.clone();
                for i in 0..self.free.len() {
                    regular.row_mut(i)[i] += rounding / squares[i];
                }
                rounding *= 4.0;
                Some(Scaled::with_pivots(&regular, 0.0, 0.0)?.inverse())
            })
        };
        let inverse = information.inverse().or_else(regular)?;
        Some(self.with_inverse(&at, |problem, inverse| problem.condition(inverse), &inverse))
    }

    /// Value of each parameter that causes an error of 1 m/s² at 1 g.
    fn units(&self) -> Vector {
        let mut units = [0.0; MOST];
        for (unit, slot) in units.iter_mut().zip(&self.free) {
            *unit = slot.per_mps2(self.gravity_mps2);
        }
        units
    }

    /// Condition number of the Jacobian, with its parameters scaled to m/s² at 1 g.
    pub fn condition(&self, inverse: &Symmetric) -> f64 {
        let mut inverse = inverse.clone();
        inverse.rescale(&self.units().map(|unit| 1.0 / unit));
        let (least, largest) = eigenvalue_range(inverse);
        // A zero eigenvalue comes out as rounding of about this size.
        let floor = largest * f64::EPSILON * 0.5;
        libm::sqrt(largest / least.max(floor))
    }

    fn with_inverse(&self, at: &Evaluated, condition: Condition, inverse: &Symmetric) -> Knowledge {
        let units = self.units();
        let mut worst = 0.0;
        let mut poorest = Orientation::ALL[0];
        let mut see = |variance: f64, orientation: Orientation| {
            if variance > worst {
                worst = variance;
                poorest = orientation;
            }
        };
        let row = |orientation: Orientation| {
            let force = Vector3::from(orientation.up().map(|c| c * self.gravity_mps2));
            self.derivatives(at, &at.at(force))
        };
        let opposites = Orientation::ALL.iter().zip(Orientation::ALL.iter().rev());
        for (&one, &other) in opposites.take(Orientation::ALL.len() / 2) {
            let mut derivatives = row(one);
            see(inverse.form(&derivatives), one);
            if at.terms {
                derivatives = row(other);
            } else {
                // Only the derivatives of the bias, the first three, change their sign.
                for d in &mut derivatives[..3] {
                    *d = -*d;
                }
            }
            see(inverse.form(&derivatives), other);
        }
        Knowledge {
            condition: condition(self, inverse),
            amplification: libm::sqrt(worst),
            poorest,
            variance: core::array::from_fn(|i| match i < inverse.n() {
                true => inverse.at(i, i) / (units[i] * units[i]),
                false => 0.0,
            }),
        }
    }
}
