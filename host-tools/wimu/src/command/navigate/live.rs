//! `wimu navigate LINK`.

use std::io::{self, IsTerminal};

use serde::Serialize;
use wimu_host::decode::{Arrival, Event};
use wimu_host::finding::{Finding, text};
use wimu_host::inertial::{Choice, Fix, FixLink, Fixes, LeastDelay, Live, PathPoint};
use wimu_host::monitor::{Reading, Readings};
use wimu_host::motion::{MotionRecording, UnitSample};
use wimu_host::{ErrorCode, Input, LinkUrl, Result};

use super::inertial::{choice, present};
use crate::arguments::Navigate;
use crate::command::{connect, listen_until};
use crate::output::{Output, usage};

/// Answers a second without `--rate`.
const RATE_HZ: f64 = 10.0;
/// Shortest wait for late fixes, s.
const LATE_S: f64 = 0.5;
/// Longest, s.
const MOST_LATE_S: f64 = 2.0;

/// A position, as `--json` prints it.
#[derive(Serialize)]
struct Pose {
    schema: &'static str,
    /// Device clock.
    time_s: f64,
    position_m: [f64; 3],
    sigma_m: [f64; 3],
    velocity_m_s: [f64; 3],
    velocity_sigma_m_s: [f64; 3],
    /// W, X, Y, Z, body axes to east-north-up.
    quaternion: [f64; 4],
    /// About east, north and up.
    attitude_sigma_rad: [f64; 3],
    resting: bool,
    valid: bool,
}

impl Pose {
    fn of(point: &PathPoint) -> Self {
        Self {
            schema: "wimu.pose/1",
            time_s: point.time_s,
            position_m: point.position_m,
            sigma_m: point.sigma_m(),
            velocity_m_s: point.velocity_mps,
            velocity_sigma_m_s: point.velocity_sd_mps,
            quaternion: point.quaternion,
            attitude_sigma_rad: point.attitude_sd_rad,
            resting: point.resting,
            valid: point.valid,
        }
    }

    /// A line, where so many headings are possible.
    fn text(&self, headings: usize) -> String {
        let [e, n, u] = self.position_m;
        let sd = self.sigma_m.iter().map(|s| s * s).sum::<f64>().sqrt();
        let speed = self.velocity_m_s.iter().map(|v| v * v).sum::<f64>().sqrt();
        let motion = match self.resting {
            true => "at rest".to_owned(),
            false => format!("{speed:.2} m/s"),
        };
        let note = match (self.valid, headings) {
            (true, _) => String::new(),
            (false, 2..) => format!("  not valid: {headings} headings fit the fixes, move"),
            (false, _) => "  not valid".to_owned(),
        };
        format!(
            "{:8.2} s  E {e:+.3} N {n:+.3} U {u:+.3} m ± {sd:.3} m  {motion}{note}",
            self.time_s
        )
    }
}

/// Navigates the samples of a board while they arrive.
pub fn run(arguments: &Navigate, link: &str, output: Output) -> Result<()> {
    if !arguments.calibration.is_empty() || arguments.sensitivity.is_some() {
        let remedy =
            format!("write the calibration to the board: `wimu params push {link} CAL.json`");
        return Err(usage("a board corrects its samples itself", remedy));
    }
    for file in [&arguments.output, &arguments.report].into_iter().flatten() {
        let folder = file
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty());
        if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
            let message = format!("there is no folder {}", folder.display());
            return Err(usage(message, "create it, or name another file"));
        }
    }
    let mut choice = choice(arguments)?;
    let mut fixes = match arguments.fixes.as_deref() {
        None => Aiding::None,
        Some(from) => match Input::parse(&from.to_string_lossy())? {
            Input::Link(url) => {
                choice.fixes.fixes.clear();
                Aiding::of(&url, arguments.fix_delay)?
            }
            _ => Aiding::Table(std::mem::take(&mut choice.fixes.fixes)),
        },
    };
    let late_s = match fixes {
        Aiding::None => 0.0,
        _ => (arguments.fix_delay + LATE_S).clamp(LATE_S, MOST_LATE_S),
    };
    let mut client = connect(link)?;
    let mut session = Session::new(&choice, link, late_s);
    let mut shown = Shown::new(arguments.rate.unwrap_or(RATE_HZ), output);
    let mut points = Vec::new();
    let ended = listen_until(&mut client, arguments.seconds, |arrival| {
        fixes.give(&mut session);
        let restarted = session.take(arrival)?;
        if restarted {
            output.print("the device has restarted: position begins again at zero");
        }
        if let Some(point) = shown.due(&session) {
            points.push(point);
        }
        if let Some(finding) = fixes.finding() {
            shown.say(std::slice::from_ref(finding));
        }
        shown.say(&session.live.findings());
        Ok(shown.going)
    });
    output.end_refresh();
    if points.is_empty() {
        ended?;
        return Err(ErrorCode::NoRows
            .error(
                "no position within the time: the first needs three seconds of samples",
                "wait longer; `wimu monitor LINK` shows whether samples arrive",
            )
            .at(link));
    }
    // A lost link loses no position.
    let mut path = session.live.path(points);
    path.findings.extend(fixes.finding().cloned());
    output.object(&present(
        arguments,
        &path,
        &choice,
        link.to_owned(),
        output,
    )?);
    ended
}

/// Where fixes come from.
enum Aiding {
    None,
    /// At times of the device's clock.
    Table(Vec<Fix>),
    Link(FixLink),
}

impl Aiding {
    fn of(link: &LinkUrl, delay_s: f64) -> Result<Self> {
        Ok(Self::Link(FixLink::open(link, delay_s)?))
    }

    fn give(&mut self, session: &mut Session) {
        match self {
            Self::None => {}
            Self::Table(fixes) => fixes.drain(..).for_each(|fix| session.live.fix(fix)),
            Self::Link(link) => {
                for fix in link.arrived() {
                    let offset_s = session.clock.offset_s().unwrap_or_default();
                    let time_s = fix.time_s + offset_s;
                    session.live.fix(Fix { time_s, ..fix });
                }
            }
        }
    }

    fn finding(&self) -> Option<&Finding> {
        match self {
            Self::Link(link) => link.finding(),
            _ => None,
        }
    }
}

/// One start of the device.
struct Session {
    choice: Choice,
    name: String,
    late_s: f64,
    readings: Readings,
    live: Live,
    /// The device's clock on that of the links.
    clock: LeastDelay,
}

impl Session {
    fn new(choice: &Choice, name: &str, late_s: f64) -> Self {
        let choice = Choice {
            fixes: Fixes {
                lever_arm_m: choice.fixes.lever_arm_m,
                ..Fixes::default()
            },
            ..choice.clone()
        };
        let of = MotionRecording::new(name, Vec::new(), Vec::new());
        Self {
            live: Live::new(choice.clone(), of, late_s),
            choice,
            name: name.to_owned(),
            late_s,
            readings: Readings::new(),
            clock: LeastDelay::default(),
        }
    }

    /// Takes what has arrived; returns whether the device has restarted.
    fn take(&mut self, arrival: &Arrival) -> Result<bool> {
        let restarted = matches!(arrival.event, Event::Restart { .. });
        if restarted {
            *self = Self::new(&self.choice, &self.name, self.late_s);
        }
        let mut arrived = Vec::new();
        self.readings
            .push(&arrival.event, |reading| arrived.push(reading));
        for reading in arrived {
            let time_s = reading.time.to_seconds();
            self.clock.see(time_s, arrival.host_ns as f64 * 1e-9);
            let sample = self.sample(&reading);
            self.live.push(time_s, sample)?;
        }
        Ok(restarted)
    }

    fn sample(&mut self, reading: &Reading) -> UnitSample {
        if reading.field.is_some_and(|field| !field.calibrated) {
            self.live.field_is_uncalibrated();
        }
        let field = reading.field.filter(|field| field.calibrated);
        UnitSample {
            step_s: 0.0,
            force_mps2: reading.specific_force.0,
            rate_rad_s: reading.angular_rate,
            field_ut: field.map(|field| field.nt.map(|nt| nt * 1e-3)),
        }
    }
}

/// What is printed while it goes on.
struct Shown {
    output: Output,
    refreshes: bool,
    every_s: f64,
    last_s: Option<f64>,
    printed_s: Option<f64>,
    /// Findings that were printed, without their figures.
    said: Vec<String>,
    going: bool,
}

impl Shown {
    fn new(rate_hz: f64, output: Output) -> Self {
        Self {
            output,
            refreshes: io::stdout().is_terminal() && io::stderr().is_terminal(),
            every_s: rate_hz.recip(),
            last_s: None,
            printed_s: None,
            said: Vec::new(),
            going: true,
        }
    }

    /// Prints the answer, if the next one is due.
    fn due(&mut self, session: &Session) -> Option<PathPoint> {
        let newest_s = session.live.newest_s()?;
        let is_due = |last: Option<f64>, every_s: f64| {
            last.is_none_or(|last| !(0.0..every_s - 1e-6).contains(&(newest_s - last)))
        };
        if !is_due(self.last_s, self.every_s) {
            return None;
        }
        let point = session.live.now()?;
        self.last_s = Some(newest_s);
        let pose = Pose::of(&point);
        if self.output.is_json() {
            self.going &= self.output.object(&pose);
        } else if self.refreshes {
            self.output.refresh(&pose.text(session.live.headings()));
        } else if is_due(self.printed_s, 1.0) {
            self.printed_s = Some(newest_s);
            self.output.print(pose.text(session.live.headings()));
        }
        Some(point)
    }

    /// Prints findings of a kind that was not printed before.
    fn say(&mut self, findings: &[Finding]) {
        for finding in findings {
            let is_word = |c: &char| !c.is_ascii_digit() && *c != '.' && *c != 's';
            let kind: String = finding.evidence.chars().filter(is_word).collect();
            if !self.said.contains(&kind) {
                self.said.push(kind);
                self.output.end_refresh();
                let text = text(std::slice::from_ref(finding), 1);
                self.output.print(text.trim_end());
            }
        }
    }
}
