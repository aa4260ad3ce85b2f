//! The sending half of a UART.

use embassy_rp::interrupt::{Interrupt, InterruptExt};
use embassy_rp::uart::{BufferedUartTx, Error};
use embedded_io_async::{ErrorType, Write};

/// [`BufferedUartTx`], which alone may leave bytes behind: its interrupt takes bytes up to the end
/// of its ring, and comes again only when the hardware's queue falls past a level that it may not
/// have reached. Asking once more takes those from the start of the ring.
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
        let count = Write::write(&mut self.uart, bytes).await?;
        self.interrupt.pend();
        Ok(count)
    }

    fn flush(&mut self) -> impl Future<Output = Result<(), Error>> {
        Write::flush(&mut self.uart)
    }
}
