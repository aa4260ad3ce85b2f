//! `wimu calibrate LINK` on a screen.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use wimu_host::calibration::CalibrateOptions;
use wimu_host::clock::Pace;
use wimu_host::guided::{DEFAULT_FILE, Guided};
use wimu_host::live::{Heard, LiveClient, LiveLinks, Tap};
use wimu_host::{LinkUrl, Result};

use crate::arguments::Calibrate;
use crate::command::{connect_for, interrupted};
use crate::output::Output;
use crate::screen::calibrate::draw;
use crate::screen::{Key, Screen};

/// Longest wait for data before keys are read.
const GLANCE: Duration = Duration::from_millis(20);

/// Calibrates on a screen. Returns the exit code.
pub fn run(arguments: &Calibrate, options: &CalibrateOptions, output: &Output) -> Result<u8> {
    let client = connect_for(&arguments.input, arguments.push)?;
    let hello = *client.hello();
    let name = client.name().to_owned();
    let file = arguments.output.as_deref().unwrap_or(Path::new(DEFAULT_FILE));
    let count = arguments.count.map(usize::from);
    let mut guided = Guided::new(options.clone(), count, &hello, &name, file)?;
    guided.writes = arguments.output.is_some();
    if arguments.resume {
        guided.resume()?;
    }
    let mut on_screen = OnScreen {
        push: arguments.push,
        url: name.parse()?,
        stop: interrupted()?,
        guided,
        first_line: 0,
        done: false,
    };
    let screen = Screen::open()?;
    let outcome = on_screen.show(screen, client.map_transport(Tap::on));
    // From here on the terminal is as before.
    outcome?;
    end(&on_screen.guided, arguments, output)
}

struct OnScreen {
    /// Whether a usable result is pushed without a key.
    push: bool,
    url: LinkUrl,
    stop: Arc<AtomicBool>,
    guided: Guided,
    /// First visible line of the result.
    first_line: u16,
    done: bool,
}

impl OnScreen {
    /// Shows the screen until the person quits.
    fn show(&mut self, mut screen: Screen, mut client: LiveClient) -> Result<()> {
        while !self.done {
            let links = LiveLinks::start(vec![(self.url.clone(), client)], Pace::sparse);
            let push = self.listen(&mut screen, &links)?;
            let guided = &mut self.guided;
            let rest = |_, heard: &Heard| {
                guided.take(heard);
            };
            let Some(back) = links.finish(rest).pop() else {
                return Ok(());
            };
            client = back;
            if push {
                self.guided.push(&mut client);
            }
        }
        Ok(())
    }

    /// Shows the screen until a push is wanted (true), or the person quits.
    fn listen(&mut self, screen: &mut Screen, links: &LiveLinks) -> Result<bool> {
        loop {
            match links.next(GLANCE) {
                Ok((_, heard)) => {
                    if self.guided.take(&heard) {
                        screen.bell();
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => self.done = true,
            }
            while let Some(key) = screen.key() {
                if self.press(key) {
                    return Ok(true);
                }
                // A closed terminal goes on giving `Quit`.
                if self.done {
                    return Ok(false);
                }
            }
            if self.stop.load(Ordering::Relaxed) {
                self.done = true;
            }
            if self.done {
                return Ok(false);
            }
            if self.guided.is_due() {
                self.calibrate();
                if self.push && self.guided.view.usable {
                    return Ok(true);
                }
            }
            self.guided.refresh();
            screen.draw(|frame| draw(&self.guided.view, self.first_line, frame))?;
        }
    }

    fn calibrate(&mut self) {
        self.first_line = 0;
        self.guided.calibrate();
    }

    /// Handles a key; returns whether the result is to be pushed.
    fn press(&mut self, key: Key) -> bool {
        let guided = &mut self.guided;
        match (key, &guided.view.result) {
            (Key::Quit | Key::Char('q'), _) => self.done = true,
            (Key::Char('p'), Some(_)) if guided.view.usable => return true,
            (Key::Char('w'), Some(_)) if guided.view.usable => guided.write(true),
            (Key::Char('m'), Some(_)) => guided.more(),
            (Key::Up, Some(_)) => self.first_line = self.first_line.saturating_sub(1),
            (Key::Down, Some(text)) => {
                self.first_line = (self.first_line + 1).min(text.lines().count() as u16);
            }
            (_, Some(_)) => {}
            (Key::Char('u'), None) => guided.undo(),
            (Key::Char('s'), None) => guided.skip(),
            (Key::Char('r'), None) if guided.view.resumable => {
                if let Err(error) = guided.resume() {
                    guided.view.message = format!("cannot resume: {}", error.text);
                }
            }
            (Key::Enter | Key::Char('f'), None) => self.calibrate(),
            _ => {}
        }
        false
    }
}

/// Prints what remains of the session after the screen.
fn end(guided: &Guided, arguments: &Calibrate, output: &Output) -> Result<u8> {
    let remark = guided.end();
    let Some(report) = guided.report() else {
        output.print(remark.unwrap_or_default());
        return Ok(0);
    };
    let code = super::finish(report, &report.outcome, None, None, output, || {
        super::write_page(arguments, || report.page())
    })?;
    if let Some(path) = guided.written() {
        output.print(format!("the calibration is in {}", path.display()));
    }
    if guided.view.pushed {
        output.print("pushed: the board corrects its samples now");
    } else if code == 0 {
        output.print("not pushed to the board");
    }
    Ok(code)
}
