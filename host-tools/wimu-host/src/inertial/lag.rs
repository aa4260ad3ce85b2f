//! Delay of the angular rate against the specific force, which no single innovation shows.

use wimu_nav::navigator::{Profile, Sample};

use super::segments::IMPROBABLE;
use super::track::Track;
use super::unit::{Unit, sample};
use super::{Choice, Fixes, Method};
use crate::motion::UnitSample;

/// Step of the search, s, and its end: half the swing of a step.
const STEP_S: f64 = 0.02;
const LARGEST_S: f64 = 0.2;
/// Part of a recording that shows a delay, s, and the least degrees of freedom of its innovations.
const SHOWN_S: f64 = 20.0;
const INNOVATIONS: usize = 30;

impl Unit<'_> {
    /// The delay of the angular rate with the smallest innovations at rests and stances, s: least squares. `None` where they
    /// do not differ from those without a delay by more than chance: the logarithm of the ratio of two mean squares of ν
    /// values has the variance 4/ν (R. A. Fisher, "On a distribution yielding the error functions of several well known
    /// statistics", 1924).
    pub fn rate_delay_s(&self, choice: &Choice) -> Option<f64> {
        if choice.profile == Profile::Vehicle || choice.fixes != Fixes::default() {
            return None;
        }
        let (now, dof) = self.mean_square(0.0, choice)?;
        if dof < INNOVATIONS {
            return None;
        }
        let at = |delay_s: f64| Some(self.mean_square(delay_s, choice)?.0.ln());
        let [before, middle, after] = [at(-STEP_S)?, now.ln(), at(STEP_S)?];
        let step_s = if after < before { STEP_S } else { -STEP_S };
        let (mut delay_s, mut least, mut last) = (0.0_f64, middle, before.max(after));
        let mut next = before.min(after);
        while next < least && delay_s.abs() < LARGEST_S {
            (delay_s, last, least) = (delay_s + step_s, least, next);
            next = at(delay_s + step_s)?;
        }
        // The vertex of the parabola through the least value and those beside it.
        let vertex = 0.5 * (last - next) / (last - 2.0 * least + next);
        delay_s += step_s * vertex.clamp(-0.5, 0.5);
        let gained = middle - at(delay_s)?.min(least);
        (gained > IMPROBABLE * (4.0 / dof as f64).sqrt()).then_some(delay_s)
    }

    /// Mean square of the innovations at a delay, and their degrees of freedom.
    fn mean_square(&self, delay_s: f64, choice: &Choice) -> Option<(f64, usize)> {
        let end = self.times_s.partition_point(|t| *t < self.times_s[0] + SHOWN_S);
        let moved = self.advanced(delay_s, end);
        let samples: Vec<Sample> = moved.iter().map(sample).collect();
        let inputs = self.inputs(&samples, choice, Method::Strapdown);
        let rests: Vec<bool> = inputs.iter().map(|input| input.resting).collect();
        let start = self.start(&samples, &rests, choice).ok()?;
        let at_rest = self.first_rest(&rests).is_some();
        let mut track = Track::new(start, choice, self.times_s[0], at_rest);
        for input in &inputs {
            track.step(input, &choice.fixes);
        }
        track.segments.mean_square()
    }

    /// The first `count` samples with the angular rate that is measured `delay_s` later, between two samples linearly.
    pub fn advanced(&self, delay_s: f64, count: usize) -> Vec<UnitSample> {
        let rate_at = |time_s: f64| {
            let next = self.times_s.partition_point(|t| *t < time_s);
            let before = next.saturating_sub(1);
            let next = next.min(self.times_s.len() - 1);
            let [a, b] = [before, next].map(|k| self.samples[k].rate_rad_s);
            let [from_s, to_s] = [before, next].map(|k| self.times_s[k]);
            let (Some(a), Some(b), true) = (a, b, to_s > from_s) else {
                return b.or(a);
            };
            let part = ((time_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0);
            Some([0, 1, 2].map(|axis| a[axis] + part * (b[axis] - a[axis])))
        };
        let moved =
            self.samples[..count].iter().zip(self.times_s).map(|(sample, time_s)| UnitSample {
                rate_rad_s: sample.rate_rad_s.and_then(|_| rate_at(time_s + delay_s)),
                ..*sample
            });
        moved.collect()
    }
}
