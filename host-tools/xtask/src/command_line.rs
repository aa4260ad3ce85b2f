//! Commands that are shown as they run, so that each can be run again by hand.

use std::fmt;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Whether this is a continuous-integration machine.
pub fn is_ci() -> bool {
    std::env::var("CI").is_ok_and(|value| value == "true")
}

/// A program, its arguments, where it runs, and what its environment has beyond ours.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CommandLine {
    environment: Vec<(String, String)>,
    words: Vec<String>,
    folder: Option<PathBuf>,
}

impl CommandLine {
    /// The words of `line`, separated by spaces; the first is the program.
    pub fn new(line: &str) -> Self {
        Self::default().words(line)
    }

    /// Appends the words of `line`.
    pub fn words(mut self, line: &str) -> Self {
        self.words.extend(line.split_whitespace().map(str::to_owned));
        self
    }

    /// Appends one word, spaces included.
    pub fn word(mut self, word: &str) -> Self {
        self.words.push(word.to_owned());
        self
    }

    /// Sets an environment variable.
    pub fn with(mut self, name: &str, value: &str) -> Self {
        self.environment.push((name.to_owned(), value.to_owned()));
        self
    }

    /// Runs it in `folder`.
    pub fn inside(mut self, folder: &Path) -> Self {
        self.folder = Some(folder.to_owned());
        self
    }

    /// Runs it in view.
    ///
    /// # Errors
    /// Says which command failed when it cannot be started or does not succeed.
    pub fn run(&self) -> Result<(), String> {
        println!("$ {self}");
        match self.command().stdin(Stdio::null()).status() {
            Ok(status) if status.success() => Ok(()),
            Ok(status) => Err(format!("`{self}` failed ({status})")),
            Err(problem) => Err(format!("`{self}` cannot be started: {problem}")),
        }
    }

    /// Goes on as this program, in view, so that signals reach it and its exit code is ours; returns
    /// only if it cannot be started.
    #[cfg(unix)]
    pub fn become_it(&self) -> String {
        println!("$ {self}");
        let problem = std::os::unix::process::CommandExt::exec(&mut self.command());
        format!("`{self}` cannot be started: {problem}")
    }

    /// Runs it out of sight: what it put out, if it succeeded.
    pub fn output(&self) -> Option<String> {
        let output = self.command().stdin(Stdio::null()).output().ok()?;
        let text = String::from_utf8(output.stdout).ok()?;
        output.status.success().then_some(text)
    }

    fn command(&self) -> Command {
        let (program, arguments) = self.words.split_first().expect("a program");
        let mut command = Command::new(program);
        command
            .args(arguments)
            .env("CARGO_TERM_COLOR", if colour() { "always" } else { "never" })
            .envs(self.environment.iter().map(|(name, value)| (name, value)));
        if let Some(folder) = &self.folder {
            command.current_dir(folder);
        }
        command
    }
}

impl fmt::Display for CommandLine {
    /// As a shell would take it.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(folder) = &self.folder {
            write!(out, "(cd {} && ", quoted(&folder.display().to_string()))?;
        }
        for (name, value) in &self.environment {
            write!(out, "{name}={} ", quoted(value))?;
        }
        let words: Vec<String> = self.words.iter().map(|word| quoted(word)).collect();
        out.write_str(&words.join(" "))?;
        out.write_str(if self.folder.is_some() { ")" } else { "" })
    }
}

fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_=+.,:/@".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

/// Prints the heading of a piece of work.
pub fn heading(text: &str) {
    if colour() {
        println!("\n\x1b[1m== {text}\x1b[0m");
    } else {
        println!("\n== {text}");
    }
}

/// One decision for us and for everything that we start.
fn colour() -> bool {
    match std::env::var("CARGO_TERM_COLOR").as_deref() {
        Ok("always") => true,
        Ok("never") => false,
        _ => std::env::var_os("NO_COLOR").is_none() && std::io::stdout().is_terminal(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_shown_as_a_shell_takes_it() {
        let line = CommandLine::new("cargo doc --no-deps")
            .word("it's here")
            .with("RUSTDOCFLAGS", "-D warnings");
        assert_eq!(
            line.to_string(),
            r"RUSTDOCFLAGS='-D warnings' cargo doc --no-deps 'it'\''s here'"
        );
    }

    #[test]
    fn a_command_in_a_folder_is_shown_with_it() {
        let line = CommandLine::new("cargo build").inside(Path::new("firmware/a board"));
        assert_eq!(line.to_string(), "(cd 'firmware/a board' && cargo build)");
    }

    #[test]
    fn a_failure_names_the_command() {
        let missing = CommandLine::new("no-such-program-at-all --flag");
        assert_eq!(missing.output(), None);
        let problem = missing.run().expect_err("it does not exist");
        assert!(problem.contains("no-such-program-at-all --flag"), "{problem}");
    }
}
