//! Noise of a recording at rest from the Allan deviation.

mod file;
mod page;
mod sensor;

pub use file::{noise, noise_of};
pub use sensor::{GyroscopeAxis, SensorNoise};

use serde::Serialize;
use wimu_calib::{AllanPoint, AllanVariance, AxisNoise, Measured};
use wimu_link::batch::Stream;
use wimu_model::{STANDARD_GRAVITY_MPS2, Sensitivity};

use crate::decode::Event;
use crate::problem::Outcome;
use crate::recording::RateSource;
use crate::{Code, Result};

/// A number and its standard deviation, 1 σ.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Figure {
    /// The number.
    pub value: f64,
    /// Its standard deviation.
    pub sd: f64,
    /// 95 % confidence interval.
    pub interval_95: [f64; 2],
}

impl From<Measured> for Figure {
    fn from(measured: Measured) -> Self {
        Self { value: measured.value, sd: measured.sd, interval_95: measured.interval_95() }
    }
}

/// The noise of an axis.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AxisReport {
    /// Noise density, one-sided as datasheets give it, m/s²/√Hz.
    pub noise_density_m_s2_rthz: Figure,
    /// Velocity random walk, the noise density / √2, m/s/√s.
    pub velocity_random_walk_m_s_rts: Figure,
    /// Bias instability, m/s²; `None` where the recording is too short to observe it.
    pub bias_instability_m_s2: Option<Figure>,
    /// Acceleration random walk, m/s²/√s, where it is observed.
    pub acceleration_random_walk_m_s2_rts: Option<Figure>,
    /// Linear drift, m/s² per s, where it is observed.
    pub ramp_m_s3: Option<Figure>,
    /// Whether bias instability and random walk are left out because a single event, not noise, dominates long times.
    pub is_one_event: bool,
    /// Quantisation noise, m/s, where it is observed.
    pub quantisation_m_s: Option<Figure>,
    /// Smallest Allan deviation, m/s².
    pub floor_m_s2: f64,
    /// Averaging time of the smallest deviation, s.
    pub floor_tau_s: f64,
    /// χ² per degree of freedom of the curve's residuals under the noise terms; 1 for noise.
    pub misfit: f64,
    /// False where hum or vibration is present.
    pub is_noise: bool,
    /// Averaging time from which a filtered output is white, s; the terms are estimated from there. `None` where it is not
    /// filtered.
    pub white_from_s: Option<f64>,
    /// Standard deviation from one sample to the next, m/s².
    pub sample_sd_m_s2: f64,
    /// Smallest step of the output, m/s²: one count for counts.
    pub step_m_s2: f64,
    /// Whether that step is larger than the noise: then the figures are those of the quantisation.
    pub is_coarse: bool,
    /// Samples at the highest or lowest output in excess of the noise: the output is clipped.
    pub clipped_samples: u64,
}

impl From<AxisNoise> for AxisReport {
    fn from(noise: AxisNoise) -> Self {
        Self {
            noise_density_m_s2_rthz: noise.noise_density().into(),
            velocity_random_walk_m_s_rts: noise.velocity_random_walk.into(),
            bias_instability_m_s2: noise.bias_instability_mps2.map(Figure::from),
            acceleration_random_walk_m_s2_rts: noise.acceleration_random_walk.map(Figure::from),
            ramp_m_s3: noise.ramp_mps3.map(Figure::from),
            is_one_event: noise.is_one_event,
            quantisation_m_s: noise.quantisation_mps.map(Figure::from),
            floor_m_s2: noise.floor_mps2,
            floor_tau_s: noise.floor_tau_s,
            misfit: noise.misfit,
            is_noise: noise.is_noise(),
            white_from_s: noise.white_from_s,
            sample_sd_m_s2: noise.sample_sd_mps2,
            step_m_s2: noise.step_mps2,
            is_coarse: noise.is_coarse(),
            clipped_samples: noise.clipped_samples,
        }
    }
}

/// One averaging time.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct PointReport {
    /// τ, s.
    pub tau_s: f64,
    /// Allan deviation of X, Y, Z, m/s².
    pub deviation_m_s2: [f64; 3],
    /// Standard deviation of each, relative.
    pub relative_sd: f64,
}

impl From<AllanPoint> for PointReport {
    fn from(point: AllanPoint) -> Self {
        Self {
            tau_s: point.tau_s,
            deviation_m_s2: point.deviation_mps2,
            relative_sd: point.relative_sd(),
        }
    }
}

/// The JSON of `wimu allan`.
#[derive(Clone, Debug, Serialize)]
pub struct NoiseReport {
    /// Status and findings.
    #[serde(skip)]
    pub outcome: Outcome,
    /// The data.
    pub source: String,
    /// Samples at rest.
    pub samples: u64,
    /// Sample rate, Hz.
    pub rate_hz: f64,
    /// Source of the rate.
    pub rate_source: RateSource,
    /// The accelerometer, X, Y, Z.
    pub axes: Option<[AxisReport; 3]>,
    /// The gyroscope, X, Y, Z, where there is one whose unit is known.
    pub gyroscope: Option<[GyroscopeAxis; 3]>,
    /// The curve of the accelerometer.
    pub points: Vec<PointReport>,
    /// The accelerometer and the gyroscope in SI units, where they were measured.
    #[serde(skip)]
    pub sensors: [Option<SensorNoise>; 2],
}

/// The noise of a board at rest, while its samples arrive.
pub struct NoiseMeter {
    name: String,
    given: Option<Sensitivity>,
    /// Whether the board reports its sensitivity.
    known: bool,
    /// Rate, m/s² and rad/s per LSB and range, from the first epoch on.
    running: Option<(f64, [f64; 2], u8)>,
    force: Box<AllanVariance>,
    rate: Box<AllanVariance>,
    next_sequence: Option<u32>,
}

impl NoiseMeter {
    /// For a board with this name in errors; `known` is whether it reports its sensitivity, which is used
    /// where none is given.
    pub fn new(name: &str, given: Option<Sensitivity>, known: bool) -> Self {
        Self {
            name: name.to_owned(),
            given,
            known,
            running: None,
            force: Box::new(AllanVariance::new(1.0)),
            rate: Box::new(AllanVariance::of_gyroscope(1.0)),
            next_sequence: None,
        }
    }

    /// Takes an event of the link.
    ///
    /// # Errors
    /// `data_refused` when the sensitivity is unknown, or rate or range change.
    pub fn take(&mut self, event: &Event) -> Result<()> {
        match event {
            Event::Restart { .. } => self.next_sequence = None,
            Event::Epoch { epoch, .. } if epoch.sensor == 0 => {
                let refused = |message: &str, remedy: &str| {
                    Code::DataRefused.error(message, remedy).at(&self.name)
                };
                if let Some((rate_hz, _, range_g)) = self.running {
                    let rate = 1e9 / f64::from(epoch.period_ns.max(1));
                    if range_g != epoch.range_g || (rate / rate_hz - 1.0).abs() > 0.2 {
                        return Err(refused(
                            "range or rate changed during the measurement",
                            "leave the board's settings unchanged while its noise is measured",
                        ));
                    }
                    return Ok(());
                }
                let own = Sensitivity::from_lsb_per_g(epoch.sensitivity_lsb_per_g).ok();
                let sensitivity = self.given.or(own.filter(|_| self.known));
                let scale = sensitivity.ok_or_else(|| {
                    refused(
                        "the board does not know the sensitivity of its sensor",
                        "give it: --sensitivity LSB_PER_G",
                    )
                })?;
                let rate_hz = 1e9 / f64::from(epoch.period_ns.max(1));
                let rad_s_per_lsb =
                    epoch.gyroscope.map_or(0.0, |gyroscope| gyroscope.rad_s_per_lsb);
                self.running =
                    Some((rate_hz, [scale.mps2_per_lsb(), rad_s_per_lsb], epoch.range_g));
                *self.force = AllanVariance::new(rate_hz);
                *self.rate = AllanVariance::of_gyroscope(rate_hz);
            }
            Event::Samples(samples) if (samples.sensor, samples.stream) == (0, Stream::Raw) => {
                let Some((_, [mps2_per_lsb, rad_s_per_lsb], _)) = self.running else {
                    return Ok(());
                };
                for sample in samples.iter() {
                    if self.next_sequence != Some(sample.sequence) {
                        self.force.gap();
                        self.rate.gap();
                    }
                    self.next_sequence = Some(sample.sequence.wrapping_add(1));
                    self.force.push(sample.value.map(|axis| f64::from(axis) * mps2_per_lsb));
                    if let Some(rate) = sample.rate {
                        self.rate.push(rate.map(|axis| f64::from(axis) * rad_s_per_lsb));
                    }
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn rate_hz(&self) -> f64 {
        self.running.map_or(1.0, |(rate_hz, ..)| rate_hz)
    }

    /// Progress as a line of text.
    pub fn progress(&self) -> String {
        let samples = self.force.samples();
        let so_far = format!("{:.0} s, {samples} samples", samples as f64 / self.rate_hz());
        match self.force.result() {
            Err(refusal) => format!("{so_far}: {refusal}"),
            Ok(axes) => {
                let densities = axes.map(|axis| {
                    let density = axis.noise_density();
                    let ug = 1e6 / STANDARD_GRAVITY_MPS2;
                    format!("{:.1} ± {:.1}", density.value * ug, density.sd * ug)
                });
                format!("{so_far}: noise density {} µg/√Hz", densities.join(", "))
            }
        }
    }

    /// The result so far.
    ///
    /// # Errors
    /// `no_rows` when the link carried no raw samples.
    pub fn report(&self) -> Result<NoiseReport> {
        if self.force.samples() == 0 {
            return Err(Code::NoRows
                .error(
                    "no raw samples came over the link",
                    "switch the raw stream on with `wimu device settings set`, or use the other link",
                )
                .at(&self.name));
        }
        let source = RateSource::Device;
        let rate = (self.rate.samples() > 0).then_some(&*self.rate);
        let allans = [Some(&*self.force), rate];
        Ok(NoiseReport::new(&self.name, self.rate_hz(), source, allans))
    }
}

impl NoiseReport {
    /// Of an accelerometer and a gyroscope, at least one of them; the first one's rate.
    fn new(
        source: &str,
        rate_hz: f64,
        rate_source: RateSource,
        allans: [Option<&AllanVariance>; 2],
    ) -> Self {
        let mut outcome = Outcome::default();
        if rate_source == RateSource::Assumed {
            let text = "the noise densities scale with the square root of the assumed rate";
            outcome.findings.push(Code::Rate.note(text));
        }
        let kinds = [&sensor::ACCELEROMETER, &sensor::GYROSCOPE];
        let sensors =
            [0, 1].map(|place: usize| match SensorNoise::of(allans[place]?, kinds[place]) {
                Ok(sensor) => {
                    outcome.findings.extend(sensor.findings());
                    Some(sensor)
                }
                Err(refusal) if place == 1 && allans[0].is_some() => {
                    let text = format!("the gyroscope's noise is not measured: {refusal}");
                    outcome.findings.push(Code::NotNoise.warning(text));
                    None
                }
                Err(refusal) => {
                    outcome.refuse(refusal.to_string());
                    None
                }
            });
        let [force, rate] = &sensors;
        Self {
            outcome,
            source: source.to_owned(),
            samples: allans.into_iter().flatten().next().map_or(0, AllanVariance::samples),
            rate_hz,
            rate_source,
            axes: force.as_ref().map(|sensor| sensor.axes.map(AxisReport::from)),
            gyroscope: rate.as_ref().map(|sensor| sensor.axes.map(GyroscopeAxis::from)),
            points: force.as_ref().map(|sensor| sensor.points.clone()).unwrap_or_default(),
            sensors,
        }
    }

    /// The sensors that were measured.
    pub fn measured(&self) -> impl Iterator<Item = &SensorNoise> {
        self.sensors.iter().flatten()
    }
}
