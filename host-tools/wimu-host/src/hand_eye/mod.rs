//! Pose of a camera in the axes of a body: rotation, translation and clock offset from the camera's poses and those of the body,
//! or inertial data. Equations (200) to (205) of docs/reference/equations.
//!
//! The method is the robot–world hand–eye calibration AX = YB (Zhuang, Roth & Sudhakar 1994; Strobl & Hirzinger 2006) as a
//! maximum-likelihood fit with Student weights. Each block of the recording has its own frame Y, so that a tracker may drift.
//! The scatter of the blocks gives the covariance (Birge ratio): white noise would make it too small.

mod fit;
mod report;
mod start;
mod stream;

use nalgebra::SMatrix;
use serde::Serialize;

pub use fit::Residual;
pub use stream::{PoseStream, StreamPose};

use crate::Code;
use crate::digits;
use crate::plural::counted;
use crate::problem::Outcome;
use fit::{Fit, Observation, SHARED, State};

/// Least time between two poses that are used, s: the errors of trackers are correlated over it.
const APART_S: f64 = 0.1;
/// Blocks of a recording: the fewest whose scatter gives a Birge ratio with 27 degrees of freedom or more.
const BLOCKS: usize = 5;
/// Longest block of a gyroscope, s: its bias is constant over it.
const INERTIAL_BLOCK_S: f64 = 5.0;
/// Fewest poses of a block.
const BLOCK_POSES: usize = 10;
/// A weight below this belongs to a pose beyond 5 σ in the rotation or in the position.
const CONTRADICTS: f64 = 0.25;
/// Correlation of the angular rates below which the streams may not belong together.
const CORRELATED: f64 = 0.5;

/// How to find the camera's pose.
#[derive(Clone, Copy, Debug)]
pub struct HandEyeOptions {
    /// Largest clock offset that is searched, s; `None`: any.
    pub offset_limit_s: Option<f64>,
    /// Largest standard deviation with which a translation is stated, m.
    pub translation_limit_m: f64,
    /// Largest standard deviation with which a rotation is stated, rad.
    pub rotation_limit_rad: f64,
}

impl Default for HandEyeOptions {
    /// Any offset, translations to 5 cm, rotations to 3°: what fusion of a camera and an IMU can start from.
    fn default() -> Self {
        Self {
            offset_limit_s: None,
            translation_limit_m: 0.05,
            rotation_limit_rad: 3.0_f64.to_radians(),
        }
    }
}

/// The pose of a camera in the body, or why there is none.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct HandEye {
    /// Whether there is a result, and what was noticed.
    #[serde(skip)]
    pub outcome: Outcome,
    /// The camera's stream and the body's.
    pub sources: [String; 2],
    /// Rotation from camera axes to body axes: w, x, y, z.
    pub quaternion: Option<[f64; 4]>,
    /// Its standard deviations about the camera's axes, rad.
    pub rotation_sd_rad: Option<[f64; 3]>,
    /// Camera in the body, m, body axes; `None` where the motion does not show it.
    pub translation_m: Option<[f64; 3]>,
    /// Its standard deviations, m.
    pub translation_sd_m: Option<[f64; 3]>,
    /// Time of the body's clock less that of the camera's, s, and its standard deviation.
    pub offset_s: Option<[f64; 2]>,
    /// Scale error of the camera's positions, and its standard deviation.
    pub scale: Option<[f64; 2]>,
    /// Covariance of rotation, rad, and translation, m, by rows.
    pub covariance: Option<[[f64; 6]; 6]>,
    /// Scatter of the blocks over that of white noise; σ includes it.
    pub birge_ratio: Option<f64>,
    /// Noise of a component: rotation, rad, and position, m.
    pub noise: Option<[f64; 2]>,
    /// Poses used, and those that contradict the others.
    pub poses: [usize; 2],
    /// Residual of each pose.
    #[serde(skip)]
    pub residuals: Vec<Residual>,
}

/// Finds the pose of `camera` in the axes of `body`.
///
/// # Errors
/// None: data that do not show it are a refusal in the [`Outcome`].
pub fn hand_eye(camera: &PoseStream, body: &PoseStream, options: &HandEyeOptions) -> HandEye {
    let mut report =
        HandEye { sources: [camera.name.clone(), body.name.clone()], ..HandEye::default() };
    let findings = camera.findings.iter().chain(&body.findings).cloned();
    report.outcome.findings.extend(findings);
    match solve(camera, body, options, &mut report.outcome) {
        Ok(fit) => report.state(fit, body.inertial, options),
        Err(reason) => report.outcome.refuse(reason),
    }
    report
}

/// The fit, or why there is none.
fn solve(
    camera: &PoseStream,
    body: &PoseStream,
    options: &HandEyeOptions,
    outcome: &mut Outcome,
) -> std::result::Result<Fit, String> {
    let limit = options.offset_limit_s;
    let offset = stream::clock_offset(camera, body, limit).ok_or(
        "the two streams overlap for less than 5 s, or one does not rotate: record both while the body rotates about two axes",
    )?;
    if limit.is_some_and(|limit| offset.offset_s.abs() > limit - 0.1) {
        return Err(format!(
            "the clock offset is at the limit of its search, {:.2} s",
            offset.offset_s
        ));
    }
    if offset.correlation < CORRELATED {
        let text = format!(
            "the angular rates of the two streams differ (correlation {:.2})",
            offset.correlation
        );
        let finding = Code::Clock.warning(text);
        outcome
            .findings
            .push(finding.remedy("check that both are of one rigid body, and the clock"));
    }
    // The fit refines it.
    let offset_s = offset.grid_offset_s;
    let (observations, blocks) = observations(camera, body, offset_s)?;
    let rotation = start::rotation(camera, body, offset_s)?;
    let state = State::begin(rotation, offset_s, body, &observations, blocks);
    fit::fit(state, body, &observations).ok_or_else(|| {
        "the motion does not show the camera's rotation: rotate the body about two axes".to_owned()
    })
}

/// Poses of the camera that overlap with the body's, at least [`APART_S`] apart, in blocks of equal length.
fn observations(
    camera: &PoseStream,
    body: &PoseStream,
    offset_s: f64,
) -> std::result::Result<(Vec<Observation>, usize), String> {
    let (mut poses, mut last_s) = (Vec::<StreamPose>::new(), f64::NEG_INFINITY);
    for pose in camera.poses() {
        // Which poses are taken does not depend on the offset.
        if pose.time_s - last_s <= 0.99 * APART_S {
            continue;
        }
        last_s = pose.time_s;
        if body.at(pose.time_s + offset_s).is_some() {
            poses.push(pose);
        }
    }
    if poses.len() < BLOCKS * BLOCK_POSES {
        return Err(format!(
            "only {} of both streams overlap: record at least {} s",
            counted(poses.len(), "pose"),
            (BLOCKS * BLOCK_POSES) as f64 * APART_S
        ));
    }
    let from = poses[0].time_s;
    let length = poses[poses.len() - 1].time_s - from;
    let blocks = if body.inertial {
        BLOCKS.max((length / INERTIAL_BLOCK_S).ceil() as usize)
    } else {
        BLOCKS
    };
    let place = |pose: StreamPose| {
        let at = (pose.time_s - from) / length * blocks as f64;
        let block = (at as usize).min(blocks - 1);
        Observation { pose, block, phase: 2.0 * (at - block as f64) - 1.0 }
    };
    Ok((poses.into_iter().map(place).collect(), blocks))
}

impl HandEye {
    /// States what a fit found, as far as the limits allow.
    fn state(&mut self, fit: Fit, inertial: bool, options: &HandEyeOptions) {
        let sd: [f64; SHARED] = std::array::from_fn(|k| fit.covariance[(k, k)].sqrt());
        let contradicting = fit.residuals.iter().filter(|r| r.weight < CONTRADICTS).count();
        self.poses = [fit.residuals.len(), contradicting];
        self.noise = Some(fit.noise);
        self.birge_ratio = Some(fit.birge);
        if contradicting * 50 > fit.residuals.len() {
            let text = format!(
                "{contradicting} of {} contradict the others (jumps of a tracker)",
                counted(fit.residuals.len(), "pose")
            );
            self.outcome.findings.push(Code::Residuals.note(text));
        }
        let worst = fit.worst_sd(0);
        if worst > options.rotation_limit_rad {
            self.outcome.refuse(format!(
                "the rotation is known to ± {}° only: rotate the body about two axes, by 60° or more",
                digits::significant(worst.to_degrees(), 2)
            ));
            return;
        }
        let q = fit.state.rotation;
        self.quaternion = Some([q.w, q.i, q.j, q.k]);
        self.rotation_sd_rad = Some([sd[0], sd[1], sd[2]]);
        self.offset_s = Some([fit.state.offset_s, sd[6]]);
        let worst = fit.worst_sd(3);
        if inertial {
            let text = "inertial data show the rotation and the clock offset, not the translation";
            let finding = Code::NotObserved.note(text);
            let remedy = "for the translation, give poses of the body, such as those of a motion capture system";
            self.outcome.findings.push(finding.remedy(remedy));
        } else if worst > options.translation_limit_m {
            let text = format!(
                "the motion does not show the translation (± {} m)",
                digits::significant(worst, 2)
            );
            let finding = Code::NotObserved.warning(text);
            self.outcome
                .findings
                .push(finding.remedy("rotate the body about two axes, by 60° or more"));
        } else {
            self.translation_m = Some(fit.state.translation_m.into());
            self.translation_sd_m = Some([sd[3], sd[4], sd[5]]);
            self.scale = Some([fit.state.scale, sd[7]]);
        }
        let block = SMatrix::<f64, 6, 6>::from(fit.covariance.fixed_view::<6, 6>(0, 0));
        self.covariance = Some(block.into());
        self.residuals = fit.residuals;
    }
}

impl HandEye {
    /// A page with the result, residuals over time and `text`, that of the command.
    ///
    /// # Errors
    /// Those of [`Document`](crate::document::Document).
    pub fn page(&self, text: &str) -> crate::document::Document {
        report::page(self, text)
    }
}
