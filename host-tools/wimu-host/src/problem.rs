//! Problems: what is wrong or worth knowing, where, and what to do about it.
//!
//! One type for errors, refusals, warnings and notes. It ends a command as the error of a [`Result`], or stands in the list
//! of a result.
//!
//! ```
//! use wimu_host::problem::{Code, text};
//!
//! let problem = Code::RowsMasked
//!     .warning("3 of 100 rows are not finite")
//!     .of_sensor(1)
//!     .between(2.0, 2.5)
//!     .remedy("they are left out");
//! assert_eq!(
//!     text(&[problem], 5),
//!     "  warning: sensor 1, 2.00 to 2.50 s: 3 of 100 rows are not finite\n           they are left out\n"
//! );
//! ```

use std::cmp::Reverse;
use std::fmt;

use serde::{Serialize, Serializer};

use crate::plural::counted;
use crate::untrusted::printable;

/// Importance of a problem.
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

/// Where a problem is, as far as known.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Place {
    /// File with line, column or byte; or link.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at: Option<String>,
    /// Index of the sensor.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor: Option<u8>,
    /// First and last time, s since the recording's first sample.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub span_s: Option<[f64; 2]>,
}

impl fmt::Display for Place {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sensor = self.sensor.map(|sensor| format!("sensor {sensor}"));
        let span = self.span_s.map(|[from, to]| format!("{from:.2} to {to:.2} s"));
        let parts: Vec<String> = [self.at.clone(), sensor, span].into_iter().flatten().collect();
        out.write_str(&parts.join(", "))
    }
}

/// Something wrong, or worth knowing. Each text is one line; what a terminal would act on is escaped.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Problem {
    /// Its kind.
    pub code: Code,
    /// Its importance.
    pub severity: Severity,
    /// Where it is.
    pub place: Place,
    /// What is wrong, with numbers.
    pub text: String,
    /// What to do, or what was done.
    pub remedy: String,
}

/// A result whose error is a [`Problem`] unless another is named.
pub type Result<T, E = Problem> = std::result::Result<T, E>;

impl Problem {
    /// A problem of all sensors and times, without a remedy.
    pub fn new(code: Code, severity: Severity, text: impl Into<String>) -> Self {
        let text = printable(&text.into()).into_owned();
        Self { code, severity, place: Place::default(), text, remedy: String::new() }
    }

    /// A file that cannot be opened, read or written. Reading is the user's input (exit code 2);
    /// so is a path for output that already exists or cannot be created.
    pub fn file(path: &str, doing: &str, error: &std::io::Error) -> Self {
        use std::io::ErrorKind;
        let (code, remedy) = match error.kind() {
            ErrorKind::NotFound => (Code::FileUnreadable, "check the path"),
            ErrorKind::PermissionDenied => (Code::FileUnreadable, "check its permissions"),
            ErrorKind::AlreadyExists => (Code::FileExists, "name another file, or remove this one"),
            ErrorKind::InvalidData => (Code::FileUnreadable, "name a text file"),
            ErrorKind::IsADirectory => (Code::FileUnreadable, "name a file, not a folder"),
            ErrorKind::NotADirectory => (Code::FileUnreadable, "name a folder, not a file"),
            ErrorKind::StorageFull => (Code::FileFailed, "free some space"),
            _ => (Code::FileFailed, "check the disk and that the file is still there"),
        };
        code.error(format!("cannot {doing} the file: {error}"), remedy).at(path)
    }

    /// The same with where it is: file, line, column, byte or link.
    #[must_use]
    pub fn at(mut self, location: impl Into<String>) -> Self {
        self.place.at = Some(printable(&location.into()).into_owned());
        self
    }

    /// The same, of one sensor.
    #[must_use]
    pub fn of_sensor(mut self, sensor: u8) -> Self {
        self.place.sensor = Some(sensor);
        self
    }

    /// The same, from one time to another, s since the recording's first sample.
    #[must_use]
    pub fn between(mut self, from_s: f64, to_s: f64) -> Self {
        self.place.span_s = Some([from_s, to_s]);
        self
    }

    /// The same, with what to do.
    #[must_use]
    pub fn remedy(mut self, remedy: impl Into<String>) -> Self {
        self.remedy = printable(&remedy.into()).into_owned();
        self
    }

    /// Exit code of a command that ends with this error: 1 failed, 2 wrong usage or unreadable input, 3 the data do not
    /// support an answer, 4 the device refused.
    pub fn exit_code(&self) -> u8 {
        self.code.exit_code()
    }
}

impl std::error::Error for Problem {}

impl fmt::Display for Problem {
    /// One line; the alternative form (`{:#}`) has the remedy in a line of its own.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.place != Place::default() {
            write!(out, "{}: ", self.place)?;
        }
        out.write_str(&self.text)?;
        if self.remedy.is_empty() {
            return Ok(());
        }
        out.write_str(if out.alternate() { "\n" } else { "; " })?;
        out.write_str(&self.remedy)
    }
}

macro_rules! codes {
    ($($(#[doc = $doc:literal])+ $name:ident = $text:literal, $exit:literal;)+) => {
        /// Kind of a problem: a name for machines, and the exit code of a command that it ends.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[non_exhaustive]
        pub enum Code {
            $($(#[doc = $doc])+ $name,)+
        }

        impl Code {
            /// The name in JSON.
            pub fn as_str(self) -> &'static str {
                match self {
                    $(Self::$name => $text,)+
                }
            }

            /// See [`Problem::exit_code`].
            pub fn exit_code(self) -> u8 {
                match self {
                    $(Self::$name => $exit,)+
                }
            }
        }
    };
}

impl Code {
    /// An error of this kind: what is wrong, and what to do about it.
    pub fn error(self, text: impl Into<String>, remedy: impl Into<String>) -> Problem {
        Problem::new(self, Severity::Error, text).remedy(remedy)
    }

    /// A warning of this kind; see [`Problem::new`].
    pub fn warning(self, text: impl Into<String>) -> Problem {
        Problem::new(self, Severity::Warning, text)
    }

    /// A note of this kind; see [`Problem::new`].
    pub fn note(self, text: impl Into<String>) -> Problem {
        Problem::new(self, Severity::Note, text)
    }
}

impl Serialize for Code {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}

codes! {
    /// No such port or host.
    LinkAbsent = "link_absent", 1;
    /// Another program has the port open.
    LinkBusy = "link_busy", 1;
    /// The port may not be opened by this user.
    LinkPermission = "link_permission", 1;
    /// Nothing listens at the address.
    LinkRefused = "link_refused", 1;
    /// The link failed while in use.
    LinkLost = "link_lost", 1;
    /// What answers is no wimu board, or nothing answers.
    NotAWimuBoard = "not_a_wimu_board", 1;
    /// The board speaks another version of the protocol.
    ProtocolVersion = "protocol_version", 1;
    /// A board that was there does not answer a request.
    NoAnswer = "no_answer", 1;
    /// The board holds other parameters than those sent.
    VerifyFailed = "verify_failed", 1;
    /// No debug probe.
    ProbeAbsent = "probe_absent", 1;
    /// A debug probe that this user may not open, or that another program has.
    ProbePermission = "probe_permission", 1;
    /// A chip that is locked: unlocking erases it.
    ChipLocked = "chip_locked", 1;
    /// Writing a board's flash failed.
    FlashFailed = "flash_failed", 1;
    /// Reading or writing a file failed half-way.
    FileFailed = "file_failed", 1;
    /// A text that is no LINK.
    BadLink = "bad_link", 2;
    /// A LINK of a kind that this build leaves out.
    LinkKindMissing = "link_kind_missing", 2;
    /// Something that this build leaves out.
    FeatureMissing = "feature_missing", 2;
    /// A configuration with an error.
    BadConfig = "bad_config", 2;
    /// A firmware image of another board.
    WrongImage = "wrong_image", 2;
    /// A wrong flag or value.
    Usage = "usage", 2;
    /// A file that is absent or may not be read.
    FileUnreadable = "file_unreadable", 2;
    /// A file that would be overwritten.
    FileExists = "file_exists", 2;
    /// A file of a kind that the command does not read.
    UnknownFormat = "unknown_format", 2;
    /// A CSV file without a line.
    CsvEmpty = "csv_empty", 2;
    /// A CSV file whose first line holds numbers, or no commas.
    CsvNoHeader = "csv_no_header", 2;
    /// A column, or an axis of one, that is not there.
    CsvMissingColumn = "csv_missing_column", 2;
    /// The same column twice.
    CsvDuplicateColumn = "csv_duplicate_column", 2;
    /// A column without its unit, or with one that is not known.
    CsvUnknownUnit = "csv_unknown_unit", 2;
    /// Axes in different units.
    CsvMixedUnits = "csv_mixed_units", 2;
    /// A field that is not a finite number.
    CsvBadNumber = "csv_bad_number", 2;
    /// No row is left after the filter, or there is none.
    NoRows = "no_rows", 2;
    /// A file that is not an MCAP recording, or damaged beyond use.
    BadRecording = "bad_recording", 2;
    /// An MCAP file in which wimu has recorded nothing.
    NoWimuTopics = "no_wimu_topics", 2;
    /// A calibration file that cannot be used.
    BadCalibration = "bad_calibration", 2;
    /// A calibration of another device.
    OtherDevice = "other_device", 2;
    /// The data do not support an answer.
    DataRefused = "data_refused", 3;
    /// The device refused a command.
    DeviceRefused = "device_refused", 4;
    /// This does not pass a broker: unsigned writes, keys.
    NotThroughBroker = "not_through_broker", 4;
    /// The device takes this on the link only with its key.
    KeyNeeded = "key_needed", 4;
    /// Another device answers under the name of a board.
    DeviceChanged = "device_changed", 4;
    /// Rows that are not finite numbers, or have too few fields, are masked.
    RowsMasked = "rows_masked", 3;
    /// Rows whose time is not later than that of the row before are masked.
    TimesUnordered = "times_unordered", 3;
    /// The file ends within a record, or records in it are damaged.
    Truncated = "truncated", 3;
    /// One of several topics, messages or sensors was chosen.
    TrackChosen = "track_chosen", 3;
    /// A unit that the file does not name was inferred.
    UnitInferred = "unit_inferred", 3;
    /// Counts are around a mid-scale value, which was subtracted.
    ZeroCount = "zero_count", 3;
    /// The acceleration excludes gravity.
    GravityMissing = "gravity_missing", 3;
    /// Gravity, recorded apart, was added to the linear acceleration.
    GravityAdded = "gravity_added", 3;
    /// The default gravity dominates the uncertainty of the scale factors.
    GravityAssumed = "gravity_assumed", 3;
    /// The sample rate was assumed or has gaps.
    Rate = "rate", 3;
    /// The clock of the times: what they are relative to.
    Clock = "clock", 3;
    /// A quantity that a calibration does not correct.
    Uncalibrated = "uncalibrated", 3;
    /// The calibration in f64 from which a device's integers were compiled is not known.
    SourceUnknown = "source_unknown", 3;
    /// There is no result: the data do not support one, or the command failed.
    NoResult = "no_result", 3;
    /// Static poses or rests are left out, or contradict the others.
    PosesLeftOut = "poses_left_out", 3;
    /// Samples are left out because their unit or time is unknown.
    SamplesLeftOut = "samples_left_out", 3;
    /// Parameters that were not fitted or not observed.
    NotObserved = "not_observed", 3;
    /// Errors of the placement in known orientations, and their repeatability.
    Placement = "placement", 3;
    /// Residuals larger than those of the model.
    Residuals = "residuals", 3;
    /// The bias drifted during the session.
    Drift = "drift", 3;
    /// The bias, the scale factor or the sign of an axis changed at one time during the session.
    Step = "step", 3;
    /// The nominal sensitivity is not that of the data, or an axis departs far from it.
    Sensitivity = "sensitivity", 3;
    /// The data were normalised or corrected before.
    AlreadyCorrected = "already_corrected", 3;
    /// Estimates compared with the limits of a datasheet.
    Datasheet = "datasheet", 3;
    /// The full-scale range was assumed.
    RangeAssumed = "range_assumed", 3;
    /// The calibration cannot be pushed to a board.
    NotForBoards = "not_for_boards", 3;
    /// Cross-axis sensitivity, or errors of the axes that the data cannot show.
    Axes = "axes", 3;
    /// The temperature is unknown, or outside that of the calibration.
    Temperature = "temperature", 3;
    /// The magnetic field: too few measurements, a disturbance, or its dip.
    MagneticField = "magnetic_field", 3;
    /// The output is coarser than its noise.
    Quantisation = "quantisation", 3;
    /// The output is clipped.
    Saturated = "saturated", 3;
    /// A sensor gives one and the same value.
    Frozen = "frozen", 3;
    /// Hum, vibration, a filter or a single event: not white noise alone.
    NotNoise = "not_noise", 3;
    /// Values that cannot be compared.
    Incomparable = "incomparable", 3;
    /// What the format of an exported file cannot express.
    NotExpressible = "not_expressible", 3;
    /// Positions and delays of an array.
    Geometry = "geometry", 3;
    /// Data that the device did not send.
    Forged = "forged", 3;
    /// Data without a proof that the device has sent them.
    NotAuthentic = "not_authentic", 3;
    /// Assumptions and events of a navigation.
    Navigation = "navigation", 3;
}

/// Samples whose range is unknown, and what became of them.
pub fn without_unit(count: usize, one: &str, what: &str) -> Option<Problem> {
    let count = (count > 0).then(|| counted(count, one))?;
    let cause = "their range is unknown because a time-reference message (Epoch) was lost";
    Some(Code::SamplesLeftOut.warning(format!("{count} {what}: {cause}")))
}

/// Problems as lines, the most severe first: at most `most` of them, one of each code before a second, then the number of the
/// others. Without [`Code::NoResult`], with which a text begins.
pub fn text(findings: &[Problem], most: usize) -> String {
    let is_told = |finding: &&Problem| finding.code != Code::NoResult;
    let mut sorted: Vec<&Problem> = findings.iter().filter(is_told).collect();
    sorted.sort_by_key(|finding| Reverse(finding.severity));
    let before = |k: usize| sorted[..k].iter().filter(|other| other.code == sorted[k].code).count();
    let mut shown: Vec<usize> = (0..sorted.len()).collect();
    shown.sort_by_key(|k| (Reverse(sorted[*k].severity), before(*k)));
    shown.truncate(most);
    shown.sort_unstable();
    let label = |severity: Severity| format!("  {severity:?}: ").to_lowercase();
    let line = |k: &usize| labelled(&label(sorted[*k].severity), sorted[*k]);
    let mut text: String = shown.iter().map(line).collect();
    if sorted.len() > most {
        text += &format!("  {} more with --verbose\n", sorted.len() - most);
    }
    text
}

/// A finding behind a label, with its remedy in the next line.
pub fn labelled(label: &str, finding: &Problem) -> String {
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
    pub findings: Vec<Problem>,
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
        let finding = Problem::new(Code::NoResult, Severity::Error, &reason);
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
