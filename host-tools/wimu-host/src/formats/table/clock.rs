//! Time of a row: numbers, dates, counters, or the number of the row.

use std::borrow::Cow;

use super::text::with_point;
use super::units;
use crate::csv::number;

const DAY_NS: i64 = 86_400_000_000_000;

/// Where the time of a row comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum Source {
    /// A column of numbers, each times ten to this power, times [`units::multiple`], in ns; and one of a
    /// fraction, of another power, beside seconds.
    /// `digits`: those that a fraction has with its leading zeros, which were not written.
    Numbers { column: usize, exponent: i32, fraction: Option<(usize, i32)>, digits: Option<usize> },
    /// Columns of dates or times of day.
    Dates { date: Option<usize>, time: usize },
    /// A column that counts sample periods, modulo a number.
    Counter { column: usize, period_ns: f64, modulus: i64 },
    /// No column: of this period, which may be assumed.
    Rows { period_ns: f64, is_assumed: bool },
    /// A file of its own, one for each row.
    List(Vec<i64>),
}

impl Source {
    /// Whether each row has a time stamp.
    pub fn is_stamped(&self) -> bool {
        matches!(self, Self::Numbers { .. } | Self::Dates { .. })
    }

    /// Length of a tick of its numbers, ns; `None` of dates, counters and rows, and below 1 ns.
    pub fn tick_ns(&self) -> Option<i64> {
        let Self::Numbers { exponent, .. } = *self else { return None };
        let power = 10_i64.checked_pow(u32::try_from(exponent).ok()?)?;
        Some(power.saturating_mul(units::multiple(exponent)))
    }
}

/// Times of rows, in their order.
#[derive(Clone, Debug)]
pub struct Clock {
    pub source: Source,
    comma: bool,
    rows: i64,
    /// Whole days, or cycles of the counter, so far.
    cycles: i64,
    last: Option<i64>,
}

impl Clock {
    pub fn new(source: Source, comma: bool) -> Self {
        Self { source, comma, rows: 0, cycles: 0, last: None }
    }

    /// Time of the next row, ns; `None` if it has none.
    pub fn next_time(&mut self, fields: &[Cow<str>]) -> Option<i64> {
        self.rows += 1;
        let decimal = |column: usize, exponent| {
            let text = with_point(fields.get(column)?, self.comma);
            number::decimal(&text, exponent)
        };
        match &self.source {
            Source::List(times) => times.get(usize::try_from(self.rows - 1).ok()?).copied(),
            &Source::Numbers { column, exponent, fraction, digits } => {
                let time = match digits {
                    Some(digits) => {
                        let text = with_point(fields.get(column)?, self.comma);
                        let (whole, fraction) = text.split_once('.').unwrap_or((&text, "0"));
                        number::decimal(&format!("{whole}.{fraction:0>digits$}"), exponent)
                    }
                    None => decimal(column, exponent),
                };
                let time = time?.checked_mul(units::multiple(exponent))?;
                time.checked_add(
                    fraction.map_or(Some(0), |(column, exponent)| decimal(column, exponent))?,
                )
            }
            &Source::Rows { period_ns, .. } => {
                Some(((self.rows - 1) as f64 * period_ns).round() as i64)
            }
            &Source::Counter { column, period_ns, modulus } => {
                let count = decimal(column, 0)?;
                let total = self.unwrapped(count, modulus)?;
                Some((total as f64 * period_ns).round() as i64)
            }
            &Source::Dates { date: column, time } => {
                let day = column.and_then(|column| fields.get(column)).map(|text| &**text);
                let (ns, has_date) = date(day, fields.get(time)?)?;
                if has_date { Some(ns) } else { self.unwrapped(ns, DAY_NS) }
            }
        }
    }

    /// A count that starts again after `modulus`, continued.
    fn unwrapped(&mut self, count: i64, modulus: i64) -> Option<i64> {
        if self.last.is_some_and(|last| count < last.saturating_sub(modulus / 2)) {
            self.cycles += 1;
        }
        self.last = Some(count);
        count.checked_add(self.cycles.checked_mul(modulus)?)
    }
}

/// A date and time, or a time of day, ns, and whether it has a date: `2024-05-01T12:30:01.25Z`, `12:30:01.25`,
/// `05/31/2024 12:30:01,25`; the date may be in a field of its own.
pub fn date(day: Option<&str>, text: &str) -> Option<(i64, bool)> {
    // No date is longer; a plain number has no separators.
    if text.len() > 40 || !text.contains(':') {
        return None;
    }
    let (own_day, clock) = match text.trim().split_once(['T', ' ']) {
        Some((day, clock)) => (Some(day), clock.trim()),
        None => (None, text.trim()),
    };
    let clock = clock.trim_end_matches(['Z', 'z']).trim_end_matches("UTC");
    let half = [(" AM", 0), (" PM", 12), (" am", 0), (" pm", 12)];
    let half = half.into_iter().find_map(|(end, hours)| Some((clock.strip_suffix(end)?, hours)));
    let clock = half.map_or(clock, |(clock, _)| clock);
    let (clock, offset_ns) = match clock.rfind(['+', '-']) {
        Some(at) => (&clock[..at], offset_ns(&clock[at..])?),
        None => (clock, 0),
    };
    let mut parts = clock.trim().splitn(3, ':');
    let whole = |text: &str| text.trim().parse::<u32>().ok();
    let (hour, minute) = (whole(parts.next()?)?, whole(parts.next()?)?);
    let hour = match half {
        Some((_, hours)) if (1..=12).contains(&hour) => hour % 12 + hours,
        Some(_) => return None,
        None => hour,
    };
    // Some programs put a colon before the milliseconds.
    let seconds = parts.next().unwrap_or("0").replace([',', ':'], ".");
    let ns = number::decimal(&seconds, 9)?;
    if hour > 23 || minute > 59 || !(0..61_000_000_000).contains(&ns) {
        return None;
    }
    let ns = i64::from(hour * 60 + minute) * 60_000_000_000 + ns;
    match own_day.or(day) {
        None => Some((ns, false)),
        Some(day) => {
            let midnight = days(day)?.checked_mul(DAY_NS)?;
            Some((midnight.checked_add(ns - offset_ns)?, true))
        }
    }
}

/// Offset from UTC of a local time: `+0200`, `-05:30`.
fn offset_ns(text: &str) -> Option<i64> {
    let (sign, digits) = text.split_at_checked(1)?;
    let digits: String = digits.chars().filter(|c| *c != ':').collect();
    let value: i64 = digits.parse::<u16>().ok().filter(|_| digits.len() == 4)?.into();
    let minutes = value / 100 * 60 + value % 100;
    Some(minutes * 60_000_000_000 * if sign == "-" { -1 } else { 1 })
}

/// Days since 1970-01-01 of year-month-day, month/day/year or day.month.year.
fn days(text: &str) -> Option<i64> {
    let parts: Vec<&str> = text.trim().split(['-', '/', '.']).collect();
    let [a, b, c] = parts[..] else {
        return None;
    };
    let whole = |text: &str| text.parse::<u16>().ok().map(i64::from);
    let (a_value, b_value, c_value) = (whole(a)?, whole(b)?, whole(c)?);
    let (year, month, day) = match (a.len(), c.len()) {
        (4, _) => (a_value, b_value, c_value),
        (_, 4) if text.contains('.') || a_value > 12 => (c_value, b_value, a_value),
        (_, 4) => (c_value, a_value, b_value),
        _ => return None,
    };
    if !(1..=12).contains(&month) || !(1..=31).contains(&day) {
        return None;
    }
    // Days of the civil calendar, with years that begin in March.
    let (year, month) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    let era = year.div_euclid(400);
    let of_era = year.rem_euclid(400);
    let of_year = (153 * month + 2) / 5 + day - 1;
    Some(era * 146_097 + of_era * 365 + of_era / 4 - of_era / 100 + of_year - 719_468)
}
