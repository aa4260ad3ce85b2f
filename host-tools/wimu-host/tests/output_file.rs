//! Files that are written as a whole.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use wimu_host::OutputFile;

fn folder_with(old: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.json");
    fs::write(&path, old).unwrap();
    (folder, path)
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
}

#[test]
fn what_stood_there_stays_until_the_new_file_is_whole() {
    let (folder, path) = folder_with("old");
    let (output, mut file) = OutputFile::create(&path).unwrap();
    file.write_all(&[b'x'; 100_000]).unwrap();
    assert_eq!(fs::read_to_string(&path).unwrap(), "old");
    drop(output);
    assert_eq!(fs::read_to_string(&path).unwrap(), "old");
    assert_eq!(names(folder.path()), ["a.json"]);
    OutputFile::write(&path, "new").unwrap();
    assert_eq!(fs::read_to_string(&path).unwrap(), "new");
    assert_eq!(names(folder.path()), ["a.json"]);
}

#[cfg(unix)]
#[test]
fn a_file_keeps_its_mode_and_its_links_and_a_new_one_has_the_usual_mode() {
    use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
    let (folder, path) = folder_with("old");
    let mode = |path: &Path| fs::metadata(path).unwrap().mode() & 0o777;
    let usual = mode(&path);
    let new = folder.path().join("new.json");
    OutputFile::write(&new, "new").unwrap();
    assert_eq!(mode(&new), usual);
    fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
    let link = folder.path().join("link.json");
    symlink("a.json", &link).unwrap();
    OutputFile::write(&link, "through").unwrap();
    assert_eq!(fs::read_to_string(&path).unwrap(), "through");
    assert_eq!(mode(&path), 0o640);
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    // A link to a file that is yet to be made.
    symlink("later.json", folder.path().join("hanging.json")).unwrap();
    OutputFile::write(&folder.path().join("hanging.json"), "made").unwrap();
    assert_eq!(fs::read_to_string(folder.path().join("later.json")).unwrap(), "made");
}

#[cfg(unix)]
#[test]
fn pipes_and_devices_are_written_directly() {
    let (folder, _) = folder_with("");
    let pipe = folder.path().join("pipe.csv");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    assert!(made.unwrap().success());
    let reader = std::thread::spawn({
        let pipe = pipe.clone();
        move || fs::read_to_string(pipe).unwrap()
    });
    OutputFile::write(&pipe, "through").unwrap();
    assert_eq!(reader.join().unwrap(), "through");
    OutputFile::write(Path::new("/dev/null"), "gone").unwrap();
}
