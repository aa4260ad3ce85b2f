//! Results as text or JSON, and errors.

use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};

use serde::Serialize;
use terminal_size::terminal_size;
use wimu_host::finding::{Finding, labelled, text};
use wimu_host::{ErrorCode, HostError, Result};

/// Largest number of findings in a text without `--verbose`.
const MOST_FINDINGS: usize = 5;

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
        Self {
            json,
            verbose,
            content: false,
        }
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
        let text = text.as_ref();
        if self.json || self.content {
            let _ = writeln!(io::stderr(), "{text}");
        } else {
            note(writeln!(io::stdout(), "{text}"));
        }
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
        let most = if self.verbose {
            usize::MAX
        } else {
            MOST_FINDINGS
        };
        text(findings, most)
            .lines()
            .for_each(|line| self.print(line));
    }

    /// Width of the terminal on stdout, characters, without the last column: some terminals wrap after it.
    pub fn width() -> Option<usize> {
        let (width, _) = io::stdout().is_terminal().then(terminal_size)??;
        Some(usize::from(width.0).saturating_sub(1))
    }

    /// Prints a line that the next one replaces, on a terminal, cut to its width.
    pub fn refresh(self, text: &str) {
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
        self.object(&Answer {
            schema,
            status: "ok",
            found,
        });
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
        if self.json {
            self.object(error);
        }
        let _ = write!(io::stderr(), "{}", labelled("wimu: ", &error.into()));
    }
}
