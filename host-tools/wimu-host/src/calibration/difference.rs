//! What changes when a calibration replaces another one.

use crate::calibration::parameter_id;
use serde::Serialize;
use wimu_model::ParameterSet;

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
            result: "the device is uncalibrated".to_owned(),
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
    let ([x, y, z], thermal) = (terms.matrix, terms.temperature);
    vec![
        ("bias, m/s²", terms.bias_mps2.to_vec()),
        ("matrix, row X", x.to_vec()),
        ("matrix, row Y", y.to_vec()),
        ("matrix, row Z", z.to_vec()),
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
            let all = all.iter().map(|value| format!("{value:+.5}"));
            Vec::from_iter(all).join(" ")
        }
    }
}
