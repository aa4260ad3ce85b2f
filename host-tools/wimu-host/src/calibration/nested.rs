//! Nested models beside an estimate: what its residuals show of the sensor, in one list of hypotheses.

use statrs::distribution::{ContinuousCDF, FisherSnedecor};
use wimu_calib::{
    Estimate, Gravity, MultiPosition, Nested, Pose, Term, Terms, TestedPose, Unexplained,
    multi_position,
};
use wimu_model::{CalibrationMethod, STANDARD_GRAVITY_MPS2 as G};

use super::report::AXES;
use crate::{Code, Problem};

/// Fewest poses before and after a step.
const MIN_SIDE: usize = 3;
/// Largest number of times at which a step is tested.
const MAX_TIMES: usize = 100;
/// Smallest residual that is tested, m/s²: of data without noise, the rounding is not a drift.
const FLOOR_MPS2: f64 = 1e-4;

/// Steps of the linearised estimate of a change that no fit explains yet.
const ROUNDS: usize = 3;
/// Least evidence of a change against a single bad pose: difference of the Bayesian information criterion, odds of 20 to 1.
const EVIDENCE: f64 = 6.0;
/// Fewest degrees of freedom of a fit that is offered instead of a refused one: with fewer any poses fit.
const MIN_REDUNDANCY: usize = 3;
/// Option of `--model`, terms, and effect.
const EFFECTS: [(&str, &[Term], &str); 3] = [
    (
        "temperature",
        &[Term::BiasTemperature, Term::ScaleTemperature],
        "the bias may depend on temperature",
    ),
    ("drift", &[Term::Drift], "the bias may have drifted"),
    ("quadratic", &[Term::Quadratic], "the output may not be linear"),
];

/// What may have changed, or is missing in the model.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    /// Of the bias, with this time constant as a fraction of the session.
    Drift(f64),
    Temperature,
    Quadratic,
    /// At one time, of an axis.
    Step(Step, usize),
}

#[derive(Clone, Copy, PartialEq)]
enum Step {
    Bias,
    Gain,
    /// Of the bias and of the misalignments, as a changed sign appears.
    Sign,
}

/// A hypothesis: terms that the model lacks.
struct Hypothesis {
    kind: Kind,
    /// Probability of a finding in a session without the effect: a cold start is more frequent than the others.
    false_alarm: f64,
    terms: usize,
    /// Terms of the model with which it is not tested.
    unless: Option<Term>,
}

const fn bias(kind: Kind, false_alarm: f64, unless: Option<Term>) -> Hypothesis {
    Hypothesis { kind, false_alarm, terms: 3, unless }
}

const SESSION: [Hypothesis; 4] = [
    bias(Kind::Drift(0.3), 0.003, None),
    bias(Kind::Drift(f64::INFINITY), 0.003, None),
    bias(Kind::Temperature, 0.001, Some(Term::BiasTemperature)),
    bias(Kind::Quadratic, 0.0005, Some(Term::Quadratic)),
];
/// The false alarms are those over all times and axes.
const STEPS: [(Step, f64, usize); 3] =
    [(Step::Bias, 0.0007, 1), (Step::Gain, 0.0007, 1), (Step::Sign, 0.0007, 3)];

impl Kind {
    /// Derivative of |f| by a term, at a pose before or after (`late`) the time of a step.
    fn derivative(self, pose: &TestedPose, late: bool, term: usize) -> f64 {
        let (up, late) = (pose.up, f64::from(u8::from(late)));
        match self {
            Self::Drift(f64::INFINITY) => up[term] * pose.progress,
            Self::Drift(constant) => up[term] * (1.0 - (-pose.progress / constant).exp()),
            Self::Temperature => up[term] * pose.warmer_k,
            Self::Quadratic => G * G * up[term].powi(3),
            Self::Step(Step::Gain, axis) => G * up[axis] * up[axis] * late,
            Self::Step(_, axis) if term == 0 => up[axis] * late,
            Self::Step(_, axis) => G * up[axis] * up[(axis + term) % 3] * late,
        }
    }

    /// What is found and what to do; `size` is the largest term, `fitted` the terms of the model.
    fn problem(self, size: f64, fitted: Terms) -> Problem {
        let step = |text: String| {
            Code::Step.warning(format!("{text} between two poses")).remedy(
                "calibrate the poses before and after it separately; check the mounting and the driver",
            )
        };
        let (mm, percent) = (size * 1e3, size * 1e2);
        match self {
            Self::Drift(_) if fitted.contains(Term::Drift) => Code::Drift
                .warning("the bias drift was not linear, as during warm-up: the bias at the end exceeds its interval")
                .remedy("record again when the sensor is warm, or with its temperature and --model auto+temperature"),
            Self::Drift(_) => Code::Drift
                .warning(format!("the bias drifted by {:.0} mm/s²", mm.abs()))
                .remedy("use --model 9+drift, or record again when the sensor is warm"),
            Self::Temperature => Code::Temperature
                .warning(format!("the bias changed with temperature by {:.2} mm/s² per K", mm.abs()))
                .remedy("use --model 9+temperature"),
            Self::Quadratic => Code::Residuals
                .warning(format!("the output is not linear: quadratic term {size:.1e} s²/m"))
                .remedy("use --model 9+quadratic"),
            Self::Step(Step::Bias, k) => {
                step(format!("the bias of {} changed by {mm:+.0} mm/s²", AXES[k]))
            }
            Self::Step(Step::Gain, k) => {
                step(format!("the scale factor of {} changed by {percent:+.1} %", AXES[k]))
            }
            Self::Step(Step::Sign, k) => step(format!("the sign of {} changed", AXES[k])),
        }
    }
}

/// A significant hypothesis.
#[derive(Clone, Copy)]
struct Found {
    kind: Kind,
    /// Index, in the order of time, of the first pose after a step.
    after: usize,
    /// The largest term, of a step the first.
    size: f64,
    /// Bayesian information criterion; lower is better.
    score: f64,
}

/// The most likely of the significant hypotheses. `refit` is the fit of other poses; `since_start_s` the time of a pose, s
/// since the start of the data.
pub(super) fn finding(
    poses: &[Pose],
    estimate: &Estimate,
    refit: impl Fn(&[Pose]) -> Option<Estimate>,
    since_start_s: impl Fn(&Pose) -> f64,
) -> Option<Problem> {
    if estimate.method != CalibrationMethod::MultiPosition {
        return None;
    }
    let tested = |all: bool| {
        let unexplained = Unexplained::new(poses, estimate, all)?;
        Some((likeliest(&unexplained, estimate.terms)?, unexplained))
    };
    let rejected = estimate.rejected.len();
    // A step may have caused the rejection of the poses beyond it.
    let (mut found, unexplained) =
        tested(rejected == 0).or_else(|| tested(true).filter(|_| rejected >= MIN_SIDE))?;
    let rows = unexplained.poses();
    if let Kind::Step(Step::Bias | Step::Sign, axis) = found.kind {
        found.kind = Kind::Step(Step::Bias, axis);
        let change = Change { step: Step::Sign, axis, first_s: rows[found.after].time_s };
        let is_better = refit(&change.undone(poses, 0.0, 0.0)).is_some_and(|fit| {
            let squares = fit.fitted_rms_mps2.powi(2) * fit.poses as f64;
            fit.rejected.len() <= rejected && score(squares, rows.len(), 1) < found.score
        });
        if is_better {
            found.kind = Kind::Step(Step::Sign, axis);
        }
    }
    let ends = match found.kind {
        Kind::Step(..) => [found.after - 1, found.after],
        _ => [0, rows.len() - 1],
    };
    let [from_s, to_s] = ends.map(|k| since_start_s(&poses[rows[k].index]));
    Some(found.kind.problem(found.size, estimate.terms).between(from_s, to_s))
}

/// Why poses contradict each other, and what to do: the change of the sensor with which they fit. `None` where none does,
/// or leaving out a single pose explains them about as well.
pub(super) fn contradiction(
    poses: &[Pose],
    gravity: Gravity,
    model: MultiPosition,
) -> Option<String> {
    let (given, count) = (poses, poses.len());
    let mut poses = given.to_vec();
    poses.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    // Of means without times, the order of their rows is that of time.
    if poses.iter().all(|pose| pose.time_s == given[0].time_s) {
        poses.iter_mut().zip(0_u32..).for_each(|(pose, k)| pose.time_s = f64::from(k));
    }
    let model = MultiPosition { reject: false, ..model };
    let fit = |poses: &[Pose]| multi_position(poses, gravity, model).ok();
    let of_fit = |fit: &Estimate, parameters: usize| {
        score(fit.fitted_rms_mps2.powi(2) * fit.poses as f64, count, parameters)
    };
    // The place of a pose or step is a parameter too.
    let without = |k: usize| fit(&[&poses[..k], &poses[k + 1..]].concat());
    let of_pose = (0..count).filter_map(without).map(|fit| of_fit(&fit, 2)).reduce(f64::min);
    let mut found = Vec::new();
    for (option, terms, effect) in EFFECTS {
        let terms = model.terms.iter().chain(terms.iter().copied()).collect();
        let more = MultiPosition { terms, ..model };
        let Ok(fit) = multi_position(given, gravity, more) else { continue };
        if terms != model.terms && fit.dof >= MIN_REDUNDANCY {
            let base = if model.priors { "auto" } else { "9" };
            let text = format!("{effect}: --model {base}+{option} fits these poses");
            found.push((of_fit(&fit, terms.parameters()), text));
        }
    }
    for after in times(count) {
        for (step, axis) in STEPS.iter().flat_map(|(step, ..)| (0..3).map(move |k| (*step, k))) {
            let change = Change { step, axis, first_s: poses[after].time_s };
            let Some((size, fit)) = change.fitted(&poses, gravity, fit) else { continue };
            let Problem { text, remedy, .. } = Kind::Step(step, axis).problem(size, model.terms);
            let text = format!("{text}, {} and {after} (from 0): {remedy}", after - 1);
            found.push((of_fit(&fit, if step == Step::Sign { 1 } else { 2 }), text));
        }
    }
    let (score, text) = found.into_iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
    let is_clear = of_pose.is_none_or(|of_pose| score + EVIDENCE < of_pose);
    is_clear.then(|| format!("The poses contradict each other: {text}."))
}

/// A step of an axis before the pose of this time.
#[derive(Clone, Copy)]
struct Change {
    step: Step,
    axis: usize,
    first_s: f64,
}

impl Change {
    /// Its size, and the fit of the poses without it.
    fn fitted(
        self,
        poses: &[Pose],
        gravity: Gravity,
        fit: impl Fn(&[Pose]) -> Option<Estimate>,
    ) -> Option<(f64, Estimate)> {
        if self.step == Step::Sign {
            return Some((0.0, fit(&self.undone(poses, 0.0, 0.0))?));
        }
        let kind = Kind::Step(self.step, self.axis);
        // From a perfect sensor and with equal weights: the poses have no fit yet.
        let mut estimate = Estimate::default();
        (estimate.gravity, estimate.pose_sd_mps2) = (gravity, 1.0);
        let (mut size, mut undone) = (0.0, poses.to_vec());
        for _ in 0..ROUNDS {
            let unexplained = Unexplained::new(&undone, &estimate, true)?;
            let late = |pose: &TestedPose| pose.time_s >= self.first_s;
            let nested = unexplained.with(1, |pose, _| kind.derivative(pose, late(pose), 0))?;
            size += nested.size[0];
            undone = self.undone(poses, size, estimate.model.terms().bias_mps2[self.axis]);
            estimate = fit(&undone)?;
        }
        Some((size, estimate))
    }

    fn undone(self, poses: &[Pose], size: f64, bias_mps2: f64) -> Vec<Pose> {
        let mut undone = poses.to_vec();
        for pose in undone.iter_mut().filter(|pose| pose.time_s >= self.first_s) {
            let value = &mut pose.mean_mps2[self.axis];
            *value = match self.step {
                Step::Bias => *value - size,
                Step::Gain => bias_mps2 + (*value - bias_mps2) / (1.0 + size),
                Step::Sign => -*value,
            };
        }
        undone
    }
}

/// Indices of the poses before which a step is tested.
fn times(count: usize) -> impl Iterator<Item = usize> + Clone {
    (MIN_SIDE..=count.saturating_sub(MIN_SIDE)).step_by(count.div_ceil(MAX_TIMES).max(1))
}

fn likeliest(unexplained: &Unexplained, fitted: Terms) -> Option<Found> {
    let count = unexplained.poses().len();
    let mut found = Vec::new();
    let of_session = SESSION.iter().filter(|h| !h.unless.is_some_and(|term| fitted.contains(term)));
    for hypothesis in of_session {
        found.extend(test(unexplained, hypothesis, 0));
    }
    let times = times(count);
    let tests = (3 * times.clone().count().max(1)) as f64;
    for after in times {
        for axis in 0..3 {
            for (step, false_alarm, terms) in STEPS {
                let (kind, false_alarm) = (Kind::Step(step, axis), false_alarm / tests);
                let hypothesis = Hypothesis { kind, false_alarm, terms, unless: None };
                found.extend(test(unexplained, &hypothesis, after));
            }
        }
    }
    found.into_iter().min_by(|a, b| a.score.total_cmp(&b.score))
}

/// The hypothesis, of a step before pose `after`, if chance explains the residuals with a probability below its false alarm.
fn test(unexplained: &Unexplained, hypothesis: &Hypothesis, after: usize) -> Option<Found> {
    let &Hypothesis { kind, false_alarm, terms, .. } = hypothesis;
    let first_s = unexplained.poses().get(after)?.time_s;
    let nested = unexplained
        .with(terms, |pose, term| kind.derivative(pose, pose.time_s >= first_s, term))?;
    let is_step = matches!(kind, Kind::Step(..));
    // The many hypotheses of a step need the scatter that sensors have. It would hide the drift of those with less.
    let probability = if is_step {
        probability(&nested.clone().with_usual_scatter(), 0.0)
    } else {
        probability(&nested, FLOOR_MPS2)
    };
    let largest = |a: f64, b: &f64| if b.abs() > a.abs() { *b } else { a };
    (probability? < false_alarm).then(|| Found {
        kind,
        after,
        size: if is_step { nested.size[0] } else { nested.size.iter().fold(0.0, largest) },
        score: score(nested.squares[1], unexplained.poses().len(), terms + usize::from(is_step)),
    })
}

/// Probability that the statistic is exceeded without the terms.
fn probability(nested: &Nested, floor_mps2: f64) -> Option<f64> {
    let [terms, rest] = nested.dof.map(|dof| dof as f64);
    let fisher = FisherSnedecor::new(terms, rest).ok()?;
    Some(fisher.sf(nested.statistic(floor_mps2)))
}

/// Bayesian information criterion of `parameters` beyond the fitted ones that leave `squares`, (m/s²)², in `count` poses.
fn score(squares: f64, count: usize, parameters: usize) -> f64 {
    let scatter =
        Nested { size: Vec::new(), squares: [0.0, squares], dof: [0, count] }.with_usual_scatter();
    scatter.dof[1] as f64 * scatter.squares[1].ln() + parameters as f64 * (count as f64).ln()
}
