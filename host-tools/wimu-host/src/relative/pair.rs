//! Samples of two units on one clock: means over common steps.

use nalgebra::{Vector3, Vector6};

use crate::imu::{Imu, Sample};
use crate::series::{Flags, Interp, Ns, Series};

/// Shortest common step, s: joints of machines and limbs move below 20 Hz.
const LEAST_STEP_S: f64 = 0.005;
/// Interval over which the angular rate is averaged for the search of the clock offset, s.
const RATE_OVER_S: f64 = 0.02;
/// Shortest overlap, s: the noise of a shorter one can fit anything.
pub(super) const LEAST_OVERLAP_S: f64 = 5.0;

/// A common step: means of the first and the second unit, each in its axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    /// Its end, s, clock of the first unit.
    pub time_s: f64,
    pub step_s: f64,
    pub force_mps2: [Vector3<f64>; 2],
    pub rate_rad_s: [Vector3<f64>; 2],
    /// Whether both have samples.
    pub measured: bool,
}

/// A unit: integrals of its samples over time. A mean over any step follows from them, whatever the rates, and repeated rows
/// count for the time that they last.
#[derive(Default)]
pub(super) struct Unit {
    /// Of force and rate up to each time.
    integrals: Series<Vector6<f64>>,
    /// Force and rate of the last sample.
    last: Option<Vector6<f64>>,
    step_s: f64,
}

impl Unit {
    /// `None` without a gyroscope.
    pub(super) fn of(recording: &Imu) -> Option<Self> {
        let mut unit = Self {
            integrals: Series::default().with_gap(recording.samples.pause_s()),
            step_s: recording.samples.period_s(),
            ..Self::default()
        };
        for (time, sample) in recording.samples.t.iter().zip(&recording.samples.v) {
            unit.push(*time, sample);
        }
        (unit.integrals.len() > 2).then_some(unit)
    }

    /// The next sample. One that is not finite, not later than the last one or without angular rate is left out.
    pub(super) fn push(&mut self, time: Ns, sample: &Sample) {
        let Some(rate_rad_s) = sample.rate_rad_s else {
            return;
        };
        let all = sample.force_mps2.iter().chain(&rate_rad_s).copied();
        let now = Vector6::from_iterator(all);
        if !now.iter().all(|v| v.is_finite()) {
            return;
        }
        let mut sum = self.integrals.v.last().copied().unwrap_or_default();
        if let (Some(before), Some(last)) = (self.last, self.integrals.t.last()) {
            sum += (before + now) * (0.5 * time.since_s(*last));
        }
        if self.integrals.push(time, sum, Flags::NONE) {
            self.last = Some(now);
        }
    }

    /// Forgets samples before a time, s, but for the last two.
    pub(super) fn forget(&mut self, before_s: f64) {
        self.integrals.forget_before(Ns::from_s(before_s), 2);
    }

    pub(super) fn span_s(&self) -> [f64; 2] {
        self.integrals.span().unwrap_or_default().map(Ns::s)
    }

    /// Integrals up to a time, or to the first or last one; `None` in a gap.
    fn until(&self, time_s: f64) -> Option<Vector6<f64>> {
        let [first, last] = self.integrals.span()?;
        let time = Ns::from_s(time_s).clamp(first, last);
        Some(self.integrals.at(time, Interp::Linear)?.value)
    }

    /// Magnitude of the angular rate, which does not depend on the mounting.
    pub(super) fn magnitudes(&self) -> Series<f64> {
        let [start_s, end_s] = self.span_s();
        let count = ((end_s - start_s) / RATE_OVER_S) as usize;
        let rate = |k: usize| {
            let time_s = start_s + k as f64 * RATE_OVER_S;
            let change = self.until(time_s + RATE_OVER_S)? - self.until(time_s)?;
            Some((Ns::from_s(time_s), change.fixed_rows::<3>(3).norm() / RATE_OVER_S))
        };
        Series::of((0..count).filter_map(rate))
    }
}

/// Common steps, one after the other.
pub(super) struct Steps {
    /// The second unit's clock is so much behind the first's, s.
    pub offset_s: f64,
    start_s: f64,
    step_s: f64,
    count: u32,
    /// Integrals of both units up to the last step; none in a gap.
    before: [Option<Vector6<f64>>; 2],
}

impl Steps {
    /// From the first time that both have in common.
    pub(super) fn new(units: &[Unit; 2], offset_s: f64) -> Self {
        let start_s = f64::max(units[0].span_s()[0], units[1].span_s()[0] + offset_s);
        Self {
            offset_s,
            start_s,
            step_s: units[0].step_s.max(units[1].step_s).max(LEAST_STEP_S),
            count: 0,
            before: both(units, start_s, offset_s),
        }
    }

    /// The end of the last step, s, clock of the first unit.
    pub(super) fn time_s(&self) -> f64 {
        self.start_s + f64::from(self.count) * self.step_s
    }

    /// The next step; `None` until both units have samples up to its end.
    pub(super) fn next(&mut self, units: &[Unit; 2]) -> Option<Step> {
        let (step_s, offset_s) = (self.step_s, self.offset_s);
        let time_s = self.start_s + f64::from(self.count + 1) * step_s;
        if time_s > units[0].span_s()[1].min(units[1].span_s()[1] + offset_s) {
            return None;
        }
        self.count += 1;
        let now = both(units, time_s, offset_s);
        let before = std::mem::replace(&mut self.before, now);
        let measured = [now, before].iter().flatten().all(Option::is_some);
        let means = [0, 1].map(|k| match (now[k], before[k]) {
            (Some(now), Some(before)) if measured => (now - before) / step_s,
            _ => Vector6::zeros(),
        });
        Some(Step {
            time_s,
            step_s,
            force_mps2: means.map(|mean| mean.fixed_rows::<3>(0).into()),
            rate_rad_s: means.map(|mean| mean.fixed_rows::<3>(3).into()),
            measured,
        })
    }
}

fn both(units: &[Unit; 2], time_s: f64, offset_s: f64) -> [Option<Vector6<f64>>; 2] {
    [units[0].until(time_s), units[1].until(time_s - offset_s)]
}

/// All common steps where the second unit's clock is `offset_s` behind the first's.
pub(super) fn steps(units: &[Unit; 2], offset_s: f64) -> Vec<Step> {
    let mut steps = Steps::new(units, offset_s);
    std::iter::from_fn(|| steps.next(units)).collect()
}
