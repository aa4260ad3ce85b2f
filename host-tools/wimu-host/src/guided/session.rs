//! A guided calibration from the first pose to the pushed result.

use std::path::{Path, PathBuf};

use serde::Serialize;
use wimu_calib::{Face, Orientation, Pose};
use wimu_link::Hello;
use wimu_link::batch::Stream;
use wimu_link::message::Event as Happened;
use wimu_model::{CalibrationMethod, ParameterId, ParameterSet};

use super::capture::{Capture, Hold};
use super::plan::{Plan, Uncertainty};
use crate::calibration::{self, CalibrationReport};
use crate::capture::Link;
use crate::client::Client;
use crate::decode::{Arrival, Event};
use crate::live::LinkUpdate;
use crate::plural::counted;
use crate::recording::{Recording, Selection};
use crate::stats::norm;
use crate::transport::Transport;
use crate::{Result, problem};

/// Poses that are added at a time. Chosen: a third of the usual number.
const MORE: usize = 4;
/// File of the calibration where none was named.
pub const DEFAULT_FILE: &str = "wimu-calibration.json";

/// Writes a calibration to a board, signed if this computer has its key, and verifies that the board holds it.
///
/// # Errors
/// Those of [`Client::use_own_key`] and [`Client::push_verified`].
pub fn push<T: Transport>(client: &mut Client<T>, set: &ParameterSet) -> Result<ParameterId> {
    client.use_own_key()?;
    client.push_verified(set)
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
    plan: Plan,
    name: String,
    /// File of the poses.
    poses_file: PathBuf,
    /// File of the calibration.
    file: PathBuf,
    /// Whether that of the poses has those of an earlier session, which are kept as `.old.csv`.
    has_earlier: bool,
    /// Whether poses are saved after each capture.
    pub saves: bool,
    written: bool,
    /// Whether a file of an earlier session may be overwritten.
    overwrite: bool,
    /// Why the poses could not be saved.
    unsaved: Option<String>,
    record: Link,
    /// `None` before the rate of the samples is known.
    capture: Option<Capture>,
    report: Option<CalibrationReport>,
    /// Number of poses at the latest attempt to calibrate.
    tried: Option<usize>,
    /// What is shown.
    pub view: GuidedView,
}

impl Guided {
    /// A session of the board `hello` at the link `name`, whose calibration goes to `file`.
    pub fn new(plan: Plan, hello: &Hello, name: &str, file: &Path) -> Self {
        let poses_file = file.with_extension("poses.csv");
        let view = GuidedView {
            device: format!("{} with {}, {} link", hello.board.name, hello.sensor.name, hello.role),
            sides: *plan.sides,
            wanted: plan.count,
            message: plan.instruction(),
            ..GuidedView::default()
        };
        Self {
            plan,
            name: name.to_owned(),
            has_earlier: poses_file.exists(),
            poses_file,
            file: file.to_owned(),
            saves: true,
            written: false,
            overwrite: false,
            unsaved: None,
            record: Link::new(hello.role),
            capture: None,
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
            self.record.take(arrival);
            if self.take_event(&arrival.event) {
                any = true;
                self.save();
            }
        }
        self.uncertainty();
        any
    }

    /// Returns whether a pose was captured.
    fn take_event(&mut self, event: &Event) -> bool {
        match (event, &mut self.capture) {
            (Event::Epoch { epoch, .. }, None) if epoch.sensor == 0 => {
                self.capture = Capture::new(epoch, self.plan.wanted());
                self.suggest();
                false
            }
            (Event::Samples(samples), Some(capture))
                if samples.stream == Stream::Raw && samples.sensor == 0 =>
            {
                let ignored = capture.session.ignores_hold();
                let mut any = false;
                for sample in samples.iter() {
                    let capture = self.capture.as_mut();
                    if capture.is_some_and(|it| it.push(sample.value.map(f64::from))) {
                        any = true;
                        self.captured();
                    }
                }
                // The rest of a hold whose pose was removed.
                if ignored {
                    self.drop_latest(samples.values.len() as u64);
                }
                any
            }
            (Event::Device { event: Happened::Marked { .. }, .. }, Some(capture)) => {
                if capture.session.capture().is_some() {
                    self.captured();
                    return true;
                }
                self.skip();
                self.view.message = "skipped by the board's button".to_owned();
                false
            }
            _ => false,
        }
    }

    /// Says that a pose was captured, and plans the next one.
    fn captured(&mut self) {
        let Some(pose) = self.capture.as_mut().and_then(Capture::captured) else { return };
        let side = Face::of(&pose).map(|side| format!(": {} up", self.plan.sides[side as usize]));
        let (count, side) = (self.poses().len(), side.unwrap_or_default());
        self.view.message = format!("pose {count} captured{side}");
        self.suggest();
    }

    /// Plans the next orientation, after a change of the poses: it takes milliseconds.
    fn suggest(&mut self) {
        let sides_left = self.sides_left();
        let Some(capture) = &mut self.capture else { return };
        capture.next = match self.plan.options.method {
            CalibrationMethod::SixPosition => {
                sides_left.first().map(|side| Orientation::from(*side))
            }
            CalibrationMethod::MultiPosition => capture.session.next(),
            _ => None,
        };
    }

    fn drop_latest(&mut self, count: u64) {
        if let Some(capture) = &mut self.capture {
            capture.kept = capture.kept.saturating_sub(count);
        }
        self.record.drop_latest_raw(usize::try_from(count).unwrap_or(usize::MAX));
    }

    fn poses(&self) -> &[Pose] {
        self.capture.as_ref().map_or(&[], |capture| capture.session.poses())
    }

    /// The sides that were not captured yet, of six.
    fn sides_left(&self) -> Vec<Face> {
        let captured = Vec::from_iter(self.poses().iter().filter_map(Face::of));
        Face::ALL.into_iter().filter(|side| !captured.contains(side)).collect()
    }

    /// Saves the poses after a change.
    fn save(&mut self) {
        if !self.saves {
            return;
        }
        if std::mem::take(&mut self.has_earlier) {
            let _ = std::fs::rename(&self.poses_file, self.poses_file.with_extension("old.csv"));
        }
        if self.poses().is_empty() {
            let _ = std::fs::remove_file(&self.poses_file);
            return;
        }
        let saved = self.recording().and_then(|all| all.write_table(&self.poses_file));
        self.unsaved = saved.err().map(|error| error.to_string());
        if let Some(error) = &self.unsaved {
            self.view.message = format!("the poses are not saved: {error}");
        }
    }

    /// Brings the course of the uncertainty up to the number of poses.
    fn uncertainty(&mut self) {
        let (Some(capture), known) = (&self.capture, &mut self.view.uncertainty) else { return };
        let wanted = capture.session.poses().len() + 1;
        known.truncate(wanted);
        if known.len() < wanted {
            known.resize(wanted, self.plan.uncertainty(&capture.session));
        }
    }

    /// Removes the latest pose with its samples.
    pub fn undo(&mut self) {
        let Some(samples) = self.capture.as_mut().and_then(Capture::undo) else {
            self.view.message = "there is no pose to remove".to_owned();
            return;
        };
        self.drop_latest(samples);
        self.suggest();
        self.view.message =
            "the latest pose is removed: rotate the board, then hold it still".to_owned();
        self.save();
        self.uncertainty();
    }

    /// Skips the suggested orientation.
    pub fn skip(&mut self) {
        self.capture.iter_mut().for_each(|capture| capture.session.skip());
        self.suggest();
        self.view.message = "skipped: this orientation is not suggested again".to_owned();
    }

    /// Whether all poses were captured and no result was computed of them.
    pub fn is_due(&self) -> bool {
        let count = self.poses().len();
        let has_sides = !self.plan.is_of_sides() || self.sides_left().is_empty();
        let is_complete = has_sides && count >= self.plan.count;
        self.report.is_none() && is_complete && self.tried != Some(count)
    }

    /// All samples so far.
    ///
    /// # Errors
    /// Those of [`Recording::of_link`].
    pub fn recording(&self) -> Result<Recording> {
        Recording::of_link(&self.record, &self.name)
    }

    /// Computes the result of the poses so far; the view shows it, or why there is none.
    ///
    /// # Errors
    /// Those of [`calibration::calibrate`].
    pub fn calibrate(&mut self) -> Result<()> {
        self.tried = Some(self.poses().len());
        let report = self.recording().and_then(|data| {
            calibration::calibrate(&data.samples(Selection::default())?, &self.plan.options)
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

    /// Goes back to the poses for four more.
    pub fn more(&mut self) {
        let before = self.plan.count;
        self.plan.count += MORE;
        let wanted = self.plan.wanted();
        self.capture.iter_mut().for_each(|capture| capture.session.want(wanted));
        self.view.wanted = self.plan.count;
        (self.report, self.view.result, self.tried) = (None, None, None);
        self.view.message = format!(
            "{before} + {MORE} = {} poses are wanted now, for a smaller uncertainty; finish earlier if you like",
            self.plan.count
        );
    }

    /// Writes the calibration; a file of an earlier session only when it is asked for twice.
    pub fn write(&mut self) {
        let path = &self.file;
        if !self.written && path.exists() && !self.overwrite {
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
        let poses = self.poses();
        let count = poses.len();
        self.view.poses = poses.iter().filter_map(|pose| unit(pose.mean_mps2)).collect();
        let capture = self.capture.as_ref();
        let next = capture.and_then(|capture| capture.next);
        self.view.up = capture.and_then(|capture| capture.output_mps2).and_then(unit);
        let heard = capture.filter(|_| self.view.lost.is_none());
        self.view.hold = heard.map_or(Hold::Waiting, Capture::hold);
        self.view.instruction = self.plan.next_instruction(count, next);
        self.view.next = next.map(Orientation::up);
    }

    /// Ends the session. Returns a sentence about the poses of an unfinished one.
    pub fn end(&self) -> Option<String> {
        if self.report.is_some() {
            if self.view.pushed || self.written {
                self.forget_poses();
            }
            return None;
        }
        let count = counted(self.poses().len(), "pose");
        Some(match &self.unsaved {
            _ if self.poses().is_empty() => "no pose was captured".to_owned(),
            Some(error) => format!("the poses are not saved: {error}"),
            None if self.saves => {
                let path = self.poses_file.display();
                format!("{count} saved in {path}, which `wimu calibrate` reads")
            }
            None => format!("{count} not saved"),
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
fn unit(v: [f64; 3]) -> Option<[f64; 3]> {
    let length = norm(v);
    (length > 1e-9 && length.is_finite()).then(|| v.map(|axis| axis / length))
}
