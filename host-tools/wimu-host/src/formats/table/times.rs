//! Times of the rows of a table: numbers in a unit that is named or follows from the implied rate, dates, counters, or the
//! number of the row.

use std::borrow::Cow;

use super::header::Table;
use super::layout::Layout;
use super::names;
use super::presets::{OXTS, XSENS_DOT};
use super::survey::Survey;
use super::text::with_point;
use super::units;
use crate::csv::number::multiplied;
use crate::recording::Stamped;
use crate::{Code, Problem};

const DAY_NS: i64 = 86_400_000_000_000;
const MINUTE_NS: i64 = 60_000_000_000;
/// Assumed sample rates of tables without times, Hz; that of KITTI is the rate of its synchronised packets.
const ASSUMED_RATE_HZ: f64 = 100.0;
const OXTS_RATE_HZ: f64 = 10.0;
/// A tick of `SampleTimeFine` of MT Manager and of a DOT, ns, and sample rates of Xsens, Hz.
const FINE_NS: f64 = 1e5;
const DOT_NS: f64 = 1e3;
const XSENS_HZ: std::ops::Range<f64> = 5.0..2100.0;
/// UTC of the years 2000 to 2100, s.
const UTC_S: std::ops::Range<f64> = 9.4e8..4.1e9;
/// Sample rates that a named unit may imply, and those among which a unit that is not named is ambiguous, Hz.
const RATES_HZ: std::ops::Range<f64> = 0.5..20_000.0;
const USUAL_HZ: std::ops::RangeInclusive<f64> = 1.0..=8_000.0;

/// Where the time of a row comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum Times {
    /// A column of numbers, each of this many ns; and one of a fraction of another unit beside seconds.
    /// `digits`: those that a fraction has with its leading zeros, which were not written.
    Numbers { column: usize, unit_ns: i64, fraction: Option<(usize, i64)>, digits: Option<usize> },
    /// Columns of dates or times of day.
    Dates { date: Option<usize>, time: usize },
    /// A column that counts sample periods.
    Counter { column: usize, period_ns: f64 },
    /// No column: of this period, which may be assumed.
    Rows { period_ns: f64, is_assumed: bool },
    /// A file of its own, one for each row.
    List(Vec<i64>),
}

impl Times {
    /// Time of a row, ns; `None` if it has none.
    pub fn of(&self, row: usize, fields: &[Cow<str>], comma: bool) -> Option<i64> {
        let number = |column: usize, unit_ns: i64| {
            multiplied(&with_point(fields.get(column)?, comma), unit_ns)
        };
        match *self {
            Self::List(ref times) => times.get(row).copied(),
            Self::Rows { period_ns, .. } => Some((row as f64 * period_ns).round() as i64),
            Self::Counter { column, period_ns } => {
                Some((number(column, 1)? as f64 * period_ns).round() as i64)
            }
            Self::Dates { date: day, time } => {
                let day = day.and_then(|column| fields.get(column)).map(|text| &**text);
                date(day, fields.get(time)?)
            }
            Self::Numbers { column, unit_ns, fraction, digits: Some(digits) } => {
                let text = with_point(fields.get(column)?, comma);
                let (whole, part) = text.split_once('.').unwrap_or((&text, "0"));
                let time = multiplied(&format!("{whole}.{part:0>digits$}"), unit_ns)?;
                time.checked_add(fraction.map_or(Some(0), |(column, ns)| number(column, ns))?)
            }
            Self::Numbers { column, unit_ns, fraction, digits: None } => {
                let time = number(column, unit_ns)?;
                time.checked_add(fraction.map_or(Some(0), |(column, ns)| number(column, ns))?)
            }
        }
    }

    /// The stamps of its rows; `None` of numbers of rows and files.
    pub fn stamped(&self) -> Option<Stamped> {
        match *self {
            Self::Dates { .. } => Some(Stamped::By(None)),
            Self::Numbers { unit_ns, .. } => Some(Stamped::By(Some(unit_ns))),
            Self::Counter { period_ns, .. } => Some(Stamped::By(Some(period_ns.round() as i64))),
            Self::Rows { .. } | Self::List(_) => None,
        }
    }

    /// Whether the sample rate is assumed.
    pub fn is_assumed(&self) -> bool {
        matches!(self, Self::Rows { is_assumed: true, .. })
    }
}

/// A date and time, or a time of day, ns: `2024-05-01T12:30:01.25Z`, `12:30:01.25`, `1:30:01 PM`, `05/31/2024 12:30:01,25`, and
/// of minutes and seconds alone `30:01.25`; the date may be in a field of its own.
pub fn date(day: Option<&str>, text: &str) -> Option<i64> {
    // No date is longer; a plain number has no separators.
    if text.len() > 40 || !text.contains(':') {
        return None;
    }
    let text = text.trim().trim_end_matches(['Z', 'z']).trim_end_matches("UTC").trim_end();
    let half = [(" AM", 0), (" PM", 12), (" am", 0), (" pm", 12)];
    let half = half.into_iter().find_map(|(end, hours)| Some((text.strip_suffix(end)?, hours)));
    let text = half.map_or(text, |(clock, _)| clock);
    let (own_day, clock) = match text.split_once(['T', ' ']) {
        Some((day, clock)) => (Some(day), clock.trim()),
        None => (None, text),
    };
    let (clock, offset_ns) = match clock.rfind(['+', '-']) {
        Some(at) => (&clock[..at], offset_ns(&clock[at..])?),
        None => (clock, 0),
    };
    let parts: Vec<&str> = clock.trim().splitn(3, ':').collect();
    let (hour, minute, seconds) = match parts[..] {
        [hour, minute, seconds] => (hour, minute, seconds),
        // Spreadsheets leave the hours out.
        [minute, seconds] if seconds.contains('.') => ("0", minute, seconds),
        [hour, minute] => (hour, minute, "0"),
        _ => return None,
    };
    let whole = |text: &str| text.trim().parse::<u32>().ok();
    let (hour, minute) = (whole(hour)?, whole(minute)?);
    let hour = match half {
        Some((_, hours)) if (1..=12).contains(&hour) => hour % 12 + hours,
        Some(_) => return None,
        None => hour,
    };
    // Some programs put a colon before the milliseconds.
    let seconds = seconds.replace([',', ':'], ".");
    let ns = multiplied(&seconds, units::SECOND)?;
    if hour > 23 || minute > 59 || !(0..61_000_000_000).contains(&ns) {
        return None;
    }
    let ns = i64::from(hour * 60 + minute) * MINUTE_NS + ns;
    match own_day.or(day) {
        None => Some(ns),
        Some(day) => days(day)?.checked_mul(DAY_NS)?.checked_add(ns - offset_ns),
    }
}

/// Offset from UTC of a local time: `+0200`, `-05:30`.
fn offset_ns(text: &str) -> Option<i64> {
    let (sign, digits) = text.split_at_checked(1)?;
    let digits: String = digits.chars().filter(|c| *c != ':').collect();
    let value: i64 = digits.parse::<u16>().ok().filter(|_| digits.len() == 4)?.into();
    let minutes = value / 100 * 60 + value % 100;
    Some(minutes * MINUTE_NS * if sign == "-" { -1 } else { 1 })
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
    let (era, of_era) = (year.div_euclid(400), year.rem_euclid(400));
    let of_year = (153 * month + 2) / 5 + day - 1;
    Some(era * 146_097 + of_era * 365 + of_era / 4 - of_era / 100 + of_year - 719_468)
}

/// Times of the rows of a table.
pub fn choose(
    table: &Table,
    layout: &Layout,
    survey: &Survey,
    of_poses: bool,
    findings: &mut Vec<Problem>,
) -> Times {
    let are_equal = survey.times.steps > 0 && survey.times.equal == survey.times.steps;
    if let (Some((column, _)), true) = (layout.time, are_equal) {
        let text = format!("all times `{}` are equal: {}", table.names[column], survey.times.last);
        let remedy =
            "a spreadsheet may have rounded them: use the original file, or give --rate HZ";
        findings.push(Code::TimesUnordered.warning(text).remedy(remedy));
    } else if let Some((column, unit_ns)) = layout.time {
        if survey.times.dates > survey.columns[column].numbers {
            return Times::Dates { date: layout.date, time: column };
        }
        return numbers(column, unit_ns, table, layout, survey, of_poses, findings);
    }
    let find = |key: &str| {
        let column = table.names.iter().position(|name| names::key(name) == key)?;
        (survey.columns[column].numbers > 0).then_some(column)
    };
    if let Some(column) = find("sampletimefine") {
        let period_ns = if layout.program == Some(XSENS_DOT) { DOT_NS } else { FINE_NS };
        return Times::Counter { column, period_ns };
    }
    let of_header = rate_of(&table.preamble);
    let rate = match layout.program {
        _ if of_header.is_some() => of_header.unwrap_or_default(),
        Some(OXTS) => OXTS_RATE_HZ,
        _ => ASSUMED_RATE_HZ,
    };
    let counter = find("packetcounter");
    let how = if of_header.is_some() { "by the header" } else { "assumed" };
    let text = match counter {
        Some(_) => format!("times are counted at {rate} Hz, {how}"),
        None => format!("there are no times: {rate} Hz {how}"),
    };
    let finding = match (of_header, counter) {
        (Some(_), _) => Code::Rate.note(text),
        (None, Some(_)) => {
            Code::Rate.warning(text).remedy("export SampleTimeFine for measured times")
        }
        (None, None) => Code::Rate
            .warning(text)
            .remedy("give --rate HZ, or name the column of times in the header, `Time (ms)`"),
    };
    findings.push(finding);
    let period_ns = 1e9 / rate;
    match counter {
        Some(column) => Times::Counter { column, period_ns },
        None => Times::Rows { period_ns, is_assumed: of_header.is_none() },
    }
}

/// Times in a column of numbers.
fn numbers(
    column: usize,
    named_ns: Option<i64>,
    table: &Table,
    layout: &Layout,
    survey: &Survey,
    of_poses: bool,
    findings: &mut Vec<Problem>,
) -> Times {
    let name = &table.names[column];
    let unit_ns = match named_ns {
        Some(unit_ns) => {
            if !of_poses {
                findings.extend(implausible(name, survey.step(column), unit_ns));
            }
            unit_ns
        }
        None => unit_of(name, survey, column, findings),
    };
    // A spreadsheet keeps 15 digits.
    if unit_ns == 1 && survey.columns[column].is_fractional {
        let text = format!("times `{name}` in ns are not whole numbers: they were rounded");
        let remedy = "use the original file, not one saved by a spreadsheet";
        findings.push(Code::Clock.warning(text).remedy(remedy));
    }
    let digits = survey.times.unpadded_digits();
    if digits.is_some() {
        let text = format!("the fractions of `{name}` have no leading zeros");
        findings.push(Code::Clock.warning(text).remedy("`28.16` is read as 28.016"));
    }
    Times::Numbers { column, unit_ns, fraction: layout.fraction, digits }
}

/// `// Update Rate: 100.0Hz`, `… at 40 Hz …`
fn rate_of(preamble: &[String]) -> Option<f64> {
    let before = preamble.iter().find_map(|line| line.split_once("Hz"))?.0.trim_end();
    let number = before.rsplit(|c: char| !(c.is_ascii_digit() || c == '.')).next()?;
    number.parse().ok().filter(|rate| (1e-3..1e6).contains(rate))
}

/// Whether a table of Xsens is of a DOT, whose `SampleTimeFine` is in µs, by the rate that follows.
pub fn is_dot(table: &Table, layout: &Layout, survey: &Survey) -> bool {
    let is_fine = |name: &String| names::key(name) == "sampletimefine";
    let column = table.names.iter().position(is_fine).filter(|_| {
        layout.program.is_some_and(|program| program.starts_with("Xsens")) && layout.time.is_none()
    });
    let Some([Some(first), Some(second)]) = column.map(|column| survey.columns[column].first)
    else {
        return false;
    };
    let rate_hz = |tick_ns: f64| 1e9 / ((second - first) * tick_ns);
    !XSENS_HZ.contains(&rate_hz(FINE_NS)) && XSENS_HZ.contains(&rate_hz(DOT_NS))
}

/// The units between which is chosen, ns, and their symbols.
const CHOICE: [(i64, &str); 4] =
    [(units::SECOND, "s"), (units::MILLISECOND, "ms"), (units::MICROSECOND, "us"), (1, "ns")];

/// Sample rate that a step in units of this length implies, Hz.
fn rate_hz(step: f64, unit_ns: i64) -> f64 {
    1e9 / (step * unit_ns as f64)
}

/// Warns of a unit in the header that implies a sample rate below [`RATES_HZ`], where a smaller unit does not.
fn implausible(name: &str, step: Option<f64>, unit_ns: i64) -> Option<Problem> {
    let step = step.filter(|step| *step > 0.0)?;
    let is_plausible =
        |(ns, _): &(i64, &str)| *ns < unit_ns && (1.0..RATES_HZ.end).contains(&rate_hz(step, *ns));
    let (plausible, unit) = CHOICE.into_iter().find(is_plausible)?;
    if rate_hz(step, unit_ns) >= RATES_HZ.start || unit_ns > units::SECOND {
        return None;
    }
    let (bare, _) = names::split_unit(name);
    let text = format!("the unit of `{name}` implies {:.3} Hz", rate_hz(step, unit_ns));
    let remedy = format!(
        "{unit} would be {:.0} Hz: --columns \"t={bare}:{unit},…\"",
        rate_hz(step, plausible)
    );
    Some(Code::UnitInferred.warning(text).remedy(remedy))
}

/// Unit of a time column that names none, ns.
fn unit_of(name: &str, survey: &Survey, column: usize, findings: &mut Vec<Problem>) -> i64 {
    let Some((first, step)) = survey.times.first.zip(survey.step(column)) else {
        return units::SECOND;
    };
    let is_fractional = survey.columns[column].is_fractional;
    let is_utc = |(ns, _): &(i64, &str)| {
        UTC_S.contains(&(first * *ns as f64 * 1e-9)) && RATES_HZ.contains(&rate_hz(step, *ns))
    };
    let utc = CHOICE.into_iter().find(is_utc);
    let by_step = match step {
        // Whole numbers: at least 1 a sample, and ms up to 3 Hz.
        s if s < 1.0 || is_fractional && s <= 2.0 => CHOICE[0],
        s if s < 300.0 => CHOICE[1],
        s if s < 5e5 => CHOICE[2],
        _ => CHOICE[3],
    };
    let (unit_ns, unit) = utc.unwrap_or(by_step);
    let unknown = names::split_unit(name).1.filter(|unit| !unit.is_empty());
    let why =
        unknown.map_or("name no unit".to_owned(), |unit| format!("have the unknown unit `{unit}`"));
    let rate = rate_hz(step, unit_ns);
    let mut text =
        format!("times `{name}` {why}: mean step {step:.4}, taken as {unit} ({rate:.4} Hz)");
    let is_other = |(ns, _): &(i64, &str)| {
        *ns != unit_ns && USUAL_HZ.contains(&rate_hz(step, *ns)) && !(is_fractional && step < 1.0)
    };
    let other = CHOICE.into_iter().find(is_other).filter(|_| utc.is_none());
    if let Some((ns, other)) = other {
        text += &format!("; {other} would be {:.4} Hz", rate_hz(step, ns));
    }
    let remedy =
        "if they are not, name the unit in the header, such as `Time (ms)`, or give --rate HZ";
    let finding = if unknown.is_some() || other.is_some() || !RATES_HZ.contains(&rate) {
        Code::UnitInferred.warning(text)
    } else {
        Code::UnitInferred.note(text)
    };
    findings.push(finding.remedy(remedy));
    unit_ns
}
