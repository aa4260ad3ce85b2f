//! The encoder: chooses the coding and writes the bits.

use core::num::NonZeroU8;

use wimu_model::DeviceTimeUs;

use super::predict::{Coding, MEAN_GAINS, Mean, fold, unfold};
use super::sample::{Stream, Width};
use super::{CORRECTED_BIT, DECIMATED_BIT, ESCAPE, HEADER, MAX_BATCH, SHIFT_BIT};
use crate::bits::BitWriter;
use crate::frame::EncodeError;

/// Samples of X that choose the predictor.
const TRIED: usize = 8;

/// A batch to encode: one encoder serves samples of all types.
pub(super) struct Unpacked<'v> {
    pub(super) stream: Stream,
    pub(super) width: Width,
    /// Samples, 1 to [`MAX_BATCH`].
    pub(super) count: usize,
    pub(super) every: NonZeroU8,
    pub(super) first_sequence: u32,
    pub(super) first_time: DeviceTimeUs,
    /// `count` values of each axis, three axes a sensor.
    pub(super) values: &'v mut [i32],
}

impl Unpacked<'_> {
    /// Packs the batch into the body of a frame; returns its length, bytes.
    pub(super) fn encode(&mut self, body: &mut [u8]) -> Result<usize, EncodeError> {
        let width = self.width;
        let sensors = self.values.chunks_exact_mut(3 * self.count);
        let mut shifts = [0; 2];
        for (values, shift) in sensors.zip(&mut shifts) {
            *shift = common_shift(values);
            values.iter_mut().for_each(|value| *value >>= *shift);
        }

        let (header, bits) = body.split_first_chunk_mut::<HEADER>().ok_or(EncodeError::NoRoom)?;
        let [sequence_0, sequence_1, ..] = self.first_sequence.to_le_bytes();
        let [time_0, time_1, time_2, ..] = self.first_time.0.to_le_bytes();
        let stream_bit = match self.stream {
            Stream::Raw => 0,
            Stream::Corrected => CORRECTED_BIT,
        };
        let shift_bit = if shifts != [0; 2] { SHIFT_BIT } else { 0 };
        let decimated = self.every > NonZeroU8::MIN;
        let decimated_bit = if decimated { DECIMATED_BIT } else { 0 };
        let first = (self.count - 1) as u8 | stream_bit | shift_bit | decimated_bit;
        *header = [first, sequence_0, sequence_1, time_0, time_1, time_2];
        let (more, bits) =
            bits.split_at_mut_checked(decimated.into()).ok_or(EncodeError::NoRoom)?;
        if let [more] = more {
            *more = self.every.get();
        }

        let mut packer = Packer {
            writer: BitWriter::new(bits),
            residuals: [0; MAX_BATCH - 1],
            coding: None,
            latest_k: None,
        };
        let sensors = self.values.chunks_exact(3 * self.count);
        if shift_bit != 0 {
            for shift in shifts.iter().take(sensors.len()) {
                packer.writer.push(*shift, width.field());
            }
        }
        for sensor in sensors {
            packer.coding = None;
            for axis in sensor.chunks_exact(self.count) {
                packer.pack(width, axis);
            }
        }
        let packed = packer.writer.finish().ok_or(EncodeError::NoRoom)?;
        Ok(HEADER + usize::from(decimated) + packed)
    }
}

/// Number of low bits that are zero in all values: equation (20).
fn common_shift(values: &[i32]) -> u32 {
    let mut used = 0;
    for few in values.chunks(12) {
        used = few.iter().fold(used, |used, value| used | value);
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

/// Bits of the longest value, without its sign.
fn longest(values: &[i32]) -> u32 {
    bit_length(values.iter().fold(0, |longest, &value| longest | magnitude(value)))
}

// The loops over samples are separate functions, so that each can use all registers.

/// Linear if the second differences of the first values are smaller than the first differences, else mean.
#[inline(never)]
fn likely_coding(first: i32, values: &[i32]) -> Coding {
    let mut previous = first;
    let mut slope = values.first().map_or(0, |value| value.wrapping_sub(first));
    let (mut first_differences, mut second_differences) = (0_u32, 0_u32);
    for &value in values.iter().take(TRIED) {
        let step = value.wrapping_sub(previous);
        first_differences = first_differences.saturating_add(magnitude(step));
        second_differences = second_differences.saturating_add(magnitude(step.wrapping_sub(slope)));
        (previous, slope) = (value, step);
    }
    if second_differences < first_differences { Coding::Linear } else { Coding::Mean }
}

/// The residuals of the mean for the values after the first, folded but not yet wrapped to W bits; returns their
/// sum.
#[inline(never)]
fn mean_residuals(first: i32, values: &[i32], residuals: &mut Residuals) -> u32 {
    let mut mean = Mean::of(first);
    let mut sum = 0_u32;
    for ((value, folded), gain) in values.iter().zip(residuals).zip(&MEAN_GAINS) {
        let residual = value.wrapping_sub(mean.rounded());
        *folded = fold(residual);
        sum = sum.saturating_add(*folded);
        mean.correct(residual, *gain);
    }
    sum
}

/// The same for the linear prediction from the two previous values.
#[inline(never)]
fn linear_residuals(first: i32, values: &[i32], residuals: &mut Residuals) -> u32 {
    let (mut previous, mut slope) = (first, 0_i32);
    let mut sum = 0_u32;
    for (&value, folded) in values.iter().zip(residuals) {
        let step = value.wrapping_sub(previous);
        *folded = fold(step.wrapping_sub(slope));
        sum = sum.saturating_add(*folded);
        (previous, slope) = (value, step);
    }
    sum
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
    /// Packs the values of an axis.
    // Not inlined, to keep the code small.
    #[inline(never)]
    fn pack(&mut self, width: Width, values: &[i32]) {
        let field = width.field();
        let Some((&first, rest)) = values.split_first() else {
            return;
        };
        let coding = *(self.coding).get_or_insert_with(|| likely_coding(first, rest));
        let sum = match coding {
            Coding::Linear => linear_residuals(first, rest, &mut self.residuals),
            _ => mean_residuals(first, rest, &mut self.residuals),
        };
        let residuals = self.residuals.get_mut(..rest.len()).unwrap_or_default();
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
        let fixed = |length: u32| 2 + field + (length + 1) * values.len() as u32;
        if coded < fixed(first_length) || coded < fixed(longest(values)) {
            self.latest_k = Some(k);
            return;
        }
        let length = longest(values);
        writer.go_back(start);
        writer.push((Coding::Fixed as u32) << field | length, 2 + field);
        let spare = 31 - length;
        for &value in values {
            writer.push(((value as u32) << spare) >> spare, length + 1);
        }
    }
}
