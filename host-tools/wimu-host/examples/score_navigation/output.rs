//! The readable table, and JSON with one line for each score of a method.

use std::io::Write;

use serde::Serialize;
use serde_json::ser::{Formatter, PrettyFormatter, Serializer};

use crate::report::{ArrayReport, ConsistencyReport, MethodReport, RecordingReport, Report};

/// Three significant digits, nine characters, the first a space.
fn figure(value: f64) -> String {
    let size = value.abs();
    let text = if !value.is_finite() {
        "-".to_owned()
    } else if size >= 99_950.0 || (size > 0.0 && size < 9.995e-4) {
        format!("{value:.2e}")
    } else if size == 0.0 {
        "0".to_owned()
    } else {
        // The exponent after rounding to three digits.
        let rounded = format!("{size:.2e}");
        let exponent: i32 = rounded.rsplit('e').next().unwrap_or("0").parse().unwrap_or(0);
        format!("{value:.*}", usize::try_from(2 - exponent).unwrap_or(0))
    };
    format!(" {text:>8}")
}

fn percent(fraction: f64) -> String {
    if fraction.is_finite() { format!("{:7.1}", 100.0 * fraction) } else { format!("{:>7}", "-") }
}

fn figures(values: &[f64]) -> String {
    values.iter().map(|v| figure(*v)).collect()
}

/// Prints one block: windows, whole run, ratios.
pub fn print(report: &RecordingReport) {
    let RecordingReport { name, moving_samples, windows, methods } = report;
    println!("\n## {name}: {moving_samples} moving samples, {windows} windows");
    for method in methods {
        if let Some(refused) = &method.refused {
            let short: String = refused.chars().take(80).collect();
            println!("{:<26}refused: {short}", method.name);
        }
        if let Some(closure) = method.closure_m {
            println!(
                "{:<26}distance of the end from the start, m:{}",
                method.name,
                figure(closure)
            );
        }
    }
    print_windows(methods);
    print_whole(methods);
    print_ratios(methods);
    let lost: usize = methods.iter().map(|m| m.non_finite).sum();
    if lost > 0 {
        println!("values that are not finite: {lost}");
    }
}

fn print_windows(methods: &[MethodReport]) {
    let with_windows: Vec<_> =
        methods.iter().filter_map(|m| Some((m.name, m.windows.as_ref()?))).collect();
    if with_windows.is_empty() {
        return;
    }
    println!("{:<26}{:>27}{:>27}", "windows, 1 / 2 / 5 s", "median error, m", "RMS error, m");
    for (name, windows) in &with_windows {
        println!("{name:<26}{}{}", figures(&windows.median_m), figures(&windows.rms_m));
    }
    println!(
        "{:<35}{:>21}{:>27}{:>27}",
        "", "NEES < 95 % point, %", "NEES median (2.37)", "log score"
    );
    for (name, windows) in &with_windows {
        for (what, score) in [("position", &windows.position), ("velocity", &windows.velocity)] {
            let Some(score) = score else {
                continue;
            };
            let below: String = score.nees_below_95.iter().map(|f| percent(*f)).collect();
            let (median, log) = (figures(&score.nees_median), figures(&score.log_score));
            println!("{name:<26}{what:<9}{below}{median}{log}");
        }
    }
}

fn print_whole(methods: &[MethodReport]) {
    let scored: Vec<_> = methods.iter().filter_map(|m| Some((m.name, m.whole.as_ref()?))).collect();
    if scored.is_empty() {
        return;
    }
    println!(
        "{:<26}{:>7}{:>9}{:>9}{:>9}{:>9}{:>12}{:>9}",
        "whole run, error, m", "valid %", "median", "RMS", "end", "σ", "last rest", "σ"
    );
    for (name, whole) in &scored {
        let rest = figures(&whole.last_rest_m);
        println!(
            "{name:<26}{}{}{}{rest:>21}",
            percent(whole.valid),
            figures(&[whole.median_m, whole.rms_m]),
            figures(&whole.end_m)
        );
    }
    let head = format!("{:>9}{:>7}{:>9}{:>9}", "log", "< 95 %", "median", "worst σ");
    println!("{:<26}{:^34}{:^34}", "", "position: log score, NEES", "velocity: log score, NEES");
    println!("{:<26}{head}{head}", "");
    for (name, whole) in scored.iter().filter(|(_, w)| w.velocity.is_some() || w.position.is_some())
    {
        let (position, velocity) = (whole.position.as_ref(), whole.velocity.as_ref());
        println!("{name:<26}{}{}", consistency(position), consistency(velocity));
        if let Some(nis) = &whole.nis {
            println!(
                "{:<26} NIS of {} zero-velocity updates:{} % < 95 % point, median{}",
                "",
                nis.updates,
                percent(nis.below_95),
                figure(nis.median)
            );
        }
    }
}

fn consistency(score: Option<&ConsistencyReport>) -> String {
    let Some(s) = score else {
        return format!("{:>9}{:>7}{:>9}{:>9}", "-", "-", "-", "-");
    };
    let (log, below) = (figure(s.log_score), percent(s.nees_below_95));
    format!("{log}{below}{}", figures(&[s.nees_median, s.worst_sigma]))
}

fn print_ratios(methods: &[MethodReport]) {
    if methods.iter().all(|m| m.ratio_to.is_empty()) {
        return;
    }
    let head = ["error ratio to", "windows, 1 / 2 / 5 s", "RMS", "last rest"];
    println!("{:<42}{:>27}{:>9}{:>12}", head[0], head[1], head[2], head[3]);
    for method in methods {
        for (baseline, ratio) in &method.ratio_to {
            let windows = figures(&ratio.windows.unwrap_or([f64::NAN; 3]));
            let (rms, rest) = (figure(ratio.rms), figure(ratio.last_rest));
            println!("{:<26}{baseline:<16}{windows}{rms}{rest:>12}", method.name);
        }
    }
}

/// Prints the block of an array.
pub fn print_array(report: &ArrayReport) {
    println!(
        "\n## {}: {} samples above 1 rad/s, {} next to clipping left out",
        report.name, report.moving_samples, report.next_to_clipping
    );
    println!(
        "{:<26}{:>7}{:>9}{:>9}{:>13}{:>9}{:>7}{:>9}{:>9}",
        "angular rate, deg/s",
        "valid %",
        "RMSE",
        "median",
        "wrong sign %",
        "log",
        "< 95 %",
        "NEES",
        "worst σ"
    );
    for method in &report.methods {
        let wrong = percent(method.wrong_sign);
        println!(
            "{:<26}{}{}{wrong:>13}{}",
            method.name,
            percent(method.valid.unwrap_or(f64::NAN)),
            figures(&[method.rms_deg_s, method.median_deg_s]),
            consistency(method.rate.as_ref())
        );
    }
}

/// Objects and lists up to this depth have a line for each entry; deeper ones are on one line.
const LINES_TO: usize = 5;

/// [`PrettyFormatter`] up to a depth, and compact beyond it.
struct Lines {
    pretty: PrettyFormatter<'static>,
    depth: usize,
}

/// Each of a pair of calls goes to the pretty formatter above the depth.
macro_rules! begin {
    ($name:ident, $bracket:literal) => {
        fn $name<W: ?Sized + Write>(&mut self, writer: &mut W) -> std::io::Result<()> {
            self.depth += 1;
            if self.depth <= LINES_TO {
                self.pretty.$name(writer)
            } else {
                writer.write_all($bracket)
            }
        }
    };
}
macro_rules! end {
    ($name:ident, $bracket:literal) => {
        fn $name<W: ?Sized + Write>(&mut self, writer: &mut W) -> std::io::Result<()> {
            self.depth -= 1;
            if self.depth < LINES_TO {
                self.pretty.$name(writer)
            } else {
                writer.write_all($bracket)
            }
        }
    };
}
macro_rules! entry {
    ($name:ident) => {
        fn $name<W: ?Sized + Write>(&mut self, writer: &mut W, first: bool) -> std::io::Result<()> {
            match (self.depth <= LINES_TO, first) {
                (true, _) => self.pretty.$name(writer, first),
                (false, true) => Ok(()),
                (false, false) => writer.write_all(b", "),
            }
        }
    };
}

impl Formatter for Lines {
    begin!(begin_array, b"[");
    begin!(begin_object, b"{");
    end!(end_array, b"]");
    end!(end_object, b"}");
    entry!(begin_array_value);
    entry!(begin_object_key);

    fn end_array_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> std::io::Result<()> {
        self.pretty.end_array_value(writer)
    }

    fn begin_object_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> std::io::Result<()> {
        self.pretty.begin_object_value(writer)
    }

    fn end_object_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> std::io::Result<()> {
        self.pretty.end_object_value(writer)
    }
}

/// The report as JSON. Values that are not finite become `null`.
///
/// # Errors
/// None that serialising to memory can have.
pub fn json(report: &Report) -> serde_json::Result<Vec<u8>> {
    let mut text = Vec::new();
    let lines = Lines { pretty: PrettyFormatter::with_indent(b" "), depth: 0 };
    report.serialize(&mut Serializer::with_formatter(&mut text, lines))?;
    text.push(b'\n');
    Ok(text)
}
