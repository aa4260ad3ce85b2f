//! Whether the sensors of an array tell of one rigid body where the geometry says they are.

use wimu_nav::array::ArraySolver;

use super::calibration::{BIAS_MPS2, MOST_SCALE};
use super::motion::{axes, refused, sample, with_room};
use super::{ArrayCalibration, ArrayGeometry, ArrayRecording};
use crate::{ErrorCode, HostError, Result};

/// Outputs that differ by so many times their noise and more, m/s², show a turn.
const NOISES: f64 = 10.0;
const LEAST_MPS2: f64 = 0.3;
/// Fewer samples do not decide.
const LEAST_SAMPLES: usize = 50;
/// Share of what no motion explains from which on the geometry is not this array's, where that is beyond so many
/// deviations of what the sensors' own errors may add.
const CONTRADICTION: f64 = 0.15;
const BEYOND: f64 = 3.0;

/// How well the outputs of a turning array fit a motion, equation (101).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agreement {
    /// Samples in which the sensors differ by far more than their noise.
    pub samples: usize,
    /// Share of the variance among them that no motion of one rigid body explains, median: 0 where all
    /// fits, about 1 for places that have nothing to do with the outputs.
    pub unexplained: f64,
    /// That part in m/s² an axis, median.
    pub unexplained_mps2: f64,
    /// What errors of the sensors, their places and times that are allowed for add to each output, m/s², median.
    pub allowed_mps2: f64,
    /// The sensor that fits worst.
    pub worst: usize,
}

impl Agreement {
    /// Of a recording in body axes; `None` where too few samples turn, or motion explains everything.
    ///
    /// # Errors
    /// As [`angular_rate`](super::angular_rate).
    pub fn of(
        recording: &ArrayRecording,
        geometry: &ArrayGeometry,
        calibration: &ArrayCalibration,
    ) -> Result<Option<Self>> {
        with_room!(
            geometry.sensors.len(),
            agreement(recording, geometry, calibration)
        )
    }

    /// Refuses sensors that contradict each other.
    ///
    /// # Errors
    /// `data_refused`, with what to check.
    pub fn check(&self, name: &str) -> Result<()> {
        let allowed = self.unexplained_mps2 < BEYOND * self.allowed_mps2;
        if self.unexplained < CONTRADICTION || allowed {
            return Ok(());
        }
        Err(HostError::new(
            ErrorCode::DataRefused,
            format!(
                "the sensors contradict each other: {:.0} % of what they differ by while the array turns \
                 fits no motion of one rigid body; sensor {} (from 0) fits worst",
                100.0 * self.unexplained,
                self.worst
            ),
            "check the geometry: the order of the sensors, the signs of their places, and which way their \
             axes point. If they are right, calibrate the sensors: hold the array still in a dozen orientations, \
             `wimu calibrate RESTS.csv --geometry PLACES.csv -o ARRAY.json`, and navigate with --geometry ARRAY.json",
        )
        .at(name))
    }

    /// What to tell the user.
    pub fn remark(&self) -> String {
        format!(
            "{:.1} % of what the sensors differ by while the array turns, {:.3} m/s², fits no motion of one \
             rigid body",
            100.0 * self.unexplained,
            self.unexplained_mps2
        )
    }
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

fn agreement<const M: usize>(
    recording: &ArrayRecording,
    geometry: &ArrayGeometry,
    calibration: &ArrayCalibration,
) -> Result<Option<Agreement>> {
    let axes = axes::<M>(geometry, calibration)?;
    let used: Vec<usize> = (0..recording.sensors())
        .filter(|sensor| calibration.uses(*sensor))
        .collect();
    let solver =
        ArraySolver::<f64, M>::of(&axes, |sensor| calibration.uses(sensor)).map_err(refused)?;
    let all = 3 * used.len();
    if all < 10 || solver.rank() < 3 {
        return Ok(None);
    }
    let noise = solver.variance_mps2();
    let least = (NOISES * NOISES * noise).max(LEAST_MPS2 * LEAST_MPS2);
    let (mut shares, mut sizes, mut allowed) = (Vec::new(), Vec::new(), Vec::new());
    let scale = Some(calibration.scale).filter(|s| *s < MOST_SCALE);
    // Of what turns make the outputs differ by.
    let place = 3.0 * (calibration.place_sd_m / solver.arm_m()).powi(2);
    let mut of_sensor = vec![0.0; recording.sensors()];
    for index in 0..recording.outputs.len() {
        if !used.iter().all(|sensor| recording.has(index, *sensor)) {
            continue;
        }
        let mut output = sample::<M>(recording, calibration, index);
        for (axis, value) in output.iter_mut().enumerate() {
            if !used.contains(&(axis / 3)) {
                *value = 0.0;
            }
        }
        let mut apart = 0.0;
        for axis in 0..3 {
            let values = || used.iter().map(|s| output[3 * s + axis]);
            let mean = values().sum::<f64>() / used.len() as f64;
            apart += values().map(|v| (v - mean).powi(2)).sum::<f64>();
        }
        let apart = apart / (all - 3) as f64;
        if apart < least {
            continue;
        }
        let linear = solver.reduce(&output);
        let solution = solver.roots_of(&linear);
        let Some(best) = solution.hypotheses().next() else {
            continue;
        };
        // What is left of each output, of the noise's variance.
        let (expected, _) = solver.expected_z(best.rate_rad_s);
        let mut rest = solver.project(&output);
        for (row, z) in solver.z_rows().iter().zip(expected) {
            for (rest, value) in rest.iter_mut().zip(row) {
                *rest -= value * z;
            }
        }
        let left = rest.map(|r| (r * noise).powi(2));
        let total = left.iter().sum::<f64>() / (all - 9) as f64;
        shares.push(total / apart);
        sizes.push(total.sqrt());
        let change = calibration.changed(index, best.specific_force_mps2);
        let change = change.iter().map(|c| c * c).sum::<f64>();
        let scaled = scale.unwrap_or_default().powi(2) * change;
        allowed.push((noise + BIAS_MPS2.powi(2) + scaled + place * apart).sqrt());
        for (sensor, sum) in of_sensor.iter_mut().enumerate() {
            *sum += left[3 * sensor..3 * sensor + 3].iter().sum::<f64>() / apart;
        }
    }
    if shares.len() < LEAST_SAMPLES {
        return Ok(None);
    }
    Ok(Some(Agreement {
        samples: shares.len(),
        unexplained: median(&mut shares),
        unexplained_mps2: median(&mut sizes),
        allowed_mps2: median(&mut allowed),
        worst: (0..of_sensor.len())
            .max_by(|a, b| of_sensor[*a].total_cmp(&of_sensor[*b]))
            .unwrap_or_default(),
    }))
}
