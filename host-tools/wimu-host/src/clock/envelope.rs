//! Fit of the lines that bound the delays: equations (60) to (63).

mod edge;
mod transfer;

use std::cmp::Ordering;

pub(super) use edge::MAX_RATE;
use edge::{Edge, edges, rate_width, tops};
use transfer::{CLASSES, KINDS, keep_least_of};
pub(super) use transfer::{Class, Folded, LINKS, Transfer};

/// Smallest mean delay, ns.
const LEAST_MEAN_NS: f64 = 1000.0;
/// Number of the least delayed transfers of a kind and block that are kept, and of the most delayed ones.
const KEPT: usize = 128;
/// Largest difference of two rates of one clock, standard deviations.
const MAX_DEVIATIONS: f64 = 3.0;
/// Number of slopes at which the likelihood is summed.
const SLOPES: usize = 41;

/// Estimate of the clocks' difference at `x`: means and variances.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    /// Slope, ns/s, and its variance.
    pub rate: f64,
    pub rate_variance: f64,
    /// Difference at `x` by exchanges over the link with the narrowest bounds, if both directions take
    /// equally long: equation (62); else by the fastest transfer. ns.
    pub middle: f64,
    pub middle_variance: f64,
    /// Covariance of slope and middle.
    pub covariance: f64,
    /// Certain bounds of the clocks' difference at `x`, given the slope, ns.
    pub lower: Option<f64>,
    pub upper: Option<f64>,
}

impl Folded {
    /// Keeps only transfers that can be close to the edges of the delays, at the slope of all transfers and at that of
    /// their direction, so that a contradiction between the directions is preserved.
    #[must_use]
    pub fn reduced(mut self) -> Self {
        let middle = 0.5 * (self.span.0 + self.span.1);
        let rate = fit(&[&self], middle, None).map_or(0.0, |fit| fit.rate);
        let (edges, tops) = (edges(&[&self], middle), tops(&[&self], middle));
        let shown = |link, questions| {
            direction(&edges, &tops, link, questions).map_or(rate, |(rate, _)| rate)
        };
        let of_link = |link| [false, true].map(|questions| shown(link, questions));
        let own: [_; LINKS] = std::array::from_fn(of_link);
        for cell in &mut self.cells {
            if let Some(first) = cell.hull.first() {
                let own = own[first.link][usize::from(first.class.is_question())];
                let slopes = [rate, own].map(|rate| first.class.sign() * rate);
                keep_least_of(&mut cell.least, slopes, KEPT);
                keep_least_of(&mut cell.most, slopes.map(|slope| -slope), KEPT);
            }
            // Blocks are kept for minutes.
            cell.hull.shrink_to_fit();
            cell.least.shrink_to_fit();
            cell.most.shrink_to_fit();
        }
        self
    }
}

/// The estimate at `x` from the transfers of `blocks`, with the slope `given`, if there is one; `None`
/// without transfers.
pub(super) fn fit(blocks: &[&Folded], x: f64, given: Option<f64>) -> Option<Fit> {
    let mut edges = edges(blocks, x);
    if edges.is_empty() {
        return None;
    }
    let mut tops = tops(blocks, x);
    let summed = match given {
        Some(rate) => {
            edges.iter_mut().for_each(|edge| edge.narrow(rate));
            tops.clear();
            vec![Terms::new(&edges, &tops, rate)]
        }
        None => posterior(&mut edges, &mut tops)?,
    };
    let (rate, rate_variance) = moments(&summed, |term| (term.rate, 0.0))?;
    let (lower, upper) = bounds(&edges, rate);
    let link = best_link(&edges, rate);
    let of = |term: &Terms| term.centre(link?);
    let (middle, middle_variance, covariance) = if summed.iter().all(|term| of(term).is_some()) {
        let of = |term: &Terms| of(term).unwrap_or_default();
        let (middle, variance) = moments(&summed, of)?;
        let (_, sum) = moments(&summed, |term| {
            let (mean, variance) = of(term);
            (mean + term.rate * SCALE, variance)
        })?;
        let both = sum - variance - rate_variance * SCALE * SCALE;
        (middle, variance, 0.5 * both / SCALE)
    } else {
        let least = |term: &Terms| term.fastest(&edges);
        let (mean, variance) = moments(&summed, least)?;
        let touched = upper.unwrap_or(mean);
        (touched, variance + (touched - mean).powi(2), 0.0)
    };
    let mut fit = Fit { rate, rate_variance, middle, middle_variance, covariance, lower, upper };
    if let (None, Some(excess)) = (given, contradiction(&edges, &tops)) {
        let (first, last) = (blocks.first()?.span.0, blocks.last()?.span.1);
        fit.admit(excess, &mut edges, last - first);
    }
    Some(fit)
}

impl Fit {
    /// Increases the variances for a link whose least delay has changed: equation (63a).
    fn admit(&mut self, contradiction: Contradiction, edges: &mut [Edge], span: f64) {
        self.rate += contradiction.share * (contradiction.middle - self.rate);
        edges.iter_mut().for_each(|edge| edge.narrow(self.rate));
        let terms = Terms::new(edges, &[], self.rate);
        if let Some((middle, _)) = best_link(edges, self.rate).and_then(|link| terms.centre(link)) {
            self.middle = middle;
        }
        (self.lower, self.upper) = bounds(edges, self.rate);
        self.rate_variance += contradiction.excess;
        self.middle_variance += contradiction.excess * (0.25 * span).powi(2);
        self.covariance = 0.0;
    }
}

/// Excess of the difference of the rates from both directions of a link.
#[derive(Clone, Copy, Debug)]
struct Contradiction {
    /// Their mean.
    middle: f64,
    /// The square of half their difference, less that expected by chance.
    excess: f64,
    /// Fraction of their squared difference that is not chance.
    share: f64,
}

/// The smallest contradiction of the directions, if there is one on every link.
fn contradiction(edges: &[Edge], tops: &[Edge]) -> Option<Contradiction> {
    let mut least: Option<Contradiction> = None;
    for link in 0..LINKS {
        let by = |questions| direction(edges, tops, link, questions);
        let (Some(here), Some(there)) = (by(false), by(true)) else {
            continue;
        };
        let square = (here.0 - there.0).powi(2);
        let excess = square - MAX_DEVIATIONS * MAX_DEVIATIONS * (here.1 + there.1);
        if excess <= 0.0 {
            return None;
        }
        if least.is_none_or(|least| 0.25 * excess < least.excess) {
            least = Some(Contradiction {
                middle: 0.5 * (here.0 + there.0),
                excess: 0.25 * excess,
                share: excess / square,
            });
        }
    }
    least
}

/// The slope from one direction of a link, and its variance.
fn direction(edges: &[Edge], tops: &[Edge], link: usize, questions: bool) -> Option<(f64, f64)> {
    let of = |all: &[Edge]| -> Vec<Edge> {
        let own = |edge: &&Edge| {
            edge.link == link && edge.class.is_question() == questions && edge.class.shows_rate()
        };
        all.iter().filter(own).cloned().collect()
    };
    let (mut edges, mut tops) = (of(edges), of(tops));
    if edges.is_empty() {
        return None;
    }
    let summed = posterior(&mut edges, &mut tops)?;
    moments(&summed, |term| (term.rate, 0.0))
}

/// The likelihood over the slopes, from the transfers that are least delayed at them.
fn posterior(edges: &mut [Edge], tops: &mut [Edge]) -> Option<Vec<Terms>> {
    let mut rate = likeliest_rate(edges);
    let mut summed = Vec::new();
    // The least delayed transfers depend on the slope.
    for _ in 0..6 {
        let all = edges.iter_mut().chain(&mut *tops);
        all.for_each(|edge| edge.narrow(rate));
        summed = slopes(edges, tops, rate)?;
        let (mean, variance) = moments(&summed, |term| (term.rate, 0.0))?;
        let moved = (mean - rate).abs();
        rate = mean.clamp(-MAX_RATE, MAX_RATE);
        if moved < 0.5 * variance.sqrt() {
            break;
        }
    }
    Some(summed)
}

/// The likelihood over the slopes around `centre`, over a range adapted to its width.
fn slopes(edges: &[Edge], tops: &[Edge], mut centre: f64) -> Option<Vec<Terms>> {
    let mut half = rate_width(edges).min(rate_width(tops)).max(1e-3);
    let mut summed = Vec::new();
    for _ in 0..16 {
        let step = half / (SLOPES / 2) as f64;
        summed = (0..SLOPES)
            .map(|k| Terms::new(edges, tops, centre + step * (k as f64 - (SLOPES / 2) as f64)))
            .collect();
        let (mean, variance) = moments(&summed, |term| (term.rate, 0.0))?;
        let sd = variance.sqrt();
        if (4.0..9.0).contains(&(half / sd)) && (mean - centre).abs() < sd {
            break;
        }
        centre = mean.clamp(-MAX_RATE, MAX_RATE);
        half = (6.0 * sd).clamp(half / 8.0, half * 2.5).max(1e-6);
    }
    Some(summed)
}

/// Scale of a slope, ns/s, relative to a difference, ns: s.
const SCALE: f64 = 100.0;

/// Mean and variance, over all slopes, of a quantity with a mean and a variance at each.
fn moments(terms: &[Terms], of: impl Fn(&Terms) -> (f64, f64)) -> Option<(f64, f64)> {
    let most = terms.iter().map(|term| term.log_likelihood).reduce(f64::max)?;
    let weight = |term: &Terms| (term.log_likelihood - most).exp();
    let all: f64 = terms.iter().map(weight).sum();
    let mean = terms.iter().map(|term| weight(term) * of(term).0).sum::<f64>() / all;
    let variance = terms
        .iter()
        .map(|term| {
            let (value, variance) = of(term);
            weight(term) * ((value - mean).powi(2) + variance)
        })
        .sum::<f64>()
        / all;
    mean.is_finite().then_some((mean, variance))
}

/// Results at the slope `rate`.
struct Terms {
    rate: f64,
    log_likelihood: f64,
    /// Mean and variance of the least delay of each kind.
    floors: [Option<(f64, f64)>; KINDS],
}

impl Terms {
    fn new(edges: &[Edge], tops: &[Edge], rate: f64) -> Self {
        let mut terms = Self { rate, log_likelihood: 0.0, floors: [None; KINDS] };
        for edge in edges {
            if edge.least.is_empty() {
                continue;
            }
            // Neither a request nor its answer has a negative delay.
            let is_other = |other: &&Edge| {
                other.link == edge.link && other.class.is_question() != edge.class.is_question()
            };
            let others = edges.iter().filter(is_other);
            let least = others.fold(f64::INFINITY, |least, other| least.min(other.floor(rate).0));
            let floor = edge.floor(rate).0;
            let room = floor + least;
            let (log, mean, variance) = edge.likelihood(rate, room);
            if edge.shows_rate() {
                terms.log_likelihood += log;
            }
            // The least delay of a line that is always busy is unknown.
            let found = if edge.is_seen() || !room.is_finite() {
                (mean, variance)
            } else {
                (floor - 0.5 * room, room * room / 12.0)
            };
            terms.floors[edge.kind()] = Some(found);
        }
        for top in tops {
            terms.log_likelihood += top.likelihood(rate, f64::INFINITY).0;
        }
        terms
    }

    fn floor(&self, link: usize, class: Class) -> Option<(f64, f64)> {
        self.floors[CLASSES * link + class as usize]
    }

    /// The clocks' difference by exchanges over `link`, with its variance.
    fn centre(&self, link: usize) -> Option<(f64, f64)> {
        let (answer, answer_variance) = self.floor(link, Class::Answer)?;
        let questions = [Class::Question, Class::OtherQuestion];
        let questions = questions.into_iter().filter_map(|class| self.floor(link, class));
        let (question, variance) = questions.min_by(|a, b| a.1.total_cmp(&b.1))?;
        Some((0.5 * (answer - question), 0.25 * (answer_variance + variance)))
    }

    /// The same by the fastest transfer, with a delay of zero.
    fn fastest(&self, edges: &[Edge]) -> (f64, f64) {
        let to_host = edges.iter().filter(|edge| !edge.class.is_question());
        let floors = to_host.filter_map(|edge| self.floor(edge.link, edge.class));
        floors.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, 0.0))
    }
}

/// Strict bounds of the clocks' difference by the transfers selected by `of`.
fn bounds_by(edges: &[Edge], rate: f64, of: impl Fn(&Edge) -> bool) -> (Option<f64>, Option<f64>) {
    let bound = |questions: bool| {
        let chosen = edges.iter().filter(|edge| of(edge) && edge.class.is_question() == questions);
        chosen.map(|edge| edge.floor(rate).0).reduce(f64::min)
    };
    (bound(true).map(|bound| -bound), bound(false))
}

fn bounds(edges: &[Edge], rate: f64) -> (Option<f64>, Option<f64>) {
    bounds_by(edges, rate, |_| true)
}

/// The link with the narrowest bounds.
fn best_link(edges: &[Edge], rate: f64) -> Option<usize> {
    let width = |link: &usize| {
        let (lower, upper) = bounds_by(edges, rate, |edge| edge.link == *link);
        Some(upper? - lower?)
    };
    (0..LINKS)
        .filter(|link| width(link).is_some())
        .min_by(|a, b| width(a).partial_cmp(&width(b)).unwrap_or(Ordering::Equal))
}

/// Derivative of the likelihood of exponential delays by the slope; it falls as the slope grows.
fn gradient(edges: &[(f64, &Edge)], rate: f64) -> f64 {
    edges
        .iter()
        .map(|(weight, edge)| {
            let touched = edge.floor(rate).1.x;
            weight * edge.sign * (edge.sum_x - edge.count * touched)
        })
        .sum()
}

/// The slope of greatest likelihood for exponential delays: equation (61).
fn likeliest_rate(edges: &[Edge]) -> f64 {
    let solve = |edges: &[(f64, &Edge)]| {
        let (mut low, mut high) = (-MAX_RATE, MAX_RATE);
        for _ in 0..48 {
            let middle = 0.5 * (low + high);
            if gradient(edges, middle) > 0.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        0.5 * (low + high)
    };
    let steady = edges.iter().filter(|edge| edge.class.shows_rate());
    let mut weighted: Vec<_> = steady.map(|edge| (1.0, edge)).collect();
    let mut rate = solve(&weighted);
    if weighted.len() > 1 {
        // The mean delays depend on the slope.
        for _ in 0..3 {
            for (weight, edge) in &mut weighted {
                let mean = (edge.sum_v - edge.sign * rate * edge.sum_x) / edge.count;
                *weight = 1.0 / (mean - edge.floor(rate).0).max(LEAST_MEAN_NS);
            }
            rate = solve(&weighted);
        }
    }
    rate
}
