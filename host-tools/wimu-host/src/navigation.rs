//! Velocity and position of a recording: as computed by the device, and recomputed.

use wimu_integrator::{Config, Integrator, Navigation, Phase};
use wimu_link::message::{self, Environment, Epoch};
use wimu_model::{
    AngularRateQ20, CentiCelsius, DeviceTimeUs, ParameterSet, PeriodNs, PositionNm,
    STANDARD_GRAVITY_MPS2, SpecificForceQ16, VelocityNmps,
};

use crate::calibration::{Calibration, SensorCalibration};
use crate::capture::Boot;
use crate::decode::TimedSample;
use crate::imu::{BEYOND_RANGE, Imu, ImuOptions, Sample};
use crate::recording::Recording;
use crate::replay::{Correction, Replay, Step, find};
use crate::series::Ns;
use crate::stats::norm;
use crate::{Code, Problem, Result};

/// Velocity and position after one sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Point {
    /// The sample's number.
    pub sequence: u32,
    /// When it was taken, device clock.
    pub time: DeviceTimeUs,
    /// The integrator's output.
    pub navigation: Navigation,
}

/// The positions computed by the device.
pub fn device(boot: &Boot) -> Vec<Point> {
    boot.navigation
        .iter()
        .filter_map(|sent| {
            let attitude = find(&boot.attitude, sent.sequence, |sent| sent.sequence);
            Some(Point {
                sequence: sent.sequence,
                time: boot.time_of(sent.sequence)?,
                navigation: from_wire(sent, attitude.map(|sent| sent.quaternion)),
            })
        })
        .collect()
}

fn from_wire(sent: &message::Navigation, attitude: Option<[i32; 4]>) -> Navigation {
    Navigation {
        position: PositionNm(sent.position_nm),
        velocity: VelocityNmps(sent.velocity_nmps),
        since_rest_ms: sent.since_rest_ms,
        phase: sent.phase,
        flags: wimu_integrator::Flags(sent.flags),
        heading_sd_mrad: sent.heading_sd_mrad,
        attitude,
    }
}

/// The device's arithmetic applied to the recorded raw samples, from the first epoch on: equal to
/// [`device`], at every sample.
pub fn replayed(boot: &Boot) -> Vec<Point> {
    Replay::new(boot, 0)
        .filter_map(|step| match step {
            Step::Sample(sample) => Some(Point {
                sequence: sample.raw.sequence,
                time: sample.raw.time,
                navigation: sample.navigation,
            }),
            _ => None,
        })
        .collect()
}

/// The recorded raw samples corrected with these parameters, else with the latest of the device, integrated with or
/// without ZUPT.
///
/// # Errors
/// `no_rows` without an epoch; `data_refused` when the parameters cannot be compiled; `bad_recording` when those of the
/// device were not sent.
pub fn recomputed(
    boot: &Boot,
    parameters: Option<&ParameterSet>,
    zupt: bool,
) -> Result<Vec<Point>> {
    let (Some(first), Some(latest)) = (boot.epochs().first(), boot.epochs().last()) else {
        return Err(Code::NoRows.error(
            "the recording has no epoch, so the sample period is unknown",
            "record for longer than a second",
        ));
    };
    let correction = match parameters {
        Some(parameters) => {
            let first_temperature = first_temperature(boot);
            Correction::compile(parameters, &first.epoch, first_temperature).map_err(refused)?
        }
        None => Correction::at(boot, &latest.epoch, first_temperature(boot))?,
    };
    // The latest epoch has the best estimate of the true period.
    let period = PeriodNs(latest.epoch.period_ns);
    let config = Config { period, zupt, gravity_um_s2: first.epoch.state.config.gravity_um_s2 };
    let config = config.checked().map_err(refused)?;
    let mut integrator = Integrator::new(config);
    let mut next = None;
    Ok(boot
        .raw()
        .iter()
        .filter(|raw| correction.takes(raw))
        .map(|raw| {
            if next.is_some_and(|next| next != raw.sequence) {
                integrator.gap();
            }
            next = Some(raw.sequence.wrapping_add(1));
            correction.integrate(raw, &mut integrator);
            Point { sequence: raw.sequence, time: raw.time, navigation: integrator.navigation() }
        })
        .collect())
}

fn first_temperature(boot: &Boot) -> Option<CentiCelsius> {
    boot.environment.iter().find_map(|e| e.temperature_centi_c).map(CentiCelsius)
}

fn refused(error: impl std::error::Error) -> Problem {
    Code::DataRefused.error(error.to_string(), "give the calibration of this sensor")
}

/// The samples of one start as input of [`crate::inertial::navigate`]: the raw ones corrected with this calibration, else with
/// the latest of the device; without raw samples, or where its range changed, as the device corrected each. The magnetic field
/// is left out where the magnetometer is not calibrated.
///
/// # Errors
/// `no_rows` with fewer than two samples; those of [`SensorCalibration::compile`]; `data_refused` with a calibration where the
/// range changed.
pub fn motion(name: &str, boot: &Boot, calibration: Option<&SensorCalibration>) -> Result<Imu> {
    let Some(options) = calibration.map(ImuOptions::of).or_else(|| held(boot)) else {
        return corrected_by_device(name, boot);
    };
    if boot.raw().len() < 2 {
        let message = "fewer than two raw samples can be corrected";
        let remedy = "switch the raw stream on with `wimu device settings set`, and record again";
        return Err(Code::NoRows.error(message, remedy).at(name));
    }
    let mut imu = Imu::of(&Recording::of_boot(boot, name)?, &options)?;
    let calibrated = options.calibration.is_some_and(|own| own.magnetometer.is_some());
    if !calibrated && imu.samples.v.iter().any(|sample| sample.field_ut.is_some()) {
        imu.samples.v.iter_mut().for_each(|sample| sample.field_ut = None);
        imu.field_uncalibrated = true;
    }
    if imu.field_uncalibrated && calibration.is_none() {
        imu.findings.extend(boot.unknown_source());
    }
    Ok(imu)
}

/// What corrects all raw samples of a device: its latest parameters; `None` where it has no raw samples, sent no parameters, or
/// its range changed.
fn held(boot: &Boot) -> Option<ImuOptions> {
    let latest = &boot.epochs().last()?.epoch;
    let range = |epoch: &Epoch| (epoch.range_g, epoch.gyroscope.map(|own| own.rad_s_per_lsb));
    let one_range = boot.epochs().iter().all(|mark| range(&mark.epoch) == range(latest));
    if boot.raw().is_empty() || !one_range {
        return None;
    }
    let set = boot.parameters_of(latest).ok()?;
    let mut options = ImuOptions::of(Calibration::held(&set).sensor());
    options.calibration = options.calibration.filter(|_| latest.parameters != 0);
    options.sensitivity_lsb_per_g = Some(set.sensitivity.lsb_per_g());
    Some(options)
}

/// The samples as the device corrected them.
fn corrected_by_device(name: &str, boot: &Boot) -> Result<Imu> {
    type Corrected = (DeviceTimeUs, SpecificForceQ16, Option<AngularRateQ20>);
    let sent = |sample: &TimedSample| {
        (sample.time, SpecificForceQ16(sample.value), sample.rate.map(AngularRateQ20))
    };
    let replayed = |step: Step| match step {
        Step::Sample(sample) => Some((sample.raw.time, sample.force, sample.rate)),
        _ => None,
    };
    let forces: Vec<Corrected> = if boot.epochs().is_empty() || boot.raw().is_empty() {
        boot.corrected().iter().map(sent).collect()
    } else {
        Replay::new(boot, 0).filter_map(replayed).collect()
    };
    if forces.len() < 2 {
        return Err(Code::NoRows
            .error("fewer than two samples can be corrected", "record for longer than a second")
            .at(name));
    }
    let field = |e: &Environment| Some((e.time_us, boot.corrected_field_nt(e)?));
    let mut fields = boot.environment.iter().filter_map(field).peekable();
    let mut imu = Imu::new(name);
    for (time, force, rate) in &forces {
        // Each field belongs to the first sample after it.
        let mut field_ut = None;
        while let Some((_, nt)) = fields.next_if(|(at, _)| *at <= time.0) {
            field_ut = Some(nt.map(|axis| axis * 1e-3).into());
        }
        let sample = Sample {
            step_s: 0.0,
            force_mps2: force.to_mps2().0.into(),
            field_ut,
            rate_rad_s: rate.map(|rate| rate.to_rad_s().into()),
        };
        imu.push(Ns(time.0.cast_signed().saturating_mul(1000)), sample);
    }
    let range_g = boot.epochs().iter().map(|mark| mark.epoch.range_g).max();
    imu.full_scale_mps2 = range_g.map(|g| f64::from(g) * STANDARD_GRAVITY_MPS2 * BEYOND_RANGE);
    let has_field = boot.environment.iter().any(|e| e.magnetic_field_nt.is_some());
    imu.field_uncalibrated = has_field && imu.samples.v.iter().all(|s| s.field_ut.is_none());
    if imu.field_uncalibrated {
        imu.findings.extend(boot.unknown_source());
    }
    Ok(imu)
}

/// Length of the path through the valid `points`, m.
pub fn path_length_m(points: &[Point]) -> f64 {
    points
        .windows(2)
        .filter(|pair| pair[1].navigation.phase != Phase::Searching)
        .map(|pair| {
            let [from, to] = [pair[0], pair[1]].map(|p| p.navigation.position.to_m());
            distance_m(from, to)
        })
        .sum()
}

/// Distance between two positions, m.
pub fn distance_m(from: [f64; 3], to: [f64; 3]) -> f64 {
    norm([0, 1, 2].map(|axis| to[axis] - from[axis]))
}
