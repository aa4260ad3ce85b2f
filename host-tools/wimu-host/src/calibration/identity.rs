//! The id of a calibration.

use wimu_model::checksum::Digest;
use wimu_model::{
    CalibrationMethod, CalibrationQuality, GyroscopeParameters, MagnetometerModel, ParameterId,
    ParameterSet, SensorId,
};

/// The id of `set`: CRC-32C of its numbers, little-endian, in the order below; 1 in place of 0, which is the uncalibrated
/// set's. An optional part follows a byte 1, or is a byte 0.
pub fn parameter_id(set: &ParameterSet) -> ParameterId {
    let mut numbers = Numbers(Digest::new());
    let terms = set.model.terms();
    let t = &terms.temperature;
    numbers.byte(set.range_g);
    numbers.doubles(&[set.sensitivity.lsb_per_g()]);
    numbers.doubles(&terms.bias_mps2);
    numbers.doubles(terms.matrix.as_flattened());
    numbers.doubles(&[t.reference_c]);
    for values in [t.bias_mps2_per_k, t.bias_mps2_per_k2, t.scale_per_k, terms.nonlinearity] {
        numbers.doubles(&values);
    }
    numbers.doubles(&set.alignment.quaternion());
    numbers.part(set.alignment_covariance, |numbers, covariance| {
        numbers.floats(covariance.factor().as_flattened());
    });
    numbers.part(set.quality.as_ref(), Numbers::quality);
    numbers.part(set.magnetometer.as_ref(), Numbers::magnetometer);
    // What is absent at the end is left out.
    let goes_on = set.sensor_index != 0 || set.gyroscope.is_some();
    if goes_on || set.sensor.is_some() {
        numbers.bytes(&set.sensor.map_or(0, |SensorId(number)| number).to_le_bytes());
    }
    if goes_on {
        numbers.byte(set.sensor_index);
        numbers.part(set.gyroscope.as_ref(), Numbers::gyroscope);
    }
    ParameterId(numbers.0.finalize().max(1))
}

struct Numbers(Digest);

impl Numbers {
    fn bytes(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    fn byte(&mut self, byte: u8) {
        self.bytes(&[byte]);
    }

    fn doubles(&mut self, values: &[f64]) {
        values.iter().for_each(|value| self.bytes(&value.to_le_bytes()));
    }

    fn floats(&mut self, values: &[f32]) {
        values.iter().for_each(|value| self.bytes(&value.to_le_bytes()));
    }

    /// Seven bits a byte, the lowest first.
    fn varint(&mut self, mut value: u64) {
        while value > 127 {
            self.byte(value as u8 | 128);
            value >>= 7;
        }
        self.byte(value as u8);
    }

    fn part<T>(&mut self, part: Option<T>, content: fn(&mut Self, T)) {
        self.byte(part.is_some().into());
        if let Some(part) = part {
            content(self, part);
        }
    }

    fn quality(&mut self, quality: &CalibrationQuality) {
        let terms = quality.terms();
        let sd = &terms.other_sd;
        self.varint(match terms.method {
            CalibrationMethod::MultiPosition => 0,
            CalibrationMethod::SixPosition => 1,
            CalibrationMethod::FourAngle => 2,
            CalibrationMethod::ThreeAngle => 3,
            CalibrationMethod::Reference => 4,
            CalibrationMethod::Updated => 5,
        });
        self.part(terms.utc_s, Self::varint);
        self.part(terms.temperature, |numbers, t| {
            numbers.floats(&[t.mean_c, t.lowest_c, t.highest_c]);
        });
        self.varint(terms.poses.into());
        self.varint(terms.dof.into());
        self.floats(&[terms.rms_mps2]);
        for value in [terms.loo_rms_mps2, terms.condition] {
            self.part(value, |numbers, value| numbers.floats(&[value]));
        }
        self.floats(terms.covariance.factor().as_flattened());
        for values in [sd.bias_mps2_per_k, sd.bias_mps2_per_k2, sd.scale_per_k, sd.nonlinearity] {
            self.floats(&values);
        }
    }

    fn magnetometer(&mut self, model: &MagnetometerModel) {
        let terms = model.terms();
        self.floats(&terms.hard_iron_nt);
        self.floats(&terms.hard_iron_sd_nt);
        self.floats(&terms.soft_iron);
        self.floats(&terms.soft_iron_sd);
        self.floats(&[terms.field_nt]);
        self.varint(terms.poses.into());
        self.floats(&[terms.rms_nt, terms.loo_rms_nt, terms.condition]);
        self.part(terms.to_accelerometer, |numbers, mounting| {
            numbers.doubles(&mounting.rotation.quaternion());
            numbers.floats(mounting.covariance.factor().as_flattened());
            numbers.floats(&[mounting.dip_rad, mounting.dip_rms_rad]);
        });
    }

    fn gyroscope(&mut self, gyroscope: &GyroscopeParameters) {
        let terms = gyroscope.model.terms();
        let t = &terms.temperature;
        self.bytes(&gyroscope.range_dps.to_le_bytes());
        self.doubles(&[gyroscope.rad_s_per_lsb]);
        self.doubles(&terms.bias_rad_s);
        self.doubles(terms.matrix.as_flattened());
        self.doubles(terms.g_sensitivity.as_flattened());
        self.doubles(&[t.reference_c]);
        self.doubles(&t.bias_rad_s_per_k);
        self.doubles(&t.scale_per_k);
        self.part(gyroscope.sd, |numbers, sd| numbers.floats(&sd));
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::calibration::read_parameters;

    /// The ids that these files have had since the first version.
    #[test]
    fn files_keep_their_ids() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/vectors/compat");
        let mut files = 0;
        for file in std::fs::read_dir(folder.join("calibrations")).expect("calibrations") {
            let path = file.expect("a file").path();
            let Ok(set) = read_parameters(&path) else { continue };
            let text = std::fs::read_to_string(&path).expect("text");
            assert!(text.contains(&parameter_id(&set).to_string()), "{}", path.display());
            files += 1;
        }
        assert!(files >= 2, "{files}");
    }
}
