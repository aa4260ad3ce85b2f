//! Scores of the pose of a camera on public recordings, beside the references of a naive robust hand–eye fit:
//! `cargo run --release -p wimu-host --example score_align -- [DATA]`.
//!
//! Halves: both halves of one recording must agree within their stated covariances: the squared difference over the sum of the
//! covariances, with its probability below 0.95. One rig: the same for falcon 3 and 5, and the angle between them.

use std::path::{Path, PathBuf};

use nalgebra::{Quaternion, SMatrix, SVector, UnitQuaternion, Vector3};
use wimu_host::hand_eye::{HandEye, HandEyeOptions, PoseStream, hand_eye};
use wimu_testkit::figure;

/// Recordings: camera, body, and the residual of the reference.
const PAIRS: [[&str; 2]; 9] = [
    ["robot_arm_simulated_camera", "robot_arm_simulated_arm"],
    ["falcon_3_tango", "falcon_3_vicon"],
    ["falcon_5_tango", "falcon_5_vicon"],
    ["falcon_5_depth_camera", "falcon_5_vicon"],
    ["falcon_5_depth_camera", "falcon_5_tango"],
    ["prime_sense_1_camera", "prime_sense_1_vicon"],
    ["tango_slow_a", "tango_slow_b"],
    ["tango_slow_a", "tango_slow_c"],
    ["tango_slow_b", "tango_slow_c"],
];
/// 95 % point of χ² with three and six degrees of freedom.
const CHI2_95: [f64; 2] = [7.81, 12.59];

fn main() -> Result<(), String> {
    let data = std::env::args().nth(1).unwrap_or("../shared/data".into());
    let data = PathBuf::from(data).join("camera");
    let mut rigs = Vec::new();
    let mut agreeing = Vec::new();
    println!(
        "recording                            poses  σ deg   σ mm  Birge   halves: deg   mm    χ² rotation, pose (95 %: 7.81, 12.6)"
    );
    for [camera, body] in PAIRS {
        let [camera_stream, body_stream] = [read(&data, camera)?, read(&data, body)?];
        let whole = solved(&camera_stream, &body_stream)?;
        let [from, to] = camera_stream.span_s();
        let middle = 0.5 * (from + to);
        let half = |first: bool| {
            let poses = camera_stream.poses().iter().filter(|p| (p.time_s < middle) == first);
            PoseStream::new(camera, poses.copied().collect()).map_err(|e| e.to_string())
        };
        let halves = [true, false].map(|first| solved(&half(first)?, &body_stream));
        let (sd_deg, sd_mm) = worst_sd(&whole);
        print!(
            "{:36} {:5} {sd_deg:6.2} {sd_mm:6.1} {:6.1}",
            format!("{camera} {}", body.rsplit('_').next().unwrap_or(body)),
            whole.poses[0],
            whole.birge_ratio.unwrap_or(f64::NAN),
        );
        match halves {
            [Ok(a), Ok(b)] => {
                let (deg, mm, rotation, pose) = difference(&a, &b);
                agreeing.push(rotation < CHI2_95[0] && pose < CHI2_95[1]);
                println!(
                    "   {deg:11.2} {mm:5.0}   {rotation:5.1} {pose:6.1}{}",
                    verdict(rotation, pose)
                );
            }
            [a, b] => {
                agreeing.push(false);
                let why = a.err().or(b.err());
                println!("   {}", why.unwrap_or_else(|| String::from("-")));
            }
        }
        if camera.contains("tango") && body.contains("vicon") {
            rigs.push(whole);
        }
    }
    let agree = agreeing.iter().filter(|agrees| **agrees).count();
    let all = agreeing.len();
    figure(
        "camera and body: halves of a recording agree within their 95 % regions",
        format!("{agree} of {all}"),
        "all",
        agree == all,
    );
    if let [a, b] = &rigs[..] {
        let (deg, mm, rotation, pose) = difference(a, b);
        let agree = rotation < CHI2_95[0] && pose < CHI2_95[1];
        figure(
            "camera and body: falcon 3 and 5, one rig, deg (naive: 2 to 3)",
            format!("{deg:.2}, {mm:.0} mm, χ² {rotation:.1} and {pose:.1}"),
            "at most 1.5 and in the 95 % region",
            deg <= 1.5 && agree,
        );
    }
    Ok(())
}

fn read(data: &Path, name: &str) -> Result<PoseStream, String> {
    PoseStream::read(&data.join(format!("{name}.csv"))).map_err(|e| e.to_string())
}

fn solved(camera: &PoseStream, body: &PoseStream) -> Result<HandEye, String> {
    let options = HandEyeOptions {
        offset_limit_s: None,
        translation_limit_m: f64::INFINITY,
        rotation_limit_rad: f64::INFINITY,
    };
    let found = hand_eye(camera, body, &options);
    match &found.outcome.reason {
        Some(reason) => Err(reason.clone()),
        None => Ok(found),
    }
}

fn worst_sd(found: &HandEye) -> (f64, f64) {
    let worst = |sd: Option<[f64; 3]>| sd.unwrap_or_default().into_iter().fold(0.0, f64::max);
    (worst(found.rotation_sd_rad).to_degrees(), 1e3 * worst(found.translation_sd_m))
}

/// Angle, deg, distance, mm, and squared differences over their covariance: rotation, pose.
fn difference(a: &HandEye, b: &HandEye) -> (f64, f64, f64, f64) {
    let rotation = |h: &HandEye| {
        let [w, x, y, z] = h.quaternion.unwrap_or_default();
        UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
    };
    let translation = |h: &HandEye| Vector3::from(h.translation_m.unwrap_or_default());
    let covariance = |h: &HandEye| SMatrix::<f64, 6, 6>::from(h.covariance.unwrap_or_default());
    let angle = (rotation(a).inverse() * rotation(b)).scaled_axis();
    let moved = translation(b) - translation(a);
    let both = covariance(a) + covariance(b);
    let pose = SVector::<f64, 6>::from_iterator(angle.iter().chain(moved.iter()).copied());
    let square = |v: SVector<f64, 6>| both.cholesky().map_or(f64::NAN, |c| v.dot(&c.solve(&v)));
    let of_rotation = both.fixed_view::<3, 3>(0, 0).into_owned().cholesky();
    let of_rotation = of_rotation.map_or(f64::NAN, |c| angle.dot(&c.solve(&angle)));
    (angle.norm().to_degrees(), 1e3 * moved.norm(), of_rotation, square(pose))
}

fn verdict(rotation: f64, pose: f64) -> &'static str {
    match (rotation < CHI2_95[0], pose < CHI2_95[1]) {
        (true, true) => "  agree",
        (true, false) => "  rotations agree",
        _ => "  DISAGREE",
    }
}
