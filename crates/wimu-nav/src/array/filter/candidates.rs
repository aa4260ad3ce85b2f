//! Hypotheses and what a sample makes of them: equation (97).

use super::super::hypothesis::{
    Candidate, Hypothesis, MEASURED, Noise, OMEGA, TURN, TURNING, View, WEIGHT_FREEDOM, r,
};
use super::super::solver::{Linear, Roots};
use super::{ArrayFilter, MOST};
use crate::Real;

/// Those that a sample may bring: each one's own, its opposite and all roots of the sample.
const CANDIDATES: usize = MOST * 6;
/// A hypothesis less likely than the best by this factor is given up, as a logarithm.
const GIVEN_UP: f64 = 20.0;
/// χ² from which on no hypothesis can be right, and how far ω may then be from what was thought, rad/s.
const LOST: f64 = 300.0;
const LOST_RATE_RAD_S: f64 = 20.0;

impl<R: Real, const M: usize> ArrayFilter<R, M> {
    /// Every hypothesis meets every root: equation (97).
    pub(super) fn update(&mut self, linear: &Linear<R>, noise: &Noise<R>) {
        let mut measured = [R::default(); MEASURED];
        measured[..3].copy_from_slice(&linear.theta[..3]);
        measured[3..].copy_from_slice(&linear.z);
        let mut candidates = self.candidates(linear, &measured, noise);
        let misfit = |all: &[Option<Candidate<R>>]| {
            let found = all.iter().flatten().map(|c| c.misfit);
            found.fold(f64::INFINITY, f64::min)
        };
        if misfit(&candidates) > LOST {
            // None of the histories can be right: every root is possible again.
            for hypothesis in self.hypotheses.iter_mut().flatten() {
                for i in 0..3 {
                    hypothesis.cov[OMEGA + i][OMEGA + i] += r(LOST_RATE_RAD_S * LOST_RATE_RAD_S);
                    hypothesis.cov[TURN + i][TURN + i] += r(self.activity + 1.0);
                }
            }
            candidates = self.candidates(linear, &measured, noise);
        }
        candidates.sort_unstable_by(|a, b| {
            let weight = |c: &Option<Candidate<R>>| c.map_or(f64::NEG_INFINITY, |c| c.weight);
            weight(b).total_cmp(&weight(a))
        });
        let Some(Some(best)) = candidates.first() else {
            return;
        };
        let least = best.weight - GIVEN_UP;
        let freedom = self.array.solver().rank() as f64 + 3.0;
        self.surprise = ((WEIGHT_FREEDOM + best.misfit) / (WEIGHT_FREEDOM + freedom)).max(1.0);
        let solver = self.array.solver();
        let before = self.hypotheses;
        self.hypotheses = [None; MOST];
        let mut slots = self.hypotheses.iter_mut();
        for candidate in candidates.iter().flatten().filter(|c| c.weight > least) {
            let Some(Some(parent)) = before.get(candidate.parent) else {
                continue;
            };
            if let Some(next) = parent.measured(solver, &measured, noise, candidate)
                && let Some(slot) = slots.next()
            {
                *slot = Some(next);
            }
        }
        if self.hypotheses[0].is_none() {
            self.hypotheses = before;
        }
    }

    /// What each hypothesis makes of a sample: its own, its opposite, and where the plane of an array
    /// mirrors them, the roots of the sample.
    fn candidates(
        &self,
        linear: &Linear<R>,
        measured: &[R; MEASURED],
        noise: &Noise<R>,
    ) -> [Option<Candidate<R>>; CANDIDATES] {
        let solver = self.array.solver();
        let mut roots = None;
        let mut candidates: [Option<Candidate<R>>; CANDIDATES] = [None; CANDIDATES];
        let mut count = 0;
        for (parent, hypothesis) in self.hypotheses.iter().enumerate() {
            let Some(hypothesis) = hypothesis else {
                continue;
            };
            let Some(view) = View::of(hypothesis, solver, noise) else {
                continue;
            };
            let mut put = |start: [R; TURNING]| {
                let found = view.refine(solver, measured, start)?;
                let candidate = Candidate {
                    parent,
                    turning: found.turning,
                    weight: hypothesis.weight + found.weight,
                    misfit: found.misfit,
                };
                let twin = candidates.iter_mut().flatten().find(|other| {
                    other.parent == parent && view.apart(&other.turning, &found.turning) < 0.01
                });
                if let Some(twin) = twin {
                    if candidate.weight > twin.weight {
                        *twin = candidate;
                    }
                } else if let Some(slot) = candidates.get_mut(count) {
                    *slot = Some(candidate);
                    count += 1;
                }
                Some(found.turning)
            };
            let mut start = put(view.mean).unwrap_or(view.mean);
            for w in start.iter_mut().take(3) {
                *w = -*w;
            }
            if !view.within_reach(&start) && solver.roots() == Roots::Two {
                continue;
            }
            put(start);
            let roots = roots.get_or_insert_with(|| solver.roots_of(linear));
            for root in roots.hypotheses() {
                start[..3].copy_from_slice(&root.rate_rad_s);
                if view.within_reach(&start) {
                    put(start);
                }
            }
        }
        candidates
    }

    /// Probabilities that add to 1, and hypotheses that have become the same as one.
    pub(super) fn merge(&mut self) {
        for i in 0..MOST {
            for j in i + 1..MOST {
                let (Some(a), Some(b)) = (self.hypotheses[i], self.hypotheses[j]) else {
                    continue;
                };
                if a.same(&b) {
                    self.hypotheses[i] = Some(a.joined(&b));
                    self.hypotheses[j] = None;
                }
            }
        }
        let weight = |h: &Option<Hypothesis<R>>| h.map_or(f64::NEG_INFINITY, |h| h.weight);
        self.hypotheses
            .sort_unstable_by(|a, b| weight(b).total_cmp(&weight(a)));
        let most = weight(&self.hypotheses[0]);
        for slot in &mut self.hypotheses {
            if weight(slot) < most - GIVEN_UP {
                *slot = None;
            }
        }
        let sum: f64 = self
            .hypotheses
            .iter()
            .flatten()
            .map(|h| libm::exp(h.weight - most))
            .sum();
        let total = most + libm::log(sum);
        for hypothesis in self.hypotheses.iter_mut().flatten() {
            hypothesis.weight -= total;
        }
    }
}
