//! Whether the outputs of gyroscope and accelerometer belong together.

use alloc::format;

use nalgebra::{Matrix3, Vector3};

use super::rests::Session;
use crate::estimate::Residuals;
use crate::orientation::axis_name;
use crate::{Reason, Refusal, UnitHint};

/// Largest error of the predicted directions of an uncalibrated gyroscope, rad rms (23°): scale factors 10 % off over
/// 180°, and misalignment.
const PLAUSIBLE_RAD: f64 = 0.4;
/// An explanation must be better than the next one by this factor.
const CLEARLY: f64 = 0.6;
/// Output over angular rate with wrong units or a wrong full-scale range.
const FACTORS: [f64; 8] = [57.2958, 0.017_453_3, 2.0, 0.5, 4.0, 0.25, 8.0, 0.125];
/// Orders of the axes.
const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [1, 0, 2], [0, 2, 1], [2, 1, 0], [1, 2, 0], [2, 0, 1]];
/// Largest difference of a mean rate from that over the rests, rad/s: 6 °/s, three times a g-sensitivity
/// of 1 °/s per *g*; and of the specific force from the mean, relative.
const AT_REST_RAD_S: f64 = 0.1;
const AT_REST_SHARE: f64 = 0.1;

/// What the rests show beforehand.
#[derive(Clone, Copy)]
pub(super) struct Start {
    /// Mean output, rad/s.
    pub bias: Vector3<f64>,
    /// Variance of a sample, (rad/s)².
    pub sample_variance: f64,
}

/// Refuses rests that are none, and units and axes that do not predict the direction of gravity.
pub(super) fn plausible(session: &Session<'_>) -> Result<Start, Refusal> {
    let poses = session.given.poses;
    if let Some(rest) = poses.iter().position(|pose| session.rest(pose).is_none()) {
        let text = format!("Samples of rest {rest} (from 0) are missing or not finite. Remove it.");
        return Err(Refusal::new(Reason::Input { index: rest }, text));
    }
    if poses.is_empty() {
        let text = "No rest was found. Hold the sensor still for two seconds.";
        return Err(Refusal::new(Reason::TooFew { have: 0, need: 1 }, text));
    }
    let angles = session.angles(Matrix3::identity(), true);
    if angles.rms() > PLAUSIBLE_RAD {
        return Err(explanation(session).unwrap_or_else(|| inconsistent(&angles)));
    }
    let count = poses.len() as f64;
    let mean = |of: &dyn Fn(&super::rests::Rest) -> f64| {
        session.rests().map(|rest| of(&rest)).sum::<f64>() / count
    };
    let bias = session.rests().map(|rest| rest.rate).sum::<Vector3<f64>>() / count;
    let force = mean(&|rest| rest.force.norm());
    for (k, rest) in session.rests().enumerate() {
        let rate_rad_s = (rest.rate - bias).norm();
        let share = (rest.force.norm() / force - 1.0).abs();
        if rate_rad_s > AT_REST_RAD_S || share > AT_REST_SHARE {
            let text = format!(
                "The sensor was not at rest in rest {k} (from 0): it rotated by {:.1} °/s or accelerated. Put it down \
                 there.",
                rate_rad_s.to_degrees()
            );
            return Err(Refusal::new(Reason::Moved { index: k }, text));
        }
    }
    Ok(Start { bias, sample_variance: mean(&|rest| rest.rate_variance) })
}

/// The k-th wrong unit, or order and signs of the axes: from output to angular rate.
fn hypothesis(k: usize) -> Matrix3<f64> {
    if let Some(factor) = FACTORS.get(k) {
        return Matrix3::identity() / *factor;
    }
    let k = k - FACTORS.len() + 1;
    let order = ORDERS[k / 8 % 6];
    let sign = |axis: usize| if k >> axis & 1 == 1 { -1.0 } else { 1.0 };
    Matrix3::from_fn(|row, column| if order[row] == column { sign(row) } else { 0.0 })
}

/// The unit or the order of the axes that predicts the directions, if only one does.
fn explanation(session: &Session<'_>) -> Option<Refusal> {
    let (mut best, mut next) = ((f64::INFINITY, 0), f64::INFINITY);
    for k in 0..FACTORS.len() + 47 {
        let rms = session.angles(hypothesis(k), true).rms();
        if rms < best.0 {
            (best, next) = ((rms, k), best.0);
        } else {
            next = next.min(rms);
        }
    }
    let (rms, k) = best;
    if rms >= PLAUSIBLE_RAD || rms >= CLEARLY * next {
        return None;
    }
    let Some(factor) = FACTORS.get(k) else {
        return Some(other_axes(&hypothesis(k)));
    };
    let text = match *factor {
        50.0..65.0 => "The angular rates are 57.3 times too large, probably in deg/s. Name that unit (`--units deg/s`)."
            .into(),
        0.015..0.02 => "The angular rates are 57.3 times too small, probably in rad/s. Name that unit (`--units rad/s`)."
            .into(),
        _ => format!(
            "The angular rates are about {factor} times the rotation. Check the sensitivity and the full-scale range of the \
             gyroscope."
        ),
    };
    Some(Refusal::new(Reason::Unit { magnitude: rms, hint: UnitHint::Sensitivity }, text))
}

/// The refusal of axes that are exchanged or negated.
fn other_axes(matrix: &Matrix3<f64>) -> Refusal {
    let name = |axis: usize| {
        let of = matrix.row(axis).transpose().iamax();
        let sign = if matrix[(axis, of)] < 0.0 { "−" } else { "" };
        format!("{} = {sign}{}", axis_name(axis), axis_name(of))
    };
    let text = format!(
        "The axes of gyroscope and accelerometer differ: {}, {}, {} of the gyroscope. Correct order and signs in the driver \
         or the columns.",
        name(0),
        name(1),
        name(2)
    );
    Refusal::new(Reason::Axes, text)
}

/// The refusal of directions that are not predicted.
pub(super) fn inconsistent(angles: &Residuals) -> Refusal {
    let (rms, index) = (angles.rms(), angles.worst);
    let text = format!(
        "The rotations predict the direction of gravity to {:.1}° rms only, worst after rest {index} (from 0). Check units \
         and times, or rotate more slowly.",
        rms.to_degrees()
    );
    Refusal::new(Reason::PoorFit { rms, index }, text)
}
