//! wimu on a Seeed XIAO nRF52840 Sense: pins, clocks, interrupts and `start`. The sensor is the board's LSM6DS3TR-C, the
//! wireless link Bluetooth Low Energy ([`nus`]), the cable the USB socket. Everything else is in `wimu-node`,
//! `wimu-embassy`, `wimu-cortex-m` and `wimu-nrf`.

#![no_std]
#![no_main]

mod flash;
#[path = "../../shared/nus.rs"]
mod nus;
mod radio;

// Where the log goes: to the debug probe.
#[cfg(feature = "defmt")]
use defmt_rtt as _;
use embassy_executor::Spawner;
use embassy_nrf::config::LfclkSource;
use embassy_nrf::gpio::{Input, Level, Output, OutputDrive, Pull};
use embassy_nrf::interrupt::{self, InterruptExt, Priority};
use embassy_nrf::peripherals::{TWISPI0, USBD};
use embassy_nrf::rng::Rng;

use embassy_nrf::usb::vbus_detect::{self, HardwareVbusDetect};
use embassy_nrf::wdt::WatchdogHandle;
use embassy_nrf::{bind_interrupts, twim, usb};
use embassy_time::Duration;
use nrf_sdc::mpsl;
use wimu_embassy::{PacketLink, PacketReader, PacketWriter};
use wimu_link::hello::{Capabilities, Part, board};
use wimu_node::{Board, FifoSensor, FlashLayout, FlashStore};
use wimu_nrf::{BoardTimer, Line, SensorBus};
use wimu_sensors::{I2cBus, Lsm6ds3trC};

use crate::flash::StoreFlash;

bind_interrupts!(struct Interrupts {
    TWISPI0 => twim::InterruptHandler<TWISPI0>;
    USBD => usb::InterruptHandler<USBD>;
    EGU0_SWI0 => mpsl::LowPrioInterruptHandler;
    CLOCK_POWER => mpsl::ClockInterruptHandler, vbus_detect::InterruptHandler;
    RADIO => mpsl::HighPrioInterruptHandler;
    TIMER0 => mpsl::HighPrioInterruptHandler;
    RTC0 => mpsl::HighPrioInterruptHandler;
});

type UsbDriver = usb::Driver<'static, HardwareVbusDetect>;
type Chip = Lsm6ds3trC<I2cBus<SensorBus>>;
type Sensor = FifoSensor<Chip, Line, BoardTimer>;

wimu_cortex_m::board! {
    start: start,
    restart: cortex_m::peripheral::SCB::sys_reset,
    sampling: EGU1_SWI1,
    timer: BoardTimer,
    sensor: Sensor,
    store: FlashStore<StoreFlash>,
    cable: (cable::Reader, cable::Writer),
    wireless: (PacketReader<'static>, PacketWriter<'static>),
    watchdog: WatchdogHandle, |watchdog| watchdog.pet(), wimu_embassy::without_limit([2, 3]),
    light: (Output<'static>, Input<'static>), lit: false,
}

// The numbers are those of Seeed's own firmware for this board.
wimu_embassy::usb_cable!(UsbDriver, (0x2886, 0x8045), "XIAO nRF52840 Sense");

/// The 8 KiB below the bootloader, which memory.x excludes.
const LAYOUT: FlashLayout<StoreFlash> = FlashLayout::new(0xF2000..0xF4000);
/// The longest erase of a page, ms: nine steps of 10 ms, each after up to 30 ms of radio, and as much reserve.
const PAUSE_MS: u16 = 720;
/// From power of the sensor until it answers, ms: 15 by its datasheet, with reserve.
const SENSOR_START_MS: u64 = 25;
static WIRELESS: PacketLink = PacketLink::new();

/// A separate function, so that its stack frame is gone before the tasks run.
#[inline(never)]
fn start(spawner: Spawner) {
    let mut config = wimu_nrf::config();
    config.lfclk_source = LfclkSource::ExternalXtal;
    let begun = wimu_cortex_m::begin(wimu_nrf::reset_reason());
    let chip = embassy_nrf::init(config);
    // The sensor, its pull-ups and the microphone are fed by this pin.
    let power = Output::new(chip.P1_08, Level::High, OutputDrive::HighDrive);
    core::mem::forget(power);
    let delay_ms = u64::from(begun.delay_ms()).max(SENSOR_START_MS);
    embassy_time::block_for(Duration::from_millis(delay_ms));
    wimu_nrf::protect_flash();
    // 0 is the radio's.
    interrupt::TWISPI0.set_priority(Priority::P1);
    interrupt::USBD.set_priority(Priority::P2);
    interrupt::EGU1_SWI1.set_priority(Priority::P3);

    // TIMER0 is the radio's.
    let rose = wimu_nrf::start_clock(chip.TIMER1);
    let (channel, pin, ppi) = (chip.GPIOTE_CH0, chip.P0_11, chip.PPI_CH0);
    let line = Line::new(channel, pin, Pull::Down, Level::High, ppi, rose);
    let i2c = wimu_nrf::sensor_bus(chip.TWISPI0, Interrupts, chip.P0_07, chip.P0_27);
    let mut random = Rng::new_blocking(chip.RNG);
    let mut entropy = [0; 16];
    random.blocking_fill_bytes(&mut entropy);
    let mpsl = radio::layer(radio::layer_peripherals!(chip));
    // Each task is spawned once. The layer runs before what waits for it: the clock's crystal, the flash.
    spawner.spawn(radio::run(mpsl).unwrap());
    let controller = radio::controller(mpsl, radio::controller_peripherals!(chip), random);
    let usb = UsbDriver::new(chip.USBD, Interrupts, HardwareVbusDetect::new(Interrupts));
    let cable = cable::start(spawner, usb, wimu_nrf::device_id());
    let board = Board {
        hello: wimu_embassy::hello::<Sensor>(
            wimu_nrf::device_id(),
            env!("CARGO_PKG_VERSION"),
            &begun,
            Capabilities::DATA_READY.with(Capabilities::STORE),
            Part::new(board::XIAO_NRF52840, "XIAO nRF52840"),
        ),
        sensor: Sensor::new(Chip::new(I2cBus { i2c, address: Chip::ADDRESS }), line, BoardTimer),
        timer: BoardTimer,
        store: FlashStore::new(StoreFlash::new(mpsl, chip.NVMC), LAYOUT, PAUSE_MS),
        entropy,
        cable,
        wireless: WIRELESS.split(),
        nearest_rate: None,
    };
    let led = Output::new(chip.P0_26, Level::High, OutputDrive::Standard);
    let light = (led, Input::new(chip.P0_02, Pull::Up));
    spawner.spawn(nus::run(controller, wimu_nrf::device_id(), &WIRELESS).unwrap());
    let above = SAMPLING.start(interrupt::EGU1_SWI1);
    tasks::launch(board, above, spawner, wimu_nrf::watchdog(chip.WDT), light);
}
