//! Zip archives as folders, and gzip as the file in it. Both are unpacked in memory, up to a bound.

use std::io::Read;
use std::path::Path;

use zip::ZipArchive;

use super::Source;
use crate::{Code, Problem, Result};

/// Bytes of all files of an archive, at most.
const MAX_BYTES: u64 = 1 << 28;
/// Files of an archive, at most.
const MAX_FILES: usize = 4096;

/// The content of an archive; `None` if it is none.
///
/// # Errors
/// `bad_recording` if it is damaged, or unpacks to more than 256 MB.
pub(super) fn unpacked(source: &Source) -> Result<Option<Source>> {
    match source.start() {
        [b'P', b'K', 3, 4, ..] => zip(source).map(Some),
        [0x1f, 0x8b, 8, ..] => {
            let bytes =
                bounded(&mut flate2::read::MultiGzDecoder::new(source.reader()?), MAX_BYTES);
            let bytes = bytes.map_err(|error| error.at(source.name()))?;
            let name = source.name().trim_end_matches(".gz");
            Ok(Some(Source::of_bytes(name, bytes)))
        }
        _ => Ok(None),
    }
}

fn zip(source: &Source) -> Result<Source> {
    let failed = |error: &dyn std::fmt::Display| damaged(error).at(source.name());
    let mut archive = ZipArchive::new(source.reader()?).map_err(|error| failed(&error))?;
    let (mut members, mut left) = (Vec::new(), MAX_BYTES);
    for index in 0..archive.len().min(MAX_FILES) {
        let mut file = archive.by_index(index).map_err(|error| failed(&error))?;
        let name = file.name().map_err(|error| failed(&error))?.into_owned();
        // macOS adds a second file for each.
        let is_hidden = Path::new(&name).components().any(|part| part.as_os_str() == "__MACOSX");
        if file.is_dir() || is_hidden {
            continue;
        }
        let bytes = bounded(&mut file, left)
            .map_err(|error| error.at(format!("{}, {name}", source.name())))?;
        left -= bytes.len() as u64;
        members.push(Source::of_bytes(name, bytes));
    }
    members.sort_by(|a, b| a.name().cmp(b.name()));
    Ok(Source::of_members(source.name(), members))
}

fn bounded(reader: &mut dyn Read, most: u64) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    reader.take(most + 1).read_to_end(&mut bytes).map_err(|error| damaged(&error))?;
    if bytes.len() as u64 > most {
        return Err(Code::BadRecording.error(
            format!("it unpacks to more than {} MB", MAX_BYTES >> 20),
            "unpack it, and give the file or the folder",
        ));
    }
    Ok(bytes)
}

fn damaged(error: &dyn std::fmt::Display) -> Problem {
    Code::BadRecording.error(format!("the archive is damaged: {error}"), "export it again")
}
