//! Baseline with the attitude of low-passed accelerometer and magnetometer: every acceleration tilts it. Specific force
//! is rotated with it, gravity is subtracted, and the rest is integrated twice by the trapezoidal rule.

use wimu_host::motion::MotionRecording;

/// Time constant of the first-order low-pass filter, s.
pub const TIME_CONSTANT_S: f64 = 1.0;

/// Acceleration, m/s², east-north-up, and heading, rad, at each sample.
pub struct LowPass {
    pub acceleration: Vec<[f64; 3]>,
    pub headings: Vec<f64>,
}

/// Position, m, and velocity, m/s.
pub type State = ([f64; 3], [f64; 3]);

impl LowPass {
    /// Of a recording with a magnetometer. `gravity` is subtracted, m/s².
    pub fn of(recording: &MotionRecording, gravity: f64) -> Self {
        let samples = &recording.samples;
        let mut force = samples[0].force_mps2;
        let mut field = samples[0].field_ut.unwrap_or_default();
        let mut found = Self { acceleration: Vec::new(), headings: Vec::new() };
        for sample in samples {
            let weight = sample.step_s / (TIME_CONSTANT_S + sample.step_s);
            for i in 0..3 {
                force[i] += weight * (sample.force_mps2[i] - force[i]);
                if let Some(seen) = sample.field_ut {
                    field[i] += weight * (seen[i] - field[i]);
                }
            }
            let up = unit(force);
            let east = unit(cross(field, up));
            let north = cross(up, east);
            let dot = |a: [f64; 3]| (0..3).map(|i| a[i] * sample.force_mps2[i]).sum::<f64>();
            found.acceleration.push([dot(east), dot(north), dot(up) - gravity]);
            found.headings.push(north[0].atan2(east[0]));
        }
        found
    }

    /// Integrates from one sample to a later one, with the acceleration rotated by `yaw`, rad, about the vertical.
    pub fn integrate(
        &self,
        times_s: &[f64],
        from: usize,
        to: usize,
        yaw: f64,
        start: State,
    ) -> State {
        let (sin, cos) = yaw.sin_cos();
        let rotated = |a: [f64; 3]| [cos * a[0] - sin * a[1], sin * a[0] + cos * a[1], a[2]];
        let (mut p, mut v) = start;
        for k in from..to {
            let (a, b) = (rotated(self.acceleration[k]), rotated(self.acceleration[k + 1]));
            let dt = times_s[k + 1] - times_s[k];
            for i in 0..3 {
                let next = v[i] + 0.5 * (a[i] + b[i]) * dt;
                p[i] += 0.5 * (v[i] + next) * dt;
                v[i] = next;
            }
        }
        (p, v)
    }
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let n = v.iter().map(|a| a * a).sum::<f64>().sqrt();
    v.map(|a| a / n)
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
