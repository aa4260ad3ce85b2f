//! A simulated board in real time behind two TCP ports, for any host that speaks the wire.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread;
use std::time::{Duration, Instant};

use wimu_link::LinkRole;

use crate::board::Board;

/// Bytes held for a client that reads slowly; beyond, the board's writer stalls and it sheds.
const HELD_BYTES: usize = 4096;
/// How often somebody looks at least.
const TICK: Duration = Duration::from_millis(1);
/// The board runs for at most so long, by its own clock, before it is looked at.
const STEP_US: u64 = 5000;
/// Bytes that come one after the other are written together if no farther apart than this.
const TOGETHER: Duration = Duration::from_micros(250);
/// And no more than these.
const FEW_BYTES: usize = 512;
/// A client that takes nothing for so long reads slowly.
const WRITE_PATIENCE: Duration = Duration::from_millis(1);
/// A client that comes while another is there is turned away after this time: on a busy machine the end
/// of the one before is noticed a little later.
const GRACE: Duration = Duration::from_millis(100);

/// A board that listens. Each port takes one client at a time, as a serial port does; what the
/// board says while nobody listens is lost.
///
/// Bytes pass at their own time, not at that of a look now and then: the link's delays are to be
/// those of its faults, and as sharp.
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

/// What a client has sent, or nothing: it has gone.
struct Heard {
    role: LinkRole,
    /// Which of the port's clients.
    client: u64,
    bytes: Vec<u8>,
}

impl Server {
    /// Puts `board` behind `cable` and `wireless`; port 0 takes any free one.
    ///
    /// # Errors
    /// When an address cannot be listened on, with the address.
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

    /// Lets the board's time run `speed` times as fast. A board that runs faster than the clock waits for a
    /// client that reads slowly, so that what arrives does not depend on the speed of this machine.
    #[must_use]
    pub fn at_speed(mut self, speed: f64) -> Self {
        self.speed = speed;
        self
    }

    /// Lets the board's time begin when the first client connects.
    #[must_use]
    pub fn waiting_for_client(mut self) -> Self {
        self.wait_for_client = true;
        self
    }

    /// The address of a link.
    ///
    /// # Errors
    /// What the operating system says.
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

    /// Serves until `stop` returns true; it sees the board a thousand times a second and more, and however
    /// late that is, every 5 ms of the board's own time.
    pub fn run(&mut self, mut stop: impl FnMut(&mut Board) -> bool) {
        while !stop(&mut self.board) && !self.tick(&mut stop) {
            self.wait();
        }
        // What was on its way is delivered.
        let deadline = Instant::now() + Duration::from_secs(1);
        while Instant::now() < deadline && (self.cable.owes() || self.wireless.owes()) {
            self.tick(&mut |_| false);
            self.wait();
        }
    }

    /// Waits for a client's bytes, or until the board has something to do or to say.
    fn wait(&mut self) {
        let Some(started) = self.started else {
            return thread::sleep(TICK);
        };
        let at =
            |time_us: u64| started + Duration::from_secs_f64(time_us as f64 * 1e-6 / self.speed);
        let now = Instant::now();
        let mut until = now + TICK;
        // A faster board would be up all the time: it has more to do, and nobody measures its delays.
        let is_punctual = self.speed <= 1.0;
        if let Some(time_us) = self.board.next_deadline_us().filter(|_| is_punctual) {
            until = until.min(at(time_us));
        }
        for port in [&self.cable, &self.wireless] {
            let Some(client) = port.client.as_ref().filter(|_| is_punctual) else {
                continue;
            };
            let arrives = match port.outgoing.is_empty() {
                true => self.board.link(port.role).next_arrival_us().map(at),
                false => Some(now),
            };
            if let Some(arrives) = arrives {
                until = until.min(arrives.max(client.written + TOGETHER));
            }
        }
        if let Ok(heard) = self
            .heard
            .recv_timeout(until.saturating_duration_since(now))
        {
            self.take(heard);
        }
    }

    fn take(&mut self, heard: Heard) {
        match heard.role {
            LinkRole::Cable => self.cable.take(heard),
            _ => self.wireless.take(heard),
        }
    }

    /// Carries what has arrived and lets the board catch up with the time, or until `stop` says so; whether
    /// it does.
    fn tick(&mut self, stop: &mut impl FnMut(&mut Board) -> bool) -> bool {
        // First, so that a client that has gone makes room for the next.
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
            self.started = Some(Instant::now());
        }
        let mut stopped = false;
        if let Some(started) = self.started {
            let now_us = (started.elapsed().as_secs_f64() * self.speed * 1e6) as u64;
            // In small steps, so that a fast board's links are emptied in between.
            while !stopped && self.board.now_us() < now_us {
                if self.speed > 1.0 && (self.cable.is_slow() || self.wireless.is_slow()) {
                    let ran = self.board.now_us() as f64 * 1e-6 / self.speed;
                    self.started = Instant::now().checked_sub(Duration::from_secs_f64(ran));
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
        // It has heard that, and says when it has something to do.
        self.board.run_until(self.board.now_us());
        stopped
    }
}

struct Port {
    role: LinkRole,
    listener: TcpListener,
    client: Option<Connected>,
    /// One that came while `client` was there, and when.
    waiting: Option<(TcpStream, Instant)>,
    /// Clients so far.
    clients: u64,
    /// When it last looked for one.
    looked: Instant,
    /// The board's connection that the client has.
    connection: Option<u64>,
    incoming: Vec<u8>,
    outgoing: VecDeque<u8>,
}

/// A client.
struct Connected {
    stream: TcpStream,
    /// When it was last written to.
    written: Instant,
    /// Whether it took nothing the last time in this tick.
    is_slow: bool,
}

impl Drop for Connected {
    /// Ends its listener, too.
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

    /// Whether its client took nothing the last time in this tick.
    fn is_slow(&self) -> bool {
        self.client.as_ref().is_some_and(|client| client.is_slow)
    }

    /// Hangs up when the board's link is disconnected.
    fn follow_connection(&mut self, board: &mut Board) {
        let connection = board.link(self.role).connection();
        if connection != self.connection {
            self.connection = connection;
            self.client = None;
        }
    }

    /// Takes a client if there is none; turns a second one away, and any while the link is
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
            self.client = Some(Connected {
                stream,
                written: self.looked,
                is_slow: false,
            });
        }
    }

    /// Takes what a client has sent, if it is still the port's.
    fn take(&mut self, heard: Heard) {
        if heard.client != self.clients || self.client.is_none() {
        } else if heard.bytes.is_empty() {
            self.client = None;
        } else {
            self.incoming.extend(heard.bytes);
        }
    }

    /// Gives it to the board, whose time has caught up by now: it must not hear before it is asked.
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

/// Tells what a client sends, and when it has gone.
fn listen(mut stream: TcpStream, role: LinkRole, client: u64, hear: &Sender<Heard>) {
    let mut bytes = [0; 1024];
    loop {
        let count = match stream.read(&mut bytes) {
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            outcome => outcome.unwrap_or(0),
        };
        let heard = Heard {
            role,
            client,
            bytes: bytes[..count].to_vec(),
        };
        if hear.send(heard).is_err() || count == 0 {
            return;
        }
    }
}
