//! Batches of samples under way to the links.

use core::num::NonZeroU8;

use embassy_sync::blocking_mutex::raw::RawMutex;
use heapless::Vec;
use wimu_link::LinkRole;
use wimu_link::batch::{self, Layout, MAX_BATCH, Sample, Stream};
use wimu_link::frame::MAX_FRAME;
use wimu_link::message::{Settings, Streams};
use wimu_model::DeviceTimeUs;

use crate::sample::RawSample;
use crate::shared::{Common, ROLES};

/// Age at which a batch is sent before it is full, µs.
const OLDEST_BATCH_US: u64 = 250_000;

/// Batches for one link, or for both if their lengths and decimations are equal.
pub(crate) struct Lane<S: RawSample> {
    roles: [bool; 2],
    raw: Batcher<S>,
    corrected: Batcher<S::Corrected>,
    length: usize,
    /// Decimation: samples whose sequence number is a multiple of this are sent. 0 for an unused lane.
    every: u8,
}

impl<S: RawSample> Default for Lane<S> {
    fn default() -> Self {
        Self {
            roles: [false; 2],
            raw: Batcher::default(),
            corrected: Batcher::default(),
            length: 0,
            every: 0,
        }
    }
}

impl<S: RawSample> Lane<S> {
    pub(super) fn of(settings: &Settings) -> [Self; 2] {
        let lane = |roles, streams: Streams| Self {
            roles,
            length: usize::from(streams.batch).clamp(1, MAX_BATCH),
            every: streams.every.max(1),
            ..Self::default()
        };
        let (cable, wireless) = (settings.cable, settings.wireless);
        if (cable.batch, cable.every) == (wireless.batch, wireless.every) {
            [lane([true; 2], cable), Self::default()]
        } else {
            [lane([true, false], cable), lane([false, true], wireless)]
        }
    }

    pub(super) fn add<M: RawMutex>(
        &mut self,
        shared: &Common<M>,
        sequence: u32,
        time: DeviceTimeUs,
        sample: S,
        corrected: S::Corrected,
    ) {
        if self.roles == [false; 2] {
            return;
        }
        if self.takes(sequence) {
            self.raw.add(sequence, time, sample);
            self.corrected.add(sequence, time, corrected);
        }
        let age = time.0.saturating_sub(self.raw.first_time.0);
        if self.raw.samples.len() >= self.length::<S>() || age >= OLDEST_BATCH_US {
            self.flush(shared);
        }
    }

    /// Whether the sample with this sequence number is sent.
    pub(crate) fn takes(&self, sequence: u32) -> bool {
        match self.every {
            0 | 1 => self.every == 1,
            every => sequence.is_multiple_of(every.into()),
        }
    }

    /// Length of batches of samples `B`.
    pub(crate) fn length<B: Sample>(&self) -> usize {
        self.length.min(B::MOST)
    }

    pub(super) fn flush<M: RawMutex>(&mut self, shared: &Common<M>) {
        let every = self.every();
        let layout = Layout { sensor: 0, every };
        self.raw.flush(shared, self.roles, layout);
        self.corrected.flush(shared, self.roles, layout);
    }

    /// Sends the samples in `batcher` as those of `sensor`.
    pub(crate) fn send<B: Sample, M: RawMutex>(
        &self,
        shared: &Common<M>,
        sensor: u8,
        batcher: &mut Batcher<B>,
    ) {
        let every = self.every();
        batcher.flush(shared, self.roles, Layout { sensor, every });
    }

    fn every(&self) -> NonZeroU8 {
        NonZeroU8::new(self.every).unwrap_or(NonZeroU8::MIN)
    }
}

pub(crate) struct Batcher<S> {
    samples: Vec<S, MAX_BATCH>,
    first_sequence: u32,
    first_time: DeviceTimeUs,
}

impl<S> Default for Batcher<S> {
    fn default() -> Self {
        Self {
            samples: Vec::new(),
            first_sequence: 0,
            first_time: DeviceTimeUs(0),
        }
    }
}

impl<S: Sample> Batcher<S> {
    pub(crate) fn len(&self) -> usize {
        self.samples.len()
    }

    pub(crate) fn add(&mut self, sequence: u32, time: DeviceTimeUs, sample: S) {
        if self.samples.is_empty() {
            self.first_sequence = sequence;
            self.first_time = time;
        }
        // A lane flushes before a batch exceeds `MAX_BATCH`.
        let _ = self.samples.push(sample);
    }

    fn flush<M: RawMutex>(&mut self, shared: &Common<M>, roles: [bool; 2], layout: Layout) {
        let mut frame = [0; MAX_FRAME];
        let (sequence, time) = (self.first_sequence, self.first_time);
        let encoded = batch::encode_with(layout, sequence, time, &self.samples, &mut frame);
        self.samples.clear();
        if let Ok(length) = encoded {
            let wanted: fn(&Streams) -> bool = match S::STREAM {
                Stream::Raw => |streams| streams.raw,
                Stream::Corrected => |streams| streams.corrected,
            };
            shared.stream_frame(roles, frame.get(..length).unwrap_or_default(), wanted);
        }
    }
}

const _: () = {
    // `roles` of a lane are in the order of `ROLES`.
    assert!(matches!(ROLES, [LinkRole::Cable, LinkRole::Wireless]));
};
