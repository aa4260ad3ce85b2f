//! Single axes as an array: where each one is, which way it measures, and the motion that they show.

use serde::{Deserialize, Serialize};
use wimu_model::STANDARD_GRAVITY_MPS2;
use wimu_nav::array::{ArrayConfig, ArrayFilter, ArraySolver, ArrayState, Axis, Geometry, Roots};

use super::calibration::{BIAS_MPS2, LEAST_SCALE};
use super::motion::{AT_LIMIT_MPS2, followed, refused, with_room};
use super::{ArrayGeometry, ArrayRecording, RefineOptions};
use crate::inertial::Zupt;
use crate::stats::norm;
use crate::{Code, Result};

/// Noise and biases are those of the quietest stretch of so long, s.
const QUIET_S: f64 = 1.0;
/// Noise that coarse steps hide, m/s².
const LEAST_NOISE_MPS2: f64 = 1e-3;
/// What the axes show there may differ from gravity by, as a part of it.
const GRAVITY_SHARE: f64 = 0.2;

/// A sensing axis of its own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SingleAxis {
    /// Place of the sensing element, m, body axes.
    pub place_m: [f64; 3],
    /// Direction in which it measures, body axes, of any length.
    pub direction: [f64; 3],
    /// Name of its column without the unit; `Accelerometer 0`, … in the order of the axes where there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub column: Option<String>,
}

impl From<&Axis> for SingleAxis {
    fn from(axis: &Axis) -> Self {
        Self { place_m: axis.position_m, direction: axis.direction, column: None }
    }
}

impl SingleAxis {
    /// The column of axis `index` (from 0).
    pub(super) fn column_name(&self, index: usize) -> String {
        let default = || format!("Accelerometer {index}");
        self.column.clone().unwrap_or_else(default)
    }
}

/// What the filter knows after each sample of single axes ([`ArrayRecording::axes_from_csv`]), and what it met on the way.
/// They are not calibrated: what they show at the quietest second that no rest has says how wrong they are.
///
/// # Errors
/// `usage` for more than 48 axes; `data_refused` where they do not show ω̇ and s, or no gravity.
pub fn navigated_axes(
    recording: &ArrayRecording,
    geometry: &ArrayGeometry,
    known: &RefineOptions,
    zupt: Zupt,
) -> Result<(Vec<ArrayState<f64>>, Vec<String>)> {
    with_room!(geometry.axes.len().div_ceil(3), navigate(recording, geometry, known, zupt))
}

fn navigate<const M: usize>(
    recording: &ArrayRecording,
    geometry: &ArrayGeometry,
    known: &RefineOptions,
    zupt: Zupt,
) -> Result<(Vec<ArrayState<f64>>, Vec<String>)> {
    check_moving(recording, geometry)?;
    let quiet = Quiet::<M>::of(recording);
    let axes: Vec<Axis> = (geometry.axes.iter().zip(&quiet.noise_mps2))
        .map(|(axis, noise)| Axis {
            position_m: axis.place_m,
            direction: axis.direction,
            noise_mps2: *noise,
        })
        .collect();
    let axes = Geometry::<M>::from_axes(&axes).map_err(refused)?;
    let solver = ArraySolver::<f64, M>::new(&axes).map_err(refused)?;
    let linear = solver.reduce(&quiet.mean_mps2);
    let (turn, force) = linear.theta.split_at(3);
    let gravity = norm(force);
    if (gravity / STANDARD_GRAVITY_MPS2 - 1.0).abs() > GRAVITY_SHARE {
        return Err(Code::DataRefused.error(format!("where the axes are quietest they show {gravity:.2} m/s², which is not gravity"),
            "check the unit in the columns' names (g, m/s², LSB), --sensitivity, and the directions of the axes",
        )
        .at(&recording.name));
    }
    // In units of the noise's variance: ω̇ and z of a rest are none, |s| is gravity.
    let covariance = solver.covariance();
    let of_turn = (0..3).map(|i| turn[i] * turn[i] / covariance[i][i]);
    let of_force = (gravity - STANDARD_GRAVITY_MPS2).powi(2) / covariance[3][3];
    let of_z = linear.z.iter().map(|z| z * z);
    let squares = of_turn.chain([of_force]).chain(of_z).sum::<f64>();
    let square = squares * solver.variance_mps2() / (4 + solver.rank()) as f64;
    let bias_mps2 = square.sqrt().max(BIAS_MPS2);
    // In one orientation a bias and an error of scale are one.
    let scale = (square.sqrt() / STANDARD_GRAVITY_MPS2).max(LEAST_SCALE);
    let config = ArrayConfig {
        rests: zupt.rests(),
        range_mps2: AT_LIMIT_MPS2,
        bias_mps2,
        scale,
        place_sd_m: known.place_sd_m,
        delay_sd_s: known.delay_sd_s,
        ..ArrayConfig::default()
    };
    let filter = ArrayFilter::<M>::new(axes, config).map_err(refused)?;
    let (states, mut remarks) =
        followed(recording, filter, zupt, &|_| true, |_, index, _| output::<M>(recording, index));
    remarks.push(format!(
        "{} uncalibrated single axes: as they show where they are quietest, biases of ± {bias_mps2:.3} m/s² and \
         sensitivities and directions wrong by ± {:.2} % are allowed for",
        geometry.axes.len(),
        100.0 * scale
    ));
    match solver.roots() {
        Roots::None | Roots::Partial => remarks.push(
            "these axes do not show the angular rate itself: it is what its derivative adds up to since the last rest, and is \
             known the less the longer that is ago"
                .to_owned(),
        ),
        Roots::Four => remarks.push(
            "all axes are in one plane: a turn and its mirror image look alike until time tells".to_owned(),
        ),
        Roots::Two => {}
    }
    Ok((states, remarks))
}

/// Refuses axes whose output never moves while that of others does: no axis can stand in for one of so few.
fn check_moving(recording: &ArrayRecording, geometry: &ArrayGeometry) -> Result<()> {
    let never_moves = |axis: &usize| {
        let mut values =
            (recording.outputs.iter()).map(|row| row[*axis][0]).filter(|v| v.is_finite());
        let first = values.next();
        values.all(|v| Some(v) == first)
    };
    let count = geometry.axes.len();
    let dead: Vec<usize> = (0..count).filter(never_moves).collect();
    let (Some(first), true) = (dead.first(), dead.len() < count) else {
        return Ok(());
    };
    let names: Vec<String> = (dead.iter())
        .map(|axis| format!("`{}`", geometry.axes[*axis].column_name(*axis)))
        .collect();
    Err(Code::DataRefused
        .error(
            format!(
                "the output of {} never moves: axis {first} (from 0) is dead",
                names.join(", ")
            ),
            "check that sensor, its wires and its column; single axes do without none of them",
        )
        .at(&recording.name))
}

fn output<const M: usize>(recording: &ArrayRecording, index: usize) -> [f64; M] {
    let mut output = [0.0; M];
    let limited = recording.saturated[index];
    for (k, (slot, [value, ..])) in output.iter_mut().zip(&recording.outputs[index]).enumerate() {
        *slot = if limited >> k & 1 == 1 { AT_LIMIT_MPS2 } else { *value };
    }
    output
}

/// The stretch in which all axes together change least.
struct Quiet<const M: usize> {
    mean_mps2: [f64; M],
    noise_mps2: [f64; M],
}

impl<const M: usize> Quiet<M> {
    fn of(recording: &ArrayRecording) -> Self {
        let axes = recording.sensors().min(M);
        let rows = recording.outputs.len();
        let length = ((QUIET_S / recording.period_s()).ceil() as usize).clamp(2, rows.max(2));
        let mut quietest = Self { mean_mps2: [0.0; M], noise_mps2: [LEAST_NOISE_MPS2; M] };
        let mut least = f64::INFINITY;
        for window in recording.outputs.chunks_exact(length) {
            let mut one = Self { mean_mps2: [0.0; M], noise_mps2: [LEAST_NOISE_MPS2; M] };
            let mut sum = 0.0;
            for axis in 0..axes {
                let values = || window.iter().map(|row| row[axis][0]);
                let mean = values().sum::<f64>() / length as f64;
                let variance =
                    values().map(|v| (v - mean).powi(2)).sum::<f64>() / (length - 1) as f64;
                one.mean_mps2[axis] = mean;
                one.noise_mps2[axis] = variance.sqrt().max(LEAST_NOISE_MPS2);
                sum += variance;
            }
            // Not a number where an axis is missing.
            if sum < least {
                (least, quietest) = (sum, one);
            }
        }
        quietest
    }
}
