//! A board to copy. The numbers are the steps of docs/reference/boards/porting.md.

#![no_std]
#![no_main]

mod hal;

use cortex_m_rt::entry;
// Where the log goes: to the debug probe.
#[cfg(feature = "defmt")]
use defmt_rtt as _;
use embassy_executor::{Executor, InterruptExecutor, Spawner};
use static_cell::StaticCell;
use wimu_cortex_m::{START, stack};
use wimu_embassy::{BlockingFlash, LIMITS_US};
use wimu_link::hello::{Capabilities, Part, ResetReason, sensor};
use wimu_model::DeviceTimeUs;
use wimu_node::wimu_adxl345::{Address, I2cBus};
use wimu_node::{Adxl345, Board, FlashLayout, FlashStore, TimeoutBus, Timer};

use crate::tasks::Shared;

// 3. The sensor: a driver of wimu-node on the HAL's bus, and its data-ready line.
type Bus = I2cBus<TimeoutBus<hal::I2c, BoardTimer>>;
type Sensor = Adxl345<Bus, hal::Pin, BoardTimer>;

// 4. The flash, or the HAL's region of it whose sectors have one size.
type StoreFlash = BlockingFlash<hal::Flash>;
type Memory = FlashStore<StoreFlash>;

/// The pages of the store, which memory.x excludes, bytes from the start of the flash (or of the region).
const LAYOUT: FlashLayout<StoreFlash> = FlashLayout::new(0x7C000..0x80000);
/// Longest erase of a page (datasheet), ms.
const PAUSE_MS: u16 = 100;
/// Cycles of the processor in a millisecond after the reset.
const CYCLES_A_MS: u32 = 16_000;

/// The tasks of the node.
mod tasks {
    use super::{BoardTimer, Memory, Sensor, hal};
    wimu_embassy::tasks! {
        sensor: Sensor,
        timer: BoardTimer,
        store: Memory,
        // 5. The halves of the UARTs.
        links: (hal::Uart, hal::Uart),
    }
}

// 6. The handlers of panics and faults.
wimu_cortex_m::fault_handlers!(restart);

/// Time since the start. 3. With a driver of embassy-time: `Instant::now()` and `Timer::at`, with `tick-hz-1_000_000`.
#[derive(Clone, Copy)]
pub struct BoardTimer;

impl Timer for BoardTimer {
    fn now(&self) -> DeviceTimeUs {
        DeviceTimeUs(hal::now_us())
    }

    async fn until(&self, _moment: DeviceTimeUs) {
        core::future::pending().await
    }
}

/// 7. Feeds the watchdog while the node works.
#[embassy_executor::task]
async fn supervise(shared: &'static Shared, mut watchdog: hal::Watchdog) -> ! {
    wimu_embassy::supervise(LIMITS_US, shared, &START, BoardTimer, stack::status, || {
        watchdog.feed();
    })
    .await
}

/// Runs the sampler above all tasks, below the interrupts of the bus and of the data-ready line.
static SAMPLING: InterruptExecutor = InterruptExecutor::new();

/// The handler of an interrupt that no peripheral uses; with a HAL, `#[cortex_m_rt::interrupt] unsafe fn NAME()`.
const SPARE: unsafe extern "C" fn() = {
    unsafe extern "C" fn handler() {
        // SAFETY: this is the executor's own interrupt.
        unsafe { SAMPLING.on_interrupt() };
    }
    handler
};

#[entry]
fn main() -> ! {
    static EXECUTOR: StaticCell<Executor> = StaticCell::new();
    EXECUTOR.init(Executor::new()).run(start)
}

/// A separate function, so that its stack frame is gone before the tasks run.
#[inline(never)]
fn start(spawner: Spawner) {
    static SHARED: Shared = Shared::new();
    let begun = wimu_cortex_m::begin(reason());
    // Here: the clocks and peripherals of the HAL, and their interrupts' priorities. Then, with the HAL's timer,
    // `embassy_time::block_for(Duration::from_millis(begun.delay_ms().into()))`.
    cortex_m::asm::delay(begun.delay_ms() * CYCLES_A_MS);
    let bus = TimeoutBus::new(hal::I2c, BoardTimer);
    let address = Address::Low;
    let board = Board {
        // 8. Who the board is, and what it can do.
        hello: wimu_embassy::hello(
            0, // the serial number of the chip
            env!("CARGO_PKG_VERSION"),
            &begun,
            Capabilities::ACCELEROMETER.with(Capabilities::STORE),
            Part::new(0, "my board"),
            Part::new(sensor::ADXL345, "ADXL345"),
        ),
        sensor: Sensor::new(I2cBus { i2c: bus, address }, hal::Pin, BoardTimer),
        timer: BoardTimer,
        store: FlashStore::new(BlockingFlash(hal::Flash), LAYOUT, PAUSE_MS),
        entropy: [0; 16], // from the chip's source of randomness, zeros without one
        cable: (hal::Uart, hal::Uart),
        wireless: (hal::Uart, hal::Uart),
        nearest_rate: None,
    };
    let node = tasks::place(board, &SHARED);
    tasks::spawn(node, SAMPLING.start(hal::SpareInterrupt), spawner);
    // Spawned once.
    spawner.spawn(supervise(&SHARED, hal::Watchdog).unwrap());
}

/// 6. Resets the chip.
fn restart() -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}

/// 6. Why the chip has started, from its register of reset flags. Clear the flags after reading.
fn reason() -> ResetReason {
    ResetReason::Unknown
}
