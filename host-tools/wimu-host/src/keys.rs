//! The user's device keys, in the configuration folder.

use std::fs::{self, OpenOptions};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

use wimu_link::auth::{DeviceKey, KeyId};

use crate::OutputFile;
use crate::{Code, Problem, Result};

/// The user's folder for wimu: `wimu` in `$XDG_CONFIG_HOME` or `~/.config`, on Windows in `%APPDATA%`, on macOS in
/// `~/Library/Application Support`.
///
/// # Errors
/// `usage` when none of these is known.
pub fn configuration() -> Result<PathBuf> {
    let variable = |name| std::env::var_os(name).filter(|value| !value.is_empty());
    let home = |rest: &str| variable("HOME").map(|home| Path::new(&home).join(rest));
    let base = if cfg!(windows) {
        variable("APPDATA").map(PathBuf::from)
    } else {
        let fallback =
            if cfg!(target_os = "macos") { "Library/Application Support" } else { ".config" };
        variable("XDG_CONFIG_HOME").map(PathBuf::from).or_else(|| home(fallback))
    };
    base.map(|base| base.join("wimu")).ok_or_else(|| {
        Code::Usage.error(
            "this user has no folder for configuration, where keys are kept",
            "set HOME or XDG_CONFIG_HOME",
        )
    })
}

/// A folder of keys, one file per device: 64 hexadecimal digits, readable by the user only (mode 0600
/// in a folder of mode 0700, where there are modes).
///
/// A key being sent to a device is in a second file until the device has confirmed it, and
/// the replaced key in a third one until the device has proved the new one: neither a killed program, nor a lost
/// answer, nor a full disk loses the key that the device has.
#[derive(Clone, Debug)]
pub struct KeyFolder(PathBuf);

impl KeyFolder {
    /// The user's: `keys` in the folder of [`configuration`].
    ///
    /// # Errors
    /// Those of [`configuration`].
    pub fn of_user() -> Result<Self> {
        Ok(Self(configuration()?.join("keys")))
    }

    /// The folder at `path`.
    pub fn at(path: &Path) -> Self {
        Self(path.to_path_buf())
    }

    /// Path of a device's key.
    pub fn file(&self, device_id: u64) -> PathBuf {
        self.named(device_id, "key")
    }

    fn pending(&self, device_id: u64) -> PathBuf {
        self.named(device_id, "new.key")
    }

    fn replaced(&self, device_id: u64) -> PathBuf {
        self.named(device_id, "old.key")
    }

    fn named(&self, device_id: u64, ending: &str) -> PathBuf {
        self.0.join(format!("{device_id:016x}.{ending}"))
    }

    /// The keys that a device may have: the confirmed one, one being sent, and the
    /// replaced one.
    ///
    /// # Errors
    /// `file_unreadable` when the device's file exists but contains no key, or when others can read
    /// a key or change the folder.
    pub fn candidates(&self, device_id: u64) -> Result<Vec<DeviceKey>> {
        self.is_ours_alone()?;
        let mut keys = Vec::new();
        match read(&self.file(device_id))? {
            Found::Key(key) => keys.push(key),
            Found::Nothing => {}
            Found::Damaged(error) => return Err(error),
        }
        for path in [self.pending(device_id), self.replaced(device_id)] {
            // An incomplete file: that key never reached the device, or was replaced.
            if let Found::Key(key) = read(&path)? {
                keys.push(key);
            }
        }
        Ok(keys)
    }

    /// The keys that this user has of a device; none where they cannot be used. Then tags are not verified, which is
    /// reported where there are tags.
    pub fn own(device_id: u64) -> Vec<DeviceKey> {
        let known = Self::of_user().and_then(|folder| folder.candidates(device_id));
        known.unwrap_or_default()
    }

    /// All keys in the folder: to verify recordings. Files without a key are left out.
    ///
    /// # Errors
    /// `file_unreadable` when others can read a key or change the folder.
    pub fn all(&self) -> Result<Vec<DeviceKey>> {
        self.is_ours_alone()?;
        let Ok(folder) = fs::read_dir(&self.0) else {
            return Ok(Vec::new());
        };
        let mut keys = Vec::new();
        for path in folder.flatten().map(|entry| entry.path()) {
            if path.extension().is_some_and(|extension| extension == "key")
                && let Found::Key(key) = read(&path)?
            {
                keys.push(key);
            }
        }
        Ok(keys)
    }

    /// The key of a device with the id `held`, as the device reports it. If it is the one being sent,
    /// it is confirmed by that.
    ///
    /// # Errors
    /// Those of [`KeyFolder::candidates`] and [`KeyFolder::confirm`].
    pub fn settle(&self, device_id: u64, held: KeyId) -> Result<Option<DeviceKey>> {
        let known = self.candidates(device_id)?;
        let ours = known.into_iter().find(|key| key.id() == held);
        if let (Some(key), Found::Key(pending)) = (ours, read(&self.pending(device_id))?)
            && key == pending
        {
            self.confirm(device_id)?;
        }
        Ok(ours)
    }

    /// Checks that a board that is reached by its name is the device that it was the first time, as SSH's `known_hosts`
    /// does. A new name is remembered if the device has `proved` to have its key.
    ///
    /// # Errors
    /// `device_changed`; those of the file.
    pub fn recognise(&self, board: &str, device_id: u64, proved: bool) -> Result<()> {
        self.is_ours_alone()?;
        let path = self.0.join("known_boards");
        let name = path.display().to_string();
        let known = match fs::read_to_string(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => String::new(),
            read => read.map_err(|error| Problem::file(&name, "read", &error))?,
        };
        let id = format!("{device_id:016x}");
        let mut names = known.lines().filter_map(|line| line.rsplit_once(' '));
        match names.find(|(known, _)| *known == board) {
            Some((_, first)) if first != id => Err(Code::DeviceChanged
                .error(
                    format!("device {id} answers, this board was device {first}"),
                    format!("if the board was exchanged on purpose, remove its line from {name}; else do not trust the broker"),
                )
                .at(board)),
            None if proved => OutputFile::write(&path, format!("{known}{board} {id}\n")),
            _ => Ok(()),
        }
    }

    /// Stores a key that is about to be sent to a device.
    ///
    /// # Errors
    /// When it cannot be written; nothing has changed then.
    pub fn prepare(&self, device_id: u64, key: &DeviceKey) -> Result<()> {
        let path = self.pending(device_id);
        let failed = |error| Problem::file(&path.display().to_string(), "write", &error);
        let mut folder = fs::DirBuilder::new();
        folder.recursive(true);
        #[cfg(unix)]
        std::os::unix::fs::DirBuilderExt::mode(&mut folder, 0o700);
        folder.create(&self.0).map_err(failed)?;
        self.is_ours_alone()?;
        let digits = key.expose().iter().map(|byte| format!("{byte:02x}"));
        let text = digits.collect::<String>() + "\n";
        // Renamed when it is complete.
        let draft = self.named(device_id, "draft");
        let written = write_new(&draft, &text).and_then(|()| fs::rename(&draft, &path));
        if written.is_err() {
            let _ = fs::remove_file(&draft);
        }
        written.and_then(|()| self.sync()).map_err(failed)
    }

    /// Confirms the key being sent: it replaces the previous one.
    ///
    /// # Errors
    /// When a file cannot be renamed; no key is lost then.
    pub fn confirm(&self, device_id: u64) -> Result<()> {
        let (file, path) = (self.file(device_id), self.pending(device_id));
        unless_absent(fs::rename(&file, self.replaced(device_id)))
            .and_then(|()| fs::rename(&path, &file))
            .and_then(|()| self.sync())
            .map_err(|error| Problem::file(&path.display().to_string(), "rename", &error))
    }

    /// Removes the replaced key, once the device has proved that it has the new one: with the old one
    /// others could impersonate the device.
    pub fn drop_replaced(&self, device_id: u64) {
        let _ = fs::remove_file(self.replaced(device_id));
    }

    /// Removes the key being sent: the device refused it.
    pub fn withdraw(&self, device_id: u64) {
        let _ = fs::remove_file(self.pending(device_id));
    }

    /// Checks that others cannot exchange keys in the folder, nor the folder. Those above may be writable by a group: on
    /// many systems that is the user's own. With the sticky bit only the owner can rename what is in one.
    fn is_ours_alone(&self) -> Result<()> {
        #[cfg(unix)]
        for folder in [self.0.as_path(), &self.0.canonicalize().unwrap_or_default()]
            .into_iter()
            .flat_map(Path::ancestors)
        {
            let Ok(found) = fs::metadata(folder) else {
                continue;
            };
            let mode = std::os::unix::fs::PermissionsExt::mode(&found.permissions());
            let (others, remedy) = if folder == self.0 {
                (0o022, "set its mode to 700 (chmod 700)")
            } else {
                (0o002, "take the right to write from others (chmod o-w)")
            };
            let is_sticky = mode & 0o1000 != 0 && folder != self.0;
            if mode & others != 0 && !is_sticky {
                return Err(Code::FileUnreadable
                    .error("others can change this folder of keys", remedy)
                    .at(folder.display().to_string()));
            }
        }
        Ok(())
    }

    /// Syncs the folder's entries to disk.
    fn sync(&self) -> io::Result<()> {
        #[cfg(unix)]
        fs::File::open(&self.0)?.sync_all()?;
        Ok(())
    }

    /// Removes all keys of a device.
    ///
    /// # Errors
    /// When a file cannot be removed.
    pub fn forget(&self, device_id: u64) -> Result<()> {
        let files = [Self::file, Self::pending, Self::replaced];
        for path in files.map(|file| file(self, device_id)) {
            unless_absent(fs::remove_file(&path))
                .map_err(|error| Problem::file(&path.display().to_string(), "remove", &error))?;
        }
        Ok(())
    }
}

/// A new key from the random source of the operating system.
///
/// # Errors
/// `file_failed` when there is none.
pub fn generate() -> Result<DeviceKey> {
    let mut bytes = [0; DeviceKey::LENGTH];
    random(&mut bytes)?;
    Ok(DeviceKey::new(bytes))
}

/// Fills `bytes` from the random source of the operating system.
pub fn random(bytes: &mut [u8]) -> Result<()> {
    getrandom::fill(bytes).map_err(|error| {
        Code::FileFailed.error(
            format!("no random numbers from the operating system: {error}"),
            "run wimu on a system with a random source",
        )
    })
}

/// Ignores the error that the file does not exist.
fn unless_absent(outcome: io::Result<()>) -> io::Result<()> {
    match outcome {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        outcome => outcome,
    }
}

/// Writes and syncs a file readable by the user only.
fn write_new(path: &Path, text: &str) -> io::Result<()> {
    unless_absent(fs::remove_file(path))?;
    let mut file = OpenOptions::new();
    file.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut file, 0o600);
    let mut file = file.open(path)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()
}

/// Content of a file of the folder.
enum Found {
    Key(DeviceKey),
    /// There is no such file.
    Nothing,
    /// Not a key, and why.
    Damaged(Problem),
}

fn read(path: &Path) -> Result<Found> {
    let name = path.display().to_string();
    let bytes = match fs::read(path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Found::Nothing),
        Err(error) => return Err(Problem::file(&name, "read", &error)),
    };
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = fs::metadata(path)
            .map_err(|error| Problem::file(&name, "read", &error))?
            .permissions()
            .mode();
        if mode & 0o077 != 0 {
            return Err(Code::FileUnreadable.error("others can read this key",
                "set its mode to 600 (chmod 600), and give the device a new one: wimu device key rotate",
            )
            .at(name));
        }
    }
    let digits = bytes.trim_ascii();
    let pairs = digits.as_chunks::<2>().0.iter();
    let key: Vec<u8> =
        pairs.filter_map(|&[high, low]| Some(digit(high)? << 4 | digit(low)?)).collect();
    Ok(match key.try_into() {
        Ok(key) if digits.len() == 2 * DeviceKey::LENGTH => Found::Key(DeviceKey::new(key)),
        _ => Found::Damaged(
            Code::FileUnreadable.error(format!(
                        "a key is {} hexadecimal digits, but the {} bytes of this file are not",
                    2 * DeviceKey::LENGTH,
                    digits.len()
                ),
                    "restore the file; if it is lost, remove it, erase the board's key (gesture on its page), and run `wimu device key set`",
            )
            .at(name),
        ),
    })
}

fn digit(character: u8) -> Option<u8> {
    let value = char::from(character).to_digit(16)?;
    u8::try_from(value).ok()
}
