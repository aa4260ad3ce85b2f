//! A serial link between the simulated device and its host, with bounded buffers and, optionally,
//! a baud rate and faults.

use std::cell::{RefCell, RefMut};
use std::collections::VecDeque;
use std::convert::Infallible;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::{Poll, Waker};

use embedded_io_async::{ErrorType, Read, Write};

use crate::clock::VirtualClock;
use crate::faults::{Channel, LinkFaults};

/// Bits per byte times ns per second.
const BITS_PER_BYTE_NS: u64 = 10_000_000_000;

/// Properties of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinkConfig {
    /// Baud rate in each direction (8N1); `None` for a link without one, such as TCP.
    pub baud: Option<u32>,
    /// Bytes the device's transmit buffer holds, at least 1.
    pub transmit_buffer: usize,
    /// Bytes the device's receive buffer holds, at least 1.
    pub receive_buffer: usize,
}

impl Default for LinkConfig {
    /// No line rate, 1024 bytes each way.
    fn default() -> Self {
        Self { baud: None, transmit_buffer: 1024, receive_buffer: 1024 }
    }
}

/// Makes a link; `clock` paces it.
///
/// With a baud rate it is a UART without flow control: bytes are sent whether or not the host reads
/// (its buffer is unlimited), and bytes that reach a full receive buffer are lost and counted.
/// Without one it is a TCP connection: a host that does not read stalls the device's writer, a
/// device that does not read delays the host's bytes, and nothing is lost.
///
/// # Panics
/// When a buffer holds no byte, or the baud rate is 0.
pub fn link(clock: &VirtualClock, config: LinkConfig) -> (DeviceReader, DeviceWriter, HostEnd) {
    faulty_link(clock, config, None)
}

/// Makes a link as [`link`] does, with faults.
///
/// # Panics
/// As [`link`].
pub fn faulty_link(
    clock: &VirtualClock,
    config: LinkConfig,
    channels: Option<Channels>,
) -> (DeviceReader, DeviceWriter, HostEnd) {
    assert!(config.transmit_buffer > 0 && config.receive_buffer > 0);
    assert!(config.baud != Some(0));
    let byte_ns = config.baud.map(|baud| BITS_PER_BYTE_NS / u64::from(baud));
    let direction = |sender, receiver, channel| Direction {
        clock: clock.clone(),
        line: Rc::new(RefCell::new(Line {
            bauds: config.baud.map(|baud| [baud; 2]),
            byte_ns,
            sender_holds: sender,
            receiver_holds: receiver,
            channel,
            ..Line::default()
        })),
    };
    let (outwards, inwards) = match channels {
        Some(Channels { to_host, to_device }) => (Some(to_host), Some(to_device)),
        None => (None, None),
    };
    let to_host = direction(Some(config.transmit_buffer), None, outwards);
    let to_device = direction(None, Some(config.receive_buffer), inwards);
    let reader = DeviceReader(to_device.clone());
    let writer = DeviceWriter(to_host.clone());
    (reader, writer, HostEnd { to_host, to_device })
}

/// The faults of a link, one channel for each direction. Clones are the same channels.
#[derive(Clone, Debug)]
pub struct Channels {
    /// From device to host.
    pub to_host: Rc<RefCell<Channel>>,
    /// From host to device.
    pub to_device: Rc<RefCell<Channel>>,
}

impl Channels {
    /// Channels with these faults.
    pub fn new(faults: &LinkFaults, seed: u64) -> Self {
        let shared = |channel| Rc::new(RefCell::new(channel));
        Self {
            to_host: shared(Channel::new(faults, seed)),
            // Another seed, so that the directions are independent.
            to_device: shared(Channel::new(faults, !seed).without_values()),
        }
    }

    /// Drops bytes under way.
    pub fn clear(&self) {
        self.to_host.borrow_mut().clear();
        self.to_device.borrow_mut().clear();
    }
}

/// One direction.
#[derive(Debug, Default)]
struct Line {
    /// Baud rates of the sender and of the receiver.
    bauds: Option<[u32; 2]>,
    /// If they differ: accumulated bits of the receiver's next byte.
    misread: u32,
    byte_ns: Option<u64>,
    sender_holds: Option<usize>,
    receiver_holds: Option<usize>,
    /// Accepted from the sender, not yet sent over the line.
    sending: VecDeque<u8>,
    /// Time at which the first byte of `sending` has crossed the line, ns.
    next_arrival_ns: u64,
    channel: Option<Rc<RefCell<Channel>>>,
    arrived: VecDeque<u8>,
    lost: u64,
    receiver_gone: bool,
    /// Waits for an event other than time: room, or a byte.
    waiting: Option<Waker>,
}

impl Line {
    /// Moves the bytes that have crossed the line and the channel by `now`, µs.
    fn settle(&mut self, now: u64) {
        let channel = self.channel.clone();
        while let Some(&byte) = self.sending.front() {
            // Without a baud rate, bytes without room wait at the sender.
            let full = match &channel {
                Some(channel) => channel.borrow().room() == 0,
                None => self.is_full(),
            };
            let crossed_ns = match self.byte_ns {
                Some(_) if self.next_arrival_ns > now * 1000 => break,
                Some(byte_ns) => {
                    self.next_arrival_ns += byte_ns;
                    self.next_arrival_ns - byte_ns
                }
                None if full => break,
                None => now * 1000,
            };
            self.sending.pop_front();
            for byte in self.read_as(byte) {
                match &channel {
                    Some(channel) => channel.borrow_mut().push(crossed_ns, &[byte]),
                    None => self.arrive(byte),
                }
            }
        }
        if let Some(channel) = channel {
            let mut channel = channel.borrow_mut();
            // A UART's bytes arrive even without room for them.
            let room = match self.byte_ns {
                Some(_) => usize::MAX,
                None => self
                    .receiver_holds
                    .map_or(usize::MAX, |holds| holds.saturating_sub(self.arrived.len())),
            };
            for byte in channel.pull(now * 1000, room) {
                self.arrive(byte);
            }
        }
    }

    /// The bytes that the receiver reads for one byte: itself, or, if the baud rates differ too much, as many
    /// invalid bytes as fit its time.
    fn read_as(&mut self, byte: u8) -> impl Iterator<Item = u8> + use<> {
        let [sender, receiver] = self.bauds.unwrap_or([1, 1]);
        let misread = sender.abs_diff(receiver) > sender / 25;
        let count = if misread {
            self.misread += receiver;
            let count = self.misread / sender;
            self.misread %= sender;
            count
        } else {
            1
        };
        (0..count).map(move |index| {
            if misread { byte.rotate_left(index % 8).wrapping_mul(0x9d) ^ 0xa5 } else { byte }
        })
    }

    fn set_sender_baud(&mut self, baud: u32) {
        if let Some([sender, _]) = &mut self.bauds {
            *sender = baud;
            self.byte_ns = Some(BITS_PER_BYTE_NS / u64::from(baud));
        }
    }

    fn set_receiver_baud(&mut self, baud: u32) {
        if let Some([_, receiver]) = &mut self.bauds {
            *receiver = baud;
        }
    }

    fn is_full(&self) -> bool {
        self.receiver_holds.is_some_and(|holds| self.arrived.len() >= holds)
    }

    fn arrive(&mut self, byte: u8) {
        if self.receiver_gone {
        } else if self.is_full() {
            self.lost += 1;
        } else {
            self.arrived.push_back(byte);
        }
    }

    /// Earliest time at which the next byte reaches the receiver, µs.
    fn next_step_at(&self) -> Option<u64> {
        let crossing = (!self.sending.is_empty()).then(|| self.over_line_at(1));
        let due = self
            .channel
            .as_ref()
            .and_then(|channel| channel.borrow().next_arrival_ns())
            .map(|due_ns| due_ns.div_ceil(1000));
        [crossing.flatten(), due].into_iter().flatten().min()
    }

    /// Free bytes of the sender's buffer.
    fn room(&self) -> usize {
        let held = match self.byte_ns {
            Some(_) => self.sending.len(),
            // Without a baud rate, unread bytes are still with the sender.
            None => self.sending.len() + self.arrived.len(),
        };
        let holds = self.sender_holds.unwrap_or(usize::MAX);
        holds.saturating_sub(held)
    }

    /// Time at which `count` bytes of `sending` have crossed the line, µs; `None` without a baud rate.
    fn over_line_at(&self, count: usize) -> Option<u64> {
        let further = self.byte_ns? * (count.max(1) as u64 - 1);
        Some((self.next_arrival_ns + further).div_ceil(1000))
    }

    /// Takes `bytes` at `now`, µs; the caller has checked the room.
    fn send(&mut self, bytes: &[u8], now: u64) {
        if let (true, Some(byte_ns)) = (self.sending.is_empty(), self.byte_ns) {
            self.next_arrival_ns = now * 1000 + byte_ns;
        }
        self.sending.extend(bytes);
        self.settle(now);
    }

    fn wake(&mut self) {
        if let Some(waker) = self.waiting.take() {
            waker.wake();
        }
    }
}

/// A line and the clock that paces it. Clones are the same line.
#[derive(Clone, Debug)]
struct Direction {
    clock: VirtualClock,
    line: Rc<RefCell<Line>>,
}

impl Direction {
    /// The line, with all transfers up to the present time.
    fn settled(&self) -> RefMut<'_, Line> {
        let mut line = self.line.borrow_mut();
        line.settle(self.clock.now());
        line
    }

    /// Waits until `ready` returns a value, checked at each event at the line's other end.
    async fn when<T>(&self, mut ready: impl FnMut(&mut Line) -> Option<T>) -> T {
        poll_fn(|context| {
            let mut line = self.settled();
            match ready(&mut line) {
                Some(value) => Poll::Ready(value),
                None => {
                    line.waiting = Some(context.waker().clone());
                    Poll::Pending
                }
            }
        })
        .await
    }
}

/// The device's receiver. Reading is cancel-safe: a cancelled read takes no byte.
#[derive(Debug)]
pub struct DeviceReader(Direction);

impl ErrorType for DeviceReader {
    type Error = Infallible;
}

impl Read for DeviceReader {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        if buffer.is_empty() {
            return Ok(0);
        }
        loop {
            // Either bytes, or the time of arrival of the next one.
            let step = self.0.when(|line| {
                let count = buffer.len().min(line.arrived.len());
                if count > 0 {
                    for (to, from) in buffer.iter_mut().zip(line.arrived.drain(..count)) {
                        *to = from;
                    }
                    // Without a baud rate, this makes room for further bytes of the host.
                    line.settle(self.0.clock.now());
                    Some(Ok(count))
                } else {
                    line.next_step_at().map(Err)
                }
            });
            match step.await {
                Ok(count) => return Ok(count),
                Err(arrival) => self.0.clock.until(arrival).await,
            }
        }
    }
}

/// The device's transmitter. A cancelled write has written nothing.
#[derive(Debug)]
pub struct DeviceWriter(Direction);

impl ErrorType for DeviceWriter {
    type Error = Infallible;
}

impl Write for DeviceWriter {
    /// Takes what fits the transmit buffer; when it is full, waits until half of it is free (or
    /// room for all of `bytes`), as a driver with a refill interrupt does.
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        if bytes.is_empty() {
            return Ok(0);
        }
        loop {
            let step = self.0.when(|line| {
                let room = line.room();
                if room > 0 || line.receiver_gone {
                    let count = bytes.len().min(room.max(1));
                    line.send(&bytes[..count], self.0.clock.now());
                    Some(Ok(count))
                } else {
                    let half = line.sending.len().div_ceil(2);
                    line.over_line_at(half.min(bytes.len())).map(Err)
                }
            });
            match step.await {
                Ok(count) => return Ok(count),
                Err(room) => self.0.clock.until(room).await,
            }
        }
    }

    /// With a baud rate, waits until every byte has crossed the line; without one, returns at once.
    async fn flush(&mut self) -> Result<(), Infallible> {
        let over = {
            let line = self.0.settled();
            match line.sending.len() {
                0 => None,
                count => line.over_line_at(count),
            }
        };
        if let Some(over) = over {
            self.0.clock.until(over).await;
        }
        Ok(())
    }
}

/// The host's end, which never blocks. After it is dropped, data of the device are discarded.
#[derive(Debug)]
pub struct HostEnd {
    to_host: Direction,
    to_device: Direction,
}

impl HostEnd {
    /// Baud rate at this end: the host's, or that of its radio adapter; `None` for a link
    /// without one.
    pub fn baud(&self) -> Option<u32> {
        self.to_device.line.borrow().bauds.map(|[sender, _]| sender)
    }

    /// Changes it; without effect on a link without one.
    pub fn set_baud(&mut self, baud: u32) {
        self.to_device.settled().set_sender_baud(baud);
        self.to_host.settled().set_receiver_baud(baud);
    }

    /// Changes that at the device's end; likewise. What crosses a link of two rates is damaged.
    pub fn set_device_baud(&mut self, baud: u32) {
        self.to_host.settled().set_sender_baud(baud);
        self.to_device.settled().set_receiver_baud(baud);
    }

    /// Takes the bytes that have arrived by now.
    pub fn pull(&mut self) -> Vec<u8> {
        let mut line = self.to_host.settled();
        let bytes = line.arrived.drain(..).collect();
        line.wake();
        bytes
    }

    /// Number of bytes that [`pull`](Self::pull) would return now.
    pub fn available(&self) -> usize {
        self.to_host.settled().arrived.len()
    }

    /// Time at which [`pull`](Self::pull) returns the next byte under way, µs on the clock.
    pub fn next_arrival_us(&self) -> Option<u64> {
        let line = self.to_host.settled();
        if line.arrived.is_empty() { line.next_step_at() } else { Some(self.to_host.clock.now()) }
    }

    /// Number of lost connections so far; `None` while there is none.
    pub fn connection(&self) -> Option<u64> {
        let now = self.to_host.clock.now();
        match &self.to_host.line.borrow().channel {
            Some(channel) => channel.borrow().connection(now * 1000),
            None => Some(0),
        }
    }

    /// Sends all of `bytes` to the device.
    pub fn push(&mut self, bytes: &[u8]) {
        let mut line = self.to_device.settled();
        line.send(bytes, self.to_device.clock.now());
        line.wake();
    }

    /// Bytes to the device that were lost because its receive buffer was full.
    pub fn lost(&self) -> u64 {
        self.to_device.settled().lost
    }
}

impl Drop for HostEnd {
    fn drop(&mut self) {
        let mut line = self.to_host.line.borrow_mut();
        line.receiver_gone = true;
        line.arrived.clear();
        line.wake();
    }
}
