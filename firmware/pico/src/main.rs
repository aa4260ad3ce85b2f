//! wimu on a Raspberry Pi Pico or Pico 2 with an MPU-6050 or ADXL345: pins, clocks, interrupts and `start`. Everything
//! else is in `wimu-node`, `wimu-embassy` and `wimu-cortex-m`.

#![no_std]
#![no_main]

mod chip;
mod data_ready;
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
use embassy_rp::peripherals::{I2C0, UART0, WATCHDOG};
use embassy_rp::uart::{self, BufferedUart, BufferedUartRx};
use embassy_rp::watchdog::Watchdog;
use embassy_time::Duration;
use static_cell::StaticCell;
use wimu_embassy::BoardTimer;
use wimu_link::hello::{Capabilities, Part, board};
use wimu_node::{Board, FlashStore, TimeoutBus};

use crate::chip::StoreFlash;
use crate::data_ready::Line;
use crate::sender::Sender;

bind_interrupts!(struct Interrupts {
    I2C0_IRQ => i2c::InterruptHandler<I2C0>;
    UART0_IRQ => uart::BufferedInterruptHandler<UART0>;
    #[cfg(not(feature = "usb"))]
    UART1_IRQ => uart::BufferedInterruptHandler<embassy_rp::peripherals::UART1>;
    #[cfg(feature = "usb")]
    USBCTRL_IRQ => embassy_rp::usb::InterruptHandler<embassy_rp::peripherals::USB>;
});

type I2cBus = TimeoutBus<I2c<'static, I2C0, i2c::Async>, BoardTimer>;
#[cfg(feature = "adxl345")]
use wimu_node::{Adxl345 as Driver, wimu_adxl345::Address, wimu_adxl345::I2cBus as Bus};
#[cfg(not(feature = "adxl345"))]
use wimu_node::{Mpu6050 as Driver, wimu_mpu6050::Address, wimu_mpu6050::I2cBus as Bus};
type Sensor = Driver<Bus<I2cBus>, Line, BoardTimer>;

// The halves of the cable.
#[cfg(feature = "usb")]
type Receiver = wimu_embassy::PacketReader<'static>;
#[cfg(feature = "usb")]
type Transmitter = wimu_embassy::PacketWriter<'static>;
#[cfg(not(feature = "usb"))]
use {BufferedUartRx as Receiver, Sender as Transmitter};

/// The tasks of the node.
mod tasks {
    use super::Transmitter;
    use super::{BoardTimer, BufferedUartRx, FlashStore, Receiver, Sender, Sensor, StoreFlash};
    wimu_embassy::tasks! {
        sensor: Sensor,
        timer: BoardTimer,
        store: FlashStore<StoreFlash>,
        cable: (Receiver, Transmitter),
        wireless: (BufferedUartRx, Sender),
    }
}

wimu_cortex_m::board! {
    start: start,
    restart: restart,
    sampling: SWI_IRQ_1,
    timer: BoardTimer,
    watchdog: Watchdog, |watchdog| watchdog.feed(WATCHDOG_TIME), LIMITS,
    light: (Output<'static>, Input<'static>), lit: true,
}

/// The host of a USB cable can stop it.
#[cfg(feature = "usb")]
const LIMITS: [u64; 4] = wimu_embassy::without_limit([2]);
#[cfg(not(feature = "usb"))]
const LIMITS: [u64; 4] = wimu_embassy::LIMITS_US;
/// Timeout of the watchdog, longer than an erase of a sector of the flash.
const WATCHDOG_TIME: Duration = Duration::from_secs(2);
/// Longest erase of a sector (datasheet), ms.
const PAUSE_MS: u16 = 400;
/// Rate of the UARTs unless another one is stored for the wireless link, bit/s, 8N1.
const BAUD: u32 = 115_200;

/// A separate function, so that its stack frame is gone before the tasks run.
#[inline(never)]
fn start(spawner: Spawner) {
    static SHARED: tasks::Shared = tasks::Shared::new();
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
        uart.baudrate = BAUD;
        let (uart1, tx, rx) = (chip.UART1, chip.PIN_8, chip.PIN_9);
        sender::halves(
            BufferedUart::new(uart1, tx, rx, Interrupts, c, d, uart),
            interrupt::UART1_IRQ,
        )
    };
    #[cfg(feature = "usb")]
    let cable = usb::start(spawner, chip.USB, device_id);
    uart.baudrate = wimu_node::line_rate(&mut store).map_or(BAUD, sender::nearest_rate);
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
        sensor: Sensor::new(Bus { i2c, address: Address::Low }, line, BoardTimer),
        timer: BoardTimer,
        store,
        entropy,
        cable,
        wireless: sender::halves(wireless, interrupt::UART0_IRQ),
        nearest_rate: Some(sender::nearest_rate),
    };
    let node = tasks::place(board, &SHARED);
    watchdog.start(WATCHDOG_TIME);
    chip::set_priorities();
    let led = Output::new(chip.PIN_25, Level::Low);
    let key_lost = Input::new(chip.PIN_22, Pull::Up);
    tasks::spawn(node, SAMPLING.start(interrupt::SWI_IRQ_1), spawner);
    spawner.spawn(supervise(&SHARED, watchdog).unwrap());
    spawner.spawn(show(&SHARED, begun.is_safe_mode(), led, key_lost).unwrap());
}

/// The USB socket as the cable.
#[cfg(feature = "usb")]
mod usb {
    use embassy_rp::Peri;
    use embassy_rp::peripherals::USB;
    use embassy_rp::usb::Driver;
    use wimu_embassy::{PacketLink, UsbIdentity, UsbMemory};

    use super::{Interrupts, Receiver, Spawner, StaticCell, Transmitter};

    static CABLE: PacketLink = PacketLink::new();
    /// Those of a serial port in the Pico's own SDK.
    const NUMBERS: (u16, u16) = (0x2E8A, 0x000A);

    #[embassy_executor::task]
    async fn run(chip: Peri<'static, USB>, memory: &'static mut UsbMemory, device_id: u64) -> ! {
        let identity = UsbIdentity { numbers: NUMBERS, product: "Pico", device_id };
        wimu_embassy::run_usb(Driver::new(chip, Interrupts), memory, identity, &CABLE).await
    }

    pub fn start(
        spawner: Spawner,
        chip: Peri<'static, USB>,
        device_id: u64,
    ) -> (Receiver, Transmitter) {
        static MEMORY: StaticCell<UsbMemory> = StaticCell::new();
        // Spawned once.
        spawner.spawn(run(chip, MEMORY.init_with(Default::default), device_id).unwrap());
        CABLE.split()
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
