//! wimu on a Raspberry Pi Pico with an ADXL345: pins, clocks, interrupts and a main. Everything
//! else is `wimu-node`.

#![no_std]
#![no_main]

mod clock;
mod data_ready;
mod flash;
mod store;

use cortex_m_rt::entry;
use embassy_executor::{Executor, InterruptExecutor};
use embassy_rp::gpio::{Input, Pull};
use embassy_rp::i2c::{self, I2c};
use embassy_rp::interrupt::{self, InterruptExt, Priority};
use embassy_rp::peripherals::{I2C0, UART0, UART1};
use embassy_rp::uart::{self, BufferedUart, BufferedUartRx, BufferedUartTx};
use embassy_rp::bind_interrupts;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex as M;
use static_cell::StaticCell;
use wimu_link::hello::{Capabilities, Part, ResetReason, board, sensor};
use wimu_link::{Hello, LinkRole};
use wimu_node::{Adxl345, Board, Control, LinkReader, LinkWriter, Sampler, Shared};

use crate::clock::BoardTimer;
use crate::data_ready::Line;
use crate::flash::StoreFlash;
use crate::store::FlashStore;

bind_interrupts!(struct Interrupts {
    I2C0_IRQ => i2c::InterruptHandler<I2C0>;
    UART0_IRQ => uart::BufferedInterruptHandler<UART0>;
    UART1_IRQ => uart::BufferedInterruptHandler<UART1>;
});

type Sensor = Adxl345<I2c<'static, I2C0, i2c::Async>, Line, BoardTimer>;

#[embassy_executor::task]
async fn sample(sampler: Sampler<'static, Sensor, BoardTimer, M>) -> ! {
    sampler.run().await
}

#[embassy_executor::task]
async fn control(control: Control<'static, Sensor, BoardTimer, FlashStore, M>) -> ! {
    control.run().await
}

#[embassy_executor::task(pool_size = 2)]
async fn listen(reader: LinkReader<'static, BufferedUartRx, BoardTimer, M>) -> ! {
    reader.run().await
}

#[embassy_executor::task(pool_size = 2)]
async fn talk(writer: LinkWriter<'static, BufferedUartTx, M>) -> ! {
    writer.run().await
}

/// Above all tasks but below the interrupts of the bus and of the data-ready line.
static SAMPLING: InterruptExecutor = InterruptExecutor::new();

#[cortex_m_rt::interrupt]
unsafe fn SWI_IRQ_1() {
    // SAFETY: it is the executor's own interrupt.
    unsafe { SAMPLING.on_interrupt() };
}



#[entry]
fn main() -> ! {
    static EXECUTOR: StaticCell<Executor> = StaticCell::new();
    static SHARED: StaticCell<Shared<M>> = StaticCell::new();
    static BUFFERS: StaticCell<[[u8; 128]; 4]> = StaticCell::new();

    let chip = embassy_rp::init(Default::default());
    let mut bus = i2c::Config::default();
    bus.frequency = 400_000;
    let i2c = I2c::new_async(chip.I2C0, chip.PIN_5, chip.PIN_4, Interrupts, bus);
    let line = Line(Input::new(chip.PIN_6, Pull::Down));
    let [a, b, c, d] = BUFFERS.init([[0; 128]; 4]);
    // 115,200 baud, 8N1.
    let uart = uart::Config::default;
    let wireless = BufferedUart::new(chip.UART0, chip.PIN_0, chip.PIN_1, Interrupts, a, b, uart());
    let cable = BufferedUart::new(chip.UART1, chip.PIN_8, chip.PIN_9, Interrupts, c, d, uart());
    let (wireless_tx, wireless_rx) = wireless.split();
    let (cable_tx, cable_rx) = cable.split();
    let board = Board {
        hello: hello(),
        accelerometer: Sensor::new(i2c, line, BoardTimer),
        timer: BoardTimer,
        store: FlashStore::new(StoreFlash::new(chip.FLASH)),
        cable: (cable_rx, cable_tx),
        wireless: (wireless_rx, wireless_tx),
    };
    let node = board.split(SHARED.init(Shared::new()));

    interrupt::IO_IRQ_BANK0.set_priority(Priority::P0);
    interrupt::I2C0_IRQ.set_priority(Priority::P1);
    interrupt::TIMER_IRQ_0.set_priority(Priority::P1);
    interrupt::SWI_IRQ_1.set_priority(Priority::P2);
    interrupt::UART0_IRQ.set_priority(Priority::P2);
    interrupt::UART1_IRQ.set_priority(Priority::P2);
    let sampling = SAMPLING.start(interrupt::SWI_IRQ_1);
    sampling.spawn(sample(node.sampler).unwrap());
    EXECUTOR.init(Executor::new()).run(|spawner| {
        // Each is spawned once: there is room.
        spawner.spawn(control(node.control).unwrap());
        spawner.spawn(listen(node.cable_reader).unwrap());
        spawner.spawn(talk(node.cable_writer).unwrap());
        spawner.spawn(listen(node.wireless_reader).unwrap());
        spawner.spawn(talk(node.wireless_writer).unwrap());
    })
}

fn hello() -> Hello {
    let part = |text: &str| text.parse().unwrap_or(0);
    Hello {
        device_id: 0,
        firmware: [
            part(env!("CARGO_PKG_VERSION_MAJOR")),
            part(env!("CARGO_PKG_VERSION_MINOR")),
            part(env!("CARGO_PKG_VERSION_PATCH")),
        ],
        reset_reason: ResetReason::PowerOn,
        capabilities: Capabilities::ACCELEROMETER
            .with(Capabilities::DATA_READY)
            .with(Capabilities::STORE),
        sensitivity_known: true,
        board: Part::new(board::PICO_ADXL345, "Pico"),
        sensor: Part::new(sensor::ADXL345, "ADXL345"),
        ..Hello::new(LinkRole::Cable)
    }
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! { loop {} }
