//! Model selection with rejection of outliers.

#![no_std]
#![no_main]

use wimu_calib::{Gravity, Terms, best_model};

#[cortex_m_rt::entry]
fn main() -> ! {
    calibration::run(|poses| {
        core::hint::black_box(best_model(poses, Gravity::UNKNOWN_PLACE, Terms::NONE, true)).is_ok()
    })
}
