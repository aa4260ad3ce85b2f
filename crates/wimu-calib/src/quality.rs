//! Quality record of an estimate, as stored on a device.

use wimu_model::{
    CalibratedTemperature, CalibrationQuality, ModelCovariance, QualityTerms, TermDeviations,
};

use crate::{Estimate, Pose, input};

impl Estimate {
    /// Quality record for a parameter set: estimated at `utc_s`, s since 1970 UTC, from `poses`,
    /// whose temperatures bound the calibrated range.
    ///
    /// `None` when a value exceeds the bounds of [`QualityTerms`], which valid estimates do not.
    pub fn quality(&self, utc_s: Option<u64>, poses: &[Pose]) -> Option<CalibrationQuality> {
        let temperatures = poses.iter().filter_map(|pose| pose.temperature_c);
        let [lowest, highest] = input::extremes(temperatures);
        let temperature = self.temperature_c.map(|mean| CalibratedTemperature {
            mean_c: mean as f32,
            lowest_c: lowest.min(mean) as f32,
            highest_c: highest.max(mean) as f32,
        });
        let [_, bias, scale, quadratic] = self.term_sd;
        CalibrationQuality::new(QualityTerms {
            method: self.method,
            utc_s,
            temperature,
            poses: u32::try_from(self.poses).unwrap_or(u32::MAX),
            dof: u32::try_from(self.dof).unwrap_or(u32::MAX),
            rms_mps2: self.fitted_rms_mps2 as f32,
            loo_rms_mps2: self.loo_rms_mps2.map(|loo| loo as f32),
            condition: Some(self.condition().max(1.0) as f32),
            covariance: ModelCovariance::from_matrix(self.covariance.matrix()).ok()?,
            other_sd: TermDeviations {
                bias_mps2_per_k: bias.map(|sd| sd as f32),
                bias_mps2_per_k2: [0.0; 3],
                scale_per_k: scale.map(|sd| sd as f32),
                nonlinearity: quadratic.map(|sd| sd as f32),
            },
        })
        .ok()
    }
}
