//! Boards: each is built in its own folder, with its own lock file, target and profile.

use std::path::{Path, PathBuf};

use crate::command_line::{CommandLine, heading};
use crate::output::Output;
use crate::setup::{self, Need, Source, ThisMachine, embedded_cargo};
use crate::workspace::Workspace;

/// The board that everyone has.
const QEMU_BOARD: &str = "firmware/qemu-mps2";
const QEMU_PROGRAM: &str = "wimu-qemu-mps2";
const QEMU_TARGET: &str = "thumbv7em-none-eabihf";

/// Builds every board.
///
/// # Errors
/// Says which command failed.
pub fn run(workspace: &Workspace) -> Result<(), String> {
    let source = setup::provide(Need::Targets, &mut ThisMachine)?;
    for folder in &workspace.firmware {
        heading(&folder.display().to_string());
        build(source, folder, None).run()?;
    }
    Ok(())
}

fn build(source: Source, folder: &Path, target: Option<&str>) -> CommandLine {
    let cargo = embedded_cargo(source).word("--release").inside(folder);
    target.map_or(cargo.clone(), |target| cargo.word("--target").word(target))
}

/// Builds the package in `folder` for its own target, or for another; says where that went.
///
/// # Errors
/// Says which command failed.
pub fn built(source: Source, folder: &Path, target: Option<&str>) -> Result<Output, String> {
    build(source, folder, target).run()?;
    Output::of(folder)
}

/// Builds the board for QEMU; returns its image.
///
/// # Errors
/// Says what is missing or which command failed.
pub fn qemu_image() -> Result<PathBuf, String> {
    setup::provide(Need::Qemu, &mut ThisMachine)?;
    let source = setup::provide(Need::Targets, &mut ThisMachine)?;
    let image = built(source, Path::new(QEMU_BOARD), None)?.image(QEMU_PROGRAM, QEMU_TARGET);
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
        let line = build(Source::Debian, Path::new("firmware/x"), None).to_string();
        assert!(line.starts_with("(cd firmware/x && "), "{line}");
        assert!(line.contains("-Zbuild-std=core,alloc") && line.ends_with("--release)"));
    }

    /// What a package's manifest says of how its code is optimised.
    fn optimisation(folder: &str) -> Vec<String> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let manifest = std::fs::read_to_string(root.join(folder).join("Cargo.toml"));
        let manifest = manifest.expect("a manifest");
        let mut table = "";
        let mut found = Vec::new();
        for line in manifest.lines().filter(|line| !line.starts_with('#')) {
            if line.starts_with('[') {
                table = line;
            } else if table.starts_with("[profile.release")
                && !line.is_empty()
                && !line.starts_with("debug")
            {
                found.push(format!("{table} {line}"));
            }
        }
        found
    }

    #[test]
    fn the_image_is_optimised_as_the_code_whose_instructions_are_counted() {
        let counted = optimisation("firmware/bench");
        assert!(counted.len() > 3, "{counted:?}");
        assert_eq!(optimisation(QEMU_BOARD), counted);
    }
}
