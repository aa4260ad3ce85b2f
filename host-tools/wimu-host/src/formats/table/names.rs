//! Meaning of a column's name: quantity, sensor, axis and unit.
//!
//! `Accelerometer 0 X (g)`, `acc_x [m/s^2]`, `AccelX (mg)`, `a_RS_S_x [m s^-2]`, `ax_g`, `field.angular_velocity.x` and the
//! like: letters and digits count, case does not; the axis is at the end.

use super::units::{self, Scale};
use crate::recording::{Origin, Quantity};

/// Content of a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    Time,
    /// One component of a track.
    Component {
        quantity: Quantity,
        origin: Origin,
        sensor: u8,
        component: usize,
    },
    /// LSB/g of the accelerometer's counts in the row.
    Sensitivity,
    /// rad/s of an LSB of the gyroscope's counts in the row.
    GyroscopeScale,
    Other,
}

/// A column by its name.
#[derive(Clone, Debug, PartialEq)]
pub struct Meaning {
    pub kind: Kind,
    /// Power of ten of a nanosecond of a time, where its unit is named.
    pub exponent: Option<i32>,
    /// Unit of a component, where it is named.
    pub scale: Option<Scale>,
    /// Whether the name is one of wimu's own.
    pub is_ours: bool,
}

impl Kind {
    /// Quantity of a component.
    pub fn quantity(self) -> Option<Quantity> {
        match self {
            Self::Component { quantity, .. } => Some(quantity),
            _ => None,
        }
    }
}

impl Meaning {
    pub fn of(kind: Kind) -> Self {
        Self { kind, exponent: None, scale: None, is_ours: false }
    }
}

/// Longest name that is looked at, bytes.
const MAX_NAME: usize = 100;

/// Names of times, as [`key`].
const TIMES: &[((), &str)] = &[(
    (),
    "time timestamp t ts timens elapsedtime timeelapsed elapsed secondselapsed epoch unixtime systemtime sampletime micros \
     millis microseconds milliseconds nanoseconds hosttime devicetime stamp fieldheaderstamp chiptime loggingtime datetime \
     rtctime timestampunix unixtimestamp hhmmss hhmmssfff headerstampsec headerstampsecs stampsec stampsecs sec secs datum uhrzeit zeit zeitstempel datumuhrzeit fecha hora heure",
)];

/// Names of three axes without the axis, as [`key`].
const STEMS: &[(Quantity, &str)] = &[
    (
        Quantity::SpecificForce,
        "accelerometer acceleration accel acc a ac arss gf gforce totalacceleration rawacc accraw \
         accelerometeracceleration accelerometeruncalibrated accelerationwithg accsmooth accelerometerms2",
    ),
    (
        Quantity::LinearAcceleration,
        "linearacceleration linearaccelerometer linacc linaccel lacc linearaccel useracceleration accelerationwithoutg freeacc",
    ),
    (Quantity::Gravity, "gravity grav"),
    (
        Quantity::AngularRate,
        "gyroscope gyroscopeuncalibrated gyro gyr gy g w wrss omega angularvelocity angularrate rotationrate angvel rotation rate gyroraw gyrorotation gyroadc gyrorad",
    ),
    (Quantity::MagneticField, "magnetometer magneticfield mag m b h"),
    (Quantity::Position, "position"),
    (Quantity::Velocity, "velocity"),
    (Quantity::Attitude, "quaternion quat q orientation"),
];

/// Letters and digits of a name, lower case.
pub fn key(name: &str) -> String {
    let kept = name.chars().filter(|c| c.is_alphanumeric());
    kept.flat_map(char::to_lowercase).collect()
}

/// Quantity of a file or of three columns by this name.
pub fn quantity(stem: &str) -> Option<Quantity> {
    units::spelled(STEMS, stem)
}

/// Whether the name of a column says that it is a unit of time. `h` is rather a height.
pub fn is_time_unit(name: &str) -> bool {
    let key = key(split_unit(name).0);
    key != "h" && units::time(&key).is_some()
}

/// Whether a name that is not of a time has the word `time` or `timestamp`.
pub fn mentions_time(name: &str) -> bool {
    let bare = split_unit(name).0.to_lowercase();
    let mut words = bare.split(|c: char| !c.is_alphanumeric());
    bare.contains("timestamp") || words.any(|word| word == "time")
}

/// Unit of a time: in parentheses, the whole name, or its last word.
pub fn time_unit(name: &str) -> Option<i32> {
    let (bare, unit) = split_unit(name);
    let last = bare.rsplit([' ', '_']).next();
    unit.or(last).and_then(units::time)
}

/// Meaning of a column; `of_file` is the quantity that the file's name says, for columns `x`, `y`, `z`.
pub fn meaning(name: &str, of_file: Option<Quantity>) -> Meaning {
    let name = name.trim_start_matches(['#', '%', ' ']).trim();
    if name.len() > MAX_NAME {
        return Meaning::of(Kind::Other);
    }
    // `accSmooth[0]` is X.
    let axis = |(index, axis)| Some(format!("{} {axis}", name.strip_suffix(index)?));
    let indexed = [("[0]", 'x'), ("[1]", 'y'), ("[2]", 'z')].into_iter().find_map(axis);
    let name = indexed.as_deref().unwrap_or(name);
    let (bare, unit) = split_unit(name);
    let bare = match key(bare).as_str() {
        "xaxis" => "x",
        "yaxis" => "y",
        "zaxis" => "z",
        _ => bare,
    };
    let mut meaning = component(bare, unit, of_file);
    if let Some(unit) = unit {
        match meaning.kind {
            Kind::Time => meaning.exponent = units::time(unit),
            Kind::Component { quantity, .. } => {
                meaning.scale = units::scale(quantity, unit);
                // `AngleX(deg)`: another quantity than the name suggests.
                if meaning.scale.is_none() && !unit.is_empty() {
                    meaning.kind = Kind::Other;
                }
            }
            _ => {}
        }
        return meaning;
    }
    if meaning.kind == Kind::Other {
        return with_suffix(bare, of_file).unwrap_or(meaning);
    }
    if meaning.kind == Kind::Time {
        meaning.exponent = match key(bare).as_str() {
            "timens" | "nanoseconds" | "fieldheaderstamp" => Some(0),
            "micros" | "microseconds" => Some(3),
            "millis" | "milliseconds" => Some(6),
            "secondselapsed" => Some(9),
            _ => None,
        };
    }
    meaning
}

/// `acc_x_g`, `time_ms`, `ax/g`, `gyro_x_deg_s`: a unit behind a separator.
fn with_suffix(name: &str, of_file: Option<Quantity>) -> Option<Meaning> {
    let breaks = name.char_indices().filter(|(_, c)| matches!(c, '_' | '/' | ' '));
    for (at, separator) in breaks {
        let (bare, unit) = (&name[..at], &name[at + separator.len_utf8()..]);
        let unit = unit.replace('_', "/");
        let mut meaning = component(bare, Some(&unit), of_file);
        match meaning.kind {
            Kind::Time => meaning.exponent = units::time(&unit),
            Kind::Component { quantity, .. } => meaning.scale = units::scale(quantity, &unit),
            _ => continue,
        }
        if meaning.exponent.is_some() || meaning.scale.is_some() {
            return Some(meaning);
        }
    }
    None
}

/// `Name (unit)`, `Name [unit]` or `Name` in its two parts.
pub fn split_unit(name: &str) -> (&str, Option<&str>) {
    let within = |open, close| name.strip_suffix(close)?.rsplit_once(open);
    // `Mat[1][1]` has an index.
    let named = within('(', ')').or_else(|| within('[', ']')).or_else(|| within('{', '}'));
    match named.filter(|(_, unit)| unit.parse::<u32>().is_err()) {
        Some((bare, unit)) => (bare.trim(), Some(unit.trim())),
        None => (name, None),
    }
}

/// Meaning of a name without its unit.
fn component(bare: &str, unit: Option<&str>, of_file: Option<Quantity>) -> Meaning {
    let key = key(bare);
    let is_ours = |kind| Meaning { is_ours: true, ..Meaning::of(kind) };
    let single =
        |quantity| Kind::Component { quantity, origin: Origin::Sensor, sensor: 0, component: 0 };
    match key.as_str() {
        "time" => return is_ours(Kind::Time),
        "temperature" => return is_ours(single(Quantity::Temperature)),
        "sensitivity" if unit.is_some_and(|u| u.eq_ignore_ascii_case("LSB/g")) => {
            return is_ours(Kind::Sensitivity);
        }
        "gyroscopescale" => return is_ours(Kind::GyroscopeScale),
        // SampleTimeFine of Xsens and others say more; see the presets.
        _ if units::spelled(TIMES, &key).is_some() => return Meaning::of(Kind::Time),
        "temp" | "imudegc" | "imutemp" | "imutemperature" | "tempc" => {
            let mut meaning = Meaning::of(single(Quantity::Temperature));
            meaning.scale = key.ends_with('c').then_some(Scale::Si(1.0));
            return meaning;
        }
        _ => {}
    }
    axes(bare, &key, unit, of_file).unwrap_or(Meaning::of(Kind::Other))
}

/// A component of three or four.
fn axes(bare: &str, key: &str, unit: Option<&str>, of_file: Option<Quantity>) -> Option<Meaning> {
    let (rest, origin) = match key.strip_prefix("truth") {
        Some(rest) => (rest, Origin::Truth),
        None => (key, Origin::Sensor),
    };
    let rest = rest.strip_prefix("field").filter(|_| bare.starts_with("field.")).unwrap_or(rest);
    let trimmed = rest.trim_end_matches(|c: char| c.is_ascii_digit());
    let after = &rest[trimmed.len()..];
    let last = trimmed.chars().last()?;
    let before = &trimmed[..trimmed.len() - last.len_utf8()];
    let stem = before.trim_end_matches(|c: char| c.is_ascii_digit());
    let middle = &before[stem.len()..];
    let (device, stem) = match stem.strip_prefix("imu") {
        Some(rest) => {
            let name = rest.trim_start_matches(|c: char| c.is_ascii_digit());
            (&rest[..rest.len() - name.len()], name)
        }
        None => ("", stem),
    };
    let number = [middle, after, device].into_iter().find(|n| !n.is_empty());
    let sensor = match number {
        Some(number) => number.parse().ok()?,
        None => 0,
    };
    let by_unit = || {
        use Quantity::{AngularRate, MagneticField, SpecificForce};
        let fits = |quantity: &Quantity| unit.is_some_and(|u| units::scale(*quantity, u).is_some());
        [SpecificForce, AngularRate, MagneticField].into_iter().find(fits)
    };
    let mut quantity = match stem {
        "" if bare.chars().count() == 1 => of_file.or_else(by_unit)?,
        "imu" | "" => return None,
        _ => quantity(stem)?,
    };
    // ROS names specific force `linear_acceleration`.
    if quantity == Quantity::LinearAcceleration && bare.contains("linear_acceleration") {
        quantity = Quantity::SpecificForce;
    }
    let letters = match quantity {
        Quantity::Attitude => "wxyz",
        Quantity::Position | Quantity::Velocity if "enu".contains(last) => "enu",
        _ => "xyz",
    };
    let estimated = matches!(
        quantity,
        Quantity::Attitude | Quantity::Position | Quantity::Velocity | Quantity::Gravity
    );
    let words: Vec<&str> = bare.split_whitespace().collect();
    Some(Meaning {
        kind: Kind::Component {
            quantity,
            origin: match origin {
                Origin::Sensor if estimated => Origin::Estimate,
                origin => origin,
            },
            sensor,
            component: letters.find(last)?,
        },
        is_ours: words.len() > 1 && matches!(stem, "accelerometer" | "gyroscope" | "magnetometer"),
        ..Meaning::of(Kind::Other)
    })
}
