//! Where an axis goes on giving its last value: nothing was measured there.

use std::ops::Range;

use nalgebra::Vector3;

use crate::imu::{Imu, Sample};
use crate::plural::counted;
use crate::stats::median;

/// Second differences of an axis whose noise is more than a step are, in the median, three steps and more: two are 1.65 σ of
/// white noise.
const NOISY_STEPS: f64 = 2.5;
/// Such an axis repeats itself once in three samples and more rarely, and so often in a row never: 3⁻¹⁶ is one in
/// forty million. Fewer samples than this are no fault that a path shows.
const REPEATS: usize = 16;
const FEWEST: usize = 50;

/// What a sensor gives in a sample.
pub(crate) type Sense = fn(&Sample) -> Option<Vector3<f64>>;

/// Samples in which axes of a sensor repeat their last value, and what to say of them.
pub(crate) struct Frozen {
    pub samples: Vec<usize>,
    pub text: String,
}

impl Frozen {
    /// Of a sensor: `None` where no axis repeats itself for longer than a sampling hold explains, or where its noise at rest
    /// does not show, as of coarse steps, for it repeats itself then. Of an axis that never changes, that of the others counts.
    pub fn of(recording: &Imu, sensor: &str, sense: Sense) -> Option<Self> {
        let axes = [0, 1, 2].map(|axis| Axis::of(recording, sense, axis));
        if !axes.iter().any(Axis::has_long_runs) {
            return None;
        }
        let quiet: Vec<Range<usize>> =
            recording.still_seconds().into_iter().map(|(second, _)| second).collect();
        // A slower sensor holds each of its samples, on all axes.
        let is_new = |k: &usize| axes.iter().any(|axis| axis.begins_at(*k));
        let sampled: Vec<usize> = (0..recording.samples.len()).filter(is_new).collect();
        let noisy = axes.each_ref().map(|axis| axis.is_noisy(&sampled, &quiet));
        let (mut names, mut frozen) = (Vec::new(), vec![false; recording.samples.len()]);
        for (k, axis) in axes.iter().enumerate().filter(|(_, axis)| axis.has_long_runs()) {
            if noisy[k] || (axis.runs.len() == 1 && noisy.contains(&true)) {
                names.push(["X", "Y", "Z"][k]);
                axis.long_runs().for_each(|run| frozen[run.start + axis.held..run.end].fill(true));
            }
        }
        let samples: Vec<usize> = (0..frozen.len()).filter(|k| frozen[*k]).collect();
        let from_s = recording.samples.t[*samples.first()?].s();
        let text = format!(
            "{sensor} {} gives one and the same value, without noise, from {from_s:.2} s on, in {}",
            names.join(", "),
            counted(samples.len(), "sample")
        );
        Some(Self { samples, text })
    }
}

/// An axis of a sensor.
struct Axis {
    values: Vec<f64>,
    /// Runs of equal values.
    runs: Vec<Range<usize>>,
    /// Samples for which a slower sensor holds each of its values.
    held: usize,
}

impl Axis {
    fn of(recording: &Imu, sense: Sense, axis: usize) -> Self {
        let samples = recording.samples.v.iter();
        let values: Vec<f64> = samples.map(|s| sense(s).map_or(f64::NAN, |v| v[axis])).collect();
        let mut runs: Vec<Range<usize>> = Vec::new();
        for (k, value) in values.iter().enumerate() {
            match runs.last_mut() {
                Some(run) if values[run.start] == *value => run.end = k + 1,
                _ => runs.push(k..k + 1),
            }
        }
        let mut lengths: Vec<usize> = runs.iter().map(ExactSizeIterator::len).collect();
        lengths.sort_unstable();
        let held = if runs.len() > 1 { lengths[lengths.len() / 2] } else { 1 };
        Self { values, runs, held }
    }

    fn long_runs(&self) -> impl Iterator<Item = &Range<usize>> {
        self.runs.iter().filter(|run| run.len() > FEWEST.max(REPEATS * self.held))
    }

    fn has_long_runs(&self) -> bool {
        self.long_runs().next().is_some()
    }

    /// Whether its value is new at a sample.
    fn begins_at(&self, k: usize) -> bool {
        self.runs.binary_search_by(|run| run.start.cmp(&k)).is_ok()
    }

    /// Whether its noise is more than its steps in the first quiet second that has enough samples in which it does not repeat
    /// itself. `sampled`: the samples at which the sensor has new values.
    fn is_noisy(&self, sampled: &[usize], quiet: &[Range<usize>]) -> bool {
        let value = |run: &Range<usize>| self.values[run.start];
        let changes = self.runs.windows(2).map(|two| (value(&two[1]) - value(&two[0])).abs());
        let step = changes.filter(|change| *change > 0.0).fold(f64::INFINITY, f64::min);
        // The first sample of a run is one of the motion.
        let is_free = |k: &usize| !self.long_runs().any(|run| (run.start + 1..run.end).contains(k));
        let live = |second: &Range<usize>| -> Vec<usize> {
            let there = sampled.iter().copied().filter(|k| second.contains(k));
            there.filter(is_free).collect()
        };
        let Some(second) = quiet.iter().map(live).find(|live| live.len() >= REPEATS) else {
            return false;
        };
        let bend = |three: &[usize]| {
            let [a, b, c] = [0, 1, 2].map(|k| self.values[three[k]]);
            (a - 2.0 * b + c).abs()
        };
        let middle = median(second.windows(3).map(bend));
        middle.is_some_and(|middle| middle > NOISY_STEPS * step)
    }
}
