//! The numbers of an estimate in the form of the report.

use wimu_calib::{Estimate, Method, Parameter, Pose};
use wimu_model::{ErrorTerms, STANDARD_GRAVITY_MPS2, TemperatureTerms};

use super::range::Range;
use super::{DriftReport, Fit, OtherUnits, Source, StaticPose};

/// Largest number of poses that a report lists.
pub(super) const MAX_POSES: usize = 1000;

pub(super) fn numbers(estimate: &Estimate, range: Option<Range>) -> Fit {
    let known = range.filter(|range| range.source != Source::SixteenBits);
    let range_g = known.map(|range| range.g);
    let sd = estimate.sd();
    let bias = estimate.model.terms().bias_mps2;
    let matrix = estimate.model.terms().matrix;
    let of_sides = match estimate.method {
        Method::SixPosition { placement_sd_rad, revisit_sd_mps2, .. } => {
            Some((placement_sd_rad, revisit_sd_mps2))
        }
        _ => None,
    };
    Fit {
        fitted: estimate.fitted.iter().map(|p| p.to_string()).collect(),
        not_observed: estimate.not_observed().iter().map(|p| p.to_string()).collect(),
        dof: estimate.dof,
        rms_mm_s2: estimate.rms_mps2 * 1e3,
        fitted_rms_mm_s2: estimate.fitted_rms_mps2 * 1e3,
        max_mm_s2: estimate.max_mps2 * 1e3,
        loo_rms_mm_s2: estimate.loo_rms_mps2.map(|loo| loo * 1e3),
        loo_orientation_rms_mm_s2: estimate.loo_orientation_rms_mps2.map(|loo| loo * 1e3),
        orientations: estimate.orientations,
        condition: estimate.condition,
        worst_sd_mm_s2: estimate.worst_sd_mps2 * 1e3,
        coverage: estimate.coverage,
        temperature_c: estimate.temperature_c,
        temperature_range_c: estimate.temperature_range_c,
        drift: estimate.drift.map(|drift| DriftReport {
            change_m_s2: drift.change_mps2,
            sd_m_s2: estimate.term_sd.drift_mps2,
            span_s: drift.span_s,
        }),
        placement_sd_deg: of_sides.map(|(placement, _)| placement.to_degrees()),
        revisit_sd_mm_s2: of_sides.map(|(_, revisit)| revisit * 1e3),
        model: *estimate.model.terms(),
        sd: ErrorTerms {
            bias_mps2: sd.bias_mps2,
            matrix: sd.matrix,
            temperature: TemperatureTerms {
                reference_c: 0.0,
                bias_mps2_per_k: estimate.term_sd.bias_mps2_per_k,
                bias_mps2_per_k2: [0.0; 3],
                scale_per_k: estimate.term_sd.scale_per_k,
            },
            nonlinearity: estimate.term_sd.nonlinearity,
        },
        half_width_95: Parameter::ALL.map(|parameter| {
            let seen = !estimate.not_observed().contains(parameter);
            seen.then(|| estimate.half_width_95(parameter))
        }),
        units: OtherUnits {
            bias_mg: bias.map(|b| b * 1e3 / STANDARD_GRAVITY_MPS2),
            bias_percent_of_full_scale: range_g.map(|range_g| {
                bias.map(|b| b * 100.0 / (STANDARD_GRAVITY_MPS2 * f64::from(range_g)))
            }),
            scale_error_ppm: [0, 1, 2].map(|axis| (matrix[axis][axis] - 1.0) * 1e6),
        },
        covariance: *estimate.covariance.matrix(),
    }
}

/// The report of each pose.
pub(super) fn static_poses(poses: &[Pose], estimate: Option<&Estimate>) -> Vec<StaticPose> {
    if poses.len() > MAX_POSES {
        return Vec::new();
    }
    let one = |pose: &Pose| StaticPose {
        mean_m_s2: pose.mean_mps2,
        sd_m_s2: pose.sd_mps2,
        samples: pose.samples,
        first_sample: pose.first_sample,
        time_s: pose.time_s,
        temperature_c: pose.temperature_c,
        residual_mm_s2: estimate.map(|estimate| estimate.residual_mps2(pose) * 1e3),
    };
    poses.iter().map(one).collect()
}

/// Standard deviations of no terms.
pub(super) fn no_terms() -> ErrorTerms {
    ErrorTerms {
        matrix: [[0.0; 3]; 3],
        temperature: TemperatureTerms { reference_c: 0.0, ..TemperatureTerms::default() },
        ..ErrorTerms::default()
    }
}
