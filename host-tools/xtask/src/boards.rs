//! The packages of firmware: each is built in its own folder, with its own lock file, target and profile.

use std::path::{Path, PathBuf};

use xshell::{Cmd, Shell, cmd};

use crate::image::{self, Format};
use crate::setup::{TARGETS, embedded_cargo, has};
use crate::{Result, heading};

/// A package of firmware.
pub struct Board {
    /// Its folder below the repository's root.
    pub folder: &'static str,
    pub target: &'static str,
    /// Its image, or the first of several.
    pub program: &'static str,
    /// How the board takes its image without a probe.
    pub format: Option<Format>,
    /// Whether it has a feature `defmt`.
    pub has_log: bool,
}

const fn board(folder: &'static str, program: &'static str, target: &'static str) -> Board {
    Board { folder, target, program, format: None, has_log: false }
}

pub const QEMU: Board = board("firmware/qemu-mps2", "wimu-qemu-mps2", TARGETS[0]);
pub const MICROBIT: Board = Board {
    format: Some(Format::Hex),
    has_log: true,
    ..board("firmware/microbit-v2", "wimu-microbit-v2", TARGETS[0])
};
pub const PICO: Board = Board {
    format: Some(Format::Uf2(0xe48b_ff56)),
    has_log: true,
    ..board("firmware/pico", "wimu-pico", TARGETS[1])
};
/// Its build script reads C headers.
pub const XIAO: Board = Board {
    format: Some(Format::Uf2(0xada5_2840)),
    has_log: true,
    ..board("firmware/xiao-nrf52840", "wimu-xiao-nrf52840", TARGETS[0])
};
const STM32: Board =
    Board { has_log: true, ..board("firmware/stm32f411", "wimu-stm32f411", TARGETS[0]) };
/// Flashed by `espflash`.
pub const ESP32C3: Board = board("firmware/esp32c3", "wimu-esp32c3", "riscv32imc-unknown-none-elf");
pub const BARE_LOOP: Board = board("firmware/bare-loop", "bare-loop", TARGETS[0]);
pub const BENCH: Board = board("firmware/bench", "bench", TARGETS[0]);

pub const ALL: [Board; 8] = [QEMU, MICROBIT, PICO, XIAO, STM32, ESP32C3, BARE_LOOP, BENCH];

/// The boards that can be built on this machine.
pub fn buildable(sh: &Shell) -> Vec<Board> {
    let mut boards = Vec::from(ALL);
    let needs = [(XIAO, "libclang"), (ESP32C3, "core for Cortex-M33 and RISC-V")];
    for (of, need) in needs {
        if !has(sh, need) {
            boards.retain(|board| board.folder != of.folder);
        }
    }
    boards
}

impl Board {
    /// Runs cargo in the board's folder.
    pub fn cargo(&self, sh: &Shell, verb: &str, options: &[&str]) -> Result {
        let _folder = sh.push_dir(self.folder);
        let mut cargo = embedded_cargo(sh, verb).args(options);
        // Debian's libclang finds its own headers only in its folder below /usr/lib.
        let mut libclang: Vec<PathBuf> = sh.read_dir("/usr/lib").unwrap_or_default();
        libclang.retain(|folder| {
            folder.join("lib/libclang.so").exists() || folder.join("lib/libclang.so.1").exists()
        });
        if let Some(folder) = libclang.last() {
            cargo = cargo.env("LIBCLANG_PATH", folder.join("lib"));
        }
        Ok(cargo.run()?)
    }

    /// Builds it with further options of cargo.
    pub fn build(&self, sh: &Shell, options: &[&str]) -> Result {
        let flags = format!("build.rustflags=[{}]", without_this_machine(sh));
        self.cargo(sh, "build", &[&["--release", "--config", &flags], options].concat())
    }

    /// Where one of its images is.
    pub fn image(&self, program: &str) -> PathBuf {
        let folder = std::env::var_os("CARGO_TARGET_DIR").map(PathBuf::from);
        let folder = folder.unwrap_or_else(|| Path::new(self.folder).join("target"));
        let image = folder.join(self.target).join("release").join(program);
        std::path::absolute(&image).unwrap_or(image)
    }

    /// Writes the file for the board's drive, if it takes one.
    fn write(&self) -> Result<Option<PathBuf>> {
        let Some(format) = self.format else { return Ok(None) };
        image::write(Path::new(self.folder), &self.image(self.program), format).map(Some)
    }
}

/// Flags that take this machine's folders out of the names of source files in panics: images are alike wherever they
/// are built, and smaller.
fn without_this_machine(sh: &Shell) -> String {
    let home = std::env::var_os("CARGO_HOME").map(PathBuf::from);
    let home = home.or_else(|| Some(std::env::home_dir()?.join(".cargo"))).unwrap_or_default();
    let mut folders = sh.read_dir(home.join("registry/src")).unwrap_or_default();
    folders.push(sh.current_dir());
    folders.iter().map(|folder| format!("'--remap-path-prefix={}/=',", folder.display())).collect()
}

/// Builds every board, and writes the files that boards take without a probe.
pub fn write_all(sh: &Shell) -> Result {
    for board in buildable(sh) {
        heading(board.folder);
        board.build(sh, &[])?;
        if let Some(file) = board.write()? {
            println!("{}", file.display());
        }
    }
    Ok(())
}

/// Builds the board called `name` and writes it with `wimu device flash` and its `options`.
pub fn flash(sh: &Shell, name: &str, options: &[String]) -> Result {
    let mut boards = ALL.into_iter().filter(|board| board.format.is_some());
    let board = boards.find(|board| board.folder.ends_with(&format!("/{name}")));
    let board = board.ok_or("the boards are microbit-v2, pico and xiao-nrf52840")?;
    board.build(sh, &[])?;
    board.write()?;
    // In the foreground, with the terminal's input.
    let wimu = cmd!(
        sh,
        "cargo run --release --quiet -p wimu --features flash -- device flash {name} {options...}"
    );
    foreground(wimu)
}

/// Starts the board in QEMU with a moving sensor until Ctrl-C; `options` are those of the example `qemu` of wimu-tests.
pub fn qemu(sh: &Shell, options: &[String]) -> Result {
    QEMU.build(sh, &[])?;
    let image = QEMU.image(QEMU.program);
    foreground(cmd!(
        sh,
        "cargo run --release --quiet -p wimu-tests --example qemu -- {image} {options...}"
    ))
}

/// Runs a command with our input.
fn foreground(command: Cmd<'_>) -> Result {
    let status = std::process::Command::from(command).status()?;
    if status.success() { Ok(()) } else { std::process::exit(status.code().unwrap_or(1)) }
}

/// The emulated RP2040 runs the Pico's image for this sensor, with the cable on UART1: it has no USB.
pub fn build_pico(sh: &Shell, sensor: &str) -> Result<[PathBuf; 2]> {
    let features = format!("pico,{sensor}");
    PICO.build(sh, &["--no-default-features", "--features", &features])?;
    let file = PICO.write()?.ok_or("the Pico takes a file")?;
    Ok([std::path::absolute(file)?, PICO.image(PICO.program)])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the manifest of a board says of how its code is optimised.
    fn optimisation(board: &Board) -> Vec<String> {
        let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
        let manifest = std::fs::read_to_string(format!("{root}/{}/Cargo.toml", board.folder));
        let manifest = manifest.expect("a manifest");
        let profile = manifest.split("\n[").filter(|table| table.starts_with("profile.release"));
        let lines = profile.flat_map(str::lines).filter(|line| !line.starts_with(['#', 'd']));
        lines.filter(|line| !line.is_empty()).map(str::to_owned).collect()
    }

    #[test]
    fn the_image_is_optimised_as_the_code_whose_instructions_are_counted() {
        assert!(optimisation(&BENCH).len() > 3);
        assert_eq!(optimisation(&QEMU), optimisation(&BENCH));
    }
}
