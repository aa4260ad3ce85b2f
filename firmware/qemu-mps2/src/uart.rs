//! The machine's CMSDK UARTs, interrupt-driven, behind `embedded_io_async`.

use core::cell::RefCell;
use core::convert::Infallible;
use core::future::poll_fn;
use core::task::{Poll, Waker};

use critical_section::Mutex;
use embedded_io_async::{ErrorType, Read, Write};
use heapless::Deque;

use crate::clock;
use crate::register::Register;

const DATA: usize = 0x00;
const STATE: usize = 0x04;
const CTRL: usize = 0x08;
const INTERRUPT: usize = 0x0C;
const BAUD_DIVIDER: usize = 0x10;

const STATE_TX_FULL: u32 = 1;
const STATE_RX_FULL: u32 = 1 << 1;
const CTRL_TX: u32 = 1;
const CTRL_RX: u32 = 1 << 1;
const CTRL_TX_INTERRUPT: u32 = 1 << 2;
const CTRL_RX_INTERRUPT: u32 = 1 << 3;
const INTERRUPT_TX: u32 = 1;
const INTERRUPT_RX: u32 = 1 << 1;

/// 115,200 baud from 25 MHz; QEMU itself knows no baud rate.
const DIVIDER: u32 = 217;
/// Capacity of each queue, bytes.
const QUEUE: usize = 1024;

/// The wireless link.
pub static WIRELESS: Uart = Uart::new(0x4000_4000);
/// The cable.
pub static CABLE: Uart = Uart::new(0x4000_5000);
/// The bridge to the sensor.
pub static SENSOR_BUS: Uart = Uart::new(0x4000_6000);
/// Logs.
pub static LOG: Uart = Uart::new(0x4000_7000);

/// One UART.
pub struct Uart {
    base: usize,
    state: Mutex<RefCell<State>>,
}

struct State {
    received: Deque<u8, QUEUE>,
    sending: Deque<u8, QUEUE>,
    traffic: Traffic,
    reader: Option<Waker>,
    writer: Option<Waker>,
}

/// Bytes received and sent on a line since the start, modulo 2¹⁶.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Traffic {
    /// Received, whether read yet or not.
    pub received: u16,
    /// Handed to the line, sent yet or not.
    pub sent: u16,
}

impl Uart {
    const fn new(base: usize) -> Self {
        Self {
            base,
            state: Mutex::new(RefCell::new(State {
                received: Deque::new(),
                sending: Deque::new(),
                traffic: Traffic { received: 0, sent: 0 },
                reader: None,
                writer: None,
            })),
        }
    }

    const fn register(&self, offset: usize) -> Register {
        // SAFETY: `base` is one of the machine's UARTs, the offsets are those of its registers.
        unsafe { Register::at(self.base + offset) }
    }

    fn with<R>(&self, f: impl FnOnce(&mut State) -> R) -> R {
        critical_section::with(|cs| f(&mut self.state.borrow_ref_mut(cs)))
    }

    /// Switches it on; its interrupts must be unmasked for it to work.
    pub fn start(&'static self) -> (Reader, Writer) {
        self.register(BAUD_DIVIDER).write(DIVIDER);
        self.register(CTRL).write(CTRL_TX | CTRL_RX | CTRL_TX_INTERRUPT | CTRL_RX_INTERRUPT);
        (Reader(self), Writer(self))
    }

    /// Switches only its sending half on, without interrupts: for [`write_now`](Self::write_now).
    pub fn start_polled(&self) {
        self.register(BAUD_DIVIDER).write(DIVIDER);
        self.register(CTRL).write(CTRL_TX);
    }

    /// Sends bytes and waits until they are on the line, also where interrupts are off.
    pub fn write_now(&self, bytes: &[u8]) {
        for &byte in bytes {
            self.register(DATA).write(byte.into());
            while self.register(STATE).read() & STATE_TX_FULL != 0 {}
        }
    }

    /// Blocks until `buffer` is full: no other task runs. Calls `poll` first and after each interrupt.
    pub fn read_now(&self, buffer: &mut [u8], mut poll: impl FnMut()) {
        let mut count = 0;
        loop {
            // Interrupts are disabled so that none is handled between the check and `wfi`; a pending one
            // still wakes the processor.
            let full = cortex_m::interrupt::free(|_| {
                poll();
                count += self.take(&mut buffer[count..]);
                let full = count == buffer.len();
                if !full {
                    cortex_m::asm::wfi();
                }
                full
            });
            if full {
                return;
            }
        }
    }

    /// Its receive interrupt.
    pub fn on_receive(&self) {
        let waker = self.with(|state| {
            self.register(INTERRUPT).write(INTERRUPT_RX);
            while self.register(STATE).read() & STATE_RX_FULL != 0 {
                if state.received.is_full() {
                    // The byte stays in the UART until there is room: the sender waits.
                    self.listen(false);
                    break;
                }
                self.receive(state);
            }
            state.reader.take()
        });
        waker.into_iter().for_each(Waker::wake);
    }

    /// Its transmit interrupt.
    pub fn on_sent(&self) {
        let waker = self.with(|state| {
            self.register(INTERRUPT).write(INTERRUPT_TX);
            self.send(state);
            state.writer.take()
        });
        waker.into_iter().for_each(Waker::wake);
    }

    /// Bytes received and sent since the start.
    pub fn traffic(&self) -> Traffic {
        self.with(|state| state.traffic)
    }

    /// Moves a byte from the UART to the queue, which has room.
    fn receive(&self, state: &mut State) {
        let _ = state.received.push_back(self.register(DATA).read() as u8);
        state.traffic.received = state.traffic.received.wrapping_add(1);
    }

    fn drained(&self, state: &State) -> bool {
        state.sending.is_empty() && self.register(STATE).read() & STATE_TX_FULL == 0
    }

    fn send(&self, state: &mut State) {
        while self.register(STATE).read() & STATE_TX_FULL == 0 {
            match state.sending.pop_front() {
                Some(byte) => self.register(DATA).write(byte.into()),
                None => break,
            }
        }
    }

    fn listen(&self, on: bool) {
        let control = self.register(CTRL);
        control.write(if on {
            control.read() | CTRL_RX_INTERRUPT
        } else {
            control.read() & !CTRL_RX_INTERRUPT
        });
    }

    /// Moves received bytes to `buffer` without waiting; returns their number.
    fn take(&self, buffer: &mut [u8]) -> usize {
        self.with(|state| self.take_from(state, buffer))
    }

    /// Queues as many bytes as there is room for, without waiting; returns their number. In lockstep it waits
    /// until all bytes are sent, so that the receiver's speed does not change the order of tasks.
    fn put(&self, bytes: &[u8]) -> usize {
        if clock::is_lockstep() {
            self.write_now(bytes);
            let count = bytes.len() as u16;
            self.with(|state| state.traffic.sent = state.traffic.sent.wrapping_add(count));
            return bytes.len();
        }
        self.with(|state| {
            let count = bytes.len().min(QUEUE - state.sending.len());
            state.sending.extend(&bytes[..count]);
            state.traffic.sent = state.traffic.sent.wrapping_add(count as u16);
            self.send(state);
            count
        })
    }

    fn take_from(&self, state: &mut State, buffer: &mut [u8]) -> usize {
        let mut count = 0;
        for place in buffer {
            let Some(byte) = state.received.pop_front() else {
                break;
            };
            *place = byte;
            count += 1;
        }
        if count > 0 && self.register(CTRL).read() & CTRL_RX_INTERRUPT == 0 {
            self.listen(true);
            // A byte that waited in the UART raises no interrupt.
            if self.register(STATE).read() & STATE_RX_FULL != 0 {
                self.receive(state);
            }
        }
        count
    }
}

/// The receiving half of a UART.
pub struct Reader(&'static Uart);

impl ErrorType for Reader {
    type Error = Infallible;
}

impl Read for Reader {
    /// Cancel-safe: bytes are taken when it completes or not at all.
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        if buffer.is_empty() {
            return Ok(0);
        }
        poll_fn(|context| {
            self.0.with(|state| match self.0.take_from(state, buffer) {
                0 => {
                    state.reader = Some(context.waker().clone());
                    Poll::Pending
                }
                count => Poll::Ready(Ok(count)),
            })
        })
        .await
    }
}

/// The sending half of a UART.
pub struct Writer(&'static Uart);

impl Writer {
    async fn when(&mut self, ready: impl Fn(&Uart, &State) -> bool) {
        poll_fn(|context| {
            self.0.with(|state| {
                if ready(self.0, state) {
                    Poll::Ready(())
                } else {
                    state.writer = Some(context.waker().clone());
                    Poll::Pending
                }
            })
        })
        .await;
    }
}

impl ErrorType for Writer {
    type Error = Infallible;
}

impl Write for Writer {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        if bytes.is_empty() {
            return Ok(0);
        }
        self.when(|_, state| !state.sending.is_full()).await;
        Ok(self.0.put(bytes))
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        self.when(Uart::drained).await;
        Ok(())
    }
}
