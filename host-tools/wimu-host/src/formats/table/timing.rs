//! Choice of the clock of a table, and the unit of its times.

use super::clock::Source;
use super::header::Table;
use super::layout::Layout;
use super::names;
use super::survey::Survey;
use super::units;
use crate::{Code, Problem, Severity};

/// Assumed sample rates of tables without times, Hz; that of KITTI is the rate of its synchronised packets.
const ASSUMED_RATE_HZ: f64 = 100.0;
const OXTS_RATE_HZ: f64 = 10.0;
/// A tick of `SampleTimeFine` of MT Manager, ns, and sample rates of Xsens, Hz.
const FINE_NS: f64 = 1e5;
const XSENS_HZ: std::ops::Range<f64> = 5.0..2100.0;
/// UTC of the years 2000 to 2100, s.
const UTC_S: std::ops::Range<f64> = 9.4e8..4.1e9;
/// Sample rates among which a unit of time is chosen, Hz.
const RATES_HZ: std::ops::Range<f64> = 0.5..20_000.0;

/// Clock of the rows.
pub fn choose(
    table: &Table,
    layout: &Layout,
    survey: &Survey,
    of_poses: bool,
    findings: &mut Vec<Problem>,
) -> Source {
    let are_equal = survey.times.steps > 0 && survey.times.equal == survey.times.steps;
    if let (Some((column, _)), true) = (layout.time, are_equal) {
        let text = format!("all times `{}` are equal: {}", table.names[column], survey.times.last);
        let remedy =
            "a spreadsheet may have rounded them: use the original file, or give --rate HZ";
        findings.push(Code::TimesUnordered.warning(text).remedy(remedy));
    } else if let Some((column, exponent)) = layout.time {
        let numbers = survey.columns[column].numbers;
        if survey.times.dates > numbers {
            return Source::Dates { date: layout.date, time: column };
        }
        let named = exponent.filter(|_| !of_poses);
        findings.extend(named.and_then(|exponent| implausible(table, survey, column, exponent)));
        let exponent = exponent.unwrap_or_else(|| exponent_of(table, survey, column, findings));
        // A spreadsheet keeps 15 digits.
        if exponent == 0 && survey.columns[column].is_fractional {
            let text = format!(
                "times `{}` in ns are not whole numbers: they were rounded",
                table.names[column]
            );
            let finding = Code::Clock.warning(text);
            findings.push(finding.remedy("use the original file, not one saved by a spreadsheet"));
        }
        let digits = survey.times.unpadded_digits();
        if digits.is_some() {
            let text = format!("the fractions of `{}` have no leading zeros", table.names[column]);
            let finding = Code::Clock.warning(text);
            findings.push(finding.remedy("`28.16` is read as 28.016"));
        }
        return Source::Numbers { column, exponent, fraction: layout.fraction, digits };
    }
    let find = |key: &str| {
        let of = |name: &String| names::key(name) == key;
        let column = table.names.iter().position(of)?;
        (survey.columns[column].numbers > 0).then_some(column)
    };
    let mut note = |text: String, severity, remedy: &str| {
        findings.push(Problem::new(Code::Rate, severity, text).remedy(remedy));
    };
    if let Some(column) = find("sampletimefine") {
        let period_ns = if layout.program == Some("Xsens DOT") { 1e3 } else { FINE_NS };
        return Source::Counter { column, period_ns, modulus: 1 << 32 };
    }
    if let Some(column) = find("packetcounter") {
        let (rate, how, severity) = match rate_of(&table.preamble) {
            Some(rate) => (rate, "by the header", Severity::Note),
            None => (ASSUMED_RATE_HZ, "assumed", Severity::Warning),
        };
        note(
            format!("times are counted at {rate} Hz, {how}"),
            severity,
            "export SampleTimeFine for measured times",
        );
        return Source::Counter { column, period_ns: 1e9 / rate, modulus: 1 << 16 };
    }
    if let Some(rate) = rate_of(&table.preamble) {
        note(format!("there are no times: {rate} Hz by the header"), Severity::Note, "");
        return Source::Rows { period_ns: 1e9 / rate, is_assumed: false };
    }
    let rate = match layout.program {
        Some("KITTI oxts") => OXTS_RATE_HZ,
        _ => ASSUMED_RATE_HZ,
    };
    note(
        format!("there are no times: {rate} Hz assumed"),
        Severity::Warning,
        "give --rate HZ, or name the column of times: --columns \"t=COLUMN:ms,…\"",
    );
    Source::Rows { period_ns: 1e9 / rate, is_assumed: true }
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
    !XSENS_HZ.contains(&rate_hz(FINE_NS)) && XSENS_HZ.contains(&rate_hz(1e3))
}

/// Warns of a unit in the header that implies a sample rate below [`RATES_HZ`], where a smaller unit does not.
fn implausible(table: &Table, survey: &Survey, column: usize, exponent: i32) -> Option<Problem> {
    let step = survey.step(column).filter(|step| *step > 0.0)?;
    let rate_hz = |exponent: i32| 1.0 / (step * 10_f64.powi(exponent - 9));
    let smaller = [(6, "ms"), (3, "us"), (0, "ns")];
    let mut smaller = smaller.into_iter().filter(|(e, _)| *e < exponent);
    let (plausible, unit) = smaller.find(|(e, _)| (1.0..RATES_HZ.end).contains(&rate_hz(*e)))?;
    if rate_hz(exponent) >= RATES_HZ.start || units::multiple(exponent) != 1 {
        return None;
    }
    let name = &table.names[column];
    let (bare, _) = names::split_unit(name);
    let text = format!("the unit of `{name}` implies {:.3} Hz", rate_hz(exponent));
    let remedy =
        format!("{unit} would be {:.0} Hz: --columns \"t={bare}:{unit},…\"", rate_hz(plausible));
    Some(Code::UnitInferred.warning(text).remedy(remedy))
}

/// Power of ten of a nanosecond of a time column without a unit.
fn exponent_of(table: &Table, survey: &Survey, column: usize, findings: &mut Vec<Problem>) -> i32 {
    let Some((first, step)) = survey.times.first.zip(survey.step(column)) else {
        return 9;
    };
    let is_fractional = survey.columns[column].is_fractional;
    let units = [(9, "s"), (6, "ms"), (3, "µs"), (0, "ns")];
    let seconds = |exponent: i32| 10_f64.powi(exponent - 9);
    let is_utc = |exponent: i32| {
        UTC_S.contains(&(first * seconds(exponent)))
            && step * seconds(exponent) <= 1.0 / RATES_HZ.start
            && step * seconds(exponent) >= 1.0 / RATES_HZ.end
    };
    let utc = units.map(|(exponent, _)| exponent).into_iter().find(|e| is_utc(*e));
    let by_step = match step {
        // Whole numbers: at least 1 a sample, and ms up to 3 Hz.
        s if s < 1.0 || is_fractional && s <= 2.0 => 9,
        s if s < 300.0 => 6,
        s if s < 5e5 => 3,
        _ => 0,
    };
    let exponent = utc.unwrap_or(by_step);
    let unit = units.iter().find(|(e, _)| *e == exponent);
    let unit = unit.map_or("s", |(_, unit)| *unit);
    let rate = 1.0 / (step * seconds(exponent)).max(1e-12);
    let name = &table.names[column];
    let unknown = names::split_unit(name).1.filter(|unit| !unit.is_empty());
    let severity = unknown.map_or(Severity::Note, |_| Severity::Warning);
    let why =
        unknown.map_or("name no unit".to_owned(), |unit| format!("have the unknown unit `{unit}`"));
    let text = format!("times `{name}` {why}: mean step {step:.4}, taken as {unit} ({rate:.4} Hz)");
    let remedy =
        "if they are not, give --columns \"t=COLUMN:s,…\" with one of s, ms, us, ns, min, h";
    findings.push(Problem::new(Code::UnitInferred, severity, text).remedy(remedy));
    exponent
}
