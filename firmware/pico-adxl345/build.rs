//! Linker arguments, and where flash and RAM are.

use std::path::Path;
use std::{env, fs};

fn main() {
    let folder = env::var("OUT_DIR").expect("cargo sets OUT_DIR");
    let script = fs::read("memory.x").expect("memory.x lies here");
    fs::write(Path::new(&folder).join("memory.x"), script).expect("OUT_DIR can be written");
    println!("cargo::rustc-link-search={folder}");
    println!("cargo::rerun-if-changed=memory.x");
    println!("cargo::rerun-if-changed=build.rs");
    // Here and not in .cargo/config.toml, where RUSTFLAGS in the environment would replace it.
    // Functions that are alike are there once.
    let mut arguments = vec!["--nmagic", "--icf=all", "-Tlink.x", "-Tlink-rp.x"];
    if env::var_os("CARGO_FEATURE_DEFMT").is_some() {
        arguments.push("-Tdefmt.x");
    }
    for argument in arguments {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
}
