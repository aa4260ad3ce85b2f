//! ArduPilot flight logs (DataFlash, `.BIN`).
//!
//! ArduPilot logs each inertial sensor as `IMU` (sensor i in the field `I`, in older logs as
//! `IMU`, `IMU2`, `IMU3`) after its calibration and low-pass filter, at 25 to 400 Hz, and on
//! request each sample as `ACC` and `GYR`, calibrated but not filtered. The one with more rows is
//! read; `--topic IMU`, `--topic ACC` or `--topic IMU[1]` decide otherwise. Sensor i is instance
//! i.
//!
//! Units are those that the log names (`FMTU`, `UNIT`, `MULT`), or else those of ArduPilot's
//! documentation: m/s², rad/s, mG, degrees. Sensor axes are body axes, forward, right, down: at
//! level rest the specific force is about (0, 0, −9.81) m/s². Attitude (`ATT`), position and
//! velocity (`NKF1`, `XKF1`) are estimates of the autopilot, converted from north-east-down to
//! east-north-up. Times are those of `SampleUS` where there is one, or else of `TimeUS` or
//! `TimeMS`.

mod dataflash;

use std::collections::HashMap;

use self::dataflash::{Field, Format, Units};
use super::autopilot::{Choice, Family, Role, Rows, Topic};
use super::{ReadOptions, Source, ned};
use crate::Result;
use crate::recording::{Quantity, Sink, TrackId};

/// rad.
const DEGREE: f64 = std::f64::consts::PI / 180.0;
/// T.
const GAUSS: f64 = 1e-4;

const ACC: &[&str] = &["AccX", "AccY", "AccZ"];
const GYR: &[&str] = &["GyrX", "GyrY", "GyrZ"];
const RAW: Role = Role::Raw(Family::Inertial);
const PROCESSED: Role = Role::Processed(Family::Inertial);

#[rustfmt::skip]
const TOPICS: &[Topic] = &[
    Topic::new("ACC", RAW, Quantity::SpecificForce, ACC),
    Topic::new("GYR", RAW, Quantity::AngularRate, GYR),
    Topic::new("IMU", PROCESSED, Quantity::SpecificForce, ACC),
    Topic::new("IMU", PROCESSED, Quantity::AngularRate, GYR),
    Topic::new("IMU", PROCESSED, Quantity::Temperature, &["T"]),
    Topic::new("MAG", Role::Processed(Family::Magnetic), Quantity::MagneticField, &["MagX", "MagY", "MagZ"])
        .in_units_of(1e-3 * GAUSS),
    Topic::new("ATT", Role::Estimate, Quantity::Attitude, &["Roll", "Pitch", "Yaw"])
        .in_units_of(DEGREE),
    Topic::new("NKF1", Role::Estimate, Quantity::Position, &["PN", "PE", "PD"]),
    Topic::new("NKF1", Role::Estimate, Quantity::Velocity, &["VN", "VE", "VD"]),
    Topic::new("XKF1", Role::Estimate, Quantity::Position, &["PN", "PE", "PD"]),
    Topic::new("XKF1", Role::Estimate, Quantity::Velocity, &["VN", "VE", "VD"]),
];

/// SI units of a unit that a log names.
fn si(unit: &str) -> Option<f64> {
    Some(match unit {
        "m/s/s" | "rad/s" | "m" | "m/s" | "degC" | "rad" => 1.0,
        "deg" | "degheading" | "deg/s" => DEGREE,
        "Gauss" => GAUSS,
        "mGauss" => 1e-3 * GAUSS,
        _ => return None,
    })
}

/// Whether it is a DataFlash log.
pub(super) fn detect(source: &Source) -> bool {
    source.start().starts_with(&dataflash::START)
}

/// Reads it: first the number of rows of each message and the units, then the rows.
pub(super) fn read(source: &Source, options: &ReadOptions, sink: &mut dyn Sink) -> Result<()> {
    let mut rows = Rows::default();
    let mut units = Units::default();
    let (damage, length) = dataflash::walk(source, &mut |format, message| {
        let (topic, instance) = topic_of(format, message);
        rows.add(topic, instance);
        units.take(format, message);
    })?;
    damage.refuse_most(source, length)?;
    let mut options = options.clone();
    options.topic = options.topic.map(|topic| match split(&topic) {
        (name, Some(instance)) => format!("{name}[{instance}]"),
        _ => topic,
    });
    let choice = Choice::of(TOPICS, &rows, &options, source)?;
    let finding = damage.finding(0..length);
    finding.into_iter().for_each(|finding| sink.finding(finding));
    choice.report(&rows, sink);

    let mut plans: HashMap<(u8, u8), Vec<Plan>> = HashMap::new();
    dataflash::walk(source, &mut |format, message| {
        let (topic, instance) = topic_of(format, message);
        let plans = plans.entry((format.id, instance));
        let plans = plans.or_insert_with(|| {
            let topics = TOPICS.iter().filter(|of| of.name == topic);
            let read = topics.filter(|topic| choice.takes(topic, instance));
            read.filter_map(|topic| Plan::new(topic, instance, format, &units, sink)).collect()
        });
        for plan in plans {
            plan.hand_on(message, sink);
        }
    })?;
    Ok(())
}

/// Topic and instance of `IMU2`: `IMU` and 1.
fn split(name: &str) -> (&str, Option<u8>) {
    for sensor in ["IMU", "ACC", "GYR", "MAG"] {
        let digit = name.strip_prefix(sensor).and_then(|rest| rest.parse().ok());
        if let Some(digit @ 1_u8..) = digit {
            return (sensor, Some(digit - 1));
        }
    }
    (name, None)
}

/// Topic and instance of a message.
fn topic_of<'a>(format: &'a Format, message: &[u8]) -> (&'a str, u8) {
    let (topic, instance) = split(&format.name);
    let field = format.field("I").or_else(|| format.field("C"));
    let field = field.and_then(|field| field.read(message));
    let known = TOPICS.iter().any(|of| of.name == topic);
    let instance = field.filter(|_| known).map(|value| value as u8).or(instance);
    (topic, instance.unwrap_or(0))
}

/// How messages become rows of a track.
struct Plan {
    track: TrackId,
    topic: &'static Topic,
    time: Field,
    /// µs.
    time_unit: f64,
    /// Fields, and SI units of one of their units.
    values: Vec<(Field, f64)>,
}

impl Plan {
    /// `None` if the format lacks a field.
    fn new(
        topic: &'static Topic,
        instance: u8,
        format: &Format,
        units: &Units,
        sink: &mut dyn Sink,
    ) -> Option<Self> {
        let mut values = Vec::new();
        for name in topic.fields {
            let field = format.field(name)?;
            let unit = units.of(format, field);
            let named = unit.and_then(|(unit, factor)| Some(si(unit)? * factor));
            values.push((field, named.unwrap_or(topic.si)));
        }
        let times = [("SampleUS", 1.0), ("TimeUS", 1.0), ("TimeMS", 1e3)];
        let mut times = times.iter();
        let (time, time_unit) =
            times.find_map(|(name, unit)| Some((format.field(name)?, *unit)))?;
        let name = match split(&format.name) {
            (_, None) if topic.role != Role::Estimate => format!("{}[{instance}]", format.name),
            _ => format.name.clone(),
        };
        Some(Self { track: topic.track(&name, instance, sink), topic, time, time_unit, values })
    }

    fn hand_on(&self, message: &[u8], sink: &mut dyn Sink) {
        let Some(time) = self.time.read(message) else {
            return;
        };
        let mut row = [f64::NAN; 4];
        for (value, (field, si)) in row.iter_mut().zip(&self.values) {
            *value = field.read(message).unwrap_or(f64::NAN) * si;
        }
        if self.topic.quantity == Quantity::Attitude {
            row = ned::of_angles([row[0], row[1], row[2]]);
        }
        self.topic.row(self.track, time * self.time_unit, row, sink);
    }
}
