//! Linker arguments, and the memory of the machine that runs the target.

#[path = "../shared/link.rs"]
mod link;

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
    let target = std::env::var("TARGET").expect("cargo sets TARGET");
    let memory = if target.starts_with("thumbv6m") { MICROBIT } else { MPS2_AN386 };
    link::link(memory, &["-Tlink.x", "--nmagic"]);
}
