//! A [`Transport`] over the Nordic UART Service: a stream of bytes in the packets of Bluetooth Low Energy.

use std::collections::VecDeque;
use std::time::Duration;

use super::Transport;
use crate::{Code, Problem, Result};

/// Longest write of a connection whose MTU was not negotiated, bytes: 23 − 3.
const SHORTEST: usize = 20;

/// A connection to a peripheral with the Nordic UART Service. The feature `ble` implements it with `btleplug`; implement
/// it for another Bluetooth stack, and give it to [`NusLink::new`].
///
/// The `Err` of a function says why the connection has ended.
pub trait Peripheral {
    /// Longest value of one write, bytes: the MTU − 3.
    fn longest(&self) -> usize;

    /// Whether a write can be confirmed by the peripheral. Otherwise all are without response.
    fn confirms(&self) -> bool;

    /// Waits for the next notification; `None` without one within `timeout`.
    ///
    /// # Errors
    /// The connection has ended.
    fn notification(&mut self, timeout: Duration) -> std::result::Result<Option<Vec<u8>>, String>;

    /// Writes one piece of at most [`longest`](Self::longest) bytes; with `confirmed`, waits for the response.
    ///
    /// # Errors
    /// The connection has ended.
    fn write(&mut self, piece: &[u8], confirmed: bool) -> std::result::Result<(), String>;
}

/// Bytes to and from a [`Peripheral`].
///
/// Writes are split into pieces that the connection carries. They are confirmed where the peripheral allows it: requests
/// are short, and a stack may discard unconfirmed writes without notice.
#[derive(Debug)]
pub struct NusLink<P> {
    name: String,
    peripheral: P,
    received: VecDeque<u8>,
}

impl<P: Peripheral> NusLink<P> {
    /// The link that errors call `name`.
    pub fn new(name: impl Into<String>, peripheral: P) -> Self {
        Self { name: name.into(), peripheral, received: VecDeque::new() }
    }

    fn lost(&self, why: &str) -> Problem {
        Code::LinkLost
            .error(
                format!("the Bluetooth connection has ended: {why}"),
                "check the board's supply and its distance, then connect again",
            )
            .at(&self.name)
    }
}

impl<P: Peripheral> Transport for NusLink<P> {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize> {
        if self.received.is_empty() && !buffer.is_empty() {
            let value = self.peripheral.notification(timeout);
            let value = value.map_err(|why| self.lost(&why))?;
            self.received.extend(value.unwrap_or_default());
        }
        let count = self.received.len().min(buffer.len());
        for (place, byte) in buffer.iter_mut().zip(self.received.drain(..count)) {
            *place = byte;
        }
        Ok(count)
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        let confirmed = self.peripheral.confirms();
        for piece in bytes.chunks(self.peripheral.longest().max(SHORTEST)) {
            let written = self.peripheral.write(piece, confirmed);
            written.map_err(|why| self.lost(&why))?;
        }
        Ok(())
    }
}
