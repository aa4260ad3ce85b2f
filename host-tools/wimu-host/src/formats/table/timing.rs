//! Choice of the clock of a table, and the unit of its times.

use super::clock::Source;
use super::header::Table;
use super::layout::Layout;
use super::names;
use super::survey::Survey;
use crate::finding::{Finding, FindingCode, Severity};

/// Assumed sample rates of tables without times, Hz; that of KITTI is the rate of its synchronised packets.
const ASSUMED_RATE_HZ: f64 = 100.0;
const OXTS_RATE_HZ: f64 = 10.0;
/// UTC of the years 2000 to 2100, s.
const UTC_S: std::ops::Range<f64> = 9.4e8..4.1e9;
/// Sample rates among which a unit of time is chosen, Hz.
const RATES_HZ: std::ops::Range<f64> = 0.5..20_000.0;

/// Clock of the rows.
pub fn choose(
    table: &Table,
    layout: &Layout,
    survey: &Survey,
    findings: &mut Vec<Finding>,
) -> Source {
    if let Some((column, exponent)) = layout.time {
        let numbers = survey.columns[column].numbers;
        if survey.times.dates > numbers {
            return Source::Dates { date: layout.date, time: column };
        }
        let exponent = exponent.unwrap_or_else(|| exponent_of(table, survey, column, findings));
        // A spreadsheet keeps 15 digits.
        if exponent == 0 && survey.columns[column].is_fractional {
            let text = format!(
                "times `{}` in ns are not whole numbers: they were rounded",
                table.names[column]
            );
            let finding = Finding::new(FindingCode::Clock, Severity::Warning, text);
            findings.push(finding.remedy("use the original file, not one saved by a spreadsheet"));
        }
        return Source::Numbers { column, exponent };
    }
    let find = |key: &str| {
        let of = |name: &String| names::key(name) == key;
        let column = table.names.iter().position(of)?;
        (survey.columns[column].numbers > 0).then_some(column)
    };
    let mut note = |text: String, severity, remedy: &str| {
        findings.push(Finding::new(FindingCode::Rate, severity, text).remedy(remedy));
    };
    // Ticks of 0.1 ms, 32 bits.
    if let Some(column) = find("sampletimefine") {
        return Source::Counter { column, period_ns: 1e5, modulus: 1 << 32 };
    }
    if let Some(column) = find("packetcounter") {
        let (rate, how, severity) = match update_rate(&table.preamble) {
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
    let rate = match layout.program {
        Some("KITTI oxts") => OXTS_RATE_HZ,
        _ => ASSUMED_RATE_HZ,
    };
    note(
        format!("there are no times: {rate} Hz assumed"),
        Severity::Warning,
        "name the column of times: --columns \"t=COLUMN:ms,…\"",
    );
    Source::Rows { period_ns: 1e9 / rate }
}

/// `// Update Rate: 100.0Hz`
fn update_rate(preamble: &[String]) -> Option<f64> {
    let line = preamble.iter().find_map(|line| line.split_once("Update Rate:"))?.1;
    let rate: f64 = line.trim().trim_end_matches("Hz").trim().parse().ok()?;
    (1e-3..1e6).contains(&rate).then_some(rate)
}

/// Power of ten of a nanosecond of a time column without a unit.
fn exponent_of(table: &Table, survey: &Survey, column: usize, findings: &mut Vec<Finding>) -> i32 {
    let Some((first, step)) = survey.times.first.zip(survey.times.mean_step()) else {
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
    findings.push(Finding::new(FindingCode::UnitInferred, severity, text).remedy(remedy));
    exponent
}
