//! Tables of known programs: what their headers leave out.

use super::names;
use super::units::{self, Scale};
use crate::recording::Quantity::{self, *};

/// A program's table.
#[derive(Debug)]
pub struct Preset {
    /// Its name in docs/reference/formats.md.
    pub name: &'static str,
    /// Columns that only it has, as [`names::key`] of the name without unit.
    columns: &'static [&'static str],
    /// Units of quantities whose columns do not name one.
    units: &'static [(Quantity, &'static str)],
    /// Its time column, and the nanoseconds of its unit.
    pub time: Option<(&'static str, Option<i64>)>,
}

impl Preset {
    const fn new(
        name: &'static str,
        columns: &'static [&'static str],
        units: &'static [(Quantity, &'static str)],
    ) -> Self {
        Self { name, columns, units, time: None }
    }

    const fn timed(mut self, column: &'static str, unit_ns: Option<i64>) -> Self {
        self.time = Some((column, unit_ns));
        self
    }

    /// Unit of a quantity.
    pub fn scale(&self, quantity: Quantity) -> Option<Scale> {
        let (_, unit) = self.units.iter().find(|(of, _)| *of == quantity)?;
        units::scale(quantity, unit)
    }
}

type Units = &'static [(Quantity, &'static str)];
#[rustfmt::skip]
const SI: Units = &[
    (SpecificForce, "m/s2"), (LinearAcceleration, "m/s2"), (Gravity, "m/s2"), (AngularRate, "rad/s"),
];
#[rustfmt::skip]
const PHONE: Units = &[
    (SpecificForce, "m/s2"), (LinearAcceleration, "m/s2"), (Gravity, "m/s2"), (AngularRate, "rad/s"), (MagneticField, "uT"),
];
#[rustfmt::skip]
const XSENS: Units = &[
    (SpecificForce, "m/s2"), (LinearAcceleration, "m/s2"), (AngularRate, "rad/s"), (MagneticField, "au"),
];
const ARTEMIS: Units = &[(SpecificForce, "mg"), (AngularRate, "deg/s"), (MagneticField, "uT")];
#[rustfmt::skip]
const TOOLBOX: Units = &[
    (SpecificForce, "g"), (LinearAcceleration, "m/s2"), (AngularRate, "rad/s"), (MagneticField, "uT"),
];
/// Counts of a sensor of ±16 g and 16 bits.
const BLACKBOX: Units = &[(SpecificForce, "g/2048"), (AngularRate, "deg/s")];
const WIT: Units = &[(SpecificForce, "g"), (AngularRate, "deg/s"), (MagneticField, "au")];
const MAVLINK: Units = &[(SpecificForce, "mg"), (AngularRate, "mrad/s"), (MagneticField, "mgauss")];

pub const SENSOR_LOGGER: &str = "Sensor Logger";
pub const XSENS_DOT: &str = "Xsens DOT";
pub const OXTS: &str = "KITTI oxts";

/// `ROS Imu` are tables of `ros2 topic echo --csv` and tables made from bags.
const PRESETS: &[Preset] = &[
    Preset::new("EuRoC", &["arssx", "wrssx"], SI),
    Preset::new("rostopic echo -p", &["fieldlinearaccelerationx"], SI)
        .timed("fieldheaderstamp", Some(1)),
    Preset::new("ROS Imu", &["angularvelocityx", "linearaccelerationx"], SI),
    Preset::new(SENSOR_LOGGER, &["secondselapsed"], PHONE)
        .timed("secondselapsed", Some(units::SECOND)),
    Preset::new("OpenLog Artemis", &["rtcdate", "ax"], ARTEMIS).timed("rtctime", None),
    Preset::new("OpenLog Artemis", &["outputhz", "ax"], ARTEMIS),
    Preset::new("Physics Toolbox", &["gfx"], TOOLBOX),
    Preset::new("WitMotion", &["chiptime"], WIT).timed("chiptime", None),
    Preset::new("Xsens MT Manager", &["packetcounter", "accx"], XSENS),
    Preset::new("blackbox_decode", &["loopiteration", "accsmooth0"], BLACKBOX),
    Preset::new("ulog2csv", &["timestampsample", "deviceid"], SI)
        .timed("timestamp", Some(units::MICROSECOND)),
    Preset::new("MATLAB Mobile", &["timestamp", "x", "y", "z"], PHONE),
    Preset::new("MAVLink RAW_IMU", &["xacc", "xgyro"], MAVLINK),
    Preset::new("MAVLink RAW_IMU", &["rawimuxacc", "rawimuxgyro"], MAVLINK),
];

/// The preset of a header.
pub fn of_header(header: &[String]) -> Option<&'static Preset> {
    let keys: Vec<String> =
        header.iter().map(|name| names::key(names::split_unit(name).0)).collect();
    let has = |column: &&'static str| keys.iter().any(|key| key == column);
    PRESETS.iter().find(|preset| preset.columns.iter().all(has))
}

/// Columns of KITTI's oxts packets, in their order.
const PACKET: &str = "lat,lon,alt,roll,pitch,yaw,vn,ve,vf,vl,vu,ax (m/s2),ay (m/s2),az (m/s2),af,al,au,wx (rad/s),wy (rad/s),\
                    wz (rad/s),wf,wl,wu,pos_accuracy,vel_accuracy,navstat,numsats,posmode,velmode,orimode";

/// Columns of `ros2 topic echo --csv` of a sensor_msgs/Imu, to the specific force: stamp, frame, attitude, angular rate, each
/// with its covariance.
const ECHO: &str = "sec,nanosec,frame,qx,qy,qz,qw,c,c,c,c,c,c,c,c,c,gx (rad/s),gy (rad/s),gz (rad/s),\
                    c,c,c,c,c,c,c,c,c,ax (m/s2),ay (m/s2),az (m/s2)";
const ECHO_WIDTH: usize = 40;

/// Names of the columns of a table without a header, and what it was taken for. `increases` says of each column whether it
/// only increases, `texts` whether it is text.
pub fn without_header(increases: &[bool], texts: &[bool]) -> Option<(Vec<String>, &'static str)> {
    let width = increases.len();
    let timed = matches!(width, 4 | 7 | 10) && increases[0];
    let text = texts.iter().position(|is_text| *is_text);
    if let Some(column) = text {
        let (names, program) = match (width, column) {
            (ECHO_WIDTH, 2) => (ECHO, "ros2 topic echo --csv"),
            (6, 1) if increases[2] => ("user,activity,timestamp,ax,ay,az", "WISDM"),
            _ => return None,
        };
        let names = names.split(',').map(str::to_owned).chain((1..).map(|k| format!("c{k}")));
        return Some((names.take(width).collect(), program));
    }
    let (names, program) = match width {
        30 => (PACKET, OXTS),
        3 | 6 | 9 => ("ax,ay,az,gx,gy,gz,mx,my,mz", "Arduino without header"),
        _ if timed => ("time,ax,ay,az,gx,gy,gz,mx,my,mz", "Arduino without header"),
        _ => return None,
    };
    let names = names.split(',').take(width).map(str::to_owned);
    Some((names.collect(), program))
}
