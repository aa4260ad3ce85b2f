//! The lines that bound delays: equations (60) to (63).

use std::cmp::Ordering;
use std::collections::HashSet;

/// Links that one clock is seen through.
pub(super) const LINKS: usize = 2;
const CLASSES: usize = 6;
const KINDS: usize = CLASSES * LINKS;
/// Mean delays below this are taken as this, ns.
const LEAST_MEAN_NS: f64 = 1000.0;
/// No oscillator is worse, ns/s.
pub(super) const MAX_RATE: f64 = 5e7;
/// The least delayed transfers of a kind and stretch that are kept, and the most delayed ones.
const KEPT: usize = 128;
/// Those of them that tell where the delays end; the share of all that they are, at most.
const EDGE: usize = 96;
/// Most transfers that a stall delays by more than the link does otherwise, and nothing held up.
const STRAYS: usize = 16;
/// Four times as many as an edge needs of them to tell a rate.
const LEAST_POINTS: usize = 4;
/// Transfers that nothing held up, without which no upper edge is looked for.
const LEAST_FREE: f64 = 64.0;
const EDGE_SHARE: f64 = 0.5;
/// The delays' edge is looked at no closer than this, ns: no host tells when bytes came better.
const LEAST_WINDOW_NS: f64 = 20_000.0;
/// How steeply the density of delays may rise from the least: as e^(α − 1).
const SHAPES: [f64; 6] = [1.0, 1.5, 2.0, 3.0, 4.0, 6.0];
/// Places of the least delay below the least seen, where its likelihood is summed up.
const DEPTHS: usize = 24;
/// The least delay is as likely anywhere down to so many times the time between two of the least ones
/// below them, and then the less the farther.
const NEAR_BELOW: f64 = 4.0;
/// How many transfers apart late ones may be for one reason.
const NEAR: u32 = 3;
/// Two rates of one clock may differ by so many standard deviations.
const CHANCE: f64 = 3.0;
/// Slopes at which the likelihood is summed up.
const SLOPES: usize = 41;

/// What is delayed. Transfers of a class take the same least time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Class {
    /// The first byte of a batch of raw samples.
    Raw,
    /// That of a batch of corrected samples: often waits for the raw batch before it.
    Corrected,
    /// That of an answer to a question.
    AnswerBegins,
    /// A whole answer: its two ends are the same delay twice, so that it tells no rate of its own.
    Answer,
    /// A host's whole question.
    Question,
    /// The same, of another length than before.
    OtherQuestion,
}

impl Class {
    /// Whether it goes to the device.
    fn is_question(self) -> bool {
        matches!(self, Self::Question | Self::OtherQuestion)
    }

    /// −1 towards the device: there the clocks' difference shortens what it lengthens here.
    pub(super) fn sign(self) -> f64 {
        if self.is_question() { -1.0 } else { 1.0 }
    }

    fn shows_rate(self) -> bool {
        self != Self::Answer
    }
}

/// One transfer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Transfer {
    /// Below [`LINKS`].
    pub link: usize,
    pub class: Class,
    /// Device time since the origin, s.
    pub x: f64,
    /// Sign · (host time − device time) since the origin, ns: the delay, and the clocks'
    /// difference.
    pub v: f64,
    /// The v from which on it came by itself. Below, it came right behind another: that one's
    /// delay has held it up, and it had less. Infinite if it was sent right behind another: then it went
    /// with that one, or waited for it, and tells nothing of its own but a bound.
    pub free_from: f64,
    /// Its number among those of its kind.
    pub index: u32,
}

impl Transfer {
    fn kind(&self) -> usize {
        CLASSES * self.link + self.class as usize
    }

    fn is_free(&self) -> bool {
        self.v >= self.free_from
    }

    fn is_own(&self) -> bool {
        self.free_from < f64::INFINITY
    }

    /// What it tells: when it came, or that it came before this.
    fn told(&self) -> f64 {
        self.v.max(self.free_from)
    }

    /// The latest as the earliest: with this the upper edge of the delays is a lower one.
    fn mirrored(&self) -> Self {
        Self {
            v: -self.v,
            free_from: f64::NEG_INFINITY,
            ..*self
        }
    }
}

/// Transfers of one kind: how many, the sums of their times and delays, those that can touch a line
/// from above; how many have delays of their own, and the least delayed of them; of those that nothing
/// held up, how many and the most delayed, mirrored.
#[derive(Clone, Debug, Default)]
struct Cell {
    count: f64,
    sum_x: f64,
    sum_v: f64,
    hull: Vec<Transfer>,
    own: f64,
    least: Vec<Transfer>,
    free: f64,
    most: Vec<Transfer>,
}

/// A stretch of transfers, by their kinds.
#[derive(Clone, Debug)]
pub(super) struct Folded {
    /// Times of the first and last transfer, s.
    pub span: (f64, f64),
    cells: [Cell; KINDS],
}

/// What is known of the clocks' difference about `x`: means, and how uncertain they are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    /// Slope, ns/s, and its variance.
    pub rate: f64,
    pub rate_variance: f64,
    /// Difference at `x` by exchanges over the link that bounds it best, if both directions take
    /// equally long: equation (62). Else by the fastest transfer. ns.
    pub middle: f64,
    pub middle_variance: f64,
    /// Of slope and middle.
    pub covariance: f64,
    /// Certain bounds of the clocks' difference at `x`, given the slope, ns.
    pub lower: Option<f64>,
    pub upper: Option<f64>,
}

impl Folded {
    /// Sorts `transfers`; `None` without any.
    pub fn new(transfers: &[Transfer]) -> Option<Self> {
        let first = transfers.first()?;
        let mut span = (first.x, first.x);
        for transfer in transfers {
            span = (span.0.min(transfer.x), span.1.max(transfer.x));
        }
        let mut cells: [Cell; KINDS] = Default::default();
        let mut before = [f64::NEG_INFINITY; KINDS];
        for transfer in transfers {
            let kind = transfer.kind();
            let cell = &mut cells[kind];
            let transfer = &Transfer {
                index: cell.count as u32,
                ..*transfer
            };
            cell.count += 1.0;
            cell.sum_x += transfer.x;
            cell.sum_v += transfer.v;
            cell.hull.push(*transfer);
            if transfer.is_own() {
                cell.own += 1.0;
                cell.least.push(*transfer);
            }
            if transfer.is_free() {
                cell.free += 1.0;
                if transfer.v > before[kind] && transfer.class.shows_rate() {
                    cell.most.push(transfer.mirrored());
                }
            }
            before[kind] = transfer.v;
        }
        for cell in &mut cells {
            cell.hull = hull(std::mem::take(&mut cell.hull));
        }
        Some(Self { span, cells })
    }

    /// Keeps only those that can come near the edges of the delays over the slope that they have, all
    /// together and those of their direction: where the directions contradict each other, they are to
    /// do so still.
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
        }
        self
    }

    /// Transfers kept.
    #[cfg(test)]
    pub fn points(&self) -> usize {
        self.cells
            .iter()
            .map(|cell| cell.hull.len() + cell.least.len())
            .sum()
    }
}

/// Keeps the `most` transfers that are delayed least over a line of this slope, in order.
fn keep_least(transfers: &mut Vec<Transfer>, slope: f64, most: usize) {
    let delay = |transfer: &Transfer| transfer.told() - slope * transfer.x;
    let order = |a: &Transfer, b: &Transfer| delay(a).total_cmp(&delay(b));
    if transfers.len() > most {
        transfers.select_nth_unstable_by(most, order);
        transfers.truncate(most);
    }
    transfers.sort_by(order);
}

/// Keeps those that are among the `most` over a line of one of these slopes.
fn keep_least_of(transfers: &mut Vec<Transfer>, slopes: [f64; 2], most: usize) {
    let [mut least, other] = slopes.map(|slope| {
        let mut least = transfers.clone();
        keep_least(&mut least, slope, most);
        least
    });
    let known: HashSet<u32> = least.iter().map(|transfer| transfer.index).collect();
    least.extend(other.iter().filter(|other| !known.contains(&other.index)));
    *transfers = least;
}

/// Puts `transfers` in order over this slope, and leaves out the first that are farther from the others
/// than these from each other: a link that stalled says nothing of how late it is otherwise.
fn drop_strays(transfers: &mut Vec<Transfer>, slope: f64) {
    let all = transfers.len();
    keep_least(transfers, slope, all);
    let delay = |index: usize| {
        let transfer: &Transfer = &transfers[index];
        transfer.v - slope * transfer.x
    };
    let pairs = 0..all.saturating_sub(STRAYS + 1).min(STRAYS);
    let stray = |index: &usize| {
        let next = delay(index + 1);
        next - delay(*index) > (delay(index + 1 + STRAYS) - next).max(LEAST_WINDOW_NS)
    };
    let strays = pairs.rev().find(stray).map_or(0, |index| index + 1);
    transfers.drain(..strays);
}

/// What the transfers of `blocks` tell about `x`; with the slope `given`, if there is one. `None`
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
    let mut fit = Fit {
        rate,
        rate_variance,
        middle,
        middle_variance,
        covariance,
        lower,
        upper,
    };
    if let (None, Some(apart)) = (given, contradiction(&edges, &tops)) {
        let (first, last) = (blocks.first()?.span.0, blocks.last()?.span.1);
        fit.admit(apart, &mut edges, last - first);
    }
    Some(fit)
}

impl Fit {
    /// Widens what is told of a link whose least delay has changed: equation (63a).
    fn admit(&mut self, apart: Apart, edges: &mut [Edge], span: f64) {
        self.rate += apart.share * (apart.middle - self.rate);
        edges.iter_mut().for_each(|edge| edge.narrow(self.rate));
        let terms = Terms::new(edges, &[], self.rate);
        if let Some((middle, _)) = best_link(edges, self.rate).and_then(|link| terms.centre(link)) {
            self.middle = middle;
        }
        (self.lower, self.upper) = bounds(edges, self.rate);
        self.rate_variance += apart.excess;
        self.middle_variance += apart.excess * (0.25 * span).powi(2);
        self.covariance = 0.0;
    }
}

/// By how much the rates that both directions of a link show differ more than they may.
#[derive(Clone, Copy, Debug)]
struct Apart {
    /// Their mean.
    middle: f64,
    /// The square of half their difference, less what chance makes.
    excess: f64,
    /// The part of their difference that is not chance.
    share: f64,
}

/// Whether on every link the directions contradict each other; then those of the link that does so
/// least.
fn contradiction(edges: &[Edge], tops: &[Edge]) -> Option<Apart> {
    let mut least: Option<Apart> = None;
    for link in 0..LINKS {
        let by = |questions| direction(edges, tops, link, questions);
        let (Some(here), Some(there)) = (by(false), by(true)) else {
            continue;
        };
        let square = (here.0 - there.0).powi(2);
        let excess = square - CHANCE * CHANCE * (here.1 + there.1);
        if excess <= 0.0 {
            return None;
        }
        if least.is_none_or(|least| 0.25 * excess < least.excess) {
            least = Some(Apart {
                middle: 0.5 * (here.0 + there.0),
                excess: 0.25 * excess,
                share: excess / square,
            });
        }
    }
    least
}

/// The slope that one direction of a link shows, and its variance.
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

/// The likelihood over the slopes, of the transfers that are least delayed about it.
fn posterior(edges: &mut [Edge], tops: &mut [Edge]) -> Option<Vec<Terms>> {
    let mut rate = likeliest_rate(edges);
    let mut summed = Vec::new();
    // Which delays are the least depends on the slope.
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

/// The likelihood over the slopes about `centre` where it is: neither much more nor less.
fn slopes(edges: &[Edge], tops: &[Edge], mut centre: f64) -> Option<Vec<Terms>> {
    let mut half = spread(edges).min(spread(tops)).max(1e-3);
    let mut summed = Vec::new();
    for _ in 0..16 {
        let step = half / (SLOPES / 2) as f64;
        summed = (0..SLOPES)
            .map(|k| {
                Terms::new(
                    edges,
                    tops,
                    centre + step * (k as f64 - (SLOPES / 2) as f64),
                )
            })
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

/// Makes a slope, ns/s, comparable with a difference, ns: s.
const SCALE: f64 = 100.0;

/// Mean and variance of what has at each slope a mean and a variance, over all slopes.
fn moments(terms: &[Terms], of: impl Fn(&Terms) -> (f64, f64)) -> Option<(f64, f64)> {
    let most = terms
        .iter()
        .map(|term| term.log_likelihood)
        .reduce(f64::max)?;
    let weight = |term: &Terms| (term.log_likelihood - most).exp();
    let all: f64 = terms.iter().map(weight).sum();
    let mean = terms
        .iter()
        .map(|term| weight(term) * of(term).0)
        .sum::<f64>()
        / all;
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

/// The transfers of a kind, at least one, times about the middle.
#[derive(Clone)]
struct Edge {
    link: usize,
    class: Class,
    /// Of the clocks' difference in v.
    sign: f64,
    count: f64,
    sum_x: f64,
    sum_v: f64,
    hull: Vec<Transfer>,
    /// Whether it is an upper edge, mirrored.
    is_top: bool,
    /// How many have delays of their own.
    own: f64,
    /// Those that may be near the line.
    candidates: Vec<Transfer>,
    /// Those nearest to it, and where they end: v of the end at x = 0, and its slope.
    least: Vec<Transfer>,
    end: (f64, f64),
    /// The part of them that are independent: late ones often come together.
    independent: f64,
}

fn edges(blocks: &[&Folded], x: f64) -> Vec<Edge> {
    let about = |transfer: &Transfer| Transfer {
        x: transfer.x - x,
        ..*transfer
    };
    let kind = |kind: usize| {
        let cells = || blocks.iter().map(|block| &block.cells[kind]);
        let hull: Vec<_> = cells().flat_map(|cell| &cell.hull).map(about).collect();
        let Transfer { link, class, .. } = *hull.first()?;
        Some(Edge {
            link,
            class,
            sign: class.sign(),
            count: cells().map(|cell| cell.count).sum(),
            sum_x: cells().map(|cell| cell.sum_x - cell.count * x).sum(),
            sum_v: cells().map(|cell| cell.sum_v).sum(),
            hull,
            is_top: false,
            own: cells().map(|cell| cell.own).sum(),
            candidates: cells().flat_map(|cell| &cell.least).map(about).collect(),
            least: Vec::new(),
            end: (0.0, 0.0),
            independent: 1.0,
        })
    };
    (0..KINDS).filter_map(kind).collect()
}

/// The upper edges of the delays, mirrored, of kinds that came often enough.
fn tops(blocks: &[&Folded], x: f64) -> Vec<Edge> {
    let about = |transfer: &Transfer| Transfer {
        x: transfer.x - x,
        ..*transfer
    };
    let kind = |kind: usize| {
        let cells = || blocks.iter().map(|block| &block.cells[kind]);
        let free: f64 = cells().map(|cell| cell.free).sum();
        let most: Vec<_> = cells().flat_map(|cell| &cell.most).map(about).collect();
        let Transfer { link, class, .. } = *most.first()?;
        (free >= LEAST_FREE).then(|| Edge {
            link,
            class,
            sign: -class.sign(),
            count: free,
            sum_x: 0.0,
            sum_v: 0.0,
            hull: hull(most.clone()),
            is_top: true,
            own: free,
            candidates: most,
            least: Vec::new(),
            end: (0.0, 0.0),
            independent: 1.0,
        })
    };
    (0..KINDS).filter_map(kind).collect()
}

impl Edge {
    /// Least delay above a line of slope `rate`, and the transfer that has it.
    fn floor(&self, rate: f64) -> (f64, &Transfer) {
        let slope = self.sign * rate;
        let mut least = (f64::INFINITY, &self.hull[0]);
        for point in &self.hull {
            let delay = point.v - slope * point.x;
            if delay < least.0 {
                least = (delay, point);
            }
        }
        least
    }

    /// Leaves the transfers that are delayed least over a line of slope `rate`, of an upper edge without
    /// its strays.
    fn narrow(&mut self, rate: f64) {
        let slope = self.sign * rate;
        let few = (self.own * EDGE_SHARE) as usize;
        let most = EDGE.min(few).max(1);
        self.least.clone_from(&self.candidates);
        if self.is_top {
            // Over another slope than their own they do not stand out.
            drop_strays(&mut self.least, slope);
            self.hull = hull(self.least.clone());
        }
        keep_least(&mut self.least, slope, most + 1);
        let delay = |point: &Transfer| point.told() - slope * point.x;
        let floor = self.floor(rate).0;
        let last = self.least.last().map_or(floor, delay);
        self.end = (last.max(floor + LEAST_WINDOW_NS), slope);
        if self.least.len() > most {
            self.least.pop();
        }
        self.independent = independent(&self.least, self.own);
    }

    /// Width of the window about its middle, ns.
    fn window(&self) -> f64 {
        self.end.0 - self.floor(self.sign * self.end.1).0
    }

    /// Whether it tells where the delays begin. What others held up says only that it had less delay than
    /// they: the more of that, the farther below the line may lie.
    fn is_seen(&self) -> bool {
        let free = self.least.iter().filter(|point| point.is_free()).count();
        4 * free >= self.least.len().max(LEAST_POINTS)
    }

    fn shows_rate(&self) -> bool {
        self.class.shows_rate() && self.is_seen()
    }

    /// The likelihood of slope `rate`, summed up over the places where the least delay may lie, `room`
    /// below the least seen at most, and how the delays rise from it: its logarithm; mean and variance of
    /// the place.
    fn likelihood(&self, rate: f64, room: f64) -> (f64, f64, f64) {
        let slope = self.sign * rate;
        let floor = self.floor(rate).0;
        let window = self.window();
        let count = self.least.iter().filter(|point| point.is_free()).count() as f64;
        let between = window / self.least.len() as f64;
        let near = NEAR_BELOW * between;
        // Equally far apart as logarithms.
        let nearest = 0.02 * between;
        let farthest = (6.0 * window).min(room).max(2.0 * nearest);
        let ratio = (farthest / nearest).powf(1.0 / (DEPTHS - 1) as f64);
        let mut depth = nearest;
        let mut found = [(0.0, 0.0); DEPTHS];
        for (index, found) in found.iter_mut().enumerate() {
            let place = floor - depth;
            let (mut delays, mut windows) = (LogProduct::default(), LogProduct::default());
            let mut free = LogProduct::default();
            for point in &self.least {
                let line = slope * point.x + place;
                let delay = point.told() - line;
                delays.times(delay);
                if point.is_free() {
                    free.times(delay);
                }
                let end = self.end.0 + self.end.1 * point.x;
                // A slope that is far out lets the line cross the window's end.
                windows.times((end - line).max(1.0));
            }
            let (delays, windows, free) = (delays.log(), windows.log(), free.log());
            let of = |shape: &f64| {
                let log = count * shape.ln() + shape * (delays - windows) - free;
                self.independent * log
            };
            let all = log_sum(SHAPES.iter().map(of));
            // The nearest stands for all that is nearer, too.
            let width = if index == 0 {
                depth
            } else {
                depth * ratio.ln()
            };
            // A place far below all that came is the less likely.
            let width = width / (1.0 + depth / near);
            *found = (all + width.ln(), depth);
            depth *= ratio;
        }
        let all = log_sum(found.iter().map(|(log, _)| *log));
        let mean: f64 = found.iter().map(|(log, at)| (log - all).exp() * at).sum();
        let variance = found
            .iter()
            .map(|(log, at)| (log - all).exp() * (at - mean).powi(2))
            .sum();
        (all, floor - mean, variance)
    }
}

/// The part of transfers among `count` that do not only follow another one of them.
fn independent(least: &[Transfer], count: f64) -> f64 {
    let free = least.iter().filter(|point| point.is_free());
    let mut order: Vec<_> = free.map(|point| (point.x, point.index)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let follow = |pair: &&[(f64, u32)]| (1..=NEAR).contains(&pair[1].1.wrapping_sub(pair[0].1));
    let following = order.windows(2).filter(follow).count() as f64;
    let all = order.len().max(1) as f64;
    // So many would by chance.
    let chance = f64::from(NEAR) * all * all / count;
    (1.0 - (following - chance) / all).clamp(1.0 / all, 1.0)
}

/// How far from the likeliest slope others are likely, ns/s: about.
fn spread(edges: &[Edge]) -> f64 {
    let of = |edge: &Edge| {
        let xs = edge.least.iter().map(|point| point.x);
        let span = xs.clone().fold(0.0, f64::max) - xs.fold(0.0, f64::min);
        32.0 * edge.window() / edge.least.len() as f64 / span.max(1e-3)
    };
    let steady = edges.iter().filter(|edge| edge.shows_rate());
    steady.map(of).fold(MAX_RATE, f64::min)
}

/// What the transfers say if the slope is `rate`.
struct Terms {
    rate: f64,
    log_likelihood: f64,
    /// Mean and variance of the least delay of each kind.
    floors: [Option<(f64, f64)>; KINDS],
}

impl Terms {
    fn new(edges: &[Edge], tops: &[Edge], rate: f64) -> Self {
        let mut terms = Self {
            rate,
            log_likelihood: 0.0,
            floors: [None; KINDS],
        };
        for edge in edges {
            if edge.least.is_empty() {
                continue;
            }
            // No question came before it was asked, and no answer before that.
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
            // Of a line that is always busy nobody knows how long it takes else.
            let found = match edge.is_seen() || !room.is_finite() {
                true => (mean, variance),
                false => (floor - 0.5 * room, room * room / 12.0),
            };
            terms.floors[CLASSES * edge.link + edge.class as usize] = Some(found);
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
        let questions = questions
            .into_iter()
            .filter_map(|class| self.floor(link, class));
        let (question, variance) = questions.min_by(|a, b| a.1.total_cmp(&b.1))?;
        Some((
            0.5 * (answer - question),
            0.25 * (answer_variance + variance),
        ))
    }

    /// The same by the fastest transfer, taken to have taken no time.
    fn fastest(&self, edges: &[Edge]) -> (f64, f64) {
        let to_host = edges.iter().filter(|edge| !edge.class.is_question());
        let floors = to_host.filter_map(|edge| self.floor(edge.link, edge.class));
        floors
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap_or((0.0, 0.0))
    }
}

/// Certain bounds of the clocks' difference by the transfers that `of` chooses.
fn bounds_by(edges: &[Edge], rate: f64, of: impl Fn(&Edge) -> bool) -> (Option<f64>, Option<f64>) {
    let bound = |questions: bool| {
        let chosen = edges
            .iter()
            .filter(|edge| of(edge) && edge.class.is_question() == questions);
        chosen.map(|edge| edge.floor(rate).0).reduce(f64::min)
    };
    (bound(true).map(|bound| -bound), bound(false))
}

fn bounds(edges: &[Edge], rate: f64) -> (Option<f64>, Option<f64>) {
    bounds_by(edges, rate, |_| true)
}

/// The link that bounds the difference most narrowly.
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
        // The better the slope, the less the delays of the better link look.
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

/// The logarithm of a product of many, without that of each.
pub(super) struct LogProduct {
    log: f64,
    product: f64,
}

impl Default for LogProduct {
    fn default() -> Self {
        Self {
            log: 0.0,
            product: 1.0,
        }
    }
}

impl LogProduct {
    pub fn times(&mut self, factor: f64) {
        self.product *= factor;
        if !(1e-150..1e150).contains(&self.product) {
            self.log += self.product.ln();
            self.product = 1.0;
        }
    }

    pub fn log(&self) -> f64 {
        self.log + self.product.ln()
    }
}

/// The logarithm of the sum of what has these logarithms.
pub(super) fn log_sum(logs: impl Iterator<Item = f64> + Clone) -> f64 {
    let most = logs.clone().fold(f64::NEG_INFINITY, f64::max);
    most + logs.map(|log| (log - most).exp()).sum::<f64>().ln()
}

/// The lower convex hull of v over time.
fn hull(mut points: Vec<Transfer>) -> Vec<Transfer> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.v.total_cmp(&b.v)));
    points.dedup_by(|later, kept| later.x == kept.x);
    let mut hull: Vec<Transfer> = Vec::new();
    for point in points {
        while let [.., a, b] = hull.as_slice() {
            if (b.v - a.v) * (point.x - a.x) < (point.v - a.v) * (b.x - a.x) {
                break;
            }
            hull.pop();
        }
        hull.push(point);
    }
    hull
}
