//! Whether what goes back in time is late, or the device has started anew.
//!
//! Both look alike at first: numbers and times begin anew at each start, from the same beginnings.
//! What follows tells. After something late or repeated the present start goes on; after a restart
//! nothing is as far as the present start would be by then.

/// What goes back by no more than this is late: a device is not up again so soon, µs.
const LATE_US: i64 = 500_000;
/// How long a new start must have gone on without a sign of the old one, ns.
const CERTAIN_NS: u64 = 3_000_000_000;
/// The same where the numbers have passed the old one's.
const CERTAIN_BEYOND_NS: u64 = 5_000_000_000;
/// By how much a new start's frames may be later than its first, µs.
const LATENCY_US: i64 = 1_000_000;
/// Held at most: more than arrive while it is uncertain.
const MAX_HELD: usize = 2048;

/// Something at its time of arrival and at its device time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment {
    /// Host's monotonic clock, ns.
    pub host_ns: u64,
    /// Device time, µs; at most 2⁶³ − 1.
    pub time_us: u64,
}

impl Moment {
    /// The device time at `host_ns`, if nothing is late and the device has gone on.
    fn foretold_us(self, host_ns: u64) -> i64 {
        let passed_us = host_ns.saturating_sub(self.host_ns) / 1000;
        self.time_us.saturating_add(passed_us).min(i64::MAX as u64) as i64
    }
}

/// Where something is among its kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// Behind the latest, and next to it.
    Next,
    /// Behind the latest.
    Ahead,
    /// Not behind the latest.
    Back,
}

/// What to do with it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// It goes on.
    InOrder,
    /// It is late or repeated.
    Late,
    /// To be held until what follows tells.
    Hold,
    /// What is held was late; this goes on.
    HeldWasLate,
    /// The device has started anew before what is held.
    NewStart,
}

/// The order of what a link brings of one start; holds `T`.
#[derive(Debug)]
pub(super) struct Order<T> {
    front: Option<Moment>,
    doubt: Option<Moment>,
    held: Vec<T>,
}

impl<T> Order<T> {
    /// Nothing has come yet.
    pub fn new() -> Self {
        Self {
            front: None,
            doubt: None,
            held: Vec::new(),
        }
    }

    /// Whether something is held: all that follows is, too, until it is decided.
    pub fn is_in_doubt(&self) -> bool {
        self.doubt.is_some()
    }

    /// Whether what tells nothing of its place is to be held: in doubt, while there is room.
    pub fn holds(&self) -> bool {
        self.is_in_doubt() && self.held.len() < MAX_HELD
    }

    /// What is held.
    pub fn held(&self) -> &[T] {
        &self.held
    }

    /// The latest device time, µs.
    pub fn latest_us(&self) -> Option<u64> {
        self.front.map(|front| front.time_us)
    }

    /// Holds something.
    pub fn hold(&mut self, held: T) {
        self.held.push(held);
    }

    /// Ends the doubt; returns what was held.
    pub fn release(&mut self) -> Vec<T> {
        self.doubt = None;
        std::mem::take(&mut self.held)
    }

    /// What to do with what has come.
    pub fn judge(&mut self, moment: Moment, place: Place) -> Verdict {
        let (Some(front), Some(doubt)) = (self.front, self.doubt) else {
            return self.judge_undoubted(moment, place);
        };
        let time = moment.time_us as i64;
        let old = front.foretold_us(moment.host_ns);
        let new = doubt.foretold_us(moment.host_ns);
        let is_nearer_to_old = time > new + (old - new) / 2;
        let is_late_for_new = time < new - LATENCY_US;
        // After a stall what is next to the old is far behind both.
        let is_old = is_nearer_to_old || (place == Place::Next && is_late_for_new);
        if is_old && place != Place::Back {
            self.advance(moment);
            return Verdict::HeldWasLate;
        }
        let held_ns = moment.host_ns.saturating_sub(doubt.host_ns);
        let fits_new = !is_nearer_to_old && !is_late_for_new;
        let certain_ns = if place == Place::Back {
            CERTAIN_NS
        } else {
            CERTAIN_BEYOND_NS
        };
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
        let back_us = self.front.map_or(0, |front| {
            front.foretold_us(moment.host_ns) - moment.time_us as i64
        });
        if back_us <= LATE_US {
            return Verdict::Late;
        }
        self.doubt = Some(moment);
        Verdict::Hold
    }

    fn advance(&mut self, moment: Moment) {
        if self
            .front
            .is_none_or(|front| moment.time_us > front.time_us)
        {
            self.front = Some(moment);
        }
    }
}
