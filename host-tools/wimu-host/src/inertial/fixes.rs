//! Measurements of other systems: position, height, velocity and heading fixes, and a path that ends where it began.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use wimu_nav::filter::{Gate, Innovation};
use wimu_nav::navigator::{Model, Navigator};
use wimu_nav::sensor::{Heading, Position, Velocity};
use wimu_nav::smoother::Recorder;

use crate::csv::columns::{ANGLE, LENGTH, SPEED, TIME, Table};
use crate::finding::{Finding, FindingCode};
use crate::plural::counted;
use crate::{ErrorCode, Result};

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
}

/// Fixes, in the order of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Fixes {
    /// The measurements.
    pub fixes: Vec<Fix>,
    /// The antenna from the origin of the unit, m, body axes.
    pub lever_arm_m: [f64; 3],
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
        Self::of(&Table::read(path)?, delay_s, None)
    }

    /// Those of a table. `arrived_s`: the time of rows of a table without times.
    pub(super) fn of(table: &Table, delay_s: f64, arrived_s: Option<f64>) -> Result<Self> {
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
        let columns = position.iter().chain(&velocity).chain(&heading[..1]);
        if columns.flatten().next().is_none() {
            return Err(table.missing("Position E (m)"));
        }
        let mut fixes = Vec::new();
        for row in 0..table.rows.len() {
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
            let velocity_sd = three(velocity_sd)?.into_iter().flatten();
            let velocity_sd = velocity_sd.reduce(f64::max).unwrap_or(VELOCITY_SD_MPS);
            let velocity = match three(velocity)? {
                [Some(e), Some(n), Some(u)] => Some(([e, n, u], velocity_sd)),
                _ => None,
            };
            let sd = |value: Option<f64>, usual: f64| value.filter(|sd| *sd > 0.0).unwrap_or(usual);
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
            };
            if fix.has_position() || fix.velocity_mps.is_some() || fix.heading_rad.is_some() {
                fixes.push(fix);
            }
        }
        if fixes.is_empty() {
            let remedy = "fill in the position, velocity or heading of at least one row";
            return Err(table.empty("there is no fix", remedy));
        }
        fixes.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        Ok(Self {
            fixes,
            ..Self::default()
        })
    }

    /// Refuses fixes of which none is within the times of a recording, s.
    pub(super) fn within(&self, times_s: &[f64]) -> Result<()> {
        let ends =
            (self.fixes.first().zip(self.fixes.last())).zip(times_s.first().zip(times_s.last()));
        let Some(((first, last), (from, to))) = ends else {
            return Ok(());
        };
        if self
            .fixes
            .iter()
            .any(|fix| (*from..=*to).contains(&fix.time_s))
        {
            return Ok(());
        }
        let message = format!(
            "no fix is within the time of the recording: fixes from {:.2} to {:.2} s, samples from {from:.2} to {to:.2} s",
            first.time_s, last.time_s
        );
        Err(ErrorCode::DataRefused.error(message, "give both the times of one clock"))
    }

    /// The first fix of the horizontal position: the path is in its frame.
    pub(super) fn origin(&self) -> Option<&Fix> {
        let level = |fix: &&Fix| fix.position_sd_m[..2].iter().all(|sd| sd.is_finite());
        self.fixes.iter().find(level)
    }
}

impl Fix {
    fn has_position(&self) -> bool {
        self.position_sd_m.iter().any(|sd| sd.is_finite())
    }
}

/// Fixes of the position in succession that fail their test until one is taken for true: the path is wrong.
const CONTRADICTIONS: usize = 5;

/// Logarithm of the density of a fix that contradicts the path, in 1/m³: a fix anywhere within 100 m.
const OUTLIER: f64 = -13.8;

/// The use of fixes along a path.
#[derive(Clone, Debug)]
pub(super) struct Aiding {
    /// Fixes before this time were compared with the path, s.
    from_s: f64,
    /// Of all fixes that were compared with the path.
    pub log_likelihood: f64,
    used: usize,
    rejected: Vec<f64>,
    in_succession: usize,
    jumps: Vec<f64>,
}

impl Aiding {
    /// From a time on, s: earlier fixes are left out.
    pub fn from(time_s: f64) -> Self {
        Self {
            from_s: time_s,
            log_likelihood: 0.0,
            used: 0,
            rejected: Vec::new(),
            in_succession: 0,
            jumps: Vec::new(),
        }
    }

    /// Updates with the fixes up to a time, s.
    pub fn update<M: Model<f64, N>, const N: usize, L: Recorder<f64, N>>(
        &mut self,
        fixes: &Fixes,
        time_s: f64,
        navigator: &mut Navigator<f64, M, N, L>,
    ) {
        let next = fixes.fixes.partition_point(|fix| fix.time_s < self.from_s);
        for fix in fixes.fixes[next..]
            .iter()
            .take_while(|fix| fix.time_s <= time_s)
        {
            if self.is_accepted(fix, time_s - fix.time_s, fixes.lever_arm_m, navigator) {
                self.used += 1;
            } else {
                self.rejected.push(fix.time_s);
            }
        }
        let next = fixes.speeds.partition_point(|speed| speed[0] < self.from_s);
        let speeds = fixes.speeds[next..].iter();
        for [_, speed_mps] in speeds.take_while(|speed| speed[0] <= time_s) {
            navigator.odometer(*speed_mps);
        }
        self.from_s = time_s.next_up();
    }

    fn is_accepted<M: Model<f64, N>, const N: usize, L: Recorder<f64, N>>(
        &mut self,
        fix: &Fix,
        age_s: f64,
        lever_arm_m: [f64; 3],
        navigator: &mut Navigator<f64, M, N, L>,
    ) -> bool {
        let mut accepted = true;
        if fix.has_position() {
            let position = Position {
                position_m: fix.position_m.into(),
                deviation_m: fix.position_sd_m.into(),
                lever_arm_m: lever_arm_m.into(),
            };
            if self.in_succession >= CONTRADICTIONS {
                let off = position.position_m - Vector3::from(navigator.solution().position_m);
                let known = position.deviation_m.map(f64::is_finite);
                let off = off.zip_map(&known, |off, known| if known { off } else { 0.0 });
                navigator.loosen_position(off.norm());
                self.jumps.push(fix.time_s);
            }
            accepted &= self.count(&navigator.fix(position, age_s, Gate::ChiSquare));
            self.in_succession = if accepted { 0 } else { self.in_succession + 1 };
        }
        // A receiver filters its velocity more than its position: 0.1 s later on the drive of a car (score_localization).
        let delayed = navigator.vehicle().is_some() && fix.has_position();
        if let (false, Some((velocity_mps, deviation_mps))) = (delayed, fix.velocity_mps) {
            let velocity = Velocity {
                velocity_mps: velocity_mps.into(),
                deviation_mps,
                offset: None,
            };
            accepted &= self.count(&navigator.update(&velocity, Gate::ChiSquare));
        }
        if let Some([heading_rad, deviation_rad]) = fix.heading_rad {
            let heading = Heading {
                heading_rad,
                deviation_rad,
            };
            accepted &= self.count(&navigator.update(&heading, Gate::ChiSquare));
        }
        accepted
    }

    fn count(&mut self, innovation: &Innovation<f64>) -> bool {
        self.log_likelihood += innovation.log_likelihood.max(OUTLIER);
        innovation.accepted
    }

    /// What happened to the fixes up to now.
    pub fn findings(&self) -> Vec<Finding> {
        let all = self.used + self.rejected.len();
        let mut found = Vec::new();
        if let (Some(first), Some(last)) = (self.rejected.first(), self.rejected.last()) {
            let text = format!(
                "{} of {all} fixes contradict the path by far more than both standard deviations: not used",
                self.rejected.len()
            );
            let remedy = "check their standard deviations, the delay (--fix-delay) and the lever arm (--lever-arm)";
            let finding = FindingCode::Navigation.warning(text).remedy(remedy);
            found.push(finding.between(*first, *last));
        }
        if let (Some(first), Some(last)) = (self.jumps.first(), self.jumps.last()) {
            let text = format!(
                "{CONTRADICTIONS} fixes in succession contradicted the path, {}: it jumps to the next one there",
                counted(self.jumps.len(), "time")
            );
            let finding = FindingCode::Navigation.warning(text);
            found.push(finding.between(*first, *last));
        }
        found
    }

    /// Says how many of `all` fixes were not compared.
    pub fn outside(&self, all: usize) -> Option<Finding> {
        let outside = all - self.used - self.rejected.len();
        let text = || {
            format!(
                "{} outside the time of the recording",
                counted(outside, "fix")
            )
        };
        (outside > 0).then(|| FindingCode::Clock.note(text()))
    }
}

/// Standard deviations of a start whose position the first fix gives, m, and of each heading that is tried, rad.
const START_M: f64 = 100.0;
const HEADING_SD: f64 = 0.3;

/// Moves a navigator to the frame of fixes, at a heading, rad.
pub(super) fn place<M: Model<f64, N>, const N: usize, L: Recorder<f64, N>>(
    navigator: &mut Navigator<f64, M, N, L>,
    fix: &Fix,
    heading: f64,
) {
    let solution = navigator.solution();
    let variance = Matrix3::from(solution.velocity_covariance).diagonal().max();
    navigator.set_heading(heading);
    let deviations = [START_M, variance.sqrt(), HEADING_SD];
    navigator.set_pose(
        fix.position_m.into(),
        solution.velocity_mps.into(),
        heading,
        deviations,
    );
}
