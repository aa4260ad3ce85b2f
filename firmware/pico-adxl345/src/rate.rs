//! The rate of a UART.

use embassy_rp::clocks::clk_peri_freq;
use embassy_rp::pac::uart::Uart;
use wimu_node::LineRate;

/// A UART's rate: the driver sets one only before its halves are apart.
pub struct Rate(pub Uart);

/// Bits of a byte with its start and stop.
const BITS: u32 = 10;
/// Bytes that the hardware's queue holds.
const QUEUE: u32 = 32;

impl Rate {
    /// Clocks of a bit, in quarters of one: what the chip takes as 1/64 of 16 clocks.
    fn divisor(baud: u32) -> u32 {
        let quarters = clk_peri_freq().saturating_mul(4);
        (quarters + baud / 2) / baud.max(1)
    }
}

impl LineRate for Rate {
    /// The divisor has fractions: all rates from the slowest adapter's to what the host's are.
    fn nearest(baud: u32) -> u32 {
        baud.clamp(1200, 921_600)
    }

    fn set(&mut self, baud: u32) {
        let whole = u32::from(self.0.uartibrd().read().baud_divint()) << 6;
        let before = whole | u32::from(self.0.uartfbrd().read().baud_divfrac());
        // A bit takes a quarter as many clocks of the UART, which are the processor's.
        let byte_clocks = BITS * before / 4;
        // What has been handed over leaves at the old rate.
        for _ in 0..=QUEUE {
            if !self.0.uartfr().read().busy() {
                break;
            }
            cortex_m::asm::delay(byte_clocks);
        }
        let divisor = Self::divisor(baud);
        self.0.uartcr().modify(|control| control.set_uarten(false));
        // A byte that is being received ends.
        cortex_m::asm::delay(2 * byte_clocks);
        self.0
            .uartibrd()
            .write(|w| w.set_baud_divint((divisor >> 6) as u16));
        self.0
            .uartfbrd()
            .write(|w| w.set_baud_divfrac((divisor & 63) as u8));
        // Writing this one makes the chip take the divisor.
        self.0.uartlcr_h().modify(|_| {});
        self.0.uartcr().modify(|control| control.set_uarten(true));
    }
}
