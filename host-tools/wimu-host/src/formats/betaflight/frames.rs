//! Frames of a log: each main frame holds all fields (I) or differences to the frames before (P).

use super::super::window::{Damage, Window};
use super::encoding::{self, Cursor};
use super::header::{Header, MARKER};
use crate::Result;

/// First bytes of frames.
const KINDS: &[u8] = b"IPSGHE";
/// Longest frame, bytes; those of today have up to 256.
const MAX_FRAME: usize = 1024;
/// Longest time between two frames of a log that is not damaged, µs (as blackbox_decode).
const MAX_STEP_US: i64 = 10_000_000;

const EVENT_SYNC_BEEP: u32 = 0;
const EVENT_ADJUSTMENT: u32 = 13;
const EVENT_RESUME: u32 = 14;
const EVENT_DISARM: u32 = 15;
const EVENT_FLIGHT_MODE: u32 = 30;
const EVENT_IMU_FAILURE: u32 = 40;
const EVENT_END: u32 = 255;
const END_OF_LOG: &[u8] = b"End of log";

/// What a log holds, apart from its rows.
#[derive(Clone, Debug, Default)]
pub(super) struct Summary {
    /// Number of rows.
    pub(super) rows: usize,
    /// Times of the first and the last, µs.
    pub(super) times_us: Option<[i64; 2]>,
    /// Number of frames whose reference is damaged or whose time is implausible.
    pub(super) lost: usize,
    /// Bytes that belong to no frame.
    pub(super) damage: Damage,
}

/// A frame.
enum Frame {
    Intra,
    Inter,
    /// The logger was paused.
    Resume,
    End,
    Other,
}

/// Decodes the frames of one log.
pub(super) struct Decoder {
    encodings: [Vec<u8>; 5],
    /// Index of the time and of the other fields that are wanted, and predictors of their
    /// differences.
    wanted: Vec<(usize, u8)>,
    /// Values of all fields of a frame.
    values: Vec<i64>,
    /// Values of the wanted fields of the latest two main frames.
    history: [Vec<i64>; 2],
    /// Whether differences can be added to them.
    valid: bool,
    /// Whether the next time may be any.
    any_time: bool,
}

impl Decoder {
    /// Decoder of the time and the fields of `names`; `None` if the header does not say how.
    pub(super) fn new(header: &Header, names: &[String]) -> Option<Self> {
        let encodings = |frame| header.numbers(frame, "encoding");
        let fields = header.names('I');
        let intra = encodings('I').filter(|intra| intra.len() == fields.len())?;
        let inter = encodings('P').filter(|inter| inter.len() == fields.len())?;
        let predictors = ['I', 'P'].map(|frame| header.numbers(frame, "predictor"));
        let [Some(of_intra), Some(of_inter)] = predictors else {
            return None;
        };
        let index_of = |name: &str| {
            let index = fields.iter().position(|field| *field == name)?;
            let predictor = *of_inter.get(index).filter(|predictor| **predictor <= 3)?;
            (of_intra.get(index) == Some(&0)).then_some((index, predictor))
        };
        let names = std::iter::once("time").chain(names.iter().map(String::as_str));
        let wanted: Option<Vec<_>> = names.map(index_of).collect();
        let others = ['S', 'G', 'H'].map(|frame| encodings(frame).unwrap_or_default());
        let [slow, gps, home] = others;
        Some(Self {
            encodings: [intra, inter, slow, gps, home],
            wanted: wanted?,
            values: Vec::new(),
            history: [Vec::new(), Vec::new()],
            valid: false,
            any_time: true,
        })
    }

    /// Reads the frames up to the end of the log; hands the time, µs, and the wanted fields of
    /// each main frame to `each`.
    pub(super) fn decode(
        mut self,
        window: &mut Window,
        each: &mut dyn FnMut(i64, &[i64]),
    ) -> Result<Summary> {
        let mut summary = Summary::default();
        let shortest = 1 + encoding::shortest(&self.encodings[1]);
        let mut gap = 0;
        loop {
            let ahead = window.peek(MAX_FRAME + 1)?;
            if ahead.is_empty() || ahead.starts_with(MARKER) {
                break;
            }
            let Some((frame, length)) = self.frame(ahead) else {
                summary.damage.add(window.position());
                window.skip(1);
                gap += 1;
                continue;
            };
            window.skip(length);
            // A shorter gap cannot hide a main frame.
            self.valid &= gap < shortest;
            gap = 0;
            match frame {
                Frame::Intra | Frame::Inter => match self.row(matches!(frame, Frame::Intra)) {
                    Some(time_us) => {
                        summary.rows += 1;
                        let first = summary.times_us.map_or(time_us, |times| times[0]);
                        summary.times_us = Some([first, time_us]);
                        each(time_us, &self.history[0][1..]);
                    }
                    None => summary.lost += 1,
                },
                Frame::Resume => self.any_time = true,
                Frame::End => break,
                Frame::Other => (),
            }
        }
        Ok(summary)
    }

    /// The frame that starts here, with its length, if another one or nothing follows.
    fn frame(&mut self, ahead: &[u8]) -> Option<(Frame, usize)> {
        let mut cursor = Cursor::new(ahead, 1);
        let kind = KINDS.iter().position(|kind| *kind == ahead[0])?;
        let frame = match self.encodings.get(kind) {
            Some(encodings) if encodings.is_empty() => return None,
            Some(encodings) => {
                cursor.fields(encodings, &mut self.values)?;
                match kind {
                    0 => Frame::Intra,
                    1 => Frame::Inter,
                    _ => Frame::Other,
                }
            }
            None => event(&mut cursor, ahead)?,
        };
        let next = ahead.get(cursor.at);
        let followed = next.is_none_or(|next| KINDS.contains(next));
        (followed || matches!(frame, Frame::End)).then_some((frame, cursor.at))
    }

    /// Adds the latest main frame to the history; returns its time, µs.
    fn row(&mut self, intra: bool) -> Option<i64> {
        if !intra && !self.valid {
            return None;
        }
        let [before, before_that] = &self.history;
        let mut row = Vec::with_capacity(self.wanted.len());
        for (k, (index, predictor)) in self.wanted.iter().enumerate() {
            let value = *self.values.get(*index)?;
            let value = match (intra, predictor) {
                (true, _) | (_, 0) => value,
                (_, 1) => value + before[k],
                (_, 2) => value + 2 * before[k] - before_that[k],
                _ => value + (before[k] + before_that[k]) / 2,
            };
            // Fields have 32 bits, as in the device.
            row.push(match (k, before.first()) {
                (0, Some(last)) => {
                    last + i64::from((value as u32).wrapping_sub(*last as u32) as i32)
                }
                (0, None) => i64::from(value as u32),
                _ => i64::from(value as i32),
            });
        }
        let step = before.first().map(|last| row[0] - last);
        let plausible = step.is_none_or(|step| (1..=MAX_STEP_US).contains(&step));
        // After one implausible time, the next I frame starts anew.
        self.valid = plausible || self.any_time && intra;
        self.any_time = !self.valid;
        if !self.valid {
            return None;
        }
        let time_us = row[0];
        let old = std::mem::replace(&mut self.history[0], row);
        self.history[1] = if intra { self.history[0].clone() } else { old };
        Some(time_us)
    }
}

/// An event, up to its end.
fn event(cursor: &mut Cursor, ahead: &[u8]) -> Option<Frame> {
    match cursor.byte()? {
        EVENT_SYNC_BEEP | EVENT_DISARM | EVENT_IMU_FAILURE => drop(cursor.unsigned()?),
        EVENT_FLIGHT_MODE => {
            cursor.unsigned()?;
            cursor.unsigned()?;
        }
        EVENT_RESUME => {
            cursor.unsigned()?;
            cursor.unsigned()?;
            return Some(Frame::Resume);
        }
        EVENT_ADJUSTMENT => match cursor.byte()? {
            // A float of 32 bits.
            0x80.. => cursor.at += 4,
            _ => drop(cursor.signed()?),
        },
        EVENT_END if ahead.get(cursor.at..)?.starts_with(END_OF_LOG) => {
            cursor.at += END_OF_LOG.len() + 1;
            return Some(Frame::End);
        }
        _ => return None,
    }
    Some(Frame::Other)
}
