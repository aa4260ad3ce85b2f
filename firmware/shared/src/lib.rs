//! What the boards share that needs `unsafe`: the memory of the start record, the handlers of panics and faults, and
//! small memory routines.

#![no_std]

mod memory;

use wimu_embassy::StartRecord;

pub use {cortex_m, cortex_m_rt, wimu_embassy};

/// The start record, in memory that is not cleared at a start.
// `used`: the compiler must not assume the initial value.
#[used]
#[unsafe(link_section = ".uninit.WIMU_START")]
pub static START: StartRecord = StartRecord::new();

/// Defines the handlers of panics and processor faults. They record the place in [`START`] and call `$restart`, a
/// function `fn() -> !` that resets the chip. With the board's feature `defmt` a panic is also logged.
#[macro_export]
macro_rules! fault_handlers {
    ($restart:path) => {
        #[panic_handler]
        fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
            use $crate::wimu_embassy::wimu_link::hello::Fault;
            $crate::cortex_m::interrupt::disable();
            #[cfg(feature = "defmt")]
            defmt::error!("{}", defmt::Display2Format(info));
            let place = info.location();
            let fault = place.map_or(Fault::default(), |place| {
                Fault::panic(place.file(), place.line())
            });
            $crate::START.record(&fault);
            $restart()
        }

        #[$crate::cortex_m_rt::exception]
        unsafe fn HardFault(frame: &$crate::cortex_m_rt::ExceptionFrame) -> ! {
            use $crate::wimu_embassy::wimu_link::hello::Fault;
            $crate::cortex_m::interrupt::disable();
            $crate::START.record(&Fault::processor("hard fault", frame.pc()));
            $restart()
        }
    };
}
