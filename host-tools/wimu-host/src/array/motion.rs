//! The motion of a body with an array: its angular rate, and where it is.

use nalgebra::{Matrix3, Vector3};
use wimu_nav::array::{ArrayConfig, ArrayFault, ArrayFilter, ArrayState, Axis, Geometry};

use super::calibration::BIAS_MPS2;
use super::{Agreement, Array, ArrayCalibration, ArrayGeometry};
use crate::inertial::Zupt;
use crate::plural::counted;
use crate::{Code, Problem, Result};

/// Squared difference of the angular rates of both directions of time, over their covariances, from which they contradict each
/// other: χ² with three degrees of freedom, probability 10⁻³.
const CONTRADICTS: f64 = 16.3;

/// A recording of an array in body axes ([`Array::arranged`]) with its geometry and calibration.
#[derive(Debug)]
pub struct ArrayBody<'a> {
    recording: &'a Array,
    geometry: &'a ArrayGeometry,
    calibration: &'a ArrayCalibration,
    /// Agreement of the sensors; `None` with too few samples in motion, or where motion explains everything.
    pub agreement: Option<Agreement>,
}

impl<'a> ArrayBody<'a> {
    /// Judges whether the sensors agree.
    ///
    /// # Errors
    /// Those of [`Agreement::of`].
    pub fn of(
        recording: &'a Array,
        geometry: &'a ArrayGeometry,
        calibration: &'a ArrayCalibration,
    ) -> Result<Self> {
        let agreement = Agreement::of(recording, geometry, calibration)?;
        Ok(Self { recording, geometry, calibration, agreement })
    }

    /// What the filter of the array knows after each sample, from the samples up to it, and what it met on
    /// the way. `gravity_mps2` is the length of gravity in the recording's own scale.
    ///
    /// # Errors
    /// `data_refused` when the geometry shows no angular acceleration or specific force.
    pub fn navigated(
        &self,
        gravity_mps2: f64,
        zupt: Zupt,
    ) -> Result<(Vec<ArrayState>, Vec<String>)> {
        let pass = filtered(self, gravity_mps2, zupt, false)?;
        let remarks = pass.remarks(zupt, self.calibration);
        Ok((pass.states, remarks))
    }

    /// Angular rate, rad/s, and its covariance from the whole recording: that of `states` and that of the filter in reversed time,
    /// in which the body rotates the other way, by covariance intersection (S. Julier and J. Uhlmann, "A non-divergent
    /// estimation algorithm in the presence of unknown correlations", American Control Conference, 1997), equation (80).
    ///
    /// # Errors
    /// Those of [`navigated`](Self::navigated).
    pub fn smooth_rates(
        &self,
        states: &mut [ArrayState],
        gravity_mps2: f64,
        zupt: Zupt,
    ) -> Result<()> {
        let mut reversed = filtered(self, gravity_mps2, zupt, true)?;
        reversed.states.reverse();
        for (state, other) in states.iter_mut().zip(&reversed.states) {
            let other = (-Vector3::from(other.rate_rad_s), other.rate_covariance.into());
            let own = (state.rate_rad_s.into(), state.rate_covariance.into());
            let (rate, covariance) = intersection(own, other);
            (state.rate_rad_s, state.rate_covariance) = (rate.into(), covariance.into());
        }
        Ok(())
    }
}

type Rate = (Vector3<f64>, Matrix3<f64>);

/// Of two estimates whose errors may be correlated; the surer one where they contradict each other.
fn intersection(a: Rate, b: Rate) -> Rate {
    let surer = if a.1.trace() <= b.1.trace() { a } else { b };
    let Some((p, q)) = a.1.try_inverse().zip(b.1.try_inverse()) else {
        return surer;
    };
    let apart = a.0 - b.0;
    let distance = (a.1 + b.1).try_inverse().map_or(f64::NAN, |sum| apart.dot(&(sum * apart)));
    let covariance = ((p + q) * 0.5).try_inverse().filter(|_| distance < CONTRADICTS);
    covariance.map_or(surer, |covariance| (covariance * (p * a.0 + q * b.0) * 0.5, covariance))
}

pub(super) fn check(recording: &Array, geometry: &ArrayGeometry) -> Result<()> {
    if geometry.sensors.len() == recording.sensors() {
        return Ok(());
    }
    Err(Code::Usage
        .error(
            format!(
                "the geometry has {} sensors, the recording {}",
                geometry.sensors.len(),
                recording.sensors()
            ),
            format!(
                "give one line with the place of each sensor, in their order: {}",
                if geometry.sensors.len() < recording.sensors() {
                    format!(
                        "the places from sensor {} (from 0) on are missing",
                        geometry.sensors.len()
                    )
                } else {
                    format!(
                        "columns from `Accelerometer {} X` on are missing, or leave lines out",
                        recording.sensors()
                    )
                }
            ),
        )
        .at(&recording.name))
}

pub(super) fn refused(message: impl ToString) -> Problem {
    Code::DataRefused.error(
        message.to_string(),
        "four triads and more, not in a plane, show the angular rate best",
    )
}

/// The axes as the solver wants them, those of sensor k at 3 k, for a noise of each sensor, m/s².
pub(super) fn axes(geometry: &ArrayGeometry, noise_mps2: &[f64]) -> Result<Geometry> {
    let sensors = geometry.sensors.iter().zip(noise_mps2);
    let axes = sensors.flat_map(|(sensor, noise)| {
        (0..3).map(|axis| Axis {
            position_m: sensor.places_m[axis],
            direction: std::array::from_fn(|i| if i == axis { 1.0 } else { 0.0 }),
            noise_mps2: *noise,
        })
    });
    Geometry::new(axes, 3).map_err(refused)
}

/// One sample of all axes, corrected, without what the sensors added at rest `rest`; a sensor that is not used or at its limit
/// is not a number.
pub(super) fn sample(
    recording: &Array,
    calibration: &ArrayCalibration,
    index: usize,
    rest: usize,
) -> Vec<f64> {
    let force = |sensor: usize| {
        if calibration.uses(sensor) && !recording.is_saturated(index, sensor) {
            calibration.force_since(sensor, recording.output(index, sensor), rest)
        } else {
            [f64::NAN; 3]
        }
    };
    (0..recording.sensors()).flat_map(force).collect()
}

/// Whether the rate may be zero: within three of its deviations.
fn may_rest(state: Option<&ArrayState>) -> bool {
    state.is_none_or(|state| {
        let rate = Vector3::from(state.rate_rad_s);
        let along = rate.dot(&(Matrix3::from(state.rate_covariance) * rate));
        rate.norm_squared().powi(2) <= 9.0 * along
    })
}

/// What a filter knew after each sample, and what it met on the way.
struct Pass {
    states: Vec<ArrayState>,
    /// Whether it began in motion, once that is known.
    moving_start: bool,
    gaps: usize,
    saturated: usize,
    blind: usize,
    recoveries: usize,
    /// Samples without each sensor.
    without: Vec<usize>,
}

/// Runs the filter over the recording, or over the same in reversed time.
fn filtered(body: &ArrayBody<'_>, gravity_mps2: f64, zupt: Zupt, reversed: bool) -> Result<Pass> {
    let (recording, calibration) = (body.recording, body.calibration);
    let axes = axes(body.geometry, &calibration.noise_mps2)?;
    let used = (0..recording.sensors()).filter(|sensor| calibration.uses(*sensor)).count();
    let config = ArrayConfig {
        gravity_mps2,
        rests: zupt.rests(),
        // What the sensors differ by at the rests is taken off them: their mean bias is left.
        bias_mps2: BIAS_MPS2,
        common_bias_mps2: (calibration.bias_mps2.powi(2) - BIAS_MPS2.powi(2)).max(0.0).sqrt()
            / (used.max(1) as f64).sqrt(),
        scale: calibration.scale,
        common_scale: calibration.common_scale,
        place_sd_m: body.agreement.as_ref().map_or(calibration.place_sd_m, |agreement| {
            agreement.place_sd_m(calibration.place_sd_m)
        }),
        delay_sd_s: calibration.delay_sd_s,
        ..ArrayConfig::default()
    };
    let mut filter = ArrayFilter::new(axes, config).map_err(refused)?;
    let (times, count) = (recording.times(), recording.len());
    let order = |k: usize| if reversed { count - 1 - k } else { k };
    let mut pass = Pass {
        states: Vec::with_capacity(count),
        moving_start: false,
        gaps: 0,
        saturated: 0,
        blind: 0,
        recoveries: 0,
        without: vec![0; recording.sensors()],
    };
    let mut offset = calibration.offset_of(order(0));
    let (mut begun, mut last) = (false, times[order(0)]);
    // Start of the path since the last rest.
    let mut start = 0;
    for k in 0..count {
        let index = order(k);
        // An even turn about the vertical may look like a rest: a window with a measured rate other than zero is not a rest.
        let rest = calibration.offset_of(index);
        if rest != offset && may_rest(pass.states.last()) {
            offset = rest;
            filter.residual_biases_taken_off();
        }
        let time = times[index];
        let step_s = time.since_s(last).abs();
        let pushed = filter.push(step_s, &sample(recording, calibration, index, offset));
        last = time;
        match pushed {
            Ok(absent) => {
                let at_limit = |sensor| recording.is_saturated(index, sensor);
                let used = |sensor: &usize| calibration.uses(*sensor);
                pass.saturated += usize::from((0..pass.without.len()).filter(used).any(at_limit));
                for (sensor, count) in pass.without.iter_mut().enumerate() {
                    *count += usize::from(absent >> sensor & 1 == 1 && !at_limit(sensor));
                }
            }
            Err(ArrayFault::Gap) => pass.gaps += 1,
            Err(_) => pass.blind += 1,
        }
        let state = filter.state();
        // Aligned: whether at rest.
        if state.certainty > 0.0 && !begun {
            (begun, pass.moving_start) = (true, !state.valid);
        }
        pass.states.push(state);
        if filter.recoveries() as usize != pass.recoveries {
            pass.recoveries = filter.recoveries() as usize;
            pass.states[start..k].iter_mut().for_each(|state| state.valid = false);
        }
        if state.resting && zupt.is_on() {
            start = k + 1;
        }
    }
    Ok(pass)
}

impl Pass {
    fn remarks(&self, zupt: Zupt, calibration: &ArrayCalibration) -> Vec<String> {
        let mut remarks = Vec::new();
        if self.moving_start {
            remarks.push(
                "no rest at the start: neither velocity nor attitude are known before the first rest, where \
                 the position begins"
                    .to_owned(),
            );
        } else if !zupt.is_on() {
            remarks.push(
                "at rest at the start: velocity and angular rate are taken as zero there"
                    .to_owned(),
            );
        }
        let met = [
            (
                self.gaps,
                "gap",
                "longer than 0.25 s: the displacement within one is unknown, and position is not valid until the next rest",
            ),
            (self.saturated, "sample", "without the sensors that were at their limit"),
            (self.blind, "sample", "with too few sensors: the angular rate is carried over"),
            (
                self.recoveries,
                "rest",
                "at which the estimated velocity is not zero: the path since the rest before is not valid; check positions and sensitivity of the sensors",
            ),
        ];
        let met = met.into_iter().filter(|(count, ..)| *count > 0);
        remarks.extend(met.map(|(count, one, what)| format!("{} {what}", counted(count, one))));
        let absent = self.without.iter().enumerate();
        let absent = absent.filter(|(sensor, count)| **count > 0 && calibration.uses(*sensor));
        let absent: Vec<String> =
            absent.map(|(sensor, count)| format!("{count} of sensor {sensor}")).collect();
        if !absent.is_empty() {
            remarks.push(format!(
                "samples that a sensor (from 0) did not give, or that were left out: {}",
                absent.join(", ")
            ));
        }
        remarks
    }
}
