//! For build scripts: the memory layout and the arguments of the linker.

use std::path::Path;
use std::{env, fs};

/// Links the binaries with `memory` as `memory.x`, and with `arguments`.
pub fn link(memory: &str, arguments: &[&str]) {
    let folder = env::var("OUT_DIR").expect("cargo sets OUT_DIR");
    fs::write(Path::new(&folder).join("memory.x"), memory).expect("OUT_DIR can be written");
    println!("cargo::rustc-link-search={folder}");
    // Not in .cargo/config.toml, where RUSTFLAGS in the environment would replace them.
    for argument in arguments {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
    for file in ["build.rs", "memory.x", "../shared/board.rs", "../shared/link.rs"] {
        if Path::new(file).exists() {
            println!("cargo::rerun-if-changed={file}");
        }
    }
}
