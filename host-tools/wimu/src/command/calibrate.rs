//! `wimu calibrate`.

mod array;
mod magnetometer;

use std::fmt::Display;
use std::io::IsTerminal;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::mpsc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::Serialize;
use wimu_calib::{Face, Model, Phase, Session};
use wimu_host::calibration::{
    self, CalibrateOptions, CalibrationFile, MethodChoice, ModelChoice, Paired,
};
use wimu_host::decode::Event;
use wimu_host::finding::Outcome;
use wimu_host::formats::{self, ReadOptions};
use wimu_host::history::{self, LinkHistory};
use wimu_host::recording::{Recording, Selection};
use wimu_host::{Input, Result};
use wimu_link::batch::Stream;
use wimu_link::hello::board;
use wimu_link::message::Event as Happened;
use wimu_model::{ParameterSet, Sensitivity};

use crate::arguments::{Calibrate, Calibrated, Method};
use crate::command::{Connection, connect_for, interrupted, not_over_input, params};
use crate::output::{Output, usage};

/// Returns the exit code: 0, or 3 if the data do not support an answer.
pub fn run(arguments: &Calibrate, output: Output) -> Result<u8> {
    not_over_input(Path::new(&arguments.input), arguments.output.as_deref())?;
    for file in &arguments.more {
        not_over_input(file, arguments.output.as_deref())?;
    }
    match (&arguments.geometry, arguments.sensor, arguments.method) {
        (Some(geometry), ..) => array::run(arguments, geometry, output).map(|()| 0),
        (_, Calibrated::Magnetometer, _) => magnetometer::run(arguments, output),
        (_, _, Method::Update) => update(arguments, output),
        (_, _, Method::Reference) => against_reference(arguments, output),
        _ if !arguments.more.is_empty() => several(arguments, output),
        _ => with_gravity(arguments, output),
    }
}

/// Prints a report with this outcome, writes the calibration to `path` if there is one, and does the rest. Returns the
/// exit code.
pub fn finish<R: Display + Serialize>(
    report: &R,
    outcome: &Outcome,
    path: Option<&Path>,
    file: Option<CalibrationFile>,
    output: Output,
    rest: impl FnOnce() -> Result<()>,
) -> Result<u8> {
    output.print(report.to_string());
    output.findings(&outcome.findings);
    let exit_code = outcome.exit_code();
    if let (0, Some(path), Some(file)) = (exit_code, path, file) {
        file.write(path)?;
    }
    rest()?;
    output.object(report);
    Ok(exit_code)
}

/// Reads the samples of `input` and the calibration that belongs to them: `given`, else that of the recording or of the
/// device. `checked` refuses a calibration that does not serve, before `listen` collects the samples of a LINK.
pub fn read_calibrated(
    input: &str,
    load: &ReadOptions,
    given: Option<&Path>,
    push: bool,
    checked: impl Fn(Option<ParameterSet>) -> Result<ParameterSet>,
    listen: impl FnOnce(&mut Connection, &ParameterSet) -> Result<Recording>,
) -> Result<(Recording, ParameterSet, Option<Connection>)> {
    let mut load = load.clone();
    load.stored_zero_count = given.and_then(calibration::zero_count);
    let given = given.map(calibration::read_parameters).transpose()?;
    match Input::parse(input)? {
        Input::File(path) => Ok((formats::load(&path, &load)?, checked(given)?, None)),
        Input::Recording(path) => {
            let recording = history::Recording::load(&path)?;
            let link = recording.link(load.role)?;
            let data = Recording::of_link(link, &recording.name)?;
            let set = given.map_or_else(|| link.last_parameters(), |set| Ok(Some(set)))?;
            Ok((data, checked(set)?, None))
        }
        Input::Link(_) => {
            let mut client = connect_for(input, push)?;
            let set = given.map_or_else(|| params::held(&mut client), |set| Ok(Some(set)))?;
            let set = checked(set)?;
            Ok((listen(&mut client, &set)?, set, Some(client)))
        }
    }
}

/// How to read the input, and which of its samples.
fn reading(arguments: &Calibrate) -> (ReadOptions, Selection) {
    let selection = Selection {
        accelerometer: arguments.accelerometer,
        poses: arguments.poses,
    };
    (arguments.reading.options(arguments.poses), selection)
}

/// Calibrates with poses, by the magnitude or the direction of gravity.
fn with_gravity(arguments: &Calibrate, output: Output) -> Result<u8> {
    let options = options(arguments)?;
    let (load, selection) = reading(arguments);
    let mut client = None;
    let data = match Input::parse(&arguments.input)? {
        Input::File(path) | Input::Recording(path) => formats::load(&path, &load)?,
        Input::Link(_) => {
            let client = client.insert(connect_for(&arguments.input, arguments.push)?);
            collect(client, arguments, &options, output)?
        }
    };
    let report = calibration::calibrate(&data.samples(selection)?, &options)?;
    let (path, file) = (arguments.output.as_deref(), report.file.clone());
    finish(&report, &report.outcome, path, file, output, || {
        if let Some(path) = &arguments.report {
            report.page()?.write(path)?;
        }
        match (&mut client, &report.parameters) {
            (Some(client), Some(set)) if arguments.push => params::push(client, set, output),
            _ => Ok(()),
        }
    })
}

/// Calibrates with several sessions of one sensor.
fn several(arguments: &Calibrate, output: Output) -> Result<u8> {
    let options = options(arguments)?;
    let (load, selection) = reading(arguments);
    let first = Path::new(&arguments.input);
    let files = std::iter::once(first).chain(arguments.more.iter().map(AsRef::as_ref));
    let sessions: Vec<Recording> = files
        .map(|file| formats::load(file, &load))
        .collect::<Result<_>>()?;
    let data: Vec<_> = sessions
        .iter()
        .map(|session| session.samples(selection))
        .collect::<Result<_>>()?;
    let report = calibration::calibrate_several(&data, &options)?;
    let (path, file) = (arguments.output.as_deref(), report.file.clone());
    finish(&report, &report.outcome, path, file, output, || Ok(()))
}

/// Calibrates one stream with another of the same motion.
fn against_reference(arguments: &Calibrate, output: Output) -> Result<u8> {
    let sensitivity = arguments.sensitivity.map(Sensitivity::from_lsb_per_g);
    let sensitivity = sensitivity
        .transpose()
        .map_err(|error| usage(error.to_string(), "check --sensitivity"))?;
    let data = match Input::parse(&arguments.input)? {
        Input::File(path) => Paired::of_recording(
            &formats::load(&path, &reading(arguments).0)?,
            [arguments.reference, arguments.accelerometer],
            sensitivity,
            arguments.reference_sensitivity,
        )?
        .at_range(arguments.range),
        Input::Recording(path) => Paired::of_links(&history::Recording::load(&path)?)?,
        Input::Link(_) => {
            return Err(usage(
                "--method reference needs a recording of both links, or a CSV file",
                "record with `wimu record LINK --cable LINK -o FILE.mcap` first",
            ));
        }
    };
    let report = calibration::compare_with_reference(&data, arguments.noise_ratio, utc_s())?;
    let (path, file) = (arguments.output.as_deref(), report.file.clone());
    finish(&report, &report.outcome, path, file, output, || Ok(()))
}

/// Checks and updates a stored calibration with later rests.
fn update(arguments: &Calibrate, output: Output) -> Result<u8> {
    let not_live = || {
        usage(
            "--method update needs a recording or a CSV file",
            "record with `wimu record LINK -o FILE.mcap` first",
        )
    };
    if let Ok(Input::Link(_)) = Input::parse(&arguments.input) {
        return Err(not_live());
    }
    let checked = |set: Option<_>| {
        set.ok_or_else(|| usage("there is no calibration to update", "add --with CAL.json"))
    };
    let (load, selection) = reading(arguments);
    let (data, stored, _) = read_calibrated(
        &arguments.input,
        &load,
        arguments.with.as_deref(),
        false,
        checked,
        |_, _| Err(not_live()),
    )?;
    let report = calibration::update(
        &data.samples(selection)?,
        &stored,
        arguments.gravity,
        utc_s(),
    )?;
    let with = arguments.with.as_deref();
    let file = |set| CalibrationFile::after(with, &stored, set, &report.source);
    let file = report.parameters.as_ref().map(file);
    let path = arguments.output.as_deref();
    finish(&report, &report.outcome, path, file, output, || Ok(()))
}

/// Now, s since 1970 UTC.
fn utc_s() -> Option<u64> {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.ok().map(|since| since.as_secs())
}

fn options(arguments: &Calibrate) -> Result<CalibrateOptions> {
    let method = match arguments.method {
        Method::SixPosition => MethodChoice::SixPosition,
        Method::FourAngle => MethodChoice::FourAngle,
        Method::ThreeAngle => MethodChoice::ThreeAngle,
        Method::MultiPosition | Method::Reference | Method::Update => MethodChoice::MultiPosition,
    };
    let text = arguments.model.as_deref().unwrap_or_default();
    let (model, terms) = calibration::parse_model(text, method)?;
    let datasheet = arguments.sensor_model.as_deref();
    Ok(CalibrateOptions {
        method,
        model,
        terms,
        sides: arguments.sides.clone(),
        gravity_mps2: arguments.gravity,
        place: arguments
            .latitude
            .map(|latitude| [latitude, arguments.height]),
        sensitivity_lsb_per_g: arguments.sensitivity,
        range_g: arguments.range,
        placement_sd_deg: arguments.placement_sd,
        datasheet: datasheet.map(calibration::datasheet).transpose()?,
        utc_s: utc_s(),
    })
}

/// Capacity of a live calibration, poses.
const CAPACITY: usize = 64;
/// Default number of poses of a live calibration.
const POSES: usize = 12;

/// A message for each line `s` that is entered; none if stdin is no terminal.
fn skips() -> mpsc::Receiver<()> {
    let (sender, receiver) = mpsc::channel();
    if std::io::stdin().is_terminal() {
        std::thread::spawn(move || {
            for line in std::io::stdin().lines().map_while(std::result::Result::ok) {
                if line.trim() == "s" && sender.send(()).is_err() {
                    return;
                }
            }
        });
    }
    receiver
}

/// Collects a live board's samples until enough poses were captured, or Ctrl-C.
fn collect(
    client: &mut Connection,
    arguments: &Calibrate,
    options: &CalibrateOptions,
    output: Output,
) -> Result<Recording> {
    let six = arguments.method == Method::SixPosition;
    let count = arguments.count.map_or(POSES, usize::from);
    let fewest = match options.model {
        ModelChoice::Fixed(model) => model.parameters() + 1,
        ModelChoice::Auto => Model::Bias3.parameters() + 1,
    };
    if !six && count < fewest {
        return Err(usage(
            format!("--count {count} is too small for this model"),
            format!("give {fewest} or more, or a smaller --model"),
        ));
    }
    output.print(if six {
        "hold the board still with each of its six sides up, in any order; the board's button \
         captures a side at once"
            .to_owned()
    } else {
        format!(
            "hold the board still in {count} different orientations; the board's button, or s and Enter, \
             skips a suggested one; Ctrl-C stops early"
        )
    });
    let stop = interrupted()?;
    let skips = skips();
    let needed = if six { CAPACITY } else { count };
    let model = match options.model {
        ModelChoice::Fixed(model) => model,
        ModelChoice::Auto => Model::Full9,
    };
    let mut record = LinkHistory::new(client.hello().role);
    let mut live: Option<LivePoses> = None;
    while !stop.load(Ordering::Relaxed) {
        while skips.try_recv().is_ok() {
            if let Some(live) = &mut live {
                live.skip();
            }
        }
        let Some(arrival) = client.next_event(Duration::from_millis(100))? else {
            continue;
        };
        record.take(&arrival);
        match &arrival.event {
            Event::Epoch { epoch, .. } if live.is_none() => {
                let rate_hz = 1e9 / f64::from(epoch.period_ns.max(1));
                if let Ok(sensitivity) = Sensitivity::from_lsb_per_g(epoch.sensitivity_lsb_per_g) {
                    let live = live.insert(LivePoses {
                        session: Session::new(rate_hz, model, needed),
                        sensitivity,
                        needed,
                        names: side_names(client.hello().board.number),
                        sides: six.then(Vec::new),
                        output,
                    });
                    live.advise();
                }
            }
            Event::Samples(samples) if samples.stream == Stream::Raw => {
                let Some(live) = &mut live else {
                    continue;
                };
                samples.iter().for_each(|sample| live.push(sample.value));
                if live.is_complete() {
                    break;
                }
            }
            Event::Device {
                event: Happened::Marked { .. },
                ..
            } => {
                if let Some(live) = &mut live {
                    live.press();
                }
            }
            _ => {}
        }
    }
    Recording::of_link(&record, client.name())
}

/// Names of the sides that are up, in the order of [`Face::ALL`], as printed on boards whose layout is known.
fn side_names(board: u16) -> &'static [&'static str; 6] {
    match board {
        board::MICROBIT_V2 => &[
            "logo up",
            "logo down",
            "button A up",
            "button A down",
            "display up",
            "display down",
        ],
        _ => &Face::NAMES,
    }
}

/// Instructions of a live calibration.
struct LivePoses {
    session: Session<CAPACITY>,
    sensitivity: Sensitivity,
    /// Number of poses to capture, if `sides` is `None`.
    needed: usize,
    names: &'static [&'static str; 6],
    /// For the six-position method: the sides captured.
    sides: Option<Vec<Face>>,
    output: Output,
}

impl LivePoses {
    /// Takes a raw sample.
    fn push(&mut self, counts: [i32; 3]) {
        let scale = self.sensitivity.mps2_per_lsb();
        let output = counts.map(|axis| f64::from(axis) * scale);
        if let Phase::Captured { pose } = self.session.push(output) {
            self.captured(pose);
        }
    }

    /// The board's button captures the pose that is held, or skips the suggested one.
    fn press(&mut self) {
        match self.session.capture() {
            Some(pose) => self.captured(pose),
            None => self.skip(),
        }
    }

    fn skip(&mut self) {
        self.session.skip();
        self.advise();
    }

    fn captured(&mut self, pose: usize) {
        let side = self.session.poses().get(pose).and_then(Face::of);
        self.output.print(match side {
            Some(side) => format!("pose {} captured: {}", pose + 1, self.name(side)),
            None => format!("pose {} captured", pose + 1),
        });
        if let (Some(sides), Some(side)) = (&mut self.sides, side)
            && !sides.contains(&side)
        {
            sides.push(side);
        }
        self.advise();
    }

    fn advise(&self) {
        match &self.sides {
            Some(sides) => {
                let left = Face::ALL.iter().filter(|side| !sides.contains(side));
                let left: Vec<_> = left.map(|side| self.name(*side)).collect();
                if !left.is_empty() {
                    self.output.print(format!("remaining: {}", left.join("; ")));
                }
            }
            None => {
                if let Some(next) = self.session.next() {
                    let how = next.instruction_with(self.names);
                    self.output.print(format!("suggested next: {how}"));
                }
            }
        }
    }

    fn name(&self, side: Face) -> &'static str {
        let all = Face::ALL.iter().zip(self.names);
        let mut named = all.filter(|(other, _)| **other == side);
        named.next().map_or("", |(_, name)| name)
    }

    /// Whether all poses were captured.
    fn is_complete(&self) -> bool {
        let all = match &self.sides {
            Some(sides) => sides.len() == Face::ALL.len(),
            None => self.session.poses().len() >= self.needed,
        };
        all || self.session.poses().len() == CAPACITY
    }
}

#[cfg(test)]
mod tests {
    use wimu_calib::Orientation;

    use super::*;

    #[test]
    fn the_sides_of_a_microbit_have_the_names_of_its_parts() {
        let instruction = |board, side: Face| {
            let names = side_names(board);
            Orientation::from(side).instruction_with(names).to_string()
        };
        let microbit = |side| instruction(board::MICROBIT_V2, side);
        assert_eq!(microbit(Face::ZUp), "hold it with display up");
        assert_eq!(microbit(Face::XDown), "hold it with logo down");
        assert_eq!(microbit(Face::YUp), "hold it with button A up");
        assert_eq!(instruction(0, Face::YUp), "hold it with Y up");
    }
}
