//! `wimu`: the command-line tool; see the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    wimu::run(std::env::args_os().skip(1), &mut wimu::Output::process())
}
