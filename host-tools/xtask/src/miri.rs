//! The fast tests of the crates under Miri, an interpreter that finds undefined behaviour.

use crate::command_line::CommandLine;

/// What installs Miri.
const INSTALL: &str = "rustup toolchain install nightly --component miri,rust-src";
/// Packages and tests: those of the golden vectors have all messages, and none takes many repetitions. The crates forbid
/// `unsafe`; of their dependencies these two use some that have it, for queues, frames and tasks.
const TESTS: [&str; 2] = [
    "-p wimu-link -p wimu-node --features wimu-node/full --lib",
    "-p wimu-link --test all vectors::",
];

/// Runs them.
///
/// # Errors
/// Says what to install, or which command failed.
pub fn run() -> Result<(), String> {
    let miri = || CommandLine::new("rustup run nightly cargo miri");
    if miri().word("--version").output().is_none() {
        return Err(format!("Miri is not installed: {INSTALL}"));
    }
    TESTS.iter().try_for_each(|tests| {
        miri()
            .word("test")
            .words(tests)
            // The tests read files; their lane is the shortest.
            .with("MIRIFLAGS", "-Zmiri-disable-isolation")
            .with("WIMU_LANE", "check")
            .with("PROPTEST_CASES", "4")
            .run()
    })
}
