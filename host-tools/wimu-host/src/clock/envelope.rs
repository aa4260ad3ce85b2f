//! The line under one-sided delays: equations (60) to (62).

use std::cmp::Ordering;

/// Independent parts of the transfers, by which the estimate judges itself.
pub(super) const PARTS: usize = 4;
/// How long a part listens before the next one does, s: delays close in time are alike.
const PART_S: f64 = 1.0;
/// Links that one clock is seen through.
pub(super) const LINKS: usize = 2;
const CLASSES: usize = 5;
const KINDS: usize = CLASSES * LINKS;
/// Mean delays below this are taken as this, ns.
const LEAST_MEAN_NS: f64 = 1000.0;
/// No oscillator is worse, ns/s.
pub(super) const MAX_RATE: f64 = 5e7;

/// What is delayed. Transfers of a class take the same least time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Class {
    /// The first byte of a batch of raw samples.
    Raw,
    /// That of a batch of corrected samples: often waits for the raw batch before it.
    Corrected,
    /// That of an answer to a question.
    AnswerBegins,
    /// A whole answer.
    Answer,
    /// A host's whole question.
    Question,
}

impl Class {
    /// −1 towards the device: there the clocks' difference shortens what it lengthens here.
    fn sign(self) -> f64 {
        if self == Self::Question { -1.0 } else { 1.0 }
    }

    /// Whether it takes equally long whatever its length: questions and answers grow by a byte now
    /// and then, which would look like a rate.
    fn shows_rate(self) -> bool {
        !matches!(self, Self::Answer | Self::Question)
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
}

impl Transfer {
    fn kind(&self) -> usize {
        CLASSES * self.link + self.class as usize
    }
}

/// Transfers of one kind and part: how many, the sum of their times, and those that can touch a
/// line from above.
#[derive(Clone, Debug, Default)]
struct Cell {
    count: f64,
    sum_x: f64,
    sum_v: f64,
    hull: Vec<Transfer>,
}

/// A stretch of transfers, reduced to its lower convex hulls.
#[derive(Clone, Debug)]
pub(super) struct Folded {
    /// Times of the first and last transfer, s.
    pub span: (f64, f64),
    cells: [[Cell; PARTS]; KINDS],
}

/// A line under the delays, about `x`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    /// Slope, ns/s.
    pub rate: f64,
    /// Least delay of each kind of transfer, ns.
    floor: [Option<f64>; KINDS],
    /// Certain bounds of the clocks' difference at `x` by each link, given the slope, ns.
    lower: [Option<f64>; LINKS],
    upper: [Option<f64>; LINKS],
}

impl Fit {
    /// Certain bounds of the clocks' difference at `x`, given the slope, ns.
    pub fn bounds(&self) -> (Option<f64>, Option<f64>) {
        let lower = self.lower.iter().flatten().copied().reduce(f64::max);
        let upper = self.upper.iter().flatten().copied().reduce(f64::min);
        (lower, upper)
    }

    /// The link that bounds the difference most narrowly.
    pub fn best_link(&self) -> Option<usize> {
        let width = |link: &usize| Some(self.upper[*link]? - self.lower[*link]?);
        (0..LINKS)
            .filter(|link| width(link).is_some())
            .min_by(|a, b| width(a).partial_cmp(&width(b)).unwrap_or(Ordering::Equal))
    }

    /// The clocks' difference at `x` by exchanges over `link`, ns, if both directions take
    /// equally long: equation (62).
    pub fn centre(&self, link: usize) -> Option<f64> {
        let floor = |class: Class| self.floor[CLASSES * link + class as usize];
        Some((floor(Class::Answer)? - floor(Class::Question)?) / 2.0)
    }
}

impl Folded {
    /// Reduces `transfers`; `None` without any.
    pub fn new(transfers: &[Transfer]) -> Option<Self> {
        let first = transfers.first()?;
        let mut span = (first.x, first.x);
        for transfer in transfers {
            span = (span.0.min(transfer.x), span.1.max(transfer.x));
        }
        let mut cells: [[Cell; PARTS]; KINDS] = Default::default();
        for transfer in transfers {
            let part = (transfer.x / PART_S).floor().rem_euclid(PARTS as f64) as usize;
            let cell = &mut cells[transfer.kind()][part];
            cell.count += 1.0;
            cell.sum_x += transfer.x;
            cell.sum_v += transfer.v;
            cell.hull.push(*transfer);
        }
        for cell in cells.iter_mut().flatten() {
            cell.hull = hull(std::mem::take(&mut cell.hull));
        }
        Some(Self { span, cells })
    }
}

#[cfg(test)]
impl Folded {
    /// Transfers kept.
    pub fn points(&self) -> usize {
        self.cells
            .iter()
            .flatten()
            .map(|cell| cell.hull.len())
            .sum()
    }
}

/// The best line about `x` under the transfers of `blocks`, of one part or of all; with the slope
/// `given`, if there is one. `None` without transfers.
pub(super) fn fit(
    blocks: &[&Folded],
    part: Option<usize>,
    x: f64,
    given: Option<f64>,
) -> Option<Fit> {
    let mut lines = Vec::new();
    for kind in 0..KINDS {
        let cells = || {
            blocks.iter().flat_map(|block| {
                let cells = &block.cells[kind];
                match part {
                    Some(part) => &cells[part..=part],
                    None => &cells[..],
                }
            })
        };
        let points: Vec<_> = cells()
            .flat_map(|cell| &cell.hull)
            .map(|transfer| Transfer {
                x: transfer.x - x,
                ..*transfer
            })
            .collect();
        if !points.is_empty() {
            lines.push(Line {
                count: cells().map(|cell| cell.count).sum(),
                sum_x: cells().map(|cell| cell.sum_x - cell.count * x).sum(),
                sum_v: cells().map(|cell| cell.sum_v).sum(),
                weight: 1.0,
                points,
            });
        }
    }
    if lines.is_empty() {
        return None;
    }
    let (mut steady, rest): (Vec<_>, Vec<_>) = lines
        .into_iter()
        .partition(|line| line.points[0].class.shows_rate());
    let mut rate = given.unwrap_or_else(|| best_rate(&steady));
    for line in &mut steady {
        let above =
            (line.sum_v - line.sign() * rate * line.sum_x) / line.count - line.floor(rate).0;
        line.weight = 1.0 / above.max(LEAST_MEAN_NS);
    }
    if steady.len() > 1 && given.is_none() {
        rate = best_rate(&steady);
    }
    let mut fit = Fit {
        rate,
        floor: [None; KINDS],
        lower: [None; LINKS],
        upper: [None; LINKS],
    };
    for line in steady.iter().chain(&rest) {
        let Transfer { link, class, .. } = line.points[0];
        let bound = line.floor(rate).0;
        fit.floor[CLASSES * link + class as usize] = Some(bound);
        if class == Class::Question {
            fit.lower[link] = Some(-bound);
        } else {
            fit.upper[link] = Some(fit.upper[link].map_or(bound, |upper| bound.min(upper)));
        }
    }
    Some(fit)
}

/// The transfers of a kind, at least one, times about the middle.
struct Line {
    count: f64,
    sum_x: f64,
    sum_v: f64,
    /// One over the mean delay above the floor, 1/ns.
    weight: f64,
    points: Vec<Transfer>,
}

impl Line {
    /// Least delay above a line of slope `rate`, and the transfer that has it.
    fn floor(&self, rate: f64) -> (f64, &Transfer) {
        let slope = self.sign() * rate;
        let mut least = (f64::INFINITY, &self.points[0]);
        for point in &self.points {
            let delay = point.v - slope * point.x;
            if delay < least.0 {
                least = (delay, point);
            }
        }
        least
    }

    fn sign(&self) -> f64 {
        self.points[0].class.sign()
    }
}

/// Derivative of the likelihood by the slope; it falls as the slope grows.
fn gradient(lines: &[Line], rate: f64) -> f64 {
    lines
        .iter()
        .map(|line| {
            let touched = line.floor(rate).1.x;
            line.weight * line.sign() * (line.sum_x - line.count * touched)
        })
        .sum()
}

/// The slope of greatest likelihood: equation (61).
fn best_rate(lines: &[Line]) -> f64 {
    let (mut low, mut high) = (-MAX_RATE, MAX_RATE);
    for _ in 0..48 {
        let middle = 0.5 * (low + high);
        if gradient(lines, middle) > 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
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
