//! Runs a calibration once, and prints the bytes of stack that it took.

#![no_std]

use core::hint::black_box;
use core::panic::PanicInfo;

use cortex_m::register::msp;
use cortex_m_semihosting::{debug, hio};
use wimu_calib::Pose;

/// Stack that is watched, bytes.
const WATCHED: u32 = 256 << 10;
/// Below the current frames nothing is written while the stack is painted, bytes.
const MARGIN: u32 = 256;
const PAINT: u32 = 0xa5a5_5a5a;

/// Poses in 26 directions of a sensor with a bias and scale errors, with noise of 3 mm/s² rms.
fn poses() -> [Pose; 26] {
    let mut state = 1_u32;
    core::array::from_fn(|k| {
        let k = if k < 13 { k } else { k + 1 };
        let up = [k / 9, k / 3 % 3, k % 3].map(|digit| digit as f32 - 1.0);
        let nonzero = up.iter().filter(|c| **c != 0.0).count();
        let force = [9.806_65, 6.934_35, 5.661_87][nonzero.clamp(1, 3) - 1];
        let mut noise = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            0.01 * ((state >> 8) as f32 / 16_777_216.0 - 0.5)
        };
        let [x, y, z] = up.map(|c| force * c + noise());
        Pose::from_mean([1.02 * x + 0.3, 0.98 * y - 0.2, z + 0.1].map(f64::from))
    })
}

/// Calls `calibrate`, which says whether it succeeded, prints its stack in bytes, and ends QEMU.
pub fn run(calibrate: fn(&[Pose]) -> bool) -> ! {
    let poses = black_box(poses());
    let top = msp::read() - MARGIN;
    for address in (top - WATCHED..top).step_by(4) {
        // SAFETY: RAM below the stack pointer that nothing else uses: there are no interrupts.
        unsafe { core::ptr::write_volatile(address as *mut u32, PAINT) };
    }
    let sound = black_box(calibrate)(&poses);
    // SAFETY: as above.
    let untouched =
        |address: &u32| unsafe { core::ptr::read_volatile(*address as *const u32) == PAINT };
    let untouched = (top - WATCHED..top).step_by(4).take_while(untouched).count() as u32;
    let mut stack = WATCHED + MARGIN - 4 * untouched;
    let mut digits = *b"       \n";
    for digit in digits[..7].iter_mut().rev() {
        *digit = b'0' + (stack % 10) as u8;
        stack /= 10;
    }
    let printed = hio::hstdout().and_then(|mut out| out.write_all(&digits));
    debug::exit(if sound && printed.is_ok() { debug::EXIT_SUCCESS } else { debug::EXIT_FAILURE });
    loop {
        cortex_m::asm::wfi();
    }
}

#[panic_handler]
fn panic(_: &PanicInfo) -> ! {
    debug::exit(debug::EXIT_FAILURE);
    loop {
        cortex_m::asm::wfi();
    }
}
