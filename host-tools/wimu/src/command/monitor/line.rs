//! A reading of a board as text and as JSON.

use serde::Serialize;
use wimu_host::monitor::Reading;
use wimu_model::ParameterId;

/// One reading as JSON.
#[derive(Clone, Debug, Serialize)]
pub struct Line {
    pub sequence: u32,
    pub time_s: f64,
    pub raw_lsb: Option<[i32; 3]>,
    pub raw_angular_rate_lsb: Option<[i32; 3]>,
    pub specific_force_m_s2: [f64; 3],
    pub angular_rate_rad_s: Option<[f64; 3]>,
    pub corrected: bool,
    /// Parameters in use; "00000000" on an uncalibrated device.
    pub parameter_id: Option<String>,
    pub magnetic_field_ut: Option<[f64; 3]>,
    /// Whether the field is corrected and in body axes.
    pub magnetic_field_calibrated: Option<bool>,
    /// Heading of body x, clockwise from magnetic north, 0 to 360. Without a standard deviation it is uncalibrated:
    /// 90 (east) at the first rest, by definition.
    pub heading_deg: Option<f64>,
    pub heading_sd_deg: Option<f64>,
    pub temperature_c: Option<f64>,
    pub phase: Option<String>,
    pub velocity_m_s: Option<[f64; 3]>,
    pub position_m: Option<[f64; 3]>,
    pub since_rest_s: Option<f64>,
    pub valid: Option<bool>,
    /// Attitude W, X, Y, Z, body axes to east-north-up.
    pub quaternion: Option<[f64; 4]>,
}

impl From<&Reading> for Line {
    fn from(reading: &Reading) -> Self {
        let environment = reading.environment;
        let navigation = reading.navigation;
        let scaled = |nm: [i64; 3]| nm.map(|nm| nm as f64 / 1e9);
        Self {
            sequence: reading.sequence,
            // The nearest number, which has no more digits than the microseconds.
            time_s: reading.time.0 as f64 / 1e6,
            raw_lsb: reading.raw.map(|sample| sample.value),
            raw_angular_rate_lsb: reading.raw.and_then(|sample| sample.rate),
            specific_force_m_s2: reading.specific_force.0,
            angular_rate_rad_s: reading.angular_rate,
            corrected: reading.corrected,
            parameter_id: reading.parameters.map(|id| id.to_string()),
            magnetic_field_ut: reading.field.map(|field| field.nt.map(|nt| nt * 1e-3)),
            magnetic_field_calibrated: reading.field.map(|field| field.calibrated),
            heading_deg: reading.heading.map(|heading| heading.rad.to_degrees().rem_euclid(360.0)),
            heading_sd_deg: reading.heading.and_then(|heading| heading.sd_rad).map(f64::to_degrees),
            temperature_c: environment
                .and_then(|e| e.temperature_centi_c)
                .map(|centi| f64::from(centi) / 100.0),
            phase: navigation.map(|n| format!("{:?}", n.phase).to_lowercase()),
            velocity_m_s: navigation.map(|n| scaled(n.velocity_nmps)),
            position_m: navigation.map(|n| scaled(n.position_nm)),
            since_rest_s: navigation.map(|n| f64::from(n.since_rest_ms) / 1000.0),
            valid: navigation.map(|n| n.flags == 0),
            quaternion: reading.attitude.map(|attitude| attitude.to_quaternion()),
        }
    }
}

impl Line {
    /// Whether the device has a calibration.
    pub fn is_calibrated(&self) -> bool {
        let uncalibrated = ParameterId::UNCALIBRATED.to_string();
        self.parameter_id.as_ref().is_some_and(|id| *id != uncalibrated)
    }

    /// The parts as rows with their names.
    pub fn rows(&self) -> Vec<String> {
        let row = |(name, text): (&str, String)| format!("{name:12} {}", text.trim());
        let mut rows: Vec<String> = self.parts().into_iter().map(row).collect();
        let corrected = self.corrected && self.is_calibrated();
        let state = if corrected { "corrected" } else { "nominal sensitivity" };
        let id = self.parameter_id.as_deref().filter(|_| self.is_calibrated());
        rows.push(format!("{:12} {} ({state})", "parameters", id.unwrap_or("none: uncalibrated")));
        rows
    }

    /// The parts in one line.
    pub fn text(&self) -> String {
        self.parts().into_iter().map(|(_, text)| text).collect()
    }

    /// The parts of a line in order, each with its name.
    fn parts(&self) -> Vec<(&'static str, String)> {
        let [x, y, z] = self.specific_force_m_s2;
        let norm = (x * x + y * y + z * z).sqrt();
        let mut parts = vec![
            ("time", format!("{:7.2} s", self.time_s)),
            ("force", format!("  f {x:+7.3} {y:+7.3} {z:+7.3} m/s²")),
            ("magnitude", format!("  |f| {norm:7.3}")),
        ];
        if let Some([x, y, z]) = self.angular_rate_rad_s {
            parts.push(("rate", format!("  ω {x:+7.3} {y:+7.3} {z:+7.3} rad/s")));
        }
        if let Some(quaternion) = self.quaternion {
            let [roll, pitch, yaw] = euler_deg(quaternion);
            let text = format!("  roll {roll:+4.0}° pitch {pitch:+3.0}° yaw {yaw:+4.0}°");
            parts.push(("attitude", text));
        }
        if let Some([x, y, z]) = self.magnetic_field_ut {
            let calibrated = self.magnetic_field_calibrated == Some(true);
            let note = if calibrated { "" } else { " uncalibrated" };
            parts.push(("field", format!("  B {x:+6.1} {y:+6.1} {z:+6.1} µT{note}")));
        }
        if let Some(heading) = self.heading_deg {
            let sd = self.heading_sd_deg;
            let sd = sd.map_or("° uncalibrated".to_owned(), |sd| format!(" ± {sd:.0}°"));
            parts.push(("heading", format!("  heading {heading:3.0}{sd}")));
        }
        if let Some(celsius) = self.temperature_c {
            parts.push(("temperature", format!("  {celsius:.1} °C")));
        }
        if let Some(phase) = &self.phase {
            let invalid = self.valid == Some(false);
            let note = if invalid { " (invalid)" } else { "" };
            parts.push(("motion", format!("  {phase}{note}")));
            if let Some([e, n, u]) = self.position_m.filter(|_| phase != "searching") {
                parts.push(("position", format!("  p {e:+.3} {n:+.3} {u:+.3} m")));
            }
        }
        parts
    }
}

/// Roll, pitch and yaw of a quaternion W, X, Y, Z, degrees: rotations about x, then y, then z.
fn euler_deg([w, x, y, z]: [f64; 4]) -> [f64; 3] {
    let roll = (2.0 * (w * x + y * z)).atan2(1.0 - 2.0 * (x * x + y * y));
    let pitch = (2.0 * (w * y - x * z)).clamp(-1.0, 1.0).asin();
    let yaw = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    [roll, pitch, yaw].map(f64::to_degrees)
}
