//! The steps of a foot, by which a recording of one is recognised.

use std::ops::Range;

use nalgebra::Vector3;
use wimu_nav::GRAVITY_MPS2;
use wimu_nav::navigator::Sample;

/// A shorter run of samples is no stance, s.
const STANCE_S: f64 = 0.03;
/// A swing in walking or running lasts so long, s; the foot rotates faster, rad/s, and accelerates more, m/s².
const SWING_S: Range<f64> = 0.2..1.2;
const SWING_RAD_S: f64 = 3.0;
const SWING_MPS2: f64 = 5.0;
/// Least number of steps, and their part of the time between stances: 0.76 or more in 12 pyshoe trials, below 0.1 in the two
/// on stairs, which are not recognised; at most 0.61 in a hand (BROAD). All these recordings were seen for the choice.
const STEPS: usize = 8;
const PART: f64 = 0.7;

/// Number of the steps between stances, if the motion is that of a foot.
pub(super) fn steps(
    times_s: &[f64],
    samples: &[Sample],
    stances: &[Range<usize>],
) -> Option<usize> {
    let lasts_s = |run: &Range<usize>| times_s[run.end - 1] - times_s[run.start];
    let stances: Vec<_> = stances.iter().filter(|stance| lasts_s(stance) > STANCE_S).collect();
    let (mut steps, mut in_steps_s, mut between_s) = (0, 0.0, 0.0);
    for pair in stances.windows(2) {
        let swing = pair[0].end..pair[1].start;
        let swing_s = times_s[swing.end] - times_s[swing.start];
        between_s += swing_s;
        if SWING_S.contains(&swing_s) && is_swing(&samples[swing]) {
            steps += 1;
            in_steps_s += swing_s;
        }
    }
    (steps >= STEPS && in_steps_s > PART * between_s).then_some(steps)
}

/// Whether a sensor rotates anywhere as a foot does in its swings.
pub(super) fn turns_like_a_foot(samples: &[Sample]) -> bool {
    samples.iter().any(|sample| sample.rate_rad_s.is_some_and(|rate| rate.norm() > SWING_RAD_S))
}

fn is_swing(samples: &[Sample]) -> bool {
    let excess = |force: &Vector3<f64>| (force.norm() - GRAVITY_MPS2).abs();
    turns_like_a_foot(samples)
        && samples.iter().any(|sample| excess(&sample.force_mps2) > SWING_MPS2)
}
