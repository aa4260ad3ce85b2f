//! Findings: what was noticed in data, where, and what to do about it.
//!
//! ```
//! use wimu_host::finding::{Finding, FindingCode, Severity};
//!
//! let finding = Finding::new(FindingCode::RowsMasked, Severity::Warning, "3 of 100 rows are not finite")
//!     .of_sensor(1)
//!     .between(2.0, 2.5)
//!     .remedy("they are left out");
//! assert_eq!(
//!     finding.to_string(),
//!     "sensor 1, 2.00 to 2.50 s: 3 of 100 rows are not finite; they are left out"
//! );
//! ```

use std::fmt;

use serde::Serialize;

/// Importance of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Background: what was assumed or chosen.
    Note,
    /// The result may be wrong.
    Warning,
    /// There is no result.
    Error,
}

impl Severity {
    /// Its name in texts.
    pub fn name(self) -> &'static str {
        match self {
            Self::Note => "note",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

/// Kind of a finding, for programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum FindingCode {
    /// Rows that are not finite numbers, or have too few fields, are masked.
    RowsMasked,
    /// Rows whose time is not later than that of the row before are masked.
    TimesUnordered,
    /// The file ends within a record, or records in it are damaged.
    Truncated,
    /// One of several topics, messages or sensors was chosen.
    TrackChosen,
    /// A unit that the file does not name was inferred.
    UnitInferred,
    /// Counts are around a mid-scale value, which was subtracted.
    ZeroCount,
    /// The acceleration excludes gravity.
    GravityMissing,
    /// Gravity, recorded apart, was added to the linear acceleration.
    GravityAdded,
    /// The sample rate was assumed or has gaps.
    Rate,
    /// The clock of the times: what they are relative to.
    Clock,
    /// A quantity that a calibration does not correct.
    Uncalibrated,
}

/// Something noticed in data.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Finding {
    /// Its kind.
    pub code: FindingCode,
    /// Its importance.
    pub severity: Severity,
    /// Index of the sensor.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor: Option<u8>,
    /// First and last time, s since the recording's first sample.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub span_s: Option<[f64; 2]>,
    /// What was found, with numbers.
    pub evidence: String,
    /// What to do, or what was done.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub remedy: String,
}

impl Finding {
    /// A finding of all sensors and times, without a remedy.
    pub fn new(code: FindingCode, severity: Severity, evidence: impl Into<String>) -> Self {
        Self {
            code,
            severity,
            sensor: None,
            span_s: None,
            evidence: evidence.into(),
            remedy: String::new(),
        }
    }

    /// A note of all sensors and times, with what to do.
    pub fn note(code: FindingCode, evidence: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::new(code, Severity::Note, evidence).remedy(remedy)
    }

    /// A warning of all sensors and times, with what to do.
    pub fn warning(
        code: FindingCode,
        evidence: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::new(code, Severity::Warning, evidence).remedy(remedy)
    }

    /// The same, of one sensor.
    #[must_use]
    pub fn of_sensor(mut self, sensor: u8) -> Self {
        self.sensor = Some(sensor);
        self
    }

    /// The same, from one time to another, s since the recording's first sample.
    #[must_use]
    pub fn between(mut self, from_s: f64, to_s: f64) -> Self {
        self.span_s = Some([from_s, to_s]);
        self
    }

    /// The same, with what to do.
    #[must_use]
    pub fn remedy(mut self, remedy: impl Into<String>) -> Self {
        self.remedy = remedy.into();
        self
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sensor = self.sensor.map(|sensor| format!("sensor {sensor}"));
        let span = self
            .span_s
            .map(|[from, to]| format!("{from:.2} to {to:.2} s"));
        let place: Vec<String> = [sensor, span].into_iter().flatten().collect();
        if !place.is_empty() {
            write!(out, "{}: ", place.join(", "))?;
        }
        out.write_str(&self.evidence)?;
        match self.remedy.is_empty() {
            true => Ok(()),
            false => write!(out, "; {}", self.remedy),
        }
    }
}

/// The most severe findings first, at most `most` of them, and the number left out.
pub fn most_severe(findings: &[Finding], most: usize) -> (Vec<&Finding>, usize) {
    let mut sorted: Vec<&Finding> = findings.iter().collect();
    sorted.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    sorted.truncate(most);
    let left = findings.len() - sorted.len();
    (sorted, left)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_severe_findings_come_first_and_the_rest_is_counted() {
        let note = Finding::new(FindingCode::Clock, Severity::Note, "a");
        let error = Finding::new(FindingCode::GravityMissing, Severity::Error, "b");
        let findings = [note.clone(), error.clone(), note];
        let (first, left) = most_severe(&findings, 1);
        assert_eq!((first, left), (vec![&error], 2));
    }
}
