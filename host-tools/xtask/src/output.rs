//! Where cargo puts the images of a firmware package.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::command_line::CommandLine;

/// What is built of one package.
pub struct Output {
    folder: PathBuf,
    /// The names of its programs.
    pub programs: Vec<String>,
}

impl Output {
    /// Of the package in `folder`.
    pub fn of(folder: &Path) -> Result<Self, String> {
        let listing =
            CommandLine::new("cargo metadata --no-deps --format-version 1").inside(folder);
        let metadata = listing
            .output()
            .and_then(|text| serde_json::from_str::<Value>(&text).ok())
            .ok_or_else(|| format!("`{listing}` failed: run it to see why"))?;
        let folder = metadata["target_directory"]
            .as_str()
            .ok_or_else(|| format!("`{listing}` names no target directory"))?;
        let packages = metadata["packages"].as_array().into_iter().flatten();
        let targets = packages.flat_map(|p| p["targets"].as_array().into_iter().flatten());
        Ok(Self {
            folder: folder.into(),
            programs: targets
                .filter(|target| target["kind"][0] == "bin")
                .filter_map(|target| target["name"].as_str().map(str::to_owned))
                .collect(),
        })
    }

    /// The image of `program` for `target`, built or not.
    pub fn image(&self, program: &str, target: &str) -> PathBuf {
        self.folder.join(target).join("release").join(program)
    }
}
