//! Semihosting: command line and exit code.

use core::arch::asm;
use core::sync::atomic::{Ordering, compiler_fence};

const GET_CMDLINE: usize = 0x15;
const EXIT_EXTENDED: usize = 0x20;
const APPLICATION_EXIT: usize = 0x2_0026;

/// The command line: QEMU's `arg=…` joined with spaces, up to the length of `buffer`.
pub fn command_line(buffer: &mut [u8]) -> &str {
    let mut block = [buffer.as_mut_ptr() as usize, buffer.len()];
    // SAFETY: the block names memory that is ours for the time of the call.
    let failed = unsafe { call(GET_CMDLINE, block.as_mut_ptr()) } != 0;
    let length = if failed { 0 } else { block[1] };
    buffer.get(..length).and_then(|line| core::str::from_utf8(line).ok()).unwrap_or_default()
}

/// Ends the machine; its host exits with `code`.
pub fn exit(code: u8) -> ! {
    let mut block = [APPLICATION_EXIT, code.into()];
    loop {
        // SAFETY: the block is what the call expects.
        unsafe { call(EXIT_EXTENDED, block.as_mut_ptr()) };
    }
}

/// # Safety
/// `block` must be what `operation` expects.
unsafe fn call(operation: usize, block: *mut usize) -> usize {
    let result;
    compiler_fence(Ordering::SeqCst);
    // SAFETY: the breakpoint hands over to the host, which changes nothing but what `block` names.
    unsafe {
        asm!(
            "bkpt #0xAB",
            inlateout("r0") operation => result,
            in("r1") block,
            options(nostack, preserves_flags),
        );
    }
    compiler_fence(Ordering::SeqCst);
    result
}
