//! What a link brings, and how much of it.

use wimu_link::batch::Stream;
use wimu_link::message::{ActiveParameters, Environment, Epoch, Navigation, Status};
use wimu_link::{FrameError, Hello, Reply, Settings};
use wimu_model::{DeviceTimeUs, PeriodNs};

/// Something that a link brought.
#[derive(Clone, Debug)]
#[allow(
    clippy::large_enum_variant,
    reason = "events are handed on one at a time"
)]
pub enum Event {
    /// Who the device is.
    Hello(Hello),
    /// The device has started anew: sequence numbers and device times begin again.
    Restart {
        /// Which start it is, if the device has said so.
        boot_count: Option<u32>,
    },
    /// Consecutive samples.
    Samples(Samples),
    /// Samples that arrived after later ones.
    Late(Samples),
    /// From here on samples can be replayed; may come before samples that precede it.
    Epoch {
        /// As sent.
        epoch: Epoch,
        /// Whether epochs before it have not arrived.
        after_loss: bool,
    },
    /// Magnetic field and temperature.
    Environment(Environment),
    /// Velocity and position.
    Navigation(Navigation),
    /// The parameters in use.
    Parameters(ActiveParameters),
    /// The settings in use.
    Settings(Settings),
    /// How the device is.
    Status(Status),
    /// Something happened on the device.
    Device {
        /// When.
        time: DeviceTimeUs,
        /// What.
        event: wimu_link::message::Event,
    },
    /// An answer to a request.
    Reply {
        /// What is known of it here.
        reply: Reply,
        /// The frame's body, which the signature holds for.
        body: Vec<u8>,
    },
    /// A damaged frame, or one of another version.
    Damaged(FrameError),
    /// An undamaged frame whose body makes no sense here.
    Unreadable(String),
}

impl Event {
    /// Whether it says something of the start that it is from.
    pub(super) fn is_of_a_start(&self) -> bool {
        !matches!(
            self,
            Self::Reply { .. } | Self::Damaged(_) | Self::Unreadable(_)
        )
    }
}

/// Samples of one stream, of which none between the first and the last is missing, never the same
/// ones twice.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Samples {
    /// Raw counts or corrected specific force.
    pub stream: Stream,
    /// Sequence number of the first.
    pub first_sequence: u32,
    /// Device time of the first.
    pub first_time: DeviceTimeUs,
    /// Time from one sample that the sensor takes to the next.
    pub period: PeriodNs,
    /// From one sample's sequence number to the next one's: 1 unless the stream is decimated.
    pub every: u8,
    /// X, Y, Z in LSB or 2⁻¹⁶ m/s².
    pub values: Vec<[i32; 3]>,
}

impl Samples {
    /// The samples one by one.
    pub fn iter(&self) -> impl Iterator<Item = TimedSample> + '_ {
        self.values.iter().enumerate().map(|(index, value)| {
            let later = index as u32 * u32::from(self.every);
            let later_us = u64::from(later) * u64::from(self.period.0) / 1000;
            TimedSample {
                sequence: self.first_sequence.wrapping_add(later),
                time: DeviceTimeUs(self.first_time.0.wrapping_add(later_us)),
                value: *value,
            }
        })
    }
}

/// A sample with its number and time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimedSample {
    /// Counts every sample that the sensor took.
    pub sequence: u32,
    /// When it was taken.
    pub time: DeviceTimeUs,
    /// X, Y, Z in LSB or 2⁻¹⁶ m/s².
    pub value: [i32; 3],
}

/// An event and when the bytes that completed it arrived.
#[derive(Clone, Debug)]
pub struct Arrival {
    /// ns on the host's monotonic clock.
    pub host_ns: u64,
    /// The same for the first byte of its frame: independent of the frame's length.
    pub began_ns: u64,
    /// What arrived.
    pub event: Event,
}

/// What a link carried and lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct LinkStatistics {
    /// Bytes received.
    pub bytes: u64,
    /// Undamaged frames.
    pub frames: u64,
    /// Damaged frames, but for those before the first whole one: listening may have begun within
    /// one.
    pub frames_damaged: u64,
    /// Undamaged frames of an unknown version or kind, or with a body that makes no sense.
    pub frames_unreadable: u64,
    /// Undamaged frames with a number or time that the device cannot have reached, which were left out.
    pub frames_rejected: u64,
    /// Events that were left out because too many waited for somebody to take them.
    pub events_dropped: u64,
    /// The raw samples.
    pub raw: StreamStatistics,
    /// The corrected samples.
    pub corrected: StreamStatistics,
    /// Batches that no epoch has told the place of.
    pub batches_unplaced: u64,
    /// Magnetic field and temperature, velocity and position that arrived again or after later ones
    /// and were left out.
    pub readings_repeated: u64,
    /// How often the link was lost and had to be opened again.
    pub interruptions: u64,
}

impl LinkStatistics {
    pub(super) fn stream(&mut self, stream: Stream) -> &mut StreamStatistics {
        match stream {
            Stream::Raw => &mut self.raw,
            Stream::Corrected => &mut self.corrected,
        }
    }
}

/// What of a stream of samples arrived.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct StreamStatistics {
    /// Samples received.
    pub received: u64,
    /// Samples between the first and the last received that did not arrive: missed by the device
    /// or lost on the link.
    pub missing: u64,
    /// Samples that arrived again and were left out.
    pub duplicated: u64,
    /// Samples that arrived after later ones: not among those received.
    pub late: u64,
}
