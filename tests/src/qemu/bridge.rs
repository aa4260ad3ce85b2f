//! The host's side of a UART-to-I²C bridge, with a register-level sensor behind it: how a board
//! in an emulator that has no accelerometer reaches one.
//!
//! It speaks as NXP's SC18IM700 does: `S address length [bytes] … P` is a transaction with
//! repeated starts, `R register … P` reads the chip's registers, `W register value … P` writes
//! them, `I P` reads its port. Two things differ: a read that nobody answers gives 0xFF bytes, as
//! an idle bus does, so that every question has an answer of known length; and the sensor's
//! data-ready line is bit 0 of the port.
//!
//! For lockstep there is one command more, which the chip has not: `T flags wait cable-in
//! wireless-in cable-out wireless-out P` lets time pass. Bit 0 of the flags asks for data-ready;
//! the wait is in µs from the answer before, 32 bits, all ones without a deadline; how many bytes
//! the board has received and sent on each of its links follows, 16 bits each. It is answered
//! when the wait is over, when data are ready, or when a lone `P` ends it, with the low 32 bits of
//! the time since the board's start, µs, and flags, bit 0 data-ready. All lowest byte first.

use std::pin::pin;
use std::rc::Rc;

use embassy_futures::select::select;
use embedded_hal_async::i2c::{I2c, Operation};

use wimu_sim::clock::VirtualClock;
use wimu_sim::i2c::{Faults, I2cError, SimI2c, Target};
use wimu_sim::sensor::Sensor;

/// Registers of the chip.
const IO_STATE: u8 = 0x04;
const I2C_STATUS: u8 = 0x0A;
/// Contents of the status register.
const STATUS_OK: u8 = 0xF0;
const STATUS_NACK_ADDRESS: u8 = 0xF1;
const STATUS_TIMEOUT: u8 = 0xF8;
/// How long it waits for a line that is held low, µs.
const HELD_US: u64 = 10_000;
/// What an idle bus reads.
const IDLE: u8 = 0xFF;
/// Content of registers that do nothing here.
const RESERVED: u8 = 0x00;

const WATCH_DATA_READY: u8 = 1;
const NO_DEADLINE: u32 = u32::MAX;

/// Bytes that a board has received and sent on its links, modulo 2¹⁶: cable first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Received by the board.
    pub received: [u16; 2],
    /// Sent by the board.
    pub sent: [u16; 2],
}

/// A bridge, its bus at 400 kHz, and a sensor on it, in virtual time.
pub struct Bridge {
    clock: VirtualClock,
    sensor: Sensor,
    i2c: SimI2c,
    /// Received, not yet a whole message.
    incoming: Vec<u8>,
    status: u8,
    /// When the board started, µs on the clock.
    started_us: u64,
    /// When the board was last told the time, µs on the clock.
    told_us: u64,
    wait: Option<Wait>,
}

/// A board that lets time pass.
#[derive(Clone, Copy, Debug)]
struct Wait {
    deadline_us: Option<u64>,
    watches: bool,
    traffic: Traffic,
}

/// A whole message of the board.
#[derive(Debug, PartialEq)]
enum Message {
    Transaction(Vec<Part>),
    ReadRegisters(Vec<u8>),
    WriteRegisters,
    ReadPort,
    Wait { flags: u8, wait_us: u32, traffic: Traffic },
    Stop,
}

/// What follows one start condition.
#[derive(Debug, PartialEq)]
enum Part {
    Write { address: u8, bytes: Vec<u8> },
    Read { address: u8, length: usize },
}

impl Bridge {
    /// A bridge to `sensor`, which runs on `clock`.
    pub fn new(clock: &VirtualClock, sensor: Sensor) -> Self {
        Self {
            clock: clock.clone(),
            i2c: SimI2c::new(clock, [Rc::new(sensor.clone()) as Rc<dyn Target>]),
            sensor,
            incoming: Vec::new(),
            status: STATUS_OK,
            started_us: clock.now(),
            told_us: clock.now(),
            wait: None,
        }
    }

    /// The board and its sensor get power: a clock of 0 for the board, registers as after a start.
    pub fn power_on(&mut self) {
        self.sensor.power_cycle();
        self.incoming.clear();
        self.status = STATUS_OK;
        self.started_us = self.clock.now();
        self.told_us = self.started_us;
        self.wait = None;
    }

    /// The clock it runs on.
    pub fn clock(&self) -> &VirtualClock {
        &self.clock
    }

    /// When the board got power, µs on the clock.
    pub fn started_us(&self) -> u64 {
        self.started_us
    }

    /// The sensor, to break it or to give it other samples.
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    /// The sensor's bus, to break it.
    pub fn bus_faults(&self) -> Faults {
        self.i2c.faults()
    }

    /// Takes bytes from the board; returns the answers that are due.
    pub fn receive(&mut self, bytes: &[u8]) -> Vec<u8> {
        self.incoming.extend(bytes);
        let mut answers = Vec::new();
        loop {
            let (message, length) = match parse(&self.incoming) {
                Parsed::Whole(message, length) => (Some(message), length),
                Parsed::Unknown => (None, 1),
                Parsed::Part => return answers,
            };
            self.incoming.drain(..length);
            // Whoever goes on does not wait any more.
            if self.wait.take().is_some() {
                answers.extend(self.tell_time());
            }
            if let Some(message) = message {
                self.obey(message, &mut answers);
            }
        }
    }

    /// What the board had received and sent when it began to wait; `None` while it does not.
    pub fn waiting(&self) -> Option<Traffic> {
        self.wait.map(|wait| wait.traffic)
    }

    /// Lets time pass while the board waits, up to `limit_us` on the clock at most; returns what to
    /// tell the board once its wait is over. Without a wait nothing happens.
    pub fn pass_time(&mut self, limit_us: u64) -> Option<[u8; 5]> {
        let wait = self.wait?;
        let over = async {
            let deadline = async {
                match wait.deadline_us {
                    Some(deadline) => self.clock.until(deadline).await,
                    None => std::future::pending().await,
                }
            };
            if wait.watches {
                let _ = select(self.sensor.ready(), deadline).await;
            } else {
                deadline.await;
            }
        };
        if self.clock.run_until(pin!(over), limit_us).is_pending() {
            return None;
        }
        self.wait = None;
        Some(self.tell_time())
    }

    fn tell_time(&mut self) -> [u8; 5] {
        self.told_us = self.clock.now();
        let [a, b, c, d] = ((self.told_us - self.started_us) as u32).to_le_bytes();
        [a, b, c, d, self.port() & WATCH_DATA_READY]
    }

    /// Data-ready in bit 0; the other pins are pulled up.
    fn port(&self) -> u8 {
        0xFE | u8::from(self.sensor.is_ready())
    }

    fn obey(&mut self, message: Message, answers: &mut Vec<u8>) {
        match message {
            Message::Transaction(parts) => self.transact(&parts, answers),
            Message::ReadRegisters(registers) => {
                answers.extend(registers.into_iter().map(|register| match register {
                    IO_STATE => self.port(),
                    I2C_STATUS => self.status,
                    _ => RESERVED,
                }));
            }
            Message::ReadPort => answers.push(self.port()),
            // Baud rate, pin modes and bus speed are what they are.
            Message::WriteRegisters | Message::Stop => {}
            Message::Wait { flags, wait_us, traffic } => {
                self.wait = Some(Wait {
                    deadline_us: (wait_us != NO_DEADLINE)
                        .then(|| self.told_us.saturating_add(wait_us.into())),
                    watches: flags & WATCH_DATA_READY != 0,
                    traffic,
                });
            }
        }
    }

    fn transact(&mut self, parts: &[Part], answers: &mut Vec<u8>) {
        let clock = self.clock.clone();
        self.status = STATUS_OK;
        // One transaction is with one device; the chip would allow several.
        for of_one in parts.chunk_by(|a, b| a.address() == b.address()) {
            let mut buffers: Vec<Vec<u8>> = of_one
                .iter()
                .map(|part| match part {
                    Part::Write { bytes, .. } => bytes.clone(),
                    Part::Read { length, .. } => vec![IDLE; *length],
                })
                .collect();
            let mut operations: Vec<Operation<'_>> = of_one
                .iter()
                .zip(&mut buffers)
                .map(|(part, buffer)| match part {
                    Part::Write { .. } => Operation::Write(buffer),
                    Part::Read { .. } => Operation::Read(buffer),
                })
                .collect();
            let address = of_one[0].address();
            if self.i2c.faults().stuck() {
                // The chip does not wait without end.
                clock.advance_to(clock.now() + HELD_US);
                self.status = STATUS_TIMEOUT;
            } else {
                match clock.run(self.i2c.transaction(address, &mut operations)) {
                    Ok(Ok(())) => {}
                    Ok(Err(I2cError::NoAcknowledge { .. })) => self.status = STATUS_NACK_ADDRESS,
                    Err(_) => self.status = STATUS_TIMEOUT,
                }
            }
            for (part, buffer) in of_one.iter().zip(buffers) {
                if let Part::Read { .. } = part {
                    answers.extend(buffer);
                }
            }
        }
    }
}

impl Part {
    fn address(&self) -> u8 {
        match self {
            Self::Write { address, .. } | Self::Read { address, .. } => *address,
        }
    }
}

enum Parsed {
    /// A message and how many bytes it took.
    Whole(Message, usize),
    /// More bytes are needed.
    Part,
    /// Nothing begins with this byte.
    Unknown,
}

fn parse(bytes: &[u8]) -> Parsed {
    let after_stop = |message: Message, rest: &[u8]| match rest {
        [b'P', rest @ ..] => Parsed::Whole(message, bytes.len() - rest.len()),
        [] => Parsed::Part,
        _ => Parsed::Unknown,
    };
    match bytes {
        [] => Parsed::Part,
        [b'P', ..] => Parsed::Whole(Message::Stop, 1),
        [b'S', ..] => transaction(bytes),
        [b'I', rest @ ..] => after_stop(Message::ReadPort, rest),
        [b'R', rest @ ..] => match rest.iter().position(|&byte| byte == b'P') {
            Some(end) => after_stop(Message::ReadRegisters(rest[..end].to_vec()), &rest[end..]),
            None => Parsed::Part,
        },
        [b'W', rest @ ..] => {
            let mut rest = rest;
            // No register has the number of a stop.
            while let [register, _, after @ ..] = rest
                && *register != b'P'
            {
                rest = after;
            }
            match rest {
                [b'P', ..] => after_stop(Message::WriteRegisters, rest),
                _ => Parsed::Part,
            }
        }
        [b'T', rest @ ..] => {
            let Some((fields, rest)) = rest.split_at_checked(13) else {
                return Parsed::Part;
            };
            let count = |at: usize| u16::from_le_bytes([fields[at], fields[at + 1]]);
            let message = Message::Wait {
                flags: fields[0],
                wait_us: u32::from_le_bytes([fields[1], fields[2], fields[3], fields[4]]),
                traffic: Traffic { received: [count(5), count(7)], sent: [count(9), count(11)] },
            };
            after_stop(message, rest)
        }
        _ => Parsed::Unknown,
    }
}

fn transaction(bytes: &[u8]) -> Parsed {
    let mut parts = Vec::new();
    let mut rest = bytes;
    loop {
        match rest {
            [b'S', address, length, after @ ..] => {
                let reads = address & 1 != 0;
                let address = address >> 1;
                let length = usize::from(*length);
                if reads {
                    parts.push(Part::Read { address, length });
                    rest = after;
                } else {
                    let Some((data, after)) = after.split_at_checked(length) else {
                        return Parsed::Part;
                    };
                    parts.push(Part::Write { address, bytes: data.to_vec() });
                    rest = after;
                }
            }
            [b'P', after @ ..] => {
                return Parsed::Whole(Message::Transaction(parts), bytes.len() - after.len());
            }
            [] | [b'S', ..] => return Parsed::Part,
            _ => return Parsed::Unknown,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wimu_model::Counts;
    use wimu_sim::source::Replay;

    /// Turns the accelerometer on: 100 Hz, 12 bits, data-ready on INT1.
    const START: &[u8] = b"S\x32\x02\x22\x10PS\x32\x02\x23\x88PS\x32\x02\x20\x57P";
    const READ_DATA: &[u8] = b"S\x32\x01\xA8S\x33\x06PR\x0AP";

    fn bridge(samples: usize) -> Bridge {
        let counts = (0..samples).map(|n| Counts([n as i16 * 16 + 16; 3]));
        let clock = VirtualClock::new();
        let sensor = Sensor::lsm303agr(&clock, Replay::new(counts));
        let mut bridge = Bridge::new(&clock, sensor);
        assert!(bridge.receive(START).is_empty());
        bridge
    }

    fn wait(flags: u8, wait_us: u32) -> Vec<u8> {
        let mut message = vec![b'T', flags];
        message.extend(wait_us.to_le_bytes());
        message.extend([0; 8]);
        message.push(b'P');
        message
    }

    fn time(answer: [u8; 5]) -> u32 {
        u32::from_le_bytes([answer[0], answer[1], answer[2], answer[3]])
    }

    #[test]
    fn registers_are_read_with_a_repeated_start() {
        let mut bridge = bridge(0);
        assert_eq!(bridge.receive(b"S\x32\x01\x0FS\x33\x01PR\x0AP"), [0x33, STATUS_OK]);
    }

    #[test]
    fn a_message_may_come_in_any_pieces() {
        for split in 0..READ_DATA.len() {
            let mut bridge = bridge(3);
            bridge.clock().advance_to(11_000);
            let mut answer = bridge.receive(&READ_DATA[..split]);
            answer.extend(bridge.receive(&READ_DATA[split..]));
            assert_eq!(answer, [16, 0, 16, 0, 16, 0, STATUS_OK], "split at {split}");
        }
    }

    #[test]
    fn nobody_at_the_address_reads_as_an_idle_bus_and_a_refusal() {
        let mut bridge = bridge(0);
        let answer = bridge.receive(b"S\x20\x01\x0FS\x21\x02PR\x0AP");
        assert_eq!(answer, [IDLE, IDLE, STATUS_NACK_ADDRESS]);
        bridge.sensor().set_present(false);
        assert_eq!(bridge.receive(READ_DATA)[6], STATUS_NACK_ADDRESS);
    }

    #[test]
    fn a_stuck_bus_is_a_time_out() {
        let mut bridge = bridge(1);
        bridge.bus_faults().set_stuck(true);
        assert_eq!(bridge.receive(READ_DATA)[6], STATUS_TIMEOUT);
    }

    #[test]
    fn the_port_shows_data_ready() {
        let mut bridge = bridge(2);
        assert_eq!(bridge.receive(b"IP"), [0xFE]);
        bridge.clock().advance_to(12_000);
        assert_eq!(bridge.receive(b"IPR\x04P"), [0xFF, 0xFF]);
        bridge.receive(READ_DATA);
        assert_eq!(bridge.receive(b"IP"), [0xFE]);
    }

    #[test]
    fn time_passes_to_the_deadline_or_to_the_data_and_no_further_than_allowed() {
        let mut bridge = bridge(5);
        let started = bridge.clock().now();
        assert_eq!(bridge.pass_time(1_000_000), None, "nobody waits");
        assert!(bridge.receive(&wait(0, 4_000)).is_empty());
        assert_eq!(bridge.pass_time(started + 1_000), None);
        assert_eq!(bridge.clock().now(), started + 1_000);
        let answer = bridge.pass_time(1_000_000).expect("the deadline is before");
        assert_eq!((time(answer), answer[4]), (4_000, 0));
        // The data come before the deadline.
        bridge.receive(&wait(WATCH_DATA_READY, 900_000));
        let answer = bridge.pass_time(1_000_000).expect("data are ready before");
        assert_eq!(answer[4], 1);
        assert!(time(answer) < 11_000, "{}", time(answer));
    }

    #[test]
    fn a_wait_is_ended_by_the_board_at_the_present_time() {
        let mut bridge = bridge(0);
        let started = bridge.clock().now();
        bridge.receive(&wait(0, NO_DEADLINE));
        assert_eq!(bridge.waiting(), Some(Traffic::default()));
        assert_eq!(bridge.pass_time(started + 500), None);
        let answer = bridge.receive(b"P");
        let answer: [u8; 5] = answer.try_into().expect("a time");
        assert_eq!(u64::from(time(answer)), started + 500);
        assert_eq!(bridge.waiting(), None);
        assert!(bridge.receive(b"P").is_empty(), "nothing to end");
    }

    #[test]
    fn a_restarted_board_has_a_clock_from_zero_and_a_sensor_without_a_setting() {
        let mut bridge = bridge(5);
        bridge.clock().advance_to(5_000_000);
        bridge.power_on();
        assert_eq!(bridge.receive(b"S\x32\x01\x20S\x33\x01P"), [0x07]);
        bridge.receive(&wait(0, 700));
        let answer = bridge.pass_time(u64::MAX).expect("the deadline");
        assert_eq!(time(answer), 700);
    }

    #[test]
    fn what_is_no_message_is_passed_over() {
        let mut bridge = bridge(0);
        assert_eq!(bridge.receive(b"xyzIPq\x00IP"), [0xFE, 0xFE]);
    }
}
