//! Noise of a recording at rest from the Allan deviation.

mod file;
mod page;
mod sensor;

pub use file::{noise, noise_of};
pub use sensor::{AxisNoise, Figure, Point, SensorNoise};

use serde::Serialize;
use wimu_calib::AllanVariance;
use wimu_link::batch::Stream;
use wimu_model::{STANDARD_GRAVITY_MPS2, Sensitivity};

use crate::decode::Event;
use crate::problem::Outcome;
use crate::recording::RateSource;
use crate::{Code, Result};

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
    /// The accelerometer.
    pub accelerometer: Option<SensorNoise>,
    /// The gyroscope, where there is one whose unit is known.
    pub gyroscope: Option<SensorNoise>,
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
        let [force, rate] = allans;
        let accelerometer = force.and_then(|allan| {
            let measured = SensorNoise::of(allan, &sensor::ACCELEROMETER);
            measured.map_err(|refusal| outcome.refuse(refusal.to_string())).ok()
        });
        let gyroscope = rate.and_then(|allan| match SensorNoise::of(allan, &sensor::GYROSCOPE) {
            Ok(measured) => Some(measured),
            Err(refusal) if force.is_some() => {
                let text = format!("the gyroscope's noise is not measured: {refusal}");
                outcome.findings.push(Code::NotNoise.warning(text));
                None
            }
            Err(refusal) => {
                outcome.refuse(refusal.to_string());
                None
            }
        });
        let measured = accelerometer.iter().chain(&gyroscope);
        outcome.findings.extend(measured.flat_map(SensorNoise::problems));
        Self {
            outcome,
            source: source.to_owned(),
            samples: force.or(rate).map_or(0, AllanVariance::samples),
            rate_hz,
            rate_source,
            accelerometer,
            gyroscope,
        }
    }

    /// The sensors that were measured.
    pub fn measured(&self) -> impl Iterator<Item = &SensorNoise> {
        self.accelerometer.iter().chain(&self.gyroscope)
    }
}
