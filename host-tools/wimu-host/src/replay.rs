//! Replay of the device's arithmetic: corrected samples, velocity and position from raw samples and epochs,
//! bit for bit.

use wimu_integrator::{Integrator, Navigation, State};
use wimu_link::message::{ARITHMETIC_REVISION, EpochReason};
use wimu_model::{CentiCelsius, Corrector, Counts, PeriodNs, SpecificForceQ16};

use crate::decode::{TimedSample, sequence_order};
use crate::error::{ErrorCode, HostError, Result};
use crate::history::{Boot, EpochMark};

/// Longest interval between epochs, ns of samples; without the next one by then
/// the state of the device is unknown.
const EPOCH_WITHIN_NS: u64 = 1_000_000_000;

/// A step of a replay.
#[derive(Debug)]
#[allow(
    clippy::large_enum_variant,
    reason = "steps are handed on one at a time"
)]
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
    /// Replay stops until the next epoch: a raw sample or an epoch is missing.
    Break {
        /// Sequence number of the first sample that is not replayed.
        sequence: u32,
    },
    /// An epoch from which no replay is possible.
    Unusable {
        /// Its index.
        index: usize,
        /// Why.
        error: HostError,
    },
}

/// A raw sample and the replayed results.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Replayed {
    /// The raw sample.
    pub raw: TimedSample,
    /// Corrected specific force.
    pub force: SpecificForceQ16,
    /// Velocity and position after it.
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
    corrector: Corrector,
    integrator: Integrator,
    full_scale: i32,
    next_sequence: u32,
    /// Samples since the latest epoch, and their largest number without another one.
    since_epoch: u64,
    most: u64,
}

impl Running {
    fn from_epoch(boot: &Boot, mark: &EpochMark) -> Result<Self> {
        if !mark.epoch.state.is_ours() {
            return Err(ErrorCode::BadRecording.error(format!(
                    "the device uses revision {} of the arithmetic, this wimu {ARITHMETIC_REVISION}: a bit-exact replay is not possible",
                    mark.epoch.state.revision
                ),
                "replay it with the wimu of the device's firmware version; the samples themselves are readable",
            ));
        }
        let state = State::from(mark.epoch.state);
        Ok(Self {
            corrector: corrector(boot, mark)?,
            integrator: Integrator::from_state(state).map_err(unusable)?,
            full_scale: mark.epoch.full_scale,
            next_sequence: mark.epoch.sequence,
            since_epoch: 0,
            most: most_samples(mark),
        })
    }

    /// Continues with the parameters, temperature, period and range of an epoch.
    fn adopt(&mut self, boot: &Boot, mark: &EpochMark) -> Result<()> {
        self.corrector = corrector(boot, mark)?;
        self.integrator
            .set_period(PeriodNs(mark.epoch.period_ns))
            .map_err(unusable)?;
        if mark.epoch.reason == EpochReason::Heading {
            self.integrator
                .adopt_heading(&State::from(mark.epoch.state));
        }
        self.full_scale = mark.epoch.full_scale;
        self.since_epoch = 0;
        self.most = most_samples(mark);
        Ok(())
    }
}

fn corrector(boot: &Boot, mark: &EpochMark) -> Result<Corrector> {
    let temperature = mark.epoch.temperature_centi_c.map(CentiCelsius);
    Corrector::compile(&boot.parameters_of(&mark.epoch)?, temperature).map_err(unusable)
}

fn most_samples(mark: &EpochMark) -> u64 {
    EPOCH_WITHIN_NS / u64::from(mark.epoch.period_ns.max(1)) + 1
}

fn unusable(error: impl std::error::Error) -> HostError {
    ErrorCode::BadRecording.error(
        format!("an epoch cannot be replayed: {error}"),
        "update firmware and wimu to one version",
    )
}

impl<'a> Replay<'a> {
    /// Begins at the epoch of this index in [`Boot::epochs`].
    pub fn new(boot: &'a Boot, epoch: usize) -> Self {
        Self {
            boot,
            epoch,
            raw: 0,
            running: None,
        }
    }

    /// Takes the next epoch.
    fn take_epoch(&mut self) -> Option<Step> {
        let index = self.epoch;
        let mark = self.boot.epochs.get(index)?;
        self.epoch += 1;
        let began_anew = matches!(
            mark.epoch.reason,
            EpochReason::Start
                | EpochReason::Gap
                | EpochReason::Settings
                | EpochReason::Parameters
                | EpochReason::Other(_)
        ) || mark.after_loss;
        let outcome = match &mut self.running {
            Some(running) if !began_anew => running.adopt(self.boot, mark).map(|()| {
                let agrees = running.integrator.state() == State::from(mark.epoch.state);
                Some(agrees)
            }),
            _ => Running::from_epoch(self.boot, mark).map(|running| {
                let start = running.next_sequence;
                let is_before = |raw: &TimedSample| sequence_order(raw.sequence, start).is_lt();
                self.raw = self.boot.raw.partition_point(is_before);
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
        if let Some(mark) = self.boot.epochs.get(self.epoch)
            && mark.epoch.sequence == sequence
        {
            return self.take_epoch();
        }
        let raw = self.boot.raw.get(self.raw).copied();
        match raw {
            Some(raw) if raw.sequence == sequence && running.since_epoch < running.most => {
                let counts = Counts(raw.value.map(|axis| axis as i16));
                let force = running.corrector.correct(counts);
                running
                    .integrator
                    .step(force, counts.saturated(running.full_scale));
                running.next_sequence = sequence.wrapping_add(1);
                running.since_epoch += 1;
                self.raw += 1;
                Some(Step::Sample(Replayed {
                    raw,
                    force,
                    navigation: running.integrator.navigation(),
                }))
            }
            None if self.epoch >= self.boot.epochs.len() => None,
            _ => {
                self.running = None;
                // Epochs before this sample are skipped.
                let epochs = &self.boot.epochs;
                while epochs
                    .get(self.epoch)
                    .is_some_and(|mark| sequence_order(mark.epoch.sequence, sequence).is_lt())
                {
                    self.epoch += 1;
                }
                Some(Step::Break { sequence })
            }
        }
    }
}

/// Comparison of a replay with the data sent by the device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct ReplayReport {
    /// Raw samples replayed.
    pub samples: u64,
    /// Corrected samples compared.
    pub corrected_compared: u64,
    /// Of these, different in any bit.
    pub corrected_differ: u64,
    /// Velocities and positions compared.
    pub navigation_compared: u64,
    /// Of these, different in any bit.
    pub navigation_differ: u64,
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
        self.corrected_compared + self.navigation_compared + self.states_compared > 0
            && self.corrected_differ + self.navigation_differ + self.states_differ == 0
    }

    fn add(&mut self, span: &Self) {
        self.samples += span.samples;
        self.corrected_compared += span.corrected_compared;
        self.corrected_differ += span.corrected_differ;
        self.navigation_compared += span.navigation_compared;
        self.navigation_differ += span.navigation_differ;
        self.first_difference = self.first_difference.or(span.first_difference);
    }
}

/// Replays from the epoch of this index to the end of the start, and compares with every corrected
/// sample, velocity, position and state that the device sent.
pub fn verify(boot: &Boot, epoch: usize) -> ReplayReport {
    let mut report = ReplayReport::default();
    // Compared since the latest epoch: counts once the next one has arrived without a loss.
    let mut span = ReplayReport::default();
    for step in Replay::new(boot, epoch) {
        match step {
            Step::Sample(replayed) => compare(boot, &replayed, &mut span),
            Step::Epoch { index, agrees } => {
                let mark = &boot.epochs[index];
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
    let mut differs = false;
    if let Ok(found) = boot
        .corrected
        .binary_search_by(|sample| sequence_order(sample.sequence, sequence))
    {
        span.corrected_compared += 1;
        if boot.corrected[found].value != replayed.force.0 {
            span.corrected_differ += 1;
            differs = true;
        }
    }
    if let Ok(found) = boot
        .navigation
        .binary_search_by(|navigation| sequence_order(navigation.sequence, sequence))
    {
        span.navigation_compared += 1;
        let ours = wimu_link::message::Navigation::new(sequence, &replayed.navigation);
        if boot.navigation[found] != ours {
            span.navigation_differ += 1;
            differs = true;
        }
    }
    if differs {
        span.first_difference.get_or_insert(sequence);
    }
}

#[cfg(test)]
mod tests;
