//! Recordings in the formats of other programs and devices: detected by content, read into a
//! [`Recording`]. docs/reference/formats.md lists them.

mod archive;
mod ardupilot;
mod autopilot;
mod betaflight;
mod ned;
mod px4;
mod ros;
pub(crate) mod source;
mod summary;
pub(crate) mod table;
mod unsupported;
mod wimu;
mod window;

use std::path::Path;

use wimu_link::LinkRole;

pub use source::Source;
pub use summary::{Overview, Summary, TrackSummary};

use crate::calibration::Calibration;
use crate::csv::Filter;
use crate::recording::{How, Intake, OF_WIMU, Recording, Sink};
use crate::{Code, Problem, Result};

/// How to read a file whose content does not say enough.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct ReadOptions {
    /// The format, by its name in docs/reference/formats.md, instead of the detected one.
    pub format: Option<String>,
    /// The topic or message to read where there are several.
    pub topic: Option<String>,
    /// Columns of a table, `ROLE=COLUMN:UNIT` separated by commas, such as `t=timestamp:ns,x=ax:g,gx=5:deg/s`. Roles are
    /// t, x, y, z (acceleration), gx, gy, gz (angular rate), mx, my, mz (magnetic field) and temp. A column is its name
    /// or its number from 1; the unit may be left out where the name has it.
    pub columns: Option<String>,
    /// Rows of a table to keep.
    pub filter: Option<Filter>,
    /// Unit of the accelerations, and after a comma of the angular rates, whatever the file says: `m/s2`, `g`, `mg`, `mm/s2`,
    /// of a table also `LSB`; `rad/s`, `deg/s`.
    pub units: Option<String>,
    /// Sample rate of a table, Hz, instead of its times.
    pub rate_hz: Option<f64>,
    /// Output at zero, LSB.
    pub zero_count: Option<f64>,
    /// Output at zero that a calibration holds, LSB: for a table of counts, where [`zero_count`](Self::zero_count) is `None`.
    pub stored_zero_count: Option<f64>,
    /// Whether the rows of a table are means over static poses, in any order of time.
    pub poses: bool,
    /// Link of a recording of wimu; see [`Capture::link`](crate::capture::Capture::link).
    pub role: Option<LinkRole>,
}

/// A format that wimu reads.
struct Format {
    /// Its name in docs/reference/formats.md.
    name: &'static str,
    /// Whether a file with these first bytes has it.
    detect: fn(&Source) -> bool,
    /// Hands tracks and rows to the sink.
    read: fn(&Source, &ReadOptions, &mut dyn Sink) -> Result<()>,
    /// The options that it has a use for.
    takes: &'static [&'static str],
}

const ALL_OPTIONS: &[&str] = &["topic", "columns", "where", "units", "rate", "zero-count", "link"];
const OF_TABLES: &[&str] = &["columns", "where", "units", "rate", "zero-count"];
const OF_LOGS: &[&str] = &["topic", "units"];

const TABLE: &str = "table";
const UNSUPPORTED: &str = "unsupported";

/// In the order in which they are tried.
#[rustfmt::skip]
const FORMATS: &[Format] = &[
    Format { name: OF_WIMU, detect: wimu::detect, read: wimu::read, takes: &["topic", "link"] },
    Format { name: "ROS 1 bag", detect: ros::bag::detect, read: ros::bag::read, takes: OF_LOGS },
    Format { name: "ROS 2 MCAP", detect: ros::mcap::detect, read: ros::mcap::read, takes: OF_LOGS },
    Format { name: "ROS 2 sqlite", detect: ros::db3::detect, read: ros::db3::read, takes: OF_LOGS },
    Format { name: "PX4 ULog", detect: px4::detect, read: px4::read, takes: OF_LOGS },
    Format { name: "ArduPilot DataFlash", detect: ardupilot::detect, read: ardupilot::read, takes: OF_LOGS },
    Format { name: "Betaflight blackbox", detect: betaflight::detect, read: betaflight::read, takes: OF_LOGS },
    Format { name: UNSUPPORTED, detect: unsupported::detect, read: unsupported::read, takes: ALL_OPTIONS },
    Format { name: TABLE, detect: table::detect, read: table::read, takes: OF_TABLES },
];

/// Reads a file into `sink`; returns the name of its format.
///
/// # Errors
/// `file_unreadable`; `unknown_format`, which names what was found; `bad_recording` when most of it is
/// unusable; `usage` for an unknown name of a format, and for an option that the format ignores.
pub fn read(source: &Source, options: &ReadOptions, sink: &mut dyn Sink) -> Result<&'static str> {
    let format = match &options.format {
        Some(name) => named(name)?,
        None => match detected(source) {
            Some(format) => format,
            // A folder or archive with one recording.
            None => match recordings(source).as_slice() {
                [only] => return read(only, options, sink),
                several => return Err(unknown(source, several)),
            },
        },
    };
    refuse_ignored(format, options).map_err(|error| error.at(source.name()))?;
    let start = String::from_utf8_lossy(source.start());
    // A recording of wimu holds the text of its calibration, further on.
    if start.trim_start().starts_with('{') && start.contains(Calibration::FAMILY) {
        let remedy = "give it beside a recording: --with CAL.json";
        let error = Code::UnknownFormat.error("this is a calibration and no recording", remedy);
        return Err(error.at(source.name()));
    }
    let factors = match &options.units {
        Some(units) if format.takes == OF_LOGS => table::si_of(units)?,
        _ => [1.0; 2],
    };
    let is_one_table = source.members().is_empty();
    let how = How { in_order: !options.poses, factors, is_one_table };
    let mut intake = Intake::new(sink, how);
    (format.read)(source, options, &mut intake)?;
    intake.finish(source.name())?;
    Ok(format.name)
}

/// Whether `wimu record` wrote it.
pub(crate) fn is_own(source: &Source) -> bool {
    detected(source).is_some_and(|format| format.name == OF_WIMU)
}

fn detected(source: &Source) -> Option<&'static Format> {
    FORMATS.iter().find(|format| (format.detect)(source))
}

fn refuse_ignored(format: &Format, options: &ReadOptions) -> Result<()> {
    let given = [
        options.topic.is_some(),
        options.columns.is_some(),
        options.filter.is_some(),
        options.units.is_some(),
        options.rate_hz.is_some(),
        options.zero_count.is_some(),
        // The topic names it.
        options.role.is_some() && options.topic.is_none(),
    ];
    let mut given = given.into_iter().zip(ALL_OPTIONS);
    match given.find(|(given, option)| *given && !format.takes.contains(option)) {
        None => Ok(()),
        Some((_, option)) => Err(Code::Usage.error(
            format!("--{option} has no effect on the format `{}`", format.name),
            "leave it out",
        )),
    }
}

fn named(name: &str) -> Result<&'static Format> {
    let found = FORMATS.iter().find(|format| format.name == name);
    found.ok_or_else(|| {
        let names = FORMATS.iter().map(|format| format.name);
        let names: Vec<&str> = names.filter(|name| *name != UNSUPPORTED).collect();
        Code::Usage.error(
            format!("there is no format `{name}`"),
            format!("choose one of {}", names.join(", ")),
        )
    })
}

/// Members of a folder or archive that are recordings, other than tables.
fn recordings(source: &Source) -> Vec<&Source> {
    let formats =
        || FORMATS.iter().filter(|format| format.name != TABLE && format.name != UNSUPPORTED);
    let members = source.members().iter();
    members.filter(|member| formats().any(|format| (format.detect)(member))).collect()
}

fn unknown(source: &Source, several: &[&Source]) -> Problem {
    let (code, message, remedy) = match several {
        [_, ..] => {
            let names: Vec<&str> = several.iter().map(|member| member.name()).collect();
            let message = format!("it has {} recordings: {}", several.len(), names.join(", "));
            (Code::Usage, message, "give one of them")
        }
        [] if source.start().is_empty() && source.members().is_empty() => {
            (Code::CsvEmpty, "the file is empty".to_owned(), "record or export it again")
        }
        [] => (
            Code::UnknownFormat,
            "the format is not known".to_owned(),
            "see docs/reference/formats.md, or convert it to CSV",
        ),
    };
    code.error(message, remedy).at(source.name())
}

/// Reads a file: [`read`] into a [`Recording`], whose rows out of order are masked.
///
/// # Errors
/// Those of [`read`]; `data_refused` when most rows of an accelerometer cannot be used.
pub fn load(path: &Path, options: &ReadOptions) -> Result<Recording> {
    let source = Source::open(path)?;
    let mut recording = Recording::new(source.name());
    recording.format = read(&source, options, &mut recording)?;
    Ok(recording)
}
