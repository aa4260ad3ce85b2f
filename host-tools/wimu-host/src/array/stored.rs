//! An array's calibration as it is stored: the error models of its sensors in its geometry.

use wimu_calib::Gravity;
use wimu_model::{ErrorModel, ErrorTerms, SpecificForceMps2};

use super::{Agreement, Array, ArrayCalibration, ArrayGeometry, ArraySensor};
use crate::{Code, Problem, Result};

/// Calibration of an array from a recording of rests.
#[derive(Clone, Debug)]
pub struct CalibratedArray {
    /// The geometry with an error model of each sensor that is used, which includes the sensors' rotations against each other.
    pub geometry: ArrayGeometry,
    /// What the rests show; the models are in body axes.
    pub calibration: ArrayCalibration,
    /// How well the sensors agree in motion, where there is some.
    pub findings: Vec<Problem>,
}

/// Calibrates an array from a recording in the sensors' own axes: rests in a dozen orientations show the
/// error models and how the sensors are rotated against each other. Models in `geometry` are not used.
///
/// # Errors
/// `data_refused` where the rests do not suffice, the sensors contradict each other or their positions show no angular rate;
/// those of [`ArrayCalibration::of`].
pub fn calibrate_array(
    recording: &Array,
    geometry: &ArrayGeometry,
    gravity: Gravity,
) -> Result<CalibratedArray> {
    let mut geometry = geometry.clone();
    for sensor in &mut geometry.sensors {
        (sensor.model, sensor.sensitivity_lsb_per_g) = (None, None);
    }
    let arranged = recording.clone().arranged(&geometry)?;
    let calibration = ArrayCalibration::of(&arranged, &geometry, gravity)?;
    if let Some(why) = &calibration.uncalibrated {
        return Err(Code::DataRefused.error(format!("the array cannot be calibrated: {why}"),
            "hold the array still for two seconds in a dozen orientations, all sides and some tilts between",
        )
        .at(&recording.name));
    }
    let used = (0..recording.sensors()).filter(|sensor| calibration.uses(*sensor)).count();
    if let (0 | 1, [(sensor, why), ..]) = (used, &calibration.left_out[..]) {
        let message =
            format!("one sensor is no array: sensor {sensor} (from 0) is left out: {why}");
        let remedy = "check this sensor, its wiring and its columns";
        return Err(Code::DataRefused.error(message, remedy).at(&recording.name));
    }
    let mut findings = Vec::new();
    // Whoever navigates with these positions would be refused.
    if let Some(agreement) = Agreement::of(&arranged, &geometry, &calibration)? {
        agreement.check(&recording.name)?;
        findings.extend(agreement.findings());
    }
    for (k, sensor) in geometry.sensors.iter_mut().enumerate() {
        if calibration.fits[k].is_none() || !calibration.uses(k) {
            continue;
        }
        sensor.model = Some(in_own_axes(sensor, &calibration.sensors[k])?);
        sensor.sensitivity_lsb_per_g = recording.units[k].sensitivity_lsb_per_g;
    }
    Ok(CalibratedArray { geometry, calibration, findings })
}

/// The model of a sensor in its own axes from that in body axes: with R from sensor to body axes, b ← Rᵀ b,
/// A ← Rᵀ A R, equation (107).
fn in_own_axes(sensor: &ArraySensor, model: &ErrorModel) -> Result<ErrorModel> {
    // Of 0, e_x, e_y, e_z in the sensor's axes.
    let output = |own: [f64; 3]| -> [f64; 3] {
        let body = sensor.in_body_axes(own);
        let out = model.distort(SpecificForceMps2(body), None).0;
        sensor.axes.map(|axis| (0..3).map(|i| axis[i] * out[i]).sum())
    };
    let bias_mps2 = output([0.0; 3]);
    let columns: [[f64; 3]; 3] = std::array::from_fn(|j| {
        let mut unit = [0.0; 3];
        unit[j] = 1.0;
        let along = output(unit);
        std::array::from_fn(|i| along[i] - bias_mps2[i])
    });
    ErrorModel::new(ErrorTerms {
        bias_mps2,
        matrix: std::array::from_fn(|i| std::array::from_fn(|j| columns[j][i])),
        ..ErrorTerms::default()
    })
    .map_err(|error| {
        Code::DataRefused.error(
            error.to_string(),
            "check the sensor, the sensitivity and the axes of the geometry",
        )
    })
}
