//! Where a stream stops: readings that pile up at an end of an axis while the other stream goes on.

use super::sums::AxisSums;
use crate::Scalar;
use crate::scalar::sealed::Total;

/// So many samples at one reading are a pile.
const PILE: f64 = 10.0;
/// The other stream goes on where it is beyond by more than so many standard deviations of chance,
const DEVIATIONS: f64 = 4.0;
/// and by this much of the steps of both, which rounding hides.
const HIDDEN_STEPS: f64 = 0.5;

/// The samples at the lowest or highest reading of one side.
#[derive(Clone, Copy, Debug)]
struct End<R: Scalar> {
    at: R,
    n: R::Total,
    /// Σ of the other side and of its squares.
    other: R::Total,
    squares: R::Total,
}

impl<R: Scalar> End<R> {
    fn none() -> Self {
        Self {
            at: R::default(),
            n: R::Total::ZERO,
            other: R::Total::ZERO,
            squares: R::Total::ZERO,
        }
    }

    fn take(&mut self, at: R, other: R) {
        self.at = at;
        self.n.add(R::of(1.0));
        self.other.add(other);
        self.squares.add(other * other);
    }
}

/// Both ends of both sides of an axis: reference, output; low, high.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ends<R: Scalar> {
    ends: [[End<R>; 2]; 2],
    /// The sample before, and the least change from one to the next.
    last: [R; 2],
    step: [Option<R>; 2],
}

/// A reading that a stream stops at.
pub(super) struct Stopped {
    /// 0 the reference, 1 the output.
    pub side: usize,
    /// The reading, about the origin.
    pub at: f64,
    pub samples: f64,
}

impl<R: Scalar> Ends<R> {
    pub fn none() -> Self {
        Self {
            ends: [[End::none(); 2]; 2],
            last: [R::default(); 2],
            step: [None; 2],
        }
    }

    /// Takes the next pair, about the origin.
    pub fn take(&mut self, pair: [R; 2]) {
        let [x, y] = pair;
        for (side, (own, other)) in [(x, y), (y, x)].into_iter().enumerate() {
            for (high, end) in self.ends[side].iter_mut().enumerate() {
                let beyond = if high == 1 {
                    own > end.at
                } else {
                    own < end.at
                };
                if beyond {
                    *end = End::none();
                }
                if beyond || own == end.at {
                    end.take(own, other);
                }
            }
            let step = (own - self.last[side]).size();
            if step > R::default() && self.step[side].is_none_or(|least| step < least) {
                self.step[side] = Some(step);
            }
        }
        self.last = pair;
    }

    /// The first end that a side stops at, the output's first: with the line through its other samples,
    /// the other side is beyond it on the mean, where noise at an end, chosen by its reading, is on this
    /// side of it.
    pub fn stopped(&self, all: &AxisSums, delta: f64) -> Option<Stopped> {
        [1, 0]
            .into_iter()
            .find_map(|side| self.stopped_on(side, all, delta))
    }

    fn stopped_on(&self, side: usize, all: &AxisSums, delta: f64) -> Option<Stopped> {
        let piles = || {
            let ends = self.ends[side].iter().enumerate();
            ends.filter(|(_, end)| end.n.value() >= PILE)
        };
        let free = piles().fold(*all, |sums, (_, end)| {
            let sums_of_it = [end.n.value(), end.other.value(), end.squares.value()];
            sums.without(side, end.at.into(), sums_of_it)
        });
        let moments = free.moments();
        let slope = moments.slope(delta).filter(|_| free.n >= PILE)?;
        let noise = libm::sqrt(moments.left(slope).max(0.0));
        let step = |side: usize| self.step[side].map_or(0.0, Into::into);
        let hidden = HIDDEN_STEPS * (step(1) + slope.abs() * step(0));
        let mut stopped = piles().filter_map(|(high, end)| {
            let (at, n): (f64, f64) = (end.at.into(), end.n.value());
            let other = end.other.value() / n;
            let [x, y] = if side == 0 { [at, other] } else { [other, at] };
            let off = y - moments.y - slope * (x - moments.x);
            // An output that stops at its high end falls short; a reference that does is passed.
            let off = if side == 0 && slope < 0.0 { -off } else { off };
            let short = if high == side { -off } else { off };
            (short > DEVIATIONS * noise / libm::sqrt(n) + hidden).then_some(Stopped {
                side,
                at,
                samples: n,
            })
        });
        stopped.next()
    }
}
