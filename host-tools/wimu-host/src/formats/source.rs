//! Bytes of a recording: a file, a folder, or a member of an archive.

use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::archive::unpacked;
use crate::progress::Watched;
use crate::untrusted::{self, printable};
use crate::{Problem, Result};

/// Number of first bytes by which a format is detected.
const START: u64 = 4096;

/// Depth of folders in a folder.
const MAX_DEPTH: usize = 2;
/// Files of a folder, at most.
const MAX_MEMBERS: usize = 100_000;

/// Bytes that can be read more than once.
#[derive(Clone, Debug)]
pub struct Source {
    name: String,
    start: Vec<u8>,
    content: Content,
}

#[derive(Clone, Debug)]
enum Content {
    File(PathBuf),
    Bytes(Arc<[u8]>),
    /// Files of a folder or archive, sorted by name.
    Members(Vec<Source>),
}

/// What [`Source::reader`] returns.
pub trait ReadSeek: Read + Seek {}
impl<T: Read + Seek> ReadSeek for T {}

impl Source {
    /// A file, a folder with its files, or an archive with those in it (zip; gzip is the file in it).
    ///
    /// # Errors
    /// `file_unreadable`, `file_failed`; `bad_recording` for a damaged archive.
    pub fn open(path: &Path) -> Result<Self> {
        Self::open_at(path, 0)
    }

    /// The same at a depth of folders.
    fn open_at(path: &Path, depth: usize) -> Result<Self> {
        let name = untrusted::name(path);
        let failed = |error| Problem::file(&name, "read", &error);
        if path.is_dir() {
            let entries = std::fs::read_dir(path).map_err(failed)?;
            let paths: std::io::Result<Vec<PathBuf>> =
                entries.map(|entry| Ok(entry?.path())).collect();
            let mut paths = paths.map_err(failed)?;
            paths.retain(|path| path.is_file() || path.is_dir() && depth < MAX_DEPTH);
            paths.sort();
            let mut members = Vec::new();
            for path in paths.iter().take(MAX_MEMBERS) {
                let member = Self::open_at(path, depth + 1)?;
                match member.content {
                    Content::Members(inner) => members.extend(inner),
                    _ => members.push(member),
                }
            }
            return Ok(Self::of_members(name, members));
        }
        let mut start = Vec::new();
        let file = File::open(path).map_err(failed)?;
        file.take(START).read_to_end(&mut start).map_err(failed)?;
        let source = Self { content: Content::File(path.to_owned()), name, start };
        // An archive in a folder is not looked into.
        let content = if depth == 0 { unpacked(&source)? } else { None };
        Ok(content.unwrap_or(source))
    }

    /// Bytes in memory, for example of a member of an archive.
    pub fn of_bytes(name: impl Into<String>, bytes: impl Into<Arc<[u8]>>) -> Self {
        let bytes = bytes.into();
        Self {
            name: printable(&name.into()).into_owned(),
            start: bytes.iter().take(START as usize).copied().collect(),
            content: Content::Bytes(bytes),
        }
    }

    /// A folder or archive.
    pub fn of_members(name: impl Into<String>, members: Vec<Self>) -> Self {
        Self { name: name.into(), start: Vec::new(), content: Content::Members(members) }
    }

    /// The files of a folder or archive, sorted by name; empty for a file.
    pub fn members(&self) -> &[Self] {
        match &self.content {
            Content::Members(members) => members,
            Content::File(_) | Content::Bytes(_) => &[],
        }
    }

    /// What messages call it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its first 4096 bytes, or fewer.
    pub fn start(&self) -> &[u8] {
        &self.start
    }

    /// Its path, if it is a file.
    pub fn path(&self) -> Option<&Path> {
        match &self.content {
            Content::File(path) => Some(path),
            Content::Bytes(_) | Content::Members(_) => None,
        }
    }

    /// Reads it from the beginning; a folder or archive has no bytes of its own.
    ///
    /// # Errors
    /// `file_unreadable`, `file_failed`.
    pub fn reader(&self) -> Result<Box<dyn ReadSeek>> {
        match &self.content {
            Content::File(path) => {
                let file = Watched::open(path);
                let file = file.map_err(|error| Problem::file(&self.name, "read", &error))?;
                Ok(Box::new(BufReader::new(file)))
            }
            Content::Bytes(bytes) => Ok(Box::new(Cursor::new(bytes.clone()))),
            Content::Members(_) => Ok(Box::new(std::io::empty())),
        }
    }
}
