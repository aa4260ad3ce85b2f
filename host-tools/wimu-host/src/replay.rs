//! Replay of the device's arithmetic: corrected samples, velocity, position and attitude from raw samples and
//! epochs, bit for bit.

use wimu_integrator::{Integrator, Navigation, Saturation};
use wimu_link::message::{ARITHMETIC_REVISION, Epoch, EpochReason};
use wimu_model::{
    AngularRateQ20, CentiCelsius, CompileError, CompiledSet, Corrector, GyroscopeCorrector,
    ParameterSet, PeriodNs, Sensitivity, SpecificForceQ16, WideCounts,
};

use crate::calibration::compiled_for;
use crate::capture::{Boot, EpochMark};
use crate::decode::{TimedSample, sequence_order};
use crate::{Code, Problem, Result};

/// Longest interval between epochs, ns of samples; without the next one by then
/// the state of the device is unknown.
const EPOCH_WITHIN_NS: u64 = 1_000_000_000;

/// A step of a replay.
#[derive(Debug)]
#[allow(clippy::large_enum_variant, reason = "steps are handed on one at a time")]
pub enum Step {
    /// A sample, replayed.
    Sample(Replayed),
    /// An epoch, by its index in [`Boot::epochs`].
    Epoch {
        /// Its index.
        index: usize,
        /// Whether the device's state equals the replayed one; `None` where it cannot be compared,
        /// because the replay or the device started here.
        agrees: Option<bool>,
    },
    /// Replay stops until the next epoch: a raw sample, its angular rate or an epoch is missing.
    Break {
        /// Sequence number of the first sample that is not replayed.
        sequence: u32,
    },
    /// An epoch from which no replay is possible.
    Unusable {
        /// Its index.
        index: usize,
        /// Why.
        error: Problem,
    },
}

/// A raw sample and the replayed results.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Replayed {
    /// The raw sample.
    pub raw: TimedSample,
    /// Corrected specific force.
    pub force: SpecificForceQ16,
    /// Corrected angular rate; `None` without a gyroscope.
    pub rate: Option<AngularRateQ20>,
    /// Velocity, position and, with a gyroscope, attitude after it.
    pub navigation: Navigation,
}

/// Replays the raw samples of a start from an epoch on.
///
/// Within an uninterrupted run of samples everything is computed from the run's first epoch alone; later
/// epochs give the temperature, the period and the heading, and their states are compared.
pub struct Replay<'a> {
    boot: &'a Boot,
    /// The next epoch.
    epoch: usize,
    /// The next raw sample.
    raw: usize,
    running: Option<Running>,
}

struct Running {
    correction: Correction,
    integrator: Integrator,
    next_sequence: u32,
    /// Samples since the latest epoch, and their largest number without another one.
    since_epoch: u64,
    most: u64,
}

impl Running {
    fn from_epoch(boot: &Boot, mark: &EpochMark) -> Result<Self> {
        if !mark.epoch.is_ours() {
            return Err(Code::BadRecording.error(format!(
                    "the device uses revision {} of the arithmetic, this wimu {ARITHMETIC_REVISION}: a bit-exact replay is not possible",
                    mark.epoch.revision
                ),
                "replay it with the wimu of the device's firmware version; the samples themselves are readable",
            ));
        }
        Ok(Self {
            correction: Correction::of(boot, mark)?,
            integrator: Integrator::from_state(mark.epoch.state).map_err(unusable)?,
            next_sequence: mark.epoch.sequence,
            since_epoch: 0,
            most: most_samples(mark),
        })
    }

    /// Continues with the parameters, temperature, period and range of an epoch.
    fn adopt(&mut self, boot: &Boot, mark: &EpochMark) -> Result<()> {
        self.correction = Correction::of(boot, mark)?;
        self.integrator.set_period(PeriodNs(mark.epoch.period_ns)).map_err(unusable)?;
        if mark.epoch.reason == EpochReason::Heading {
            self.integrator.adopt_heading(&mark.epoch.state);
        }
        self.since_epoch = 0;
        self.most = most_samples(mark);
        Ok(())
    }
}

/// Correction of the samples after an epoch.
pub(crate) struct Correction {
    accelerometer: Corrector,
    full_scale: i32,
    /// With the full scale of its counts; `None` without a gyroscope.
    gyroscope: Option<(GyroscopeCorrector, i32)>,
}

impl Correction {
    /// As the device corrects.
    fn of(boot: &Boot, mark: &EpochMark) -> Result<Self> {
        let temperature = mark.epoch.temperature_centi_c.map(CentiCelsius);
        Self::at(boot, &mark.epoch, temperature)
    }

    /// As the device corrects with the parameters of an epoch, at a temperature.
    ///
    /// # Errors
    /// `bad_recording` when they were not sent.
    pub fn at(boot: &Boot, epoch: &Epoch, temperature: Option<CentiCelsius>) -> Result<Self> {
        if let Some(set) = boot.set_of(epoch)? {
            return Ok(Self::calibrated(&set, epoch, temperature));
        }
        let nominal = Sensitivity::from_lsb_per_g(epoch.sensitivity_lsb_per_g);
        Ok(Self::with(Corrector::ideal(nominal.map_err(unusable)?), None, epoch))
    }

    fn calibrated(set: &CompiledSet, epoch: &Epoch, temperature: Option<CentiCelsius>) -> Self {
        Self::with(set.corrector(temperature), set.gyroscope(temperature), epoch)
    }

    /// A gyroscope that is not calibrated is corrected as an ideal one.
    fn with(
        accelerometer: Corrector,
        calibrated: Option<GyroscopeCorrector>,
        epoch: &Epoch,
    ) -> Self {
        let gyroscope = epoch.gyroscope.map(|nominal| {
            let ideal = || GyroscopeCorrector::ideal(nominal.rad_s_per_lsb);
            (calibrated.unwrap_or_else(ideal), nominal.full_scale)
        });
        Self { accelerometer, full_scale: epoch.full_scale, gyroscope }
    }

    /// With a calibration, for the sensor of an epoch.
    ///
    /// # Errors
    /// [`CompileError`].
    pub fn compile(
        set: &ParameterSet,
        epoch: &Epoch,
        temperature: Option<CentiCelsius>,
    ) -> std::result::Result<Self, CompileError> {
        let nominal = epoch.gyroscope.map(|gyroscope| gyroscope.rad_s_per_lsb);
        let set = compiled_for(set, 0, nominal, false)?;
        Ok(Self::calibrated(&set, epoch, temperature))
    }

    /// Whether all axes of a sample are there.
    pub fn takes(&self, raw: &TimedSample) -> bool {
        self.gyroscope.is_none() || raw.rate.is_some()
    }

    /// Corrected specific force and, with a gyroscope, angular rate. Counts of 16 bits give the same results by
    /// either width.
    pub fn correct(&self, raw: &TimedSample) -> (SpecificForceQ16, Option<AngularRateQ20>) {
        let force = self.accelerometer.correct_wide(WideCounts(raw.value));
        let rate = self.gyroscope.zip(raw.rate);
        let rate =
            rate.map(|((gyroscope, _), rate)| gyroscope.correct_wide(WideCounts(rate), force));
        (force, rate)
    }

    /// Corrects a sample and adds it to the integration.
    pub fn integrate(
        &self,
        raw: &TimedSample,
        integrator: &mut Integrator,
    ) -> (SpecificForceQ16, Option<AngularRateQ20>) {
        let (force, rate) = self.correct(raw);
        let accelerometer = WideCounts(raw.value).saturated(self.full_scale);
        match (rate, self.gyroscope.zip(raw.rate)) {
            (Some(rate), Some(((_, full_scale), counts))) => {
                let saturated = Saturation {
                    accelerometer,
                    gyroscope: WideCounts(counts).saturated(full_scale),
                };
                integrator.step_inertial(force, rate, saturated)
            }
            _ => integrator.step(force, accelerometer),
        };
        (force, rate)
    }
}

fn most_samples(mark: &EpochMark) -> u64 {
    EPOCH_WITHIN_NS / u64::from(mark.epoch.period_ns.max(1)) + 1
}

fn unusable(error: impl std::error::Error) -> Problem {
    Code::BadRecording.error(
        format!("an epoch cannot be replayed: {error}"),
        "update firmware and wimu to one version",
    )
}

impl<'a> Replay<'a> {
    /// Begins at the epoch of this index in [`Boot::epochs`].
    pub fn new(boot: &'a Boot, epoch: usize) -> Self {
        Self { boot, epoch, raw: 0, running: None }
    }

    /// Takes the next epoch.
    fn take_epoch(&mut self) -> Option<Step> {
        let index = self.epoch;
        let mark = self.boot.epochs().get(index)?;
        self.epoch += 1;
        let began_anew = matches!(
            mark.epoch.reason,
            EpochReason::Start | EpochReason::Gap | EpochReason::Settings | EpochReason::Parameters
        ) || mark.after_loss;
        let outcome = match &mut self.running {
            Some(running) if !began_anew => running.adopt(self.boot, mark).map(|()| {
                let agrees = running.integrator.state() == mark.epoch.state;
                Some(agrees)
            }),
            _ => Running::from_epoch(self.boot, mark).map(|running| {
                let start = running.next_sequence;
                let is_before = |raw: &TimedSample| sequence_order(raw.sequence, start).is_lt();
                self.raw = self.boot.raw().partition_point(is_before);
                self.running = Some(running);
                None
            }),
        };
        Some(match outcome {
            Ok(agrees) => Step::Epoch { index, agrees },
            Err(error) => {
                self.running = None;
                Step::Unusable { index, error }
            }
        })
    }
}

impl Iterator for Replay<'_> {
    type Item = Step;

    fn next(&mut self) -> Option<Step> {
        let Some(running) = &mut self.running else {
            return self.take_epoch();
        };
        let sequence = running.next_sequence;
        if let Some(mark) = self.boot.epochs().get(self.epoch)
            && mark.epoch.sequence == sequence
        {
            return self.take_epoch();
        }
        // The samples after the last one were not recorded: an epoch ahead of them replays nothing.
        let raw = self.boot.raw().get(self.raw).copied()?;
        if raw.sequence == sequence
            && running.since_epoch < running.most
            && running.correction.takes(&raw)
        {
            let (force, rate) = running.correction.integrate(&raw, &mut running.integrator);
            running.next_sequence = sequence.wrapping_add(1);
            running.since_epoch += 1;
            self.raw += 1;
            return Some(Step::Sample(Replayed {
                raw,
                force,
                rate,
                navigation: running.integrator.navigation(),
            }));
        }
        self.running = None;
        // Epochs before this sample are skipped.
        let epochs = self.boot.epochs();
        while epochs
            .get(self.epoch)
            .is_some_and(|mark| sequence_order(mark.epoch.sequence, sequence).is_lt())
        {
            self.epoch += 1;
        }
        Some(Step::Break { sequence })
    }
}

/// Comparison of a replay with the data sent by the device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct ReplayReport {
    /// Raw samples replayed.
    pub samples: u64,
    /// Corrected samples compared.
    pub corrected_compared: u64,
    /// Of these, with a specific force that differs in any bit.
    pub corrected_differ: u64,
    /// Of the corrected samples, those with an angular rate.
    pub rates_compared: u64,
    /// Of these, with an angular rate that differs in any bit.
    pub rates_differ: u64,
    /// Velocities and positions compared.
    pub navigation_compared: u64,
    /// Of these, different in any bit.
    pub navigation_differ: u64,
    /// Attitudes compared.
    pub attitudes_compared: u64,
    /// Of these, different in any bit.
    pub attitudes_differ: u64,
    /// Integrator states in epochs compared with those replayed from an earlier epoch.
    pub states_compared: u64,
    /// Of these, different in any bit.
    pub states_differ: u64,
    /// Restarts of the replay after a missing sample or epoch.
    pub breaks: u64,
    /// Epochs from which no replay was possible.
    pub epochs_unusable: u64,
    /// Samples not compared because a lost epoch may have applied to some of them.
    pub samples_uncertain: u64,
    /// Sequence number at the first difference.
    pub first_difference: Option<u32>,
}

impl ReplayReport {
    /// Whether all compared data are equal, and there are any.
    pub fn is_exact(&self) -> bool {
        let compared = self.corrected_compared
            + self.navigation_compared
            + self.attitudes_compared
            + self.states_compared;
        compared > 0 && self.differences() == 0
    }

    fn differences(&self) -> u64 {
        self.corrected_differ
            + self.rates_differ
            + self.navigation_differ
            + self.attitudes_differ
            + self.states_differ
    }

    fn add(&mut self, span: &Self) {
        self.samples += span.samples;
        self.corrected_compared += span.corrected_compared;
        self.corrected_differ += span.corrected_differ;
        self.rates_compared += span.rates_compared;
        self.rates_differ += span.rates_differ;
        self.attitudes_compared += span.attitudes_compared;
        self.attitudes_differ += span.attitudes_differ;
        self.navigation_compared += span.navigation_compared;
        self.navigation_differ += span.navigation_differ;
        self.first_difference = self.first_difference.or(span.first_difference);
    }
}

/// Replays from the epoch of this index to the end of the start, and compares with every corrected
/// sample, velocity, position, attitude and state that the device sent.
pub fn verify(boot: &Boot, epoch: usize) -> ReplayReport {
    let mut report = ReplayReport::default();
    // Compared since the latest epoch: counts once the next one has arrived without a loss.
    let mut span = ReplayReport::default();
    for step in Replay::new(boot, epoch) {
        match step {
            Step::Sample(replayed) => compare(boot, &replayed, &mut span),
            Step::Epoch { index, agrees } => {
                let mark = &boot.epochs()[index];
                if mark.after_loss {
                    report.samples_uncertain += span.samples;
                } else {
                    report.add(&span);
                }
                span = ReplayReport::default();
                if let Some(agrees) = agrees {
                    report.states_compared += 1;
                    if !agrees {
                        report.states_differ += 1;
                        report.first_difference.get_or_insert(mark.epoch.sequence);
                    }
                }
            }
            Step::Break { .. } => report.breaks += 1,
            Step::Unusable { .. } => report.epochs_unusable += 1,
        }
    }
    report.add(&span);
    report
}

fn compare(boot: &Boot, replayed: &Replayed, span: &mut ReplayReport) {
    let sequence = replayed.raw.sequence;
    span.samples += 1;
    let before = span.differences();
    if let Some(sent) = find(boot.corrected(), sequence, |sample| sample.sequence) {
        span.corrected_compared += 1;
        span.corrected_differ += u64::from(sent.value != replayed.force.0);
        if let Some(rate) = sent.rate {
            span.rates_compared += 1;
            span.rates_differ += u64::from(replayed.rate != Some(AngularRateQ20(rate)));
        }
    }
    if let Some(sent) = find(&boot.navigation, sequence, |sent| sent.sequence) {
        let ours = wimu_link::message::Navigation::new(sequence, &replayed.navigation);
        span.navigation_compared += 1;
        span.navigation_differ += u64::from(*sent != ours);
    }
    if let Some(sent) = find(&boot.attitude, sequence, |sent| sent.sequence) {
        let differs = replayed.navigation.attitude != Some(sent.quaternion);
        span.attitudes_compared += 1;
        span.attitudes_differ += u64::from(differs);
    }
    if span.differences() > before {
        span.first_difference.get_or_insert(sequence);
    }
}

/// The item with this sequence number, which `of` returns.
pub(crate) fn find<T>(items: &[T], sequence: u32, of: impl Fn(&T) -> u32) -> Option<&T> {
    let found = items.binary_search_by(|item| sequence_order(of(item), sequence));
    items.get(found.ok()?)
}
