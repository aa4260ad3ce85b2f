//! Recordings of wimu: the raw samples of one link.

use std::path::Path;

use wimu_link::LinkRole;
use wimu_link::batch::Stream;

use super::{ReadOptions, Source};
use crate::capture::Capture;
use crate::decode::{Decoder, Event};
use crate::mcap_file::{self, RecordingReader};
use crate::recording::{LinkRows, Sink};
use crate::stream;
use crate::{Code, Result};

/// Whether it is an MCAP file that `wimu record` wrote, or one that is cut off or damaged at its beginning.
pub(super) fn detect(source: &Source) -> bool {
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
        let error = Code::UnknownFormat
            .error("a recording of wimu in an archive is not read", "extract it first");
        return Err(error.at(source.name()));
    };
    let name = crate::untrusted::name(path);
    let mut role = match options.role {
        Some(role) => role,
        None => usual_link(path)?,
    };
    let mut rows = LinkRows::new(sink);
    stream::read(&mut RecordingReader::open(path)?, role, |part| rows.part(part, &name))?;
    if rows.is_empty() {
        // Gives the reason.
        role = Capture::survey(path, Vec::new())?.link(options.role)?.role;
    }
    rows.finish(role, &name)
}

/// The cable if it has raw samples, else the wireless link.
fn usual_link(path: &Path) -> Result<LinkRole> {
    let mut reader = RecordingReader::open(path)?;
    let mut decoder = Decoder::new();
    while let Some(received) = reader.next_received()? {
        if received.role == LinkRole::Cable {
            let mut has_raw = false;
            decoder.push(received.host_ns, &received.bytes, |arrival| {
                if let Event::Samples(samples) = arrival.event {
                    has_raw |= samples.stream == Stream::Raw;
                }
            });
            if has_raw {
                return Ok(LinkRole::Cable);
            }
        }
    }
    Ok(LinkRole::Wireless)
}
