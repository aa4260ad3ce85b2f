//! The minimal fit in f64.

#![no_std]
#![no_main]

use wimu_calib::{Gravity, minimal_fit};

#[cortex_m_rt::entry]
fn main() -> ! {
    calibration::run(|poses| {
        core::hint::black_box(minimal_fit::<f64>(poses, Gravity::UNKNOWN_PLACE)).is_ok()
    })
}
