//! State of a decoder within one start of the device.

use std::collections::VecDeque;

use wimu_link::message::Epoch;
use wimu_link::{Batch, batch};
use wimu_model::DeviceTimeUs;

use super::Received;
use super::anchor::Anchor;
use super::event::{Event, Samples};
use super::gaps::Gaps;
use super::order::Order;

/// Number of sensor indices.
const SENSORS: usize = batch::MAX_SENSOR as usize + 1;

/// State of a decoder within one start of the device.
#[derive(Debug, Default)]
pub(super) struct Start {
    /// By sensor index.
    pub tracks: [Track; SENSORS],
    pub order: Order<(Received, Held)>,
    /// Time of the latest magnetic field and temperature, numbers of the latest position and attitude.
    pub last_environment: Option<u64>,
    pub last_navigation: Option<u32>,
    pub last_attitude: Option<u32>,
}

/// The same of one sensor: it has its own sequence numbers and epochs.
#[derive(Debug, Default)]
pub(super) struct Track {
    /// The latest and the one before: epochs may overtake samples.
    pub anchors: [Option<Anchor>; 2],
    /// The latest epoch, if it jumped: accepted once the next one continues it.
    pub jumped: Option<Anchor>,
    pub unplaced: VecDeque<(Received, Batch)>,
    /// The latest sequence number of raw and corrected samples, and the decimation.
    pub latest: [Option<(u32, u8)>; 2],
    /// Missing samples of each that may still arrive.
    pub gaps: [Gaps; 2],
    /// Whether what preceded the next samples of each is unknown.
    pub skipped: [bool; 2],
    pub last_epoch_time: Option<DeviceTimeUs>,
    pub last_epoch_number: Option<u8>,
}

impl Start {
    /// Batches that wait for an epoch.
    pub fn unplaced(&self) -> usize {
        self.tracks.iter().map(|track| track.unplaced.len()).sum()
    }
}

impl Track {
    /// Samples of a batch; `None` if no epoch defines their numbers.
    pub fn place(&self, batch: &Batch) -> Option<Samples> {
        self.anchors.iter().flatten().find_map(|anchor| {
            let (first_sequence, first_time) = anchor.place(batch)?;
            Some(Samples {
                sensor: batch.sensor(),
                stream: batch.stream(),
                first_sequence,
                first_time,
                period: anchor.period,
                every: batch.every(),
                values: batch.samples().to_vec(),
                rates: batch.angular_rates().to_vec(),
            })
        })
    }
}

/// Data held until their start is known.
#[derive(Debug)]
pub(super) enum Held {
    Epoch(Box<Epoch>),
    Batch(Box<Batch>),
    Event(Box<Event>),
}
