//! Calibration 651d5c66 of a ±4 g accelerometer, exported by wimu.

use wimu_model::{
    Alignment, ErrorModel, ErrorTerms, GyroscopeModel, GyroscopeParameters, GyroscopeTemperatureTerms,
    GyroscopeTerms, ParameterSet, Sensitivity, TemperatureTerms,
};

/// The error model, y = b(T) + A(T) u: m/s², sensor axes.
pub const TERMS: ErrorTerms = ErrorTerms {
    bias_mps2: [0.125, -0.3, 0.51],
    matrix: [[1.01, 0.002, -0.003], [0.011, 0.985, 0.004], [-0.02, 0.005, 1.02]],
    temperature: TemperatureTerms {
        reference_c: 24.5,
        bias_mps2_per_k: [0.001, -0.002, 0.003],
        bias_mps2_per_k2: [1e-5, 0.0, -2e-5],
        scale_per_k: [0.0001, 0.0002, -0.0001],
    },
    nonlinearity: [1e-5, -2e-5, 0.0],
};

/// The parameter set for `wimu_model::Corrector`; `None` is ruled out by the export.
pub fn parameters() -> Option<ParameterSet> {
    Some(ParameterSet {
        model: ErrorModel::new(TERMS).ok()?,
        alignment: Alignment::try_from([0.9233805168766387, 0.10259783520851541, -0.20519567041703082, 0.3077935056255462]).ok()?,
        gyroscope: Some(gyroscope()?),
        ..ParameterSet::uncalibrated(4, Sensitivity::from_lsb_per_g(8192.0).ok()?)
    })
}

/// The gyroscope, for `wimu_model::GyroscopeCorrector`; `None` is ruled out by the export.
pub fn gyroscope() -> Option<GyroscopeParameters> {
    let model = GyroscopeModel::new(GyroscopeTerms {
        bias_rad_s: [0.01, -0.02, 0.03],
        matrix: [[0.99, 0.003, -0.001], [-0.004, 1.02, 0.002], [0.005, -0.006, 1.01]],
        g_sensitivity: [[0.0001, 0.0002, 0.0], [0.0, -0.0001, 0.0003], [1e-5, 0.0, 0.0002]],
        temperature: GyroscopeTemperatureTerms {
            reference_c: 22.0,
            bias_rad_s_per_k: [0.0001, -0.0002, 0.0003],
            scale_per_k: [0.0001, 0.0, -0.0001],
        },
    });
    GyroscopeParameters::new(500, 0.000305, model.ok()?, Some([0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001])).ok()
}
