//! Where the firmware stopped, kept over the reset that follows: the next Hello tells.

use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr::{addr_of, addr_of_mut};

use cortex_m_rt::{ExceptionFrame, exception};
// Where the log goes: to the debug probe.
#[cfg(feature = "defmt")]
use defmt_rtt as _;
use wimu_link::hello::Fault;

/// Tells a note from what memory holds by chance.
const MAGIC: u32 = 0x5749_4d55;

/// In memory that nobody clears at a start.
#[derive(Clone, Copy)]
#[repr(C)]
struct Note {
    magic: u32,
    line: u32,
    /// The end of a file's name, zeros behind it.
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

/// What was noted before the last start, once.
pub fn take() -> Option<Fault> {
    // SAFETY: it is called before there are tasks, and the handlers below never return; any bits
    // are a note, and the check tells whether it is one of ours.
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

fn leave(fault: &Fault) -> ! {
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
    // SAFETY: interrupts are off for good, nobody else looks.
    unsafe { addr_of_mut!(NOTE).cast::<Note>().write_volatile(note) };
    crate::restart()
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    #[cfg(feature = "defmt")]
    defmt::error!("{}", defmt::Display2Format(info));
    let place = info.location();
    leave(&place.map_or(Fault::default(), |place| {
        Fault::panic(place.file(), place.line())
    }))
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    leave(&Fault::processor("hard fault", frame.pc()))
}
