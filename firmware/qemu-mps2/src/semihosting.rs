//! Semihosting: command line and exit code.

use core::sync::atomic::{Ordering, compiler_fence};

use cortex_m_semihosting::{nr, syscall};

const EXIT_EXTENDED: usize = 0x20;
const APPLICATION_EXIT: usize = 0x2_0026;

/// The command line: QEMU's `arg=…` joined with spaces, up to the length of `buffer`.
pub fn command_line(buffer: &mut [u8]) -> &str {
    let block = core::cell::UnsafeCell::new([buffer.as_mut_ptr() as usize, buffer.len()]);
    // SAFETY: the block names memory that is ours for the time of the call.
    let failed = unsafe { syscall(nr::GET_CMDLINE, &block) } != 0;
    compiler_fence(Ordering::SeqCst);
    let [_, length] = block.into_inner();
    let length = if failed { 0 } else { length };
    buffer.get(..length).and_then(|line| core::str::from_utf8(line).ok()).unwrap_or_default()
}

/// Ends the machine; its host exits with `code`.
pub fn exit(code: u8) -> ! {
    loop {
        // SAFETY: the block is what the call expects.
        unsafe { syscall(EXIT_EXTENDED, &[APPLICATION_EXIT, code.into()]) };
    }
}
