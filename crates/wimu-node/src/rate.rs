//! Lines whose rate can be set.

use embassy_futures::select::{Either, Either3, select, select3};
use embassy_sync::blocking_mutex::raw::RawMutex;
use wimu_link::LinkRole;
use wimu_model::DeviceTimeUs;

use crate::shared::{RateOrder, Shared};
use crate::timer::Timer;

/// The rates that radio adapters are usually set to, tried after the stored one.
const USUAL: [u32; 3] = [115_200, 9600, 38_400];
/// A rate is tried so long.
const TRY_US: u64 = 2_000_000;
/// A host has so long to be heard at a new rate.
const HEARD_WITHIN_US: u64 = 5_000_000;
/// The answer at the old rate has so long to leave.
const DRAIN_US: u64 = 2_000_000;
/// So often it is looked at.
const GLANCE_US: u64 = 2_000;

/// The rate of a serial line, of both its halves.
///
/// Bytes that come at another rate must come out of the line's reader, as whatever bytes or as an
/// error: by them the node tells a wrong rate from silence.
pub trait LineRate {
    /// The rate nearest to `baud`, bits/s, that the line can run at.
    fn nearest(baud: u32) -> u32;

    /// Runs the line at `baud`, one that [`nearest`](Self::nearest) returns, from the next byte on.
    fn set(&mut self, baud: u32);
}

/// Keeps the rate of one line: sets it when a host asks, goes back when the host is not heard at the
/// new one within 5 s, and finds an adapter's on the wireless link.
///
/// A board spawns its `run` beside the node's tasks for each line whose rate can be set; without it
/// the device says of a link that its rate is fixed. A cable runs as the board opened it until a rate
/// is stored. A wireless link runs at the stored rate, or as it was opened, until bytes come that no
/// frame is made of; then it tries that rate, 115,200, 9600 and 38,400 baud, 2 s each, until an
/// undamaged frame comes, and stores what worked.
pub struct RateKeeper<'a, L, T, M: RawMutex> {
    role: LinkRole,
    line: L,
    timer: T,
    shared: &'a Shared<M>,
    /// What the line runs at.
    rate: u32,
}

impl<'a, L: LineRate, T: Timer, M: RawMutex> RateKeeper<'a, L, T, M> {
    /// For the line of the link `role`, which the board has opened at `opened` bits/s; make it before
    /// the node runs.
    pub fn new(role: LinkRole, line: L, opened: u32, timer: T, shared: &'a Shared<M>) -> Self {
        shared.has_rate(role, L::nearest);
        Self {
            role,
            line,
            timer,
            shared,
            rate: opened,
        }
    }

    /// Runs for ever.
    pub async fn run(&mut self) -> ! {
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

    /// Finds the adapter's rate; returns early with an order.
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
                // In silence nobody is misunderstood.
                Either3::Second(()) if !signals.noise.signaled() => {}
                Either3::Second(()) => self.set(rates.next().unwrap_or(stored)),
                Either3::Third(order) => return Some(order),
            }
        }
    }

    /// Changes the rate after the answer has left, and goes back if nobody is heard at it.
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

    /// Waits until no answer is left to send.
    async fn drain(&mut self) {
        let end = self.timer.now().0.saturating_add(DRAIN_US);
        while !self.shared.is_drained(self.role) && self.timer.now().0 < end {
            self.timer.after_us(GLANCE_US).await;
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
