//! Serial lines with an adjustable rate.

use embassy_futures::select::{Either, Either3, select, select3};
use embassy_sync::blocking_mutex::raw::RawMutex;
use wimu_link::LinkRole;
use wimu_model::DeviceTimeUs;

use crate::sample::RawSample;
use crate::shared::{Common, RateOrder, Shared};
use crate::timer::Timer;

/// Usual rates of radio adapters, bit/s, tried after the stored one.
const USUAL: [u32; 3] = [115_200, 9600, 38_400];
/// Time for which a rate is tried, µs.
const TRY_US: u64 = 2_000_000;
/// Time within which a host must be received at a new rate, µs.
const HEARD_WITHIN_US: u64 = 5_000_000;
/// Longest wait for the answer at the old rate to be sent, µs.
const DRAIN_US: u64 = 2_000_000;
/// Interval between checks whether it has been sent, µs.
const CHECK_US: u64 = 2_000;

/// The rate of a serial line, of both its halves.
///
/// The line's reader must return bytes received at another rate, as any bytes or as an error: they distinguish
/// a wrong rate from silence.
pub trait LineRate {
    /// The supported rate nearest to `baud`, bit/s.
    fn nearest(baud: u32) -> u32;

    /// Sets the rate to `baud`, a result of [`nearest`](Self::nearest), from the next byte on.
    fn set(&mut self, baud: u32);
}

/// Controls the rate of one line: changes it on request, returns to the old rate if no host is received
/// within 5 s, and detects the rate of the adapter on the wireless link.
///
/// A board spawns its `run` beside the node's tasks for each line with an adjustable rate; without it the
/// device reports a fixed rate. A cable uses the rate at which the board opened it until another one is
/// stored. Without the feature `line-rates` its `run` does nothing. A wireless link uses the stored rate, or that at which it was opened. If bytes arrive without an
/// undamaged frame, it tries that rate, 115,200, 9600 and 38,400 baud for 2 s each until an undamaged frame
/// arrives, and stores the rate.
pub struct RateKeeper<'a, L, T, M: RawMutex> {
    role: LinkRole,
    line: L,
    timer: T,
    shared: &'a Common<M>,
    /// The present rate, bit/s.
    rate: u32,
}

#[cfg_attr(not(feature = "line-rates"), allow(dead_code))]
impl<'a, L: LineRate, T: Timer, M: RawMutex> RateKeeper<'a, L, T, M> {
    /// For the line of the link `role`, which the board has opened at `opened` bit/s. To be called before the
    /// node runs.
    pub fn new<S: RawSample>(
        role: LinkRole,
        line: L,
        opened: u32,
        timer: T,
        shared: &'a Shared<M, S>,
    ) -> Self {
        let shared = &shared.common;
        if cfg!(feature = "line-rates") {
            shared.has_rate(role, L::nearest);
        }
        Self { role, line, timer, shared, rate: opened }
    }

    /// Runs for ever.
    pub async fn run(&mut self) -> ! {
        #[cfg(feature = "line-rates")]
        if crate::shared::runs(self.role) {
            self.keep().await
        }
        core::future::pending().await
    }

    async fn keep(&mut self) -> ! {
        let signals = self.shared.rate_signals(self.role);
        let mut next = None;
        loop {
            let order = match next.take() {
                Some(order) => order,
                None => signals.order.wait().await,
            };
            match order {
                RateOrder::Use(stored) => {
                    if self.role == LinkRole::Cable {
                        if let Some(stored) = stored {
                            self.set(stored);
                        }
                    } else {
                        next = self.search(stored.unwrap_or(self.rate)).await;
                    }
                }
                RateOrder::Try(baud) => self.try_out(baud).await,
            }
        }
    }

    /// Detects the adapter's rate; returns early with an order.
    async fn search(&mut self, stored: u32) -> Option<RateOrder> {
        let signals = self.shared.rate_signals(self.role);
        let mut rates = core::iter::once(stored)
            .chain(USUAL.into_iter().filter(move |usual| *usual != stored))
            .cycle();
        self.set(rates.next().unwrap_or(stored));
        loop {
            signals.heard.reset();
            signals.noise.reset();
            let end = self.timer.now().0.saturating_add(TRY_US);
            let waited = select3(
                signals.heard.wait(),
                self.timer.until(DeviceTimeUs(end)),
                signals.order.wait(),
            );
            match waited.await {
                Either3::First(()) => {
                    if self.rate != stored {
                        self.shared.rates.send((self.role, self.rate)).await;
                    }
                    return None;
                }
                // Silence says nothing about the rate.
                Either3::Second(()) if !signals.noise.signaled() => {}
                Either3::Second(()) => self.set(rates.next().unwrap_or(stored)),
                Either3::Third(order) => return Some(order),
            }
        }
    }

    /// Changes the rate after the answer has been sent, and returns to the old one if no host is received.
    async fn try_out(&mut self, baud: u32) {
        let before = self.rate;
        self.drain().await;
        let signals = self.shared.rate_signals(self.role);
        self.set(baud);
        signals.heard.reset();
        let end = self.timer.now().0.saturating_add(HEARD_WITHIN_US);
        let waited = select(signals.heard.wait(), self.timer.until(DeviceTimeUs(end)));
        match waited.await {
            Either::First(()) => self.shared.rates.send((self.role, baud)).await,
            Either::Second(()) => self.set(before),
        }
    }

    /// Waits until all answers have been sent.
    async fn drain(&mut self) {
        let end = self.timer.now().0.saturating_add(DRAIN_US);
        while !self.shared.is_drained(self.role) && self.timer.now().0 < end {
            self.timer.after_us(CHECK_US).await;
        }
    }

    fn set(&mut self, baud: u32) {
        let baud = L::nearest(baud);
        if self.rate != baud {
            self.line.set(baud);
            self.rate = baud;
        }
    }
}
