//! The bare loop with a fixed calibration: counts to position.

#![no_std]
#![no_main]

use core::hint::black_box;

use bare_loop::run;
use wimu_model::{Corrector, CorrectorParts, Counts, PeriodNs};

/// As `wimu convert CAL.json --to rust` writes it.
const CORRECTOR: Corrector = Corrector::from_parts(CorrectorParts {
    shift: 9,
    coefficients: [
        [658_113_141, 2_105_344, 0],
        [-1_052_672, 655_360_000, 4_210_688],
        [0, 0, 660_602_880],
    ],
    offset: [257, -12_288, 6_144],
})
.unwrap();

#[cortex_m_rt::entry]
fn main() -> ! {
    let mut position = [0; 3];
    let ran = run(
        &CORRECTOR,
        PeriodNs(10_000_000),
        || black_box(Some(Counts([0, 0, 16384]))),
        |navigation| position = black_box(navigation.position.0),
    );
    let _ = black_box((ran, position));
    bare_loop_image::idle()
}
