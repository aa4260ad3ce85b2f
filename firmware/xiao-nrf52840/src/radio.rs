//! The radio: Nordic's multiprotocol layer, which shares it with the flash, and the SoftDevice Controller on it.

use embassy_futures::select::{Either, select};
use embassy_nrf::mode::Blocking;
use embassy_nrf::rng::Rng;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use nrf_sdc::mpsl::{self, MultiprotocolServiceLayer, SessionMem, raw};
use nrf_sdc::{Builder, Mem, SoftdeviceController};
use static_cell::StaticCell;
use trouble_host::prelude::{DefaultPacketPool, PacketPool};

use crate::Interrupts;

/// Memory of the controller, bytes: more than one connection with [`PACKETS`] of the longest packets in each direction
/// needs. Too little would end the start with a panic.
const MEMORY: usize = 8 << 10;
/// Packets that wait in the controller, in each direction.
const PACKETS: u8 = 4;
/// Accuracy of the board's crystal of 32,768 Hz, ppm: 20 by its datasheet, with temperature.
const ACCURACY_PPM: u16 = 50;

pub type Layer = MultiprotocolServiceLayer<'static>;
pub type Controller = SoftdeviceController<'static>;
pub type ControllerError = nrf_sdc::Error;

/// What the layer takes of the chip.
macro_rules! layer_peripherals {
    ($chip:ident) => {
        nrf_sdc::mpsl::Peripherals::new(
            $chip.RTC0,
            $chip.TIMER0,
            $chip.TEMP,
            $chip.PPI_CH19,
            $chip.PPI_CH30,
            $chip.PPI_CH31,
        )
    };
}

/// What the controller takes of the chip.
macro_rules! controller_peripherals {
    ($chip:ident) => {
        nrf_sdc::Peripherals::new(
            $chip.PPI_CH17,
            $chip.PPI_CH18,
            $chip.PPI_CH20,
            $chip.PPI_CH21,
            $chip.PPI_CH22,
            $chip.PPI_CH23,
            $chip.PPI_CH24,
            $chip.PPI_CH25,
            $chip.PPI_CH26,
            $chip.PPI_CH27,
            $chip.PPI_CH28,
            $chip.PPI_CH29,
        )
    };
}
pub(crate) use {controller_peripherals, layer_peripherals};

/// The layer's task has to run it again.
static TURN: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// Starts the layer, with a session for the flash. Call it once.
pub fn layer(peripherals: mpsl::Peripherals<'static>) -> &'static Layer {
    static LAYER: StaticCell<Layer> = StaticCell::new();
    static SESSION: StaticCell<SessionMem<1>> = StaticCell::new();
    let clock = raw::mpsl_clock_lfclk_cfg_t {
        source: raw::MPSL_CLOCK_LF_SRC_XTAL as u8,
        // Of the other source.
        rc_ctiv: 0,
        rc_temp_ctiv: 0,
        accuracy_ppm: ACCURACY_PPM,
        skip_wait_lfclk_started: false,
    };
    let session = SESSION.init(SessionMem::new());
    let layer = Layer::with_timeslots(peripherals, Interrupts, clock, session);
    // It fails only with arguments that it does not know.
    LAYER.init(layer.unwrap())
}

/// Starts the controller: one connection to a host, with long packets. Call it once.
pub fn controller(
    layer: &'static Layer,
    peripherals: nrf_sdc::Peripherals<'static>,
    random: Rng<'static, Blocking>,
) -> Controller {
    static MEM: StaticCell<Mem<MEMORY>> = StaticCell::new();
    static RANDOM: StaticCell<Rng<'static, Blocking>> = StaticCell::new();
    let length = DefaultPacketPool::MTU as u16;
    let build = || {
        Builder::new()?
            .support_adv()
            .support_peripheral()
            .support_dle_peripheral()
            .support_phy_update_peripheral()
            .support_le_2m_phy()
            .peripheral_count(1)?
            .buffer_cfg(length, length, PACKETS, PACKETS)?
            .build(peripherals, RANDOM.init(random), layer, MEM.init(Mem::new()))
    };
    // It fails only if MEMORY is too small.
    build().unwrap()
}

/// Runs the layer, and keeps the crystal of the high-frequency clock on: the device's clock needs it.
#[embassy_executor::task]
pub async fn run(layer: &'static Layer) -> ! {
    let _crystal = layer.request_hfclk().await;
    loop {
        select(layer.run(), TURN.wait()).await;
    }
}

/// Runs the layer until `future` has ended, and nothing else meanwhile.
pub fn block_on<T>(layer: &'static Layer, future: impl Future<Output = T>) -> T {
    let outcome = embassy_futures::block_on(select(layer.run(), future));
    // The layer wakes whoever ran it last.
    TURN.signal(());
    match outcome {
        Either::First(never) => never,
        Either::Second(value) => value,
    }
}
