//! Batches of samples in their order: losses, repetitions and late samples.

use wimu_link::Batch;
use wimu_model::DeviceTimeUs;

use super::event::{Arrival, Event};
use super::order::{Place, Verdict};
use super::start::Held;
use super::{Decoder, Received};

/// Largest number of batches kept until an epoch defines their numbers: more than arrive between two epochs.
pub(super) const MAX_UNPLACED: usize = 512;

impl Decoder {
    pub(super) fn take_batch(
        &mut self,
        received: Received,
        batch: &Batch,
        each: &mut impl FnMut(Arrival),
    ) {
        if self.repeats.is_of_a_start_before(batch, received.host_ns) {
            let statistics = self.statistics.stream(batch.sensor(), batch.stream());
            statistics.duplicated += batch.len() as u64;
            return;
        }
        let track = &mut self.start.tracks[usize::from(batch.sensor())];
        let Some(mut samples) = track.place(batch) else {
            if self.start.order.holds() {
                return self.start.order.hold((received, Held::Batch(Box::new(*batch))));
            }
            track.unplaced.push_back((received, *batch));
            if track.unplaced.len() > MAX_UNPLACED {
                track.unplaced.pop_front();
                self.statistics.batches_unplaced += 1;
            }
            return;
        };
        let (sequence, time) = (samples.first_sequence, samples.first_time);
        let every = u32::from(batch.every());
        let index = batch.stream() as usize;
        let before_last = (batch.len() as u32).saturating_sub(1) * every;
        let last = sequence.wrapping_add(before_last);
        let latest = track.latest[index];
        let place = latest.map_or(Place::Ahead, |(latest, _)| {
            // Samples taken by the sensor from the latest one to these.
            let ahead = |number: u32| number.wrapping_sub(latest) as i32;
            match (ahead(sequence), ahead(last)) {
                (_, ..=0) => Place::Back,
                (..=0, _) => Place::Ahead,
                (first, _) if first.unsigned_abs() <= every => Place::Next,
                _ => Place::Ahead,
            }
        });
        let last_us = u64::from(before_last) * u64::from(samples.period.0) / 1000;
        let moment = received.at(DeviceTimeUs(time.0.saturating_add(last_us)));
        match self.start.order.judge(moment, place) {
            Verdict::InOrder => {}
            Verdict::Late => return self.take_late(received, batch, each),
            Verdict::Hold => {
                return self.start.order.hold((received, Held::Batch(Box::new(*batch))));
            }
            Verdict::HeldWasLate => self.go_on(each),
            Verdict::NewStart => {
                self.restart_unannounced(received, each);
                return self.take_batch(received, batch, each);
            }
        }
        let track = &mut self.start.tracks[usize::from(batch.sensor())];
        // Follows the samples, so that numbers can be completed even if an epoch is lost.
        if let Some(latest) = &mut track.anchors[0]
            && time > latest.time
        {
            latest.sequence = sequence;
            latest.time = time;
            latest.host_ns = received.host_ns;
        }
        let statistics = self.statistics.stream(batch.sensor(), batch.stream());
        let skipped = std::mem::take(&mut track.skipped[index]);
        if let Some((latest, every_before)) = latest {
            let ahead = sequence.wrapping_sub(latest) as i32;
            if ahead > 0 && skipped {
                // What was skipped is not known to be missing.
            } else if ahead > 0 {
                // Where the decimation changes, at most the larger one was skipped.
                let missing = (ahead as u32 - 1) / every.max(every_before.into());
                statistics.missing += u64::from(missing);
                if missing > 0 {
                    track.gaps[index].add(latest.wrapping_add(1), sequence);
                }
            } else {
                let known = (ahead.unsigned_abs() / every + 1) as usize;
                for late in track.gaps[index].take(&samples, known, statistics) {
                    each(received.with(Event::Late(late)));
                }
                samples.drop_first(known);
            }
        }
        statistics.received += samples.values.len() as u64;
        track.latest[index] = Some((last, samples.every));
        self.repeats.add(batch, received.host_ns);
        // Constructed in place: events are large.
        each(Arrival {
            host_ns: received.host_ns,
            began_ns: received.began_ns,
            event: Event::Samples(samples),
        });
    }

    /// Takes a batch whose samples fill gaps, or are repeated.
    pub(super) fn take_late(
        &mut self,
        received: Received,
        batch: &Batch,
        each: &mut impl FnMut(Arrival),
    ) {
        let track = &mut self.start.tracks[usize::from(batch.sensor())];
        let Some(samples) = track.place(batch) else {
            self.statistics.batches_unplaced += 1;
            return;
        };
        let statistics = self.statistics.stream(batch.sensor(), batch.stream());
        let gaps = &mut track.gaps[batch.stream() as usize];
        let late = gaps.take(&samples, usize::MAX, statistics);
        if !late.is_empty() {
            self.repeats.add(batch, received.host_ns);
        }
        for late in late {
            each(received.with(Event::Late(late)));
        }
    }
}
