//! Output files: an existing file is replaced only when the new one is complete.

use std::fs::File;
use std::io::{self, Write, stdout};
use std::path::{Path, PathBuf};

use tempfile::{Builder, TempPath};

use crate::{Problem, Result};

/// The name of standard output.
const STANDARD_OUTPUT: &str = "-";
/// Largest number of symbolic links that are followed, as in Linux.
const MAX_LINKS: usize = 40;

/// A file being written: a temporary file in the same folder until [`finish`](Self::finish) renames it.
/// Dropping it removes the temporary file. A pipe, a device or an open file of a process (`/dev/stdout`) is written
/// directly. `-` is standard output, which gets the content when it is complete.
#[derive(Debug)]
pub struct OutputFile {
    name: String,
    /// The temporary file, and the path that it will get.
    draft: Option<(TempPath, PathBuf)>,
}

impl OutputFile {
    /// Begins a file that replaces an existing one and keeps its mode; returns the file for the content.
    ///
    /// # Errors
    /// `file_unreadable`, `file_failed`: the existing file is unchanged.
    pub fn create(path: &Path) -> Result<(Self, File)> {
        let name = path.display().to_string();
        let (file, draft) = begun(path).map_err(|e| Problem::file(&name, "create", &e))?;
        Ok((Self { name, draft }, file))
    }

    /// Writes a whole file.
    ///
    /// # Errors
    /// Those of [`create`](Self::create) and [`finish`](Self::finish).
    pub fn write(path: &Path, content: impl AsRef<[u8]>) -> Result<()> {
        let (output, mut file) = Self::create(path)?;
        let written = file.write_all(content.as_ref());
        written.map_err(|e| Problem::file(&output.name, "write", &e))?;
        output.finish()
    }

    /// Name in errors.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The file for the content, for a writer that opens it by name; it has the final extension.
    pub fn path(&self) -> &Path {
        let draft = self.draft.as_ref();
        draft.map_or(Path::new(&self.name), |(temporary, _)| temporary)
    }

    /// Syncs the content to disk, then replaces the existing file.
    ///
    /// # Errors
    /// `file_failed`, `file_unreadable`: the existing file is unchanged.
    pub fn finish(self) -> Result<()> {
        let Some((temporary, target)) = self.draft else {
            return Ok(());
        };
        let failed = |error: io::Error| Problem::file(&self.name, "write", &error);
        if target.as_os_str() == STANDARD_OUTPUT {
            let copied = File::open(&temporary)
                .and_then(|mut file| io::copy(&mut file, &mut stdout().lock()));
            return match copied.and_then(|_| stdout().flush()) {
                Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(failed(error)),
                _ => Ok(()),
            };
        }
        let synced = File::options().write(true).open(&temporary);
        synced
            .and_then(|file| file.sync_all())
            .and_then(|()| temporary.persist(target).map_err(|error| error.error))
            .map_err(failed)
    }
}

fn begun(path: &Path) -> io::Result<(File, Option<(TempPath, PathBuf)>)> {
    if path.as_os_str() == STANDARD_OUTPUT {
        let (file, temporary) = tempfile::NamedTempFile::new()?.into_parts();
        return Ok((file, Some((temporary, path.to_owned()))));
    }
    let Some(target) = resolved(path) else {
        return Ok((File::create(path)?, None));
    };
    // A write-protected file is not replaced either.
    let before = match File::options().write(true).open(&target) {
        Ok(file) if !file.metadata()?.is_file() => return Ok((file, None)),
        Ok(file) => Some(file.metadata()?),
        Err(error) if error.kind() == io::ErrorKind::NotFound => None,
        Err(error) => return Err(error),
    };
    let extension = target.extension().unwrap_or_default().to_string_lossy();
    let suffix = format!(".{extension}");
    let mut builder = Builder::new();
    builder.prefix(".wimu-").suffix(&suffix);
    // The umask applies.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let folder = target.parent().filter(|f| !f.as_os_str().is_empty());
    let draft = builder.tempfile_in(folder.unwrap_or(Path::new(".")))?;
    let (file, temporary) = draft.into_parts();
    if let Some(before) = before {
        // Only root may change the owner, and some file systems have no modes.
        #[cfg(unix)]
        {
            use std::os::unix::fs::{MetadataExt, fchown};
            let _ = fchown(&file, Some(before.uid()), Some(before.gid()));
        }
        let _ = file.set_permissions(before.permissions());
    }
    Ok((file, Some((temporary, target))))
}

/// Target of symbolic links, also to a file that does not exist yet; `None` for an open file of a process.
fn resolved(path: &Path) -> Option<PathBuf> {
    let mut at = path.to_owned();
    for _ in 0..MAX_LINKS {
        if at.starts_with("/proc") || at.starts_with("/dev/fd") {
            return None;
        }
        let Ok(link) = std::fs::read_link(&at) else {
            break;
        };
        at = at.parent().unwrap_or(Path::new("")).join(link);
    }
    Some(at)
}
