//! The node and its parts.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_io_async::{Read, Write};
use wimu_link::hello::Capabilities;
use wimu_link::{Hello, LinkRole};

use crate::control::Control;
use crate::link::{LinkReader, LinkWriter};
use crate::sampler::Sampler;
use crate::sensor::InertialSensor;
use crate::shared::Shared;
use crate::store::{Store, records};
use crate::timer::Timer;

/// The parts of a board.
pub struct Board<A, T, S, CR, CW, WR, WW> {
    /// Identity of the device. The node fills in role, boot count, uptime and parameters. In safe mode it uses neither
    /// stored parameters nor stored settings until the next start, and sends raw samples only.
    pub hello: Hello,
    /// The sensor.
    pub sensor: A,
    /// The clock.
    pub timer: T,
    /// Non-volatile memory.
    pub store: S,
    /// Unpredictable bits, new at each start, from a cryptographic source. Zeros without one: then only the
    /// boot count makes the sessions of two starts differ.
    pub entropy: [u8; 16],
    /// Receiving and sending half of the cable. `read` must be cancel-safe.
    pub cable: (CR, CW),
    /// The wireless link, likewise.
    pub wireless: (WR, WW),
    /// The rates of the wireless link's serial line, if it has one whose rate can be set. The board opens it at the
    /// [stored rate](crate::line_rate).
    pub nearest_rate: Option<NearestRate>,
}

/// Returns the supported rate nearest to the argument, bit/s.
pub type NearestRate = fn(u32) -> u32;

/// The tasks of a node. Each has a `run` that never ends. Spawn `sampler` at a higher priority than the others;
/// it never waits for them.
pub struct Node<'a, A: InertialSensor, T, S, CR, CW, WR, WW, M: RawMutex> {
    /// Reads, corrects, integrates and packs samples.
    pub sampler: Sampler<'a, A, T, M>,
    /// Executes requests, and stores parameters and settings.
    pub control: Control<'a, A, T, S, M>,
    /// Receives from the cable.
    pub cable_reader: LinkReader<'a, CR, T, M>,
    /// Sends to the cable.
    pub cable_writer: LinkWriter<'a, CW, M>,
    /// Receives from the wireless link.
    pub wireless_reader: LinkReader<'a, WR, T, M>,
    /// Sends to the wireless link.
    pub wireless_writer: LinkWriter<'a, WW, M>,
}

impl<A, T, S, CR, CW, WR, WW> Board<A, T, S, CR, CW, WR, WW>
where
    A: InertialSensor,
    T: Timer,
    S: Store,
    CR: Read,
    CW: Write,
    WR: Read,
    WW: Write,
{
    /// Builds the node's tasks, which share `shared`.
    pub fn split<M: RawMutex>(
        self,
        shared: &Shared<M, A::Sample>,
    ) -> Node<'_, A, T, S, CR, CW, WR, WW, M> {
        let Shared { common, orders } = shared;
        let planner = self.sensor.planner();
        common.publish(|published| {
            published.hello = self.hello;
            published.hello.capabilities = capabilities(self.hello.capabilities, self.nearest_rate);
            published.lock.device_id = self.hello.device_id;
            published.lock.entropy = self.entropy;
        });
        Node {
            cable_reader: LinkReader {
                role: LinkRole::Cable,
                line: self.cable.0,
                timer: self.timer.clone(),
                shared: common,
            },
            cable_writer: LinkWriter { role: LinkRole::Cable, line: self.cable.1, shared: common },
            wireless_reader: LinkReader {
                role: LinkRole::Wireless,
                line: self.wireless.0,
                timer: self.timer.clone(),
                shared: common,
            },
            wireless_writer: LinkWriter {
                role: LinkRole::Wireless,
                line: self.wireless.1,
                shared: common,
            },
            sampler: Sampler::new(self.sensor, self.timer.clone(), shared),
            control: Control {
                planner,
                orders,
                store: records(self.store),
                timer: self.timer,
                shared: common,
                #[cfg(all(feature = "wireless", feature = "store"))]
                nearest_rate: self.nearest_rate,
                parameters_changed: false,
                latched: None,
            },
        }
    }
}

/// The capabilities of a board, with what this build of the node can do.
fn capabilities(board: Capabilities, nearest_rate: Option<NearestRate>) -> Capabilities {
    let sets_rate = cfg!(all(feature = "wireless", feature = "store")) && nearest_rate.is_some();
    let mut all = board.with(Capabilities::LISTED);
    for (there, functions) in [
        (cfg!(feature = "correction"), Capabilities::CORRECTION),
        (cfg!(feature = "navigation"), Capabilities::NAVIGATION),
        (cfg!(feature = "heading"), Capabilities::HEADING),
        (cfg!(feature = "auth"), Capabilities::AUTHENTICATION),
        (sets_rate, Capabilities::LINE_RATES),
    ] {
        if there {
            all = all.with(functions);
        }
    }
    if cfg!(feature = "store") { all } else { all.without(Capabilities::STORE) }
}

impl<A, T, S, CR, CW, WR, WW, M> Node<'_, A, T, S, CR, CW, WR, WW, M>
where
    A: InertialSensor,
    T: Timer,
    S: Store,
    CR: Read,
    CW: Write,
    WR: Read,
    WW: Write,
    M: RawMutex,
{
    /// Runs all tasks on one executor: for boards without priorities, and for simulation.
    pub async fn run(mut self) -> ! {
        use embassy_futures::join::{join3, join4};
        let samples_and_control =
            join3(self.sampler.run(), self.control.run(), self.cable_reader.run());
        let rest = join4(
            samples_and_control,
            self.cable_writer.run(),
            self.wireless_reader.run(),
            self.wireless_writer.run(),
        );
        rest.await.1
    }
}
