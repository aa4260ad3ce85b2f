//! Specific force as the sum of linear acceleration and gravity that a phone reports apart.

use nalgebra::Vector3;

use super::{Quantity, Sink, TrackId, TrackInfo, Unit};
use crate::series::{Interp, Ns, Series};
use crate::{Code, Problem};

/// Longest time between two samples of gravity between which it is interpolated, s. Chosen: some periods of the slowest
/// setting of phones.
const MAX_STEP_S: f64 = 0.5;

/// Rows of a track.
struct Kept {
    info: TrackInfo,
    track: TrackId,
    rows: Vec<(i64, [f64; 3])>,
}

/// The parts of a specific force, until there is a whole one.
pub(super) struct Gravity {
    kept: Vec<Kept>,
    has_force: bool,
    /// Whether all tracks come before the first row.
    is_one_table: bool,
    /// Problems of missing gravity.
    missing: Vec<Problem>,
}

impl Gravity {
    pub(super) fn new(is_one_table: bool) -> Self {
        Self { kept: Vec::new(), has_force: false, is_one_table, missing: Vec::new() }
    }

    pub(super) fn track(&mut self, info: TrackInfo, track: TrackId) {
        self.has_force |= info.quantity == Quantity::SpecificForce;
        let is_part = matches!(info.quantity, Quantity::LinearAcceleration | Quantity::Gravity);
        if is_part && info.unit == Unit::Si {
            self.kept.push(Kept { info, track, rows: Vec::new() });
        }
    }

    pub(super) fn row(&mut self, track: TrackId, time_ns: i64, values: &[f64]) {
        // Without its counterpart a track need not be kept.
        if self.has_force || self.is_one_table && self.kept.len() < 2 {
            return;
        }
        let kept = self.kept.iter_mut().find(|kept| kept.track == track);
        if let (Some(kept), Ok(values)) = (kept, values.try_into()) {
            kept.rows.push((time_ns, values));
        }
    }

    /// Keeps a problem of missing gravity; returns others.
    pub(super) fn keep(&mut self, problem: Problem) -> Option<Problem> {
        if problem.code == Code::GravityMissing {
            self.missing.push(problem);
            return None;
        }
        Some(problem)
    }

    /// Hands the sum on, or the problems of missing gravity.
    pub(super) fn finish(self, sink: &mut dyn Sink) {
        if self.has_force {
            return;
        }
        let of = |quantity| self.kept.iter().find(|kept| kept.info.quantity == quantity);
        match (of(Quantity::LinearAcceleration), of(Quantity::Gravity)) {
            (Some(linear), Some(gravity)) => add(linear, gravity, sink),
            _ => self.missing.into_iter().for_each(|problem| sink.finding(problem)),
        }
    }
}

fn add(linear: &Kept, gravity: &Kept, sink: &mut dyn Sink) {
    let name = format!("{} + {}", linear.info.name, gravity.info.name);
    let track = sink.track(TrackInfo::new(name, Quantity::SpecificForce, Unit::Si));
    let rows = gravity.rows.iter().map(|(time, value)| (Ns(*time), Vector3::from(*value)));
    let gravity_at = Series::of(rows).with_gap(MAX_STEP_S);
    let mut added = 0;
    for (time, acceleration) in &linear.rows {
        let gravity = gravity_at.at(Ns(*time), Interp::Linear);
        added += usize::from(gravity.is_some());
        let sum = gravity
            .map_or([f64::NAN; 3], |gravity| (Vector3::from(*acceleration) + gravity.value).into());
        sink.row(track, *time, &sum);
    }
    let text = format!(
        "`{}` excludes gravity; that of `{}` was added to {added} of {} samples",
        linear.info.name,
        gravity.info.name,
        linear.rows.len()
    );
    let remedy = "gravity is an estimate of the phone: an acceleration with gravity is better";
    sink.finding(Code::GravityAdded.note(text).remedy(remedy));
}
