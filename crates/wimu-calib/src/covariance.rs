//! Covariance of an error model's parameters.

use wimu_model::{ErrorTerms, TemperatureTerms};

use crate::terms::{self, Theta, USUAL_BIAS_MPS2};
use crate::{Gravity, Parameter, Parameters, Term};

/// Covariance of the 12 parameters of y = b + A f: m/s² for the bias, 1 for A.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Covariance([[f64; Parameter::COUNT]; Parameter::COUNT]);

impl Covariance {
    /// Covariance of two parameters, in the product of their units; 0 where one was not fitted.
    pub fn get(&self, a: Parameter, b: Parameter) -> f64 {
        self.0[a.index()][b.index()]
    }

    /// Standard deviation of a parameter, in its unit.
    pub fn sd(&self, parameter: Parameter) -> f64 {
        libm::sqrt(self.get(parameter, parameter).max(0.0))
    }

    /// The full matrix, in the order of [`Parameter::ALL`].
    pub fn matrix(&self) -> &[[f64; Parameter::COUNT]; Parameter::COUNT] {
        &self.0
    }

    /// Standard deviations in the form of the model, with those of the terms in the order of [`Term::ALL`].
    pub fn deviations(&self, terms: &[[f64; 3]; Term::ALL.len()]) -> ErrorTerms {
        let sd = Parameter::ALL.map(|parameter| self.sd(parameter));
        let [_, bias_mps2_per_k, scale_per_k, nonlinearity] = *terms;
        ErrorTerms {
            bias_mps2: [sd[0], sd[1], sd[2]],
            matrix: [[sd[3], sd[4], sd[5]], [sd[6], sd[7], sd[8]], [sd[9], sd[10], sd[11]]],
            temperature: TemperatureTerms {
                reference_c: 0.0,
                bias_mps2_per_k,
                scale_per_k,
                ..TemperatureTerms::default()
            },
            nonlinearity,
        }
    }

    pub(crate) const ZERO: Self = Self([[0.0; Parameter::COUNT]; Parameter::COUNT]);

    pub(crate) fn add(&mut self, a: Parameter, b: Parameter, covariance: f64) {
        self.0[a.index()][b.index()] += covariance;
    }

    /// Adds the covariances of the fitted parameters `free`, as far as they are among the 12.
    pub(crate) fn add_fitted(&mut self, free: &[usize], more: impl Fn(usize, usize) -> f64) {
        for (r, &a) in free.iter().enumerate() {
            for (c, &b) in free.iter().enumerate() {
                if a.max(b) < Parameter::COUNT {
                    self.0[a][b] += more(r, c);
                }
            }
        }
    }

    pub(crate) fn set(&mut self, a: Parameter, b: Parameter, covariance: f64) {
        self.0[a.index()][b.index()] = covariance;
    }

    /// Sets the variance of unobserved parameters to that of typical datasheets: 50 mg, 3 %, 2 %.
    pub(crate) fn take_for_granted(&mut self, unseen: Parameters) {
        for parameter in unseen.iter() {
            let usual = terms::usual_sd(parameter.index()).unwrap_or(USUAL_BIAS_MPS2);
            self.set(parameter, parameter, usual * usual);
        }
    }

    /// Of a full matrix, in the order of [`Parameter::ALL`].
    pub fn from_matrix(matrix: &[[f64; Parameter::COUNT]; Parameter::COUNT]) -> Self {
        Self(*matrix)
    }

    /// Adds the uncertainty of gravity: A is proportional to 1/g, so its relative error is common
    /// to all of A. The last term of equation (15).
    pub(crate) fn add_gravity(&mut self, theta: &Theta, gravity: Gravity) {
        let relative = gravity.sd_mps2() / gravity.mps2();
        self.add_common_scale(theta, relative * relative);
    }

    /// Removes the uncertainty of gravity, as far as it is included.
    pub(crate) fn remove_gravity(&mut self, theta: &Theta, gravity: Gravity) {
        let held = self.held_of_gravity(theta, gravity);
        self.add_common_scale(theta, -held);
    }

    /// Part of the variance of a parameter that is due to gravity.
    pub(crate) fn of_gravity(&self, theta: &Theta, gravity: Gravity, parameter: Parameter) -> f64 {
        match parameter.index() {
            0..3 => 0.0,
            i => theta[i] * theta[i] * self.held_of_gravity(theta, gravity),
        }
    }

    /// Relative variance of gravity, as far as it is included.
    fn held_of_gravity(&self, theta: &Theta, gravity: Gravity) -> f64 {
        let relative = gravity.sd_mps2() / gravity.mps2();
        let held = |axis: usize| {
            let scale = theta[3 + 4 * axis];
            self.0[3 + 4 * axis][3 + 4 * axis] / (scale * scale)
        };
        let most = (0..3).map(held).fold(f64::INFINITY, f64::min);
        (relative * relative).min(most)
    }

    fn add_common_scale(&mut self, theta: &Theta, variance: f64) {
        for i in 3..Parameter::COUNT {
            for j in 3..Parameter::COUNT {
                self.0[i][j] += theta[i] * theta[j] * variance;
            }
        }
    }
}
