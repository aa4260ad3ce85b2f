//! Anchors that are not where their file has them: of two the positions may be exchanged, or one may stand elsewhere. Each is a
//! hypothesis about the same ranges. Equation (173).

use nalgebra::Vector3;

use super::hypotheses::choose;
use super::model::Model;
use super::ranging::Ranging;
use super::run::Recording;
use crate::{Code, Problem};

/// Standard deviations of a component of the anchor's position in successive rounds, m: the size of a room first, then what
/// the linearisation of the round before leaves.
const ROUNDS_M: [f64; 3] = [3.0, 1.0, 0.3];

/// An error of the file of anchors.
#[derive(Clone, Copy, Debug)]
pub(super) enum Misplaced {
    /// Two anchors, by their indices, have each other's position.
    Exchanged([usize; 2]),
    /// An anchor, by its index, is elsewhere.
    Moved(usize),
}

impl Misplaced {
    /// The error that explains the ranges best, with the anchors as they are then.
    pub fn search(problem: &Recording, model: &Model) -> Option<(Self, Ranging)> {
        let count = problem.ranging.anchors.len();
        let pairs = (0..count).flat_map(|b| (0..b).map(move |a| Self::Exchanged([a, b])));
        let judged = pairs.chain((0..count).map(Self::Moved)).filter_map(|error| {
            let ranging = error.corrected(problem, model)?;
            let part = Recording { ranging: &ranging, ..*problem };
            let start = choose(&part, model)?.start;
            Some((part.log_likelihood(model, &start, f64::INFINITY), error, ranging))
        });
        let best = judged.max_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((best.1, best.2))
    }

    /// The anchors without this error.
    fn corrected(self, problem: &Recording, model: &Model) -> Option<Ranging> {
        let mut ranging = problem.ranging.clone();
        match self {
            Self::Exchanged([a, b]) => ranging.exchange(a, b),
            Self::Moved(index) => {
                for sd_m in ROUNDS_M {
                    ranging.surveyed = Some((index, sd_m));
                    let part = Recording { ranging: &ranging, ..*problem };
                    let start = choose(&part, model)?.start;
                    let anchors = part.run(model, &start, false).anchors;
                    ranging.anchors[index].position_m = anchors[index].position_m.into();
                }
                ranging.surveyed = None;
            }
        }
        Some(ranging)
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
