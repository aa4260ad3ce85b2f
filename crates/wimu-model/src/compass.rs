//! What a heading from the magnetic field needs: equation (58) of docs/reference/equations.

use crate::matrix::{self, Matrix3};
use crate::{MagneticFieldNt, ParameterSet};

/// Turn-on bias repeatability of an accelerometer, m/s², which tilts the measured vertical.
const TURN_ON_MPS2: f64 = 0.015;
/// Bias of an accelerometer without a quality record, m/s².
const UNKNOWN_BIAS_MPS2: f64 = 0.1;
const GRAVITY_MPS2: f64 = 9.81;

/// The magnetometer model with its rotation to the body, and their uncertainties, in single precision: its rounding is
/// 10⁻⁴ rad, below the errors of magnetometers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct CompassTerms {
    /// R_a R S⁻¹: from magnetometer to body axes.
    pub to_body: [[f32; 3]; 3],
    /// h, nT, magnetometer axes.
    pub hard_iron_nt: [f32; 3],
    /// Magnitude of the field at the calibration, nT.
    pub field_nt: f32,
    /// Its vertical component, up, nT.
    pub up_nt: f32,
    /// Covariance of the rotation error from magnetometer to accelerometer in body axes, rad²: xx, yy, zz, xy, xz, yz.
    pub mounting_rad2: [f32; 6],
    /// That of the rotation error from sensor to body.
    pub alignment_rad2: [f32; 6],
    /// Variance of a component of the corrected field from hard iron, soft iron and residual, nT².
    pub model_nt2: f32,
    /// Variance of the tilt of the measured vertical, rad².
    pub tilt_rad2: f32,
}

impl CompassTerms {
    /// `None` if the set has no magnetometer, or its rotation to the accelerometer is unknown.
    pub fn new(set: &ParameterSet) -> Option<Self> {
        let terms = set.magnetometer.as_ref()?.terms();
        let mounting = terms.to_accelerometer.as_ref()?;
        // The correction is affine: its columns follow from outputs of 1 mT each.
        let none = set.correct_field(MagneticFieldNt([0; 3]))?;
        let mut to_body = [[0.0; 3]; 3];
        for column in 0..3 {
            let mut output = [0; 3];
            output[column] = 1_000_000;
            let some = set.correct_field(MagneticFieldNt(output))?;
            for row in 0..3 {
                to_body[row][column] = ((some[row] - none[row]) * 1e-6) as f32;
            }
        }
        let mean_square = |sd: &[f32]| {
            sd.iter().map(|sd| f64::from(*sd) * f64::from(*sd)).sum::<f64>() / sd.len() as f64
        };
        let bias_mps2 = set.quality.map_or(UNKNOWN_BIAS_MPS2, |quality| {
            let covariance = &quality.terms().covariance;
            (0..3).map(|axis| covariance.sd(axis)).fold(0.0, f64::max)
        });
        let rotation = set.alignment.matrix();
        let transposed = matrix::transposed(&rotation);
        let turned = matrix::multiply(
            &matrix::multiply(&rotation, &mounting.covariance.matrix()),
            &transposed,
        );
        let alignment = set.alignment_covariance.map_or([[0.0; 3]; 3], |c| c.matrix());
        let field_nt = f64::from(terms.field_nt);
        let model_nt2 = mean_square(&terms.hard_iron_sd_nt)
            + mean_square(&terms.soft_iron_sd) * field_nt * field_nt
            + mean_square(&[terms.rms_nt]);
        let tilt_rad2 =
            (bias_mps2 * bias_mps2 + TURN_ON_MPS2 * TURN_ON_MPS2) / (GRAVITY_MPS2 * GRAVITY_MPS2);
        Some(Self {
            to_body,
            hard_iron_nt: terms.hard_iron_nt,
            field_nt: terms.field_nt,
            up_nt: (-field_nt * libm::sin(mounting.dip_rad.into())) as f32,
            mounting_rad2: symmetric(&turned),
            alignment_rad2: symmetric(&alignment),
            model_nt2: model_nt2 as f32,
            tilt_rad2: tilt_rad2 as f32,
        })
    }

    /// Calls `each` for every number, in order.
    pub(crate) fn fields(&mut self, mut each: impl FnMut(&mut f32)) {
        self.to_body.as_flattened_mut().iter_mut().for_each(&mut each);
        self.hard_iron_nt.iter_mut().for_each(&mut each);
        [&mut self.field_nt, &mut self.up_nt].into_iter().for_each(&mut each);
        self.mounting_rad2.iter_mut().for_each(&mut each);
        self.alignment_rad2.iter_mut().for_each(&mut each);
        [&mut self.model_nt2, &mut self.tilt_rad2].into_iter().for_each(&mut each);
    }
}

fn symmetric(m: &Matrix3) -> [f32; 6] {
    [m[0][0], m[1][1], m[2][2], m[0][1], m[0][2], m[1][2]].map(|element| element as f32)
}
