//! The command `wimu` as a library: [`run`] takes the arguments of a command line and an [`Output`].
//!
//! ```
//! use std::process::ExitCode;
//! use wimu::{Output, run};
//!
//! let mut output = Output::to(std::io::sink(), std::io::sink());
//! assert_eq!(run(["info", "missing.csv", "--json"], &mut output), ExitCode::from(2));
//! ```
//!
//! Arguments and printing are here; all work is in the libraries.

mod arguments;
mod command;
mod output;
mod progress;
mod text_view;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, FromArgMatches};
use wimu_host::Result;
use wimu_host::untrusted::printable;

use crate::arguments::{Arguments, Command, Device};
use crate::output::usage;

pub use crate::output::Output;

/// Runs a command line, without the program's name.
///
/// Exit codes: 0 done, 1 failed, 2 wrong usage or unreadable input, 3 the data do not support an answer, 4 the device
/// refused. With `--json` stdout gets `{schema, command, data, problems}`; see [`Output`].
pub fn run(
    arguments: impl IntoIterator<Item = impl Into<OsString>>,
    output: &mut Output,
) -> ExitCode {
    let words: Vec<OsString> = arguments.into_iter().map(Into::into).collect();
    let line = std::iter::once(OsString::from("wimu")).chain(words.iter().cloned());
    let parsed = arguments::with_negative_numbers(Arguments::command()).try_get_matches_from(line);
    let parsed = parsed.and_then(|matches| {
        let arguments = Arguments::from_arg_matches(&matches)?;
        Ok((arguments, matches))
    });
    let (mut arguments, matches) = match parsed {
        Ok(parsed) => parsed,
        Err(error) => {
            // A line break in an argument is not one of the message.
            let shown = words.iter().map(|word| printable(&word.to_string_lossy()).into_owned());
            let again = arguments::with_negative_numbers(Arguments::command())
                .try_get_matches_from(std::iter::once("wimu".to_owned()).chain(shown));
            return wrong_usage(&again.err().unwrap_or(error), &words, output);
        }
    };
    let to_stdout = Arguments::writes_standard_output(&matches);
    output.begin(&command_name(&matches), arguments.json, arguments.verbose, to_stdout);
    let done = arguments
        .read_setup()
        .and_then(|()| arguments::check(&matches, &arguments.command))
        .and_then(|()| {
            if arguments.json && to_stdout {
                return Err(usage(
                    "--json and `-o -` both need standard output",
                    "name a file with -o",
                ));
            }
            arguments.take_standard_input()
        })
        .and_then(|_input| dispatch(arguments.command, output));
    progress::clear();
    match done.and_then(|code| output.finish().map(|()| code)) {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            output.failure(&error);
            ExitCode::from(error.exit_code())
        }
    }
}

/// Runs a command; returns its exit code.
fn dispatch(command: Command, output: &Output) -> Result<u8> {
    match command {
        Command::Align(arguments) => return command::align::run(&arguments, output),
        Command::Allan(arguments) => return command::allan::run(&arguments, output),
        Command::Calibrate(arguments) => return command::calibrate::run(&arguments, output),
        Command::Demo(arguments) => command::demo::run(&arguments, output),
        Command::Simulate(arguments) => command::simulate::run(&arguments, output),
        Command::Monitor(arguments) => command::monitor::run(&arguments, output),
        Command::Dashboard(arguments) => command::dashboard::run(&arguments, output),
        Command::Record(arguments) => command::record::run(&arguments, output),
        Command::Info(arguments) => command::info::run(&arguments, output),
        Command::Compare(arguments) => command::compare::run(&arguments, output),
        Command::Convert(arguments) => command::convert::run(&arguments, output),
        Command::Device { action } => device(&action, output),
        Command::Fleet { action } => command::fleet::run(&action, output),
        Command::Completions(arguments) => command::manual::completions(&arguments, output),
        Command::Man(arguments) => command::manual::man(&arguments, output),
        Command::Navigate(arguments) => command::navigate::run(&arguments, output),
    }
    .map(|()| 0)
}

fn device(action: &Device, output: &Output) -> Result<()> {
    match action {
        Device::Ports(arguments) => command::ports::run(arguments, output),
        Device::Info { link } => command::info::board(link, output),
        Device::Params { action } => command::params::run(action, output),
        Device::Settings { action } => command::settings::run(action, output),
        Device::Key(arguments) => command::key::run(arguments, output),
        Device::Flash(arguments) => command::flash::run(arguments, output),
        Device::ReportBug(arguments) => command::report_bug::run(arguments, output),
    }
}

/// The names of a command and of its actions, such as `device params push`.
fn command_name(mut matches: &clap::ArgMatches) -> String {
    let mut names = Vec::new();
    while let Some((name, inner)) = matches.subcommand() {
        names.push(name);
        matches = inner;
    }
    names.join(" ")
}

/// Prints help, version or a usage error of clap; with `--json` an error is an object.
fn wrong_usage(error: &clap::Error, words: &[OsString], output: &mut Output) -> ExitCode {
    if matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion) {
        output.help(error);
        return ExitCode::SUCCESS;
    }
    if !words.iter().any(|word| word == "--json") {
        output.help(error);
        return ExitCode::from(2);
    }
    let text = error.to_string();
    let lines = text.lines().map(str::trim);
    let message: Vec<&str> = lines
        .take_while(|line| !line.starts_with("Usage:") && !line.starts_with("For more"))
        .filter(|line| !line.is_empty())
        .collect();
    let message = message.join(" ").trim_start_matches("error: ").to_owned();
    let command = Arguments::command();
    let named = words
        .iter()
        .filter_map(|word| word.to_str())
        .find(|word| command.find_subcommand(word).is_some());
    let help = match named {
        Some(name) => format!("see `wimu {name} --help`"),
        None => "see `wimu --help`".to_owned(),
    };
    output.begin(named.unwrap_or_default(), true, false, false);
    output.failure(&usage(message, help));
    ExitCode::from(2)
}
