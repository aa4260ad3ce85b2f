//! Rests in a recording: the one incremental detector, and a loop over it.

use std::ops::Range;

use nalgebra::Vector3;
pub use wimu_nav::stationarity::{RestDetector, RestLimits};

/// A sample: specific force, m/s², angular rate, rad/s, and the time since the sample before, s.
pub type RestSample = (Vector3<f64>, Option<Vector3<f64>>, f64);

/// The rests among samples, as ranges of them. Each begins where the window of the detector is full.
pub fn rests(
    samples: impl IntoIterator<Item = RestSample>,
    limits: RestLimits,
) -> Vec<Range<usize>> {
    let mut detector = RestDetector::new(limits);
    let mut found: Vec<Range<usize>> = Vec::new();
    for (k, (force, rate, step_s)) in samples.into_iter().enumerate() {
        if !detector.push(&force, rate.as_ref(), step_s) {
            continue;
        }
        match found.last_mut().filter(|rest| rest.end == k) {
            Some(rest) => rest.end = k + 1,
            None => found.push(k..k + 1),
        }
    }
    found
}
