//! Calibrations for a fleet in stages: one board, then 10 %, then all; stops at the first disagreement, and resumes.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde::{Deserialize, Serialize};
use wimu_link::message::parameter_id;
use wimu_model::ParameterSet;

use super::status::FleetStatus;
use super::topics::{Fleet, Name};
use crate::calibration::read_parameters;
use crate::client;
use crate::keys::KeyFolder;
use crate::{ErrorCode, HostError, LinkUrl, OutputFile, Result};

const SCHEMA: &str = "wimu.fleet-push/1";
/// Fraction of the boards after the second stage.
const SECOND: f64 = 0.1;

/// What a push has done so far, kept in a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Rollout {
    /// `wimu.fleet-push/1`.
    pub schema: String,
    /// Name of the fleet.
    pub fleet: String,
    /// The parameters that each board has confirmed.
    pub done: BTreeMap<String, String>,
    /// The board that disagreed last, and how.
    pub stopped: Option<(String, String)>,
}

/// A board and its calibration.
#[derive(Clone, Debug)]
pub struct Target {
    /// Its name.
    pub board: Name,
    /// Device id that the fleet's state names.
    pub device_id: Option<String>,
    /// Its calibration.
    pub set: ParameterSet,
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
    /// `file_unreadable` without the folder; those of [`read_parameters`], before anything is pushed.
    pub fn new(status: &FleetStatus, folder: &Path) -> Result<Self> {
        let mut plan = Self::default();
        let mut unused = calibrations(folder)?;
        for (board, state) in &status.boards {
            let names = [Some(board.as_str()), state.device_id.as_deref()];
            let names = names.map(|name| name.map(|name| format!("{name}.json")));
            let file = names.iter().flatten().find(|name| unused.remove(*name));
            let Some(file) = file.map(|name| folder.join(name)) else {
                plan.without_file.push(board.clone());
                continue;
            };
            let Some(name) = board.parse().ok().filter(|_| state.alive) else {
                plan.away.push(board.clone());
                continue;
            };
            let set = read_parameters(&file)?;
            plan.targets.push(Target {
                board: name,
                device_id: state.device_id.clone(),
                set,
            });
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
        std::fs::read_dir(folder).map_err(|error| HostError::file(&name, "open", &error))?;
    let names = entries.flatten().map(|entry| entry.file_name());
    Ok(names
        .filter_map(|name| name.into_string().ok())
        .filter(|name| name.ends_with(".json"))
        .collect())
}

impl Rollout {
    /// What the file says, or nothing if there is none.
    ///
    /// # Errors
    /// `file_unreadable`; `usage` when it is no such file, or of another fleet.
    pub fn read(path: &Path, fleet: &Fleet) -> Result<Self> {
        let name = path.display().to_string();
        let text = match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Ok(Self {
                    schema: SCHEMA.to_owned(),
                    fleet: fleet.fleet.to_string(),
                    done: BTreeMap::new(),
                    stopped: None,
                });
            }
            Err(error) => return Err(HostError::file(&name, "read", &error)),
        };
        let other = |why: String| {
            ErrorCode::Usage
                .error(why, "name another file with --state")
                .at(&name)
        };
        let found: Self = serde_json::from_str(&text)
            .map_err(|error| other(format!("no state of a fleet push: {error}")))?;
        match found.schema == SCHEMA && found.fleet == fleet.fleet.as_str() {
            true => Ok(found),
            false => Err(other(format!("it is of fleet `{}`", found.fleet))),
        }
    }

    /// Pushes to the boards in order until `until` of them are done; `report` gets each board with its id, and whether it
    /// was written now. The file is written after each board.
    ///
    /// # Errors
    /// The first disagreement: a board that is away, refuses, or confirms other parameters. It is in the file, too.
    pub fn push(
        &mut self,
        fleet: &Fleet,
        targets: &[Target],
        until: usize,
        file: &Path,
        mut report: impl FnMut(&Name, &str, bool),
    ) -> Result<()> {
        for target in targets.iter().take(until) {
            let id = parameter_id(&target.set).to_string();
            if self.done.get(target.board.as_str()) == Some(&id) {
                continue;
            }
            match push(fleet, target) {
                Ok(written) => {
                    self.done.insert(target.board.to_string(), id.clone());
                    self.stopped = None;
                    self.write(file)?;
                    report(&target.board, &id, written);
                }
                Err(error) => {
                    self.stopped = Some((target.board.to_string(), error.to_string()));
                    self.write(file)?;
                    return Err(error);
                }
            }
        }
        Ok(())
    }

    fn write(&self, file: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).unwrap_or_default();
        OutputFile::write(file, &(text + "\n"))
    }
}

/// Pushes a calibration and compares what the board then holds; returns whether it was written.
fn push(fleet: &Fleet, target: &Target) -> Result<bool> {
    let link = LinkUrl::Mqtt {
        broker: fleet.broker.clone(),
        fleet: fleet.fleet.clone(),
        board: target.board.clone(),
    };
    let mut client = client::connect(&link)?;
    let name = link.to_string();
    let device_id = format!("{:016x}", client.hello().device_id);
    let disagrees = |message: String| {
        (ErrorCode::VerifyFailed.error(
            message,
            "find out why before the next boards: run `wimu params get LINK`",
        ))
        .at(&name)
    };
    if target
        .device_id
        .as_ref()
        .is_some_and(|known| *known != device_id)
    {
        return Err(disagrees(format!(
            "device {device_id} answers, the fleet's state names another one"
        )));
    }
    let keys = KeyFolder::of_user()?.candidates(client.hello().device_id)?;
    if !client.use_key_among(&keys)? {
        return Err(ErrorCode::KeyNeeded
            .error(
                "this computer has no key of the board",
                "copy its key here, or set one over a cable with `wimu key set`",
            )
            .at(&name));
    }
    let id = parameter_id(&target.set);
    let written = client.parameters()?.id != id.0;
    if written {
        client.push_parameters(&target.set)?;
    }
    let held = client.parameters()?.id;
    match held == id.0 {
        true => Ok(written),
        false => Err(disagrees(format!(
            "the board holds {held:08x} instead of the pushed {id}"
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stages_are_one_board_a_tenth_and_all() {
        let stages = |boards: usize| {
            let target = || Target {
                board: "a".parse().unwrap(),
                device_id: None,
                set: set(),
            };
            Plan {
                targets: (0..boards).map(|_| target()).collect(),
                ..Plan::default()
            }
            .stages()
        };
        assert_eq!(stages(0), [0, 0, 0]);
        assert_eq!(stages(5), [1, 1, 5]);
        assert_eq!(stages(200), [1, 20, 200]);
        assert_eq!(stages(1001), [1, 101, 1001]);
    }

    fn set() -> ParameterSet {
        use wimu_model::Sensitivity;
        ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16_384.0).unwrap())
    }
}
