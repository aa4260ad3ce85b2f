//! A simulated board in real time behind two TCP ports, for any host that speaks the wire.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

use wimu_link::LinkRole;

use crate::board::Board;

/// Bytes held for a client that reads slowly; beyond, the board's writer stalls and it sheds.
const HELD_BYTES: usize = 4096;
/// How often bytes are carried.
const TICK: Duration = Duration::from_millis(1);
/// The board runs for at most so long, by its own clock, before it is looked at.
const STEP_US: u64 = 5000;

/// A board that listens. Each port takes one client at a time, as a serial port does; what the
/// board says while nobody listens is lost.
pub struct Server {
    board: Board,
    cable: Port,
    wireless: Port,
    /// Board seconds per second.
    speed: f64,
    started: Option<Instant>,
    wait_for_client: bool,
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
        Ok(Self {
            board,
            cable: listen(cable, LinkRole::Cable)?,
            wireless: listen(wireless, LinkRole::Wireless)?,
            speed: 1.0,
            started: None,
            wait_for_client: false,
        })
    }

    /// Lets the board's time run `speed` times as fast.
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

    /// Serves until `stop` returns true; it sees the board a thousand times a second, and however late that
    /// is, every 5 ms of the board's own time.
    pub fn run(&mut self, mut stop: impl FnMut(&mut Board) -> bool) {
        while !stop(&mut self.board) && !self.tick(&mut stop) {
            std::thread::sleep(TICK);
        }
        // What was on its way is delivered.
        let deadline = Instant::now() + Duration::from_secs(1);
        while Instant::now() < deadline && (self.cable.owes() || self.wireless.owes()) {
            self.tick(&mut |_| false);
            std::thread::sleep(TICK);
        }
    }

    /// Carries what has arrived and lets the board catch up with the time, or until `stop` says so; whether
    /// it does.
    fn tick(&mut self, stop: &mut impl FnMut(&mut Board) -> bool) -> bool {
        for port in [&mut self.cable, &mut self.wireless] {
            // First, so that a client that has gone makes room for the next.
            port.follow_connection(&mut self.board);
            port.listen();
            port.accept();
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
        stopped
    }
}

struct Port {
    role: LinkRole,
    listener: TcpListener,
    client: Option<TcpStream>,
    /// The board's connection that the client has.
    connection: Option<u64>,
    incoming: Vec<u8>,
    outgoing: VecDeque<u8>,
}

impl Port {
    fn bind(address: SocketAddr, role: LinkRole) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        Ok(Self {
            role,
            listener,
            client: None,
            connection: Some(0),
            incoming: Vec::new(),
            outgoing: VecDeque::new(),
        })
    }

    fn owes(&self) -> bool {
        self.client.is_some() && !self.outgoing.is_empty()
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
    fn accept(&mut self) {
        if let Ok((client, _)) = self.listener.accept()
            && self.client.is_none()
            && self.connection.is_some()
            && client.set_nonblocking(true).is_ok()
            && client.set_nodelay(true).is_ok()
        {
            self.outgoing.clear();
            self.client = Some(client);
        }
    }

    /// Takes what the client has sent.
    fn listen(&mut self) {
        let mut bytes = [0; 1024];
        loop {
            let Some(client) = &mut self.client else {
                return;
            };
            match client.read(&mut bytes) {
                Ok(0) => self.client = None,
                Ok(count) => self.incoming.extend_from_slice(&bytes[..count]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => self.client = None,
            }
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
        if self.client.is_none() {
            self.outgoing.clear();
            board.link(self.role).pull();
            return;
        }
        if self.outgoing.len() < HELD_BYTES {
            self.outgoing.extend(board.link(self.role).pull());
        }
        while !self.outgoing.is_empty() {
            let Some(client) = &mut self.client else {
                return;
            };
            let (front, _) = self.outgoing.as_slices();
            match client.write(front) {
                Ok(0) => self.client = None,
                Ok(count) => {
                    self.outgoing.drain(..count);
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => self.client = None,
            }
        }
    }
}
