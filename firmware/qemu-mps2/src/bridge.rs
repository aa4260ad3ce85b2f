//! The sensor's I²C bus behind a UART: an SC18IM700-style bridge (NXP), simulated by the host.
//!
//! The commands are those of the chip's datasheet: `S address length [bytes] … P` is a
//! transaction, `R register P` reads one of its registers, `I P` its port. Two things differ: a
//! read without an acknowledgement returns 0xFF bytes, as from an idle bus, and the sensor's data-ready
//! line is bit 0 of the port.

use embassy_sync::mutex::Mutex;
use embedded_hal_async::i2c::{Error, ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use embedded_io_async::{Read, Write};
use heapless::{CapacityError, Vec};
use wimu_embassy::Mutex as RawMutex;
use wimu_model::DeviceTimeUs;
use wimu_node::Timer;

use crate::clock::{BoardTimer, is_lockstep};
use crate::uart::{Reader, SENSOR_BUS, Writer};
use crate::watchdog;

/// Register I2CStat.
const STATUS_REGISTER: u8 = 0x0A;
const STATUS_OK: u8 = 0xF0;
const STATUS_NACK_ADDRESS: u8 = 0xF1;
const STATUS_NACK_DATA: u8 = 0xF2;
/// Timeout of an answer, µs.
const TIMEOUT_US: u64 = 1_000_000;
/// Idle time of the line after which the bridge has answered every request, µs.
const IDLE_US: u64 = 100_000;
/// Capacity for a message, bytes: the longest one is 16 samples of 14 bytes and the status.
const MESSAGE: usize = 256;

/// The line to the bridge, which answers the requests in order.
pub struct Bridge {
    reader: Reader,
    writer: Writer,
    /// Bytes not yet received of the latest answer. If its future was dropped, they are discarded.
    pending_bytes: usize,
    /// Whether the number of pending bytes is unknown, after a timeout.
    out_of_sync: bool,
}

impl Bridge {
    /// The bridge on a UART.
    pub fn new((reader, writer): (Reader, Writer)) -> Self {
        Self { reader, writer, pending_bytes: 0, out_of_sync: false }
    }

    /// Sends `request` and waits for as many bytes as `answer` has. If the future is dropped, the
    /// next call discards the rest of the answer. In lockstep no other task runs meanwhile, because its
    /// progress would depend on the speed of the host.
    async fn ask(&mut self, request: &[u8], answer: &mut [u8]) -> Result<(), BridgeError> {
        if is_lockstep() {
            SENSOR_BUS.write_now(request);
            SENSOR_BUS.read_now(answer, || {});
            return Ok(());
        }
        if self.out_of_sync {
            self.resynchronise().await?;
        }
        let deadline = DeviceTimeUs(BoardTimer.now().0 + TIMEOUT_US);
        while self.pending_bytes > 0 {
            let mut stale = [0; MESSAGE];
            let length = self.pending_bytes.min(stale.len());
            self.receive(deadline, &mut stale[..length]).await?;
        }
        self.pending_bytes = answer.len();
        let Ok(()) = self.writer.write_all(request).await;
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
                self.pending_bytes -= count;
                Ok(count)
            }
            None => {
                self.out_of_sync = true;
                Err(BridgeError::Silent)
            }
        }
    }

    /// Resynchronises after a timeout: a delayed bridge answers every request since then, a restarted one
    /// none of them. Sends one more request and discards all answers.
    async fn resynchronise(&mut self) -> Result<(), BridgeError> {
        let Ok(()) = self.writer.write_all(b"IP").await;
        let mut stale = [0; MESSAGE];
        let mut timeout = TIMEOUT_US;
        loop {
            let deadline = DeviceTimeUs(BoardTimer.now().0 + timeout);
            match BoardTimer.before(deadline, self.reader.read(&mut stale)).await {
                Some(Ok(_)) => timeout = IDLE_US,
                None if timeout == IDLE_US => break,
                None => return Err(BridgeError::Silent),
            }
        }
        self.pending_bytes = 0;
        self.out_of_sync = false;
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
pub struct BridgeI2c(pub &'static Mutex<RawMutex, Bridge>);

impl ErrorType for BridgeI2c {
    type Error = BridgeError;
}

impl I2c for BridgeI2c {
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), BridgeError> {
        watchdog::fail_as_requested().await;
        let mut request = Vec::<u8, MESSAGE>::new();
        let mut expected = 1;
        // Neighbours in one direction are one message on the bus.
        let same = |a: &Operation<'_>, b: &Operation<'_>| {
            matches!(a, Operation::Read(_)) == matches!(b, Operation::Read(_))
        };
        for group in operations.chunk_by(same) {
            let reads = matches!(group, [Operation::Read(_), ..]);
            let length: usize = group.iter().map(length).sum();
            let count = u8::try_from(length).map_err(|_| BridgeError::TooLong)?;
            request.extend_from_slice(&[b'S', address << 1 | u8::from(reads), count])?;
            for operation in group {
                if let Operation::Write(bytes) = operation {
                    request.extend_from_slice(bytes)?;
                }
            }
            expected += if reads { length } else { 0 };
        }
        request.extend_from_slice(&[b'P', b'R', STATUS_REGISTER, b'P'])?;

        let mut answer = [0; MESSAGE];
        let answer = answer.get_mut(..expected).ok_or(BridgeError::TooLong)?;
        self.0.lock().await.ask(&request, answer).await?;
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
