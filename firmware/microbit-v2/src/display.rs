//! The LED matrix, which shows the device's state.

use embassy_nrf::gpio::Output;
use wimu_node::Health;

/// Five rows from the top, each of five bits; the highest bit is the leftmost LED.
type Picture = [u8; 5];

/// A question mark: the sensor does not answer.
const NO_SENSOR: Picture = [0b01110, 0b00010, 0b00100, 0b00000, 0b00100];
/// Three dots: no samples in the last second.
const NO_SAMPLES: Picture = [0b00000, 0b00000, 0b10101, 0b00000, 0b00000];
/// An exclamation mark: safe mode.
const SAFE_MODE: Picture = [0b00100, 0b00100, 0b00100, 0b00000, 0b00100];
/// A cross: samples, but no calibration.
const UNCALIBRATED: Picture = [0b10001, 0b01010, 0b00100, 0b01010, 0b10001];
/// A tick: samples and a calibration.
const CALIBRATED: Picture = [0b00000, 0b00001, 0b00010, 0b10100, 0b01000];
/// Added while a link is too slow for its streams.
const POOR_LINK: Picture = [0b00000, 0b00000, 0b00000, 0b00000, 0b11111];
/// The button was pressed.
pub const MARKED: Picture = [0b11111, 0b11111, 0b11111, 0b11111, 0b11111];

/// The picture for the present state `now` and that of a second ago, `before`.
pub fn picture(before: &Health, now: &Health, is_safe_mode: bool) -> Picture {
    let mut picture = if now.sensor_lost {
        NO_SENSOR
    } else if now.samples == before.samples {
        NO_SAMPLES
    } else if is_safe_mode {
        SAFE_MODE
    } else if now.calibrated {
        CALIBRATED
    } else {
        UNCALIBRATED
    };
    if now.shed != before.shed {
        for (row, added) in picture.iter_mut().zip(POOR_LINK) {
            *row |= added;
        }
    }
    picture
}

/// The matrix, of which one row is lit at a time.
pub struct Matrix {
    /// From the top; lit while high.
    pub rows: [Output<'static>; 5],
    /// From the left; lit while low.
    pub columns: [Output<'static>; 5],
}

impl Matrix {
    /// Lights a row of `picture`.
    pub fn show(&mut self, picture: Picture, row: usize) {
        for other in &mut self.rows {
            other.set_low();
        }
        let Some(&bits) = picture.get(row) else {
            return;
        };
        for (index, column) in self.columns.iter_mut().enumerate() {
            column.set_level((bits >> (4 - index) & 1 == 0).into());
        }
        if let Some(row) = self.rows.get_mut(row) {
            row.set_high();
        }
    }
}
