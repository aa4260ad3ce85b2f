//! One error type for the host: what went wrong, where, what to do, and the exit code.

use thiserror::Error;

use crate::untrusted::printable;

/// A failure as the command line reports it.
///
/// Serialises to a problem: `{code, severity, place, text, remedy}`.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{}{message}; {remedy}", self.location.as_ref().map(|l| format!("{l}: ")).unwrap_or_default())]
pub struct HostError {
    code: ErrorCode,
    message: String,
    location: Option<String>,
    remedy: String,
}

impl HostError {
    /// A failure of kind `code`: `message` says what is wrong, `remedy` what to do about it. Each is one line; what a
    /// terminal would act on is escaped.
    pub fn new(code: ErrorCode, message: impl Into<String>, remedy: impl Into<String>) -> Self {
        let [message, remedy] =
            [message.into(), remedy.into()].map(|text| printable(&text).into_owned());
        Self { code, message, location: None, remedy }
    }

    /// The same failure with where it happened: file, line, column, byte or link.
    #[must_use]
    pub fn at(mut self, location: impl Into<String>) -> Self {
        self.location = Some(printable(&location.into()).into_owned());
        self
    }

    /// A file that cannot be opened, read or written. Reading is the user's input (exit code 2);
    /// so is a path for output that already exists or cannot be created.
    pub fn file(path: &str, doing: &str, error: &std::io::Error) -> Self {
        use std::io::ErrorKind;
        let (code, remedy) = match error.kind() {
            ErrorKind::NotFound => (ErrorCode::FileUnreadable, "check the path"),
            ErrorKind::PermissionDenied => (ErrorCode::FileUnreadable, "check its permissions"),
            ErrorKind::AlreadyExists => {
                (ErrorCode::FileExists, "name another file, or remove this one")
            }
            ErrorKind::InvalidData => (ErrorCode::FileUnreadable, "name a text file"),
            ErrorKind::IsADirectory => (ErrorCode::FileUnreadable, "name a file, not a folder"),
            ErrorKind::NotADirectory => (ErrorCode::FileUnreadable, "name a folder, not a file"),
            ErrorKind::StorageFull => (ErrorCode::FileFailed, "free some space"),
            _ => (ErrorCode::FileFailed, "check the disk and that the file is still there"),
        };
        Self::new(code, format!("cannot {doing} the file: {error}"), remedy).at(path)
    }

    /// What kind of failure.
    pub fn code(&self) -> ErrorCode {
        self.code
    }

    /// What is wrong.
    pub fn message(&self) -> &str {
        &self.message
    }

    /// Where: file, line, column, byte or link.
    pub fn location(&self) -> Option<&str> {
        self.location.as_deref()
    }

    /// What to do.
    pub fn remedy(&self) -> &str {
        &self.remedy
    }

    /// Exit code of a command that ends with this failure: 1 failed, 2 wrong usage or unreadable
    /// input, 3 the data do not support an answer, 4 the device refused.
    pub fn exit_code(&self) -> u8 {
        self.code.exit_code()
    }
}

macro_rules! codes {
    ($($(#[doc = $doc:literal])+ $name:ident = $text:literal, $exit:literal;)+) => {
        /// Kinds of failure; each has a name for machines and an exit code.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[non_exhaustive]
        pub enum ErrorCode {
            $($(#[doc = $doc])+ $name,)+
        }

        impl ErrorCode {
            /// The name in the failure's JSON.
            pub fn as_str(self) -> &'static str {
                match self {
                    $(Self::$name => $text,)+
                }
            }

            /// A failure of this kind; see [`HostError::new`].
            pub fn error(
                self,
                message: impl Into<String>,
                remedy: impl Into<String>,
            ) -> HostError {
                HostError::new(self, message, remedy)
            }

            /// See [`HostError::exit_code`].
            pub fn exit_code(self) -> u8 {
                match self {
                    $(Self::$name => $exit,)+
                }
            }
        }
    };
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
    /// A line with more or fewer fields than the header.
    CsvFieldCount = "csv_field_count", 2;
    /// Time that goes backwards.
    CsvTimeBackwards = "csv_time_backwards", 2;
    /// Bytes that are not UTF-8.
    CsvNotUtf8 = "csv_not_utf8", 2;
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
}

/// A result whose error is [`HostError`] unless another is named.
pub type Result<T, E = HostError> = std::result::Result<T, E>;
