//! Progress of reading files.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::OnceLock;

/// Bytes between two reports.
const REPORT_BYTES: u64 = 1 << 20;

/// Receives how many bytes of a file were read and its length; `None` when it is closed.
pub type Observer = fn(Option<(u64, u64)>);

static OBSERVER: OnceLock<Observer> = OnceLock::new();

/// Reports the progress of all files that are read from now on; the first observer of a process counts.
pub fn observe(observer: Observer) {
    let _ = OBSERVER.set(observer);
}

/// A file that reports how much of it was read.
#[derive(Debug)]
pub struct Watched {
    file: File,
    length: u64,
    position: u64,
    reported: u64,
}

impl Watched {
    /// Opens a file.
    ///
    /// # Errors
    /// Those of [`File::open`].
    pub fn open(path: &Path) -> io::Result<Self> {
        let file = File::open(path)?;
        Ok(Self { length: file.metadata()?.len(), file, position: 0, reported: 0 })
    }
}

impl Read for Watched {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.file.read(buffer)?;
        self.position += count as u64;
        if self.position.abs_diff(self.reported) >= REPORT_BYTES
            && let Some(observer) = OBSERVER.get()
        {
            self.reported = self.position;
            observer(Some((self.position, self.length)));
        }
        Ok(count)
    }
}

impl Seek for Watched {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.position = self.file.seek(to)?;
        Ok(self.position)
    }
}

impl Drop for Watched {
    fn drop(&mut self) {
        if let Some(observer) = OBSERVER.get() {
            observer(None);
        }
    }
}
