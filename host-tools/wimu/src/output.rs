//! Where results and human text go.

use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};

use serde::Serialize;
use terminal_size::terminal_size;
use wimu_host::{ErrorCode, HostError, Result};

/// Whether something could not be written to stdout.
static FAILED: AtomicBool = AtomicBool::new(false);

/// Remembers a failed write; returns whether it was done.
fn note(outcome: io::Result<()>) -> bool {
    if let Err(error) = &outcome
        && error.kind() != io::ErrorKind::BrokenPipe
    {
        FAILED.store(true, Ordering::Relaxed);
    }
    outcome.is_ok()
}

/// With `--json`, objects go to stdout and human text to stderr; without, human text to stdout.
#[derive(Clone, Copy)]
pub struct Output {
    json: bool,
}

impl Output {
    /// For a command with or without `--json`.
    pub fn new(json: bool) -> Self {
        Self { json }
    }

    /// Whether objects are wanted.
    pub fn is_json(self) -> bool {
        self.json
    }

    /// Human text.
    pub fn say(self, text: impl AsRef<str>) {
        let text = text.as_ref();
        if self.json {
            let _ = writeln!(io::stderr(), "{text}");
        } else {
            note(writeln!(io::stdout(), "{text}"));
        }
    }

    /// Whether everything could be written.
    ///
    /// # Errors
    /// `file_failed` when stdout took less than all. Whoever closed the other end of a pipe has
    /// seen enough: that is no failure.
    pub fn finish() -> Result<()> {
        if FAILED.load(Ordering::Relaxed) {
            return Err(HostError::new(
                ErrorCode::FileFailed,
                "what was to be printed could not be written",
                "check where stdout goes, and that there is space",
            ));
        }
        Ok(())
    }

    /// Characters that a line holds where stdout is a terminal, but for the last column: behind it
    /// some begin a new line.
    pub fn width() -> Option<usize> {
        let (width, _) = io::stdout().is_terminal().then(terminal_size)??;
        Some(usize::from(width.0).saturating_sub(1))
    }

    /// A line that the next one replaces, on a terminal; what is beyond its width is left out.
    pub fn refresh(self, text: &str) {
        let mut stderr = io::stderr();
        if stderr.is_terminal() {
            let width = Self::width().unwrap_or(usize::MAX);
            let text: String = text.chars().take(width).collect();
            let _ = write!(stderr, "\r\x1b[2K{text}");
            let _ = stderr.flush();
        }
    }

    /// Ends a refreshed line.
    pub fn end_refresh(self) {
        self.refresh("");
    }

    /// One object on a line of its own. Returns false when nobody reads any more.
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

    /// A failure, in the form that was asked for.
    pub fn failure(self, error: &HostError) {
        if self.json {
            self.object(error);
        }
        let place = error
            .location()
            .map_or(String::new(), |place| format!("{place}: "));
        let _ = writeln!(io::stderr(), "wimu: {place}{}", error.message());
        let _ = writeln!(io::stderr(), "      {}", error.remedy());
    }
}
