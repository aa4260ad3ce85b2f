//! `wimu calibrate`.

mod array;
mod magnetometer;

use std::io::IsTerminal;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::mpsc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use wimu_calib::{Face, Model, Phase, Session, Term, Terms};
use wimu_host::calibration::{self, CalibrateOptions, MethodChoice, ModelChoice, Paired};
use wimu_host::client::Client;
use wimu_host::dataset::{Dataset, LoadOptions};
use wimu_host::decode::Event;
use wimu_host::history::{LinkHistory, Recording};
use wimu_host::transport::Transport;
use wimu_host::{ErrorCode, HostError, Input, Result};
use wimu_link::batch::Stream;
use wimu_link::hello::board;
use wimu_link::message::Event as Happened;
use wimu_model::{Counts, Sensitivity};

use crate::arguments::{Calibrate, Calibrated, Method};
use crate::command::{connect, connect_to_write, interrupted, not_over_input, params};
use crate::output::Output;

/// Returns the exit code: 0, or 3 when the data do not support an answer.
pub fn run(arguments: &Calibrate, output: Output) -> Result<u8> {
    if let Some(geometry) = &arguments.geometry {
        return array::run(arguments, geometry, output).map(|()| 0);
    }
    let of_arrays = [
        ("several boards", !arguments.boards.is_empty()),
        ("--place-sd", arguments.place_sd.is_some()),
        ("--delay-sd", arguments.delay_sd.is_some()),
    ];
    if let Some((what, _)) = of_arrays.into_iter().find(|(_, given)| *given) {
        return Err(HostError::new(
            ErrorCode::Usage,
            format!("{what}: for arrays only, with --geometry"),
            "give --geometry FILE, or leave it out",
        ));
    }
    only_what_counts(arguments)?;
    if arguments.sensor == Calibrated::Magnetometer {
        return magnetometer::run(arguments, output);
    }
    if arguments.method == Method::Update {
        return updated(arguments, output);
    }
    if arguments.with.is_some() {
        return Err(HostError::new(
            ErrorCode::Usage,
            "--with goes with --sensor magnetometer or --method update only",
            "leave it out, or add one of them",
        ));
    }
    if arguments.method == Method::Reference {
        return against_reference(arguments, output);
    }
    let of_reference = [
        ("--reference", arguments.reference.is_some()),
        (
            "--reference-sensitivity",
            arguments.reference_sensitivity.is_some(),
        ),
        ("--noise-ratio", arguments.noise_ratio.is_some()),
    ];
    if let Some((flag, _)) = of_reference.into_iter().find(|(_, given)| *given) {
        return Err(HostError::new(
            ErrorCode::Usage,
            format!("{flag} goes with --method reference only"),
            "leave it out, or add --method reference",
        ));
    }
    let options = options(arguments)?;
    let load = LoadOptions {
        filter: arguments.filter.as_deref().map(str::parse).transpose()?,
        accelerometer: arguments.accelerometer,
        poses: arguments.poses,
        role: arguments.link.map(Into::into),
    };
    let input = Input::parse(&arguments.input)?;
    not_over_input(Path::new(&arguments.input), arguments.output.as_deref())?;
    if arguments.push && !matches!(input, Input::Link(_)) {
        return Err(HostError::new(
            ErrorCode::Usage,
            "--push needs a LINK",
            "write the calibration with -o and push it with `wimu params push LINK CAL.json`",
        ));
    }
    let mut client = None;
    let data = match input {
        Input::Csv(path) => Dataset::from_csv(&path, &load)?,
        Input::Recording(path) => Dataset::from_recording(&path, &load)?,
        Input::Link(_) => {
            let connected = if arguments.push {
                connect_to_write(&arguments.input)
            } else {
                connect(&arguments.input)
            };
            let client = client.insert(connected?);
            collect(client, arguments, &options, output)?
        }
    };
    let report = calibration::calibrate(&data, &options)?;
    output.say(report.to_string());
    if report.exit_code() == 0
        && let Some(path) = &arguments.output
    {
        calibration::write_report(path, &report)?;
    }
    if let Some(path) = &arguments.report {
        report.page()?.write(path)?;
    }
    if report.exit_code() == 0
        && arguments.push
        && let Some(client) = &mut client
        && let Some(set) = &report.parameters
    {
        params::push(client, set, output)?;
    }
    output.object(&report);
    Ok(report.exit_code())
}

/// Refuses what the input or the method would pass over in silence.
fn only_what_counts(arguments: &Calibrate) -> Result<()> {
    let (csv, link, recording) = match Input::parse(&arguments.input) {
        Ok(Input::Csv(_)) => (true, false, false),
        Ok(Input::Link(_)) => (false, true, false),
        Ok(Input::Recording(_)) => (false, false, true),
        // What is not there is said when it is read.
        Err(_) => return Ok(()),
    };
    let known_orientations = matches!(
        arguments.method,
        Method::SixPosition | Method::FourAngle | Method::ThreeAngle
    );
    let magnetometer = arguments.sensor == Calibrated::Magnetometer;
    let passed_over = [
        ("--count", arguments.count.is_some() && !link, "a LINK only"),
        (
            "--where",
            arguments.filter.is_some() && !csv,
            "a CSV file only",
        ),
        ("--poses", arguments.poses && !csv, "a CSV file only"),
        (
            "--accelerometer",
            arguments.accelerometer.is_some() && !csv,
            "a CSV file only",
        ),
        (
            "--link",
            arguments.link.is_some() && !recording,
            "a recording only",
        ),
        (
            "--range",
            arguments.range.is_some() && !csv,
            "a CSV file only",
        ),
        (
            "--reference-sensitivity",
            arguments.reference_sensitivity.is_some() && !csv,
            "a CSV file only",
        ),
        (
            "--placement-sd",
            arguments.placement_sd.is_some() && !known_orientations,
            "--method six-position, four-angle or three-angle only",
        ),
        (
            "--dip",
            arguments.dip.is_some() && !magnetometer,
            "--sensor magnetometer only",
        ),
    ];
    match passed_over.into_iter().find(|(_, given, _)| *given) {
        Some((flag, _, what)) => Err(HostError::new(
            ErrorCode::Usage,
            format!("{flag} goes with {what}"),
            "leave it out",
        )),
        None => Ok(()),
    }
}

/// One stream against another of the same motion.
fn against_reference(arguments: &Calibrate, output: Output) -> Result<u8> {
    let others = [
        ("--model", arguments.model.is_some()),
        ("--gravity", arguments.gravity.is_some()),
        ("--poses", arguments.poses),
        ("--placement-sd", arguments.placement_sd.is_some()),
        ("--sides", arguments.sides.is_some()),
        ("--report", arguments.report.is_some()),
        ("--sensor-model", arguments.sensor_model.is_some()),
        ("--link", arguments.link.is_some()),
        ("--push", arguments.push),
    ];
    if let Some((flag, _)) = others.into_iter().find(|(_, given)| *given) {
        return Err(HostError::new(
            ErrorCode::Usage,
            format!("{flag} does not go with --method reference"),
            "leave it out; push the result with `wimu params push LINK CAL.json`",
        ));
    }
    not_over_input(Path::new(&arguments.input), arguments.output.as_deref())?;
    let worth = |lsb_per_g: Option<f64>, flag: &str| {
        let known = lsb_per_g.map(Sensitivity::from_lsb_per_g).transpose();
        known.map_err(|error| {
            HostError::new(ErrorCode::Usage, error.to_string(), format!("check {flag}"))
        })
    };
    let sensitivity = worth(arguments.sensitivity, "--sensitivity")?;
    let of_reference = worth(arguments.reference_sensitivity, "--reference-sensitivity")?;
    let data = match Input::parse(&arguments.input)? {
        Input::Csv(path) => Paired::from_csv(
            &path,
            arguments
                .filter
                .as_deref()
                .map(str::parse)
                .transpose()?
                .as_ref(),
            arguments.reference,
            arguments.accelerometer,
            sensitivity,
            of_reference,
        )?
        .at_range(arguments.range),
        Input::Recording(path) => Paired::from_recording(&Recording::load(&path)?)?,
        Input::Link(_) => {
            return Err(HostError::new(
                ErrorCode::Usage,
                "--method reference needs a recording of both links, or a CSV file",
                "record with `wimu record LINK --cable LINK -o FILE.mcap` first",
            ));
        }
    };
    let report = calibration::compare_with_reference(&data, arguments.noise_ratio, utc_s())?;
    output.say(report.to_string());
    if report.exit_code() == 0
        && let Some(path) = &arguments.output
    {
        calibration::write_report(path, &report)?;
    }
    output.object(&report);
    Ok(report.exit_code())
}

/// A stored calibration by later rests.
fn updated(arguments: &Calibrate, output: Output) -> Result<u8> {
    let others = [
        ("--model", arguments.model.is_some()),
        ("--sensitivity", arguments.sensitivity.is_some()),
        ("--sensor-model", arguments.sensor_model.is_some()),
        ("--placement-sd", arguments.placement_sd.is_some()),
        ("--sides", arguments.sides.is_some()),
        ("--reference", arguments.reference.is_some()),
        (
            "--reference-sensitivity",
            arguments.reference_sensitivity.is_some(),
        ),
        ("--noise-ratio", arguments.noise_ratio.is_some()),
        ("--range", arguments.range.is_some()),
        ("--report", arguments.report.is_some()),
        ("--push", arguments.push),
    ];
    if let Some((flag, _)) = others.into_iter().find(|(_, given)| *given) {
        return Err(HostError::new(
            ErrorCode::Usage,
            format!("{flag} does not go with --method update"),
            "leave it out; push the result with `wimu params push LINK CAL.json`",
        ));
    }
    not_over_input(Path::new(&arguments.input), arguments.output.as_deref())?;
    let given = arguments
        .with
        .as_deref()
        .map(calibration::read_parameters)
        .transpose()?;
    let load = LoadOptions {
        filter: arguments.filter.as_deref().map(str::parse).transpose()?,
        accelerometer: arguments.accelerometer,
        poses: arguments.poses,
        role: arguments.link.map(Into::into),
    };
    let (data, recorded) = match Input::parse(&arguments.input)? {
        Input::Csv(path) => (Dataset::from_csv(&path, &load)?, None),
        Input::Recording(path) => {
            let recording = Recording::load(&path)?;
            let link = recording.link(load.role)?;
            (
                Dataset::from_link(link, &recording.name)?,
                link.last_parameters()?,
            )
        }
        Input::Link(_) => {
            return Err(HostError::new(
                ErrorCode::Usage,
                "--method update needs a recording or a CSV file",
                "record with `wimu record LINK -o FILE.mcap` first",
            ));
        }
    };
    let stored = given.or(recorded).ok_or_else(|| {
        HostError::new(
            ErrorCode::Usage,
            "there is no calibration to update",
            "give it with --with CAL.json",
        )
    })?;
    let report = calibration::update(&data, &stored, arguments.gravity, utc_s())?;
    output.say(report.to_string());
    if report.exit_code() == 0
        && let Some(path) = &arguments.output
    {
        calibration::write_report(path, &report)?;
    }
    output.object(&report);
    Ok(report.exit_code())
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
    let usage = |message: String, remedy: &str| HostError::new(ErrorCode::Usage, message, remedy);
    let text = arguments.model.as_deref().unwrap_or_default();
    let mut parts = text.split('+');
    let base = parts.next().unwrap_or_default();
    let mut terms = Terms::NONE;
    for part in parts {
        terms = match part {
            "drift" => terms.with(Term::Drift),
            "temperature" => terms
                .with(Term::BiasTemperature)
                .with(Term::ScaleTemperature),
            "quadratic" => terms.with(Term::Quadratic),
            other => {
                return Err(usage(
                    format!("--model {text}: there is no term {other:?}"),
                    "the terms are drift, temperature and quadratic, as in 9+drift",
                ));
            }
        };
    }
    let multi = method == MethodChoice::MultiPosition;
    let model = match (base, method) {
        ("", _) => ModelChoice::default(),
        ("9", MethodChoice::MultiPosition) => ModelChoice::Fixed(Model::Full9),
        ("6", MethodChoice::MultiPosition) => ModelChoice::Fixed(Model::BiasScale6),
        ("3", MethodChoice::MultiPosition) => ModelChoice::Fixed(Model::Bias3),
        ("auto", MethodChoice::MultiPosition) => ModelChoice::Auto,
        ("12", MethodChoice::SixPosition)
        | ("6", MethodChoice::FourAngle | MethodChoice::ThreeAngle) => ModelChoice::default(),
        _ => {
            return Err(usage(
                format!("--model {text} does not go with --method {}", method.name()),
                "multi-position has 3, 6, 9 or auto, six-position 12, four-angle and three-angle 6",
            ));
        }
    };
    if terms != Terms::NONE && !multi {
        return Err(usage(
            format!("--model {text}: only multi-position has terms"),
            "leave the term out, or use --method multi-position",
        ));
    }
    let sides = match &arguments.sides {
        Some(_) if method != MethodChoice::SixPosition => {
            return Err(usage(
                "--sides goes with --method six-position only".to_owned(),
                "leave it out",
            ));
        }
        Some(text) => Some(text.split(',').map(side).collect::<Result<Vec<_>>>()?),
        None => None,
    };
    Ok(CalibrateOptions {
        method,
        model,
        terms,
        sides,
        gravity_mps2: arguments.gravity,
        sensitivity_lsb_per_g: arguments.sensitivity,
        range_g: arguments.range,
        placement_sd_deg: arguments.placement_sd,
        datasheet: arguments
            .sensor_model
            .as_deref()
            .map(calibration::datasheet)
            .transpose()?,
        utc_s: utc_s(),
    })
}

fn side(text: &str) -> Result<Face> {
    let text = text.trim().to_ascii_lowercase();
    let (sign, axis) = match text.strip_prefix('-') {
        Some(axis) => (1, axis),
        None => (0, text.strip_prefix('+').unwrap_or(&text)),
    };
    ["x", "y", "z"]
        .iter()
        .position(|name| *name == axis)
        .map(|axis| Face::ALL[2 * axis + sign])
        .ok_or_else(|| {
            HostError::new(
                ErrorCode::Usage,
                format!("--sides: {text:?} is no side"),
                "the sides that are up are x, -x, y, -y, z and -z, separated by commas",
            )
        })
}

/// Most poses of a live calibration.
const ROOM: usize = 64;
/// Poses of a live calibration where nothing is said.
const POSES: usize = 12;

/// Tells of every `s` that a person enters; of none where nobody sits at a terminal.
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

/// Collects a live board's samples until enough poses were held, or Ctrl-C.
fn collect<T: Transport>(
    client: &mut Client<T>,
    arguments: &Calibrate,
    options: &CalibrateOptions,
    output: Output,
) -> Result<Dataset> {
    let six = arguments.method == Method::SixPosition;
    let count = arguments.count.unwrap_or(POSES);
    let fewest = match options.model {
        ModelChoice::Fixed(model) => model.parameters() + 1,
        ModelChoice::Auto => Model::Bias3.parameters() + 1,
    };
    if count > ROOM {
        return Err(HostError::new(
            ErrorCode::Usage,
            format!("--count {count} is more than {ROOM} poses"),
            "twelve to twenty are enough",
        ));
    }
    if !six && count < fewest {
        return Err(HostError::new(
            ErrorCode::Usage,
            format!("--count {count} poses do not suffice"),
            format!("give {fewest} or more, or a smaller --model"),
        ));
    }
    output.say(if six {
        "hold the board still with each of its six sides up, in any order; its button takes a side at \
         once"
            .to_owned()
    } else {
        format!(
            "hold the board still in {count} orientations, as advised or as different as you can; \
             Ctrl-C ends early, the board's button, or s and Enter, skips what cannot be reached"
        )
    });
    let stop = interrupted()?;
    let skips = skips();
    let wanted = if six { ROOM } else { count };
    let model = match options.model {
        ModelChoice::Fixed(model) => model,
        ModelChoice::Auto => Model::Full9,
    };
    let mut record = LinkHistory::new(client.hello().role);
    let mut live: Option<Live> = None;
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
                    let live = live.insert(Live {
                        session: Session::new(rate_hz, model, wanted),
                        sensitivity,
                        wanted,
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
                    live.go_on();
                }
            }
            _ => {}
        }
    }
    Dataset::from_link(&record, client.name())
}

/// What is up, in the order of [`Face::ALL`]: as one sees it on a board whose sides are known.
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

/// A live calibration: what a person who turns the board is told.
struct Live {
    session: Session<ROOM>,
    sensitivity: Sensitivity,
    /// So many poses are enough, unless sides are to be up.
    wanted: usize,
    /// The board's sides, as one sees them.
    names: &'static [&'static str; 6],
    /// Of the six-position method: the sides that have been up.
    sides: Option<Vec<Face>>,
    output: Output,
}

impl Live {
    /// Takes a raw sample.
    fn push(&mut self, counts: [i32; 3]) {
        let counts = Counts(counts.map(|axis| axis as i16));
        let output = self.sensitivity.to_mps2(counts);
        if let Phase::Captured { pose } = self.session.push(output.0) {
            self.captured(pose);
        }
    }

    /// The board's button: takes the pose that is held, or skips the one that is advised.
    fn go_on(&mut self) {
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
        self.output.say(match side {
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
                    self.output
                        .say(format!("still to come: {}", left.join("; ")));
                }
            }
            None => {
                if let Some(next) = self.session.next() {
                    let how = next.instruction_with(self.names);
                    self.output.say(format!("next, for example: {how}"));
                }
            }
        }
    }

    fn name(&self, side: Face) -> &'static str {
        let place = Face::ALL.iter().position(|other| *other == side);
        place
            .and_then(|place| self.names.get(place))
            .copied()
            .unwrap_or_default()
    }

    /// Whether there are poses enough, or no room for more.
    fn is_complete(&self) -> bool {
        let all = match &self.sides {
            Some(sides) => sides.len() == Face::ALL.len(),
            None => self.session.poses().len() >= self.wanted,
        };
        all || self.session.poses().len() == ROOM
    }
}

#[cfg(test)]
mod tests {
    use wimu_calib::Orientation;

    use super::*;

    #[test]
    fn the_sides_of_a_microbit_are_called_what_one_sees() {
        let told = |board, side: Face| {
            let names = side_names(board);
            Orientation::from(side).instruction_with(names).to_string()
        };
        let microbit = |side| told(board::MICROBIT_V2, side);
        assert_eq!(microbit(Face::ZUp), "hold it with display up");
        assert_eq!(microbit(Face::XDown), "hold it with logo down");
        assert_eq!(microbit(Face::YUp), "hold it with button A up");
        assert_eq!(told(0, Face::YUp), "hold it with Y up");
    }
}
