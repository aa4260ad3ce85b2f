//! Delay of the angular rate against the specific force, which no single innovation shows.

use nalgebra::Vector3;
use wimu_nav::navigator::{Profile, Sample};

use super::aids::Aids;
use super::unit::{Unit, run};
use super::{Choice, Method};
use crate::lag::likeliest;
use crate::series::{Interp, Ns, Series};
use crate::stats::{IMPROBABLE, median};

/// Step of the search, s, and its end: half the swing of a step.
const STEP_S: f64 = 0.02;
const LARGEST_S: f64 = 0.2;
/// Part of a recording that shows a delay, s, and the least degrees of freedom of its innovations.
const SHOWN_S: f64 = 20.0;
const INNOVATIONS: usize = 30;

impl Unit<'_> {
    /// The delay of the angular rate of greatest likelihood of the innovations at rests and stances, of unknown variance, s. `None`
    /// where they do not differ from those without a delay by more than chance, or it is below a sample interval, where
    /// interpolation averages two samples and so reduces the noise: the logarithm of the ratio of two mean squares of ν values
    /// has the variance 4/ν (R. A. Fisher, "On a distribution yielding the error functions of several well known statistics",
    /// 1924), and the log-likelihood, ν/2 of it, ν.
    pub fn rate_delay_s(&self, choice: &Choice) -> Option<f64> {
        if choice.profile == Profile::Vehicle || choice.aids != Aids::default() {
            return None;
        }
        let (_, dof) = self.mean_square(0.0, choice)?;
        if dof < INNOVATIONS {
            return None;
        }
        let half = 0.5 * dof as f64;
        let log_likelihood = |delay_s: f64| Some(-half * self.mean_square(delay_s, choice)?.0.ln());
        let found = likeliest(0.0, [STEP_S; 2], LARGEST_S, log_likelihood)?;
        let interval_s = median(self.times_s.windows(2).map(|pair| pair[1] - pair[0]))?;
        let is_shown = found.gain > IMPROBABLE * (dof as f64).sqrt();
        (is_shown && found.offset_s.abs() > interval_s).then_some(found.offset_s)
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
