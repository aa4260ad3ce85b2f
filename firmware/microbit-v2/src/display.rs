//! The LED matrix, which shows the device's state.

use embassy_nrf::Peri;
use embassy_nrf::gpio::{AnyPin, Input, Level, Output, OutputDrive};
use wimu_node::{Health, Timer};
use wimu_nrf::BoardTimer;

use crate::tasks::Shared;

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
const MARKED: Picture = [0b11111, 0b11111, 0b11111, 0b11111, 0b11111];

/// The picture for the present state `now` and that of a second ago, `before`.
fn picture(before: &Health, now: &Health, is_safe_mode: bool) -> Picture {
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
    rows: [Output<'static>; 5],
    /// From the left; lit while low.
    columns: [Output<'static>; 5],
}

impl Matrix {
    pub fn new(rows: [Peri<'static, AnyPin>; 5], columns: [Peri<'static, AnyPin>; 5]) -> Self {
        let led = |pin| Output::new(pin, Level::Low, OutputDrive::Standard);
        Self { rows: rows.map(led), columns: columns.map(led) }
    }

    /// Lights a row of `picture`.
    fn show(&mut self, picture: Picture, row: usize) {
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

/// Time for which a row of the display is lit, µs.
const ROW_US: u64 = 3_000;
/// Rows of the display in a second.
const ROWS_A_SECOND: u32 = 333;
/// Consecutive rows for which a button must be down.
const DEBOUNCE: u32 = 10;
/// Rows of the display for which button B must be held to erase the key: 5 s.
const KEY_LOST_ROWS: u32 = 5 * ROWS_A_SECOND;

/// Shows the device's state and polls the buttons.
#[embassy_executor::task]
pub async fn attend(
    shared: &'static Shared,
    is_safe_mode: bool,
    mut matrix: Matrix,
    buttons: [Input<'static>; 2],
) -> ! {
    let [button_a, button_b] = buttons;
    let mut before = shared.health();
    let mut shown = picture(&before, &before, is_safe_mode);
    let mut pressed = 0;
    // A button that has been down since the start is ignored.
    let mut released = false;
    let mut held = 0;
    let mut marks = 0_u16;
    for tick in (0..ROWS_A_SECOND).cycle() {
        if tick == 0 {
            let now = shared.health();
            shown = picture(&before, &now, is_safe_mode);
            before = now;
        }
        pressed = if button_a.is_low() { pressed + 1 } else { 0 };
        if pressed == DEBOUNCE {
            marks = marks.wrapping_add(1);
            shared.mark(BoardTimer.now(), marks);
            shown = MARKED;
        }
        released |= button_b.is_high();
        let is_held = released && button_b.is_low();
        held = if is_held { held + 1 } else { 0 };
        if held == KEY_LOST_ROWS {
            shared.forget_key();
            shown = MARKED;
        }
        matrix.show(shown, tick as usize % 5);
        BoardTimer.after_us(ROW_US).await;
    }
    core::future::pending().await
}
