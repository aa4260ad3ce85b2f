//! The error model compiled into integers.

use core::fmt;

use crate::kernel::{Fixed, Kernel, LOW_BITS, whole};
use crate::matrix::Matrix3;
use crate::{
    CentiCelsius, CompiledSet, Counts, ParameterId, ParameterSet, STANDARD_GRAVITY_MPS2,
    Sensitivity, SpecificForceQ16, WideCounts,
};

/// Fraction bits of the high part: with fewer than the minimum the error can exceed 1 LSB.
const MIN_SHIFT: u32 = 3;
const MAX_SHIFT: u32 = 14;
/// Largest output, LSB: 2²⁹ (8192 m/s²), because the integrator adds two samples in 32 bits.
const LARGEST_OUTPUT: f64 = 536_870_912.0;

/// Maps counts to specific force in body axes in integers, at one latched temperature.
///
/// f = M c + o with M = R A(T)⁻¹ · (m/s² per LSB) and o = −R A(T)⁻¹ b(T): equation (3) of
/// docs/reference/equations. Sums are exact, and the same on every target: a processor with a long
/// multiplication takes nine of them, Cortex-M0+ eighteen of a count and half a coefficient.
///
/// At the model's reference temperature the result is at most 1 LSB (2⁻¹⁶ m/s²) from the f64 result for every count from
/// −32768 to 32767, elsewhere as [`CompiledSet`] says, and within ±2²⁹ LSB. The nonlinearity q is left out: the host applies it.
///
/// ```
/// use wimu_model::{Corrector, Counts, ParameterSet, Sensitivity};
///
/// let sensitivity = Sensitivity::from_lsb_per_g(16384.0)?;
/// let parameters = ParameterSet::uncalibrated(2, sensitivity);
/// let corrector = Corrector::compile(&parameters, None)?;
/// let force = corrector.correct(Counts([0, 0, 16384]));
/// assert_eq!(force.to_mps2().0[2], (9.80665_f64 * 65536.0).round() / 65536.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Corrector {
    pub(crate) kernel: Kernel,
}

impl Corrector {
    /// That of a [`CompiledSet`] of `parameters` at `temperature` (at the model's reference if `None`).
    ///
    /// # Errors
    /// [`CompileError`].
    pub fn compile(
        parameters: &ParameterSet,
        temperature: Option<CentiCelsius>,
    ) -> Result<Self, CompileError> {
        let parameters = ParameterSet { gyroscope: None, ..*parameters };
        let set = CompiledSet::compile(&parameters, ParameterId::UNCALIBRATED, 0)?;
        Ok(set.corrector(temperature))
    }

    /// That of an uncalibrated sensor in body axes. Called in a constant, it leaves no floating point in the image.
    pub const fn ideal(sensitivity: Sensitivity) -> Self {
        let count = STANDARD_GRAVITY_MPS2 / sensitivity.lsb_per_g();
        Self { kernel: Kernel::new(&diagonal(count * SpecificForceQ16::LSB_PER_MPS2)) }
    }

    /// The corrector of these integers, for a calibration in the source of a firmware: without a model,
    /// without floating point, at compile time.
    ///
    /// ```
    /// use wimu_model::{Corrector, CorrectorParts, Counts};
    ///
    /// /// From `wimu convert CAL.json --to rust`.
    /// const PARTS: CorrectorParts = CorrectorParts {
    ///     shift: 9,
    ///     coefficients: [[658_113_141, 0, 0], [0, 658_113_141, 0], [0, 0, 658_113_141]],
    ///     offset: [257; 3],
    /// };
    /// const CORRECTOR: Corrector = Corrector::from_parts(PARTS).unwrap();
    /// assert_eq!(CORRECTOR.to_parts(), PARTS);
    /// let force = CORRECTOR.correct(Counts([0, 0, 16384]));
    /// assert!((force.to_mps2().0[2] - 9.80665).abs() < 1e-4);
    /// ```
    ///
    /// Returns `None` where the sums of full-scale counts would not fit: [`CompileError::Overflow`].
    pub const fn from_parts(parts: CorrectorParts) -> Option<Self> {
        let shift = parts.shift as u32;
        if shift < MIN_SHIFT || shift > MAX_SHIFT {
            return None;
        }
        // As `kernel` asks, and the rounding of its sums.
        let largest = (LARGEST_OUTPUT as i64) << shift;
        let word = (1 << 31) - 131_072;
        let most = (if largest < word { largest } else { word }) + (1 << 14);
        let mut axis = 0;
        while axis < 3 {
            let mut reach = (parts.offset[axis] as i64).abs();
            let mut i = 0;
            while i < 3 {
                let coefficient = (parts.coefficients[axis][i] as i64).abs();
                // The high part has 16 bits.
                if coefficient > 32766 << LOW_BITS {
                    return None;
                }
                reach += coefficient;
                i += 1;
            }
            if reach > most {
                return None;
            }
            axis += 1;
        }
        let CorrectorParts { coefficients, offset, .. } = parts;
        Some(Self { kernel: Kernel::new(&Fixed { shift, coefficients, offset }) })
    }

    /// Its integers.
    pub fn to_parts(&self) -> CorrectorParts {
        CorrectorParts::of(&self.kernel)
    }

    /// Specific force in body axes for counts in sensor axes.
    #[inline]
    pub fn correct(&self, counts: Counts) -> SpecificForceQ16 {
        SpecificForceQ16(self.kernel.apply(counts.0))
    }

    /// The same for counts of 20 bits; counts beyond are clamped, and so is the result, to ±2²⁹ LSB.
    ///
    /// Within that range, at the reference temperature, at most 1 LSB from the f64 result, if no row of M is longer than 511 LSB per
    /// count, which holds for sensors of 2000 LSB/g and more (±262 g).
    pub fn correct_wide(&self, counts: WideCounts) -> SpecificForceQ16 {
        SpecificForceQ16(self.kernel.apply_wide(counts))
    }
}

/// The integers of a [`Corrector`], the same for every target: those of M and o in equation (3) of
/// docs/reference/equations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CorrectorParts {
    /// Fraction bits of the offset, 3 to 14.
    pub shift: u8,
    /// M, row by row, 2^−(shift + 15) · 2⁻¹⁶ m/s² per LSB.
    pub coefficients: [[i32; 3]; 3],
    /// o and the rounding of sums, 2^−shift · 2⁻¹⁶ m/s².
    pub offset: [i32; 3],
}

impl CorrectorParts {
    pub(crate) fn of(kernel: &Kernel) -> Self {
        let Fixed { shift, coefficients, offset } = kernel.fixed();
        Self { shift: shift as u8, coefficients, offset }
    }
}

/// The integers of y = k c with k LSB per count, at most 4095.
pub(crate) const fn diagonal(lsb_per_count: f64) -> Fixed {
    let k = if lsb_per_count < 4095.0 { lsb_per_count } else { 4095.0 };
    let mut shift = MAX_SHIFT;
    while shift > MIN_SHIFT && k * (1_u32 << shift) as f64 > 32766.0 {
        shift -= 1;
    }
    let value = k * (1_u32 << shift) as f64;
    // Rounded to nearest; positive.
    let high = (value + 0.5) as i32;
    let low = ((value - high as f64) * (1_u32 << LOW_BITS) as f64 + 32768.5) as i32 - 32768;
    let whole = whole(high, low);
    Fixed {
        shift,
        coefficients: [[whole, 0, 0], [0, whole, 0], [0, 0, whole]],
        offset: [(1 << (shift - 1)) + 1; 3],
    }
}

/// The integers of y = M c + o, LSB, with room for the offset to change by `drift` and for all to grow by the factor
/// `growth`; `None` where full-scale counts exceed [`LARGEST_OUTPUT`] or the result would be more than 1 LSB from the f64
/// result.
pub(crate) fn kernel(
    coefficients: Matrix3,
    offset: [f64; 3],
    drift: [f64; 3],
    growth: f64,
) -> Option<Kernel> {
    let mut largest = 0.0_f64;
    let mut reach = 0.0_f64;
    for axis in 0..3 {
        let magnitudes = coefficients[axis].map(f64::abs);
        largest = magnitudes.iter().fold(largest, |l, &m| l.max(m));
        let offset = offset[axis].abs() + drift[axis];
        let counts = (magnitudes[0] + magnitudes[1] + magnitudes[2]) * 32768.0;
        reach = reach.max((counts + offset) * growth);
    }
    largest *= growth;
    // The sum of the high parts may exceed the total by that of the low parts, 3 · 2¹⁵ / 2, and
    // the rounding; 2¹⁷ covers both.
    let fits = |shift: u32| {
        let unit = (1_u32 << shift) as f64;
        largest * unit <= 32766.0 && reach * unit <= 2_147_483_648.0 - 131_072.0
    };
    let shift =
        (MIN_SHIFT..=MAX_SHIFT).rev().find(|&shift| fits(shift) && reach <= LARGEST_OUTPUT)?;
    let unit = (1_u32 << shift) as f64;
    Some(Kernel::new(&Fixed {
        shift,
        coefficients: coefficients.map(|row| row.map(|k| split(k * unit))),
        // Half a unit is added because the sum of the low parts is rounded down.
        offset: offset.map(|o| round(o * unit + 0.5) + (1 << (shift - 1))),
    }))
}

/// `value` as high + low · 2⁻¹⁵, both rounded to nearest, in units of 2⁻¹⁵.
fn split(value: f64) -> i32 {
    let high = round(value);
    let low = round((value - high as f64) * (1_u32 << LOW_BITS) as f64);
    whole(high, low)
}

pub(crate) fn round(value: f64) -> i32 {
    (value + if value < 0.0 { -0.5 } else { 0.5 }) as i32
}

/// Why parameters cannot be compiled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum CompileError {
    /// The result would not fit 32 bits, or not be exact to one LSB.
    Overflow,
    /// A cannot be inverted.
    Singular,
    /// Bias or scale factor change too much with temperature: the scale factor by more than 0.1 %/K.
    Slope,
    /// The set has both a gyroscope and a magnetometer: more than 256 bytes.
    TooLong,
}

impl fmt::Display for CompileError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Overflow => {
                "full-scale counts under these parameters exceed what 32 bits hold at 2⁻¹⁶ m/s²; check sensitivity, bias and scale"
            }
            Self::Singular => "the matrix of scale factors and misalignments cannot be inverted",
            Self::Slope => {
                "bias or scale factor change too much with temperature (scale factor: at most 0.1 %/K); check the temperature terms"
            }
            Self::TooLong => {
                "a device takes either a gyroscope or a magnetometer beside the accelerometer; leave out one"
            }
        })
    }
}

impl core::error::Error for CompileError {}
