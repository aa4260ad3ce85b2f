//! The gyroscope of a multi-position session, and its report.

use serde_json::{Value, json};
use wimu_calib::{
    AccelerometerCalibration, Estimate, GyroscopeEstimate, GyroscopeSession, Pose, Reason, Refusal,
    TurnFault,
};
use wimu_model::{GyroscopeParameters, STANDARD_GRAVITY_MPS2};

use super::report::AXES;
use crate::digits::{signed_with_sd, significant, with_sd};
use crate::plural::counted;
use crate::recording::{Samples, Track, Unit};
use crate::{Code, Problem};

/// Full-scale range, °/s, of a gyroscope whose output came in °/s or rad/s: the largest usual one.
const USUAL_DPS: f64 = 2000.0;
/// A scale factor farther from 1 is beyond the tolerance of any gyroscope.
const TOLERANCE: f64 = 0.1;
/// Largest departure of a scale factor from 1 at which a usual sensitivity is taken: counterfeits are 10 % off.
const USABLE: f64 = 0.16;
/// Usual sensitivities, LSB per °/s: of ±250 to ±2000 °/s by InvenSense, of ±245 to ±2000 °/s by ST (datasheets of MPU-6050,
/// LSM6DSO), and of the ITG-3200.
const USUAL_LSB_PER_DPS: [f64; 9] =
    [131.0, 65.5, 32.8, 16.4, 1e3 / 8.75, 1e3 / 17.5, 1e3 / 35.0, 1e3 / 70.0, 14.375];
/// Counts of 16 bits from which on an axis may be clipped.
const LARGEST_COUNT: f64 = 32_700.0;
/// Where A and G begin among the parameters of an estimate, each row by row; before them is the bias.
const MATRIX: usize = 3;
const G_SENSITIVITY: usize = 12;

/// Calibrates the gyroscope of `data`, of which `poses` are the rests, m/s², at `mps2` m/s² per unit. With the
/// parameters for a board; `None` without a gyroscope or with findings only.
pub(super) fn calibrate(
    data: &Samples<'_>,
    mps2: f64,
    poses: &[Pose],
    accelerometer: &Estimate,
    findings: &mut Vec<Problem>,
) -> Option<(GyroscopeEstimate, Option<GyroscopeParameters>)> {
    let track = data.rate.filter(|_| !data.poses)?;
    let kept = |(k, pose): (usize, &Pose)| (!accelerometer.rejected.contains(&k)).then_some(*pose);
    let poses = Vec::from_iter(poses.iter().enumerate().filter_map(kept));
    let fit = fit(data, track, mps2, &poses, &AccelerometerCalibration::from(accelerometer));
    let Fit { estimate, turning, lsb } = fit.map_err(|problem| findings.push(problem)).ok()?;
    if let (Unit::Counts { si_per_lsb: None } | Unit::Unknown, Some(rad_s)) = (track.info.unit, lsb)
    {
        let lsb_per_dps = 1.0 / rad_s.to_degrees();
        findings.push(Code::UnitInferred.note(format!(
            "gyroscope: {lsb_per_dps:.1} LSB per °/s fits its counts, of the usual sensitivities"
        )));
    }
    if turning > 0 {
        findings.push(Code::PosesLeftOut.note(format!(
            "gyroscope: {} left out, in which the sensor rotated about the vertical",
            counted(turning, "pose")
        )));
    }
    let range_dps = track.info.full_scale.map_or(USUAL_DPS, f64::to_degrees).round();
    let rad_s_per_lsb = lsb.unwrap_or(range_dps.to_radians() / 32_768.0);
    let parameters = estimate.parameters(range_dps.clamp(1.0, 65_535.0) as u16, rad_s_per_lsb);
    if let Err(error) = &parameters {
        findings.push(refused(Code::Uncalibrated, &error.to_string()));
    }
    findings.extend(remarks(&estimate));
    Some((estimate, parameters.ok()))
}

/// An estimate, the number of poses that were left out, and rad/s of a count, of data in counts.
struct Fit {
    estimate: GyroscopeEstimate,
    turning: usize,
    lsb: Option<f64>,
}

/// The estimate in the unit of the data; of counts without one, at the usual sensitivity that fits best. Errors are findings.
fn fit(
    data: &Samples<'_>,
    track: &Track,
    mps2: f64,
    poses: &[Pose],
    accelerometer: &AccelerometerCalibration,
) -> Result<Fit, Problem> {
    let estimate = |rad_s: f64, lsb: Option<f64>| {
        let samples = data.six_axis(track, mps2, rad_s);
        let full_scale_rad_s = track.info.full_scale.or(lsb.map(|lsb| LARGEST_COUNT * lsb));
        let found = at_rests(poses.to_vec(), |poses| {
            GyroscopeSession { poses, samples: &samples, accelerometer, full_scale_rad_s }
                .estimate()
        });
        found.map(|(estimate, turning)| Fit { estimate, turning, lsb })
    };
    let found = match track.info.unit {
        Unit::Si => estimate(1.0, None),
        Unit::Counts { si_per_lsb: Some(rad_s) } => estimate(rad_s, Some(rad_s)),
        _ => match usual(|rad_s| estimate(rad_s, Some(rad_s))) {
            Ok(found) => Ok(found),
            Err(Some(axes)) => Err(axes),
            Err(None) => {
                let text = "the gyroscope is not calibrated: its unit is not known, and no usual sensitivity fits";
                let remedy = "name the unit in its columns: deg/s or rad/s";
                return Err(Code::Uncalibrated.note(text).remedy(remedy));
            }
        },
    };
    found.map_err(|refusal| {
        // Axes that differ are found: they are not undetectable.
        let is_axes = refusal.reason == Reason::Axes;
        let code = if is_axes { Code::Axes } else { Code::Uncalibrated };
        refused(code, &refusal.to_string())
    })
}

fn refused(code: Code, reason: &str) -> Problem {
    code.warning(format!("the gyroscope is not calibrated. {reason}"))
}

/// The estimate without the poses in which the gyroscope shows a rotation, at most one of five, and their number.
fn at_rests(
    mut poses: Vec<Pose>,
    estimate: impl Fn(&[Pose]) -> Result<GyroscopeEstimate, Refusal>,
) -> Result<(GyroscopeEstimate, usize), Refusal> {
    let most = poses.len() / 5;
    let mut turning = 0;
    loop {
        match estimate(&poses) {
            Err(Refusal { reason: Reason::Moved { index: rest }, .. }) if turning < most => {
                poses.remove(rest);
                turning += 1;
            }
            found => return found.map(|found| (found, turning)),
        }
    }
}

/// The estimate at the usual sensitivity that fits best: of those with scale factors within the tolerance, else of the usable
/// ones, the one with the smallest error after turns. If none fits, the refusal of a sensitivity at which only the axes differ.
fn usual(estimate: impl Fn(f64) -> Result<Fit, Refusal>) -> Result<Fit, Option<Refusal>> {
    let off = |fit: &Fit| {
        let matrix = fit.estimate.model.terms().matrix;
        (0..3).map(|axis| (matrix[axis][axis] - 1.0).abs()).fold(0.0, f64::max)
    };
    let (mut fits, mut axes) = (Vec::new(), None);
    for lsb_per_dps in USUAL_LSB_PER_DPS {
        match estimate((1.0 / lsb_per_dps).to_radians()) {
            Ok(found) if off(&found) < USABLE => fits.push(found),
            Err(refusal) if refusal.reason == Reason::Axes => axes = Some(refusal),
            _ => {}
        }
    }
    let best = fits.into_iter().min_by(|a, b| {
        let [far_a, far_b] = [a, b].map(|fit| off(fit) >= TOLERANCE);
        far_a.cmp(&far_b).then(a.estimate.rms_rad.total_cmp(&b.estimate.rms_rad))
    });
    best.ok_or(axes)
}

fn remarks(estimate: &GyroscopeEstimate) -> Vec<Problem> {
    let left_out = estimate.left_out.iter().map(|&(rest, fault)| {
        let code = match fault {
            TurnFault::Saturated { .. } => Code::Saturated,
            _ => Code::SamplesLeftOut,
        };
        code.warning(format!("gyroscope: the turn after rest {rest} (from 0) is left out: {fault}"))
    });
    let matrix = estimate.model.terms().matrix;
    let far = (0..3).filter(|axis| (matrix[*axis][*axis] - 1.0).abs() > TOLERANCE);
    let far = far.map(|axis| {
        let scale = matrix[axis][axis];
        let finding = Code::Datasheet.warning(format!(
            "gyroscope: scale factor {} = {scale:.3} is beyond the tolerance of a gyroscope",
            AXES[axis]
        ));
        finding.remedy("check the sensitivity and the full-scale range")
    });
    left_out.chain(far).collect()
}

/// The numbers of an estimate: its bias is that at the last rest, standard deviations of what was not observed are those of
/// datasheets, half widths of 95 % intervals null.
pub(super) fn json(estimate: &GyroscopeEstimate) -> Value {
    let all = 0..estimate.covariance.len();
    let half_width = |i| estimate.observed(i).then(|| estimate.half_width_95(i));
    json!({
        "model": estimate.model.terms(),
        "sd": Vec::from_iter(all.clone().map(|i| estimate.sd(i))),
        "half_width_95": Vec::from_iter(all.map(half_width)),
        "turns": estimate.turns,
        "before_deg": estimate.before_rad.to_degrees(),
        "rms_deg": estimate.rms_rad.to_degrees(),
        "advice": estimate.advice(),
    })
}

/// An estimate as text.
pub(super) fn lines(estimate: &GyroscopeEstimate) -> Vec<String> {
    let terms = estimate.model.terms();
    let mut lines = Vec::new();
    for (axis, name) in AXES.into_iter().enumerate() {
        let [bias, sd] = [terms.bias_rad_s[axis], estimate.sd(axis)].map(f64::to_degrees);
        let (i, bias) = (MATRIX + 4 * axis, signed_with_sd(bias, sd));
        let scale = if estimate.observed(i) {
            with_sd(terms.matrix[axis][axis], estimate.sd(i))
        } else {
            format!("not observed, taken as 1 ± {:.2}", estimate.sd(i))
        };
        lines.push(format!("gyroscope {name}: bias {bias} °/s, scale factor {scale}"));
    }
    let cells = || (0..9).map(|k| (k, k / 3, k % 3));
    let misaligned = cells().filter(|(k, r, c)| r != c && estimate.observed(MATRIX + k));
    let misaligned = Vec::from_iter(misaligned.map(|(k, r, c)| {
        let off = signed_with_sd(1e3 * terms.matrix[r][c], 1e3 * estimate.sd(MATRIX + k));
        format!("m_{}{} {off}", AXES[c].to_lowercase(), AXES[r].to_lowercase())
    }));
    if !misaligned.is_empty() {
        lines.push(format!("gyroscope misalignment, mrad: {}", misaligned.join(", ")));
    }
    let size = |(_, r, c): &(usize, usize, usize)| terms.g_sensitivity[*r][*c].abs();
    let observed = cells().filter(|(k, ..)| estimate.observed(G_SENSITIVITY + k));
    if let Some(cell) = observed.max_by(|a, b| size(a).total_cmp(&size(b))) {
        let [largest, sd] = [size(&cell), estimate.sd(G_SENSITIVITY + cell.0)]
            .map(|value| (value * STANDARD_GRAVITY_MPS2).to_degrees());
        let largest = with_sd(largest, sd);
        lines.push(format!("gyroscope g-sensitivity: at most {largest} °/s per g"));
    }
    if estimate.turns > 0 {
        let [before, after] =
            [estimate.before_rad, estimate.rms_rad].map(|rad| significant(rad.to_degrees(), 3));
        let turns = counted(estimate.turns, "turn");
        lines.push(format!(
            "direction of gravity after a turn: error {before}° rms before, {after}° after ({turns})"
        ));
    }
    lines.extend(estimate.advice().map(|advice| format!("to improve the gyroscope: {advice}")));
    lines
}
