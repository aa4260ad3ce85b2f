//! wimu on a Raspberry Pi Pico with an ADXL345: pins, clocks, interrupts and `main`. Everything
//! else is in `wimu-node`.

#![no_std]
#![no_main]

mod clock;
mod data_ready;
mod flash;
mod sender;

use cortex_m_rt::entry;
use embassy_executor::{Executor, InterruptExecutor, Spawner};
use embassy_rp::clocks::RoscRng;
use embassy_rp::gpio::{Input, Level, Output, Pull};
use embassy_rp::i2c::{self, I2c};
use embassy_rp::interrupt::{self, InterruptExt, Priority};
use embassy_rp::peripherals::{I2C0, UART0, UART1, WATCHDOG};
use embassy_rp::uart::{self, BufferedUart, BufferedUartRx};
use embassy_rp::watchdog::{ResetReason as WatchdogReason, Watchdog};
use embassy_rp::{bind_interrupts, pac};
use embassy_time::Duration;
// Where the log goes: to the debug probe.
#[cfg(feature = "defmt")]
use defmt_rtt as _;
use static_cell::StaticCell;
use wimu_cortex_m::{START, stack};
use wimu_embassy::LIMITS_US;
use wimu_link::hello::{Capabilities, Part, ResetReason, board, sensor};
use wimu_node::wimu_adxl345::{Address, I2cBus};
use wimu_node::{Adxl345, Board, FlashStore, TimeoutBus};

use crate::clock::BoardTimer;
use crate::data_ready::Line;
use crate::flash::StoreFlash;
use crate::sender::Sender;
use crate::tasks::Shared;

bind_interrupts!(struct Interrupts {
    I2C0_IRQ => i2c::InterruptHandler<I2C0>;
    UART0_IRQ => uart::BufferedInterruptHandler<UART0>;
    UART1_IRQ => uart::BufferedInterruptHandler<UART1>;
});

/// The types of the node.
type Bus = I2cBus<TimeoutBus<I2c<'static, I2C0, i2c::Async>, BoardTimer>>;
type Sensor = Adxl345<Bus, Line, BoardTimer>;
type Memory = FlashStore<StoreFlash>;

/// The tasks of the node.
mod tasks {
    use super::{BoardTimer, BufferedUartRx, Memory, Sender, Sensor};
    wimu_embassy::tasks! {
        sensor: Sensor,
        timer: BoardTimer,
        store: Memory,
        links: (BufferedUartRx, Sender),
    }
}

wimu_cortex_m::fault_handlers!(restart);

/// The rate of the UARTs unless another one is stored for the wireless link, bit/s, 8N1.
const BAUD: u32 = 115_200;

/// Timeout of the watchdog, longer than an erase of a sector of the flash.
const WATCHDOG_TIME: Duration = Duration::from_secs(2);
/// Longest erase of a sector (datasheet), ms.
const PAUSE_MS: u16 = 400;

/// Steps of 125 ms for which GP22 must be connected to ground to erase the key: 5 s.
const KEY_LOST_STEPS: u32 = 40;

/// Runs the sampler above all tasks, below the interrupts of the bus and of the data-ready line.
static SAMPLING: InterruptExecutor = InterruptExecutor::new();

#[cortex_m_rt::interrupt]
unsafe fn SWI_IRQ_1() {
    // SAFETY: this is the executor's own interrupt.
    unsafe { SAMPLING.on_interrupt() };
}

#[entry]
fn main() -> ! {
    static EXECUTOR: StaticCell<Executor> = StaticCell::new();
    EXECUTOR.init(Executor::new()).run(start)
}

/// A separate function, so that its stack frame is gone before the tasks run.
#[inline(never)]
fn start(spawner: Spawner) {
    static SHARED: Shared = Shared::new();
    static BUFFERS: StaticCell<[[u8; 128]; 4]> = StaticCell::new();

    let chip = embassy_rp::init(Default::default());
    let mut watchdog = Watchdog::new(chip.WATCHDOG);
    let begun = wimu_cortex_m::begin(reason(&watchdog));
    embassy_time::block_for(Duration::from_millis(begun.delay_ms().into()));
    let mut flash = chip.FLASH;
    let device_id = flash::chip_number(flash.reborrow());
    let mut bus = i2c::Config::default();
    bus.frequency = 400_000;
    let i2c = I2c::new_async(chip.I2C0, chip.PIN_5, chip.PIN_4, Interrupts, bus);
    let i2c = TimeoutBus::new(i2c, BoardTimer);
    let address = Address::Low;
    let line = Line(Input::new(chip.PIN_6, Pull::Down));
    let [a, b, c, d] = BUFFERS.init([[0; 128]; 4]);
    let mut store = FlashStore::new(StoreFlash::new(flash), flash::LAYOUT, PAUSE_MS);
    let mut uart = uart::Config::default();
    uart.baudrate = BAUD;
    let cable = BufferedUart::new(chip.UART1, chip.PIN_8, chip.PIN_9, Interrupts, c, d, uart);
    uart.baudrate = wimu_node::line_rate(&mut store).map_or(BAUD, nearest_rate);
    let wireless = BufferedUart::new(chip.UART0, chip.PIN_0, chip.PIN_1, Interrupts, a, b, uart);
    let (wireless_tx, wireless_rx) = wireless.split();
    let (cable_tx, cable_rx) = cable.split();
    let board = Board {
        hello: wimu_embassy::hello(
            device_id,
            env!("CARGO_PKG_VERSION"),
            &begun,
            Capabilities::ACCELEROMETER.with(Capabilities::DATA_READY).with(Capabilities::STORE),
            Part::new(board::PICO_ADXL345, "Pico"),
            Part::new(sensor::ADXL345, "ADXL345"),
        ),
        sensor: Sensor::new(I2cBus { i2c, address }, line, BoardTimer),
        timer: BoardTimer,
        store,
        entropy: entropy(),
        cable: (cable_rx, Sender { uart: cable_tx, interrupt: interrupt::UART1_IRQ }),
        wireless: (wireless_rx, Sender { uart: wireless_tx, interrupt: interrupt::UART0_IRQ }),
        nearest_rate: Some(nearest_rate),
    };
    let shared = &SHARED;
    let node = tasks::place(board, shared);
    watchdog.start(WATCHDOG_TIME);

    interrupt::IO_IRQ_BANK0.set_priority(Priority::P0);
    interrupt::I2C0_IRQ.set_priority(Priority::P1);
    interrupt::TIMER_IRQ_0.set_priority(Priority::P1);
    interrupt::SWI_IRQ_1.set_priority(Priority::P2);
    interrupt::UART0_IRQ.set_priority(Priority::P2);
    interrupt::UART1_IRQ.set_priority(Priority::P2);
    let sampling = SAMPLING.start(interrupt::SWI_IRQ_1);
    let led = Output::new(chip.PIN_25, Level::Low);
    let key_lost = Input::new(chip.PIN_22, Pull::Up);
    tasks::spawn(node, sampling, spawner);
    spawner.spawn(supervise(shared, watchdog).unwrap());
    spawner.spawn(show(shared, begun.is_safe_mode(), led, key_lost).unwrap());
}

/// Feeds the watchdog while the node works.
#[embassy_executor::task]
async fn supervise(shared: &'static Shared, mut watchdog: Watchdog) -> ! {
    wimu_embassy::supervise(LIMITS_US, shared, &START, BoardTimer, stack::status, || {
        watchdog.feed(WATCHDOG_TIME);
    })
    .await
}

/// Shows the device's state with the LED and polls the pin.
#[embassy_executor::task]
async fn show(
    shared: &'static Shared,
    is_safe_mode: bool,
    mut led: Output<'static>,
    key_lost: Input<'static>,
) -> ! {
    let mut before = shared.health();
    let mut step = 0_u32;
    // A pin that has been low since the start is ignored.
    let mut released = false;
    let mut held = 0;
    loop {
        released |= key_lost.is_high();
        let is_held = released && key_lost.is_low();
        held = if is_held { held + 1 } else { 0 };
        if held == KEY_LOST_STEPS {
            shared.forget_key();
        }
        let now = shared.health();
        // One bit per step of 125 ms, lowest first: LED on.
        let pattern: u8 = if now.sensor_lost {
            0b0101_0101
        } else if is_safe_mode {
            0b0001_0101
        } else if now.shed != before.shed {
            0b0000_0101
        } else if now.calibrated {
            0b1111_1110
        } else {
            0b0000_1111
        };
        led.set_level((pattern >> (step % 8) & 1 != 0).into());
        step = step.wrapping_add(1);
        if step.is_multiple_of(8) {
            before = now;
        }
        embassy_time::Timer::after_millis(125).await;
    }
}

/// Resets the chip.
fn restart() -> ! {
    // SAFETY: the callers do not use the watchdog again.
    Watchdog::new(unsafe { WATCHDOG::steal() }).trigger_reset();
    loop {
        cortex_m::asm::nop();
    }
}

/// The fractional divisor of a UART supports every rate between the usual limits.
fn nearest_rate(baud: u32) -> u32 {
    baud.clamp(1200, 921_600)
}

/// The reset reason.
fn reason(watchdog: &Watchdog) -> ResetReason {
    let chip = pac::VREG_AND_CHIP_RESET.chip_reset().read();
    match watchdog.reset_reason() {
        Some(WatchdogReason::TimedOut) => ResetReason::Watchdog,
        Some(WatchdogReason::Forced) => ResetReason::Software,
        None if chip.had_run() => ResetReason::Pin,
        // Power-on and brown-out resets are not distinguished.
        None if chip.had_por() => ResetReason::PowerOn,
        None => ResetReason::Unknown,
    }
}

/// From the ring oscillator, which is not a qualified cryptographic source: should it fail, the boot count makes
/// sessions differ.
fn entropy() -> [u8; 16] {
    let mut bits = [0; 16];
    RoscRng.fill_bytes(&mut bits);
    bits
}
