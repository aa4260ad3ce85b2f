//! A parameter set in words, and what changes when one replaces another.

use std::time::{Duration, UNIX_EPOCH};

use serde::Serialize;
use wimu_calib::{Gravity, Parameter, Parameters};
use wimu_link::hello::sensor;
use wimu_model::{
    CalibratedTemperature, ErrorTerms, ParameterSet, QualityTerms, STANDARD_GRAVITY_MPS2, SensorId,
};

use super::parameter_id;
use super::report::AXES;
use crate::digits::{signed, signed_with_sd, with_sd};
use crate::plural::counted;

/// Begin of the year 10000, s since 1970 UTC: later times have no date.
const YEAR_10000_S: u64 = 253_402_300_800;
/// Misalignments by name, row and column of A.
const MISALIGNMENTS: [(&str, usize, usize); 6] = [
    ("m_yx", 0, 1),
    ("m_zx", 0, 2),
    ("m_xy", 1, 0),
    ("m_zy", 1, 2),
    ("m_xz", 2, 0),
    ("m_yz", 2, 1),
];

/// The difference of two calibrations of a device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Difference {
    /// Which calibration replaces which.
    pub result: String,
    /// The terms that change: name with unit, value before, value after.
    pub changed: Vec<[String; 3]>,
    /// What else differs.
    pub notes: Vec<String>,
}

impl Difference {
    /// Of what the device holds (`None`: uncalibrated) and what would be written.
    pub fn of(before: Option<&ParameterSet>, after: &ParameterSet) -> Self {
        let Some(before) = before else {
            let result = "the device was uncalibrated before".to_owned();
            return Self { result, changed: Vec::new(), notes: Vec::new() };
        };
        let [old, new] = [before, after].map(parameter_id);
        if old == new {
            let result = format!("the device already holds {new}");
            return Self { result, changed: Vec::new(), notes: Vec::new() };
        }
        let pairs = parameter_figures(before).into_iter().zip(parameter_figures(after));
        let changed = pairs.filter_map(|((name, old), (_, new))| {
            let [old, new] = [&old, &new].map(|values| values_text(values));
            (old != new).then(|| [name.to_owned(), old, new])
        });
        let others = [
            ("alignment", before.alignment != after.alignment),
            ("magnetometer calibration", before.magnetometer != after.magnetometer),
            ("quality of the fit", before.quality != after.quality),
            ("sensor", before.sensor != after.sensor),
            ("gyroscope calibration", before.gyroscope != after.gyroscope),
        ];
        let notes = others.into_iter().filter(|(_, differs)| *differs);
        Self {
            result: format!("{old} → {new}"),
            changed: changed.collect(),
            notes: notes.map(|(name, _)| format!("{name} differs")).collect(),
        }
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

/// A parameter set beside its error model, as lines of text.
pub fn describe(set: &ParameterSet) -> Vec<String> {
    let mut lines = Vec::new();
    if let Some(SensorId(number)) = set.sensor {
        lines.push(format!("sensor: {}", sensor::name(number)));
    }
    match &set.quality {
        None => lines.push("no information on how the model was estimated".to_owned()),
        Some(quality) => lines.extend(quality_lines(quality.terms())),
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
    if let Some(utc_s) = q.utc_s.filter(|utc_s| *utc_s < YEAR_10000_S) {
        let made = httpdate::fmt_http_date(UNIX_EPOCH + Duration::from_secs(utc_s));
        lines.push(format!("made on {made}"));
    }
    lines
}

/// Gravity as text.
pub(super) fn gravity_text(gravity: Gravity) -> String {
    let uncertain = match gravity.sd_mps2() {
        0.0 => String::new(),
        sd => format!(" ± {sd}"),
    };
    format!("g = {:.5}{uncertain} m/s²", gravity.mps2())
}

/// A line for each axis, and one of the misalignments, of a model and its standard deviations.
pub(super) fn parameter_lines(
    (model, sd): (&ErrorTerms, &ErrorTerms),
    fitted: Parameters,
    not_observed: Parameters,
) -> Vec<String> {
    let mut lines = Vec::new();
    for (axis, name) in AXES.into_iter().enumerate() {
        let (bias, bias_sd) = (model.bias_mps2[axis], sd.bias_mps2[axis]);
        let bias = if not_observed.contains(Parameter::ALL[axis]) {
            format!("bias not observed, taken as 0 ± {bias_sd:.1} m/s²")
        } else {
            let mg = signed(bias * 1e3 / STANDARD_GRAVITY_MPS2, 3);
            format!("bias {} m/s² ({mg} mg)", signed_with_sd(bias, bias_sd))
        };
        let (scale, scale_sd) = (model.matrix[axis][axis], sd.matrix[axis][axis]);
        let scale = if fitted.contains(Parameter::ALL[3 + 4 * axis]) {
            with_sd(scale, scale_sd)
        } else {
            format!("not observed, taken as 1 ± {scale_sd:.2}")
        };
        lines.push(format!("{name}: {bias}, scale factor {scale}"));
    }
    let seen = |(_, r, c): &(_, usize, usize)| fitted.contains(Parameter::ALL[3 + 3 * r + c]);
    let text = |(name, r, c): (&str, usize, usize)| {
        let known = signed_with_sd(model.matrix[r][c] * 1e3, sd.matrix[r][c] * 1e3);
        format!("{name} {known}")
    };
    let misaligned = Vec::from_iter(MISALIGNMENTS.into_iter().filter(seen).map(text));
    if !misaligned.is_empty() {
        lines.push(format!("misalignment, mrad: {}", misaligned.join(", ")));
    }
    lines
}

/// The temperature coefficients of a model and their standard deviations, where they were fitted.
pub(super) fn temperature_line(
    (model, sd): (&ErrorTerms, &ErrorTerms),
    valid: Option<CalibratedTemperature>,
) -> Option<String> {
    let (slopes, slopes_sd) = (&model.temperature, &sd.temperature);
    let CalibratedTemperature { lowest_c, highest_c, .. } =
        valid.filter(|_| slopes_sd.bias_mps2_per_k[0] > 0.0)?;
    let of = |value: [f64; 3], sd: [f64; 3], unit: f64| {
        [0, 1, 2].map(|k| signed_with_sd(value[k] * unit, sd[k] * unit)).join(", ")
    };
    Some(format!(
        "per K from {:.1} °C, valid from {lowest_c:.1} to {highest_c:.1} °C: bias {} mm/s², scale factor {} ppm",
        slopes.reference_c,
        of(slopes.bias_mps2_per_k, slopes_sd.bias_mps2_per_k, 1e3),
        of(slopes.scale_per_k, slopes_sd.scale_per_k, 1e6),
    ))
}
