//! The lane `release`: what `test` leaves out, before a release.

use xshell::{Shell, cmd};

use crate::boards::{PICO, QEMU, build_pico, buildable};
use crate::lanes::{Lane, Run, libraries};
use crate::setup::{OLDEST, PICO2, TARGETS, embedded_cargo, has, has_core};
use crate::{Result, budget, instructions, panics, python, setup};

/// Tests of the host that take minutes or need a program; campaigns are not among them.
const HEAVY: [&str; 5] =
    ["qemu::", "dashboard::browser::", "report_pages::", "fleet::", "hostile::"];

pub const RELEASE: Lane = (
    "release",
    &[
        ("setup", |run| setup::run(run.sh, true)),
        ("oldest", oldest),
        ("doc", doc),
        ("features", features),
        ("embedded", embedded),
        ("panics", |run| panics::run(run.sh)),
        ("boards", boards),
        ("sizes", |run| budget::sizes(run.sh)),
        ("instructions", |run| instructions::run(run.sh)),
        ("heavy", |run| {
            QEMU.build(run.sh, &[])?;
            run.ignored_tests(&HEAVY)
        }),
        ("pico", pico),
        ("optional", optional),
        ("python", wheel),
        ("packages", packages),
    ],
);

const DENY: [&str; 3] = ["--", "-D", "warnings"];

fn oldest(run: &Run<'_>) -> Result {
    if !has(run.sh, "the oldest Rust") {
        return Ok(());
    }
    Ok(cmd!(run.sh, "rustup run {OLDEST} cargo check --workspace --locked").run()?)
}

fn doc(run: &Run<'_>) -> Result {
    let doc = cmd!(run.sh, "cargo doc --locked --no-deps --all-features").args(selected(run)?);
    Ok(doc.env("RUSTDOCFLAGS", "-D warnings").run()?)
}

/// The libraries as options of cargo.
fn selected(run: &Run<'_>) -> Result<Vec<String>> {
    Ok(libraries(run.sh)?.into_iter().flat_map(|(name, _)| ["-p".to_owned(), name]).collect())
}

fn features(run: &Run<'_>) -> Result {
    for (name, features) in libraries(run.sh)? {
        let all = features.join(",");
        let one_by_one = features.iter().map(String::as_str);
        for choice in one_by_one.chain([all.as_str(), ""]) {
            let clippy =
                cmd!(run.sh, "cargo clippy --locked --quiet -p {name} --no-default-features");
            clippy.args(["--features", choice]).args(DENY).run()?;
        }
    }
    Ok(())
}

/// Each package by itself: built together, one could lean on features that another asks for.
fn embedded(run: &Run<'_>) -> Result {
    for (name, features) in libraries(run.sh)? {
        for features in [String::new(), features.join(",")] {
            let check = embedded_cargo(run.sh, "check").args(["--lib", "-p", &name]);
            let check = check.args(["--features", &features]);
            check.args(TARGETS.iter().flat_map(|target| ["--target", target])).run()?;
        }
    }
    let bare_loop =
        embedded_cargo(run.sh, "build").args(["-p", "bare-loop", "--target", TARGETS[0]]);
    Ok(bare_loop.run()?)
}

/// Every board with its log. Debian's toolchain has no Clippy of its version.
fn boards(run: &Run<'_>) -> Result {
    let has_clippy = has_core(run.sh);
    if !has_clippy {
        println!("skipped: Clippy, as the active toolchain has no core for the boards");
    }
    for board in buildable(run.sh) {
        if board.has_log {
            board.build(run.sh, &["--features", "defmt"])?;
        }
        if has_clippy && board.folder == PICO.folder {
            let pico2 = ["--no-default-features", "--features", "pico2,mpu6050,usb"];
            board.cargo(
                run.sh,
                "check",
                &[&["--release", "--target", PICO2][..], &pico2].concat(),
            )?;
        }
        if has_clippy {
            board.cargo(run.sh, "clippy", &[&["--release"], &DENY[..]].concat())?;
        }
    }
    Ok(())
}

fn pico(run: &Run<'_>) -> Result {
    if !has(run.sh, "rp2040js") {
        return Ok(());
    }
    for (sensor, names) in [("adxl345", "pico::"), ("mpu6050", "pico_mpu6050::")] {
        let [file, elf] = build_pico(run.sh, sensor)?;
        let tests = cmd!(run.sh, "cargo test --locked --workspace --test all {names} -- --ignored");
        run.tests(tests.env("WIMU_PICO_FIRMWARE", file).env("WIMU_PICO_ELF", elf))?;
    }
    Ok(())
}

fn optional(run: &Run<'_>) -> Result {
    let sh = run.sh;
    cmd!(sh, "cargo check --locked -p wimu --features flash").env("PKG_CONFIG", "false").run()?;
    run.tests(cmd!(sh, "cargo test --locked -p wimu-host --features sqlite --test all bags::"))?;
    cmd!(sh, "cargo check --locked -p wimu --features mqtt-tls").run()?;
    if !has(sh, "libdbus") {
        return Ok(());
    }
    let clippy = cmd!(sh, "cargo clippy --locked -p wimu -p wimu-host --all-targets");
    clippy.args(["--features", "wimu/ble,wimu-host/ble"]).args(DENY).run()?;
    let ble = cmd!(sh, "cargo test --locked -p wimu-host --features ble --test all");
    run.tests(ble.args(["--", "ble::", "transport::", "link_url::"]))
}

fn wheel(run: &Run<'_>) -> Result {
    if has(run.sh, "maturin") { python::wheel(run.sh) } else { Ok(()) }
}

/// What is published. Offline, as asking the registry for each dependency again takes minutes.
fn packages(run: &Run<'_>) -> Result {
    let package = cmd!(run.sh, "cargo package --locked --offline --no-verify --allow-dirty");
    let host = ["-p", "wimu", "-p", "wimu-host", "-p", "wimu-sim"];
    Ok(package.args(selected(run)?).args(host).run()?)
}

/// Runs the fast tests of the crates whose dependencies have `unsafe` code, for queues, frames and tasks, under Miri.
pub fn miri(sh: &Shell) -> Result {
    const PACKAGES: &str = "-p wimu-link -p wimu-node --features wimu-node/full --lib";
    for tests in [PACKAGES, "-p wimu-link --test all vectors::"] {
        let tests = tests.split(' ');
        // The tests read files; their lane is the shortest.
        cmd!(sh, "rustup run nightly cargo miri test {tests...}")
            .env("MIRIFLAGS", "-Zmiri-disable-isolation")
            .env("WIMU_LANE", "check")
            .env("PROPTEST_CASES", "4")
            .run()?;
    }
    Ok(())
}
