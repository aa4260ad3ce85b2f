//! That no panic is reachable in the libraries: no function of a library's optimised object file refers to a
//! panic of `core`. Generic functions count where the library itself uses them. Not covered: `wimu-calib` and `wimu-nav`,
//! which index matrices of `nalgebra`, and the borrows inside critical sections of generic and asynchronous functions.

use std::collections::BTreeMap;
use std::path::PathBuf;

use object::read::elf::ElfFile32;
use object::{Object as _, ObjectSection as _, ObjectSymbol as _, RelocationTarget};
use xshell::Shell;

use crate::setup::{TARGETS, embedded_cargo};
use crate::{Result, cargo_target};

/// The libraries, with the features that add functions.
const LIBRARIES: [(&str, &str); 5] = [
    ("wimu-model", ""),
    ("wimu-integrator", ""),
    ("wimu-link", "auth"),
    ("wimu-node", "full,flash-store"),
    ("wimu-sensors", ""),
];
/// Functions for constants, whose panic is an error of the compiler.
const CONSTANTS: [&str; 1] = ["wimu_node::mounting::Mounting::new"];

/// Builds the libraries and looks for panics.
pub fn run(sh: &Shell) -> Result {
    let mut found = Vec::new();
    let mut known = 0;
    for target in TARGETS {
        for (library, features) in LIBRARIES {
            let package =
                ["-p", library, "--lib", "--release", "--target", target, "--features", features];
            let compiler = ["--emit=obj", "-Copt-level=3", "-Ccodegen-units=1", "-Cpanic=abort"];
            embedded_cargo(sh, "rustc").args(package).arg("--").args(compiler).run()?;
            let object = newest_object(library, target)?;
            for (function, panic) in panics(&std::fs::read(object)?)? {
                if CONSTANTS.iter().any(|known| function.starts_with(known)) {
                    known += 1;
                } else {
                    found.push(format!("{function}: {panic}"));
                }
            }
        }
    }
    if known == 0 {
        return Err("no panic was found where one is known to be".into());
    }
    if found.is_empty() {
        return Ok(());
    }
    Err(format!("panics are reachable in\n    {}", found.join("\n    ")).into())
}

/// The object file of a library that was written last.
fn newest_object(library: &str, target: &str) -> Result<PathBuf> {
    let folder = cargo_target().join(target).join("release/deps");
    let start = format!("{}-", library.replace('-', "_"));
    let mut newest = None;
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.starts_with(&start) && name.ends_with(".o") {
            newest = newest.max(Some((entry.metadata()?.modified()?, entry.path())));
        }
    }
    let (_, path) = newest.ok_or_else(|| format!("{library}: no object file"))?;
    Ok(path)
}

/// The functions of an object file that refer to a panic, and to which.
fn panics(object: &[u8]) -> object::Result<BTreeMap<String, String>> {
    let object = ElfFile32::<object::LittleEndian>::parse(object)?;
    let mut found = BTreeMap::new();
    for section in object.sections() {
        let Some(function) = section.name()?.strip_prefix(".text.") else {
            continue;
        };
        for (_, relocation) in section.relocations() {
            let RelocationTarget::Symbol(symbol) = relocation.target() else {
                continue;
            };
            let symbol = demangled(object.symbol_by_index(symbol)?.name()?);
            if is_panic(&symbol) {
                found.insert(demangled(function), symbol);
            }
        }
    }
    Ok(found)
}

fn demangled(symbol: &str) -> String {
    format!("{:#}", rustc_demangle::demangle(symbol))
}

/// Whether a function of `core` ends in a panic.
fn is_panic(function: &str) -> bool {
    let last = function.rsplit("::").next().unwrap_or_default();
    function.starts_with("core::")
        && (function.contains("::panic") || last.ends_with("_fail") || last.ends_with("_failed"))
}
