//! What is printed and checked while boards send.

use serde::Serialize;
use wimu_host::{Problem, Result};

use crate::arguments::Navigate;
use crate::output::{Output, usage};

/// Answers a second without `--rate`.
const RATE_HZ: f64 = 10.0;
/// Remedy where there was no answer.
pub const WAIT: &str = "wait longer; `wimu monitor LINK` shows whether samples arrive";

/// What is printed while it goes on.
pub struct Shown<'a> {
    output: &'a Output,
    refreshes: bool,
    every_s: f64,
    last_s: Option<f64>,
    printed_s: Option<f64>,
    /// Findings that were printed, without their figures.
    said: Vec<String>,
    /// False once the output is closed.
    pub going: bool,
}

impl<'a> Shown<'a> {
    /// Answers per second from `--rate`, [`RATE_HZ`] without it.
    pub fn new(rate_hz: Option<f64>, output: &'a Output) -> Self {
        Self {
            output,
            refreshes: output.is_terminal(),
            every_s: rate_hz.unwrap_or(RATE_HZ).recip(),
            last_s: None,
            printed_s: None,
            said: Vec::new(),
            going: true,
        }
    }

    /// Whether the next answer is due at the time of the newest sample, s.
    pub fn is_due(&self, newest_s: f64) -> bool {
        is_due(newest_s, self.last_s, self.every_s)
    }

    /// Prints an answer at a time, s.
    pub fn show(&mut self, time_s: f64, answer: &impl Serialize, text: impl FnOnce() -> String) {
        self.last_s = Some(time_s);
        if self.output.is_json() {
            self.going &= self.output.object(answer);
        } else if self.refreshes {
            self.output.refresh(&text());
        } else if is_due(time_s, self.printed_s, 1.0) {
            self.printed_s = Some(time_s);
            self.output.print(text());
        }
    }

    /// Whether no finding of this kind was printed.
    pub fn is_new(&self, finding: &Problem) -> bool {
        !self.said.contains(&kind(finding))
    }

    /// Prints findings of a kind that was not printed before.
    pub fn say(&mut self, findings: &[Problem]) {
        for finding in findings {
            if self.is_new(finding) {
                self.said.push(kind(finding));
                self.output.end_refresh();
                self.output.findings(std::slice::from_ref(finding));
            }
        }
    }
}

/// The text of a finding without its figures.
fn kind(finding: &Problem) -> String {
    let is_word = |c: &char| !c.is_ascii_digit() && *c != '.' && *c != 's';
    finding.text.chars().filter(is_word).collect()
}

fn is_due(newest_s: f64, last_s: Option<f64>, every_s: f64) -> bool {
    last_s.is_none_or(|last_s| !(0.0..every_s - 1e-6).contains(&(newest_s - last_s)))
}

/// Refuses a calibration for samples that a board corrects.
pub fn corrected_there(arguments: &Navigate, link: &str) -> Result<()> {
    if arguments.with.is_empty() && arguments.sensitivity.is_none() {
        return Ok(());
    }
    let remedy =
        format!("write the calibration to the board: `wimu device params push {link} CAL.json`");
    Err(usage("a board corrects its samples itself", remedy))
}
