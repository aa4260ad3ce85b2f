//! What the lanes need beyond cargo, found or installed, and where `core` for the microcontrollers comes from.

use xshell::{Cmd, Shell, cmd};

use crate::Result;

/// Cortex-M4F and Cortex-M0+.
pub const TARGETS: [&str; 2] = ["thumbv7em-none-eabihf", "thumbv6m-none-eabi"];
/// Cortex-M33 of a Pico 2.
pub const PICO2: &str = "thumbv8m.main-none-eabihf";
/// The oldest Rust that users may have.
pub const OLDEST: &str = env!("CARGO_PKG_RUST_VERSION");

/// Something that a lane needs: a shell line that succeeds where it is there, and one that installs it. `apt` stands for
/// `apt-get install --yes --no-install-recommends`, `pip` for that of the virtual environment.
struct Need {
    name: &'static str,
    check: &'static str,
    install: &'static str,
}

const fn need(name: &'static str, check: &'static str, install: &'static str) -> Need {
    Need { name, check, install }
}

/// The active toolchain has `core` for both targets.
const TOOLCHAIN_CORE: &str = "for target in thumbv7em-none-eabihf thumbv6m-none-eabi; do \
     ls \"$(rustc --print target-libdir --target $target)\"/libcore-*.rlib || exit 1; done";
/// The same, or Debian's toolchain beside it can build `core` from its source, and link.
const CORE: &str = "(for target in thumbv7em-none-eabihf thumbv6m-none-eabi; do \
     ls \"$(rustc --print target-libdir --target $target)\"/libcore-*.rlib || exit 1; done) || \
     (ld.lld --version && /usr/bin/cargo --version && \
     ls \"$(/usr/bin/rustc --print sysroot)/lib/rustlib/src/rust/library/core/Cargo.toml\")";
const INSTALL_CORE: &str = "rustup target add thumbv7em-none-eabihf thumbv6m-none-eabi || \
     apt rustc-web cargo-web rust-web-src lld";
/// The same for the boards of the lane `release` only.
const OTHER_CORE: &str = "for target in thumbv8m.main-none-eabihf riscv32imc-unknown-none-elf; do \
     ls \"$(rustc --print target-libdir --target $target)\"/libcore-*.rlib || exit 1; done";
const OLDEST_CHECK: &str =
    concat!("rustup run ", env!("CARGO_PKG_RUST_VERSION"), " cargo --version");
const OLDEST_INSTALL: &str =
    concat!("rustup toolchain install --profile minimal ", env!("CARGO_PKG_RUST_VERSION"));

#[rustfmt::skip]
const NEEDS: [Need; 8] = [
    need("rustfmt", "cargo fmt --version", "rustup component add rustfmt"),
    need("clippy", "cargo clippy --version", "rustup component add clippy"),
    need("core for Cortex-M4F and Cortex-M0+", CORE, INSTALL_CORE),
    need("QEMU", "command -v qemu-system-arm", "apt qemu-system-arm"),
    need("Chromium", "command -v chromium", "apt chromium"),
    need("Mosquitto", "test -x /usr/sbin/mosquitto", "apt mosquitto"),
    need("Python 3 with venv", "python3 -c 'import venv, ensurepip'", "apt python3 python3-venv"),
    need("NumPy", "target/python/bin/python -c 'import numpy'", "python3 -m venv target/python && pip numpy"),
];
/// What only the lane `release` needs, which leaves out what cannot be done without it.
#[rustfmt::skip]
const RELEASE_NEEDS: [Need; 8] = [
    need("maturin", "target/python/bin/python -m maturin --version", "pip maturin"),
    need("faketime", "command -v faketime", "apt faketime"),
    need("libclang", "ls /usr/lib/llvm-*/lib/libclang.so*", "apt libclang-dev"),
    need("libdbus", "pkg-config --exists dbus-1", "apt libdbus-1-dev pkg-config"),
    need("Node.js", "node --version && npm --version", "apt nodejs npm"),
    need("rp2040js", "ls tests/pico/node_modules/rp2040js", "npm ci --no-audit --no-fund --prefix tests/pico"),
    need("the oldest Rust", OLDEST_CHECK, OLDEST_INSTALL),
    need("core for Cortex-M33 and RISC-V", OTHER_CORE, "rustup target add thumbv8m.main-none-eabihf riscv32imc-unknown-none-elf"),
];

/// Finds everything that the lane `test` needs, or with `release` that one too; as root or with CI=true it installs what
/// is missing.
pub fn run(sh: &Shell, release: bool) -> Result {
    let is_root = cmd!(sh, "id -u").quiet().read()? == "0";
    let may_install = is_root || std::env::var("CI").is_ok_and(|value| value == "true");
    let mut has_updated = false;
    let mut missing = Vec::new();
    let of_release = RELEASE_NEEDS.iter().filter(|_| release);
    for need in NEEDS.iter().chain(of_release) {
        let line = need.install.replace("apt ", "apt-get install --yes --no-install-recommends ");
        let line = line.replace("pip ", "target/python/bin/python -m pip install --quiet ");
        let mut found = succeeds(sh, need.check);
        if !found && may_install {
            if line.contains("apt-get") && !has_updated {
                cmd!(sh, "apt-get update").ignore_status().run()?;
                has_updated = true;
            }
            cmd!(sh, "sh -c {line}").ignore_status().run()?;
            found = succeeds(sh, need.check);
        }
        if found {
            println!("{}: found", need.name);
            continue;
        }
        println!("{} is missing; run\n    {line}", need.name);
        missing.push(need.name);
    }
    missing.retain(|name| NEEDS.iter().any(|need| need.name == *name));
    if missing.is_empty() { Ok(()) } else { Err(format!("missing: {}", missing.join(", ")).into()) }
}

/// Whether a need of `release` is met; otherwise says that what needs it is skipped.
pub fn has(sh: &Shell, name: &str) -> bool {
    let need = RELEASE_NEEDS.iter().find(|need| need.name == name).expect("a need by its name");
    let has = succeeds(sh, need.check);
    if !has {
        println!("skipped: {name} is missing");
    }
    has
}

fn succeeds(sh: &Shell, line: &str) -> bool {
    cmd!(sh, "sh -c {line}").quiet().ignore_stdout().ignore_stderr().run().is_ok()
}

/// Whether the active toolchain has `core` for the microcontrollers.
pub fn has_core(sh: &Shell) -> bool {
    succeeds(sh, TOOLCHAIN_CORE)
}

/// `cargo VERB` for the microcontrollers: of the active toolchain if it has their `core`, otherwise Debian's, which
/// builds `core` from source and has no rust-lld.
pub fn embedded_cargo<'a>(sh: &'a Shell, verb: &str) -> Cmd<'a> {
    if has_core(sh) {
        return cmd!(sh, "cargo {verb} --locked");
    }
    let from_source = ["-Zbuild-std=core,alloc", "-Zbuild-std-features=compiler-builtins-mem"];
    cmd!(sh, "/usr/bin/cargo {verb} --locked {from_source...}")
        .env("RUSTC_BOOTSTRAP", "1")
        .env("RUSTC", "/usr/bin/rustc")
        .env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", "ld.lld")
        .env("CARGO_TARGET_THUMBV6M_NONE_EABI_LINKER", "ld.lld")
}
