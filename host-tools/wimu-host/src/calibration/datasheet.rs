//! Comparison of an estimate with the sensor's datasheet.

use std::iter;

use serde::Serialize;
use wimu_calib::{Datasheet, Estimate, Finding, Quantity, Verdict};

use crate::digits::{signed, significant};
use crate::{Code, Problem, Result};

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
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LimitReport {
    /// Quantity, such as "zero-g offset".
    pub quantity: String,
    /// Axis, or two axes.
    pub of: &'static str,
    /// Unit of the numbers.
    pub unit: &'static str,
    /// As estimated.
    pub value: f64,
    /// Half its 95 % interval.
    pub half_width_95: f64,
    /// Largest magnitude in the datasheet.
    pub limit: f64,
    /// Whether the limit is guaranteed or typical.
    pub guaranteed: bool,
    /// `within`, `unclear` or `beyond`, by the interval.
    pub verdict: String,
}

/// Comparison of an estimate with its sensor's datasheet.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DatasheetReport {
    /// The sensor.
    pub sensor: &'static str,
    /// The document with the limits.
    pub document: &'static str,
    /// Number of parameters beyond their limits.
    pub beyond: usize,
    /// Number of guaranteed limits among them.
    pub beyond_guaranteed: usize,
    /// The fitted parameters that the datasheet limits.
    pub limits: Vec<LimitReport>,
}

impl DatasheetReport {
    /// `sensitivity_lsb_per_g` is that which converted counts to m/s²; `None` for data in g or m/s².
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
        let findings: Vec<Finding> =
            datasheet.findings(estimate, scale, range_g.map(f64::from)).collect();
        let beyond = || findings.iter().filter(|f| f.verdict() == Verdict::Beyond);
        Self {
            sensor: datasheet.sensor,
            document: datasheet.document,
            beyond: beyond().count(),
            beyond_guaranteed: beyond().filter(|f| f.limit.guaranteed).count(),
            limits: findings.iter().map(limit).collect(),
        }
    }
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

impl DatasheetReport {
    /// A finding for each quantity, and the number of parameters beyond their limits.
    pub(super) fn findings(&self) -> Vec<Problem> {
        let (code, count) = (Code::Datasheet, self.limits.len());
        let document = self.document;
        let summary = match (self.beyond, count) {
            (_, 0) => code.note(format!("{document}: no limits for the fitted parameters")),
            (0, _) => code.note(format!("no parameter of {count} exceeds its datasheet limit ({document})")),
            (beyond, _) => code
                .warning(format!(
                    "{beyond} of {count} parameters exceed their datasheet limits, {} of them guaranteed ({document})",
                    self.beyond_guaranteed
                ))
                .remedy("check that it is this sensor, at its nominal sensitivity and about 25 °C"),
        };
        let of_one = |limits: &[LimitReport]| {
            let part = |limit: &LimitReport| {
                let [relation, note] = match limit.verdict.as_str() {
                    "beyond" => ["exceeds", ""],
                    "unclear" => ["of", " (within its uncertainty of the limit)"],
                    _ => ["of", ""],
                };
                let value = signed(limit.value, 3);
                let half = significant(limit.half_width_95, 2);
                format!("{} {value} ± {half} {relation} ±{}{note}", limit.of, limit.limit)
            };
            let parts: Vec<String> = limits.iter().map(part).collect();
            let first = limits.first()?;
            let typical = if first.guaranteed { "" } else { ", typical limits" };
            let text =
                format!("{}, {}, 95 %{typical}: {}", first.quantity, first.unit, parts.join(", "));
            if limits.iter().any(|limit| limit.verdict == "beyond") {
                Some(code.warning(text))
            } else {
                Some(code.note(text))
            }
        };
        let by_quantity = self.limits.chunk_by(|a, b| a.quantity == b.quantity);
        iter::once(summary).chain(by_quantity.filter_map(of_one)).collect()
    }
}
