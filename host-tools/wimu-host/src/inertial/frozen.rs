//! Where an accelerometer goes on giving its last value: nothing was measured there.

use std::ops::Range;

use crate::imu::Imu;
use crate::stats::median;

/// Second differences of an axis whose noise is more than a step are, in the median, more than so many steps: 1.65 σ of
/// white noise.
const NOISY_STEPS: f64 = 2.0;
/// Such an axis repeats itself once in three samples and more rarely, and so often in a row never: 3⁻¹⁶ is one in
/// forty million.
const REPEATS: usize = 16;

/// The samples that repeat, on all axes, the one before for longer than a sampling hold explains: none where the
/// accelerometer's noise at rest does not show, as of coarse steps, for it repeats itself then.
pub(super) fn runs(recording: &Imu) -> Vec<Range<usize>> {
    let samples = &recording.samples.v;
    let mut alike: Vec<Range<usize>> = Vec::new();
    for (k, sample) in samples.iter().enumerate() {
        match alike.last_mut() {
            Some(run) if samples[run.start].force_mps2 == sample.force_mps2 => run.end = k + 1,
            _ => alike.push(k..k + 1),
        }
    }
    // A slower accelerometer holds each of its samples.
    let mut held: Vec<usize> = alike.iter().map(ExactSizeIterator::len).collect();
    held.sort_unstable();
    let Some(held) = held.get(held.len() / 2) else {
        return Vec::new();
    };
    let is_long = |run: &Range<usize>| run.len() > REPEATS * held;
    if !alike.iter().any(is_long) {
        return Vec::new();
    }
    let Some((still, _)) = recording.still_seconds().into_iter().next() else {
        return Vec::new();
    };
    let there = alike.iter();
    let there = there.filter(|run| still.contains(&run.start));
    let there: Vec<Range<usize>> = there.cloned().collect();
    if there.iter().any(is_long) || !(0..3).any(|axis| is_noisy(recording, &alike, &there, axis)) {
        return Vec::new();
    }
    let long = alike.into_iter().filter(is_long);
    long.map(|run| run.start + held..run.end).collect()
}

/// Whether an axis's noise in `quiet` is more than its steps, as they are in `all`.
fn is_noisy(recording: &Imu, all: &[Range<usize>], quiet: &[Range<usize>], axis: usize) -> bool {
    let value = |run: &Range<usize>| recording.samples.v[run.start].force_mps2[axis];
    let changes = all.windows(2).map(|two| (value(&two[1]) - value(&two[0])).abs());
    let step = changes.filter(|c| *c > 0.0).fold(f64::INFINITY, f64::min);
    let second = |three: &[Range<usize>]| {
        (value(&three[0]) - 2.0 * value(&three[1]) + value(&three[2])).abs()
    };
    let middle = median(quiet.windows(3).map(second));
    middle.is_some_and(|middle| middle > NOISY_STEPS * step)
}
