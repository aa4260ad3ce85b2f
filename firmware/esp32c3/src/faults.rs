//! The twin of `wimu-cortex-m`: the start record, the handlers of panics and exceptions, the stack.
//!
//! The HAL watches the lowest word of each stack and raises a breakpoint exception when it is written. The image is checked by
//! the bootloader.

use core::arch::asm;
use core::fmt::Write as _;
use core::panic::PanicInfo;
use core::ptr::addr_of;

use esp_hal::rtc_cntl::SocResetReason;
use esp_hal::system;
use wimu_embassy::{Start, StartRecord};
use wimu_link::hello::{Fault, Name, ResetReason};
use wimu_link::message::StackStatus;

/// The start record, in memory that only a loss of power clears.
// `used`: the compiler must not assume the initial value.
#[used]
#[unsafe(link_section = ".rtc_fast.persistent")]
pub static START: StartRecord = StartRecord::new();

/// What unused stack holds.
const PAINT: u32 = 0xCCCC_CCCC;
/// Stack below the pointer that is not painted: the frame of the function that paints, bytes.
const FRAME: u32 = 256;
/// Cause of an exception (RISC-V privileged architecture, table 3.6; of the ESP32-C3): breakpoint.
const BREAKPOINT: u32 = 3;

unsafe extern "C" {
    /// The watched word at the lower end of the stack, and the other end, from the linker. It grows down.
    static __stack_chk_guard: u32;
    static _stack_start: u32;
}

fn floor() -> u32 {
    addr_of!(__stack_chk_guard) as u32 + 4
}

/// Paints the stack and begins a start. Call it once, first of all.
pub fn begin() -> Start {
    let pointer: u32;
    // SAFETY: it reads a register.
    unsafe { asm!("mv {}, sp", out(reg) pointer, options(nomem, nostack)) };
    for address in (floor()..pointer - FRAME).step_by(4) {
        // SAFETY: the aligned word is in the stack, below all frames.
        unsafe { (address as *mut u32).write_volatile(PAINT) };
    }
    START.begin(reset_reason())
}

/// The main stack: its size, and how much has been written to.
pub fn stack() -> Option<StackStatus> {
    let (floor, top) = (floor(), addr_of!(_stack_start) as u32);
    let painted = (floor..top).step_by(4).take_while(|&address| {
        // SAFETY: the aligned address is in the stack.
        unsafe { (address as *const u32).read_volatile() == PAINT }
    });
    let size = top - floor;
    Some(StackStatus { size, used: size - 4 * painted.count() as u32 })
}

fn reset_reason() -> ResetReason {
    use SocResetReason as R;
    match system::reset_reason() {
        // Power-on and brown-out of the whole chip are not distinguished, nor is its pin.
        Some(R::ChipPowerOn) => ResetReason::PowerOn,
        Some(R::SysBrownOut) => ResetReason::BrownOut,
        Some(R::CoreSw | R::Cpu0Sw) => ResetReason::Software,
        Some(R::CoreMwdt0 | R::CoreMwdt1 | R::CoreRtcWdt | R::Cpu0Mwdt0 | R::Cpu0Mwdt1) => {
            ResetReason::Watchdog
        }
        Some(R::Cpu0RtcWdt | R::SysRtcWdt | R::SysSuperWdt) => ResetReason::Watchdog,
        // By the host, over USB.
        Some(R::CoreUsbUart | R::CoreUsbJtag) => ResetReason::Pin,
        _ => ResetReason::Unknown,
    }
}

/// Records the end of the file's name and the line, `main.rs:45`: this code has no frame pointers that lead to the caller.
#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    let (file, line) = info.location().map_or(("", 0), |place| (place.file(), place.line()));
    let mut kind = heapless::String::<15>::new();
    // Both fit: five digits at most.
    let _ = write!(kind, "{}:{line}", file.get(file.len().saturating_sub(9)..).unwrap_or_default());
    fail(Fault { address: 0, kind: Name::new(&kind) })
}

#[unsafe(no_mangle)]
extern "C" fn ExceptionHandler(_frame: *const ()) -> ! {
    let (cause, address): (u32, u32);
    // SAFETY: it reads registers.
    unsafe {
        asm!("csrr {}, mcause", "csrr {}, mepc", out(reg) cause, out(reg) address, options(nomem))
    };
    let kind = if cause & 0x1F == BREAKPOINT { "stack overflow" } else { "exception" };
    fail(Fault::processor(kind, address))
}

fn fail(fault: Fault) -> ! {
    critical_section::with(|_| START.record(&fault));
    system::software_reset()
}
