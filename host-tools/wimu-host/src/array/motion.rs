//! The motion of a body with an array: its angular rate, and where it is.

use wimu_nav::array::{
    ArrayConfig, ArrayFault, ArrayFilter, ArraySolver, ArrayState, Axis, Geometry, Observation,
    Spread, Step, track,
};

use super::calibration::BIAS_MPS2;
use super::fit::{Agreement, Fitted};
use super::{ArrayCalibration, ArrayGeometry, ArrayRecording};
use crate::inertial::Zupt;
use crate::plural::counted;
use crate::{Code, Problem, Result};

/// Output that stands for a sensor at its limit, m/s².
pub(super) const AT_LIMIT_MPS2: f64 = 1e6;

/// The angular rate of a body through a recording, from accelerometers alone.
#[derive(Clone, Debug)]
pub struct ArrayMotion {
    /// ω from all samples, rad/s, body axes.
    pub rate_rad_s: Vec<[f64; 3]>,
    /// Its covariance, (rad/s)², with what errors of lever arms and time stamps add: equations (102), (105).
    pub rate_covariance: Vec<[[f64; 3]; 3]>,
    /// How the angular rate moves, found from the recording.
    pub spread: Spread,
    /// Mean NIS per degree of freedom.
    pub nis: f64,
}

/// Calls a function for the room that the sensors need.
macro_rules! with_room {
    ($sensors:expr, $function:ident ( $($argument:expr),* )) => {
        match $sensors {
            0..=4 => $function::<12>($($argument),*),
            5..=8 => $function::<24>($($argument),*),
            9..=16 => $function::<48>($($argument),*),
            many => Err(Code::Usage.error(format!("{many} sensors are more than 16"),
                "leave some out",
            )),
        }
    };
}
pub(super) use with_room;

/// A recording of an array in body axes ([`ArrayRecording::arranged`]) with its geometry and calibration, fitted to the motion of
/// one rigid body: equation (99).
#[derive(Debug)]
pub struct ArrayBody<'a> {
    recording: &'a ArrayRecording,
    geometry: &'a ArrayGeometry,
    calibration: &'a ArrayCalibration,
    agreement: Option<Agreement>,
    /// Standard deviation of a coordinate of the positions, m.
    place_sd_m: f64,
}

impl<'a> ArrayBody<'a> {
    /// Fits the recording.
    ///
    /// # Errors
    /// `usage` when the numbers of sensors differ or are more than 16; `data_refused` when the geometry
    /// shows no angular rate.
    pub fn of(
        recording: &'a ArrayRecording,
        geometry: &'a ArrayGeometry,
        calibration: &'a ArrayCalibration,
    ) -> Result<Self> {
        let fitted = Fitted::of(recording, geometry, calibration, &calibration.prior())?;
        Ok(Self {
            recording,
            geometry,
            calibration,
            place_sd_m: fitted.shown_position_sd_m(calibration, calibration.place_sd_m),
            agreement: fitted.agreement,
        })
    }

    /// Agreement of the sensors; `None` where too few samples are in motion, or motion explains everything.
    pub fn agreement(&self) -> Option<&Agreement> {
        self.agreement.as_ref()
    }

    /// The angular rate from the whole recording, later samples too. Samples in which a sensor that is used has no output are
    /// carried over.
    ///
    /// # Errors
    /// `data_refused` when the geometry shows no angular rate.
    pub fn angular_rate(&self) -> Result<ArrayMotion> {
        with_room!(self.geometry.sensors.len(), smoothed(self))
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
    ) -> Result<(Vec<ArrayState<f64>>, Vec<String>)> {
        with_room!(self.geometry.sensors.len(), filtered(self, gravity_mps2, zupt))
    }
}

pub(super) fn check(recording: &ArrayRecording, geometry: &ArrayGeometry) -> Result<()> {
    if !geometry.axes.is_empty() {
        return Err(Code::Usage.error(
            "single axes are neither calibrated nor refined: nothing tells their errors apart",
            "navigate with the geometry as it is; for a calibration give triads",
        ));
    }
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

/// The axes as the solver wants them: those of sensor k at 3 k.
pub(super) fn axes<const M: usize>(
    geometry: &ArrayGeometry,
    calibration: &ArrayCalibration,
) -> Result<Geometry<M>> {
    axes_of(geometry, &calibration.noise_mps2)
}

/// The same for a given noise of each sensor, m/s².
pub(super) fn axes_of<const M: usize>(
    geometry: &ArrayGeometry,
    noise_mps2: &[f64],
) -> Result<Geometry<M>> {
    let sensors = geometry.sensors.iter().zip(noise_mps2);
    let axes = sensors.flat_map(|(sensor, noise)| {
        (0..3).map(|axis| Axis {
            position_m: sensor.places_m[axis],
            direction: std::array::from_fn(|i| if i == axis { 1.0 } else { 0.0 }),
            noise_mps2: *noise,
        })
    });
    Geometry::from_grouped_axes(&axes.collect::<Vec<_>>(), 3).map_err(refused)
}

/// One sample of all axes, corrected; a sensor that is not used is not a number, one at its limit far
/// beyond any.
pub(super) fn sample<const M: usize>(
    recording: &ArrayRecording,
    calibration: &ArrayCalibration,
    index: usize,
) -> [f64; M] {
    sample_since(recording, calibration, index, calibration.offset_of(index))
}

/// The same without what the sensors added at rest `rest`.
fn sample_since<const M: usize>(
    recording: &ArrayRecording,
    calibration: &ArrayCalibration,
    index: usize,
    rest: usize,
) -> [f64; M] {
    let mut output = [0.0; M];
    for (sensor, value) in recording.outputs[index].iter().enumerate() {
        let force = if !calibration.uses(sensor) {
            [f64::NAN; 3]
        } else if recording.saturated[index] >> sensor & 1 == 1 {
            [AT_LIMIT_MPS2; 3]
        } else {
            calibration.force_since(sensor, *value, rest)
        };
        output[3 * sensor..3 * sensor + 3].copy_from_slice(&force);
    }
    output
}

fn smoothed<const M: usize>(body: &ArrayBody<'_>) -> Result<ArrayMotion> {
    let (recording, geometry, calibration) = (body.recording, body.geometry, body.calibration);
    let axes = axes::<M>(geometry, calibration)?;
    let solver =
        ArraySolver::<f64, M>::of(&axes, |sensor| calibration.uses(sensor)).map_err(refused)?;
    let mut last = recording.times_s[0];
    let observations: Vec<Observation> = (0..recording.times_s.len())
        .map(|index| {
            let mut output = sample::<M>(recording, calibration, index);
            let sound = (0..recording.sensors()).all(|sensor| {
                let used = calibration.uses(sensor);
                let axes = &mut output[3 * sensor..3 * sensor + 3];
                let good = axes.iter().all(|v| v.abs() < AT_LIMIT_MPS2);
                if !used {
                    axes.fill(0.0);
                }
                good || !used
            });
            let linear = solver.reduce(&output);
            let step_s = recording.times_s[index] - last;
            last = recording.times_s[index];
            Observation {
                step_s,
                linear: sound.then_some(linear),
                excess: solver.excess(&output, &linear).filter(|_| sound).unwrap_or(1.0),
            }
        })
        .collect();
    let mut steps = vec![Step::default(); observations.len()];
    let found = track(&solver, solver.variance_mps2(), &observations, &mut steps)
        .ok_or_else(|| refused("the sensors' places show no angular rate"))?;
    let relative = solver.rate_error(body.place_sd_m);
    Ok(ArrayMotion {
        rate_rad_s: steps.iter().map(|s| s.rate_rad_s).collect(),
        rate_covariance: steps.iter().map(|s| reported(s, relative)).collect(),
        spread: found.spread,
        nis: found.nis,
    })
}

/// Covariance of the angular rate with the errors of the lever arms, equation (105), and of the time stamps, (102).
fn reported(step: &Step, relative: f64) -> [[f64; 3]; 3] {
    let late = (step.angular_acceleration_rad_s2).map(|w| w * ArrayConfig::default().time_sd_s);
    let arms = relative * relative * step.rate_rad_s.iter().map(|w| w * w).sum::<f64>();
    let mut covariance = step.covariance;
    for (i, row) in covariance.iter_mut().enumerate() {
        for (value, other) in row.iter_mut().zip(late) {
            *value += late[i] * other;
        }
        row[i] += arms;
    }
    covariance
}

/// Whether the rate may be zero: within three of its deviations.
fn may_rest(state: Option<&ArrayState<f64>>) -> bool {
    state.is_none_or(|state| {
        let rate = state.rate_rad_s;
        let square: f64 = rate.iter().map(|w| w * w).sum();
        let along: f64 = (0..3)
            .flat_map(|i| (0..3).map(move |j| rate[i] * state.rate_covariance[i][j] * rate[j]))
            .sum();
        square * square <= 9.0 * along
    })
}

fn filtered<const M: usize>(
    body: &ArrayBody<'_>,
    gravity_mps2: f64,
    zupt: Zupt,
) -> Result<(Vec<ArrayState<f64>>, Vec<String>)> {
    let (recording, geometry, calibration) = (body.recording, body.geometry, body.calibration);
    let axes = axes::<M>(geometry, calibration)?;
    let used = (0..recording.sensors()).filter(|sensor| calibration.uses(*sensor)).count();
    let config = ArrayConfig {
        gravity_mps2,
        rests: zupt.rests(),
        range_mps2: AT_LIMIT_MPS2,
        // What the sensors differ by at the rests is taken off them: their mean bias is left.
        bias_mps2: BIAS_MPS2,
        common_bias_mps2: (calibration.bias_mps2.powi(2) - BIAS_MPS2.powi(2)).max(0.0).sqrt()
            / (used.max(1) as f64).sqrt(),
        scale: calibration.scale,
        common_scale: calibration.common_scale,
        place_sd_m: body.place_sd_m,
        delay_sd_s: calibration.delay_sd_s,
        ..ArrayConfig::default()
    };
    let filter = ArrayFilter::<M>::new(axes, config).map_err(refused)?;
    let mut offset = calibration.offset_of(0);
    let uses = |sensor: usize| calibration.uses(sensor);
    Ok(followed(recording, filter, zupt, &uses, |filter, index, state| {
        // An even turn about the vertical may look like a rest: a window with a measured rate other than zero is not a rest.
        if calibration.offset_of(index) != offset && may_rest(state) {
            offset = calibration.offset_of(index);
            filter.residual_biases_taken_off();
        }
        sample_since::<M>(recording, calibration, index, offset)
    }))
}

/// What a filter knows after each sample of a recording, and what it met on the way; `output` is told the state before.
pub(super) fn followed<const M: usize>(
    recording: &ArrayRecording,
    mut filter: ArrayFilter<M>,
    zupt: Zupt,
    uses: &dyn Fn(usize) -> bool,
    mut output: impl FnMut(&mut ArrayFilter<M>, usize, Option<&ArrayState<f64>>) -> [f64; M],
) -> (Vec<ArrayState<f64>>, Vec<String>) {
    let mut states = Vec::with_capacity(recording.times_s.len());
    let (mut gaps, mut backwards, mut blind) = (0_usize, 0_usize, 0_usize);
    let mut saturated = 0_usize;
    let mut moving_start = None;
    let mut without = vec![0_usize; recording.sensors()];
    let mut last = recording.times_s[0];
    // Start of the path since the last rest, and rests whose test failed.
    let (mut start, mut recoveries) = (0, 0);
    for (index, time) in recording.times_s.iter().enumerate() {
        let output = output(&mut filter, index, states.last());
        let pushed = filter.push(time - last, &output);
        last = last.max(*time);
        match pushed {
            Ok(dropped) => {
                saturated += usize::from(dropped.saturated != 0);
                for (sensor, count) in without.iter_mut().enumerate() {
                    *count += (dropped.dead >> sensor & 1) as usize;
                }
            }
            Err(ArrayFault::Gap) => gaps += 1,
            Err(ArrayFault::NoTime) => backwards += 1,
            Err(_) => blind += 1,
        }
        let state = filter.state();
        // Aligned: whether at rest.
        if state.certainty > 0.0 {
            moving_start.get_or_insert(!state.valid);
        }
        states.push(state);
        if filter.recoveries() != recoveries {
            recoveries = filter.recoveries();
            for state in &mut states[start..index] {
                state.valid = false;
            }
        }
        if state.resting && zupt.is_on() {
            start = index + 1;
        }
    }
    let mut remarks = Vec::new();
    if moving_start == Some(true) {
        remarks.push(
            "no rest at the start: neither velocity nor attitude are known before the first rest, where \
             the position begins"
                .to_owned(),
        );
    } else if !zupt.is_on() {
        remarks.push(
            "it stands still at the start: its velocity and angular rate are taken for zero there"
                .to_owned(),
        );
    }
    let mut remark = |count: usize, one: &str, what: &str| {
        if count > 0 {
            remarks.push(format!("{} {what}", counted(count, one)));
        }
    };
    remark(
        gaps,
        "gap",
        "longer than 0.25 s: how far it went in one is not known: position is uncertain from there on, and not valid before the next rest",
    );
    remark(backwards, "sample", "whose time stood still or went back: left out");
    remark(saturated, "sample", "without the sensors that were at their limit");
    remark(blind, "sample", "with too few sensors: the angular rate is carried over");
    remark(
        recoveries as usize,
        "rest",
        "at which the estimated velocity was not zero: the path since the rest before is not valid; check \
         the positions of the sensors and their sensitivity",
    );
    let absent = without.iter().enumerate();
    let absent = absent.filter(|(sensor, count)| **count > 0 && uses(*sensor));
    let absent: Vec<String> =
        absent.map(|(sensor, count)| format!("{count} of sensor {sensor}")).collect();
    if !absent.is_empty() {
        remarks.push(format!(
            "samples that a sensor (from 0) did not give, or that were left out: {}",
            absent.join(", ")
        ));
    }
    (states, remarks)
}
