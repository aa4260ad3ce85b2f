//! wimu on an STM32F411 with an LSM6DSO: pins, interrupts and `start`; clocks and priorities are in `chip`. Everything else
//! is in `wimu-node`, `wimu-embassy` and `wimu-cortex-m`.

#![no_std]
#![no_main]

mod chip;
#[path = "../../shared/edge_time.rs"]
mod edge_time;

// Where the log goes: to the debug probe.
#[cfg(feature = "defmt")]
use defmt_rtt as _;
use embassy_executor::Spawner;
use embassy_stm32::exti::{self, ExtiInput};
use embassy_stm32::flash::{Bank1Region1, Blocking, Flash};
use embassy_stm32::gpio::{Input, Level, Output, Pull, Speed};
use embassy_stm32::i2c::{self, I2c, Master};
use embassy_stm32::interrupt;
use embassy_stm32::mode::Async;
use embassy_stm32::peripherals::{DMA1_CH0, DMA1_CH6, I2C1, IWDG, USART1, USART2};
use embassy_stm32::time::Hertz;
use embassy_stm32::usart::{self, BufferedUart, BufferedUartRx, BufferedUartTx};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{bind_interrupts, dma};
use embassy_time::Duration;
use static_cell::StaticCell;
use wimu_embassy::{BlockingFlash, BoardTimer};
use wimu_link::hello::{Capabilities, Part, board};
use wimu_node::{Board, FifoSensor, FlashLayout, FlashStore, TimeoutBus};
use wimu_sensors::{I2cBus, Lsm6dso};

use crate::edge_time::Line;

bind_interrupts!(struct Interrupts {
    I2C1_EV => i2c::EventInterruptHandler<I2C1>;
    I2C1_ER => i2c::ErrorInterruptHandler<I2C1>;
    DMA1_STREAM0 => dma::InterruptHandler<DMA1_CH0>;
    DMA1_STREAM6 => dma::InterruptHandler<DMA1_CH6>;
    USART1 => usart::BufferedInterruptHandler<USART1>;
    USART2 => usart::BufferedInterruptHandler<USART2>;
    EXTI0 => exti::InterruptHandler<interrupt::typelevel::EXTI0>;
});

type Chip = Lsm6dso<I2cBus<TimeoutBus<I2c<'static, Async, Master>, BoardTimer>>>;
type Sensor = FifoSensor<Chip, Line<ExtiInput<'static, Async>>, BoardTimer>;
/// The flash's sectors of 16 KiB.
type StoreFlash = BlockingFlash<Bank1Region1<'static, Blocking>>;

wimu_cortex_m::board! {
    start: start,
    restart: cortex_m::peripheral::SCB::sys_reset,
    sampling: SPI5,
    timer: BoardTimer,
    sensor: Sensor,
    store: FlashStore<StoreFlash>,
    cable: (BufferedUartRx<'static>, BufferedUartTx<'static>),
    wireless: (BufferedUartRx<'static>, BufferedUartTx<'static>),
    watchdog: IndependentWatchdog<'static, IWDG>, |watchdog| watchdog.pet(), wimu_embassy::LIMITS_US,
    light: (Output<'static>, Input<'static>), lit: false,
}

/// Sectors 1 to 3, which memory.x excludes.
const LAYOUT: FlashLayout<StoreFlash> = FlashLayout::new(0x4000..0xC000);
/// Longest erase of a sector of 16 KiB (datasheet, table "Flash memory programming"), ms.
const PAUSE_MS: u16 = 800;
/// Timeout of the watchdog, longer than an erase of a sector, µs.
const WATCHDOG_US: u32 = 2_000_000;

/// A separate function, so that its stack frame is gone before the tasks run.
#[inline(never)]
fn start(spawner: Spawner) {
    static BUFFERS: StaticCell<[[u8; 128]; 4]> = StaticCell::new();

    let begun = wimu_cortex_m::begin(chip::reset_reason());
    let chip = embassy_stm32::init(chip::clocks());
    embassy_time::block_for(Duration::from_millis(begun.delay_ms().into()));

    let mut bus = i2c::Config::default();
    bus.frequency = Hertz(400_000);
    // Its own time-out may wait without yielding.
    bus.timeout = Duration::from_millis(20);
    let i2c =
        I2c::new(chip.I2C1, chip.PB6, chip.PB7, chip.DMA1_CH6, chip.DMA1_CH0, Interrupts, bus);
    let i2c = TimeoutBus::new(i2c, BoardTimer);
    let line = Line(ExtiInput::new(chip.PB0, chip.EXTI0, Pull::Down, Interrupts));
    // The default is 115,200 bits/s, 8N1.
    let uart = usart::Config::default;
    let [a, b, c, d] = BUFFERS.init([[0; 128]; 4]);
    let cable = BufferedUart::new(chip.USART1, chip.PA10, chip.PA9, a, b, Interrupts, uart());
    let wireless = BufferedUart::new(chip.USART2, chip.PA3, chip.PA2, c, d, Interrupts, uart());
    // The rate is one that the clock allows.
    let [cable, wireless] = [cable, wireless].map(|uart| {
        let (sender, receiver) = uart.unwrap().split();
        (receiver, sender)
    });
    let flash = Flash::new_blocking(chip.FLASH).into_blocking_regions();
    let [a, b, c, d, e, f, g, h, ..] = embassy_stm32::uid::uid();
    let board = Board {
        hello: wimu_embassy::hello::<Sensor>(
            u64::from_le_bytes([a, b, c, d, e, f, g, h]),
            env!("CARGO_PKG_VERSION"),
            &begun,
            Capabilities::DATA_READY.with(Capabilities::STORE),
            Part::new(board::STM32F411, "STM32F411"),
        ),
        sensor: Sensor::new(Chip::new(I2cBus { i2c, address: Chip::ADDRESS }), line, BoardTimer),
        timer: BoardTimer,
        store: FlashStore::new(BlockingFlash(flash.bank1_region1), LAYOUT, PAUSE_MS),
        // The chip has no entropy source.
        entropy: [0; 16],
        cable,
        wireless,
        nearest_rate: None,
    };
    chip::set_priorities();
    let mut watchdog = IndependentWatchdog::new(chip.IWDG, WATCHDOG_US);
    watchdog.unleash();
    let led = Output::new(chip.PC13, Level::High, Speed::Low);
    let light = (led, Input::new(chip.PA0, Pull::Up));
    tasks::launch(board, SAMPLING.start(interrupt::SPI5), spawner, watchdog, light);
}
