//! The node's tasks, as every board with priorities runs them.
//!
//! The board defines the types `Sensor`, `BoardTimer`, `Memory`, the halves of its UARTs `Receiver` and
//! `Transmitter`, and their `Rate`.

use embassy_executor::{SendSpawner, Spawner, task};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use static_cell::StaticCell;
use wimu_link::hello::{Capabilities, Fault, Part, ResetReason};
use wimu_link::{Hello, LinkRole};
use wimu_node::{Control, LINKS, LinkReader, LinkWriter, RateKeeper, Sampler, Shared};

use crate::{BoardTimer, Memory, Rate, Receiver, Sensor, Transmitter};

/// The mutex for tasks at two priorities.
pub type M = CriticalSectionRawMutex;
/// The board's node.
pub type Node = wimu_node::Node<
    'static,
    Sensor,
    BoardTimer,
    Memory,
    Receiver,
    Transmitter,
    Receiver,
    Transmitter,
    M,
>;
type Board =
    wimu_node::Board<Sensor, BoardTimer, Memory, Receiver, Transmitter, Receiver, Transmitter>;
type Keeper = RateKeeper<'static, Rate, BoardTimer, M>;

/// The rate at which the UARTs are opened, bits/s, 8N1.
pub const BAUD: u32 = 115_200;

/// Builds the node of a board in a `static`.
pub fn place(board: Board, shared: &'static Shared<M>) -> &'static mut Node {
    static NODE: StaticCell<Node> = StaticCell::new();
    NODE.init_with(|| board.split(shared))
}

/// Spawns the node's tasks, the sampler at the higher priority.
pub fn spawn(
    node: &'static mut Node,
    [cable, wireless]: [Keeper; 2],
    above: SendSpawner,
    others: Spawner,
) {
    // No task is spawned more often than its pool allows.
    above.spawn(sample(&mut node.sampler).unwrap());
    others.spawn(control(&mut node.control).unwrap());
    others.spawn(listen(&mut node.cable_reader).unwrap());
    others.spawn(talk(&mut node.cable_writer).unwrap());
    others.spawn(keep(cable).unwrap());
    if LINKS > 1 {
        others.spawn(listen(&mut node.wireless_reader).unwrap());
        others.spawn(talk(&mut node.wireless_writer).unwrap());
        others.spawn(keep(wireless).unwrap());
    }
}

/// The rate keepers of the UARTs, the cable's first. To be made before the node runs.
pub fn keepers([cable, wireless]: [Rate; 2], shared: &'static Shared<M>) -> [Keeper; 2] {
    [(LinkRole::Cable, cable), (LinkRole::Wireless, wireless)]
        .map(|(role, line)| RateKeeper::new(role, line, BAUD, BoardTimer, shared))
}

#[task]
async fn sample(sampler: &'static mut Sampler<'static, Sensor, BoardTimer, M>) -> ! {
    sampler.run().await
}

#[task]
async fn control(control: &'static mut Control<'static, Sensor, BoardTimer, Memory, M>) -> ! {
    control.run().await
}

#[task(pool_size = LINKS)]
async fn listen(reader: &'static mut LinkReader<'static, Receiver, BoardTimer, M>) -> ! {
    reader.run().await
}

#[task(pool_size = LINKS)]
async fn talk(writer: &'static mut LinkWriter<'static, Transmitter, M>) -> ! {
    writer.run().await
}

#[task(pool_size = LINKS)]
async fn keep(mut keeper: Keeper) -> ! {
    keeper.run().await
}

/// The identity of a device with captured sample times, a store, and the given capabilities.
pub fn hello(
    device_id: u64,
    (reset_reason, fault): (ResetReason, Option<Fault>),
    capabilities: Capabilities,
    board: Part,
    sensor: Part,
) -> Hello {
    let part = |text: &str| text.parse().unwrap_or(0);
    Hello {
        device_id,
        firmware: [
            part(env!("CARGO_PKG_VERSION_MAJOR")),
            part(env!("CARGO_PKG_VERSION_MINOR")),
            part(env!("CARGO_PKG_VERSION_PATCH")),
        ],
        reset_reason,
        fault,
        capabilities: capabilities
            .with(Capabilities::DATA_READY)
            .with(Capabilities::STORE),
        sensitivity_known: true,
        board,
        sensor,
        ..Hello::new(LinkRole::Cable)
    }
}
