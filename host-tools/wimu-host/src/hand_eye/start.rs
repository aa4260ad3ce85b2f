//! A first rotation of the camera: equation (203).

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::stream::PoseStream;
use crate::stats::cauchy_weights;

/// Interval over which rotations are compared, s: long against the noise, short against the drift of trackers.
const OVER_S: f64 = 2.0;
/// Step of these intervals, s.
const STEP_S: f64 = 0.1;
/// Least rotation about a second axis: second singular value over the first. 1e-4 is 0.6° beside 60°; the fit refuses by σ.
const SECOND_AXIS: f64 = 1e-4;
/// Reweighting steps.
const STEPS: usize = 20;

/// Camera axes to body axes from rotations over [`OVER_S`]: Wahba's problem by singular values (Markley 1988), with Cauchy
/// weights. The error says why there is none.
pub(super) fn rotation(
    camera: &PoseStream,
    body: &PoseStream,
    offset_s: f64,
) -> Result<UnitQuaternion<f64>, String> {
    let [from, to] = camera.span_s();
    let count = ((to - from - OVER_S) / STEP_S).max(0.0) as usize;
    let rotated = |stream: &PoseStream, time_s: f64| {
        let (a, b) = (stream.at(time_s)?, stream.at(time_s + OVER_S)?);
        Some((a.rotation.inverse() * b.rotation).scaled_axis())
    };
    let pair = |k: usize| {
        let time_s = from + k as f64 * STEP_S;
        Some((rotated(camera, time_s)?, rotated(body, time_s + offset_s)?))
    };
    let pairs: Vec<(Vector3<f64>, Vector3<f64>)> = (0..count).filter_map(pair).collect();
    let mut rotation = Rotation3::identity();
    let mut weights = vec![1.0; pairs.len()];
    for _ in 0..STEPS {
        let moments = pairs.iter().zip(&weights).map(|((c, b), w)| b * c.transpose() * *w);
        let svd = moments.sum::<Matrix3<f64>>().svd(true, true);
        let (Some(u), Some(v)) = (svd.u, svd.v_t) else {
            break;
        };
        let mut values: Vec<f64> = svd.singular_values.iter().copied().collect();
        values.sort_by(|a, b| b.total_cmp(a));
        if values[0].is_nan() || values[1] <= SECOND_AXIS * values[0] {
            return Err(
                "the body rotates about one axis only: rotate it about a second one, by 60° or more"
                    .to_owned(),
            );
        }
        let sign = (u * v).determinant().signum();
        let smallest = svd.singular_values.imin();
        let mut signs = Vector3::repeat(1.0);
        signs[smallest] = sign;
        rotation = Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&signs) * v);
        let errors: Vec<f64> = pairs.iter().map(|(c, b)| (b - rotation * c).norm()).collect();
        weights = cauchy_weights(&errors);
    }
    Ok(UnitQuaternion::from_rotation_matrix(&rotation))
}
