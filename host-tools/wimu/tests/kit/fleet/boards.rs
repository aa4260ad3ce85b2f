//! Replayed boards. Each sends what one simulated board has sent: real frames with its sequence numbers and times. It has an
//! own device id and answers who it is and what time it has, and nothing else.

use std::collections::VecDeque;
use std::fmt::Write as _;
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use wimu_link::message::{Answer, Command, Payload, Reply, Signature};
use wimu_link::{Deframer, Frame, Hello, Kind, MAX_FRAME, Request};
use wimu_sim::faults::{Channel, LinkFaults};

use super::Tape;

/// Replayed boards, each at a TCP port of this machine.
pub struct Boards {
    pub links: Vec<String>,
    /// Bytes that a board wrote to its link.
    pub sent: Arc<AtomicU64>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Boards {
    /// `count` boards; every fifth has `faults` on its line.
    pub fn start(tape: &Arc<Tape>, count: usize, faults: Option<&str>) -> Self {
        let listeners: Vec<_> =
            (0..count).map(|_| TcpListener::bind("127.0.0.1:0").expect("a port")).collect();
        let links = listeners
            .iter()
            .map(|listener| format!("tcp://{}", listener.local_addr().expect("bound")))
            .collect();
        let faults: Option<LinkFaults> = faults.map(|text| text.parse().expect("faults"));
        let (stop, sent) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
        let begun = Instant::now();
        let mut boards: Vec<_> = listeners
            .into_iter()
            .enumerate()
            .map(|(index, listener)| {
                listener.set_nonblocking(true).expect("a listener");
                let channel = faults
                    .as_ref()
                    .filter(|_| index % 5 == 4)
                    .map(|faults| Channel::new(faults, index as u64));
                Replayed::new(tape.clone(), index, listener, channel)
            })
            .collect();
        let second = boards.split_off(count / 2);
        let threads = [boards, second].into_iter().map(|mut boards| {
            let (stop, sent) = (stop.clone(), sent.clone());
            thread::spawn(move || {
                let mut tick = 0u32;
                while !stop.load(Ordering::Relaxed) {
                    let at = Instant::now();
                    for board in &mut boards {
                        sent.fetch_add(board.tick(begun.elapsed(), tick) as u64, Ordering::Relaxed);
                    }
                    tick += 1;
                    thread::sleep(Duration::from_millis(20).saturating_sub(at.elapsed()));
                }
            })
        });
        let threads = threads.collect();
        Self { links, sent, stop, threads }
    }

    /// The configuration of a gateway of these boards.
    pub fn config(&self, broker: &str, more: &str) -> String {
        let mut text = format!("fleet = \"hall\"\nbroker = \"{broker}\"\n{more}\n[boards]\n");
        for (index, link) in self.links.iter().enumerate() {
            let _ = writeln!(text, "{} = \"{link}\"", name(index));
        }
        text
    }
}

impl Drop for Boards {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.threads.drain(..).for_each(|thread| drop(thread.join()));
    }
}

pub fn name(index: usize) -> String {
    format!("board-{index:04}")
}

/// One replayed board.
struct Replayed {
    tape: Arc<Tape>,
    id: u64,
    /// Delay of its begin, so that not all send at once.
    phase: Duration,
    listener: TcpListener,
    client: Option<TcpStream>,
    channel: Option<Channel>,
    next: usize,
    outgoing: VecDeque<u8>,
    deframer: Deframer,
}

impl Replayed {
    fn new(tape: Arc<Tape>, index: usize, listener: TcpListener, channel: Option<Channel>) -> Self {
        Self {
            tape,
            id: 0xf1ee_7000_0000 + index as u64,
            phase: Duration::from_micros(index as u64 * 7919 % 160_000),
            listener,
            client: None,
            channel,
            next: 0,
            outgoing: VecDeque::new(),
            deframer: Deframer::new(),
        }
    }

    /// Runs up to the present; returns the bytes written.
    fn tick(&mut self, time: Duration, tick: u32) -> usize {
        let time = time.saturating_sub(self.phase);
        if self.client.is_none() && tick.is_multiple_of(5) {
            self.accept();
        }
        let mut line = self.answers(time);
        let frames = self.tape.frames[self.next..].iter();
        for (_, bytes) in frames.take_while(|(at_us, _)| u128::from(*at_us) <= time.as_micros()) {
            line.extend(bytes);
            self.next += 1;
        }
        if self.client.is_none() {
            self.outgoing.clear();
            return 0;
        }
        match &mut self.channel {
            Some(channel) => {
                let now_ns = time.as_nanos() as u64;
                channel.push(now_ns, &line);
                self.outgoing.extend(channel.pull(now_ns, usize::MAX));
            }
            None => self.outgoing.extend(line),
        }
        self.send()
    }

    fn accept(&mut self) {
        if let Ok((stream, _)) = self.listener.accept()
            && stream.set_nonblocking(true).is_ok()
            && stream.set_nodelay(true).is_ok()
        {
            self.client = Some(stream);
            self.deframer = Deframer::new();
        }
    }

    /// Answers to what has arrived.
    fn answers(&mut self, time: Duration) -> Vec<u8> {
        let mut line = Vec::new();
        let mut room = [0; 1024];
        let Some(client) = &mut self.client else {
            return line;
        };
        match client.read(&mut room) {
            Ok(0) => self.client = None,
            Ok(count) => {
                let uptime_us = self.tape.begin_us + time.as_micros() as u64;
                let hello = Hello { device_id: self.id, uptime_us, ..self.tape.hello };
                for &byte in &room[..count] {
                    if let Some(Ok(frame)) = self.deframer.push(byte) {
                        let mut out = [0; MAX_FRAME];
                        let length = answer(&frame, &hello, &mut out);
                        line.extend(&out[..length]);
                    }
                }
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(_) => self.client = None,
        }
        line
    }

    fn send(&mut self) -> usize {
        let mut written = 0;
        while let Some(client) = self.client.as_mut().filter(|_| !self.outgoing.is_empty()) {
            match client.write(self.outgoing.as_slices().0) {
                Ok(count) => {
                    written += count;
                    self.outgoing.drain(..count);
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(_) => self.client = None,
            }
        }
        // A slow client is like a full buffer of a board: whole frames are lost, which the numbers show.
        if self.outgoing.len() > 1 << 16 {
            self.client = None;
        }
        written
    }
}

/// Writes the answer of a board to a frame; returns its length.
fn answer(frame: &Frame, hello: &Hello, out: &mut [u8; MAX_FRAME]) -> usize {
    let time: Payload = Payload::Time { uptime_us: hello.uptime_us };
    match (frame.kind, Request::decode(frame.body)) {
        (Kind::WhoAreYou, _) => hello.encode(out).expect("room"),
        (Kind::Request, Ok(request)) if matches!(request.command, Command::GetTime) => Reply {
            session: request.session,
            id: request.id,
            signature: Signature::NONE,
            answer: Answer::Accepted(time),
        }
        .encode(out)
        .expect("room"),
        _ => 0,
    }
}
