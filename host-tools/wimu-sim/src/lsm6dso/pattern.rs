//! The FIFO of the LSM6DS3TR-C: words without tags.

use std::collections::VecDeque;

/// Words that it holds: 4 kbyte.
pub(super) const WORDS: usize = 2048;
/// Words of a sample: gyroscope, then accelerometer.
const SAMPLE: u16 = 6;

#[derive(Debug, Default)]
pub(super) struct Fifo {
    words: VecDeque<i16>,
    /// Place of the oldest word in its sample.
    place: u16,
    /// Until a word is read.
    pub(super) overrun: bool,
}

impl Fifo {
    pub(super) fn len(&self) -> usize {
        self.words.len()
    }

    fn pop(&mut self) -> i16 {
        let word = self.words.pop_front();
        if word.is_some() {
            self.place = (self.place + 1) % SAMPLE;
        }
        word.unwrap_or_default()
    }

    /// Appends a sample. A full FIFO drops its oldest words.
    pub(super) fn push(&mut self, sample: [i16; 6]) {
        for word in sample {
            if self.words.len() >= WORDS {
                self.pop();
                self.overrun = true;
            }
            self.words.push_back(word);
        }
    }

    /// A byte of the oldest word, which leaves the FIFO with its high byte.
    pub(super) fn read(&mut self, high: bool) -> u8 {
        let [low_byte, high_byte] = self.words.front().copied().unwrap_or_default().to_le_bytes();
        if !high {
            return low_byte;
        }
        self.pop();
        self.overrun = false;
        high_byte
    }

    /// FIFO_STATUS1 to FIFO_STATUS4.
    pub(super) fn status(&self, register: usize, above_watermark: bool) -> u8 {
        let [low, high] = (self.len() as u16 & 0x7FF).to_le_bytes();
        let [place, _] = self.place.to_le_bytes();
        let flags = u8::from(above_watermark) << 7
            | u8::from(self.overrun) << 6
            | u8::from(self.len() >= WORDS) << 5
            | u8::from(self.words.is_empty()) << 4;
        [low, flags | high, place, 0][register]
    }
}
