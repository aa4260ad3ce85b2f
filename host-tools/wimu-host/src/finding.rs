//! Findings: what was noticed in data, where, and what to do about it.
//!
//! ```
//! use wimu_host::finding::{FindingCode, text};
//!
//! let finding = FindingCode::RowsMasked
//!     .warning("3 of 100 rows are not finite")
//!     .of_sensor(1)
//!     .between(2.0, 2.5)
//!     .remedy("they are left out");
//! assert_eq!(
//!     text(&[finding], 5),
//!     "  warning: sensor 1, 2.00 to 2.50 s: 3 of 100 rows are not finite\n           they are left out\n"
//! );
//! ```

use std::cmp::Reverse;
use std::fmt;

use serde::{Serialize, Serializer};

use crate::HostError;
use crate::plural::counted;
use crate::untrusted::printable;

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
    /// The default gravity dominates the uncertainty of the scale factors.
    GravityAssumed,
    /// The sample rate was assumed or has gaps.
    Rate,
    /// The clock of the times: what they are relative to.
    Clock,
    /// A quantity that a calibration does not correct.
    Uncalibrated,
    /// The calibration in f64 from which a device's integers were compiled is not known.
    SourceUnknown,
    /// There is no result: the data do not support one, or the command failed.
    NoResult,
    /// Static poses or rests are left out, or contradict the others.
    PosesLeftOut,
    /// Samples are left out because their unit or time is unknown.
    SamplesLeftOut,
    /// Parameters that were not fitted or not observed.
    NotObserved,
    /// Errors of the placement in known orientations, and their repeatability.
    Placement,
    /// Residuals larger than those of the model.
    Residuals,
    /// The bias drifted during the session.
    Drift,
    /// The bias, the scale factor or the sign of an axis changed at one time during the session.
    Step,
    /// The nominal sensitivity is not that of the data, or an axis departs far from it.
    Sensitivity,
    /// A smaller model was used because a parameter of the one that fits best is not plausible.
    SmallerModel,
    /// The data were normalised or corrected before.
    AlreadyCorrected,
    /// Estimates compared with the limits of a datasheet.
    Datasheet,
    /// The full-scale range was assumed.
    RangeAssumed,
    /// The calibration cannot be pushed to a board.
    NotForBoards,
    /// Cross-axis sensitivity, or errors of the axes that the data cannot show.
    Axes,
    /// The temperature is unknown, or outside that of the calibration.
    Temperature,
    /// The magnetic field: too few measurements, a disturbance, or its dip.
    MagneticField,
    /// The output is coarser than its noise.
    Quantisation,
    /// The output is clipped.
    Saturated,
    /// A sensor gives one and the same value.
    Frozen,
    /// Hum, vibration, a filter or a single event: not white noise alone.
    NotNoise,
    /// Values that cannot be compared.
    Incomparable,
    /// What the format of an exported file cannot express.
    NotExpressible,
    /// Positions and delays of an array.
    Geometry,
    /// Data that the device did not send.
    Forged,
    /// Data without a proof that the device has sent them.
    NotAuthentic,
    /// Assumptions and events of a navigation.
    Navigation,
}

impl FindingCode {
    /// A note of this kind; see [`Finding::new`].
    pub fn note(self, evidence: impl Into<String>) -> Finding {
        Finding::new(self, Severity::Note, evidence)
    }

    /// A warning of this kind; see [`Finding::new`].
    pub fn warning(self, evidence: impl Into<String>) -> Finding {
        Finding::new(self, Severity::Warning, evidence)
    }
}

/// Something noticed in data. Serialises to a problem: `{code, severity, place, text, remedy}`.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Finding {
    /// Its kind.
    pub code: FindingCode,
    /// Its importance.
    pub severity: Severity,
    /// Index of the sensor.
    pub sensor: Option<u8>,
    /// First and last time, s since the recording's first sample.
    pub span_s: Option<[f64; 2]>,
    /// What was found, with numbers.
    pub evidence: String,
    /// What to do, or what was done.
    pub remedy: String,
}

/// A problem as `--json` prints it.
#[derive(Serialize)]
struct Problem<'a, C> {
    code: C,
    severity: Severity,
    place: Place<'a>,
    text: &'a str,
    remedy: &'a str,
}

/// Where a problem is, as far as known.
#[derive(Serialize)]
struct Place<'a> {
    /// File with line, column or byte; or link.
    #[serde(skip_serializing_if = "Option::is_none")]
    at: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    sensor: Option<u8>,
    #[serde(skip_serializing_if = "Option::is_none")]
    span_s: Option<[f64; 2]>,
}

impl Serialize for Finding {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Problem {
            code: self.code,
            severity: self.severity,
            place: Place { at: None, sensor: self.sensor, span_s: self.span_s },
            text: &self.evidence,
            remedy: &self.remedy,
        }
        .serialize(serializer)
    }
}

impl Serialize for HostError {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Problem {
            code: self.code().as_str(),
            severity: Severity::Error,
            place: Place { at: self.location(), sensor: None, span_s: None },
            text: self.message(),
            remedy: self.remedy(),
        }
        .serialize(serializer)
    }
}

impl Finding {
    /// A finding of all sensors and times, without a remedy. What a terminal would act on is escaped.
    pub fn new(code: FindingCode, severity: Severity, evidence: impl Into<String>) -> Self {
        Self {
            code,
            severity,
            sensor: None,
            span_s: None,
            evidence: printable(&evidence.into()).into_owned(),
            remedy: String::new(),
        }
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
        self.remedy = printable(&remedy.into()).into_owned();
        self
    }
}

/// Samples whose range is unknown, and what became of them.
pub fn without_unit(count: usize, one: &str, what: &str) -> Option<Finding> {
    let count = (count > 0).then(|| counted(count, one))?;
    let cause = "their range is unknown because a time-reference message (Epoch) was lost";
    Some(FindingCode::SamplesLeftOut.warning(format!("{count} {what}: {cause}")))
}

impl From<&HostError> for Finding {
    fn from(error: &HostError) -> Self {
        let location = error.location().map(|location| format!("{location}: "));
        let evidence = location.unwrap_or_default() + error.message();
        Self::new(FindingCode::NoResult, Severity::Error, evidence).remedy(error.remedy())
    }
}

impl fmt::Display for Finding {
    /// One line; the alternative form (`{:#}`) is evidence and remedy in a line each.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sensor = self.sensor.map(|sensor| format!("sensor {sensor}"));
        let span = self.span_s.map(|[from, to]| format!("{from:.2} to {to:.2} s"));
        let place: Vec<String> = [sensor, span].into_iter().flatten().collect();
        if !place.is_empty() {
            write!(out, "{}: ", place.join(", "))?;
        }
        out.write_str(&self.evidence)?;
        let next = if out.alternate() { "\n" } else { "; " };
        match self.remedy.is_empty() {
            true => Ok(()),
            false => write!(out, "{next}{}", self.remedy),
        }
    }
}

/// Findings as lines, the most severe first: at most `most` of them, then the number of the others. Without
/// [`FindingCode::NoResult`], with which a text begins.
pub fn text(findings: &[Finding], most: usize) -> String {
    let is_told = |finding: &&Finding| finding.code != FindingCode::NoResult;
    let mut sorted: Vec<&Finding> = findings.iter().filter(is_told).collect();
    sorted.sort_by_key(|finding| Reverse(finding.severity));
    let label = |severity: Severity| format!("  {severity:?}: ").to_lowercase();
    let line = |finding: &&Finding| labelled(&label(finding.severity), finding);
    let mut text: String = sorted.iter().take(most).map(line).collect();
    if sorted.len() > most {
        text += &format!("  {} more with --verbose\n", sorted.len() - most);
    }
    text
}

/// A finding behind a label, with its remedy in the next line.
pub fn labelled(label: &str, finding: &Finding) -> String {
    let indent = format!("\n{:1$}", "", label.len());
    format!("{label}{}\n", format!("{finding:#}").replace('\n', &indent))
}

/// Head of a report: whether there is a result, and what was noticed.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// `ok` or `refused`.
    pub status: &'static str,
    /// Why it was refused, and what to do.
    pub reason: Option<String>,
    /// What was noticed; a refusal, too.
    pub findings: Vec<Finding>,
}

impl Default for Outcome {
    fn default() -> Self {
        Self { status: "ok", reason: None, findings: Vec::new() }
    }
}

impl Outcome {
    /// Makes it a refusal.
    pub fn refuse(&mut self, reason: impl Into<String>) {
        let reason = printable(&reason.into()).into_owned();
        let finding = Finding::new(FindingCode::NoResult, Severity::Error, &reason);
        self.findings.push(finding);
        (self.status, self.reason) = ("refused", Some(reason));
    }

    /// Exit code of a command that ends with it: 0, or 3 when it was refused.
    pub fn exit_code(&self) -> u8 {
        if self.reason.is_some() { 3 } else { 0 }
    }
}

impl fmt::Display for Outcome {
    /// The refusal, if it is one.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        (self.reason.iter()).try_for_each(|reason| write!(out, "refused: {reason}"))
    }
}
