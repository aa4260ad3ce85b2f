//! What a page asks of a board.

use clap::Parser;
use serde::Deserialize;
use serde_json::{Value, json};
use wimu_host::allan::NoiseMeter;
use wimu_host::calibration::{CalibrateOptions, Calibration, Difference};
use wimu_host::guided::{Guided, Plan};
use wimu_host::live::LiveClient;
use wimu_host::{Input, LinkUrl, Result};
use wimu_model::{CalibrationMethod, ParameterSet};

use super::board::{Board, Feed};
use super::hub::Asker;
use super::path::Path3;
use crate::arguments::{Arguments, Change, Command, Device, Settings};
use crate::command::navigate::Beside;
use crate::command::settings;
use crate::output::usage;

/// Options of the filter of `wimu navigate`, as on the command line; empty: not given.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct Aiding {
    profile: String,
    fixes: String,
    ranges: String,
    anchors: String,
}

/// A request about one board.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
pub enum Action {
    /// Begin a guided calibration, of six sides or any orientations.
    Calibrate {
        #[serde(default)]
        six: bool,
    },
    Skip,
    Undo,
    /// Compute the result of the poses so far.
    Finish,
    More,
    WriteFile,
    /// Write the result to the board.
    Push,
    EndCalibration,
    /// Begin a recording, or end it.
    Record,
    Noise,
    EndNoise,
    Navigate(Aiding),
    EndNavigation,
    Zero,
    /// What a push of a file would change.
    Difference {
        file: String,
    },
    PushFile {
        file: String,
    },
    /// The settings, after changes with the options of `wimu device settings set`.
    Settings {
        options: Vec<String>,
    },
    Pause,
    Speed {
        value: f64,
    },
    /// Go to a time since the start of the recording, s.
    Seek {
        value: f64,
    },
    Close,
}

impl Action {
    /// Whether a recording takes it too.
    fn is_for_recordings(&self) -> bool {
        matches!(
            self,
            Self::Pause
                | Self::Speed { .. }
                | Self::Seek { .. }
                | Self::Navigate(_)
                | Self::EndNavigation
                | Self::Noise
                | Self::EndNoise
                | Self::Zero
        )
    }
}

/// What a board's thread is to do.
pub enum Job {
    Do(Action, Asker),
    /// Another link of the board.
    Join(LinkUrl, Box<LiveClient>),
}

/// What needs the clients, which the links have.
pub enum Next {
    Close,
    Join(LinkUrl, Box<LiveClient>),
    Do(Action, Asker),
}

impl Board {
    /// Does a job; returns what needs the clients.
    pub fn act(&mut self, job: Job, feed: &mut Feed) -> Option<Next> {
        let (action, asker) = match job {
            Job::Join(url, client) => return Some(Next::Join(url, client)),
            Job::Do(action, asker) => (action, asker),
        };
        match action {
            Action::Close => {
                asker.answer(Ok(()));
                return Some(Next::Close);
            }
            Action::Push | Action::PushFile { .. } | Action::Settings { .. }
                if matches!(feed, Feed::Live(_)) =>
            {
                return Some(Next::Do(action, asker));
            }
            Action::Difference { file } => {
                let held = self.held.as_ref().and_then(Option::as_ref).map(|(_, set)| set);
                asker.answer(self.parameters(&file).map(|set| Difference::of(held, &set)));
            }
            action => asker.answer(self.do_here(action, feed)),
        }
        None
    }

    /// Does what needs a client.
    pub fn exchange(&mut self, action: Action, client: &mut LiveClient) -> Result<Value> {
        match (action, &mut self.guided) {
            (Action::Settings { options }, _) => {
                let change = if options.is_empty() { None } else { Some(change(options)?) };
                Ok(json!(settings::exchange(client, change.as_ref())?))
            }
            (Action::PushFile { file }, _) => {
                let set = self.parameters(&file)?;
                Ok(json!(format!("pushed {}", wimu_host::guided::push(client, &set)?)))
            }
            (_, Some(guided)) => {
                guided.push(client);
                Ok(json!(guided.view.message))
            }
            (_, None) => Ok(json!("there is no calibration to push")),
        }
    }

    /// The parameters in a file of the folder, unless they are of another device.
    fn parameters(&self, file: &str) -> Result<ParameterSet> {
        let path = self.folder.file(file)?;
        let calibration = Calibration::read(&path)?;
        self.hello.map_or(Ok(()), |hello| calibration.check_device(hello.device_id))?;
        calibration.parameters()
    }

    fn do_here(&mut self, action: Action, feed: &mut Feed) -> Result<()> {
        if matches!(feed, Feed::Replay(_)) && !action.is_for_recordings() {
            return Err(usage("this is a recording", "connect a board"));
        }
        match action {
            Action::Calibrate { six } => self.calibrate(six)?,
            Action::EndCalibration => {
                let remark = self.guided.take().and_then(|guided| guided.end());
                self.message = remark.unwrap_or_default();
                self.publish("guided", &());
            }
            Action::Record => self.record(feed)?,
            Action::Noise => {
                let known = self.hello.is_none_or(|hello| hello.sensitivity_known);
                self.noise = Some(NoiseMeter::new(&self.name, None, known));
            }
            Action::EndNoise => self.noise = None,
            Action::Navigate(aiding) => {
                self.navigator = Some(self.navigator(&aiding)?);
                self.path = Path3::default();
            }
            Action::EndNavigation => {
                self.navigator = None;
                self.path = Path3::default();
            }
            Action::Zero => self.path.zero(),
            Action::Pause | Action::Speed { .. } => play(feed, &action)?,
            Action::Seek { .. } => {
                play(feed, &action)?;
                self.begin_again();
            }
            action => self.guide(&action)?,
        }
        Ok(())
    }

    /// A request about the guided calibration.
    fn guide(&mut self, action: &Action) -> Result<()> {
        let Some(guided) = &mut self.guided else {
            return Err(usage("there is no calibration", "start it again"));
        };
        let (has_result, usable) = (guided.view.result.is_some(), guided.view.usable);
        match action {
            Action::Skip if !has_result => guided.skip(),
            Action::Undo if !has_result => guided.undo(),
            Action::Finish if !has_result => guided.calibrate()?,
            Action::More if has_result => guided.more(),
            Action::WriteFile if usable => {
                guided.write();
                let (hub, list) = (&self.hub, self.folder.list());
                hub.publish("files", &list);
            }
            _ => {}
        }
        Ok(())
    }

    fn calibrate(&mut self, six: bool) -> Result<()> {
        let Some(hello) = &self.hello else {
            return Err(usage("the board is not known yet", "wait until it answers"));
        };
        let method =
            if six { CalibrationMethod::SixPosition } else { CalibrationMethod::MultiPosition };
        let options = CalibrateOptions {
            method,
            utc_s: crate::command::calibrate::utc_s(),
            ..CalibrateOptions::default()
        };
        let file =
            self.folder.path().join(format!("calibration-{:08x}.json", hello.device_id as u32));
        let plan = Plan::new(&options, None, hello)?;
        self.guided = Some(Guided::new(plan, hello, &self.name, &file));
        self.message = String::new();
        Ok(())
    }

    /// The filter of `wimu navigate`, with aiding from files of the folder or links.
    fn navigator(&self, aiding: &Aiding) -> Result<Beside> {
        let source = |name: &str| match Input::parse(name) {
            Ok(Input::Link(_)) => Ok(name.to_owned()),
            _ => Ok(self.folder.file(name)?.display().to_string()),
        };
        let Aiding { profile, fixes, ranges, anchors } = aiding;
        let mut words = Vec::from(["wimu", "navigate", &self.name].map(String::from));
        for (option, name) in [("fixes=", fixes), ("ranges=", ranges), ("setup=anchors=", anchors)]
        {
            if !name.is_empty() {
                words.push(format!("--{option}{}", source(name)?));
            }
        }
        if !profile.is_empty() {
            words.push(format!("--profile={profile}"));
        }
        match parsed(words)? {
            Command::Navigate(mut navigate) => {
                navigate.aids.read_setup()?;
                Beside::new(&navigate.aids, &self.name)
            }
            _ => Err(usage("no aiding", "choose a profile")),
        }
    }
}

/// A command line, as a page gives it.
fn parsed(words: Vec<String>) -> Result<Command> {
    let parsed = Arguments::try_parse_from(words).map_err(|error| {
        let text = error.to_string();
        let first = text.lines().next().unwrap_or_default().trim_start_matches("error: ");
        usage(first, "correct it on the page")
    })?;
    Ok(parsed.command)
}

fn change(options: Vec<String>) -> Result<Change> {
    let words = ["wimu", "device", "settings", "set", "auto"].map(String::from);
    match parsed([Vec::from(words), options].concat())? {
        Command::Device { action: Device::Settings { action: Settings::Set { change, .. } } } => {
            Ok(change)
        }
        _ => Err(usage("no change of settings", "reload the page")),
    }
}

fn play(feed: &mut Feed, action: &Action) -> Result<()> {
    let Feed::Replay(player) = feed else {
        return Err(usage("a board cannot be paused", "pause the page"));
    };
    match *action {
        Action::Pause => player.view.paused = !player.view.paused,
        Action::Speed { value } if (0.01..=100.0).contains(&value) => {
            player.view.speed = value;
        }
        Action::Seek { value } if value >= 0.0 => player.seek(value)?,
        _ => {
            return Err(usage(
                "this speed or time cannot be played",
                "give 0.01 to 100, or seconds",
            ));
        }
    }
    Ok(())
}
