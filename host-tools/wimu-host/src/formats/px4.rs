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

use std::collections::HashMap;

use self::ulog::{Field, Layout, Message, Subscription};
use super::autopilot::{Choice, Family, Role, Rows, Topic};
use super::{ReadOptions, Source};
use crate::plural::counted;
use crate::recording::{Quantity, Sink, TrackId};
use crate::{Code, Result};

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

/// Reads it: first the number of rows of each topic, which decides what is read, then the rows.
pub(super) fn read(source: &Source, options: &ReadOptions, sink: &mut dyn Sink) -> Result<()> {
    let mut rows = Rows::default();
    let (mut dropouts, mut lost_ms) = (0_usize, 0_u64);
    let (damage, length) = ulog::walk(source, &mut |message| match message {
        Message::Data(_, of, _) => rows.add(&of.name, of.instance),
        Message::Dropout(duration_ms) => {
            dropouts += 1;
            lost_ms += u64::from(duration_ms);
        }
    })?;
    damage.refuse_most(source, length)?;
    let choice = Choice::of(TOPICS, &rows, options, source)?;
    let finding = damage.finding(0..length);
    finding.into_iter().for_each(|finding| sink.finding(finding));
    if dropouts > 0 {
        let times = counted(dropouts, "dropout");
        let evidence = format!("{times} of the logger, {lost_ms} ms in all");
        let finding = Code::Rate.warning(evidence);
        sink.finding(finding.remedy("log fewer topics, or use a faster memory card"));
    }
    choice.report(&rows, sink);

    let mut plans: HashMap<u16, Vec<Plan>> = HashMap::new();
    ulog::walk(source, &mut |message| {
        if let Message::Data(id, of, payload) = message {
            let plans = plans.entry(id);
            for plan in plans.or_insert_with(|| Plan::all(of, &choice, sink)) {
                plan.hand_on(payload, sink);
            }
        }
    })?;
    Ok(())
}

/// How the messages of a subscription become rows of a track.
struct Plan {
    track: TrackId,
    topic: &'static Topic,
    time: Field,
    relative_time: Option<Field>,
    /// Field and element of each value.
    values: Vec<(Field, usize)>,
    valid: Vec<Field>,
}

impl Plan {
    /// Those of a subscription.
    fn all(of: &Subscription, choice: &Choice, sink: &mut dyn Sink) -> Vec<Self> {
        let topics = TOPICS.iter().filter(|topic| topic.name == of.name);
        let read = topics.filter(|topic| choice.takes(topic, of.instance));
        let layout = of.layout.as_ref();
        read.filter_map(|topic| Self::new(topic, of, layout?, sink)).collect()
    }

    /// `None` if the format lacks a field.
    fn new(
        topic: &'static Topic,
        of: &Subscription,
        layout: &Layout,
        sink: &mut dyn Sink,
    ) -> Option<Self> {
        let width = topic.quantity.width();
        let mut values = Vec::new();
        for name in topic.fields {
            let field = layout.field(name)?;
            let elements = 0..field.count.min(width - values.len());
            values.extend(elements.map(|element| (field.clone(), element)));
        }
        let fields = |names: &[&str]| -> Vec<Field> {
            let fields = names.iter().filter_map(|name| layout.field(name));
            fields.cloned().collect()
        };
        let time = layout.field("timestamp")?.clone();
        let name = format!("{}[{}]", topic.name, of.instance);
        (values.len() == width).then(|| Self {
            track: topic.track(&name, of.instance, sink),
            topic,
            time,
            relative_time: fields(topic.relative_time.as_slice()).pop(),
            values,
            valid: fields(topic.valid),
        })
    }

    fn hand_on(&self, payload: &[u8], sink: &mut dyn Sink) {
        let Some(mut time_us) = self.time.read(payload, 0) else {
            return;
        };
        let relative = self.relative_time.as_ref();
        let relative = relative.and_then(|field| field.read(payload, 0));
        let mut valid = relative != Some(INVALID_RELATIVE_TIME);
        if let Some(relative) = relative.filter(|_| valid) {
            time_us += relative;
        }
        valid &=
            self.valid.iter().all(|flag| flag.read(payload, 0).is_some_and(|flag| flag != 0.0));
        let mut row = [f64::NAN; 4];
        for (value, (field, element)) in row.iter_mut().zip(&self.values) {
            let read = field.read(payload, *element).filter(|_| valid);
            *value = read.unwrap_or(f64::NAN) * self.topic.si;
        }
        self.topic.row(self.track, time_us, row, sink);
    }
}
