//! `wimu`: the command-line tool. Arguments and printing are here, all work is in the libraries.

mod arguments;
mod command;
mod output;
mod progress;
mod screen;

use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, FromArgMatches};
use wimu_host::Result;

use crate::arguments::{Arguments, Command};
use crate::output::{Output, usage};

fn main() -> ExitCode {
    let parsed = Arguments::command().try_get_matches().and_then(|matches| {
        let arguments = Arguments::from_arg_matches(&matches)?;
        Ok((arguments, matches))
    });
    let (mut arguments, matches) = match parsed {
        Ok(parsed) => parsed,
        Err(error) => return wrong_usage(&error),
    };
    let to_stdout = Arguments::writes_standard_output(&matches);
    let output = Output::new(arguments.json, arguments.verbose).beside_content(to_stdout);
    if !arguments.json {
        progress::show();
    }
    let done = arguments::check(&matches)
        .and_then(|()| match arguments.json && to_stdout {
            true => {
                Err(usage("--json and `-o -` both need standard output", "name a file with -o"))
            }
            false => arguments.take_standard_input(),
        })
        .and_then(|_input| run(arguments.command, output));
    progress::clear();
    match done.and_then(|code| Output::finish().map(|()| code)) {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            output.failure(&error);
            ExitCode::from(error.exit_code())
        }
    }
}

/// Runs a command; returns its exit code.
fn run(command: Command, output: Output) -> Result<u8> {
    match command {
        Command::Align(arguments) => return command::align::run(&arguments, output),
        Command::Allan(arguments) => return command::allan::run(&arguments, output),
        Command::Calibrate(arguments) => return command::calibrate::run(&arguments, output),
        Command::Apply(arguments) => command::apply::run(&arguments, output),
        Command::Demo(arguments) => command::demo::run(&arguments, output),
        Command::Simulate(arguments) => command::simulate::run(&arguments, output),
        Command::Ports(arguments) => command::ports::run(&arguments, output),
        Command::Monitor(arguments) => command::monitor::run(&arguments, output),
        Command::Dashboard(arguments) => command::dashboard::run(&arguments, output),
        Command::Record(arguments) => command::record::run(&arguments, output),
        Command::Info(arguments) => command::info::run(&arguments, output),
        Command::Compare(arguments) => command::compare::run(&arguments, output),
        Command::Flash(arguments) => command::flash::run(&arguments, output),
        Command::Export(arguments) => command::export::run(&arguments, output),
        Command::Params { action } => command::params::run(&action, output),
        Command::Key(arguments) => command::key::run(&arguments, output),
        Command::Settings { action } => command::settings::run(&action, output),
        Command::ReportBug(arguments) => command::report_bug::run(&arguments, output),
        Command::Gateway(arguments) => command::gateway::run(&arguments, output),
        Command::Fleet { action } => command::fleet::run(&action, output),
        Command::Completions(arguments) => command::manual::completions(&arguments),
        Command::Man(arguments) => command::manual::man(&arguments, output),
        Command::Navigate(arguments) => command::navigate::run(&arguments, output),
    }
    .map(|()| 0)
}

/// Prints help, version or a usage error of clap; with `--json` an error is an object.
fn wrong_usage(error: &clap::Error) -> ExitCode {
    let asked_for_help = matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion);
    if !asked_for_help && std::env::args().any(|argument| argument == "--json") {
        let text = error.to_string();
        let lines = text.lines().map(str::trim);
        let message: Vec<&str> = lines
            .take_while(|line| !line.starts_with("Usage:") && !line.starts_with("For more"))
            .filter(|line| !line.is_empty())
            .collect();
        let message = message.join(" ").trim_start_matches("error: ").to_owned();
        let command = Arguments::command();
        let named =
            std::env::args().skip(1).find(|argument| command.find_subcommand(argument).is_some());
        let help = match named {
            Some(name) => format!("see `wimu {name} --help`"),
            None => "see `wimu --help`".to_owned(),
        };
        Output::new(true, false).failure(&usage(message, help));
    } else {
        let _ = error.print();
    }
    ExitCode::from(if asked_for_help { 0 } else { 2 })
}
