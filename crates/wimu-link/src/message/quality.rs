//! Quality of the calibration and the magnetometer's model on the wire.

use wimu_model::{
    Alignment, CalibratedTemperature, CalibrationMethod, CalibrationQuality, CovarianceError,
    MagnetometerModel, MagnetometerRotation, MagnetometerTerms, ModelCovariance, QualityTerms,
    RotationCovariance, TermDeviations,
};

use super::MessageError;
use super::exchange::{Wire, doubles, float, floats, number, number_32, option};
use super::fault::{ParameterFault, mirrored};

mirrored! {
    /// Wire form of [`CalibrationMethod`]. Append only.
    WireMethod of CalibrationMethod {
        MultiPosition,
        SixPosition,
        FourAngle,
        ThreeAngle,
        Reference,
        Updated,
    }
}

/// Wire form of [`CalibrationQuality`], not validated.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WireQuality {
    /// How the model was estimated.
    pub method: WireMethod,
    /// Time of the calibration, s since 1970 UTC.
    pub utc_s: Option<u64>,
    /// Temperature, °C: mean, lowest and highest at which the model holds.
    pub temperature_c: Option<[f32; 3]>,
    /// Poses fitted.
    pub poses: u32,
    /// Degrees of freedom.
    pub dof: u32,
    /// |f| − g over the poses, m/s² rms.
    pub rms_mps2: f32,
    /// Leave-one-out residual, m/s² rms.
    pub loo_rms_mps2: Option<f32>,
    /// Condition number of the fit.
    pub condition: Option<f32>,
    /// Cholesky factor (lower triangular, 12 rows, 78 numbers) of the covariance of b₀ and A, row by row. Rows
    /// 1 to 3: b₀, m/s². Rows 4 to 12: A row by row, dimensionless.
    pub covariance_factor: [[f32; 13]; 6],
    /// Standard deviations: b₁, m/s² per K; b₂, m/s² per K²; s₁, 1/K; q, s²/m.
    pub other_sd: [[f32; 3]; 4],
}

/// Wire form of [`MagnetometerModel`], not validated.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WireMagnetometer {
    /// h, nT.
    pub hard_iron_nt: [f32; 3],
    /// Its standard deviation, nT.
    pub hard_iron_sd_nt: [f32; 3],
    /// S: xx, yy, zz, xy, xz, yz.
    pub soft_iron: [f32; 6],
    /// Its standard deviation.
    pub soft_iron_sd: [f32; 6],
    /// |B| where it was calibrated, nT.
    pub field_nt: f32,
    /// Orientations fitted.
    pub poses: u32,
    /// |B| less the field, nT rms.
    pub rms_nt: f32,
    /// Leave-one-out residual, nT rms.
    pub loo_rms_nt: f32,
    /// Condition number of the fit.
    pub condition: f32,
    /// Rotation to the accelerometer's axes, if known.
    pub to_accelerometer: Option<WireMagnetometerRotation>,
}

/// Wire form of [`MagnetometerRotation`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WireMagnetometerRotation {
    /// Magnetometer axes to accelerometer axes, quaternion W, X, Y, Z.
    pub rotation_wxyz: [f64; 4],
    /// Cholesky factor (lower triangular) of the covariance of the rotation's error, rad, row by row.
    pub factor: [f32; 6],
    /// Magnetic dip (inclination), rad.
    pub dip_rad: f32,
    /// Residual of the dip over the poses, rad rms.
    pub dip_rms_rad: f32,
}

impl WireMethod {
    /// In the order of their numbers.
    const ALL: [Self; 6] = [
        Self::MultiPosition,
        Self::SixPosition,
        Self::FourAngle,
        Self::ThreeAngle,
        Self::Reference,
        Self::Updated,
    ];

    fn exchange(wire: &mut dyn Wire, method: &mut Self) -> Result<(), MessageError> {
        let mut place = *method as u32;
        number_32(wire, &mut place)?;
        let known = Self::ALL.get(place as usize);
        *method = *known.ok_or(MessageError::Malformed)?;
        Ok(())
    }
}

impl WireQuality {
    pub(super) const BLANK: Self = Self {
        method: WireMethod::MultiPosition,
        utc_s: None,
        temperature_c: None,
        poses: 0,
        dof: 0,
        rms_mps2: 0.0,
        loo_rms_mps2: None,
        condition: None,
        covariance_factor: [[0.0; 13]; 6],
        other_sd: [[0.0; 3]; 4],
    };

    pub(super) fn exchange(wire: &mut dyn Wire, quality: &mut Self) -> Result<(), MessageError> {
        WireMethod::exchange(wire, &mut quality.method)?;
        option(wire, &mut quality.utc_s, 0, number)?;
        option(wire, &mut quality.temperature_c, [0.0; 3], |wire, t| floats(wire, t))?;
        number_32(wire, &mut quality.poses)?;
        number_32(wire, &mut quality.dof)?;
        float(wire, &mut quality.rms_mps2)?;
        option(wire, &mut quality.loo_rms_mps2, 0.0, float)?;
        option(wire, &mut quality.condition, 0.0, float)?;
        floats(wire, quality.covariance_factor.as_flattened_mut())?;
        floats(wire, quality.other_sd.as_flattened_mut())
    }
}

impl WireMagnetometer {
    pub(super) const BLANK: Self = Self {
        hard_iron_nt: [0.0; 3],
        hard_iron_sd_nt: [0.0; 3],
        soft_iron: [0.0; 6],
        soft_iron_sd: [0.0; 6],
        field_nt: 0.0,
        poses: 0,
        rms_nt: 0.0,
        loo_rms_nt: 0.0,
        condition: 0.0,
        to_accelerometer: None,
    };

    pub(super) fn exchange(wire: &mut dyn Wire, model: &mut Self) -> Result<(), MessageError> {
        for values in [
            &mut model.hard_iron_nt[..],
            &mut model.hard_iron_sd_nt,
            &mut model.soft_iron,
            &mut model.soft_iron_sd,
            core::slice::from_mut(&mut model.field_nt),
        ] {
            floats(wire, values)?;
        }
        number_32(wire, &mut model.poses)?;
        for value in [&mut model.rms_nt, &mut model.loo_rms_nt, &mut model.condition] {
            float(wire, value)?;
        }
        let blank = WireMagnetometerRotation {
            rotation_wxyz: [0.0; 4],
            factor: [0.0; 6],
            dip_rad: 0.0,
            dip_rms_rad: 0.0,
        };
        option(wire, &mut model.to_accelerometer, blank, |wire, rotation| {
            doubles(wire, &mut rotation.rotation_wxyz)?;
            floats(wire, &mut rotation.factor)?;
            float(wire, &mut rotation.dip_rad)?;
            float(wire, &mut rotation.dip_rms_rad)
        })
    }
}

pub(super) fn rotation_factor(covariance: RotationCovariance) -> [f32; 6] {
    let [factor] = covariance.factor();
    factor
}

pub(super) fn rotation_covariance(factor: [f32; 6]) -> Result<RotationCovariance, CovarianceError> {
    RotationCovariance::from_factor([factor])
}

// Both directions name every field, so a field added to the model cannot be forgotten here.

impl From<&CalibrationQuality> for WireQuality {
    fn from(quality: &CalibrationQuality) -> Self {
        let terms = quality.terms();
        let sd = &terms.other_sd;
        Self {
            method: terms.method.into(),
            utc_s: terms.utc_s,
            temperature_c: (terms.temperature).map(|t| [t.mean_c, t.lowest_c, t.highest_c]),
            poses: terms.poses,
            dof: terms.dof,
            rms_mps2: terms.rms_mps2,
            loo_rms_mps2: terms.loo_rms_mps2,
            condition: terms.condition,
            covariance_factor: terms.covariance.factor(),
            other_sd: [sd.bias_mps2_per_k, sd.bias_mps2_per_k2, sd.scale_per_k, sd.nonlinearity],
        }
    }
}

impl TryFrom<&WireQuality> for CalibrationQuality {
    type Error = ParameterFault;

    fn try_from(wire: &WireQuality) -> Result<Self, ParameterFault> {
        let temperature = |[mean_c, lowest_c, highest_c]: [f32; 3]| CalibratedTemperature {
            mean_c,
            lowest_c,
            highest_c,
        };
        let [bias_mps2_per_k, bias_mps2_per_k2, scale_per_k, nonlinearity] = wire.other_sd;
        Ok(Self::new(QualityTerms {
            method: wire.method.into(),
            utc_s: wire.utc_s,
            temperature: wire.temperature_c.map(temperature),
            poses: wire.poses,
            dof: wire.dof,
            rms_mps2: wire.rms_mps2,
            loo_rms_mps2: wire.loo_rms_mps2,
            condition: wire.condition,
            covariance: ModelCovariance::from_factor(wire.covariance_factor)?,
            other_sd: TermDeviations {
                bias_mps2_per_k,
                bias_mps2_per_k2,
                scale_per_k,
                nonlinearity,
            },
        })?)
    }
}

impl From<&MagnetometerModel> for WireMagnetometer {
    fn from(model: &MagnetometerModel) -> Self {
        let terms = model.terms();
        let rotation = |rotation: MagnetometerRotation| WireMagnetometerRotation {
            rotation_wxyz: rotation.rotation.quaternion(),
            factor: rotation_factor(rotation.covariance),
            dip_rad: rotation.dip_rad,
            dip_rms_rad: rotation.dip_rms_rad,
        };
        Self {
            hard_iron_nt: terms.hard_iron_nt,
            hard_iron_sd_nt: terms.hard_iron_sd_nt,
            soft_iron: terms.soft_iron,
            soft_iron_sd: terms.soft_iron_sd,
            field_nt: terms.field_nt,
            poses: terms.poses,
            rms_nt: terms.rms_nt,
            loo_rms_nt: terms.loo_rms_nt,
            condition: terms.condition,
            to_accelerometer: terms.to_accelerometer.map(rotation),
        }
    }
}

impl TryFrom<&WireMagnetometer> for MagnetometerModel {
    type Error = ParameterFault;

    fn try_from(wire: &WireMagnetometer) -> Result<Self, ParameterFault> {
        let rotation = |rotation: &WireMagnetometerRotation| {
            Ok::<_, ParameterFault>(MagnetometerRotation {
                rotation: Alignment::try_from(rotation.rotation_wxyz)?,
                covariance: rotation_covariance(rotation.factor)?,
                dip_rad: rotation.dip_rad,
                dip_rms_rad: rotation.dip_rms_rad,
            })
        };
        Ok(Self::new(MagnetometerTerms {
            hard_iron_nt: wire.hard_iron_nt,
            hard_iron_sd_nt: wire.hard_iron_sd_nt,
            soft_iron: wire.soft_iron,
            soft_iron_sd: wire.soft_iron_sd,
            field_nt: wire.field_nt,
            poses: wire.poses,
            rms_nt: wire.rms_nt,
            loo_rms_nt: wire.loo_rms_nt,
            condition: wire.condition,
            to_accelerometer: wire.to_accelerometer.as_ref().map(rotation).transpose()?,
        })?)
    }
}
