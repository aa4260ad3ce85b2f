//! The Python module, `host-tools/wimu-python`.

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};
use std::fs;
use std::path::{Path, PathBuf};

use crate::command_line::CommandLine;
use crate::setup::{Need, ThisMachine, cargo, provide};

const CRATE: &str = "host-tools/wimu-python";

/// Finds Python, and installs these packages from PyPI in a virtual environment below the target folder: its interpreter.
///
/// # Errors
/// Says what is missing or which command failed.
pub fn environment(packages: &str) -> Result<PathBuf, String> {
    provide(Need::Optional, &mut ThisMachine)?;
    let folder = target().join("python");
    let python = folder.join("bin/python");
    if !python.exists() {
        CommandLine::new("python3 -m venv").word(&text(&folder)).run()?;
    }
    let has = |name: &str| interpreter(&python).word("-c").word(&format!("import {name}"));
    if packages.split(' ').any(|name| has(name).output().is_none()) {
        let install = interpreter(&python).words("-m pip install --quiet").words(packages);
        install.run().map_err(|problem| {
            format!("Python packages are missing and could not be installed from PyPI: {problem}")
        })?;
    }
    println!("{}: {packages}", python.display());
    Ok(python)
}

/// Builds the module with cargo alone and compares a calibration with that of the command.
///
/// # Errors
/// Says what is missing or which command failed.
pub fn smoke() -> Result<(), String> {
    let python = environment("numpy")?;
    // Together: with the same features of what both use.
    cargo("build -p wimu-python -p wimu").run()?;
    let built = target().join("debug");
    let module = target().join("python/module");
    let copied = fs::create_dir_all(&module).and_then(|()| {
        let library = built.join(format!("{DLL_PREFIX}wimu{DLL_SUFFIX}"));
        fs::copy(library, module.join("wimu.abi3.so"))
    });
    copied.map_err(|problem| format!("the Python module cannot be copied: {problem}"))?;
    let module = std::path::absolute(module).map_err(|problem| problem.to_string())?;
    tests(&python, &built).word("smoke").with("PYTHONPATH", &text(&module)).run()
}

/// Builds the wheel, installs it in the virtual environment, and runs all tests on it.
///
/// # Errors
/// Says what is missing or which command failed.
pub fn run() -> Result<(), String> {
    let python = environment("numpy maturin")?;
    let wheels = target().join("python/wheels");
    // The version is in the name of a wheel: one of an earlier version would be installed, too.
    let _ = fs::remove_dir_all(&wheels);
    interpreter(&python)
        .words("-m maturin build --release --locked --quiet --manifest-path")
        .word(&format!("{CRATE}/Cargo.toml"))
        .word("--out")
        .word(&text(&wheels))
        .run()?;
    let wheel = fs::read_dir(&wheels).ok().and_then(|mut files| files.next()?.ok());
    let wheel = wheel.ok_or("maturin built no wheel")?;
    interpreter(&python)
        .words("-m pip install --quiet --no-deps --force-reinstall")
        .word(&text(&wheel.path()))
        .run()?;
    cargo("build --release -p wimu").run()?;
    tests(&python, &target().join("release")).run()
}

/// The tests, which compare with the command built in the folder `built`.
fn tests(python: &Path, built: &Path) -> CommandLine {
    let command = std::path::absolute(built.join("wimu")).unwrap_or_default();
    let tests = interpreter(python).word(&format!("{CRATE}/tests/test_wimu.py"));
    tests.with("WIMU_COMMAND", &text(&command))
}

fn interpreter(python: &Path) -> CommandLine {
    CommandLine::new("").word(&text(python))
}

fn target() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| "target".into(), PathBuf::from)
}

fn text(path: &Path) -> String {
    path.display().to_string()
}
