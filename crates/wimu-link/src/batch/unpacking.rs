//! The decoder: values from bits.

use super::predict::{Coding, Linear, MEAN_WEIGHTS, Mean, Predictor, unfold};
use super::sample::{Sealed, Width};
use super::{BatchError, ESCAPE, MAX_BATCH};
use crate::bits::BitReader;

/// Reads three axes, their samples shifted left by `shift`.
pub(super) fn decode_axes<S: Sealed>(
    samples: &mut [[i32; 3]],
    shift: u32,
    latest_k: &mut Option<u32>,
    reader: &mut BitReader<'_>,
) -> Result<(), BatchError> {
    if shift >= S::WIDTH.bits() as u32 {
        return Err(BatchError::Value);
    }
    for axis in 0..3 {
        decode_axis::<S>(samples, axis, shift, latest_k, reader)?;
    }
    Ok(())
}

fn decode_axis<S: Sealed>(
    samples: &mut [[i32; 3]],
    axis: usize,
    shift: u32,
    latest_k: &mut Option<u32>,
    reader: &mut BitReader<'_>,
) -> Result<(), BatchError> {
    let bits = S::WIDTH.bits() as u32;
    let field = S::WIDTH.field();
    // The fields before the residuals have at most 45 bits.
    reader.refill();
    let coding = Coding::from_bits(reader.take(2)).ok_or(BatchError::Value)?;
    let shifted = |value: i32| S::WIDTH.wrap(value << shift);
    if coding == Coding::Fixed {
        let width = reader.take(field) + 1;
        if width > bits {
            return Err(BatchError::Value);
        }
        for sample in samples {
            let spare = 32 - width;
            sample[axis] = shifted((reader.pull(width) << spare) as i32 >> spare);
        }
        return Ok(());
    }

    let k = match *latest_k {
        None => reader.take(field),
        Some(latest) => match reader.peek(3) {
            code @ 0..0b110 => {
                // Branch-free, because the branch would be unpredictable.
                let differs = code >> 2;
                reader.take(1 + 2 * differs);
                latest.wrapping_add(differs & !code).wrapping_sub(differs & code)
            }
            _ => reader.take(2 + field) & ((1 << field) - 1),
        },
    };
    if k >= bits {
        return Err(BatchError::Value);
    }
    *latest_k = Some(k);

    let length = reader.take(field);
    if length >= bits {
        return Err(BatchError::Value);
    }
    let negative = reader.take(1) as i32;
    let magnitude = (1_u32 << length >> 1) | reader.take(length.saturating_sub(1));
    let first = magnitude as i32 ^ -negative;
    let axis = Axis { axis, shift, k };
    match coding {
        Coding::Linear => axis.decode::<S, Linear>(first, samples, reader),
        _ => axis.decode::<S, Mean>(first, samples, reader),
    }
}

/// An axis with a predictor.
#[derive(Clone, Copy)]
struct Axis {
    axis: usize,
    shift: u32,
    k: u32,
}

impl Axis {
    // Not inlined, so that each loop can use all registers.
    #[inline(never)]
    fn decode<S: Sealed, P: Predictor>(
        self,
        first: i32,
        samples: &mut [[i32; 3]],
        reader: &mut BitReader<'_>,
    ) -> Result<(), BatchError> {
        let Self { axis, shift, k } = self;
        let axis = axis.min(2);
        let width = S::WIDTH.bits() as u32;
        let Some((first_sample, rest)) = samples.split_first_mut() else {
            return Ok(());
        };
        first_sample[axis] = S::WIDTH.wrap(first << shift);
        // First all residuals, then all values: the two loops have independent dependency chains.
        let mut folded = [0; MAX_BATCH];
        let folded = folded.get_mut(..rest.len()).unwrap_or_default();
        let mut bits = *reader;
        let mut all = 0;
        let mut next = |residual: &mut u32, bits: &mut BitReader<'_>| {
            let number = bits.take_rice(k, ESCAPE, width);
            all |= number;
            *residual = number as u32;
        };
        // A residual of 16 bits has at most 27 bits, one of 20 bits 31, a corrected one 43.
        let (pairs, last) = folded.as_chunks_mut::<2>();
        for [one, other] in pairs {
            bits.refill();
            next(one, &mut bits);
            if S::WIDTH != Width::W16 {
                bits.refill();
            }
            next(other, &mut bits);
        }
        for residual in last {
            bits.refill();
            next(residual, &mut bits);
        }
        if all >> width != 0 {
            return Err(BatchError::Value);
        }
        let mut predictor = P::of(first);
        let (mut beyond, half) = (0, 1_i32.unbounded_shl(width - 1));
        for ((sample, &residual), &weight) in rest.iter_mut().zip(&*folded).zip(&MEAN_WEIGHTS) {
            let residual = unfold(residual);
            let sum = predictor.predict().wrapping_add(residual);
            // Has bits above W if the value is out of range.
            beyond |= sum.wrapping_add(half) as u32;
            sample[axis] = sum;
            predictor.advance(residual, weight);
        }
        if beyond.unbounded_shr(width) != 0 {
            // Slow path: each value is wrapped before the next prediction.
            let mut predictor = P::of(first);
            for ((sample, &residual), &weight) in rest.iter_mut().zip(&*folded).zip(&MEAN_WEIGHTS) {
                let residual = unfold(residual);
                let value = S::WIDTH.wrap(predictor.predict().wrapping_add(residual));
                sample[axis] = value;
                predictor.add(value, weight);
            }
        }
        *reader = bits;
        if shift > 0 {
            for sample in rest {
                sample[axis] = S::WIDTH.wrap(sample[axis] << shift);
            }
        }
        Ok(())
    }
}
