//! PX4 flight logs (ULog, `.ulg`).
//!
//! PX4 logs each inertial sensor (`sensor_accel[i]` and `sensor_gyro[i]`, without PX4's
//! calibration since version 1.11) and what its navigation filter uses (`sensor_combined`: one
//! selected sensor after calibration and filters). Sensor i is instance i of the raw topics.
//! Default logging keeps about one raw sample a second: where the raw topics have fewer rows than
//! `sensor_combined`, that is read instead, as sensor 0, and likewise `vehicle_magnetometer`
//! instead of `sensor_mag`. `--topic` decides otherwise: `sensor_accel` (all instances, with the
//! gyroscopes), `sensor_accel[1]`, `sensor_combined`, `sensor_mag`, `vehicle_magnetometer`.
//!
//! Sensor axes are PX4's body axes, forward, right, down: at level rest the specific force is
//! about (0, 0, −9.81) m/s². Attitude, position and velocity are estimates of the autopilot,
//! converted from north-east-down to east-north-up; the position is relative to the filter's
//! origin. Times are those of the field `timestamp`.

mod ulog;

use self::ulog::Subscription;
use super::autopilot::{self, Family, Role, Topic};
use super::{ReadOptions, Source};
use crate::Result;
use crate::recording::{Quantity, Sink};

/// Of `accelerometer_timestamp_relative`: there is no new acceleration (`sensor_combined.msg`).
const INVALID_RELATIVE_TIME: f64 = i32::MAX as f64;
/// T.
const GAUSS: f64 = 1e-4;

const XYZ: &[&str] = &["x", "y", "z"];
const RAW: Role = Role::Raw(Family::Inertial);
const PROCESSED: Role = Role::Processed(Family::Inertial);
const RAW_MAG: Role = Role::Raw(Family::Magnetic);
const PROCESSED_MAG: Role = Role::Processed(Family::Magnetic);

#[rustfmt::skip]
const TOPICS: &[Topic] = &[
    Topic::new("sensor_accel", RAW, Quantity::SpecificForce, XYZ),
    Topic::new("sensor_accel", RAW, Quantity::Temperature, &["temperature"]),
    Topic::new("sensor_gyro", RAW, Quantity::AngularRate, XYZ),
    Topic {
        relative_time: Some("accelerometer_timestamp_relative"),
        ..Topic::new("sensor_combined", PROCESSED, Quantity::SpecificForce, &["accelerometer_m_s2"])
    },
    Topic::new("sensor_combined", PROCESSED, Quantity::AngularRate, &["gyro_rad"]),
    Topic::new("sensor_mag", RAW_MAG, Quantity::MagneticField, XYZ).in_units_of(GAUSS),
    Topic::new("vehicle_magnetometer", PROCESSED_MAG, Quantity::MagneticField, &["magnetometer_ga"])
        .in_units_of(GAUSS),
    Topic::new("vehicle_attitude", Role::Estimate, Quantity::Attitude, &["q"]),
    Topic {
        valid: &["xy_valid", "z_valid"],
        ..Topic::new("vehicle_local_position", Role::Estimate, Quantity::Position, XYZ)
    },
    Topic {
        valid: &["v_xy_valid", "v_z_valid"],
        ..Topic::new("vehicle_local_position", Role::Estimate, Quantity::Velocity, &["vx", "vy", "vz"])
    },
];

/// Whether it is a ULog file.
pub(super) fn detect(source: &Source) -> bool {
    source.start().starts_with(&ulog::MAGIC)
}

/// Reads it.
pub(super) fn read(source: &Source, options: &ReadOptions, sink: &mut dyn Sink) -> Result<()> {
    autopilot::read(TOPICS, options.topic.as_deref(), source, sink, &mut |each| {
        ulog::walk(source, &mut |of, payload| each(&Data { of, payload }))
    })
}

/// Values of a topic.
struct Data<'a> {
    of: &'a Subscription,
    payload: &'a [u8],
}

impl Data<'_> {
    fn field(&self, name: &str, element: usize) -> Option<f64> {
        self.of.layout.as_ref()?.field(name)?.read(self.payload, element)
    }
}

impl autopilot::Message for Data<'_> {
    fn topic(&self) -> (&str, u8) {
        (&self.of.name, self.of.instance)
    }

    fn name(&self, topic: &Topic) -> String {
        format!("{}[{}]", topic.name, self.of.instance)
    }

    fn time_us(&self, topic: &Topic) -> Option<(f64, bool)> {
        let time_us = self.field("timestamp", 0)?;
        let relative = topic.relative_time.and_then(|name| self.field(name, 0));
        let flag = |name: &&str| self.field(name, 0).is_none_or(|flag| flag != 0.0);
        let is_valid = relative != Some(INVALID_RELATIVE_TIME) && topic.valid.iter().all(flag);
        let relative = relative.filter(|_| is_valid).unwrap_or(0.0);
        Some((time_us + relative, is_valid))
    }

    fn values(&self, topic: &Topic) -> Option<[f64; 4]> {
        let mut row = [f64::NAN; 4];
        let is_array = topic.fields.len() < topic.quantity.width();
        for (k, value) in row.iter_mut().take(topic.quantity.width()).enumerate() {
            let (name, element) =
                if is_array { (topic.fields[0], k) } else { (topic.fields[k], 0) };
            *value = self.field(name, element)? * topic.si;
        }
        Some(row)
    }
}
