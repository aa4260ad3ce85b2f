//! Guard and measurement of the stack, which cortex-m-rt paints at the start.

use core::ptr::addr_of;

#[cfg(not(feature = "armv8m"))]
use cortex_m::peripheral::MPU;
use cortex_m_rt::STACK_PAINT_VALUE;
use wimu_link::message::StackStatus;

/// Size of the guard: the smallest region of the memory protection unit of Armv6-M, bytes.
const GUARD: u32 = 256;
#[cfg(not(feature = "armv8m"))]
/// Size field of a region of [`GUARD`] bytes (Armv7-M, B3.5.9): 2⁷⁺¹ bytes.
const GUARD_SIZE: u32 = 7;
#[cfg(not(feature = "armv8m"))]
/// Region attributes: enabled; not executable; read-only.
const ATTRIBUTES: u32 = 1 | GUARD_SIZE << 1 | 0b101 << 24 | 1 << 28;
#[cfg(not(feature = "armv8m"))]
/// Control: enabled; elsewhere the default memory map holds. In handlers of faults there is no protection.
const CONTROL: u32 = 1 | 1 << 2;

unsafe extern "C" {
    /// The ends of the stack, from the linker. It grows down.
    static _stack_end: u32;
    static _stack_start: u32;
}

/// Lowest address above the guard.
fn floor() -> u32 {
    (addr_of!(_stack_end) as u32).next_multiple_of(GUARD) + GUARD
}

/// Makes an overflow of the stack a fault, so that no other data change: its bottom is read-only, or on Armv8-M its
/// pointer is limited.
pub fn guard() {
    #[cfg(feature = "armv8m")]
    // SAFETY: it is below the stack pointer.
    unsafe {
        cortex_m::register::msplim::write(floor());
    }
    #[cfg(not(feature = "armv8m"))]
    // SAFETY: the unit has no other user, and nothing but a stack that overflows writes to the guard.
    unsafe {
        let unit = &*MPU::PTR;
        // No memory protection unit in this chip.
        if unit._type.read() == 0 {
            return;
        }
        unit.rnr.write(0);
        unit.rbar.write(floor() - GUARD);
        unit.rasr.write(ATTRIBUTES);
        unit.ctrl.write(CONTROL);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// Whether a stack frame at `address` has overflowed the stack.
pub(crate) fn is_overflow(address: u32) -> bool {
    address < floor()
}

/// Addresses of the two calls that led to the panic handler that calls this: that of `panic_fmt` of `core`, often in
/// another function of `core`, and that of the function with this call. 0 where the stack holds none.
#[inline(always)]
pub(crate) fn callers() -> [u32; 2] {
    let handler: u32;
    // SAFETY: it reads a register. Code for Arm's Thumb state keeps frame pointers in r7.
    unsafe { core::arch::asm!("mov {}, r7", out(reg) handler, options(nomem, nostack)) };
    callers_of(handler)
}

/// The same of the handler with this frame. A frame holds the caller's frame and the return address.
#[inline(never)]
fn callers_of(handler: u32) -> [u32; 2] {
    let mut frame = handler;
    let mut returns = [0; 3];
    for address in &mut returns {
        if frame % 4 != 0 || frame < floor() || frame + 8 > addr_of!(_stack_start) as u32 {
            break;
        }
        // SAFETY: the two aligned words are in the stack.
        [frame, *address] = unsafe { (frame as *const [u32; 2]).read_volatile() };
    }
    let [_, callers @ ..] = returns;
    // A call takes four bytes, and bit 0 of a return address is set: the second half of the call.
    callers.map(|address| address.saturating_sub(3))
}

/// The stack above the guard: its size, and how much has been written to.
pub fn status() -> Option<StackStatus> {
    let (floor, top) = (floor(), addr_of!(_stack_start) as u32);
    let size = top.checked_sub(floor)?;
    let painted = (floor..top).step_by(4).take_while(|&address| {
        // SAFETY: the aligned address is in the stack.
        unsafe { (address as *const u32).read_volatile() == STACK_PAINT_VALUE }
    });
    let unused = 4 * painted.count() as u32;
    Some(StackStatus { size, used: size - unused })
}
