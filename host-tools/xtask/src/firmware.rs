//! Boards: each is built in its own folder, with its own lock file, target and profile.

use std::path::{Path, PathBuf};

use crate::command_line::{CommandLine, heading};
use crate::image::{self, Format};
use crate::output::Output;
use crate::setup::{self, Need, Source, TARGETS, ThisMachine, embedded_cargo};
use crate::test::RUST_ONLY;
use crate::workspace::Workspace;

/// The board that everyone has.
const QEMU_BOARD: &str = "firmware/qemu-mps2";
const QEMU_PROGRAM: &str = "wimu-qemu-mps2";
const QEMU_TARGET: &str = "thumbv7em-none-eabihf";

/// The board that is emulated with a sensor on its bus.
const PICO: &str = "firmware/pico-adxl345";

/// Builds every board, and writes the files that boards take without a probe.
///
/// # Errors
/// Says which command failed.
pub fn run(workspace: &Workspace) -> Result<(), String> {
    let source = setup::provide(Need::Targets, &mut ThisMachine)?;
    for folder in buildable(workspace) {
        heading(&folder.display().to_string());
        let output = built(source, folder, None)?;
        if let Some(format) = Format::of(folder) {
            let file = image::write(folder, &only_image(&output)?, format)?;
            println!("{}", file.display());
        }
    }
    Ok(())
}

/// The boards that can be built on this machine; says why one is left out.
pub fn buildable(workspace: &Workspace) -> Vec<&PathBuf> {
    let (needing, others): (Vec<_>, Vec<_>) =
        (workspace.firmware.iter()).partition(|folder| needs_libclang(folder));
    if needing.is_empty() {
        return others;
    }
    match setup::provide(Need::Libclang, &mut ThisMachine) {
        Ok(_) => workspace.firmware.iter().collect(),
        Err(why) => {
            for folder in needing {
                println!("skipped: {}: {why}", folder.display());
            }
            others
        }
    }
}

/// Whether a build script of a board reads C headers.
fn needs_libclang(folder: &Path) -> bool {
    let locked = std::fs::read_to_string(folder.join("Cargo.lock")).unwrap_or_default();
    locked.lines().any(|line| line == "name = \"bindgen\"")
}

/// The same command with what a build script of the board in `folder` needs.
fn prepared(cargo: CommandLine, folder: &Path) -> CommandLine {
    match setup::libclang() {
        Some(library) if needs_libclang(folder) => {
            cargo.with("LIBCLANG_PATH", &library.display().to_string())
        }
        _ => cargo,
    }
}

/// The one image of a board.
fn only_image(output: &Output) -> Result<PathBuf, String> {
    let images = output.programs.iter().flat_map(|program| {
        let image = |target: &&str| output.image(program, target);
        TARGETS.iter().map(image).collect::<Vec<_>>()
    });
    let mut built = images.filter(|image| image.is_file());
    built.next().ok_or_else(|| "no image was built".into())
}

/// Builds the board called `name` and writes it through a debug probe, with `wimu flash`; `options` are
/// its own.
///
/// # Errors
/// Says what is missing or which command failed.
pub fn flash(workspace: &Workspace, name: &str, options: &[String]) -> Result<(), String> {
    let folder = Path::new("firmware").join(name);
    let known = |folder: &PathBuf| Format::of(folder).is_some();
    let boards: Vec<String> = workspace
        .firmware
        .iter()
        .filter(|folder| known(folder))
        .filter_map(|folder| Some(folder.file_name()?.to_string_lossy().into_owned()))
        .collect();
    if !boards.iter().any(|board| board == name) {
        return Err(format!("there is no board `{name}`: {}", boards.join(", ")));
    }
    let source = setup::provide(Need::Targets, &mut ThisMachine)?;
    let image = only_image(&built(source, &folder, None)?)?;
    // Where `wimu flash` looks for it, and what to copy where there is no probe.
    if let Some(format) = Format::of(&folder) {
        image::write(&folder, &image, format)?;
    }
    let write = setup::cargo("run --release --quiet -p wimu --features flash -- flash").word(name);
    go_on_as(options.iter().fold(write, |write, option| write.word(option)))
}

/// The Pico's image on an emulated RP2040; skipped, saying so, where the emulator cannot be had.
///
/// # Errors
/// Says what is missing or which command failed.
pub fn pico(workspace: &Workspace) -> Result<(), String> {
    if let Err(why) = setup::emulator() {
        println!("skipped: {why}");
        return Ok(());
    }
    let source = setup::provide(Need::Targets, &mut ThisMachine)?;
    let folder = Path::new(PICO);
    debug_assert!(workspace.firmware.iter().any(|board| board == folder));
    let image = only_image(&built(source, folder, None)?)?;
    let file = std::path::absolute(image::write(folder, &image, Format::Uf2)?)
        .map_err(|problem| problem.to_string())?;
    // With the workspace's features: what was built for the other tests serves.
    setup::cargo("test")
        .words(RUST_ONLY)
        .words("--test all pico:: -- --ignored")
        .with("WIMU_PICO_FIRMWARE", &file.display().to_string())
        .with("WIMU_PICO_ELF", &image.display().to_string())
        .run()
}

fn build(source: Source, folder: &Path, target: Option<&str>) -> CommandLine {
    let cargo = embedded_cargo(source, "build")
        .words("--release --config")
        .word(&format!("build.rustflags=[{}]", without_this_machine()))
        .inside(folder);
    let cargo = prepared(cargo, folder);
    target.map_or(cargo.clone(), |target| cargo.word("--target").word(target))
}

/// Flags that take this machine's folders out of the names of source files, which panics have: images
/// are alike wherever they are built, and smaller.
fn without_this_machine() -> String {
    let home = std::env::var_os("CARGO_HOME").map(PathBuf::from);
    let home = home.or_else(|| Some(std::env::home_dir()?.join(".cargo")));
    let sources = home.and_then(|home| std::fs::read_dir(home.join("registry/src")).ok());
    let registries = sources.into_iter().flatten().flatten();
    std::env::current_dir()
        .into_iter()
        .chain(registries.map(|registry| registry.path()))
        .map(|folder| format!("'--remap-path-prefix={}/=',", folder.display()))
        .collect()
}

/// Builds the package in `folder` for its own target, or for another; says where that went.
///
/// # Errors
/// Says which command failed.
pub fn built(source: Source, folder: &Path, target: Option<&str>) -> Result<Output, String> {
    built_with(source, folder, target, "")
}

/// The same with further options of cargo.
///
/// # Errors
/// As [`built`].
pub fn built_with(
    source: Source,
    folder: &Path,
    target: Option<&str>,
    options: &str,
) -> Result<Output, String> {
    build(source, folder, target).words(options).run()?;
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
    if image.is_file() { Ok(image) } else { Err(format!("{} was not built", image.display())) }
}

/// Starts the board in QEMU with a moving sensor, until Ctrl-C; `options` are those of wimu-tests'
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
    let start = setup::cargo("run --release --quiet -p wimu-tests --example qemu --");
    let start = options
        .iter()
        .fold(start.word(&image.display().to_string()), |start, option| start.word(option));
    go_on_as(start)
}

/// Goes on as a command: signals reach it, and its exit code is ours, where the system can.
fn go_on_as(command: CommandLine) -> Result<(), String> {
    #[cfg(unix)]
    return Err(command.become_it());
    #[cfg(not(unix))]
    command.run()
}

/// The end-to-end tests on the board in QEMU.
///
/// # Errors
/// Says what is missing or which command failed.
pub fn test() -> Result<(), String> {
    let image = qemu_image()?;
    setup::cargo("test --workspace --test all qemu:: -- --ignored")
        .with("WIMU_QEMU_FIRMWARE", &image.display().to_string())
        .run()
}

/// Builds every board, with its log for a debug probe too if it has one, and lints it where the toolchain
/// can.
///
/// # Errors
/// Says which command failed.
pub fn check(workspace: &Workspace) -> Result<(), String> {
    let source = setup::provide(Need::Targets, &mut ThisMachine)?;
    let boards = buildable(workspace);
    for folder in &boards {
        if has_log_feature(folder) {
            build(source, folder, None).words("--features defmt").run()?;
        }
    }
    // Last: these are the images that are left.
    run(workspace)?;
    if setup::provide(Need::Targets, &mut ThisMachine)? == Source::Toolchain {
        let clippy = CommandLine::new("cargo clippy --release --locked").words("-- -D warnings");
        for folder in boards {
            prepared(clippy.clone().inside(folder), folder).run()?;
        }
    }
    Ok(())
}

fn has_log_feature(folder: &Path) -> bool {
    let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).unwrap_or_default();
    manifest.lines().any(|line| line.starts_with("defmt = ["))
}

/// Whether the source of the boards, and of the packages that they share, is formatted.
pub fn format(workspace: &Workspace) -> Vec<CommandLine> {
    let check = CommandLine::new("cargo fmt --all --check");
    let folders = workspace.firmware.iter();
    folders.map(|folder| check.clone().inside(folder)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_boards_to_buy_have_a_log_for_a_probe() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        for board in ["firmware/microbit-v2", "firmware/nrf52840-ble", PICO] {
            assert!(has_log_feature(&root.join(board)), "{board}");
        }
        assert!(!has_log_feature(&root.join(QEMU_BOARD)));
    }

    #[test]
    fn the_board_with_a_radio_needs_libclang_and_no_other() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        assert!(needs_libclang(&root.join("firmware/nrf52840-ble")));
        for board in ["firmware/microbit-v2", PICO, QEMU_BOARD] {
            assert!(!needs_libclang(&root.join(board)), "{board}");
        }
    }

    #[test]
    fn a_board_is_built_in_its_own_folder() {
        let line = build(Source::Debian, Path::new("firmware/x"), None).to_string();
        assert!(line.starts_with("(cd firmware/x && "), "{line}");
        assert!(line.contains("-Zbuild-std=core,alloc") && line.contains("--release"));
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
