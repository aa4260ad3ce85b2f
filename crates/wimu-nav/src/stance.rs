//! Stances of a foot, and the velocity of a sensor on it meanwhile: equations (157) and (158).
//!
//! How still a foot is in a stance depends on the gait: the statistic of [`RestDetector`](crate::stationarity::RestDetector)
//! with [`RestLimits::foot`](crate::stationarity::RestLimits::foot) is 0.01 in slow walking, 20 in running. The thresholds
//! follow its minima.

use core::ops::Range;

/// Statistic at which a rolling foot is taken for still, whatever the gait: 2 m/s² or 10 °/s.
const STILL: f64 = 1.0;
/// Time before and after a sample that has a stance, s: half the step of a slow walker.
const STEP_S: f64 = 0.6;
/// Upper threshold over the minimum of that time.
const UPPER: f64 = 4.0;
/// Time before a sample, and time after it, that each have a stance, s: a slow step.
const SLOW_STEP_S: f64 = 2.0;
/// Time after a sample whose statistics decide about it, s.
pub const AHEAD_S: f64 = SLOW_STEP_S;
/// Lower threshold over the larger of both minima.
const LOWER: f64 = 7.0;
/// Velocity in a still stance, m/s, a component, 1 σ.
const VELOCITY_MPS: f64 = 0.01;
/// Statistic from which the velocity grows: a lever arm of 0.3 m to the point about which the foot rolls.
const ROLLING: f64 = 0.1;

/// The stances of a recording, or of a part of one: for each sample the standard deviation of the velocity about zero, m/s,
/// a component, or `None` in a swing. `statistic` is that of a window about each sample, infinite where it is unknown, at
/// `rate_hz` samples a second; samples beyond the length of `velocity_mps` have no answer.
///
/// A stance is a run of samples below the upper threshold with a sample below the lower one. The constants were chosen on
/// the pyshoe recordings (score_navigation).
pub fn stances(statistic: &[f64], rate_hz: f64, velocity_mps: &mut [Option<f64>]) {
    let [step, slow_step] = [STEP_S, SLOW_STEP_S].map(|time_s| (time_s * rate_hz) as usize);
    let least = |range: Range<usize>| {
        let within = statistic.get(range).unwrap_or(&[]);
        within.iter().fold(f64::MAX, |least: f64, t| least.min(*t))
    };
    let end = statistic.len().min(velocity_mps.len());
    let around =
        |k: usize, width: usize| k.saturating_sub(width)..(k + width + 1).min(statistic.len());
    let is_below_upper = |k: usize| {
        let upper = STILL.max(least(around(k, step)) * UPPER);
        statistic[k] < upper
    };
    let is_below_lower = |k: usize| {
        let around = around(k, slow_step);
        let both = least(around.start..k + 1).max(least(k..around.end));
        statistic[k] <= both * LOWER
    };
    let mut k = 0;
    while k < end {
        let begin = k;
        let mut trusted = false;
        while k < end && is_below_upper(k) {
            trusted |= is_below_lower(k);
            k += 1;
        }
        for j in begin..k {
            let rolling = (statistic[j] / ROLLING).max(1.0);
            velocity_mps[j] = trusted.then(|| libm::sqrt(rolling) * VELOCITY_MPS);
        }
        if k < end {
            velocity_mps[k] = None;
            k += 1;
        }
    }
}
