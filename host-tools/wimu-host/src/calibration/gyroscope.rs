//! The gyroscope of a multi-position session, and its report.

use std::fmt;

use serde::Serialize;
use wimu_calib::{
    AccelerometerCalibration, Estimate, GyroscopeEstimate, GyroscopeSession, Pose, Reason, Refusal,
    TurnFault,
};
use wimu_model::{GyroscopeParameters, GyroscopeTerms, STANDARD_GRAVITY_MPS2};

use crate::digits::{signed_with_sd, significant, with_sd};
use crate::plural::counted;
use crate::recording::{Samples, Unit};
use crate::{Code, Problem};

/// Full-scale range, °/s, of a gyroscope whose output came in °/s or rad/s: the largest usual one.
const USUAL_DPS: f64 = 2000.0;
/// A scale factor farther from 1 is beyond the tolerance of any gyroscope.
const TOLERANCE: f64 = 0.1;
const AXES: [&str; 3] = ["X", "Y", "Z"];
/// Where A and G begin among the parameters.
const MATRIX: usize = 3;
const G_SENSITIVITY: usize = 12;

/// The errors of the gyroscope: parameters in the order bias X, Y, Z, A row by row, G row by row.
#[derive(Clone, Debug, Serialize)]
pub struct GyroscopeReport {
    /// The error model; the bias is that at the last rest.
    pub model: GyroscopeTerms,
    /// Standard deviations, rad/s, 1, rad/s per m/s²; those of datasheets for what was not observed.
    pub sd: Vec<f64>,
    /// Half widths of the 95 % intervals; null for what was not observed.
    pub half_width_95: Vec<Option<f64>>,
    /// Number of turns used.
    pub turns: usize,
    /// Error of the direction of gravity after a turn, ° rms, uncalibrated and corrected.
    pub before_deg: f64,
    /// Corrected.
    pub rms_deg: f64,
    /// What would improve the result most.
    pub advice: Option<String>,
    /// The parameters for a board.
    #[serde(skip)]
    pub parameters: Option<GyroscopeParameters>,
}

/// Calibrates the gyroscope of `data`, of which `poses` are the rests, m/s², at `mps2` m/s² per unit. `None` without a
/// gyroscope or with findings only.
pub(super) fn calibrate(
    data: &Samples<'_>,
    mps2: f64,
    poses: &[Pose],
    accelerometer: &Estimate,
    findings: &mut Vec<Problem>,
) -> Option<GyroscopeReport> {
    let track = data.rate.filter(|_| !data.poses)?;
    let full_scale = track.info.full_scale;
    let (si, lsb) = match track.info.unit {
        Unit::Si => (1.0, None),
        Unit::Counts { si_per_lsb: Some(si) } => (si, Some(si)),
        _ => {
            let finding =
                Code::Uncalibrated.note("the gyroscope is not calibrated: its unit is not known");
            findings.push(finding.remedy("name the unit in its columns: deg/s or rad/s"));
            return None;
        }
    };
    let samples = data.six_axis(track, mps2, si);
    let kept = |(k, pose): (usize, &Pose)| (!accelerometer.rejected.contains(&k)).then_some(*pose);
    let poses: Vec<Pose> = poses.iter().enumerate().filter_map(kept).collect();
    let accelerometer = AccelerometerCalibration::from(accelerometer);
    let full_scale_rad_s = full_scale.or(lsb.map(|lsb| 32_700.0 * lsb));
    let refused = |reason: String| {
        Code::Uncalibrated.warning(format!("the gyroscope is not calibrated: {reason}"))
    };
    let estimate = at_rests(poses, |poses| {
        let session = GyroscopeSession {
            poses,
            samples: &samples,
            accelerometer: &accelerometer,
            full_scale_rad_s,
        };
        session.estimate()
    });
    let (estimate, turning) = match estimate {
        Ok(found) => found,
        Err(refusal) => {
            findings.push(refused(refusal.to_string()));
            return None;
        }
    };
    if turning > 0 {
        findings.push(Code::PosesLeftOut.note(format!(
            "gyroscope: {} left out, in which the sensor rotated about the vertical",
            counted(turning, "pose")
        )));
    }
    let range_dps = full_scale.map_or(USUAL_DPS, f64::to_degrees).round();
    let rad_s_per_lsb = lsb.unwrap_or(range_dps.to_radians() / 32_768.0);
    let parameters = estimate.parameters(range_dps.clamp(1.0, 65_535.0) as u16, rad_s_per_lsb);
    if let Err(error) = &parameters {
        findings.push(refused(error.to_string()));
    }
    findings.extend(remarks(&estimate));
    let all = || 0..estimate.covariance.len();
    let half_width = |i| estimate.observed(i).then(|| estimate.half_width_95(i));
    Some(GyroscopeReport {
        model: *estimate.model.terms(),
        sd: all().map(|i| estimate.sd(i)).collect(),
        half_width_95: all().map(half_width).collect(),
        turns: estimate.turns,
        before_deg: estimate.before_rad.to_degrees(),
        rms_deg: estimate.rms_rad.to_degrees(),
        advice: estimate.advice().map(|advice| advice.to_string()),
        parameters: parameters.ok(),
    })
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

impl GyroscopeReport {
    fn is_observed(&self, parameter: usize) -> bool {
        self.half_width_95.get(parameter).is_some_and(Option::is_some)
    }
}

impl fmt::Display for GyroscopeReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sd = |i: usize| self.sd.get(i).copied().unwrap_or_default();
        for (axis, name) in AXES.into_iter().enumerate() {
            let [bias, bias_sd] = [self.model.bias_rad_s[axis], sd(axis)].map(f64::to_degrees);
            let bias = signed_with_sd(bias, bias_sd);
            write!(out, "gyroscope {name}: bias {bias} °/s, scale factor ")?;
            let (i, scale) = (MATRIX + 4 * axis, self.model.matrix[axis][axis]);
            match self.is_observed(i) {
                true => writeln!(out, "{}", with_sd(scale, sd(i)))?,
                false => writeln!(out, "not observed, taken as 1 ± {:.2}", sd(i))?,
            }
        }
        let cells = || (0..9).map(|k| (k, k / 3, k % 3));
        let misaligned: Vec<String> = cells()
            .filter(|(k, r, c)| r != c && self.is_observed(MATRIX + k))
            .map(|(k, r, c)| {
                let off = signed_with_sd(1e3 * self.model.matrix[r][c], 1e3 * sd(MATRIX + k));
                format!("m_{}{} {off}", AXES[c].to_lowercase(), AXES[r].to_lowercase())
            })
            .collect();
        if !misaligned.is_empty() {
            writeln!(out, "gyroscope misalignment, mrad: {}", misaligned.join(", "))?;
        }
        let size = |(_, r, c): &(usize, usize, usize)| self.model.g_sensitivity[*r][*c].abs();
        let observed = cells().filter(|(k, ..)| self.is_observed(G_SENSITIVITY + k));
        if let Some(cell) = observed.max_by(|a, b| size(a).total_cmp(&size(b))) {
            let per_g = |value: f64| (value * STANDARD_GRAVITY_MPS2).to_degrees();
            let largest = with_sd(per_g(size(&cell)), per_g(sd(G_SENSITIVITY + cell.0)));
            writeln!(out, "gyroscope g-sensitivity: at most {largest} °/s per g")?;
        }
        if self.turns > 0 {
            let [before, after] = [self.before_deg, self.rms_deg].map(|deg| significant(deg, 3));
            let turns = counted(self.turns, "turn");
            writeln!(
                out,
                "direction of gravity after a turn: error {before}° rms before, {after}° after ({turns})"
            )?;
        }
        match &self.advice {
            Some(advice) => writeln!(out, "to improve the gyroscope: {advice}"),
            None => Ok(()),
        }
    }
}
