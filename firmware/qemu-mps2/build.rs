//! Linker arguments, and the machine's memory.

use std::path::Path;
use std::{env, fs};

const MEMORY: &str = "
MEMORY {
  FLASH : ORIGIN = 0x00000000, LENGTH = 4M
  RAM : ORIGIN = 0x20000000, LENGTH = 4M
}";

fn main() {
    let folder = env::var("OUT_DIR").expect("cargo sets OUT_DIR");
    let file = |name: &str, content: &str| {
        fs::write(Path::new(&folder).join(name), content).expect("OUT_DIR can be written");
    };
    file("memory.x", MEMORY);
    // Every interrupt that is used has its handler in the table of `interrupts`.
    file("device.x", "");
    println!("cargo::rustc-link-search={folder}");
    // Here and not in .cargo/config.toml, where RUSTFLAGS in the environment would replace it.
    for argument in ["-Tlink.x", "-Tdefmt.x", "--nmagic"] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
    println!("cargo::rerun-if-changed=build.rs");
}
