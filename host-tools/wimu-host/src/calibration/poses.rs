//! Calibration with static poses, by the magnitude or the direction of gravity: from the samples to the report.

use std::collections::HashSet;

use wimu_calib::{
    Estimate, Gravity, Placement, Pose, Refusal, four_angle, multi_position, six_position,
    three_angle,
};
use wimu_model::{CalibrationMethod, STANDARD_GRAVITY_MPS2, Sensitivity};

use super::solution::Solution;
use super::{
    CalibrateOptions, CalibrationReport, SENSOR_LSB_PER_G, Source, checks, magnitude, median, steps,
};
use crate::plural::counted;
use crate::recording::{Output, OutputUnit, Samples};
use crate::{Code, Problem, Result};

/// Estimates the error model from a dataset.
///
/// Data that do not support an answer give a report with status `refused`, not an error.
///
/// # Errors
/// `usage` when an option is out of bounds.
pub fn calibrate(data: &Samples<'_>, options: &CalibrateOptions) -> Result<CalibrationReport> {
    let fitting = Fitting::new(options)?;
    let mut scale = Scale::of(data, options, fitting.gravity)?;
    let mut found = Poses::find(data, scale.mps2);
    let repeated = found.without_repetitions(options.method);
    options.check_sides(data, &found.poses)?;
    let mut fit = match checks::refusal(data, &found, fitting.gravity) {
        Some(refusal) => Err(refusal),
        None => fitting.of(&found.poses),
    };
    if let (Some(Source::Fit), Ok(estimate)) = (scale.source, &fit) {
        scale = scale.of_fit(estimate);
        found.rescale(scale.mps2);
        fit = fitting.of(&found.poses);
    }
    let range = range(data.unit, options.range_g, scale.of_board());
    let solution = Solution { data, options, fitting, scale, range, poses: found.poses, fit };
    Ok(solution.report(repeated))
}

/// What converts the data to m/s².
#[derive(Clone, Copy)]
pub(super) struct Scale {
    /// LSB/*g*; `None` for data in m/s² without a given one, and before the fit.
    pub lsb_per_g: Option<f64>,
    pub source: Option<Source>,
    /// m/s² of one unit.
    pub mps2: f64,
}

impl Scale {
    /// As given, else as the board says. Counts of unknown sensitivity: the median magnitude, mostly at rest, is taken as
    /// gravity at first.
    fn of(data: &Samples<'_>, options: &CalibrateOptions, gravity: Gravity) -> Result<Self> {
        let given = options.sensitivity_lsb_per_g;
        if let Some(given) = given.filter(|given| !SENSOR_LSB_PER_G.contains(given)) {
            let text = format!("{given} LSB/g is outside the range of sensors (1 to 67108864)");
            return Err(Code::Usage.error(text, "check --sensitivity"));
        }
        let (lsb_per_g, source) = match (given, data.unit) {
            (Some(_), _) => (given, Some(Source::Given)),
            (None, OutputUnit::Counts { nominal: Some(nominal), .. }) => {
                (Some(nominal.lsb_per_g()), Some(Source::Board))
            }
            (None, OutputUnit::Counts { .. }) => (None, Some(Source::Fit)),
            (None, OutputUnit::Mps2) => (None, None),
        };
        let mps2 = match (data.unit, lsb_per_g) {
            (OutputUnit::Mps2, _) => 1.0,
            (OutputUnit::Counts { .. }, Some(lsb_per_g)) => STANDARD_GRAVITY_MPS2 / lsb_per_g,
            (OutputUnit::Counts { .. }, None) => gravity.mps2() / median_magnitude(data),
        };
        Ok(Self { lsb_per_g, source, mps2 })
    }

    /// That at which the mean scale factor of an estimate is 1: scaling the counts scales A.
    fn of_fit(self, estimate: &Estimate) -> Self {
        let matrix = estimate.model.terms().matrix;
        let mean = (matrix[0][0] + matrix[1][1] + matrix[2][2]) / 3.0;
        let mps2 = self.mps2 / mean;
        Self { lsb_per_g: Some(STANDARD_GRAVITY_MPS2 / mps2), mps2, ..self }
    }

    /// As a board takes it.
    pub fn of_board(&self) -> Option<Sensitivity> {
        Sensitivity::from_lsb_per_g(self.lsb_per_g?).ok()
    }
}

/// A full-scale range, ± *g*, and its source: that of the data, else as given, else that of 16 bits at this sensitivity.
pub(super) fn range(
    unit: OutputUnit,
    given: Option<u8>,
    sensitivity: Option<Sensitivity>,
) -> Option<(u8, Source)> {
    let of_board = match unit {
        OutputUnit::Counts { range_g, .. } => range_g,
        OutputUnit::Mps2 => None,
    };
    let stated = of_board.map(|g| (g, Source::Board)).or(given.map(|g| (g, Source::Given)));
    stated.or_else(|| {
        // The power of two below it, with 10 % for the scale error of the sensor.
        let full_scale_g = 1.1 * 32768.0 / sensitivity?.lsb_per_g();
        Some((2_u8.pow((full_scale_g.log2().floor() as u32).min(7)), Source::SixteenBits))
    })
}

/// That a range was assumed.
pub(super) fn range_note(
    (range_g, source): (u8, Source),
    sensitivity: Sensitivity,
) -> Option<Problem> {
    if source != Source::SixteenBits {
        return None;
    }
    let text = format!(
        "the range is unknown: ±{range_g} g assumed (16 bits at {:.0} LSB/g); a board accepts the calibration at this range \
         only",
        sensitivity.lsb_per_g()
    );
    Some(Code::RangeAssumed.note(text).remedy("give the range with --range"))
}

/// Static poses at an assumed scale.
pub(super) struct Poses {
    pub poses: Vec<Pose>,
    /// m/s² per unit at which they were searched.
    pub scale: f64,
}

impl Poses {
    pub fn find(data: &Samples<'_>, scale: f64) -> Self {
        let si = |value: [f64; 3]| value.map(|axis| axis * scale);
        if !data.poses {
            let forces: Vec<[f64; 3]> = data.values().map(si).collect();
            return Self { poses: data.rests(&forces), scale };
        }
        let pose = |(index, output): (usize, Output)| Pose {
            samples: output.samples,
            temperature_c: output.temperature_c,
            first_sample: index as u64,
            // Without times no drift can be fitted.
            time_s: data.time_s(index).unwrap_or(0.0),
            ..Pose::from_mean(si(output.value))
        };
        Self { poses: data.iter().enumerate().map(pose).collect(), scale }
    }

    /// Removes poses that add nothing: exactly equal to an earlier one (a file joined to itself, or a logger that repeats),
    /// or the first step of a rotation again.
    fn without_repetitions(&mut self, method: CalibrationMethod) -> Option<Problem> {
        let all = self.poses.len();
        let mut why = "exactly equal to an earlier pose";
        if let Some(steps) = steps(method) {
            why = "the rotation had returned to its first step";
            self.remove_closing(steps);
        } else if method == CalibrationMethod::MultiPosition {
            let mut seen = HashSet::with_capacity(all);
            self.poses.retain(|pose| seen.insert(pose.mean_mps2.map(f64::to_bits)));
        }
        let removed = all - self.poses.len();
        (removed > 0).then(|| {
            let count = counted(removed, "pose");
            let text = format!("{count} left out: {why}; pose numbers count only the others");
            Code::PosesLeftOut.note(text)
        })
    }

    /// Removes the pose after a rotation of `steps` that repeats the rotation's first step, if whole rotations remain.
    fn remove_closing(&mut self, steps: usize) {
        let mut kept = Vec::with_capacity(self.poses.len());
        let mut rest = self.poses.as_slice();
        while let Some((turn, after)) = rest.split_at_checked(steps) {
            kept.extend_from_slice(turn);
            let comes_back = after.first().is_some_and(|pose| turn[0].is_like(pose));
            let is_over = !after.len().is_multiple_of(steps);
            rest = after.get(usize::from(is_over && comes_back)..).unwrap_or(&[]);
        }
        if rest.is_empty() {
            self.poses = kept;
        }
    }

    fn rescale(&mut self, scale: f64) {
        let change = scale / self.scale;
        self.scale = scale;
        for pose in &mut self.poses {
            pose.mean_mps2 = pose.mean_mps2.map(|axis| axis * change);
            pose.sd_mps2 = pose.sd_mps2.map(|axis| axis * change);
            pose.rounding_sd_mps2 = pose.rounding_sd_mps2.map(|axis| axis * change);
        }
    }
}

/// Median magnitude of the data, 1 where that is 0.
pub(super) fn median_magnitude(data: &Samples<'_>) -> f64 {
    median(data.values().map(magnitude)).filter(|median| *median > 0.0).unwrap_or(1.0)
}

pub(super) fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) =
        values.fold((0.0, 0.0), |(sum, count), value| (sum + value * value, count + 1.0));
    (count > 0.0).then(|| (sum / count).sqrt())
}

/// How the model is fitted to poses.
pub(crate) struct Fitting<'a> {
    options: &'a CalibrateOptions,
    pub gravity: Gravity,
    pub gravity_source: Source,
    placement: Placement,
}

impl<'a> Fitting<'a> {
    /// As the options say.
    pub fn new(options: &'a CalibrateOptions) -> Result<Self> {
        let (gravity, gravity_source) = options.gravity()?;
        Ok(Self { options, gravity, gravity_source, placement: options.placement()? })
    }

    /// The estimate from poses at the nominal sensitivity.
    pub fn of(&self, poses: &[Pose]) -> Result<Estimate, Refusal> {
        let (gravity, options) = (self.gravity, self.options);
        match options.method {
            CalibrationMethod::SixPosition => {
                six_position(poses, options.sides.as_deref(), gravity, self.placement)
            }
            CalibrationMethod::FourAngle => four_angle(poses, gravity, self.placement),
            CalibrationMethod::ThreeAngle => three_angle(poses, gravity, self.placement),
            _ => multi_position(poses, gravity, options.multi_position()),
        }
    }
}
