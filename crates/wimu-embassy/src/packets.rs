//! A link over a radio that sends packets and whose connection comes and goes, such as the Nordic UART Service.

use core::cell::RefCell;
use core::convert::Infallible;

use embassy_sync::blocking_mutex::Mutex as Lock;
use embassy_sync::signal::Signal;
use embedded_io_async::{ErrorType, Read, Write};
use heapless::Deque;
use wimu_link::WhoAreYou;

use crate::Mutex;

/// Bytes that wait for the radio: two of the longest packets of Bluetooth Low Energy (244 bytes).
const OUTGOING: usize = 512;
/// Bytes that wait for the node: a packet of the radio, and the question of [`PacketLink::connect`].
const INCOMING: usize = 288;
/// Longest frame of a [`WhoAreYou`], bytes.
const QUESTION: usize = 32;

/// The bytes between a node's link and the task of a radio.
///
/// The node reads and writes the halves of [`split`](Self::split) like a UART. The radio's task calls the other methods:
/// [`connect`](Self::connect) when a host listens, [`next_packet`](Self::next_packet) for what to send,
/// [`receive`](Self::receive) for what has come, and [`disconnect`](Self::disconnect).
///
/// - While a host listens, a writer waits for the radio: the node's queue then drops and counts samples as on a slow line.
/// - While none listens, what is written is discarded, as on a line without a listener, and counted in
///   [`dropped`](Self::dropped). What waits when a connection ends is discarded and counted too.
/// - A host that connects gets no fragment of a frame: the first byte sent is that of a frame. The node is asked who it
///   is, so that its Hello is among the first frames.
///
/// ```
/// use embassy_futures::block_on;
/// use embedded_io_async::Write;
/// use wimu_embassy::PacketLink;
///
/// static LINK: PacketLink = PacketLink::new();
/// let (_for_the_node, mut writer) = LINK.split();
/// LINK.connect();
/// block_on(async {
///     writer.write_all(b"frame\0").await?;
///     let mut packet = [0; 20]; // the connection's MTU − 3
///     let length = LINK.next_packet(&mut packet).await;
///     assert_eq!(&packet[..length], b"frame\0");
///     Ok::<(), core::convert::Infallible>(())
/// });
/// ```
pub struct PacketLink {
    state: Lock<Mutex, RefCell<State>>,
    /// Outgoing bytes were queued, or taken.
    queued: Signal<Mutex, ()>,
    sent: Signal<Mutex, ()>,
    /// Incoming bytes came, or were read.
    came: Signal<Mutex, ()>,
    read: Signal<Mutex, ()>,
}

struct State {
    is_connected: bool,
    /// The last byte from the node was not the end of a frame.
    within_frame: bool,
    /// The rest of the frame that had begun before the connection is discarded.
    skips: bool,
    outgoing: Deque<u8, OUTGOING>,
    incoming: Deque<u8, INCOMING>,
    dropped: u32,
}

impl State {
    /// Takes bytes from the node: the number taken, 0 if it must wait.
    fn take(&mut self, bytes: &[u8]) -> usize {
        let end = bytes.iter().position(|byte| *byte == 0).map(|at| at + 1);
        let taken = if !self.is_connected {
            self.drop_bytes(bytes.len());
            bytes.len()
        } else if self.skips {
            self.skips = end.is_none();
            let rest = end.unwrap_or(bytes.len());
            self.drop_bytes(rest);
            rest
        } else {
            let taken = bytes.iter().copied();
            taken.take_while(|byte| self.outgoing.push_back(*byte).is_ok()).count()
        };
        if let Some(last) = bytes.get(..taken).and_then(<[u8]>::last) {
            self.within_frame = *last != 0;
        }
        taken
    }

    fn drop_bytes(&mut self, count: usize) {
        let count = u32::try_from(count).unwrap_or(u32::MAX);
        self.dropped = self.dropped.saturating_add(count);
    }

    fn drop_outgoing(&mut self) {
        self.drop_bytes(self.outgoing.len());
        self.outgoing.clear();
    }
}

/// Moves bytes from a queue to `bytes`: their number.
fn pop<const N: usize>(queue: &mut Deque<u8, N>, bytes: &mut [u8]) -> usize {
    let mut count = 0;
    for place in bytes {
        let Some(byte) = queue.pop_front() else { break };
        *place = byte;
        count += 1;
    }
    count
}

impl PacketLink {
    /// A link without a connection.
    #[allow(clippy::new_without_default, reason = "made in a static")]
    pub const fn new() -> Self {
        Self {
            state: Lock::new(RefCell::new(State {
                is_connected: false,
                within_frame: false,
                skips: false,
                outgoing: Deque::new(),
                incoming: Deque::new(),
                dropped: 0,
            })),
            queued: Signal::new(),
            sent: Signal::new(),
            came: Signal::new(),
            read: Signal::new(),
        }
    }

    /// The halves for [`Board::wireless`](wimu_node::Board::wireless), to be made once.
    pub fn split(&self) -> (PacketReader<'_>, PacketWriter<'_>) {
        (PacketReader(self), PacketWriter(self))
    }

    /// Begins a connection: a host listens from now on. The node is asked who it is.
    pub fn connect(&self) {
        let mut question = [0; QUESTION];
        let length = WhoAreYou::default().encode(&mut question).unwrap_or(0);
        self.with(|state| {
            state.drop_outgoing();
            state.incoming.clear();
            // Ends a request that an earlier connection has left unfinished.
            let question = question.get(..length).unwrap_or_default();
            for byte in [0].iter().chain(question) {
                let _ = state.incoming.push_back(*byte);
            }
            state.skips = state.within_frame;
            state.is_connected = true;
        });
        self.came.signal(());
        self.sent.signal(());
    }

    /// Ends a connection. What has not been sent is discarded and counted.
    pub fn disconnect(&self) {
        self.with(|state| {
            state.is_connected = false;
            state.drop_outgoing();
        });
        self.sent.signal(());
        self.read.signal(());
    }

    /// Bytes from the node that no host could get, since the start.
    pub fn dropped(&self) -> u32 {
        self.with(|state| state.dropped)
    }

    /// Waits for bytes to send and moves as many as `packet` holds into it; returns their number. `packet` has the
    /// longest length that the connection allows. Cancel-safe.
    pub async fn next_packet(&self, packet: &mut [u8]) -> usize {
        loop {
            let length = self.with(|state| pop(&mut state.outgoing, packet));
            if length > 0 || packet.is_empty() {
                self.sent.signal(());
                return length;
            }
            self.queued.wait().await;
        }
    }

    /// Passes received bytes to the node. Waits while the node is busy; what is left when the connection ends is
    /// discarded.
    pub async fn receive(&self, bytes: &[u8]) {
        let mut rest = bytes;
        loop {
            let taken = self.with(|state| {
                if !state.is_connected {
                    return rest.len();
                }
                let taken = rest.iter().copied();
                taken.take_while(|byte| state.incoming.push_back(*byte).is_ok()).count()
            });
            self.came.signal(());
            rest = rest.get(taken..).unwrap_or_default();
            if rest.is_empty() {
                return;
            }
            self.read.wait().await;
        }
    }

    fn with<R>(&self, f: impl FnOnce(&mut State) -> R) -> R {
        self.state.lock(|state| f(&mut state.borrow_mut()))
    }
}

/// What the node receives.
pub struct PacketReader<'a>(&'a PacketLink);

/// What the node sends.
pub struct PacketWriter<'a>(&'a PacketLink);

impl ErrorType for PacketReader<'_> {
    type Error = Infallible;
}

impl ErrorType for PacketWriter<'_> {
    type Error = Infallible;
}

impl Read for PacketReader<'_> {
    /// Cancel-safe.
    async fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        loop {
            let read = self.0.with(|state| pop(&mut state.incoming, bytes));
            if read > 0 || bytes.is_empty() {
                self.0.read.signal(());
                return Ok(read);
            }
            self.0.came.wait().await;
        }
    }
}

impl Write for PacketWriter<'_> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        loop {
            let taken = self.0.with(|state| state.take(bytes));
            if taken > 0 || bytes.is_empty() {
                self.0.queued.signal(());
                return Ok(taken);
            }
            self.0.sent.wait().await;
        }
    }

    /// Waits until the radio has everything, or the connection has ended.
    async fn flush(&mut self) -> Result<(), Infallible> {
        while self.0.with(|state| !state.outgoing.is_empty()) {
            self.0.sent.wait().await;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
#[cfg(test)]
pub(crate) mod with_node;
