//! The node's tasks and `main`, for the sensor that the image's root names: `Sensor`, made by `sensor`, `PART`
//! and `QUANTITIES`.

use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m_rt::entry;
use embassy_executor::raw::Executor;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::mutex::Mutex;
use static_cell::StaticCell;
use wimu_link::hello::{Capabilities, Part, ResetReason, board};
use wimu_link::{Hello, LinkRole};
use wimu_node::{
    Board, Control, FlashStore, InertialSensor, LinkReader, LinkWriter, Sampler, Shared,
};

use crate::bridge::{Bridge, BridgeI2c};
use crate::clock::BoardTimer;
use crate::data_ready::DataReady;
use crate::lockstep::Lockstep;
use crate::store::{self, Flash};
use crate::uart::{CABLE, LOG, Reader, SENSOR_BUS, WIRELESS, Writer};
use crate::{PART, QUANTITIES, Sensor, clock, interrupts, log, semihosting, sensor};

type M = NoopRawMutex;
type Sample = <Sensor as InertialSensor>::Sample;
type Node = wimu_node::Node<
    'static,
    Sensor,
    BoardTimer,
    FlashStore<Flash>,
    Reader,
    Writer,
    Reader,
    Writer,
    M,
>;

#[embassy_executor::task]
async fn sample(sampler: &'static mut Sampler<'static, Sensor, BoardTimer, M>) -> ! {
    sampler.run().await
}

#[embassy_executor::task]
async fn control(
    control: &'static mut Control<'static, Sensor, BoardTimer, FlashStore<Flash>, M>,
) -> ! {
    control.run().await
}

#[embassy_executor::task(pool_size = 2)]
async fn listen(reader: &'static mut LinkReader<'static, Reader, BoardTimer, M>) -> ! {
    reader.run().await
}

#[embassy_executor::task(pool_size = 2)]
async fn talk(writer: &'static mut LinkWriter<'static, Writer, M>) -> ! {
    writer.run().await
}

/// Whether a task has been woken.
static WOKEN: AtomicBool = AtomicBool::new(false);

#[unsafe(export_name = "__pender")]
fn pend(_context: *mut ()) {
    WOKEN.store(true, Ordering::Relaxed);
}

#[entry]
fn main() -> ! {
    static EXECUTOR: StaticCell<Executor> = StaticCell::new();
    static SHARED: StaticCell<Shared<M, Sample>> = StaticCell::new();
    static BRIDGE: StaticCell<Mutex<M, Bridge>> = StaticCell::new();

    LOG.start_polled();
    let mut line = [0; 256];
    let lockstep = options(semihosting::command_line(&mut line));
    clock::start(lockstep);
    let bridge = &*BRIDGE.init(Mutex::new(Bridge::new(SENSOR_BUS.start())));
    let board = Board {
        hello: hello(),
        sensor: sensor(BridgeI2c(bridge), DataReady(bridge)),
        timer: BoardTimer,
        // SAFETY: nothing else uses the memory there.
        store: FlashStore::new(unsafe { Flash::new() }, store::LAYOUT, 0),
        // The machine has no entropy source.
        entropy: [0; 16],
        cable: CABLE.start(),
        wireless: WIRELESS.start(),
    };
    static NODE: StaticCell<Node> = StaticCell::new();
    let node = NODE.init_with(|| board.split(SHARED.init(Shared::new())));

    let executor: &'static Executor = EXECUTOR.init(Executor::new(core::ptr::null_mut()));
    let spawner = executor.spawner();
    // No task is spawned more often than its pool allows.
    spawner.spawn(sample(&mut node.sampler).unwrap());
    spawner.spawn(control(&mut node.control).unwrap());
    spawner.spawn(listen(&mut node.cable_reader).unwrap());
    spawner.spawn(talk(&mut node.cable_writer).unwrap());
    spawner.spawn(listen(&mut node.wireless_reader).unwrap());
    spawner.spawn(talk(&mut node.wireless_writer).unwrap());
    // SAFETY: no critical section is under way.
    unsafe { interrupts::unmask() };
    defmt::info!("started, lockstep {}", lockstep);

    let mut in_lockstep = Lockstep::new();
    loop {
        WOKEN.store(false, Ordering::Relaxed);
        // SAFETY: only called here.
        unsafe { executor.poll() };
        // Interrupts are disabled between the check and `wfi`; a pending one still ends `wfi`.
        let idle = cortex_m::interrupt::free(|_| {
            let idle = !WOKEN.load(Ordering::Relaxed);
            if idle && !lockstep {
                cortex_m::asm::wfi();
            }
            idle
        });
        if idle && lockstep {
            in_lockstep.pass_time();
        }
    }
}

/// Applies the options of the command line; returns whether to run in lockstep.
fn options(line: &str) -> bool {
    let mut lockstep = false;
    // The first is the program.
    for word in line.split(' ').skip(1) {
        match (word, word.split_once('=')) {
            ("lockstep", _) => lockstep = true,
            ("free-running", _) => lockstep = false,
            (_, Some(("power-loss", words))) => match words.parse() {
                Ok(words) => store::lose_power_after(words),
                Err(_) => unknown(word),
            },
            (_, Some(("slow-flash", cycles))) => match cycles.parse() {
                Ok(cycles) => store::slow_down(cycles),
                Err(_) => unknown(word),
            },
            _ => unknown(word),
        }
    }
    lockstep
}

fn unknown(option: &str) -> ! {
    defmt::error!("`{}` is not an option", option);
    semihosting::exit(log::exit_code::USAGE)
}

fn hello() -> Hello {
    let part = |text: &str| text.parse().unwrap_or(0);
    Hello {
        device_id: 0x5145_0386,
        firmware: [
            part(env!("CARGO_PKG_VERSION_MAJOR")),
            part(env!("CARGO_PKG_VERSION_MINOR")),
            part(env!("CARGO_PKG_VERSION_PATCH")),
        ],
        reset_reason: ResetReason::PowerOn,
        capabilities: QUANTITIES
            .with(Capabilities::ACCELEROMETER)
            .with(Capabilities::STORE),
        sensitivity_known: true,
        board: Part::new(board::QEMU_MPS2, "QEMU mps2-an386"),
        sensor: PART,
        ..Hello::new(LinkRole::Cable)
    }
}
