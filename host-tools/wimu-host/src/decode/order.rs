//! Distinction between delayed data and a restart of the device, when time goes back.
//!
//! Both look alike at first, because numbers and times begin again at each start. Later data
//! decide: after delayed or repeated data the present start continues; after a restart
//! no data are as far as the present start would be.

/// Data that go back by at most this are delayed: a restart takes longer, µs.
const LATE_US: i64 = 500_000;
/// Duration of a new start without data of the old one after which it is accepted, ns.
const CERTAIN_NS: u64 = 3_000_000_000;
/// The same where the numbers have passed those of the old start.
const CERTAIN_BEYOND_NS: u64 = 5_000_000_000;
/// Largest delay of a new start's frames relative to its first one, µs.
const LATENCY_US: i64 = 1_000_000;
/// Largest number of items held: more than arrive until the decision.
const MAX_HELD: usize = 2048;

/// Time of arrival and device time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment {
    /// Host's monotonic clock, ns.
    pub host_ns: u64,
    /// Device time, µs; at most 2⁶³ − 1.
    pub time_us: u64,
}

impl Moment {
    /// The device time at `host_ns`, if nothing is delayed and the device has not restarted.
    fn foretold_us(self, host_ns: u64) -> i64 {
        let passed_us = host_ns.saturating_sub(self.host_ns) / 1000;
        self.time_us.saturating_add(passed_us).min(i64::MAX as u64) as i64
    }
}

/// Position of data in their stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// Next to the latest.
    Next,
    /// After the latest.
    Ahead,
    /// At or before the latest.
    Back,
}

/// How to treat data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// They continue the present start.
    InOrder,
    /// They are delayed or repeated.
    Late,
    /// Hold them until later data decide.
    Hold,
    /// The held data were delayed; these continue the present start.
    HeldWasLate,
    /// The device has restarted before the held data.
    NewStart,
}

/// The order of a link's data within one start; holds `T`.
#[derive(Debug)]
pub(super) struct Order<T> {
    front: Option<Moment>,
    doubt: Option<Moment>,
    held: Vec<T>,
}

impl<T> Default for Order<T> {
    fn default() -> Self {
        Self { front: None, doubt: None, held: Vec::new() }
    }
}

impl<T> Order<T> {
    /// Whether data are held: all later data are held too, until the decision.
    pub fn is_in_doubt(&self) -> bool {
        self.doubt.is_some()
    }

    /// Whether data without a number or time are to be held: in doubt, while there is room.
    pub fn holds(&self) -> bool {
        self.is_in_doubt() && self.held.len() < MAX_HELD
    }

    /// The held data.
    pub fn held(&self) -> &[T] {
        &self.held
    }

    /// The latest device time, µs.
    pub fn latest_us(&self) -> Option<u64> {
        self.front.map(|front| front.time_us)
    }

    /// Holds an item.
    pub fn hold(&mut self, held: T) {
        self.held.push(held);
    }

    /// Ends the doubt; returns the held data.
    pub fn release(&mut self) -> Vec<T> {
        self.doubt = None;
        std::mem::take(&mut self.held)
    }

    /// Decides how to treat new data.
    pub fn judge(&mut self, moment: Moment, place: Place) -> Verdict {
        let (Some(front), Some(doubt)) = (self.front, self.doubt) else {
            return self.judge_undoubted(moment, place);
        };
        let time = moment.time_us as i64;
        let old = front.foretold_us(moment.host_ns);
        let new = doubt.foretold_us(moment.host_ns);
        let is_nearer_to_old = time > new + (old - new) / 2;
        let is_late_for_new = time < new - LATENCY_US;
        // After a stall, data next to the old ones are far behind both.
        let is_old = is_nearer_to_old || (place == Place::Next && is_late_for_new);
        if is_old && place != Place::Back {
            self.advance(moment);
            return Verdict::HeldWasLate;
        }
        let held_ns = moment.host_ns.saturating_sub(doubt.host_ns);
        let fits_new = !is_nearer_to_old && !is_late_for_new;
        let certain_ns = if place == Place::Back { CERTAIN_NS } else { CERTAIN_BEYOND_NS };
        if (fits_new && held_ns >= certain_ns) || self.held.len() >= MAX_HELD {
            return Verdict::NewStart;
        }
        Verdict::Hold
    }

    fn judge_undoubted(&mut self, moment: Moment, place: Place) -> Verdict {
        if place != Place::Back {
            self.advance(moment);
            return Verdict::InOrder;
        }
        let back_us =
            self.front.map_or(0, |front| front.foretold_us(moment.host_ns) - moment.time_us as i64);
        if back_us <= LATE_US {
            return Verdict::Late;
        }
        self.doubt = Some(moment);
        Verdict::Hold
    }

    fn advance(&mut self, moment: Moment) {
        if self.front.is_none_or(|front| moment.time_us > front.time_us) {
            self.front = Some(moment);
        }
    }
}
