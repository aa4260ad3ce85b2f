//! Any model in f64, with the leave-one-out error.

#![no_std]
#![no_main]

use wimu_calib::{Gravity, Model, multi_position};

#[cortex_m_rt::entry]
fn main() -> ! {
    calibration::run(|poses| {
        core::hint::black_box(multi_position(poses, Gravity::UNKNOWN_PLACE, Model::Full9)).is_ok()
    })
}
