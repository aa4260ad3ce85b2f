//! What the values of a track show that its columns do not name: their unit, whether gravity is in them, where zero is.

use wimu_model::STANDARD_GRAVITY_MPS2 as G;

use super::layout::Group;
use super::names::key;
use super::presets::SENSOR_LOGGER;
use super::units::Scale;
use super::zero::{self, Zero};
use crate::formats::ReadOptions;
use crate::problem::Severity;
use crate::recording::{Quantity, Unit};
use crate::stats::{median, norm};
use crate::{Code, Problem, Result};

/// Relative tolerance of the median magnitude of a unit. Chosen: covers bias, scale and moderate motion.
const TOLERANCE: f64 = 0.15;
/// Magnitude at rest below which an acceleration excludes gravity, g. Chosen: it is near 0 without gravity, and 1 with it.
const WITHOUT_GRAVITY_G: f64 = 0.4;
/// Standard deviation of values at rest, of their magnitude, at most. Chosen: a phone in a hand has half of it.
const REST: f64 = 0.05;
/// Samples by which that is judged.
const MIN_SAMPLES: usize = 20;
/// Smallest sensitivity of counts, LSB/g. Chosen: an analogue sensor at 10 bits has 30 or more.
const MIN_COUNTS: f64 = 25.0;
/// Units that a magnitude may show: their m/s², and their names.
const UNITS: [(f64, &str); 4] = [(1.0, "m/s²"), (G, "g"), (1e-3 * G, "mg"), (1e-3, "mm/s²")];

/// How the values of a track become those that are handed on.
#[derive(Clone, Debug)]
pub struct Conversion {
    pub quantity: Quantity,
    pub unit: Unit,
    /// SI units, or counts, of one of each column's unit.
    pub factors: Vec<f64>,
    pub zero: Zero,
    /// Whether the track is left out.
    pub is_left_out: bool,
}

/// Median magnitude.
pub fn median_norm(samples: &[[f64; 3]]) -> Option<f64> {
    median(samples.iter().copied().map(norm))
}

/// Conversion of the values of a track; the file writes them as whole numbers if `is_integer`.
///
/// # Errors
/// `csv_unknown_unit`, which asks for `--units`.
pub fn conversion(
    group: &Group,
    samples: &[[f64; 3]],
    is_integer: bool,
    program: Option<&'static str>,
    options: &ReadOptions,
    findings: &mut Vec<Problem>,
) -> Result<Conversion> {
    let mut conversion = Conversion {
        quantity: group.quantity,
        unit: Unit::Unknown,
        factors: vec![1.0; group.columns.len()],
        zero: Zero::None,
        is_left_out: false,
    };
    let named = group.scales[0];
    let may_be_counts = is_integer || named == Some(Scale::Counts);
    if may_be_counts && !matches!(named, Some(Scale::Si(_))) && group.is_inertial() {
        let given = options.zero_count.or(options.stored_zero_count);
        conversion.zero = zero::find(group, samples, given, findings);
    }
    let shifted = samples.iter().map(|row| row.map(|v| conversion.zero.apply(v)));
    let samples: Vec<[f64; 3]> = shifted.collect();
    let look_alike = group.is_implied.then(|| look_alike(group, &samples, findings)).flatten();
    match named {
        _ if look_alike.is_some() => {
            let factor = look_alike.unwrap_or(1.0);
            // The raw accelerations of iOS have the opposite sign.
            let is_ios =
                program == Some(SENSOR_LOGGER) && key(&group.name) == "accelerometeruncalibrated";
            conversion.unit = Unit::Si;
            conversion.factors.fill(if is_ios { -factor } else { factor });
        }
        Some(Scale::Si(_)) => {
            conversion.unit = Unit::Si;
            for (factor, scale) in conversion.factors.iter_mut().zip(&group.scales) {
                if let Some(Scale::Si(si)) = scale {
                    *factor = *si;
                }
            }
        }
        Some(Scale::Counts) => conversion.unit = Unit::Counts { si_per_lsb: None },
        Some(Scale::Unknown) => {}
        None if group.is_acceleration() => {
            let (unit, factor) = inferred(group, &samples, is_integer, findings)?;
            conversion.unit = unit;
            conversion.factors.fill(factor);
        }
        None if group.quantity == Quantity::AngularRate && is_integer => {
            conversion.unit = Unit::Counts { si_per_lsb: None };
        }
        None if group.quantity == Quantity::AngularRate => {
            let text = format!("`{}` is an angular rate without a unit", group.name);
            let remedy = "it is left out; name the unit: --columns \"…,gx=COLUMN:deg/s,…\"";
            let finding = Code::UnitInferred.warning(text).remedy(remedy);
            findings.push(finding.of_sensor(group.sensor));
            conversion.is_left_out = true;
        }
        None => {}
    }
    let is_own = program.is_none() && group.name.starts_with("Accelerometer");
    check_gravity(group, &samples, is_own, &mut conversion, findings)?;
    Ok(conversion)
}

/// Whether the values are at rest, and there 1 g in a unit of this many m/s².
fn is_one_g(samples: &[[f64; 3]], mps2: f64) -> bool {
    zero::at_rest(samples).is_some_and(|(magnitude, sd)| {
        (magnitude * mps2 / G - 1.0).abs() <= TOLERANCE && sd < REST * magnitude
    })
}

/// m/s² of the unit of a specific force, where it is not the one that the program writes.
fn look_alike(group: &Group, samples: &[[f64; 3]], findings: &mut Vec<Problem>) -> Option<f64> {
    let Some(Scale::Si(implied)) = group.scales[0] else { return None };
    if group.quantity != Quantity::SpecificForce || is_one_g(samples, implied) {
        return None;
    }
    let (mps2, unit) = UNITS.into_iter().find(|(mps2, _)| is_one_g(samples, *mps2))?;
    let text = format!(
        "`{}` is taken as {unit}: its magnitude at rest is 1 g only so, though this program usually writes another unit",
        group.name
    );
    findings.push(Code::UnitInferred.warning(text).remedy("if that is wrong, give --units"));
    Some(mps2)
}

fn unknown(group: &Group, message: String) -> Problem {
    let remedy = "name it: --units m/s2, g, mg, mm/s2 or LSB; linear acceleration (gravity removed) cannot be used";
    Code::CsvUnknownUnit.error(message, remedy).at(format!("column `{}`", group.name))
}

/// Unit of an acceleration that is not named, and its factor.
fn inferred(
    group: &Group,
    samples: &[[f64; 3]],
    is_integer: bool,
    findings: &mut Vec<Problem>,
) -> Result<(Unit, f64)> {
    let Some(magnitude) = median_norm(samples) else {
        let text = "no unit is named, and there are no values to infer it from".to_owned();
        return Err(unknown(group, text));
    };
    let is_near = |mps2: f64| (magnitude * mps2 / 9.81 - 1.0).abs() <= TOLERANCE;
    let unit = UNITS.into_iter().find(|(mps2, _)| is_near(*mps2));
    let lsb_per_g = zero::sensitivity(samples);
    let is_counts = is_integer && magnitude >= MIN_COUNTS;
    let (text, found) = match unit {
        Some((mps2, unit)) if !is_integer => {
            let text = format!("median |f| {magnitude:.4}, taken as {unit}");
            (text, (Unit::Si, mps2))
        }
        // Whole numbers near 9.81 or 1 may be values of a coarse sensor in m/s² or g, or counts.
        Some(_) if !is_counts => {
            let text = format!(
                "no unit is named; whole numbers with median |f| {magnitude:.2} may be counts or SI"
            );
            return Err(unknown(group, text));
        }
        _ => match lsb_per_g {
            Some(lsb) if is_counts || is_power_of_two(lsb) => {
                let whole = if is_counts { "whole numbers, " } else { "" };
                let text = format!(
                    "{whole}|f| {lsb:.0} in all orientations, taken as counts of {lsb:.0} LSB/g"
                );
                (text, (Unit::Counts { si_per_lsb: Some(G / lsb) }, 1.0))
            }
            None if is_counts => {
                let text = format!(
                    "whole numbers, median |f| {magnitude:.0}, taken as counts of unknown sensitivity"
                );
                (text, (Unit::Counts { si_per_lsb: None }, 1.0))
            }
            _ => {
                let text = format!(
                    "no unit is named, and median |f| {magnitude:.4} is neither 9.81 (m/s²) nor 1 (g)"
                );
                return Err(unknown(group, text));
            }
        },
    };
    let finding = Code::UnitInferred.note(format!("no unit is named: {text}"));
    findings.push(finding.remedy("if not, give --units").of_sensor(group.sensor));
    Ok(found)
}

/// Whether a sensitivity is a usual one of counts, averaged.
fn is_power_of_two(lsb: f64) -> bool {
    lsb >= MIN_COUNTS && (lsb / lsb.log2().round().exp2() - 1.0).abs() < 0.05
}

/// Makes an acceleration without gravity a linear acceleration.
///
/// # Errors
/// `csv_unknown_unit` where 1 g is 1 in a header's m/s².
fn check_gravity(
    group: &Group,
    samples: &[[f64; 3]],
    is_own: bool,
    conversion: &mut Conversion,
    findings: &mut Vec<Problem>,
) -> Result<()> {
    if !group.is_acceleration() {
        return Ok(());
    }
    let factor = conversion.factors[0].abs();
    let magnitude = zero::at_rest(samples).map(|(magnitude, _)| magnitude * factor);
    let is_small = magnitude.is_some_and(|magnitude| magnitude < WITHOUT_GRAVITY_G * G)
        && samples.len() >= MIN_SAMPLES;
    let reason = match (group.quantity, magnitude) {
        (Quantity::LinearAcceleration, _) => "by its name".to_owned(),
        // In wimu's own columns zeros are those of a dead sensor.
        (_, Some(magnitude)) if conversion.unit == Unit::Si && is_small && !is_own => {
            if let Some((_, unit)) = UNITS.into_iter().find(|(mps2, _)| is_one_g(samples, *mps2)) {
                let text = format!(
                    "|f| at rest is {magnitude:.3} m/s² by the unit of its name, and 1 g in {unit}"
                );
                let remedy = format!("give --units {}", unit.replace('²', "2"));
                let error = Code::CsvUnknownUnit.error(text, remedy);
                return Err(error.at(format!("column `{}`", group.name)));
            }
            format!("|a| at rest is {magnitude:.2} m/s²")
        }
        _ => return Ok(()),
    };
    conversion.quantity = Quantity::LinearAcceleration;
    let name = &group.name;
    let text = format!("`{name}` is linear acceleration, without gravity: {reason}");
    let remedy = "it cannot be used as specific force; export the acceleration with gravity";
    let finding = Problem::new(Code::GravityMissing, Severity::Error, text).remedy(remedy);
    findings.push(finding.of_sensor(group.sensor));
    Ok(())
}
