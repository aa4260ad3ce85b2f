//! Times that are those of arrival: samples that had to wait come in a burst.

use std::ops::Range;

use wimu_nav::unit::UnitSample;

use crate::motion::median_step_s;
use crate::plural::counted;

/// So many samples in less than this share of their usual time are a burst, ...
const BURST: usize = 32;
const FAST: f64 = 0.5;
/// ... where of the other steps more than this share depart from the usual one by more than that: a sensor's own times
/// do not, whatever its rate.
const UNEVEN: f64 = 0.2;
const DEPARTS: f64 = 0.3;

/// Samples that came in bursts.
fn bursts(times_s: &[f64]) -> Vec<Range<usize>> {
    let usual = median_step_s(times_s);
    let mut found: Vec<Range<usize>> = Vec::new();
    for first in 0..times_s.len().saturating_sub(BURST) {
        let end = first + BURST;
        if times_s[end] - times_s[first] > FAST * BURST as f64 * usual {
            continue;
        }
        match found.last_mut().filter(|last| last.end > first) {
            Some(last) => last.end = end + 1,
            None => found.push(first + 1..end + 1),
        }
    }
    let mut inside = vec![false; times_s.len()];
    for burst in &found {
        inside[burst.clone()].fill(true);
    }
    let others: Vec<usize> = (1..times_s.len()).filter(|k| !inside[*k]).collect();
    let departs = |k: &&usize| (times_s[**k] - times_s[**k - 1] - usual).abs() > DEPARTS * usual;
    let uneven = others.iter().filter(departs).count();
    if (uneven as f64) < UNEVEN * others.len() as f64 {
        found.clear();
    }
    found
}

/// Gives what came in a burst its usual step, and returns what to say of it.
pub(super) fn spread(times_s: &[f64], samples: &mut [UnitSample]) -> Option<String> {
    let found = bursts(times_s);
    let first = found.first()?;
    let usual = median_step_s(times_s);
    for k in found.iter().cloned().flatten() {
        samples[k].step_s = usual;
    }
    Some(format!(
        "its times are those of arrival: {} samples came in {}, first at {:.2} s, and are taken {:.1} ms apart",
        found.iter().map(Range::len).sum::<usize>(),
        counted(found.len(), "burst"),
        times_s[first.start - 1],
        1e3 * usual
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four seconds at 100 Hz with a jitter of half a step where `late`, after a second and a half that came within a
    /// quarter of its time.
    fn times_s(late: bool) -> Vec<f64> {
        let mut times = vec![0.0];
        for k in 0..550_u32 {
            let jitter = if late && k % 3 == 0 { 0.005 } else { 0.0 };
            let step = if k < 150 { 0.0025 } else { 0.01 };
            times.push(times[k as usize] + step + jitter);
        }
        times
    }

    #[test]
    fn samples_that_had_to_wait_are_taken_their_usual_step_apart() {
        let times = times_s(true);
        let mut samples = vec![UnitSample::default(); times.len()];
        let said = spread(&times, &mut samples).unwrap();
        assert!(said.contains("1 burst, first at 0.00 s"), "{said}");
        let steps: f64 = samples[1..150].iter().map(|s| s.step_s).sum();
        assert!((steps - 1.49).abs() < 0.05, "{steps}");
        assert_eq!(samples[200].step_s, 0.0);
    }

    #[test]
    fn a_sensor_that_changes_its_rate_is_believed() {
        let times = times_s(false);
        let mut samples = vec![UnitSample::default(); times.len()];
        assert!(spread(&times, &mut samples).is_none());
    }
}
