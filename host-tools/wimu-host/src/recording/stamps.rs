//! The time stamps of rows as one clock: counters that wrap, clocks that restart, equal stamps, single wrong ones.
//!
//! A stamp is judged by the rows around it: one that the rows after it contradict is wrong, one that they follow is a gap, a
//! wrap or a restart. So rows are held back, and handed on with their times.

use std::collections::VecDeque;

use super::{Sink, TrackId, TrackInfo};
use crate::plural::counted;
use crate::{Code, Problem, Severity};

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
/// Share of equal stamps that is worth a warning.
const MANY_EQUAL: f64 = 0.01;

/// A row that is held back.
#[derive(Default)]
struct Row {
    time_ns: i64,
    values: Vec<(TrackId, [f64; 4], usize)>,
}

/// Hands rows on with the times of one clock.
pub(crate) struct Stamps<'a> {
    sink: &'a mut dyn Sink,
    /// Length of a tick of a counter, ns; `None`: the stamps are dates.
    tick_ns: Option<i64>,
    rows: VecDeque<Row>,
    /// Rows that have been handed on, for their room.
    spare: Vec<Row>,
    /// What is added to the stamps, ns.
    offset_ns: i64,
    /// Latest stamp with it, and latest time that was handed on, ns.
    last_ns: Option<[i64; 2]>,
    first_ns: i64,
    count: usize,
    equal: usize,
    wraps: usize,
    restarts: usize,
    /// Rows with a wrong stamp, and the time of the first, ns.
    wrong: (usize, i64),
}

impl<'a> Stamps<'a> {
    pub(crate) fn new(sink: &'a mut dyn Sink, tick_ns: Option<i64>) -> Self {
        Self {
            sink,
            tick_ns,
            rows: VecDeque::new(),
            spare: Vec::new(),
            offset_ns: 0,
            last_ns: None,
            first_ns: 0,
            count: 0,
            equal: 0,
            wraps: 0,
            restarts: 0,
            wrong: (0, 0),
        }
    }

    /// Hands on the rows that are left, and what was found.
    pub(crate) fn finish(mut self) {
        while !self.rows.is_empty() {
            self.settle(true);
        }
        let warning = |code: Code, text: String, remedy: &str| {
            Problem::new(code, Severity::Warning, text).remedy(remedy)
        };
        if self.equal > 0 {
            let share = self.equal as f64 / self.count as f64;
            let text = format!(
                "{} of {} time stamps equal the one before ({:.0} %)",
                self.equal,
                self.count,
                100.0 * share
            );
            let severity = if share > MANY_EQUAL { Severity::Warning } else { Severity::Note };
            let finding = Problem::new(Code::TimesUnordered, severity, text);
            self.sink
                .finding(finding.remedy("such rows are spread over the time to the next stamp"));
        }
        if self.wraps > 0 {
            let text =
                format!("the counter of the times starts again: {}", counted(self.wraps, "time"));
            let finding = Code::Clock.note(text);
            self.sink.finding(finding.remedy("its times are continued"));
        }
        if self.restarts > 0 {
            let text =
                format!("the clock of the times restarts: {}", counted(self.restarts, "time"));
            let remedy = "the time in between is not known and taken as 2 s";
            self.sink.finding(warning(Code::TimesUnordered, text, remedy));
        }
        let (wrong, first_ns) = self.wrong;
        if wrong > 0 {
            let text = format!(
                "{} contradicted by the rows around, the first at {:.2} s",
                counted(wrong, "time stamp"),
                first_ns.saturating_sub(self.first_ns) as f64 * 1e-9
            );
            self.sink.finding(warning(Code::RowsMasked, text, "these rows are left out"));
        }
    }

    /// Hands on the first row, and those with the same stamp. `is_end`: there are no further rows.
    fn settle(&mut self, is_end: bool) {
        let Some(first) = self.rows.front() else { return };
        let raw_ns = first.time_ns;
        let equal = self.rows.iter().take_while(|row| row.time_ns == raw_ns).count();
        if equal == self.rows.len() && !is_end && equal < MOST_EQUAL {
            return;
        }
        let Some([last_ns, latest_ns]) = self.last_ns else {
            self.first_ns = raw_ns;
            return self.hand_on(equal, raw_ns, false);
        };
        let period_ns = self.period_ns(last_ns);
        let step_ns = self.shifted(raw_ns).saturating_sub(last_ns);
        let is_near = |step_ns: i64| step_ns >= 0 && step_ns as f64 <= FAR * period_ns;
        if is_near(step_ns) || period_ns <= 0.0 {
            return self.hand_on(equal, self.shifted(raw_ns), false);
        }
        // A row soon after it that continues the rows before says that this one is wrong.
        let continues = |(k, row): (usize, &Row)| {
            let step_ns = self.shifted(row.time_ns).saturating_sub(last_ns);
            let contradicts = self.shifted(raw_ns) < last_ns || row.time_ns < raw_ns;
            contradicts && step_ns > 0 && step_ns as f64 <= (k as f64 + 2.0) * 3.0 * period_ns
        };
        let rest = self.rows.iter().enumerate().skip(equal).take(AHEAD);
        if rest.clone().any(continues) {
            let first_wrong_ns = if self.wrong.0 == 0 { latest_ns } else { self.wrong.1 };
            self.wrong = (self.wrong.0 + equal, first_wrong_ns);
            return self.hand_on(equal, latest_ns, true);
        }
        if step_ns < 0 {
            let wrapped = MODULI.iter().filter_map(|ticks| self.tick_ns?.checked_mul(*ticks));
            if let Some(cycle_ns) =
                wrapped.into_iter().find(|cycle| is_near(step_ns.saturating_add(*cycle)))
            {
                self.wraps += 1;
                self.offset_ns = self.shifted(cycle_ns);
            } else if self.restarts < MOST_RESTARTS && self.is_restart(raw_ns, period_ns) {
                self.restarts += 1;
                self.offset_ns = latest_ns.saturating_add(RESTART_NS).saturating_sub(raw_ns);
            }
        }
        self.hand_on(equal, self.shifted(raw_ns), false);
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

    /// Usual step between the rows that are held back, ns: the median of those forward.
    fn period_ns(&self, last_ns: i64) -> f64 {
        let ahead = |row: &Row| self.shifted(row.time_ns).saturating_sub(last_ns);
        let step = self.rows.front().map_or(0, ahead);
        // The usual row needs no median.
        let next = self.rows.get(1).map_or(0, |next| ahead(next).saturating_sub(step));
        if step > 0 && next > 0 && step / 2 < next && next / 2 < step {
            return step as f64;
        }
        let times = self.rows.iter().map(|row| row.time_ns);
        let times: Vec<i64> = times.take(2 * AHEAD).collect();
        let mut steps: Vec<i64> =
            times.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
        steps.retain(|step| *step > 0);
        steps.sort_unstable();
        steps.get(steps.len() / 2).map_or(0.0, |step| *step as f64)
    }

    /// Hands on `count` rows from a time on, spread over the time to the next one; as unusable ones at that time.
    fn hand_on(&mut self, count: usize, time_ns: i64, is_wrong: bool) {
        let next_ns = self.rows.get(count).map(|next| self.shifted(next.time_ns));
        let until_ns = next_ns.filter(|next| *next > time_ns && !is_wrong);
        // Not over a gap: as far as between the stamp before and this one.
        let before_ns = self
            .last_ns
            .map(|[last_ns, _]| time_ns.saturating_sub(last_ns))
            .filter(|step| *step > 0);
        let whole_ns = until_ns.map_or(0, |until| until.saturating_sub(time_ns));
        let whole_ns =
            before_ns.map_or(whole_ns, |step| whole_ns.min(step.saturating_mul(2 * count as i64)));
        for k in 0..count {
            let Some(mut row) = self.rows.pop_front() else { break };
            let later_ns = (i128::from(whole_ns) * k as i128 / count as i128) as i64;
            for (track, values, width) in &row.values {
                let values = if is_wrong { [f64::NAN; 4] } else { *values };
                self.sink.row(*track, time_ns.saturating_add(later_ns), &values[..*width]);
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

impl Sink for Stamps<'_> {
    fn track(&mut self, info: TrackInfo) -> TrackId {
        self.sink.track(info)
    }

    fn row(&mut self, track: TrackId, time_ns: i64, values: &[f64]) {
        let mut kept = [f64::NAN; 4];
        kept[..values.len()].copy_from_slice(values);
        let item = (track, kept, values.len());
        let has_no = |row: &&mut Row| {
            row.time_ns == time_ns && row.values.iter().all(|(known, ..)| *known != track)
        };
        if let Some(row) = self.rows.back_mut().filter(has_no) {
            return row.values.push(item);
        }
        let mut row = self.spare.pop().unwrap_or_default();
        row.time_ns = time_ns;
        row.values.push(item);
        self.rows.push_back(row);
        if self.rows.len() > 2 * AHEAD {
            self.settle(false);
        }
    }

    fn finding(&mut self, finding: Problem) {
        self.sink.finding(finding);
    }

    fn takes_any(&self) -> bool {
        self.sink.takes_any()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::{Quantity, Recording, Unit};

    /// The time of each row, `None` of one that is left out.
    fn clock(stamps: impl IntoIterator<Item = i64>) -> (Vec<Option<i64>>, Vec<Code>) {
        let mut recording = Recording::new("table");
        let mut stamped = Stamps::new(&mut recording, Some(1));
        let track = stamped.track(TrackInfo::new("f", Quantity::SpecificForce, Unit::Si));
        for stamp in stamps {
            stamped.row(track, stamp, &[0.0, 0.0, 9.8]);
        }
        stamped.finish();
        let track = &recording.tracks()[0];
        let times = track.times_ns().iter().zip(track.mask());
        let times = times.map(|(time, is_valid)| is_valid.then_some(*time)).collect();
        (times, recording.findings.iter().map(|finding| finding.code).collect())
    }

    fn regular(range: std::ops::Range<i64>) -> impl Iterator<Item = i64> {
        range.map(|k| 1000 * k)
    }

    #[test]
    fn stamps_that_are_one_clock_stay_as_they_are() {
        let gap = || regular(0..100).chain(regular(5000..5100));
        let jitter = || (0..200).map(|k| 1000 * k + [0, 900, 300][k as usize % 3]);
        for stamps in [Vec::from_iter(gap()), Vec::from_iter(jitter()), vec![7], vec![]] {
            let expected = stamps.iter().copied().map(Some).collect();
            assert_eq!(clock(stamps), (expected, vec![]));
        }
    }

    #[test]
    fn a_counter_that_wraps_goes_on() {
        // The count after the last one, and that at which it goes on.
        for (end, start) in [(1 << 16, 0), (1 << 32, 0), (1 << 31, -(1 << 31))] {
            let count = |k: i64| end - 50_000 + 1000 * k;
            let wrapped = |k: i64| if count(k) < end { count(k) } else { count(k) - end + start };
            let (times, findings) = clock((0..100).map(wrapped));
            let steps = times.windows(2).map(|pair| pair[1].unwrap() - pair[0].unwrap());
            assert!(steps.into_iter().all(|step| step == 1000), "{end}");
            assert_eq!(findings, [Code::Clock]);
        }
    }

    #[test]
    fn equal_stamps_are_spread() {
        // Of ten rows a stamp, and of every fifth that repeats the one before.
        let (times, findings) = clock((0..200).map(|k| 1000 * (k / 10)));
        assert!(times[..190].iter().zip(0..).all(|(time, k)| *time == Some(100 * k)));
        assert_eq!(findings, [Code::TimesUnordered]);
        let (times, _) = clock((0..200).map(|k| 1000 * (k - i64::from(k % 5 == 4))));
        assert!(times.iter().zip(0..).all(|(time, k)| *time == Some(1000 * k) || k == 199));
    }

    #[test]
    fn a_stamp_that_the_rows_around_contradict_is_left_out() {
        for wrong in [0, 50_001, 4_200_000_000_000_000_000, -5] {
            let (times, findings) = clock((0..100).map(|k| if k == 40 { wrong } else { 1000 * k }));
            let left_out: Vec<_> = (0..100).filter(|k| times[*k].is_none()).collect();
            assert_eq!((left_out, findings), (vec![40], vec![Code::RowsMasked]), "{wrong}");
        }
    }

    #[test]
    fn a_clock_that_restarts_goes_on_after_a_break() {
        let (times, findings) = clock(regular(0..100).chain(regular(0..100)));
        assert_eq!(times[100], Some(99_000 + RESTART_NS));
        assert_eq!(times[199], Some(198_000 + RESTART_NS));
        assert_eq!(findings, [Code::TimesUnordered]);
    }

    #[test]
    fn extreme_stamps_do_no_harm() {
        let ends = [i64::MIN, i64::MAX, 0, -1, i64::MAX - 5, i64::MIN + 7];
        let (times, _) = clock((0..300).map(|k| ends[k * k % 6]));
        assert_eq!(times.len(), 300);
    }

    #[test]
    fn rows_without_an_order_are_refused() {
        let mut recording = Recording::new("table");
        let mut stamped = Stamps::new(&mut recording, Some(1));
        let track = stamped.track(TrackInfo::new("f", Quantity::SpecificForce, Unit::Si));
        (0..300).for_each(|k| stamped.row(track, 1000 * (k * 7919 % 300), &[0.0, 0.0, 9.8]));
        stamped.finish();
        assert!(recording.check(true).is_err());
    }
}
