//! The edges of the delays' distribution.

use super::transfer::{
    CLASSES, Class, Folded, KINDS, LEAST_WINDOW_NS, Transfer, drop_outliers, hull, keep_least,
};

/// Largest clock rate, ns/s.
pub const MAX_RATE: f64 = 5e7;
/// Largest number of transfers that define an edge, and their largest fraction of all.
const EDGE: usize = 96;
const EDGE_FRACTION: f64 = 0.5;
/// Fewest transfers of an edge, of which a quarter must be undelayed by others.
const MIN_POINTS: usize = 4;
/// Fewest undelayed transfers from which the upper edge is used.
const MIN_FREE: f64 = 64.0;
/// Steepness of the density of delays at the least one: it rises as e^(α − 1).
const SHAPES: [f64; 6] = [1.0, 1.5, 2.0, 3.0, 4.0, 6.0];
/// Number of depths of the least delay below the least one observed, for the marginal likelihood.
const DEPTHS: usize = 24;
/// The prior of the depth is uniform up to this multiple of the mean distance of the least delays, then decreases.
const PRIOR_DEPTH: f64 = 4.0;
/// Delayed transfers within this number of each other may have one cause.
const NEAR: u32 = 3;

/// The transfers of a kind, at least one, with times relative to the middle.
#[derive(Clone)]
pub struct Edge {
    pub link: usize,
    pub class: Class,
    /// Sign of the clocks' difference in v.
    pub sign: f64,
    pub count: f64,
    pub sum_x: f64,
    pub sum_v: f64,
    pub hull: Vec<Transfer>,
    /// Whether it is an upper edge, mirrored.
    is_top: bool,
    /// Number of those with delays of their own.
    own: f64,
    /// Those that may be close to the edge.
    candidates: Vec<Transfer>,
    /// Those closest to it, and the end of their window: v at x = 0, and slope.
    pub least: Vec<Transfer>,
    end: (f64, f64),
    /// Fraction of them that is independent: delayed ones often follow each other.
    independent: f64,
}

/// The lower edge of the delays of each kind.
pub fn edges(blocks: &[&Folded], x: f64) -> Vec<Edge> {
    let edge = |kind: usize| {
        let cells = || blocks.iter().map(|block| &block.cells[kind]);
        let hull: Vec<_> = cells().flat_map(|cell| &cell.hull).map(|t| t.about(x)).collect();
        let least = cells().flat_map(|cell| &cell.least).map(|t| t.about(x));
        let own = cells().map(|cell| cell.own).sum();
        Some(Edge {
            count: cells().map(|cell| cell.count).sum(),
            sum_x: cells().map(|cell| cell.sum_x - cell.count * x).sum(),
            sum_v: cells().map(|cell| cell.sum_v).sum(),
            ..Edge::new(*hull.first()?, hull, least.collect(), own)
        })
    };
    (0..KINDS).filter_map(edge).collect()
}

/// The upper edge of the delays, mirrored, of each kind with enough transfers.
pub fn tops(blocks: &[&Folded], x: f64) -> Vec<Edge> {
    let top = |kind: usize| {
        let cells = || blocks.iter().map(|block| &block.cells[kind]);
        let free: f64 = cells().map(|cell| cell.free).sum();
        let most: Vec<_> = cells().flat_map(|cell| &cell.most).map(|t| t.about(x)).collect();
        let first = *most.first()?;
        (free >= MIN_FREE).then(|| Edge {
            sign: -first.class.sign(),
            is_top: true,
            ..Edge::new(first, hull(most.clone()), most, free)
        })
    };
    (0..KINDS).filter_map(top).collect()
}

impl Edge {
    /// With the link and class of `first`.
    fn new(first: Transfer, hull: Vec<Transfer>, candidates: Vec<Transfer>, own: f64) -> Self {
        Self {
            link: first.link,
            class: first.class,
            sign: first.class.sign(),
            count: own,
            sum_x: 0.0,
            sum_v: 0.0,
            hull,
            is_top: false,
            own,
            candidates,
            least: Vec::new(),
            end: (0.0, 0.0),
            independent: 1.0,
        }
    }

    /// Index of its kind.
    pub fn kind(&self) -> usize {
        CLASSES * self.link + self.class as usize
    }

    /// Least delay above a line of slope `rate`, and the transfer that has it.
    pub fn floor(&self, rate: f64) -> (f64, &Transfer) {
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

    /// Selects the least delayed transfers above a line of slope `rate`, of an upper edge without outliers.
    pub fn narrow(&mut self, rate: f64) {
        let slope = self.sign * rate;
        let few = (self.own * EDGE_FRACTION) as usize;
        let most = EDGE.min(few).max(1);
        self.least.clone_from(&self.candidates);
        if self.is_top {
            // At a wrong slope outliers cannot be recognised.
            drop_outliers(&mut self.least, slope);
            self.hull = hull(self.least.clone());
        }
        keep_least(&mut self.least, slope, most + 1);
        let delay = |point: &Transfer| point.bound() - slope * point.x;
        let floor = self.floor(rate).0;
        let last = self.least.last().map_or(floor, delay);
        self.end = (last.max(floor + LEAST_WINDOW_NS), slope);
        if self.least.len() > most {
            self.least.pop();
        }
        self.independent = independent(&self.least, self.own);
    }

    /// Width of the window at the middle, ns.
    pub fn window(&self) -> f64 {
        self.end.0 - self.floor(self.sign * self.end.1).0
    }

    /// Whether it shows the least delay. Transfers delayed by others only give upper bounds of their own delay.
    pub fn is_seen(&self) -> bool {
        let free = self.least.iter().filter(|point| point.is_free()).count();
        4 * free >= self.least.len().max(MIN_POINTS)
    }

    pub fn shows_rate(&self) -> bool {
        self.class.shows_rate() && self.is_seen()
    }

    /// Log-likelihood of slope `rate`, marginalised over the least delay, at most `room`
    /// below the least one observed, and over the shape of the density; mean and variance of the least delay.
    pub fn likelihood(&self, rate: f64, room: f64) -> (f64, f64, f64) {
        let slope = self.sign * rate;
        let floor = self.floor(rate).0;
        let window = self.window();
        let count = self.least.iter().filter(|point| point.is_free()).count() as f64;
        let between = window / self.least.len() as f64;
        let near = PRIOR_DEPTH * between;
        // Logarithmically spaced depths.
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
                let delay = point.bound() - line;
                delays.times(delay);
                if point.is_free() {
                    free.times(delay);
                }
                let end = self.end.0 + self.end.1 * point.x;
                // With a wrong slope the line may cross the end of the window.
                windows.times((end - line).max(1.0));
            }
            let (delays, windows, free) = (delays.log(), windows.log(), free.log());
            let of = |shape: &f64| {
                let log = count * shape.ln() + shape * (delays - windows) - free;
                self.independent * log
            };
            let all = log_sum(SHAPES.iter().map(of));
            // The first one includes all smaller depths.
            let width = if index == 0 { depth } else { depth * ratio.ln() };
            // Prior: a least delay far below all observations is less likely.
            let width = width / (1.0 + depth / near);
            *found = (all + width.ln(), depth);
            depth *= ratio;
        }
        let all = log_sum(found.iter().map(|(log, _)| *log));
        let mean: f64 = found.iter().map(|(log, at)| (log - all).exp() * at).sum();
        let variance = found.iter().map(|(log, at)| (log - all).exp() * (at - mean).powi(2)).sum();
        (all, floor - mean, variance)
    }
}

/// Fraction of the transfers among `count` that do not follow another one of them.
fn independent(least: &[Transfer], count: f64) -> f64 {
    let free = least.iter().filter(|point| point.is_free());
    let mut order: Vec<_> = free.map(|point| (point.x, point.index)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let follow = |pair: &&[(f64, u32)]| (1..=NEAR).contains(&pair[1].1.wrapping_sub(pair[0].1));
    let following = order.windows(2).filter(follow).count() as f64;
    let all = order.len().max(1) as f64;
    // Expected by chance.
    let chance = f64::from(NEAR) * all * all / count;
    (1.0 - (following - chance) / all).clamp(1.0 / all, 1.0)
}

/// Approximate width of the likelihood over the slope, ns/s.
pub fn rate_width(edges: &[Edge]) -> f64 {
    let of = |edge: &Edge| {
        let xs = edge.least.iter().map(|point| point.x);
        let span = xs.clone().fold(0.0, f64::max) - xs.fold(0.0, f64::min);
        32.0 * edge.window() / edge.least.len() as f64 / span.max(1e-3)
    };
    let steady = edges.iter().filter(|edge| edge.shows_rate());
    steady.map(of).fold(MAX_RATE, f64::min)
}

/// Logarithm of a product of many factors, without the logarithm of each.
pub struct LogProduct {
    log: f64,
    product: f64,
}

impl Default for LogProduct {
    fn default() -> Self {
        Self { log: 0.0, product: 1.0 }
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

/// Logarithm of a sum, from the logarithms of its terms.
pub fn log_sum(logs: impl Iterator<Item = f64> + Clone) -> f64 {
    let most = logs.clone().fold(f64::NEG_INFINITY, f64::max);
    most + logs.map(|log| (log - most).exp()).sum::<f64>().ln()
}
