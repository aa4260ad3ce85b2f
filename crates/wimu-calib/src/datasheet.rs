//! Datasheet limits, and a comparison with an estimate.

use core::fmt;

use wimu_model::STANDARD_GRAVITY_MPS2;

use crate::{Estimate, Parameter, Term, student};

/// A datasheet limit on the absolute value of a parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// In the unit of its [`Quantity`].
    pub most: f64,
    /// Whether it is a maximum; a typical value is exceeded by many good sensors.
    pub guaranteed: bool,
}

const fn typical(most: f64) -> Option<Limit> {
    Some(Limit { most, guaranteed: false })
}

const fn guaranteed(most: f64) -> Option<Limit> {
    Some(Limit { most, guaranteed: true })
}

/// Datasheet limits on the errors of an accelerometer at 25 °C; `None` if not specified.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Datasheet {
    /// The sensor, as its maker writes it.
    pub sensor: &'static str,
    /// Source of the values.
    pub document: &'static str,
    /// Nominal sensitivity at each range, LSB/g.
    pub sensitivities_lsb_per_g: &'static [f64],
    /// Zero-g offset per axis, mg.
    pub zero_g_offset: [Option<Limit>; 3],
    /// Departure from the nominal sensitivity, %.
    pub sensitivity: Option<Limit>,
    /// Cross-axis sensitivity, %.
    pub cross_axis: Option<Limit>,
    /// Nonlinearity, % of full scale.
    pub nonlinearity: Option<Limit>,
    /// Temperature coefficient of the zero-g offset per axis, mg/K.
    pub offset_per_kelvin: [Option<Limit>; 3],
    /// Sensitivity with temperature, %/K.
    pub sensitivity_per_kelvin: Option<Limit>,
}

/// Ranges of ±2, 4, 8 and 16 g in 16 bits.
const BINARY: &[f64] = &[16384.0, 8192.0, 4096.0, 2048.0];

impl Datasheet {
    /// The known datasheets.
    ///
    /// Verified in copies of the documents or in drivers that quote them: all of the MPU-6050; of
    /// the LSM303AGR the sensitivities and the zero-g offset (±40 mg typical, ±80 maximum); of the
    /// ADXL345 the sensitivity (230 to 282 LSB/g; 232 to 286 in early revisions) and the zero-g
    /// offset; of the MPU-9150 and the ICM-20948 the zero-g offset. The other values are not
    /// verified: consult the document when one of them matters.
    pub const KNOWN: [Self; 6] = [
        Self {
            sensor: "LSM303AGR",
            document: "ST LSM303AGR, table 3",
            // 16 LSB a digit: 0.98, 1.95, 3.9 and 11.72 mg a digit.
            sensitivities_lsb_per_g: &[16326.5, 8205.1, 4102.6, 1365.2],
            // 40 typical.
            zero_g_offset: [guaranteed(80.0); 3],
            sensitivity: None,
            cross_axis: None,
            nonlinearity: None,
            offset_per_kelvin: [typical(0.5); 3],
            sensitivity_per_kelvin: typical(0.01),
        },
        Self {
            sensor: "ADXL345",
            document: "Analog Devices ADXL345, table 1",
            sensitivities_lsb_per_g: &[256.0, 128.0, 64.0, 32.0],
            zero_g_offset: [guaranteed(150.0), guaranteed(150.0), guaranteed(250.0)],
            // 230 to 282 LSB/g.
            sensitivity: guaranteed(10.2),
            cross_axis: typical(1.0),
            nonlinearity: typical(0.5),
            offset_per_kelvin: [typical(0.4), typical(0.4), typical(1.2)],
            sensitivity_per_kelvin: typical(0.01),
        },
        Self {
            sensor: "MPU-6050",
            document: "InvenSense PS-MPU-6000A-00 rev. 3.4, 6.2",
            sensitivities_lsb_per_g: BINARY,
            zero_g_offset: [typical(50.0), typical(50.0), typical(80.0)],
            sensitivity: typical(3.0),
            cross_axis: typical(2.0),
            nonlinearity: typical(0.5),
            // 35 and 60 mg from 0 to 70 °C, 45 K from 25 °C.
            offset_per_kelvin: [typical(0.78), typical(0.78), typical(1.33)],
            sensitivity_per_kelvin: typical(0.02),
        },
        Self {
            sensor: "MPU-9150",
            document: "InvenSense PS-MPU-9150A-00 rev. 4.3, 6.2",
            sensitivities_lsb_per_g: BINARY,
            zero_g_offset: [typical(80.0), typical(80.0), typical(150.0)],
            sensitivity: typical(3.0),
            cross_axis: typical(2.0),
            nonlinearity: typical(0.5),
            offset_per_kelvin: [typical(0.75), typical(0.75), typical(1.5)],
            sensitivity_per_kelvin: typical(0.02),
        },
        Self {
            sensor: "MPU-9250",
            document: "InvenSense PS-MPU-9250A-01 rev. 1.0, 3.2",
            sensitivities_lsb_per_g: BINARY,
            zero_g_offset: [typical(60.0), typical(60.0), typical(80.0)],
            sensitivity: typical(3.0),
            cross_axis: typical(2.0),
            nonlinearity: typical(0.5),
            offset_per_kelvin: [typical(1.5); 3],
            sensitivity_per_kelvin: typical(0.026),
        },
        Self {
            sensor: "ICM-20948",
            document: "InvenSense DS-000189 rev. 1.3, 3.2",
            sensitivities_lsb_per_g: BINARY,
            // On a board.
            zero_g_offset: [typical(50.0); 3],
            sensitivity: typical(0.5),
            cross_axis: typical(2.0),
            nonlinearity: typical(0.5),
            offset_per_kelvin: [typical(0.8); 3],
            sensitivity_per_kelvin: typical(0.026),
        },
    ];

    /// The datasheet of the sensor `name`; hyphens and case are ignored.
    pub fn of(name: &str) -> Option<&'static Self> {
        fn plain(name: &str) -> impl Iterator<Item = char> + '_ {
            name.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_uppercase())
        }
        Self::KNOWN.iter().find(|known| plain(known.sensor).eq(plain(name)))
    }

    /// The nominal sensitivity within 20 % of `lsb_per_g`.
    pub fn nominal(&self, lsb_per_g: f64) -> Option<f64> {
        let near = |nominal: &&f64| (0.8..1.2).contains(&(lsb_per_g / **nominal));
        self.sensitivities_lsb_per_g.iter().find(near).copied()
    }

    /// Compares each fitted parameter of `estimate` with its limit in the datasheet.
    ///
    /// `scale` is the sensitivity used to convert the poses to m/s², relative to the nominal one;
    /// without it the scale factors are not compared. `range_g` is the full-scale range; without it
    /// the nonlinearity is not compared. Parameters that the poses do not determine are left out.
    ///
    /// ```
    /// use wimu_calib::{Datasheet, Gravity, Placement, Pose, Verdict, six_position};
    ///
    /// let poses = [
    ///     [10.9, 0.2, -0.1], [-8.9, 0.1, 0.1], [0.1, 9.6, 0.0],
    ///     [0.3, -9.8, 0.2], [0.2, -0.1, 9.9], [0.1, 0.0, -9.9],
    /// ]
    /// .map(Pose::from_mean);
    /// let estimate = six_position(&poses, Gravity::UNKNOWN_PLACE, Placement::BY_HAND)?;
    /// let datasheet = Datasheet::of("mpu6050").ok_or("known")?;
    /// let x = datasheet.findings(&estimate, Some(1.0), None).next().ok_or("the offset of X")?;
    /// // 102 mg, where 50 are typical.
    /// assert!(x.verdict() == Verdict::Beyond && (x.value - 102.0).abs() < 1.0);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn findings(
        &self,
        estimate: &Estimate,
        scale: Option<f64>,
        range_g: Option<f64>,
    ) -> impl Iterator<Item = Finding> + use<> {
        let model = estimate.model.terms();
        let mg = 1e3 / STANDARD_GRAVITY_MPS2;
        let quantile = student::two_sided(0.05, estimate.interval_dof.unwrap_or(f64::INFINITY));
        let mut findings = heapless::Vec::<Finding, 18>::new();
        let mut add = |quantity, subject, value, half_width_95, limit: Option<Limit>| {
            let finding =
                limit.map(|limit| Finding { quantity, subject, value, half_width_95, limit });
            findings.extend(finding);
        };
        // A limit, if the poses determine the parameter.
        let seen = estimate.fitted.without(estimate.assumed);
        let fitted =
            |parameter: Parameter, limit: Option<Limit>| limit.filter(|_| seen.contains(parameter));
        for (axis, parameter) in Parameter::BIAS.into_iter().enumerate() {
            add(
                Quantity::ZeroGOffset,
                AXES[axis],
                model.bias_mps2[axis] * mg,
                estimate.half_width_95(parameter) * mg,
                fitted(parameter, self.zero_g_offset[axis]),
            );
        }
        for (axis, parameter) in Parameter::SCALE.into_iter().enumerate() {
            let limit = fitted(parameter, self.sensitivity).filter(|_| scale.is_some());
            let scale = scale.unwrap_or(1.0);
            add(
                Quantity::Sensitivity,
                AXES[axis],
                (model.matrix[axis][axis] * scale - 1.0) * 100.0,
                estimate.half_width_95(parameter) * scale * 100.0,
                limit,
            );
        }
        // Invariant under a rotation of the whole sensor: the sum of the two misalignments of a pair.
        for ((a, b), subject) in [(0, 1), (0, 2), (1, 2)].into_iter().zip(PAIRS) {
            let [ab, ba] = [Parameter::ALL[3 + 3 * b + a], Parameter::ALL[3 + 3 * a + b]];
            let covariance = &estimate.covariance;
            let variance =
                covariance.get(ab, ab) + covariance.get(ba, ba) + 2.0 * covariance.get(ab, ba);
            add(
                Quantity::CrossAxis,
                subject,
                (model.matrix[a][b] + model.matrix[b][a]) * 100.0,
                quantile * libm::sqrt(variance.max(0.0)) * 100.0,
                fitted(ab, self.cross_axis).map(|limit| Limit { most: 2.0 * limit.most, ..limit }),
            );
        }
        let (temperature, sd) = (&model.temperature, &estimate.term_sd);
        // A parabola departs from its best line by half of what it adds at full scale.
        let full_scale = range_g.map_or(0.0, |g| g * STANDARD_GRAVITY_MPS2);
        let terms = [
            (
                Term::BiasTemperature,
                Quantity::OffsetPerKelvin,
                self.offset_per_kelvin,
                (temperature.bias_mps2_per_k, sd.bias_mps2_per_k, mg),
            ),
            (
                Term::ScaleTemperature,
                Quantity::SensitivityPerKelvin,
                [self.sensitivity_per_kelvin; 3],
                (temperature.scale_per_k, sd.scale_per_k, 100.0),
            ),
            (
                Term::Quadratic,
                Quantity::Nonlinearity,
                [self.nonlinearity; 3],
                (model.nonlinearity, sd.nonlinearity, 0.5 * full_scale * 100.0),
            ),
        ];
        for (term, quantity, limits, (values, sd, unit)) in terms {
            for axis in 0..3 {
                add(
                    quantity,
                    AXES[axis],
                    values[axis] * unit,
                    quantile * sd[axis] * unit,
                    limits[axis].filter(|_| estimate.terms.contains(term) && unit > 0.0),
                );
            }
        }
        findings.into_iter()
    }
}

const AXES: [&str; 3] = ["X", "Y", "Z"];
const PAIRS: [&str; 3] = ["X-Y", "X-Z", "Y-Z"];

/// A quantity with a datasheet limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Output at zero force, mg: the bias.
    ZeroGOffset,
    /// Deviation of the sensitivity from the nominal one, %: S − 1.
    Sensitivity,
    /// Sum of the cross-axis sensitivities of two axes, %, with twice the limit of one. The
    /// difference is a rotation of the sensor on its board, which a datasheet does not specify.
    CrossAxis,
    /// Largest deviation from the best line, % of full scale, extrapolated from 1 g to full scale.
    Nonlinearity,
    /// Zero-g offset with temperature, mg/K.
    OffsetPerKelvin,
    /// Sensitivity with temperature, %/K.
    SensitivityPerKelvin,
}

impl Quantity {
    /// Its unit.
    pub fn unit(self) -> &'static str {
        match self {
            Self::ZeroGOffset => "mg",
            Self::Sensitivity | Self::CrossAxis => "%",
            Self::Nonlinearity => "% FS",
            Self::OffsetPerKelvin => "mg/K",
            Self::SensitivityPerKelvin => "%/K",
        }
    }
}

impl fmt::Display for Quantity {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::ZeroGOffset => "zero-g offset",
            Self::Sensitivity => "sensitivity off nominal",
            Self::CrossAxis => "cross-axis, both ways",
            Self::Nonlinearity => "nonlinearity",
            Self::OffsetPerKelvin => "zero-g offset with temperature",
            Self::SensitivityPerKelvin => "sensitivity with temperature",
        })
    }
}

/// A parameter compared with the limit of the datasheet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finding {
    /// What.
    pub quantity: Quantity,
    /// The axis or pair of axes: "X", "X-Y".
    pub subject: &'static str,
    /// As estimated, in the quantity's unit.
    pub value: f64,
    /// Half width of its 95 % confidence interval.
    pub half_width_95: f64,
    /// The limit.
    pub limit: Limit,
}

impl Finding {
    /// Whether the value is within the limit, according to its 95 % confidence interval.
    pub fn verdict(&self) -> Verdict {
        let size = self.value.abs();
        if size + self.half_width_95 <= self.limit.most {
            Verdict::Within
        } else if size - self.half_width_95 > self.limit.most {
            Verdict::Beyond
        } else {
            Verdict::Unclear
        }
    }
}

/// Whether a value is within its limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The whole 95 % confidence interval is within the limit.
    Within,
    /// The limit is inside the interval.
    Unclear,
    /// The whole interval is beyond the limit.
    Beyond,
}

impl fmt::Display for Verdict {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Within => "within",
            Self::Unclear => "unclear",
            Self::Beyond => "beyond",
        })
    }
}
