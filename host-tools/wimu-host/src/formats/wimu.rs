//! Recordings of wimu: the raw samples of one link.

use std::path::Path;

use super::{ReadOptions, Source};
use crate::error::{ErrorCode, Result};
use crate::history::LinkHistory;
use crate::mcap_file::{self, RecordingReader};
use crate::overview::Overview;
use crate::recording::{LinkRows, Sink};
use crate::walk::{Step, walk};

/// Raw samples that wait for those before them that arrive late.
const MAX_WAITING: usize = 1 << 14;

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
    let name = path.display().to_string();
    let overview = Overview::read(path)?;
    let link = overview.link(options.role);
    let role = link.map_err(|error| error.at(&name))?.role;
    let mut rows = LinkRows::new(sink);
    // The latest samples of the latest start, and the parameters and epochs of all of it.
    let mut latest = LinkHistory::new(role);
    let mut reader = RecordingReader::open(path)?;
    walk(&mut reader, |of, _, step| {
        let Step::Arrival(arrival) = step else {
            return Ok(());
        };
        if of != role {
            return Ok(());
        }
        latest.take(&arrival);
        if let [before, _] = &latest.boots[..] {
            rows.boot(before, &name)?;
            latest.boots.remove(0);
        }
        let boot = latest.latest();
        boot.corrected.clear();
        boot.navigation.clear();
        boot.attitude.clear();
        boot.further.clear();
        // Those that arrive late still find their place.
        if boot.raw.len() >= 2 * MAX_WAITING {
            rows.part(boot, MAX_WAITING, &name)?;
            boot.raw.drain(..MAX_WAITING);
            boot.environment.clear();
            boot.epochs.clear();
        }
        Ok(())
    })?;
    for boot in &latest.boots {
        rows.boot(boot, &name)?;
    }
    rows.finish(role, &name)
}
