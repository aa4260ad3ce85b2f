//! A navigated path as `nav_msgs/Odometry`, `nav_msgs/Path` and `tf2_msgs/TFMessage`.

use std::io::{Seek, Write};

use wimu_model::{Alignment, Matrix3};

use super::message::Message;
use crate::Result;
use crate::mcap_file::RosFile;
use crate::series::thin_out;

/// Most poses of a `nav_msgs/Path`, and least time between them, ns.
const MAX_POSES: usize = 1000;
const POSE_STEP_NS: u64 = 1_000_000_000;

/// Frames: where position is measured, the body, its sensor.
const MAP: &str = "map";
const BODY: &str = "base_link";
const SENSOR: &str = "imu_link";

/// Pose and velocity at a time. A standard deviation or variance of 0 is unknown.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    /// UTC or the file's time, ns.
    pub stamp_ns: u64,
    /// m, east-north-up.
    pub position_m: [f64; 3],
    /// Its covariance, m².
    pub position_covariance: Matrix3,
    /// Body to navigation axes, W X Y Z.
    pub quaternion: [f64; 4],
    /// Standard deviation about east, north and up, rad.
    pub attitude_sd_rad: [f64; 3],
    /// m/s, east-north-up.
    pub velocity_mps: [f64; 3],
    /// Its standard deviation, m/s.
    pub velocity_sd_mps: [f64; 3],
    /// Angular rate, rad/s, body axes.
    pub rate_rad_s: [f64; 3],
}

impl Pose {
    /// Position and orientation, as ROS orders them.
    fn numbers(&self) -> [f64; 7] {
        let ([e, n, u], [w, x, y, z]) = (self.position_m, self.quaternion);
        [e, n, u, x, y, z, w]
    }

    /// Covariance of position and orientation, axes of the map.
    fn pose_covariance(&self) -> [f64; 36] {
        let attitude =
            |i: usize, j: usize| if i == j { self.attitude_sd_rad[i].powi(2) } else { 0.0 };
        blocks(|i, j| self.position_covariance[i][j], attitude)
    }

    /// Velocity and angular rate, body axes, and their covariance.
    fn twist(&self) -> ([f64; 6], [f64; 36]) {
        let rotation = Alignment::from_quaternion(self.quaternion).unwrap_or(Alignment::IDENTITY);
        let r = rotation.matrix();
        let [x, y, z] = [0, 1, 2].map(|i| (0..3).map(|k| r[k][i] * self.velocity_mps[k]).sum());
        let [u, v, w] = self.rate_rad_s;
        let sd = self.velocity_sd_mps;
        let element = |i: usize, j: usize| (0..3).map(|k| r[k][i] * sd[k] * sd[k] * r[k][j]).sum();
        ([x, y, z, u, v, w], blocks(element, |_, _| 0.0))
    }
}

/// A 6 × 6 matrix with two blocks on its diagonal, row by row.
fn blocks(first: impl Fn(usize, usize) -> f64, second: impl Fn(usize, usize) -> f64) -> [f64; 36] {
    std::array::from_fn(|k| match (k / 6, k % 6) {
        (i @ 0..3, j @ 0..3) => first(i, j),
        (i @ 3.., j @ 3..) => second(i - 3, j - 3),
        _ => 0.0,
    })
}

/// Writes the poses of one path: each as odometry and transform, a part of them as a path.
#[derive(Debug)]
pub struct PathTopics {
    /// Before the names `/odom` and `/path`.
    prefix: String,
    /// Whether `/tf` has this path.
    transforms: bool,
    /// Stamp and numbers of the path's poses.
    poses: Vec<(u64, [f64; 7])>,
    step_ns: u64,
    /// Log time of the first pose.
    begun_ns: Option<u64>,
}

impl PathTopics {
    /// Topics that begin with `prefix`; one path of a file has `/tf`.
    pub fn new(prefix: &str, transforms: bool) -> Self {
        Self {
            prefix: prefix.to_owned(),
            transforms,
            poses: Vec::new(),
            step_ns: POSE_STEP_NS,
            begun_ns: None,
        }
    }

    /// Writes a pose that was known at `log_ns`.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn push<W: Write + Seek>(
        &mut self,
        out: &mut RosFile<W>,
        log_ns: u64,
        pose: &Pose,
    ) -> Result<()> {
        let (stamp_ns, numbers) = (pose.stamp_ns, pose.numbers());
        if self.begun_ns.is_none() {
            self.begun_ns = Some(log_ns);
            if self.transforms {
                let identity = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
                let fixed = transform(stamp_ns, BODY, SENSOR, &identity);
                out.publish("/tf_static", "tf2_msgs/TFMessage", log_ns, stamp_ns, &fixed)?;
            }
        }
        let (twist, twist_covariance) = pose.twist();
        let odometry = (Message::new().header(stamp_ns, MAP).text(BODY))
            .numbers(&numbers)
            .numbers(&pose.pose_covariance())
            .numbers(&twist)
            .numbers(&twist_covariance);
        let topic = format!("{}/odom", self.prefix);
        out.publish(&topic, "nav_msgs/Odometry", log_ns, stamp_ns, &odometry)?;
        if self.transforms {
            let moving = transform(stamp_ns, MAP, BODY, &numbers);
            out.publish("/tf", "tf2_msgs/TFMessage", log_ns, stamp_ns, &moving)?;
        }
        let last = self.poses.last();
        if last.is_none_or(|(last, _)| stamp_ns >= last.saturating_add(self.step_ns)) {
            self.poses.push((stamp_ns, numbers));
        }
        if self.poses.len() > MAX_POSES {
            self.step_ns *= 2;
            thin_out(&mut self.poses);
        }
        Ok(())
    }

    /// Writes the path, at the log time of its first pose: a viewer shows it from there on.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn finish<W: Write + Seek>(self, out: &mut RosFile<W>) -> Result<()> {
        let (Some(log_ns), Some((stamp_ns, _))) = (self.begun_ns, self.poses.first()) else {
            return Ok(());
        };
        let head = Message::new().header(*stamp_ns, MAP);
        let path = (self.poses.iter()).fold(head.count(self.poses.len()), |path, (at, pose)| {
            path.header(*at, MAP).numbers(pose)
        });
        let topic = format!("{}/path", self.prefix);
        out.publish(&topic, "nav_msgs/Path", log_ns, *stamp_ns, &path)
    }
}

fn transform(stamp_ns: u64, parent: &str, child: &str, numbers: &[f64; 7]) -> Message {
    let head = Message::new().count(1).header(stamp_ns, parent);
    head.text(child).numbers(numbers)
}
