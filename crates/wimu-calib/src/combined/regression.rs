//! Regression of the parameters of several sessions on temperature.

use nalgebra::{Matrix2, Vector2};
use wimu_model::CalibratedTemperature;

use super::group_of;
use crate::terms::usual_sd;
use crate::{Covariance, Estimate, Parameter, Parameters};

/// Sessions from which on temperature coefficients are estimated.
const SESSIONS_FOR_SLOPES: usize = 3;
/// Smallest standard deviation of a parameter within a session, its unit: noiseless data.
pub(super) const LEAST_SD: f64 = 1e-8;

/// Precision of the prior of a slope that is not estimated, of 0.
const NO_SLOPE: f64 = 1e30;

/// The temperature coefficient of a bias or scale factor, an index of [`Theta`](crate::terms::Theta).
pub(super) fn slope_of(parameter: Parameter) -> Option<usize> {
    match parameter.index() {
        axis @ 0..3 => Some(15 + axis),
        scale @ (3 | 7 | 11) => Some(18 + scale / 4),
        _ => None,
    }
}

/// Sessions of one sensor.
pub(super) struct Sessions<'a> {
    all: &'a [Estimate],
    /// Whether temperature coefficients are estimated.
    pub slopes: bool,
    /// Mean temperature, °C.
    pub reference_c: f64,
}

/// Variance between sessions.
#[derive(Clone, Copy)]
pub(super) struct Between {
    pub variance: f64,
    pub dof: f64,
}

/// One parameter as a function of temperature.
#[derive(Clone, Copy)]
pub(super) struct Line {
    /// At the reference temperature, and its change per K.
    pub at: Vector2<f64>,
    /// Their covariance, if the variances within and between sessions are right.
    pub covariance: Matrix2<f64>,
    /// Variance between sessions.
    between: f64,
    /// Precision of the slope's prior.
    prior: f64,
    /// Weighted sum of squared residuals, and its expectation.
    residual: f64,
    dof: f64,
}

impl Line {
    /// Standard deviation of the slope; 0 without one.
    pub fn slope_sd(&self) -> f64 {
        if self.prior < NO_SLOPE { libm::sqrt(self.covariance[(1, 1)]) } else { 0.0 }
    }

    /// Weight of a session in the level, from its variance and temperature.
    fn gain(&self, variance: f64, kelvin: f64) -> f64 {
        (self.covariance[(0, 0)] + self.covariance[(0, 1)] * kelvin) / (variance + self.between)
    }
}

impl<'a> Sessions<'a> {
    pub fn new(all: &'a [Estimate]) -> Self {
        let known = all.iter().all(|session| session.temperature_c.is_some());
        let sum: f64 = all.iter().filter_map(|session| session.temperature_c).sum();
        let slopes = known && all.len() >= SESSIONS_FOR_SLOPES;
        Self { all, slopes, reference_c: sum / all.len() as f64 }
    }

    /// Temperature of a session from the reference, K; 0 if no coefficients are estimated.
    fn kelvin(&self, session: &Estimate) -> f64 {
        match session.temperature_c {
            Some(celsius) if self.slopes => celsius - self.reference_c,
            _ => 0.0,
        }
    }

    /// Value of a parameter in each session, its variance there and the temperature from the
    /// reference.
    fn values(&self, parameter: Parameter) -> impl Iterator<Item = (f64, f64, f64)> {
        self.all.iter().map(move |session| {
            let terms = session.model.terms();
            let value = match parameter.index() {
                axis @ 0..3 => terms.bias_mps2[axis],
                place => terms.matrix[(place - 3) / 3][(place - 3) % 3],
            };
            let variance = session.covariance.get(parameter, parameter);
            let variance = variance.max(LEAST_SD * LEAST_SD);
            (value, variance, self.kelvin(session))
        })
    }

    /// Regression on temperature with the variance `between` sessions and the slope's prior.
    /// Equation (152).
    pub fn line(&self, parameter: Parameter, between: f64) -> Line {
        let prior_sd = slope_of(parameter).filter(|_| self.slopes).and_then(usual_sd);
        let prior = prior_sd.map_or(NO_SLOPE, |sd| 1.0 / (sd * sd));
        let row = |kelvin: f64| Vector2::new(1.0, kelvin);
        let mut information = Matrix2::from_diagonal(&Vector2::new(0.0, prior));
        let mut right = Vector2::zeros();
        for (value, variance, kelvin) in self.values(parameter) {
            let weighted = row(kelvin) / (variance + between);
            information += weighted * row(kelvin).transpose();
            right += weighted * value;
        }
        let covariance = information.try_inverse().unwrap_or_default();
        let at = covariance * right;
        let squares = self.values(parameter).map(|(value, variance, kelvin)| {
            let off = value - at.dot(&row(kelvin));
            off * off / (variance + between)
        });
        let residual = squares.sum();
        // Fraction by which the prior reduces the slope, 0..=1.
        let shrinkage = if prior < NO_SLOPE { prior * covariance[(1, 1)] } else { 1.0 };
        let dof = self.all.len() as f64 - 2.0 + shrinkage * shrinkage;
        Line { at, covariance, between, prior, residual, dof }
    }

    /// The fitted parameters of a group.
    fn of(&self, group: usize) -> impl Iterator<Item = Parameter> {
        let fitted = self.all.first().map(|session| session.fitted);
        let fitted = fitted.unwrap_or_default();
        fitted.iter().filter(move |p| group_of(*p) == group)
    }

    /// Sum of squared residuals of a group over its expectation, which falls with the variance
    /// between sessions, and the expectation.
    fn ratio(&self, group: usize, between: f64) -> (f64, f64) {
        let (mut residual, mut dof) = (0.0, 0.0);
        for parameter in self.of(group) {
            let line = self.line(parameter, between);
            residual += line.residual;
            dof += line.dof;
        }
        (residual / dof, dof)
    }

    /// The variance between sessions at which the ratio is `target`.
    fn variance_at(&self, group: usize, target: f64) -> f64 {
        let above = |between: f64| self.ratio(group, between).0 > target;
        let (mut low, mut high) = (0.0, LEAST_SD * LEAST_SD);
        if !above(0.0) {
            return 0.0;
        }
        for _ in 0..40 {
            if !above(high) {
                break;
            }
            (low, high) = (high, 4.0 * high);
        }
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            if above(middle) {
                low = middle;
            } else {
                high = middle;
            }
        }
        0.5 * (low + high)
    }

    /// Paule and Mandel's estimate. Equation (153).
    pub fn between(&self, group: usize) -> Between {
        let variance = self.variance_at(group, 1.0);
        Between { variance, dof: self.ratio(group, variance).1 }
    }

    /// Mean of what the variance between sessions can be, equation (154): with negligible variances within the sessions
    /// dof/(dof − 2) times the estimate.
    pub fn expected(&self, group: usize, found: Between) -> f64 {
        if found.dof < 1.0 {
            return 0.0;
        }
        self.variance_at(group, (found.dof - 2.0).max(1.0) / found.dof)
    }

    /// Covariance of the levels. Equation (155).
    pub fn covariance(&self, lines: &[Line; Parameter::COUNT]) -> Covariance {
        let mut sum = Covariance::ZERO;
        let Some(first) = self.all.first() else {
            return sum;
        };
        let fitted = first.fitted;
        for parameter in Parameters::ALL.without(fitted).iter() {
            sum.set(parameter, parameter, first.covariance.get(parameter, parameter));
        }
        for session in self.all {
            let gain = |p: Parameter| {
                let own = session.covariance.get(p, p).max(LEAST_SD * LEAST_SD);
                lines[p.index()].gain(own, self.kelvin(session))
            };
            for a in fitted.iter() {
                for b in fitted.iter() {
                    let own = session.covariance.get(a, b);
                    let between = if a == b { lines[a.index()].between } else { 0.0 };
                    sum.add(a, b, gain(a) * gain(b) * (own + between));
                }
            }
        }
        for parameter in fitted.iter() {
            let line = &lines[parameter.index()];
            let of_slope = line.covariance[(0, 1)];
            sum.add(parameter, parameter, of_slope * of_slope * line.prior);
        }
        sum
    }

    pub fn temperature(&self) -> Option<CalibratedTemperature> {
        let (mut lowest, mut highest) = (f64::INFINITY, f64::NEG_INFINITY);
        for session in self.all.iter() {
            let mean = session.temperature_c?;
            let [low, high] = session.temperature_range_c.unwrap_or([mean, mean]);
            (lowest, highest) = (lowest.min(low), highest.max(high));
        }
        Some(CalibratedTemperature {
            mean_c: self.reference_c as f32,
            lowest_c: lowest as f32,
            highest_c: highest as f32,
        })
    }
}
