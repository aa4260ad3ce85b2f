//! Progress on stderr of what takes longer than a second: a bar while a file is read, then the time of computing.

use std::io::{IsTerminal, stderr};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// Time after which progress is shown.
const DELAY: Duration = Duration::from_secs(1);
/// Interval between two looks at the time of computing.
const TICK: Duration = Duration::from_millis(250);

/// What takes long, since when, and what is shown of it.
struct Work {
    is_reading: bool,
    began: Instant,
    shown: Option<ProgressBar>,
}

static WORK: Mutex<Option<Work>> = Mutex::new(None);

/// Whether a screen has the terminal.
static HIDDEN: AtomicBool = AtomicBool::new(false);

fn work() -> MutexGuard<'static, Option<Work>> {
    WORK.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Shows progress from now on, if stderr is a terminal.
pub fn show() {
    if stderr().is_terminal() {
        wimu_host::progress::observe(step);
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

/// Hides progress while a screen has the terminal.
pub fn hide(hidden: bool) {
    clear();
    HIDDEN.store(hidden, Ordering::Relaxed);
}

/// Ends what is shown, before something is printed.
pub fn clear() {
    if let Some(bar) = work().take().and_then(|work| work.shown) {
        bar.finish_and_clear();
    }
}

/// Takes the bytes read of a file and its length; `None` at its end.
fn step(read: Option<(u64, u64)>) {
    let mut work = work();
    let is_reading = read.is_some();
    if work
        .as_ref()
        .is_none_or(|work| work.is_reading != is_reading)
    {
        let before = work.replace(Work {
            is_reading,
            began: Instant::now(),
            shown: None,
        });
        if let Some(bar) = before.and_then(|before| before.shown) {
            bar.finish_and_clear();
        }
    }
    if let (Some(work), Some(_)) = (work.as_mut(), read) {
        work.display(read);
    }
}

impl Work {
    /// Shows it if it takes long.
    fn display(&mut self, read: Option<(u64, u64)>) {
        if self.began.elapsed() < DELAY || HIDDEN.load(Ordering::Relaxed) {
            return;
        }
        let bar = self.shown.get_or_insert_with(|| {
            let template = match read {
                Some(_) => "reading [{bar:30}] {percent} % of {total_bytes}, {eta} left",
                None => "{spinner} computing, {elapsed}",
            };
            let style = ProgressStyle::with_template(template);
            let style = style.unwrap_or(ProgressStyle::default_bar());
            ProgressBar::no_length()
                .with_style(style.tick_chars("-\\|/ "))
                .with_elapsed(DELAY)
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
