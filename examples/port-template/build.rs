//! Linker arguments, and where flash and RAM are.

use std::path::Path;
use std::{env, fs};

fn main() {
    let folder = env::var("OUT_DIR").expect("cargo sets OUT_DIR");
    let memory = include_str!("memory.x");
    fs::write(Path::new(&folder).join("memory.x"), memory).expect("OUT_DIR can be written");
    println!("cargo::rustc-link-search={folder}");
    // The HAL brings the table of interrupts: delete this line, the function, and the feature `device` of cortex-m-rt.
    no_interrupts(&Path::new(&folder).join("device"));
    let mut arguments = vec!["--nmagic", "-Tlink.x"];
    if env::var_os("CARGO_FEATURE_DEFMT").is_some() {
        arguments.push("-Tdefmt.x");
    }
    for argument in arguments {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
    println!("cargo::rerun-if-changed=memory.x");
}

/// An empty table of interrupts, in a folder of its own: one that is left from an earlier build is not found.
fn no_interrupts(folder: &Path) {
    fs::create_dir_all(folder).expect("OUT_DIR can be written");
    fs::write(folder.join("device.x"), "").expect("OUT_DIR can be written");
    println!("cargo::rustc-link-search={}", folder.display());
}
