//! Recordings of wimu: the raw samples of one link.

use std::path::Path;

use super::{ReadOptions, Source};
use crate::error::{ErrorCode, Result};
use crate::history::Recording;
use crate::mcap_file;
use crate::recording::{self, Sink};

/// Whether it is an MCAP file that `wimu record` wrote, or one that is cut off or damaged at its beginning.
pub(crate) fn detect(source: &Source) -> bool {
    let named_mcap = |path: &Path| {
        let extension = path.extension();
        extension.is_some_and(|e| e.eq_ignore_ascii_case("mcap"))
    };
    match mcap_file::library(source.start()) {
        Some(library) => library.starts_with(b"wimu "),
        // A text has no control characters.
        None => {
            let start = source.start();
            let is_no_text = start.is_empty() || start.iter().any(|byte| *byte < 9);
            is_no_text && source.path().is_some_and(named_mcap)
        }
    }
}

pub(super) fn read(source: &Source, options: &ReadOptions, sink: &mut dyn Sink) -> Result<()> {
    let Some(path) = source.path() else {
        let error = ErrorCode::UnknownFormat.error(
            "a recording of wimu in an archive is not read",
            "extract it first",
        );
        return Err(error.at(source.name()));
    };
    let links = Recording::load(path)?;
    recording::read_link(links.link(options.role)?, &links.name, sink)
}
