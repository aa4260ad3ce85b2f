//! Calibrations for a fleet in stages: one board, then 10 %, then all; stops at the first disagreement. What the boards hold
//! is the state: to resume is to begin again.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::calibration::parameter_id;
use wimu_model::ParameterSet;

use super::status::FleetStatus;
use super::topics::{Fleet, Name};
use crate::calibration::{Calibration, read_parameters};
use crate::client;
use crate::{Code, LinkUrl, Problem, Result};

/// Fraction of the boards after the second stage.
const SECOND: f64 = 0.1;

/// A board and its calibration.
#[derive(Clone, Debug)]
pub struct Target {
    /// Its name.
    pub board: Name,
    /// Device id that the fleet's state names.
    pub device_id: Option<String>,
    /// Its calibration.
    pub set: ParameterSet,
    /// File of the calibration.
    pub file: PathBuf,
}

/// What a push is about to do.
#[derive(Debug, Default)]
pub struct Plan {
    /// The boards, in the order of their names.
    pub targets: Vec<Target>,
    /// Boards of the fleet without a file.
    pub without_file: Vec<String>,
    /// Boards with a file that are away.
    pub away: Vec<String>,
    /// Files of calibrations that are of no board.
    pub without_board: Vec<String>,
}

impl Plan {
    /// Finds the file of each board in `folder`: `BOARD.json`, or `DEVICE_ID.json`.
    ///
    /// # Errors
    /// `file_unreadable` without the folder; `usage` for two files of a board; those of [`read_parameters`], before anything is pushed.
    pub fn new(status: &FleetStatus, folder: &Path) -> Result<Self> {
        let mut plan = Self::default();
        let mut unused = calibrations(folder)?;
        for (board, state) in &status.boards {
            let names = [Some(board.as_str()), state.device_id.as_deref()];
            let names = names.into_iter().flatten();
            let files = names.map(|name| format!("{name}.json"));
            let mut files = files.filter(|name| unused.remove(name));
            let Some(file) = files.next().map(|name| folder.join(name)) else {
                plan.without_file.push(board.clone());
                continue;
            };
            if let Some(other) = files.next() {
                let message = format!("`{other}` is of the board `{board}`, too");
                let error = Code::Usage.error(message, "remove one of both files");
                return Err(error.at(file.display().to_string()));
            }
            let Some(name) = board.parse().ok().filter(|_| state.alive) else {
                plan.away.push(board.clone());
                continue;
            };
            let set = read_parameters(&file)?;
            let device_id = state.device_id.clone();
            plan.targets.push(Target { board: name, device_id, set, file });
        }
        plan.without_board = unused.into_iter().collect();
        Ok(plan)
    }

    /// Number of boards that are done after each stage.
    pub fn stages(&self) -> [usize; 3] {
        let all = self.targets.len();
        let second = (all as f64 * SECOND).ceil() as usize;
        [all.min(1), second.max(all.min(1)), all]
    }
}

/// Names of the `.json` files of a folder.
fn calibrations(folder: &Path) -> Result<BTreeSet<String>> {
    let name = folder.display().to_string();
    let entries =
        std::fs::read_dir(folder).map_err(|error| Problem::file(&name, "open", &error))?;
    let names = entries.flatten().map(|entry| entry.file_name());
    Ok(names
        .filter_map(|name| name.into_string().ok())
        .filter(|name| name.ends_with(".json"))
        .collect())
}

/// Pushes a calibration unless the board holds it, and compares what it then holds; returns whether it was written. With
/// `force` also that of another device.
///
/// # Errors
/// The disagreement: a board that is away, refuses, is another device, or confirms other parameters.
pub fn push(fleet: &Fleet, target: &Target, force: bool) -> Result<bool> {
    let link = LinkUrl::Mqtt {
        broker: fleet.broker.clone(),
        fleet: fleet.fleet.clone(),
        board: target.board.clone(),
    };
    let mut client = client::connect(&link)?;
    let name = link.to_string();
    let device_id = client.hello().device_id;
    let found = format!("{device_id:016x}");
    if target.device_id.as_ref().is_some_and(|id| *id != found) {
        return Err(Code::VerifyFailed
            .error(
                format!("device {found} answers, the fleet's state names another one"),
                "find out why before the next boards: run `wimu device params get LINK`",
            )
            .at(&name));
    }
    if !client.use_own_key()? {
        return Err(Code::KeyNeeded
            .error(
                "this computer has no key of the board",
                "copy its key here, or set one over a cable with `wimu device key set`",
            )
            .at(&name));
    }
    if !force {
        Calibration::read(&target.file)?.check_device(device_id)?;
    }
    // With a key only signed answers count.
    let id = parameter_id(&target.set);
    if client.parameters()?.id == id.0 {
        return Ok(false);
    }
    client.push_verified(&target.set)?;
    Ok(true)
}
