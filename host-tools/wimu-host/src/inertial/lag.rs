//! Delay of the angular rate against the specific force, which no single innovation shows.

use nalgebra::Vector3;
use wimu_nav::navigator::{Profile, Sample};

use super::aids::Aids;
use super::segments::IMPROBABLE;
use super::unit::{Unit, run};
use super::{Choice, Method};
use crate::series::{Interp, Ns, Series};
use crate::stats::median;

/// Step of the search, s, and its end: half the swing of a step.
const STEP_S: f64 = 0.02;
const LARGEST_S: f64 = 0.2;
/// Part of a recording that shows a delay, s, and the least degrees of freedom of its innovations.
const SHOWN_S: f64 = 20.0;
const INNOVATIONS: usize = 30;

impl Unit<'_> {
    /// The delay of the angular rate with the smallest innovations at rests and stances, s: least squares. `None` where they
    /// do not differ from those without a delay by more than chance, or it is below a sample interval, where interpolation
    /// averages two samples and so reduces the noise: the logarithm of the ratio of two mean squares of ν
    /// values has the variance 4/ν (R. A. Fisher, "On a distribution yielding the error functions of several well known
    /// statistics", 1924).
    pub fn rate_delay_s(&self, choice: &Choice) -> Option<f64> {
        if choice.profile == Profile::Vehicle || choice.aids != Aids::default() {
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
        let interval_s = median(self.times_s.windows(2).map(|pair| pair[1] - pair[0]))?;
        let is_shown = gained > IMPROBABLE * (4.0 / dof as f64).sqrt();
        (is_shown && delay_s.abs() > interval_s).then_some(delay_s)
    }

    /// Mean square of the innovations at a delay, and their degrees of freedom.
    fn mean_square(&self, delay_s: f64, choice: &Choice) -> Option<(f64, usize)> {
        let end = self.times_s.partition_point(|t| *t < self.times_s[0] + SHOWN_S);
        let moved = self.advanced(delay_s, end);
        let unit = Unit { samples: &moved, times_s: &self.times_s[..end], ..*self };
        let steps = unit.steps(choice, Method::Strapdown);
        let mut navigator = unit.begin(&steps, choice).ok()?;
        run(&mut navigator, &[], None, &steps);
        navigator.segments.mean_square()
    }

    /// The first `count` samples with the angular rate that is measured `delay_s` later, between two samples linearly.
    pub fn advanced(&self, delay_s: f64, count: usize) -> Vec<Sample> {
        let none = Vector3::repeat(f64::NAN);
        let rows = self.times_s.iter().zip(self.samples);
        let rates: Series<Vector3<f64>> =
            Series::of(rows.map(|(t, s)| (Ns::from_s(*t), s.rate_rad_s.unwrap_or(none))))
                .with_gap(f64::INFINITY);
        let rate_at = |time_s: f64| {
            let [first, last] = rates.span()?;
            let at = rates.at(Ns::from_s(time_s).clamp(first, last), Interp::Linear)?;
            Some(at.value)
        };
        let moved = self.samples[..count].iter().zip(self.times_s).map(|(sample, time_s)| Sample {
            rate_rad_s: sample.rate_rad_s.map(|rate| rate_at(time_s + delay_s).unwrap_or(rate)),
            ..*sample
        });
        moved.collect()
    }
}
