//! wimu on a BBC micro:bit v2: pins, clocks, interrupts and `main`. Everything else is in `wimu-node`.

#![no_std]
#![no_main]

mod display;
mod flash;
#[cfg(feature = "full")]
mod rate;

use embassy_executor::Spawner;
use embassy_nrf::buffered_uarte::{self, BufferedUarte, BufferedUarteRx, BufferedUarteTx};
use embassy_nrf::config::{Config, HfclkSource};
use embassy_nrf::gpio::{AnyPin, Input, Level, Output, OutputDrive, Pull};
use embassy_nrf::interrupt::{self, InterruptExt, Priority};
use embassy_nrf::nvmc::Nvmc;
#[cfg(feature = "full")]
use embassy_nrf::peripherals::UARTE1;
use embassy_nrf::peripherals::{TWISPI0, UARTE0};
use embassy_nrf::rng::Rng;
use embassy_nrf::twim::{self, Twim};
use embassy_nrf::wdt::WatchdogHandle;
use embassy_nrf::{Peri, bind_interrupts, uarte};
use embassy_time::Duration;
// Where the log goes: to the debug probe.
#[cfg(feature = "defmt")]
use defmt_rtt as _;
use static_cell::StaticCell;
use wimu_link::hello::{Capabilities, Part, board};
use wimu_node::{
    Axis, Board, FlashLayout, FlashStore, LINKS, Lsm303agr, Mounting, TimeoutBus, Timer,
};
use wimu_nrf::{BoardTimer, Bus, Line};

use crate::display::Matrix;
use crate::flash::StoreFlash;
use crate::tasks::Shared;

bind_interrupts!(struct Interrupts {
    TWISPI0 => twim::InterruptHandler<TWISPI0>;
    UARTE0 => buffered_uarte::InterruptHandler<UARTE0>;
    #[cfg(feature = "full")]
    UARTE1 => buffered_uarte::InterruptHandler<UARTE1>;
});

/// The types of the node.
type Sensor = Lsm303agr<TimeoutBus<Bus, BoardTimer>, Line, BoardTimer>;
type Memory = FlashStore<StoreFlash>;

// The halves of the wireless link.
#[cfg(feature = "full")]
type Receiver = BufferedUarteRx<'static>;
#[cfg(feature = "full")]
type Sender = BufferedUarteTx<'static>;
#[cfg(not(feature = "full"))]
use wimu_node::{NoLink as Receiver, NoLink as Sender};

/// The tasks of the node.
mod tasks {
    use super::{BoardTimer, BufferedUarteRx, BufferedUarteTx, Memory, Receiver, Sender, Sensor};
    wimu_embassy::tasks! {
        sensor: Sensor,
        timer: BoardTimer,
        store: Memory,
        cable: (BufferedUarteRx<'static>, BufferedUarteTx<'static>),
        wireless: (Receiver, Sender),
    }
}

wimu_cortex_m::board! {
    start: start,
    restart: cortex_m::peripheral::SCB::sys_reset,
    sampling: EGU1_SWI1,
    timer: BoardTimer,
    watchdog: WatchdogHandle, |watchdog| watchdog.pet(), wimu_embassy::LIMITS_US,
}

/// The last 16 KiB of the flash, which memory.x excludes.
const LAYOUT: FlashLayout<StoreFlash> = FlashLayout::new(0x7C000..0x80000);
/// The board's axes (x to the logo, y to button A, z out of the display) in terms of the chip's, which is
/// left-handed and on the back.
const MOUNTING: Mounting = Mounting::new([Axis::MinusY, Axis::X, Axis::MinusZ]);
/// The longest erase of a page, ms: 22 steps of 5 ms, and 3 ms after each.
const PAUSE_MS: u16 = 200;
/// Time for which a row of the display is lit, µs.
const ROW_US: u64 = 3_000;
/// Rows of the display in a second.
const ROWS_A_SECOND: u32 = 333;
/// Consecutive rows for which a button must be down.
const DEBOUNCE: u32 = 10;

/// Rows of the display for which button B must be held to erase the key: 5 s.
const KEY_LOST_ROWS: u32 = 5 * ROWS_A_SECOND;

/// Shows the device's state and polls the buttons.
#[embassy_executor::task]
async fn attend(
    shared: &'static Shared,
    is_safe_mode: bool,
    mut matrix: Matrix,
    button_a: Input<'static>,
    button_b: Input<'static>,
) -> ! {
    let mut before = shared.health();
    let mut picture = display::picture(&before, &before, is_safe_mode);
    let mut pressed = 0;
    // A button that has been down since the start is ignored.
    let mut released = false;
    let mut held = 0;
    let mut marks = 0_u16;
    for tick in (0..ROWS_A_SECOND).cycle() {
        if tick == 0 {
            let now = shared.health();
            picture = display::picture(&before, &now, is_safe_mode);
            before = now;
        }
        pressed = if button_a.is_low() { pressed + 1 } else { 0 };
        if pressed == DEBOUNCE {
            marks = marks.wrapping_add(1);
            shared.mark(BoardTimer.now(), marks);
            picture = display::MARKED;
        }
        released |= button_b.is_high();
        let is_held = released && button_b.is_low();
        held = if is_held { held + 1 } else { 0 };
        if held == KEY_LOST_ROWS {
            shared.forget_key();
            picture = display::MARKED;
        }
        matrix.show(picture, tick as usize % 5);
        BoardTimer.after_us(ROW_US).await;
    }
    core::future::pending().await
}

/// A separate function, so that its stack frame is gone before the tasks run.
#[inline(never)]
fn start(spawner: Spawner) {
    static SHARED: Shared = Shared::new();
    static BUFFERS: StaticCell<[[u8; 128]; 2 * LINKS]> = StaticCell::new();
    static BUS_BUFFER: StaticCell<[u8; 16]> = StaticCell::new();

    let begun = wimu_cortex_m::begin(wimu_nrf::reset_reason());
    let mut config = Config::default();
    // The device's clock needs the crystal.
    config.hfclk_source = HfclkSource::ExternalXtal;
    config.gpiote_interrupt_priority = Priority::P1;
    config.time_interrupt_priority = Priority::P2;
    let chip = embassy_nrf::init(config);
    embassy_time::block_for(Duration::from_millis(begun.delay_ms().into()));
    wimu_nrf::protect_flash();
    interrupt::TWISPI0.set_priority(Priority::P1);
    interrupt::EGU1_SWI1.set_priority(Priority::P3);
    interrupt::UARTE0.set_priority(Priority::P2);
    interrupt::UARTE1.set_priority(Priority::P2);

    let fell = wimu_nrf::start_clock(chip.TIMER0);
    // The sensor's INT1 turns a transistor on that pulls the line down, against the pull-up in this chip. The magnetometer
    // and the interface chip can pull it down too.
    let (channel, pin, ppi) = (chip.GPIOTE_CH0, chip.P0_25, chip.PPI_CH0);
    let line = Line::new(channel, pin, Pull::Up, Level::Low, ppi, fell);
    let mut bus = twim::Config::default();
    bus.frequency = twim::Frequency::K400;
    let i2c =
        Twim::new(chip.TWISPI0, Interrupts, chip.P0_16, chip.P0_08, bus, BUS_BUFFER.init([0; 16]));
    let mut store = FlashStore::new(StoreFlash(Nvmc::new(chip.NVMC)), LAYOUT, PAUSE_MS);
    let [a, b, _wireless @ ..] = BUFFERS.init([[0; 128]; _]);
    let cable = BufferedUarte::new(
        chip.UARTE0,
        chip.TIMER1,
        chip.PPI_CH1,
        chip.PPI_CH2,
        chip.PPI_GROUP0,
        chip.P1_08,
        chip.P0_06,
        Interrupts,
        uarte::Config::default(),
        a,
        b,
    );
    #[cfg(not(feature = "full"))]
    let wireless = (wimu_node::NoLink, wimu_node::NoLink);
    #[cfg(feature = "full")]
    let wireless = {
        let [c, d] = _wireless;
        let mut uart = uarte::Config::default();
        if let Some(baud) = wimu_node::line_rate(&mut store) {
            uart.baudrate = rate::setting(baud).1;
        }
        BufferedUarte::new(
            chip.UARTE1,
            chip.TIMER2,
            chip.PPI_CH3,
            chip.PPI_CH4,
            chip.PPI_GROUP1,
            chip.P0_03,
            chip.P0_02,
            Interrupts,
            uart,
            c,
            d,
        )
        .split()
    };
    let shared = &SHARED;
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
        sensor: Sensor::new(TimeoutBus::new(Bus(i2c), BoardTimer), line, BoardTimer)
            .mounted(MOUNTING),
        timer: BoardTimer,
        store,
        entropy,
        cable: cable.split(),
        wireless,
        #[cfg(feature = "full")]
        nearest_rate: Some(rate::nearest),
        #[cfg(not(feature = "full"))]
        nearest_rate: None,
    };
    let node = tasks::place(board, shared);

    let led = |pin: Peri<'static, AnyPin>| Output::new(pin, Level::Low, OutputDrive::Standard);
    let matrix = Matrix {
        rows: [
            chip.P0_21.into(),
            chip.P0_22.into(),
            chip.P0_15.into(),
            chip.P0_24.into(),
            chip.P0_19.into(),
        ]
        .map(led),
        columns: [
            chip.P0_28.into(),
            chip.P0_11.into(),
            chip.P0_31.into(),
            chip.P1_05.into(),
            chip.P0_30.into(),
        ]
        .map(led),
    };
    // The board has its own pull-ups.
    let button_a = Input::new(chip.P0_14, Pull::None);
    let button_b = Input::new(chip.P0_23, Pull::None);
    let watchdog = wimu_nrf::watchdog(chip.WDT);
    let sampling = SAMPLING.start(interrupt::EGU1_SWI1);
    tasks::spawn(node, sampling, spawner);
    // Spawned once.
    spawner.spawn(supervise(shared, watchdog).unwrap());
    spawner.spawn(attend(shared, begun.is_safe_mode(), matrix, button_a, button_b).unwrap());
}
