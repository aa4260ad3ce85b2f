//! The smallest device: it sends raw samples and receives nothing.

use heapless::Vec;
use wimu_model::{Counts, DeviceTimeUs, PeriodNs, Sensitivity};

use crate::batch::{self, MAX_BATCH, Sample};
use crate::frame::{EncodeError, MAX_FRAME};
use crate::hello::Hello;
use crate::message::{Epoch, EpochGyroscope, EpochReason, Telemetry};

/// Samples of a batch.
const BATCH: usize = 16;
/// Age at which a batch is sent before it is full, µs.
const OLDEST_US: u64 = 250_000;
/// Interval of `Hello` and [`Epoch`], µs.
const EPOCH_US: u64 = 1_000_000;

/// The sensor of a [`RawStream`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Sensor {
    /// Sample period.
    pub period: PeriodNs,
    /// Full-scale range, ± *g*.
    pub range_g: u8,
    /// Nominal sensitivity at that range.
    pub sensitivity: Sensitivity,
    /// Positive full scale of the counts, LSB: at or beyond it an axis is saturated.
    pub full_scale: i32,
    /// The gyroscope, with samples of six axes.
    pub gyroscope: Option<EpochGyroscope>,
}

/// What a device sends that has no [`Responder`](crate::Responder): `wimu monitor` and `wimu record` read it on any
/// UART. Sequence numbers, epochs and batches are its own. The link is 115,200 baud or more for 400 samples a second.
///
/// ```
/// use wimu_integrator::{Config, Integrator};
/// use wimu_link::stream::{RawStream, Sensor};
/// use wimu_link::{Hello, LinkRole};
/// use wimu_model::{CompiledSet, Counts, DeviceTimeUs, PeriodNs, Sensitivity};
///
/// # fn read() -> Option<(DeviceTimeUs, Counts)> { None }
/// # let (set, mut uart) = (set()?, |_: &[u8]| Ok::<(), core::fmt::Error>(()));
/// // let set = include_bytes!("sensor.wimu"): `wimu convert CAL.json --to device -o sensor.wimu`
/// let corrector = CompiledSet::from_bytes(&set)?.corrector(None);
/// let period = PeriodNs(5_000_000);
/// let mut integrator = Integrator::three_axes(Config::new(period)?);
/// let sensitivity = Sensitivity::from_lsb_per_g(16384.0)?;
/// let sensor = Sensor { period, range_g: 2, sensitivity, full_scale: 32_767, gyroscope: None };
/// let mut stream = RawStream::new(Hello { device_id: 7, ..Hello::new(LinkRole::Cable) }, sensor);
///
/// while let Some((time, counts)) = read() {
///     integrator.step(corrector.correct(counts), counts.saturated(sensor.full_scale));
///     stream.sample(time, counts, &mut uart)?;
///     let navigation = integrator.navigation();
///     println!("{:?} m", navigation.position.to_m());
/// }
/// # fn set() -> Result<Vec<u8>, Box<dyn std::error::Error>> {
/// #     let sensitivity = Sensitivity::from_lsb_per_g(16384.0)?;
/// #     let set = wimu_model::ParameterSet::uncalibrated(2, sensitivity);
/// #     let mut bytes = [0; CompiledSet::MAX_BYTES];
/// #     let length = CompiledSet::compile(&set, wimu_model::ParameterId(1), 0)?.to_bytes(&mut bytes);
/// #     Ok(bytes[..length].to_vec())
/// # }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct RawStream<S: Sample = Counts> {
    hello: Hello,
    sensor: Sensor,
    /// Sequence number of the next sample.
    sequence: u32,
    epochs: u8,
    /// When the next epoch is due, µs; `None` at the start.
    epoch_at_us: Option<u64>,
    missed: u32,
    batch: Vec<S, MAX_BATCH>,
    first_time: DeviceTimeUs,
}

impl<S: Sample> RawStream<S> {
    /// Before the first sample. `hello` identifies the device.
    pub const fn new(hello: Hello, sensor: Sensor) -> Self {
        Self {
            hello,
            sensor,
            sequence: 0,
            epochs: 0,
            epoch_at_us: None,
            missed: 0,
            batch: Vec::new(),
            first_time: DeviceTimeUs(0),
        }
    }

    /// Takes the next sample, at the device time `time`, and passes the frames that are due to `send`.
    ///
    /// # Errors
    /// That of `send`; the frame that it was given is lost, which the host notices.
    pub fn sample<E>(
        &mut self,
        time: DeviceTimeUs,
        counts: S,
        mut send: impl FnMut(&[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        let missed = core::mem::take(&mut self.missed);
        let age_us = time.0.saturating_sub(self.first_time.0);
        if self.batch.len() >= BATCH || age_us >= OLDEST_US || missed > 0 {
            self.flush(&mut send)?;
        }
        self.sequence = self.sequence.wrapping_add(missed);
        let reason = match self.epoch_at_us {
            None => Some(EpochReason::Start),
            Some(_) if missed > 0 => Some(EpochReason::Gap),
            Some(due) => (time.0 >= due).then_some(EpochReason::Periodic),
        };
        if let Some(reason) = reason {
            self.introduce(time, reason, &mut send)?;
        }
        if self.batch.is_empty() {
            self.first_time = time;
        }
        // There is room: it is sent at half of that.
        let _ = self.batch.push(counts);
        self.sequence = self.sequence.wrapping_add(1);
        Ok(())
    }

    /// Samples were lost before the next one: as many numbers are skipped.
    pub fn gap(&mut self, missed: u32) {
        self.missed = self.missed.saturating_add(missed);
    }

    fn flush<E>(&mut self, send: &mut impl FnMut(&[u8]) -> Result<(), E>) -> Result<(), E> {
        let samples = core::mem::take(&mut self.batch);
        let first = self.sequence.wrapping_sub(samples.len() as u32);
        with_frame(send, |frame| batch::encode(first, self.first_time, &samples, frame))
    }

    /// Sends `Hello` and an epoch.
    fn introduce<E>(
        &mut self,
        time: DeviceTimeUs,
        reason: EpochReason,
        send: &mut impl FnMut(&[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        self.epoch_at_us = Some(time.0.saturating_add(EPOCH_US));
        let hello = Hello { uptime_us: time.0, ..self.hello };
        with_frame(send, |frame| hello.encode(frame))?;
        let epoch = Telemetry::Epoch(Epoch {
            reason,
            number: self.epochs,
            sequence: self.sequence,
            time_us: time.0,
            period_ns: self.sensor.period.0,
            range_g: self.sensor.range_g,
            sensitivity_lsb_per_g: self.sensor.sensitivity.lsb_per_g(),
            full_scale: self.sensor.full_scale,
            gyroscope: self.sensor.gyroscope,
            ..Epoch::default()
        });
        self.epochs = self.epochs.wrapping_add(1);
        with_frame(send, |frame| epoch.encode(frame))
    }
}

/// Encodes a frame and passes it on.
fn with_frame<E>(
    send: &mut impl FnMut(&[u8]) -> Result<(), E>,
    encode: impl FnOnce(&mut [u8]) -> Result<usize, EncodeError>,
) -> Result<(), E> {
    let mut frame = [0; MAX_FRAME];
    // An empty batch has no frame; everything else fits.
    let length = encode(&mut frame).unwrap_or(0);
    match frame.get(..length) {
        Some(frame) if length > 0 => send(frame),
        _ => Ok(()),
    }
}
