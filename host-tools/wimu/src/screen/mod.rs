//! Full screens in a terminal. A view is a state and a pure function that draws it into a frame.

mod ascii;
mod board;
pub mod calibrate;
pub mod monitor;
mod widgets;

use std::io::{self, IsTerminal, Stdout, Write};
use std::mem::ManuallyDrop;
use std::time::{Duration, Instant};

use ratatui::Terminal;
use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use ratatui::crossterm::terminal::size;
use ratatui::layout::Rect;
use ratatui::prelude::Frame;
use wimu_host::{Problem, Result};

use crate::output::Output;
use crate::progress;

/// Interval between two frames, 40 Hz. With data passed on every 20 ms, a sample is shown after at most 65 ms and the
/// time of drawing.
const FRAME: Duration = Duration::from_millis(25);
/// Smallest terminal of a full screen, columns and rows.
const LEAST: (u16, u16) = (80, 24);

/// A key that a person pressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Key {
    /// A character, in lower case.
    Char(char),
    Enter,
    Up,
    Down,
    /// Ctrl-C, Ctrl-D or Esc, or the terminal is gone.
    Quit,
}

/// The terminal as a screen. Dropping it, and a panic, restore the terminal.
pub struct Screen {
    /// Its own drop prints to stderr, and panics where that is a closed terminal.
    terminal: ManuallyDrop<Terminal<CrosstermBackend<Stdout>>>,
    ascii: bool,
    drawn: Option<Instant>,
}

impl Screen {
    /// Whether a person sits at a terminal that can show a screen and is large enough for it.
    pub fn is_possible(output: &Output) -> bool {
        let terminals = io::stdin().is_terminal() && io::stdout().is_terminal();
        terminals
            && !output.is_json()
            && std::env::var_os("TERM").is_none_or(|term| term != "dumb")
            && size().is_ok_and(|(width, height)| is_enough(width, height))
    }

    /// Takes the terminal over.
    ///
    /// # Errors
    /// `file_failed` when the terminal refuses it.
    pub fn open() -> Result<Self> {
        progress::hide(true);
        Ok(Self {
            terminal: ManuallyDrop::new(ratatui::try_init().map_err(|error| failed(&error))?),
            ascii: !ascii::is_utf8(|name| std::env::var(name).ok()),
            drawn: None,
        })
    }

    /// Draws a frame if one is due.
    ///
    /// # Errors
    /// `file_failed` when the terminal is gone.
    pub fn draw(&mut self, view: impl FnOnce(&mut Frame)) -> Result<()> {
        if self.drawn.is_some_and(|drawn| drawn.elapsed() < FRAME) {
            return Ok(());
        }
        self.drawn = Some(Instant::now());
        let ascii = self.ascii;
        let drawn = self.terminal.draw(|frame| paint(frame, ascii, view));
        drawn.map(drop).map_err(|error| failed(&error))
    }

    /// The next key that was pressed; `None` without one.
    pub fn key(&self) -> Option<Key> {
        // crossterm would read the end of the input for ever.
        if is_gone() {
            return Some(Key::Quit);
        }
        loop {
            match event::poll(Duration::ZERO) {
                Ok(false) => return None,
                Ok(true) => {}
                Err(_) => return Some(Key::Quit),
            }
            let Ok(event) = event::read() else {
                return Some(Key::Quit);
            };
            let Event::Key(key) = event else { continue };
            if key.kind == KeyEventKind::Release {
                continue;
            }
            let control = key.modifiers.contains(KeyModifiers::CONTROL);
            return Some(match key.code {
                KeyCode::Char('c' | 'd') if control => Key::Quit,
                KeyCode::Esc => Key::Quit,
                KeyCode::Char(c) => Key::Char(c.to_ascii_lowercase()),
                KeyCode::Enter => Key::Enter,
                KeyCode::Up => Key::Up,
                KeyCode::Down => Key::Down,
                _ => continue,
            });
        }
    }

    /// Rings the terminal's bell.
    pub fn bell(&self) {
        let mut stdout = io::stdout();
        let _ = stdout.write_all(b"\x07").and_then(|()| stdout.flush());
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _ = self.terminal.show_cursor();
        let _ = ratatui::try_restore();
        progress::hide(false);
    }
}

/// Whether the terminal was closed.
#[cfg(unix)]
fn is_gone() -> bool {
    use rustix::event::{PollFd, PollFlags, Timespec, poll};

    let stdin = io::stdin();
    let mut watched = [PollFd::new(&stdin, PollFlags::empty())];
    let polled = poll(&mut watched, Some(&Timespec::default()));
    let gone = PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL;
    polled.is_ok_and(|count| count > 0) && watched[0].revents().intersects(gone)
}

#[cfg(not(unix))]
fn is_gone() -> bool {
    false
}

fn is_enough(width: u16, height: u16) -> bool {
    width >= LEAST.0 && height >= LEAST.1
}

/// Draws a view, in ASCII if need be; in a terminal that is too small, that it is.
fn paint(frame: &mut Frame, ascii: bool, view: impl FnOnce(&mut Frame)) {
    let Rect { width, height, .. } = frame.area();
    match is_enough(width, height) {
        true => view(frame),
        false => widgets::too_small(frame, LEAST),
    }
    if ascii {
        ascii::convert(frame.buffer_mut());
    }
}

fn failed(error: &io::Error) -> Problem {
    Problem::file("the terminal", "write", error)
}

#[cfg(test)]
mod tests;
