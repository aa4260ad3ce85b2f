//! The node's tasks and `main`, for the sensor that the image's root names: `Sensor`, made by `sensor`.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m_rt::entry;
use embassy_executor::raw::Executor;
use embassy_sync::mutex::Mutex;
use static_cell::StaticCell;
use wimu_cortex_m::stack;
use wimu_embassy::{LIMITS_US, Start};
use wimu_link::Hello;
use wimu_link::hello::{Capabilities, Part, board};
use wimu_node::{Board, FlashStore};

use self::tasks::Shared;
use crate::bridge::{Bridge, BridgeI2c};
use crate::clock::BoardTimer;
use crate::data_ready::DataReady;
use crate::lockstep::Lockstep;
use crate::store::{self, Flash};
use crate::uart::{CABLE, LOG, Reader, SENSOR_BUS, WIRELESS, Writer};
use crate::watchdog::FAILURES;
use crate::{Sensor, clock, interrupts, log, semihosting, sensor, watchdog};

/// The tasks of the node.
mod tasks {
    use super::{BoardTimer, Flash, FlashStore, Reader, Sensor, Writer};
    wimu_embassy::tasks! {
        sensor: Sensor,
        timer: BoardTimer,
        store: FlashStore<Flash>,
        cable: (Reader, Writer),
        wireless: (Reader, Writer),
    }
}

/// Feeds the watchdog while the node works.
#[embassy_executor::task]
async fn supervise(shared: &'static Shared) -> ! {
    let record = &watchdog::kept().start;
    wimu_embassy::supervise(LIMITS_US, shared, record, BoardTimer, stack::status, watchdog::feed)
        .await
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
    static SHARED: Shared = Shared::new();
    static BRIDGE: StaticCell<Mutex<wimu_embassy::Mutex, Bridge>> = StaticCell::new();

    LOG.start_polled();
    let mut line = [0; 256];
    let lockstep = options(semihosting::command_line(&mut line));
    clock::start(lockstep);
    let bridge = &*BRIDGE.init(Mutex::new(Bridge::new(SENSOR_BUS.start())));
    let board = Board {
        hello: hello(&watchdog::begin()),
        sensor: sensor(BridgeI2c(bridge), DataReady(bridge)),
        timer: BoardTimer,
        // SAFETY: nothing else uses the memory there.
        store: FlashStore::new(unsafe { Flash::new() }, store::LAYOUT, 0),
        // The machine has no entropy source.
        entropy: [0; 16],
        cable: CABLE.start(),
        wireless: WIRELESS.start(),
        nearest_rate: None,
    };
    let node = tasks::place(board, &SHARED);
    let executor: &'static Executor = EXECUTOR.init(Executor::new(core::ptr::null_mut()));
    let spawner = executor.spawner();
    tasks::spawn(node, spawner.make_send(), spawner);
    // Spawned once.
    spawner.spawn(supervise(&SHARED).unwrap());
    // SAFETY: no critical section is under way.
    unsafe { interrupts::unmask() };
    defmt::info!("started, lockstep {}", lockstep);

    let mut in_lockstep = Lockstep::new();
    loop {
        WOKEN.store(false, Ordering::Relaxed);
        // SAFETY: only called here.
        unsafe { executor.poll() };
        watchdog::check();
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
            (_, Some((failure, ms))) => match (failing(failure), ms.parse()) {
                (Some(at), Ok(ms)) => at.store(ms, Ordering::Relaxed),
                _ => unknown(word),
            },
            _ => unknown(word),
        }
    }
    lockstep
}

fn failing(how: &str) -> Option<&'static AtomicU32> {
    match how {
        "panic" => Some(&FAILURES.panic),
        "stuck" => Some(&FAILURES.stuck),
        "overflow" => Some(&FAILURES.overflow),
        _ => None,
    }
}

fn unknown(option: &str) -> ! {
    defmt::error!("`{}` is not an option", option);
    semihosting::exit(log::exit_code::USAGE)
}

fn hello(start: &Start) -> Hello {
    wimu_embassy::hello::<Sensor>(
        0x5145_0386,
        env!("CARGO_PKG_VERSION"),
        start,
        Capabilities::STORE,
        Part::new(board::QEMU_MPS2, "QEMU mps2-an386"),
    )
}
