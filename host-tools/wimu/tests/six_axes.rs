//! Recordings of a sensor with a gyroscope, and of a second sensor on the same board. Their frames are made here,
//! as a board sends them.

use crate::kit;

use std::fs;
use std::num::NonZeroU8;
use std::path::Path;

use kit::{folder, wimu};
use serde_json::Value;
use wimu_host::calibration::{Calibration, parameter_id, source};
use wimu_host::capture::{Boot, Link};
use wimu_host::decode::{Decoder, LinkStatistics, TimedSample};
use wimu_host::mcap_file::{ClockAnchor, RecordingWriter};
use wimu_host::motion::{MotionRecording, TableOptions};
use wimu_host::replay::verify;
use wimu_integrator::{Config, Flags, Integrator, Saturation, Transition};
use wimu_link::batch::{self, Layout, Stream};
use wimu_link::message::{
    Attitude, BusFault, Epoch, EpochGyroscope, EpochReason, Event, Navigation, SetBytes,
};
use wimu_link::{Hello, LinkRole, MAX_FRAME, Telemetry};
use wimu_model::{
    Alignment, AngularRateQ20, CentiCelsius, CompiledSet, Corrector, Counts, DeviceTimeUs,
    ErrorModel, ErrorTerms, GyroscopeCorrector, GyroscopeModel, GyroscopeParameters,
    GyroscopeTerms, ParameterSet, PeriodNs, Sensitivity, SpecificForceQ16, WideCounts,
};
use wimu_testkit::Random;

const LSB_PER_G: f64 = 16384.0;
/// ±250 °/s.
const RAD_S_PER_LSB: f64 = 1.527_163e-4;
const FULL_SCALE: i32 = 32_767;
const PERIOD_NS: u32 = 10_000_000;
const BATCH: usize = 16;
const STEPS: u32 = 75 * BATCH as u32;
/// Samples with saturated rates, a change of temperature, and samples without a gyroscope where it stops.
const SATURATED: std::ops::Range<u32> = 450..460;
const WARMER: u32 = 333;
const STOPPED: std::ops::Range<u32> = 640..720;
/// Number of samples of the first sensor for each sample of the second.
const SECOND_EVERY: u32 = 5;

#[derive(Clone, Copy)]
enum What {
    Other,
    Raw(u32),
}

struct Frame {
    what: What,
    time_us: u64,
    bytes: Vec<u8>,
}

fn time(step: u32) -> DeviceTimeUs {
    DeviceTimeUs(1_000_000 + u64::from(step) * u64::from(PERIOD_NS / 1000))
}

fn parameters() -> ParameterSet {
    let model = GyroscopeModel::new(GyroscopeTerms {
        bias_rad_s: [0.01, -0.02, 0.005],
        matrix: [[1.02, 0.01, 0.0], [0.0, 0.97, 0.0], [0.0, 0.002, 1.01]],
        ..GyroscopeTerms::default()
    });
    let sd = [[1e-3, 2e-3, 3e-3].as_slice(), &[0.0; 9]].concat();
    let sd = sd.try_into().ok();
    ParameterSet {
        model: ErrorModel::new(ErrorTerms { bias_mps2: [0.3, -0.2, 0.1], ..ErrorTerms::default() })
            .unwrap(),
        // A quarter turn about z.
        alignment: Alignment::from_quaternion([0.5_f64.sqrt(), 0.0, 0.0, 0.5_f64.sqrt()]).unwrap(),
        gyroscope: GyroscopeParameters::new(250, RAD_S_PER_LSB, model.unwrap(), sd).ok(),
        ..ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(LSB_PER_G).unwrap())
    }
}

fn compiled(set: &ParameterSet) -> CompiledSet {
    CompiledSet::compile(set, parameter_id(set), 0).unwrap()
}

/// What a device does per sample, without a sensor or a link: the same crates, and frames.
struct Device {
    set: ParameterSet,
    temperature: CentiCelsius,
    correctors: (Corrector, GyroscopeCorrector),
    integrator: Integrator,
    epochs: u8,
    since_epoch: u32,
    frames: Vec<Frame>,
}

type Pair = (Counts, Counts);
type Corrected = (SpecificForceQ16, AngularRateQ20);

impl Device {
    fn compile(set: &ParameterSet, at: CentiCelsius) -> (Corrector, GyroscopeCorrector) {
        let set = compiled(set);
        (set.corrector(Some(at)), set.gyroscope(Some(at)).unwrap())
    }

    fn send(
        &mut self,
        what: What,
        time: DeviceTimeUs,
        encode: impl FnOnce(&mut [u8]) -> Result<usize, wimu_link::frame::EncodeError>,
    ) {
        let mut frame = [0; MAX_FRAME];
        let length = encode(&mut frame).unwrap();
        self.frames.push(Frame { what, time_us: time.0, bytes: frame[..length].to_vec() });
    }

    fn say(&mut self, what: What, step: u32, message: Telemetry) {
        self.send(what, time(step), |frame| message.encode(frame));
    }

    fn epoch(&mut self, step: u32, reason: EpochReason) {
        self.since_epoch = 0;
        self.epochs = self.epochs.wrapping_add(1);
        let epoch = Telemetry::Epoch(Epoch {
            reason,
            number: self.epochs,
            sequence: step,
            time_us: time(step).0,
            period_ns: PERIOD_NS,
            range_g: 2,
            sensitivity_lsb_per_g: LSB_PER_G,
            full_scale: FULL_SCALE,
            parameters: parameter_id(&self.set).0,
            temperature_centi_c: Some(self.temperature.0),
            state: self.integrator.state(),
            gyroscope: Some(EpochGyroscope {
                rad_s_per_lsb: RAD_S_PER_LSB,
                full_scale: FULL_SCALE,
            }),
            ..Epoch::default()
        });
        self.say(What::Other, step, epoch);
    }

    /// The second sensor, ±200 g with counts of 20 bits, for a second from this step on.
    fn second(&mut self, step: u32) {
        let count = 100 / SECOND_EVERY;
        let first = step / SECOND_EVERY;
        let epoch = Telemetry::Epoch(Epoch {
            reason: EpochReason::Periodic,
            number: (step / 100) as u8,
            sequence: first,
            time_us: time(step).0,
            period_ns: PERIOD_NS * SECOND_EVERY,
            range_g: 200,
            sensitivity_lsb_per_g: 2560.0,
            full_scale: 512_000,
            sensor: 1,
            ..Epoch::default()
        });
        self.say(What::Other, step, epoch);
        let samples: Vec<_> = (first..first + count).map(second_counts).collect();
        let layout = Layout { sensor: 1, every: NonZeroU8::MIN };
        self.send(What::Other, time(step), |frame| {
            batch::encode_with(layout, first, time(step), &samples, frame)
        });
    }

    fn sample(&mut self, step: u32, (force, rate): Pair) -> (Corrected, Transition) {
        let corrected_force = self.correctors.0.correct(force);
        let corrected_rate = self.correctors.1.correct(rate, corrected_force);
        let saturation = Saturation {
            accelerometer: force.saturated(FULL_SCALE),
            gyroscope: rate.saturated(FULL_SCALE),
        };
        let transition =
            (self.integrator).step_inertial(corrected_force, corrected_rate, saturation);
        if step.is_multiple_of(10) {
            let state = self.integrator.navigation();
            let navigation = Telemetry::Navigation(Navigation::new(step, &state));
            self.say(What::Other, step, navigation);
            if let Some(quaternion) = state.attitude {
                let sequence = step;
                let attitude = Telemetry::Attitude(Attitude { sequence, quaternion });
                self.say(What::Other, step, attitude);
            }
        }
        ((corrected_force, corrected_rate), transition)
    }
}

fn second_counts(sequence: u32) -> WideCounts {
    WideCounts([sequence as i32, -400_000, 2560])
}

/// Rest, a rotation with a push, and rest again, in sensor axes.
fn counts(step: u32, random: &mut Random) -> Pair {
    let mut noise = || random.below(16) as i16 - 8;
    let push = match step {
        420..470 => 2000,
        470..520 => -2000,
        _ => 0,
    };
    let rate = match step {
        _ if SATURATED.contains(&step) => i16::MAX,
        400..520 => 6000,
        _ => 0,
    };
    (
        Counts([push + noise(), noise(), 16384 + noise()]),
        Counts([65 + noise(), -131 + noise(), rate.saturating_add(33 + noise())]),
    )
}

/// The frames of a recording, with the samples of sensor 0; `stops`: the gyroscope stops for a while.
fn run(stops: bool) -> (Vec<Frame>, Vec<Pair>) {
    let set = parameters();
    let temperature = CentiCelsius(2500);
    let config = Config::new(PeriodNs(PERIOD_NS)).unwrap();
    let mut device = Device {
        set,
        temperature,
        correctors: Device::compile(&set, temperature),
        integrator: Integrator::new(config),
        epochs: 0,
        since_epoch: 0,
        frames: Vec::new(),
    };
    let parameters = SetBytes::from(&compiled(&set));
    device.say(What::Other, 0, Telemetry::Parameters(parameters));
    let mut random = Random::new(6);
    let (mut all, mut raw, mut corrected) = (Vec::new(), Vec::new(), Vec::new());
    let mut due = Some(EpochReason::Start);
    for step in 0..STEPS {
        if step.is_multiple_of(100) {
            device.second(step);
        }
        let pair = counts(step, &mut random);
        all.push(pair);
        raw.push(pair);
        let is_stopped = stops && STOPPED.contains(&step);
        if stops && step == STOPPED.start {
            let event = Event::GyroscopeLost(BusFault::Timeout);
            let time_us = time(step).0;
            device.say(What::Other, step, Telemetry::Event { time_us, event });
        }
        if stops && step == STOPPED.end {
            device.integrator.gap();
            due = Some(EpochReason::Gap);
        }
        if step == WARMER {
            device.temperature = CentiCelsius(2612);
            device.correctors = Device::compile(&device.set, device.temperature);
            due = Some(EpochReason::Temperature);
        }
        if !is_stopped {
            if let Some(reason) = due.take() {
                device.epoch(step, reason);
            }
            let (sample, transition) = device.sample(step, pair);
            corrected.push(sample);
            device.since_epoch += 1;
            if matches!(transition, Transition::Rest | Transition::Motion) {
                due = Some(EpochReason::Stillness);
            } else if device.since_epoch >= 90 {
                due = Some(EpochReason::Periodic);
            }
        }
        if raw.len() == BATCH {
            let first = step + 1 - BATCH as u32;
            let raw = std::mem::take(&mut raw);
            let corrected = std::mem::take(&mut corrected);
            let at = time(first);
            if is_stopped {
                let forces: Vec<Counts> = raw.iter().map(|(force, _)| *force).collect();
                device.send(What::Raw(first), at, |frame| batch::encode(first, at, &forces, frame));
            } else {
                device.send(What::Raw(first), at, |frame| batch::encode(first, at, &raw, frame));
                device.send(What::Other, at, |frame| batch::encode(first, at, &corrected, frame));
            }
        }
    }
    (device.frames, all)
}

fn hello(role: LinkRole) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let hello = Hello { boot_count: 1, sensitivity_known: true, ..Hello::new(role) };
    let length = hello.encode(&mut frame).unwrap();
    frame[..length].to_vec()
}

/// What a host has of these frames.
fn heard<'a>(frames: impl IntoIterator<Item = &'a Frame>) -> (Boot, LinkStatistics) {
    let mut history = Link::new(LinkRole::Cable);
    let mut decoder = Decoder::new();
    for frame in frames {
        decoder.push(frame.time_us * 1000, &frame.bytes, |arrival| {
            history.take(&arrival);
        });
    }
    assert_eq!(history.boots.len(), 1);
    assert_eq!(decoder.statistics().frames_unreadable, 0);
    (history.boots.remove(0), decoder.statistics())
}

/// A recording of both links; the wireless one loses every tenth raw batch.
fn file(folder: &Path, stops: bool) -> String {
    file_with(folder, stops, true)
}

/// The same with or without the source of the parameters.
fn file_with(folder: &Path, stops: bool, has_source: bool) -> String {
    let path = folder.join(format!("six-{has_source}.mcap"));
    let anchor = ClockAnchor { monotonic_ns: 0, utc_ns: 1_795_222_920_000_000_000 };
    let mut writer = RecordingWriter::create(&path, anchor).unwrap();
    if has_source {
        source::learn(&parameters());
        writer.keep_calibration(parameter_id(&parameters())).unwrap();
    }
    for role in [LinkRole::Cable, LinkRole::Wireless] {
        writer.append(role, 1_000_000_000, &hello(role)).unwrap();
    }
    for frame in run(stops).0 {
        let at_ns = frame.time_us * 1000 + 200_000_000;
        writer.append(LinkRole::Cable, at_ns, &frame.bytes).unwrap();
        if !matches!(frame.what, What::Raw(first) if first % 160 == 32) {
            writer.append(LinkRole::Wireless, at_ns + 5_000_000, &frame.bytes).unwrap();
        }
    }
    writer.finish().unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn samples_of_six_axes_are_decoded_and_replayed_bit_for_bit_from_any_epoch() {
    let (frames, sent) = run(false);
    let (boot, statistics) = heard(&frames);
    let received: Vec<Pair> = boot
        .raw()
        .iter()
        .map(|sample| {
            let narrow = |axes: [i32; 3]| Counts(axes.map(|axis| axis as i16));
            (narrow(sample.value), narrow(sample.rate.unwrap()))
        })
        .collect();
    assert_eq!(received, sent);
    assert_eq!(statistics.raw.received, u64::from(STEPS));
    let flagged = |n: &Navigation| Flags(n.flags).contains(Flags::GYROSCOPE_SATURATED);
    assert!(boot.navigation.iter().any(flagged));
    assert!(boot.epochs().len() >= 12, "{}", boot.epochs().len());
    for epoch in 0..boot.epochs().len() {
        let report = verify(&boot, epoch);
        assert!(report.is_exact(), "{epoch}: {report:?}");
        assert_eq!((report.breaks, report.epochs_unusable), (0, 0));
        let samples = u64::from(STEPS - boot.epochs()[epoch].epoch.sequence);
        assert_eq!((report.samples, report.rates_compared), (samples, samples));
        assert_eq!(report.states_compared, (boot.epochs().len() - epoch - 1) as u64);
        let due = |a: &&Attitude| a.sequence >= boot.epochs()[epoch].epoch.sequence;
        let attitudes = boot.attitude.iter().filter(due).count() as u64;
        assert!(attitudes > 0 || epoch + 1 == boot.epochs().len());
        assert_eq!(report.attitudes_compared, attitudes);
    }
}

fn samples(boot: &mut Boot, stream: Stream) -> &mut Vec<TimedSample> {
    boot.samples.get_mut(&(0, stream)).unwrap()
}

#[test]
fn a_difference_in_rate_or_attitude_is_found_and_located() {
    let (intact, _) = heard(&run(false).0);
    let mut other = intact.clone();
    samples(&mut other, Stream::Corrected)[500].rate.as_mut().unwrap()[2] += 1;
    let report = verify(&other, 0);
    assert_eq!((report.rates_differ, report.corrected_differ), (1, 0));
    assert_eq!(report.first_difference, Some(500));
    assert!(!report.is_exact());

    let mut other = intact.clone();
    other.attitude[20].quaternion[0] ^= 1;
    let report = verify(&other, 0);
    assert_eq!(report.attitudes_differ, 1);
    assert!(!report.is_exact());

    let mut other = intact;
    samples(&mut other, Stream::Raw)[320].rate.as_mut().unwrap()[1] += 1;
    let report = verify(&other, 0);
    assert_eq!((report.rates_differ, report.corrected_differ), (1, 0));
    assert!(report.states_differ > 0, "{report:?}");
}

#[test]
fn where_the_gyroscope_stops_the_replay_pauses_until_the_next_epoch() {
    let (boot, statistics) = heard(&run(true).0);
    assert_eq!(statistics.raw.missing, 0);
    let without = boot.raw().iter().filter(|sample| sample.rate.is_none());
    assert_eq!(without.count(), STOPPED.len());
    let report = verify(&boot, 0);
    assert!(report.is_exact() && report.breaks == 1, "{report:?}");
    assert_eq!(report.samples as usize, STEPS as usize - STOPPED.len());

    let folder = folder();
    let table = folder.path().join("raw.csv").display().to_string();
    wimu(&["convert", &file(folder.path(), true), "-o", &table]).succeeds();
    let (header, rows) = table_of(&table);
    let rate = column(&header, "Gyroscope X (LSB)");
    let empty = rows.iter().filter(|row| row[rate].is_empty());
    assert_eq!(empty.count(), STOPPED.len());
}

#[test]
fn a_second_sensor_has_its_own_numbers_times_and_units() {
    let (boot, statistics) = heard(&run(false).0);
    let second = boot.of(1, Stream::Raw);
    assert_eq!(boot.samples.len(), 3);
    assert_eq!(second.len(), (STEPS / SECOND_EVERY) as usize);
    assert_eq!(statistics.further.received, second.len() as u64);
    for (number, sample) in (0..).zip(second) {
        assert_eq!(sample.sequence, number);
        assert_eq!(sample.time, time(number * SECOND_EVERY));
        assert_eq!(WideCounts(sample.value), second_counts(number));
        assert_eq!(sample.rate, None);
    }
    assert!(boot.epochs_of(1).iter().all(|mark| mark.epoch.range_g == 200));
    assert!(boot.epochs().iter().all(|mark| mark.epoch.range_g == 2));
}

fn table_of(path: &str) -> (Vec<String>, Vec<Vec<String>>) {
    let text = fs::read_to_string(path).unwrap();
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect());
    (lines.next().unwrap(), lines.collect())
}

fn column(header: &[String], name: &str) -> usize {
    let found = header.iter().position(|column| column == name);
    found.unwrap_or_else(|| panic!("{name}: {header:?}"))
}

fn numbers<const N: usize>(
    (header, rows): &(Vec<String>, Vec<Vec<String>>),
    names: [&str; N],
) -> Vec<[f64; N]> {
    let columns = names.map(|name| column(header, name));
    let number = |row: &Vec<String>, at: usize| row[at].parse().unwrap_or(f64::NAN);
    rows.iter().map(|row| columns.map(|at| number(row, at))).collect()
}

#[test]
fn exported_tables_have_rates_and_attitudes_and_serve_as_input() {
    let folder = folder();
    let session = file(folder.path(), false);
    let sent = run(false).1;
    let table = |stream: &str, more: &[&str]| {
        let path = folder.path().join(format!("{stream}{}.csv", more.len()));
        let path = path.to_str().unwrap().to_owned();
        let arguments = ["convert", &session, "--stream", stream, "-o", &path];
        let report = wimu(&[&arguments[..], more].concat()).succeeds();
        assert_eq!(report["sensors"], serde_json::json!([0, 1]));
        (table_of(&path), path)
    };
    let (raw, raw_path) = table("raw", &[]);
    let rates = numbers(&raw, ["Gyroscope X (LSB)", "Gyroscope Y (LSB)", "Gyroscope Z (LSB)"]);
    let expected: Vec<_> = sent.iter().map(|(_, rate)| rate.0.map(f64::from)).collect();
    assert_eq!(rates, expected);
    let scale = numbers(&raw, ["Gyroscope Scale (rad/s/LSB)"]);
    assert!(scale.iter().all(|[scale]| *scale == RAD_S_PER_LSB));

    let (corrected, corrected_path) = table("corrected", &[]);
    let rates =
        numbers(&corrected, ["Gyroscope X (rad/s)", "Gyroscope Y (rad/s)", "Gyroscope Z (rad/s)"]);
    let (boot, _) = heard(&run(false).0);
    for (found, sample) in rates.iter().zip(boot.corrected()) {
        assert_eq!(*found, AngularRateQ20(sample.rate.unwrap()).to_rad_s());
    }

    let (navigation, _) = table("navigation", &[]);
    let quaternions =
        numbers(&navigation, ["Quaternion W", "Quaternion X", "Quaternion Y", "Quaternion Z"]);
    let units = quaternions.iter().filter(|q| !q[0].is_nan());
    assert_eq!(units.clone().count(), boot.attitude.len());
    for q in units {
        let norm = q.iter().map(|part| part * part).sum::<f64>();
        assert!((norm - 1.0).abs() < 1e-6, "{norm}");
    }

    let (second, _) = table("raw", &["--sensor", "1"]);
    let values = numbers(
        &second,
        ["Accelerometer 1 X (LSB)", "Accelerometer 1 Y (LSB)", "Accelerometer 1 Z (LSB)"],
    );
    let expected: Vec<_> =
        (0..STEPS / SECOND_EVERY).map(|number| second_counts(number).0.map(f64::from)).collect();
    assert_eq!(values, expected);
    let out = folder.path().join("none.csv").display().to_string();
    let none = wimu(&["convert", &session, "--sensor", "3", "-o", &out]);
    let none = none.fails(2, "no_rows");
    assert!(none["remedy"].as_str().unwrap().contains("[0, 1]"), "{none}");

    let options = TableOptions {
        calibration: Some(Calibration::held(&parameters()).sensor().clone()),
        ..TableOptions::default()
    };
    let motion = MotionRecording::from_csv_with(Path::new(&raw_path), &options).unwrap();
    for (found, sample) in motion.samples.iter().zip(boot.corrected()) {
        let expected = AngularRateQ20(sample.rate.unwrap()).to_rad_s();
        for (found, expected) in found.rate_rad_s.unwrap().iter().zip(expected) {
            assert!((found - expected).abs() < 3e-6, "{found} {expected}");
        }
    }

    let model = folder.path().join("link.json").display().to_string();
    let text = serde_json::json!({
        "schema": "wimu.link_model/1", "link": "cable", "device_id": "", "pairs": 9,
        "bias_mps2": ([0.0; 3]), "scale": ([1.0; 3]), "bias_sd_mps2": ([0.1; 3]), "scale_sd": ([0.1; 3]),
    });
    fs::write(&model, text.to_string()).unwrap();
    let both = ["convert", &session, "--sensor", "1", "--with", &model];
    wimu(&[&both[..], &["-o", &out]].concat()).fails(2, "usage");

    for input in [&raw_path, &corrected_path, &session] {
        let mut arguments = vec!["navigate", input];
        if input == &raw_path {
            arguments.extend(["--sensitivity", "16384"]);
        }
        let report = wimu(&arguments).succeeds();
        let path = report.get("path").unwrap_or(&report);
        assert_eq!(path["method"], "strapdown");
    }
}

/// The numbers of each `sensor_msgs/msg/Imu` on a topic.
fn imu(path: &str, topic: &str) -> Vec<[f64; 37]> {
    let bytes = fs::read(path).unwrap();
    mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(|message| message.unwrap())
        .filter(|message| message.channel.topic == topic)
        .map(|message| {
            let numbers = &message.data[message.data.len() - 37 * 8..];
            let mut fields = [0.0; 37];
            for (field, bytes) in fields.iter_mut().zip(numbers.chunks(8)) {
                *field = f64::from_le_bytes(bytes.try_into().unwrap());
            }
            fields
        })
        .collect()
}

#[test]
fn ros_messages_have_angular_velocity_with_covariance_and_orientation() {
    let folder = folder();
    let session = file(folder.path(), false);
    let out = folder.path().join("decoded.mcap").display().to_string();
    wimu(&["convert", &session, "-o", &out]).succeeds();
    let (boot, _) = heard(&run(false).0);
    let data = imu(&out, "/cable/imu/data");
    assert_eq!(data.len(), boot.corrected().len());
    for (fields, sample) in data.iter().zip(boot.corrected()) {
        let rate = AngularRateQ20(sample.rate.unwrap()).to_rad_s();
        assert_eq!(fields[13..16], rate);
        // Of the bias, turned by a quarter about z.
        let [xx, yy, zz] = [16, 20, 24].map(|at| fields[at].sqrt());
        for (found, expected) in [(xx, 2e-3), (yy, 1e-3), (zz, 3e-3)] {
            assert!((found - expected).abs() < 1e-6, "{found}");
        }
        let sent = boot.attitude.iter().find(|a| a.sequence == sample.sequence);
        match sent.map(Attitude::to_quaternion) {
            Some([w, x, y, z]) => assert_eq!(fields[..5], [x, y, z, w, 0.0]),
            None => assert_eq!(fields[..5], [0.0, 0.0, 0.0, 1.0, -1.0]),
        }
    }
    let raw = imu(&out, "/cable/imu/data_raw");
    assert_eq!(raw.len(), boot.raw().len());
    for (fields, sample) in raw.iter().zip(boot.raw()) {
        let expected = sample.rate.unwrap().map(|lsb| f64::from(lsb) * RAD_S_PER_LSB);
        assert_eq!((&fields[13..16], fields[16]), (&expected[..], 0.0));
    }
    let second = imu(&out, "/cable/imu_1/data_raw");
    assert_eq!(second.len(), boot.of(1, Stream::Raw).len());
    assert!(second.iter().all(|fields| fields[16] == -1.0));
}

#[test]
fn a_calibration_whose_source_is_not_known_corrects_with_its_integers() {
    let folder = folder();
    let [known, unknown] = [true, false].map(|has| file_with(folder.path(), false, has));
    let path = |session: &str| {
        let report = wimu(&["navigate", session, "--zupt", "off"]).succeeds();
        report["starts"][0]["recomputed"].clone()
    };
    assert!(path(&known)["final_position_m"].is_array(), "{}", path(&known));
    assert_eq!(path(&known), path(&unknown));

    let notes = |session: &str| {
        let ran = wimu(&["align", session, "--up", "z", "--forward"]);
        let problems = ran.problems();
        problems.into_iter().filter(|p| p["code"] == "source_unknown").collect::<Vec<_>>()
    };
    assert_eq!(notes(&known), Vec::<Value>::new());
    let text = notes(&unknown)[0]["text"].to_string();
    assert!(text.contains("part for the gyroscope is left out"), "{text}");
}

#[test]
fn a_calibration_exported_for_a_device_is_the_set_that_the_device_compiles() {
    let folder = folder();
    let [calibration, out] =
        ["CAL.json", "sensor.wimu"].map(|name| folder.path().join(name).display().to_string());
    Calibration::new(&parameters(), &[], "").write(Path::new(&calibration)).unwrap();
    let report = wimu(&["convert", &calibration, "--to", "device", "-o", &out]).succeeds();
    let bytes = fs::read(&out).unwrap();
    assert_eq!(report["bytes"], bytes.len());
    assert_eq!(CompiledSet::from_bytes(&bytes).unwrap(), compiled(&parameters()));
}

#[test]
fn info_monitor_and_compare_know_the_gyroscope_and_the_second_sensor() {
    let folder = folder();
    let session = file(folder.path(), false);
    let info = wimu(&["info", &session]).succeeds();
    let link = &info["links"][0];
    let (first, second) = (&link["sensors"][0], &link["sensors"][1]);
    assert_eq!(first["angular_rates"], 2 * STEPS);
    let range = first["gyroscope_range_dps"].as_f64().unwrap();
    assert!((range - 286.7).abs() < 0.1, "{range}");
    assert_eq!(
        (&second["raw_samples"], &second["rate_hz"]),
        (&(STEPS / SECOND_EVERY).into(), &20.0.into())
    );
    assert_eq!(second["gyroscope_range_dps"], Value::Null);
    assert_eq!(link["statistics"]["raw"]["missing"], 0);

    let monitor = wimu(&["monitor", &session]);
    assert_eq!(monitor.code, 0, "{monitor:?}");
    let lines = monitor.objects();
    assert_eq!(lines.len(), STEPS as usize);
    let last = &lines[lines.len() - 1];
    assert_eq!(last["angular_rate_rad_s"].as_array().unwrap().len(), 3);
    assert_eq!(last["raw_angular_rate_lsb"].as_array().unwrap().len(), 3);
    assert_eq!(last["quaternion"].as_array().unwrap().len(), 4);

    let compare = wimu(&["compare", &session]).succeeds();
    let pairs = compare["pairs"].as_u64().unwrap();
    assert_eq!(compare["identical"], pairs);
    assert_eq!(compare["with_rates"], pairs);
    assert_eq!(compare["rates_differ"], 0);
    assert_eq!(compare["links"][1]["lost"], u64::from(STEPS) - pairs);
}
