//! The sensor's I²C bus behind a UART: an SC18IM700-style bridge (NXP), played by the host.
//!
//! The chip's commands are used as its data sheet has them: `S address length [bytes] … P` is a
//! transaction, `R register P` reads one of its registers, `I P` its port. Two things differ: a
//! read without an acknowledgement gives 0xFF bytes, as an idle bus does, and the sensor's data-ready
//! line is bit 0 of the port.

use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::mutex::Mutex;
use embedded_hal_async::i2c::{Error, ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use embedded_io_async::{Read, Write};
use heapless::{CapacityError, Vec};
use wimu_model::DeviceTimeUs;
use wimu_node::Timer;

use crate::clock::{BoardTimer, is_lockstep};
use crate::uart::{Reader, SENSOR_BUS, Writer};

/// I2CStat.
const STATUS_REGISTER: u8 = 0x0A;
const STATUS_OK: u8 = 0xF0;
const STATUS_NACK_ADDRESS: u8 = 0xF1;
const STATUS_NACK_DATA: u8 = 0xF2;
/// Longest time until the bridge answers, µs.
const PATIENCE_US: u64 = 1_000_000;
/// Silence after which the bridge has answered every question, µs.
const QUIET_US: u64 = 100_000;
/// Longest message: 16 samples and the status.
const MESSAGE: usize = 128;

/// The line to the bridge, which answers one question after the other.
pub struct Bridge {
    reader: Reader,
    writer: Writer,
    /// Bytes still to come of an answer that is no longer awaited.
    owed: usize,
    /// Whether it is unknown which answers are still to come.
    lost: bool,
}

impl Bridge {
    /// The bridge on a UART.
    pub fn new((reader, writer): (Reader, Writer)) -> Self {
        Self {
            reader,
            writer,
            owed: 0,
            lost: false,
        }
    }

    /// Sends `question` and waits for as many bytes as `answer` has. If the future is dropped, the
    /// next call discards the rest of the answer. In lockstep no other task runs meanwhile, because its
    /// progress would depend on the speed of the host.
    async fn ask(&mut self, question: &[u8], answer: &mut [u8]) -> Result<(), BridgeError> {
        if is_lockstep() {
            SENSOR_BUS.write_now(question);
            SENSOR_BUS.read_now(answer, || {});
            return Ok(());
        }
        if self.lost {
            self.resynchronise().await?;
        }
        let deadline = DeviceTimeUs(BoardTimer.now().0 + PATIENCE_US);
        while self.owed > 0 {
            let mut stale = [0; MESSAGE];
            let length = self.owed.min(stale.len());
            self.receive(deadline, &mut stale[..length]).await?;
        }
        self.owed = answer.len();
        let Ok(()) = self.writer.write_all(question).await;
        let mut rest = answer;
        while !rest.is_empty() {
            let count = self.receive(deadline, rest).await?;
            rest = &mut rest[count..];
        }
        Ok(())
    }

    async fn receive(
        &mut self,
        deadline: DeviceTimeUs,
        buffer: &mut [u8],
    ) -> Result<usize, BridgeError> {
        match BoardTimer.before(deadline, self.reader.read(buffer)).await {
            Some(Ok(count)) => {
                self.owed -= count;
                Ok(count)
            }
            None => {
                self.lost = true;
                Err(BridgeError::Silent)
            }
        }
    }

    /// Resynchronises after a timeout: a delayed bridge answers every question since then, a restarted one
    /// none of them. Asks once more and discards all answers.
    async fn resynchronise(&mut self) -> Result<(), BridgeError> {
        let Ok(()) = self.writer.write_all(b"IP").await;
        let mut stale = [0; MESSAGE];
        let mut patience = PATIENCE_US;
        loop {
            let deadline = DeviceTimeUs(BoardTimer.now().0 + patience);
            match BoardTimer
                .before(deadline, self.reader.read(&mut stale))
                .await
            {
                Some(Ok(_)) => patience = QUIET_US,
                None if patience == QUIET_US => break,
                None => return Err(BridgeError::Silent),
            }
        }
        self.owed = 0;
        self.lost = false;
        Ok(())
    }

    /// Whether the sensor has data.
    pub async fn data_ready(&mut self) -> Result<bool, BridgeError> {
        let mut port = [0];
        self.ask(b"IP", &mut port).await?;
        Ok(port[0] & 1 != 0)
    }
}

/// Why a transaction failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BridgeError {
    /// The bridge does not answer.
    Silent,
    /// The transaction is longer than a message.
    TooLong,
    /// The bridge reports a status other than done.
    Status(u8),
}

impl From<CapacityError> for BridgeError {
    fn from(_: CapacityError) -> Self {
        Self::TooLong
    }
}

impl Error for BridgeError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Status(STATUS_NACK_ADDRESS) => {
                ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address)
            }
            Self::Status(STATUS_NACK_DATA) => ErrorKind::NoAcknowledge(NoAcknowledgeSource::Data),
            Self::Status(_) => ErrorKind::Bus,
            Self::TooLong => ErrorKind::Overrun,
            Self::Silent => ErrorKind::Other,
        }
    }
}

/// The sensor's bus.
pub struct BridgeI2c(pub &'static Mutex<NoopRawMutex, Bridge>);

impl ErrorType for BridgeI2c {
    type Error = BridgeError;
}

impl I2c for BridgeI2c {
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), BridgeError> {
        let mut question = Vec::<u8, MESSAGE>::new();
        let mut expected = 1;
        // Neighbours in one direction are one message on the bus.
        let same = |a: &Operation<'_>, b: &Operation<'_>| {
            matches!(a, Operation::Read(_)) == matches!(b, Operation::Read(_))
        };
        for group in operations.chunk_by(same) {
            let reads = matches!(group, [Operation::Read(_), ..]);
            let length: usize = group.iter().map(length).sum();
            let count = u8::try_from(length).map_err(|_| BridgeError::TooLong)?;
            question.extend_from_slice(&[b'S', address << 1 | u8::from(reads), count])?;
            for operation in group {
                if let Operation::Write(bytes) = operation {
                    question.extend_from_slice(bytes)?;
                }
            }
            expected += if reads { length } else { 0 };
        }
        question.extend_from_slice(&[b'P', b'R', STATUS_REGISTER, b'P'])?;

        let mut answer = [0; MESSAGE];
        let answer = answer.get_mut(..expected).ok_or(BridgeError::TooLong)?;
        self.0.lock().await.ask(&question, answer).await?;
        match answer {
            [data @ .., STATUS_OK] => {
                let mut rest = &*data;
                for operation in operations {
                    if let Operation::Read(buffer) = operation {
                        let (mine, after) = rest.split_at(buffer.len());
                        buffer.copy_from_slice(mine);
                        rest = after;
                    }
                }
                Ok(())
            }
            [.., status] => Err(BridgeError::Status(*status)),
            [] => Err(BridgeError::Silent),
        }
    }
}

fn length(operation: &Operation<'_>) -> usize {
    match operation {
        Operation::Read(buffer) => buffer.len(),
        Operation::Write(bytes) => bytes.len(),
    }
}
