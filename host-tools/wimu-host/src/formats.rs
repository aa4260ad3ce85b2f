//! Recordings in the formats of other programs and devices: detected by content, read into a
//! [`Recording`]. docs/FORMATS.md lists them.

mod archive;
mod ardupilot;
mod autopilot;
mod betaflight;
#[cfg(test)]
mod check;
mod ned;
mod px4;
mod ros;
pub(crate) mod source;
mod summary;
mod table;
mod unsupported;
pub(crate) mod wimu;
mod window;

use std::path::Path;

use wimu_link::LinkRole;

pub use source::Source;
pub use summary::{Summary, TrackSummary};

use crate::csv::Filter;
use crate::error::{ErrorCode, Result};
use crate::recording::{OF_WIMU, Recording, Sink};

/// How to read a file whose content does not say enough.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct ReadOptions {
    /// The format, by its name in docs/FORMATS.md, instead of the detected one.
    pub format: Option<String>,
    /// The topic or message to read where there are several.
    pub topic: Option<String>,
    /// Columns of a table, `ROLE=COLUMN:UNIT` separated by commas, such as `t=timestamp:ns,x=ax:g,gx=5:deg/s`. Roles are
    /// t, x, y, z (acceleration), gx, gy, gz (angular rate), mx, my, mz (magnetic field) and temp. A column is its name
    /// or its number from 1; the unit may be left out where the name has it.
    pub columns: Option<String>,
    /// Rows of a table to keep.
    pub filter: Option<Filter>,
    /// Unit of the accelerations of a table, whatever it names: `m/s2`, `g`, `mg` or `LSB`.
    pub units: Option<String>,
    /// Output at zero, LSB.
    pub zero_count: Option<f64>,
    /// Whether the rows of a table are means over static poses, in any order of time.
    pub poses: bool,
    /// Link of a recording of wimu; see [`Recording::link`](crate::history::Recording::link).
    pub role: Option<LinkRole>,
}

/// A format that wimu reads.
struct Format {
    /// Its name in docs/FORMATS.md.
    name: &'static str,
    /// Whether a file with these first bytes has it.
    detect: fn(&Source) -> bool,
    /// Hands tracks and rows to the sink.
    read: fn(&Source, &ReadOptions, &mut dyn Sink) -> Result<()>,
}

/// In the order in which they are tried.
const FORMATS: &[Format] = &[
    Format {
        name: OF_WIMU,
        detect: wimu::detect,
        read: wimu::read,
    },
    Format {
        name: "ROS 1 bag",
        detect: ros::bag::detect,
        read: ros::bag::read,
    },
    Format {
        name: "ROS 2 MCAP",
        detect: ros::mcap::detect,
        read: ros::mcap::read,
    },
    Format {
        name: "ROS 2 sqlite",
        detect: ros::db3::detect,
        read: ros::db3::read,
    },
    Format {
        name: "PX4 ULog",
        detect: px4::detect,
        read: px4::read,
    },
    Format {
        name: "ArduPilot DataFlash",
        detect: ardupilot::detect,
        read: ardupilot::read,
    },
    Format {
        name: "Betaflight blackbox",
        detect: betaflight::detect,
        read: betaflight::read,
    },
    Format {
        name: "unsupported",
        detect: unsupported::detect,
        read: unsupported::read,
    },
    Format {
        name: "text table",
        detect: table::detect,
        read: table::read,
    },
];

/// Reads a file into `sink`; returns the name of its format.
///
/// # Errors
/// `file_unreadable`; `unknown_format`, which names what was found; `bad_recording` when most of it is
/// unusable; `usage` for an unknown name of a format.
pub fn read(source: &Source, options: &ReadOptions, sink: &mut dyn Sink) -> Result<&'static str> {
    let format = match &options.format {
        Some(name) => FORMATS
            .iter()
            .find(|format| format.name == name)
            .ok_or_else(|| {
                let names: Vec<_> = FORMATS.iter().map(|format| format.name).collect();
                ErrorCode::Usage.error(
                    format!("there is no format `{name}`"),
                    format!("choose one of {}", names.join(", ")),
                )
            })?,
        None => FORMATS
            .iter()
            .find(|format| (format.detect)(source))
            .ok_or_else(|| {
                if source.start().is_empty() && source.members().is_empty() {
                    let remedy = "record or export it again";
                    return ErrorCode::CsvEmpty
                        .error("the file is empty", remedy)
                        .at(source.name());
                }
                ErrorCode::UnknownFormat
                    .error(
                        "the format is not known",
                        "see docs/FORMATS.md, or convert it to CSV",
                    )
                    .at(source.name())
            })?,
    };
    (format.read)(source, options, sink)?;
    Ok(format.name)
}

/// Reads a file: [`read`] into a [`Recording`], whose rows out of order are masked.
///
/// # Errors
/// Those of [`read`]; `data_refused` when most rows of an accelerometer cannot be used.
pub fn load(path: &Path, options: &ReadOptions) -> Result<Recording> {
    let source = Source::open(path)?;
    let mut recording = Recording::new(source.name());
    recording.format = read(&source, options, &mut recording)?;
    recording.check(!options.poses)?;
    Ok(recording)
}
