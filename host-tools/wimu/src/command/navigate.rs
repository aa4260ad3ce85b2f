//! `wimu navigate`.

mod array;
mod inertial;
mod live;
mod ranges;
mod relative;
mod shown;

pub use live::Beside;

use serde::Serialize;
use wimu_host::calibration::{Calibration, SensorCalibration};
use wimu_host::capture::{Boot, Capture, Link};
use wimu_host::digits::{signed, significant};
use wimu_host::inertial::InertialPath;
use wimu_host::navigation::{self, Point};
use wimu_host::plural::counted;
use wimu_host::replay::{self, ReplayReport};
use wimu_host::{Code, Input, Result};
use wimu_integrator::Phase;
use wimu_model::ParameterSet;

use crate::arguments::{MotionProfile, Navigate, SETUP_EXAMPLE, ZeroVelocity};
use crate::output::{Output, usage};

#[derive(Serialize)]
struct Navigated {
    source: String,
    link: String,
    /// One entry for each start of the device.
    starts: Vec<Start>,
    /// Path of the longest start with its uncertainty; null if there is none.
    path: Option<InertialPath>,
}

#[derive(Serialize)]
struct Start {
    device: Option<Track>,
    recomputed: Option<Track>,
    /// Bit-exact comparison of the recomputed values with the device's; null with other parameters or settings than
    /// the device's.
    replay: Option<ReplayReport>,
}

impl Start {
    fn print(&self, output: &Output) {
        match &self.device {
            Some(track) => output.print(format!("computed on the board: {}", track.text())),
            None => output.print("computed on the board: no position sent, or no rest detected"),
        }
        match &self.recomputed {
            Some(track) => output.print(format!("recomputed on the host: {}", track.text())),
            None => output.print("recomputed on the host: no rest detected"),
        }
        if let (Some(_), Some(replay)) = (&self.recomputed, &self.replay) {
            output.print(replay_text(replay));
        }
    }
}

#[derive(Serialize)]
struct Track {
    duration_s: f64,
    distance_m: f64,
    final_position_m: [f64; 3],
    final_velocity_m_s: [f64; 3],
    legs: usize,
    since_rest_s: f64,
    valid: bool,
}

impl Track {
    fn of(points: &[Point]) -> Option<Self> {
        let first = points.iter().find(|point| point.navigation.phase != Phase::Searching)?;
        let last = points.last()?;
        let moving = |point: &Point| point.navigation.phase == Phase::Moving;
        let starts = points.windows(2).filter(|pair| !moving(&pair[0]) && moving(&pair[1]));
        Some(Self {
            duration_s: last.time.to_seconds() - first.time.to_seconds(),
            distance_m: navigation::path_length_m(points),
            final_position_m: last.navigation.position.to_m(),
            final_velocity_m_s: last.navigation.velocity.to_mps(),
            legs: starts.count(),
            since_rest_s: f64::from(last.navigation.since_rest_ms) / 1000.0,
            valid: last.navigation.flags.is_valid(),
        })
    }

    fn text(&self) -> String {
        let [e, n, u] = self.final_position_m.map(|axis| signed(to_tenth_mm(axis), 3));
        format!(
            "{:.1} s, {}, path {} m, ends at E {e} N {n} U {u} m{}",
            self.duration_s,
            counted(self.legs, "leg"),
            significant(to_tenth_mm(self.distance_m), 3),
            if self.valid {
                String::new()
            } else {
                format!(
                    "; not valid at the end, {} s after the last rest",
                    significant(self.since_rest_s, 3)
                )
            }
        )
    }
}

/// Rounded to 0.1 mm, without a negative zero.
fn to_tenth_mm(m: f64) -> f64 {
    (m * 1e4).round() / 1e4 + 0.0
}

pub fn run(arguments: &Navigate, output: &Output) -> Result<()> {
    if arguments.print_setup {
        output.print(SETUP_EXAMPLE.trim_end());
        return Ok(());
    }
    let input = arguments.input.to_string_lossy();
    if !arguments.relative
        && let Ok(Input::Link(link)) = Input::parse(&input)
    {
        return live::run(arguments, &link.to_string(), output);
    }
    if arguments.relative {
        return relative::run(arguments, output);
    }
    if arguments.with.len() > 1 && arguments.aids.setup.geometry.is_none() {
        return Err(usage(
            "--with was given more than once for a single sensor",
            "give one, or `--setup geometry=FILE`",
        ));
    }
    let in_vehicle = arguments.aids.profile == MotionProfile::Vehicle;
    if arguments.odometry.is_some() && arguments.aids.setup.anchors.is_none() && !in_vehicle {
        let remedy = "add `--profile vehicle`, or ranges with `--setup anchors=FILE`";
        return Err(usage("--odometry goes with a vehicle or with ranges", remedy));
    }
    if let Some(anchors) = &arguments.aids.setup.anchors {
        return ranges::run(arguments, anchors, output);
    }
    let is_of_wimu = matches!(Input::parse(&input), Ok(Input::Recording(_)));
    if !is_of_wimu || arguments.aids.setup.geometry.is_some() {
        return inertial::run(arguments, output);
    }
    let recording = Capture::load(&arguments.input)?;
    let link = recording.link(arguments.reading.role())?;
    let calibration = arguments.with.first();
    let calibration = calibration.map(|file| Calibration::read(file)).transpose()?;
    let parameters = calibration.as_ref().map(Calibration::parameters).transpose()?;
    let starts = link.boots.iter().map(|boot| start(boot, arguments, parameters.as_ref()));
    let starts = starts.collect::<Result<Vec<Start>>>()?;
    if starts.iter().all(|start| start.device.is_none() && start.recomputed.is_none()) {
        return Err(Code::DataRefused
            .error(
                "the recording has no rest, which initial attitude and position need",
                "hold the board still for at least a second before moving it",
            )
            .at(&recording.name));
    }
    let calibration = calibration.as_ref().map(Calibration::sensor);
    let path = path(link, arguments, calibration, &recording.name, output)?;
    for start in &starts {
        start.print(output);
    }
    let navigated =
        Navigated { source: recording.name.clone(), link: link.role.to_string(), starts, path };
    output.object(&navigated);
    Ok(())
}

/// The filter's path through the longest start of the device. It may be absent if no option asks for it.
fn path(
    link: &Link,
    arguments: &Navigate,
    calibration: Option<&SensorCalibration>,
    name: &str,
    output: &Output,
) -> Result<Option<InertialPath>> {
    let Some(boot) = link.longest() else {
        return Ok(None);
    };
    let required = arguments.output.is_some() || arguments.report.is_some();
    let found = navigation::motion(name, boot, calibration)
        .and_then(|motion| inertial::one_unit(arguments, &motion, name.to_owned(), output));
    match found {
        Ok(found) => Ok(Some(found)),
        Err(error) if required => Err(error),
        Err(error) => {
            output.print(format!("no path with uncertainty: {error}"));
            Ok(None)
        }
    }
}

fn start(boot: &Boot, arguments: &Navigate, calibration: Option<&ParameterSet>) -> Result<Start> {
    let device = Track::of(&navigation::device(boot));
    let as_device = calibration.is_none() && arguments.zupt.is_none();
    if as_device || boot.epochs().is_empty() {
        return Ok(Start {
            device,
            recomputed: Track::of(&navigation::replayed(boot)),
            replay: (!boot.epochs().is_empty()).then(|| replay::verify(boot, 0)),
        });
    }
    let mark = &boot.epochs()[boot.epochs().len() - 1];
    let zupt =
        arguments.zupt.map_or(mark.epoch.state.config.zupt, |zupt| zupt != ZeroVelocity::Off);
    let points = navigation::recomputed(boot, calibration, zupt)?;
    Ok(Start { device, recomputed: Track::of(&points), replay: None })
}

fn replay_text(replay: &ReplayReport) -> String {
    if replay.is_exact() {
        let attitudes = match replay.attitudes_compared {
            0 => String::new(),
            count => format!("{count} attitudes, "),
        };
        format!(
            "bit for bit equal to the device's: {} corrected samples, {} positions, {attitudes}{} states compared",
            replay.corrected_compared, replay.navigation_compared, replay.states_compared
        )
    } else {
        format!(
            "differs from the device's: {} of {} corrected samples, {} of {} positions, {} of {} attitudes, first at sample {}",
            replay.corrected_differ.max(replay.rates_differ),
            replay.corrected_compared,
            replay.navigation_differ,
            replay.navigation_compared,
            replay.attitudes_differ,
            replay.attitudes_compared,
            replay.first_difference.map_or("?".to_owned(), |s| s.to_string())
        )
    }
}
