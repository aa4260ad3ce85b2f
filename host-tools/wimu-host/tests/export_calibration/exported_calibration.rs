//! Calibration 9a012514 of a ±4 g accelerometer, exported by wimu.

use wimu_model::{
    Alignment, ErrorModel, ErrorTerms, ParameterSet, Sensitivity, TemperatureTerms,
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
        ..ParameterSet::uncalibrated(4, Sensitivity::from_lsb_per_g(8192.0).ok()?)
    })
}
