//! wimu on an ESP32-C3 with an MPU-6050: pins, clocks and `start`. The wireless link is Bluetooth Low Energy ([`nus`]), the
//! cable the chip's USB serial port. Everything else is in `wimu-node` and `wimu-embassy`.

#![no_std]
#![no_main]

mod bus;
#[path = "../../shared/edge_time.rs"]
mod edge_time;
mod faults;
#[path = "../../shared/nus.rs"]
mod nus;
mod radio;

use embassy_executor::Spawner;
use esp_hal::Async;
use esp_hal::clock::CpuClock;
use esp_hal::delay::Delay;
use esp_hal::gpio::{Input, InputConfig, Io, Level, Output, OutputConfig, Pull};
use esp_hal::i2c::master::{Config, I2c};
use esp_hal::interrupt::Priority;
use esp_hal::peripherals::{Peripherals, TIMG0};
use esp_hal::rng::{Trng, TrngSource};
use esp_hal::time::{Duration, Rate};
use esp_hal::timer::timg::{MwdtStage, TimerGroup, Wdt};
use esp_hal::usb::usb_serial_jtag::{UsbSerialJtag, UsbSerialJtagRx, UsbSerialJtagTx};
use esp_rtos::embassy::{Executor, InterruptExecutor};
use esp_storage::FlashStorage;
use static_cell::StaticCell;
use wimu_embassy::{BlockingFlash, BoardTimer, PacketLink, PacketReader, PacketWriter, Start};
use wimu_link::hello::{Capabilities, Part, board};
use wimu_node::{Board, FifoSensor, FlashLayout, FlashStore, TimeoutBus};
use wimu_sensors::{I2cBus, Mpu6050};

use crate::bus::Bus;
use crate::edge_time::Line;

// What the bootloader wants to know.
esp_bootloader_esp_idf::esp_app_desc!();

type Chip = Mpu6050<I2cBus<TimeoutBus<Bus, BoardTimer>>>;
type Sensor = FifoSensor<Chip, Line<Input<'static>>, BoardTimer>;
type StoreFlash = BlockingFlash<FlashStorage<'static>>;
type Watchdog = Wdt<TIMG0<'static>>;

wimu_embassy::board! {
    record: faults::START,
    stack: faults::stack,
    timer: BoardTimer,
    sensor: Sensor,
    store: FlashStore<StoreFlash>,
    cable: (UsbSerialJtagRx<'static, Async>, UsbSerialJtagTx<'static, Async>),
    wireless: (PacketReader<'static>, PacketWriter<'static>),
    watchdog: Watchdog, |watchdog| watchdog.feed(), wimu_embassy::without_limit([2, 3]),
    light: (Output<'static>, Input<'static>), lit: false,
}

/// Two sectors of the partition `nvs` of espflash's table, which nothing else uses.
const LAYOUT: FlashLayout<StoreFlash> = FlashLayout::new(0x9000..0xB000);
/// Longest erase of a sector of usual flash chips, ms.
const PAUSE_MS: u16 = 400;
/// Timeout of the watchdog, longer than an erase of a sector.
const WATCHDOG_TIME: Duration = Duration::from_secs(2);
/// Heap of the radio's driver, in memory that the bootloader leaves.
const HEAP_BYTES: usize = 64 << 10;

static WIRELESS: PacketLink = PacketLink::new();

#[esp_hal::main]
fn main() -> ! {
    static EXECUTOR: StaticCell<Executor> = StaticCell::new();
    let begun = faults::begin();
    let chip = esp_hal::init(esp_hal::Config::default().with_cpu_clock(CpuClock::max()));
    Delay::new().delay_millis(begun.delay_ms());
    EXECUTOR.init(Executor::new()).run(|spawner| start(spawner, chip, begun))
}

/// A separate function, so that its stack frame is gone before the tasks run.
#[inline(never)]
fn start(spawner: Spawner, chip: Peripherals, begun: Start) {
    static SAMPLING: StaticCell<InterruptExecutor<1>> = StaticCell::new();

    esp_alloc::heap_allocator!(#[esp_hal::ram(reclaimed)] size: HEAP_BYTES);
    let timers = TimerGroup::new(chip.TIMG0);
    esp_rtos::start(timers.timer0, chip.FROM_CPU_INTR0);
    let entropy = entropy(TrngSource::new(chip.RNG, chip.ADC1));
    let controller = radio::controller(chip.BT);
    let config = Config::default().with_frequency(Rate::from_khz(400));
    // It fails only for a frequency that the clock does not allow.
    let i2c = I2c::new(chip.I2C0, config).unwrap().with_sda(chip.GPIO6).with_scl(chip.GPIO7);
    let i2c = TimeoutBus::new(Bus(i2c.into_async()), BoardTimer);
    // The line's time is captured in this interrupt.
    Io::new(chip.IO_MUX).set_interrupt_priority(Priority::max());
    let line = Input::new(chip.GPIO5, InputConfig::default().with_pull(Pull::Down));
    let device_id = device_id();
    let board = Board {
        hello: wimu_embassy::hello::<Sensor>(
            device_id,
            env!("CARGO_PKG_VERSION"),
            &begun,
            Capabilities::DATA_READY.with(Capabilities::STORE),
            Part::new(board::ESP32C3, "ESP32-C3"),
        ),
        sensor: Sensor::new(
            Chip::new(I2cBus { i2c, address: Chip::ADDRESS }),
            Line(line),
            BoardTimer,
        ),
        timer: BoardTimer,
        store: FlashStore::new(BlockingFlash(FlashStorage::new(chip.FLASH)), LAYOUT, PAUSE_MS),
        entropy,
        cable: UsbSerialJtag::new(chip.USB_DEVICE).into_async().split(),
        wireless: WIRELESS.split(),
        nearest_rate: None,
    };
    let mut watchdog = timers.wdt;
    watchdog.set_timeout(MwdtStage::Stage0, WATCHDOG_TIME);
    watchdog.enable();
    let led = Output::new(chip.GPIO8, Level::High, OutputConfig::default());
    let boot = Input::new(chip.GPIO9, InputConfig::default().with_pull(Pull::Up));

    // Spawned once.
    spawner.spawn(nus::run(controller, device_id, &WIRELESS).unwrap());
    let sampling = SAMPLING.init(InterruptExecutor::new(chip.FROM_CPU_INTR1));
    tasks::launch(board, sampling.start(Priority::Priority3), spawner, watchdog, (led, boot));
}

/// Random bytes from the noise of the converter, which the radio's takes the place of later.
fn entropy(_source: TrngSource<'_>) -> [u8; 16] {
    let mut bytes = [0; 16];
    // It fails only without a source.
    Trng::try_new().unwrap().read(&mut bytes);
    bytes
}

/// The chip's number: its base MAC address.
fn device_id() -> u64 {
    let address = esp_hal::efuse::base_mac_address();
    address.as_bytes().iter().fold(0, |number, byte| number << 8 | u64::from(*byte))
}
