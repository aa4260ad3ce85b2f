//! What the others have beside their calibration.

#![no_std]
#![no_main]

#[cortex_m_rt::entry]
fn main() -> ! {
    calibration::run(|poses| !poses.is_empty())
}
