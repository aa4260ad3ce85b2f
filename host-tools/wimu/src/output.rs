//! Results as text or JSON, and errors.

use std::borrow::Cow;
use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};

use ratatui::crossterm::terminal;
use serde::Serialize;
use wimu_host::finding::{Finding, labelled, text};
use wimu_host::{ErrorCode, HostError, Result};

use crate::progress;

/// Largest number of findings in a text without `--verbose`.
const MOST_FINDINGS: usize = 5;

/// Narrowest terminal for which text wraps between words, characters.
const LEAST_WIDTH: usize = 20;

/// Set when a write to stdout has failed.
static FAILED: AtomicBool = AtomicBool::new(false);

/// Records a failed write; returns whether the write succeeded.
fn note(outcome: io::Result<()>) -> bool {
    if let Err(error) = &outcome
        && error.kind() != io::ErrorKind::BrokenPipe
    {
        FAILED.store(true, Ordering::Relaxed);
    }
    outcome.is_ok()
}

/// The object of a command that succeeded.
#[derive(Serialize)]
struct Answer<'a, T> {
    schema: &'static str,
    status: &'static str,
    #[serde(flatten)]
    found: &'a T,
}

/// A `usage` error: what is wrong, and what to do.
pub fn usage(message: impl Into<String>, remedy: impl Into<String>) -> HostError {
    ErrorCode::Usage.error(message, remedy)
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

/// With `--json`, objects go to stdout and human text to stderr; without, human text to stdout.
#[derive(Clone, Copy)]
pub struct Output {
    json: bool,
    verbose: bool,
    /// Whether standard output is for the content of a file.
    content: bool,
}

impl Output {
    /// Output with or without `--json` and `--verbose`.
    pub fn new(json: bool, verbose: bool) -> Self {
        Self { json, verbose, content: false }
    }

    /// The same; with `content` standard output is for the content of a file, and human text goes to stderr.
    #[must_use]
    pub fn beside_content(self, content: bool) -> Self {
        Self { content, ..self }
    }

    /// Whether `--json` was given.
    pub fn is_json(self) -> bool {
        self.json
    }

    /// Prints human text.
    pub fn print(self, text: impl AsRef<str>) {
        self.line(text);
    }

    /// Prints human text. Returns false when the pipe is closed.
    pub fn line(self, text: impl AsRef<str>) -> bool {
        progress::clear();
        let text = wrapped(text.as_ref(), self.text_width());
        if self.json || self.content {
            let _ = writeln!(io::stderr(), "{text}");
            return true;
        }
        note(writeln!(io::stdout(), "{text}"))
    }

    /// Width at which human text wraps: that of the terminal that it goes to.
    fn text_width(self) -> Option<usize> {
        let is_terminal = match self.json || self.content {
            true => io::stderr().is_terminal(),
            false => io::stdout().is_terminal(),
        };
        let (width, _) = is_terminal.then(terminal::size)?.ok()?;
        Some(width.into()).filter(|width| *width >= LEAST_WIDTH)
    }

    /// Checks that everything was written.
    ///
    /// # Errors
    /// `file_failed` when a write to stdout failed. A closed pipe is no failure.
    pub fn finish() -> Result<()> {
        if FAILED.load(Ordering::Relaxed) {
            return Err(ErrorCode::FileFailed.error(
                "the output could not be written to stdout",
                "check where stdout goes, and that the disk has space",
            ));
        }
        Ok(())
    }

    /// Prints the most severe findings, with `--verbose` all.
    pub fn findings(self, findings: &[Finding]) {
        let most = if self.verbose { usize::MAX } else { MOST_FINDINGS };
        text(findings, most).lines().for_each(|line| self.print(line));
    }

    /// Width of the terminal on stdout, characters, without the last column: some terminals wrap after it.
    pub fn width() -> Option<usize> {
        let (width, _) = io::stdout().is_terminal().then(terminal::size)?.ok()?;
        Some(usize::from(width).saturating_sub(1))
    }

    /// Prints a line that the next one replaces, on a terminal, cut to its width.
    pub fn refresh(self, text: &str) {
        progress::clear();
        let mut stderr = io::stderr();
        if stderr.is_terminal() {
            let width = Self::width().unwrap_or(usize::MAX);
            let text: String = text.chars().take(width).collect();
            let _ = write!(stderr, "\r\x1b[2K{text}");
            let _ = stderr.flush();
        }
    }

    /// Clears the refreshed line.
    pub fn end_refresh(self) {
        self.refresh("");
    }

    /// Prints the object of a command that succeeded.
    pub fn answer(self, schema: &'static str, found: &impl Serialize) {
        self.object(&Answer { schema, status: "ok", found });
    }

    /// Prints one object on a line. Returns false when the pipe is closed.
    pub fn object(self, object: &impl Serialize) -> bool {
        if !self.json {
            return true;
        }
        let mut stdout = io::stdout().lock();
        note(
            serde_json::to_string(object)
                .map_err(io::Error::from)
                .and_then(|text| writeln!(stdout, "{text}"))
                .and_then(|()| stdout.flush()),
        )
    }

    /// Prints an error, with `--json` as an object too.
    pub fn failure(self, error: &HostError) {
        progress::clear();
        if self.json {
            self.object(error);
        }
        let _ = write!(io::stderr(), "{}", labelled("wimu: ", &error.into()));
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
