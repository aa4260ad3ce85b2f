//! A bar on stderr while a file is read for longer than a second.

use std::io::{IsTerminal, stderr};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// Time after which the bar is shown.
const DELAY: Duration = Duration::from_secs(1);

/// Start of reading, and the bar once it is shown.
static READING: Mutex<Option<(Instant, Option<ProgressBar>)>> = Mutex::new(None);

/// Shows the bar from now on, if stderr is a terminal.
pub fn show() {
    if stderr().is_terminal() {
        wimu_host::progress::observe(step);
    }
}

/// Takes the bytes read of a file and its length; `None` at its end.
fn step(read: Option<(u64, u64)>) {
    let mut reading = READING.lock().unwrap_or_else(PoisonError::into_inner);
    let Some((position, length)) = read else {
        if let Some((_, Some(bar))) = reading.take() {
            bar.finish_and_clear();
        }
        return;
    };
    let (began, bar) = reading.get_or_insert_with(|| (Instant::now(), None));
    if bar.is_none() && began.elapsed() >= DELAY {
        let style = ProgressStyle::with_template(
            "reading [{bar:30}] {percent} % of {total_bytes}, {eta} left",
        );
        *bar = Some(
            ProgressBar::new(length).with_style(style.unwrap_or(ProgressStyle::default_bar())),
        );
    }
    if let Some(bar) = bar {
        bar.set_length(length);
        bar.set_position(position);
    }
}
