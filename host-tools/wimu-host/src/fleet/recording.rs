//! The recordings of a board: a new file after a time, and again when a full disk has space.

use std::fs;
use std::path::PathBuf;
use std::time::Duration;

use super::gateway::Shared;
use crate::client::nanoseconds;
use crate::mcap_file::{Recorded, RecordingWriter};
use crate::transport::now;
use crate::{Code, Problem, Result};

/// Interval between attempts to write again after a full disk.
const AGAIN: Duration = Duration::from_secs(5);

/// The files of a board, one after the other.
pub struct Recording {
    folder: PathBuf,
    writer: Option<(RecordingWriter<fs::File>, Duration)>,
    /// Its file.
    path: PathBuf,
    /// Whether it has begun a file that has no identification yet.
    pub began: bool,
    /// Bytes written since the last flush: lost when the disk is full.
    unflushed: u64,
    retry_at: Duration,
}

impl Recording {
    pub fn new(folder: PathBuf) -> Self {
        Self {
            folder,
            writer: None,
            path: PathBuf::new(),
            began: false,
            unflushed: 0,
            retry_at: Duration::ZERO,
        }
    }

    /// Writes an entry; returns the number of received bytes that could not be recorded.
    pub fn write(&mut self, entry: &Recorded, shared: &Shared) -> u64 {
        let (bytes, ends_frame) = match entry {
            Recorded::Received(received) => {
                let bytes = &received.bytes;
                (bytes.len() as u64, bytes.last() == Some(&0))
            }
            _ => (0, true),
        };
        let at = now();
        if self.writer.is_none() && at < self.retry_at {
            return bytes;
        }
        self.unflushed += bytes;
        match self.try_write(entry, shared, at) {
            Ok(opened) if ends_frame && at >= opened + shared.config.rotate => self.close(),
            Ok(_) => {}
            Err(error) => {
                shared.note(format!("not recorded: {error}"));
                self.retry_at = at + AGAIN;
                self.writer = None;
                return std::mem::take(&mut self.unflushed);
            }
        }
        0
    }

    /// Returns when the file was opened.
    fn try_write(&mut self, entry: &Recorded, shared: &Shared, at: Duration) -> Result<Duration> {
        let (mut writer, opened) = match self.writer.take() {
            Some(open) => open,
            None => (self.create(shared, at)?, at),
        };
        let flushed = writer.flushed_ns();
        writer.record(entry)?;
        if writer.flushed_ns() != flushed {
            self.unflushed = 0;
            if !self.path.exists() {
                let file = self.path.display().to_string();
                let remedy = "a new file is begun; move files when the next one has been begun";
                return Err(Code::FileFailed.error("the file is gone", remedy).at(file));
            }
        }
        self.writer = Some((writer, opened));
        Ok(opened)
    }

    /// A file that is named by UTC in ms: sorted by time.
    fn create(&mut self, shared: &Shared, at: Duration) -> Result<RecordingWriter<fs::File>> {
        let failed = |error| Problem::file(&self.folder.display().to_string(), "create", &error);
        fs::create_dir_all(&self.folder).map_err(failed)?;
        let begin_ms = shared.utc_ns(nanoseconds(at)) / 1_000_000;
        self.path = self.folder.join(format!("{begin_ms:013}.mcap"));
        let writer = RecordingWriter::create(&self.path, shared.anchor).inspect_err(|error| {
            // What a full disk leaves is no recording; but one of before a clock's jump back may have this name.
            if error.code != Code::FileExists {
                let _ = fs::remove_file(&self.path);
            }
        })?;
        self.began = true;
        Ok(writer)
    }

    pub fn close(&mut self) {
        if let Some((writer, _)) = self.writer.take() {
            self.unflushed = 0;
            let _ = writer.finish();
        }
    }
}
