//! Datasheet limits of accelerometers, and an estimate beside them.

use serde::Serialize;
use wimu_calib::{Estimate, Parameter};
use wimu_model::STANDARD_GRAVITY_MPS2;

use super::report::AXES;
use crate::digits::{signed, significant};
use crate::{Code, Problem, Result};

/// Largest magnitude of an error in a datasheet.
#[derive(Clone, Copy, Debug)]
enum Limit {
    /// Many good sensors exceed it.
    Typical(f64),
    Guaranteed(f64),
}
use Limit::{Guaranteed, Typical};

/// What the datasheet of an accelerometer says, at 25 °C.
#[derive(Clone, Copy, Debug)]
pub struct Datasheet {
    /// The sensor, as its maker writes it.
    pub sensor: &'static str,
    /// Source of the values.
    pub document: &'static str,
    /// Nominal sensitivity at each range, LSB/g.
    pub sensitivities_lsb_per_g: &'static [f64],
    /// Zero-g offset per axis, mg.
    zero_g_offset: [Limit; 3],
    /// Departure from the nominal sensitivity, %.
    sensitivity: Option<Limit>,
}

/// Ranges of ±2, 4, 8 and 16 g in 16 bits.
const BINARY: &[f64] = &[16384.0, 8192.0, 4096.0, 2048.0];

impl Datasheet {
    /// The known ones. The offsets were verified in copies of the documents or in drivers that quote them, the tolerances
    /// of the sensitivity of MPU-6050 and ADXL345 too.
    pub const KNOWN: [Self; 6] = [
        Self {
            sensor: "LSM303AGR",
            document: "ST LSM303AGR, table 3",
            // 16 LSB a digit: 0.98, 1.95, 3.9 and 11.72 mg a digit.
            sensitivities_lsb_per_g: &[16326.5, 8205.1, 4102.6, 1365.2],
            zero_g_offset: [Guaranteed(80.0); 3],
            sensitivity: None,
        },
        Self {
            sensor: "ADXL345",
            document: "Analog Devices ADXL345, table 1",
            sensitivities_lsb_per_g: &[256.0, 128.0, 64.0, 32.0],
            zero_g_offset: [Guaranteed(150.0), Guaranteed(150.0), Guaranteed(250.0)],
            // 230 to 282 LSB/g.
            sensitivity: Some(Guaranteed(10.2)),
        },
        Self {
            sensor: "MPU-6050",
            document: "InvenSense PS-MPU-6000A-00 rev. 3.4, 6.2",
            sensitivities_lsb_per_g: BINARY,
            zero_g_offset: [Typical(50.0), Typical(50.0), Typical(80.0)],
            sensitivity: Some(Typical(3.0)),
        },
        Self {
            sensor: "MPU-9150",
            document: "InvenSense PS-MPU-9150A-00 rev. 4.3, 6.2",
            sensitivities_lsb_per_g: BINARY,
            zero_g_offset: [Typical(80.0), Typical(80.0), Typical(150.0)],
            sensitivity: Some(Typical(3.0)),
        },
        Self {
            sensor: "MPU-9250",
            document: "InvenSense PS-MPU-9250A-01 rev. 1.0, 3.2",
            sensitivities_lsb_per_g: BINARY,
            zero_g_offset: [Typical(60.0), Typical(60.0), Typical(80.0)],
            sensitivity: Some(Typical(3.0)),
        },
        Self {
            sensor: "ICM-20948",
            document: "InvenSense DS-000189 rev. 1.3, 3.2",
            sensitivities_lsb_per_g: BINARY,
            // On a board.
            zero_g_offset: [Typical(50.0); 3],
            sensitivity: Some(Typical(0.5)),
        },
    ];

    /// That of the sensor `name`; hyphens and case are ignored.
    pub fn of(name: &str) -> Option<&'static Self> {
        fn plain(name: &str) -> impl Iterator<Item = char> + '_ {
            name.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_uppercase())
        }
        Self::KNOWN.iter().find(|known| plain(known.sensor).eq(plain(name)))
    }
}

/// The datasheet of the sensor called `name`.
///
/// # Errors
/// `usage` when it is unknown; the remedy lists the known ones.
pub fn datasheet(name: &str) -> Result<&'static Datasheet> {
    Datasheet::of(name).ok_or_else(|| {
        Code::Usage.error(
            format!("no datasheet is known for the sensor {name:?}"),
            format!(
                "known sensors: {}; for others leave out --chip",
                Datasheet::KNOWN.map(|known| known.sensor).join(", ")
            ),
        )
    })
}

/// A parameter compared with the datasheet's limit.
#[derive(Serialize)]
struct LimitReport {
    quantity: &'static str,
    /// Axis.
    of: &'static str,
    unit: &'static str,
    value: f64,
    half_width_95: f64,
    /// Largest magnitude in the datasheet.
    limit: f64,
    guaranteed: bool,
    /// Whether the whole interval is beyond the limit.
    beyond: bool,
}

/// Comparison of an estimate with its sensor's datasheet.
#[derive(Serialize)]
pub(super) struct DatasheetReport {
    sensor: &'static str,
    document: &'static str,
    /// The parameters that the poses determine and the datasheet limits.
    limits: Vec<LimitReport>,
}

impl DatasheetReport {
    /// `sensitivity_lsb_per_g` is that which converted counts to m/s²; `None` for data in g or m/s².
    pub fn new(
        datasheet: &Datasheet,
        estimate: &Estimate,
        sensitivity_lsb_per_g: Option<f64>,
    ) -> Self {
        // The sensitivity that converted the poses over the nominal one; unknown far from all of them.
        let scale = sensitivity_lsb_per_g.map_or(Some(1.0), |used| {
            let ratios = datasheet.sensitivities_lsb_per_g.iter().map(|nominal| used / nominal);
            ratios.into_iter().find(|ratio| (0.8..1.2).contains(ratio))
        });
        let terms = estimate.model.terms();
        let limit = |parameter: Parameter| {
            let (place, mg) = (parameter.index(), 1e3 / STANDARD_GRAVITY_MPS2);
            let (quantity, unit, value, factor, limit) = match place {
                0..3 => {
                    let limit = datasheet.zero_g_offset[place];
                    ("zero-g offset", "mg", terms.bias_mps2[place] * mg, mg, limit)
                }
                3 | 7 | 11 => {
                    let (axis, factor) = (place % 3, 100.0 * scale?);
                    let off = terms.matrix[axis][axis] * factor - 100.0;
                    ("sensitivity off nominal", "%", off, factor, datasheet.sensitivity?)
                }
                _ => return None,
            };
            let (Typical(most) | Guaranteed(most)) = limit;
            let half_width_95 = estimate.half_width_95(parameter) * factor;
            Some(LimitReport {
                quantity,
                of: AXES[place % 3],
                unit,
                value,
                half_width_95,
                limit: most,
                guaranteed: matches!(limit, Guaranteed(_)),
                beyond: f64::abs(value) - half_width_95 > most,
            })
        };
        let seen = estimate.fitted.without(estimate.assumed);
        let limits = seen.iter().filter_map(limit).collect();
        Self { sensor: datasheet.sensor, document: datasheet.document, limits }
    }

    /// The parameters beyond their limits, or that there are none.
    pub fn finding(&self) -> Problem {
        let (code, count, document) = (Code::Datasheet, self.limits.len(), self.document);
        let beyond = || self.limits.iter().filter(|limit| limit.beyond);
        let part = |limit: &LimitReport| {
            let kind = if limit.guaranteed { "guaranteed" } else { "typical" };
            let (value, half) = (signed(limit.value, 3), significant(limit.half_width_95, 2));
            let LimitReport { quantity, of, unit, limit, .. } = limit;
            format!("{quantity} of {of} {value} ± {half} {unit} ({kind} ±{limit})")
        };
        match (beyond().count(), count) {
            (_, 0) => code.note(format!("{document}: no limits for the fitted parameters")),
            (0, _) => code
                .note(format!("no parameter of {count} exceeds its datasheet limit ({document})")),
            (exceed, _) => code
                .warning(format!(
                    "{exceed} of {count} parameters exceed their datasheet limits ({document}): {}",
                    beyond().map(part).collect::<Vec<_>>().join(", ")
                ))
                .remedy("check that it is this sensor, at its nominal sensitivity and about 25 °C"),
        }
    }
}
