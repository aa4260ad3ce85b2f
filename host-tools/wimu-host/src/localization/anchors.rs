//! Anchors that are not where their file has them: of two the positions may be exchanged, or one may stand elsewhere. Each is a
//! hypothesis about the same ranges. Equation (173).

use nalgebra::Vector3;

use super::hypotheses::choose;
use super::model::Model;
use super::ranging::Ranging;
use super::run::Recording;
use super::scales::MOST;
use crate::{Code, Problem};

/// Standard deviations of a component of the anchor's position in successive rounds, m: the size of a room first, then what
/// the linearisation of the round before leaves.
const ROUNDS_M: [f64; 3] = [3.0, 1.0, 0.3];

/// Anchors of which every two are tried as exchanged: those that explain most if they are moved.
const EXCHANGED: usize = 12;

/// An error of the file of anchors.
#[derive(Clone, Copy, Debug)]
pub(super) enum Misplaced {
    /// Two anchors, by their indices, have each other's position.
    Exchanged([usize; 2]),
    /// An anchor, by its index, is elsewhere.
    Moved(usize),
}

/// Anchors without an error, and the likelihood of the ranges then.
struct Judged {
    log_likelihood: f64,
    error: Misplaced,
    ranging: Ranging,
}

impl Misplaced {
    /// The error that explains the first ranges best, with the anchors as they are then. Of two exchanged anchors either
    /// explains much if it is moved.
    pub fn search(problem: &Recording, model: &Model) -> Option<(Self, Ranging)> {
        let ranges = &problem.ranges[..problem.ranges.len().min(MOST)];
        let part = Recording { ranges, ..*problem };
        let moved = |index| Some((index, Self::Moved(index).judged(&part, model)?));
        let mut moved: Vec<(usize, Judged)> =
            (0..problem.ranging.anchors.len()).filter_map(moved).collect();
        moved.sort_by(|(_, a), (_, b)| b.log_likelihood.total_cmp(&a.log_likelihood));
        let likely: Vec<usize> = moved.iter().take(EXCHANGED).map(|(index, _)| *index).collect();
        let pairs = likely.iter().enumerate();
        let pairs = pairs.flat_map(|(k, b)| likely[..k].iter().map(|a| [*a, *b]));
        let exchanged = pairs.filter_map(|pair| Self::Exchanged(pair).judged(&part, model));
        let found = moved.into_iter().map(|(_, judged)| judged).chain(exchanged);
        let best = found.max_by(|a, b| a.log_likelihood.total_cmp(&b.log_likelihood))?;
        Some((best.error, best.ranging))
    }

    /// The anchors without this error, and how well they explain the ranges.
    fn judged(self, problem: &Recording, model: &Model) -> Option<Judged> {
        let until_s = problem.ranges.last()?.time_s + model.shift_s.max(0.0);
        let mut ranging = problem.ranging.clone();
        match self {
            Self::Exchanged([a, b]) => ranging.exchange(a, b),
            Self::Moved(index) => {
                for sd_m in ROUNDS_M {
                    ranging.surveyed = Some((index, sd_m));
                    let part = Recording { ranging: &ranging, ..*problem };
                    let start = choose(&part, model)?.start;
                    let navigator = part.navigated(model, &start, until_s, None);
                    let anchors = navigator.anchors.as_ref()?.estimates(navigator.core.filter());
                    ranging.anchors[index].position_m = anchors[index].position_m.into();
                }
                ranging.surveyed = None;
            }
        }
        let part = Recording { ranging: &ranging, ..*problem };
        let start = choose(&part, model)?.start;
        let log_likelihood = part.log_likelihood(model, &start, until_s);
        Some(Judged { log_likelihood, error: self, ranging })
    }

    /// What is said of it, where the ranges show it.
    pub fn finding(self, given: &Ranging, found: &Ranging) -> Problem {
        let name = |index: usize| &given.anchors[index].id;
        let (text, remedy) = match self {
            Self::Exchanged([a, b]) => {
                let text = format!(
                    "the ranges fit when the positions of anchors {} and {} are exchanged: used so",
                    name(a),
                    name(b)
                );
                (text, "see which is where, and correct the file of anchors")
            }
            Self::Moved(index) => {
                let [from, to] = [given, found].map(|r| Vector3::from(r.anchors[index].position_m));
                let text = format!(
                    "the ranges place anchor {} at E {:.2} N {:.2} U {:.2} m, {:.2} m from where the file has it: used there",
                    name(index),
                    to.x,
                    to.y,
                    to.z,
                    (to - from).norm()
                );
                (text, "measure its position again, and correct the file of anchors")
            }
        };
        Code::Residuals.warning(text).remedy(remedy)
    }
}
