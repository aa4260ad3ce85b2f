//! Bytes of a recording: a file, or a member of an archive.

use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::error::{HostError, Result};

/// Number of first bytes by which a format is detected.
const START: u64 = 4096;

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
}

/// What [`Source::reader`] returns.
pub trait ReadSeek: Read + Seek {}
impl<T: Read + Seek> ReadSeek for T {}

impl Source {
    /// A file.
    ///
    /// # Errors
    /// `file_unreadable`, `file_failed`.
    pub fn open(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let failed = |error| HostError::file(&name, "read", &error);
        let mut start = Vec::new();
        let file = File::open(path).map_err(failed)?;
        file.take(START).read_to_end(&mut start).map_err(failed)?;
        Ok(Self {
            content: Content::File(path.to_owned()),
            name,
            start,
        })
    }

    /// Bytes in memory, for example of a member of an archive.
    pub fn of_bytes(name: impl Into<String>, bytes: impl Into<Arc<[u8]>>) -> Self {
        let bytes = bytes.into();
        Self {
            name: name.into(),
            start: bytes.iter().take(START as usize).copied().collect(),
            content: Content::Bytes(bytes),
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
            Content::Bytes(_) => None,
        }
    }

    /// Reads it from the beginning.
    ///
    /// # Errors
    /// `file_unreadable`, `file_failed`.
    pub fn reader(&self) -> Result<Box<dyn ReadSeek>> {
        match &self.content {
            Content::File(path) => {
                let file = File::open(path);
                let file = file.map_err(|error| HostError::file(&self.name, "read", &error))?;
                Ok(Box::new(BufReader::new(file)))
            }
            Content::Bytes(bytes) => Ok(Box::new(Cursor::new(bytes.clone()))),
        }
    }
}
