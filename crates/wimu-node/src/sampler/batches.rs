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
use crate::shared::{ALL, Common, NONE, ROLES, Roles};

/// Age at which a batch is sent before it is full, µs.
const OLDEST_BATCH_US: u64 = 250_000;

/// One, or none without the feature `correction`.
const CORRECTED: usize = cfg!(feature = "correction") as usize;

/// Batches for one link, or for both if their lengths and decimations are equal.
pub(crate) struct Lane<S: RawSample> {
    roles: Roles,
    raw: Batcher<S>,
    corrected: [Batcher<S::Corrected>; CORRECTED],
    length: usize,
    /// Decimation: samples whose sequence number is a multiple of this are sent. 0 for an unused lane.
    every: u8,
}

impl<S: RawSample> Default for Lane<S> {
    fn default() -> Self {
        Self {
            roles: NONE,
            raw: Batcher::default(),
            corrected: [(); CORRECTED].map(|()| Batcher::default()),
            length: 0,
            every: 0,
        }
    }
}

impl<S: RawSample> Lane<S> {
    pub(super) fn of(settings: &Settings) -> Roles<Self> {
        let lane = |roles, streams: Streams| Self {
            roles,
            length: usize::from(streams.batch).clamp(1, MAX_BATCH),
            every: streams.every.max(1),
            ..Self::default()
        };
        let streams = ROLES.map(|role| match role {
            LinkRole::Cable => settings.cable,
            _ => settings.wireless,
        });
        let [first, ..] = streams;
        let alike = |other: &Streams| (other.batch, other.every) == (first.batch, first.every);
        if streams.iter().all(alike) {
            let mut lanes = ROLES.map(|_| Self::default());
            lanes[0] = lane(ALL, first);
            return lanes;
        }
        let mut roles = ROLES.into_iter();
        streams.map(|streams| {
            let role = roles.next();
            lane(ROLES.map(|other| Some(other) == role), streams)
        })
    }

    pub(super) fn add<M: RawMutex>(
        &mut self,
        shared: &Common<M>,
        sequence: u32,
        time: DeviceTimeUs,
        sample: S,
        corrected: Option<S::Corrected>,
    ) {
        if self.roles == NONE {
            return;
        }
        if self.takes(sequence) {
            self.raw.add(sequence, time, sample);
            if let (Some(corrected), [batcher]) = (corrected, &mut self.corrected[..]) {
                batcher.add(sequence, time, corrected);
            }
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
        for corrected in &mut self.corrected {
            corrected.flush(shared, self.roles, layout);
        }
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
        Self { samples: Vec::new(), first_sequence: 0, first_time: DeviceTimeUs(0) }
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

    fn flush<M: RawMutex>(&mut self, shared: &Common<M>, roles: Roles, layout: Layout) {
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
