//! Linker arguments, and the memory of the machine that runs the target.

use std::path::Path;
use std::{env, fs};

/// QEMU's mps2-an386: Cortex-M4F.
const MPS2_AN386: &str = "
MEMORY {
  FLASH : ORIGIN = 0x00000000, LENGTH = 4M
  RAM : ORIGIN = 0x20000000, LENGTH = 4M
}";

/// QEMU's microbit: nRF51822, Cortex-M0.
const MICROBIT: &str = "
MEMORY {
  FLASH : ORIGIN = 0x00000000, LENGTH = 256K
  RAM : ORIGIN = 0x20000000, LENGTH = 16K
}";

fn main() {
    let target = env::var("TARGET").expect("cargo sets TARGET");
    let folder = env::var("OUT_DIR").expect("cargo sets OUT_DIR");
    let memory = if target.starts_with("thumbv6m") {
        MICROBIT
    } else {
        MPS2_AN386
    };
    fs::write(Path::new(&folder).join("memory.x"), memory).expect("OUT_DIR can be written");
    println!("cargo::rustc-link-search={folder}");
    // Here and not in .cargo/config.toml, where RUSTFLAGS in the environment would replace it.
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    println!("cargo::rustc-link-arg-bins=--nmagic");
    println!("cargo::rerun-if-changed=build.rs");
}
