//! Specific force as the sum of linear acceleration and gravity that a phone reports apart.

use crate::recording::{Quantity, Sink, TrackId, TrackInfo, Unit};
use crate::{Code, Problem};

/// Longest time between two samples of gravity between which it is interpolated, ns. Chosen: some periods of the slowest
/// setting of phones.
const MAX_STEP_NS: i64 = 500_000_000;

/// Rows of a track.
struct Kept {
    info: TrackInfo,
    track: TrackId,
    rows: Vec<(i64, [f64; 3])>,
}

/// Hands everything on, and at the end the sum, if there is no other specific force.
pub struct WithGravity<'a> {
    inner: &'a mut dyn Sink,
    kept: Vec<Kept>,
    has_force: bool,
    /// Whether all tracks come before the first row.
    is_one_table: bool,
    /// Findings of missing gravity.
    missing: Vec<Problem>,
}

impl<'a> WithGravity<'a> {
    /// Hands on to `inner` one table, or several.
    pub fn new(inner: &'a mut dyn Sink, is_one_table: bool) -> Self {
        Self { inner, kept: Vec::new(), has_force: false, is_one_table, missing: Vec::new() }
    }

    /// Hands the sum on, or the findings of missing gravity.
    pub fn finish(self) {
        let of = |quantity| self.kept.iter().find(|kept| kept.info.quantity == quantity);
        match (of(Quantity::LinearAcceleration), of(Quantity::Gravity)) {
            _ if self.has_force => {}
            (Some(linear), Some(gravity)) => add(linear, gravity, self.inner),
            _ => self.missing.into_iter().for_each(|finding| self.inner.finding(finding)),
        }
    }
}

impl Sink for WithGravity<'_> {
    fn track(&mut self, info: TrackInfo) -> TrackId {
        let track = self.inner.track(info.clone());
        self.has_force |= info.quantity == Quantity::SpecificForce;
        let is_part = matches!(info.quantity, Quantity::LinearAcceleration | Quantity::Gravity);
        if is_part && info.unit == Unit::Si {
            let rows = Vec::new();
            self.kept.push(Kept { info, track, rows });
        }
        track
    }

    fn row(&mut self, track: TrackId, time_ns: i64, values: &[f64]) {
        // Without its counterpart a track need not be kept.
        let is_needed = !self.has_force && (!self.is_one_table || self.kept.len() > 1);
        if let Some(kept) =
            self.kept.iter_mut().find(|kept| kept.track == track).filter(|_| is_needed)
            && let Ok(values) = values.try_into()
        {
            kept.rows.push((time_ns, values));
        }
        self.inner.row(track, time_ns, values);
    }

    fn finding(&mut self, finding: Problem) {
        match finding.code {
            Code::GravityMissing => self.missing.push(finding),
            _ => self.inner.finding(finding),
        }
    }
}

fn add(linear: &Kept, gravity: &Kept, sink: &mut dyn Sink) {
    let name = format!("{} + {}", linear.info.name, gravity.info.name);
    let track = sink.track(TrackInfo::new(name, Quantity::SpecificForce, Unit::Si));
    let mut after = 0;
    let mut without = 0;
    for (time, acceleration) in &linear.rows {
        while gravity.rows.get(after).is_some_and(|(t, _)| t < time) {
            after += 1;
        }
        let sum = match at(&gravity.rows, after, *time) {
            Some(gravity) => [0, 1, 2].map(|k| acceleration[k] + gravity[k]),
            None => {
                without += 1;
                [f64::NAN; 3]
            }
        };
        sink.row(track, *time, &sum);
    }
    let text = format!(
        "`{}` excludes gravity; that of `{}` was added to {} of {} samples",
        linear.info.name,
        gravity.info.name,
        linear.rows.len() - without,
        linear.rows.len()
    );
    let remedy = "gravity is an estimate of the phone: an acceleration with gravity is better";
    sink.finding(Code::GravityAdded.note(text).remedy(remedy));
}

/// Gravity at a time, of which `after` is the first row not before it.
fn at(rows: &[(i64, [f64; 3])], after: usize, time: i64) -> Option<[f64; 3]> {
    let (t1, v1) = *rows.get(after)?;
    if t1 == time {
        return Some(v1);
    }
    let (t0, v0) = *rows.get(after.checked_sub(1)?)?;
    let step = t1.checked_sub(t0).filter(|step| (1..=MAX_STEP_NS).contains(step))?;
    let fraction = time.checked_sub(t0)? as f64 / step as f64;
    Some([0, 1, 2].map(|k| v0[k] + fraction * (v1[k] - v0[k])))
}
