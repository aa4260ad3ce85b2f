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

const SI: &[(Quantity, &str)] = &[
    (SpecificForce, "m/s2"),
    (LinearAcceleration, "m/s2"),
    (Gravity, "m/s2"),
    (AngularRate, "rad/s"),
];
const SI_UT: &[(Quantity, &str)] = &[
    (SpecificForce, "m/s2"),
    (LinearAcceleration, "m/s2"),
    (Gravity, "m/s2"),
    (AngularRate, "rad/s"),
    (MagneticField, "uT"),
];
const ARTEMIS: &[(Quantity, &str)] = &[
    (SpecificForce, "mg"),
    (AngularRate, "deg/s"),
    (MagneticField, "uT"),
];

const PRESETS: &[Preset] = &[
    Preset {
        name: "EuRoC",
        columns: &["arssx", "wrssx"],
        units: SI,
        time: None,
    },
    Preset {
        name: "rostopic echo -p",
        columns: &["fieldlinearaccelerationx"],
        units: SI,
        time: Some(("fieldheaderstamp", Some(0))),
    },
    Preset {
        name: "Sensor Logger",
        columns: &["secondselapsed"],
        units: SI_UT,
        time: Some(("secondselapsed", Some(9))),
    },
    Preset {
        name: "OpenLog Artemis",
        columns: &["rtcdate", "ax"],
        units: ARTEMIS,
        time: Some(("rtctime", None)),
    },
    Preset {
        name: "OpenLog Artemis",
        columns: &["outputhz", "ax"],
        units: ARTEMIS,
        time: None,
    },
    Preset {
        name: "Physics Toolbox",
        columns: &["gfx"],
        units: &[
            (SpecificForce, "g"),
            (LinearAcceleration, "m/s2"),
            (AngularRate, "rad/s"),
            (MagneticField, "uT"),
        ],
        time: None,
    },
    Preset {
        name: "WitMotion",
        columns: &["chiptime"],
        units: &[
            (SpecificForce, "g"),
            (AngularRate, "deg/s"),
            (MagneticField, "au"),
        ],
        time: Some(("chiptime", None)),
    },
    Preset {
        name: "Xsens MT Manager",
        columns: &["packetcounter", "accx"],
        units: &[
            (SpecificForce, "m/s2"),
            (LinearAcceleration, "m/s2"),
            (AngularRate, "rad/s"),
            (MagneticField, "au"),
            (Temperature, "C"),
        ],
        time: None,
    },
    Preset {
        name: "MATLAB Mobile",
        columns: &["timestamp", "x", "y", "z"],
        units: SI_UT,
        time: None,
    },
];

/// The preset of a header.
pub fn of_header(header: &[String]) -> Option<&'static Preset> {
    let keys: Vec<String> = header
        .iter()
        .map(|name| names::key(names::split_unit(name).0))
        .collect();
    let has = |column: &&str| keys.iter().any(|key| key == column);
    PRESETS
        .iter()
        .find(|preset| preset.columns.iter().all(|column| has(column)))
}

/// Columns of KITTI's oxts packets, in their order.
const OXTS: [&str; 30] = [
    "lat",
    "lon",
    "alt",
    "roll",
    "pitch",
    "yaw",
    "vn",
    "ve",
    "vf",
    "vl",
    "vu",
    "ax (m/s2)",
    "ay (m/s2)",
    "az (m/s2)",
    "af",
    "al",
    "au",
    "wx (rad/s)",
    "wy (rad/s)",
    "wz (rad/s)",
    "wf",
    "wl",
    "wu",
    "pos_accuracy",
    "vel_accuracy",
    "navstat",
    "numsats",
    "posmode",
    "velmode",
    "orimode",
];

/// Names of the columns of a table without a header, and what it was taken for. `increases` says of each column whether it
/// only increases.
pub fn without_header(increases: &[bool]) -> Option<(Vec<String>, &'static str)> {
    let width = increases.len();
    let names = |names: &[&str]| {
        names
            .iter()
            .map(|name| (*name).to_owned())
            .collect::<Vec<_>>()
    };
    if width == OXTS.len() {
        return Some((names(&OXTS), "KITTI oxts"));
    }
    let axes = ["ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz"];
    match width {
        3 | 6 | 9 => Some((names(&axes[..width]), "Arduino without header")),
        4 | 7 | 10 if increases[0] => {
            let mut columns = names(&["time"]);
            columns.extend(names(&axes[..width - 1]));
            Some((columns, "Arduino without header"))
        }
        _ => None,
    }
}
