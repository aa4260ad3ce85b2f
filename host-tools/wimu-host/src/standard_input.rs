//! Standard input as a file, because recordings are read more than once.

use std::io::{Read, Write, copy};
use std::path::Path;

use tempfile::{Builder, TempPath};

use crate::{HostError, Result};

/// A temporary file with all of standard input; dropping it removes the file.
#[derive(Debug)]
pub struct StandardInput(TempPath);

impl StandardInput {
    /// Reads standard input to its end. The file's name ends in `.mcap` if its content is MCAP, else in `.csv`.
    ///
    /// # Errors
    /// `file_failed`, `file_unreadable`.
    pub fn read() -> Result<Self> {
        Self::of(std::io::stdin().lock())
    }

    fn of(mut source: impl Read) -> Result<Self> {
        let failed = |error| HostError::file("-", "read", &error);
        let mut start = Vec::new();
        let head = source.by_ref().take(mcap::MAGIC.len() as u64);
        { head }.read_to_end(&mut start).map_err(failed)?;
        let suffix = match start == mcap::MAGIC {
            true => ".mcap",
            false => ".csv",
        };
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_and_binary_are_kept_whole_and_removed_at_the_end() {
        let text = b"Time (s),Accelerometer X (g)\n".to_vec();
        let binary = [mcap::MAGIC, &[0, 255, 10][..]].concat();
        for (content, extension) in [(text, "csv"), (binary, "mcap"), (Vec::new(), "csv")] {
            let file = StandardInput::of(&content[..]).unwrap();
            let path = file.path().to_owned();
            assert_eq!(path.extension().unwrap(), extension);
            assert_eq!(std::fs::read(&path).unwrap(), content);
            drop(file);
            assert!(!path.exists());
        }
    }
}
