//! Tables of known programs: what their headers leave out.

use super::names;
use crate::recording::Quantity::{self, *};

/// A program's table.
#[derive(Debug)]
pub struct Preset {
    /// Its name in docs/FORMATS.md.
    pub name: &'static str,
    /// Columns that only it has, as [`names::key`] of the name without unit.
    columns: &'static [&'static str],
    /// Units of quantities whose columns do not name one.
    pub units: &'static [(Quantity, &'static str)],
    /// Its time column, and the power of ten of a nanosecond.
    pub time: Option<(&'static str, Option<i32>)>,
}

macro_rules! presets {
    ($($name:literal, $columns:expr, $units:expr, $time:expr;)+) => {
        &[$(Preset { name: $name, columns: &$columns, units: $units, time: $time }),+]
    };
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

/// `ROS Imu` are tables of `ros2 topic echo --csv` and tables made from bags.
#[rustfmt::skip]
const PRESETS: &[Preset] = presets![
    "EuRoC", ["arssx", "wrssx"], SI, None;
    "rostopic echo -p", ["fieldlinearaccelerationx"], SI, Some(("fieldheaderstamp", Some(0)));
    "ROS Imu", ["angularvelocityx", "linearaccelerationx"], SI, None;
    "Sensor Logger", ["secondselapsed"], PHONE, Some(("secondselapsed", Some(9)));
    "OpenLog Artemis", ["rtcdate", "ax"], ARTEMIS, Some(("rtctime", None));
    "OpenLog Artemis", ["outputhz", "ax"], ARTEMIS, None;
    "Physics Toolbox", ["gfx"], TOOLBOX, None;
    "WitMotion", ["chiptime"], WIT, Some(("chiptime", None));
    "Xsens MT Manager", ["packetcounter", "accx"], XSENS, None;
    "blackbox_decode", ["loopiteration", "accsmooth0"], BLACKBOX, None;
    "ulog2csv", ["timestampsample", "deviceid"], SI, Some(("timestamp", Some(3)));
    "MATLAB Mobile", ["timestamp", "x", "y", "z"], PHONE, None;
];

/// The preset of a header.
pub fn of_header(header: &[String]) -> Option<&'static Preset> {
    let keys: Vec<String> =
        header.iter().map(|name| names::key(names::split_unit(name).0)).collect();
    let has = |column: &&'static str| keys.iter().any(|key| key == column);
    PRESETS.iter().find(|preset| preset.columns.iter().all(has))
}

/// Columns of KITTI's oxts packets, in their order.
const OXTS: &str = "lat,lon,alt,roll,pitch,yaw,vn,ve,vf,vl,vu,ax (m/s2),ay (m/s2),az (m/s2),af,al,au,wx (rad/s),wy (rad/s),\
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
        30 => (OXTS, "KITTI oxts"),
        3 | 6 | 9 => ("ax,ay,az,gx,gy,gz,mx,my,mz", "Arduino without header"),
        _ if timed => ("time,ax,ay,az,gx,gy,gz,mx,my,mz", "Arduino without header"),
        _ => return None,
    };
    let names = names.split(',').take(width).map(str::to_owned);
    Some((names.collect(), program))
}
