//! The encoder: chooses the coding and writes the bits.

use core::num::NonZeroU8;

use wimu_model::DeviceTimeUs;

use super::predict::{Coding, MEAN_GAINS, Mean, fold, unfold};
use super::sample::{Sample, Stream, Width};
use super::{CORRECTED_BIT, DECIMATED_BIT, ESCAPE, HEADER, MAX_BATCH, SHIFT_BIT};
use crate::bits::BitWriter;
use crate::frame::EncodeError;

/// Samples of X that choose the predictor.
const TRIED: usize = 8;

/// Packs samples into the body of a frame; returns its length, bytes.
pub(super) fn encode_body<S: Sample>(
    every: NonZeroU8,
    first_sequence: u32,
    first_time: DeviceTimeUs,
    samples: &[S],
    body: &mut [u8],
) -> Result<usize, EncodeError> {
    if samples.is_empty() || samples.len() > S::MOST {
        return Err(EncodeError::BatchLength { most: S::MOST });
    }
    let shifts = [0, 3].map(|from| if from < S::AXES { common_shift(samples, from) } else { 0 });

    let (header, bits) = body.split_first_chunk_mut::<HEADER>().ok_or(EncodeError::NoRoom)?;
    let [sequence_0, sequence_1, ..] = first_sequence.to_le_bytes();
    let [time_0, time_1, time_2, ..] = first_time.0.to_le_bytes();
    let stream_bit = match S::STREAM {
        Stream::Raw => 0,
        Stream::Corrected => CORRECTED_BIT,
    };
    let shift_bit = if shifts != [0; 2] { SHIFT_BIT } else { 0 };
    let decimated = every > NonZeroU8::MIN;
    let decimated_bit = if decimated { DECIMATED_BIT } else { 0 };
    let first = (samples.len() - 1) as u8 | stream_bit | shift_bit | decimated_bit;
    *header = [first, sequence_0, sequence_1, time_0, time_1, time_2];
    let (more, bits) = bits.split_at_mut_checked(decimated.into()).ok_or(EncodeError::NoRoom)?;
    if let [more] = more {
        *more = every.get();
    }

    let mut packer = Packer {
        writer: BitWriter::new(bits),
        residuals: [0; MAX_BATCH - 1],
        coding: None,
        latest_k: None,
    };
    let sensors = shifts.iter().take(S::AXES / 3);
    if shift_bit != 0 {
        for shift in sensors.clone() {
            packer.writer.push(*shift, S::WIDTH.field());
        }
    }
    for (sensor, &shift) in sensors.enumerate() {
        packer.coding = None;
        for axis in 3 * sensor..3 * sensor + 3 {
            packer.pack(Axis { samples, axis, shift });
        }
    }
    let packed = packer.writer.finish().ok_or(EncodeError::NoRoom)?;
    Ok(HEADER + usize::from(decimated) + packed)
}

/// Number of low bits that are zero in all samples of the three axes that begin with `from`: equation (20).
fn common_shift<S: Sample>(samples: &[S], from: usize) -> u32 {
    let mut used = 0;
    for few in samples.chunks(4) {
        used = few.iter().fold(used, |used, sample| {
            used | sample.axis(from) | sample.axis(from + 1) | sample.axis(from + 2)
        });
        if used & 1 == 1 {
            return 0;
        }
    }
    if used == 0 { 0 } else { used.trailing_zeros() }
}

/// `value`, or −`value` − 1 if `value` is negative.
fn magnitude(value: i32) -> u32 {
    (value ^ (value >> 31)) as u32
}

/// Bits of `magnitude` without leading zeros.
fn bit_length(magnitude: u32) -> u32 {
    32 - magnitude.leading_zeros()
}

/// An axis's Rice parameter on the wire: a number of at most 7 bits.
fn k_code(width: Width, k: u32, latest: Option<u32>) -> (u32, u32) {
    let field = width.field();
    match latest {
        None => (k, field),
        Some(latest) if k == latest => (0, 1),
        Some(latest) if k == latest + 1 => (0b100, 3),
        Some(latest) if k + 1 == latest => (0b101, 3),
        Some(_) => ((0b11 << field) | k, 2 + field),
    }
}

/// One axis of samples, shifted right by their common shift.
#[derive(Clone, Copy)]
struct Axis<'s, S> {
    samples: &'s [S],
    axis: usize,
    shift: u32,
}

// The loops over samples are separate functions, so that each can use all registers.
impl<S: Sample> Axis<'_, S> {
    #[inline]
    fn value(&self, sample: &S) -> i32 {
        sample.axis(self.axis) >> self.shift
    }

    /// Bits of the longest value, without its sign.
    fn longest(&self) -> u32 {
        bit_length((self.samples.iter()).fold(0, |longest, s| longest | magnitude(self.value(s))))
    }

    /// Linear if the second differences of the first samples are smaller than the first differences, else
    /// mean.
    #[inline(never)]
    fn likely_coding(self, first: i32) -> Coding {
        let mut previous = first;
        let mut slope = (self.samples.first()).map_or(0, |s| self.value(s).wrapping_sub(first));
        let (mut first_differences, mut second_differences) = (0, 0);
        for sample in self.samples.iter().take(TRIED) {
            let value = self.value(sample);
            let step = value.wrapping_sub(previous);
            first_differences = S::WIDTH.add(first_differences, magnitude(step));
            second_differences =
                S::WIDTH.add(second_differences, magnitude(step.wrapping_sub(slope)));
            (previous, slope) = (value, step);
        }
        if second_differences < first_differences { Coding::Linear } else { Coding::Mean }
    }

    /// The residuals of the mean for the samples after the first, folded but not yet wrapped to W bits;
    /// returns their sum.
    #[inline(never)]
    fn mean_residuals(self, first: i32, residuals: &mut Residuals) -> u32 {
        let mut mean = Mean::of(first);
        let mut sum = 0;
        for ((sample, folded), gain) in self.samples.iter().zip(residuals).zip(&MEAN_GAINS) {
            let residual = self.value(sample).wrapping_sub(mean.rounded());
            *folded = fold(residual);
            sum = S::WIDTH.add(sum, *folded);
            mean.correct(residual, *gain);
        }
        sum
    }

    /// The same for the linear prediction from the two previous samples.
    #[inline(never)]
    fn linear_residuals(self, first: i32, residuals: &mut Residuals) -> u32 {
        let (mut previous, mut slope) = (first, 0_i32);
        let mut sum = 0;
        for (sample, folded) in self.samples.iter().zip(residuals) {
            let value = self.value(sample);
            let step = value.wrapping_sub(previous);
            *folded = fold(step.wrapping_sub(slope));
            sum = S::WIDTH.add(sum, *folded);
            (previous, slope) = (value, step);
        }
        sum
    }
}

/// Residuals of the samples after the first. Cleared once per batch.
type Residuals = [u32; MAX_BATCH - 1];

/// State shared by the axes of a batch.
struct Packer<'a> {
    writer: BitWriter<'a>,
    residuals: Residuals,
    /// Chosen from a sensor's first axis, used for its others.
    coding: Option<Coding>,
    latest_k: Option<u32>,
}

impl Packer<'_> {
    // Not inlined, to keep the code small.
    #[inline(never)]
    fn pack<S: Sample>(&mut self, all: Axis<'_, S>) {
        let width = S::WIDTH;
        let field = width.field();
        let Some((first, rest)) = all.samples.split_first() else {
            return;
        };
        let first = all.value(first);
        let rest = Axis { samples: rest, ..all };
        let coding = *(self.coding).get_or_insert_with(|| rest.likely_coding(first));
        let sum = match coding {
            Coding::Linear => rest.linear_residuals(first, &mut self.residuals),
            _ => rest.mean_residuals(first, &mut self.residuals),
        };
        let residuals = self.residuals.get_mut(..rest.samples.len()).unwrap_or_default();
        if width.can_be_exceeded_in(sum) {
            for folded in &mut *residuals {
                *folded = fold(width.wrap(unfold(*folded)));
            }
        }

        // k = floor(log2 of the mean residual). k − 1 is sometimes better, by one or two bits.
        let average = sum / (residuals.len() as u32).max(1);
        let k = average.max(1).ilog2().min(width.largest_k());
        let (code, code_bits) = k_code(width, k, self.latest_k);
        let first_magnitude = magnitude(first);
        let first_length = bit_length(first_magnitude);
        let head = ((coding as u32) << code_bits | code) << field | first_length;
        let head = head << 1 | u32::from(first < 0);
        let head_bits = 2 + code_bits + field + 1;
        let tail_bits = first_length.saturating_sub(1);
        let tail = first_magnitude & !(1 << tail_bits);
        let writer = &mut self.writer;
        let start = writer.place();
        match width {
            // At most 13 and 14 bits.
            Width::W16 => writer.push(head << tail_bits | tail, head_bits + tail_bits),
            Width::W20 | Width::W32 => {
                writer.push(head, head_bits);
                writer.push(tail, tail_bits);
            }
        }
        writer.push_rice(residuals, k, ESCAPE, width.bits() as u32);

        // Fixed width if that is not longer. The longest sample is searched only if the length of the first
        // one does not decide.
        let coded = writer.bits_since(&start);
        let fixed = |length: u32| 2 + field + (length + 1) * all.samples.len() as u32;
        if coded < fixed(first_length) || coded < fixed(all.longest()) {
            self.latest_k = Some(k);
            return;
        }
        let length = all.longest();
        writer.go_back(start);
        writer.push((Coding::Fixed as u32) << field | length, 2 + field);
        let spare = 31 - length;
        for sample in all.samples {
            writer.push(((all.value(sample) as u32) << spare) >> spare, length + 1);
        }
    }
}
