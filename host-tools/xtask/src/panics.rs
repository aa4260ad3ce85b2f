//! That no panic is reachable in the libraries: no function of a library's optimised object file refers to a
//! panic of `core`. Generic functions count where the library itself uses them. Not covered: `wimu-calib` and `wimu-nav`,
//! which index matrices of `nalgebra`, and the borrows inside critical sections of generic and asynchronous functions.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use object::read::elf::ElfFile32;
use object::{Object as _, ObjectSection as _, ObjectSymbol as _, RelocationTarget};

use crate::command_line::heading;
use crate::output::Output;
use crate::setup::{self, Need, TARGETS, ThisMachine, embedded_cargo};

/// The libraries, with the features that add functions.
const LIBRARIES: [(&str, &str); 7] = [
    ("wimu-model", ""),
    ("wimu-integrator", ""),
    ("wimu-link", "auth"),
    ("wimu-registers", ""),
    ("wimu-adxl345", ""),
    ("wimu-lsm6dso", ""),
    ("wimu-node", "full,flash-store"),
];
/// Functions for constants, whose panic is an error of the compiler.
const CONSTANTS: [&str; 1] = ["wimu_node::mounting::Mounting::new"];

/// Builds the libraries and looks for panics.
///
/// # Errors
/// Names each function that can panic.
pub fn run() -> Result<(), String> {
    let source = setup::provide(Need::Targets, &mut ThisMachine)?;
    let mut found = Vec::new();
    let mut known = 0;
    for target in TARGETS {
        for (library, features) in LIBRARIES {
            heading(&format!("{library} for {target}"));
            embedded_cargo(source, "rustc")
                .words(&format!("-p {library} --lib --release --target {target}"))
                .words(&format!("--features={features}"))
                .words("-- --emit=obj -Copt-level=3 -Ccodegen-units=1 -Cpanic=abort")
                .run()?;
            let object = newest_object(&Output::of(Path::new("."))?, library, target)?;
            let failed = |error: &dyn std::fmt::Display| format!("{}: {error}", object.display());
            let bytes = std::fs::read(&object).map_err(|error| failed(&error))?;
            let panics = panics(&bytes).map_err(|error| failed(&error))?;
            for (function, panic) in panics {
                match CONSTANTS.iter().any(|known| function.starts_with(known)) {
                    true => known += 1,
                    false => found.push(format!("{function}: {panic}")),
                }
            }
        }
    }
    if known == 0 {
        return Err("no panic was found where one is known to be".into());
    }
    match found {
        none if none.is_empty() => Ok(()),
        some => Err(format!("panics are reachable in\n    {}", some.join("\n    "))),
    }
}

/// The object file of a library that was written last.
fn newest_object(output: &Output, library: &str, target: &str) -> Result<PathBuf, String> {
    let folder = output.image("deps", target);
    let start = format!("{}-", library.replace('-', "_"));
    let age = |path: &PathBuf| {
        let modified = path.metadata().and_then(|data| data.modified());
        modified.unwrap_or(SystemTime::UNIX_EPOCH)
    };
    let files =
        std::fs::read_dir(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    files
        .flatten()
        .map(|file| file.path())
        .filter(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            name.starts_with(&start) && name.ends_with(".o")
        })
        .max_by_key(age)
        .ok_or_else(|| format!("{library}: no object file in {}", folder.display()))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_panics_of_core_are_known_by_their_names() {
        for panic in [
            "core::panicking::panic_bounds_check",
            "core::panicking::panic_const::panic_const_div_by_zero",
            "core::slice::index::slice_index_fail",
            "core::option::expect_failed",
            "core::result::unwrap_failed",
            "core::cell::panic_already_borrowed",
            "core::slice::copy_from_slice_impl::len_mismatch_fail",
        ] {
            assert!(is_panic(panic), "{panic}");
        }
        for other in ["memcpy", "core::fmt::write", "wimu_link::panic::expect_failed"] {
            assert!(!is_panic(other), "{other}");
        }
    }

    #[test]
    fn what_is_no_object_file_is_an_error() {
        assert!(panics(b"\x7fELF").is_err());
    }
}
