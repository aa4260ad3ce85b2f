//! wimu on an STM32F411 with an LSM6DSO: pins, clocks, interrupts and `main`. Everything else is in `wimu-node` and
//! `wimu-embassy`.

#![no_std]
#![no_main]

// Where the log goes: to the debug probe.
#[cfg(feature = "defmt")]
use defmt_rtt as _;
use embassy_executor::Spawner;
use embassy_stm32::exti::{self, ExtiInput};
use embassy_stm32::flash::{Bank1Region1, Blocking, Flash};
use embassy_stm32::gpio::{Input, Level, Output, Pull, Speed};
use embassy_stm32::i2c::{self, I2c, Master};
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::mode::Async;
use embassy_stm32::peripherals::{DMA1_CH0, DMA1_CH6, I2C1, IWDG, USART1, USART2};
use embassy_stm32::time::Hertz;
use embassy_stm32::usart::{self, BufferedUart, BufferedUartRx, BufferedUartTx};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{Config, bind_interrupts, dma, pac, rcc};
use embassy_time::Duration;
use static_cell::StaticCell;
use wimu_embassy::{BlockingFlash, BoardTimer};
use wimu_link::hello::{Capabilities, Part, ResetReason, board};
use wimu_node::wimu_lsm6dso::{Address, I2cBus};
use wimu_node::{Board, FlashLayout, FlashStore, Lsm6dso, TimeoutBus};

use crate::tasks::Shared;

bind_interrupts!(struct Interrupts {
    I2C1_EV => i2c::EventInterruptHandler<I2C1>;
    I2C1_ER => i2c::ErrorInterruptHandler<I2C1>;
    DMA1_STREAM0 => dma::InterruptHandler<DMA1_CH0>;
    DMA1_STREAM6 => dma::InterruptHandler<DMA1_CH6>;
    USART1 => usart::BufferedInterruptHandler<USART1>;
    USART2 => usart::BufferedInterruptHandler<USART2>;
    EXTI0 => exti::InterruptHandler<interrupt::typelevel::EXTI0>;
});

type Bus = I2cBus<TimeoutBus<I2c<'static, Async, Master>, BoardTimer>>;
type Sensor = Lsm6dso<Bus, ExtiInput<'static, Async>, BoardTimer>;
/// The flash's sectors of 16 KiB.
type StoreFlash = BlockingFlash<Bank1Region1<'static, Blocking>>;
type Memory = FlashStore<StoreFlash>;

/// The tasks of the node.
mod tasks {
    use super::{BoardTimer, BufferedUartRx, BufferedUartTx, Memory, Sensor};
    wimu_embassy::tasks! {
        sensor: Sensor,
        timer: BoardTimer,
        store: Memory,
        cable: (BufferedUartRx<'static>, BufferedUartTx<'static>),
        wireless: (BufferedUartRx<'static>, BufferedUartTx<'static>),
    }
}

wimu_cortex_m::board! {
    start: start,
    restart: cortex_m::peripheral::SCB::sys_reset,
    sampling: SPI5,
    timer: BoardTimer,
    watchdog: IndependentWatchdog<'static, IWDG>, |watchdog| watchdog.pet(), wimu_embassy::LIMITS_US,
    light: (Output<'static>, Input<'static>), lit: false,
}

/// Sectors 1 to 3, which memory.x excludes.
const LAYOUT: FlashLayout<StoreFlash> = FlashLayout::new(0x4000..0xC000);
/// Longest erase of a sector of 16 KiB (datasheet, table "Flash memory programming"), ms.
const PAUSE_MS: u16 = 800;
/// Timeout of the watchdog, longer than an erase of a sector, µs.
const WATCHDOG_US: u32 = 2_000_000;
/// Crystal of the board, Hz.
const CRYSTAL: Hertz = Hertz(25_000_000);

/// A separate function, so that its stack frame is gone before the tasks run.
#[inline(never)]
fn start(spawner: Spawner) {
    static SHARED: Shared = Shared::new();
    static BUFFERS: StaticCell<[[u8; 128]; 4]> = StaticCell::new();

    let begun = wimu_cortex_m::begin(reason());
    let chip = embassy_stm32::init(clocks());
    embassy_time::block_for(Duration::from_millis(begun.delay_ms().into()));

    let mut bus = i2c::Config::default();
    bus.frequency = Hertz(400_000);
    let i2c =
        I2c::new(chip.I2C1, chip.PB6, chip.PB7, chip.DMA1_CH6, chip.DMA1_CH0, Interrupts, bus);
    let i2c = TimeoutBus::new(i2c, BoardTimer);
    let address = Address::Low;
    let line = ExtiInput::new(chip.PB0, chip.EXTI0, Pull::Down, Interrupts);
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
            // Not DATA_READY: the time of a sample is that at which the task wakes.
            Capabilities::STORE,
            Part::new(board::STM32F411, "STM32F411"),
        ),
        sensor: Sensor::new(I2cBus { i2c, address }, line, BoardTimer),
        timer: BoardTimer,
        store: FlashStore::new(BlockingFlash(flash.bank1_region1), LAYOUT, PAUSE_MS),
        // The chip has no entropy source.
        entropy: [0; 16],
        cable,
        wireless,
        nearest_rate: None,
    };
    let shared = &SHARED;
    let node = tasks::place(board, shared);

    interrupt::EXTI0.set_priority(Priority::P1);
    interrupt::I2C1_EV.set_priority(Priority::P1);
    interrupt::I2C1_ER.set_priority(Priority::P1);
    interrupt::DMA1_STREAM0.set_priority(Priority::P1);
    interrupt::DMA1_STREAM6.set_priority(Priority::P1);
    interrupt::USART1.set_priority(Priority::P2);
    interrupt::USART2.set_priority(Priority::P2);
    interrupt::SPI5.set_priority(Priority::P3);
    tasks::spawn(node, SAMPLING.start(interrupt::SPI5), spawner);
    let mut watchdog = IndependentWatchdog::new(chip.IWDG, WATCHDOG_US);
    watchdog.unleash();
    let led = Output::new(chip.PC13, Level::High, Speed::Low);
    let key = Input::new(chip.PA0, Pull::Up);
    // Spawned once.
    spawner.spawn(supervise(shared, watchdog).unwrap());
    spawner.spawn(show(shared, begun.is_safe_mode(), led, key).unwrap());
}

/// 96 MHz from the crystal.
fn clocks() -> Config {
    let mut config = Config::default();
    config.rcc.hse = Some(rcc::Hse { freq: CRYSTAL, mode: rcc::HseMode::Oscillator });
    config.rcc.pll_src = rcc::PllSource::HSE;
    config.rcc.pll = Some(rcc::Pll {
        prediv: rcc::PllPreDiv::DIV25,
        mul: rcc::PllMul::MUL192,
        divp: Some(rcc::PllPDiv::DIV2),
        divq: None,
        divr: None,
    });
    config.rcc.sys = rcc::Sysclk::PLL1_P;
    // At most 50 MHz.
    config.rcc.apb1_pre = rcc::APBPrescaler::DIV2;
    config
}

/// The reset reason.
fn reason() -> ResetReason {
    let found = pac::RCC.csr().read();
    // The bits accumulate until they are cleared.
    pac::RCC.csr().modify(|flags| flags.set_rmvf(true));
    match found {
        _ if found.wdgrstf() => ResetReason::Watchdog,
        _ if found.sftrstf() => ResetReason::Software,
        _ if found.porrstf() => ResetReason::PowerOn,
        _ if found.borrstf() => ResetReason::BrownOut,
        // Set by every reset.
        _ if found.padrstf() => ResetReason::Pin,
        _ => ResetReason::Unknown,
    }
}
