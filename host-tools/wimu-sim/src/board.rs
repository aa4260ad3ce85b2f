//! A simulated board: sensor, bus, links, memory, and the node that runs on real boards.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::future::Future;
use std::iter;
use std::pin::Pin;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Wake, Waker};
use std::time::Duration;

use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use wimu_host::transport::Transport;
use wimu_host::{Code, Result};
use wimu_link::hello::{Capabilities, Part, board, sensor};
use wimu_link::{Hello, LinkRole};
use wimu_model::DeviceTimeUs;
use wimu_node::sensor::RawSample;
use wimu_node::{
    DataReady, FifoSensor, InertialSensor, NearestRate, Pair, Polled, Shared, TimeoutBus, Timer,
    line_rate,
};
use wimu_sensors::{Adxl345, I2cBus, Lsm6ds3trC, Lsm6dso, Lsm303agr, Mpu6050};

use crate::clock::{Until, VirtualClock};
use crate::faults::LinkFaults;
use crate::i2c::{Faults, SimI2c, Target};
use crate::icm42688::{self, PolledIcm42688};
pub use crate::part::SensorPart;
use crate::pipe::{Channels, DeviceReader, DeviceWriter, HostEnd, LinkConfig, faulty_link};
use crate::sensor::Sensor;
use crate::source::Source;
use crate::spi::SimSpi;
use crate::storage::Storage;

/// Range of a second accelerometer, ± g.
const SECOND_G: u8 = 16;

/// Configuration of a simulated board.
#[derive(Clone, Debug)]
pub struct BoardConfig {
    /// The cable.
    pub cable: LinkConfig,
    /// The wireless link.
    pub wireless: LinkConfig,
    /// Faults of the cable. A baud rate in it replaces that in `cable`.
    pub cable_faults: LinkFaults,
    /// Faults of the wireless link, likewise.
    pub wireless_faults: LinkFaults,
    /// Seed of the faults.
    pub fault_seed: u64,
    /// Rate error of its clock against the host's, 10⁻⁹, −10⁸..=10⁸.
    pub clock_error_ppb: i32,
    /// Its memory.
    pub storage: Storage,
    /// Its sensor.
    pub sensor: SensorPart,
    /// Whether the sensor replays a recording of another one, of unknown sensitivity.
    pub replay: bool,
    /// Its serial number.
    pub device_id: u64,
}

impl Default for BoardConfig {
    /// Two links of 115,200 baud, fresh memory.
    fn default() -> Self {
        let uart = LinkConfig { baud: Some(115_200), ..LinkConfig::default() };
        Self {
            cable: uart,
            wireless: uart,
            cable_faults: LinkFaults::default(),
            wireless_faults: LinkFaults::default(),
            fault_seed: 1,
            clock_error_ppb: 0,
            storage: Storage::in_memory(),
            sensor: SensorPart::default(),
            replay: false,
            device_id: 0x5157_0001,
        }
    }
}

/// A simulated board: `wimu-node` with the drivers of boards on simulated hardware, in virtual time.
///
/// Time passes only in [`run_until`](Self::run_until), as fast as possible or paced by the
/// caller. The same calls give the same bytes in every run.
pub struct Board {
    clock: VirtualClock,
    started_us: u64,
    config: BoardConfig,
    sensor: Sensor,
    second: Option<(SensorPart, Sensor)>,
    bus_faults: Faults,
    cable: HostEnd,
    wireless: HostEnd,
    /// Faults of the links, the cable's first.
    channels: [Option<Channels>; 2],
    buttons: Rc<dyn Buttons>,
    node: Pin<Box<dyn Future<Output = ()>>>,
    woken: Arc<Woken>,
}

impl Board {
    /// Starts a board whose sensor takes its samples from `source`.
    pub fn start(config: BoardConfig, source: impl Source + 'static) -> Self {
        Self::of_sensors(config, source, |_| None)
    }

    /// Starts a board with a second sensor, index 1, of ± 16 g on the same bus: both an LSM303AGR and an ADXL345.
    pub fn start_pair(
        config: BoardConfig,
        source: impl Source + 'static,
        (part, second): (SensorPart, impl Source + 'static),
    ) -> Self {
        Self::of_sensors(config, source, |clock| Some((part, part.power_on(clock, second))))
    }

    fn of_sensors(
        config: BoardConfig,
        source: impl Source + 'static,
        second: impl FnOnce(&VirtualClock) -> Option<(SensorPart, Sensor)>,
    ) -> Self {
        let clock = VirtualClock::new();
        let sensor = config.sensor.power_on(&clock, source);
        let second = second(&clock);
        let channels = [
            (&config.cable_faults, config.fault_seed),
            (&config.wireless_faults, config.fault_seed.wrapping_add(1)),
        ]
        .map(|(faults, seed)| (!faults.is_none()).then(|| Channels::new(faults, seed)));
        let ((node, buttons), bus_faults, cable, wireless) =
            boot(&clock, &config, &sensor, second.as_ref(), &channels);
        Self {
            clock,
            started_us: 0,
            config,
            sensor,
            second,
            bus_faults,
            cable,
            wireless,
            channels,
            buttons,
            node,
            woken: Arc::new(Woken(AtomicBool::new(true))),
        }
    }

    /// Switches power off and on: the node restarts with the content of its memory. Bytes
    /// under way on the links are lost; time continues, but the device's clock starts at 0.
    pub fn restart(&mut self) {
        self.sensor.power_cycle();
        if let Some((_, second)) = &self.second {
            second.power_cycle();
        }
        self.started_us = self.clock.now();
        for channels in self.channels.iter().flatten() {
            channels.clear();
        }
        let bauds = [self.cable.baud(), self.wireless.baud()];
        ((self.node, self.buttons), self.bus_faults, self.cable, self.wireless) =
            boot(&self.clock, &self.config, &self.sensor, self.second.as_ref(), &self.channels);
        // The other ends keep their baud rates.
        for (link, baud) in [&mut self.cable, &mut self.wireless].into_iter().zip(bauds) {
            if let Some(baud) = baud {
                link.set_baud(baud);
            }
        }
        self.woken = Arc::new(Woken(AtomicBool::new(true)));
    }

    /// Runs up to `time_us` since the first start.
    pub fn run_until(&mut self, time_us: u64) {
        loop {
            self.poll();
            match self.clock.next_deadline() {
                Some(deadline) if deadline <= time_us => self.clock.advance_to(deadline),
                _ => break,
            }
        }
        self.clock.advance_to(time_us);
        self.poll();
    }

    /// Lets `time_us` pass without the processor, as while its flash is erased.
    pub fn stall(&mut self, time_us: u64) {
        self.clock.advance_to(self.now_us() + time_us);
    }

    /// Time since the first start, µs.
    pub fn now_us(&self) -> u64 {
        self.clock.now()
    }

    /// Its next deadline, µs since the first start.
    pub fn next_deadline_us(&self) -> Option<u64> {
        self.clock.next_deadline()
    }

    /// Time of the last start, µs since the first start: 0 on the device's clock.
    pub fn started_us(&self) -> u64 {
        self.started_us
    }

    /// The sensor, for faults or other samples.
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    /// The second sensor, if it has one.
    pub fn second(&self) -> Option<&Sensor> {
        self.second.as_ref().map(|(_, sensor)| sensor)
    }

    /// Faults of the sensor's bus.
    pub fn bus_faults(&self) -> &Faults {
        &self.bus_faults
    }

    /// Presses button A for the `count`th time.
    pub fn press(&self, count: u16) {
        let timer = BoardTimer::new(&self.clock, self.started_us, &self.config);
        self.buttons.mark(timer.now(), count);
    }

    /// The gesture that erases a lost key.
    pub fn forget_key(&self) {
        self.buttons.forget_key();
    }

    /// The board's memory.
    pub fn storage(&self) -> &Storage {
        &self.config.storage
    }

    /// The host's end of a link.
    pub fn link(&mut self, role: LinkRole) -> &mut HostEnd {
        match role {
            LinkRole::Cable => &mut self.cable,
            _ => &mut self.wireless,
        }
    }

    /// Faults of a link and their statistics; `None` for a link without faults.
    pub fn faults(&self, role: LinkRole) -> Option<&Channels> {
        let [cable, wireless] = &self.channels;
        match role {
            LinkRole::Cable => cable.as_ref(),
            _ => wireless.as_ref(),
        }
    }

    fn poll(&mut self) {
        let waker = Waker::from(self.woken.clone());
        let mut context = Context::from_waker(&waker);
        while self.woken.0.swap(false, Ordering::Relaxed) {
            // The node never ends.
            let _ = self.node.as_mut().poll(&mut context);
        }
    }
}

/// The board's buttons, of a node with any sensor.
trait Buttons {
    fn mark(&self, now: DeviceTimeUs, count: u16);
    fn forget_key(&self);
}

impl<S: RawSample> Buttons for Shared<NoopRawMutex, S> {
    fn mark(&self, now: DeviceTimeUs, count: u16) {
        self.mark(now, count);
    }

    fn forget_key(&self) {
        self.forget_key();
    }
}

/// A running node.
type Running = (Pin<Box<dyn Future<Output = ()>>>, Rc<dyn Buttons>);
type Boot = (Running, Faults, HostEnd, HostEnd);

fn boot(
    clock: &VirtualClock,
    config: &BoardConfig,
    device: &Sensor,
    second: Option<&(SensorPart, Sensor)>,
    channels: &[Option<Channels>; 2],
) -> Boot {
    let devices = iter::once(device).chain(second.map(|(_, sensor)| sensor));
    let targets = devices.map(|device| Rc::new(device.clone()) as Rc<dyn Target>);
    let i2c = SimI2c::new(clock, targets);
    let faults = i2c.faults();
    let link = |config: LinkConfig, faults: &LinkFaults, channels: &Option<Channels>| {
        let config = LinkConfig { baud: faults.baud.or(config.baud), ..config };
        faulty_link(clock, config, channels.clone())
    };
    let [cable_channels, wireless_channels] = channels;
    let (cable_reader, cable_writer, cable) =
        link(config.cable, &config.cable_faults, cable_channels);
    let (wireless_reader, wireless_writer, mut wireless) =
        link(config.wireless, &config.wireless_faults, wireless_channels);
    let timer = BoardTimer::new(clock, clock.now(), config);
    let hello = Hello {
        device_id: config.device_id,
        firmware: firmware_version(),
        capabilities: Capabilities::STORE,
        sensitivity_known: !config.replay,
        board: Part::new(board::SIMULATED, "simulated"),
        ..Hello::new(LinkRole::Cable)
    };
    let storage = config.storage.clone();
    if let Some(baud) = line_rate(&mut storage.store()) {
        wireless.set_device_baud(baud);
    }
    let nearest_rate =
        wireless.baud().map(|_| -> NearestRate { |baud| baud.clamp(300, 4_000_000) });
    let links = [(cable_reader, cable_writer), (wireless_reader, wireless_writer)];
    let bus = || TimeoutBus::new(i2c.clone(), timer.clone());
    let line = |device: &Sensor| Stamped { sensor: device.clone(), timer: timer.clone() };
    let at = |address| I2cBus { i2c: bus(), address };
    let lsm303agr =
        |device: &Sensor| FifoSensor::new(Lsm303agr::new(bus()), line(device), timer.clone());
    let adxl345 =
        |device: &Sensor| FifoSensor::new(Adxl345::new(at(0x53)), line(device), timer.clone());
    let time = timer.clone();
    let node = match (config.sensor, second) {
        (SensorPart::Lsm303agr, Some((SensorPart::Adxl345, other))) => {
            let sensor = Pair::new(lsm303agr(device), adxl345(other), time.clone(), SECOND_G);
            node(hello, sensor, time, storage, links, nearest_rate)
        }
        (SensorPart::Adxl345, Some((SensorPart::Lsm303agr, other))) => {
            let sensor = Pair::new(adxl345(device), lsm303agr(other), time.clone(), SECOND_G);
            node(hello, sensor, time, storage, links, nearest_rate)
        }
        (SensorPart::Lsm303agr, _) => {
            node(hello, lsm303agr(device), time, storage, links, nearest_rate)
        }
        (SensorPart::Adxl345, _) => {
            node(hello, adxl345(device), time, storage, links, nearest_rate)
        }
        (SensorPart::Lsm6dso, _) => {
            let sensor = FifoSensor::new(Lsm6dso::<_>::new(at(0x6A)), line(device), timer);
            node(hello, sensor, time, storage, links, nearest_rate)
        }
        (SensorPart::Lsm6ds3trC, _) => {
            let sensor = FifoSensor::new(Lsm6ds3trC::new(at(0x6A)), line(device), timer);
            node(hello, sensor, time, storage, links, nearest_rate)
        }
        (SensorPart::Mpu6050, _) => {
            let sensor = FifoSensor::new(Mpu6050::new(at(0x68)), line(device), timer);
            node(hello, sensor, time, storage, links, nearest_rate)
        }
        (SensorPart::Icm42688, _) => {
            let spi = SimSpi::new(clock, Rc::new(device.clone()), 1_000_000);
            let reader = PolledIcm42688::new(spi, timer.clone());
            let sensor = Polled::new(reader, icm42688::PLANNER, timer);
            node(hello, sensor, time, storage, links, nearest_rate)
        }
    };
    (node, faults, cable, wireless)
}

fn node<A: InertialSensor + 'static>(
    hello: Hello,
    sensor: A,
    timer: BoardTimer,
    storage: Storage,
    [cable, wireless]: [(DeviceReader, DeviceWriter); 2],
    nearest_rate: Option<NearestRate>,
) -> Running {
    let timed = if A::CAPABILITIES.contains(Capabilities::POLLED) {
        Capabilities(0)
    } else {
        Capabilities::DATA_READY
    };
    let replay = Part::new(sensor::REPLAY, "replay");
    let hello = Hello {
        capabilities: hello.capabilities.with(A::CAPABILITIES).with(timed),
        sensor: if hello.sensitivity_known { A::PART } else { replay },
        ..hello
    };
    // Different at each start, and the same in every run: a simulation has no secrets.
    let entropy = u128::from(hello.device_id) << 64 | u128::from(timer.started_us);
    let board = wimu_node::Board {
        hello,
        sensor,
        timer,
        store: storage.store(),
        entropy: entropy.to_le_bytes(),
        cable,
        wireless,
        nearest_rate,
    };
    let shared = Rc::new(Shared::new());
    let buttons = shared.clone();
    let node = Box::pin(async move {
        board.split(&shared).run().await;
    });
    (node, buttons)
}

fn firmware_version() -> [u16; 3] {
    let parts = [
        env!("CARGO_PKG_VERSION_MAJOR"),
        env!("CARGO_PKG_VERSION_MINOR"),
        env!("CARGO_PKG_VERSION_PATCH"),
    ];
    parts.map(|part| part.parse().unwrap_or(0))
}

struct Woken(AtomicBool);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// The device's clock: it starts when the device does.
#[derive(Clone, Debug)]
pub struct BoardTimer {
    clock: VirtualClock,
    started_us: u64,
    /// Rate of the device's clock, 10⁻⁹ µs per µs of the simulation.
    rate_ppb: u128,
}

const ONE_PPB: u128 = 1_000_000_000;

impl BoardTimer {
    fn new(clock: &VirtualClock, started_us: u64, config: &BoardConfig) -> Self {
        Self {
            clock: clock.clone(),
            started_us,
            rate_ppb: u128::from((1_000_000_000 + i64::from(config.clock_error_ppb)) as u64),
        }
    }

    /// The device time at `time_us` of the simulation.
    fn at(&self, time_us: u64) -> DeviceTimeUs {
        let passed = u128::from(time_us.saturating_sub(self.started_us));
        DeviceTimeUs((passed * self.rate_ppb / ONE_PPB) as u64)
    }
}

impl Timer for BoardTimer {
    fn now(&self) -> DeviceTimeUs {
        self.at(self.clock.now())
    }

    async fn until(&self, moment: DeviceTimeUs) {
        // The first µs at which `now` has reached it.
        let passed = (u128::from(moment.0) * ONE_PPB).div_ceil(self.rate_ppb);
        let passed = u64::try_from(passed).unwrap_or(u64::MAX);
        let until: Until = self.clock.until(passed.saturating_add(self.started_us));
        until.await;
    }
}

/// INT1 of the sensor with the time of its rising edge, as in an interrupt handler.
struct Stamped {
    sensor: Sensor,
    timer: BoardTimer,
}

impl DataReady for Stamped {
    async fn ready(&mut self) -> Option<DeviceTimeUs> {
        Some(self.timer.at(self.sensor.ready().await))
    }
}

/// A board in virtual time, simulated or emulated: the same calls give the same bytes in every run.
pub trait VirtualBoard {
    /// Runs up to `time_us` since the first start.
    ///
    /// # Errors
    /// When the board has failed.
    fn run_until(&mut self, time_us: u64) -> Result<()>;

    /// Time since the first start, µs.
    fn now_us(&self) -> u64;

    /// Time of the last start, µs since the first start: 0 on the device's clock.
    fn started_us(&self) -> u64;

    /// Switches power off and on.
    ///
    /// # Errors
    /// When it does not start.
    fn restart(&mut self) -> Result<()>;

    /// Data received on a link since the last call.
    fn receive(&mut self, role: LinkRole) -> Vec<u8>;

    /// Sends bytes to the board on a link.
    ///
    /// # Errors
    /// When the board has failed.
    fn send(&mut self, role: LinkRole, bytes: &[u8]) -> Result<()>;

    /// Number of lost connections of a link so far; `None` while there is none.
    fn connection(&mut self, _role: LinkRole) -> Option<u64> {
        Some(0)
    }

    /// Baud rate of the host's end of a link; `None` for a link without one, or with one that
    /// cannot be set.
    fn baud(&mut self, _role: LinkRole) -> Option<u32> {
        None
    }
}

impl VirtualBoard for Board {
    fn run_until(&mut self, time_us: u64) -> Result<()> {
        self.run_until(time_us);
        Ok(())
    }

    fn now_us(&self) -> u64 {
        self.now_us()
    }

    fn started_us(&self) -> u64 {
        self.started_us()
    }

    fn restart(&mut self) -> Result<()> {
        self.restart();
        Ok(())
    }

    fn receive(&mut self, role: LinkRole) -> Vec<u8> {
        self.link(role).pull()
    }

    fn send(&mut self, role: LinkRole, bytes: &[u8]) -> Result<()> {
        self.link(role).push(bytes);
        Ok(())
    }

    fn connection(&mut self, role: LinkRole) -> Option<u64> {
        self.link(role).connection()
    }

    fn baud(&mut self, role: LinkRole) -> Option<u32> {
        self.link(role).baud()
    }
}

/// One link of a board in virtual time, as the host's [`Transport`]: while the host waits,
/// the board runs.
pub struct SimLink<'a, R = Board> {
    board: &'a RefCell<R>,
    role: LinkRole,
    /// Number of the connection.
    connection: Option<u64>,
    /// Arrived, not yet read.
    arrived: VecDeque<u8>,
}

impl<'a, R: VirtualBoard> SimLink<'a, R> {
    /// The host's end of the link `role` of `board`. It fails when the connection is lost; then a new
    /// one is to be made.
    pub fn new(board: &'a RefCell<R>, role: LinkRole) -> Self {
        Self {
            board,
            role,
            connection: board.borrow_mut().connection(role),
            arrived: VecDeque::new(),
        }
    }

    fn connected(&self, board: &mut R) -> Result<()> {
        let connection = board.connection(self.role);
        if connection.is_some() && connection == self.connection {
            return Ok(());
        }
        Err(Code::LinkLost
            .error("the simulated link is disconnected", "connect again")
            .at(format!("the simulated {} link", self.role)))
    }
}

impl<R: VirtualBoard> Transport for SimLink<'_, R> {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize> {
        let mut board = self.board.borrow_mut();
        let deadline = board.now_us() + timeout.as_micros() as u64;
        loop {
            if self.connected(&mut board).is_ok() {
                self.arrived.extend(board.receive(self.role));
            } else if self.arrived.is_empty() {
                self.connected(&mut board)?;
            }
            if !self.arrived.is_empty() || board.now_us() >= deadline {
                break;
            }
            let step = board.now_us() + 1000;
            board.run_until(step.min(deadline))?;
        }
        let count = self.arrived.len().min(buffer.len());
        for (place, byte) in buffer.iter_mut().zip(self.arrived.drain(..count)) {
            *place = byte;
        }
        Ok(count)
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        let mut board = self.board.borrow_mut();
        self.connected(&mut board)?;
        board.send(self.role, bytes)
    }

    fn now(&self) -> Duration {
        Duration::from_micros(self.board.borrow().now_us())
    }

    fn baud(&self) -> Option<u32> {
        self.board.borrow_mut().baud(self.role)
    }
}
