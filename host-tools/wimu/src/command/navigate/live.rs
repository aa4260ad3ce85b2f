//! `wimu navigate LINK`.

use std::collections::BTreeMap;

use wimu_host::decode::{Arrival, Event};
use wimu_host::imu::{Imu, Sample};
use wimu_host::inertial::{Aid, AidLink, AidUse, Choice, LeastDelay, Live, PathPoint};
use wimu_host::localization::{RangeRecording, Ranging};
use wimu_host::monitor::{Reading, Readings};
use wimu_host::{Code, Input, Problem, Result};

use super::inertial::{aided_choice, choice, mounting, present};
use super::shown::{Shown, WAIT, corrected_there, writable};
use crate::arguments::{Aids as Options, Navigate};
use crate::command::{connect, listen_until};
use crate::output::{Output, usage};

/// Shortest wait for late fixes, s.
const LATE_S: f64 = 0.5;
/// Longest, s.
const MOST_LATE_S: f64 = 2.0;

/// The line of a position; `headings` is the number of hypotheses of the heading that are left.
fn text(point: &PathPoint, headings: usize) -> String {
    let [e, n, u] = point.position_m;
    let (sd, speed) = (point.sd_m(), norm(point.velocity_mps));
    let motion = if point.resting { "at rest".to_owned() } else { format!("{speed:.2} m/s") };
    let note = match (point.valid, headings) {
        (true, _) => String::new(),
        (false, 2..) => format!("  not valid: {headings} headings are possible, keep moving"),
        (false, _) => "  not valid".to_owned(),
    };
    format!("{:8.2} s  E {e:+.3} N {n:+.3} U {u:+.3} m ± {sd:.3} m  {motion}{note}", point.time_s)
}

fn norm(vector: [f64; 3]) -> f64 {
    vector.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// Navigates the samples of a board while they arrive.
pub fn run(arguments: &Navigate, link: &str, output: &Output) -> Result<()> {
    corrected_there(arguments, link)?;
    let aids = &arguments.aids;
    writable(arguments)?;
    let mut choice = choice(arguments)?;
    let mut fixes = Aiding::of(aids, &mut choice)?;
    let mut client = connect(link)?;
    let mut session = Session::new(&choice, link, fixes.late_s(aids));
    let mut shown = Shown::new(arguments.updates, output);
    let mut points = Vec::new();
    let ended = listen_until(&mut client, arguments.seconds, |arrival| {
        fixes.give(&mut session);
        let restarted = session.take(arrival)?;
        if restarted {
            output.print("the device has restarted: position begins again at zero");
        }
        if let Some(newest_s) = session.live.newest_s()
            && shown.is_due(newest_s)
            && let Some(point) = session.live.now()
        {
            shown.show(newest_s, &point, || text(&point, session.live.headings()));
            points.push(point);
        }
        shown.say(fixes.findings());
        shown.say(&session.live.findings());
        Ok(shown.going)
    });
    output.end_refresh();
    if points.is_empty() {
        ended?;
        let message = "no position within the time: the first needs three seconds of samples";
        return Err(Code::NoRows.error(message, WAIT).at(link));
    }
    // A lost link loses no position.
    let mut path = session.live.path(points);
    path.findings.extend(fixes.findings().iter().cloned());
    let mut new = path.findings.clone();
    new.retain(|finding| shown.is_new(finding));
    output.object(&present(arguments, path, Some(&new), Some(&choice), link.to_owned(), output)?);
    ended
}

/// Where aids come from.
enum Aiding {
    None,
    /// At times of the device's clock, and what was noticed at reading.
    Table(Vec<Aid>, Vec<Problem>),
    Link(Box<AidLink>),
}

impl Aiding {
    /// Opens what the options name, and gives the choice the anchors.
    fn of(options: &Options, choice: &mut Choice) -> Result<Self> {
        let (setup, mounting) = (&options.setup, mounting(options));
        let aids = std::mem::take(&mut choice.aids.aids);
        if let Some(anchors) = &setup.anchors {
            choice.aids.ranging = Some(Ranging::read(anchors, setup.range_errors)?);
        }
        let from = match (&options.fixes, &options.ranges, &setup.anchors) {
            (Some(from), ..) | (_, Some(from), _) => from,
            (.., Some(_)) => {
                let remedy = "give the ranges: --ranges FILE or LINK";
                return Err(usage("anchors beside a board needs ranges", remedy));
            }
            _ => return Ok(Self::None),
        };
        if let Input::Link(url) = Input::parse(&from.to_string_lossy())? {
            let ranging = choice.aids.ranging.clone();
            return Ok(Self::Link(Box::new(AidLink::open(&url, mounting, ranging)?)));
        }
        let Some(anchors) = &setup.anchors else {
            return Ok(Self::Table(aids, Vec::new()));
        };
        let read = RangeRecording::read(from, anchors)?.delayed(mounting.delay_s);
        let aids = read.ranges.iter().map(|range| range.mounted(&mounting)).collect();
        Ok(Self::Table(aids, read.findings))
    }

    /// How late aids may be, s.
    fn late_s(&self, options: &Options) -> f64 {
        match self {
            Self::None => 0.0,
            _ => (options.setup.fix_delay_s + LATE_S).clamp(LATE_S, MOST_LATE_S),
        }
    }

    fn give(&mut self, session: &mut Session) {
        match self {
            Self::None => {}
            Self::Table(aids, _) => aids.drain(..).for_each(|aid| session.live.aid(aid)),
            Self::Link(link) => {
                for aid in link.arrived() {
                    let offset_s = session.clock.offset_s().unwrap_or_default();
                    session.live.aid(Aid { time_s: aid.time_s + offset_s, ..aid });
                }
            }
        }
    }

    fn findings(&self) -> &[Problem] {
        match self {
            Self::None => &[],
            Self::Table(_, findings) => findings,
            Self::Link(link) => link.finding().map_or(&[], std::slice::from_ref),
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
        let choice = choice.clone();
        let of = Imu::new(name);
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
        self.readings.push(&arrival.event, |reading| arrived.push(reading));
        for reading in arrived {
            let time_s = reading.time.to_seconds();
            self.clock.see(time_s, arrival.host_ns as f64 * 1e-9);
            if reading.field.is_some_and(|field| !field.calibrated) {
                self.live.field_is_uncalibrated();
            }
            self.live.push(time_s, sample(&reading))?;
        }
        Ok(restarted)
    }
}

/// A reading as the estimators take it: its field where it is calibrated.
pub(super) fn sample(reading: &Reading) -> Sample {
    let field = reading.field.filter(|field| field.calibrated);
    Sample {
        step_s: 0.0,
        force_mps2: reading.specific_force.0.into(),
        rate_rad_s: reading.angular_rate.map(Into::into),
        field_ut: field.map(|field| field.nt.map(|nt| nt * 1e-3).into()),
    }
}

/// A board that is navigated beside another display of its samples.
pub struct Beside {
    fixes: Aiding,
    session: Session,
}

impl Beside {
    /// # Errors
    /// Those of the files and links that the options name.
    pub fn new(options: &Options, link: &str) -> Result<Self> {
        let mut choice = aided_choice(options)?;
        let fixes = Aiding::of(options, &mut choice)?;
        let session = Session::new(&choice, link, fixes.late_s(options));
        Ok(Self { fixes, session })
    }

    /// # Errors
    /// Those of [`Live::push`].
    pub fn take(&mut self, arrival: &Arrival) -> Result<()> {
        self.fixes.give(&mut self.session);
        self.session.take(arrival).map(drop)
    }

    /// The latest position fixes, m, and whether each was used.
    pub fn fixes(&self) -> Vec<([f64; 3], bool)> {
        self.session.live.fixes().copied().collect()
    }

    /// Where the unit is, and what happened to the aids.
    pub fn now(&self) -> Option<(PathPoint, BTreeMap<&'static str, AidUse>)> {
        let live = &self.session.live;
        Some((live.now()?, live.aids()))
    }
}
