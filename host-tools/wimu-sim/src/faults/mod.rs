//! Faults of a link: baud rate, latency, losses, bit errors, splices, duplicates, stalls,
//! disconnects, and changed values. Everything is drawn from a seed by the position in
//! the byte stream and by time, so that a run repeats exactly in any partition of its bytes.
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
mod sensor;
mod spec;
mod truth;
mod values;

pub use channel::Channel;
pub use sensor::{SensorFault, SensorFaultError};
pub use spec::{FaultSpecError, PRESETS};
pub use truth::{Fate, FaultCounts, FrameTruth};

use std::time::Duration;

/// Default size of an adapter's buffer, bytes.
pub const DEFAULT_BUFFER: usize = 65_536;

/// The faults of one link, the same in both directions except the values; none by default.
///
/// As text, for `wimu simulate --faults`: `key=value` joined with commas, or names in [`PRESETS`].
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
    /// Baud rate of the simulated UART; `None` keeps the link's own.
    pub baud: Option<u32>,
    /// Delay of every byte.
    pub latency: Duration,
    /// Delay added to every packet.
    pub jitter: Option<Jitter>,
    /// Runs of lost bytes.
    pub loss: Option<Loss>,
    /// Fraction of flipped bits, 0..=0.5.
    pub bit_error_rate: f64,
    /// Probability per byte that an earlier piece is inserted before it, 0..=0.1.
    pub splice_rate: f64,
    /// Probability per byte that the preceding piece is repeated, 0..=0.1.
    pub duplicate_rate: f64,
    /// Times without transmission.
    pub stalls: Vec<Outage>,
    /// Times without a connection.
    pub disconnects: Vec<Outage>,
    /// Size of the buffer, bytes; `None` for [`DEFAULT_BUFFER`].
    pub buffer: Option<usize>,
    /// Changes of the values by the wireless unit.
    pub values: Option<ValueFaults>,
}

impl LinkFaults {
    /// Whether there are none except a baud rate.
    pub fn is_none(&self) -> bool {
        let only_baud = Self { baud: self.baud, ..Self::default() };
        *self == only_baud
    }
}

/// How the delay of packets is distributed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Jitter {
    /// Uniform from 0 to this.
    Uniform(Duration),
    /// Exponential with this mean.
    Exponential(Duration),
}

/// Gilbert and Elliott's channel: in its bad state all bytes are lost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loss {
    /// Fraction of lost bytes, 0..=0.9.
    pub fraction: f64,
    /// Mean length of a run, bytes, at least 1.
    pub mean_run: f64,
}

/// A single or periodic interval; times from the simulation's start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outage {
    /// First begin.
    pub start: Duration,
    /// Duration.
    pub length: Duration,
    /// Period, longer than the duration; `None` for a single one.
    pub every: Option<Duration>,
}

impl Outage {
    /// The outage at `time_ns`, or the next one: begin and end, ns.
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

    /// The end of the outage at `time_ns`, ns.
    fn end_at(&self, time_ns: u64) -> Option<u64> {
        let (begin, end) = self.at_or_after(time_ns)?;
        (begin <= time_ns).then_some(end)
    }
}

/// Changes of the samples between sensor and frame, as of a wireless unit with its own
/// converter: `f + scale ∘ f + bias + noise`, of raw and corrected samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ValueFaults {
    /// m/s², axes of the stream.
    pub bias_mps2: [f64; 3],
    /// Scale factor error, 1 being 100 %.
    pub scale: [f64; 3],
    /// Standard deviation, m/s².
    pub noise_mps2: f64,
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}
