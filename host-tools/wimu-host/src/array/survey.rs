//! Delays and the size of an array as its motion shows them.

use wimu_calib::Gravity;
use wimu_calib::array::ArrayPrior;

use super::fit::Fitted;
use super::{ArrayCalibration, ArrayGeometry, ArrayRecording};
use crate::Result;

/// Priors of a survey: a delay of any sensor, s, and the logarithm of the size of the array.
const ANY_DELAY_S: f64 = 0.1;
const ANY_SIZE: f64 = 0.3;
/// Longest delay that is corrected, s: as long as a swing of a hand-held body turns one way.
const LONGEST_S: f64 = 0.1;
/// Multiples of the posterior and prior deviations from which on a delay or size differs from the given one; a size by
/// this fraction too.
const DELAY_SD: f64 = 5.0;
const SIZE_SD: f64 = 3.0;
const PRIOR_SD: f64 = 3.0;
const LEAST_SIZE: f64 = 0.05;

/// An array with the delays and the size that its motion shows, where they are not those given.
pub(crate) struct Repaired {
    pub recording: ArrayRecording,
    pub geometry: ArrayGeometry,
    pub calibration: ArrayCalibration,
    /// Delay of each sensor beyond the given one.
    pub delays_s: Vec<f64>,
    pub remarks: Vec<String>,
}

/// Looks for delays of any length and for another size of the array; `None` where all is as given.
pub(crate) fn repaired(
    recording: &ArrayRecording,
    geometry: &ArrayGeometry,
    calibration: &ArrayCalibration,
) -> Result<Option<Repaired>> {
    let prior = ArrayPrior { delay_s: ANY_DELAY_S, size: ANY_SIZE, ..calibration.prior() };
    let found = Fitted::of(recording, geometry, calibration, &prior)?;
    if found.agreement.is_none() {
        return Ok(None);
    }
    let mut remarks = Vec::new();
    let mut delays: Vec<f64> = used(calibration, recording).map(|s| found.delays_s[s].0).collect();
    delays.sort_by(f64::total_cmp);
    // The common time of the sensors is that of most of them.
    let median = 0.5 * (delays[(delays.len() - 1) / 2] + delays[delays.len() / 2]);
    let mut late = vec![0.0; recording.sensors()];
    for sensor in used(calibration, recording) {
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
    // The given positions over the true ones.
    let (size, sd) = (1.0 / found.size.0, found.size.1 / found.size.0.powi(2));
    let known =
        PRIOR_SD * calibration.place_sd_m / (arm_m(geometry) * (recording.sensors() as f64).sqrt());
    let resized = size.ln().abs() > (SIZE_SD * sd / size).max(known).max(LEAST_SIZE);
    if remarks.is_empty() && !resized {
        return Ok(None);
    }
    let mut changed = Repaired {
        recording: recording.clone(),
        geometry: geometry.clone(),
        calibration: calibration.clone(),
        delays_s: late,
        remarks,
    };
    if changed.delays_s.iter().any(|delay| *delay != 0.0) {
        changed.recording = changed.recording.shifted(&changed.delays_s);
        let mut again = ArrayCalibration::of(&changed.recording, geometry, Gravity::UNKNOWN_PLACE)?;
        (again.place_sd_m, again.delay_sd_s) = (calibration.place_sd_m, calibration.delay_sd_s);
        changed.calibration = again;
    }
    if resized {
        for place in changed.geometry.sensors.iter_mut().flat_map(|s| &mut s.places_m) {
            *place = place.map(|c| c / size);
        }
        changed.calibration.size_sd_m = arm_m(&changed.geometry) * sd / size;
        changed.remarks.push(format!(
            "the positions are {size:.3} ± {sd:.3} times as far apart as the sensors: the changes of ω are not the \
             integral of ω̇; they are divided by that. Check the unit of the positions"
        ));
    }
    Ok(Some(changed))
}

fn used<'a>(
    calibration: &'a ArrayCalibration,
    recording: &ArrayRecording,
) -> impl Iterator<Item = usize> + use<'a> {
    (0..recording.sensors()).filter(|sensor| calibration.uses(*sensor))
}

/// Root mean square distance of the axes from their centre, m.
fn arm_m(geometry: &ArrayGeometry) -> f64 {
    let centre = geometry.centre_m();
    let places = || geometry.sensors.iter().flat_map(|s| s.places_m);
    let square = |p: [f64; 3]| (0..3).map(|i| (p[i] - centre[i]).powi(2)).sum::<f64>();
    let count = f64::max(places().count() as f64, 1.0);
    (places().map(square).sum::<f64>() / count).sqrt().max(1e-9)
}
