//! Check of the calibration at every rest: |f| must be g.

use wimu_calib::{Ageing, Gravity, Pose, SelfCheck};
use wimu_link::message::Event;
use wimu_model::{
    Alignment, CentiCelsius, ErrorModel, ErrorTerms, ParameterId, ParameterSet, SpecificForceMps2,
};

/// Number of consecutive contradicting rests after which the fault is reported. False-alarm probability per
/// rest: 10⁻³ (3.29 σ, [`SelfCheck`]).
const CONTRADICTIONS: u8 = 2;
/// Unit of a mean specific force, m/s².
const MPS2_PER_LSB: f64 = 1.0 / (1_u64 << 32) as f64;
/// Standard deviation of the local gravity that a user has set, m/s². Assumed: gravity anomalies, which
/// formulas of latitude and height omit, rarely exceed 1 mm/s² (100 mGal).
const GRAVITY_SD_MPS2: f64 = 0.001;
/// Default gravity, µm/s²: the user has not set it.
const STANDARD_UM_S2: u32 = 9_806_650;

/// The check of the parameters in use.
#[derive(Default)]
pub(crate) struct CalibrationCheck {
    /// The id of the parameters and the gravity, µm/s², that the check was made for.
    check: Option<(ParameterId, u32, SelfCheck<f32>)>,
    contradictions: u8,
}

/// The result of a rest.
pub(crate) enum Finding {
    /// No result: the parameters have no covariance, or the interval was no rest.
    Unknown,
    Holds,
    /// To be reported.
    Contradicted(Event),
}

impl CalibrationCheck {
    /// Checks a rest with this mean specific force, 2⁻³² m/s², body axes, corrected with `set` at the
    /// latched temperature.
    pub(crate) fn rest(
        &mut self,
        set: Option<&(ParameterId, ParameterSet)>,
        gravity_um_s2: u32,
        latched: Option<CentiCelsius>,
        mean: [i64; 3],
    ) -> Finding {
        let Some(&(id, ref set)) = set else {
            self.check = None;
            return Finding::Unknown;
        };
        let current =
            matches!(&self.check, Some((known, g, _)) if (*known, *g) == (id, gravity_um_s2));
        if !current {
            self.contradictions = 0;
            self.check = gravity(gravity_um_s2)
                .and_then(|gravity| SelfCheck::of(set, gravity, Ageing::default()))
                .map(|check| (id, gravity_um_s2, check));
        }
        let Some((_, _, check)) = &mut self.check else {
            return Finding::Unknown;
        };
        let Some(mean_mps2) = output(set, latched, mean) else {
            return Finding::Unknown;
        };
        let pose = Pose {
            temperature_c: latched.map(CentiCelsius::to_celsius),
            ..Pose::from_mean(mean_mps2)
        };
        let Some(result) = check.push(&pose) else {
            return Finding::Unknown;
        };
        // An invalid covariance allows no test.
        if !result.expected_sd_mps2.is_finite() {
            return Finding::Unknown;
        }
        if result.holds {
            self.contradictions = 0;
            return Finding::Holds;
        }
        self.contradictions = self.contradictions.saturating_add(1);
        if self.contradictions != CONTRADICTIONS {
            return Finding::Unknown;
        }
        Finding::Contradicted(Event::CalibrationContradicted {
            residual_um_s2: (result.residual_mps2 * 1e6) as i32,
            expected_um_s2: (result.expected_sd_mps2 * 1e6) as u32,
        })
    }
}

fn gravity(um_s2: u32) -> Option<Gravity> {
    if um_s2 == STANDARD_UM_S2 {
        return Some(Gravity::UNKNOWN_PLACE);
    }
    Gravity::new(f64::from(um_s2) * 1e-6, GRAVITY_SD_MPS2).ok()
}

/// The output of the sensor, m/s², sensor axes, that is corrected to `mean`. Without the nonlinearity, which
/// the device does not correct.
fn output(set: &ParameterSet, latched: Option<CentiCelsius>, mean: [i64; 3]) -> Option<[f64; 3]> {
    let [w, x, y, z] = set.alignment.quaternion();
    let to_sensor = Alignment::from_quaternion([w, -x, -y, -z]).ok()?;
    let force = to_sensor.rotate(mean.map(|lsb| lsb as f64 * MPS2_PER_LSB));
    let model = ErrorModel::new(ErrorTerms { nonlinearity: [0.0; 3], ..*set.model.terms() });
    let output = model.ok()?.distort(SpecificForceMps2(force), latched);
    Some(output.0)
}
