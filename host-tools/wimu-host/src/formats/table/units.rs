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

/// Scale, and its spellings after [`canonical`].
type Units = [(Scale, &'static str)];

#[rustfmt::skip]
const ACCELERATIONS: &Units = &[
    (Scale::Si(1.0), "m/s2 m/s/s ms-2 m/sec2 mps2 mpss ms2"), (Scale::Si(1e-2), "cm/s2"), (Scale::Si(1e-3), "mm/s2"),
    (Scale::Si(0.3048), "ft/s2 ft/s/s ft/sec2"),
    (Scale::Si(G), "g gs"), (Scale::Si(1e-3 * G), "mg millig milli-g"), (Scale::Si(1e-6 * G), "ug"),
    (Scale::Si(G / 2048.0), "g/2048"),
];
#[rustfmt::skip]
const RATES: &Units = &[
    (Scale::Si(1.0), "rad/s rads-1 rad/sec radps rads"), (Scale::Si(1e-3), "mrad/s"),
    (Scale::Si(DEGREE), "deg/s degs-1 deg/sec degree/s degrees/s degps dps"), (Scale::Si(1e-3 * DEGREE), "mdeg/s mdps"),
];
#[rustfmt::skip]
const FIELDS: &Units = &[
    (Scale::Si(1.0), "t"), (Scale::Si(1e-3), "mt"), (Scale::Si(1e-6), "ut microtesla"), (Scale::Si(1e-9), "nt"),
    (Scale::Si(1e-4), "g gauss"), (Scale::Si(1e-7), "mg mgauss mga"),
];
const COUNTS: &Units = &[(Scale::Counts, "lsb counts count raw adc"), (Scale::Unknown, "au arb")];
const TEMPERATURES: &Units = &[(Scale::Si(1.0), "c degc celsius")];

/// Size of units in SI units, and their spellings after [`canonical`].
pub(crate) type Sizes = &'static [(f64, &'static str)];
/// A number without a unit.
pub(crate) const NUMBER: Sizes = &[(1.0, "")];
pub(crate) const LENGTH: Sizes = &[(1.0, "m"), (1e-2, "cm"), (1e-3, "mm")];
pub(crate) const TIME: Sizes =
    &[(1.0, "s sec"), (1e-3, "ms msec"), (1e-6, "us usec"), (1e-9, "ns nsec")];
pub(crate) const SPEED: Sizes = &[(1.0, "m/s ms-1"), (1.0 / 3.6, "km/h")];
pub(crate) const ANGLE: Sizes = &[(1.0, "rad"), (DEGREE, "deg")];

/// Nanoseconds of a unit of time, and its spellings.
pub const TIMES: &[(i64, &str)] = &[
    (3_600_000_000_000, "h hr hrs hour hours"),
    (60_000_000_000, "min mins minute minutes"),
    (SECOND, "s sec secs second seconds"),
    (MILLISECOND, "ms msec millis millisecond milliseconds epochms"),
    (MICROSECOND, "us usec micros microsecond microseconds epochus"),
    (1, "ns nsec nanos nanosecond nanoseconds"),
];
pub const SECOND: i64 = 1_000_000_000;
pub const MILLISECOND: i64 = 1_000_000;
pub const MICROSECOND: i64 = 1_000;

/// The entry of a table among whose spellings a text is.
pub fn spelled<T: Copy>(table: &[(T, &str)], text: &str) -> Option<T> {
    let has = |(_, spellings): &&(T, &str)| {
        spellings.split(' ').any(|known| known.eq_ignore_ascii_case(text))
    };
    table.iter().find(has).map(|(entry, _)| *entry)
}

/// A unit in one spelling: `m s^-2`, `m/(s²)`, `°/s`, `µT` become `ms-2`, `m/s2`, `deg/s`, `ut`.
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
            ' ' | '^' | '*' | '·' | '.' | '(' | ')' | '_' | '\u{fffd}' => {}
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
        Quantity::Position => return size(LENGTH, unit).map(Scale::Si),
        Quantity::Velocity => return size(SPEED, unit).map(Scale::Si),
        _ => &[],
    };
    let text = canonical(unit);
    known.iter().find_map(|units| spelled(units, &text))
}

/// Size of a unit in SI units.
pub(crate) fn size(sizes: Sizes, unit: &str) -> Option<f64> {
    spelled(sizes, &canonical(unit))
}

/// Nanoseconds of a unit of time.
pub fn time(unit: &str) -> Option<i64> {
    spelled(TIMES, &canonical(unit))
}
