//! Several calibration sessions of one sensor: parameters with temperature coefficients, and the
//! standard deviation between sessions. Equations (151) to (155).

use core::fmt;
use core::mem::discriminant;

use wimu_model::{CalibratedTemperature, ErrorModel, ErrorTerms, ModelError, TemperatureTerms};

use crate::estimate::TermDeviations;
use crate::terms::{self, Slot};
use crate::{Covariance, Estimate, Gravity, Parameter, Parameters, Term, Terms, student};

/// Sessions from which on temperature coefficients are estimated.
const SESSIONS_FOR_SLOPES: usize = 3;
/// Smallest standard deviation of a parameter within a session, its unit: noiseless data.
const LEAST_SD: f64 = 1e-8;
/// Probability that the session that departs most of those without a fault reaches the limit.
const FALSE_ALARM: f64 = 0.0027;

/// Several sessions of one sensor, combined.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Combined {
    /// The error model, with temperature coefficients if they were estimated.
    pub model: ErrorModel,
    /// Which of the 12 parameters were fitted.
    pub fitted: Parameters,
    /// Covariance of the parameters of a new session at the reference temperature: that of the
    /// mean and that between sessions, including the uncertainty of both and of gravity. 1.96
    /// standard deviations are a 95 % interval.
    pub covariance: Covariance,
    /// Standard deviation within a session, rms over the sessions, of each [`Group`].
    pub within_sd: [f64; 3],
    /// Standard deviation between sessions of each [`Group`], the best estimate.
    pub between_sd: [f64; 3],
    /// Degrees of freedom of `between_sd`; 0 of a group that was not fitted.
    pub dof: [f64; 3],
    /// Standard deviations of the temperature coefficients; 0 where they were not estimated.
    pub slope_sd: TermDeviations,
    /// Temperatures of the sessions, if all have one.
    pub temperature: Option<CalibratedTemperature>,
    /// The session that departs most from the others, with three or more sessions.
    pub worst: Option<Departure>,
}

/// Parameters that have one standard deviation between sessions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Group {
    /// The bias, m/s².
    Bias,
    /// The scale factors.
    Scale,
    /// The misalignments, rad.
    Misalignment,
}

impl Group {
    /// All groups, in the order of [`Combined::between_sd`].
    pub const ALL: [Self; 3] = [Self::Bias, Self::Scale, Self::Misalignment];

    fn of(parameter: Parameter) -> Self {
        match parameter.index() {
            0..3 => Self::Bias,
            3 | 7 | 11 => Self::Scale,
            _ => Self::Misalignment,
        }
    }
}

/// A session that departs from the others.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Departure {
    /// Its index.
    pub session: usize,
    /// The parameter that departs.
    pub parameter: Parameter,
    /// Difference to its prediction by the other sessions, in standard deviations.
    pub sigmas: f64,
    /// Student's limit, which the worst of sessions without a fault exceeds in 0.27 % of
    /// calibrations.
    pub limit: f64,
}

/// Why sessions cannot be combined.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum CombineRefusal {
    /// Fewer than two sessions.
    TooFew {
        /// Number of sessions.
        have: usize,
    },
    /// A session has another method or other fitted parameters than the first.
    Different {
        /// Its index.
        session: usize,
    },
    /// A session has temperature or quadratic terms.
    Terms {
        /// Its index.
        session: usize,
    },
    /// A session was not fitted with the same exact gravity (standard deviation 0).
    Gravity {
        /// Its index.
        session: usize,
    },
    /// A value of a session is not a finite number.
    NotFinite {
        /// Its index.
        session: usize,
    },
    /// The result is out of bounds.
    Model(ModelError),
}

impl fmt::Display for CombineRefusal {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooFew { have } => {
                write!(
                    out,
                    "{have} of at least 2 sessions: record one more session"
                )
            }
            Self::Different { session } => write!(
                out,
                "session {session} has another method or model than session 0: fit all with one"
            ),
            Self::Terms { session } => write!(
                out,
                "session {session} has temperature or quadratic terms: fit the sessions without \
                 them"
            ),
            Self::Gravity { session } => write!(
                out,
                "session {session} was not fitted with the exact gravity of session 0"
            ),
            Self::NotFinite { session } => {
                write!(out, "session {session} has values that are not finite")
            }
            Self::Model(error) => write!(out, "the combined model is out of bounds: {error}"),
        }
    }
}

impl core::error::Error for CombineRefusal {}

/// Combines the sessions of one sensor, each fitted with the same method and with the mean of
/// `gravity` taken as exact. Each has its own parameters; `gravity` is common to all.
///
/// # Errors
/// [`CombineRefusal`] names the session that does not go with the first.
pub fn combine(estimates: &[Estimate], gravity: Gravity) -> Result<Combined, CombineRefusal> {
    check(estimates)?;
    let sessions = Sessions::new(estimates, None);
    let found = Group::ALL.map(|group| sessions.between(group));
    // The covariance is that of the mean of what τ² can be.
    let expected = found.map(|between| sessions.expected(&between));
    let lines = Parameter::ALL.map(|p| sessions.line(p, expected[Group::of(p) as usize]));
    let best = Parameter::ALL.map(|p| sessions.line(p, found[Group::of(p) as usize].variance));

    let mut theta = terms::theta_of(&estimates[0].model);
    let mut slope_sd = TermDeviations::default();
    for parameter in estimates[0].fitted.iter() {
        let i = parameter.index();
        theta[i] = best[i].level;
        if let Some(slot) = slope_of(parameter) {
            let unit = if i < 3 { 1.0 } else { best[i].level };
            theta[slot.index()] = best[i].slope / unit;
            slope_sd.set(slot, libm::sqrt(lines[i].slope_variance) / unit);
        }
    }
    let model = model(&theta, &sessions).map_err(CombineRefusal::Model)?;
    let mut covariance = sessions.covariance(&lines);
    for parameter in estimates[0].fitted.iter() {
        let between = expected[Group::of(parameter) as usize];
        covariance.add(parameter, parameter, between);
    }
    covariance.add_gravity(&theta, gravity);
    Ok(Combined {
        model,
        fitted: estimates[0].fitted,
        covariance,
        within_sd: Group::ALL.map(|group| sessions.within_sd(group)),
        between_sd: found.map(|between| libm::sqrt(between.variance)),
        dof: found.map(|between| between.dof),
        slope_sd,
        temperature: sessions.temperature(),
        worst: departure(estimates),
    })
}

fn check(estimates: &[Estimate]) -> Result<(), CombineRefusal> {
    let first = match estimates {
        [first, _, ..] => first,
        _ => {
            return Err(CombineRefusal::TooFew {
                have: estimates.len(),
            });
        }
    };
    for (session, estimate) in estimates.iter().enumerate() {
        let allowed = [Terms::NONE, Terms::NONE.with(Term::Drift)];
        let sound = |p: Parameter| estimate.covariance.sd(p).is_finite();
        if estimate.fitted != first.fitted
            || discriminant(&estimate.method) != discriminant(&first.method)
        {
            return Err(CombineRefusal::Different { session });
        } else if !allowed.contains(&estimate.terms) {
            return Err(CombineRefusal::Terms { session });
        } else if estimate.gravity.sd_mps2() > 0.0 || estimate.gravity != first.gravity {
            return Err(CombineRefusal::Gravity { session });
        } else if !Parameter::ALL.into_iter().all(sound) {
            return Err(CombineRefusal::NotFinite { session });
        }
    }
    Ok(())
}

fn model(theta: &terms::Theta<f64>, sessions: &Sessions<'_>) -> Result<ErrorModel, ModelError> {
    ErrorModel::new(ErrorTerms {
        bias_mps2: terms::bias(theta),
        matrix: terms::matrix(theta),
        temperature: match sessions.slopes {
            false => TemperatureTerms::default(),
            true => TemperatureTerms {
                reference_c: sessions.reference_c,
                bias_mps2_per_k: terms::triple(theta, 15),
                bias_mps2_per_k2: [0.0; 3],
                scale_per_k: terms::triple(theta, 18),
            },
        },
        nonlinearity: [0.0; 3],
    })
}

/// The temperature coefficient of a bias or scale factor.
fn slope_of(parameter: Parameter) -> Option<Slot> {
    let pairs = Parameter::BIAS.into_iter().chain(Parameter::SCALE);
    let mut pairs = pairs.zip(Slot::ALL.into_iter().skip(15));
    pairs.find(|(of, _)| *of == parameter).map(|pair| pair.1)
}

/// The session whose difference to the prediction by the others is the largest share of its limit.
fn departure(estimates: &[Estimate]) -> Option<Departure> {
    let mut worst: Option<Departure> = None;
    let fitted = estimates.first()?.fitted;
    let tests = (estimates.len() * fitted.iter().count()) as f64;
    if estimates.len() < 3 {
        return None;
    }
    for (session, estimate) in estimates.iter().enumerate() {
        let others = Sessions::new(estimates, Some(session));
        let found = Group::ALL.map(|group| others.between(group));
        let theta = terms::theta_of(&estimate.model);
        let dt = others.kelvin(estimate);
        for parameter in fitted.iter() {
            let between = found[Group::of(parameter) as usize];
            let line = others.line(parameter, between.variance);
            let own = estimate.covariance.get(parameter, parameter) + between.variance;
            let sd = libm::sqrt(line.variance(dt) + own.max(LEAST_SD * LEAST_SD));
            let off = theta[parameter.index()] - line.level - line.slope * dt;
            let departs = Departure {
                session,
                parameter,
                sigmas: libm::fabs(off) / sd,
                limit: student::two_sided(FALSE_ALARM / tests, between.dof),
            };
            let share = |d: &Departure| d.sigmas / d.limit;
            if between.dof >= 1.0
                && worst
                    .as_ref()
                    .is_none_or(|before| share(&departs) > share(before))
            {
                worst = Some(departs);
            }
        }
    }
    worst
}

/// Sessions, perhaps without one of them.
struct Sessions<'a> {
    all: &'a [Estimate],
    skipped: Option<usize>,
    /// Whether temperature coefficients are estimated.
    slopes: bool,
    /// Mean temperature, °C.
    reference_c: f64,
}

/// Variance between sessions.
#[derive(Clone, Copy)]
struct Between {
    group: Group,
    variance: f64,
    dof: f64,
    /// [`Line::shrinkage`] of each parameter.
    shrinkage: [f64; Parameter::COUNT],
}

/// One parameter as a function of temperature.
#[derive(Clone, Copy)]
struct Line {
    /// At the reference temperature, and its change per K.
    level: f64,
    slope: f64,
    slope_variance: f64,
    /// Sum of the weights, and the weighted mean temperature from the reference, K.
    weight: f64,
    mean_k: f64,
    /// Variance between sessions.
    between: f64,
    /// Precision of the slope's prior; infinite if it is 0.
    prior: f64,
    /// Fraction by which the prior reduces the slope, 0..=1.
    shrinkage: f64,
    /// Weighted sum of squared residuals, and its expectation.
    residual: f64,
    dof: f64,
}

impl Line {
    /// Variance at a temperature.
    fn variance(&self, dt: f64) -> f64 {
        let from_mean = dt - self.mean_k;
        1.0 / self.weight + from_mean * from_mean * self.slope_variance
    }
}

impl<'a> Sessions<'a> {
    fn new(all: &'a [Estimate], skipped: Option<usize>) -> Self {
        let known = all.iter().all(|session| session.temperature_c.is_some());
        let mut sessions = Self {
            all,
            skipped,
            slopes: known && all.len() >= SESSIONS_FOR_SLOPES,
            reference_c: 0.0,
        };
        let sum: f64 = sessions.iter().filter_map(|s| s.temperature_c).sum();
        sessions.reference_c = sum / sessions.iter().count() as f64;
        sessions
    }

    fn iter(&self) -> impl Iterator<Item = &'a Estimate> {
        let skipped = self.skipped;
        let all = self.all.iter().enumerate();
        all.filter(move |(k, _)| Some(*k) != skipped)
            .map(|pair| pair.1)
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
        self.iter().map(move |session| {
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
    fn line(&self, parameter: Parameter, between: f64) -> Line {
        self.line_with(parameter, between, None)
    }

    /// The same with a given shrinkage of the slope instead of its prior.
    fn line_with(&self, parameter: Parameter, between: f64, shrinkage: Option<f64>) -> Line {
        let prior_sd = slope_of(parameter).filter(|_| self.slopes);
        let prior_sd = prior_sd.and_then(Slot::usual_sd);
        let mut prior = prior_sd.map_or(f64::INFINITY, |sd| 1.0 / (sd * sd));
        let (mut count, mut weight, mut mean, mut mean_k) = (0.0, 0.0, 0.0, 0.0);
        for (value, variance, dt) in self.values(parameter) {
            let w = 1.0 / (variance + between);
            count += 1.0;
            weight += w;
            mean += w * value;
            mean_k += w * dt;
        }
        (mean, mean_k) = (mean / weight, mean_k / weight);
        let (mut square, mut product) = (0.0, 0.0);
        for (value, variance, dt) in self.values(parameter) {
            let w = 1.0 / (variance + between);
            square += w * (dt - mean_k) * (dt - mean_k);
            product += w * (dt - mean_k) * value;
        }
        if let Some(fraction) = shrinkage.filter(|_| prior.is_finite()) {
            prior = square * fraction / (1.0 - fraction).max(f64::MIN_POSITIVE);
        }
        let slope_variance = 1.0 / (square + prior);
        let slope = product * slope_variance;
        let mut residual = 0.0;
        for (value, variance, dt) in self.values(parameter) {
            let off = value - mean - slope * (dt - mean_k);
            residual += off * off / (variance + between);
        }
        let shrinkage = match prior.is_finite() {
            true => prior * slope_variance,
            false => 1.0,
        };
        Line {
            level: mean - slope * mean_k,
            slope,
            slope_variance,
            weight,
            mean_k,
            between,
            prior,
            shrinkage,
            residual,
            dof: count - 2.0 + shrinkage * shrinkage,
        }
    }

    /// The fitted parameters of a group.
    fn of(&self, group: Group) -> impl Iterator<Item = Parameter> {
        let fitted = self.all.first().map(|session| session.fitted);
        let fitted = fitted.unwrap_or_default();
        fitted.iter().filter(move |p| Group::of(*p) == group)
    }

    /// Sum of squared residuals of a group over its expectation, which falls with the variance
    /// between sessions, and the expectation; with the shrinkages of `fixed`, if given.
    fn ratio(&self, group: Group, between: f64, fixed: Option<&Between>) -> (f64, f64) {
        let (mut residual, mut dof) = (0.0, 0.0);
        for parameter in self.of(group) {
            let shrinkage = fixed.map(|found| found.shrinkage[parameter.index()]);
            let line = self.line_with(parameter, between, shrinkage);
            residual += line.residual;
            dof += line.dof;
        }
        (residual / dof, dof)
    }

    /// The variance between sessions at which the ratio is `target`.
    fn variance_at(&self, group: Group, target: f64, fixed: Option<&Between>) -> f64 {
        let above = |between: f64| self.ratio(group, between, fixed).0 > target;
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
    fn between(&self, group: Group) -> Between {
        let variance = self.variance_at(group, 1.0, None);
        let mut shrinkage = [1.0; Parameter::COUNT];
        for parameter in self.of(group) {
            shrinkage[parameter.index()] = self.line(parameter, variance).shrinkage;
        }
        let (_, dof) = self.ratio(group, variance, None);
        Between {
            group,
            variance,
            dof,
            shrinkage,
        }
    }

    /// Mean of the variance between sessions over its confidence distribution, equation (154): with
    /// negligible variances within the sessions dof/(dof − 2) times the estimate.
    fn expected(&self, found: &Between) -> f64 {
        const NODES: usize = 32;
        if found.dof < 1.0 {
            return 0.0;
        }
        // Over χ, the root of χ², whose density is smooth at 0.
        let end = libm::sqrt(found.dof) + 5.0;
        let (mut sum, mut weights) = (0.0, 0.0);
        for k in 0..NODES {
            let chi = end * (k as f64 + 0.5) / NODES as f64;
            let density = libm::pow(chi, found.dof - 1.0) * libm::exp(-0.5 * chi * chi);
            let target = chi * chi / found.dof;
            sum += density * self.variance_at(found.group, target, Some(found));
            weights += density;
        }
        sum / weights
    }

    /// Covariance of the levels. Equation (155).
    fn covariance(&self, lines: &[Line; Parameter::COUNT]) -> Covariance {
        let mut sum = Covariance::ZERO;
        let Some(first) = self.all.first() else {
            return sum;
        };
        let fitted = first.fitted;
        for parameter in Parameters::ALL.without(fitted).iter() {
            sum.set(
                parameter,
                parameter,
                first.covariance.get(parameter, parameter),
            );
        }
        for session in self.iter() {
            let dt = self.kelvin(session);
            let gain = |p: Parameter| {
                let line = &lines[p.index()];
                let own = session.covariance.get(p, p).max(LEAST_SD * LEAST_SD);
                let slope = line.slope_variance * (dt - line.mean_k);
                (1.0 / line.weight - line.mean_k * slope) / (own + line.between)
            };
            for a in fitted.iter() {
                for b in fitted.iter() {
                    let own = session.covariance.get(a, b);
                    let between = if a == b {
                        lines[a.index()].between
                    } else {
                        0.0
                    };
                    sum.add(a, b, gain(a) * gain(b) * (own + between));
                }
            }
        }
        for parameter in fitted.iter() {
            let line = &lines[parameter.index()];
            if line.prior.is_finite() {
                let off = line.mean_k * line.slope_variance;
                sum.add(parameter, parameter, off * off * line.prior);
            }
        }
        sum
    }

    /// Standard deviation within a session, rms over sessions and parameters.
    fn within_sd(&self, group: Group) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for parameter in self.of(group) {
            for (_, variance, _) in self.values(parameter) {
                sum += variance;
                count += 1.0;
            }
        }
        libm::sqrt(sum / f64::max(count, 1.0))
    }

    fn temperature(&self) -> Option<CalibratedTemperature> {
        let (mut lowest, mut highest) = (f64::INFINITY, f64::NEG_INFINITY);
        for session in self.iter() {
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
