//! The chores of this repository: `cargo xtask --help`.

mod boards;
mod budget;
mod campaign;
mod image;
mod instructions;
mod lanes;
mod lines;
mod panics;
mod pictures;
mod python;
mod release;
mod setup;
mod size;
mod validation;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use xshell::{Shell, cmd};

/// Anything that went wrong, with a text for the user.
type Error = Box<dyn std::error::Error>;
type Result<T = ()> = std::result::Result<T, Error>;

/// The chores of this repository
#[derive(Parser)]
#[command(name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Find or install what the tests need: as root or with CI=true it installs, otherwise it prints the commands
    Setup {
        /// Also what only the lane `release` needs
        #[arg(long)]
        release: bool,
    },
    /// Before each commit: format, clippy, tests with the fewest draws
    Check(Selection),
    /// Before a change is kept: what `.ci/run` runs
    Test(Selection),
    /// Before a release: everything that `test` leaves out
    Release(Selection),
    /// Count the lines of Rust outside and in tests, and of other languages
    Lines,
    /// Build every board; target/firmware gets the files for the boards' drives
    Firmware,
    /// Draw the wires of the boards: docs/pictures/wiring-*.svg
    Pictures,
    /// Build a board and write it, with `wimu device flash` and its options
    Flash {
        board: String,
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        options: Vec<String>,
    },
    /// Start the board in QEMU with a moving sensor and print its links; `qemu -- --help` lists the options
    Qemu {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        options: Vec<String>,
    },
    /// Print flash and RAM of the images by crate, instructions of a sample, bytes on the wire; fail past a limit
    Budget,
    /// Build the wheel of the Python module, install it in target/python and run all its tests
    Python,
    /// Run the fast tests of wimu-link and wimu-node under Miri
    Miri,
    /// Long statistics in release, written to docs/reference/validation; commands with fresh results are left out
    Campaign {
        name: String,
        #[arg(long, default_value_t = 0)]
        seed: u64,
    },
    /// Write docs/reference/validation.md from docs/reference/validation
    Validation,
}

#[derive(clap::Args)]
struct Selection {
    /// Only these steps
    #[arg(long, value_name = "STEP,…", value_delimiter = ',')]
    only: Vec<String>,
}

fn main() -> ExitCode {
    match run(Arguments::parse().task) {
        Ok(()) => ExitCode::SUCCESS,
        Err(problem) => {
            eprintln!("\nerror: {problem}");
            ExitCode::FAILURE
        }
    }
}

fn run(task: Task) -> Result {
    let sh = Shell::new()?;
    let root = cmd!(sh, "git rev-parse --show-toplevel").quiet().read()?;
    std::env::set_current_dir(&root)?;
    sh.change_dir(root);
    match task {
        Task::Setup { release } => setup::run(&sh, release),
        Task::Check(selection) => lanes::run(&sh, lanes::CHECK, &selection.only),
        Task::Test(selection) => lanes::run(&sh, lanes::TEST, &selection.only),
        Task::Release(selection) => lanes::run(&sh, release::RELEASE, &selection.only),
        Task::Lines => lines::run(&sh),
        Task::Firmware => boards::write_all(&sh),
        Task::Pictures => pictures::write(),
        Task::Flash { board, options } => boards::flash(&sh, &board, &options),
        Task::Qemu { options } => boards::qemu(&sh, &options),
        Task::Budget => budget::run(&sh),
        Task::Python => python::wheel(&sh),
        Task::Miri => release::miri(&sh),
        Task::Campaign { name, seed } => campaign::run(&sh, &name, seed),
        Task::Validation => validation::write(&sh),
    }
}

/// Prints the heading of a piece of work.
fn heading(text: &str) {
    println!("\n== {text}");
}

/// The folder that cargo builds into.
fn cargo_target() -> PathBuf {
    let folder = std::env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into());
    std::path::absolute(&folder).unwrap_or_else(|_| folder.into())
}
