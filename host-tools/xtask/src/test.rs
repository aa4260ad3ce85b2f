//! Everything that must hold before a change is kept.

use std::time::{Duration, Instant};

use crate::command_line::{CommandLine, heading};
use crate::firmware;
use crate::instructions;
use crate::panics;
use crate::profile;
use crate::python;
use crate::setup::{self, Need, OLDEST, Source, TARGETS, ThisMachine, cargo, embedded_cargo};
use crate::size;
use crate::workspace::{Package, Target, Workspace};

/// One thing that must hold.
pub struct Step {
    pub name: &'static str,
    pub about: &'static str,
    run: fn(&Workspace) -> Result<(), String>,
}

/// Steps that are run together, the cheaper first: a run stops at the first that fails.
pub struct Lane {
    pub name: &'static str,
    pub steps: &'static [Step],
}

/// What is run before each commit.
pub const CHECK: Lane = Lane {
    name: "check",
    steps: &[
        Step { name: "format", about: "the source is formatted", run: |_| formatted() },
        Step {
            name: "clippy",
            about: "no warning: every target of every package of the workspace",
            run: |_| workspace_clippy().run(),
        },
        Step {
            name: "embedded",
            about: "libraries compile for Cortex-M4F",
            run: |workspace| {
                let source = setup::provide(Need::Targets, &mut ThisMachine)?;
                all(embedded(workspace, source, &TARGETS[..1]))
            },
        },
        Step {
            name: "host",
            about: "the tests on this machine, statistics with 20 draws, without documentation",
            run: |_| {
                without_c_libraries("test")
                    .words(RUST_ONLY)
                    .words("--lib --bins --test all")
                    .with("WIMU_LANE", "check")
                    .run()
            },
        },
    ],
};

/// Everything that must hold before a change is kept.
pub const TEST: Lane = Lane {
    name: "test",
    steps: &[
        Step {
            name: "setup",
            about: "rustfmt, clippy, the microcontroller targets, the emulators and Python are installed",
            run: |_| setup::run(),
        },
        Step {
            name: "format",
            about: "the source is formatted",
            run: |workspace| {
                formatted()?;
                all(firmware::format(workspace))
                    .map_err(|problem| format!("{problem}; `cargo fmt --all` there formats it"))
            },
        },
        Step {
            name: "clippy",
            about: "no warning: every target of every package, and the libraries with all features",
            run: |workspace| all(clippy(workspace)),
        },
        Step {
            name: "oldest",
            about: concat!(
                "everything compiles with Rust ",
                env!("CARGO_PKG_RUST_VERSION"),
                ", if rustup has it or can install it"
            ),
            run: |_| match setup::provide(Need::Oldest, &mut ThisMachine) {
                Ok(_) => oldest().run(),
                Err(why) => {
                    println!("skipped: {why}");
                    Ok(())
                }
            },
        },
        Step {
            name: "doc",
            about: "the libraries' documentation builds without a warning",
            run: |workspace| doc(workspace).run(),
        },
        Step {
            name: "embedded",
            about: "libraries compile and bare-metal programs build for Cortex-M4F and Cortex-M0+",
            run: |workspace| {
                let source = setup::provide(Need::Targets, &mut ThisMachine)?;
                all(embedded(workspace, source, &TARGETS))
            },
        },
        Step {
            name: "features",
            about: "wimu-node compiles without a warning with every choice of its features, and works with none",
            run: |_| {
                cargo("test -p wimu-node --test sampler").run()?;
                all(choices_of_features())
            },
        },
        Step {
            name: "panics",
            about: "no function of the libraries for the device can panic, on Cortex-M4F and Cortex-M0+",
            run: |_| panics::run(),
        },
        Step {
            name: "firmware",
            about: "every board builds, without a warning, and no larger than it may be",
            run: |workspace| firmware::check(workspace).and_then(|()| size::check(workspace)),
        },
        Step {
            name: "budget",
            about: "profiles are no larger, and a sample costs no more instructions in QEMU, than they may",
            run: |_| profile::run().and_then(|()| instructions::run()),
        },
        Step {
            name: "host",
            about: "all tests on this machine, examples in the documentation included, without C libraries",
            run: |_| without_c_libraries("test").words(RUST_ONLY).run(),
        },
        Step {
            name: "qemu",
            about: "the firmware does the main job on an emulated Cortex-M4F, bit for bit",
            run: |_| firmware::test(),
        },
        Step {
            name: "pico",
            about: "the Pico's firmware works on an emulated RP2040 with an ADXL345, both links at 115,200 baud",
            run: firmware::pico,
        },
        Step {
            name: "standalone",
            about: "`wimu` compiles by itself, and with what writes boards through probes, without C libraries",
            run: |_| {
                let commands = ["check -p wimu", "check -p wimu --features flash"];
                all(commands.map(without_c_libraries).into())
            },
        },
        Step {
            name: "optional",
            about: "the Python module calibrates as the command does; ROS 2 bags in sqlite are read; links over \
                    Bluetooth Low Energy work with a unit in memory",
            run: |_| {
                python::smoke()?;
                cargo("test -p wimu-host --features sqlite --lib")
                    .word("formats::ros::tests::a_bag_in_sqlite_is_read")
                    .run()?;
                match setup::provide(Need::Dbus, &mut ThisMachine) {
                    Ok(_) => all(bluetooth()),
                    Err(why) => {
                        println!("skipped: links over Bluetooth Low Energy: {why}");
                        Ok(())
                    }
                }
            },
        },
    ],
};

fn formatted() -> Result<(), String> {
    let check = CommandLine::new("cargo fmt --all --check");
    check.run().map_err(|problem| format!("{problem}; `cargo fmt --all` formats it"))
}

/// Runs the steps of `lane` named in `only`, or all, and prints how long each took.
///
/// # Errors
/// Says what failed and how to run just that again.
pub fn run(workspace: &Workspace, lane: &Lane, only: &[String]) -> Result<(), String> {
    let mut done = Vec::new();
    let mut outcome = Ok(());
    let wanted = |step: &&Step| only.is_empty() || only.iter().any(|name| name == step.name);
    for step in lane.steps.iter().filter(wanted) {
        heading(&format!("{}: {}", step.name, step.about));
        let start = Instant::now();
        outcome = (step.run)(workspace).map_err(|problem| {
            let (lane, name) = (lane.name, step.name);
            format!("{name}: {problem}\njust this step again: cargo xtask {lane} --only {name}")
        });
        let took = start.elapsed();
        println!("{}: {:.1} s", step.name, took.as_secs_f64());
        done.push((step.name, took, outcome.is_ok()));
        if outcome.is_err() {
            break;
        }
    }
    heading("summary");
    print!("{}", table(&done));
    if let Ok(load) = std::fs::read_to_string("/proc/loadavg") {
        let cores = std::thread::available_parallelism().map_or(0, usize::from);
        let load: Vec<_> = load.split(' ').take(3).collect();
        println!("load over 1, 5, 15 min: {}; {cores} cores", load.join(", "));
    }
    outcome
}

fn table(done: &[(&str, Duration, bool)]) -> String {
    let row = |name: &str, took: Duration, remark: &str| {
        format!("{name:<11}{:>8.1} s{remark}\n", took.as_secs_f64())
    };
    let total = done.iter().map(|(_, took, _)| *took).sum();
    done.iter()
        .map(|&(name, took, passed)| row(name, took, if passed { "" } else { "  FAILED" }))
        .chain([row("total", total, "")])
        .collect()
}

fn all(commands: Vec<CommandLine>) -> Result<(), String> {
    commands.iter().try_for_each(CommandLine::run)
}

/// Packages whose tests need Rust alone.
pub const RUST_ONLY: &str = "--workspace --exclude wimu-python";
const DENY: &str = "--all-targets -- -D warnings";

fn workspace_clippy() -> CommandLine {
    cargo("clippy --workspace").words(DENY)
}

fn clippy(workspace: &Workspace) -> Vec<CommandLine> {
    let featured = workspace.below("crates").filter(|p| !p.features.is_empty());
    let featured = selecting(cargo("clippy --all-features"), featured).words(DENY);
    vec![workspace_clippy(), featured]
}

fn oldest() -> CommandLine {
    CommandLine::new("rustup run").word(OLDEST).words("cargo check --workspace --locked")
}

/// The links over Bluetooth Low Energy, and `wimu` with them.
fn bluetooth() -> Vec<CommandLine> {
    let tests = cargo("test -p wimu-host --features ble --lib").words("-- transport:: link_url::");
    let lint = cargo("clippy -p wimu -p wimu-host --features wimu/ble,wimu-host/ble");
    vec![tests, lint.words(DENY)]
}

fn doc(workspace: &Workspace) -> CommandLine {
    selecting(cargo("doc --no-deps --all-features"), workspace.below("crates"))
        .with("RUSTDOCFLAGS", "-D warnings")
}

/// As on a machine where no C library is found.
fn without_c_libraries(command: &str) -> CommandLine {
    cargo(command).with("PKG_CONFIG", "false")
}

/// wimu-node with every choice of its features; those that a feature brings with it are not chosen beside it.
fn choices_of_features() -> Vec<CommandLine> {
    const ALTERNATIVES: [&[&str]; 4] = [
        &["", "correction", "navigation", "heading", "self-check", "heading,self-check"],
        &["", "store", "auth"],
        &["", "line-rates"],
        &["", "wireless"],
    ];
    let mut choices = vec![String::new()];
    for alternatives in ALTERNATIVES {
        let with = |choice: &String| {
            alternatives.iter().map(move |one| format!("{choice},{one}")).collect()
        };
        choices = choices.iter().flat_map(|choice| -> Vec<String> { with(choice) }).collect();
    }
    let one = |choice: String| {
        let choice: Vec<_> = choice.split(',').filter(|name| !name.is_empty()).collect();
        cargo(&format!("clippy --quiet -p wimu-node --features={}", choice.join(",")))
            .words("-- -D warnings")
    };
    choices.into_iter().map(one).collect()
}

/// Each package by itself: built together, one could lean on features that another asks for.
fn embedded(workspace: &Workspace, source: Source, targets: &[&str]) -> Vec<CommandLine> {
    let mut commands = Vec::new();
    for package in workspace.below("crates").chain(workspace.below("examples")) {
        let bare_metal = |target: &&Target| target.kind == "bin" && target.no_std;
        let programs: Vec<_> = package.targets.iter().filter(bare_metal).collect();
        // Code for libraries is made with the programs and boards that use them.
        let verb = if programs.is_empty() { "check" } else { "build" };
        let mut plain = targets
            .iter()
            .fold(embedded_cargo(source, verb), |cargo, target| cargo.word("--target").word(target))
            .words(&format!("-p {} --lib", package.name));
        for program in programs {
            plain = plain.word("--bin").word(&program.name);
        }
        commands.push(plain.clone());
        // A microcontroller has all but the standard library.
        let features: Vec<&str> =
            package.features.iter().map(String::as_str).filter(|f| *f != "std").collect();
        if !features.is_empty() {
            commands.push(plain.word("--features").word(&features.join(",")));
        }
    }
    commands
}

fn selecting<'a>(cargo: CommandLine, packages: impl Iterator<Item = &'a Package>) -> CommandLine {
    packages.fold(cargo, |cargo, package| cargo.word("-p").word(&package.name))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn package(folder: &str, features: &[&str], targets: &[(&str, bool)]) -> Package {
        Package {
            name: folder.rsplit('/').next().unwrap_or(folder).into(),
            folder: folder.into(),
            features: features.iter().map(|&f| f.into()).collect(),
            targets: targets
                .iter()
                .map(|&(kind, no_std)| Target {
                    name: format!("a-{kind}"),
                    kind: kind.into(),
                    no_std,
                })
                .collect(),
        }
    }

    fn workspace() -> Workspace {
        Workspace {
            packages: vec![
                package("crates/plain", &[], &[("lib", true)]),
                package("crates/rich", &["defmt", "serde", "std"], &[("lib", true)]),
                package("examples/loop", &[], &[("lib", true), ("bin", true)]),
                package("examples/desk", &[], &[("lib", true), ("bin", false)]),
                package("host-tools/tool", &["serde"], &[("bin", false)]),
            ],
            firmware: vec!["firmware/board".into()],
        }
    }

    fn tails(commands: Vec<CommandLine>) -> Vec<String> {
        let tail = |line: String| line.split_once(" -p ").expect("a package").1.to_owned();
        commands.iter().map(|c| tail(c.to_string())).collect()
    }

    #[test]
    fn microcontroller_builds_take_each_package_alone_plain_and_with_all_features_but_std() {
        assert_eq!(
            tails(embedded(&workspace(), Source::Toolchain, &TARGETS)),
            [
                "plain --lib",
                "rich --lib",
                "rich --lib --features defmt,serde",
                "loop --lib --bin a-bin",
                "desk --lib",
            ]
        );
    }

    #[test]
    fn every_choice_of_features_is_compiled_once() {
        let mut lines = tails(choices_of_features());
        assert_eq!(lines.len(), 6 * 3 * 2 * 2);
        assert!(lines.contains(&"wimu-node --features= -- -D warnings".into()));
        assert!(
            lines.contains(
                &"wimu-node --features=heading,self-check,auth,line-rates,wireless -- -D warnings"
                    .into()
            )
        );
        lines.sort();
        lines.dedup();
        assert_eq!(lines.len(), 72);
    }

    #[test]
    fn only_libraries_with_features_are_linted_a_second_time() {
        let mut commands = clippy(&workspace());
        let everything = commands.remove(0).to_string();
        assert!(everything.contains("--workspace") && everything.contains("--all-targets"));
        assert_eq!(tails(commands), ["rich --all-targets -- -D warnings"]);
    }

    #[test]
    fn the_table_shows_what_failed_and_the_total() {
        let second = Duration::from_secs(1);
        assert_eq!(
            table(&[("format", second, true), ("clippy", second * 61, false)]),
            "format          1.0 s\nclippy         61.0 s  FAILED\ntotal          62.0 s\n"
        );
    }

    #[test]
    fn no_two_steps_share_a_name() {
        for Lane { steps, .. } in [CHECK, TEST] {
            for (i, step) in steps.iter().enumerate() {
                assert!(steps[..i].iter().all(|other| other.name != step.name));
            }
        }
    }
}
