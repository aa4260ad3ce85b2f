//! wimu on a Nordic nRF52840 DK with an LSM6DSO on wires: pins, clocks, interrupts and `main`. The wireless link is
//! Bluetooth Low Energy ([`nus`]). Everything else is in `wimu-node`, `wimu-embassy` and `wimu-nrf`.

#![no_std]
#![no_main]

mod flash;
mod nus;
mod radio;

use cortex_m_rt::entry;
use embassy_executor::{Executor, InterruptExecutor, Spawner};
use embassy_nrf::buffered_uarte::{self, BufferedUarte, BufferedUarteRx, BufferedUarteTx};
use embassy_nrf::config::{Config, HfclkSource, LfclkSource};
use embassy_nrf::gpio::{Input, Level, Output, OutputDrive, Pull};
use embassy_nrf::interrupt::{self, InterruptExt, Priority};
use embassy_nrf::peripherals::{TWISPI0, UARTE0};
use embassy_nrf::rng::Rng;
use embassy_nrf::twim::{self, Twim};
use embassy_nrf::wdt::{self, Watchdog, WatchdogHandle};
use embassy_nrf::{bind_interrupts, uarte};
use embassy_time::Duration;
use nrf_sdc::mpsl;
// Where the log goes: to the debug probe.
#[cfg(feature = "defmt")]
use defmt_rtt as _;
use static_cell::StaticCell;
use wimu_cortex_m::{START, stack};
use wimu_embassy::{LIMITS_US, PacketLink, PacketReader, PacketWriter};
use wimu_link::hello::{Capabilities, Part, board, sensor};
use wimu_node::wimu_lsm6dso::{Address, I2cBus};
use wimu_node::{Board, FlashLayout, FlashStore, Lsm6dso, TimeoutBus};
use wimu_nrf::{BoardTimer, Bus, Line};

use crate::flash::StoreFlash;
use crate::tasks::Shared;

bind_interrupts!(struct Interrupts {
    TWISPI0 => twim::InterruptHandler<TWISPI0>;
    UARTE0 => buffered_uarte::InterruptHandler<UARTE0>;
    EGU0_SWI0 => mpsl::LowPrioInterruptHandler;
    CLOCK_POWER => mpsl::ClockInterruptHandler;
    RADIO => mpsl::HighPrioInterruptHandler;
    TIMER0 => mpsl::HighPrioInterruptHandler;
    RTC0 => mpsl::HighPrioInterruptHandler;
});

/// The types of the node.
type Sensor = Lsm6dso<I2cBus<TimeoutBus<Bus, BoardTimer>>, Line, BoardTimer>;
type Memory = FlashStore<StoreFlash>;

/// The tasks of the node.
mod tasks {
    use super::Sensor;
    use super::{BoardTimer, BufferedUarteRx, BufferedUarteTx, Memory, PacketReader, PacketWriter};
    wimu_embassy::tasks! {
        sensor: Sensor,
        timer: BoardTimer,
        store: Memory,
        links: (BufferedUarteRx<'static>, BufferedUarteTx<'static>),
        wireless: (PacketReader<'static>, PacketWriter<'static>),
    }
}

wimu_cortex_m::fault_handlers!(restart);

/// The last 16 KiB of the flash, which memory.x excludes.
const LAYOUT: FlashLayout<StoreFlash> = FlashLayout::new(0xFC000..0x10_0000);
/// The longest erase of a page, ms: nine steps of 10 ms, each after up to 30 ms of radio, and as much reserve.
const PAUSE_MS: u16 = 720;
/// Timeout of the watchdog: 2 s of 32,768 Hz.
const WATCHDOG_TICKS: u32 = 65_536;
/// The wireless link has no limit: its host can stop it.
const LIMITS: [u64; 4] = [LIMITS_US[0], LIMITS_US[1], LIMITS_US[2], u64::MAX];

/// Between the node and the radio.
static WIRELESS: PacketLink = PacketLink::new();

/// Feeds the watchdog while the node works.
#[embassy_executor::task]
async fn supervise(shared: &'static Shared, mut watchdog: WatchdogHandle) -> ! {
    wimu_embassy::supervise(LIMITS, shared, &START, BoardTimer, stack::status, || {
        watchdog.pet();
    })
    .await
}

/// Shows the device's state with LED 1 and polls button 1.
#[embassy_executor::task]
async fn show(
    shared: &'static Shared,
    is_safe_mode: bool,
    mut led: Output<'static>,
    button: Input<'static>,
) -> ! {
    // Lit while low.
    let light = |on: bool| led.set_level((!on).into());
    wimu_embassy::attend(shared, is_safe_mode, BoardTimer, light, || button.is_low()).await
}

/// Runs the sampler above all tasks, below the interrupts of the bus and of the data-ready line.
static SAMPLING: InterruptExecutor = InterruptExecutor::new();

#[cortex_m_rt::interrupt]
unsafe fn EGU1_SWI1() {
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
    static BUFFERS: StaticCell<[[u8; 256]; 2]> = StaticCell::new();
    static BUS_BUFFER: StaticCell<[u8; 16]> = StaticCell::new();

    let begun = wimu_cortex_m::begin(wimu_nrf::reset_reason());
    let chip = embassy_nrf::init(clocks());
    embassy_time::block_for(Duration::from_millis(begun.delay_ms().into()));
    wimu_nrf::protect_flash();
    // 0 is the radio's.
    interrupt::TWISPI0.set_priority(Priority::P1);
    interrupt::UARTE0.set_priority(Priority::P2);
    interrupt::EGU1_SWI1.set_priority(Priority::P3);

    // TIMER0 is the radio's.
    let rose = wimu_nrf::start_clock(chip.TIMER1);
    let (channel, pin, ppi) = (chip.GPIOTE_CH0, chip.P1_03, chip.PPI_CH0);
    let line = Line::new(channel, pin, Pull::Down, Level::High, ppi, rose);
    let mut bus = twim::Config::default();
    bus.frequency = twim::Frequency::K400;
    let (sda, scl) = (chip.P0_26, chip.P0_27);
    let buffer = BUS_BUFFER.init([0; 16]);
    let i2c = Twim::new(chip.TWISPI0, Interrupts, sda, scl, bus, buffer);
    // The default is 115,200 bits/s, 8N1.
    let uart = uarte::Config::default();
    let [a, b] = BUFFERS.init([[0; 256]; 2]);
    let cable = BufferedUarte::new(
        chip.UARTE0,
        chip.TIMER2,
        chip.PPI_CH1,
        chip.PPI_CH2,
        chip.PPI_GROUP0,
        chip.P0_08,
        chip.P0_06,
        Interrupts,
        uart,
        a,
        b,
    );
    let mut random = Rng::new_blocking(chip.RNG);
    let mut entropy = [0; 16];
    random.blocking_fill_bytes(&mut entropy);
    let mpsl = radio::layer(radio::layer_peripherals!(chip));
    let controller = radio::controller(mpsl, radio::controller_peripherals!(chip), random);

    let i2c = TimeoutBus::new(Bus(i2c), BoardTimer);
    let address = Address::Low;
    let board = Board {
        hello: wimu_embassy::hello(
            wimu_nrf::device_id(),
            env!("CARGO_PKG_VERSION"),
            &begun,
            Capabilities::ACCELEROMETER
                .with(Capabilities::GYROSCOPE)
                .with(Capabilities::TEMPERATURE)
                .with(Capabilities::DATA_READY)
                .with(Capabilities::STORE),
            Part::new(board::NRF52840_BLE, "nRF52840 BLE"),
            Part::new(sensor::LSM6DSO, "LSM6DSO"),
        ),
        sensor: Sensor::new(I2cBus { i2c, address }, line, BoardTimer),
        timer: BoardTimer,
        store: FlashStore::new(StoreFlash::new(mpsl, chip.NVMC), LAYOUT, PAUSE_MS),
        entropy,
        cable: cable.split(),
        wireless: WIRELESS.split(),
        nearest_rate: None,
    };
    let shared = &SHARED;
    let node = tasks::place(board, shared);
    let mut feeding = wdt::Config::default();
    feeding.timeout_ticks = WATCHDOG_TICKS;
    feeding.action_during_debug_halt = wdt::HaltConfig::Pause;
    // It is not running yet: a reset stops it.
    let Ok((_, [watchdog])) = Watchdog::try_new(chip.WDT, feeding) else { panic!() };
    let led = Output::new(chip.P0_13, Level::High, OutputDrive::Standard);
    let button = Input::new(chip.P0_11, Pull::Up);

    // Each is spawned once. The layer runs before anything that waits for it: the clock's crystal, the flash.
    spawner.spawn(radio::run(mpsl).unwrap());
    spawner.spawn(nus::run(controller, wimu_nrf::device_id(), &WIRELESS).unwrap());
    tasks::spawn(node, SAMPLING.start(interrupt::EGU1_SWI1), spawner);
    spawner.spawn(supervise(shared, watchdog).unwrap());
    spawner.spawn(show(shared, begun.is_safe_mode(), led, button).unwrap());
}

/// Both clocks from the board's crystals, all interrupts below the radio's.
fn clocks() -> Config {
    let mut config = Config::default();
    config.hfclk_source = HfclkSource::ExternalXtal;
    config.lfclk_source = LfclkSource::ExternalXtal;
    config.gpiote_interrupt_priority = Priority::P1;
    config.time_interrupt_priority = Priority::P2;
    config
}

/// Resets the chip.
fn restart() -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}
