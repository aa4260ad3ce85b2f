//! Record of a panic or fault, kept over the reset that follows and reported in the next Hello.

use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr::{addr_of, addr_of_mut};

use cortex_m_rt::{ExceptionFrame, exception};
// Where the log goes: to the debug probe.
#[cfg(feature = "defmt")]
use defmt_rtt as _;
use wimu_link::hello::Fault;

/// Marks a valid note in uninitialised memory.
const MAGIC: u32 = 0x5749_4d55;

/// The record, in memory that is not cleared at a start.
#[derive(Clone, Copy)]
#[repr(C)]
struct Note {
    magic: u32,
    line: u32,
    /// The end of the file's name, padded with zeros.
    file: [u8; 15],
    length: u8,
    check: u32,
}

#[unsafe(link_section = ".uninit.LAST_WORDS")]
static mut NOTE: MaybeUninit<Note> = MaybeUninit::uninit();

fn check(note: &Note) -> u32 {
    let bytes = note.file.iter().chain([&note.length]);
    bytes.fold(note.magic ^ note.line, |sum, &byte| {
        sum.rotate_left(5) ^ u32::from(byte)
    })
}

/// Returns the record from before the last start, and clears it.
pub fn take() -> Option<Fault> {
    // SAFETY: called before tasks run, and the handlers below never return. Any bits are a valid `Note`; the
    // check sum decides whether it was written.
    let note = unsafe {
        let note = addr_of!(NOTE).cast::<Note>().read_volatile();
        addr_of_mut!(NOTE).cast::<u32>().write_volatile(0);
        note
    };
    if note.magic != MAGIC || note.check != check(&note) {
        return None;
    }
    let file = note.file.get(..usize::from(note.length))?;
    Some(Fault::panic(file, note.line))
}

fn record_and_restart(fault: &Fault) -> ! {
    cortex_m::interrupt::disable();
    let mut note = Note {
        magic: MAGIC,
        line: fault.line,
        file: [0; 15],
        length: 0,
        check: 0,
    };
    for (place, byte) in note.file.iter_mut().zip(fault.file.as_bytes()) {
        *place = *byte;
        note.length += 1;
    }
    note.check = check(&note);
    // SAFETY: interrupts stay disabled, so there is no other access.
    unsafe { addr_of_mut!(NOTE).cast::<Note>().write_volatile(note) };
    crate::restart()
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    #[cfg(feature = "defmt")]
    defmt::error!("{}", defmt::Display2Format(info));
    let place = info.location();
    record_and_restart(&place.map_or(Fault::default(), |place| {
        Fault::panic(place.file(), place.line())
    }))
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    record_and_restart(&Fault::processor("hard fault", frame.pc()))
}
