//! Frames without end through a faulty link, and every sample that is accepted compared with the one
//! that was sent.

use std::collections::{HashMap, VecDeque};

use wimu_host::decode::{Decoder, Event, LinkStatistics};
use wimu_link::batch::{self, Stream};
use wimu_link::frame::EncodeError;
use wimu_link::message::{Epoch, EpochReason};
use wimu_link::{MAX_FRAME, Telemetry};
use wimu_model::{Counts, DeviceTimeUs, SpecificForceQ16};
use wimu_sim::faults::{Channel, Fate, FaultCounts, FrameTruth, LinkFaults};
use wimu_testkit::Random;

/// 800 samples a second: raw and corrected batches of 16 then nearly fill 115,200 baud.
const PERIOD_US: u64 = 1250;
const BATCH: u32 = 16;
/// Batches from one epoch to the next: one second.
const BATCHES_PER_EPOCH: u32 = 50;
/// The line: 115,200 baud, ten bits to a byte.
const BYTE_NS: u64 = 10_000_000_000 / 115_200;

/// What came of it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Outcome {
    /// Frames sent.
    pub frames: u64,
    /// Samples in batches that arrived whole: between two zeros all bytes of a batch that was sent,
    /// each batch once.
    pub samples_whole: u64,
    /// Of them, those of batches that lost their own zero, and that of a lost neighbour ended.
    pub samples_rescued: u64,
    /// Samples accepted.
    pub accepted: u64,
    /// Of them, those whose number, time or value is not that of a sample sent, or that were
    /// accepted before.
    pub wrong: u64,
    /// Samples sent between the first and the last that were accepted, but not accepted.
    pub lost: u64,
    /// Most undamaged frames in a row that could not be read, since the one before was damaged.
    pub longest_resynchronisation: u32,
    /// Restarts of the device that the decoder saw; there was none.
    pub restarts: u64,
    /// What the decoder counted.
    pub counted: LinkStatistics,
    /// What the channel did.
    pub faults: FaultCounts,
}

impl Outcome {
    /// Samples that the decoder says did not arrive, or too late.
    pub fn counted_lost(&self) -> u64 {
        let streams = [self.counted.raw, self.counted.corrected];
        streams.map(|stream| stream.missing + stream.late).iter().sum()
    }
}

/// The counts of a sample: a slow motion, noise of 60 LSB, and now and then a shock.
fn counts(sequence: u32) -> [i16; 3] {
    let bits = Random::new(sequence.into()).bits();
    let phase = (sequence % 1600) as i32 - 800;
    let slow = phase.abs() * 4;
    let shock = if bits.is_multiple_of(1009) { 12_000 } else { 0 };
    let noise = |shift: u32| ((bits >> shift) & 127) as i32 - 64;
    [(slow + noise(0)) as i16, (noise(8) - slow / 2 + shock) as i16, (16_384 + noise(16)) as i16]
}

/// The corrected sample that belongs to it.
fn force(sequence: u32) -> [i32; 3] {
    counts(sequence).map(|lsb| i32::from(lsb) * 39 + 17)
}

fn time_us(sequence: u32) -> u64 {
    3_000_000 + u64::from(sequence) * PERIOD_US
}

/// Sends `frames` frames through a link with `faults`.
pub fn run(frames: u64, faults: &LinkFaults, seed: u64) -> Outcome {
    let mut channel = Channel::new(faults, seed);
    channel.log_frames();
    let mut decoder = Decoder::new();
    let mut outcome = Outcome::default();
    // The latest of raw and corrected samples accepted, and the first.
    let mut latest: [Option<u32>; 2] = [None; 2];
    let mut first: [Option<u32>; 2] = [None; 2];
    let mut fused = 0;
    let mut line_ns = 0;
    let mut sent = 0_u32;
    let mut line = Vec::new();
    let mut whole = Whole::default();
    while outcome.frames < frames {
        line.clear();
        if sent.is_multiple_of(BATCH * BATCHES_PER_EPOCH) {
            outcome.frames += encode(&mut line, |frame| epoch(sent).encode(frame));
        }
        let numbers = sent..sent + BATCH;
        let raw: Vec<_> = numbers.clone().map(|s| Counts(counts(s))).collect();
        let corrected: Vec<_> = numbers.map(|s| SpecificForceQ16(force(s))).collect();
        let time = DeviceTimeUs(time_us(sent));
        outcome.frames += encode(&mut line, |frame| batch::encode(sent, time, &raw, frame));
        outcome.frames += encode(&mut line, |frame| batch::encode(sent, time, &corrected, frame));
        sent += BATCH;
        // When the last of them was taken, or when the line is free.
        line_ns = line_ns.max(time_us(sent) * 1000);
        for piece in line.chunks(32) {
            line_ns += BYTE_NS * piece.len() as u64;
            channel.push(line_ns, piece);
        }
        for frame in channel.take_frames() {
            fused = match frame.fate {
                Fate::Fused => fused + 1,
                _ => 0,
            };
            outcome.longest_resynchronisation = outcome.longest_resynchronisation.max(fused);
            // The first byte after COBS's code: the kind in the low half, the wire's version above.
            let kind = frame.bytes.get(1).map(|byte| byte & 0x0F);
            if kind != Some(wimu_link::Kind::Telemetry as u8) {
                whole.sent(frame);
            }
        }
        // At the end, all that is under way.
        let until_ns = if outcome.frames < frames { line_ns } else { u64::MAX };
        let arrived = channel.pull(until_ns, usize::MAX);
        for fate in whole.arrived(&arrived) {
            outcome.samples_whole += u64::from(BATCH);
            if !matches!(fate, Fate::Intact | Fate::Fused) {
                outcome.samples_rescued += u64::from(BATCH);
            }
        }
        decoder.push(line_ns, &arrived, |arrival| match arrival.event {
            Event::Samples(samples) => {
                let stream = usize::from(samples.stream == Stream::Corrected);
                for sample in samples.iter() {
                    outcome.accepted += 1;
                    let value = match samples.stream {
                        Stream::Raw => counts(sample.sequence).map(i32::from),
                        Stream::Corrected => force(sample.sequence),
                    };
                    let right = sample.sequence < sent
                        && sample.value == value
                        && sample.time.0 == time_us(sample.sequence)
                        && latest[stream].is_none_or(|latest| sample.sequence > latest);
                    outcome.wrong += u64::from(!right);
                    first[stream].get_or_insert(sample.sequence);
                    latest[stream] = Some(sample.sequence);
                }
            }
            Event::Restart { .. } => outcome.restarts += 1,
            _ => {}
        });
    }
    for (first, latest) in first.iter().zip(latest) {
        if let (Some(first), Some(latest)) = (first, latest) {
            outcome.lost += u64::from(latest - first) + 1;
        }
    }
    outcome.lost -= outcome.accepted.min(outcome.lost);
    outcome.counted = decoder.statistics();
    outcome.faults = channel.counts();
    outcome
}

/// Batches under way, to tell which of them arrive byte for byte.
#[derive(Default)]
struct Whole {
    /// By their bytes without the zero: no two are alike, as they carry their number.
    under_way: HashMap<Vec<u8>, Fate>,
    order: VecDeque<Vec<u8>>,
    /// What has come since the latest zero.
    piece: Vec<u8>,
}

impl Whole {
    /// More than arrive after any other: the longest stall is of seconds.
    const MOST: usize = 16_384;

    fn sent(&mut self, mut frame: FrameTruth) {
        frame.bytes.pop();
        if self.order.len() == Self::MOST
            && let Some(oldest) = self.order.pop_front()
        {
            self.under_way.remove(&oldest);
        }
        self.order.push_back(frame.bytes.clone());
        self.under_way.insert(frame.bytes, frame.fate);
    }

    /// What the channel says of the batches that have arrived whole.
    fn arrived(&mut self, bytes: &[u8]) -> Vec<Fate> {
        let mut fates = Vec::new();
        for &byte in bytes {
            if byte != 0 {
                self.piece.push(byte);
            } else {
                fates.extend(self.under_way.remove(&self.piece));
                self.piece.clear();
            }
        }
        fates
    }
}

fn encode(line: &mut Vec<u8>, encode: impl FnOnce(&mut [u8]) -> Result<usize, EncodeError>) -> u64 {
    let mut frame = [0; MAX_FRAME];
    let length = encode(&mut frame).expect("room");
    line.extend_from_slice(&frame[..length]);
    1
}

fn epoch(sequence: u32) -> Telemetry {
    epoch_at(sequence, time_us(sequence), PERIOD_US, BATCH * BATCHES_PER_EPOCH)
}

/// The epoch at a sample, of which there is one every so many.
pub(crate) fn epoch_at(sequence: u32, time_us: u64, period_us: u64, every: u32) -> Telemetry {
    Telemetry::Epoch(Epoch {
        reason: EpochReason::Periodic,
        number: (sequence / every) as u8,
        sequence,
        time_us,
        period_ns: period_us as u32 * 1000,
        range_g: 2,
        sensitivity_lsb_per_g: 16_384.0,
        full_scale: 32_752,
        parameters: 0,
        temperature_centi_c: Some(2500),
        ..Epoch::default()
    })
}
