//! An I²C bus at 400 kHz in virtual time, and faults on it.

use std::cell::Cell;
use std::rc::Rc;

use embedded_hal_async::i2c::{
    Error, ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation, SevenBitAddress,
};

use crate::clock::VirtualClock;

/// A device on the bus.
///
/// Bytes come at the time the clock shows. A message to the device begins with
/// [`begin_write`](Self::begin_write); a message from it is only [`read`](Self::read).
pub trait Target {
    /// Whether it answers at `address`, 0..=127.
    fn acknowledges(&self, address: u8) -> bool;
    /// A message to `address` begins.
    fn begin_write(&self, address: u8);
    /// The next byte of the message to `address`.
    fn write(&self, address: u8, byte: u8);
    /// The next byte from `address`.
    fn read(&self, address: u8) -> u8;
}

/// The bus as its controller sees it; [`SimI2c::faults`] injects faults.
///
/// A cancelled transaction ends at the byte it had reached. Clones are the same bus: each waits for its own transactions
/// only.
#[derive(Clone)]
pub struct SimI2c {
    clock: VirtualClock,
    targets: Vec<Rc<dyn Target>>,
    faults: Faults,
}

/// Nine clocks of 400 kHz: eight bits and the acknowledgement.
const BYTE_NS: u64 = 22_500;
/// A start, repeated start or stop condition.
const CONDITION_NS: u64 = 2_500;
/// Interval at which a controller checks a line that is held low, µs.
const HELD_US: u64 = 100;

impl SimI2c {
    /// A bus with `targets` on it.
    pub fn new(clock: &VirtualClock, targets: impl IntoIterator<Item = Rc<dyn Target>>) -> Self {
        Self {
            clock: clock.clone(),
            targets: targets.into_iter().collect(),
            faults: Faults::default(),
        }
    }

    /// Handle for faults of this bus, also while it runs.
    pub fn faults(&self) -> Faults {
        self.faults.clone()
    }

    /// Waits until the bus has been busy up to `time_ns`.
    async fn busy_until(&self, time_ns: u64) {
        self.clock.until(time_ns.div_ceil(1000)).await;
    }
}

impl ErrorType for SimI2c {
    type Error = I2cError;
}

impl I2c<SevenBitAddress> for SimI2c {
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), I2cError> {
        // Like real controllers, without time-out.
        while self.faults.stuck() {
            self.clock.until(self.clock.now() + HELD_US).await;
        }
        let answered = self.faults.next_is_answered();
        let mut time_ns = self.clock.now() * 1000;
        let mut reading = None;
        for operation in operations {
            // Operations in one direction are one message.
            let reads = matches!(operation, Operation::Read(_));
            if reading != Some(reads) {
                reading = Some(reads);
                time_ns += CONDITION_NS + BYTE_NS;
                self.busy_until(time_ns).await;
            }
            let target = self.targets.iter().find(|t| t.acknowledges(address));
            let target = match target {
                Some(target) if answered => target.clone(),
                _ => return Err(I2cError::NoAcknowledge { address }),
            };
            match operation {
                Operation::Read(buffer) => {
                    for byte in buffer.iter_mut() {
                        time_ns += BYTE_NS;
                        self.busy_until(time_ns).await;
                        *byte = target.read(address);
                    }
                }
                Operation::Write(bytes) => {
                    target.begin_write(address);
                    for byte in bytes.iter() {
                        time_ns += BYTE_NS;
                        self.busy_until(time_ns).await;
                        target.write(address, *byte);
                    }
                }
            }
        }
        self.busy_until(time_ns + CONDITION_NS).await;
        Ok(())
    }
}

/// Why a transaction failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum I2cError {
    /// No device answers.
    #[error("no device acknowledges address {address:#04x}")]
    NoAcknowledge {
        /// At this address.
        address: u8,
    },
}

impl Error for I2cError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::NoAcknowledge { .. } => ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address),
        }
    }
}

/// Faults of a bus, also while it runs; clones control the same bus.
#[derive(Clone, Debug, Default)]
pub struct Faults(Rc<FaultState>);

#[derive(Debug, Default)]
struct FaultState {
    stuck: Cell<bool>,
    /// Number of transactions that are still answered.
    answered: Cell<Option<u32>>,
}

impl Faults {
    /// Holds a line low, or releases it: while held, no transaction begins.
    pub fn set_stuck(&self, stuck: bool) {
        self.0.stuck.set(stuck);
    }

    /// Answers `transactions` more, and refuses all later ones at their address.
    pub fn refuse_after(&self, transactions: u32) {
        self.0.answered.set(Some(transactions));
    }

    /// Removes all faults.
    pub fn clear(&self) {
        self.0.stuck.set(false);
        self.0.answered.set(None);
    }

    /// Whether the bus is held low.
    pub fn stuck(&self) -> bool {
        self.0.stuck.get()
    }

    fn next_is_answered(&self) -> bool {
        match self.0.answered.get() {
            None => true,
            Some(left) => {
                self.0.answered.set(Some(left.saturating_sub(1)));
                left > 0
            }
        }
    }
}
