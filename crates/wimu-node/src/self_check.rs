//! Does the calibration still hold? Each rest tells.

use wimu_calib::{Ageing, Gravity, Pose, SelfCheck};
use wimu_link::message::Event;
use wimu_model::{
    Alignment, CentiCelsius, ErrorModel, ErrorTerms, ParameterId, ParameterSet, SpecificForceMps2,
};

/// A good calibration fails one rest in a thousand: so many in a row are told.
const CONTRADICTIONS: u8 = 2;
/// 2⁻³² m/s².
const MPS2_PER_LSB: f64 = 1.0 / (1_u64 << 32) as f64;
/// Standard deviation of local gravity as a user knows it who has set it, m/s².
const GRAVITY_SD_MPS2: f64 = 0.001;
/// Gravity of who has not set it, µm/s².
const STANDARD_UM_S2: u32 = 9_806_650;

/// The check of the parameters in use.
#[derive(Default)]
pub(crate) struct Keeper {
    check: Option<(ParameterId, u32, SelfCheck<f32>)>,
    contradictions: u8,
}

/// What a rest told.
pub(crate) enum Verdict {
    /// Nothing: the parameters do not say how good they are, or it was no rest.
    Unknown,
    Holds,
    /// It is to be told.
    Contradicted(Event),
}

impl Keeper {
    /// Takes a rest with this mean specific force, 2⁻³² m/s², body axes, corrected with `set` at the
    /// latched temperature.
    pub(crate) fn rest(
        &mut self,
        set: Option<&(ParameterId, ParameterSet)>,
        gravity_um_s2: u32,
        latched: Option<CentiCelsius>,
        mean: [i64; 3],
    ) -> Verdict {
        let Some(&(id, ref set)) = set else {
            self.check = None;
            return Verdict::Unknown;
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
            return Verdict::Unknown;
        };
        let Some(mean_mps2) = output(set, latched, mean) else {
            return Verdict::Unknown;
        };
        let pose = Pose {
            temperature_c: latched.map(CentiCelsius::to_celsius),
            ..Pose::from_mean(mean_mps2)
        };
        let Some(told) = check.push(&pose) else {
            return Verdict::Unknown;
        };
        // A covariance that is none tells nothing.
        if !told.expected_sd_mps2.is_finite() {
            return Verdict::Unknown;
        }
        if told.holds {
            self.contradictions = 0;
            return Verdict::Holds;
        }
        self.contradictions = self.contradictions.saturating_add(1);
        if self.contradictions != CONTRADICTIONS {
            return Verdict::Unknown;
        }
        Verdict::Contradicted(Event::CalibrationContradicted {
            residual_um_s2: (told.residual_mps2 * 1e6) as i32,
            expected_um_s2: (told.expected_sd_mps2 * 1e6) as u32,
        })
    }
}

fn gravity(um_s2: u32) -> Option<Gravity> {
    if um_s2 == STANDARD_UM_S2 {
        return Some(Gravity::UNKNOWN_PLACE);
    }
    Gravity::new(f64::from(um_s2) * 1e-6, GRAVITY_SD_MPS2).ok()
}

/// What the sensor put out, sensor axes, for it to be corrected to `mean`. The device leaves out the
/// nonlinearity, and so does this.
fn output(set: &ParameterSet, latched: Option<CentiCelsius>, mean: [i64; 3]) -> Option<[f64; 3]> {
    let [w, x, y, z] = set.alignment.quaternion();
    let to_sensor = Alignment::from_quaternion([w, -x, -y, -z]).ok()?;
    let force = to_sensor.rotate(mean.map(|lsb| lsb as f64 * MPS2_PER_LSB));
    let model = ErrorModel::new(ErrorTerms {
        nonlinearity: [0.0; 3],
        ..*set.model.terms()
    });
    let output = model.ok()?.distort(SpecificForceMps2(force), latched);
    Some(output.0)
}
