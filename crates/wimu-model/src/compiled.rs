//! A calibration compiled for a device: integers, and how they change with temperature. Equations (3) and (26) of
//! docs/reference/equations.

use core::fmt;

use crate::checksum::crc_32c;
use crate::compass::CompassTerms;
use crate::corrector::{CompileError, CorrectorParts, kernel, round};
use crate::gyroscope::{self, GyroscopeCorrector};
use crate::kernel::{Fixed, Kernel, LOW_BITS};
use crate::matrix::{self, Matrix3};
use crate::{
    Alignment, AngularRateQ20, CentiCelsius, Corrector, ErrorModel, ErrorTerms,
    GyroscopeParameters, ModelError, ParameterId, ParameterSet, STANDARD_GRAVITY_MPS2, Sensitivity,
    SpecificForceQ16, TemperatureTerms, root,
};

/// Format of the bytes of a [`CompiledSet`].
const FORMAT: u8 = 1;
/// Largest change of temperature that a set follows, 0.01 K: 100 K. Beyond, the correction at 100 K is used.
const MOST_CHANGE: i32 = 10_000;
/// Largest ‖E‖∞ · 100 K, so that terms of the series beyond [`TERMS`] are below 10⁻⁶ of the output.
const MOST_SCALE_CHANGE: f64 = 0.1;
/// Terms of the Neumann series of (I + E ΔT)⁻¹ after the first.
const TERMS: usize = 5;
/// Fraction bits of the bias slope (LSB per 0.01 K) and of the bias curve (LSB per (0.01 K)²).
const SLOPE_BITS: u32 = 22;
const CURVE_BITS: u32 = 34;
/// Most fraction bits of E, 0.01 K: three products of 15, 14 and 32 bits fit 64.
const MOST_SCALE_BITS: u8 = 46;

/// What a device needs of a calibration, at most [`CompiledSet::MAX_BYTES`] bytes: no f64, no covariance. The host
/// compiles it ([`compile`](Self::compile)), checks that it suits the sensor and keeps the source; the device checks
/// length, checksum and device id.
///
/// The correctors at the reference temperature are at most 1 LSB from the f64 model; within ±100 K of it at most 2 LSB and
/// 2⁻¹⁵ of what the scale factor has changed (1 ppm of the output where it changed by 3 %).
///
/// ```
/// use wimu_model::{CompiledSet, Counts, ParameterId, ParameterSet, Sensitivity};
///
/// let calibration = ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16384.0)?);
/// let set = CompiledSet::compile(&calibration, ParameterId(7), 0)?;
/// let mut bytes = [0; CompiledSet::MAX_BYTES];
/// let length = set.to_bytes(&mut bytes);
///
/// let set = CompiledSet::from_bytes(&bytes[..length])?;
/// let force = set.corrector(None).correct(Counts([0, 0, 16384]));
/// assert!((force.to_mps2().0[2] - 9.80665).abs() < 1e-4);
/// # Ok::<(), Box<dyn core::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CompiledSet {
    device: u64,
    source: ParameterId,
    range_g: u8,
    utc_s: u32,
    reference: CentiCelsius,
    force: Triad,
    rate: Option<Rate>,
    compass: Option<CompassTerms>,
}

/// Integers of three axes at the reference temperature, and their change: M(T) = (I + E ΔT)⁻¹ M,
/// o(T) = (I + E ΔT)⁻¹ (o + o₁ ΔT + o₂ ΔT²).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Triad {
    parts: CorrectorParts,
    /// o₁, 2⁻²² LSB per 0.01 K.
    slope: [i32; 3],
    /// o₂, 2⁻³⁴ LSB per (0.01 K)².
    curve: [i32; 3],
    /// E, 2^−`scale_bits` per 0.01 K, body axes.
    scale: [[i16; 3]; 3],
    scale_bits: u8,
}

/// Those of a gyroscope, with −G at the reference temperature, LSB of rate per LSB of force, 2⁻²⁸.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Rate {
    triad: Triad,
    g_sensitivity: [[i32; 3]; 3],
}

impl CompiledSet {
    /// Longest form in bytes: of a set with a gyroscope, which has no compass.
    pub const MAX_BYTES: usize = 256;

    /// Compiles `set`, whose id is `source`, for the device with the id `device` (0: any).
    ///
    /// # Errors
    /// [`CompileError`].
    pub fn compile(
        set: &ParameterSet,
        source: ParameterId,
        device: u64,
    ) -> Result<Self, CompileError> {
        let rotation = set.alignment.matrix();
        let terms = set.model.terms();
        let t = &terms.temperature;
        let reference = CentiCelsius::from_celsius(t.reference_c);
        let force = Triad::compile(
            Affine {
                rotation,
                matrix: terms.matrix,
                bias: [terms.bias_mps2, t.bias_mps2_per_k, t.bias_mps2_per_k2],
                scale_per_k: t.scale_per_k,
                count: set.sensitivity.mps2_per_lsb(),
                lsb: SpecificForceQ16::LSB_PER_MPS2,
            }
            .after(reference.to_celsius() - t.reference_c),
        )?;
        let rate = set.gyroscope.as_ref();
        let rate = rate.map(|of| Rate::compile(of, rotation, reference)).transpose()?;
        let compass = CompassTerms::new(set);
        if rate.is_some() && compass.is_some() {
            return Err(CompileError::TooLong);
        }
        Ok(Self {
            device,
            source,
            range_g: set.range_g,
            utc_s: set.quality.and_then(|quality| quality.terms().utc_s).unwrap_or(0) as u32,
            reference,
            force,
            rate,
            compass,
        })
    }

    /// Id of the device that it is for; 0: any.
    pub fn device(&self) -> u64 {
        self.device
    }

    /// Id of the calibration that it was compiled from.
    pub fn source(&self) -> ParameterId {
        self.source
    }

    /// Full-scale range of the calibration, ± *g*.
    pub fn range_g(&self) -> u8 {
        self.range_g
    }

    /// Time of the calibration, s since 1970 UTC; `None` if unknown.
    pub fn utc_s(&self) -> Option<u32> {
        (self.utc_s > 0).then_some(self.utc_s)
    }

    /// The accelerometer's corrector at `temperature`, that of the reference if `None`.
    pub fn corrector(&self, temperature: Option<CentiCelsius>) -> Corrector {
        let (kernel, _) = self.force.at(self.change(temperature));
        Corrector { kernel }
    }

    /// The gyroscope's; `None` if it is not calibrated.
    pub fn gyroscope(&self, temperature: Option<CentiCelsius>) -> Option<GyroscopeCorrector> {
        let Rate { triad, g_sensitivity } = self.rate.as_ref()?;
        let (kernel, series) = triad.at(self.change(temperature));
        let mut g = *g_sensitivity;
        for column in 0..3 {
            let axis = series.of(g_sensitivity.map(|row| i64::from(row[column])));
            for (row, value) in g.iter_mut().zip(axis) {
                row[column] = value as i32;
            }
        }
        Some(GyroscopeCorrector::new(kernel, g))
    }

    /// What a heading needs; `None` without a calibrated magnetometer.
    pub fn compass(&self) -> Option<&CompassTerms> {
        self.compass.as_ref()
    }

    /// The calibration that these integers are, for a host that does not have the source: to the rounding of the
    /// integers, without nonlinearity, gyroscope, magnetometer and quality. `sensitivity` is the nominal one of the sensor;
    /// without it, the one with which the scale factors are 1 on average.
    ///
    /// A = L is lower triangular, and the alignment the rotation that is left: what gravity observes.
    ///
    /// # Errors
    /// [`ModelError`] where the integers are no error model.
    pub fn to_model(&self, sensitivity: Option<Sensitivity>) -> Result<ParameterSet, ModelError> {
        let parts = &self.force.parts;
        let unit = (1_u64 << (u32::from(parts.shift) + LOW_BITS)) as f64;
        let per_count = parts.coefficients.map(|row| row.map(|k| f64::from(k) / unit));
        let average = || {
            let lsb = libm::cbrt(matrix::determinant(&per_count));
            Sensitivity::from_lsb_per_g(
                STANDARD_GRAVITY_MPS2 * SpecificForceQ16::LSB_PER_MPS2 / lsb,
            )
        };
        let sensitivity = match sensitivity {
            Some(nominal) => nominal,
            None => average()
                .map_err(|_| ModelError::Singular { name: "the matrix", determinant: 0.0 })?,
        };
        let to_counts = SpecificForceQ16::LSB_PER_MPS2 * sensitivity.mps2_per_lsb();
        let to_body = per_count.map(|row| row.map(|k| k / to_counts));
        // y = b + L Q f with f in body axes.
        let (matrix, rotation) = lower(&matrix::inverse(&to_body));
        let force = |lsb: [f64; 3]| {
            let body = lsb.map(|lsb| -lsb / SpecificForceQ16::LSB_PER_MPS2);
            matrix::apply(&matrix, matrix::apply(&rotation, body))
        };
        let half = (1_u32 << (parts.shift - 1)) as f64;
        let per_lsb = (1_u32 << parts.shift) as f64;
        let slope = (1_u64 << SLOPE_BITS) as f64 / 1e2;
        let curve = (1_u64 << CURVE_BITS) as f64 / 1e4;
        let per_k = (1_u64 << self.force.scale_bits) as f64 / 1e2;
        let scale = self.force.scale.map(|row| row.map(|e| f64::from(e) / per_k));
        // E = Q E_b Qᵀ in sensor axes; A E is diagonal.
        let turned = matrix::multiply(&rotation, &scale);
        let sensor = matrix::multiply(&turned, &matrix::transposed(&rotation));
        let change = matrix::multiply(&matrix, &sensor);
        let model = ErrorModel::new(ErrorTerms {
            bias_mps2: force(parts.offset.map(|o| (f64::from(o) - half) / per_lsb)),
            matrix,
            temperature: TemperatureTerms {
                reference_c: self.reference.to_celsius(),
                bias_mps2_per_k: force(self.force.slope.map(|o| f64::from(o) / slope)),
                bias_mps2_per_k2: force(self.force.curve.map(|o| f64::from(o) / curve)),
                scale_per_k: [0, 1, 2].map(|axis| change[axis][axis] / matrix[axis][axis]),
            },
            nonlinearity: [0.0; 3],
        })?;
        let alignment = Alignment::from_matrix(&matrix::transposed(&rotation));
        Ok(ParameterSet {
            model,
            alignment,
            ..ParameterSet::uncalibrated(self.range_g, sensitivity)
        })
    }

    fn change(&self, temperature: Option<CentiCelsius>) -> i32 {
        let change = temperature.map_or(0, |now| i32::from(now.0) - i32::from(self.reference.0));
        change.clamp(-MOST_CHANGE, MOST_CHANGE)
    }

    /// Writes it; returns the length in bytes.
    pub fn to_bytes(&self, bytes: &mut [u8; Self::MAX_BYTES]) -> usize {
        let mut copy = *self;
        let mut rest = &mut bytes[..];
        let mut length = 0;
        copy.exchange(&mut |field| {
            if let Some((place, after)) =
                core::mem::take(&mut rest).split_at_mut_checked(field.len())
            {
                place.copy_from_slice(field);
                (rest, length) = (after, length + field.len());
            }
        });
        let check = crc_32c(bytes.get(..length).unwrap_or_default());
        let end = length + CHECKSUM;
        if let Some(place) = bytes.get_mut(length..end) {
            place.copy_from_slice(&check.to_le_bytes());
        }
        end
    }

    /// Reads it.
    ///
    /// # Errors
    /// [`SetError`] when the bytes are not exactly one set.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, SetError> {
        let (content, check) = bytes.split_last_chunk::<CHECKSUM>().ok_or(SetError::Length)?;
        if bytes.len() > Self::MAX_BYTES {
            return Err(SetError::Length);
        }
        if crc_32c(content) != u32::from_le_bytes(*check) {
            return Err(SetError::Checksum);
        }
        if content.first() != Some(&FORMAT) {
            return Err(SetError::Format);
        }
        let mut set = Self::default();
        let mut rest = Some(content);
        set.exchange(&mut |field| {
            let split = rest.and_then(|rest| rest.split_at_checked(field.len()));
            rest = split.map(|(read, after)| {
                field.copy_from_slice(read);
                after
            });
        });
        if rest.is_none_or(|rest| !rest.is_empty()) {
            return Err(SetError::Length);
        }
        let triads = [Some(&set.force), set.rate.as_ref().map(|rate| &rate.triad)];
        let is_sound = triads.into_iter().flatten().all(Triad::is_sound);
        if is_sound { Ok(set) } else { Err(SetError::Integers) }
    }

    /// Passes every field to `wire` in order, which reads it or writes it.
    fn exchange(&mut self, wire: &mut dyn FnMut(&mut [u8])) {
        let mut format = FORMAT;
        word(wire, &mut format);
        let mut parts = u8::from(self.rate.is_some()) | u8::from(self.compass.is_some()) << 1;
        word(wire, &mut parts);
        word(wire, &mut self.device);
        word(wire, &mut self.source.0);
        word(wire, &mut self.range_g);
        word(wire, &mut self.utc_s);
        word(wire, &mut self.reference.0);
        self.force.exchange(wire);
        if parts & 1 != 0 {
            let rate = self.rate.get_or_insert_default();
            rate.triad.exchange(wire);
            rate.g_sensitivity.as_flattened_mut().iter_mut().for_each(|g| word(wire, g));
        }
        if parts & 2 != 0 {
            let compass = self.compass.get_or_insert_default();
            compass.fields(|field| word(wire, field));
        }
    }
}

/// L and Q of a matrix L Q: L lower triangular with a positive diagonal, Q a rotation (Gram and Schmidt, by rows).
fn lower(m: &Matrix3) -> (Matrix3, Matrix3) {
    let mut l = [[0.0; 3]; 3];
    let mut q = [[0.0; 3]; 3];
    for row in 0..3 {
        let mut rest = m[row];
        for before in 0..row {
            let along = (0..3).map(|k| m[row][k] * q[before][k]).sum::<f64>();
            l[row][before] = along;
            for k in 0..3 {
                rest[k] -= along * q[before][k];
            }
        }
        let length = root::sqrt(rest.iter().map(|r| r * r).sum());
        l[row][row] = length;
        q[row] = rest.map(|r| r / length);
    }
    (l, q)
}

/// Bytes of the CRC-32C at the end.
const CHECKSUM: usize = 4;

/// A number of a fixed size, little-endian.
trait Word: Copy {
    type Bytes: AsMut<[u8]>;
    fn to_bytes(self) -> Self::Bytes;
    fn from_bytes(bytes: Self::Bytes) -> Self;
}

macro_rules! words {
    ($($number:ty),*) => {$(
        impl Word for $number {
            type Bytes = [u8; size_of::<$number>()];
            fn to_bytes(self) -> Self::Bytes {
                self.to_le_bytes()
            }
            fn from_bytes(bytes: Self::Bytes) -> Self {
                Self::from_le_bytes(bytes)
            }
        }
    )*};
}
words!(u8, i16, i32, u32, u64, f32);

fn word<W: Word>(wire: &mut dyn FnMut(&mut [u8]), value: &mut W) {
    let mut bytes = value.to_bytes();
    wire(bytes.as_mut());
    *value = W::from_bytes(bytes);
}

/// y = b(T) + A(T) u of one sensor.
struct Affine {
    /// Sensor to body.
    rotation: Matrix3,
    /// A at the reference temperature.
    matrix: Matrix3,
    /// b and its slope and curve per K.
    bias: [[f64; 3]; 3],
    /// Relative change of the diagonal of A, 1/K.
    scale_per_k: [f64; 3],
    /// Unit of y per count.
    count: f64,
    /// LSB per unit of the output.
    lsb: f64,
}

impl Affine {
    /// The same about a reference that is `change` K warmer.
    fn after(mut self, change: f64) -> Self {
        let [bias, slope, curve] = &mut self.bias;
        for axis in 0..3 {
            bias[axis] += (slope[axis] + curve[axis] * change) * change;
            slope[axis] += 2.0 * curve[axis] * change;
            let scale = 1.0 + self.scale_per_k[axis] * change;
            self.matrix[axis][axis] *= scale;
            self.scale_per_k[axis] /= scale;
        }
        self
    }
}

impl Triad {
    fn compile(of: Affine) -> Result<Self, CompileError> {
        if matrix::determinant(&of.matrix) < 0.01 {
            return Err(CompileError::Singular);
        }
        let inverse = matrix::inverse(&of.matrix);
        let to_body = matrix::multiply(&of.rotation, &inverse);
        let [offset, slope, curve] =
            of.bias.map(|bias| matrix::apply(&to_body, bias).map(|b| -b * of.lsb));
        let mut diagonal = [[0.0; 3]; 3];
        for axis in 0..3 {
            diagonal[axis][axis] = of.matrix[axis][axis] * of.scale_per_k[axis];
        }
        let transposed = matrix::transposed(&of.rotation);
        let scale = matrix::multiply(&matrix::multiply(&to_body, &diagonal), &transposed);
        let rows = scale.map(|row| row.iter().map(|e| e.abs()).sum::<f64>());
        let most_change = f64::from(MOST_CHANGE) / 100.0;
        let scale_change = rows.into_iter().fold(0.0, f64::max) * most_change;
        if scale_change > MOST_SCALE_CHANGE {
            return Err(CompileError::Slope);
        }
        let drift = [0, 1, 2]
            .map(|axis| (slope[axis].abs() + curve[axis].abs() * most_change) * most_change);
        let coefficients = to_body.map(|row| row.map(|k| k * of.count * of.lsb));
        let kernel = kernel(coefficients, offset, drift, 1.0 + 1.2 * scale_change)
            .ok_or(CompileError::Overflow)?;
        let fixed = |values: [f64; 3], unit: f64| {
            let values = values.map(|value| value * unit);
            let fits = values.iter().all(|value| value.abs() < 2_147_483_647.0);
            if fits { Ok(values.map(round)) } else { Err(CompileError::Slope) }
        };
        let largest = scale.as_flattened().iter().fold(0.0_f64, |l, e| l.max(e.abs())) / 100.0;
        let fits = |bits: &u8| largest * (1_u64 << bits) as f64 <= 32_767.0;
        let scale_bits = (1..=MOST_SCALE_BITS).rev().find(fits).ok_or(CompileError::Slope)?;
        let unit = (1_u64 << scale_bits) as f64 / 100.0;
        Ok(Self {
            parts: CorrectorParts::of(&kernel),
            slope: fixed(slope, (1_u64 << SLOPE_BITS) as f64 / 1e2)?,
            curve: fixed(curve, (1_u64 << CURVE_BITS) as f64 / 1e4)?,
            scale: scale.map(|row| row.map(|e| round(e * unit) as i16)),
            scale_bits,
        })
    }

    fn is_sound(&self) -> bool {
        let bits = 1..=MOST_SCALE_BITS;
        Corrector::from_parts(self.parts).is_some() && bits.contains(&self.scale_bits)
    }

    /// The integers after a change of temperature, 0.01 K, and the series that they were multiplied by. Those of the
    /// reference where the others would not fit 32 bits.
    fn at(&self, change: i32) -> (Kernel, Series) {
        let CorrectorParts { shift, coefficients, offset } = self.parts;
        let shift = u32::from(shift);
        let series = Series {
            scale: self.scale.map(|row| row.map(|e| i64::from(i32::from(e) * change))),
            bits: self.scale_bits.into(),
        };
        let mut changed = self.parts;
        for column in 0..3 {
            let axis = series.of(coefficients.map(|row| row[column].into()));
            for (row, value) in changed.coefficients.iter_mut().zip(axis) {
                row[column] = value as i32;
            }
        }
        // Half an LSB, which rounds the sum.
        let half = 1_i64 << (shift - 1);
        let change = i64::from(change);
        let drifted = core::array::from_fn(|axis| {
            let curve =
                (i64::from(self.curve[axis]) * change * change) >> (CURVE_BITS - SLOPE_BITS);
            let drift = i64::from(self.slope[axis]) * change + curve;
            i64::from(offset[axis]) - half + (drift >> (SLOPE_BITS - shift))
        });
        changed.offset = series.of(drifted).map(|value| (value + half) as i32);
        let sound = Corrector::from_parts(changed).map_or(self.parts, |_| changed);
        (Kernel::new(&Fixed::from(sound)), series)
    }

    fn exchange(&mut self, wire: &mut dyn FnMut(&mut [u8])) {
        word(wire, &mut self.parts.shift);
        self.parts.coefficients.as_flattened_mut().iter_mut().for_each(|k| word(wire, k));
        for values in [&mut self.parts.offset, &mut self.slope, &mut self.curve] {
            values.iter_mut().for_each(|value| word(wire, value));
        }
        self.scale.as_flattened_mut().iter_mut().for_each(|e| word(wire, e));
        word(wire, &mut self.scale_bits);
    }
}

/// (I + E ΔT)⁻¹ as a Neumann series, by Horner's rule: y ← x − E ΔT y.
struct Series {
    /// E ΔT, 2^−`bits`.
    scale: [[i64; 3]; 3],
    bits: u32,
}

impl Series {
    fn of(&self, x: [i64; 3]) -> [i64; 3] {
        let mut y = x;
        for _ in 0..TERMS {
            let product = self.scale.map(|row| {
                let sum = (row[0].wrapping_mul(y[0]))
                    .wrapping_add(row[1].wrapping_mul(y[1]))
                    .wrapping_add(row[2].wrapping_mul(y[2]));
                (sum.wrapping_add(1 << (self.bits - 1))) >> self.bits
            });
            y = [0, 1, 2].map(|axis| x[axis].wrapping_sub(product[axis]));
        }
        y
    }
}

impl Rate {
    fn compile(
        of: &GyroscopeParameters,
        rotation: Matrix3,
        reference: CentiCelsius,
    ) -> Result<Self, CompileError> {
        let terms = of.model.terms();
        let t = &terms.temperature;
        let at_reference = Affine {
            rotation,
            matrix: terms.matrix,
            bias: [terms.bias_rad_s, t.bias_rad_s_per_k, [0.0; 3]],
            scale_per_k: t.scale_per_k,
            count: of.rad_s_per_lsb,
            lsb: AngularRateQ20::LSB_PER_RAD_S,
        }
        .after(reference.to_celsius() - t.reference_c);
        let to_body = matrix::multiply(&rotation, &matrix::inverse(&at_reference.matrix));
        let triad = Triad::compile(at_reference)?;
        let g = gyroscope::g_sensitivity(&to_body, &terms.g_sensitivity, &rotation)?;
        Ok(Self { triad, g_sensitivity: g })
    }
}

/// Why bytes are not a [`CompiledSet`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SetError {
    /// They are too few or too many.
    Length,
    /// They were changed.
    Checksum,
    /// They were made by another version.
    Format,
    /// The integers cannot have come from a compiler.
    Integers,
    /// They are for a device with another id.
    Device,
}

impl fmt::Display for SetError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Device => "the set of parameters is for another device; compile it for this one",
            Self::Length => "the set of parameters is too short or too long; compile it again",
            Self::Checksum => "the set of parameters is damaged; compile it again",
            Self::Format => "the set of parameters has another format; compile it with the wimu that the device was built with",
            Self::Integers => "the set of parameters has integers out of bounds; compile it again",
        })
    }
}

impl core::error::Error for SetError {}
