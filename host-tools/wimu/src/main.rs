//! `wimu`: the command-line tool. Arguments and printing are here, all work is in the libraries.

mod arguments;
mod command;
mod output;

use std::process::ExitCode;

use clap::Parser;
use clap::error::ErrorKind;
use wimu_host::{ErrorCode, HostError, Result};

use crate::arguments::{Arguments, Command};
use crate::output::Output;

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => return wrong_usage(&error),
    };
    let output = Output::new(arguments.json);
    match run(arguments.command, output).and_then(|code| Output::finish().map(|()| code)) {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            output.failure(&error);
            ExitCode::from(error.exit_code())
        }
    }
}

/// Returns the exit code of a command that has done what it could.
fn run(command: Command, output: Output) -> Result<u8> {
    match command {
        Command::Align(arguments) => return command::align::run(&arguments, output),
        Command::Allan(arguments) => return command::allan::run(&arguments, output),
        Command::Calibrate(arguments) => return command::calibrate::run(&arguments, output),
        Command::Demo(arguments) => command::demo::run(&arguments, output),
        Command::Simulate(arguments) => command::simulate::run(&arguments, output),
        Command::Ports(arguments) => command::ports::run(&arguments, output),
        Command::Monitor(arguments) => command::monitor::run(&arguments, output),
        Command::Record(arguments) => command::record::run(&arguments, output),
        Command::Info(arguments) => command::info::run(&arguments, output),
        Command::Compare(arguments) => command::compare::run(&arguments, output),
        Command::Flash(arguments) => command::flash::run(&arguments, output),
        Command::Export(arguments) => command::export::run(&arguments, output),
        Command::Params { action } => command::params::run(&action, output),
        Command::Key { action } => command::key::run(&action, output),
        Command::Settings { action } => command::settings::run(&action, output),
        Command::Navigate(arguments) => command::navigate::run(&arguments, output),
    }
    .map(|()| 0)
}

/// Help and version are no failure; wrong usage is, and `--json` wants it as an object.
fn wrong_usage(error: &clap::Error) -> ExitCode {
    let asked_for_help = matches!(
        error.kind(),
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion
    );
    if !asked_for_help && std::env::args().any(|argument| argument == "--json") {
        // What clap says up to its own advice, in one line.
        let text = error.to_string();
        let told: Vec<&str> = text
            .lines()
            .take_while(|line| !line.starts_with("Usage:"))
            .map(str::trim)
            .filter(|line| !line.is_empty())
            .collect();
        let message = told.join(" ").trim_start_matches("error: ").to_owned();
        let failure = HostError::new(ErrorCode::Usage, message, "see `wimu --help`");
        Output::new(true).failure(&failure);
    } else {
        let _ = error.print();
    }
    ExitCode::from(if asked_for_help { 0 } else { 2 })
}
