//! An estimate beside its sensor's datasheet.

use std::fmt;

use serde::Serialize;
use wimu_calib::{Datasheet, Estimate, Finding, Quantity, Verdict};

use crate::error::{ErrorCode, HostError, Result};

/// The datasheet of the sensor called `name`.
///
/// # Errors
/// `usage` when it is not known; the remedy lists those that are.
pub fn datasheet(name: &str) -> Result<&'static Datasheet> {
    Datasheet::of(name).ok_or_else(|| {
        HostError::new(
            ErrorCode::Usage,
            format!("no datasheet of a sensor {name:?} is known"),
            format!(
                "known are {}; leave --sensor-model out for others",
                Datasheet::KNOWN.map(|known| known.sensor).join(", ")
            ),
        )
    })
}

/// A parameter beside the datasheet's limit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LimitReport {
    /// What, such as "zero-g offset".
    pub quantity: String,
    /// Of which axis, or of which two.
    pub of: &'static str,
    /// Unit of the numbers.
    pub unit: &'static str,
    /// As estimated.
    pub value: f64,
    /// Half its 95 % interval.
    pub half_width_95: f64,
    /// The largest size that the datasheet names.
    pub limit: f64,
    /// Whether the maker guarantees it, or calls it typical.
    pub guaranteed: bool,
    /// `within`, `unclear` or `beyond`, going by the interval.
    pub verdict: String,
}

/// An estimate beside its sensor's datasheet.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DatasheetReport {
    /// The sensor.
    pub sensor: &'static str,
    /// Where the limits are from.
    pub document: &'static str,
    /// How many parameters are beyond their limits.
    pub beyond: usize,
    /// How many of those limits the maker guarantees.
    pub beyond_guaranteed: usize,
    /// Each fitted parameter that the datasheet has a limit for.
    pub limits: Vec<LimitReport>,
}

impl DatasheetReport {
    /// `sensitivity_lsb_per_g` is that by which counts came to m/s²; `None` for data in g or m/s².
    pub(super) fn new(
        datasheet: &Datasheet,
        estimate: &Estimate,
        sensitivity_lsb_per_g: Option<f64>,
        range_g: Option<u8>,
    ) -> Self {
        let scale = match sensitivity_lsb_per_g {
            Some(used) => datasheet.nominal(used).map(|nominal| used / nominal),
            None => Some(1.0),
        };
        let findings: Vec<Finding> = datasheet
            .findings(estimate, scale, range_g.map(f64::from))
            .collect();
        let beyond = || findings.iter().filter(|f| f.verdict() == Verdict::Beyond);
        Self {
            sensor: datasheet.sensor,
            document: datasheet.document,
            beyond: beyond().count(),
            beyond_guaranteed: beyond().filter(|f| f.limit.guaranteed).count(),
            limits: findings.iter().map(limit).collect(),
        }
    }

    /// As rows of a table under [`DatasheetReport::HEAD`].
    pub(super) fn rows(&self) -> Vec<Vec<String>> {
        let row = |limit: &LimitReport| {
            vec![
                format!("{} {}", limit.quantity, limit.of),
                format!(
                    "{:+.3} ± {:.3} {}",
                    limit.value, limit.half_width_95, limit.unit
                ),
                format!(
                    "± {} {}{}",
                    limit.limit,
                    limit.unit,
                    if limit.guaranteed { "" } else { ", typical" }
                ),
                limit.verdict.clone(),
            ]
        };
        self.limits.iter().map(row).collect()
    }

    pub(super) const HEAD: [&'static str; 4] =
        ["parameter", "estimate, 95 %", "datasheet", "verdict"];
}

fn limit(finding: &Finding) -> LimitReport {
    LimitReport {
        quantity: finding.quantity.to_string(),
        of: finding.subject,
        unit: Quantity::unit(finding.quantity),
        value: finding.value,
        half_width_95: finding.half_width_95,
        limit: finding.limit.most,
        guaranteed: finding.limit.guaranteed,
        verdict: finding.verdict().to_string(),
    }
}

impl fmt::Display for DatasheetReport {
    /// A line for each quantity.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "beside the datasheet ({}):", self.document)?;
        if self.limits.is_empty() {
            return write!(out, " it has no limit for what was fitted");
        }
        for of_one in self.limits.chunk_by(|a, b| a.quantity == b.quantity) {
            let Some(first) = of_one.first() else {
                continue;
            };
            let kind = if first.guaranteed { "" } else { ", typical" };
            write!(out, "\n  {}, {}{kind}:", first.quantity, first.unit)?;
            for (place, limit) in of_one.iter().enumerate() {
                let comma = if place > 0 { "," } else { "" };
                let verdict = match limit.verdict.as_str() {
                    "within" => String::new(),
                    other => format!(" {}", other.to_uppercase()),
                };
                write!(
                    out,
                    "{comma} {} {:+.3} of ± {}{verdict}",
                    limit.of, limit.value, limit.limit
                )?;
            }
        }
        let count = self.limits.len();
        match self.beyond {
            0 => {
                let unclear = self.limits.iter().filter(|l| l.verdict != "within").count();
                match unclear {
                    0 => write!(out, "\n  all {count} are within"),
                    _ => write!(
                        out,
                        "\n  none of {count} is beyond, {unclear} cannot be told"
                    ),
                }
            }
            beyond => write!(
                out,
                "\n  {beyond} of {count} beyond, {} of them guaranteed: is it this sensor, at its nominal \
                 sensitivity and about 25 °C?",
                self.beyond_guaranteed
            ),
        }
    }
}
