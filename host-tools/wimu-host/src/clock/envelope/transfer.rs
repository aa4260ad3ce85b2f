//! Transfers over a link, and their blocks.

use std::collections::HashSet;

/// Number of links by which one clock is observed.
pub const LINKS: usize = 2;
pub const CLASSES: usize = 6;
pub const KINDS: usize = CLASSES * LINKS;
/// Largest number of early outliers of an upper edge: transfers that a stall delayed.
const MAX_OUTLIERS: usize = 16;
/// Smallest width of the window at the edge of the delays, ns: the resolution of times of arrival.
pub const LEAST_WINDOW_NS: f64 = 20_000.0;

/// Class of transfers that have the same least delay.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// The first byte of a batch of raw samples.
    Raw,
    /// The first byte of a batch of corrected samples, which often waits for the raw batch before it.
    Corrected,
    /// The first byte of the answer to a time request.
    AnswerBegins,
    /// A complete answer: its delay depends on that of its first byte, so that it adds nothing to the rate.
    Answer,
    /// A complete time request of the host.
    Question,
    /// The same, of another length.
    OtherQuestion,
}

impl Class {
    /// Whether it goes to the device.
    pub fn is_question(self) -> bool {
        matches!(self, Self::Question | Self::OtherQuestion)
    }

    /// −1 towards the device, where the clocks' difference has the opposite effect on the delay.
    pub fn sign(self) -> f64 {
        if self.is_question() { -1.0 } else { 1.0 }
    }

    pub fn shows_rate(self) -> bool {
        self != Self::Answer
    }
}

/// One transfer.
#[derive(Clone, Copy, Debug)]
pub struct Transfer {
    /// Below [`LINKS`].
    pub link: usize,
    pub class: Class,
    /// Device time since the origin, s.
    pub x: f64,
    /// Sign · (host time − device time) since the origin, ns: the delay plus the clocks' difference.
    pub v: f64,
    /// The v from which on it is undelayed by another transfer. Below, it followed another one immediately, which may
    /// have delayed it: its own delay was smaller. Infinite if it was sent immediately after another one: then it
    /// only gives a bound.
    pub free_from: f64,
    /// Number within its kind.
    pub index: u32,
}

impl Transfer {
    fn kind(&self) -> usize {
        CLASSES * self.link + self.class as usize
    }

    pub fn is_free(&self) -> bool {
        self.v >= self.free_from
    }

    fn is_own(&self) -> bool {
        self.free_from < f64::INFINITY
    }

    /// Its v, or the upper bound of it.
    pub fn bound(&self) -> f64 {
        self.v.max(self.free_from)
    }

    /// With the sign of v inverted: the upper edge of the delays becomes a lower one.
    fn mirrored(&self) -> Self {
        Self { v: -self.v, free_from: f64::NEG_INFINITY, ..*self }
    }

    /// With its time relative to `x`.
    pub fn about(&self, x: f64) -> Self {
        Self { x: self.x - x, ..*self }
    }
}

/// Transfers of one kind in a block.
#[derive(Clone, Debug, Default)]
pub struct Cell {
    pub count: f64,
    pub sum_x: f64,
    pub sum_v: f64,
    /// Those that a line below all can touch.
    pub hull: Vec<Transfer>,
    /// Number of those with delays of their own, and the least delayed of them.
    pub own: f64,
    pub least: Vec<Transfer>,
    /// Number of those undelayed by others, and the most delayed of them, mirrored.
    pub free: f64,
    pub most: Vec<Transfer>,
}

/// A block of transfers, by kind.
#[derive(Clone, Debug)]
pub struct Folded {
    /// Times of the first and last transfer, s.
    pub span: (f64, f64),
    pub cells: [Cell; KINDS],
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
            let transfer = &Transfer { index: cell.count as u32, ..*transfer };
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
}

/// Keeps the `most` least delayed transfers above a line of this slope, in order.
pub fn keep_least(transfers: &mut Vec<Transfer>, slope: f64, most: usize) {
    let delay = |transfer: &Transfer| transfer.bound() - slope * transfer.x;
    let order = |a: &Transfer, b: &Transfer| delay(a).total_cmp(&delay(b));
    if transfers.len() > most {
        transfers.select_nth_unstable_by(most, order);
        transfers.truncate(most);
    }
    transfers.sort_by(order);
}

/// Keeps those among the `most` least delayed above a line of either slope.
pub fn keep_least_of(transfers: &mut Vec<Transfer>, slopes: [f64; 2], most: usize) {
    let [mut least, other] = slopes.map(|slope| {
        let mut least = transfers.clone();
        keep_least(&mut least, slope, most);
        least
    });
    let known: HashSet<u32> = least.iter().map(|transfer| transfer.index).collect();
    least.extend(other.iter().filter(|other| !known.contains(&other.index)));
    *transfers = least;
}

/// Sorts `transfers` by delay above a line of this slope, and drops the first ones that are farther from the others
/// than these from each other: the delays of a stalled link are not typical.
pub fn drop_outliers(transfers: &mut Vec<Transfer>, slope: f64) {
    let all = transfers.len();
    keep_least(transfers, slope, all);
    let delay = |index: usize| {
        let transfer: &Transfer = &transfers[index];
        transfer.v - slope * transfer.x
    };
    let pairs = 0..all.saturating_sub(MAX_OUTLIERS + 1).min(MAX_OUTLIERS);
    let is_outlier = |index: &usize| {
        let next = delay(index + 1);
        next - delay(*index) > (delay(index + 1 + MAX_OUTLIERS) - next).max(LEAST_WINDOW_NS)
    };
    let outliers = pairs.rev().find(is_outlier).map_or(0, |index| index + 1);
    transfers.drain(..outliers);
}

/// The lower convex hull of v over time.
pub fn hull(mut points: Vec<Transfer>) -> Vec<Transfer> {
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
