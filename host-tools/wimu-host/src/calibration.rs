//! From data to an error model, its report, and the file that goes to a board.

mod reference;
mod report;

pub use reference::{AxisReport, Paired, ReferenceReport, compare_with_reference};
pub use report::{
    CalibrationReport, Fit, HELD_SCHEMA, NextPose, Source, describe, read_parameters, write_report,
};

use wimu_calib::{
    Estimate, Face, Gravity, Method, Model, Orientation, Placement, Pose, Refusal, find_poses,
    multi_position, six_position,
};
use wimu_link::message::parameter_id;
use wimu_model::{ErrorTerms, ParameterSet, STANDARD_GRAVITY_MPS2, Sensitivity, TemperatureTerms};

use crate::dataset::{Dataset, OutputUnit};
use crate::error::{ErrorCode, HostError, Result};

/// More poses than anyone holds still for.
const MAX_POSES: usize = 1000;

/// How to estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum MethodChoice {
    /// From the magnitude of gravity, any orientations.
    #[default]
    MultiPosition,
    /// From six known orientations.
    SixPosition,
}

/// Which parameters to fit with [`MethodChoice::MultiPosition`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModelChoice {
    /// These.
    Fixed(Model),
    /// Those with the least leave-one-out error.
    Auto,
}

impl Default for ModelChoice {
    fn default() -> Self {
        Self::Fixed(Model::Full9)
    }
}

/// What a calibration is asked for.
#[derive(Clone, Copy, Debug, Default)]
pub struct CalibrateOptions {
    /// How to estimate.
    pub method: MethodChoice,
    /// What to fit.
    pub model: ModelChoice,
    /// Local gravity, m/s², taken as exact; 9.80665 ± 0.015 where it is not given.
    pub gravity_mps2: Option<f64>,
    /// Nominal sensitivity, LSB/g; else the board's, else the fit's mean.
    pub sensitivity_lsb_per_g: Option<f64>,
    /// How well known orientations were squared, degrees, 1 σ; 1 where it is not given.
    pub placement_sd_deg: Option<f64>,
    /// When, s since 1970 UTC: for the parameter set to say.
    pub utc_s: Option<u64>,
}

/// Static poses in the unit of their dataset.
struct Poses {
    poses: Vec<Pose>,
    /// m/s² per unit under which they were looked for.
    scale: f64,
}

impl Poses {
    /// The same at another scale.
    fn scaled(&self, scale: f64) -> Vec<Pose> {
        let change = scale / self.scale;
        let scaled = |pose: &Pose| Pose {
            mean_mps2: pose.mean_mps2.map(|axis| axis * change),
            sd_mps2: pose.sd_mps2.map(|axis| axis * change),
            ..*pose
        };
        self.poses.iter().map(scaled).collect()
    }
}

/// Estimates the error model from a dataset.
///
/// Data that do not support an answer give a report that says so, not an error.
///
/// # Errors
/// `usage` when an option is out of bounds.
pub fn calibrate(data: &Dataset, options: &CalibrateOptions) -> Result<CalibrationReport> {
    let usage = |message: String, flag: &str| {
        HostError::new(ErrorCode::Usage, message, format!("check {flag}"))
    };
    let (gravity, gravity_source) = match options.gravity_mps2 {
        Some(mps2) => (
            Gravity::new(mps2, 0.0).map_err(|e| usage(e.to_string(), "--gravity"))?,
            Source::Given,
        ),
        None => (Gravity::UNKNOWN_PLACE, Source::Default),
    };
    let placement = match options.placement_sd_deg {
        Some(degrees) => Placement::new(degrees.to_radians())
            .map_err(|e| usage(e.to_string(), "--placement-sd"))?,
        None => Placement::BY_HAND,
    };
    let given = options
        .sensitivity_lsb_per_g
        .map(Sensitivity::from_lsb_per_g)
        .transpose()
        .map_err(|e| usage(e.to_string(), "--sensitivity"))?;

    let (known, source) = match (given, data.unit) {
        (Some(given), _) => (Some(given), Some(Source::Given)),
        (None, OutputUnit::Counts { nominal, .. }) => match nominal {
            Some(nominal) => (Some(nominal), Some(Source::Board)),
            None => (None, Some(Source::Fit)),
        },
        (None, OutputUnit::Mps2) => (None, None),
    };
    // For counts of unknown worth the median output, most of it at rest, stands for g at first.
    let scale = match (data.unit, known) {
        (OutputUnit::Mps2, _) => 1.0,
        (OutputUnit::Counts { .. }, Some(known)) => known.mps2_per_lsb(),
        (OutputUnit::Counts { .. }, None) => gravity.mps2() / median_magnitude(data),
    };
    let found = poses(data, scale);
    let fit = |poses: &[Pose]| match options.method {
        MethodChoice::SixPosition => six_position(poses, gravity, placement),
        MethodChoice::MultiPosition => match options.model {
            ModelChoice::Fixed(model) => multi_position(poses, gravity, model),
            ModelChoice::Auto => best_model(poses, gravity),
        },
    };
    let mut fitted = found.poses.clone();
    let mut outcome = fit(&fitted);
    let mut sensitivity = known;
    let mut reason = None;
    if source == Some(Source::Fit)
        && let Ok(estimate) = &outcome
    {
        // Scaling counts scales A: with the mean scale factor taken out, it is 1.
        let matrix = estimate.model.terms().matrix;
        let mean = (matrix[0][0] + matrix[1][1] + matrix[2][2]) / 3.0;
        match Sensitivity::from_lsb_per_g(STANDARD_GRAVITY_MPS2 / scale * mean) {
            Ok(found_sensitivity) => {
                sensitivity = Some(found_sensitivity);
                fitted = found.scaled(found_sensitivity.mps2_per_lsb());
                outcome = fit(&fitted);
            }
            Err(error) => reason = Some(format!("the counts make no accelerometer: {error}")),
        }
    }

    let (estimate, refusal) = match outcome {
        Ok(estimate) if reason.is_none() => (Some(estimate), None),
        Ok(_) => (None, None),
        Err(refusal) => {
            reason = Some(refusal.to_string());
            (None, Some(refusal))
        }
    };
    let parameters = estimate
        .as_ref()
        .zip(sensitivity)
        .map(|(estimate, sensitivity)| ParameterSet {
            model: estimate.model,
            quality: estimate.quality(options.utc_s, &fitted),
            ..ParameterSet::uncalibrated(range_g(data.unit, sensitivity), sensitivity)
        });
    Ok(CalibrationReport {
        schema: CalibrationReport::SCHEMA,
        status: if estimate.is_some() { "ok" } else { "refused" },
        reason,
        source: data.name.clone(),
        method: match options.method {
            MethodChoice::MultiPosition => "multi-position",
            MethodChoice::SixPosition => "six-position",
        },
        terms: terms(estimate.as_ref().map(|e| e.method), options),
        poses: fitted.len(),
        rate_hz: (!data.poses).then_some(data.rate_hz),
        rate_source: (!data.poses).then_some(data.rate_source),
        gravity_m_s2: gravity.mps2(),
        gravity_sd_m_s2: gravity.sd_mps2(),
        gravity_source,
        sensitivity_lsb_per_g: sensitivity.map(Sensitivity::lsb_per_g),
        sensitivity_source: source.filter(|_| sensitivity.is_some()),
        uncalibrated_rms_mm_s2: rms(fitted
            .iter()
            .map(|pose| magnitude(pose.mean_mps2) - gravity.mps2()))
        .map(|rms| rms * 1e3),
        fit: estimate.map(|estimate| numbers(&estimate)),
        rejected_poses: match options.method {
            MethodChoice::MultiPosition => Vec::new(),
            MethodChoice::SixPosition => (0..fitted.len())
                .filter(|index| Face::of(&fitted[*index]).is_none())
                .collect(),
        },
        next_poses: refusal.map_or(Vec::new(), |refusal| next_poses(&refusal, &fitted)),
        parameter_id: parameters.as_ref().map(|set| parameter_id(set).to_string()),
        parameters,
    })
}

/// The model with the least leave-one-out error of those that the poses support.
fn best_model(poses: &[Pose], gravity: Gravity) -> Result<Estimate, Refusal> {
    let loo = |estimate: &Estimate| estimate.loo_rms_mps2.unwrap_or(f64::INFINITY);
    [Model::BiasScale6, Model::Bias3]
        .into_iter()
        .map(|model| multi_position(poses, gravity, model))
        .fold(
            multi_position(poses, gravity, Model::Full9),
            |best, other| match (&best, &other) {
                (Ok(a), Ok(b)) if loo(b) < loo(a) => other,
                (Err(_), Ok(_)) => other,
                _ => best,
            },
        )
}

fn poses(data: &Dataset, scale: f64) -> Poses {
    let poses = if data.poses {
        let pose = |(index, output): (usize, &crate::dataset::Output)| Pose {
            samples: output.samples,
            temperature_c: output.temperature_c,
            first_sample: index as u64,
            ..Pose::from_mean(output.value.map(|axis| axis * scale))
        };
        data.outputs.iter().enumerate().map(pose).collect()
    } else {
        // A sample that is no number ends a hold, as missing ones do.
        let samples = data.outputs.iter().flat_map(|output| {
            let gap = output.after_gap.then_some(([f64::NAN; 3], None));
            let sample = (output.value.map(|axis| axis * scale), output.temperature_c);
            gap.into_iter().chain([sample])
        });
        let mut poses = vec![Pose::default(); MAX_POSES];
        let found = find_poses(samples, data.rate_hz, &mut poses);
        poses.truncate(found);
        poses
    };
    Poses { poses, scale }
}

fn median_magnitude(data: &Dataset) -> f64 {
    let mut magnitudes: Vec<f64> = data
        .outputs
        .iter()
        .map(|output| magnitude(output.value))
        .collect();
    magnitudes.sort_by(f64::total_cmp);
    magnitudes
        .get(magnitudes.len() / 2)
        .copied()
        .filter(|median| *median > 0.0)
        .unwrap_or(1.0)
}

fn magnitude(vector: [f64; 3]) -> f64 {
    vector.iter().map(|axis| axis * axis).sum::<f64>().sqrt()
}

fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| {
        (sum + value * value, count + 1.0)
    });
    (count > 0.0).then(|| (sum / count).sqrt())
}

fn range_g(unit: OutputUnit, sensitivity: Sensitivity) -> u8 {
    match unit {
        OutputUnit::Counts {
            range_g: Some(range_g),
            ..
        } => range_g,
        _ => likely_range_g(sensitivity),
    }
}

/// The usual full-scale range of 16 bits at this sensitivity: the power of two below it, a tenth
/// allowed for the sensor's own scale error.
fn likely_range_g(sensitivity: Sensitivity) -> u8 {
    let full_scale_g = 1.1 * 32768.0 / sensitivity.lsb_per_g();
    2_u8.pow((full_scale_g.log2().floor() as u32).min(7))
}

fn terms(method: Option<Method>, options: &CalibrateOptions) -> &'static [&'static str] {
    let model = match (method, options.method, options.model) {
        (Some(Method::MultiPosition(model)), _, _) => model,
        (_, MethodChoice::SixPosition, _) => return &["bias", "scale", "misalignment_6"],
        (_, _, ModelChoice::Fixed(model)) => model,
        (_, _, ModelChoice::Auto) => Model::Full9,
    };
    match model {
        Model::Bias3 => &["bias"],
        Model::BiasScale6 => &["bias", "scale"],
        Model::Full9 => &["bias", "scale", "misalignment_3"],
    }
}

fn numbers(estimate: &Estimate) -> Fit {
    let sd = estimate.sd();
    Fit {
        dof: estimate.dof,
        rms_mm_s2: estimate.rms_mps2 * 1e3,
        max_mm_s2: estimate.max_mps2 * 1e3,
        loo_rms_mm_s2: estimate.loo_rms_mps2.map(|loo| loo * 1e3),
        condition: estimate.condition,
        temperature_c: estimate.temperature_c,
        model: *estimate.model.terms(),
        sd: ErrorTerms {
            bias_mps2: sd.bias_mps2,
            matrix: sd.matrix,
            ..no_terms()
        },
        covariance: *estimate.covariance.matrix(),
    }
}

/// Standard deviations of nothing.
fn no_terms() -> ErrorTerms {
    ErrorTerms {
        matrix: [[0.0; 3]; 3],
        temperature: TemperatureTerms {
            reference_c: 0.0,
            ..TemperatureTerms::default()
        },
        ..ErrorTerms::default()
    }
}

/// Poses that would help against this refusal.
fn next_poses(refusal: &Refusal, poses: &[Pose]) -> Vec<NextPose> {
    match *refusal {
        Refusal::NotObservable { add, .. } => vec![add.into()],
        // One more like the pose that decides alone.
        Refusal::PoorPrediction { pose, .. } => poses
            .get(pose)
            .map(nearest)
            .into_iter()
            .map(NextPose::from)
            .collect(),
        Refusal::PoseMissing { .. } => Face::ALL
            .into_iter()
            .filter(|face| poses.iter().all(|pose| Face::of(pose) != Some(*face)))
            .map(|face| Orientation::from(face).into())
            .collect(),
        Refusal::TooFewPoses { have, need, .. } => {
            let mut taken: Vec<[f64; 3]> = poses
                .iter()
                .map(|pose| {
                    let norm = magnitude(pose.mean_mps2);
                    pose.mean_mps2.map(|axis| axis / norm)
                })
                .collect();
            (have..need).map(|_| farthest(&mut taken).into()).collect()
        }
        _ => Vec::new(),
    }
}

/// The orientation that a pose is nearest to.
fn nearest(pose: &Pose) -> Orientation {
    let along = |orientation: &Orientation| -> f64 {
        orientation
            .up()
            .iter()
            .zip(pose.mean_mps2)
            .map(|(a, b)| a * b)
            .sum()
    };
    Orientation::ALL
        .into_iter()
        .max_by(|a, b| along(a).total_cmp(&along(b)))
        .unwrap_or(Face::ZUp.into())
}

/// The orientation farthest from all that are taken; takes it.
fn farthest(taken: &mut Vec<[f64; 3]>) -> Orientation {
    let nearness = |orientation: &Orientation| {
        let up = orientation.up();
        taken
            .iter()
            .map(|other| up.iter().zip(other).map(|(a, b)| a * b).sum())
            .fold(-1.0, f64::max)
    };
    // Faces before edges and corners where they are as far: they are easier to hold.
    let faces = Face::ALL.into_iter().map(Orientation::from);
    let mut best = (f64::INFINITY, Orientation::from(Face::ZUp));
    for orientation in faces.chain(Orientation::ALL) {
        let near = nearness(&orientation);
        if near < best.0 - 1e-9 {
            best = (near, orientation);
        }
    }
    taken.push(best.1.up());
    best.1
}

#[cfg(test)]
mod tests;
