//! What `cargo metadata` knows of the workspace.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::command_line::CommandLine;

/// The packages of this repository.
pub struct Workspace {
    pub packages: Vec<Package>,
    /// The firmware packages' folders below the repository's root, the template of a port among them, each with a
    /// lock file, a target and a profile of its own, by name.
    pub firmware: Vec<PathBuf>,
}

pub struct Package {
    pub name: String,
    /// Below the repository's root.
    pub folder: PathBuf,
    /// Without `default`.
    pub features: Vec<String>,
    pub targets: Vec<Target>,
}

/// Something cargo builds from a package.
pub struct Target {
    pub name: String,
    /// `lib`, `bin`, `example`, `test`, …
    pub kind: String,
    /// Whether the root of its source says `no_std`.
    pub no_std: bool,
}

impl Workspace {
    /// Reads the workspace around the working directory, and moves to its root.
    pub fn enter() -> Result<Self, String> {
        let listing = CommandLine::new("cargo metadata --no-deps --format-version 1");
        let text =
            listing.output().ok_or("`cargo metadata` failed: run `cargo check` to see why")?;
        let metadata: Value = serde_json::from_str(&text)
            .map_err(|problem| format!("`{listing}` put out something else: {problem}"))?;
        let root = Path::new(string(&metadata["workspace_root"])?);
        std::env::set_current_dir(root)
            .map_err(|problem| format!("cannot enter {}: {problem}", root.display()))?;
        let packages = list(&metadata["packages"])?;
        let packages: Result<_, String> = packages.iter().map(|p| Package::read(p, root)).collect();
        Ok(Self {
            packages: packages?,
            firmware: [firmware(Path::new("firmware"))?, firmware(Path::new("examples"))?].concat(),
        })
    }

    /// The packages below `folder`.
    pub fn below(&self, folder: &str) -> impl Iterator<Item = &Package> {
        self.packages.iter().filter(move |p| p.folder.starts_with(folder))
    }
}

impl Package {
    fn read(package: &Value, root: &Path) -> Result<Self, String> {
        let manifest = Path::new(string(&package["manifest_path"])?);
        let folder = manifest.parent().unwrap_or(manifest);
        let features = package["features"].as_object().ok_or("no features listed")?;
        let targets: Result<_, String> =
            list(&package["targets"])?.iter().map(Target::read).collect();
        Ok(Self {
            name: string(&package["name"])?.to_owned(),
            folder: folder.strip_prefix(root).unwrap_or(folder).to_owned(),
            features: features.keys().filter(|f| *f != "default").cloned().collect(),
            targets: targets?,
        })
    }
}

impl Target {
    fn read(target: &Value) -> Result<Self, String> {
        let source = std::fs::read_to_string(string(&target["src_path"])?);
        Ok(Self {
            name: string(&target["name"])?.to_owned(),
            kind: string(&target["kind"][0])?.to_owned(),
            no_std: source.is_ok_and(|text| {
                text.lines().any(|line| line.starts_with("#![") && line.contains("no_std"))
            }),
        })
    }
}

/// The folders in `parent` that hold a package with a target of its own.
fn firmware(parent: &Path) -> Result<Vec<PathBuf>, String> {
    let failed = |problem| format!("cannot list {}: {problem}", parent.display());
    let mut folders = Vec::new();
    for entry in std::fs::read_dir(parent).map_err(failed)? {
        let folder = entry.map_err(failed)?.path();
        if folder.join(".cargo/config.toml").is_file() {
            folders.push(folder);
        }
    }
    folders.sort();
    Ok(folders)
}

fn string(value: &Value) -> Result<&str, String> {
    value.as_str().ok_or_else(|| format!("`cargo metadata`: {value} is no text"))
}

fn list(value: &Value) -> Result<&Vec<Value>, String> {
    value.as_array().ok_or_else(|| format!("`cargo metadata`: {value} is no list"))
}
