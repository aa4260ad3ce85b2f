//! The FIFO of tagged words.

use std::collections::VecDeque;

/// Words that it holds: 3 kbyte of data.
pub(super) const WORDS: usize = 512;

/// TAG_SENSOR.
pub(super) const GYROSCOPE: u8 = 1;
pub(super) const ACCELEROMETER: u8 = 2;
pub(super) const TEMPERATURE: u8 = 3;

#[derive(Debug, Default)]
pub(super) struct Fifo {
    words: VecDeque<[u8; 7]>,
    overrun: bool,
    /// Until the status is read.
    overrun_latched: bool,
}

impl Fifo {
    pub(super) fn len(&self) -> usize {
        self.words.len()
    }

    /// Appends a word. A full FIFO drops its oldest word, also while that is being read.
    pub(super) fn push(&mut self, sensor: u8, counter: u8, data: [[u8; 2]; 3]) {
        let tag = sensor << 3 | (counter & 0b11) << 1;
        // Even parity of the whole byte.
        let parity = (tag.count_ones() % 2) as u8;
        let [[a, b], [c, d], [e, f]] = data;
        if self.words.len() >= WORDS {
            self.words.pop_front();
            self.overrun = true;
            self.overrun_latched = true;
        }
        self.words.push_back([tag | parity, a, b, c, d, e, f]);
    }

    /// Byte `byte` (0..=6) of the oldest word, which leaves the FIFO with its last byte. An empty
    /// FIFO reads as 0.
    pub(super) fn read(&mut self, byte: usize) -> u8 {
        let word = self.words.front().copied().unwrap_or_default();
        if byte == 6 {
            self.words.pop_front();
            self.overrun = false;
        }
        word[byte]
    }

    /// FIFO_STATUS2 without the watermark.
    pub(super) fn status2(&mut self) -> u8 {
        u8::from(self.overrun) << 6
            | u8::from(self.len() >= WORDS) << 5
            | u8::from(std::mem::take(&mut self.overrun_latched)) << 3
            | (self.len() >> 8) as u8
    }
}
