//! The measured figures: every example of a library that measures a budget or an accuracy, and
//! what the node and a sample cost on a microcontroller.

use std::path::Path;

use crate::command_line::heading;
use crate::instructions;
use crate::profile;
use crate::setup::cargo;
use crate::workspace::Workspace;

/// Where recordings are looked for: beside the repository, of which they are no part.
pub const DATA: &str = "../shared/data";

/// Runs each measurement, handing it the folder of recordings if there is one.
///
/// # Errors
/// Says which command failed, or which figure is past its bar.
pub fn run(workspace: &Workspace, data: Option<&str>) -> Result<(), String> {
    let data = match data {
        Some(folder) if Path::new(folder).is_dir() => Some(folder),
        Some(folder) => return Err(format!("there is no folder {folder}")),
        None => Some(DATA).filter(|folder| Path::new(folder).is_dir()),
    };
    for package in workspace.below("crates") {
        let measures = |name: &str| name.contains("budget") || name.contains("accuracy");
        for example in package.targets.iter().filter(|t| t.kind == "example" && measures(&t.name)) {
            heading(&format!("{}: {}", package.name, example.name));
            let run = cargo("run --release --quiet")
                .words(&format!("-p {} --example {}", package.name, example.name));
            data.map_or(run.clone(), |folder| run.word("--").word(folder)).run()?;
        }
    }
    profile::run()?;
    instructions::run()
}
