//! Results as text or JSON, and errors.

use std::borrow::Cow;
use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use serde::Serialize;
use serde_json::Value;
use wimu_host::problem::{labelled, text};
use wimu_host::untrusted::{self, is_active, printable};
use wimu_host::{Code, Problem, Result};

use crate::progress;

/// Largest number of findings in a text without `--verbose`.
const MOST_FINDINGS: usize = 5;

/// Narrowest terminal for which text wraps between words, characters.
const LEAST_WIDTH: usize = 20;

/// Version of the objects of `--json`.
const SCHEMA: &str = "wimu/1";

/// One object of `--json`.
#[derive(Serialize)]
struct Envelope<'a, T> {
    schema: &'static str,
    command: &'a str,
    data: Option<&'a T>,
    problems: Vec<Value>,
}

/// A `usage` error: what is wrong, and what to do.
pub fn usage(message: impl Into<String>, remedy: impl Into<String>) -> Problem {
    Code::Usage.error(message, remedy)
}

/// Columns and rows of the terminal; `None` without one.
pub fn terminal_size() -> Option<(usize, usize)> {
    let (width, height) = terminal_size::terminal_size()?;
    Some((width.0.into(), height.0.into()))
}

/// Text whose longer lines are broken between words; what follows is indented as the line and two more.
pub fn wrapped(text: &str, width: Option<usize>) -> Cow<'_, str> {
    let Some(width) = width.filter(|width| text.lines().any(|line| line.chars().count() > *width))
    else {
        return text.into();
    };
    let mut out = Vec::new();
    for line in text.lines() {
        let indent = line.len() - line.trim_start().len();
        let (mut row, mut length) = (String::new(), 0);
        for word in line.split_inclusive(' ') {
            let visible = word.trim_end().chars().count();
            if length > indent + 2 && length + visible > width {
                out.push(std::mem::take(&mut row).trim_end().to_owned());
                row = " ".repeat((indent + 2).min(width / 2));
                length = row.len();
            }
            row += word;
            length += word.chars().count();
        }
        out.push(row);
    }
    out.join("\n").into()
}

/// Text of several lines, without anything else that a terminal acts on.
fn lines_of(text: &str) -> Cow<'_, str> {
    untrusted::escaped(text, |c| c != '\n' && is_active(c), |c| c.escape_default().to_string())
}

/// What a command puts out: its result, its problems, and where both go.
///
/// Human text goes to stdout. With `--json` it goes to stderr, and stdout gets one object
/// `{schema: "wimu/1", command, data, problems}`, of streaming commands one object a line. `data` is `null` after a
/// failure. Each problem is `{code, severity, place, text, remedy}`: what the human text says, in the same order.
pub struct Output {
    json: bool,
    verbose: bool,
    /// Whether standard output is for the content of a file.
    content: bool,
    command: String,
    /// Whether it writes to stdout and stderr of this process, which may be terminals.
    is_process: bool,
    writers: Mutex<Writers>,
    /// Reported since the last object.
    problems: Mutex<Vec<Value>>,
    /// Whether a write to stdout has failed.
    failed: AtomicBool,
}

struct Writers {
    stdout: Box<dyn Write + Send>,
    stderr: Box<dyn Write + Send>,
}

impl Output {
    /// Writes to stdout and stderr of this process.
    pub fn process() -> Self {
        Self { is_process: true, ..Self::to(io::stdout(), io::stderr()) }
    }

    /// Writes to `stdout` and `stderr`, neither of them a terminal.
    pub fn to(stdout: impl Write + Send + 'static, stderr: impl Write + Send + 'static) -> Self {
        Self {
            json: false,
            verbose: false,
            content: false,
            command: String::new(),
            is_process: false,
            writers: Mutex::new(Writers { stdout: Box::new(stdout), stderr: Box::new(stderr) }),
            problems: Mutex::default(),
            failed: AtomicBool::new(false),
        }
    }

    /// Begins the output of a command. With `content` standard output is for the content of a file, and human text goes
    /// to stderr.
    pub(crate) fn begin(&mut self, command: &str, json: bool, verbose: bool, content: bool) {
        (self.json, self.verbose, self.content) = (json, verbose, content);
        command.clone_into(&mut self.command);
        if !json && self.is_process {
            progress::show();
        }
    }

    /// Whether `--json` was given.
    pub(crate) fn is_json(&self) -> bool {
        self.json
    }

    /// Prints human text.
    pub(crate) fn print(&self, text: impl AsRef<str>) {
        self.line(text);
    }

    /// Prints human text. Returns false when the pipe is closed.
    pub(crate) fn line(&self, text: impl AsRef<str>) -> bool {
        progress::clear();
        let text = lines_of(text.as_ref());
        let text = wrapped(&text, self.text_width());
        if self.text_to_stderr() {
            let _ = writeln!(self.writers().stderr, "{text}");
            return true;
        }
        self.write(format!("{text}\n").as_bytes())
    }

    /// Writes to stdout. Returns false when the pipe is closed.
    pub(crate) fn write(&self, bytes: &[u8]) -> bool {
        let mut writers = self.writers();
        let outcome = writers.stdout.write_all(bytes).and_then(|()| writers.stdout.flush());
        if let Err(error) = &outcome
            && error.kind() != io::ErrorKind::BrokenPipe
        {
            self.failed.store(true, Ordering::Relaxed);
        }
        outcome.is_ok()
    }

    /// Prints help, version or wrong usage as clap words it.
    pub(crate) fn help(&self, text: &clap::Error) {
        let plain = text.render().to_string();
        if text.use_stderr() {
            let _ = self.writers().stderr.write_all(lines_of(&plain).as_bytes());
        } else if self.is_process {
            let _ = text.print();
        } else {
            self.write(plain.as_bytes());
        }
    }

    fn writers(&self) -> MutexGuard<'_, Writers> {
        self.writers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn text_to_stderr(&self) -> bool {
        self.json || self.content
    }

    /// Width at which human text wraps: that of the terminal that it goes to.
    fn text_width(&self) -> Option<usize> {
        let is_terminal = if self.text_to_stderr() {
            io::stderr().is_terminal()
        } else {
            io::stdout().is_terminal()
        };
        let (width, _) = (self.is_process && is_terminal).then(terminal_size)??;
        Some(width).filter(|width| *width >= LEAST_WIDTH)
    }

    /// Checks that everything was written; prints the problems that were reported since the last object.
    ///
    /// # Errors
    /// `file_failed` when a write to stdout failed. A closed pipe is no failure.
    pub(crate) fn finish(&self) -> Result<()> {
        if self.failed.load(Ordering::Relaxed) {
            return Err(Code::FileFailed.error(
                "the output could not be written to stdout",
                "check where stdout goes, and that the disk has space",
            ));
        }
        let reported = self.problems.lock().unwrap_or_else(PoisonError::into_inner).len();
        if reported > 0 {
            self.envelope(None::<&()>);
        }
        Ok(())
    }

    /// Reports findings: as text the most severe, with `--verbose` all; in the next object all.
    pub(crate) fn findings(&self, findings: &[Problem]) {
        let most = if self.verbose { usize::MAX } else { MOST_FINDINGS };
        text(findings, most).lines().for_each(|line| self.print(line));
        findings.iter().for_each(|finding| self.problem(finding));
    }

    /// Adds a problem to the next object.
    fn problem(&self, problem: &impl Serialize) {
        if let Ok(value) = serde_json::to_value(problem) {
            self.problems.lock().unwrap_or_else(PoisonError::into_inner).push(value);
        }
    }

    /// Whether human text goes to a terminal, so that a line can be replaced by the next.
    pub(crate) fn is_terminal(&self) -> bool {
        self.is_process && io::stdout().is_terminal() && io::stderr().is_terminal()
    }

    /// Width of the terminal on stdout, characters, without the last column: some terminals wrap after it.
    pub(crate) fn width(&self) -> Option<usize> {
        let is_terminal = self.is_process && io::stdout().is_terminal();
        let (width, _) = is_terminal.then(terminal_size)??;
        Some(width.saturating_sub(1))
    }

    /// Prints a line that the next one replaces, on a terminal, cut to its width.
    pub(crate) fn refresh(&self, text: &str) {
        progress::clear();
        if self.is_process && io::stderr().is_terminal() {
            let text = printable(text);
            let text: String = text.chars().take(self.width().unwrap_or(usize::MAX)).collect();
            let stderr = &mut self.writers().stderr;
            let _ = write!(stderr, "\r\x1b[2K{text}");
            let _ = stderr.flush();
        }
    }

    /// Clears the refreshed line.
    pub(crate) fn end_refresh(&self) {
        self.refresh("");
    }

    /// Prints an object with `data` and the problems that were reported since the last one. Returns false when the pipe
    /// is closed.
    pub(crate) fn object(&self, data: &impl Serialize) -> bool {
        self.envelope(Some(data))
    }

    fn envelope(&self, data: Option<&impl Serialize>) -> bool {
        if !self.json {
            return true;
        }
        let mut reported = self.problems.lock().unwrap_or_else(PoisonError::into_inner);
        let problems = std::mem::take(&mut *reported);
        let envelope = Envelope { schema: SCHEMA, command: &self.command, data, problems };
        let Ok(text) = serde_json::to_string(&envelope) else {
            self.failed.store(true, Ordering::Relaxed);
            return false;
        };
        // What JSON does not escape itself is within strings.
        let escape = |c| format!("\\u{:04x}", u32::from(c));
        self.write(format!("{}\n", untrusted::escaped(&text, is_active, escape)).as_bytes())
    }

    /// Prints an error, with `--json` as an object too.
    pub(crate) fn failure(&self, error: &Problem) {
        progress::clear();
        self.problem(error);
        self.envelope(None::<&()>);
        let text = labelled("wimu: ", error);
        let _ = write!(self.writers().stderr, "{text}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_lines_break_between_words_and_keep_their_indent() {
        let text = "  one two three four five\nshort";
        assert_eq!(wrapped(text, None), text);
        assert_eq!(wrapped(text, Some(80)), text);
        let narrow = wrapped(text, Some(20));
        assert_eq!(narrow, "  one two three four\n    five\nshort");
        let micro = "µµµµ ".repeat(10);
        assert!(wrapped(&micro, Some(20)).lines().all(|line| line.chars().count() <= 20));
        // A word longer than the line stays whole.
        assert_eq!(wrapped(&"x".repeat(30), Some(20)), "x".repeat(30));
    }
}
