//! The static poses of a dataset, and checks of its unit.

use std::collections::HashSet;

use wimu_calib::{
    Gravity, Model, MultiPosition, Pose, Reason, Refusal, UnitHint, multi_position_with,
};

use super::saturation;
use crate::recording::{Output, OutputUnit, Samples};
pub(super) use crate::stats::{median, norm as magnitude};

/// Static poses at an assumed scale.
pub(super) struct Poses {
    pub poses: Vec<Pose>,
    /// m/s² per unit at which they were searched.
    pub scale: f64,
    /// An axis that was saturated in some of them.
    pub saturated: Option<usize>,
}

impl Poses {
    /// Removes poses that are exactly equal to an earlier one (a file joined to itself, or a logger that repeats).
    /// Returns their number.
    pub fn remove_repeated(&mut self) -> usize {
        let all = self.poses.len();
        let mut seen = HashSet::with_capacity(all);
        self.poses.retain(|pose| seen.insert(pose.mean_mps2.map(f64::to_bits)));
        all - self.poses.len()
    }

    /// Removes the pose after a rotation of `steps` that repeats the rotation's first step, if whole rotations remain.
    /// Returns their number.
    pub fn remove_closing(&mut self, steps: usize) -> usize {
        let mut kept = Vec::with_capacity(self.poses.len());
        let mut rest = self.poses.as_slice();
        while let Some((turn, after)) = rest.split_at_checked(steps) {
            kept.extend_from_slice(turn);
            let comes_back = after.first().is_some_and(|pose| same_orientation(&turn[0], pose));
            let is_over = !after.len().is_multiple_of(steps);
            rest = after.get(usize::from(is_over && comes_back)..).unwrap_or(&[]);
        }
        if !rest.is_empty() {
            return 0;
        }
        let closing = self.poses.len() - kept.len();
        self.poses = kept;
        closing
    }

    /// The poses at another scale.
    pub fn scaled(&self, scale: f64) -> Vec<Pose> {
        let change = scale / self.scale;
        let scaled = |pose: &Pose| Pose {
            mean_mps2: pose.mean_mps2.map(|axis| axis * change),
            sd_mps2: pose.sd_mps2.map(|axis| axis * change),
            rounding_sd_mps2: pose.rounding_sd_mps2.map(|axis| axis * change),
            ..*pose
        };
        self.poses.iter().map(scaled).collect()
    }
}

/// Cosine of 10°: poses closer than that have the same orientation.
const SAME_ORIENTATION_COS: f64 = 0.984_8;

pub(super) fn same_orientation(a: &Pose, b: &Pose) -> bool {
    let [a, b] = [a.mean_mps2, b.mean_mps2];
    let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
    dot > SAME_ORIENTATION_COS * magnitude(a) * magnitude(b)
}

pub(super) fn poses(data: &Samples<'_>, scale: f64, gravity_mps2: f64) -> Poses {
    let si = |value: [f64; 3]| value.map(|axis| axis * scale);
    let forces: Vec<[f64; 3]> = data.values().map(si).collect();
    let lsb_mps2 = matches!(data.unit, OutputUnit::Counts { .. }).then_some(scale);
    let poses: Vec<Pose> = if data.poses {
        let pose = |(index, output): (usize, Output)| Pose {
            samples: output.samples,
            temperature_c: output.temperature_c,
            first_sample: index as u64,
            // Without times no drift can be fitted.
            time_s: data.time_s(index).unwrap_or(0.0),
            ..Pose::from_mean(output.value.map(|axis| axis * scale))
        };
        data.iter().enumerate().map(pose).collect()
    } else {
        data.rests(&forces)
    };
    let mut saturated = saturation::full_scale(&forces, &poses, lsb_mps2);
    if data.poses {
        saturated = saturated.or_else(|| saturation::equal_ends(&poses, gravity_mps2));
    } else {
        saturated = saturated.or_else(|| saturation::at_rest(forces.into_iter(), &poses));
    }
    Poses { poses, scale, saturated }
}

/// A wrong unit of samples in which few poses were found: in it, noise looks like motion.
pub(super) fn wrong_unit(data: &Samples<'_>, found: &Poses, gravity: Gravity) -> Option<Refusal> {
    let known = match data.unit {
        OutputUnit::Mps2 => true,
        OutputUnit::Counts { nominal, .. } => nominal.is_some(),
    };
    if !known || data.poses || found.poses.len() > 3 {
        return None;
    }
    let mean_mps2 = median_magnitude(data) * found.scale;
    let hint = not_gravity(mean_mps2, gravity)?;
    Some(Refusal::unexpected_magnitude(mean_mps2, hint))
}

/// The likely unit of an output of this magnitude at rest, m/s², if it cannot be gravity.
fn not_gravity(mps2: f64, gravity: Gravity) -> Option<UnitHint> {
    let typical = Pose::from_mean([mps2, 0.0, 0.0]);
    let bias = MultiPosition { model: Model::Bias3, ..MultiPosition::default() };
    match multi_position_with(&[typical; 4], gravity, bias) {
        Err(Refusal { reason: Reason::Unit { hint, .. }, .. }) => Some(hint),
        _ => None,
    }
}

pub(super) fn median_magnitude(data: &Samples<'_>) -> f64 {
    median(data.values().map(magnitude)).filter(|median| *median > 0.0).unwrap_or(1.0)
}

pub(super) fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) =
        values.fold((0.0, 0.0), |(sum, count), value| (sum + value * value, count + 1.0));
    (count > 0.0).then(|| (sum / count).sqrt())
}
