//! Guided calibration on a screen.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use wimu_calib::{Face, Orientation, Phase};
use wimu_host::calibration::{self, CalibrateOptions, CalibrationReport};
use wimu_host::clock::Pace;
use wimu_host::finding;
use wimu_host::keys::KeyFolder;
use wimu_host::live::{Heard, LiveClient, LiveLinks, Tap};
use wimu_host::plural::counted;
use wimu_host::recording::Selection;
use wimu_host::{LinkUrl, Result};
use wimu_link::Hello;

use super::live::{LivePoses, News, Plan, poses_file};
use crate::arguments::Calibrate;
use crate::command::{connect_for, interrupted, params};
use crate::output::Output;
use crate::screen::calibrate::{CalibrateView, Hold, draw};
use crate::screen::{Key, Screen, unit};

/// Longest wait for data before keys are read.
const GLANCE: Duration = Duration::from_millis(20);
/// Poses that are added at a time. Chosen: a third of the usual number.
const MORE: usize = 4;
/// File of the calibration where none was named.
const DEFAULT_FILE: &str = "wimu-calibration.json";

/// Calibrates on a screen. Returns the exit code.
pub fn run(arguments: &Calibrate, options: &CalibrateOptions, output: Output) -> Result<u8> {
    let client = connect_for(&arguments.input, arguments.push)?;
    let hello = *client.hello();
    let url: LinkUrl = client.name().parse()?;
    let live = LivePoses::new(Plan::new(arguments, options, &hello)?, &hello);
    let mut guided = Guided {
        arguments,
        options,
        name: client.name().to_owned(),
        url,
        file: poses_file(arguments.output.as_deref()),
        written: None,
        overwrite: false,
        unsaved: None,
        stop: interrupted()?,
        view: view_of(&hello, &live.plan),
        live,
        report: None,
        tried: None,
        done: false,
    };
    guided.start()?;
    let screen = Screen::open()?;
    let outcome = guided.show(screen, client.map_transport(Tap::on));
    // From here on the terminal is as before.
    outcome?;
    guided.end(output)
}

struct Guided<'a> {
    arguments: &'a Calibrate,
    options: &'a CalibrateOptions,
    name: String,
    url: LinkUrl,
    /// File of the poses.
    file: PathBuf,
    /// File of the calibration, once it is written.
    written: Option<PathBuf>,
    /// Whether a file of an earlier session may be overwritten.
    overwrite: bool,
    /// Why the poses could not be saved.
    unsaved: Option<String>,
    stop: Arc<AtomicBool>,
    view: CalibrateView,
    live: LivePoses,
    report: Option<CalibrationReport>,
    /// Number of poses at the latest attempt to calibrate.
    tried: Option<usize>,
    done: bool,
}

fn view_of(hello: &Hello, plan: &Plan) -> CalibrateView {
    CalibrateView {
        device: format!(
            "{} with {}, {} link",
            hello.board.name, hello.sensor.name, hello.role
        ),
        sides: *plan.names,
        wanted: plan.count,
        ..CalibrateView::default()
    }
}

impl Guided<'_> {
    /// Resumes an interrupted session if that was asked for, or offers it.
    fn start(&mut self) -> Result<()> {
        if self.arguments.resume {
            self.live.resume(&self.file)?;
            self.view.message = format!("continuing the poses in {}", self.file.display());
        } else if self.file.exists() {
            self.view.resumable = true;
            self.view.message = format!("{} has poses of an earlier session", self.file.display());
        } else {
            self.view.message =
                "hold the board as drawn on the left, or in any other orientation".to_owned();
        }
        Ok(())
    }

    /// Shows the screen until the person quits.
    fn show(&mut self, mut screen: Screen, mut client: LiveClient) -> Result<()> {
        while !self.done {
            let links = LiveLinks::start(vec![(self.url.clone(), client)], Pace::sparse);
            let push = self.listen(&mut screen, &links)?;
            let Some(back) = links.finish().pop() else {
                return Ok(());
            };
            client = back;
            if push {
                self.push(&mut client);
            }
        }
        Ok(())
    }

    /// Shows the screen until a push is wanted (true), or the person quits.
    fn listen(&mut self, screen: &mut Screen, links: &LiveLinks) -> Result<bool> {
        loop {
            match links.next(GLANCE) {
                Ok((_, heard)) => self.take(screen, &heard),
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
            let is_new = self.tried != Some(self.live.poses().len());
            if self.report.is_none() && self.live.is_complete() && is_new {
                self.calibrate();
                if self.arguments.push && self.view.usable {
                    return Ok(true);
                }
            }
            self.refresh();
            screen.draw(|frame| draw(&self.view, frame))?;
        }
    }

    fn take(&mut self, screen: &Screen, heard: &Heard) {
        self.view.lost = heard.lost.as_ref().map(|error| error.message().to_owned());
        if self.report.is_some() {
            return;
        }
        for arrival in &heard.arrivals {
            let (mut message, mut captured) = (None, false);
            self.live.take(arrival, |live, news| match news {
                News::Ready => {}
                News::Skipped => message = Some("skipped by the board's button".to_owned()),
                News::Captured(pose) => {
                    captured = true;
                    let side = Face::of(&pose).map(|side| format!(": {}", live.plan.name(side)));
                    message = Some(format!(
                        "pose {} captured{}",
                        live.poses().len(),
                        side.unwrap_or_default()
                    ));
                }
            });
            self.view.message = message.unwrap_or(std::mem::take(&mut self.view.message));
            if captured {
                screen.bell();
                if std::mem::take(&mut self.view.resumable) {
                    // The poses of an earlier session are kept.
                    let _ = std::fs::rename(&self.file, self.file.with_extension("old.csv"));
                }
                self.save();
            }
        }
        self.uncertainty();
    }

    /// Saves the poses after a change.
    fn save(&mut self) {
        if self.live.poses().is_empty() {
            let _ = std::fs::remove_file(&self.file);
            return;
        }
        let recording = self.live.recording(&self.name);
        let saved = recording.and_then(|all| all.write_table(&self.file));
        self.unsaved = saved.err().map(|error| error.to_string());
        if let Some(error) = &self.unsaved {
            self.view.message = format!("the poses are not saved: {error}");
        }
    }

    /// Brings the course of the uncertainty up to the number of poses.
    fn uncertainty(&mut self) {
        let (Some(session), known) = (self.live.session(), &mut self.view.uncertainty) else {
            return;
        };
        let wanted = session.poses().len() + 1;
        known.truncate(wanted);
        if known.len() < wanted {
            let latest = self.live.plan.uncertainty(session);
            known.resize(wanted, latest);
        }
    }

    /// Handles a key; returns whether the result is to be pushed.
    fn press(&mut self, key: Key) -> bool {
        let shown = self.view.result.as_mut();
        match (key, shown) {
            (Key::Quit | Key::Char('q'), _) => self.done = true,
            (Key::Char('p'), Some(_)) if self.view.usable => return true,
            (Key::Char('w'), Some(_)) if self.view.usable => self.write(true),
            (Key::Char('m'), Some(_)) => self.more(),
            (Key::Up, Some((_, first))) => *first = first.saturating_sub(1),
            (Key::Down, Some((text, first))) => {
                *first = (*first + 1).min(text.lines().count() as u16);
            }
            (_, Some(_)) => {}
            (Key::Char('u'), None) => match self.live.undo() {
                true => {
                    self.view.message =
                        "the latest pose is removed: turn the board, then hold it still".to_owned();
                    self.save();
                    self.uncertainty();
                }
                false => self.view.message = "there is no pose to remove".to_owned(),
            },
            (Key::Char('s'), None) => {
                self.live.skip();
                self.view.message = "skipped: this orientation is not suggested again".to_owned();
            }
            (Key::Char('r'), None) if self.view.resumable => {
                self.view.resumable = false;
                self.view.message = match self.live.resume(&self.file) {
                    Ok(()) => format!("continuing the poses in {}", self.file.display()),
                    Err(error) => format!("cannot resume: {}", error.message()),
                };
                self.uncertainty();
            }
            (Key::Enter | Key::Char('f'), None) => self.calibrate(),
            _ => {}
        }
        false
    }

    /// Computes the result and shows it.
    fn calibrate(&mut self) {
        self.tried = Some(self.live.poses().len());
        let report = self.live.recording(&self.name).and_then(|data| {
            calibration::calibrate(&data.samples(Selection::default())?, self.options)
        });
        match report {
            Ok(report) => {
                self.view.usable = report.outcome.exit_code() == 0;
                let findings = finding::text(&report.outcome.findings, usize::MAX);
                self.view.result = Some((format!("{report}\n{findings}"), 0));
                self.view.pushed = false;
                self.report = Some(report);
                self.view.message = String::new();
                if self.view.usable && self.arguments.output.is_some() {
                    self.write(false);
                }
            }
            Err(error) => self.view.message = format!("no calibration: {}", error.message()),
        }
    }

    /// Goes back to the poses for [`MORE`].
    fn more(&mut self) {
        let before = self.live.plan.count;
        self.live.extend(MORE);
        self.view.wanted = self.live.plan.count;
        (self.report, self.view.result, self.tried) = (None, None, None);
        self.view.message = format!(
            "{before} + {} = {} poses are wanted now, for a smaller uncertainty; Enter finishes earlier",
            self.view.wanted - before,
            self.view.wanted
        );
    }

    /// Writes the calibration; a file of an earlier session only once it was `asked` for twice.
    fn write(&mut self, asked: bool) {
        let named = self.arguments.output.as_deref();
        let path = named.unwrap_or(Path::new(DEFAULT_FILE));
        if asked && self.written.is_none() && path.exists() && !self.overwrite {
            self.overwrite = true;
            self.view.message = format!("{} exists: w overwrites it, q keeps it", path.display());
            return;
        }
        let Some(file) = self.report.as_ref().and_then(|report| report.file.as_ref()) else {
            return;
        };
        self.view.message = match file.write(path) {
            Ok(()) => format!("written to {}", path.display()),
            Err(error) => format!("not written: {}; {}", error.message(), error.remedy()),
        };
        self.written = Some(path.to_owned());
    }

    fn push(&mut self, client: &mut LiveClient) {
        let Some(set) = self
            .report
            .as_ref()
            .and_then(|report| report.parameters.as_ref())
        else {
            return;
        };
        let device = client.hello().device_id;
        let known = KeyFolder::of_user().and_then(|folder| folder.candidates(device));
        let pushed = known
            .and_then(|known| client.use_key_among(&known))
            .and_then(|_| params::write(client, set));
        self.view.message = match &pushed {
            Ok(id) => format!("pushed {id}; q quits"),
            Err(error) => format!("not pushed: {}; {}", error.message(), error.remedy()),
        };
        self.view.pushed = pushed.is_ok();
    }

    /// Brings the view up to date.
    fn refresh(&mut self) {
        let live = &self.live;
        self.view.poses = live
            .poses()
            .iter()
            .filter_map(|pose| unit(pose.mean_mps2))
            .collect();
        self.view.up = live.output_mps2().and_then(unit);
        let samples = |count: u32| f64::from(count) / live.rate_hz();
        let session = live.session().filter(|_| self.view.lost.is_none());
        self.view.hold = match (session, live.phase()) {
            (None, _) => Hold::Waiting,
            (_, Phase::WaitingForRest) => Hold::Moving,
            (Some(session), Phase::Collecting { samples: held }) => {
                Hold::Holding(samples(held), samples(session.capture_samples()))
            }
            _ => Hold::Captured,
        };
        let next = live.next();
        self.view.instruction = next.map_or(String::new(), |next| {
            next.instruction_with(live.plan.names).to_string()
        });
        self.view.next = next.map(Orientation::up);
    }

    /// Prints what remains of the session after the screen.
    fn end(self, output: Output) -> Result<u8> {
        let Some(report) = &self.report else {
            match (self.live.poses().len(), self.unsaved) {
                (0, _) => output.print("no pose was captured"),
                (count, None) => output.print(format!(
                    "{} saved in {}; --resume continues there",
                    counted(count, "pose"),
                    self.file.display()
                )),
                (_, Some(error)) => output.print(format!("the poses are not saved: {error}")),
            }
            return Ok(0);
        };
        // A finished session is not resumed by mistake.
        if self.view.pushed || self.written.is_some() {
            let _ = std::fs::remove_file(&self.file);
        }
        let code = super::finish(report, &report.outcome, None, None, output, || {
            super::write_page(self.arguments, || report.page())
        })?;
        if let Some(path) = &self.written {
            output.print(format!("the calibration is in {}", path.display()));
        }
        if self.view.pushed {
            output.print("pushed: the board corrects its samples now");
        } else if code == 0 {
            output.print("not pushed to the board");
        }
        Ok(code)
    }
}
