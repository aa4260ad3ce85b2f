//! Meaning of a column's name: quantity, sensor, axis and unit.
//!
//! `Accelerometer 0 X (g)`, `acc_x [m/s^2]`, `AccelX (mg)`, `a_RS_S_x [m s^-2]`, `ax_g`, `xacc`, `field.angular_velocity.x` and
//! the like: letters and digits count, case does not; the axis is at the end, or before the quantity.

use super::units::{self, MICROSECOND, MILLISECOND, SECOND, Scale};
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

/// How sure a meaning is; where columns mean the same, the surest counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Certainty {
    /// One of wimu's own names, or said by the user.
    Own,
    Known,
    /// By the last words of a longer name.
    Guess,
}

/// A column by its name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Meaning {
    pub kind: Kind,
    /// Nanoseconds of the unit of a time, where it is named.
    pub unit_ns: Option<i64>,
    /// Unit of a component, where it is named.
    pub scale: Option<Scale>,
    /// Whether the named unit does not belong to the quantity.
    pub is_unit_unknown: bool,
    pub certainty: Certainty,
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
    pub const OTHER: Self = Self::of(Kind::Other);

    const fn of(kind: Kind) -> Self {
        Self {
            kind,
            unit_ns: None,
            scale: None,
            is_unit_unknown: false,
            certainty: Certainty::Known,
        }
    }

    const fn own(kind: Kind) -> Self {
        Self { certainty: Certainty::Own, ..Self::of(kind) }
    }

    /// Takes the unit that a name has; returns whether it is one of the kind.
    pub fn take_unit(&mut self, unit: &str) -> bool {
        match self.kind {
            Kind::Time => self.unit_ns = units::time(unit),
            Kind::Component { quantity, .. } => self.scale = units::scale(quantity, unit),
            _ => {}
        }
        self.unit_ns.is_some() || self.scale.is_some()
    }
}

/// Longest name that is looked at, bytes.
const MAX_NAME: usize = 100;

/// Names of times, as [`key`].
const TIMES: &str = "time timestamp t ts timens elapsedtime timeelapsed elapsed secondselapsed epoch unixtime systemtime sampletime micros \
     millis microseconds milliseconds nanoseconds hosttime devicetime stamp fieldheaderstamp chiptime loggingtime datetime \
     rtctime timestampunix unixtimestamp hhmmss hhmmssfff headerstampsec headerstampsecs stampsec stampsecs sec secs datum \
     uhrzeit zeit zeitstempel datumuhrzeit fecha hora heure";

/// Names of three axes without the axis, as [`key`].
const STEMS: &[(Quantity, &str)] = &[
    (
        Quantity::SpecificForce,
        "accelerometer acceleration accel acc a ac arss gf gforce totalacceleration rawacc accraw \
         accelerometeracceleration accelerometeruncalibrated accelerationwithg accsmooth accelerometerms2 beschleunigung \
         aceleracion aceleración accélération",
    ),
    (
        Quantity::LinearAcceleration,
        "linearacceleration linearaccelerometer linacc linaccel lacc linearaccel useracceleration accelerationwithoutg freeacc \
         linearebeschleunigung",
    ),
    (Quantity::Gravity, "gravity grav"),
    (
        Quantity::AngularRate,
        "gyroscope gyroscopeuncalibrated gyro gyr gy g w wrss omega angularvelocity angularrate rotationrate angvel rotation \
         rate gyroraw gyrorotation gyroadc gyrorad drehrate winkelgeschwindigkeit gyroskop",
    ),
    (Quantity::MagneticField, "magnetometer magneticfield mag m b h"),
    (Quantity::Position, "position"),
    (Quantity::Velocity, "velocity"),
    (Quantity::Attitude, "quaternion quat q orientation"),
];

/// Words by which a name is not that of what a sensor measures, and those that say nothing of it.
const NOT_MEASURED: &str = "bias std sd sigma cov covariance var variance noise error err target ref reference desired sim \
                            setpoint world earth global nav ned enu est estimated offset scale truth jerk";
const SAY_NOTHING: &str = "cal raw ln wr mean filt filtered";

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
pub fn time_unit(name: &str) -> Option<i64> {
    let (bare, unit) = split_unit(name);
    let last = bare.rsplit([' ', '_']).next();
    unit.or(last).and_then(units::time)
}

/// Meaning of a column; `of_file` is the quantity that the file's name says, for columns `x`, `y`, `z`.
pub fn meaning(name: &str, of_file: Option<Quantity>) -> Meaning {
    let name = name.trim_start_matches(['#', '%', ' ']).trim();
    if name.len() > MAX_NAME {
        return Meaning::OTHER;
    }
    // `accSmooth[0]` is X.
    let axis = |(index, axis)| Some(format!("{} {axis}", name.strip_suffix(index)?));
    let indexed = [("[0]", 'x'), ("[1]", 'y'), ("[2]", 'z')].into_iter().find_map(axis);
    let (bare, unit) = split_unit(indexed.as_deref().unwrap_or(name));
    let bare = match key(bare).as_str() {
        "xaxis" => "x",
        "yaxis" => "y",
        "zaxis" => "z",
        _ => bare,
    };
    let mut meaning = whole(bare, unit, of_file);
    if meaning.kind == Kind::Other && unit.is_none() {
        meaning = with_suffix(bare, of_file).unwrap_or(meaning);
    }
    if meaning.kind == Kind::Other {
        meaning = last_words(bare, of_file).unwrap_or(meaning);
    }
    let Some(unit) = unit else {
        if meaning.kind == Kind::Time && meaning.unit_ns.is_none() {
            meaning.unit_ns = match key(bare).as_str() {
                "timens" | "nanoseconds" | "fieldheaderstamp" => Some(1),
                "micros" | "microseconds" => Some(MICROSECOND),
                "millis" | "milliseconds" => Some(MILLISECOND),
                "secondselapsed" => Some(SECOND),
                _ => None,
            };
        }
        return meaning;
    };
    // `AngleX(deg)`: another quantity than the name suggests.
    let is_component = matches!(meaning.kind, Kind::Component { .. });
    meaning.is_unit_unknown = !meaning.take_unit(unit) && is_component && !unit.is_empty();
    meaning
}

/// `acc_x_g`, `time_ms`, `ax/g`, `gyro_x_deg_s`: a unit behind a separator.
fn with_suffix(name: &str, of_file: Option<Quantity>) -> Option<Meaning> {
    let mut breaks = name.char_indices().filter(|(_, c)| matches!(c, '_' | '/' | ' '));
    breaks.find_map(|(at, separator)| {
        let (bare, unit) = (&name[..at], &name[at + separator.len_utf8()..]);
        let unit = unit.replace('_', "/");
        let mut meaning = whole(bare, Some(&unit), of_file);
        meaning.take_unit(&unit).then_some(meaning)
    })
}

/// `RAW_IMU.xacc`, `/imu/data/linear_acceleration/x`, `Shimmer_Accel_LN_X_CAL`: the last words say it, those before are a name.
fn last_words(name: &str, of_file: Option<Quantity>) -> Option<Meaning> {
    let lower = name.to_lowercase();
    let words = lower.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty());
    let is_one = |list: &str, word: &&str| list.split_whitespace().any(|known| known == *word);
    let words: Vec<&str> = words.filter(|word| !is_one(SAY_NOTHING, word)).collect();
    if words.iter().any(|word| is_one(NOT_MEASURED, word)) {
        return None;
    }
    // `raw_x` alone is an axis of the file's quantity.
    let of_file = of_file.filter(|_| words.len() == 1);
    (0..words.len()).find_map(|first| {
        let meaning = axes(&words[first..].join("_"), None, of_file)?;
        Some(Meaning { certainty: Certainty::Guess, ..meaning })
    })
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

/// Meaning of a whole name without its unit.
fn whole(bare: &str, unit: Option<&str>, of_file: Option<Quantity>) -> Meaning {
    let key = key(bare);
    let temperature = Kind::Component {
        quantity: Quantity::Temperature,
        origin: Origin::Sensor,
        sensor: 0,
        component: 0,
    };
    match key.as_str() {
        "time" => Meaning::own(Kind::Time),
        "temperature" => Meaning::own(temperature),
        "sensitivity" if unit.is_some_and(|u| u.eq_ignore_ascii_case("LSB/g")) => {
            Meaning::own(Kind::Sensitivity)
        }
        "gyroscopescale" => Meaning::own(Kind::GyroscopeScale),
        // SampleTimeFine of Xsens and others say more; see the presets.
        _ if units::spelled(&[((), TIMES)], &key).is_some() => Meaning::of(Kind::Time),
        "temp" | "imudegc" | "imutemp" | "imutemperature" | "tempc" => {
            let scale = key.ends_with('c').then_some(Scale::Si(1.0));
            Meaning { scale, ..Meaning::of(temperature) }
        }
        _ => axes(bare, unit, of_file).unwrap_or(Meaning::OTHER),
    }
}

/// A component of three or four.
fn axes(bare: &str, unit: Option<&str>, of_file: Option<Quantity>) -> Option<Meaning> {
    let key = key(bare);
    let (rest, is_truth) = match key.strip_prefix("truth") {
        Some(rest) => (rest, true),
        None => (key.as_str(), false),
    };
    let rest = rest.strip_prefix("field").filter(|_| bare.starts_with("field.")).unwrap_or(rest);
    let is_digit = |c: char| c.is_ascii_digit();
    let trimmed = rest.trim_end_matches(is_digit);
    let after = &rest[trimmed.len()..];
    // `xacc` has its axis first.
    let first = trimmed.split_at_checked(1).filter(|(axis, stem)| {
        matches!(*axis, "x" | "y" | "z") && stem.len() > 2 && quantity(stem).is_some()
    });
    let (before, last) = match first {
        Some((axis, stem)) => (stem, axis.chars().next()?),
        None => {
            let (at, last) = trimmed.char_indices().next_back()?;
            (&trimmed[..at], last)
        }
    };
    let stem = before.trim_end_matches(is_digit);
    let middle = &before[stem.len()..];
    let (device, stem) = match stem.strip_prefix("imu") {
        Some(rest) => {
            let name = rest.trim_start_matches(is_digit);
            (&rest[..rest.len() - name.len()], name)
        }
        None => ("", stem),
    };
    let number = [middle, after, device].into_iter().find(|n| !n.is_empty());
    let sensor = number.map_or(Some(0), |number| number.parse().ok())?;
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
    use Quantity::{Attitude, Gravity, Position, Velocity};
    let letters = match quantity {
        Attitude => "wxyz",
        Position | Velocity if "enu".contains(last) => "enu",
        _ => "xyz",
    };
    let origin = match quantity {
        _ if is_truth => Origin::Truth,
        Attitude | Position | Velocity | Gravity => Origin::Estimate,
        _ => Origin::Sensor,
    };
    let is_own = bare.split_whitespace().count() > 1
        && matches!(stem, "accelerometer" | "gyroscope" | "magnetometer");
    let kind = Kind::Component { quantity, origin, sensor, component: letters.find(last)? };
    Some(if is_own { Meaning::own(kind) } else { Meaning::of(kind) })
}
