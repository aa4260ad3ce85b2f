//! Checks that every method makes before it computes.

use crate::{Gravity, Pose, Refusal, UnitHint};

/// Refuses poses that are not finite, or whose mean magnitude cannot be gravity in m/s².
pub(crate) fn check<'a>(
    poses: impl Iterator<Item = &'a Pose>,
    gravity: Gravity,
) -> Result<(), Refusal> {
    let mut sum = 0.0;
    let mut count = 0.0;
    for (pose, entry) in poses.enumerate() {
        let finite = entry.mean_mps2.iter().all(|y| y.is_finite())
            && entry.sd_mps2.iter().all(|sd| sd.is_finite());
        if !finite {
            return Err(Refusal::NotFinite { pose });
        }
        sum += libm::sqrt(entry.mean_mps2.iter().map(|y| y * y).sum());
        count += 1.0;
    }
    if count == 0.0 {
        return Ok(());
    }
    let mean_mps2 = sum / count;
    // Bias and scale factor within the error model's bounds move |y| by less than this.
    let ratio = mean_mps2 / gravity.mps2();
    if (0.4..=2.1).contains(&ratio) {
        return Ok(());
    }
    let hint = match mean_mps2 {
        m if (0.7..1.4).contains(&m) => UnitHint::G,
        m if (700.0..1400.0).contains(&m) => UnitHint::MilliGOrCounts,
        m if m > 100.0 => UnitHint::Counts,
        _ => UnitHint::NotGravity,
    };
    Err(Refusal::UnexpectedMagnitude { mean_mps2, hint })
}
