//! Boards: each is built in its own folder, with its own lock file, target and profile.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::command_line::{CommandLine, heading};
use crate::setup::{self, Need, Source, ThisMachine, embedded_cargo};
use crate::workspace::Workspace;

/// The board that everyone has.
const QEMU_BOARD: &str = "firmware/qemu-mps2";

/// Builds every board.
///
/// # Errors
/// Says which command failed.
pub fn run(workspace: &Workspace) -> Result<(), String> {
    let source = setup::provide(Need::Targets, &mut ThisMachine)?;
    for folder in &workspace.firmware {
        heading(&folder.display().to_string());
        build(source, folder).run()?;
    }
    Ok(())
}

fn build(source: Source, folder: &Path) -> CommandLine {
    embedded_cargo(source).word("--release").inside(folder)
}

/// Builds the board for QEMU; returns its image.
///
/// # Errors
/// Says what is missing or which command failed.
pub fn qemu_image() -> Result<PathBuf, String> {
    setup::provide(Need::Qemu, &mut ThisMachine)?;
    let source = setup::provide(Need::Targets, &mut ThisMachine)?;
    let folder = Path::new(QEMU_BOARD);
    build(source, folder).run()?;
    let listing = CommandLine::new("cargo metadata --no-deps --format-version 1").inside(folder);
    let metadata: Option<Value> = listing
        .output()
        .and_then(|text| serde_json::from_str(&text).ok());
    let target = metadata
        .as_ref()
        .and_then(|metadata| metadata["target_directory"].as_str())
        .ok_or_else(|| format!("`{listing}` names no target directory"))?;
    let image = Path::new(target).join("thumbv7em-none-eabihf/release/wimu-qemu-mps2");
    if image.is_file() {
        Ok(image)
    } else {
        Err(format!("{} was not built", image.display()))
    }
}

/// Starts the board in QEMU with a moving sensor, until Ctrl-C; `options` are those of wimu-sim's
/// example `qemu`.
///
/// # Errors
/// Says what is missing or which command failed.
pub fn qemu(options: &[String]) -> Result<(), String> {
    let image = if options.iter().any(|option| option == "--help") {
        "IMAGE".into()
    } else {
        qemu_image()?
    };
    let start = setup::cargo("run --release --quiet -p wimu-sim --example qemu --");
    let start = options
        .iter()
        .fold(start.word(&image.display().to_string()), |start, option| {
            start.word(option)
        });
    #[cfg(unix)]
    return Err(start.become_it());
    #[cfg(not(unix))]
    start.run()
}

/// The end-to-end tests on the board in QEMU.
///
/// # Errors
/// Says what is missing or which command failed.
pub fn test() -> Result<(), String> {
    let image = qemu_image()?;
    setup::cargo("test -p wimu-tests --test qemu -- --ignored")
        .with("WIMU_QEMU_FIRMWARE", &image.display().to_string())
        .run()
}

/// Builds every board, and lints it where the toolchain can.
///
/// # Errors
/// Says which command failed.
pub fn check(workspace: &Workspace) -> Result<(), String> {
    run(workspace)?;
    if setup::provide(Need::Targets, &mut ThisMachine)? == Source::Toolchain {
        let clippy = setup::cargo("clippy --release").words("-- -D warnings");
        for folder in &workspace.firmware {
            clippy.clone().inside(folder).run()?;
        }
    }
    Ok(())
}

/// Whether the boards' source is formatted.
pub fn format(workspace: &Workspace) -> Vec<CommandLine> {
    let check = CommandLine::new("cargo fmt --check");
    let folders = workspace.firmware.iter();
    folders.map(|folder| check.clone().inside(folder)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_is_built_in_its_own_folder() {
        let line = build(Source::Debian, Path::new("firmware/x")).to_string();
        assert!(line.starts_with("(cd firmware/x && "), "{line}");
        assert!(line.contains("-Zbuild-std=core,alloc") && line.ends_with("--release)"));
    }
}
