//! `wimu completions` and `wimu man`.

use std::io;

use clap::CommandFactory;
use wimu_host::{Problem, Result};

use crate::arguments::{Arguments, Completions, Man};
use crate::output::Output;

/// Prints the completion script of a shell.
pub fn completions(arguments: &Completions, output: &Output) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut Arguments::command(), "wimu", &mut script);
    output.write(&script);
    Ok(())
}

/// Writes a manual page for each command.
pub fn man(arguments: &Man, output: &Output) -> Result<()> {
    let folder = &arguments.folder;
    let failed = |error: io::Error| Problem::file(&folder.display().to_string(), "write", &error);
    std::fs::create_dir_all(folder).map_err(failed)?;
    clap_mangen::generate_to(Arguments::command(), folder).map_err(failed)?;
    output.print(format!("wrote the pages to {}: man -l {0}/wimu.1", folder.display()));
    Ok(())
}
