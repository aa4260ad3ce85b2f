//! Detection of clipping in one of two streams.

use super::sums::AxisSums;

/// Smallest number of samples at an extreme value.
const PILE: f64 = 10.0;
/// Significance threshold for the excess of the other stream, standard deviations.
const DEVIATIONS: f64 = 4.0;
/// Excess that quantisation can hide, in quantisation steps of both streams.
const HIDDEN_STEPS: f64 = 0.5;

/// The samples at the lowest or highest reading of one side.
#[derive(Clone, Copy, Debug)]
struct End {
    at: f64,
    n: f64,
    /// Sums of the other side and its squares.
    other: f64,
    squares: f64,
}

impl End {
    fn none() -> Self {
        Self { at: 0.0, n: 0.0, other: 0.0, squares: 0.0 }
    }

    fn take(&mut self, at: f64, other: f64) {
        self.at = at;
        self.n += 1.0;
        self.other += other;
        self.squares += other * other;
    }
}

/// Both ends of both sides of an axis: reference, output; low, high.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ends {
    ends: [[End; 2]; 2],
    /// The previous sample, and the smallest change from one to the next.
    last: [f64; 2],
    step: [Option<f64>; 2],
}

/// A limit at which a stream is clipped.
pub(super) struct Stopped {
    /// 0 the reference, 1 the output.
    pub side: usize,
    /// The reading, about the origin.
    pub at: f64,
    pub samples: f64,
}

impl Ends {
    pub fn none() -> Self {
        Self { ends: [[End::none(); 2]; 2], last: [0.0; 2], step: [None; 2] }
    }

    /// Takes the next pair, about the origin.
    pub fn take(&mut self, pair: [f64; 2]) {
        let [x, y] = pair;
        for (side, (own, other)) in [(x, y), (y, x)].into_iter().enumerate() {
            for (high, end) in self.ends[side].iter_mut().enumerate() {
                let beyond = if high == 1 { own > end.at } else { own < end.at };
                if beyond {
                    *end = End::none();
                }
                if beyond || own == end.at {
                    end.take(own, other);
                }
            }
            let step = (own - self.last[side]).abs();
            if step > 0.0 && self.step[side].is_none_or(|least| step < least) {
                self.step[side] = Some(step);
            }
        }
        self.last = pair;
    }

    /// The first extreme value, of the output if possible, at which a stream is clipped: on average
    /// the other stream exceeds the regression line through the remaining samples. Noise, which is
    /// selected by the extreme value, has the opposite effect.
    pub fn stopped(&self, all: &AxisSums) -> Option<Stopped> {
        [1, 0].into_iter().find_map(|side| self.stopped_on(side, all))
    }

    fn stopped_on(&self, side: usize, all: &AxisSums) -> Option<Stopped> {
        let piles = || {
            let ends = self.ends[side].iter().enumerate();
            ends.filter(|(_, end)| end.n >= PILE)
        };
        let free = piles().fold(*all, |sums, (_, end)| {
            let sums_of_it = [end.n, end.other, end.squares];
            sums.without(side, end.at, sums_of_it)
        });
        let moments = free.moments();
        let slope = moments.slope().filter(|_| free.n >= PILE)?;
        let noise = libm::sqrt(moments.left(slope).max(0.0));
        let step = |side: usize| self.step[side].unwrap_or(0.0);
        let hidden = HIDDEN_STEPS * (step(1) + slope.abs() * step(0));
        let mut stopped = piles().filter_map(|(high, end)| {
            let (at, n) = (end.at, end.n);
            let other = end.other / n;
            let [x, y] = if side == 0 { [at, other] } else { [other, at] };
            let off = y - moments.y - slope * (x - moments.x);
            // A clipped output is too small; a clipped reference is exceeded.
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
