//! Linker arguments, and the machine's memory.

use std::path::Path;
use std::{env, fs};

#[path = "../shared/link.rs"]
mod link;

const MEMORY: &str = "
MEMORY {
  FLASH : ORIGIN = 0x00000000, LENGTH = 4M
  RAM : ORIGIN = 0x20000000, LENGTH = 256K
}";

fn main() {
    let folder = env::var("OUT_DIR").expect("cargo sets OUT_DIR");
    // Empty: the module `interrupts` has the table of interrupt handlers.
    fs::write(Path::new(&folder).join("device.x"), "").expect("OUT_DIR can be written");
    link::link(MEMORY, &["-Tlink.x", "-Tdefmt.x", "--nmagic"]);
}
