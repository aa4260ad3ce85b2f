//! The lanes `check` and `test`, and how a lane runs: each step prints its wall and CPU seconds, and the last line is
//! `N passed, N failed`.

use std::cell::Cell;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

use nix::sys::resource::{UsageWho, getrusage};
use serde_json::Value;
use xshell::{Cmd, Shell, cmd};

use crate::boards::{ALL, QEMU};
use crate::setup::{TARGETS, embedded_cargo};
use crate::{Result, budget, heading, python, setup};

/// Steps that are run in order; the first that fails is the last.
pub type Lane = (&'static str, &'static [Step]);
/// Its name, and what it does.
pub type Step = (&'static str, fn(&Run<'_>) -> Result);

/// Before each commit.
pub const CHECK: Lane = ("check", &[("format", format), ("clippy", clippy), ("tests", tests)]);

/// Before a change is kept.
pub const TEST: Lane = (
    "test",
    &[
        ("setup", |run| setup::run(run.sh, false)),
        ("format", format),
        ("clippy", clippy),
        ("build", build),
        ("tests", tests),
        ("doctests", |run| run.tests(cmd!(run.sh, "cargo test --locked --workspace --doc"))),
        ("embedded", embedded),
        ("qemu", |run| {
            QEMU.build(run.sh, &[])?;
            run.ignored_tests(&["qemu::first_light_on_a_cortex_m"])
        }),
        ("python", python::smoke),
        ("browser", |run| run.ignored_tests(&["dashboard::browser::a_person_calibrates"])),
        ("broker", |run| {
            run.ignored_tests(&["fleet::a_recording_through_the_broker", "compat::a_fleet_has"])
        }),
    ],
);

/// A lane that runs.
pub struct Run<'a> {
    pub sh: &'a Shell,
    passed: Cell<u64>,
    failed: Cell<u64>,
}

/// Runs the steps of a lane named in `only`, or all; ends this process if one fails.
pub fn run(sh: &Shell, (lane, steps): Lane, only: &[String]) -> Result {
    if let Some(unknown) = only.iter().find(|name| steps.iter().all(|step| step.0 != **name)) {
        let names: Vec<_> = steps.iter().map(|step| step.0).collect();
        return Err(format!("there is no step `{unknown}`: {}", names.join(", ")).into());
    }
    let temporary = tempfile::Builder::new().prefix("lane-").tempdir()?;
    sh.set_var("TMPDIR", temporary.path());
    sh.set_var("WIMU_LANE", if lane == "check" { "check" } else { "test" });
    // The same cases each time, so that a commit is not refused by chance; campaigns draw new ones.
    sh.set_var("PROPTEST_RNG_SEED", "0");
    let run = Run { sh, passed: Cell::new(0), failed: Cell::new(0) };
    let mut table = format!("{:<12}{:>8}{:>8}\n", "step", "wall s", "CPU s");
    let mut row = |name: &str, wall_s: f64, cpu_s: f64| {
        table += &format!("{name:<12}{wall_s:>8.1}{cpu_s:>8.1}\n")
    };
    let (start, mut problem) = (Instant::now(), None);
    for (name, step) in steps {
        if problem.is_some() || !only.is_empty() && only.iter().all(|wanted| wanted != name) {
            continue;
        }
        heading(name);
        let (start, cpu_s) = (Instant::now(), children_cpu_s()?);
        let outcome = step(&run).and_then(|()| left_nothing(temporary.path()));
        row(name, start.elapsed().as_secs_f64(), children_cpu_s()? - cpu_s);
        let counter = if outcome.is_ok() { &run.passed } else { &run.failed };
        counter.set(counter.get() + 1);
        problem = outcome.err().map(|problem| {
            format!("{name}: {problem}\njust this step again: cargo xtask {lane} --only {name}")
        });
    }
    row("total", start.elapsed().as_secs_f64(), children_cpu_s()?);
    println!("\n{table}");
    if let Some(problem) = &problem {
        println!("error: {problem}\n");
    }
    println!("{} passed, {} failed", run.passed.get(), run.failed.get());
    if problem.is_some() {
        drop(temporary);
        std::process::exit(1);
    }
    Ok(())
}

/// CPU time of all processes that ended, user and system, s.
fn children_cpu_s() -> Result<f64> {
    let usage = getrusage(UsageWho::RUSAGE_CHILDREN)?;
    let seconds = [usage.user_time(), usage.system_time()]
        .map(|t| t.tv_sec() as f64 + t.tv_usec() as f64 * 1e-6);
    Ok(seconds[0] + seconds[1])
}

/// Checks that no test left a file of ours in the folder for temporary files.
fn left_nothing(folder: &Path) -> Result {
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.starts_with("wimu") || name.starts_with(".tmp") {
            // What is in it tells the test.
            let files = std::fs::read_dir(entry.path()).into_iter().flatten().flatten().take(8);
            let files: Vec<_> = files.map(|file| file.file_name()).collect();
            let text = format!("a test left {name} {files:?} in the folder for temporary files");
            return Err(text.into());
        }
    }
    Ok(())
}

impl Run<'_> {
    /// Runs a test runner, in view, and counts its tests.
    pub fn tests(&self, command: Cmd<'_>) -> Result {
        println!("$ {command}");
        let line = command.to_string();
        let mut child =
            Command::from(command).stdin(Stdio::null()).stdout(Stdio::piped()).spawn()?;
        for line in BufReader::new(child.stdout.take().ok_or("no output")?).lines() {
            let line = line?;
            let [passed, failed] = counts(&line);
            self.passed.set(self.passed.get() + passed);
            self.failed.set(self.failed.get() + failed);
            println!("{line}");
        }
        let status = child.wait()?;
        if status.success() { Ok(()) } else { Err(format!("`{line}` failed ({status})").into()) }
    }

    /// Runs those tests that an ordinary run leaves out and whose names begin so, as they have been built for the
    /// others.
    pub fn ignored_tests(&self, names: &[&str]) -> Result {
        let before = self.passed.get();
        let tests =
            cmd!(self.sh, "cargo test --locked --workspace --test all -- --ignored {names...}");
        self.tests(tests)?;
        if self.passed.get() > before {
            Ok(())
        } else {
            Err(format!("no test is named {}", names.join(", ")).into())
        }
    }
}

/// Tests passed and failed in the closing line of a test runner: `test result: ok. 3 passed; 0 failed; …`.
fn counts(line: &str) -> [u64; 2] {
    let Some(rest) = line.strip_prefix("test result: ") else { return [0, 0] };
    ["passed", "failed"].map(|what| {
        let count = rest.split(what).next().and_then(|before| before.trim_end().rsplit(' ').next());
        count.and_then(|count| count.parse().ok()).unwrap_or(0)
    })
}

fn format(run: &Run<'_>) -> Result {
    let sh = run.sh;
    let folders = ALL.iter().map(|board| board.folder);
    for folder in [".", "firmware/nrf", "firmware/shared"].into_iter().chain(folders) {
        let _folder = sh.push_dir(folder);
        let problem = format!("{folder} is not formatted: `cargo fmt --all` there formats it");
        cmd!(sh, "cargo fmt --check").quiet().run().map_err(|_| problem)?;
    }
    Ok(())
}

fn clippy(run: &Run<'_>) -> Result {
    Ok(cmd!(run.sh, "cargo clippy --locked --workspace --all-targets -- -D warnings").run()?)
}

/// Of the whole workspace in one invocation: whatever is run later has the same features, and is not built again.
fn build(run: &Run<'_>) -> Result {
    Ok(cmd!(run.sh, "cargo build --locked --workspace --lib --bins --tests").run()?)
}

fn tests(run: &Run<'_>) -> Result {
    run.tests(cmd!(run.sh, "cargo test --locked --workspace --tests --no-fail-fast"))
}

/// A package for microcontrollers: its name and its features but `default` and `std`.
pub fn libraries(sh: &Shell) -> Result<Vec<(String, Vec<String>)>> {
    let metadata = cmd!(sh, "cargo metadata --no-deps --format-version 1").quiet().read()?;
    let metadata: Value = serde_json::from_str(&metadata)?;
    let mut libraries = Vec::new();
    for package in metadata["packages"].as_array().into_iter().flatten() {
        let text = |key: &str| package[key].as_str().unwrap_or_default();
        if text("manifest_path").contains("/crates/") {
            let features =
                package["features"].as_object().into_iter().flat_map(|features| features.keys());
            let features = features.filter(|name| !["default", "std"].contains(&name.as_str()));
            libraries.push((text("name").to_owned(), features.cloned().collect()));
        }
    }
    Ok(libraries)
}

fn embedded(run: &Run<'_>) -> Result {
    let sh = run.sh;
    let mut options = Vec::new();
    for (name, features) in libraries(sh)? {
        options.extend(["-p".to_owned(), name.clone()]);
        options.extend(features.iter().map(|feature| format!("--features={name}/{feature}")));
    }
    embedded_cargo(sh, "check").args(["--lib", "--target", TARGETS[0]]).args(options).run()?;
    QEMU.build(sh, &[])?;
    budget::check_qemu()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_closing_line_of_a_runner_is_counted_and_no_other() {
        assert_eq!(
            counts("test result: FAILED. 12 passed; 3 failed; 1 ignored; finished in 0.1s"),
            [12, 3]
        );
        assert_eq!(counts("thread panicked: 3 failed;"), [0, 0]);
    }

    #[test]
    fn a_file_of_ours_that_was_left_is_named() {
        let folder = tempfile::tempdir().unwrap();
        assert!(left_nothing(folder.path()).is_ok());
        std::fs::write(folder.path().join("wimu-left"), "").unwrap();
        assert!(left_nothing(folder.path()).unwrap_err().to_string().contains("wimu-left"));
    }
}
