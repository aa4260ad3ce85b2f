//! `wimu navigate` with its own estimators, on CSV files, recordings and arrays.

use std::path::{Path, PathBuf};

use serde::Serialize;
use wimu_host::calibration::{read_model, read_parameters, zero_count};
use wimu_host::capture::Capture;
use wimu_host::digits::east_north_up;
use wimu_host::formats;
use wimu_host::inertial::{
    self, Aided, Choice, Fixes, InertialPath, Method, Move, Profile, Zupt, consistency, navigate,
};
use wimu_host::motion::{MotionRecording, TableOptions};
use wimu_host::multi_range::{FullScales, Merge};
use wimu_host::plural::counted;
use wimu_host::{Code, Input, Problem, Result, navigation};

use super::array;
use crate::arguments::{Aids, Navigate, Smoothing, ZeroVelocity};
use crate::command::array::Refined;
use crate::output::{Output, usage};

/// A path, as `--json` prints it.
#[derive(Serialize)]
pub struct Found {
    source: String,
    method: Method,
    /// Value of the option `--zupt`.
    zupt: &'static str,
    /// Value of the option `--profile`; null for an array.
    profile: Option<&'static str>,
    /// Whether positions and σ rest on all samples. `horizon` is that of the forward filter.
    smoothed: bool,
    /// That of an array while it moves.
    angular_rate: Option<AngularRate>,
    duration_s: f64,
    /// End of the first rest, where position and velocity are zero by definition.
    origin_s: Option<f64>,
    /// Length of the path over the valid samples.
    distance_m: f64,
    final_position_m: [f64; 3],
    final_sigma_m: [f64; 3],
    final_valid: bool,
    valid_share: f64,
    horizon: Horizon,
    rests: usize,
    rests_s: f64,
    /// Use of `--fixes` and `--ranges`; null without.
    fixes: Option<Aided>,
    ranges: Option<Aided>,
    nees: Option<Nees>,
    /// NEES of an array's angular rate and velocity.
    rate_nees: Option<Nees>,
    velocity_nees: Option<Nees>,
    /// Moves between rests.
    moves: Vec<MoveFound>,
    refined: Option<Refined>,
}

#[derive(Serialize)]
struct AngularRate {
    rms_rad_s: f64,
    /// Median of the standard deviation in space.
    sigma_rad_s: f64,
    /// Whether it rests on all samples.
    smoothed: bool,
}

/// Motion time after which the position's standard deviation exceeds a limit or the position is lost; null if never.
#[derive(Serialize)]
struct Horizon {
    to_0_1_m_s: Option<f64>,
    to_1_m_s: Option<f64>,
    limit_m: f64,
    to_limit_s: Option<f64>,
    /// The same with the time in the recording.
    ends: Vec<End>,
}

#[derive(Serialize)]
struct End {
    limit_m: f64,
    #[serde(flatten)]
    horizon: inertial::Horizon,
}

/// A move between two rests.
#[derive(Serialize)]
struct MoveFound {
    from_s: f64,
    to_s: f64,
    /// Null where it is not known: without a gyroscope after a rotation, or contradicted by the rest at its end.
    length_m: Option<f64>,
    length_sd_m: Option<f64>,
    tilted_deg: f64,
}

impl MoveFound {
    fn of(found: &Move) -> Self {
        let known = |value: f64| found.valid.then_some(value);
        Self {
            from_s: found.from_s,
            to_s: found.to_s,
            length_m: known(found.length_m),
            length_sd_m: known(found.length_sd_m),
            tilted_deg: found.tilted_rad.to_degrees(),
        }
    }
}

#[derive(Serialize)]
struct Nees {
    samples: usize,
    median: f64,
    share_below_7_81: f64,
    /// Heading of the truth: `truth`, or `fitted` to the path if the truth has no heading.
    heading: &'static str,
}

impl Nees {
    fn of(all: &[f64], path: &InertialPath) -> Option<Self> {
        consistency(all).map(|(median, share_below_7_81)| Self {
            samples: all.len(),
            median,
            share_below_7_81,
            heading: if path.heading_fitted { "fitted" } else { "truth" },
        })
    }
}

/// Navigates a recording of one unit, or an array.
pub fn run(arguments: &Navigate, output: &Output) -> Result<()> {
    let source = wimu_host::untrusted::name(&arguments.input);
    let found = match &arguments.geometry {
        Some(geometry) => {
            let choice = choice(arguments)?;
            let (path, refined) = array::path(arguments, geometry, &choice, output)?;
            let mut found = present(arguments, &path, &path.findings, &choice, source, output)?;
            found.refined = refined;
            found
        }
        None => {
            let motion = calibrated(arguments, &arguments.input, arguments.with.first())?;
            one_unit(arguments, &motion, source, output)?
        }
    };
    output.object(&found);
    Ok(())
}

/// A recording of a unit, of any format; of a board the longest start.
pub fn unit(
    arguments: &Navigate,
    file: &Path,
    calibration: Option<&PathBuf>,
) -> Result<MotionRecording> {
    match Input::parse(&file.to_string_lossy())? {
        Input::Link(_) => Err(usage(
            "a LINK cannot be combined with a recording",
            "record the board: wimu record LINK -o A.mcap",
        )),
        Input::Recording(_) => {
            let recording = Capture::load(file)?;
            let link = recording.link(arguments.reading.role())?;
            let longest = link.longest().ok_or_else(|| {
                Code::NoRows
                    .error("the recording has no samples", "record again")
                    .at(&recording.name)
            })?;
            let calibration = calibration.map(|file| read_parameters(file)).transpose()?;
            navigation::motion(&recording.name, longest, calibration.as_ref())
        }
        _ => calibrated(arguments, file, calibration),
    }
}

/// Reads a recording of one unit and corrects it with a calibration.
fn calibrated(
    arguments: &Navigate,
    file: &Path,
    calibration: Option<&PathBuf>,
) -> Result<MotionRecording> {
    let options = TableOptions {
        calibration: calibration.map(|file| read_model(file)).transpose()?,
        sensitivity_lsb_per_g: arguments.sensitivity,
    };
    let mut load = arguments.reading.options(false);
    load.stored_zero_count = calibration.and_then(|file| zero_count(file));
    let mut recording = formats::load(file, &load)?;
    if arguments.full_scales.is_empty() {
        return MotionRecording::of(&recording, &options);
    }
    for other in &arguments.boards {
        recording.add_accelerometer(&formats::load(other, &load)?)?;
    }
    let scales = FullScales::of(&arguments.full_scales)?;
    let Some(merge) = Merge::of(&recording, &scales)? else {
        return MotionRecording::of(&recording, &options);
    };
    let mut motion = MotionRecording::of(&merge.recording, &options)?;
    motion.findings.splice(0..0, merge.findings);
    Ok(motion)
}

/// Computes, prints and writes the path of one unit; returns its object.
pub fn one_unit(
    arguments: &Navigate,
    recording: &MotionRecording,
    source: String,
    output: &Output,
) -> Result<Found> {
    let choice = choice(arguments)?;
    let path = navigate(recording, &choice)?;
    present(arguments, &path, &path.findings, &choice, source, output)
}

/// What the options say.
pub fn choice(arguments: &Navigate) -> Result<Choice> {
    let mut aided = aided_choice(&arguments.aids)?;
    if let Some(odometry) = &arguments.odometry {
        aided.fixes = aided.fixes.with_odometry(odometry)?;
    }
    Ok(Choice {
        zupt: ZeroVelocity::of(arguments.zupt),
        limit_m: arguments.limit,
        within_m: arguments.within,
        rests_s: arguments.rests.clone(),
        start: arguments.start,
        smooth: arguments.smooth == Smoothing::On,
        loop_m: arguments.closes,
        ..aided
    })
}

/// What the options of the aids say, and the defaults.
pub fn aided_choice(aids: &Aids) -> Result<Choice> {
    let fixes = match &aids.fixes {
        // A link has none yet.
        Some(from) => match Input::parse(&from.to_string_lossy())? {
            Input::Link(_) => Fixes::default(),
            _ => Fixes::read(from, aids.fix_delay)?,
        },
        None => Fixes::default(),
    };
    Ok(Choice {
        profile: aids.profile.into(),
        fixes: Fixes { lever_arm_m: aids.lever_arm.unwrap_or_default(), ..fixes },
        ..Choice::default()
    })
}

/// Prints a path with the findings that are `new` to the user, and writes it; returns its object.
pub fn present(
    arguments: &Navigate,
    path: &InertialPath,
    new: &[Problem],
    choice: &Choice,
    source: String,
    output: &Output,
) -> Result<Found> {
    let text = text(path, choice, arguments.aids.fixes.is_some());
    output.print(text.trim_end());
    output.findings(new);
    if let Some(file) = &arguments.output {
        path.write(file)?;
        output.print(format!("wrote {} to {}", counted(path.points.len(), "row"), file.display()));
    }
    if let Some(file) = &arguments.report {
        path.page(&source, &text).write(file)?;
        output.print(format!("wrote {}", file.display()));
    }
    Ok(found(path, choice, source))
}

fn found(path: &InertialPath, choice: &Choice, source: String) -> Found {
    let last = path.points.last();
    let rests = path.rests();
    Found {
        source,
        method: path.method,
        zupt: match choice.zupt {
            Zupt::Assumed => "cautious",
            Zupt::Stated => "on",
            Zupt::Off => "off",
        },
        profile: (path.method != Method::Array).then(|| profile(choice.profile).0),
        smoothed: path.smoothed,
        angular_rate: path.angular_rate().map(|(rms_rad_s, sigma_rad_s)| AngularRate {
            rms_rad_s,
            sigma_rad_s,
            smoothed: path.smoothed_rate,
        }),
        duration_s: path.duration_s(),
        origin_s: path.points.get(path.origin).map(|p| p.time_s),
        distance_m: path.distance_m(),
        final_position_m: last.map(|p| p.position_m).unwrap_or_default(),
        final_sigma_m: last.map(|p| p.sigma_m()).unwrap_or_default(),
        final_valid: last.is_some_and(|p| p.valid),
        valid_share: path.valid_share(),
        horizon: Horizon {
            to_0_1_m_s: path.horizon_s(0.1),
            to_1_m_s: path.horizon_s(1.0),
            limit_m: choice.limit_m,
            to_limit_s: path.horizon_s(choice.limit_m),
            ends: limits(choice)
                .into_iter()
                .filter_map(|limit_m| {
                    let horizon = path.horizon(limit_m)?;
                    Some(End { limit_m, horizon })
                })
                .collect(),
        },
        rests: rests.rests,
        rests_s: rests.lasted_s,
        fixes: some(path.aided[0]),
        ranges: some(path.aided[1]),
        nees: Nees::of(&path.nees, path),
        rate_nees: Nees::of(&path.rate_nees, path),
        velocity_nees: Nees::of(&path.velocity_nees, path),
        moves: path.moves.iter().map(MoveFound::of).collect(),
        refined: None,
    }
}

/// What happened to fixes and to ranges, a line each.
fn uses(aided: [Aided; 2]) -> Vec<String> {
    let kinds = ["fixes", "ranges"].iter().zip(aided);
    let line = |(kind, aided): (_, Aided)| {
        let Aided { used, rejected, late } = some(aided)?;
        Some(format!("{kind}: {used} used, {rejected} rejected, {late} late"))
    };
    kinds.filter_map(line).collect()
}

fn some(aided: Aided) -> Option<Aided> {
    (aided != Aided::default()).then_some(aided)
}

/// Value of the option, and what it assumes.
fn profile(profile: Profile) -> (&'static str, &'static str) {
    match profile {
        Profile::Hand => ("hand", "velocity 0 ± 2 m/s"),
        Profile::Foot => ("foot", "velocity zero in stances"),
        Profile::Vehicle => ("vehicle", "motion along the forward axis where it is known"),
        _ => ("free", "no bound"),
    }
}

/// Position limits of the printed horizons, m.
fn limits(choice: &Choice) -> Vec<f64> {
    let mut limits = vec![0.1, 1.0];
    if !limits.contains(&choice.limit_m) {
        limits.push(choice.limit_m);
    }
    limits
}

/// Moves that are listed in the text.
const LISTED: usize = 4;

/// The moves of known length, the longest first.
fn moves(path: &InertialPath) -> String {
    let mut known: Vec<&Move> = path.moves.iter().filter(|m| m.valid).collect();
    if known.is_empty() {
        return String::new();
    }
    known.sort_by(|a, b| b.length_m.total_cmp(&a.length_m));
    let one = |m: &&Move| {
        format!("{:.3} ± {:.3} m ({:.2} to {:.2} s)", m.length_m, m.length_sd_m, m.from_s, m.to_s)
    };
    let listed: Vec<String> = known.iter().take(LISTED).map(one).collect();
    let kind = match path.method {
        Method::Tilt => " without rotation",
        _ => "",
    };
    format!(
        "{}{kind} between rests, longest first: {}\n",
        counted(known.len(), "move"),
        listed.join(", ")
    )
}

/// From where position is measured.
fn origin(path: &InertialPath, choice: &Choice, has_fixes: bool) -> String {
    // Those of a link are not part of the choice.
    let of_fixes = has_fixes && (choice.fixes.fixes.is_empty() || choice.fixes.origin().is_some());
    match path.points.get(path.origin) {
        _ if choice.start.is_some() => "origin: that of --start\n".to_owned(),
        _ if of_fixes => "origin: that of the fixes\n".to_owned(),
        Some(point) if point.resting || path.method == Method::Array => {
            format!("origin: t = {:.2} s (end of the first rest)\n", point.time_s)
        }
        _ => String::new(),
    }
}

/// The result first, then what it rests on, then remarks.
fn text(path: &InertialPath, choice: &Choice, has_fixes: bool) -> String {
    let mut text = match path.angular_rate() {
        Some((rate, sd)) => format!(
            "angular rate: {rate:.3} rad/s rms in motion ± {sd:.3} rad/s (median 1 σ){}\n",
            if path.smoothed_rate { ", smoothed" } else { "" }
        ),
        None => String::new(),
    };
    text += &match path.points.iter().rfind(|p| p.valid) {
        None => "no position is known to the limit\n".to_owned(),
        Some(point) => {
            let (at, sd) = (east_north_up(point.position_m), point.sd_m());
            let ends = path.points.last().is_some_and(|last| last.valid);
            let what = if ends { "final position" } else { "last valid position" };
            format!("{what}: {at} m ± {sd:.3} m (1 σ), at {:.2} s\n", point.time_s)
        }
    };
    text += &format!(
        "path: {:.3} m in {:.1} s, {}{}; {:.0} % of the samples are valid (σ below {} m)\n",
        path.distance_m(),
        path.duration_s(),
        match path.method {
            Method::Strapdown => "with a gyroscope",
            Method::Tilt => "without a gyroscope",
            Method::Array => "with an array of accelerometers",
            Method::Ranges | Method::Odometry | Method::RangesInertial => "with ranges",
        },
        if path.smoothed { ", smoothed" } else { "" },
        100.0 * path.valid_share(),
        choice.limit_m
    );
    let limits = limits(choice);
    let horizons = limits.iter().map(|limit| match path.horizon(*limit) {
        None => format!("below {limit} m throughout"),
        Some(end) => {
            format!("below {limit} m for {:.1} s of motion (until {:.2} s)", end.moving_s, end.at_s)
        }
    });
    let filtered = if path.smoothed { "σ in real time (forward filter)" } else { "σ" };
    let horizons = horizons.collect::<Vec<_>>().join(", ");
    text += &format!("{filtered}: {horizons}\n");
    let rests = path.rests();
    let zero = match choice.zupt {
        Zupt::Stated => "velocity zero",
        Zupt::Assumed => "constant velocity of 0 ± 0.1 m/s",
        Zupt::Off => "nothing",
    };
    text +=
        &format!("assumed: {zero} at {} ({:.1} s)", counted(rests.rests, "rest"), rests.lasted_s);
    if path.method != Method::Array {
        let (name, bound) = profile(choice.profile);
        text += &format!("; --profile {name}: {bound}");
    }
    if let Some(within_m) = choice.within_m {
        text += &format!("; within {within_m} m of the start");
    }
    text.push('\n');
    text += &origin(path, choice, has_fixes);
    for line in uses(path.aided) {
        text += &format!("{line}\n");
    }
    text += &moves(path);
    let fitted = if path.heading_fitted { ", heading fitted" } else { "" };
    for (what, nees) in
        [("", &path.nees), ("angular rate, ", &path.rate_nees), ("velocity, ", &path.velocity_nees)]
    {
        if let Some((median, share)) = consistency(nees) {
            text += &format!(
                "against the truth{fitted}, in motion: {what}NEES median {median:.2} (expected 2.37), below 7.81 in {:.0} % (expected \
                 95 %)\n",
                100.0 * share
            );
        }
    }
    text
}
