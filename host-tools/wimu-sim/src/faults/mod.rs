//! What goes wrong on a link: pacing, latency, losses, bit errors, splices, duplicates, stalls,
//! disconnects, and values that the sender changed. Everything is drawn from a seed by the place in
//! the stream of bytes and by time, so that a run repeats exactly however its bytes are carried.
//!
//! ```
//! use wimu_sim::faults::{Channel, LinkFaults};
//!
//! let faults: LinkFaults = "loss=2%,burst=20,bits=1e-4,jitter=50ms,stall=3s@30s".parse()?;
//! let mut channel = Channel::new(&faults, 7);
//! channel.push(0, &[0x55; 10_000]);
//! let arrived = channel.pull(60_000_000_000, usize::MAX);
//! assert!(arrived.len() < 10_000);
//! assert_eq!(channel.counts().bytes_lost, 10_000 - arrived.len() as u64);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod channel;
mod spec;
mod truth;
mod values;

pub use channel::Channel;
pub use spec::{FaultSpecError, PRESETS};
pub use truth::{Fate, FaultCounts, FrameTruth};

use std::time::Duration;

/// Bytes that an adapter holds at most, if nothing else is said.
pub const DEFAULT_BUFFER: usize = 65_536;

/// The faults of one link, the same in both directions but for the values; none by default.
///
/// As text, for `wimu simulate --faults`: `key=value` joined with commas, see [`PRESETS`] for the
/// names that stand for several.
///
/// | key | value | |
/// |---|---|---|
/// | `baud` | 300 to 4000000 | rate of the simulated UART, bits/s, ten to a byte |
/// | `latency` | `20ms` | delay of every byte |
/// | `jitter` | `50ms`, `exp:50ms` | delay added to every packet (64 bytes, or what came before a pause of 3 ms): uniform up to that, or exponential with that mean |
/// | `loss` | `2%` | part of the bytes lost, in runs (Gilbert and Elliott's two states) |
/// | `burst` | `20` | mean length of a run, bytes |
/// | `bits` | `1e-4` | part of the bits flipped |
/// | `splice` | `1e-5` | per byte: a piece of 1 to 64 bytes sent earlier comes in between |
/// | `duplicate` | `1e-5` | per byte: the last 1 to 256 bytes come again, of one in sixteen up to 4096 |
/// | `stall` | `3s@30s`, `1s@10s/20s` | nothing passes for 3 s from 30 s on; for 1 s from 10 s on and every 20 s; may be given again |
/// | `disconnect` | likewise | both ends lose their connection, and what is under way |
/// | `buffer` | `4096` | bytes held during latency and stalls; more are lost from a UART, and wait on TCP |
/// | `bias` | `10mg`, `10/-5/3mg` | added to every accelerometer sample before it is framed, device to host: all axes, or X, Y, Z |
/// | `scale` | `0.5%`, `100/0/-100ppm` | the samples are multiplied by 1 and that |
/// | `noise` | `2mg` | standard deviation added per axis |
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinkFaults {
    /// Rate of the simulated UART, bits/s; `None` leaves the link's own.
    pub baud: Option<u32>,
    /// Delay of every byte.
    pub latency: Duration,
    /// Delay added to every packet.
    pub jitter: Option<Jitter>,
    /// Runs of bytes that are lost.
    pub loss: Option<Loss>,
    /// Part of the bits that are flipped, 0..=0.5.
    pub bit_error_rate: f64,
    /// Probability per byte that an earlier piece comes in before it, 0..=0.1.
    pub splice_rate: f64,
    /// Probability per byte that the piece up to it comes again, 0..=0.1.
    pub duplicate_rate: f64,
    /// When nothing passes.
    pub stalls: Vec<Outage>,
    /// When there is no connection.
    pub disconnects: Vec<Outage>,
    /// Bytes held at most; `None` for [`DEFAULT_BUFFER`].
    pub buffer: Option<usize>,
    /// What the device's wireless unit does to the values.
    pub values: Option<ValueFaults>,
}

impl LinkFaults {
    /// Whether there are none but a rate of the line.
    pub fn is_none(&self) -> bool {
        let only_baud = Self {
            baud: self.baud,
            ..Self::default()
        };
        *self == only_baud
    }
}

/// How the delay of packets is distributed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Jitter {
    /// Between nothing and this.
    Uniform(Duration),
    /// With this mean, and without a limit.
    Exponential(Duration),
}

/// Gilbert and Elliott's channel: it is good, then bad for a run of bytes, all of them lost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loss {
    /// Part of the bytes lost, 0..=0.9.
    pub fraction: f64,
    /// Mean length of a run, bytes, at least 1.
    pub mean_run: f64,
}

/// A time that comes once, or again and again; counted from the simulation's start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outage {
    /// When it first begins.
    pub start: Duration,
    /// How long it lasts.
    pub length: Duration,
    /// From one begin to the next, longer than it lasts; `None` if it comes once.
    pub every: Option<Duration>,
}

impl Outage {
    /// The outage that is on at `time_ns`, or the next one: its begin and its end, ns.
    fn at_or_after(&self, time_ns: u64) -> Option<(u64, u64)> {
        let [start, length] = [self.start, self.length].map(nanoseconds);
        let past = time_ns.saturating_sub(start);
        let begin = match self.every.map(nanoseconds) {
            _ if past < length => start,
            None | Some(0) => return None,
            Some(every) if past % every < length => start + past - past % every,
            Some(every) => start + past - past % every + every,
        };
        Some((begin, begin + length))
    }

    /// Its end, ns, if it is on at `time_ns`.
    fn end_at(&self, time_ns: u64) -> Option<u64> {
        let (begin, end) = self.at_or_after(time_ns)?;
        (begin <= time_ns).then_some(end)
    }
}

/// Changes of the samples between the sensor and the frame, as a wireless unit with a converter of
/// its own has them: `f + scale ∘ f + bias + noise`, both of raw and of corrected samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ValueFaults {
    /// m/s², axes of the stream.
    pub bias_mps2: [f64; 3],
    /// Error of the scale factor, 1 being 100 %.
    pub scale: [f64; 3],
    /// Standard deviation, m/s².
    pub noise_mps2: f64,
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}
