//! A guided calibration from the first pose to the pushed result.

use std::path::{Path, PathBuf};

use serde::Serialize;
use wimu_calib::{Face, Orientation, Phase};
use wimu_link::Hello;
use wimu_model::{ParameterId, ParameterSet};

use super::poses::{Guidance, LivePoses, News, Plan, Uncertainty};
use crate::Result;
use crate::calibration::{self, CalibrateOptions, CalibrationReport};
use crate::client::Client;
use crate::decode::Arrival;
use crate::live::LinkUpdate;
use crate::problem;
use crate::recording::{Recording, Selection};
use crate::stats::norm;
use crate::transport::Transport;

/// Poses that are added at a time. Chosen: a third of the usual number.
pub const MORE: usize = 4;
/// File of the calibration where none was named.
pub const DEFAULT_FILE: &str = "wimu-calibration.json";

/// The file with the poses of a session whose calibration goes to `file`.
pub fn poses_file(file: &Path) -> PathBuf {
    file.with_extension("poses.csv")
}

/// Writes a calibration to a board, signed if this computer has its key, and verifies that the board holds it.
///
/// # Errors
/// Those of [`Client::use_own_key`] and [`Client::push_verified`].
pub fn push<T: Transport>(client: &mut Client<T>, set: &ParameterSet) -> Result<ParameterId> {
    client.use_own_key()?;
    client.push_verified(set)
}

/// Whether the board rests.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Hold {
    /// No sample arrived yet.
    #[default]
    Waiting,
    /// It moves.
    Moving,
    /// At rest for this long, of the duration of a capture, s.
    Holding(f64, f64),
    /// Captured: another orientation is needed.
    Captured,
}

/// What a screen or a page shows of it.
#[derive(Clone, Debug, Default, Serialize)]
pub struct GuidedView {
    /// The board and its link.
    pub device: String,
    /// Names of the sides that +X, −X, +Y, … point out of.
    pub sides: [&'static str; 6],
    /// Number of poses.
    pub wanted: usize,
    /// Directions that were up in the captured poses, unit vectors, sensor axes.
    pub poses: Vec<[f64; 3]>,
    /// Present direction that is up.
    pub up: Option<[f64; 3]>,
    /// Suggested direction.
    pub next: Option<[f64; 3]>,
    /// How to reach the next one, in words.
    pub instruction: String,
    /// Whether the board rests.
    pub hold: Hold,
    /// After each pose.
    pub uncertainty: Vec<Uncertainty>,
    /// Why the link is lost at present.
    pub lost: Option<String>,
    /// The latest message.
    pub message: String,
    /// Text of the finished calibration.
    pub result: Option<String>,
    /// Whether the result can be used.
    pub usable: bool,
    /// Whether the board holds the result.
    pub pushed: bool,
}

/// A guided calibration. The poses are saved after each capture, so that those of an interrupted session can be calibrated.
pub struct Guided {
    options: CalibrateOptions,
    name: String,
    /// File of the poses.
    poses_file: PathBuf,
    /// File of the calibration.
    file: PathBuf,
    /// Whether that file has the poses of an earlier session, which are kept as `.old.csv`.
    has_earlier: bool,
    /// Whether poses are saved after each capture.
    pub saves: bool,
    written: bool,
    /// Whether a file of an earlier session may be overwritten.
    overwrite: bool,
    /// Why the poses could not be saved.
    unsaved: Option<String>,
    live: LivePoses,
    report: Option<CalibrationReport>,
    /// Number of poses at the latest attempt to calibrate.
    tried: Option<usize>,
    /// What is shown.
    pub view: GuidedView,
}

impl Guided {
    /// A session of the board `hello` at the link `name`, whose calibration goes to `file`.
    pub fn new(plan: Plan, hello: &Hello, name: &str, file: &Path) -> Self {
        let poses_file = poses_file(file);
        let mut view = GuidedView {
            device: format!("{} with {}, {} link", hello.board.name, hello.sensor.name, hello.role),
            sides: *plan.sides,
            wanted: plan.count,
            ..GuidedView::default()
        };
        view.message = match plan.guidance {
            Guidance::Orientations => {
                "hold the board as suggested, or in any other orientation".to_owned()
            }
            _ => plan.instruction(),
        };
        Self {
            options: plan.options().clone(),
            name: name.to_owned(),
            has_earlier: poses_file.exists(),
            poses_file,
            file: file.to_owned(),
            saves: true,
            written: false,
            overwrite: false,
            unsaved: None,
            live: LivePoses::new(plan, hello),
            report: None,
            tried: None,
            view,
        }
    }

    /// Takes what a link has received; returns whether a pose was captured.
    pub fn take(&mut self, heard: &LinkUpdate) -> bool {
        self.view.lost = heard.lost.as_ref().map(|error| error.text.clone());
        self.take_arrivals(&heard.arrivals)
    }

    /// Takes what has arrived; returns whether a pose was captured.
    pub fn take_arrivals(&mut self, arrivals: &[Arrival]) -> bool {
        if self.report.is_some() {
            return false;
        }
        let mut any = false;
        for arrival in arrivals {
            let (mut message, mut captured) = (None, false);
            self.live.take(arrival, |live, news| match news {
                News::Ready => {}
                News::Skipped => message = Some("skipped by the board's button".to_owned()),
                News::Captured(pose) => {
                    captured = true;
                    let side = Face::of(&pose).map(|side| format!(": {} up", live.plan.name(side)));
                    message = Some(format!(
                        "pose {} captured{}",
                        live.poses().len(),
                        side.unwrap_or_default()
                    ));
                }
            });
            self.view.message = message.unwrap_or(std::mem::take(&mut self.view.message));
            if captured {
                any = true;
                self.save();
            }
        }
        self.uncertainty();
        any
    }

    /// Saves the poses after a change.
    fn save(&mut self) {
        if !self.saves {
            return;
        }
        if std::mem::take(&mut self.has_earlier) {
            let _ = std::fs::rename(&self.poses_file, self.poses_file.with_extension("old.csv"));
        }
        if self.live.poses().is_empty() {
            let _ = std::fs::remove_file(&self.poses_file);
            return;
        }
        let recording = self.live.recording(&self.name);
        let saved = recording.and_then(|all| all.write_table(&self.poses_file));
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

    /// Removes the latest pose.
    pub fn undo(&mut self) {
        if self.live.undo() {
            self.view.message =
                "the latest pose is removed: rotate the board, then hold it still".to_owned();
            self.save();
            self.uncertainty();
        } else {
            self.view.message = "there is no pose to remove".to_owned()
        }
    }

    /// Skips the suggested orientation.
    pub fn skip(&mut self) {
        self.live.skip();
        self.view.message = "skipped: this orientation is not suggested again".to_owned();
    }

    /// Whether all poses were captured and no result was computed of them.
    pub fn is_due(&self) -> bool {
        let is_new = self.tried != Some(self.live.poses().len());
        self.report.is_none() && self.live.is_complete() && is_new
    }

    /// All samples so far.
    ///
    /// # Errors
    /// Those of [`LivePoses::recording`].
    pub fn recording(&self) -> Result<Recording> {
        self.live.recording(&self.name)
    }

    /// Computes the result of the poses so far; the view shows it, or why there is none.
    ///
    /// # Errors
    /// Those of [`calibration::calibrate`].
    pub fn calibrate(&mut self) -> Result<()> {
        self.tried = Some(self.live.poses().len());
        let report = self.recording().and_then(|data| {
            calibration::calibrate(&data.samples(Selection::default())?, &self.options)
        });
        let report = report.inspect_err(|error| {
            self.view.message = format!("no calibration: {}", error.text);
        })?;
        self.view.usable = report.outcome.exit_code() == 0;
        let findings = problem::text(&report.outcome.findings, usize::MAX);
        self.view.result = Some(format!("{report}\n{findings}"));
        self.view.pushed = false;
        self.report = Some(report);
        self.view.message = String::new();
        Ok(())
    }

    /// Goes back to the poses for [`MORE`].
    pub fn more(&mut self) {
        let before = self.live.plan.count;
        self.live.extend(MORE);
        self.view.wanted = self.live.plan.count;
        (self.report, self.view.result, self.tried) = (None, None, None);
        self.view.message = format!(
            "{before} + {} = {} poses are wanted now, for a smaller uncertainty; finish earlier if you like",
            self.view.wanted - before,
            self.view.wanted
        );
    }

    /// Writes the calibration; a file of an earlier session only once it was `asked` for twice.
    pub fn write(&mut self, asked: bool) {
        let path = &self.file;
        if asked && !self.written && path.exists() && !self.overwrite {
            self.overwrite = true;
            self.view.message = format!("{} exists: write again to overwrite it", path.display());
            return;
        }
        let Some(file) = self.report.as_ref().and_then(|report| report.file.as_ref()) else {
            return;
        };
        self.view.message = match file.write(path) {
            Ok(()) => format!("written to {}", path.display()),
            Err(error) => format!("not written: {}; {}", error.text, error.remedy),
        };
        self.written = true;
    }

    /// Writes the result to the board, signed if this computer has its key.
    pub fn push<T: Transport>(&mut self, client: &mut Client<T>) {
        let Some(set) = self.report.as_ref().and_then(|report| report.parameters.as_ref()) else {
            return;
        };
        let pushed = push(client, set);
        self.view.message = match &pushed {
            Ok(id) => format!("pushed {id}"),
            Err(error) => format!("not pushed: {}; {}", error.text, error.remedy),
        };
        self.view.pushed = pushed.is_ok();
    }

    /// Brings the view up to date with the samples.
    pub fn refresh(&mut self) {
        let live = &self.live;
        let poses = live.poses().iter();
        self.view.poses = poses.filter_map(|pose| unit(pose.mean_mps2)).collect();
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
        self.view.instruction = live.plan.next_instruction(live.poses().len(), next);
        self.view.next = next.map(Orientation::up);
    }

    /// Ends the session. Returns a sentence about the poses of an unfinished
    /// one.
    pub fn end(&self) -> Option<String> {
        if self.report.is_some() {
            if self.view.pushed || self.written {
                self.forget_poses();
            }
            return None;
        }
        Some(match (self.live.poses().len(), &self.unsaved) {
            (0, _) => "no pose was captured".to_owned(),
            (_, Some(error)) => format!("the poses are not saved: {error}"),
            (count, None) if self.saves => format!(
                "{} saved in {}, which `wimu calibrate` reads",
                crate::plural::counted(count, "pose"),
                self.poses_file.display()
            ),
            (count, None) => format!("{} not saved", crate::plural::counted(count, "pose")),
        })
    }

    /// Removes the saved poses.
    pub fn forget_poses(&self) {
        if self.saves {
            let _ = std::fs::remove_file(&self.poses_file);
        }
    }

    /// The result, once it is computed.
    pub fn report(&self) -> Option<&CalibrationReport> {
        self.report.as_ref()
    }
}

/// The unit vector along `v`; `None` without a direction.
pub fn unit(v: [f64; 3]) -> Option<[f64; 3]> {
    let length = norm(v);
    (length > 1e-9 && length.is_finite()).then(|| v.map(|axis| axis / length))
}
