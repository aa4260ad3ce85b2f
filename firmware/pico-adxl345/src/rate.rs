//! The rate of a UART.

use embassy_rp::clocks::clk_peri_freq;
use embassy_rp::pac::uart::Uart;
use wimu_node::LineRate;

/// A UART's rate. The driver can set it only before it is split.
pub struct Rate(pub Uart);

/// Bits of a byte with start and stop bit.
const BITS: u32 = 10;
/// Bytes of the hardware's FIFO.
const QUEUE: u32 = 32;

impl Rate {
    /// Divisor in the chip's unit: quarters of a clock per bit (1/64 of 16 clocks).
    fn divisor(baud: u32) -> u32 {
        let quarters = clk_peri_freq().saturating_mul(4);
        (quarters + baud / 2) / baud.max(1)
    }
}

impl LineRate for Rate {
    /// The fractional divisor supports every rate between the usual limits.
    fn nearest(baud: u32) -> u32 {
        baud.clamp(1200, 921_600)
    }

    fn set(&mut self, baud: u32) {
        let whole = u32::from(self.0.uartibrd().read().baud_divint()) << 6;
        let before = whole | u32::from(self.0.uartfbrd().read().baud_divfrac());
        // `before` counts quarters of a clock; UART and processor have the same clock.
        let byte_clocks = BITS * before / 4;
        // Wait until bytes in the FIFO are sent at the old rate.
        for _ in 0..=QUEUE {
            if !self.0.uartfr().read().busy() {
                break;
            }
            cortex_m::asm::delay(byte_clocks);
        }
        let divisor = Self::divisor(baud);
        self.0.uartcr().modify(|control| control.set_uarten(false));
        // Wait for the end of a byte being received.
        cortex_m::asm::delay(2 * byte_clocks);
        self.0.uartibrd().write(|w| w.set_baud_divint((divisor >> 6) as u16));
        self.0.uartfbrd().write(|w| w.set_baud_divfrac((divisor & 63) as u8));
        // The chip takes over the divisor when this register is written.
        self.0.uartlcr_h().modify(|_| {});
        self.0.uartcr().modify(|control| control.set_uarten(true));
    }
}
