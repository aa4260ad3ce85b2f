//! The result of a calibration: as text, as JSON, and as parameters for a board.

use serde::{Deserialize, Serialize};
use wimu_calib::{Estimate, Orientation, Parameter};
use wimu_link::hello::sensor;
use wimu_model::{CalibrationMethod, ErrorTerms, ParameterSet, SensorId};

use super::{CalibrationFile, DatasheetReport, GyroscopeReport};
use crate::plural::counted;
use crate::problem::Outcome;
use crate::recording::RateSource;

/// Where a number comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Source {
    /// Given by the user.
    Given,
    /// The default.
    #[default]
    Default,
    /// Reported by the board.
    Board,
    /// The fit, so that the mean scale factor is 1.
    Fit,
    /// Computed from a latitude and a height.
    Latitude,
    /// Assumed: the range that a 16-bit sensor has at this sensitivity.
    SixteenBits,
}

/// A recommended pose.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NextPose {
    /// Direction that points up, a unit vector in sensor axes.
    pub up: [f64; 3],
    /// The same as text.
    pub text: String,
    /// Instruction to a person.
    pub instruction: String,
}

impl From<Orientation> for NextPose {
    fn from(orientation: Orientation) -> Self {
        Self {
            up: orientation.up(),
            text: orientation.to_string(),
            instruction: orientation.instruction().to_string(),
        }
    }
}

/// The numbers of an estimate.
#[derive(Clone, Debug, Serialize)]
pub struct Fit {
    /// The parameters of A and b that were fitted, by name.
    pub fitted: Vec<String>,
    /// Parameters that were not observed, by name: the model has the ideal value, `sd` the standard deviation typical of
    /// datasheets.
    pub not_observed: Vec<String>,
    /// Degrees of freedom.
    pub dof: usize,
    /// |f| − g over all poses, mm/s² rms.
    pub rms_mm_s2: f64,
    /// |f| − g over the fitted poses, mm/s² rms.
    pub fitted_rms_mm_s2: f64,
    /// The largest over all poses, mm/s².
    pub max_mm_s2: f64,
    /// |f| − g of each pose under the model fitted without it, mm/s² rms; `None` where no pose can be left out.
    pub loo_rms_mm_s2: Option<f64>,
    /// The same with all visits of the pose's orientation left out, which decides; `None` where no orientation was
    /// visited again.
    pub loo_orientation_rms_mm_s2: Option<f64>,
    /// Orientations among the poses: those within 10° of each other are visits of one.
    pub orientations: usize,
    /// Condition number of the fit; 1 is best.
    pub condition: f64,
    /// Expected standard deviation of |f| − g in the worst orientation, mm/s².
    pub worst_sd_mm_s2: f64,
    /// Fraction of the 26 orientations (sides, edges, corners) within 40° of a pose's, 0 to 1.
    pub coverage: f64,
    /// Mean temperature of the poses, °C.
    pub temperature_c: Option<f64>,
    /// Lowest and highest temperature of the poses, °C: temperature terms are valid between them.
    pub temperature_range_c: Option<[f64; 2]>,
    /// Bias drift over the session, where it was fitted: the model's bias is that at the end.
    pub drift: Option<DriftReport>,
    /// Placement error that the standard deviations include, 1 σ, where orientations were known.
    pub placement_sd_deg: Option<f64>,
    /// Repeatability of positions beyond noise and placement, mm/s², 1 σ; included in the standard deviations.
    pub revisit_sd_mm_s2: Option<f64>,
    /// The error model.
    pub model: ErrorTerms,
    /// Standard deviations, 1 σ, in the model's shape; 0 for terms that are fixed or not fitted.
    pub sd: ErrorTerms,
    /// Half width of the 95 % interval (Student's t) of the bias, then of A row by row; `None` for what was not observed.
    pub half_width_95: [Option<f64>; Parameter::COUNT],
    /// Bias and scale error in other units.
    pub units: OtherUnits,
    /// Covariance of the bias, then A row by row.
    pub covariance: [[f64; Parameter::COUNT]; Parameter::COUNT],
}

/// Bias drift over a session, linear in time.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct DriftReport {
    /// From the first pose to the last, m/s².
    pub change_m_s2: [f64; 3],
    /// Its standard deviation, m/s².
    pub sd_m_s2: [f64; 3],
    /// From the first pose to the last, s (poses, where they have no times).
    pub span_s: f64,
}

/// A model's numbers in the units of datasheets.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct OtherUnits {
    /// Bias, mg.
    pub bias_mg: [f64; 3],
    /// Bias, % of full scale, where the range is known.
    pub bias_percent_of_full_scale: Option<[f64; 3]>,
    /// S − 1, ppm.
    pub scale_error_ppm: [f64; 3],
}

/// One static pose.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct StaticPose {
    /// Mean output at the nominal sensitivity, m/s².
    pub mean_m_s2: [f64; 3],
    /// Standard deviation of a sample, m/s²; 0 where it is unknown.
    pub sd_m_s2: [f64; 3],
    /// Number of samples in the mean.
    pub samples: u32,
    /// Its first row or sample, from 0.
    pub first_sample: u64,
    /// Its middle, s.
    pub time_s: f64,
    /// Mean temperature, °C.
    pub temperature_c: Option<f64>,
    /// |f| − g after correction, mm/s².
    pub residual_mm_s2: Option<f64>,
}

/// The result of a calibration: the JSON of `wimu calibrate --json`, with the numbers of the fit.
#[derive(Clone, Debug, Serialize)]
pub struct CalibrationReport {
    /// Status and findings.
    #[serde(skip)]
    pub outcome: Outcome,
    /// The data.
    pub source: String,
    /// `multi-position`, `six-position`, `four-angle` or `three-angle`.
    pub method: &'static str,
    /// Terms that were fitted.
    pub terms: Vec<&'static str>,
    /// Number of static poses found or given.
    pub poses: usize,
    /// Sample rate at which poses were searched, Hz; `None` for pose means.
    pub rate_hz: Option<f64>,
    /// Source of the rate.
    pub rate_source: Option<RateSource>,
    /// Gravity, m/s².
    pub gravity_m_s2: f64,
    /// Its standard deviation, m/s².
    pub gravity_sd_m_s2: f64,
    /// Source of gravity.
    pub gravity_source: Source,
    /// Unit of the data: `LSB`, or `m/s²` for g too.
    pub unit: &'static str,
    /// Nominal sensitivity, LSB/g; `None` for data in m/s² without a given one.
    pub sensitivity_lsb_per_g: Option<f64>,
    /// Source of the sensitivity.
    pub sensitivity_source: Option<Source>,
    /// Full-scale range, ± *g*; `None` where it is unknown.
    pub range_g: Option<u8>,
    /// Source of the range.
    pub range_source: Option<Source>,
    /// |y| − g over all poses before correction, mm/s² rms.
    pub uncalibrated_rms_mm_s2: Option<f64>,
    /// The estimate, if there is one.
    #[serde(flatten)]
    pub fit: Option<Fit>,
    /// Poses left out of the fit, by index from 0.
    pub rejected_poses: Vec<usize>,
    /// Number of poses left out; of very many, not all are listed.
    pub rejected: usize,
    /// Recommended poses, the most useful first: against a refusal, or to improve the answer.
    pub next_poses: Vec<NextPose>,
    /// How many more poses are worthwhile: each lowers the expected error by 3 % or more.
    pub poses_worth_adding: usize,
    /// The poses that were found or given; empty above 1000.
    pub static_poses: Vec<StaticPose>,
    /// The gyroscope, if it was calibrated.
    pub gyroscope: Option<GyroscopeReport>,
    /// Comparison with the sensor's datasheet, where the sensor is known.
    pub datasheet: Option<DatasheetReport>,
    /// The set for a board; `None` when the data's sensitivity is unknown.
    pub parameters: Option<ParameterSet>,
    /// Id of that set.
    pub parameter_id: Option<String>,
    /// The calibration file.
    #[serde(skip)]
    pub file: Option<CalibrationFile>,
    /// What was estimated, if there is an answer.
    #[serde(skip)]
    pub estimate: Option<Estimate>,
}

/// The parameters, by name, that were not observed when a set was made: they have the ideal value and the standard
/// deviation typical of datasheets.
pub fn not_observed(set: &ParameterSet) -> Vec<String> {
    let Some(quality) = &set.quality else {
        return Vec::new();
    };
    let q = quality.terms();
    let by_choice = |parameter: Parameter| {
        use Parameter::{MisalignmentYx, MisalignmentZx, MisalignmentZy};
        q.method == CalibrationMethod::MultiPosition
            && [MisalignmentYx, MisalignmentZx, MisalignmentZy].contains(&parameter)
    };
    let perfect = ErrorTerms::default();
    let unseen = |parameter: &Parameter| {
        let place = parameter.index();
        let terms = set.model.terms();
        let (value, ideal, usual) = match place {
            0..3 => (terms.bias_mps2[place], 0.0, 0.5),
            _ => {
                let (row, column) = ((place - 3) / 3, (place - 3) % 3);
                let usual = if row == column { 0.03 } else { 0.02 };
                (terms.matrix[row][column], perfect.matrix[row][column], usual)
            }
        };
        value == ideal && q.covariance.sd(place) > 0.999 * usual && !by_choice(*parameter)
    };
    Parameter::ALL.into_iter().filter(unseen).map(|parameter| parameter.to_string()).collect()
}

/// A parameter set beside its error model, as lines of text.
pub fn describe(set: &ParameterSet) -> Vec<String> {
    let mut lines = Vec::new();
    if let Some(SensorId(number)) = set.sensor {
        lines.push(format!("sensor: {}", sensor::name(number)));
    }
    match &set.quality {
        None => lines.push("no information on how the model was estimated".to_owned()),
        Some(quality) => {
            let q = quality.terms();
            let sd = |place: usize| q.covariance.sd(place);
            let unseen = not_observed(set);
            if !unseen.is_empty() {
                lines.push(format!("not observed, taken as ideal: {}", unseen.join(", ")));
            }
            lines.push(format!(
                "± (1 σ) bias {:.5} {:.5} {:.5} m/s², scale factor {:.6} {:.6} {:.6}",
                sd(0),
                sd(1),
                sd(2),
                sd(3),
                sd(7),
                sd(11)
            ));
            let mut line = format!(
                "made by {}, {}, {} of freedom, {:.2} mm/s² rms",
                q.method,
                counted(q.poses as usize, "pose"),
                counted(q.dof as usize, "degree"),
                q.rms_mps2 * 1e3
            );
            if let Some(loo) = q.loo_rms_mps2 {
                line += &format!(", leave-one-out {:.2}", loo * 1e3);
            }
            if let Some(condition) = q.condition {
                line += &format!(", condition {condition:.1}");
            }
            lines.push(line);
            if let Some(t) = q.temperature {
                lines.push(format!(
                    "at {:.1} °C, valid from {:.1} to {:.1} °C",
                    t.mean_c, t.lowest_c, t.highest_c
                ));
            }
            if let Some(utc_s) = q.utc_s {
                lines.push(format!("made on {}", date(utc_s)));
            }
        }
    }
    let [w, x, y, z] = set.alignment.quaternion();
    let known = match set.alignment_covariance {
        Some(c) => {
            let [x, y, z] = [0, 1, 2].map(|axis| c.sd(axis).to_degrees());
            format!(" ± {x:.2} {y:.2} {z:.2}° about the body axes")
        }
        None => " (not measured)".to_owned(),
    };
    lines.push(format!(
        "alignment quaternion (w x y z), sensor to body: {w:+.5} {x:+.5} {y:+.5} {z:+.5}{known}"
    ));
    if let Some(gyroscope) = &set.gyroscope {
        let [x, y, z] = gyroscope.model.terms().bias_rad_s;
        let sd = gyroscope
            .sd
            .map_or(String::new(), |sd| format!(" ± {:.5} {:.5} {:.5} (1 σ)", sd[0], sd[1], sd[2]));
        lines.push(format!(
            "gyroscope, ±{} °/s: bias {x:+.5} {y:+.5} {z:+.5}{sd} rad/s",
            gyroscope.range_dps
        ));
    }
    match &set.magnetometer {
        None => lines.push("magnetometer not calibrated: no heading".to_owned()),
        Some(model) => {
            let m = model.terms();
            let [x, y, z] = m.hard_iron_nt.map(|h| h / 1e3);
            lines.push(format!(
                "magnetometer: hard iron {x:+.2} {y:+.2} {z:+.2} µT, field {:.2} µT, {:.2} µT rms{}",
                m.field_nt / 1e3,
                m.rms_nt / 1e3,
                if m.to_accelerometer.is_some() {
                    ""
                } else {
                        "; its rotation is unknown: no heading"
                }
            ));
        }
    }
    lines
}

/// Date and time of day of a UTC time in s since 1970.
fn date(utc_s: u64) -> String {
    // Years from March on, in eras of 400 years (Hinnant, "chrono-compatible low-level date algorithms").
    let days = utc_s / 86_400 + 719_468;
    let day_of_era = days % 146_097;
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * from_march + 2) / 5 + 1;
    let (month, next) = if from_march < 10 { (from_march + 3, 0) } else { (from_march - 9, 1) };
    let year = 400 * (days / 146_097) + year_of_era + next;
    let (hour, minute) = (utc_s / 3600 % 24, utc_s / 60 % 60);
    format!("{year:04}-{month:02}-{day:02} {hour:02}:{minute:02} UTC")
}
