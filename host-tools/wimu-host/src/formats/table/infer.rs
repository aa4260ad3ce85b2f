//! Units and gravity that a table does not name, by its values.

use wimu_model::STANDARD_GRAVITY_MPS2 as G;

use super::layout::Group;
use super::units::Scale;
use super::zero::{self, Zero};
use crate::recording::{Quantity, Unit};
use crate::stats::{median, norm};
use crate::{Code, Problem, Result, Severity};

/// Relative tolerance of the median magnitude of a unit. Chosen: covers bias, scale and moderate motion.
const TOLERANCE: f64 = 0.15;
/// Magnitude at rest below which an acceleration excludes gravity, g. Chosen: it is near 0 without gravity, and 1 with it.
const WITHOUT_GRAVITY_G: f64 = 0.4;
/// Samples by which that is judged.
const MIN_SAMPLES: usize = 20;
/// Smallest sensitivity of counts, LSB/g. Chosen: an analogue sensor at 10 bits has 30 or more.
const MIN_COUNTS: f64 = 25.0;

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

/// What a track's values are judged by.
#[derive(Clone, Copy)]
pub struct Evidence<'a> {
    pub samples: &'a [[f64; 3]],
    pub program: Option<&'static str>,
    /// Whether the columns are called as wimu calls them.
    pub is_own: bool,
    /// Whether the file writes them without decimal mark.
    pub is_integer: bool,
    /// Output at zero, where the user says it, LSB.
    pub zero_count: Option<f64>,
}

/// Median magnitude.
pub fn median_norm(samples: &[[f64; 3]]) -> Option<f64> {
    median(samples.iter().copied().map(norm))
}

/// Conversion of the values of a track.
///
/// # Errors
/// `csv_unknown_unit`, which asks for `--units`.
pub fn conversion(
    group: &Group,
    evidence: Evidence,
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
    let is_rate = group.quantity == Quantity::AngularRate;
    let may_be_counts = evidence.is_integer || named == Some(Scale::Counts);
    if may_be_counts && !matches!(named, Some(Scale::Si(_))) && group.is_inertial() {
        conversion.zero = zero::find(group, evidence, findings);
    }
    let shifted = |row: &[f64; 3]| row.map(|v| conversion.zero.apply(v));
    let samples: Vec<[f64; 3]> = evidence.samples.iter().map(shifted).collect();
    match named {
        Some(Scale::Si(_)) => {
            conversion.unit = Unit::Si;
            let factor = |scale: &Option<Scale>| match scale {
                Some(Scale::Si(factor)) => *factor,
                _ => 1.0,
            };
            conversion.factors = group.scales.iter().map(factor).collect();
        }
        Some(Scale::Counts) => conversion.unit = Unit::Counts { si_per_lsb: None },
        Some(Scale::Unknown) => {}
        None if group.is_acceleration() => {
            let (unit, factor) = inferred(group, &samples, evidence.is_integer, findings)?;
            conversion.unit = unit;
            conversion.factors.fill(factor);
        }
        None if is_rate && evidence.is_integer => {
            conversion.unit = Unit::Counts { si_per_lsb: None }
        }
        None if is_rate => {
            let text = format!("`{}` is an angular rate without a unit", group.name);
            let remedy = "it is left out; name the unit: --columns \"…,gx=COLUMN:deg/s,…\"";
            let finding = Code::UnitInferred.warning(text).remedy(remedy);
            findings.push(finding.of_sensor(group.sensor));
            conversion.is_left_out = true;
        }
        None => {}
    }
    let is_1 = |magnitude: f64| (magnitude - 1.0).abs() <= TOLERANCE;
    if evidence.program == Some("Sensor Logger")
        && group.quantity == Quantity::SpecificForce
        && median_norm(&samples).is_some_and(is_1)
    {
        conversion.factors.fill(-G);
        let text = "the accelerations are in g, with the opposite sign: those of iOS";
        findings.push(Code::UnitInferred.note(text).of_sensor(group.sensor));
    }
    check_gravity(group, &samples, evidence.is_own, &mut conversion, findings);
    Ok(conversion)
}

/// Unit of an acceleration that is not named, and its factor.
fn inferred(
    group: &Group,
    samples: &[[f64; 3]],
    is_integer: bool,
    findings: &mut Vec<Problem>,
) -> Result<(Unit, f64)> {
    let asks = |message: String| {
        let remedy = "name it: --units m/s2, g, mg, mm/s2 or LSB; linear acceleration (gravity removed) cannot be used";
        Code::CsvUnknownUnit.error(message, remedy).at(format!("column `{}`", group.name))
    };
    let magnitude = median_norm(samples).ok_or_else(|| {
        asks("no unit is named, and there are no values to infer it from".to_owned())
    })?;
    let is_near = |expected: f64| (magnitude / expected - 1.0).abs() <= TOLERANCE;
    let counts = is_integer && magnitude >= MIN_COUNTS;
    let mut add = |text: String| {
        let text = format!("no unit is named: {text}");
        let finding = Code::UnitInferred.note(text).remedy("if not, give --units");
        findings.push(finding.of_sensor(group.sensor));
    };
    // Integers near 9.81 or 1 may be values of a coarse sensor in m/s² or g, or counts.
    match (is_near(9.81), is_near(1.0), counts) {
        (true, false, false) if !is_integer => {
            add(format!("median |f| {magnitude:.3}, taken as m/s²"));
            Ok((Unit::Si, 1.0))
        }
        (false, true, false) if !is_integer => {
            add(format!("median |f| {magnitude:.4}, taken as g"));
            Ok((Unit::Si, G))
        }
        _ if !is_integer && is_near(1000.0) => {
            add(format!("median |f| {magnitude:.1}, taken as mg"));
            Ok((Unit::Si, 1e-3 * G))
        }
        _ if !is_integer && is_near(1e3 * G) => {
            add(format!("median |f| {magnitude:.0}, taken as mm/s²"));
            Ok((Unit::Si, 1e-3))
        }
        (false, false, false) if is_power_of_two(samples) => {
            let lsb_per_g = zero::sensitivity(samples).unwrap_or(magnitude);
            add(format!(
                "|f| {lsb_per_g:.0} in all orientations, taken as counts of {lsb_per_g:.0} LSB/g"
            ));
            Ok((Unit::Counts { si_per_lsb: Some(G / lsb_per_g) }, 1.0))
        }
        (false, false, true) => {
            let lsb_per_g = zero::sensitivity(samples);
            let text = match lsb_per_g {
                Some(lsb) => {
                    format!("|f| {lsb:.0} in all orientations, taken as counts of {lsb:.0} LSB/g")
                }
                None => {
                    format!("median |f| {magnitude:.0}, taken as counts of unknown sensitivity")
                }
            };
            let text = format!("whole numbers, {text}");
            add(text);
            let si_per_lsb = lsb_per_g.map(|lsb| G / lsb);
            Ok((Unit::Counts { si_per_lsb }, 1.0))
        }
        (true, ..) | (_, true, _) => Err(asks(format!(
            "no unit is named; whole numbers with median |f| {magnitude:.2} may be counts or SI"
        ))),
        _ => Err(asks(format!(
            "no unit is named, and median |f| {magnitude:.4} is neither 9.81 (m/s²) nor 1 (g)"
        ))),
    }
}

/// Whether |f| is that of counts of a usual sensitivity, a power of two, averaged.
fn is_power_of_two(samples: &[[f64; 3]]) -> bool {
    let lsb_per_g = zero::sensitivity(samples).filter(|lsb| *lsb >= MIN_COUNTS);
    lsb_per_g.is_some_and(|lsb| (lsb / lsb.log2().round().exp2() - 1.0).abs() < 0.05)
}

/// Makes an acceleration without gravity a linear acceleration.
fn check_gravity(
    group: &Group,
    samples: &[[f64; 3]],
    is_own: bool,
    conversion: &mut Conversion,
    findings: &mut Vec<Problem>,
) {
    if !group.is_acceleration() {
        return;
    }
    let magnitude = zero::at_rest(samples).map(|magnitude| magnitude * conversion.factors[0].abs());
    let is_small = magnitude.is_some_and(|magnitude| magnitude < WITHOUT_GRAVITY_G * G)
        && samples.len() >= MIN_SAMPLES;
    let reason = match group.quantity {
        Quantity::LinearAcceleration => "by its name".to_owned(),
        // In wimu's own columns zeros are those of a dead sensor.
        _ if conversion.unit == Unit::Si && is_small && !is_own => {
            format!("|a| at rest is {:.2} m/s²", magnitude.unwrap_or(0.0))
        }
        _ => return,
    };
    conversion.quantity = Quantity::LinearAcceleration;
    let name = &group.name;
    let text = format!("`{name}` is linear acceleration, without gravity: {reason}");
    let remedy = "it cannot be used as specific force; export the acceleration with gravity";
    let finding = Problem::new(Code::GravityMissing, Severity::Error, text).remedy(remedy);
    findings.push(finding.of_sensor(group.sensor));
}
