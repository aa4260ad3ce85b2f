//! The files that pages may name: those of one folder, and those of the command line.

use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};
use std::path::{Component, Path, PathBuf};
use std::time::{Duration, Instant};

use data_encoding::BASE64;
use serde::{Deserialize, Serialize};
use serde_json::json;
use wimu_host::chart::Chart;
use wimu_host::formats::{Overview, ReadOptions, Source};
use wimu_host::{Code, Problem, Result};

use super::hub::Hub;

/// Interval between pictures of a file that is read.
const PICTURE: Duration = Duration::from_millis(500);
/// Most files that are listed, and levels of folders below the dashboard's.
const MOST_LISTED: usize = 500;
const DEPTH: usize = 4;
const KNOWN: [&str; 11] =
    ["mcap", "csv", "txt", "json", "bag", "db3", "ulg", "bin", "bbl", "bfl", "zip"];

/// A folder, and files besides.
#[derive(Default)]
pub struct Folder {
    path: PathBuf,
    given: Vec<PathBuf>,
}

/// A piece of a file that was dropped on a page.
#[derive(Deserialize)]
pub struct Piece {
    file: String,
    /// Offset of the piece, bytes.
    at: u64,
    /// Its bytes in Base64.
    data: String,
    last: bool,
}

/// A file in a list.
#[derive(Serialize)]
pub struct Listed {
    name: String,
    bytes: u64,
}

impl Folder {
    /// # Errors
    /// `file_unreadable` where there is no such folder or file, or one for the other.
    pub fn new(path: &Path, given: Vec<PathBuf>) -> Result<Self> {
        let name = path.display().to_string();
        let failed = |error: std::io::Error| Problem::file(&name, "open", &error);
        let path = path.canonicalize().map_err(failed)?;
        if !path.is_dir() {
            return Err(failed(std::io::ErrorKind::NotADirectory.into()));
        }
        for file in &given {
            let name = file.display().to_string();
            std::fs::File::open(file).map_err(|error| Problem::file(&name, "open", &error))?;
        }
        Ok(Self { path, given })
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A file by the name that a page gives it.
    ///
    /// # Errors
    /// `usage` for a path, or a link to the outside; `file_unreadable` for what does not exist.
    pub fn file(&self, name: &str) -> Result<PathBuf> {
        if let Some(given) = self.given.iter().find(|given| given.display().to_string() == name) {
            return Ok(given.clone());
        }
        let refused = || {
            let remedy = "choose a file of the list; `wimu dashboard --folder` sets the folder";
            Code::Usage.error("only files of the dashboard's folder can be opened", remedy).at(name)
        };
        let is_below = |part| matches!(part, Component::Normal(_));
        let is_plain = Path::new(name).components().all(is_below) && !name.contains(['\\', ':']);
        if name.is_empty() || !is_plain {
            return Err(refused());
        }
        let path = self.path.join(name);
        let real = path.canonicalize().map_err(|error| Problem::file(name, "open", &error))?;
        if !real.starts_with(&self.path) {
            return Err(refused());
        }
        Ok(real)
    }

    /// Takes a piece of a file that was dropped on a page, at its offset; returns its name once the last one is written.
    ///
    /// # Errors
    /// `usage` for a name that is no file of recordings, that exists, and for pieces out of order; `file_failed`.
    pub fn receive<'a>(&self, piece: &'a Piece) -> Result<Option<&'a str>> {
        let Piece { file: name, at, data, last } = piece;
        let to = self.path.join(name);
        let is_plain = Path::new(name).file_name().is_some_and(|part| part == name.as_str());
        if !is_plain || name.starts_with('.') || name.contains(['\\', ':']) || !is_known(&to) {
            let remedy = format!("drop a recording, table or calibration: {}", KNOWN.join(", "));
            return Err(Code::Usage.error("this is no file for the dashboard", remedy).at(name));
        }
        if to.symlink_metadata().is_ok() {
            return Err(Problem::file(name, "create", &ErrorKind::AlreadyExists.into()));
        }
        let failed = |error: std::io::Error| Problem::file(name, "write", &error);
        // Hidden, so that it is not listed.
        let draft = self.path.join(format!(".{name}.part"));
        if *at == 0 {
            let _ = std::fs::remove_file(&draft);
        }
        let mut options = OpenOptions::new();
        let mut written = options.append(true).create_new(*at == 0).open(&draft).map_err(failed)?;
        let data = BASE64.decode(data.as_bytes());
        let in_order = written.metadata().is_ok_and(|about| about.len() == *at);
        let Some(data) = data.ok().filter(|_| in_order) else {
            let message = "the pieces of the file did not arrive in order";
            return Err(Code::Usage.error(message, "drop it again").at(name));
        };
        written.write_all(&data).map_err(failed)?;
        if !last {
            return Ok(None);
        }
        written.sync_all().and_then(|()| std::fs::rename(&draft, &to)).map_err(failed)?;
        Ok(Some(name))
    }

    /// The files, by name.
    pub fn list(&self) -> Vec<Listed> {
        let given = self.given.iter().flat_map(|path| path.canonicalize());
        let mut listed = Vec::new();
        self.list_below(&self.path, DEPTH, &Vec::from_iter(given), &mut listed);
        listed.extend(self.given.iter().map(|path| Listed {
            name: path.display().to_string(),
            bytes: std::fs::metadata(path).map_or(0, |about| about.len()),
        }));
        listed.sort_by(|a, b| a.name.cmp(&b.name));
        listed
    }

    /// Lists a folder and those in it, `depth` levels down.
    fn list_below(&self, folder: &Path, depth: usize, given: &[PathBuf], listed: &mut Vec<Listed>) {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let (path, about) = (entry.path(), entry.metadata());
            // A hidden one may be a draft of a file that is being written.
            let is_hidden = entry.file_name().as_encoded_bytes().starts_with(b".");
            let Some(about) = about.ok().filter(|_| !is_hidden && listed.len() < MOST_LISTED)
            else {
                continue;
            };
            if about.is_dir() && depth > 0 {
                self.list_below(&path, depth - 1, given, listed);
            }
            let name = path.strip_prefix(&self.path).ok().and_then(Path::to_str);
            if let Some(name) = name.filter(|_| about.is_file() && is_known(&path))
                && !given.contains(&path)
            {
                listed.push(Listed { name: name.replace('\\', "/"), bytes: about.len() });
            }
        }
    }
}

/// Whether the dashboard shows a file of this name.
fn is_known(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    KNOWN.contains(&extension.as_str())
}

/// Reads a file in this thread, and shows what it holds under `topic` while it is read.
pub fn show(hub: &Hub, topic: &str, name: &str, path: &Path) {
    let mut shown = Instant::now();
    let view = |overview: &Overview, format: &str, done, error: Option<String>| {
        json!({
            "name": name,
            "rows": overview.rows(),
            "done": done,
            "error": error,
            "duration_s": overview.duration_s(),
            "format": format,
            "charts": Vec::from_iter(overview.charts().iter().map(Chart::json)),
            "findings": Vec::from_iter(overview.findings().iter().map(ToString::to_string)),
        })
    };
    let mut overview = Overview::default();
    hub.publish(topic, &view(&overview, "", false, None));
    overview.observe(Box::new(|overview| {
        if shown.elapsed() >= PICTURE {
            shown = Instant::now();
            hub.publish(topic, &view(overview, "", false, None));
        }
    }));
    let read =
        Source::open(path).and_then(|source| overview.read(&source, &ReadOptions::default()));
    let (format, error) = match read {
        Ok(format) => (format, None),
        Err(error) => ("", Some(error.to_string())),
    };
    hub.publish(topic, &view(&overview, format, true, error));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_reaches_the_files_of_the_folder_and_no_others() {
        let outside = tempfile::tempdir().unwrap();
        std::fs::write(outside.path().join("secret.csv"), "x").unwrap();
        let inside = outside.path().join("folder");
        std::fs::create_dir(&inside).unwrap();
        std::fs::write(inside.join("mine.csv"), "x").unwrap();
        std::fs::write(inside.join("key.pem"), "x").unwrap();
        std::fs::create_dir_all(inside.join("day/one")).unwrap();
        std::fs::write(inside.join("day/one/walk.csv"), "x").unwrap();
        #[cfg(unix)]
        std::os::unix::fs::symlink(outside.path().join("secret.csv"), inside.join("link.csv"))
            .unwrap();
        let given = outside.path().join("given.mcap");
        std::fs::write(&given, "x").unwrap();
        let folder = Folder::new(&inside, vec![given.clone()]).unwrap();
        assert!(folder.file("mine.csv").unwrap().ends_with("folder/mine.csv"));
        assert_eq!(folder.file(given.to_str().unwrap()).unwrap(), given);
        let absolute = outside.path().join("secret.csv").display().to_string();
        for name in [
            "../secret.csv",
            "..",
            ".",
            "",
            "/etc/passwd",
            "./mine.csv",
            "mine.csv/",
            "a/../../secret.csv",
            "..\\secret.csv",
            "C:secret.csv",
            "link.csv",
            &absolute,
        ] {
            let error = folder.file(name).unwrap_err();
            assert!(matches!(error.code, Code::Usage | Code::FileUnreadable), "{name}: {error}");
        }
        let names = |folder: &Folder| Vec::from_iter(folder.list().into_iter().map(|one| one.name));
        let listed = names(&folder);
        assert_eq!(listed[1..], ["day/one/walk.csv", "mine.csv"]);
        assert!(folder.file("day/one/walk.csv").is_ok() && folder.file("day/../mine.csv").is_err());
        let mine = inside.join("mine.csv");
        let folder = Folder::new(&inside, vec![mine.clone()]).unwrap();
        let once = names(&folder).into_iter().filter(|name| name.ends_with("mine.csv"));
        assert_eq!(Vec::from_iter(once), [mine.display().to_string()]);
    }

    #[test]
    fn a_dropped_file_arrives_in_order_and_replaces_none() {
        let place = tempfile::tempdir().unwrap();
        let folder = Folder::new(place.path(), Vec::new()).unwrap();
        let take = |file: &str, at: u64, data: &str, last| {
            let (file, data) = (file.to_owned(), BASE64.encode(data.as_bytes()));
            folder.receive(&Piece { file, at, data, last }).map(|name| name.is_some())
        };
        assert!(!take("a.csv", 0, "1,", false).unwrap());
        assert!(take("a.csv", 5, "2", true).is_err(), "a piece is missing");
        assert!(folder.list().is_empty());
        assert!(take("a.csv", 2, "2", true).unwrap());
        assert_eq!(std::fs::read_to_string(place.path().join("a.csv")).unwrap(), "1,2");
        for name in ["a.csv", "../b.csv", "c/d.csv", ".e.csv", "run.sh", "", "..", "C:f.csv"] {
            assert!(take(name, 0, "x", true).is_err(), "{name}");
        }
        assert_eq!(folder.list().len(), 1);
    }

    #[test]
    fn an_unreadable_folder_or_file_is_an_error_at_the_start() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.csv");
        std::fs::write(&file, "x").unwrap();
        for (path, given) in
            [(file.as_path(), vec![]), (folder.path(), vec![folder.path().join("absent.csv")])]
        {
            let error = Folder::new(path, given).err().unwrap();
            assert_eq!(error.code, Code::FileUnreadable);
        }
    }
}
