//! The sending half of a UART.

use core::future::poll_fn;
use core::pin::pin;

use embassy_rp::interrupt::{Interrupt, InterruptExt};
use embassy_rp::uart::{BufferedUart, BufferedUartRx, BufferedUartTx, Error};
use embedded_io_async::{ErrorType, Write};

/// [`BufferedUartTx`] with a workaround. Its interrupt takes bytes up to the end of its ring buffer, and occurs
/// again only when the hardware's FIFO falls below a level that it may not have reached. Whoever waits for the ring
/// buffer pends the interrupt once more, which takes the bytes at the start of the ring buffer.
pub struct Sender {
    /// The UART.
    pub uart: BufferedUartTx,
    /// Its interrupt.
    pub interrupt: Interrupt,
}

impl ErrorType for Sender {
    type Error = Error;
}

impl Write for Sender {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Error> {
        with_interrupt(self.interrupt, Write::write(&mut self.uart, bytes)).await
    }

    async fn flush(&mut self) -> Result<(), Error> {
        with_interrupt(self.interrupt, Write::flush(&mut self.uart)).await
    }
}

/// `transfer`, with its interrupt pending after each poll.
async fn with_interrupt<T>(interrupt: Interrupt, transfer: impl Future<Output = T>) -> T {
    let mut transfer = pin!(transfer);
    poll_fn(|context| {
        let state = transfer.as_mut().poll(context);
        interrupt.pend();
        state
    })
    .await
}

/// Both halves of a UART with this interrupt.
pub fn halves(uart: BufferedUart, interrupt: Interrupt) -> (BufferedUartRx, Sender) {
    let (sender, receiver) = uart.split();
    (receiver, Sender { uart: sender, interrupt })
}

/// The fractional divisor of a UART supports every rate between the usual limits.
pub fn nearest_rate(baud: u32) -> u32 {
    baud.clamp(1200, 921_600)
}
