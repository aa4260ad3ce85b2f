//! The Python module, `host-tools/wimu-python`.

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};
use std::path::PathBuf;

use xshell::{Cmd, Shell, cmd};

use crate::lanes::Run;
use crate::{Result, cargo_target, setup};

const CRATE: &str = "host-tools/wimu-python";

/// Compares a calibration of the module, as built with the tests, with that of the command.
pub fn smoke(run: &Run<'_>) -> Result {
    let sh = run.sh;
    cmd!(sh, "cargo build --locked --workspace --lib --bins --tests").run()?;
    let module = cargo_target().join("python/module");
    sh.create_dir(&module)?;
    let library = cargo_target().join(format!("debug/{DLL_PREFIX}wimu{DLL_SUFFIX}"));
    sh.copy_file(library, module.join("wimu.abi3.so"))?;
    run.tests(tests(sh, "debug").arg("smoke").env("PYTHONPATH", module))
}

/// Builds the wheel, installs it in the virtual environment, and runs all tests on it.
pub fn wheel(sh: &Shell) -> Result {
    setup::run(sh, true)?;
    let wheels = cargo_target().join("python/wheels");
    // The version is in the name of a wheel: one of an earlier version would be installed, too.
    sh.remove_path(&wheels)?;
    let manifest = format!("{CRATE}/Cargo.toml");
    let python = python();
    cmd!(sh, "{python} -m maturin build --release --locked --quiet --manifest-path {manifest} --out {wheels}").run()?;
    let wheel = sh.read_dir(&wheels)?;
    cmd!(sh, "{python} -m pip install --quiet --no-deps --force-reinstall {wheel...}").run()?;
    cmd!(sh, "cargo build --release --locked -p wimu").run()?;
    Ok(tests(sh, "release").run()?)
}

/// The tests, which compare with the command built in a profile.
fn tests<'a>(sh: &'a Shell, profile: &str) -> Cmd<'a> {
    let (python, command) = (python(), cargo_target().join(profile).join("wimu"));
    cmd!(sh, "{python} {CRATE}/tests/test_wimu.py").env("WIMU_COMMAND", command)
}

/// The interpreter of the virtual environment, which `cargo xtask setup` makes.
fn python() -> PathBuf {
    std::env::current_dir().unwrap_or_default().join("target/python/bin/python")
}
