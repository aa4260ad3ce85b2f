//! Samples of two units on one clock: means over common steps.

use nalgebra::Vector3;

use crate::lag::scores;
use crate::motion::{MotionRecording, UnitSample, gap_s, median_step_s};

/// Shortest common step, s: joints of machines and limbs move below 20 Hz.
const LEAST_STEP_S: f64 = 0.005;
/// Interval at which readings of the magnetometers are used, and their largest age, s.
const FIELD_S: f64 = 0.1;
/// Points of the search over all lags.
const COARSE_POINTS: usize = 4000;
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
    /// Readings of both magnetometers, µT.
    pub field_ut: Option<[Vector3<f64>; 2]>,
    /// Whether both have samples.
    pub measured: bool,
}

/// A unit: integrals of its samples over time. A mean over any step follows from them, whatever the rates, and repeated rows
/// count for the time that they last.
#[derive(Default)]
pub(super) struct Unit {
    times_s: Vec<f64>,
    /// Of force and rate up to each time.
    integrals: Vec<[Vector3<f64>; 2]>,
    /// Force and rate of the last sample.
    last: Option<[Vector3<f64>; 2]>,
    fields: Vec<(f64, Vector3<f64>)>,
    gap_s: f64,
    step_s: f64,
}

impl Unit {
    /// `None` without a gyroscope.
    pub(super) fn of(recording: &MotionRecording) -> Option<Self> {
        let mut unit = Self {
            gap_s: gap_s(&recording.times_s),
            step_s: median_step_s(&recording.times_s),
            ..Self::default()
        };
        for (&time_s, sample) in recording.times_s.iter().zip(&recording.samples) {
            unit.push(time_s, sample);
        }
        (unit.times_s.len() > 2).then_some(unit)
    }

    /// The next sample. One that is not finite, not later than the last one or without angular rate is left out.
    pub(super) fn push(&mut self, time_s: f64, sample: &UnitSample) {
        let Some(rate_rad_s) = sample.rate_rad_s else {
            return;
        };
        let now = [sample.force_mps2, rate_rad_s].map(Vector3::from);
        if !now.iter().flatten().chain([&time_s]).all(|v| v.is_finite()) {
            return;
        }
        let sum = match (self.last, self.times_s.last(), self.integrals.last()) {
            (Some(before), Some(last_s), Some(sum)) if time_s > *last_s => {
                let half = 0.5 * (time_s - last_s);
                [0, 1].map(|k| sum[k] + (before[k] + now[k]) * half)
            }
            (Some(_), ..) => return,
            _ => [Vector3::zeros(); 2],
        };
        self.times_s.push(time_s);
        self.integrals.push(sum);
        if let Some(field) = sample.field_ut.map(Vector3::from)
            && self.fields.last().is_none_or(|(_, last)| *last != field)
        {
            self.fields.push((time_s, field));
        }
        self.last = Some(now);
    }

    /// Forgets samples before a time, s, but for the last two and the last reading of the magnetometer.
    pub(super) fn forget(&mut self, before_s: f64) {
        let old = self.times_s.partition_point(|t| *t < before_s);
        let old = old.min(self.times_s.len().saturating_sub(2));
        self.times_s.drain(..old);
        self.integrals.drain(..old);
        let old = self.fields.partition_point(|(t, _)| *t < before_s);
        self.fields.drain(..old.min(self.fields.len().saturating_sub(1)));
    }

    pub(super) fn span_s(&self) -> [f64; 2] {
        [self.times_s[0], self.times_s[self.times_s.len() - 1]]
    }

    /// Integrals up to a time, and whether it is not in a gap.
    fn until(&self, time_s: f64) -> ([Vector3<f64>; 2], bool) {
        let next = self.times_s.partition_point(|t| *t < time_s);
        let next = next.clamp(1, self.times_s.len() - 1);
        let (from, to) = (self.times_s[next - 1], self.times_s[next]);
        let part = ((time_s - from) / (to - from)).clamp(0.0, 1.0);
        let [before, after] = [self.integrals[next - 1], self.integrals[next]];
        let sum = [0, 1].map(|k| before[k] + (after[k] - before[k]) * part);
        (sum, to - from <= self.gap_s)
    }

    /// The last reading of the magnetometer.
    fn field(&self, time_s: f64) -> Option<Vector3<f64>> {
        let next = self.fields.partition_point(|(t, _)| *t <= time_s);
        let (read_s, field) = self.fields[..next].last()?;
        (time_s - read_s <= FIELD_S).then_some(*field)
    }

    /// Magnitude of the angular rate, which does not depend on the mounting, on a grid; less its mean.
    fn magnitudes(&self, step_s: f64) -> Vec<f64> {
        let [start_s, end_s] = self.span_s();
        let count = ((end_s - start_s) / step_s) as usize;
        let sums = (0..=count).map(|k| self.until(start_s + k as f64 * step_s).0[1]);
        let sums: Vec<Vector3<f64>> = sums.collect();
        let values: Vec<f64> = sums.windows(2).map(|w| (w[1] - w[0]).norm() / step_s).collect();
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        values.into_iter().map(|value| value - mean).collect()
    }
}

/// Common steps, one after the other.
pub(super) struct Steps {
    /// The second unit's clock is so much behind the first's, s.
    pub offset_s: f64,
    start_s: f64,
    step_s: f64,
    count: u32,
    /// Integrals of both units up to the last step, and whether they are not in a gap.
    before: [Until; 2],
    field_s: f64,
}

/// Integrals of force and rate, and whether they are not in a gap.
type Until = ([Vector3<f64>; 2], bool);

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
            field_s: f64::NEG_INFINITY,
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
        let mean = |what: usize| [0, 1].map(|k| (now[k].0[what] - before[k].0[what]) / step_s);
        let fields = units[0]
            .field(time_s)
            .zip(units[1].field(time_s - offset_s))
            .filter(|_| time_s - self.field_s >= FIELD_S);
        if fields.is_some() {
            self.field_s = time_s;
        }
        Some(Step {
            time_s,
            step_s,
            force_mps2: mean(0),
            rate_rad_s: mean(1),
            field_ut: fields.map(|(a, b)| [a, b]),
            measured: [now, before].iter().flatten().all(|(_, measured)| *measured),
        })
    }
}

fn both(units: &[Unit; 2], time_s: f64, offset_s: f64) -> [Until; 2] {
    [units[0].until(time_s), units[1].until(time_s - offset_s)]
}

/// All common steps where the second unit's clock is `offset_s` behind the first's.
pub(super) fn steps(units: &[Unit; 2], offset_s: f64) -> Vec<Step> {
    let mut steps = Steps::new(units, offset_s);
    std::iter::from_fn(|| steps.next(units)).collect()
}

/// Offset of the clocks by the correlation of the magnitudes of both angular rates, s, with its correlation; the best
/// correlation of those within `near_s` of the clocks as they are, and the second best of the others.
pub(super) struct Lag {
    pub offset_s: f64,
    pub best: f64,
    pub as_recorded: f64,
    pub second: f64,
}

pub(super) fn lag(units: &[Unit; 2], near_s: f64) -> Option<Lag> {
    let spans = [0, 1].map(|k| units[k].span_s());
    let longest = spans.iter().map(|[from, to]| to - from).fold(0.0, f64::max);
    let step_s = (longest / COARSE_POINTS as f64).max(0.02);
    let [a, b] = [0, 1].map(|k| units[k].magnitudes(step_s));
    let least = (LEAST_OVERLAP_S / step_s) as usize;
    let least = least.max(a.len().min(b.len()) / 2);
    let apart_s = spans[0][0] - spans[1][0];
    let scores = scores(&a, &b, least);
    let offset = |lag: i64| apart_s + lag as f64 * step_s;
    let (best, lag) = scores.iter().copied().max_by(|x, y| x.0.total_cmp(&y.0))?;
    let best_of = |keep: &dyn Fn(f64) -> bool| {
        let kept = scores.iter().filter(|(_, lag)| keep(offset(*lag)));
        kept.map(|(score, _)| *score).fold(f64::NEG_INFINITY, f64::max)
    };
    let offset_s = offset(lag);
    Some(Lag {
        offset_s,
        best,
        as_recorded: best_of(&|offset: f64| offset.abs() <= near_s),
        second: best_of(&|offset: f64| (offset - offset_s).abs() > 1.0),
    })
}
