//! A parameter set in words, and what changes when one replaces another.

use serde::Serialize;
use wimu_calib::Parameter;
use wimu_link::hello::sensor;
use wimu_model::{
    CalibratedTemperature, CalibrationMethod, ErrorTerms, ParameterSet, QualityTerms, SensorId,
};

use super::parameter_id;
use super::report::MISALIGNMENTS;
use crate::plural::counted;

/// A term that changes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Change {
    /// Its name with its unit.
    pub name: &'static str,
    /// Its values.
    pub before: String,
    /// The new ones.
    pub after: String,
}

/// The difference of two calibrations of a device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Difference {
    /// Which calibration replaces which.
    pub result: String,
    /// The terms that change.
    pub changed: Vec<Change>,
    /// What else differs.
    pub notes: Vec<String>,
}

impl Difference {
    /// Of what the device holds (`None`: uncalibrated) and what would be written.
    pub fn of(before: Option<&ParameterSet>, after: &ParameterSet) -> Self {
        let mut found = Self {
            result: "the device was uncalibrated before".to_owned(),
            changed: Vec::new(),
            notes: Vec::new(),
        };
        let Some(before) = before else {
            return found;
        };
        let [old, new] = [before, after].map(parameter_id);
        if old == new {
            found.result = format!("the device already holds {new}");
            return found;
        }
        found.result = format!("{old} → {new}");
        let mut below_precision = Vec::new();
        for ((name, old), (_, new)) in
            parameter_figures(before).into_iter().zip(parameter_figures(after))
        {
            let [before, after] = [&old, &new].map(|values| values_text(values));
            if before != after {
                found.changed.push(Change { name, before, after });
            } else if old != new {
                below_precision.push(name);
            }
        }
        if !below_precision.is_empty() {
            let names = below_precision.join("; ");
            found.notes.push(format!("differences below the printed precision: {names}"));
        }
        let others = [
            ("alignment", before.alignment != after.alignment),
            ("magnetometer calibration", before.magnetometer != after.magnetometer),
            ("fit statistics", before.quality != after.quality),
            ("sensor", before.sensor != after.sensor),
            ("gyroscope calibration", before.gyroscope != after.gyroscope),
        ];
        let others = others.into_iter().filter(|(_, differs)| *differs);
        let others = others.map(|(name, _)| match name {
            "fit statistics" => format!("{name} differ"),
            _ => format!("{name} differs"),
        });
        found.notes.extend(others);
        found
    }
}

/// The numbers of a parameter set, with their names and units.
pub fn parameter_figures(set: &ParameterSet) -> Vec<(&'static str, Vec<f64>)> {
    let terms = set.model.terms();
    let (a, thermal) = (terms.matrix, terms.temperature);
    let scale = [0, 1, 2].map(|axis| a[axis][axis]);
    let misalignment = MISALIGNMENTS.map(|(_, row, column)| a[row][column] * 1e3);
    vec![
        ("bias, m/s²", terms.bias_mps2.to_vec()),
        ("scale factor", scale.to_vec()),
        ("misalignment yx zx xy zy xz yz, mrad", misalignment.to_vec()),
        ("bias slope, m/s²/K", thermal.bias_mps2_per_k.to_vec()),
        ("bias curvature, m/s²/K²", thermal.bias_mps2_per_k2.to_vec()),
        ("scale slope, 1/K", thermal.scale_per_k.to_vec()),
        ("nonlinearity, s²/m", terms.nonlinearity.to_vec()),
        ("sensitivity, LSB/g", vec![set.sensitivity.lsb_per_g()]),
        ("range, ± g", vec![set.range_g.into()]),
        ("reference, °C", vec![thermal.reference_c]),
    ]
}

/// Values as text.
pub fn values_text(values: &[f64]) -> String {
    match values {
        [value] => value.to_string(),
        all => {
            // Adding zero makes −0 positive.
            let rounded = all.iter().map(|value| (value * 1e5).round() / 1e5 + 0.0);
            let all = rounded.map(|value| format!("{value:+.5}"));
            Vec::from_iter(all).join(" ")
        }
    }
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
            let unseen = not_observed(set);
            if !unseen.is_empty() {
                lines.push(format!("not observed, taken as ideal: {}", unseen.join(", ")));
            }
            lines.extend(quality_lines(quality.terms()));
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
        let range = gyroscope.range_dps;
        lines.push(format!("gyroscope, ±{range} °/s: bias {x:+.5} {y:+.5} {z:+.5}{sd} rad/s"));
    }
    let Some(model) = &set.magnetometer else {
        lines.push("magnetometer not calibrated: no heading".to_owned());
        return lines;
    };
    let m = model.terms();
    let [x, y, z] = m.hard_iron_nt.map(|h| h / 1e3);
    let [field, rms] = [m.field_nt, m.rms_nt].map(|nt| nt / 1e3);
    let unknown = match m.to_accelerometer {
        Some(_) => "",
        None => "; its rotation is unknown: no heading",
    };
    lines.push(format!(
        "magnetometer: hard iron {x:+.2} {y:+.2} {z:+.2} µT, field {field:.2} µT, {rms:.2} µT rms{unknown}"
    ));
    lines
}

/// How a model was estimated, and its deviations.
fn quality_lines(q: &QualityTerms) -> Vec<String> {
    let [x, y, z, sx, sy, sz] = [0, 1, 2, 3, 7, 11].map(|place| q.covariance.sd(place));
    let mut lines = vec![format!(
        "± (1 σ) bias {x:.5} {y:.5} {z:.5} m/s², scale factor {sx:.6} {sy:.6} {sz:.6}"
    )];
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
        let CalibratedTemperature { mean_c, lowest_c, highest_c } = t;
        lines.push(format!("at {mean_c:.1} °C, valid from {lowest_c:.1} to {highest_c:.1} °C"));
    }
    lines.extend(q.utc_s.map(|utc_s| format!("made on {}", date(utc_s))));
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
