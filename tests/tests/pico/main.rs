//! The Pico's own image on an emulated RP2040 with an ADXL345 on its bus: `cargo xtask release --only
//! pico`. Both UARTs take their time, bit by bit.

mod faults;
mod image;
mod rates;
pub mod run;
mod store;
mod streams;
