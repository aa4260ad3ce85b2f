//! Whether the outputs of gyroscope and accelerometer belong together.

use nalgebra::{Matrix3, Vector3};

use super::GyroscopeRefusal;
use super::filter::Angles;
use super::rests::Session;

/// Largest error of the predicted directions of an uncalibrated gyroscope, rad rms (12°): 5 % of 180°,
/// and misalignment.
const PLAUSIBLE_RAD: f64 = 0.21;
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
pub(super) fn plausible(session: &Session<'_>) -> Result<Start, GyroscopeRefusal> {
    let poses = session.given.poses;
    if let Some(rest) = poses.iter().position(|pose| session.rest(pose).is_none()) {
        return Err(GyroscopeRefusal::NotFinite { rest });
    }
    if poses.is_empty() {
        return Err(GyroscopeRefusal::NoRest);
    }
    let angles = session.angles(Matrix3::identity(), true);
    if angles.rms_rad() > PLAUSIBLE_RAD {
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
            return Err(GyroscopeRefusal::NotAtRest { rest: k, rate_rad_s });
        }
    }
    Ok(Start { bias, sample_variance: mean(&|rest| rest.rate_variance) })
}

/// The unit or the order of the axes that predicts the directions, if only one does.
fn explanation(session: &Session<'_>) -> Option<GyroscopeRefusal> {
    let units =
        FACTORS.map(|factor| (Matrix3::identity() / factor, GyroscopeRefusal::Unit { factor }));
    let axes = (1..48).map(|k| {
        let order = ORDERS[k / 8 % 6];
        let axes = [0, 1, 2].map(|axis| (order[axis], k >> axis & 1 == 1));
        let matrix = Matrix3::from_fn(|row, column| {
            let (of, negated) = axes[row];
            let size = if negated { -1.0 } else { 1.0 };
            if of == column { size } else { 0.0 }
        });
        (matrix, GyroscopeRefusal::Axes { axes })
    });
    let mut best = (f64::INFINITY, f64::INFINITY, None);
    for (matrix, refusal) in units.into_iter().chain(axes) {
        let rms = session.angles(matrix, true).rms_rad();
        if rms < best.0 {
            best = (rms, best.0, Some(refusal));
        } else {
            best.1 = best.1.min(rms);
        }
    }
    let (rms, next, refusal) = best;
    refusal.filter(|_| rms < PLAUSIBLE_RAD && rms < CLEARLY * next)
}

/// The refusal of directions that are not predicted.
pub(super) fn inconsistent(angles: &Angles) -> GyroscopeRefusal {
    GyroscopeRefusal::Inconsistent { rms_rad: angles.rms_rad(), worst_turn: angles.worst_turn }
}
