//! A simulated board in real time behind two TCP ports.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread;
use std::time::{Duration, Instant};

use wimu_link::LinkRole;

use crate::board::Board;

/// Bytes held for a slow client; beyond, the board's writer stalls and it sheds frames.
const HELD_BYTES: usize = 4096;
/// Longest interval between looks at the links.
const TICK: Duration = Duration::from_millis(1);
/// Longest run of the board between looks, in its own time.
const STEP_US: u64 = 5000;
/// Bytes that follow each other within this are written together.
const TOGETHER: Duration = Duration::from_micros(250);
/// Number of bytes that are written at once.
const FEW_BYTES: usize = 512;
/// A client that accepts nothing for this long is slow.
const WRITE_PATIENCE: Duration = Duration::from_millis(1);
/// A second client is refused after this time: on a busy machine the end of the first is noticed late.
const GRACE: Duration = Duration::from_millis(100);

/// A board behind TCP ports. Each port accepts one client at a time, like a serial port; data
/// sent without a client are lost.
///
/// Bytes are forwarded at their own time, not in fixed intervals, so that the link has the delays of its
/// faults.
pub struct Server {
    board: Board,
    cable: Port,
    wireless: Port,
    /// Board seconds per second.
    speed: f64,
    started: Option<Instant>,
    wait_for_client: bool,
    heard: Receiver<Heard>,
    hear: Sender<Heard>,
}

/// Data of a client; empty when it has disconnected.
struct Heard {
    role: LinkRole,
    /// Number of the port's client.
    client: u64,
    bytes: Vec<u8>,
}

impl Server {
    /// Connects `board` to `cable` and `wireless`; port 0 takes any free one.
    ///
    /// # Errors
    /// When an address cannot be used, with the address.
    pub fn bind(
        board: Board,
        cable: SocketAddr,
        wireless: SocketAddr,
    ) -> Result<Self, (SocketAddr, io::Error)> {
        let listen = |address, role| Port::bind(address, role).map_err(|error| (address, error));
        let (hear, heard) = mpsc::channel();
        Ok(Self {
            board,
            cable: listen(cable, LinkRole::Cable)?,
            wireless: listen(wireless, LinkRole::Wireless)?,
            speed: 1.0,
            started: None,
            wait_for_client: false,
            heard,
            hear,
        })
    }

    /// Runs the board `speed` times as fast as real time. A faster board waits for a
    /// slow client, so that the received data do not depend on the speed of this machine.
    #[must_use]
    pub fn at_speed(mut self, speed: f64) -> Self {
        self.speed = speed;
        self
    }

    /// Starts the board's time when the first client connects.
    #[must_use]
    pub fn waiting_for_client(mut self) -> Self {
        self.wait_for_client = true;
        self
    }

    /// The address of a link.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn address(&self, role: LinkRole) -> io::Result<SocketAddr> {
        match role {
            LinkRole::Cable => self.cable.listener.local_addr(),
            _ => self.wireless.listener.local_addr(),
        }
    }

    /// The board.
    pub fn board(&mut self) -> &mut Board {
        &mut self.board
    }

    /// Runs until `stop` returns true; it is called at least a thousand times a second, and at
    /// least every 5 ms of the board's own time.
    pub fn run(&mut self, mut stop: impl FnMut(&mut Board) -> bool) {
        while !stop(&mut self.board) && !self.tick(&mut stop) {
            self.wait();
        }
        // Deliver data under way.
        let deadline = Instant::now() + Duration::from_secs(1);
        while Instant::now() < deadline && (self.cable.owes() || self.wireless.owes()) {
            self.tick(&mut |_| false);
            self.wait();
        }
    }

    /// The start from which the board would have run as far as it has.
    fn started_if_on_time(&self) -> Option<Instant> {
        let ran = self.board.now_us() as f64 * 1e-6 / self.speed;
        Instant::now().checked_sub(Duration::from_secs_f64(ran))
    }

    /// Waits for data of a client, or until the board has something to do or to send.
    fn wait(&mut self) {
        let Some(started) = self.started else {
            return thread::sleep(TICK);
        };
        let at =
            |time_us: u64| started + Duration::from_secs_f64(time_us as f64 * 1e-6 / self.speed);
        let now = Instant::now();
        let mut until = now + TICK;
        // A faster board is always busy, and its delays are not measured.
        let is_punctual = self.speed <= 1.0;
        if let Some(time_us) = self.board.next_deadline_us().filter(|_| is_punctual) {
            until = until.min(at(time_us));
        }
        for port in [&self.cable, &self.wireless] {
            let Some(client) = port.client.as_ref().filter(|_| is_punctual) else {
                continue;
            };
            let arrives = if port.outgoing.is_empty() {
                self.board.link(port.role).next_arrival_us().map(at)
            } else {
                Some(now)
            };
            if let Some(arrives) = arrives {
                until = until.min(arrives.max(client.written + TOGETHER));
            }
        }
        if let Ok(heard) = self.heard.recv_timeout(until.saturating_duration_since(now)) {
            self.take(heard);
        }
    }

    fn take(&mut self, heard: Heard) {
        match heard.role {
            LinkRole::Cable => self.cable.take(heard),
            _ => self.wireless.take(heard),
        }
    }

    /// Forwards data and runs the board up to the present, or until `stop` returns true; returns whether
    /// it did.
    fn tick(&mut self, stop: &mut impl FnMut(&mut Board) -> bool) -> bool {
        // First, so that a disconnected client makes room for the next.
        while let Ok(heard) = self.heard.try_recv() {
            self.take(heard);
        }
        for port in [&mut self.cable, &mut self.wireless] {
            port.follow_connection(&mut self.board);
            port.accept(&self.hear);
            port.fetch(&mut self.board);
        }
        let connected = self.cable.client.is_some() || self.wireless.client.is_some();
        if self.started.is_none() && (connected || !self.wait_for_client) {
            self.started = self.started_if_on_time();
        }
        let mut stopped = false;
        if let Some(started) = self.started {
            let now_us = (started.elapsed().as_secs_f64() * self.speed * 1e6) as u64;
            // In small steps, so that a fast board's links are emptied in between.
            while !stopped && self.board.now_us() < now_us {
                if self.speed > 1.0 && (self.cable.is_slow() || self.wireless.is_slow()) {
                    self.started = self.started_if_on_time();
                    break;
                }
                let step = (self.board.now_us() + STEP_US).min(now_us);
                self.board.run_until(step);
                for port in [&mut self.cable, &mut self.wireless] {
                    port.fetch(&mut self.board);
                }
                stopped = stop(&mut self.board);
            }
        }
        for port in [&mut self.cable, &mut self.wireless] {
            port.deliver(&mut self.board);
        }
        // It has received the data, and updates its next deadline.
        self.board.run_until(self.board.now_us());
        stopped
    }
}

struct Port {
    role: LinkRole,
    listener: TcpListener,
    client: Option<Connected>,
    /// A client that came while `client` was connected, and when.
    waiting: Option<(TcpStream, Instant)>,
    /// Number of clients so far.
    clients: u64,
    /// Time of the last look for a client.
    looked: Instant,
    /// Number of the board's connection that the client uses.
    connection: Option<u64>,
    incoming: Vec<u8>,
    outgoing: VecDeque<u8>,
}

/// A client.
struct Connected {
    stream: TcpStream,
    /// Time of the last write.
    written: Instant,
    /// Whether the last write of this tick was not accepted.
    is_slow: bool,
}

impl Drop for Connected {
    /// Ends its receiver thread, too.
    fn drop(&mut self) {
        let _ = self.stream.shutdown(Shutdown::Both);
    }
}

impl Port {
    fn bind(address: SocketAddr, role: LinkRole) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        Ok(Self {
            role,
            listener,
            client: None,
            waiting: None,
            clients: 0,
            looked: Instant::now(),
            connection: Some(0),
            incoming: Vec::new(),
            outgoing: VecDeque::new(),
        })
    }

    fn owes(&self) -> bool {
        self.client.is_some() && !self.outgoing.is_empty()
    }

    /// Whether its client did not accept the last write of this tick.
    fn is_slow(&self) -> bool {
        self.client.as_ref().is_some_and(|client| client.is_slow)
    }

    /// Disconnects the client when the board's link is disconnected.
    fn follow_connection(&mut self, board: &mut Board) {
        let connection = board.link(self.role).connection();
        if connection != self.connection {
            self.connection = connection;
            self.client = None;
        }
    }

    /// Accepts a client if there is none; rejects a second one, and any while the link is
    /// disconnected.
    fn accept(&mut self, hear: &Sender<Heard>) {
        if let Some(client) = &mut self.client {
            client.is_slow = false;
        }
        if self.looked.elapsed() < TICK {
            return;
        }
        self.looked = Instant::now();
        if self.waiting.is_none() {
            let accepted = self.listener.accept().ok();
            self.waiting = accepted.map(|(stream, _)| (stream, self.looked));
        }
        let free = self.client.is_none();
        let decided = |(_, since): &mut (_, Instant)| free || since.elapsed() >= GRACE;
        if let Some((stream, _)) = self.waiting.take_if(decided)
            && free
            && self.connection.is_some()
            && let Ok(ear) = stream.try_clone()
            && stream.set_nonblocking(false).is_ok()
            && stream.set_write_timeout(Some(WRITE_PATIENCE)).is_ok()
            && stream.set_nodelay(true).is_ok()
        {
            self.outgoing.clear();
            self.clients += 1;
            let (role, client, hear) = (self.role, self.clients, hear.clone());
            thread::spawn(move || listen(ear, role, client, &hear));
            self.client = Some(Connected { stream, written: self.looked, is_slow: false });
        }
    }

    /// Takes data of a client, if it is still the port's.
    fn take(&mut self, heard: Heard) {
        if heard.client != self.clients || self.client.is_none() {
        } else if heard.bytes.is_empty() {
            self.client = None;
        } else {
            self.incoming.extend(heard.bytes);
        }
    }

    /// Passes received data to the board after it has run up to the present, so that it does not receive too early.
    fn deliver(&mut self, board: &mut Board) {
        if !self.incoming.is_empty() {
            board.link(self.role).push(&self.incoming);
            self.incoming.clear();
        }
    }

    fn fetch(&mut self, board: &mut Board) {
        let Some(client) = &mut self.client else {
            self.outgoing.clear();
            board.link(self.role).pull();
            return;
        };
        if self.outgoing.len() < HELD_BYTES {
            self.outgoing.extend(board.link(self.role).pull());
        }
        let waits = client.written.elapsed() < TOGETHER && self.outgoing.len() < FEW_BYTES;
        if client.is_slow || waits {
            return;
        }
        while !self.outgoing.is_empty() {
            let (front, _) = self.outgoing.as_slices();
            client.written = Instant::now();
            match client.stream.write(front) {
                Ok(count) if count > 0 => {
                    self.outgoing.drain(..count);
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error)
                    if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) =>
                {
                    client.is_slow = true;
                    return;
                }
                _ => {
                    self.client = None;
                    return;
                }
            }
        }
    }
}

/// Forwards the data of a client, and its end.
fn listen(mut stream: TcpStream, role: LinkRole, client: u64, hear: &Sender<Heard>) {
    let mut bytes = [0; 1024];
    loop {
        let count = match stream.read(&mut bytes) {
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            outcome => outcome.unwrap_or(0),
        };
        let heard = Heard { role, client, bytes: bytes[..count].to_vec() };
        if hear.send(heard).is_err() || count == 0 {
            return;
        }
    }
}
