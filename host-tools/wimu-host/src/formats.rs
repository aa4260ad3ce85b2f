//! Recordings in the formats of other programs and devices: detected by content, read into a
//! [`Recording`]. docs/FORMATS.md lists them.

mod archive;
pub(crate) mod source;
mod table;

use std::path::Path;

pub use source::Source;

use crate::csv::Filter;
use crate::error::{ErrorCode, Result};
use crate::recording::{Recording, Sink};

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
const FORMATS: &[Format] = &[Format {
    name: "text table",
    detect: table::detect,
    read: table::read,
}];

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

/// Reads a file: [`read`] into a [`Recording`].
///
/// # Errors
/// Those of [`read`].
pub fn load(path: &Path, options: &ReadOptions) -> Result<Recording> {
    let source = Source::open(path)?;
    let mut recording = Recording::new(source.name());
    recording.format = read(&source, options, &mut recording)?;
    Ok(recording)
}
