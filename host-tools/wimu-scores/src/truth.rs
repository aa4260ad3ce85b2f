//! True positions and attitudes, by time.

use std::path::Path;

use nalgebra::{UnitQuaternion, Vector3};

use crate::command::{Point, at};
use crate::manifest::Entry;
use crate::table::{ENU, Result, Table};

/// Largest interval of the truth that is interpolated, s.
const GAP_S: f64 = 0.5;
/// Intervals over which the speed shows a glitch, a moving sample, and the velocity of a start, s; speed of the second, m/s.
const GLITCH_S: f64 = 0.02;
const MOVING_S: f64 = 0.2;
const VELOCITY_S: f64 = 0.1;
const MOVING_MPS: f64 = 0.05;
/// Motion after the start of a window, fixes of the truth before it, and their interval, s.
const MOVES_S: f64 = 2.0;
const GIVEN_S: f64 = 1.5;
const FIX_S: f64 = 0.05;
const FIXES: &str = "Time (s),Position E (m),Position N (m),Position U (m),Velocity E (m/s),\
    Velocity N (m/s),Velocity U (m/s),Heading (deg),Position Sigma E (m),Position Sigma N (m),\
    Position Sigma U (m),Velocity Sigma E (m/s),Velocity Sigma N (m/s),Velocity Sigma U (m/s),\
    Heading Sigma (deg)";

pub struct Truth<'a> {
    points: Vec<Point>,
    pub entry: &'a Entry,
    /// Standard deviation, m.
    pub sd_m: f64,
}

impl<'a> Truth<'a> {
    /// `None` without columns of a truth.
    pub fn read(file: &Path, entry: &'a Entry) -> Result<Option<Self>> {
        let mut table = Table::read(file)?;
        if entry.planar {
            table = table.or_zero("Truth Position U (m)");
        }
        let Ok(positions) = table.vectors("Truth Position # (m)", ENU) else { return Ok(None) };
        let attitudes = table.attitudes("Truth Quaternion").ok();
        let mut points: Vec<Point> = Vec::new();
        for (k, (time_s, mut position)) in table.times()?.into_iter().zip(positions).enumerate() {
            let time_s = time_s - entry.lag_s.unwrap_or(0.0);
            if position.norm().is_nan() || points.last().is_some_and(|p| p.time_s >= time_s) {
                continue;
            }
            if entry.left_handed {
                position.y = -position.y;
            }
            let attitude = attitudes.as_ref().map(|all| all[k]);
            let attitude = attitude.map(|q| if entry.inverse_attitude { q.inverse() } else { q });
            points.push(Point { attitude, ..Point::new(time_s, position) });
        }
        Ok(Some(Self::new(points, entry)))
    }

    pub fn new(points: Vec<Point>, entry: &'a Entry) -> Self {
        let mut truth =
            Self { points: points.clone(), entry, sd_m: entry.truth_sd_m.unwrap_or(0.001) };
        let fastest_mps = entry.fastest_mps.unwrap_or(f64::INFINITY);
        let speed = |p: &Point| truth.velocity(p.time_s, GLITCH_S).map_or(0.0, |v| v.norm());
        let mut is_glitch: Vec<bool> = points.iter().map(|p| speed(p) > fastest_mps).collect();
        // Beside a jump the truth repeats the last value that it saw.
        let is_held = |k: usize| points[k].value == points[k - 1].value;
        for k in 1..points.len() {
            is_glitch[k] |= is_glitch[k - 1] && is_held(k);
        }
        for k in (1..points.len()).rev() {
            is_glitch[k - 1] |= is_glitch[k] && is_held(k);
        }
        let kept = points.iter().zip(&is_glitch).filter(|(_, is_glitch)| !**is_glitch);
        truth.points = kept.map(|(point, _)| *point).collect();
        truth
    }

    pub fn position(&self, time_s: f64) -> Option<Vector3<f64>> {
        let next = self.points.partition_point(|point| point.time_s < time_s);
        let before = self.points.get(next.saturating_sub(1))?;
        let is_dense = self.points.get(next)?.time_s - before.time_s <= GAP_S;
        at(&self.points, time_s).filter(|_| is_dense).map(|point| point.value)
    }

    fn velocity(&self, time_s: f64, over_s: f64) -> Option<Vector3<f64>> {
        let [before, after] = [-0.5, 0.5].map(|part| self.position(time_s + part * over_s));
        Some((after? - before?) / over_s)
    }

    /// Direction of body x from east to north, rad.
    pub fn heading(&self, time_s: f64) -> Option<f64> {
        heading(at(&self.points, time_s)?.attitude)
    }

    /// Position, velocity and heading.
    pub fn start(&self, time_s: f64) -> Option<(Vector3<f64>, Vector3<f64>, f64)> {
        let velocity = self.velocity(time_s, VELOCITY_S)?;
        Some((self.position(time_s)?, velocity, self.heading(time_s)?))
    }

    /// Whether a sample is scored.
    pub fn is_moving(&self, time_s: f64) -> bool {
        let is_within = self.entry.span_s.is_none_or(|[a, b]| (a..=b).contains(&time_s));
        let least_mps = self.entry.moving_mps.unwrap_or(MOVING_MPS);
        is_within && self.velocity(time_s, MOVING_S).is_some_and(|v| v.norm() > least_mps)
    }

    /// Starts of windows at whole seconds, each with truth from its first fix to its end, s.
    pub fn windows(&self, length_s: f64) -> Vec<f64> {
        let times = || self.points.iter().map(|point| point.time_s);
        let (from_s, until_s) = (times().next().unwrap_or(0.0), times().next_back().unwrap_or(0.0));
        let is_used = |start_s: &f64| {
            let steps = |from_s: f64, until_s: f64| {
                let count = ((until_s - from_s) / FIX_S) as usize;
                (0..=count).map(move |k| start_s + from_s + k as f64 * FIX_S)
            };
            self.start(*start_s).is_some()
                && steps(-GIVEN_S, length_s).all(|t| self.position(t).is_some())
                && steps(0.0, MOVES_S).all(|t| self.is_moving(t))
        };
        (from_s as i64..until_s as i64).map(|second| second as f64).filter(is_used).collect()
    }

    /// Fixes that end at the starts of windows.
    pub fn fixes(&self, starts: &[f64]) -> Table {
        let (sd, speed_sd) = (self.sd_m, 0.02 + 3.0 * self.sd_m);
        let sds = [sd, sd, sd, speed_sd, speed_sd, speed_sd, 0.5];
        let steps = (0..=(GIVEN_S / FIX_S) as usize).rev().map(|k| k as f64 * FIX_S);
        let times = starts.iter().flat_map(|start_s| steps.clone().map(move |step| start_s - step));
        let row = |t: f64| {
            let (position, velocity, heading) = self.start(t)?;
            let state = [t].into_iter().chain(position.iter().chain(&velocity).copied());
            Some(state.chain([heading.to_degrees()]).chain(sds).collect())
        };
        Table::of(FIXES, times.filter_map(row))
    }
}

/// Direction of body x from east to north, rad; none where x is steeper than 60°.
pub fn heading(attitude: Option<UnitQuaternion<f64>>) -> Option<f64> {
    let x = attitude? * Vector3::x();
    (x.xy().norm() > 0.5).then(|| x.y.atan2(x.x))
}
