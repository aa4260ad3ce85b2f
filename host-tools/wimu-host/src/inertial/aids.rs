//! Measurements by other systems: one file a kind, and one line in [`KINDS`].
//!
//! A [`Kind`] names its columns, their unit, its usual σ, the states that it adds to the filter, and how a value updates the
//! navigator. Reading, order of time, tests, counts, residuals, findings, JSON and report are common to all kinds; lever arm and
//! σ of the time are those of positions, velocities and ranges. A new kind is a file as [`barometer`] with its `mod`, a line in [`KINDS`], and
//! a row in docs/how-to/position.md; the command reads it with `--fixes`. Its update takes a measurement of
//! [`wimu_nav::sensor`], or one of its own by blocks of [`wimu_nav::state`], east-north-up, whose derivatives a test checks as
//! those of `wimu-nav/tests/jacobians.rs`.

pub mod barometer;
pub mod heading;
pub mod position;
pub mod range;
pub mod rest;
pub mod speed;
pub mod velocity;

use std::fmt;
use std::path::Path;

use nalgebra::Vector3;
use wimu_nav::filter::{Gate, Innovation};
use wimu_nav::navigator;
use wimu_nav::sensor::{Measurement, Timed};
use wimu_nav::state::Block;

use super::{Residual, StartPose, other_clock};
use crate::digits::significant;
use crate::formats::table::{MeasuredColumn, Measurements, TIME};
use crate::localization::{AnchorStates, Ranging};
use crate::plural::counted;
use crate::stats::norm;
use crate::{Code, Problem, Result};

/// All kinds.
pub static KINDS: [&Kind; 8] = [
    &position::POSITION,
    &position::LOOP,
    &velocity::VELOCITY,
    &heading::HEADING,
    &barometer::PRESSURE,
    &speed::SPEED,
    &rest::REST,
    &range::RANGE,
];

/// A kind of measurement.
pub struct Kind {
    /// What residuals, JSON and states call it.
    pub name: &'static str,
    /// What findings call one; several have an s or es.
    pub one: &'static str,
    /// Names of the column of each value, without the unit; none of a kind that is not read from a table. The column of
    /// σ has the word `Sigma` at the end, or before an axis.
    pub columns: &'static [&'static [&'static str]],
    /// Size of units in SI units, and their names; the first is the SI unit, which messages name.
    pub unit: &'static [(f64, &'static str)],
    /// Values that may be, in SI units: others have a wrong unit, or were not measured.
    pub range: [f64; 2],
    /// σ without a column of it, in SI units; `None` where the model of the vehicle or of the ranges has it.
    pub usual_sd: Option<f64>,
    /// States that it adds to the filter.
    pub states: &'static [State],
    /// Fraction of rejected ones that is not reported.
    pub rejects: f64,
    /// What to do about rejected ones.
    pub remedy: &'static str,
    /// What to do where none applies.
    pub needs: &'static str,
    /// Updates the navigator; `None` where it does not apply.
    pub update: fn(&Aid, &mut Update<'_>) -> Option<Outcome>,
}

impl Kind {
    /// Three values that do nothing, each of which may be missing.
    pub const DEFAULT: Self = Self {
        range: [f64::NEG_INFINITY, f64::INFINITY],
        name: "",
        one: "",
        columns: &[],
        unit: &[(1.0, "")],
        usual_sd: None,
        states: &[],
        rejects: 0.0,
        remedy: "check their standard deviations, the delay (--setup fix_delay_s=S) and the lever arm (lever_arm_m)",
        needs: "",
        update: |_, _| None,
    };
}

impl fmt::Debug for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

impl PartialEq for Kind {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

/// A state that a kind adds: constant but for a random walk.
#[derive(Debug)]
pub struct State {
    /// Name.
    pub name: &'static str,
    /// SI unit.
    pub unit: &'static str,
    /// Standard deviation about zero at the start.
    pub sd: f64,
    /// Density of its random walk, unit/√s.
    pub walk: f64,
}

/// A measurement at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aid {
    /// When it was measured by the clock of the recording, s.
    pub time_s: f64,
    /// Its kind.
    pub kind: &'static Kind,
    /// Values in SI units, east-north-up where they have a direction.
    pub value: [f64; 3],
    /// Their standard deviations; infinite where nothing is measured, which the update leaves out.
    pub sd: [f64; 3],
    /// The point that it measures from the origin of the unit, m, body axes: an antenna.
    pub lever_arm_m: [f64; 3],
    /// Standard deviation of its time, s.
    pub time_sd_s: f64,
    /// Where it comes from: of a range the index of the anchor.
    pub source: usize,
}

impl Aid {
    /// One of up to three values with one standard deviation.
    pub fn of(kind: &'static Kind, time_s: f64, values: &[f64], sd: f64) -> Self {
        let at = |k: usize| values.get(k).copied();
        Self {
            time_s,
            kind,
            value: [0, 1, 2].map(|k| at(k).unwrap_or_default()),
            sd: [0, 1, 2].map(|k| at(k).map_or(f64::INFINITY, |_| sd)),
            lever_arm_m: [0.0; 3],
            time_sd_s: 0.0,
            source: 0,
        }
    }

    /// Whether a horizontal component is measured.
    fn is_horizontal(&self) -> bool {
        self.sd[..2].iter().any(|sd| sd.is_finite())
    }

    /// Whether it is a horizontal position.
    pub(super) fn is_level(&self) -> bool {
        *self.kind == position::POSITION && self.sd[..2].iter().all(|sd| sd.is_finite())
    }
}

/// Where a path begins in the frame of aids.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    /// East, north and up, m.
    pub position_m: Vector3<f64>,
    /// Standard deviation of each component, m.
    pub sd_m: Vector3<f64>,
}

/// What a kind updates.
pub struct Update<'a> {
    /// The filter.
    pub navigator: &'a mut navigator::Navigator,
    /// Time since the measurement, s.
    pub age_s: f64,
    /// The states of the kind, in their order.
    pub states: &'a [Block<1>],
    /// Whether a position was measured at the same time.
    pub with_position: bool,
    pub(super) time_sd_s: f64,
    pub(super) anchors: Option<&'a mut AnchorStates>,
}

impl Update<'_> {
    /// Updates with a measurement that passes the χ² test.
    pub fn with(&mut self, measurement: impl Measurement) -> Option<Outcome> {
        let timed = Timed { measurement, time_sd_s: self.time_sd_s };
        Some(self.navigator.update(&timed, Gate::ChiSquare).into())
    }
}

/// What came of a measurement.
#[derive(Clone, Copy, Debug)]
pub struct Outcome {
    /// Its test.
    pub innovation: Innovation,
    /// Its weight: 1 if it was used, 0 if not, and between for what may be without a line of sight.
    pub weight: f64,
    /// Logarithm of its density.
    pub log_likelihood: f64,
    /// Whether the path jumped to what it shows.
    pub has_jumped: bool,
}

/// Logarithm of the density of a measurement that contradicts the path, a component, in 1/m of a fix: it is anywhere within 100 m.
const OUTLIER: f64 = -4.6;

impl From<Innovation> for Outcome {
    fn from(innovation: Innovation) -> Self {
        Self {
            innovation,
            weight: f64::from(u8::from(innovation.accepted)),
            log_likelihood: innovation.log_likelihood.max(OUTLIER * innovation.dof as f64),
            has_jumped: false,
        }
    }
}

/// How the other system is mounted, and its clock.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mounting {
    /// See [`Aid::lever_arm_m`].
    pub lever_arm_m: [f64; 3],
    /// Time from a measurement to its time stamp, s.
    pub delay_s: f64,
    /// See [`Aid::time_sd_s`].
    pub time_sd_s: f64,
}

/// Measurements in the order of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Aids {
    /// The measurements.
    pub aids: Vec<Aid>,
    /// The anchors of ranges.
    pub ranging: Option<Ranging>,
    /// What was noticed while they were read.
    pub findings: Vec<Problem>,
}

/// Standard deviation of a start whose position the first fix gives, m, and of one that `--start` gives, m.
const START_M: f64 = 100.0;
const GIVEN_M: f64 = 0.3;
/// Fixes in succession that equal the one before them: with three or more coordinates of a moving unit, none by chance.
const REPEATED: usize = 3;
/// Least time between two fixes whose difference shows a velocity, s: at 0.5 m of noise, 1.4 m/s.
const DIFFERENCE_S: f64 = 0.5;
/// Acceleration between a fix and the start, m/s². Assumed: a car that brakes or turns in traffic.
const VEHICLE_MPS2: f64 = 2.0;
/// Ranges of this time show the position at the start, s.
const FIRST_RANGES_S: f64 = 1.0;

impl Aids {
    /// The position of a fix that has this residual; a height that was not measured is 0.
    pub(super) fn position_of(&self, residual: &Residual) -> Option<[f64; 3]> {
        let time_s = residual.time_s;
        let from = self.aids.partition_point(|aid| aid.time_s < time_s);
        let same = self.aids[from..].iter().take_while(|aid| aid.time_s <= time_s);
        let fix = same.clone().find(|aid| aid.kind.name == residual.aid)?;
        let is_position =
            residual.aid == position::POSITION.name && fix.sd[..2].iter().all(|sd| sd.is_finite());
        let [e, n, u] = fix.value;
        is_position.then_some([e, n, if fix.sd[2].is_finite() { u } else { 0.0 }])
    }

    /// Reads a table: `Time (s)`, and columns of any kinds with their σ. Values may be missing. Positions may be by latitude,
    /// longitude and altitude.
    ///
    /// # Errors
    /// `file_unreadable`, `csv_missing_column`, `csv_bad_number`, `no_rows` without a measurement.
    pub fn read(path: &Path, mounting: &Mounting) -> Result<Self> {
        let (mut table, mut plane) = (Measurements::read(path)?, None);
        table.project(&mut plane)?;
        let mut all = Self::of(&table, None, mounting)?;
        all.findings.extend(plane.map(|plane| plane.note()));
        Ok(all)
    }

    /// Those of a table. `arrived_s`: the time of rows of a table without times.
    pub(super) fn of(
        table: &Measurements,
        arrived_s: Option<f64>,
        mounting: &Mounting,
    ) -> Result<Self> {
        let time = match arrived_s {
            Some(_) => table.column(&["Time"], TIME),
            None => Some(table.needed(&["Time"], TIME)?),
        };
        let found: Vec<_> = KINDS.iter().filter_map(|kind| Columns::of(kind, table)).collect();
        if found.is_empty() {
            let text = format!("no column is a measurement: {}", table.header.join(", "));
            return Err(Code::CsvMissingColumn.error(text, known_names()).at(&table.name));
        }
        let mut all = Self { findings: noticed(table, time, &found), ..Self::default() };
        let mut not_positive = 0;
        for row in 0..table.len() {
            let time_s = time.map_or(Ok(None), |time| table.value(row, time))?;
            let Some(time_s) = time_s.or(arrived_s) else {
                continue;
            };
            for columns in &found {
                let aid = columns.aid(table, row, &mut not_positive)?;
                all.aids.extend(aid.map(|aid| Aid {
                    time_s: time_s - mounting.delay_s,
                    lever_arm_m: mounting.lever_arm_m,
                    time_sd_s: mounting.time_sd_s,
                    ..aid
                }));
            }
        }
        for Columns { kind, .. } in &found {
            all.leave_out_impossible(kind).map_err(|error| error.at(&table.name))?;
        }
        if not_positive > 0 {
            let what = counted(not_positive, "standard deviation");
            let text =
                format!("{what} of the fixes are not positive: the usual ones are used there");
            all.findings.push(Code::Navigation.warning(text));
        }
        if all.aids.is_empty() {
            let remedy = "fill in the values of at least one row";
            return Err(table.empty("there is no fix", remedy));
        }
        all.aids.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        all.leave_out_repeated();
        Ok(all)
    }

    /// Leaves out values of a kind outside of its range.
    ///
    /// # Errors
    /// `data_refused` where all are.
    fn leave_out_impossible(&mut self, kind: &Kind) -> Result<()> {
        let [least, most] = kind.range;
        let is_outside =
            |(value, sd): (&f64, &f64)| sd.is_finite() && !(least..=most).contains(value);
        let is_impossible =
            |aid: &Aid| aid.kind == kind && aid.value.iter().zip(&aid.sd).any(is_outside);
        let all = self.aids.iter().filter(|aid| aid.kind == kind).count();
        let before = self.aids.len();
        self.aids.retain(|aid| !is_impossible(aid));
        let count = before - self.aids.len();
        if count == 0 {
            return Ok(());
        }
        let what = if count == all { several(kind.one) } else { counted(count, kind.one) };
        let unit = kind.unit[0].1;
        let text = format!("{what} outside of {least} to {most} {unit}");
        let remedy = "check their unit";
        if count == all {
            return Err(Code::DataRefused.error(format!("all {text}"), remedy));
        }
        self.findings
            .push(Code::SamplesLeftOut.warning(format!("{text}: left out")).remedy(remedy));
        Ok(())
    }

    /// Leaves out fixes that a receiver repeats while it has no signal.
    fn leave_out_repeated(&mut self) {
        let fixes = |aid: &&Aid| *aid.kind == position::POSITION;
        let mut runs: Vec<(Aid, Vec<f64>)> = Vec::new();
        for fix in self.aids.iter().filter(fixes) {
            match runs.last_mut().filter(|(first, _)| first.value == fix.value && first.is_level())
            {
                Some((_, repeated_s)) => repeated_s.push(fix.time_s),
                None => runs.push((*fix, Vec::new())),
            }
        }
        runs.retain(|(_, repeated_s)| repeated_s.len() >= REPEATED);
        let repeated_s: Vec<f64> = runs.into_iter().flat_map(|(_, times_s)| times_s).collect();
        let (Some(first), Some(last)) = (repeated_s.first(), repeated_s.last()) else { return };
        let text = format!(
            "{} equal to the one before, as of a receiver without signal: left out",
            counted(repeated_s.len(), "fix")
        );
        let remedy = "give each fix of the receiver once";
        self.findings.push(Code::Frozen.warning(text).between(*first, *last).remedy(remedy));
        let is_repeated =
            |aid: &Aid| *aid.kind == position::POSITION && repeated_s.contains(&aid.time_s);
        self.aids.retain(|aid| !is_repeated(aid));
    }

    /// Adds those of another source.
    pub fn extend(&mut self, other: Self) {
        self.aids.extend(other.aids);
        self.findings.extend(other.findings);
        self.aids.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    }

    /// The same with a lever arm of the fixes that is estimated; `None` where it is given, or there are no fixes.
    pub(super) fn of_antenna(&self) -> Option<Self> {
        let is_fix = |aid: &&mut Aid| *aid.kind == position::POSITION;
        let mut all = self.clone();
        let mut fixes = all.aids.iter_mut().filter(is_fix).peekable();
        fixes.peek()?;
        for fix in fixes {
            if fix.lever_arm_m != [0.0; 3] {
                return None;
            }
            fix.kind = &position::ANTENNA;
        }
        Some(all)
    }

    /// The remedy of a path that is not known to `limit_m`, where the fixes are the cause.
    pub(super) fn remedy(&self, limit_m: f64) -> Option<String> {
        let fixes = self.aids.iter().filter(|aid| *aid.kind == position::POSITION);
        let least_m = fixes.map(|fix| norm(fix.sd)).reduce(f64::min)?;
        let text = || {
            let sd = significant(least_m, 2);
            format!(
                "the fixes are ± {sd} m in space at best: give their σ as Position Sigma E (m), N, U if it is smaller, or a \
                 larger `limit_m` (--setup)"
            )
        };
        (least_m > limit_m && least_m.is_finite()).then(text)
    }

    /// Refuses measurements of which none is within the times of a recording, s.
    pub(super) fn within(&self, times_s: &[f64]) -> Result<()> {
        let ends = self.aids.first().zip(self.aids.last());
        let Some(((first, last), (from, to))) = ends.zip(times_s.first().zip(times_s.last()))
        else {
            return Ok(());
        };
        if self.aids.iter().any(|aid| (*from..=*to).contains(&aid.time_s)) {
            return Ok(());
        }
        let fixes = ("fixes", [first.time_s, last.time_s]);
        Err(other_clock([fixes, ("samples", [*from, *to])]))
    }

    /// Places at a time, s, in the frame of the fixes: that of the first fix, or those that ranges show; `given` instead of the
    /// latter. None as long as there are none.
    pub(super) fn places(&self, time_s: f64, given: Option<&StartPose>) -> Vec<Place> {
        if self.origin().is_some_and(|fix| fix.time_s <= time_s) {
            return vec![self.place(given)];
        }
        let Some(ranging) = &self.ranging else {
            return Vec::new();
        };
        let is_range = |aid: &&Aid| aid.time_s <= time_s && *aid.kind == range::RANGE;
        let ranges: Vec<Aid> = self.aids.iter().filter(is_range).copied().collect();
        match (given, ranges.first()) {
            (Some(pose), Some(_)) => {
                vec![Place { position_m: pose.position_m.into(), sd_m: Vector3::repeat(GIVEN_M) }]
            }
            (None, Some(first)) if first.time_s <= time_s - FIRST_RANGES_S => {
                let found = ranging.positions(&ranges).into_iter();
                let place = |(position_m, sd_m)| Place { position_m, sd_m: Vector3::repeat(sd_m) };
                found.map(place).collect()
            }
            _ => Vec::new(),
        }
    }

    /// The first fix that measures each component.
    fn firsts(&self) -> [Option<&Aid>; 3] {
        let fixes = || self.aids.iter().filter(|aid| *aid.kind == position::POSITION);
        [0, 1, 2].map(|axis| fixes().find(|fix| fix.sd[axis].is_finite()))
    }

    /// Where the path starts: a place that is given, or that of the first fixes. A component that no fix measures is that from
    /// there.
    pub(super) fn place(&self, given: Option<&StartPose>) -> Place {
        let mut place = Place { position_m: Vector3::zeros(), sd_m: Vector3::zeros() };
        for (axis, first) in self.firsts().into_iter().enumerate() {
            if let Some(fix) = first {
                place.position_m[axis] = fix.value[axis];
                place.sd_m[axis] = given.map_or(START_M, |_| GIVEN_M);
            }
        }
        Place { position_m: given.map_or(place.position_m, |pose| pose.position_m.into()), ..place }
    }

    /// A path that closes within `sd_m`, m: it ends where it begins.
    pub(super) fn closed(&self, sd_m: f64, given: Option<&StartPose>, time_s: f64) -> Aid {
        let mut closed = Aid::of(&position::LOOP, time_s, &[0.0; 3], sd_m);
        if let Some(pose) = given {
            return Aid { value: pose.position_m, ..closed };
        }
        for (axis, first) in self.firsts().into_iter().enumerate() {
            if let Some(fix) = first {
                closed.value[axis] = fix.value[axis];
                closed.sd[axis] = sd_m.hypot(fix.sd[axis]).hypot(norm(fix.lever_arm_m));
            }
        }
        closed
    }

    /// The first fix of a horizontal position: the path is in its frame.
    pub fn origin(&self) -> Option<&Aid> {
        self.aids.iter().find(|aid| *aid.kind == position::POSITION && aid.is_horizontal())
    }

    /// Whether they show the heading: that of the path is then theirs.
    pub(super) fn show_heading(&self) -> bool {
        let shows = |aid: &Aid| {
            *aid.kind == heading::HEADING
                || (*aid.kind == velocity::VELOCITY && aid.is_horizontal())
        };
        self.origin().is_some() || self.aids.iter().any(shows)
    }

    /// The first measured height, m, of fixes without a horizontal position, and its standard deviation.
    pub(super) fn height(&self) -> Option<[f64; 2]> {
        let mut fixes = self.aids.iter().filter(|aid| *aid.kind == position::POSITION);
        fixes.find(|fix| fix.sd[2].is_finite()).map(|fix| [fix.value[2], fix.sd[2]])
    }

    /// Velocity at the time, s, of a start in motion, m/s, with the standard deviation of a component: that measured with
    /// the first fix, or of the way to the next one that is far enough in time.
    pub(super) fn velocity(&self, time_s: f64) -> Option<(Vector3<f64>, f64)> {
        let first = self.aids.iter().find(|aid| aid.is_level())?;
        let since = |fix_s: f64| VEHICLE_MPS2 * (fix_s - time_s).abs();
        let with = |aid: &&Aid| {
            aid.time_s == first.time_s
                && *aid.kind == velocity::VELOCITY
                && aid.sd.iter().all(|sd| sd.is_finite())
        };
        if let Some(known) = self.aids.iter().find(with) {
            return Some((known.value.into(), known.sd[0].hypot(since(first.time_s))));
        }
        let far = |aid: &&Aid| aid.is_level() && aid.time_s >= first.time_s + DIFFERENCE_S;
        let next = self.aids.iter().find(far)?;
        let over_s = next.time_s - first.time_s;
        let (mut velocity, mut variance) = (Vector3::zeros(), 0.0_f64);
        for axis in 0..3 {
            let sd_m = first.sd[axis].hypot(next.sd[axis]);
            if sd_m.is_finite() {
                velocity[axis] = (next.value[axis] - first.value[axis]) / over_s;
                variance = variance.max((sd_m / over_s).powi(2));
            }
        }
        let middle_s = 0.5 * (first.time_s + next.time_s);
        Some((velocity, variance.sqrt().hypot(since(middle_s))))
    }
}

/// The columns of a kind in a table.
struct Columns {
    kind: &'static Kind,
    values: Vec<Option<MeasuredColumn>>,
    sds: Vec<Option<MeasuredColumn>>,
}

impl Columns {
    /// `None` where the table has no value of the kind.
    fn of(kind: &'static Kind, table: &Measurements) -> Option<Self> {
        let values = kind.columns.iter().map(|names| table.column(names, kind.unit));
        let sds = kind.columns.iter().map(|names| {
            let names: Vec<String> = names.iter().map(|name| sigma(name)).collect();
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            table.column(&names, kind.unit)
        });
        let columns = Self { kind, values: values.collect(), sds: sds.collect() };
        columns.values.iter().any(Option::is_some).then_some(columns)
    }

    /// The measurement of a row; `None` where none is filled in.
    fn aid(
        &self,
        table: &Measurements,
        row: usize,
        not_positive: &mut usize,
    ) -> Result<Option<Aid>> {
        let usual = self.kind.usual_sd.unwrap_or_default();
        let mut aid = Aid::of(self.kind, 0.0, &[], usual);
        let mut measured = 0;
        for (k, (value, sd)) in self.values.iter().zip(&self.sds).enumerate() {
            let read =
                |column: &Option<MeasuredColumn>| column.map_or(Ok(None), |c| table.value(row, c));
            let (Some(value), sd) = (read(value)?, read(sd)?) else {
                continue;
            };
            *not_positive += usize::from(sd.is_some_and(|sd| sd <= 0.0));
            aid.value[k] = value;
            aid.sd[k] = sd.filter(|sd| *sd > 0.0).unwrap_or(usual);
            measured += 1;
        }
        Ok((measured > 0).then_some(aid))
    }
}

/// The name of more than one.
pub(super) fn several(one: &str) -> String {
    counted(2, one).split_off(2)
}

/// The name of the column of a value's σ.
fn sigma(name: &str) -> String {
    match name.rsplit_once(' ').filter(|(_, axis)| axis.len() == 1) {
        Some((name, axis)) => format!("{name} Sigma {axis}"),
        None => format!("{name} Sigma"),
    }
}

fn known_names() -> String {
    let names: Vec<&str> = KINDS.iter().flat_map(|kind| kind.columns).map(|n| n[0]).collect();
    format!("known names, each with its unit and with Sigma: {}", names.join(", "))
}

/// What is said of the columns of a table.
fn noticed(table: &Measurements, time: Option<MeasuredColumn>, found: &[Columns]) -> Vec<Problem> {
    let mut findings = Vec::new();
    let used = found.iter().flat_map(|columns| columns.values.iter().chain(&columns.sds));
    let others = table.others(used.chain([&time]).copied().flatten());
    if !others.is_empty() {
        let text = format!("columns of the fixes that are not used: {}", others.join(", "));
        findings.push(Code::Navigation.note(text).remedy(known_names()));
    }
    for Columns { kind, values, sds } in found {
        if values.len() == 3 && values[0].is_some() != values[1].is_some() {
            let text = format!(
                "of {} and {} the fixes have only one: the other is not measured",
                kind.columns[0][0], kind.columns[1][0]
            );
            findings.push(Code::Navigation.warning(text));
        }
        if let (Some(sd), true) = (kind.usual_sd, sds.iter().all(Option::is_none)) {
            let unit = kind.unit[0].1.split(' ').next().unwrap_or_default();
            let text = format!(
                "the {} have no standard deviation: {sd} {unit} is used",
                several(kind.one)
            );
            let remedy = format!("give it as {} ({unit})", sigma(kind.columns[0][0]));
            findings.push(Code::Navigation.note(text).remedy(remedy));
        }
    }
    findings
}
