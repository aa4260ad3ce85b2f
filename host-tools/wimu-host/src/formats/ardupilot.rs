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

use self::dataflash::{Format, Units};
use super::autopilot::{self, Family, Role, Topic};
use super::{ReadOptions, Source, ned};
use crate::Result;
use crate::recording::{Quantity, Sink};

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

/// Reads it.
pub(super) fn read(source: &Source, options: &ReadOptions, sink: &mut dyn Sink) -> Result<()> {
    let asked = options.topic.as_ref().map(|topic| match split(topic) {
        (name, Some(instance)) => format!("{name}[{instance}]"),
        _ => topic.clone(),
    });
    let mut units = Units::default();
    autopilot::read(TOPICS, asked.as_deref(), source, sink, &mut |each| {
        dataflash::walk(source, &mut |format, bytes| {
            units.take(format, bytes);
            each(&Message { format, bytes, units: &units });
        })
    })
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

/// A message with the units of its log.
struct Message<'a> {
    format: &'a Format,
    bytes: &'a [u8],
    units: &'a Units,
}

impl autopilot::Message for Message<'_> {
    fn topic(&self) -> (&str, u8) {
        let (topic, instance) = split(&self.format.name);
        let field = self.format.field("I").or_else(|| self.format.field("C"));
        let field = field.and_then(|field| field.read(self.bytes));
        let known = TOPICS.iter().any(|of| of.name == topic);
        let instance = field.filter(|_| known).map(|value| value as u8).or(instance);
        (topic, instance.unwrap_or(0))
    }

    fn name(&self, topic: &Topic) -> String {
        let name = &self.format.name;
        if topic.role == Role::Estimate || split(name).1.is_some() {
            return name.clone();
        }
        format!("{name}[{}]", self.topic().1)
    }

    fn time_us(&self, _: &Topic) -> Option<(f64, bool)> {
        let times = [("SampleUS", 1.0), ("TimeUS", 1.0), ("TimeMS", 1e3)];
        let mut times = times.iter();
        let (field, unit) =
            times.find_map(|(name, unit)| Some((self.format.field(name)?, *unit)))?;
        Some((field.read(self.bytes)? * unit, true))
    }

    fn values(&self, topic: &Topic) -> Option<[f64; 4]> {
        let mut row = [f64::NAN; 4];
        for (value, name) in row.iter_mut().zip(topic.fields) {
            let field = self.format.field(name)?;
            let unit = self.units.of(self.format, field);
            let named = unit.and_then(|(unit, factor)| Some(si(unit)? * factor));
            *value = field.read(self.bytes).unwrap_or(f64::NAN) * named.unwrap_or(topic.si);
        }
        if topic.quantity == Quantity::Attitude {
            row = ned::of_angles([row[0], row[1], row[2]]);
        }
        Some(row)
    }
}
