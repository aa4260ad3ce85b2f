//! Progress on stderr of what takes longer than a second: a bar while a file is read, otherwise the time since the latest
//! output.

use std::io::{IsTerminal, stderr};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// Time after which progress is shown.
const DELAY: Duration = Duration::from_secs(1);
/// Interval between two looks at the time since the latest output.
const TICK: Duration = Duration::from_millis(250);

/// What takes long, since when, and what is shown of it.
struct Work {
    is_reading: bool,
    began: Instant,
    shown: Option<ProgressBar>,
}

static WORK: Mutex<Option<Work>> = Mutex::new(None);

/// Whether a screen has the terminal, or the command waits for data.
static HIDDEN: AtomicBool = AtomicBool::new(false);

fn work() -> MutexGuard<'static, Option<Work>> {
    WORK.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Shows progress from now on, if stderr is a terminal.
pub fn show() {
    if stderr().is_terminal() {
        wimu_host::progress::observe(step);
        *work() = Some(Work::new(false));
        thread::spawn(|| {
            loop {
                thread::sleep(TICK);
                if let Some(work) = work().as_mut().filter(|work| !work.is_reading) {
                    work.display(None);
                }
            }
        });
    }
}

/// Hides progress while a screen has the terminal, or the command waits for data.
pub fn hide(hidden: bool) {
    clear();
    HIDDEN.store(hidden, Ordering::Relaxed);
}

/// Ends what is shown, before something is printed.
pub fn clear() {
    if let Some(work) = work().as_mut() {
        work.end(false);
    }
}

/// Takes the bytes read of a file and its length; `None` at its end.
fn step(read: Option<(u64, u64)>) {
    let mut work = work();
    let Some(work) = work.as_mut() else { return };
    if work.is_reading != read.is_some() {
        work.end(read.is_some());
    }
    if read.is_some() {
        work.display(read);
    }
}

impl Work {
    fn new(is_reading: bool) -> Self {
        Self { is_reading, began: Instant::now(), shown: None }
    }

    /// Ends it; the next begins.
    fn end(&mut self, is_reading: bool) {
        if let Some(bar) = std::mem::replace(self, Self::new(is_reading)).shown {
            bar.finish_and_clear();
        }
    }

    /// Shows it if it takes long.
    fn display(&mut self, read: Option<(u64, u64)>) {
        if self.began.elapsed() < DELAY || HIDDEN.load(Ordering::Relaxed) {
            return;
        }
        let bar = self.shown.get_or_insert_with(|| {
            let template = match read {
                Some(_) => "reading [{bar:30}] {percent} % of {total_bytes}, {eta} left",
                None => "{spinner} working, {elapsed}",
            };
            let style = ProgressStyle::with_template(template);
            let style = style.unwrap_or(ProgressStyle::default_bar());
            ProgressBar::no_length().with_style(style.tick_chars("-\\|/ ")).with_elapsed(DELAY)
        });
        match read {
            Some((position, length)) => {
                bar.set_length(length);
                bar.set_position(position);
            }
            None => bar.tick(),
        }
    }
}
