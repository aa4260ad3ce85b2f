//! The LED matrix: how the device is, as a picture.

use embassy_nrf::gpio::Output;
use wimu_node::Health;

/// Five rows from the top, in each five LEDs, the leftmost the highest of five bits.
type Picture = [u8; 5];

/// A question mark: the sensor does not answer.
const NO_SENSOR: Picture = [0b01110, 0b00010, 0b00100, 0b00000, 0b00100];
/// Three dots: no samples yet.
const SEARCHING: Picture = [0b00000, 0b00000, 0b10101, 0b00000, 0b00000];
/// A cross: samples, but no calibration.
const UNCALIBRATED: Picture = [0b10001, 0b01010, 0b00100, 0b01010, 0b10001];
/// A tick: samples and a calibration.
const CALIBRATED: Picture = [0b00000, 0b00001, 0b00010, 0b10100, 0b01000];
/// Added while a link is too slow for what it is to carry.
const POOR_LINK: Picture = [0b00000, 0b00000, 0b00000, 0b00000, 0b11111];
/// The button was pressed.
pub const MARKED: Picture = [0b11111, 0b11111, 0b11111, 0b11111, 0b11111];

/// What to show of a device that was `before` a second ago and is `now`.
pub fn picture(before: &Health, now: &Health) -> Picture {
    let mut picture = if now.sensor_lost {
        NO_SENSOR
    } else if now.samples == before.samples {
        SEARCHING
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
    /// Lights row `index` of `picture`.
    pub fn show(&mut self, picture: Picture, index: usize) {
        for row in &mut self.rows {
            row.set_low();
        }
        let Some(&bits) = picture.get(index) else {
            return;
        };
        for (place, column) in self.columns.iter_mut().enumerate() {
            column.set_level((bits >> (4 - place) & 1 == 0).into());
        }
        if let Some(row) = self.rows.get_mut(index) {
            row.set_high();
        }
    }
}
