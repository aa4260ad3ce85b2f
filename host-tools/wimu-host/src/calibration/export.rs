//! Export of a calibration to other firmware and tools.

use std::fmt::Write;
use std::path::Path;

use serde_json::Value;

use wimu_link::message::parameter_id;
use wimu_model::{Alignment, GyroscopeParameters, Matrix3, ParameterSet, STANDARD_GRAVITY_MPS2};

use crate::allan::NoiseReport;
use crate::error::{ErrorCode, HostError, Result};

/// Noise of the accelerometer for Kalibr, from `wimu allan`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KalibrNoise {
    /// Velocity random walk N, m/s/√s.
    pub density: f64,
    /// Acceleration random walk K, m/s²/√s; above 0.
    pub random_walk: f64,
    /// Whether it was observed; else it is an upper bound.
    pub random_walk_seen: bool,
    /// Sample rate, Hz.
    pub rate_hz: f64,
    /// Whether the counts of an axis are coarser than its noise: then the density is that of the quantisation.
    pub coarse: bool,
}

impl KalibrNoise {
    /// Reads the output of `wimu allan --json`; the noisiest axis counts. For an acceleration random walk that was
    /// not observed, the upper bound is taken, because Kalibr needs a number above 0: alone it would be
    /// σ(τ) = K √(τ/3) at the lowest σ.
    ///
    /// # Errors
    /// `file_unreadable`; `bad_calibration` when it is not such a report, or was refused.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|e| HostError::file(&name, "read", &e))?;
        let bad = || {
            ErrorCode::BadCalibration
                .error(
                    "this is not a noise report",
                    "make it with `wimu allan --json rest.mcap > NOISE.json`",
                )
                .at(&name)
        };
        let report: Value = serde_json::from_str(&text).map_err(|_| bad())?;
        if report["schema"] != NoiseReport::SCHEMA || report["status"] != "ok" {
            return Err(bad());
        }
        let worst = |key: &str| {
            let axes = report["axes"].as_array()?;
            let of = |axis: &Value| axis[key]["value"].as_f64();
            axes.iter().filter_map(of).reduce(f64::max)
        };
        let walk = |axis: &Value| {
            let seen = axis["acceleration_random_walk_m_s2_rts"]["value"].as_f64();
            let (floor, tau) = (axis["floor_m_s2"].as_f64()?, axis["floor_tau_s"].as_f64()?);
            let most = floor * (3.0 / tau).sqrt();
            Some((seen.unwrap_or(most), seen.is_some()))
        };
        let axes = report["axes"].as_array().ok_or_else(bad)?;
        let (random_walk, random_walk_seen) = axes
            .iter()
            .filter_map(walk)
            .filter(|(walk, _)| walk.is_finite() && *walk > 0.0)
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .ok_or_else(bad)?;
        Ok(Self {
            density: worst("velocity_random_walk_m_s_rts").ok_or_else(bad)?,
            random_walk,
            random_walk_seen,
            rate_hz: report["rate_hz"].as_f64().ok_or_else(bad)?,
            coarse: report["axes"]
                .as_array()
                .is_some_and(|axes| axes.iter().any(|axis| axis["is_coarse"] == true)),
        })
    }
}

/// Description of the accelerometer; its range may be unknown.
fn accelerometer(set: &ParameterSet, range_known: bool) -> String {
    let (range_g, lsb_per_g) = (set.range_g, set.sensitivity.lsb_per_g());
    if range_known {
        format!("a +/-{range_g} g accelerometer")
    } else {
        format!(
            "an accelerometer of {lsb_per_g:.0} LSB/g; its range is unknown (+/-{range_g} g if it has 16 bits)"
        )
    }
}

/// A Rust module that builds the set with `wimu-model`; a comment says if the range is unknown.
pub fn to_rust(set: &ParameterSet, range_known: bool) -> String {
    let terms = set.model.terms();
    let t = &terms.temperature;
    let [imports, field, gyroscope] = set.gyroscope.map_or_else(Default::default, rust_gyroscope);
    format!(
        "//! Calibration {id} of {what}, exported by wimu.\n\n\
         use wimu_model::{{\n    Alignment, ErrorModel, ErrorTerms, {imports}ParameterSet, Sensitivity, TemperatureTerms,\n}};\n\n\
         /// The error model, y = b(T) + A(T) u: m/s², sensor axes.\n\
         pub const TERMS: ErrorTerms = ErrorTerms {{\n    \
         bias_mps2: {bias:?},\n    matrix: {matrix:?},\n    \
         temperature: TemperatureTerms {{\n        reference_c: {reference:?},\n        \
         bias_mps2_per_k: {b1:?},\n        bias_mps2_per_k2: {b2:?},\n        \
         scale_per_k: {s1:?},\n    }},\n    nonlinearity: {q:?},\n}};\n\n\
         /// The parameter set for `wimu_model::Corrector`; `None` is ruled out by the export.\n\
         pub fn parameters() -> Option<ParameterSet> {{\n    Some(ParameterSet {{\n        \
         model: ErrorModel::new(TERMS).ok()?,\n        \
         alignment: Alignment::try_from({alignment:?}).ok()?,\n        {field}\
         ..ParameterSet::uncalibrated({range}, Sensitivity::from_lsb_per_g({sensitivity:?}).ok()?)\n    }})\n}}\n{gyroscope}",
        id = parameter_id(set),
        what = accelerometer(set, range_known).replace("+/-", "±"),
        range = set.range_g,
        bias = terms.bias_mps2,
        matrix = terms.matrix,
        reference = t.reference_c,
        b1 = t.bias_mps2_per_k,
        b2 = t.bias_mps2_per_k2,
        s1 = t.scale_per_k,
        q = terms.nonlinearity,
        alignment = set.alignment.quaternion(),
        sensitivity = set.sensitivity.lsb_per_g(),
    )
}

/// Imports, field and function of [`to_rust`] for a gyroscope.
fn rust_gyroscope(gyroscope: GyroscopeParameters) -> [String; 3] {
    let terms = gyroscope.model.terms();
    let t = &terms.temperature;
    [
        "GyroscopeModel, GyroscopeParameters, GyroscopeTemperatureTerms,\n    GyroscopeTerms, "
            .to_owned(),
        "gyroscope: Some(gyroscope()?),\n        ".to_owned(),
        format!(
            "\n/// The gyroscope, for `wimu_model::GyroscopeCorrector`; `None` is ruled out by the export.\n\
             pub fn gyroscope() -> Option<GyroscopeParameters> {{\n    \
             let model = GyroscopeModel::new(GyroscopeTerms {{\n        \
             bias_rad_s: {bias:?},\n        matrix: {matrix:?},\n        g_sensitivity: {g:?},\n        \
             temperature: GyroscopeTemperatureTerms {{\n            reference_c: {reference:?},\n            \
             bias_rad_s_per_k: {b1:?},\n            scale_per_k: {s1:?},\n        }},\n    }});\n    \
             GyroscopeParameters::new({range}, {scale:?}, model.ok()?, {sd:?}).ok()\n}}\n",
            bias = terms.bias_rad_s,
            matrix = terms.matrix,
            g = terms.g_sensitivity,
            reference = t.reference_c,
            b1 = t.bias_rad_s_per_k,
            s1 = t.scale_per_k,
            range = gyroscope.range_dps,
            scale = gyroscope.rad_s_per_lsb,
            sd = gyroscope.sd,
        ),
    ]
}

/// C: z = a⁻¹ y by cofactors, up to the open loop over `i`.
const C_SOLVE: &str = "    det = a[0][0] * (a[1][1] * a[2][2] - a[1][2] * a[2][1])
        - a[0][1] * (a[1][0] * a[2][2] - a[1][2] * a[2][0])
        + a[0][2] * (a[1][0] * a[2][1] - a[1][1] * a[2][0]);
    for (i = 0; i < 3; i++) {
        z[i] = 0.0;
        for (j = 0; j < 3; j++) {
            const int r1 = (j + 1) % 3, r2 = (j + 2) % 3, c1 = (i + 1) % 3, c2 = (i + 2) % 3;
            z[i] += (a[r1][c1] * a[r2][c2] - a[r1][c2] * a[r2][c1]) / det * y[j];
        }
";

fn c_vector(v: [f64; 3]) -> String {
    format!("{{{:?}, {:?}, {:?}}}", v[0], v[1], v[2])
}

fn c_matrix(m: Matrix3) -> String {
    let [x, y, z] = m.map(c_vector);
    format!("{{{x}, {y}, {z}}}")
}

/// A C header with a function, counts to specific force in body axes, and one for the gyroscope if it is calibrated; a
/// comment says if the range is unknown.
pub fn to_c(set: &ParameterSet, range_known: bool) -> String {
    let terms = set.model.terms();
    let t = &terms.temperature;
    let mut out = format!(
        "/* Calibration {} of {}, exported by wimu. C99. */\n\
         #ifndef WIMU_CALIBRATION_H\n#define WIMU_CALIBRATION_H\n\n#include <stdint.h>\n\n",
        parameter_id(set),
        accelerometer(set, range_known)
    );
    let scale = STANDARD_GRAVITY_MPS2 / set.sensitivity.lsb_per_g();
    let alignment = c_matrix(set.alignment.matrix());
    let _ = write!(
        out,
        "/* Specific force in body axes, m/s^2, from raw counts at a temperature in degrees Celsius;\n   \
         pass WIMU_REFERENCE_C where there is no thermometer.\n   \
         z = A(T)^-1 (y - b(T)), f = z - q z z, then sensor axes to body axes. */\n\
         #define WIMU_REFERENCE_C {reference:?}\n\n\
         static inline void wimu_correct(const int16_t counts[3], double temperature_c, double force[3])\n{{\n    \
         static const double b0[3] = {b0};\n    static const double b1[3] = {b1};\n    \
         static const double b2[3] = {b2};\n    static const double s1[3] = {s1};\n    \
         static const double q[3] = {q};\n    static const double a0[3][3] = {a};\n    \
         static const double r[3][3] = {alignment};\n    \
         const double dt = temperature_c - WIMU_REFERENCE_C;\n    \
         double a[3][3], y[3], z[3], det;\n    int i, j;\n\n    \
         for (i = 0; i < 3; i++) {{\n        for (j = 0; j < 3; j++)\n            a[i][j] = a0[i][j];\n        \
         a[i][i] *= 1.0 + s1[i] * dt;\n        \
         y[i] = counts[i] * {scale:?} - (b0[i] + (b1[i] + b2[i] * dt) * dt);\n    }}\n{C_SOLVE}        \
         z[i] -= q[i] * z[i] * z[i];\n    }}\n    \
         for (i = 0; i < 3; i++)\n        force[i] = r[i][0] * z[0] + r[i][1] * z[1] + r[i][2] * z[2];\n}}\n",
        reference = t.reference_c,
        b0 = c_vector(terms.bias_mps2),
        b1 = c_vector(t.bias_mps2_per_k),
        b2 = c_vector(t.bias_mps2_per_k2),
        s1 = c_vector(t.scale_per_k),
        q = c_vector(terms.nonlinearity),
        a = c_matrix(terms.matrix),
    );
    if let Some(gyroscope) = &set.gyroscope {
        out += &c_gyroscope(gyroscope, &alignment);
    }
    out + "\n#endif\n"
}

/// The function of [`to_c`] for a gyroscope.
fn c_gyroscope(gyroscope: &GyroscopeParameters, alignment: &str) -> String {
    let terms = gyroscope.model.terms();
    let t = &terms.temperature;
    format!(
        "\n/* Angular rate in body axes, rad/s, from raw counts of the gyroscope at a temperature in degrees Celsius;\n   \
         pass WIMU_GYROSCOPE_REFERENCE_C where there is no thermometer. force: specific force in body axes,\n   \
         m/s^2, from wimu_correct. A(T)^-1 (y - b(T) - G f), then sensor axes to body axes. */\n\
         #define WIMU_GYROSCOPE_REFERENCE_C {reference:?}\n\n\
         static inline void wimu_correct_rate(const int16_t counts[3], const double force[3],\n    \
         double temperature_c, double rate[3])\n{{\n    \
         static const double b0[3] = {b0};\n    static const double b1[3] = {b1};\n    \
         static const double s1[3] = {s1};\n    static const double g[3][3] = {g};\n    \
         static const double a0[3][3] = {a};\n    static const double r[3][3] = {alignment};\n    \
         const double dt = temperature_c - WIMU_GYROSCOPE_REFERENCE_C;\n    \
         double a[3][3], y[3], z[3], det;\n    int i, j;\n\n    \
         for (i = 0; i < 3; i++)\n        z[i] = r[0][i] * force[0] + r[1][i] * force[1] + r[2][i] * force[2];\n    \
         for (i = 0; i < 3; i++) {{\n        y[i] = counts[i] * {scale:?} - (b0[i] + b1[i] * dt);\n        \
         for (j = 0; j < 3; j++) {{\n            a[i][j] = a0[i][j];\n            y[i] -= g[i][j] * z[j];\n        }}\n        \
         a[i][i] *= 1.0 + s1[i] * dt;\n    }}\n{C_SOLVE}    }}\n    \
         for (i = 0; i < 3; i++)\n        rate[i] = r[i][0] * z[0] + r[i][1] * z[1] + r[i][2] * z[2];\n}}\n",
        reference = t.reference_c,
        b0 = c_vector(terms.bias_rad_s),
        b1 = c_vector(t.bias_rad_s_per_k),
        s1 = c_vector(t.scale_per_k),
        g = c_matrix(terms.g_sensitivity),
        a = c_matrix(terms.matrix),
        scale = gyroscope.rad_s_per_lsb,
    )
}

/// What [`to_kalibr`] leaves out of a set, as lines of text: Kalibr's file has no field for it.
pub fn not_in_kalibr(set: &ParameterSet) -> Vec<String> {
    let terms = set.model.terms();
    let t = &terms.temperature;
    let moves = [t.bias_mps2_per_k, t.bias_mps2_per_k2, t.scale_per_k];
    let mut left_out = Vec::new();
    if moves != [[0.0; 3]; 3] {
        left_out.push(format!(
            "M and b are those at {:.2} °C: their temperature coefficients are left out",
            t.reference_c
        ));
    }
    let rates = (set.gyroscope.as_ref()).map(|gyroscope| gyroscope.model.terms().temperature);
    if let Some(t) = rates.filter(|t| [t.bias_rad_s_per_k, t.scale_per_k] != [[0.0; 3]; 2]) {
        left_out.push(format!(
            "the gyroscope's M and b are those at {:.2} °C: their temperature coefficients are left out",
            t.reference_c
        ));
    }
    if terms.nonlinearity != [0.0; 3] {
        left_out.push("the nonlinearity is left out".to_owned());
    }
    if set.alignment != Alignment::IDENTITY {
        left_out
            .push("the alignment is left out: axes are the sensor's, not the body's".to_owned());
    }
    left_out
}

/// Kalibr's IMU file: noise, and the intrinsics of accelerometer and gyroscope in its convention, y = M f + b and
/// y = M C_gyro_i ω + A f + b, which are equations (1) and (25): its M is our A, its A our G, b the bias.
pub fn to_kalibr(set: &ParameterSet, noise: Option<KalibrNoise>) -> String {
    let terms = set.model.terms();
    let mut out = format!(
        "# Calibration {} of a +/-{} g accelerometer, exported by wimu.\nrostopic: /imu/data_raw\n",
        parameter_id(set),
        set.range_g
    );
    let _ = match noise {
        Some(noise) => writeln!(
            out,
            "{}update_rate: {:?}\n# m/s^2/sqrt(Hz) in Kalibr's convention: the velocity random walk, m/s/sqrt(s)\n\
             accelerometer_noise_density: {:?}\n{}accelerometer_random_walk: {:?}",
            if noise.coarse {
                "# Counts are coarser than the noise: this is the noise of the quantisation, not of the sensor.\n"
            } else {
                ""
            },
            noise.rate_hz,
            noise.density,
            if noise.random_walk_seen {
                ""
            } else {
                "# Not observed in the recording: upper bound, m/s^2/sqrt(s).\n"
            },
            noise.random_walk
        ),
        None => writeln!(
            out,
            "# Not measured: give the JSON of `wimu allan --json` with --noise.\n\
             # update_rate:\n# accelerometer_noise_density:\n# accelerometer_random_walk:"
        ),
    };
    let _ = writeln!(
        out,
        "# Output = M * specific force + b, sensor axes, m/s^2. The gyroscope's noise is not calibrated by wimu:\n\
         # add gyroscope_noise_density and gyroscope_random_walk."
    );
    for line in not_in_kalibr(set) {
        let _ = writeln!(out, "# {line}.");
    }
    let matrix = |out: &mut String, name: &str, rows: Matrix3| {
        let _ = writeln!(out, "  {name}:");
        for row in rows {
            let _ = writeln!(out, "  - {row:?}");
        }
    };
    out.push_str("accelerometers:\n");
    matrix(&mut out, "M", terms.matrix);
    let _ = writeln!(out, "  b: {:?}", terms.bias_mps2);
    if let Some(gyroscope) = &set.gyroscope {
        let terms = gyroscope.model.terms();
        out.push_str(
            "# Output = M * C_gyro_i * angular rate + A * specific force + b, sensor axes, rad/s.\ngyroscopes:\n",
        );
        matrix(&mut out, "M", terms.matrix);
        matrix(&mut out, "C_gyro_i", Alignment::IDENTITY.matrix());
        matrix(&mut out, "A", terms.g_sensitivity);
        let _ = writeln!(out, "  b: {:?}", terms.bias_rad_s);
    }
    out
}
