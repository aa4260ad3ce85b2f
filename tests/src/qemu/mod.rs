//! A board in QEMU: the firmware's own image on an emulated processor, its sensor behind a
//! [`Bridge`].

use std::collections::VecDeque;
use std::fs;
use std::io::{self, ErrorKind, Read, Write};
use std::net::SocketAddr;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use wimu_host::{Code, Problem, Result};
use wimu_link::LinkRole;

use wimu_sim::board::{SensorPart, VirtualBoard};
use wimu_sim::clock::VirtualClock;
use wimu_sim::i2c::Faults;
use wimu_sim::sensor::Sensor;
use wimu_sim::source::Source;

use self::bridge::{Bridge, Traffic};

mod bridge;

const QEMU: &str = "qemu-system-arm";
/// Longest start of QEMU, on a busy machine.
const START_PATIENCE: Duration = Duration::from_secs(20);
/// Longest time without a message from the board.
const PATIENCE: Duration = Duration::from_secs(60);
/// Longest wait for one byte: a full link stalls the board, so all lines are read in turn.
const GLANCE: Duration = Duration::from_millis(1);
/// Bytes sent before waiting until the board has received them.
const PIECE: usize = 512;

/// How a board in QEMU is made.
#[derive(Clone, Debug)]
pub struct Machine {
    /// The firmware, an ELF file for mps2-an386.
    pub image: PathBuf,
    /// The sensor that it drives.
    pub sensor: SensorPart,
    /// File of its non-volatile memory, created if missing; `None`: content is lost at the end.
    pub memory: Option<PathBuf>,
    /// Where its `defmt` log goes.
    pub log: Option<PathBuf>,
    /// Power is lost after this many words of flash have been written or erased.
    pub power_loss_after: Option<u32>,
    /// Extra processor cycles for each word of flash written.
    pub slow_flash: Option<u32>,
    /// How its sensor's driver fails, such as `panic=1500` (at 1500 ms).
    pub failure: Option<String>,
}

impl Machine {
    /// A machine that runs the `image` for a board with `sensor`, without memory and log. The images are in
    /// one folder: an LSM303AGR's has the name of the firmware, another one's ends with the sensor's name.
    pub fn new(image: &Path, sensor: SensorPart) -> Self {
        let image = match sensor {
            SensorPart::Lsm303agr => image.to_owned(),
            other => {
                let mut name = image.file_name().unwrap_or_default().to_owned();
                name.push(format!("-{}", other.name()).to_lowercase());
                image.with_file_name(name)
            }
        };
        Self {
            image,
            sensor,
            memory: None,
            log: None,
            power_loss_after: None,
            slow_flash: None,
            failure: None,
        }
    }

    /// A bridge to the sensor, with samples from `source`.
    fn bridge(&self, source: impl Source + 'static) -> Bridge {
        let clock = VirtualClock::new();
        let sensor = self.sensor.power_on(&clock, source);
        Bridge::new(&clock, sensor)
    }

    /// QEMU with the board's UARTs on character devices described as QEMU does.
    fn start(&self, mode: &str, [cable, wireless, sensor_bus]: [&str; 3]) -> Result<Process> {
        if !self.image.is_file() {
            return Err(Code::FileUnreadable
                .error("there is no firmware", "run `cargo xtask firmware`")
                .at(self.image.display().to_string()));
        }
        let mut command = Command::new(QEMU);
        command.args(["-display", "none", "-monitor", "none"]);
        let mut machine = String::from("mps2-an386");
        if let Some(memory) = &self.memory {
            machine.push_str(",memory-backend=flash");
            command.args([
                "-object",
                &format!(
                    "memory-backend-file,id=flash,size=16M,share=on,mem-path={}",
                    escaped(memory)
                ),
            ]);
        }
        command.args(["-machine", &machine]).arg("-kernel").arg(&self.image);
        let mut semihosting = format!("enable=on,target=native,arg=wimu,arg={mode}");
        if let Some(words) = self.power_loss_after {
            semihosting.push_str(&format!(",arg=power-loss={words}"));
        }
        if let Some(cycles) = self.slow_flash {
            semihosting.push_str(&format!(",arg=slow-flash={cycles}"));
        }
        if let Some(failure) = &self.failure {
            semihosting.push_str(&format!(",arg={failure}"));
        }
        command.args(["-semihosting-config", &semihosting]);
        for (name, device) in [("wireless", wireless), ("cable", cable), ("bus", sensor_bus)] {
            command.args(["-chardev", &format!("socket,id={name},{device}")]);
            command.args(["-serial", &format!("chardev:{name}")]);
        }
        let log = self.log.as_deref().map(|path| format!("file:{}", escaped(path)));
        command.args(["-serial", log.as_deref().unwrap_or("null")]);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        match command.spawn() {
            Ok(child) => Ok(Process(child)),
            Err(error) if error.kind() == ErrorKind::NotFound => Err(Code::LinkAbsent.error(
                format!("{QEMU} is not installed"),
                "run `cargo xtask setup`, or install Debian's package qemu-system-arm",
            )),
            Err(error) => Err(Code::LinkAbsent
                .error(format!("{QEMU} does not start: {error}"), "check its installation")),
        }
    }
}

/// A path as a value in QEMU's options.
fn escaped(path: &Path) -> String {
    path.display().to_string().replace(',', ",,")
}

/// The QEMU process; killed when dropped.
struct Process(Child);

impl Process {
    /// Why it has ended; `None` while it runs.
    fn failure(&mut self) -> Option<Problem> {
        let status = self.0.try_wait().ok()??;
        let mut message = String::new();
        if let Some(stderr) = &mut self.0.stderr {
            let _ = stderr.read_to_string(&mut message);
        }
        let message = message.trim();
        let message = if message.is_empty() { "no message" } else { message };
        Some(Code::LinkLost.error(format!("{QEMU} has ended ({status}): {message}"),
            "exit code 3: requested power loss, 4: watchdog, 101: firmware panic, 102: processor fault; see its log",
        ))
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A folder for sockets, gone when dropped.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Result<Self> {
        static MADE: AtomicU32 = AtomicU32::new(0);
        let number = MADE.fetch_add(1, Ordering::Relaxed);
        let name = format!("wimu-qemu-{}-{number}", std::process::id());
        let path = std::env::temp_dir().join(name);
        fs::create_dir_all(&path)
            .map_err(|error| Problem::file(&path.display().to_string(), "make", &error))?;
        Ok(Self(path))
    }

    fn listen(&self, name: &str) -> Result<Listener> {
        let path = self.0.join(name);
        let failed = |error| Problem::file(&path.display().to_string(), "listen on", &error);
        // A socket left from the previous start.
        let _ = fs::remove_file(&path);
        let listener = UnixListener::bind(&path).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        Ok(Listener { listener, path })
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

struct Listener {
    listener: UnixListener,
    path: PathBuf,
}

impl Listener {
    /// The value of QEMU's option.
    fn device(&self) -> String {
        format!("path={}", escaped(&self.path))
    }

    fn accept(&self, process: &mut Process) -> Result<UnixStream> {
        let start = Instant::now();
        loop {
            match self.listener.accept() {
                Ok((stream, _)) => return Ok(stream),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) => return Err(lost(&error)),
            }
            if let Some(failure) = process.failure() {
                return Err(failure);
            }
            if start.elapsed() > START_PATIENCE {
                return Err(Code::LinkAbsent.error(
                    format!("{QEMU} does not connect within {} s", START_PATIENCE.as_secs()),
                    "reduce the load of this computer",
                ));
            }
            thread::sleep(Duration::from_millis(2));
        }
    }
}

fn lost(error: &io::Error) -> Problem {
    Code::LinkLost.error(format!("the line to {QEMU} failed: {error}"), "start it again")
}

/// A board in QEMU in lockstep: its time passes only when its host lets it, however long the
/// emulator takes, so that the same calls give the same bytes in every run.
pub struct QemuBoard {
    machine: Machine,
    bridge: Bridge,
    lines: Lines,
    folder: Folder,
}

/// A started QEMU and the lines to it.
struct Lines {
    sensor_bus: UnixStream,
    /// Cable first.
    links: [Link; 2],
    process: Process,
}

struct Link {
    stream: UnixStream,
    /// Bytes ever sent to the board and received from it, modulo 2¹⁶.
    sent: u16,
    received: u16,
    /// Received, not yet taken.
    arrived: VecDeque<u8>,
}

impl QemuBoard {
    /// Puts power on a board whose sensor takes its samples from `source`.
    ///
    /// # Errors
    /// When QEMU is missing or ends, or the firmware does not begin to work.
    pub fn start(machine: Machine, source: impl Source + 'static) -> Result<Self> {
        let folder = Folder::new()?;
        let mut board = Self {
            lines: Lines::open(&machine, &folder)?,
            bridge: machine.bridge(source),
            machine,
            folder,
        };
        board.settle()?;
        Ok(board)
    }

    /// How it is made; a change holds from the next restart on.
    pub fn machine(&mut self) -> &mut Machine {
        &mut self.machine
    }

    /// QEMU's process, to kill it at its work.
    pub fn process_id(&self) -> u32 {
        self.lines.process.0.id()
    }

    /// The sensor, to break it or to give it other samples.
    pub fn sensor(&self) -> &Sensor {
        self.bridge.sensor()
    }

    /// The sensor's bus, to break it.
    pub fn bus_faults(&self) -> Faults {
        self.bridge.bus_faults()
    }

    /// Lets the board compute until it waits for time to pass and both sides have received all
    /// that the other has sent.
    fn settle(&mut self) -> Result<()> {
        let mut heard = Instant::now();
        loop {
            if let Some(traffic) = self.bridge.waiting() {
                let now = self.bridge.clock().now();
                if let Some(answer) = self.bridge.pass_time(now) {
                    self.lines.answer(&answer)?;
                    continue;
                }
                self.lines.fetch()?;
                if traffic == self.lines.traffic() {
                    return Ok(());
                }
            }
            let bytes = self.lines.hear(GLANCE)?;
            if bytes.is_empty() {
                // Links that are full would hold it up.
                self.lines.fetch()?;
                if let Some(failure) = self.lines.process.failure() {
                    return Err(failure);
                }
                if heard.elapsed() > PATIENCE {
                    return Err(Code::LinkLost.error(
                        format!("the board has not gone on for {} s", PATIENCE.as_secs()),
                        "see its log",
                    ));
                }
                continue;
            }
            heard = Instant::now();
            let answers = self.bridge.receive(&bytes);
            self.lines.answer(&answers)?;
        }
    }
}

impl VirtualBoard for QemuBoard {
    fn run_until(&mut self, time_us: u64) -> Result<()> {
        while let Some(answer) = self.bridge.pass_time(time_us) {
            self.lines.answer(&answer)?;
            self.settle()?;
            if self.now_us() >= time_us {
                break;
            }
        }
        Ok(())
    }

    fn now_us(&self) -> u64 {
        self.bridge.clock().now()
    }

    fn started_us(&self) -> u64 {
        self.bridge.started_us()
    }

    /// Kills QEMU and starts it anew with the same memory.
    fn restart(&mut self) -> Result<()> {
        // Two must not have the memory at once.
        let _ = self.lines.process.0.kill();
        let _ = self.lines.process.0.wait();
        self.bridge.power_on();
        self.lines = Lines::open(&self.machine, &self.folder)?;
        self.settle()
    }

    fn receive(&mut self, role: LinkRole) -> Vec<u8> {
        self.lines.link(role).arrived.drain(..).collect()
    }

    fn send(&mut self, role: LinkRole, bytes: &[u8]) -> Result<()> {
        for piece in bytes.chunks(PIECE) {
            let link = self.lines.link(role);
            link.stream.write_all(piece).map_err(|error| lost(&error))?;
            link.sent = link.sent.wrapping_add(piece.len() as u16);
            self.settle()?;
        }
        Ok(())
    }
}

impl Lines {
    fn open(machine: &Machine, folder: &Folder) -> Result<Self> {
        let [cable, wireless, sensor_bus] = ["cable", "wireless", "bus"].map(|n| folder.listen(n));
        let listeners = [cable?, wireless?, sensor_bus?];
        let devices = listeners.each_ref().map(Listener::device);
        let mut process = machine.start("lockstep", devices.each_ref().map(String::as_str))?;
        let [cable, wireless, sensor_bus] = &listeners;
        Ok(Self {
            links: [
                Link::new(cable.accept(&mut process)?)?,
                Link::new(wireless.accept(&mut process)?)?,
            ],
            sensor_bus: sensor_bus.accept(&mut process)?,
            process,
        })
    }

    fn link(&mut self, role: LinkRole) -> &mut Link {
        let [cable, wireless] = &mut self.links;
        match role {
            LinkRole::Cable => cable,
            _ => wireless,
        }
    }

    /// What the board says of its links once both sides have received everything.
    fn traffic(&self) -> Traffic {
        Traffic {
            received: self.links.each_ref().map(|link| link.sent),
            sent: self.links.each_ref().map(|link| link.received),
        }
    }

    /// Takes what has arrived on the links.
    fn fetch(&mut self) -> Result<()> {
        self.links.iter_mut().try_for_each(Link::fetch)
    }

    fn answer(&mut self, bytes: &[u8]) -> Result<()> {
        let outcome = self.sensor_bus.write_all(bytes);
        outcome.map_err(|error| self.cause(&error))
    }

    /// Waits for bytes from the sensor's UART; none if none come in time.
    fn hear(&mut self, patience: Duration) -> Result<Vec<u8>> {
        match hear(&mut self.sensor_bus, patience) {
            Ok(Some(bytes)) => Ok(bytes),
            Ok(None) => Err(self.cause(&ErrorKind::UnexpectedEof.into())),
            Err(error) => Err(self.cause(&error)),
        }
    }

    /// The cause of a failed line: usually that QEMU has ended.
    fn cause(&mut self, error: &io::Error) -> Problem {
        let start = Instant::now();
        while start.elapsed() < Duration::from_secs(1) {
            if let Some(failure) = self.process.failure() {
                return failure;
            }
            thread::sleep(Duration::from_millis(5));
        }
        lost(error)
    }
}

impl Link {
    fn new(stream: UnixStream) -> Result<Self> {
        stream.set_nonblocking(true).map_err(|error| lost(&error))?;
        Ok(Self { stream, sent: 0, received: 0, arrived: VecDeque::new() })
    }

    fn fetch(&mut self) -> Result<()> {
        let mut bytes = [0; 4096];
        loop {
            match self.stream.read(&mut bytes) {
                Ok(0) => return Err(lost(&ErrorKind::UnexpectedEof.into())),
                Ok(count) => {
                    self.arrived.extend(&bytes[..count]);
                    self.received = self.received.wrapping_add(count as u16);
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(lost(&error)),
            }
        }
    }
}

/// Waits for bytes; none if none come in time, `None` at the line's end.
fn hear(stream: &mut UnixStream, patience: Duration) -> io::Result<Option<Vec<u8>>> {
    let mut bytes = [0; 512];
    stream.set_read_timeout(Some(patience))?;
    match stream.read(&mut bytes) {
        Ok(0) => Ok(None),
        Ok(count) => Ok(Some(bytes[..count].to_vec())),
        Err(error) => match error.kind() {
            ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted => {
                Ok(Some(Vec::new()))
            }
            _ => Err(error),
        },
    }
}

/// Where a link of a [`FreeRunning`] board listens.
#[derive(Clone, Debug)]
pub enum Listen {
    /// A TCP port. It takes megabytes that nobody reads: there a link never looks slow.
    Tcp(SocketAddr),
    /// A Unix socket. It takes a few hundred bytes that nobody reads, as a serial port does: the
    /// board then waits.
    Unix(PathBuf),
}

impl From<SocketAddr> for Listen {
    fn from(address: SocketAddr) -> Self {
        Self::Tcp(address)
    }
}

impl Listen {
    /// The value of QEMU's option.
    fn device(&self) -> String {
        let place = match self {
            Self::Tcp(address) => {
                format!("host={},port={},nodelay=on", address.ip(), address.port())
            }
            Self::Unix(path) => format!("path={}", escaped(path)),
        };
        format!("{place},server=on,wait=off")
    }
}

/// A board in QEMU in real time behind two sockets, for any host that speaks the wire: its time
/// is that of the machine's timers, its sensor's that of this computer.
pub struct FreeRunning {
    bridge: Bridge,
    sensor_bus: UnixStream,
    started: Instant,
    process: Process,
    _folder: Folder,
}

impl FreeRunning {
    /// Puts power on a board whose sensor takes its samples from `source`, and whose links listen
    /// at `cable` and `wireless`. Each takes one client at a time; what the board says while
    /// nobody listens is lost.
    ///
    /// # Errors
    /// When QEMU is missing or ends, as it does when an address cannot be listened on.
    pub fn start(
        machine: &Machine,
        source: impl Source + 'static,
        cable: impl Into<Listen>,
        wireless: impl Into<Listen>,
    ) -> Result<Self> {
        let folder = Folder::new()?;
        let listener = folder.listen("bus")?;
        let devices = [cable.into().device(), wireless.into().device(), listener.device()];
        let mut process = machine.start("free-running", devices.each_ref().map(String::as_str))?;
        Ok(Self {
            bridge: machine.bridge(source),
            sensor_bus: listener.accept(&mut process)?,
            started: Instant::now(),
            process,
            _folder: folder,
        })
    }

    /// The sensor, to break it.
    pub fn sensor(&self) -> &Sensor {
        self.bridge.sensor()
    }

    /// Plays the sensor until `stop` returns true, which is asked many times a second.
    ///
    /// # Errors
    /// When QEMU has ended.
    pub fn run(&mut self, mut stop: impl FnMut() -> bool) -> Result<()> {
        while !stop() {
            let heard = hear(&mut self.sensor_bus, GLANCE);
            self.bridge.clock().advance_to(self.started.elapsed().as_micros() as u64);
            let outcome = match heard {
                Ok(Some(bytes)) => self.sensor_bus.write_all(&self.bridge.receive(&bytes)),
                Ok(None) => Err(ErrorKind::UnexpectedEof.into()),
                Err(error) => Err(error),
            };
            if let Err(error) = outcome {
                // Its exit code comes a moment after its lines end.
                thread::sleep(Duration::from_millis(200));
                // Ctrl-C in a terminal ends it too.
                if stop() {
                    break;
                }
                return Err(self.process.failure().unwrap_or_else(|| lost(&error)));
            }
        }
        Ok(())
    }
}
