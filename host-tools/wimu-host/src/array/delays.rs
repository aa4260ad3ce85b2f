//! Delays of sensors of an array against their times, as its motion shows them.

use wimu_calib::Gravity;
use wimu_calib::array::ArrayPrior;

use super::fit::Fitted;
use super::{ArrayCalibration, ArrayGeometry, ArrayRecording};
use crate::Result;

/// Prior standard deviation of the delay of any sensor, s.
const ANY_DELAY_S: f64 = 0.1;
/// Longest delay that is corrected, s: as long as a swing of a hand-held body turns one way.
const LONGEST_S: f64 = 0.1;
/// Multiples of the posterior and prior deviations from which on a delay differs from the given one.
const DELAY_SD: f64 = 5.0;
const PRIOR_SD: f64 = 3.0;

/// Delays beyond the given ones, and the recording at its true times with its calibration.
pub(crate) struct DelayCorrection {
    pub recording: ArrayRecording,
    pub calibration: ArrayCalibration,
    /// Delay of each sensor beyond the given one.
    pub delays_s: Vec<f64>,
    pub remarks: Vec<String>,
}

/// Looks for delays of any length; `None` where all are as given.
pub(crate) fn corrected_delays(
    recording: &ArrayRecording,
    geometry: &ArrayGeometry,
    calibration: &ArrayCalibration,
) -> Result<Option<DelayCorrection>> {
    let prior = ArrayPrior { delay_s: ANY_DELAY_S, ..calibration.prior() };
    let found = Fitted::of(recording, geometry, calibration, &prior)?;
    if found.agreement.is_none() {
        return Ok(None);
    }
    let mut remarks = Vec::new();
    let used = || (0..recording.sensors()).filter(|sensor| calibration.uses(*sensor));
    let mut delays: Vec<f64> = used().map(|s| found.delays_s[s].0).collect();
    delays.sort_by(f64::total_cmp);
    // The common time of the sensors is that of most of them.
    let median = 0.5 * (delays[(delays.len() - 1) / 2] + delays[delays.len() / 2]);
    let mut late = vec![0.0; recording.sensors()];
    for sensor in used() {
        let (delay, sd) = (found.delays_s[sensor].0 - median, found.delays_s[sensor].1);
        if delay.abs() > LONGEST_S {
            // Not a delay: the agreement of the sensors is tested later.
            return Ok(None);
        }
        if delay.abs() > (DELAY_SD * sd).max(PRIOR_SD * calibration.delay_sd_s) && delays.len() > 2
        {
            late[sensor] = delay;
            remarks.push(format!(
                "sensor {sensor} (from 0): its samples are taken {:.2} ± {:.2} ms {} than their times say, relative to \
                 most sensors; this is corrected",
                delay.abs() * 1e3,
                sd * 1e3,
                if delay > 0.0 { "later" } else { "earlier" }
            ));
        }
    }
    if remarks.is_empty() {
        return Ok(None);
    }
    let recording = recording.clone().shifted(&late);
    let mut again = ArrayCalibration::of(&recording, geometry, Gravity::UNKNOWN_PLACE)?;
    (again.place_sd_m, again.delay_sd_s) = (calibration.place_sd_m, calibration.delay_sd_s);
    Ok(Some(DelayCorrection { recording, calibration: again, delays_s: late, remarks }))
}
