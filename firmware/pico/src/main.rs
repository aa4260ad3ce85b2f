//! wimu on a Raspberry Pi Pico or Pico 2 with an MPU-6050 or ADXL345: pins, clocks, interrupts and `start`. Everything
//! else is in `wimu-node`, `wimu-embassy` and `wimu-cortex-m`.

#![no_std]
#![no_main]

mod chip;
#[path = "../../shared/edge_time.rs"]
mod edge_time;
mod sender;

// Where the log goes: to the debug probe.
#[cfg(feature = "defmt")]
use defmt_rtt as _;
use embassy_executor::Spawner;
use embassy_rp::bind_interrupts;
use embassy_rp::clocks::RoscRng;
use embassy_rp::gpio::{Input, Level, Output, Pull};
use embassy_rp::i2c::{self, I2c};
use embassy_rp::interrupt;
use embassy_rp::peripherals::{I2C0, UART0};
use embassy_rp::uart::{self, BufferedUart, BufferedUartRx};
use embassy_rp::watchdog::Watchdog;
use embassy_time::Duration;
use static_cell::StaticCell;
use wimu_embassy::BoardTimer;
use wimu_link::hello::{Capabilities, Part, board};
use wimu_node::{Board, FifoSensor, FlashStore, TimeoutBus};
use wimu_sensors::I2cBus;

use crate::chip::StoreFlash;
use crate::edge_time::Line;
use crate::sender::Sender;

bind_interrupts!(struct Interrupts {
    I2C0_IRQ => i2c::InterruptHandler<I2C0>;
    UART0_IRQ => uart::BufferedInterruptHandler<UART0>;
    #[cfg(not(feature = "usb"))]
    UART1_IRQ => uart::BufferedInterruptHandler<embassy_rp::peripherals::UART1>;
    #[cfg(feature = "usb")]
    USBCTRL_IRQ => embassy_rp::usb::InterruptHandler<USB>;
});

type Bus = TimeoutBus<I2c<'static, I2C0, i2c::Async>, BoardTimer>;
#[cfg(feature = "adxl345")]
type Chip = wimu_sensors::Adxl345<I2cBus<Bus>>;
#[cfg(not(feature = "adxl345"))]
type Chip = wimu_sensors::Mpu6050<I2cBus<Bus>>;
type Sensor = FifoSensor<Chip, Line<Input<'static>>, BoardTimer>;

wimu_cortex_m::board! {
    start: start,
    restart: chip::restart,
    sampling: SWI_IRQ_1,
    timer: BoardTimer,
    sensor: Sensor,
    store: FlashStore<StoreFlash>,
    cable: (cable::Reader, cable::Writer),
    wireless: (BufferedUartRx, Sender),
    watchdog: Watchdog, |watchdog| watchdog.feed(WATCHDOG_TIME), LIMITS,
    light: (Output<'static>, Input<'static>), lit: true,
}

#[cfg(feature = "usb")]
use embassy_rp::{peripherals::USB, usb::Driver as UsbDriver};
// The numbers are those of a serial port in the Pico's own SDK.
#[cfg(feature = "usb")]
wimu_embassy::usb_cable!(UsbDriver<'static, USB>, (0x2E8A, 0x000A), "Pico");
#[cfg(not(feature = "usb"))]
mod cable {
    pub use {crate::sender::Sender as Writer, embassy_rp::uart::BufferedUartRx as Reader};
}

/// The host of a USB cable can stop it.
const LIMITS: [u64; 4] =
    if cfg!(feature = "usb") { wimu_embassy::without_limit([2]) } else { wimu_embassy::LIMITS_US };
/// Timeout of the watchdog, longer than an erase of a sector of the flash.
const WATCHDOG_TIME: Duration = Duration::from_secs(2);
/// Longest erase of a sector (datasheet), ms.
const PAUSE_MS: u16 = 400;

/// A separate function, so that its stack frame is gone before the tasks run.
#[inline(never)]
fn start(spawner: Spawner) {
    static BUFFERS: StaticCell<[[u8; 128]; 4]> = StaticCell::new();

    let chip = embassy_rp::init(Default::default());
    let mut watchdog = Watchdog::new(chip.WATCHDOG);
    let begun = wimu_cortex_m::begin(chip::reset_reason(&watchdog));
    embassy_time::block_for(Duration::from_millis(begun.delay_ms().into()));
    let (flash, device_id) = chip::flash(chip.FLASH);
    let mut bus = i2c::Config::default();
    bus.frequency = 400_000;
    let i2c = I2c::new_async(chip.I2C0, chip.PIN_5, chip.PIN_4, Interrupts, bus);
    let i2c = TimeoutBus::new(i2c, BoardTimer);
    let line = Line(Input::new(chip.PIN_6, Pull::Down));
    let mut store = FlashStore::new(flash, chip::LAYOUT, PAUSE_MS);
    let [a, b, _cable @ ..] = BUFFERS.init([[0; 128]; 4]);
    let mut uart = uart::Config::default();
    #[cfg(not(feature = "usb"))]
    let cable = {
        let [c, d] = _cable;
        let (uart1, tx, rx) = (chip.UART1, chip.PIN_8, chip.PIN_9);
        let cable = BufferedUart::new(uart1, tx, rx, Interrupts, c, d, uart);
        sender::halves(cable, interrupt::UART1_IRQ)
    };
    #[cfg(feature = "usb")]
    let cable = cable::start(spawner, UsbDriver::new(chip.USB, Interrupts), device_id);
    // 115,200 bits/s, 8N1, unless another rate is stored.
    if let Some(baud) = wimu_node::line_rate(&mut store) {
        uart.baudrate = sender::nearest_rate(baud);
    }
    let (uart0, tx, rx) = (chip.UART0, chip.PIN_0, chip.PIN_1);
    let wireless = BufferedUart::new(uart0, tx, rx, Interrupts, a, b, uart);
    // Not a qualified cryptographic source: should it fail, the boot count makes sessions differ.
    let mut entropy = [0; 16];
    RoscRng.fill_bytes(&mut entropy);
    let board = Board {
        hello: wimu_embassy::hello::<Sensor>(
            device_id,
            env!("CARGO_PKG_VERSION"),
            &begun,
            Capabilities::DATA_READY.with(Capabilities::STORE),
            Part::new(board::PICO, if cfg!(feature = "pico2") { "Pico 2" } else { "Pico" }),
        ),
        sensor: Sensor::new(Chip::new(I2cBus { i2c, address: Chip::ADDRESS }), line, BoardTimer),
        timer: BoardTimer,
        store,
        entropy,
        cable,
        wireless: sender::halves(wireless, interrupt::UART0_IRQ),
        nearest_rate: Some(sender::nearest_rate),
    };
    watchdog.start(WATCHDOG_TIME);
    chip::set_priorities();
    let light = (Output::new(chip.PIN_25, Level::Low), Input::new(chip.PIN_22, Pull::Up));
    tasks::launch(board, SAMPLING.start(interrupt::SWI_IRQ_1), spawner, watchdog, light);
}
