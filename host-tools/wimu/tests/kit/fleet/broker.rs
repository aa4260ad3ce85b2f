//! The broker, a foreign client of it, and a slow line to it.

use std::collections::VecDeque;
use std::fs;
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use crate::kit::{folder, wait_until};

/// A Mosquitto of Debian on a free port of this machine.
pub struct Mosquitto {
    pub port: u16,
    folder: tempfile::TempDir,
    child: Option<Child>,
}

impl Mosquitto {
    /// Starts it.
    pub fn start() -> Self {
        let mut broker = Self { port: free_port(), folder: folder(), child: None };
        broker.restart();
        broker
    }

    pub fn url(&self) -> String {
        format!("mqtt://127.0.0.1:{}", self.port)
    }

    fn log(&self) -> PathBuf {
        self.folder.path().join("log")
    }

    /// Ids of the clients that have connected, in their order.
    pub fn clients(&self) -> Vec<String> {
        let log = fs::read_to_string(self.log()).expect("a log");
        let ids = log.lines().filter_map(|line| {
            let (_, rest) = line.split_once("New client connected from ")?;
            Some(rest.split_once(" as ")?.1.split_whitespace().next()?.to_owned())
        });
        ids.collect()
    }

    pub fn pid(&self) -> u32 {
        self.child.as_ref().expect("it runs").id()
    }

    /// Kills it, without notice to its clients.
    pub fn kill(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }

    /// Starts it again, with nothing of before.
    pub fn restart(&mut self) {
        self.kill();
        let file = self.folder.path().join("mosquitto.conf");
        let text = format!(
            "listener {} 127.0.0.1\nallow_anonymous true\npersistence false\nsys_interval 1\n\
             max_inflight_messages 1000\nmax_queued_messages 100000\nset_tcp_nodelay true\n",
            self.port
        );
        fs::write(&file, text).expect("written");
        let log = fs::File::create(self.log()).expect("a file");
        let child = Command::new(installed())
            .arg("-c")
            .arg(&file)
            .stdout(Stdio::null())
            .stderr(log)
            .spawn();
        self.child = Some(child.expect("mosquitto"));
        let address = SocketAddr::from(([127, 0, 0, 1], self.port));
        wait_until("the broker", || TcpStream::connect(address).is_ok());
    }
}

impl Drop for Mosquitto {
    fn drop(&mut self) {
        self.kill();
    }
}

fn installed() -> &'static str {
    let paths = ["/usr/sbin/mosquitto", "/usr/bin/mosquitto"];
    let found = paths.into_iter().find(|path| Path::new(path).exists());
    found.expect("Mosquitto is missing: cargo xtask setup")
}

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0")
        .and_then(|listener| listener.local_addr())
        .expect("a port")
        .port()
}

/// A line to a server that delays both directions, and can be cut.
pub struct SlowLine {
    pub port: u16,
    cuts: Arc<AtomicU64>,
}

impl SlowLine {
    pub fn to(port: u16, delay: Duration) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let own = listener.local_addr().expect("bound").port();
        let cuts = Arc::new(AtomicU64::new(0));
        let shared = cuts.clone();
        thread::spawn(move || {
            for client in listener.incoming() {
                let (Ok(client), Ok(server)) = (client, TcpStream::connect(("127.0.0.1", port)))
                else {
                    continue;
                };
                for (from, to) in [(&client, &server), (&server, &client)] {
                    let (from, to) =
                        (from.try_clone().expect("a stream"), to.try_clone().expect("a stream"));
                    let _ = to.set_nodelay(true);
                    let cuts = shared.clone();
                    thread::spawn(move || delayed(from, to, delay, &cuts));
                }
            }
        });
        Self { port: own, cuts }
    }

    /// Cuts all connections.
    pub fn cut(&self) {
        self.cuts.fetch_add(1, Ordering::Relaxed);
    }
}

fn delayed(mut from: TcpStream, mut to: TcpStream, delay: Duration, cuts: &AtomicU64) {
    let before = cuts.load(Ordering::Relaxed);
    let mut under_way: VecDeque<(Instant, Vec<u8>)> = VecDeque::new();
    let _ = from.set_read_timeout(Some(Duration::from_millis(5)));
    let mut room = vec![0; 1 << 16];
    let mut ended = false;
    while cuts.load(Ordering::Relaxed) == before && !(ended && under_way.is_empty()) {
        match from.read(&mut room) {
            Ok(0) => ended = true,
            Ok(count) => under_way.push_back((Instant::now() + delay, room[..count].to_vec())),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_) => ended = true,
        }
        while under_way.front().is_some_and(|(due, _)| *due <= Instant::now()) {
            let (_, bytes) = under_way.pop_front().expect("there is one");
            if to.write_all(&bytes).is_err() {
                ended = true;
                under_way.clear();
            }
        }
    }
    let _ = from.shutdown(Shutdown::Both);
    let _ = to.shutdown(Shutdown::Both);
}

/// A connection to the broker as a foreign client with an id.
pub struct Foreign(TcpStream);

impl Foreign {
    pub fn connect(port: u16, id: &str) -> Self {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("the broker");
        let connect = [&field("MQTT")[..], &[4, 2, 0, 60], &field(id)].concat();
        stream.write_all(&packet(0x10, &connect)).expect("connected");
        stream.read_exact(&mut [0; 4]).expect("accepted");
        Self(stream)
    }

    /// Publishes a retained message of any length.
    pub fn publish(&mut self, topic: &str, payload: &[u8]) {
        let publish = packet(0x31, &[&field(topic), payload].concat());
        self.0.write_all(&publish).expect("published");
        // It has read all when it answers a ping.
        self.0.write_all(&[0xc0, 0]).expect("a ping");
        self.0.read_exact(&mut [0; 2]).expect("an answer");
    }

    /// Whether the broker ends the connection within a time.
    pub fn is_ended_within(&mut self, time: Duration) -> bool {
        self.0.set_read_timeout(Some(time)).expect("a socket");
        matches!(self.0.read(&mut [0; 16]), Ok(0))
    }
}

fn field(text: &str) -> Vec<u8> {
    [&(text.len() as u16).to_be_bytes()[..], text.as_bytes()].concat()
}

fn packet(kind: u8, content: &[u8]) -> Vec<u8> {
    let mut out = vec![kind];
    let mut length = content.len();
    while length >= 128 {
        out.push(length as u8 | 128);
        length >>= 7;
    }
    out.push(length as u8);
    [&out[..], content].concat()
}
