//! Samples of two units on one clock: means over common steps.

use nalgebra::Vector3;

use crate::compare::align::correlation::scores;
use crate::motion::{MotionRecording, gap_s, median_step_s};

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
pub(super) struct Unit {
    times_s: Vec<f64>,
    /// Of force and rate up to each time.
    integrals: Vec<[Vector3<f64>; 2]>,
    fields: Vec<(f64, Vector3<f64>)>,
    gap_s: f64,
    step_s: f64,
}

impl Unit {
    /// `None` without a gyroscope.
    pub(super) fn of(recording: &MotionRecording) -> Option<Self> {
        let usual_s = gap_s(&recording.times_s);
        let mut unit = Self {
            times_s: Vec::new(),
            integrals: Vec::new(),
            fields: Vec::new(),
            gap_s: usual_s,
            step_s: median_step_s(&recording.times_s),
        };
        let mut last: Option<[Vector3<f64>; 2]> = None;
        for (&time_s, sample) in recording.times_s.iter().zip(&recording.samples) {
            let now = [sample.force_mps2, sample.rate_rad_s?].map(Vector3::from);
            if !now.iter().flatten().chain([&time_s]).all(|v| v.is_finite()) {
                continue;
            }
            let sum = match (last, unit.times_s.last(), unit.integrals.last()) {
                (Some(before), Some(last_s), Some(sum)) if time_s > *last_s => {
                    let half = 0.5 * (time_s - last_s);
                    [0, 1].map(|k| sum[k] + (before[k] + now[k]) * half)
                }
                (Some(_), ..) => continue,
                _ => [Vector3::zeros(); 2],
            };
            unit.times_s.push(time_s);
            unit.integrals.push(sum);
            if let Some(field) = sample.field_ut.map(Vector3::from)
                && unit.fields.last().is_none_or(|(_, last)| *last != field)
            {
                unit.fields.push((time_s, field));
            }
            last = Some(now);
        }
        (unit.times_s.len() > 2).then_some(unit)
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
        let values: Vec<f64> = sums
            .windows(2)
            .map(|w| (w[1] - w[0]).norm() / step_s)
            .collect();
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        values.into_iter().map(|value| value - mean).collect()
    }
}

/// Common steps where the second unit's clock is `offset_s` behind the first's.
pub(super) fn steps(units: &[Unit; 2], offset_s: f64) -> Vec<Step> {
    let [[a0, a1], [b0, b1]] = [units[0].span_s(), units[1].span_s()];
    let (start_s, end_s) = (a0.max(b0 + offset_s), a1.min(b1 + offset_s));
    let step_s = units[0].step_s.max(units[1].step_s).max(LEAST_STEP_S);
    let count = ((end_s - start_s) / step_s).max(0.0) as usize;
    let shift_s = [0.0, -offset_s];
    let at = |time_s: f64| [0, 1].map(|k| units[k].until(time_s + shift_s[k]));
    let mut before = at(start_s);
    let mut field_s = f64::NEG_INFINITY;
    let mut all = Vec::with_capacity(count);
    for k in 1..=count {
        let time_s = start_s + k as f64 * step_s;
        let now = at(time_s);
        let mean = |what: usize| [0, 1].map(|k| (now[k].0[what] - before[k].0[what]) / step_s);
        let field = |k: usize| units[k].field(time_s + shift_s[k]);
        let fields = field(0)
            .zip(field(1))
            .filter(|_| time_s - field_s >= FIELD_S);
        field_s = if fields.is_some() { time_s } else { field_s };
        all.push(Step {
            time_s,
            step_s,
            force_mps2: mean(0),
            rate_rad_s: mean(1),
            field_ut: fields.map(|(a, b)| [a, b]),
            measured: [now, before]
                .iter()
                .flatten()
                .all(|(_, measured)| *measured),
        });
        before = now;
    }
    all
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
        kept.map(|(score, _)| *score)
            .fold(f64::NEG_INFINITY, f64::max)
    };
    let offset_s = offset(lag);
    Some(Lag {
        offset_s,
        best,
        as_recorded: best_of(&|offset: f64| offset.abs() <= near_s),
        second: best_of(&|offset: f64| (offset - offset_s).abs() > 1.0),
    })
}
