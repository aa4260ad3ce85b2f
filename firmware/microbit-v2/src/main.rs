//! wimu on a BBC micro:bit v2: pins, clocks, interrupts and `start`. Everything else is in `wimu-node`, `wimu-embassy`,
//! `wimu-cortex-m` and `wimu-nrf`.

#![no_std]
#![no_main]

mod display;
mod flash;
#[cfg(feature = "full")]
mod wireless;
#[cfg(not(feature = "full"))]
mod wireless {
    pub use wimu_node::{NoLink as Receiver, NoLink as Sender};
    pub const NEAREST_RATE: Option<fn(u32) -> u32> = None;
}

use embassy_executor::Spawner;
use embassy_nrf::buffered_uarte::{self, BufferedUarte, BufferedUarteRx, BufferedUarteTx};
use embassy_nrf::gpio::{AnyPin, Input, Level, Pull};
use embassy_nrf::interrupt::{self, InterruptExt, Priority};
use embassy_nrf::nvmc::Nvmc;
#[cfg(feature = "full")]
use embassy_nrf::peripherals::UARTE1;
use embassy_nrf::peripherals::{TWISPI0, UARTE0};
use embassy_nrf::rng::Rng;
use embassy_nrf::wdt::WatchdogHandle;
use embassy_nrf::{Peri, bind_interrupts, twim, uarte};
use embassy_time::Duration;
// Where the log goes: to the debug probe.
#[cfg(feature = "defmt")]
use defmt_rtt as _;
use static_cell::StaticCell;
use wimu_link::hello::{Capabilities, Part, board};
use wimu_node::{Axis, Board, FifoSensor, FlashLayout, FlashStore, LINKS, Mounting};
use wimu_nrf::{BoardTimer, Line, SensorBus};
use wimu_sensors::Lsm303agr;

use crate::display::Matrix;
use crate::flash::StoreFlash;

bind_interrupts!(struct Interrupts {
    TWISPI0 => twim::InterruptHandler<TWISPI0>;
    UARTE0 => buffered_uarte::InterruptHandler<UARTE0>;
    #[cfg(feature = "full")]
    UARTE1 => buffered_uarte::InterruptHandler<UARTE1>;
});

type Sensor = FifoSensor<Lsm303agr<SensorBus>, Line, BoardTimer>;

wimu_cortex_m::board! {
    start: start,
    restart: cortex_m::peripheral::SCB::sys_reset,
    sampling: EGU1_SWI1,
    timer: BoardTimer,
    sensor: Sensor,
    store: FlashStore<StoreFlash>,
    cable: (BufferedUarteRx<'static>, BufferedUarteTx<'static>),
    wireless: (wireless::Receiver, wireless::Sender),
    watchdog: WatchdogHandle, |watchdog| watchdog.pet(), wimu_embassy::LIMITS_US,
}

/// The last 8 KiB of the flash, which memory.x excludes.
const LAYOUT: FlashLayout<StoreFlash> = FlashLayout::new(0x7E000..0x80000);
/// The board's axes (x to the logo, y to button A, z out of the display) in terms of the chip's, which is
/// left-handed and on the back.
const MOUNTING: Mounting = Mounting::new([Axis::MinusY, Axis::X, Axis::MinusZ]);
/// The longest erase of a page, ms: 22 steps of 5 ms, and 3 ms after each.
const PAUSE_MS: u16 = 200;
/// A separate function, so that its stack frame is gone before the tasks run.
#[inline(never)]
fn start(spawner: Spawner) {
    static BUFFERS: StaticCell<[[u8; 128]; 2 * LINKS]> = StaticCell::new();

    let begun = wimu_cortex_m::begin(wimu_nrf::reset_reason());
    let chip = embassy_nrf::init(wimu_nrf::config());
    embassy_time::block_for(Duration::from_millis(begun.delay_ms().into()));
    wimu_nrf::protect_flash();
    interrupt::TWISPI0.set_priority(Priority::P1);
    interrupt::EGU1_SWI1.set_priority(Priority::P3);
    interrupt::UARTE0.set_priority(Priority::P2);
    #[cfg(feature = "full")]
    interrupt::UARTE1.set_priority(Priority::P2);

    let fell = wimu_nrf::start_clock(chip.TIMER0);
    // The sensor's INT1 turns a transistor on that pulls the line down, against the pull-up in this chip. The magnetometer
    // and the interface chip can pull it down too.
    let (channel, pin, ppi) = (chip.GPIOTE_CH0, chip.P0_25, chip.PPI_CH0);
    let line = Line::new(channel, pin, Pull::Up, Level::Low, ppi, fell);
    let i2c = wimu_nrf::sensor_bus(chip.TWISPI0, Interrupts, chip.P0_16, chip.P0_08);
    let store = FlashStore::new(StoreFlash(Nvmc::new(chip.NVMC)), LAYOUT, PAUSE_MS);
    let [a, b, _wireless @ ..] = BUFFERS.init([[0; 128]; _]);
    let (timer, c, d, group) = (chip.TIMER1, chip.PPI_CH1, chip.PPI_CH2, chip.PPI_GROUP0);
    let (uart, rx, tx, config) = (chip.UARTE0, chip.P1_08, chip.P0_06, uarte::Config::default());
    let cable = BufferedUarte::new(uart, timer, c, d, group, rx, tx, Interrupts, config, a, b);
    #[cfg(not(feature = "full"))]
    let wireless = (wimu_node::NoLink, wimu_node::NoLink);
    #[cfg(feature = "full")]
    let mut store = store;
    #[cfg(feature = "full")]
    let wireless = {
        let [a, b] = _wireless;
        let (timer, c, d, group) = (chip.TIMER2, chip.PPI_CH3, chip.PPI_CH4, chip.PPI_GROUP1);
        let (uart, rx, tx, config) =
            (chip.UARTE1, chip.P0_03, chip.P0_02, wireless::config(&mut store));
        BufferedUarte::new(uart, timer, c, d, group, rx, tx, Interrupts, config, a, b).split()
    };
    let mut entropy = [0; 16];
    Rng::new_blocking(chip.RNG).blocking_fill_bytes(&mut entropy);
    let board = Board {
        hello: wimu_embassy::hello::<Sensor>(
            wimu_nrf::device_id(),
            env!("CARGO_PKG_VERSION"),
            &begun,
            Capabilities::DATA_READY.with(Capabilities::STORE),
            Part::new(board::MICROBIT_V2, "micro:bit v2"),
        ),
        sensor: Sensor::new(Lsm303agr::new(i2c).mounted(MOUNTING), line, BoardTimer),
        timer: BoardTimer,
        store,
        entropy,
        cable: cable.split(),
        wireless,
        nearest_rate: wireless::NEAREST_RATE,
    };

    macro_rules! pins {
        ($($pin:ident)*) => { [$(chip.$pin.into()),*] };
    }
    let matrix =
        Matrix::new(pins![P0_21 P0_22 P0_15 P0_24 P0_19], pins![P0_28 P0_11 P0_31 P1_05 P0_30]);
    // The board has its own pull-ups.
    let buttons = [chip.P0_14.into(), chip.P0_23.into()]
        .map(|pin: Peri<'_, AnyPin>| Input::new(pin, Pull::None));
    let above = SAMPLING.start(interrupt::EGU1_SWI1);
    let shared = tasks::launch(board, above, spawner, wimu_nrf::watchdog(chip.WDT));
    // Spawned once.
    spawner.spawn(display::attend(shared, begun.is_safe_mode(), matrix, buttons).unwrap());
}
