//! Linker arguments, and the machine's memory.

#[path = "../shared/link.rs"]
mod link;

/// QEMU's mps2-an386: Cortex-M4F.
const MEMORY: &str = "
MEMORY {
  FLASH : ORIGIN = 0x00000000, LENGTH = 4M
  RAM : ORIGIN = 0x20000000, LENGTH = 4M
}";

fn main() {
    link::link(MEMORY, &["-Tlink.x", "--nmagic"]);
}
