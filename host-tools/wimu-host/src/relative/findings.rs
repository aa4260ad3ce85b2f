//! Findings and refusals: whether the alignment is accurate enough.

use super::engine::Pose;
use super::hinge::relative;
use super::{Hinge, RelativePath};
use crate::{Code, Problem};

/// Standard deviation of the axis up to which it is accurate enough, rad: 10° change an angle by 1 − cos 10° = 1.5 %.
const AXIS_RAD: f64 = 0.175;
/// Standard deviation of the angle up to which it is accurate enough, rad: 2°, a quarter of the accelerometers' error in motion.
const ANGLE_RAD: f64 = 0.035;
/// Root mean square of the relative rate across the axis over that along it, from which a joint is no hinge.
const NOT_A_HINGE: f64 = 0.5;

/// Normalised innovation squared over its degrees of freedom, mean, from which the joint contradicts the samples: the expectation
/// of a consistent filter.
const CONTRADICTS: f64 = 1.0;

impl Hinge {
    /// Whether the joint turns about one axis.
    pub fn is_a_hinge(&self) -> bool {
        self.across < NOT_A_HINGE
    }

    /// Largest standard deviation of the axis in either unit, rad.
    pub fn worst_sd_rad(&self) -> f64 {
        self.sd_rad[0].max(self.sd_rad[1])
    }
}

impl RelativePath {
    /// Whether axis and angle are accurate enough: standard deviations up to 10° and 2°, and a joint that explains the samples.
    pub fn is_accurate(&self) -> bool {
        let is_explained = self.joint_nis <= CONTRADICTS;
        is_explained
            && self.hinge.is_a_hinge()
            && self.hinge.worst_sd_rad() <= AXIS_RAD
            && self.median_sigma_rad() <= ANGLE_RAD
    }
}

/// Of a result.
pub(super) fn after(found: &RelativePath) -> Vec<Problem> {
    let mut findings = Vec::new();
    let (hinge, sigma_rad) = (&found.hinge, found.median_sigma_rad());
    let axis_deg = hinge.worst_sd_rad().to_degrees();
    if !hinge.is_a_hinge() {
        let percent = 100.0 * hinge.across;
        let evidence = format!(
            "the joint rotates about more than one axis: {percent:.0} % of the rate is across the main one"
        );
        let remedy = "the angle is that about the main axis; the quaternion has the whole rotation; a hinge is given by --setup hinge=[X,Y,Z]";
        findings.push(Code::NotObserved.warning(evidence).remedy(remedy));
    } else if hinge.worst_sd_rad() > AXIS_RAD {
        let evidence = format!("the hinge axis is known to {axis_deg:.1}° only (1 σ)");
        let remedy = "move the joint through its range several times, or give the axis: --setup hinge=[X,Y,Z]";
        findings.push(Code::NotObserved.warning(evidence).remedy(remedy));
    }
    if found.joint_nis > CONTRADICTS {
        let nis = found.joint_nis;
        let evidence = format!(
            "the accelerations of both units do not fit a common joint: NIS {nis:.1} (at most 1)"
        );
        let remedy = "the clocks differ (shake both bodies together once), a unit slips, or the bodies have no joint";
        findings.push(Code::Residuals.warning(evidence).remedy(remedy));
    }
    if sigma_rad > ANGLE_RAD {
        let evidence =
            format!("the angle is known to {:.1}° only (1 σ, median)", sigma_rad.to_degrees());
        let remedy = "rest for some seconds and move the joint in several directions";
        findings.push(Code::NotObserved.warning(evidence).remedy(remedy));
    }
    let lost = found.points.iter().filter(|point| !point.valid).count();
    if lost > 0 {
        let percent = 100.0 * lost as f64 / found.points.len() as f64;
        let evidence = format!(
            "{percent:.1} % of the points are in a gap of one of the recordings: not valid"
        );
        findings.push(Code::Rate.warning(evidence));
    }
    if found.is_accurate() {
        let evidence = format!(
            "the alignment is accurate enough: axis ± {axis_deg:.1}° (limit 10°), angle ± {:.1}° (limit 2°)",
            sigma_rad.to_degrees()
        );
        findings.push(Code::Axes.note(evidence));
    }
    findings
}

/// The heading is not unique.
pub(super) fn ambiguous() -> Problem {
    let evidence = "two headings of the second unit are equally probable";
    let remedy =
        "move the joint in several directions, or give the axis with --setup hinge=[X,Y,Z]";
    Code::NotObserved.warning(evidence).remedy(remedy)
}

/// The joint did not move.
pub(super) fn no_motion(poses: &[Pose]) -> Problem {
    let largest = poses.iter().map(|pose| relative(pose).norm()).fold(0.0, f64::max);
    Code::DataRefused.error(
        format!(
            "the joint hardly moves (largest relative rate {:.1} deg/s): its axis is not known",
            largest.to_degrees()
        ),
        "move the joint through its range several times, or give the axis: --setup hinge=[X,Y,Z]",
    )
}

/// The filter has no answer.
pub(super) fn no_answer() -> Problem {
    Code::DataRefused
        .error("no rotation explains the samples", "check units and axes of both recordings")
}
