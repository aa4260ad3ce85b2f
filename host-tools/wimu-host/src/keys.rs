//! The keys of the user's devices, in the user's configuration folder.

use std::fs::{self, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use wimu_link::auth::DeviceKey;

use crate::error::{ErrorCode, HostError, Result};

/// A folder of keys, one file a device: 64 hexadecimal digits, for the user's eyes only (mode 0600
/// in a folder of mode 0700, where there are modes).
///
/// A key that is on its way to a device lies in a second file until the device has confirmed it, so
/// that neither a program that is killed nor a lost answer loses it.
#[derive(Clone, Debug)]
pub struct KeyFolder(PathBuf);

impl KeyFolder {
    /// The user's: `wimu/keys` in `$XDG_CONFIG_HOME` or `~/.config`, on Windows in `%APPDATA%`, on
    /// macOS in `~/Library/Application Support`.
    ///
    /// # Errors
    /// `usage` when none of these is known.
    pub fn of_user() -> Result<Self> {
        let variable = |name| std::env::var_os(name).filter(|value| !value.is_empty());
        let home = |rest: &str| variable("HOME").map(|home| Path::new(&home).join(rest));
        let base = if cfg!(windows) {
            variable("APPDATA").map(PathBuf::from)
        } else {
            let fallback = if cfg!(target_os = "macos") {
                "Library/Application Support"
            } else {
                ".config"
            };
            variable("XDG_CONFIG_HOME")
                .map(PathBuf::from)
                .or_else(|| home(fallback))
        };
        base.map(|base| Self(base.join("wimu").join("keys")))
            .ok_or_else(|| {
                HostError::new(
                    ErrorCode::Usage,
                    "this user has no folder for configuration, where keys are kept",
                    "set HOME or XDG_CONFIG_HOME",
                )
            })
    }

    /// The one at `path`.
    pub fn at(path: &Path) -> Self {
        Self(path.to_path_buf())
    }

    fn file(&self, device_id: u64) -> PathBuf {
        self.0.join(format!("{device_id:016x}.key"))
    }

    fn pending(&self, device_id: u64) -> PathBuf {
        self.0.join(format!("{device_id:016x}.new.key"))
    }

    /// The keys that a device may have: the one that it confirmed, and one that was on its way.
    ///
    /// # Errors
    /// `file_unreadable` when a file is there and holds no key, or others can read it.
    pub fn candidates(&self, device_id: u64) -> Result<Vec<DeviceKey>> {
        let files = [self.file(device_id), self.pending(device_id)];
        let keys = files.iter().map(|path| read(path));
        keys.filter_map(Result::transpose).collect()
    }

    /// Keeps a key that is about to be sent to a device.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn prepare(&self, device_id: u64, key: &DeviceKey) -> Result<()> {
        let path = self.pending(device_id);
        let failed = |error| HostError::file(&path.display().to_string(), "write", &error);
        let mut folder = fs::DirBuilder::new();
        folder.recursive(true);
        let mut file = OpenOptions::new();
        file.write(true).create_new(true);
        #[cfg(unix)]
        {
            use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
            folder.mode(0o700);
            file.mode(0o600);
        }
        folder.create(&self.0).map_err(failed)?;
        match fs::remove_file(&path) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(failed(error)),
            _ => {}
        }
        let digits = key.expose().iter().map(|byte| format!("{byte:02x}"));
        let text = digits.collect::<String>() + "\n";
        file.open(&path)
            .and_then(|mut file| {
                file.write_all(text.as_bytes())?;
                file.sync_all()
            })
            .map_err(failed)
    }

    /// The device has confirmed the key that was on its way: it takes the place of the one before.
    ///
    /// # Errors
    /// When the file cannot be renamed.
    pub fn confirm(&self, device_id: u64) -> Result<()> {
        let path = self.pending(device_id);
        fs::rename(&path, self.file(device_id))
            .map_err(|error| HostError::file(&path.display().to_string(), "rename", &error))
    }

    /// The device did not take the key that was on its way.
    pub fn withdraw(&self, device_id: u64) {
        let _ = fs::remove_file(self.pending(device_id));
    }

    /// Forgets all keys of a device.
    ///
    /// # Errors
    /// When a file cannot be removed.
    pub fn forget(&self, device_id: u64) -> Result<()> {
        for path in [self.file(device_id), self.pending(device_id)] {
            match fs::remove_file(&path) {
                Err(error) if error.kind() != ErrorKind::NotFound => {
                    let path = path.display().to_string();
                    return Err(HostError::file(&path, "remove", &error));
                }
                _ => {}
            }
        }
        Ok(())
    }
}

/// A new key from the operating system's source of randomness.
///
/// # Errors
/// `file_failed` when it has none.
pub fn generate() -> Result<DeviceKey> {
    let mut bytes = [0; DeviceKey::LENGTH];
    random(&mut bytes)?;
    Ok(DeviceKey::new(bytes))
}

/// Fills `bytes` from the operating system's source of randomness.
pub(crate) fn random(bytes: &mut [u8]) -> Result<()> {
    getrandom::fill(bytes).map_err(|error| {
        HostError::new(
            ErrorCode::FileFailed,
            format!("the operating system gives no random bits: {error}"),
            "run wimu where it does",
        )
    })
}

/// The key in a file; `None` if there is no such file.
fn read(path: &Path) -> Result<Option<DeviceKey>> {
    let name = path.display().to_string();
    let text = match fs::read_to_string(path) {
        Ok(text) => text,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(HostError::file(&name, "read", &error)),
    };
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = fs::metadata(path)
            .map_err(|error| HostError::file(&name, "read", &error))?
            .permissions()
            .mode();
        if mode & 0o077 != 0 {
            return Err(HostError::new(
                ErrorCode::FileUnreadable,
                "others can read this key",
                "set its mode to 600 (chmod 600), and give the device a new one: wimu key rotate",
            )
            .at(name));
        }
    }
    let digits = text.trim();
    let byte = |at| u8::from_str_radix(digits.get(at..at + 2)?, 16).ok();
    let bytes = (0..DeviceKey::LENGTH).map(|place| byte(2 * place));
    let bytes: Option<Vec<u8>> = bytes.collect();
    let key = bytes
        .filter(|_| digits.len() == 2 * DeviceKey::LENGTH)
        .and_then(|bytes| bytes.try_into().ok());
    key.map(DeviceKey::new).map(Some).ok_or_else(|| {
        HostError::new(
            ErrorCode::FileUnreadable,
            format!(
                "a key is {} hexadecimal digits, this file holds {} characters",
                2 * DeviceKey::LENGTH,
                digits.chars().count()
            ),
            "put the right file back; if there is none, erase the key at the board",
        )
        .at(name)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_kept_for_its_owner_only_until_it_is_forgotten() {
        let folder = tempfile::tempdir().expect("a folder");
        let keys = KeyFolder::at(&folder.path().join("wimu/keys"));
        assert_eq!(keys.candidates(7), Ok(vec![]));
        let (first, second) = (generate().expect("random"), generate().expect("random"));
        assert!(first != second);
        keys.prepare(7, &first).expect("written");
        assert_eq!(keys.candidates(7), Ok(vec![first]));
        keys.confirm(7).expect("renamed");
        keys.prepare(7, &second).expect("written");
        assert_eq!(keys.candidates(7), Ok(vec![first, second]));
        keys.withdraw(7);
        assert_eq!(keys.candidates(7), Ok(vec![first]));
        assert_eq!(keys.candidates(8), Ok(vec![]));
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let mode = |path: &Path| fs::metadata(path).expect("there").permissions().mode();
            assert_eq!(mode(&keys.file(7)) & 0o777, 0o600);
            assert_eq!(mode(&keys.0) & 0o777, 0o700);
        }
        keys.forget(7).expect("removed");
        assert_eq!(keys.candidates(7), Ok(vec![]));
        keys.forget(7).expect("nothing to remove");
    }

    #[test]
    fn a_file_that_holds_no_key_says_what_is_wrong_and_never_what_it_holds() {
        let folder = tempfile::tempdir().expect("a folder");
        let keys = KeyFolder::at(folder.path());
        keys.prepare(7, &DeviceKey::new([0xC5; 32]))
            .expect("written");
        keys.confirm(7).expect("renamed");
        let whole = fs::read_to_string(keys.file(7)).expect("there");
        for text in [
            "",
            "c5",
            &whole[1..],
            &format!("c5{whole}"),
            &whole.replace('5', "x"),
            "µ",
        ] {
            fs::write(keys.file(7), text).expect("written");
            let error = keys.candidates(7).expect_err("no key");
            assert_eq!(error.code(), ErrorCode::FileUnreadable);
            assert!(
                error.to_string().contains("64 hexadecimal digits"),
                "{error}"
            );
            assert!(!error.to_string().contains("c5c5"), "{error}");
        }
        fs::write(keys.file(7), &whole).expect("written");
        assert_eq!(keys.candidates(7).map(|keys| keys.len()), Ok(1));
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let open = fs::Permissions::from_mode(0o644);
            fs::set_permissions(keys.file(7), open).expect("changed");
            let error = keys.candidates(7).expect_err("readable by others");
            assert!(error.to_string().contains("others can read"), "{error}");
        }
    }
}
