//! Units in column names.

use wimu_model::STANDARD_GRAVITY_MPS2 as G;

use crate::recording::Quantity;

/// What one of a column's unit is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scale {
    /// This many SI units of the quantity.
    Si(f64),
    /// One LSB.
    Counts,
    /// Named, but of no known size ("a.u.").
    Unknown,
}

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Spelling, after [`canonical`], and scale.
type Units = [(&'static str, Scale)];

const ACCELERATIONS: &Units = &[
    ("m/s2", Scale::Si(1.0)),
    ("m/s/s", Scale::Si(1.0)),
    ("ms-2", Scale::Si(1.0)),
    ("m/sec2", Scale::Si(1.0)),
    ("mps2", Scale::Si(1.0)),
    ("mpss", Scale::Si(1.0)),
    ("ms2", Scale::Si(1.0)),
    ("cm/s2", Scale::Si(1e-2)),
    ("mm/s2", Scale::Si(1e-3)),
    ("ft/s2", Scale::Si(0.3048)),
    ("ft/s/s", Scale::Si(0.3048)),
    ("ft/sec2", Scale::Si(0.3048)),
    ("g", Scale::Si(G)),
    ("gs", Scale::Si(G)),
    ("mg", Scale::Si(1e-3 * G)),
    ("millig", Scale::Si(1e-3 * G)),
    ("milli-g", Scale::Si(1e-3 * G)),
    ("ug", Scale::Si(1e-6 * G)),
];

const RATES: &Units = &[
    ("rad/s", Scale::Si(1.0)),
    ("rads-1", Scale::Si(1.0)),
    ("rad/sec", Scale::Si(1.0)),
    ("radps", Scale::Si(1.0)),
    ("rads", Scale::Si(1.0)),
    ("mrad/s", Scale::Si(1e-3)),
    ("deg/s", Scale::Si(DEGREE)),
    ("degs-1", Scale::Si(DEGREE)),
    ("deg/sec", Scale::Si(DEGREE)),
    ("degree/s", Scale::Si(DEGREE)),
    ("degrees/s", Scale::Si(DEGREE)),
    ("degps", Scale::Si(DEGREE)),
    ("dps", Scale::Si(DEGREE)),
    ("mdeg/s", Scale::Si(1e-3 * DEGREE)),
    ("mdps", Scale::Si(1e-3 * DEGREE)),
];

const FIELDS: &Units = &[
    ("ut", Scale::Si(1e-6)),
    ("microtesla", Scale::Si(1e-6)),
    ("t", Scale::Si(1.0)),
    ("mt", Scale::Si(1e-3)),
    ("nt", Scale::Si(1e-9)),
    ("g", Scale::Si(1e-4)),
    ("gauss", Scale::Si(1e-4)),
    ("mg", Scale::Si(1e-7)),
    ("mgauss", Scale::Si(1e-7)),
    ("mga", Scale::Si(1e-7)),
];

const COUNTS: &Units = &[
    ("lsb", Scale::Counts),
    ("counts", Scale::Counts),
    ("count", Scale::Counts),
    ("raw", Scale::Counts),
    ("adc", Scale::Counts),
    ("au", Scale::Unknown),
    ("arb", Scale::Unknown),
];

const TEMPERATURES: &Units = &[
    ("c", Scale::Si(1.0)),
    ("degc", Scale::Si(1.0)),
    ("celsius", Scale::Si(1.0)),
];
const LENGTHS: &Units = &[("m", Scale::Si(1.0)), ("mm", Scale::Si(1e-3))];
const SPEEDS: &Units = &[("m/s", Scale::Si(1.0)), ("ms-1", Scale::Si(1.0))];

/// Powers of ten of a nanosecond that stand for a minute, 6 × 10¹⁰ ns, and an hour, 36 × 10¹¹ ns; see [`multiple`].
const MINUTE: i32 = 10;
const HOUR: i32 = 11;

/// Times: power of ten of a nanosecond.
const TIMES: &[(&str, i32)] = &[
    ("h", HOUR),
    ("hr", HOUR),
    ("hrs", HOUR),
    ("hour", HOUR),
    ("hours", HOUR),
    ("min", MINUTE),
    ("mins", MINUTE),
    ("minute", MINUTE),
    ("minutes", MINUTE),
    ("s", 9),
    ("sec", 9),
    ("secs", 9),
    ("second", 9),
    ("seconds", 9),
    ("ms", 6),
    ("msec", 6),
    ("millis", 6),
    ("millisecond", 6),
    ("milliseconds", 6),
    ("epochms", 6),
    ("us", 3),
    ("usec", 3),
    ("micros", 3),
    ("microsecond", 3),
    ("microseconds", 3),
    ("epochus", 3),
    ("ns", 0),
    ("nsec", 0),
    ("nanos", 0),
    ("nanosecond", 0),
    ("nanoseconds", 0),
];

/// A unit in one spelling: `m s^-2`, `m/s²`, `°/s`, `µT` become `ms-2`, `m/s2`, `deg/s`, `ut`.
fn canonical(unit: &str) -> String {
    let mut text = String::new();
    for c in unit.chars() {
        match c {
            // Micro sign, Greek mu, and letters that programs write in their place.
            'µ' | 'μ' | 'ʯ' => text.push('u'),
            '²' => text.push('2'),
            '⁻' => text.push('-'),
            '¹' => text.push('1'),
            '°' | 'º' => text.push_str("deg"),
            ' ' | '^' | '*' | '·' | '.' | '\u{fffd}' => {}
            c => text.extend(c.to_lowercase()),
        }
    }
    text
}

/// Scale of a unit of a quantity; `None` if it is not one.
pub fn scale(quantity: Quantity, unit: &str) -> Option<Scale> {
    let known: &[&Units] = match quantity {
        Quantity::SpecificForce | Quantity::LinearAcceleration | Quantity::Gravity => {
            &[ACCELERATIONS, COUNTS]
        }
        Quantity::AngularRate => &[RATES, COUNTS],
        Quantity::MagneticField => &[FIELDS, COUNTS],
        Quantity::Temperature => &[TEMPERATURES],
        Quantity::Position => &[LENGTHS],
        Quantity::Velocity => &[SPEEDS],
        _ => &[],
    };
    let text = canonical(unit);
    let mut known = known.iter().flat_map(|units| units.iter());
    known
        .find(|(name, _)| *name == text)
        .map(|(_, scale)| *scale)
}

/// Factor of the power of ten of a unit of time: not 1 for minutes and hours.
pub fn multiple(exponent: i32) -> i64 {
    match exponent {
        MINUTE => 6,
        HOUR => 36,
        _ => 1,
    }
}

/// Power of ten of a nanosecond of a unit of time, which is to be multiplied by its [`multiple`].
pub fn time(unit: &str) -> Option<i32> {
    let text = canonical(unit).replace('_', "");
    let found = TIMES.iter().find(|(name, _)| *name == text)?;
    Some(found.1)
}
