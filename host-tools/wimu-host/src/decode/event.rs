//! Events of a link, and their statistics.

use crate::calibration::source::ActiveParameters;
use wimu_link::batch::Stream;
use wimu_link::message::{Attitude, Environment, Epoch, Navigation, Status};
use wimu_link::{FrameError, Hello, Reply, Settings};
use wimu_model::{DeviceTimeUs, PeriodNs};

use super::tags::Interval;

/// An event of a link.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant, reason = "events are handed on one at a time")]
pub enum Event {
    /// Identification of the device.
    Hello(Hello),
    /// The device has restarted: sequence numbers and device times begin again.
    Restart {
        /// Boot count, if the device has reported it.
        boot_count: Option<u32>,
    },
    /// Consecutive samples.
    Samples(Samples),
    /// Samples that arrived after later ones.
    Late(Samples),
    /// Samples can be replayed from here on; may arrive before samples that precede it.
    Epoch {
        /// As sent.
        epoch: Epoch,
        /// Whether epochs before it were lost.
        after_loss: bool,
    },
    /// Magnetic field and temperature.
    Environment(Environment),
    /// Velocity and position.
    Navigation(Navigation),
    /// Attitude, of a sensor with a gyroscope.
    Attitude(Attitude),
    /// Parameters in use.
    Parameters(ActiveParameters),
    /// Settings in use.
    Settings(Settings),
    /// Status of the device.
    Status(Status),
    /// An event of the device.
    Device {
        /// When.
        time: DeviceTimeUs,
        /// What.
        event: wimu_link::message::Event,
    },
    /// An answer to a request.
    Reply {
        /// Decoded reply.
        reply: Reply,
        /// The frame's body, which is signed.
        body: Vec<u8>,
    },
    /// An interval has ended with a tag of the device.
    Tagged(Interval),
    /// A damaged frame, or one of another version.
    Damaged(FrameError),
    /// An undamaged frame with an invalid body.
    Unreadable(String),
}

impl Event {
    /// Whether it depends on the start in which it was sent.
    pub(super) fn is_of_a_start(&self) -> bool {
        !matches!(
            self,
            Self::Reply { .. } | Self::Tagged(_) | Self::Damaged(_) | Self::Unreadable(_)
        )
    }
}

/// Consecutive samples of one stream without gaps or repetitions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Samples {
    /// Index of the sensor, 0 to 7.
    pub sensor: u8,
    /// Raw counts or corrected specific force and angular rate.
    pub stream: Stream,
    /// Sequence number of the first.
    pub first_sequence: u32,
    /// Device time of the first.
    pub first_time: DeviceTimeUs,
    /// Sample period of the sensor.
    pub period: PeriodNs,
    /// Difference of consecutive sequence numbers: 1 unless the stream is decimated.
    pub every: u8,
    /// X, Y, Z of the accelerometer, LSB or 2⁻¹⁶ m/s².
    pub values: Vec<[i32; 3]>,
    /// X, Y, Z of the gyroscope, LSB or 2⁻²⁰ rad/s, one for each of `values`; empty without a gyroscope.
    pub rates: Vec<[i32; 3]>,
}

impl Samples {
    /// The samples, one by one.
    pub fn iter(&self) -> impl Iterator<Item = TimedSample> + '_ {
        self.values.iter().enumerate().map(|(index, value)| {
            let later = index as u32 * u32::from(self.every);
            let later_us = u64::from(later) * u64::from(self.period.0) / 1000;
            TimedSample {
                sequence: self.first_sequence.wrapping_add(later),
                time: DeviceTimeUs(self.first_time.0.wrapping_add(later_us)),
                value: *value,
                rate: self.rates.get(index).copied(),
            }
        })
    }

    /// Removes the first `count` samples.
    pub(super) fn drop_first(&mut self, count: usize) {
        let first = self.iter().nth(count);
        if let Some(first) = first {
            self.first_sequence = first.sequence;
            self.first_time = first.time;
        }
        for axes in [&mut self.values, &mut self.rates] {
            axes.drain(..count.min(axes.len()));
        }
    }
}

/// A sample with its number and time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimedSample {
    /// Number among all samples taken by the sensor.
    pub sequence: u32,
    /// When it was taken.
    pub time: DeviceTimeUs,
    /// X, Y, Z of the accelerometer, LSB or 2⁻¹⁶ m/s².
    pub value: [i32; 3],
    /// X, Y, Z of the gyroscope, LSB or 2⁻²⁰ rad/s; `None` without one.
    pub rate: Option<[i32; 3]>,
}

/// An event with the time of arrival of its last byte.
#[derive(Clone, Debug)]
pub struct Arrival {
    /// ns on the host's monotonic clock.
    pub host_ns: u64,
    /// The same for the first byte of its frame: independent of the frame's length.
    pub began_ns: u64,
    /// The event.
    pub event: Event,
}

/// Statistics of a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct LinkStatistics {
    /// Bytes received.
    pub bytes: u64,
    /// Undamaged frames.
    pub frames: u64,
    /// Damaged frames, except those before the first undamaged one: reception may have begun within one.
    pub frames_damaged: u64,
    /// Undamaged frames of an unknown version or kind, or with an invalid body.
    pub frames_unreadable: u64,
    /// Undamaged frames with a number or time that the device cannot have reached; rejected.
    pub frames_rejected: u64,
    /// Events dropped because too many were waiting.
    pub events_dropped: u64,
    /// The raw samples.
    pub raw: StreamStatistics,
    /// The corrected samples.
    pub corrected: StreamStatistics,
    /// The samples of all further sensors, index 1 to 7.
    pub further: StreamStatistics,
    /// Batches whose sequence numbers no epoch defines.
    pub batches_unplaced: u64,
    /// Environment and navigation messages that were repeated or arrived after later ones; left out.
    pub readings_repeated: u64,
    /// How often the link was lost and reopened.
    pub interruptions: u64,
}

impl LinkStatistics {
    pub(super) fn stream(&mut self, sensor: u8, stream: Stream) -> &mut StreamStatistics {
        match (sensor, stream) {
            (0, Stream::Raw) => &mut self.raw,
            (0, Stream::Corrected) => &mut self.corrected,
            _ => &mut self.further,
        }
    }
}

/// Statistics of a stream of samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct StreamStatistics {
    /// Samples received.
    pub received: u64,
    /// Samples between the first and the last received that did not arrive: missed by the device
    /// or lost on the link.
    pub missing: u64,
    /// Repeated samples; left out.
    pub duplicated: u64,
    /// Samples that arrived after later ones; not counted as received.
    pub late: u64,
}
