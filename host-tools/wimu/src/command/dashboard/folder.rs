//! The files that pages may name: those of one folder, and those of the command line.

use std::path::{Component, Path, PathBuf};
use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::json;
use wimu_host::chart::Chart;
use wimu_host::formats::{Overview, ReadOptions, Source};
use wimu_host::{Code, Problem, Result};

use super::hub::Hub;

/// Interval between pictures of a file that is read.
const PICTURE: Duration = Duration::from_millis(500);
/// Most files that are listed.
const MOST_LISTED: usize = 500;
const KNOWN: [&str; 11] =
    ["mcap", "csv", "txt", "json", "bag", "db3", "ulg", "bin", "bbl", "bfl", "zip"];

/// A folder, and files besides.
#[derive(Default)]
pub struct Folder {
    path: PathBuf,
    given: Vec<PathBuf>,
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
        let mut parts = Path::new(name).components();
        match (parts.next(), parts.next()) {
            (Some(Component::Normal(part)), None)
                if part == name && !name.contains(['\\', '/', ':']) => {}
            _ => return Err(refused()),
        }
        let path = self.path.join(name);
        let real = path.canonicalize().map_err(|error| Problem::file(name, "open", &error))?;
        if real.parent() != Some(&self.path) {
            return Err(refused());
        }
        Ok(real)
    }

    /// The files, by name.
    pub fn list(&self) -> Vec<Listed> {
        let is_known = |path: &Path| {
            let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
            KNOWN.contains(&extension.as_str())
        };
        let given = self.given.iter().flat_map(|path| path.canonicalize());
        let given: Vec<PathBuf> = given.collect();
        let entries = std::fs::read_dir(&self.path).into_iter().flatten().flatten();
        let mut listed: Vec<Listed> = entries
            .filter(|entry| is_known(&entry.path()) && !given.contains(&entry.path()))
            .filter_map(|entry| {
                let about = entry.metadata().ok().filter(|about| about.is_file())?;
                let name = entry.file_name().into_string().ok()?;
                // A hidden one may be a draft of a file that is being written.
                (!name.starts_with('.')).then_some(Listed { name, bytes: about.len() })
            })
            .take(MOST_LISTED)
            .collect();
        listed.extend(self.given.iter().map(|path| Listed {
            name: path.display().to_string(),
            bytes: std::fs::metadata(path).map_or(0, |about| about.len()),
        }));
        listed.sort_by(|a, b| a.name.cmp(&b.name));
        listed
    }
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
        assert!(listed.contains(&"mine.csv".to_owned()) && !listed.contains(&"key.pem".to_owned()));
        let mine = inside.join("mine.csv");
        let folder = Folder::new(&inside, vec![mine.clone()]).unwrap();
        let once = names(&folder).into_iter().filter(|name| name.ends_with("mine.csv"));
        assert_eq!(Vec::from_iter(once), [mine.display().to_string()]);
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
