//! The pose of a camera in a body, on simulated motion with known truth.

use nalgebra::{SVector, UnitQuaternion, Vector3};
use wimu_host::hand_eye::{HandEye, HandEyeOptions, PoseStream, StreamPose, hand_eye};
use wimu_host::imu::{Imu, Sample};
use wimu_host::series::Ns;
use wimu_testkit::{Coverage, Random, coverage_figure, draws};

/// Standard deviation of the camera's rotation, rad, and position, m.
const NOISE: [f64; 2] = [0.005, 0.005];
/// Time of the body's clock less that of the camera's, s.
const OFFSET_S: f64 = 0.37;

/// A body in motion with a camera on it.
struct Rig {
    /// Amplitude, angular frequency and phase of each axis: rotation, rad, and position, m.
    waves: [[[f64; 3]; 2]; 6],
    rotation: UnitQuaternion<f64>,
    translation_m: Vector3<f64>,
    frame: (UnitQuaternion<f64>, Vector3<f64>),
}

fn random_rotation(random: &mut Random) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::from(random.direction()) * random.within(3.0))
}

impl Rig {
    fn new(random: &mut Random, axes: usize) -> Self {
        let waves = std::array::from_fn(|axis| {
            let size = if axis < axes {
                0.6
            } else if axis < 3 {
                0.0
            } else {
                0.3
            };
            std::array::from_fn(|_| {
                let frequency = 0.8 + 1.5 * random.uniform();
                [size, frequency, 6.0 * random.uniform()]
            })
        });
        Self {
            waves,
            rotation: random_rotation(random),
            translation_m: Vector3::from(random.normals(0.1)),
            frame: (random_rotation(random), Vector3::from(random.normals(2.0))),
        }
    }

    /// Pose of the body at a time of its clock.
    fn body(&self, time_s: f64) -> StreamPose {
        let value = |axis: usize| -> f64 {
            let waves = self.waves[axis].iter();
            waves.map(|[size, frequency, phase]| size * (frequency * time_s + phase).sin()).sum()
        };
        StreamPose {
            time_s,
            position_m: Vector3::new(value(3), value(4), value(5)),
            rotation: UnitQuaternion::from_scaled_axis(Vector3::new(value(0), value(1), value(2))),
        }
    }

    fn bodies(&self, seconds: f64) -> PoseStream {
        let poses = (0..(seconds * 100.0) as usize).map(|k| self.body(0.01 * k as f64));
        PoseStream::new("body", poses.collect()).unwrap()
    }

    /// Poses of the camera at 10 Hz, in its own frame and clock. `correlated` is the part of the noise with a time constant of
    /// 0.5 s.
    fn camera(&self, seconds: f64, random: &mut Random, correlated: f64) -> Vec<StreamPose> {
        let keep: f64 = (-0.1_f64 / 0.5).exp();
        let mut slow = SVector::<f64, 6>::zeros();
        let count = ((seconds - 1.0) * 10.0) as usize;
        let pose = |k: usize| {
            let time_s = 0.1 * k as f64 + 0.1;
            let body = self.body(time_s + OFFSET_S);
            for (axis, value) in slow.iter_mut().enumerate() {
                let driving = correlated * (1.0 - keep * keep).sqrt() * NOISE[axis / 3];
                *value = keep * *value + driving * random.normal();
            }
            let rotation = Vector3::from(random.normals(NOISE[0])) + slow.fixed_rows::<3>(0);
            let position = Vector3::from(random.normals(NOISE[1])) + slow.fixed_rows::<3>(3);
            let (turn, origin) = self.frame;
            StreamPose {
                time_s,
                position_m: turn * (body.position_m + body.rotation * self.translation_m)
                    + origin
                    + position,
                rotation: turn
                    * body.rotation
                    * self.rotation
                    * UnitQuaternion::from_scaled_axis(rotation),
            }
        };
        (0..count).map(pose).collect()
    }

    /// Angular rates of the body at 200 Hz, with the bias and noise of a consumer sensor.
    fn gyroscope(&self, seconds: f64, random: &mut Random) -> Imu {
        let step_s = 0.005;
        let bias = Vector3::from(random.normals(0.005));
        let mut recording = Imu::new("imu");
        for k in 0..(seconds / step_s) as usize {
            let time_s = step_s * k as f64;
            let [before, now] = [time_s - step_s, time_s].map(|t| self.body(t).rotation);
            let rate = (before.inverse() * now).scaled_axis() / step_s;
            let rate_rad_s = Some(rate + bias + Vector3::from(random.normals(0.002)));
            recording.push(Ns::from_s(time_s), Sample { rate_rad_s, ..Sample::default() });
        }
        recording
    }

    fn rotation_error(&self, found: &HandEye) -> Vector3<f64> {
        let [w, x, y, z] = found.quaternion.unwrap();
        let rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
        (self.rotation.inverse() * rotation).scaled_axis()
    }

    /// Error of an answer: rotation, rad, translation, m, and clock offset, s.
    fn error(&self, found: &HandEye) -> SVector<f64, 7> {
        let rotation = self.rotation_error(found);
        let translation = Vector3::from(found.translation_m.unwrap()) - self.translation_m;
        let offset = found.offset_s.unwrap()[0] - OFFSET_S;
        SVector::from_iterator(rotation.iter().chain(translation.iter()).copied().chain([offset]))
    }
}

fn stream(poses: Vec<StreamPose>) -> PoseStream {
    PoseStream::new("camera", poses).unwrap()
}

fn sds(found: &HandEye) -> Vec<f64> {
    let rotation = found.rotation_sd_rad.unwrap();
    let all = rotation.into_iter().chain(found.translation_sd_m.unwrap());
    all.chain([found.offset_s.unwrap()[1]]).collect()
}

fn found(camera: &PoseStream, body: &PoseStream) -> HandEye {
    let found = hand_eye(camera, body, &HandEyeOptions::default());
    assert_eq!(found.outcome.reason, None);
    found
}

#[test]
fn the_pose_of_a_camera_lies_within_its_stated_intervals() {
    let mut kinds = Vec::new();
    for correlated in [0.0, 2.0] {
        let mut coverage = [Coverage::default(); 7];
        for seed in 0..draws(1000, 7) as u64 {
            let mut random = Random::new(seed);
            let rig = Rig::new(&mut random, 3);
            let camera = stream(rig.camera(60.0, &mut random, correlated));
            let found = found(&camera, &rig.bodies(60.0));
            for ((error, sd), held) in rig.error(&found).iter().zip(sds(&found)).zip(&mut coverage)
            {
                held.count(error.abs() < 1.96 * sd);
            }
        }
        let kind = format!("correlated {correlated}");
        for held in coverage {
            held.assert_can_be(0.93..=0.97, &kind);
        }
        coverage.into_iter().sum::<Coverage>().assert_can_be(0.93..=0.97, &kind);
        kinds.extend(coverage);
    }
    coverage_figure(
        "camera in the body: 95 % intervals, white and correlated noise",
        &kinds,
        0.93..=0.97,
    );
}

#[test]
fn a_gyroscope_shows_the_rotation_and_the_clock_but_not_the_translation() {
    let mut held = Coverage::default();
    for seed in 0..draws(400, 4) as u64 {
        let mut random = Random::new(1000 + seed);
        let rig = Rig::new(&mut random, 3);
        let camera = stream(rig.camera(60.0, &mut random, 0.0));
        let body = PoseStream::of_inertial(&rig.gyroscope(60.0, &mut random)).unwrap();
        let found = found(&camera, &body);
        assert_eq!(found.translation_m, None);
        let (sd, error) = (found.rotation_sd_rad.unwrap(), rig.rotation_error(&found));
        (0..3).for_each(|k| held.count(error[k].abs() < 1.96 * sd[k]));
        let [offset, offset_sd] = found.offset_s.unwrap();
        held.count((offset - OFFSET_S).abs() < 1.96 * offset_sd);
        assert!(sd.iter().all(|sd| *sd < 0.01) && offset_sd < 0.01, "{sd:?} {offset_sd}");
    }
    coverage_figure("camera to gyroscope: 95 % intervals", &[held], 0.93..=0.97);
    held.assert_can_be(0.93..=0.97, "rotation and clock");
}

#[test]
fn jumps_of_a_tracker_do_not_move_the_answer() {
    let mut random = Random::new(5);
    let rig = Rig::new(&mut random, 3);
    let mut poses = rig.camera(60.0, &mut random, 0.0);
    let clean = rig.error(&found(&stream(poses.clone()), &rig.bodies(60.0)));
    for pose in poses.iter_mut().step_by(20) {
        pose.position_m += Vector3::from(random.direction()) * 0.5;
        pose.rotation *= UnitQuaternion::from_scaled_axis(Vector3::from(random.direction()) * 0.3);
    }
    let found = found(&stream(poses), &rig.bodies(60.0));
    assert!(found.poses[1] >= found.poses[0] / 21, "{:?}", found.poses);
    let moved = rig.error(&found) - clean;
    for (moved, sd) in moved.iter().zip(sds(&found)) {
        assert!(moved.abs() < 2.0 * sd, "{moved} ± {sd}");
    }
}

#[test]
fn rotation_about_one_axis_is_refused_and_no_rotation_too() {
    for axes in [0, 1] {
        let mut random = Random::new(7);
        let rig = Rig::new(&mut random, axes);
        let camera = stream(rig.camera(60.0, &mut random, 0.0));
        let found = hand_eye(&camera, &rig.bodies(60.0), &HandEyeOptions::default());
        let reason = found.outcome.reason.unwrap();
        assert!(reason.contains("axis") || reason.contains("axes"), "{axes}: {reason}");
        assert!(found.quaternion.is_none());
    }
}

#[test]
fn a_clock_offset_beyond_the_limit_is_refused_and_one_within_it_is_found() {
    let mut random = Random::new(9);
    let rig = Rig::new(&mut random, 3);
    let camera = stream(rig.camera(60.0, &mut random, 0.0));
    let limited = |limit| {
        let options = HandEyeOptions { offset_limit_s: Some(limit), ..HandEyeOptions::default() };
        hand_eye(&camera, &rig.bodies(60.0), &options).offset_s
    };
    assert_eq!(limited(0.2), None);
    let [offset, sd] = limited(1.0).unwrap();
    assert!((offset - OFFSET_S).abs() < 4.0 * sd && sd < 0.005, "{offset} ± {sd}");
}

#[test]
fn streams_of_two_bodies_are_reported() {
    let mut random = Random::new(11);
    let [one, other] = [(); 2].map(|()| Rig::new(&mut random, 3));
    let camera = stream(one.camera(60.0, &mut random, 0.0));
    let options = HandEyeOptions { offset_limit_s: Some(1.0), ..HandEyeOptions::default() };
    let found = hand_eye(&camera, &other.bodies(60.0), &options);
    let text = wimu_host::problem::text(&found.outcome.findings, 9);
    assert!(text.contains("two streams differ"), "{text}");
}

#[test]
fn a_table_and_a_tum_trajectory_are_the_same_poses() {
    let folder = tempfile::tempdir().unwrap();
    let [csv, tum] = ["poses.csv", "poses.txt"].map(|name| folder.path().join(name));
    std::fs::write(
        &csv,
        "Time (s),Position X (m),Position Y (m),Position Z (m),Quaternion W,Quaternion X,Quaternion Y,Quaternion Z\n\
         0,1,2,3,1,0,0,0\n0.1,1,2,4,0,1,0,0\n0.2,,,,1,0,0,0\n",
    )
    .unwrap();
    std::fs::write(&tum, "# a comment\n0 1 2 3 0 0 0 1\n0.1 1 2 4 1 0 0 0\n").unwrap();
    let [a, b] = [csv, tum].map(|path| PoseStream::read(&path).unwrap());
    assert!(a.poses().eq(b.poses()));
    assert_eq!((a.poses().count(), a.findings.len(), b.findings.len()), (2, 1, 0));
}
