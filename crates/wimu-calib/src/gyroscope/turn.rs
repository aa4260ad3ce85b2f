//! Integration of the angular rate from one rest to the next, with sensitivities.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::rests::Rates;
use super::{SixAxisSample, TurnFault};

/// Longest step between two samples of a turn, s: a longer one is a gap.
const LONGEST_STEP_S: f64 = 0.2;

/// Attitude at the end of a turn in the axes at its start, and integrals over it.
pub(super) struct Turn {
    /// C, axes at the end to axes at the start.
    pub attitude: Matrix3<f64>,
    /// ∫ C dt, s.
    pub time: Matrix3<f64>,
    /// ∫ C ω_j dt, rad.
    pub rate: [Matrix3<f64>; 3],
    /// ∫ C f_j dt, m/s.
    pub force: [Matrix3<f64>; 3],
    /// T, s.
    pub length_s: f64,
    /// ∫ |ω| dt, rad.
    pub angle_rad: f64,
    steps: u32,
}

impl Turn {
    /// Integrates `samples`; the step before the first is not part of the turn. Equation (144).
    pub fn integrate(samples: &[SixAxisSample], rates: &Rates<'_>) -> Result<Self, TurnFault> {
        let zero = Matrix3::zeros();
        let mut turn = Self {
            attitude: Matrix3::identity(),
            time: zero,
            rate: [zero; 3],
            force: [zero; 3],
            length_s: 0.0,
            angle_rad: 0.0,
            steps: 0,
        };
        let mut before = None;
        for sample in samples {
            if let Some(axis) = rates.saturated(sample) {
                return Err(TurnFault::Saturated { axis });
            }
            let now = rates.of(sample);
            let dt = sample.step_s;
            match before {
                None => {}
                // A repeated sample.
                Some(_) if dt == 0.0 => {}
                Some(before) if dt > 0.0 && dt < LONGEST_STEP_S => turn.step(before, now, dt),
                Some(_) => return Err(TurnFault::Gap),
            }
            before = Some(now);
        }
        if turn.attitude.iter().all(|c| c.is_finite()) && turn.length_s > 0.0 {
            Ok(turn)
        } else {
            Err(TurnFault::Gap)
        }
    }

    /// Mean step, s.
    pub fn step_s(&self) -> f64 {
        self.length_s / f64::from(self.steps.max(1))
    }

    /// A step between two samples of rate and specific force.
    fn step(&mut self, before: [Vector3<f64>; 2], now: [Vector3<f64>; 2], dt: f64) {
        let [rate, force] = [0, 1].map(|k| (before[k] + now[k]) * 0.5);
        let vector = rate * dt + before[0].cross(&now[0]) * (dt * dt / 12.0);
        let middle = self.attitude + self.attitude * (vector * 0.5).cross_matrix();
        for axis in 0..3 {
            self.rate[axis] += middle * (rate[axis] * dt);
            self.force[axis] += middle * (force[axis] * dt);
        }
        self.time += middle * dt;
        self.attitude *= Rotation3::new(vector).into_inner();
        self.length_s += dt;
        self.angle_rad += rate.norm() * dt;
        self.steps += 1;
    }
}
