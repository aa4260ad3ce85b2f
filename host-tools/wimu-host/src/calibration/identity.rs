//! The id of a calibration.

use serde::Serialize;
use wimu_model::checksum::Digest;
use wimu_model::{ParameterId, ParameterSet, SensorId};

/// The id of `set`: CRC-32C of its numbers in postcard's encoding, in the order below; 1 in place of 0, which is the
/// uncalibrated set's. What is absent at the end is left out.
pub fn parameter_id(set: &ParameterSet) -> ParameterId {
    let mut bytes = encoded(&(
        (set.range_g, set.sensitivity, set.model),
        (set.alignment, set.alignment_covariance, set.quality, set.magnetometer),
    ));
    let goes_on = set.sensor_index != 0 || set.gyroscope.is_some();
    if goes_on || set.sensor.is_some() {
        bytes.extend(set.sensor.map_or(0, |SensorId(number)| number).to_le_bytes());
    }
    if goes_on {
        bytes.push(set.sensor_index);
        let gyroscope = set.gyroscope.map(|gyroscope| {
            let range = gyroscope.range_dps.to_le_bytes();
            (range, gyroscope.rad_s_per_lsb, gyroscope.model, gyroscope.sd)
        });
        bytes.extend(encoded(&gyroscope));
    }
    let mut digest = Digest::new();
    digest.update(&bytes);
    ParameterId(digest.finalize().max(1))
}

/// Numbers are always encodable in memory.
fn encoded(numbers: &impl Serialize) -> Vec<u8> {
    postcard::to_stdvec(numbers).unwrap_or_default()
}
