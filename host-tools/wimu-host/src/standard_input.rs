//! Standard input as a file, because recordings are read more than once.

use std::io::{Read, Write, copy};
use std::path::Path;

use tempfile::{Builder, TempPath};

use crate::{Problem, Result};

/// A temporary file with all of standard input; dropping it removes the file.
#[derive(Debug)]
pub struct StandardInput(TempPath);

impl StandardInput {
    /// Reads standard input to its end. The file's name ends in `.mcap` if its content is MCAP, else in `.csv`.
    ///
    /// # Errors
    /// `file_failed`, `file_unreadable`.
    pub fn read() -> Result<Self> {
        let mut source = std::io::stdin().lock();
        let failed = |error| Problem::file("-", "read", &error);
        let mut start = Vec::new();
        let head = source.by_ref().take(mcap::MAGIC.len() as u64);
        { head }.read_to_end(&mut start).map_err(failed)?;
        let suffix = if start == mcap::MAGIC { ".mcap" } else { ".csv" };
        let file = Builder::new().prefix("wimu-stdin-").suffix(suffix).tempfile();
        let mut file = file.map_err(failed)?;
        file.write_all(&start).map_err(failed)?;
        copy(&mut source, &mut file).map_err(failed)?;
        Ok(Self(file.into_temp_path()))
    }

    /// Where the file is.
    pub fn path(&self) -> &Path {
        &self.0
    }
}
