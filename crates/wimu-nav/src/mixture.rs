//! Mixture of Gaussians: at most `K` weighted filters, where one Gaussian does not hold what is known. Examples: the sign of
//! an angular rate of which only the square is measured, a range with or without line of sight. Equations (140) to (142).
//!
//! Weights are products of likelihoods; components that agree are merged, and the mean of all is reported, both by their
//! first two moments (Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation",
//! 2001, sections 1.4.16 and 11.6; H. A. P. Blom and Y. Bar-Shalom, "The interacting multiple model algorithm for systems
//! with Markovian switching coefficients", IEEE Trans. Autom. Control 33, 1988).

use heapless::Vec;

use crate::filter::{Filter, Gate, Innovation};
use crate::sensor::Measurement;
use crate::state::Block;

/// Components below this fraction of the most probable one are removed, as a logarithm.
const PRUNED: f64 = -20.0;
/// Most candidates of one update.
const CANDIDATES: usize = 24;

/// A filter with the logarithm of its probability.
#[derive(Clone, Debug)]
pub struct Component {
    /// Logarithm of the probability.
    pub log_weight: f64,
    /// State and covariance under this hypothesis.
    pub filter: Filter,
}

/// At most `K` filters with their probabilities, the most probable first. There is always one.
#[derive(Clone, Debug)]
pub struct Mixture<const K: usize> {
    components: Vec<Component, K>,
}

/// A measurement under one hypothesis of one component.
struct Candidate<Z> {
    parent: usize,
    measurement: Z,
    log_weight: f64,
    innovation: Option<Innovation>,
}

impl<const K: usize> Mixture<K> {
    /// One filter, with probability 1.
    pub fn new(filter: Filter) -> Self {
        const { assert!(K >= 1, "a mixture needs a component") };
        let mut components = Vec::new();
        let log_weight = 0.0;
        let _ = components.push(Component { log_weight, filter });
        Self { components }
    }

    /// The components, the most probable first.
    pub fn components(&self) -> &[Component] {
        &self.components
    }

    /// The filters, for predictions, and updates that do not distinguish between them.
    pub fn filters_mut(&mut self) -> impl Iterator<Item = &mut Filter> {
        self.components.iter_mut().map(|c| &mut c.filter)
    }

    /// Probability of the most probable component.
    pub fn certainty(&self) -> f64 {
        self.components.first().map_or(1.0, |best| libm::exp(best.log_weight))
    }

    /// Update with a measurement whose model is ambiguous. `propose` calls its second argument with each model that may hold
    /// for a component: linearised at each root, or with and without line of sight. Each model makes a component of its
    /// own; the `K` most probable remain. Likelihoods are those of Student's t with `freedom` degrees of freedom, so that an
    /// outlier does not decide (M. Roth, E. Özkan, F. Gustafsson, "A Student's t filter for heavy tailed process and
    /// measurement noise", ICASSP 2013).
    ///
    /// Returns the innovation of the most probable one. It is not accepted, and the mixture unchanged, where its statistic
    /// exceeds `limit`. `None`: no model was proposed, or none had a finite likelihood.
    pub fn update<Z: Measurement>(
        &mut self,
        freedom: f64,
        limit: f64,
        mut propose: impl FnMut(&Filter, &mut dyn FnMut(Z)),
    ) -> Option<Innovation> {
        let mut candidates: Vec<Candidate<Z>, CANDIDATES> = Vec::new();
        for (parent, component) in self.components.iter().enumerate() {
            propose(&component.filter, &mut |measurement| {
                let _ = candidates.push(Candidate {
                    parent,
                    measurement,
                    log_weight: component.log_weight,
                    innovation: None,
                });
            });
        }
        if let ([component], [only]) = (&mut *self.components, &*candidates) {
            let within = |i: &Innovation| i.statistic <= limit;
            let innovation = component.filter.update_if(&only.measurement, within);
            return Some(innovation).filter(|i| i.statistic.is_finite());
        }
        self.weigh(&mut candidates, freedom);
        let mut best = candidates.first()?.innovation?;
        best.accepted = best.statistic <= limit;
        if !best.accepted {
            return Some(best);
        }
        let mut children: Vec<Component, K> = Vec::new();
        for candidate in &candidates {
            if let Some(parent) = self.components.get(candidate.parent) {
                let mut filter = parent.filter.clone();
                if filter.update(&candidate.measurement, Gate::Open).accepted {
                    let log_weight = candidate.log_weight;
                    let _ = children.push(Component { log_weight, filter });
                }
            }
        }
        if !children.is_empty() {
            self.components = children;
            self.normalise();
        }
        Some(best)
    }

    /// Likelihoods of the candidates, the greatest first; without those that are pruned.
    fn weigh<Z: Measurement>(&self, candidates: &mut Vec<Candidate<Z>, CANDIDATES>, freedom: f64) {
        for candidate in candidates.iter_mut() {
            if let Some(parent) = self.components.get(candidate.parent) {
                let innovation = parent.filter.test(&candidate.measurement);
                candidate.log_weight += robust(&innovation, freedom);
                candidate.innovation = Some(innovation);
            }
        }
        candidates.retain(|c| c.log_weight.is_finite());
        candidates.sort_unstable_by(|a, b| {
            let order = b.log_weight.partial_cmp(&a.log_weight);
            order.unwrap_or(core::cmp::Ordering::Equal)
        });
        if let Some(most) = candidates.first().map(|c| c.log_weight) {
            candidates.retain(|c| c.log_weight > most + PRUNED);
        }
        candidates.truncate(K);
    }

    /// Merges components whose states in a block differ by less than `distance` squared deviations.
    pub fn merge<const W: usize>(&mut self, block: Block<W>, distance: f64) {
        if self.components.len() < 2 {
            return;
        }
        let mut first = 0;
        while first < self.components.len() {
            let mut second = first + 1;
            while second < self.components.len() {
                let [a, b] = [&self.components[first], &self.components[second]];
                if a.filter.distance(&b.filter, block) < distance {
                    let merged = a.merged(b);
                    self.components[first] = merged;
                    self.components.swap_remove(second);
                } else {
                    second += 1;
                }
            }
            first += 1;
        }
        self.normalise();
    }

    /// One filter with the mean and the covariance of the mixture.
    pub fn moments(&self) -> Filter {
        let mut all = self.components[0].clone();
        for component in self.components.iter().skip(1) {
            all = all.merged(component);
        }
        all.filter
    }

    /// Update of every component with one measurement. Returns the innovation of the component that was the most probable.
    pub fn update_each(
        &mut self,
        freedom: f64,
        gate: Gate,
        measurement: &impl Measurement,
    ) -> Option<Innovation> {
        let mut best = None;
        for component in &mut self.components {
            let innovation = component.filter.update(measurement, gate);
            let likelihood = robust(&innovation, freedom);
            if likelihood.is_finite() {
                component.log_weight += likelihood;
            }
            best = best.or(Some(innovation));
        }
        self.normalise();
        best
    }

    /// Sorts, prunes, and makes the sum of the probabilities one.
    fn normalise(&mut self) {
        self.components.sort_unstable_by(|a, b| {
            let order = b.log_weight.partial_cmp(&a.log_weight);
            order.unwrap_or(core::cmp::Ordering::Equal)
        });
        let most = self.components[0].log_weight;
        let mut first = true;
        self.components.retain(|c| core::mem::take(&mut first) || c.log_weight >= most + PRUNED);
        let weights = self.components.iter().map(|c| libm::exp(c.log_weight - most));
        let total = most + libm::log(weights.fold(0.0, |sum, w| sum + w));
        for component in &mut self.components {
            component.log_weight -= total;
        }
    }
}

impl Component {
    /// Both with their mean and covariance.
    fn merged(&self, other: &Self) -> Self {
        let most = self.log_weight.max(other.log_weight);
        let [a, b] = [self, other].map(|c| libm::exp(c.log_weight - most));
        Self {
            log_weight: most + libm::log(a + b),
            filter: self.filter.moments(&other.filter, b / (a + b)),
        }
    }
}

/// Logarithm of Student's t density of an innovation, up to a constant.
fn robust(innovation: &Innovation, freedom: f64) -> f64 {
    let half = 0.5;
    let dof = innovation.dof as f64;
    let gaussian = innovation.log_likelihood + innovation.statistic * half;
    gaussian - (freedom + dof) * half * libm::log1p(innovation.statistic / freedom)
}
