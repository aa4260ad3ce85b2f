//! Several calibration sessions of one sensor: parameters with temperature coefficients, and the
//! standard deviation between sessions. Equations (151) to (155).

mod regression;

use alloc::format;

use wimu_model::{CalibratedTemperature, ErrorModel, ErrorTerms, ModelError, TemperatureTerms};

use crate::terms;
use crate::{Covariance, Estimate, Gravity, Parameter, Parameters, Reason, Refusal, Term, Terms};
use regression::{Sessions, slope_of};

/// Several sessions of one sensor, combined.
#[derive(Clone, Debug, PartialEq)]
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
    /// Standard deviation between sessions of the bias, m/s², the scale factors and the misalignments, rad, the best estimate.
    pub between_sd: [f64; 3],
    /// Degrees of freedom of `between_sd`; 0 of a group that was not fitted.
    pub dof: [f64; 3],
    /// Standard deviations of the temperature coefficients, in the order of [`Term::ALL`]; 0 where they were not estimated.
    pub term_sd: [[f64; 3]; Term::ALL.len()],
    /// Temperatures of the sessions, if all have one.
    pub temperature: Option<CalibratedTemperature>,
}

/// Parameters that have one standard deviation between sessions: 0 the bias, 1 the scale factors, 2 the misalignments.
fn group_of(parameter: Parameter) -> usize {
    match parameter.index() {
        0..3 => 0,
        3 | 7 | 11 => 1,
        _ => 2,
    }
}

/// Combines the sessions of one sensor, each fitted with the same method and with the mean of
/// `gravity` taken as exact. Each has its own parameters; `gravity` is common to all.
///
/// # Errors
/// [`Refusal`] names the session that does not go with the first.
pub fn combine(estimates: &[Estimate], gravity: Gravity) -> Result<Combined, Refusal> {
    check(estimates)?;
    let sessions = Sessions::new(estimates);
    let found = [0, 1, 2].map(|group| sessions.between(group));
    // The covariance is that of the mean of what τ² can be.
    let expected = [0, 1, 2].map(|group| sessions.expected(group, found[group]));
    let lines = Parameter::ALL.map(|p| sessions.line(p, expected[group_of(p)]));
    let best = Parameter::ALL.map(|p| sessions.line(p, found[group_of(p)].variance));

    let mut theta = terms::theta_of(&estimates[0].model);
    let mut term_sd = [[0.0; 3]; Term::ALL.len()];
    for parameter in estimates[0].fitted.iter() {
        let i = parameter.index();
        theta[i] = best[i].at[0];
        if let Some((slope, term)) = slope_of(parameter).and_then(|at| Some((at, terms::term(at)?)))
        {
            let unit = if i < 3 { 1.0 } else { best[i].at[0] };
            theta[slope] = best[i].at[1] / unit;
            term_sd[term as usize][slope % 3] = lines[i].slope_sd() / unit;
        }
    }
    let model = model(&theta, &sessions)
        .map_err(|error| Refusal::out_of_bounds(error, "an accelerometer"))?;
    let mut covariance = sessions.covariance(&lines);
    for parameter in estimates[0].fitted.iter() {
        let between = expected[group_of(parameter)];
        covariance.add(parameter, parameter, between);
    }
    covariance.add_gravity(&theta, gravity);
    Ok(Combined {
        model,
        fitted: estimates[0].fitted,
        covariance,
        between_sd: found.map(|between| libm::sqrt(between.variance)),
        dof: found.map(|between| between.dof),
        term_sd,
        temperature: sessions.temperature(),
    })
}

fn check(estimates: &[Estimate]) -> Result<(), Refusal> {
    let [first, _, ..] = estimates else {
        let have = estimates.len();
        let text = format!("{have} of at least 2 sessions. Record one more.");
        return Err(Refusal::new(Reason::TooFew { have, need: 2 }, text));
    };
    for (session, estimate) in estimates.iter().enumerate() {
        let allowed = [Terms::NONE, Terms::NONE.with(Term::Drift)];
        let sound = |p: Parameter| estimate.covariance.sd(p).is_finite();
        let why = if estimate.fitted != first.fitted || estimate.method != first.method {
            "has another method or model than session 0: fit all with one"
        } else if !allowed.contains(&estimate.terms) {
            "has temperature or quadratic terms: fit the sessions without them"
        } else if estimate.gravity.sd_mps2() > 0.0 || estimate.gravity != first.gravity {
            "was not fitted with the exact gravity of session 0"
        } else if !Parameter::ALL.into_iter().all(sound) {
            "has values that are not finite"
        } else {
            continue;
        };
        let text = format!("Session {session} {why}.");
        return Err(Refusal::new(Reason::Input { index: session }, text));
    }
    Ok(())
}

fn model(theta: &terms::Theta, sessions: &Sessions<'_>) -> Result<ErrorModel, ModelError> {
    ErrorModel::new(ErrorTerms {
        bias_mps2: terms::bias(theta),
        matrix: terms::matrix(theta),
        temperature: if sessions.slopes {
            TemperatureTerms {
                reference_c: sessions.reference_c,
                bias_mps2_per_k: terms::triple(theta, 15),
                bias_mps2_per_k2: [0.0; 3],
                scale_per_k: terms::triple(theta, 18),
            }
        } else {
            TemperatureTerms::default()
        },
        nonlinearity: [0.0; 3],
    })
}
