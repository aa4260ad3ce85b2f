//! Aids that arrive over a link, as lines of a table.

use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::Duration;

use super::aids::{Aid, Aids, Mounting};
use crate::formats::table::{Measurements, TangentPlane};
use crate::localization::Ranging;
use crate::plural::counted;
use crate::transport::{self, Transport};
use crate::{Code, LinkUrl, Problem, Result};

/// Time for which a least delay counts, s: two clocks drift apart by 6 ms meanwhile (50 ppm).
const COUNTS_S: f64 = 120.0;
/// Lines that are taken at once: a faster link waits.
const MOST_LINES: usize = 1000;
/// Longest line, bytes: the rest of a longer one is dropped.
const MAX_LINE: usize = 4096;

/// The offset of another clock, from messages with its time: that of the least delay.
#[derive(Clone, Copy, Debug, Default)]
pub struct LeastDelay {
    /// Smallest differences, s, of the running half of [`COUNTS_S`] and of the half before.
    least: [Option<f64>; 2],
    begun_s: f64,
}

impl LeastDelay {
    /// A message with a time of the other clock, s, and when it arrived.
    pub fn see(&mut self, time_s: f64, arrived_s: f64) {
        if arrived_s - self.begun_s > 0.5 * COUNTS_S {
            self.least = [None, self.least[0]];
            self.begun_s = arrived_s;
        }
        let offset = arrived_s - time_s;
        self.least[0] = Some(self.least[0].map_or(offset, |least| least.min(offset)));
    }

    /// The other clock's time minus this clock's, s, if the least delay is zero; `None` before the first message.
    pub fn offset_s(&self) -> Option<f64> {
        let least = self.least.into_iter().flatten();
        least.reduce(f64::min).map(|least| -least)
    }
}

/// A link that carries aids or ranges: the header of their table, then its lines. Without a column of times a measurement
/// is made when it arrives; with one, the least delayed is.
pub struct AidLink {
    name: String,
    /// Lines, and when they arrived on the clock of the host's links, s.
    lines: Receiver<(f64, Result<String>)>,
    header: Option<String>,
    clock: LeastDelay,
    mounting: Mounting,
    /// The anchors, of ranges.
    ranging: Option<Ranging>,
    /// Where positions by latitude and longitude are measured from.
    plane: Option<TangentPlane>,
    unreadable: usize,
    finding: Option<Problem>,
}

impl AidLink {
    /// Opens the link. A measurement is made the delay of the mounting before it arrives. With anchors it carries ranges to them.
    ///
    /// # Errors
    /// Those of [`transport::open`].
    pub fn open(link: &LinkUrl, mounting: Mounting, ranging: Option<Ranging>) -> Result<Self> {
        let mut transport = transport::open(link)?;
        let (give, lines) = mpsc::sync_channel(MOST_LINES);
        thread::spawn(move || {
            let mut reader = Lines::default();
            loop {
                let read = reader.next(&mut transport);
                let over = read.is_err();
                if give.send((transport.now().as_secs_f64(), read)).is_err() || over {
                    return;
                }
            }
        });
        Ok(Self {
            name: link.to_string(),
            lines,
            header: None,
            clock: LeastDelay::default(),
            mounting,
            ranging,
            plane: None,
            unreadable: 0,
            finding: None,
        })
    }

    /// The aids that have arrived, at times of the host's links.
    pub fn arrived(&mut self) -> Vec<Aid> {
        let mut found = Vec::new();
        for _ in 0..MOST_LINES {
            let Ok((arrived_s, line)) = self.lines.try_recv() else {
                break;
            };
            let line = match line {
                Ok(line) => line,
                Err(error) => {
                    let text = format!("no more {}: {error}", self.kind());
                    self.finding = Some(Code::Navigation.warning(text));
                    break;
                }
            };
            let Some(header) = &self.header else {
                self.header = Some(line);
                continue;
            };
            let text = format!("{header}\n{line}\n");
            match self.aids(&text, arrived_s) {
                Ok(aids) => found.extend(aids.into_iter().map(|aid| {
                    self.clock.see(aid.time_s, arrived_s);
                    let offset_s = self.clock.offset_s().unwrap_or_default();
                    Aid { time_s: aid.time_s - offset_s - self.mounting.delay_s, ..aid }
                })),
                Err(error) => {
                    self.unreadable += 1;
                    let text = format!(
                        "{} of the {} cannot be read: {error}",
                        counted(self.unreadable, "line"),
                        self.kind()
                    );
                    self.finding = Some(Code::SamplesLeftOut.warning(text));
                }
            }
        }
        found
    }

    fn kind(&self) -> &'static str {
        self.ranging.as_ref().map_or("fixes", |_| "ranges")
    }

    fn aids(&mut self, text: &str, arrived_s: f64) -> Result<Vec<Aid>> {
        let mut table = Measurements::of(&self.name, text)?;
        let is_first = self.plane.is_none();
        table.project(&mut self.plane)?;
        if let Some(plane) = self.plane.as_ref().filter(|_| is_first) {
            self.finding = Some(plane.note());
        }
        let mounting = Mounting { delay_s: 0.0, ..self.mounting };
        match &self.ranging {
            None => Ok(Aids::of(&table, Some(arrived_s), &mounting)?.aids),
            Some(ranging) => {
                let ranges = ranging.ranges(&table, arrived_s)?;
                Ok(ranges.iter().map(|range| range.mounted(&mounting)).collect())
            }
        }
    }

    /// What was noticed last: a lost link, lines that are no fixes.
    pub fn finding(&self) -> Option<&Problem> {
        self.finding.as_ref()
    }
}

/// Lines of a byte stream.
#[derive(Default)]
struct Lines {
    bytes: Vec<u8>,
}

impl Lines {
    /// The next line that is not empty.
    fn next(&mut self, transport: &mut dyn Transport) -> Result<String> {
        loop {
            if let Some(end) = self.bytes.iter().position(|byte| *byte == b'\n') {
                let line: Vec<u8> = self.bytes.drain(..=end).collect();
                let line = String::from_utf8_lossy(&line).trim().to_owned();
                if !line.is_empty() {
                    return Ok(line);
                }
                continue;
            }
            self.bytes.truncate(MAX_LINE);
            let mut buffer = [0; 1024];
            let count = transport.read(&mut buffer, Duration::from_secs(1))?;
            self.bytes.extend_from_slice(&buffer[..count]);
        }
    }
}
