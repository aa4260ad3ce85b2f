//! Measurements of other systems: position, height, velocity and heading fixes, and ranges to anchors.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use wimu_nav::filter::{Gate, Innovation};
use wimu_nav::navigator::Navigator;
use wimu_nav::sensor::{Heading, Position, Velocity};

use super::segments::Segments;
use super::suspects::{Lag, Suspects};
use super::{Residual, StartPose};
use crate::digits::significant;
use crate::formats::table::{ANGLE, LENGTH, MeasuredColumn, Measurements, SPEED, TIME};
use crate::localization::{AnchorStates, Model, RangeSample, Ranging};
use crate::motion::other_clock;
use crate::plural::counted;
use crate::stats::norm;
use crate::{Code, Problem, Result};

/// A measurement at one time, east-north-up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fix {
    /// Time, s, of the measurement by the clock of the recording.
    pub time_s: f64,
    /// Position, m.
    pub position_m: [f64; 3],
    /// Standard deviation of each component, m; infinite where it is not measured.
    pub position_sd_m: [f64; 3],
    /// Velocity, m/s, and the standard deviation of a component.
    pub velocity_mps: Option<([f64; 3], f64)>,
    /// Angle of the body x axis from east towards north, and its standard deviation, rad.
    pub heading_rad: Option<[f64; 2]>,
    /// Range to an anchor of [`Fixes::ranging`], by its index, m.
    pub range_m: Option<(usize, f64)>,
}

/// Fixes, in the order of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Fixes {
    /// The measurements.
    pub fixes: Vec<Fix>,
    /// The antenna from the origin of the unit, m, body axes.
    pub lever_arm_m: [f64; 3],
    /// What was noticed while they were read.
    pub findings: Vec<Problem>,
    /// The anchors of ranges.
    pub ranging: Option<Ranging>,
    /// Speeds by the wheels of a vehicle, positive forward: time, s, and speed, m/s.
    pub speeds: Vec<[f64; 2]>,
}

/// Standard deviations of a file without them: a position by GNSS without corrections, m; a velocity by its Doppler shift,
/// m/s; a compass, rad.
const POSITION_SD_M: f64 = 3.0;
const VELOCITY_SD_MPS: f64 = 0.2;
const HEADING_SD_RAD: f64 = 0.1;

impl Fixes {
    /// Reads a table: `Time (s)`, `Position E (m)`, `Position N (m)`, `Position U (m)` or `Height (m)`, `Velocity E (m/s)`
    /// … `U`, `Heading (deg)`, each with `… Sigma E (m)`, `Height Sigma (m)`, `Heading Sigma (deg)`. Every column but the
    /// time is optional, as are values. A fix was measured `delay_s` before its time.
    ///
    /// # Errors
    /// `file_unreadable`, `csv_missing_column`, `csv_bad_number`, `no_rows` without a fix.
    pub fn read(path: &Path, delay_s: f64) -> Result<Self> {
        Self::of(&Measurements::read(path)?, delay_s, None)
    }

    /// Those of a table. `arrived_s`: the time of rows of a table without times.
    pub(super) fn of(table: &Measurements, delay_s: f64, arrived_s: Option<f64>) -> Result<Self> {
        let time = match arrived_s {
            Some(_) => table.column(&["Time"], TIME),
            None => Some(table.needed(&["Time"], TIME)?),
        };
        let axes = |name: &str, units| {
            ["E", "N", "U"].map(|axis| table.column(&[&format!("{name} {axis}")], units))
        };
        let mut position = axes("Position", LENGTH);
        let mut position_sd = axes("Position Sigma", LENGTH);
        position[2] = position[2].or_else(|| table.column(&["Height"], LENGTH));
        position_sd[2] = position_sd[2].or_else(|| table.column(&["Height Sigma"], LENGTH));
        let velocity = axes("Velocity", SPEED);
        let velocity_sd = axes("Velocity Sigma", SPEED);
        let heading = [["Heading"], ["Heading Sigma"]].map(|names| table.column(&names, ANGLE));
        let measured = position.iter().chain(&velocity).chain(&heading[..1]);
        if measured.clone().flatten().next().is_none() {
            return Err(table.missing("Position E (m)"));
        }
        let deviations = position_sd.iter().chain(&velocity_sd).chain(&heading[1..]);
        let mut findings = Vec::new();
        let used = measured.chain(deviations).chain([&time]);
        let others = table.others(used.copied().flatten());
        if !others.is_empty() {
            let text = format!("columns of the fixes that are not used: {}", others.join(", "));
            let remedy = "known names: Position E (m), N, U, Height (m), Velocity E (m/s), N, U, Heading (deg), each with Sigma";
            findings.push(Code::Navigation.note(text).remedy(remedy));
        }
        if position[0].is_some() != position[1].is_some() {
            let text = "of Position E (m) and N the fixes have only one: the other is not measured";
            findings.push(Code::Navigation.warning(text));
        }
        let has_no_sd = |values: &[Option<MeasuredColumn>], sds: &[Option<MeasuredColumn>]| {
            values.iter().any(Option::is_some) && sds.iter().all(Option::is_none)
        };
        if has_no_sd(&position, &position_sd) {
            let text = format!("the fixes have no standard deviation: {POSITION_SD_M} m is used");
            let remedy = "give it as Position Sigma E (m), N, U";
            findings.push(Code::Navigation.note(text).remedy(remedy));
        }
        let (mut fixes, mut not_positive) = (Vec::new(), 0);
        for row in 0..table.len() {
            let value = |column: Option<_>| match column {
                Some(column) => table.value(row, column),
                None => Ok(None),
            };
            let three = |columns: [Option<_>; 3]| -> Result<[Option<f64>; 3]> {
                Ok([value(columns[0])?, value(columns[1])?, value(columns[2])?])
            };
            let Some(time_s) = value(time)?.or(arrived_s) else {
                continue;
            };
            let mut sd = |value: Option<f64>, usual: f64| {
                not_positive += usize::from(value.is_some_and(|sd| sd <= 0.0));
                value.filter(|sd| *sd > 0.0).unwrap_or(usual)
            };
            let velocity_sd = three(velocity_sd)?.into_iter().flatten();
            let velocity_sd = sd(velocity_sd.reduce(f64::max), VELOCITY_SD_MPS);
            let velocity = match three(velocity)? {
                [Some(e), Some(n), Some(u)] => Some(([e, n, u], velocity_sd)),
                _ => None,
            };
            let heading_sd = sd(value(heading[1])?, HEADING_SD_RAD);
            let (position, position_sd) = (three(position)?, three(position_sd)?);
            let fix = Fix {
                time_s: time_s - delay_s,
                position_m: position.map(Option::unwrap_or_default),
                position_sd_m: [0, 1, 2].map(|axis| match position[axis] {
                    Some(_) => sd(position_sd[axis], POSITION_SD_M),
                    None => f64::INFINITY,
                }),
                velocity_mps: velocity,
                heading_rad: value(heading[0])?.map(|heading| [heading, heading_sd]),
                range_m: None,
            };
            if fix.has_position() || fix.velocity_mps.is_some() || fix.heading_rad.is_some() {
                fixes.push(fix);
            }
        }
        if not_positive > 0 {
            let what = counted(not_positive, "standard deviation");
            let text = format!(
                "{what} of the fixes are not positive: {POSITION_SD_M} m, {VELOCITY_SD_MPS} m/s, {:.0}° are used there",
                HEADING_SD_RAD.to_degrees()
            );
            findings.push(Code::Navigation.warning(text));
        }
        if fixes.is_empty() {
            let remedy = "fill in the position, velocity or heading of at least one row";
            return Err(table.empty("there is no fix", remedy));
        }
        fixes.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        Ok(Self { fixes, findings, ..Self::default() })
    }

    /// The remedy of a path that is not known to `limit_m`, where the fixes are the cause.
    pub(super) fn remedy(&self, limit_m: f64) -> Option<String> {
        let sds = self.fixes.iter().map(|fix| norm(fix.position_sd_m));
        let least_m = sds.reduce(f64::min)?;
        let text = || {
            let sd = significant(least_m, 2);
            format!(
                "the fixes are ± {sd} m in space at best: give their σ as Position Sigma E (m), N, U if it is smaller, or a \
                 larger `limit_m` (--setup)"
            )
        };
        (least_m > limit_m && least_m.is_finite()).then(text)
    }

    /// Refuses fixes of which none is within the times of a recording, s.
    pub(super) fn within(&self, times_s: &[f64]) -> Result<()> {
        let ends =
            (self.fixes.first().zip(self.fixes.last())).zip(times_s.first().zip(times_s.last()));
        let Some(((first, last), (from, to))) = ends else {
            return Ok(());
        };
        let inside = |fix: &Fix| (*from..=*to).contains(&fix.time_s);
        match self.fixes.iter().any(inside) {
            true => Ok(()),
            false => Err(other_clock([
                ("fixes", [first.time_s, last.time_s]),
                ("samples", [*from, *to]),
            ])),
        }
    }

    /// Positions at a time, s, in the frame of the fixes, m, with standard deviations: that of the first fix, or those that
    /// ranges show; `given` instead of the latter. None as long as there are none.
    pub(super) fn positions(
        &self,
        time_s: f64,
        given: Option<&StartPose>,
    ) -> Vec<(Vector3<f64>, f64)> {
        let fix = self.origin().filter(|fix| fix.time_s <= time_s);
        if let Some(fix) = fix {
            return vec![fix.position()];
        }
        let Some(ranging) = &self.ranging else {
            return Vec::new();
        };
        let end = self.fixes.partition_point(|fix| fix.time_s <= time_s);
        let ranges: Vec<RangeSample> = self.fixes[..end].iter().filter_map(Fix::range).collect();
        match (given, ranges.first()) {
            (Some(pose), Some(_)) => vec![(pose.position_m.into(), GIVEN_M)],
            (None, Some(first)) if first.time_s <= time_s - FIRST_RANGES_S => {
                ranging.positions(&ranges)
            }
            _ => Vec::new(),
        }
    }

    /// The first fix of the horizontal position: the path is in its frame.
    pub fn origin(&self) -> Option<&Fix> {
        self.fixes.iter().find(|fix| fix.is_level())
    }

    /// Velocity at the time, s, of a start in motion, m/s, with the standard deviation of a component: that of the first
    /// fix, or of the way to the next one that is far enough in time.
    pub(super) fn velocity(&self, time_s: f64) -> Option<(Vector3<f64>, f64)> {
        let first = self.origin()?;
        let since = |fix_s: f64| VEHICLE_MPS2 * (fix_s - time_s).abs();
        if let Some((velocity, sd)) = first.velocity_mps {
            return Some((velocity.into(), sd.hypot(since(first.time_s))));
        }
        let far = |fix: &&Fix| fix.is_level() && fix.time_s >= first.time_s + DIFFERENCE_S;
        let next = self.fixes.iter().find(far)?;
        let over_s = next.time_s - first.time_s;
        let (mut velocity, mut variance) = (Vector3::zeros(), 0.0_f64);
        for axis in 0..3 {
            let sd_m = first.position_sd_m[axis].hypot(next.position_sd_m[axis]);
            if sd_m.is_finite() {
                velocity[axis] = (next.position_m[axis] - first.position_m[axis]) / over_s;
                variance = variance.max((sd_m / over_s).powi(2));
            }
        }
        let middle_s = 0.5 * (first.time_s + next.time_s);
        Some((velocity, variance.sqrt().hypot(since(middle_s))))
    }
}

impl Fix {
    /// Nothing that is measured, at a time, s.
    pub fn at(time_s: f64) -> Self {
        Self {
            time_s,
            position_m: [0.0; 3],
            position_sd_m: [f64::INFINITY; 3],
            velocity_mps: None,
            heading_rad: None,
            range_m: None,
        }
    }

    /// Position, m, and its standard deviation at a start.
    pub(super) fn position(&self) -> (Vector3<f64>, f64) {
        (self.position_m.into(), START_M)
    }

    fn is_level(&self) -> bool {
        self.position_sd_m[..2].iter().all(|sd| sd.is_finite())
    }

    fn has_position(&self) -> bool {
        self.position_sd_m.iter().any(|sd| sd.is_finite())
    }

    fn range(&self) -> Option<RangeSample> {
        self.range_m.map(|(anchor, range_m)| RangeSample { time_s: self.time_s, anchor, range_m })
    }
}

impl From<RangeSample> for Fix {
    fn from(range: RangeSample) -> Self {
        Self { range_m: Some((range.anchor, range.range_m)), ..Self::at(range.time_s) }
    }
}

/// Fixes of the position in succession that fail their test until one is taken for true: the path is wrong.
pub(super) const CONTRADICTIONS: usize = 5;

/// Logarithm of the density of a fix that contradicts the path, in 1/m³: a fix anywhere within 100 m.
const OUTLIER: f64 = -13.8;

/// A range whose line of sight is less probable is counted as not used.
pub(crate) const LINE_OF_SIGHT: f64 = 0.5;

/// What happened to the measurements of one kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Aided {
    /// Number that was used.
    pub used: usize,
    /// Number that contradicted the path. A rejected range had no line of sight, or little weight for another reason.
    pub rejected: usize,
    /// Number that came too late.
    pub late: usize,
}

impl Aided {
    fn count(&mut self, used: bool) {
        let counter = if used { &mut self.used } else { &mut self.rejected };
        *counter += 1;
    }

    /// Of all that was compared with the path.
    pub(super) fn compared(&self) -> usize {
        self.used + self.rejected
    }
}

/// The use of fixes along a path.
#[derive(Clone, Debug, Default)]
pub(super) struct Aiding {
    /// Fixes before this time were compared with the path, s.
    from_s: f64,
    /// Of all fixes that were compared with the path.
    pub log_likelihood: f64,
    pub fixes: Aided,
    pub ranges: Aided,
    /// Times of the first and of the last fix that contradicted the path, s.
    pub rejected_s: Option<[f64; 2]>,
    in_succession: usize,
    pub jumps: Vec<f64>,
    /// The anchors in the state, as soon as the path is in their frame.
    pub anchors: Option<AnchorStates>,
    pub suspects: Suspects,
    pub lag: Lag,
    /// Of position, velocity and heading.
    pub residuals: Vec<Residual>,
}

impl Aiding {
    /// From a time on, s: earlier fixes are left out.
    pub fn from(time_s: f64) -> Self {
        Self { from_s: time_s, ..Self::default() }
    }

    /// Updates with the fixes up to a time, s.
    pub fn update(
        &mut self,
        fixes: &Fixes,
        time_s: f64,
        navigator: &mut Navigator,
        segments: &mut Segments,
    ) {
        let next = fixes.fixes.partition_point(|fix| fix.time_s < self.from_s);
        for fix in fixes.fixes[next..].iter().take_while(|fix| fix.time_s <= time_s) {
            if fix.range_m.is_some() {
                self.take_range(fix, time_s - fix.time_s, fixes, navigator);
                segments.locate();
            } else {
                let age_s = time_s - fix.time_s;
                let accepted = self.is_accepted(fix, age_s, fixes.lever_arm_m, navigator, segments);
                self.fixes.count(accepted);
                if !accepted {
                    self.rejected_s =
                        Some([self.rejected_s.map_or(fix.time_s, |s| s[0]), fix.time_s]);
                }
            }
        }
        let next = fixes.speeds.partition_point(|speed| speed[0] < self.from_s);
        let speeds = fixes.speeds[next..].iter();
        for [_, speed_mps] in speeds.take_while(|speed| speed[0] <= time_s) {
            navigator.odometer(*speed_mps);
        }
        self.from_s = time_s.next_up();
    }

    fn take_range(&mut self, fix: &Fix, age_s: f64, fixes: &Fixes, navigator: &mut Navigator) {
        let states = self.anchors.as_mut().zip(fixes.ranging.as_ref());
        let (Some((states, ranging)), Some(range)) = (states, fix.range()) else {
            return;
        };
        let model = Model { lever_arm_m: fixes.lever_arm_m, ..ranging.model };
        let found = states.update(&model, range, age_s, navigator);
        self.log_likelihood += found.log_likelihood;
        let believed = found.weight >= LINE_OF_SIGHT;
        self.ranges.count(believed);
        self.suspects.see(&range, believed);
        if states.recovers(&ranging.positions_m(), &model, navigator) {
            self.jumps.push(fix.time_s);
        }
    }

    fn is_accepted(
        &mut self,
        fix: &Fix,
        age_s: f64,
        lever_arm_m: [f64; 3],
        navigator: &mut Navigator,
        segments: &mut Segments,
    ) -> bool {
        let mut accepted = true;
        if fix.has_position() {
            let position = Position {
                position_m: fix.position_m.into(),
                deviation_m: fix.position_sd_m.into(),
                lever_arm_m: lever_arm_m.into(),
            };
            let solution = navigator.solution();
            let off = position.position_m - Vector3::from(solution.position_m);
            let known = position.deviation_m.map(f64::is_finite);
            let off = off.zip_map(&known, |off, known| if known { off } else { 0.0 });
            if self.in_succession >= CONTRADICTIONS {
                navigator.loosen(off.norm());
                self.jumps.push(fix.time_s);
            }
            let innovation = navigator.fix(position, age_s, Gate::ChiSquare);
            segments.see_fix(&innovation);
            accepted &= self.count(fix.time_s, "position", off.norm(), &innovation);
            if accepted {
                segments.locate();
            } else {
                self.lag.see(&off, &solution.velocity_mps.into());
            }
            self.in_succession = if accepted { 0 } else { self.in_succession + 1 };
        }
        // A receiver filters its velocity more than its position: 0.1 s later on the drive of a car (score_localization).
        let delayed = navigator.vehicle().is_some() && fix.has_position();
        if let (false, Some((velocity_mps, deviation_mps))) = (delayed, fix.velocity_mps) {
            let velocity =
                Velocity { velocity_mps: velocity_mps.into(), deviation_mps, offset: None };
            let off = velocity.velocity_mps - Vector3::from(navigator.solution().velocity_mps);
            let innovation = navigator.update(&velocity, Gate::ChiSquare);
            accepted &= self.count(fix.time_s, "velocity", off.norm(), &innovation);
        }
        if let Some([heading_rad, deviation_rad]) = fix.heading_rad {
            let heading = Heading { heading_rad, deviation_rad };
            let off = heading_rad - navigator.heading();
            let innovation = navigator.update(&heading, Gate::ChiSquare);
            accepted &= self.count(fix.time_s, "heading", off.sin().atan2(off.cos()), &innovation);
        }
        accepted
    }

    fn count(&mut self, time_s: f64, aid: &str, value: f64, innovation: &Innovation) -> bool {
        self.log_likelihood += innovation.log_likelihood.max(OUTLIER);
        let Innovation { statistic, dof, accepted, .. } = *innovation;
        self.residuals.push(Residual {
            time_s,
            aid: aid.to_owned(),
            value,
            statistic,
            dof,
            accepted,
        });
        accepted
    }

    /// Says how many of `all` fixes were not compared.
    pub fn outside(&self, all: usize) -> Option<Problem> {
        let outside = all - self.fixes.compared();
        let text = || format!("{} outside the time of the recording", counted(outside, "fix"));
        (outside > 0).then(|| Code::Clock.note(text()))
    }
}

/// Standard deviations of a start whose position the first fix gives, m, that `--start` gives, m, and of each heading that
/// is tried, rad.
const START_M: f64 = 100.0;
const GIVEN_M: f64 = 0.3;
const HEADING_SD: f64 = 0.3;
/// Least time between two fixes whose difference shows a velocity, s: at 0.5 m of noise, 1.4 m/s.
const DIFFERENCE_S: f64 = 0.5;
/// Acceleration between a fix and the start, m/s². Assumed: a car that brakes or turns in traffic.
const VEHICLE_MPS2: f64 = 2.0;
/// Ranges of this time show the position at the start, s.
const FIRST_RANGES_S: f64 = 1.0;

/// Moves a navigator to a position in the frame of fixes, m, with its standard deviation, at a heading, rad.
pub(super) fn place(
    navigator: &mut Navigator,
    (position, position_sd): (Vector3<f64>, f64),
    velocity: Option<(Vector3<f64>, f64)>,
    heading: f64,
) {
    let solution = navigator.solution();
    let variance = Matrix3::from(solution.velocity_covariance).diagonal().max();
    let (velocity, velocity_sd) =
        velocity.unwrap_or((solution.velocity_mps.into(), variance.sqrt()));
    navigator.set_heading(heading);
    navigator.set_pose(position, velocity, heading, [position_sd, velocity_sd, HEADING_SD]);
}
