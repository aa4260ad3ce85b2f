//! Velocity and position of a recording: as computed by the device, and recomputed.

use wimu_integrator::{Config, Integrator, Navigation, Phase};
use wimu_link::message::{self, Epoch};
use wimu_model::{
    AngularRateQ20, CentiCelsius, DeviceTimeUs, MagneticFieldNt, ParameterSet, PeriodNs,
    PositionNm, SpecificForceQ16, VelocityNmps,
};

use crate::calibration;
use crate::capture::Boot;
use crate::decode::TimedSample;
use crate::imu::{Imu, Sample};
use crate::multi_range::{FullScales, Merge};
use crate::recording::{Quantity, Recording};
use crate::replay::{Correction, Replay, Step, find};
use crate::series::Ns;
use crate::stats::norm;
use crate::stream::Part;
use crate::{Code, Problem, Result};

/// Largest specific force after correction per *g* of full-scale range, m/s²: 1.5 g.
const BEYOND_RANGE: f64 = 1.5 * wimu_model::STANDARD_GRAVITY_MPS2;

/// m/s² per *g*.
const G: f64 = wimu_model::STANDARD_GRAVITY_MPS2;

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
        Some(parameters) => correction(boot, &first.epoch, parameters)?,
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

/// The correction of raw samples with other parameters than the device's, at the first temperature.
fn correction(boot: &Boot, epoch: &Epoch, parameters: &ParameterSet) -> Result<Correction> {
    Correction::compile(parameters, epoch, first_temperature(boot)).map_err(refused)
}

fn first_temperature(boot: &Boot) -> Option<CentiCelsius> {
    boot.environment.iter().find_map(|e| e.temperature_centi_c).map(CentiCelsius)
}

fn refused(error: impl std::error::Error) -> Problem {
    Code::DataRefused.error(error.to_string(), "give the calibration of this sensor")
}

/// The samples of one start as input of [`crate::inertial::navigate`], with the magnetic field where the
/// magnetometer is calibrated; corrected with these parameters, else with those of the device: where it got
/// others meanwhile, with the latest.
///
/// # Errors
/// `no_rows` with fewer than two samples; `data_refused` when the parameters cannot be compiled.
pub fn motion(name: &str, boot: &Boot, parameters: Option<&ParameterSet>) -> Result<Imu> {
    type Corrected = (DeviceTimeUs, (SpecificForceQ16, Option<AngularRateQ20>));
    let is_given = parameters.is_some();
    let latest = if is_given { None } else { replaced(boot) };
    let correction = match (parameters, &latest, boot.epochs().first()) {
        (Some(parameters), _, Some(first)) => Some(correction(boot, &first.epoch, parameters)?),
        (None, Some((epoch, _)), _) => Some(Correction::at(boot, epoch, first_temperature(boot))?),
        _ => None,
    };
    let parameters = parameters.or(latest.as_ref().map(|(_, set)| set));
    let forces: Vec<Corrected> = match (correction, boot.epochs().first()) {
        (Some(correction), _) => {
            let correct = |raw: &TimedSample| (raw.time, correction.correct(raw));
            boot.raw().iter().map(correct).collect()
        }
        (None, _) if is_given => Vec::new(),
        (None, first) if first.is_none() || boot.raw().is_empty() => boot
            .corrected()
            .iter()
            .map(|sent| {
                let rate = sent.rate.map(AngularRateQ20);
                (sent.time, (SpecificForceQ16(sent.value), rate))
            })
            .collect(),
        (None, _) => Replay::new(boot, 0)
            .filter_map(|step| match step {
                Step::Sample(sample) => Some((sample.raw.time, (sample.force, sample.rate))),
                _ => None,
            })
            .collect(),
    };
    if forces.len() < 2 {
        return Err(Code::NoRows
            .error("fewer than two samples can be corrected", "record for longer than a second")
            .at(name));
    }
    let mut fields = boot
        .environment
        .iter()
        .filter_map(|e| {
            let field_nt = match parameters {
                Some(set) => set.correct_field(MagneticFieldNt(e.magnetic_field_nt?)),
                None => boot.corrected_field_nt(e),
            }?;
            Some((e.time_us, field_nt.map(|b| b * 1e-3)))
        })
        .peekable();
    let mut recording = Imu::new(name);
    for (time, (force, rate)) in &forces {
        // Each field belongs to the first sample after it.
        let mut field_ut = None;
        while let Some((_, field)) = fields.next_if(|(at, _)| *at <= time.0) {
            field_ut = Some(field.into());
        }
        let sample = Sample {
            step_s: 0.0,
            force_mps2: force.to_mps2().0.into(),
            field_ut,
            rate_rad_s: rate.map(|rate| rate.to_rad_s().into()),
        };
        recording.push(Ns(time.0.cast_signed().saturating_mul(1000)), sample);
    }
    let range_g = boot.epochs().iter().map(|mark| mark.epoch.range_g).max();
    recording.full_scale_mps2 = range_g.map(|g| f64::from(g) * BEYOND_RANGE);
    let has_field = boot.environment.iter().any(|e| e.magnetic_field_nt.is_some());
    recording.field_uncalibrated =
        has_field && recording.samples.v.iter().all(|s| s.field_ut.is_none());
    if recording.field_uncalibrated && !is_given {
        recording.findings.extend(boot.unknown_source());
    }
    if boot.samples.keys().any(|(sensor, _)| *sensor > 0) && !boot.raw().is_empty() {
        widen(&mut recording, boot, parameters)?;
    }
    Ok(recording)
}

/// The latest parameters of a device that had others before, with an epoch, if they are known and belong to the range of
/// all samples.
fn replaced(boot: &Boot) -> Option<(&Epoch, ParameterSet)> {
    let (first, last) = (&boot.epochs().first()?.epoch, &boot.epochs().last()?.epoch);
    if first.parameters == last.parameters || boot.raw().is_empty() {
        return None;
    }
    let one_range = boot.epochs().iter().all(|mark| mark.epoch.range_g == last.range_g);
    let set = boot.parameters_of(last).ok().filter(|_| one_range)?;
    Some((last, set))
}

/// Merges further accelerometers of other ranges with the first. Where that is not possible, the first stays as it is.
fn widen(motion: &mut Imu, boot: &Boot, parameters: Option<&ParameterSet>) -> Result<()> {
    let (Some(first), Some(mark)) = (boot.raw().first(), boot.epochs().first()) else {
        return Ok(());
    };
    let merge = Recording::of_boot(boot, &motion.name)
        .and_then(|recording| Merge::of(&recording, &FullScales::default()));
    let merge = match merge {
        Ok(Some(merge)) => merge,
        Ok(None) => return Ok(()),
        Err(error) => {
            let finding = Code::Navigation.warning(format!("not merged: {}", error.text));
            motion.findings.push(finding.remedy(error.remedy));
            return Ok(());
        }
    };
    let set = match parameters {
        Some(set) => *set,
        None => boot.parameters_of(&mark.epoch)?,
    };
    let Some(track) = merge.recording.first(Quantity::SpecificForce) else {
        return Ok(());
    };
    let (part, correction) = (Part::from(boot), calibration::Correction::from(&set));
    let mut rows = track.times_ns().iter().enumerate().peekable();
    for (time, sample) in motion.samples.t.iter().zip(&mut motion.samples.v) {
        let time_us = (time.0 / 1000) as u64;
        let since_ns = time_us.wrapping_sub(first.time.0) as i64 * 1000;
        while rows.next_if(|(_, time_ns)| **time_ns < since_ns).is_some() {}
        let Some((row, _)) = rows.next_if(|(_, time_ns)| **time_ns == since_ns) else {
            continue;
        };
        let Some(Ok(counts)) = track.row(row).map(<[f64; 3]>::try_from) else {
            continue;
        };
        let celsius = part.environment_at(DeviceTimeUs(time_us));
        let celsius = celsius.and_then(|known| known.temperature_centi_c);
        let celsius = celsius.map(|centi| f64::from(centi) * 1e-2);
        sample.force_mps2 = correction.sample(counts, celsius).into();
    }
    motion.full_scale_mps2 = track.info.full_scale.map(|full| full * BEYOND_RANGE / G);
    motion.findings.extend(merge.findings);
    Ok(())
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
