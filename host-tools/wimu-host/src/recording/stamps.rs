//! The time stamps of rows as one clock: counters that wrap, clocks that restart, equal stamps, single wrong ones.
//!
//! A stamp is judged by the rows around it: one that the rows after it contradict is wrong, one that they follow is a gap, a
//! wrap or a restart. So rows are held back, and handed on with their times.

use std::collections::VecDeque;

use super::TrackId;
use crate::plural::counted;
use crate::problem::Severity;
use crate::{Code, Problem};

/// Rows by which a stamp is judged.
const AHEAD: usize = 32;
/// Rows with one stamp that are spread, at most.
const MOST_EQUAL: usize = 4096;
/// Periods of a step that may be one between neighbours. Longer ones, and steps back, are judged.
const FAR: f64 = 10.0;
/// Taken for the time between the end of a clock and its restart, which is not known, ns; longer than a break.
const RESTART_NS: i64 = 2_000_000_000;
/// Restarts after which a table is one of unordered rows.
const MOST_RESTARTS: usize = 16;
/// Ticks after which counters start again: 16 and 32 bits, signed or not.
const MODULI: [i64; 2] = [1 << 16, 1 << 32];
/// Times after which clocks of an hour, half a day or a day start again, and by which summer time begins and ends, ns.
const CYCLES_NS: [i64; 3] = [3_600_000_000_000, 43_200_000_000_000, 86_400_000_000_000];
/// Share of equal stamps, or of rows that are out of order, that is worth a warning.
const MANY: f64 = 0.01;
/// Periods between two rows beyond which one between them is missing.
const HOLE: f64 = 1.5;

/// The stamps of a track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Stamped {
    /// Those of a clock of its own, whose counter has ticks of this length, ns; `None`: dates.
    By(Option<i64>),
    /// Those of the rows of another track.
    Like(TrackId),
}

/// A row that is held back.
#[derive(Default)]
struct Row {
    time_ns: i64,
    values: Vec<(TrackId, [f64; 4], usize)>,
}

/// Where a row goes; one with a wrong stamp has no values.
type Out<'a> = dyn FnMut(TrackId, i64, &[f64]) + 'a;

/// The clock of some tracks.
#[derive(Default)]
pub(super) struct Clock {
    /// Name of its first track.
    pub(super) name: String,
    tick_ns: Option<i64>,
    rows: VecDeque<Row>,
    /// Rows that have been handed on, for their room.
    spare: Vec<Row>,
    /// What is added to the stamps, ns.
    offset_ns: i64,
    /// Latest stamp with it, and latest time that was handed on, ns.
    last_ns: Option<[i64; 2]>,
    first_ns: i64,
    /// Time between rows that were spread last, ns.
    spacing_ns: i64,
    count: usize,
    equal: usize,
    /// Rows that came after later ones, and were put before them.
    moved: usize,
    wraps: usize,
    restarts: usize,
    /// Rows with a wrong stamp, and the time of the first, ns.
    wrong: (usize, i64),
}

impl Clock {
    pub(super) fn new(name: &str, tick_ns: Option<i64>) -> Self {
        Self { name: name.to_owned(), tick_ns, ..Self::default() }
    }

    /// Takes a row, and hands on those that are settled.
    pub(super) fn push(&mut self, track: TrackId, time_ns: i64, values: &[f64], out: &mut Out) {
        let mut kept = [f64::NAN; 4];
        let width = values.len().min(kept.len());
        kept[..width].copy_from_slice(&values[..width]);
        let place = self.place(time_ns);
        let has_no = |row: &&mut Row| {
            row.time_ns == time_ns && row.values.iter().all(|(known, ..)| *known != track)
        };
        let same = place.checked_sub(1).and_then(|before| self.rows.get_mut(before));
        if let Some(row) = same.filter(has_no) {
            return row.values.push((track, kept, width));
        }
        let place = self.missing_at(place, time_ns).unwrap_or(self.rows.len());
        self.moved += usize::from(place < self.rows.len());
        let mut row = self.spare.pop().unwrap_or_default();
        row.time_ns = time_ns;
        row.values.push((track, kept, width));
        self.rows.insert(place, row);
        if self.rows.len() > 2 * AHEAD {
            self.settle(false, out);
        }
    }

    /// Index after the last held row that is not later.
    fn place(&self, time_ns: i64) -> usize {
        self.rows.iter().rposition(|row| row.time_ns <= time_ns).map_or(0, |before| before + 1)
    }

    /// The place in the order of time of a stamp that goes back, where a row is missing: packets overtake each other.
    fn missing_at(&self, place: usize, time_ns: i64) -> Option<usize> {
        let next_ns = self.rows.get(place)?.time_ns;
        let period_ns = self.median_step_ns();
        let until_next = |time_ns: i64| next_ns.saturating_sub(time_ns) as f64 / period_ns;
        let before = place.checked_sub(1).map(|before| self.rows[before].time_ns);
        let is_between = match before {
            Some(before_ns) => before_ns < time_ns && until_next(before_ns) > HOLE,
            None => self.last_ns.is_none(),
        };
        let is_missing = is_between && until_next(time_ns) <= FAR;
        is_missing.then_some(place)
    }

    /// Hands on the rows that are left.
    pub(super) fn finish(&mut self, out: &mut Out) {
        while !self.rows.is_empty() {
            self.settle(true, out);
        }
    }

    /// What was found.
    pub(super) fn problems(&self) -> Vec<Problem> {
        let mut problems = Vec::new();
        if self.equal > 0 {
            let share = self.equal as f64 / self.count as f64;
            let text = format!(
                "{} of {} time stamps equal the one before ({:.0} %)",
                self.equal,
                self.count,
                100.0 * share
            );
            let severity = if share > MANY { Severity::Warning } else { Severity::Note };
            let finding = Problem::new(Code::TimesUnordered, severity, text);
            problems.push(finding.remedy("such rows are spread over the time to the next stamp"));
        }
        if self.moved > 0 {
            let share = self.moved as f64 / self.count as f64;
            let severity = if share > MANY { Severity::Warning } else { Severity::Note };
            let rows = counted(self.moved, "row");
            let text = format!("{rows} of {} come after later ones", self.count);
            let finding = Problem::new(Code::TimesUnordered, severity, text);
            problems.push(finding.remedy("they are put in the order of time"));
        }
        if self.wraps > 0 {
            let wraps = counted(self.wraps, "time");
            let text = format!("the counter of the times starts again: {wraps}");
            let finding = Code::Clock.note(text);
            problems.push(finding.remedy("its times are continued"));
        }
        if self.restarts > 0 {
            let restarts = counted(self.restarts, "time");
            let text = format!("the clock of the times restarts: {restarts}");
            let remedy = "the time in between is not known and taken as 2 s";
            problems.push(Code::TimesUnordered.warning(text).remedy(remedy));
        }
        let (wrong, first_ns) = self.wrong;
        if wrong > 0 {
            let text = format!(
                "{} inconsistent with the rows around, the first at {:.2} s",
                counted(wrong, "time stamp"),
                first_ns.saturating_sub(self.first_ns) as f64 * 1e-9
            );
            problems.push(Code::RowsMasked.warning(text).remedy("these rows are left out"));
        }
        problems
    }

    /// Hands on the first row, and those with the same stamp. `is_end`: there are no further rows.
    fn settle(&mut self, is_end: bool, out: &mut Out) {
        let Some(first) = self.rows.front() else { return };
        let raw_ns = first.time_ns;
        let equal = self.rows.iter().take_while(|row| row.time_ns == raw_ns).count();
        if equal == self.rows.len() && !is_end && equal < MOST_EQUAL {
            return;
        }
        let Some([last_ns, latest_ns]) = self.last_ns else {
            self.first_ns = raw_ns;
            return self.hand_on(equal, raw_ns, false, out);
        };
        let period_ns = self.period_ns(last_ns);
        let step_ns = self.shifted(raw_ns).saturating_sub(last_ns);
        let is_near = |step_ns: i64| step_ns >= 0 && step_ns as f64 <= FAR * period_ns;
        if is_near(step_ns) || period_ns <= 0.0 {
            return self.hand_on(equal, self.shifted(raw_ns), false, out);
        }
        if self.is_contradicted(equal, last_ns, period_ns) {
            let first_wrong_ns = if self.wrong.0 == 0 { latest_ns } else { self.wrong.1 };
            self.wrong = (self.wrong.0 + equal, first_wrong_ns);
            return self.hand_on(equal, latest_ns, true, out);
        }
        let is_back = step_ns < 0;
        let cycle_ns = self.cycles_ns(is_back).into_iter();
        if let Some(cycle_ns) = cycle_ns.flatten().find(|ns| is_near(step_ns.saturating_add(*ns))) {
            self.wraps += 1;
            self.offset_ns = self.shifted(cycle_ns);
        } else if is_back && self.restarts < MOST_RESTARTS && self.is_restart(raw_ns, period_ns) {
            self.restarts += 1;
            self.offset_ns = latest_ns.saturating_add(RESTART_NS).saturating_sub(raw_ns);
        }
        self.hand_on(equal, self.shifted(raw_ns), false, out);
    }

    /// Whether a row soon after the first `equal` ones continues the rows before, so that they are wrong.
    fn is_contradicted(&self, equal: usize, last_ns: i64, period_ns: f64) -> bool {
        let Some(raw_ns) = self.rows.front().map(|row| row.time_ns) else { return false };
        // As many stamps as there are up to a row, within a factor of three.
        let (mut stamps, mut before_ns) = (1.0, raw_ns);
        self.rows.iter().skip(equal).take(AHEAD).any(|row| {
            if row.time_ns != before_ns {
                (stamps, before_ns) = (stamps + 1.0, row.time_ns);
            }
            let steps = self.shifted(row.time_ns).saturating_sub(last_ns) as f64 / period_ns;
            let contradicts = self.shifted(raw_ns) < last_ns || row.time_ns < raw_ns;
            contradicts && steps > stamps / 3.0 && steps <= 3.0 * (stamps + 1.0)
        })
    }

    /// What may be added where the stamps go back, and of dates also where they leap ahead, ns.
    fn cycles_ns(&self, is_back: bool) -> [Option<i64>; 3] {
        match self.tick_ns {
            Some(tick_ns) => {
                let [short, long] =
                    MODULI.map(|ticks| tick_ns.checked_mul(ticks).filter(|_| is_back));
                [short, long, None]
            }
            None => CYCLES_NS.map(|ns| Some(if is_back { ns } else { -ns })),
        }
    }

    fn shifted(&self, time_ns: i64) -> i64 {
        time_ns.saturating_add(self.offset_ns)
    }

    /// Whether the rows from a stamp on are in order.
    fn is_restart(&self, raw_ns: i64, period_ns: f64) -> bool {
        let times = std::iter::once(raw_ns).chain(self.rows.iter().map(|row| row.time_ns));
        let times: Vec<i64> = times.take(AHEAD).collect();
        let in_order = times.windows(2).filter(|pair| {
            (0.0..=FAR * period_ns).contains(&(pair[1].saturating_sub(pair[0]) as f64))
        });
        times.len() > 2 && 10 * in_order.count() >= 9 * (times.len() - 1)
    }

    /// Usual step between the rows that are held back, ns.
    fn period_ns(&self, last_ns: i64) -> f64 {
        let ahead = |row: &Row| self.shifted(row.time_ns).saturating_sub(last_ns);
        let step = self.rows.front().map_or(0, ahead);
        // The usual row needs no median.
        let next = self.rows.get(1).map_or(0, |next| ahead(next).saturating_sub(step));
        if step > 0 && next > 0 && step / 2 < next && next / 2 < step {
            return step as f64;
        }
        self.median_step_ns()
    }

    /// Median of the steps forward between the rows that are held back, ns.
    fn median_step_ns(&self) -> f64 {
        let times = self.rows.iter().map(|row| row.time_ns);
        let times: Vec<i64> = times.take(2 * AHEAD).collect();
        let mut steps: Vec<i64> =
            times.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
        steps.retain(|step| *step > 0);
        steps.sort_unstable();
        steps.get(steps.len() / 2).map_or(0.0, |step| *step as f64)
    }

    /// Hands on `count` rows from a time on, spread over the time to the next one; as unusable ones at that time.
    fn hand_on(&mut self, count: usize, time_ns: i64, is_wrong: bool, out: &mut Out) {
        let next_ns = self.rows.get(count).map(|next| self.shifted(next.time_ns));
        let until_ns = next_ns.filter(|next| *next > time_ns && !is_wrong);
        // Not over a gap: as far as between the stamp before and this one.
        let before_ns = self
            .last_ns
            .map(|[last_ns, _]| time_ns.saturating_sub(last_ns))
            .filter(|step| *step > 0);
        let whole_ns = match (next_ns, until_ns) {
            (_, Some(until_ns)) => until_ns.saturating_sub(time_ns),
            (None, None) => self.spacing_ns.saturating_mul(count as i64),
            (Some(_), None) => 0,
        };
        let whole_ns =
            before_ns.map_or(whole_ns, |step| whole_ns.min(step.saturating_mul(2 * count as i64)));
        self.spacing_ns = if count > 1 { whole_ns / count as i64 } else { 0 };
        for k in 0..count {
            let Some(mut row) = self.rows.pop_front() else { break };
            let later_ns = (i128::from(whole_ns) * k as i128 / count as i128) as i64;
            for (track, values, width) in &row.values {
                let width = if is_wrong { 0 } else { *width };
                out(*track, time_ns.saturating_add(later_ns), &values[..width]);
            }
            row.values.clear();
            self.spare.push(row);
            if !is_wrong {
                self.last_ns = Some([time_ns, time_ns.saturating_add(later_ns)]);
            }
        }
        self.equal += if is_wrong { 0 } else { count - 1 };
        self.count += count;
    }
}
