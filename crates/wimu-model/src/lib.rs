#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod checksum;
mod compass;
mod compiled;
mod corrector;
mod covariance;
mod error;
mod error_model;
pub mod fixed;
mod gyroscope;
mod kernel;
mod magnetometer;
mod matrix;
mod parameters;
mod quality;
mod quantities;
pub mod root;

pub use compass::CompassTerms;
pub use compiled::{CompiledSet, SetError};
pub use corrector::{CompileError, Corrector, CorrectorParts};
pub use covariance::{CovarianceError, ModelCovariance, RotationCovariance};
pub use error::ModelError;
pub use error_model::{ErrorModel, ErrorTerms, TemperatureTerms};
pub use gyroscope::{
    GyroscopeCorrector, GyroscopeModel, GyroscopeTemperatureTerms, GyroscopeTerms,
};
pub use magnetometer::{MagnetometerModel, MagnetometerRotation, MagnetometerTerms};
pub use matrix::Matrix3;
pub use parameters::{
    Alignment, AlignmentError, GyroscopeParameters, ParameterId, ParameterSet, SensorId,
};
pub use quality::{
    CalibratedTemperature, CalibrationMethod, CalibrationQuality, QualityTerms, TermDeviations,
};
pub use quantities::{
    AngularRateQ20, CentiCelsius, Counts, DeviceTimeUs, MagneticFieldNt, PeriodNs, PositionNm,
    STANDARD_GRAVITY_MPS2, Sensitivity, SensitivityError, SpecificForceMps2, SpecificForceQ16,
    VelocityNmps, WideCounts,
};
