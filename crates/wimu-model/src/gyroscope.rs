//! The error model of a gyroscope, and its fixed-point corrector: equations (25) and (26) of
//! docs/reference/equations.

use crate::corrector::{CompileError, diagonal, round};
use crate::error::{Bounds, ModelError, check_matrix};
use crate::fixed::scaled_dot;
use crate::kernel::Kernel;
use crate::matrix::{self, Matrix3};
use crate::{AngularRateQ20, CentiCelsius, Counts, SpecificForceQ16, WideCounts};

/// Temperature terms about a reference temperature T₀: b(T) = b₀ + b₁ (T−T₀), S(T) = S₀ (1 + s₁ (T−T₀)).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GyroscopeTemperatureTerms {
    /// T₀, °C, −60..=150.
    pub reference_c: f64,
    /// b₁, rad/s per K, |b₁| ≤ 0.05.
    pub bias_rad_s_per_k: [f64; 3],
    /// s₁, 1/K, |s₁| ≤ 0.01.
    pub scale_per_k: [f64; 3],
}

impl Default for GyroscopeTemperatureTerms {
    /// No temperature effect, about 25 °C.
    fn default() -> Self {
        Self { reference_c: 25.0, bias_rad_s_per_k: [0.0; 3], scale_per_k: [0.0; 3] }
    }
}

/// The parameters of a gyroscope's error model before they are checked: [`GyroscopeModel::new`] checks
/// them.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GyroscopeTerms {
    /// b₀, rad/s, sensor axes, each within ±1.
    pub bias_rad_s: [f64; 3],
    /// A at T₀, dimensionless: scale factors within 0.5..=1.5, misalignments within ±0.3 rad.
    pub matrix: Matrix3,
    /// G, rad/s per m/s², each within ±0.02 (11 °/s per *g*); sensor axes of gyroscope and accelerometer.
    #[cfg_attr(feature = "serde", serde(default))]
    pub g_sensitivity: Matrix3,
    /// Temperature terms.
    #[cfg_attr(feature = "serde", serde(default))]
    pub temperature: GyroscopeTemperatureTerms,
}

impl Default for GyroscopeTerms {
    /// A perfect sensor.
    fn default() -> Self {
        Self {
            bias_rad_s: [0.0; 3],
            matrix: matrix::IDENTITY,
            g_sensitivity: [[0.0; 3]; 3],
            temperature: GyroscopeTemperatureTerms::default(),
        }
    }
}

/// The error model of a three-axis gyroscope: y = b(T) + A(T) ω + G f, output y and angular rate ω in
/// rad/s, specific force f in m/s², all in sensor axes (IEEE Std 528: bias, scale factor, misalignment,
/// acceleration-sensitive drift).
///
/// Always finite, within bounds and invertible: it cannot be built otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "GyroscopeTerms", into = "GyroscopeTerms"))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GyroscopeModel(GyroscopeTerms);

impl GyroscopeModel {
    /// Checks the terms and makes them a model.
    ///
    /// # Errors
    /// [`ModelError`] names the first term that is outside the bounds given on [`GyroscopeTerms`]
    /// and [`GyroscopeTemperatureTerms`] (a NaN is), or says that A is singular.
    pub fn new(terms: GyroscopeTerms) -> Result<Self, ModelError> {
        let t = &terms.temperature;
        Bounds("reference temperature", " °C", -60.0, 150.0).check(t.reference_c)?;
        Bounds("gyroscope bias", " rad/s", -1.0, 1.0).check_axes(&terms.bias_rad_s)?;
        check_matrix("the gyroscope's matrix", &terms.matrix)?;
        let g = terms.g_sensitivity.as_flattened();
        Bounds("g-sensitivity", " rad/s per m/s²", -0.02, 0.02).check_axes(g)?;
        Bounds("gyroscope bias slope", " rad/s/K", -0.05, 0.05).check_axes(&t.bias_rad_s_per_k)?;
        Bounds("scale-factor slope", " 1/K", -0.01, 0.01).check_axes(&t.scale_per_k)?;
        Ok(Self(terms))
    }

    /// The parameters.
    pub fn terms(&self) -> &GyroscopeTerms {
        &self.0
    }

    /// Output of the sensor, rad/s, sensor axes, without noise, for angular rate `rate`, rad/s, and
    /// specific force `force`, m/s², at `temperature` (T₀ if `None`). Equation (25).
    pub fn distort(
        &self,
        rate: [f64; 3],
        force: [f64; 3],
        temperature: Option<CentiCelsius>,
    ) -> [f64; 3] {
        let (bias, a) = self.at(temperature);
        let rotation = matrix::apply(&a, rate);
        let g = matrix::apply(&self.0.g_sensitivity, force);
        [0, 1, 2].map(|axis| bias[axis] + rotation[axis] + g[axis])
    }

    /// Angular rate, rad/s, from the output of the sensor; the inverse of [`distort`](Self::distort).
    pub fn correct(
        &self,
        output: [f64; 3],
        force: [f64; 3],
        temperature: Option<CentiCelsius>,
    ) -> [f64; 3] {
        let (bias, a) = self.at(temperature);
        let g = matrix::apply(&self.0.g_sensitivity, force);
        matrix::apply(
            &matrix::inverse(&a),
            [0, 1, 2].map(|axis| output[axis] - bias[axis] - g[axis]),
        )
    }

    /// b(T) in rad/s and A(T).
    fn at(&self, temperature: Option<CentiCelsius>) -> ([f64; 3], Matrix3) {
        let t = &self.0.temperature;
        let dt = temperature.map_or(0.0, |now| now.to_celsius() - t.reference_c);
        let (mut bias, mut a) = (self.0.bias_rad_s, self.0.matrix);
        for axis in 0..3 {
            bias[axis] += t.bias_rad_s_per_k[axis] * dt;
            a[axis][axis] *= 1.0 + t.scale_per_k[axis] * dt;
        }
        (bias, a)
    }
}

impl TryFrom<GyroscopeTerms> for GyroscopeModel {
    type Error = ModelError;

    fn try_from(terms: GyroscopeTerms) -> Result<Self, ModelError> {
        Self::new(terms)
    }
}

impl From<GyroscopeModel> for GyroscopeTerms {
    fn from(model: GyroscopeModel) -> GyroscopeTerms {
        model.0
    }
}

/// Maps counts of a gyroscope to angular rate in body axes in integers, at one latched temperature:
/// ω = R A(T)⁻¹ (y − b(T) − G Rᵀ f), equation (26) of docs/reference/equations.
///
/// At the model's reference temperature and without g-sensitivity the result is at most 1 LSB (2⁻²⁰ rad/s) from the f64
/// result for all 16-bit counts, with it at most 2 LSB for specific force within ±2²⁴ LSB (256 m/s²). It is within ±2²⁸ LSB
/// (256 rad/s).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GyroscopeCorrector {
    kernel: Kernel,
    /// −R A⁻¹ G Rᵀ, LSB of rate per LSB of force, 2⁻²⁸; `None` if G is zero.
    g_sensitivity: Option<[[i32; 3]; 3]>,
}

impl GyroscopeCorrector {
    /// That of an uncalibrated sensor in body axes, of `rad_s_per_lsb`, at most 0.0039 rad/s. Called in a constant, it
    /// leaves no floating point in the image.
    pub const fn ideal(rad_s_per_lsb: f64) -> Self {
        let kernel = Kernel::new(&diagonal(rad_s_per_lsb * AngularRateQ20::LSB_PER_RAD_S));
        Self { kernel, g_sensitivity: None }
    }

    pub(crate) fn new(kernel: Kernel, g_sensitivity: [[i32; 3]; 3]) -> Self {
        Self { kernel, g_sensitivity: (g_sensitivity != [[0; 3]; 3]).then_some(g_sensitivity) }
    }

    /// Angular rate in body axes for counts in sensor axes, and the corrected specific force of the same
    /// sample, body axes.
    #[inline]
    pub fn correct(&self, counts: Counts, force: SpecificForceQ16) -> AngularRateQ20 {
        self.compensated(self.kernel.apply(counts.0), force)
    }

    /// The same for counts of 20 bits; counts beyond are clamped, and so is the result without
    /// g-sensitivity, to ±2²⁹ LSB (512 rad/s).
    ///
    /// Within that range the error is that of [`correct`](Self::correct) for a scale of up to
    /// 3 · 10⁻⁴ rad/s per LSB (±157 rad/s).
    pub fn correct_wide(&self, counts: WideCounts, force: SpecificForceQ16) -> AngularRateQ20 {
        self.compensated(self.kernel.apply_wide(counts), force)
    }

    /// `rate` without the effect of specific force.
    #[inline]
    fn compensated(&self, mut rate: [i32; 3], force: SpecificForceQ16) -> AngularRateQ20 {
        if let Some(g) = &self.g_sensitivity {
            for (axis, row) in rate.iter_mut().zip(g) {
                // Within 2³¹: three products of 2²⁹ each, and the rate.
                *axis = axis.wrapping_add(scaled_dot(*row, force.0));
            }
        }
        AngularRateQ20(rate)
    }
}

/// −R A⁻¹ G Rᵀ, LSB of rate per LSB of force, 2⁻²⁸, of R A⁻¹, G and R.
///
/// # Errors
/// [`CompileError::Overflow`] beyond 0.0625 rad/s per m/s².
pub(crate) fn g_sensitivity(
    to_body: &Matrix3,
    g: &Matrix3,
    rotation: &Matrix3,
) -> Result<[[i32; 3]; 3], CompileError> {
    let transposed = matrix::transposed(rotation);
    let body = matrix::multiply(&matrix::multiply(to_body, g), &transposed);
    let lsb = AngularRateQ20::LSB_PER_RAD_S / SpecificForceQ16::LSB_PER_MPS2;
    let unit = (1_u32 << G_BITS) as f64 * lsb;
    let integers = body.map(|row| row.map(|k| round(-k * unit)));
    let fits = integers.as_flattened().iter().all(|k| k.unsigned_abs() <= LARGEST_G);
    if fits { Ok(integers) } else { Err(CompileError::Overflow) }
}

/// Fraction bits of a g-sensitivity coefficient.
const G_BITS: u32 = 28;
/// Largest g-sensitivity coefficient, 2⁻²⁸: 0.0625 rad/s per m/s².
const LARGEST_G: u32 = (1 << 28) - 1;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Alignment, CompiledSet, GyroscopeParameters, ParameterId, ParameterSet, Sensitivity,
    };
    use proptest::prelude::*;

    fn compile(
        model: &GyroscopeModel,
        rad_s_per_lsb: f64,
        alignment: Alignment,
        temperature: Option<CentiCelsius>,
    ) -> Result<GyroscopeCorrector, CompileError> {
        let gyroscope = GyroscopeParameters::new(2000, rad_s_per_lsb, *model, None);
        let sensitivity = Sensitivity::from_lsb_per_g(16384.0).expect("within bounds");
        let set = ParameterSet {
            alignment,
            gyroscope: Some(gyroscope.expect("within bounds")),
            ..ParameterSet::uncalibrated(2, sensitivity)
        };
        let set = CompiledSet::compile(&set, ParameterId(1), 0)?;
        Ok(set.gyroscope(temperature).expect("a gyroscope"))
    }

    prop_compose! {
        fn terms()(
            bias in prop::array::uniform3(-0.5..0.5_f64),
            scale in prop::array::uniform3(0.9..1.1_f64),
            skew in prop::array::uniform6(-0.05..0.05_f64),
            g in prop::array::uniform9(-0.01..0.01_f64),
            slope in prop::array::uniform3(-0.01..0.01_f64),
        ) -> GyroscopeTerms {
            GyroscopeTerms {
                bias_rad_s: bias,
                matrix: [
                    [scale[0], skew[0], skew[1]],
                    [skew[2], scale[1], skew[3]],
                    [skew[4], skew[5], scale[2]],
                ],
                g_sensitivity: [[g[0], g[1], g[2]], [g[3], g[4], g[5]], [g[6], g[7], g[8]]],
                temperature: GyroscopeTemperatureTerms {
                    bias_rad_s_per_k: slope,
                    ..GyroscopeTemperatureTerms::default()
                },
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(5000))]

        #[test]
        fn the_corrector_is_within_2_lsb_of_the_model(
            terms in terms(),
            counts: [i16; 3],
            force in prop::array::uniform3(-(1 << 24)..1_i32 << 24),
            quaternion in prop::array::uniform4(-1.0..1.0_f64),
            celsius in -20.0..60.0_f64,
        ) {
            let Ok(alignment) = Alignment::from_quaternion(quaternion) else { return Ok(()) };
            let model = GyroscopeModel::new(terms).expect("within bounds");
            let temperature = Some(CentiCelsius::from_celsius(celsius));
            let rad_s_per_lsb = 0.0011;
            let corrector = compile(&model, rad_s_per_lsb, alignment, temperature)
                .expect("in range");
            let force = SpecificForceQ16(force);
            let rotation = alignment.matrix();
            let back = [0, 1, 2].map(|row| [0, 1, 2].map(|column| rotation[column][row]));
            let output = counts.map(|c| f64::from(c) * rad_s_per_lsb);
            let sensor = model.correct(output, matrix::apply(&back, force.to_mps2().0), temperature);
            let exact = matrix::apply(&rotation, sensor).map(|r| r * AngularRateQ20::LSB_PER_RAD_S);
            let found = corrector.correct(Counts(counts), force);
            for axis in 0..3 {
                let error = f64::from(found.0[axis]) - exact[axis];
                prop_assert!(error.abs() <= 2.0, "{error}");
            }
        }

        #[test]
        fn wide_counts_are_within_1_lsb_of_the_model_and_clamped_beyond_20_bits(
            terms in terms(),
            counts in prop::array::uniform3(WideCounts::MIN..=WideCounts::MAX),
            force in prop::array::uniform3(-(1 << 24)..1_i32 << 24),
            rad_s_per_lsb in 1e-6..3e-4_f64,
            celsius in -20.0..60.0_f64,
        ) {
            let edge = |beyond: i32| {
                counts.map(|c| if c < 0 { WideCounts::MIN - beyond } else { WideCounts::MAX + beyond })
            };
            let temperature = Some(CentiCelsius::from_celsius(celsius));
            let force = SpecificForceQ16(force);
            let g_sensitivity = [[0.0; 3]; 3];
            for (terms, bound) in [(GyroscopeTerms { g_sensitivity, ..terms }, 1.0), (terms, 2.0)] {
                let model = GyroscopeModel::new(terms).expect("within bounds");
                let identity = Alignment::IDENTITY;
                let corrector =
                    compile(&model, rad_s_per_lsb, identity, temperature).expect("in range");
                for counts in [counts, edge(0), [WideCounts::MIN; 3], [WideCounts::MAX; 3]] {
                    let output = counts.map(|c| f64::from(c) * rad_s_per_lsb);
                    let exact = model.correct(output, force.to_mps2().0, temperature);
                    let found = corrector.correct_wide(WideCounts(counts), force);
                    for axis in 0..3 {
                        let error = f64::from(found.0[axis]) - exact[axis] * AngularRateQ20::LSB_PER_RAD_S;
                        prop_assert!(error.abs() <= bound, "{error}");
                    }
                }
                let wide = |counts| corrector.correct_wide(WideCounts(counts), force);
                prop_assert_eq!(wide(edge(1)), wide(edge(0)));
                prop_assert_eq!(wide(edge(i32::MAX / 2)), wide(edge(0)));
            }
        }

        #[test]
        fn correcting_undoes_the_model(
            terms in terms(),
            rate in prop::array::uniform3(-30.0..30.0_f64),
            force in prop::array::uniform3(-100.0..100.0_f64),
        ) {
            let model = GyroscopeModel::new(terms).expect("within bounds");
            let found = model.correct(model.distort(rate, force, None), force, None);
            for axis in 0..3 {
                prop_assert!((found[axis] - rate[axis]).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn terms_beyond_their_bounds_and_nan_are_named() {
        for value in [1.001, f64::NAN, f64::INFINITY] {
            let mut terms = GyroscopeTerms::default();
            terms.bias_rad_s[1] = value;
            assert!(matches!(
                GyroscopeModel::new(terms),
                Err(ModelError::OutOfBounds { name: "gyroscope bias", axis: Some(1), .. })
            ));
        }
        let mut terms = GyroscopeTerms::default();
        terms.bias_rad_s[1] = 1.0;
        assert!(GyroscopeModel::new(terms).is_ok());
    }

    #[test]
    fn a_g_sensitivity_beyond_its_range_in_body_axes_is_refused() {
        let compiled = |g| {
            let model = GyroscopeModel::new(GyroscopeTerms {
                matrix: [[0.52, 0.3, 0.3], [0.3, 0.52, 0.3], [0.3, 0.3, 0.52]],
                g_sensitivity: [[g, -g, -g], [-g, g, -g], [-g, -g, g]],
                ..GyroscopeTerms::default()
            })
            .expect("within bounds");
            compile(&model, 0.0011, Alignment::IDENTITY, None)
        };
        assert!(compiled(0.005).is_ok());
        assert_eq!(compiled(0.02), Err(CompileError::Overflow));
    }

    #[test]
    fn a_sensor_beyond_128_rad_s_is_refused() {
        let compiled = |rad_s_per_lsb| {
            compile(&GyroscopeModel::default(), rad_s_per_lsb, Alignment::IDENTITY, None)
        };
        assert!(compiled(0.0038).is_ok());
        assert_eq!(compiled(0.004), Err(CompileError::Overflow));
    }
}
