use wimu_integrator::{Config, Transition};
use wimu_link::batch;
use wimu_link::message::{ActiveParameters, Epoch, WireParameters, parameter_id};
use wimu_link::{Hello, LinkRole, MAX_FRAME, Telemetry};
use wimu_model::{
    Counts, DeviceTimeUs, ErrorModel, ErrorTerms, ParameterSet, Sensitivity, TemperatureTerms,
};
use wimu_testkit::Random;

use super::*;
use crate::decode::Decoder;
use crate::history::LinkHistory;

/// What a device does per sample, without a sensor or a link: the same crates, and frames.
struct Device {
    set: ParameterSet,
    temperature: CentiCelsius,
    corrector: Corrector,
    integrator: Integrator,
    period: PeriodNs,
    sequence: u32,
    first: u32,
    due: Option<EpochReason>,
    since_epoch: u32,
    epochs: u8,
    frames: Vec<Vec<u8>>,
    pending: Vec<(Counts, SpecificForceQ16)>,
}

impl Device {
    fn new() -> Self {
        Self::from(100_000)
    }

    /// One whose first sample has this number.
    fn from(sequence: u32) -> Self {
        let set = ParameterSet {
            model: ErrorModel::new(ErrorTerms {
                bias_mps2: [0.3, -0.2, 0.1],
                matrix: [[1.02, 0.01, 0.0], [0.0, 0.97, 0.02], [-0.01, 0.0, 1.01]],
                temperature: TemperatureTerms {
                    bias_mps2_per_k: [0.01, 0.0, -0.02],
                    ..TemperatureTerms::default()
                },
                ..ErrorTerms::default()
            })
            .unwrap(),
            ..ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16384.0).unwrap())
        };
        let period = PeriodNs(10_000_000);
        let temperature = CentiCelsius(2500);
        let mut device = Self {
            set,
            temperature,
            corrector: Corrector::compile(&set, Some(temperature)).unwrap(),
            integrator: Integrator::new(Config::new(period).unwrap()),
            period,
            sequence,
            first: sequence,
            due: Some(EpochReason::Start),
            since_epoch: 0,
            epochs: 0,
            frames: Vec::new(),
            pending: Vec::new(),
        };
        device.send(|frame| Hello::new(LinkRole::Cable).encode(frame));
        let parameters = Telemetry::Parameters(ActiveParameters {
            active: Some(WireParameters::from(&set)),
            id: parameter_id(&set).0,
        });
        device.send(|frame| parameters.encode(frame));
        device
    }

    fn send(
        &mut self,
        encode: impl FnOnce(&mut [u8]) -> Result<usize, wimu_link::frame::EncodeError>,
    ) {
        let mut frame = [0; MAX_FRAME];
        let length = encode(&mut frame).unwrap();
        self.frames.push(frame[..length].to_vec());
    }

    fn time(&self, sequence: u32) -> DeviceTimeUs {
        DeviceTimeUs(u64::from(sequence.wrapping_sub(self.first)) * 10_000)
    }

    fn set_temperature(&mut self, temperature: CentiCelsius) {
        self.temperature = temperature;
        self.corrector = Corrector::compile(&self.set, Some(temperature)).unwrap();
        self.due = Some(EpochReason::Temperature);
    }

    fn sample(&mut self, counts: Counts) {
        if let Some(reason) = self.due.take() {
            self.since_epoch = 0;
            self.epochs = self.epochs.wrapping_add(1);
            let epoch = <Telemetry>::Epoch(Epoch {
                reason,
                number: self.epochs,
                sequence: self.sequence,
                time_us: self.time(self.sequence).0,
                period_ns: self.period.0,
                range_g: 2,
                sensitivity_lsb_per_g: 16384.0,
                full_scale: 32752,
                parameters: parameter_id(&self.set).0,
                temperature_centi_c: Some(self.temperature.0),
                state: self.integrator.state().into(),
                ..Epoch::default()
            });
            self.send(|frame| epoch.encode(frame));
        }
        let force = self.corrector.correct(counts);
        let transition = self.integrator.step(force, counts.saturated(0x7FF0));
        self.pending.push((counts, force));
        if self.sequence.wrapping_sub(self.first).is_multiple_of(10) {
            let navigation = <Telemetry>::Navigation(wimu_link::message::Navigation::new(
                self.sequence,
                &self.integrator.navigation(),
            ));
            self.send(|frame| navigation.encode(frame));
        }
        self.sequence = self.sequence.wrapping_add(1);
        self.since_epoch += 1;
        if self.pending.len() == 16 {
            self.flush();
        }
        if matches!(transition, Transition::Rest | Transition::Motion) {
            self.due = Some(EpochReason::Stillness);
        } else if self.since_epoch >= 90 {
            self.due = Some(EpochReason::Periodic);
        }
    }

    fn flush(&mut self) {
        let first = self.sequence.wrapping_sub(self.pending.len() as u32);
        let time = self.time(first);
        let (raw, corrected): (Vec<_>, Vec<_>) = self.pending.drain(..).unzip();
        if !raw.is_empty() {
            self.send(|frame| batch::encode(first, time, &raw, frame));
            self.send(|frame| batch::encode(first, time, &corrected, frame));
        }
    }

    /// Rest, a shove and rest again, with some noise; a change of temperature and of the period.
    fn run(mut self) -> Vec<Vec<u8>> {
        let mut random = Random::new(1);
        for step in 0..900_u32 {
            let shove = match step {
                300..350 => 2_000,
                350..400 => -2_000,
                _ => 0,
            };
            let counts = [0, 0, 16384].map(|axis| axis + random.below(16) as i16);
            if step == 333 {
                self.set_temperature(CentiCelsius(2612));
            }
            if step == 700 {
                self.period = PeriodNs(10_010_000);
                self.integrator.set_period(self.period).unwrap();
                self.due = Some(EpochReason::Periodic);
            }
            self.sample(Counts([counts[0] + shove, counts[1], counts[2]]));
        }
        self.flush();
        self.frames
    }
}

fn boot(frames: &[Vec<u8>]) -> Boot {
    let mut record = LinkHistory::new(LinkRole::Cable);
    let mut decoder = Decoder::new();
    for frame in frames {
        decoder.push(0, frame, |arrival| record.take(&arrival));
    }
    assert_eq!(record.boots.len(), 1);
    record.boots.remove(0)
}

#[test]
fn raw_samples_give_what_the_device_sent_bit_for_bit_from_any_epoch() {
    let boot = boot(&Device::new().run());
    assert!(boot.epochs.len() >= 12, "{}", boot.epochs.len());
    assert!(boot.navigation.iter().any(|n| n.position_nm[0].abs() > 100_000_000));
    for epoch in 0..boot.epochs.len() {
        let report = verify(&boot, epoch);
        assert!(report.is_exact(), "{epoch}: {report:?}");
        assert_eq!((report.breaks, report.epochs_unusable), (0, 0), "{report:?}");
        let samples = u64::from(100_900 - boot.epochs[epoch].epoch.sequence);
        assert_eq!((report.samples, report.corrected_compared), (samples, samples));
        assert_eq!(report.navigation_compared, samples / 10);
        assert_eq!(report.states_compared, (boot.epochs.len() - epoch - 1) as u64);
    }
}

#[test]
fn a_lost_batch_breaks_the_run_and_the_next_epoch_begins_another() {
    let mut frames = Device::new().run();
    let batches: Vec<_> = (0..frames.len()).filter(|i| frames[*i].len() > 30).collect();
    let whole = verify(&boot(&frames), 0);
    // A raw batch well after the beginning.
    let lost = batches
        .into_iter()
        .find(|index| {
            let mut with_loss = frames.clone();
            with_loss.remove(*index);
            let boot = boot(&with_loss);
            boot.raw.len() == 884 && boot.raw[0].sequence == 100_000
        })
        .unwrap();
    frames.remove(lost);
    let report = verify(&boot(&frames), 0);
    assert!(report.is_exact(), "{report:?}");
    assert_eq!(report.breaks, 1);
    assert!(report.samples < whole.samples - 15 && report.samples > whole.samples - 120);
}

#[test]
fn any_difference_is_found_and_located() {
    let intact = boot(&Device::new().run());

    let mut other = intact.clone();
    other.corrected[500].value[1] += 1;
    let report = verify(&other, 0);
    assert_eq!((report.corrected_differ, report.first_difference), (1, Some(100_500)));
    assert!(!report.is_exact());

    let mut other = intact.clone();
    other.navigation[40].position_nm[2] -= 1;
    assert_eq!(verify(&other, 0).navigation_differ, 1);

    let mut other = intact.clone();
    other.raw[320].value[0] += 1;
    let report = verify(&other, 0);
    assert_eq!(report.corrected_differ, 1);
    assert!(report.states_differ > 0 && report.navigation_differ > 0, "{report:?}");

    let mut other = intact.clone();
    other.epochs[3].epoch.state.rest_mean[0] ^= 1;
    assert_eq!(verify(&other, 0).states_differ, 1);

    // By other arithmetic nothing is computed again, and nothing is said to differ.
    let mut other = intact.clone();
    for mark in &mut other.epochs {
        mark.epoch.state.revision += 1;
    }
    let report = verify(&other, 0);
    assert_eq!((report.samples, report.epochs_unusable), (0, other.epochs.len() as u64));
    assert!(!report.is_exact());
}

#[test]
fn an_epoch_that_is_lost_makes_samples_uncertain_not_different() {
    let frames = Device::new().run();
    let intact = boot(&frames);
    let temperature = intact
        .epochs
        .iter()
        .position(|mark| mark.epoch.reason == EpochReason::Temperature)
        .unwrap();
    let sequence = intact.epochs[temperature].epoch.sequence;
    let mut record = LinkHistory::new(LinkRole::Cable);
    let mut decoder = Decoder::new();
    let mut epochs = 0;
    for frame in &frames {
        let mut is_epoch = false;
        Decoder::new().push(0, frame, |arrival| {
            is_epoch |= matches!(arrival.event, crate::decode::Event::Epoch { .. });
        });
        // It is lost without a trace: no damage shows that something was there.
        if !(is_epoch && epochs == temperature) {
            decoder.push(0, frame, |arrival| record.take(&arrival));
        }
        epochs += usize::from(is_epoch);
    }
    let lossy = record.boots.remove(0);
    assert!(lossy.epochs.iter().all(|mark| mark.epoch.sequence != sequence));
    let report = verify(&lossy, 0);
    assert!(report.is_exact(), "{report:?}");
    assert!(report.samples_uncertain > 0);
}

#[test]
fn parameters_that_were_not_recorded_are_named() {
    let mut boot = boot(&Device::new().run());
    boot.parameters.clear();
    let report = verify(&boot, 0);
    assert_eq!(report.epochs_unusable as usize, boot.epochs.len());
    assert!(!report.is_exact());
    let error = boot.parameters_of(&boot.epochs[0].epoch).unwrap_err();
    assert!(error.message().contains(&format!("{:08x}", boot.epochs[0].epoch.parameters)));
}

#[test]
fn numbers_that_wrap_are_replayed_and_their_times_found() {
    let first = 0_u32.wrapping_sub(450);
    let boot = boot(&Device::from(first).run());
    assert_eq!(boot.raw.len(), 900);
    for step in 0..900 {
        let time = boot.time_of(first.wrapping_add(step)).expect("it arrived");
        // To what a period that changes within a batch makes of it.
        assert!(time.0.abs_diff(u64::from(step) * 10_000) < 500, "{step}: {time:?}");
    }
    let before = boot.epochs.iter().filter(|mark| mark.epoch.sequence >= first).count();
    assert!(0 < before && before < boot.epochs.len());
    for epoch in 0..boot.epochs.len() {
        let report = verify(&boot, epoch);
        assert!(report.is_exact(), "{epoch}: {report:?}");
        assert_eq!(report.breaks, 0, "{epoch}");
        let behind = boot.epochs[epoch].epoch.sequence.wrapping_sub(first);
        assert_eq!(report.samples, u64::from(900 - behind));
        assert_eq!(report.corrected_compared, report.samples);
        assert_eq!(report.navigation_compared, report.samples / 10);
    }
}
