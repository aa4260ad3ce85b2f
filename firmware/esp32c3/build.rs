//! Linker arguments. Where flash and RAM are is in the linker script of esp-hal.

fn main() {
    // Not in .cargo/config.toml, where RUSTFLAGS in the environment would replace it.
    println!("cargo::rustc-link-arg-bins=-Tlinkall.x");
    println!("cargo::rerun-if-changed=build.rs");
}
