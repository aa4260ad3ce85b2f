//! Rows of text that are redrawn in place at a terminal, with plain ANSI sequences, so that it works over SSH. Elsewhere
//! commands print lines.

use std::io::IsTerminal;
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};

use wimu_host::untrusted::printable;

use crate::output::{Output, terminal_size, wrapped};
use crate::progress;

/// Interval between two drawings. Chosen: text is read, not watched.
const DRAW_EVERY: Duration = Duration::from_millis(100);

/// A terminal whose screen belongs to one view. Dropping it shows what was there before.
pub struct TextView<'a> {
    output: &'a Output,
    drawn: Option<Instant>,
}

impl<'a> TextView<'a> {
    /// Takes the terminal over; `None` where no person sits at one.
    pub fn open(output: &'a Output) -> Option<Self> {
        let is_dumb = std::env::var_os("TERM").is_some_and(|term| term == "dumb");
        if is_dumb || output.is_json() || !output.is_terminal() || !std::io::stdin().is_terminal() {
            return None;
        }
        progress::hide(true);
        // The alternate screen.
        output.write(b"\x1b[?1049h").then_some(Self { output, drawn: None })
    }

    /// Draws rows if it is time for it. Returns false once the terminal is gone.
    pub fn draw(&mut self, rows: impl FnOnce() -> Vec<String>) -> bool {
        if self.drawn.is_some_and(|drawn| drawn.elapsed() < DRAW_EVERY) {
            return true;
        }
        self.drawn = Some(Instant::now());
        let (columns, lines) = terminal_size().unwrap_or((80, 24));
        let rows = rows().iter().map(|row| printable(row)).collect::<Vec<_>>().join("\n");
        // Some terminals wrap after the last column.
        let width = columns.saturating_sub(1);
        let height = lines.saturating_sub(1);
        // Long rows go on in the next one where all fit, else they are cut.
        let whole = wrapped(&rows, Some(width));
        let shown = if whole.lines().count() <= height { &*whole } else { &*rows };
        let mut text = "\x1b[H".to_owned();
        for row in shown.lines().take(height) {
            text.extend(row.chars().take(width));
            text += "\x1b[K\r\n";
        }
        self.output.write((text + "\x1b[J").as_bytes())
    }

    /// Rings the terminal's bell.
    pub fn bell(&self) {
        self.output.write(b"\x07");
    }
}

impl Drop for TextView<'_> {
    fn drop(&mut self) {
        self.output.write(b"\x1b[?1049l");
        progress::hide(false);
    }
}

/// The lines that a person types; none where stdin is no terminal.
pub fn typed() -> Receiver<String> {
    let (sender, receiver) = mpsc::channel();
    if std::io::stdin().is_terminal() {
        std::thread::spawn(move || {
            for line in std::io::stdin().lines().map_while(Result::ok) {
                if sender.send(line.trim().to_lowercase()).is_err() {
                    return;
                }
            }
        });
    }
    receiver
}
