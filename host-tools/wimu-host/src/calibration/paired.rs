//! Two streams of samples of one motion: the wireless link and the cable, or two accelerometers of a recording.

use wimu_link::LinkRole;
use wimu_link::batch::Stream;
use wimu_model::{Sensitivity, SensorId};

use super::Source;
use super::poses::{median_magnitude, range};
use crate::capture;
use crate::decode::sequence_order;
use crate::recording::{OutputUnit, Quantity, Recording, Selection};
use crate::{Code, Result};

/// Two streams of one motion, sample by sample.
#[derive(Clone, Debug)]
pub struct Paired {
    /// Name of the data in errors.
    pub name: String,
    /// The reference.
    pub reference: String,
    /// The output that is compared with it.
    pub output: String,
    /// Reference and output, m/s², sensor axes, in order.
    pub pairs: Vec<[[f64; 3]; 2]>,
    /// Raw samples left out because their range is unknown: no epoch covers them.
    pub without_unit: usize,
    /// Sample rate, Hz.
    pub rate_hz: f64,
    /// Whether both are of one sensor, over two links: their axes are parallel.
    pub one_sensor: bool,
    /// Sensitivity that converted counts into m/s², or that a board needs for data in m/s².
    pub sensitivity: Option<Sensitivity>,
    /// Full-scale range, ± *g*, and its source.
    pub range: Option<(u8, Source)>,
    /// The accelerometer, where a device identified it.
    pub sensor: Option<SensorId>,
    /// Its device.
    pub device_id: Option<u64>,
}

impl Paired {
    /// Two accelerometers of a recording: `reference` (the first if `None`) and `output` (the other one if `None` and
    /// there are two).
    ///
    /// `sensitivity`, LSB/g, is that of both; without it, the median magnitude of the reference's counts is taken as 1 g. For
    /// data in m/s² it is only stored for a board. `range_g`, ± *g*, is for data that do not contain it.
    ///
    /// # Errors
    /// Those of [`Recording::samples`]; `usage` when the recording does not have the two.
    pub fn of_recording(
        recording: &Recording,
        chosen: [Option<u8>; 2],
        sensitivity: Option<Sensitivity>,
        range_g: Option<u8>,
    ) -> Result<Self> {
        let [reference, output] = two(recording, chosen)?;
        let samples =
            |sensor| recording.samples(Selection { accelerometer: Some(sensor), poses: false });
        let (x, y) = (samples(reference)?, samples(output)?);
        let found = match x.unit {
            OutputUnit::Counts { nominal: None, .. } => {
                Sensitivity::from_lsb_per_g(median_magnitude(&x)).map(Some)
            }
            OutputUnit::Counts { nominal, .. } => Ok(nominal),
            OutputUnit::Mps2 => Ok(None),
        };
        let sensitivity = match (sensitivity, found) {
            (Some(given), _) => Some(given),
            (None, Ok(found)) => found,
            (None, Err(error)) => {
                let text =
                    format!("the median of the reference's counts is not a sensitivity: {error}");
                let error = Code::Usage.error(text, "give --sensitivity");
                return Err(error.at(&recording.name));
            }
        };
        let scale = match (x.unit, sensitivity) {
            (OutputUnit::Counts { .. }, Some(known)) => known.mps2_per_lsb(),
            _ => 1.0,
        };
        let scaled =
            |(x, y): ([f64; 3], [f64; 3])| [x, y].map(|value| value.map(|axis| axis * scale));
        Ok(Self {
            name: recording.name.clone(),
            reference: format!("accelerometer {reference}"),
            output: format!("accelerometer {output}"),
            pairs: x.values_with(&y).map(scaled).collect(),
            without_unit: 0,
            rate_hz: x.rate_hz,
            one_sensor: false,
            sensitivity,
            range: range(x.unit, range_g, sensitivity),
            sensor: None,
            device_id: None,
        })
    }

    /// The raw samples of a recording that came over both links, the cable's as reference.
    ///
    /// # Errors
    /// Those of [`capture::Capture::link`]; `no_rows` when no sample came over both.
    pub fn of_links(recording: &capture::Capture) -> Result<Self> {
        let cable = recording.link(Some(LinkRole::Cable))?;
        let wireless = recording.link(Some(LinkRole::Wireless))?;
        let same_start = wireless.boots.iter().filter_map(|theirs| {
            let ours = cable
                .boots
                .iter()
                .find(|ours| ours.start == theirs.start && !ours.raw().is_empty())?;
            Some((ours, theirs))
        });
        let mut without_unit = 0;
        let mut pairs = Vec::new();
        let mut sensor = None;
        let mut known: Option<(Sensitivity, u8, f64)> = None;
        for (ours, theirs) in same_start {
            let Some(mark) = ours.epochs().first() else {
                continue;
            };
            let Ok(sensitivity) = Sensitivity::from_lsb_per_g(mark.epoch.sensitivity_lsb_per_g)
            else {
                continue;
            };
            let rate_hz = 1e9 / f64::from(mark.epoch.period_ns.max(1));
            sensor = sensor.or(ours.sensor());
            known.get_or_insert((sensitivity, mark.epoch.range_g, rate_hz));
            let start = theirs.start.and_then(|start| recording.starts.get(&start));
            for sample in theirs.raw() {
                let found = ours
                    .raw()
                    .binary_search_by(|ours| sequence_order(ours.sequence, sample.sequence));
                let Ok(index) = found else { continue };
                let unit = start.and_then(|start| start.unit(Stream::Raw, 0, sample.sequence));
                let Some(unit) = unit else {
                    without_unit += 1;
                    continue;
                };
                let both = [ours.raw()[index].value, sample.value];
                pairs.push(both.map(|value| unit.mps2(value)));
            }
        }
        let Some((sensitivity, range_g, rate_hz)) = known.filter(|_| !pairs.is_empty()) else {
            return Err(Code::NoRows
                .error(
                    "no raw sample came over both links",
                    "record both at once with `wimu record LINK LINK`, raw samples on both",
                )
                .at(&recording.name));
        };
        Ok(Self {
            name: recording.name.clone(),
            reference: "cable".to_owned(),
            output: "wireless".to_owned(),
            pairs,
            without_unit,
            rate_hz,
            one_sensor: true,
            sensitivity: Some(sensitivity),
            range: Some((range_g, Source::Board)),
            sensor,
            device_id: wireless.hello().map(|hello| hello.device_id),
        })
    }
}

/// Two accelerometers of a recording, as chosen: the reference and the output.
fn two(recording: &Recording, [reference, output]: [Option<u8>; 2]) -> Result<[u8; 2]> {
    let tracks = recording.of(Quantity::SpecificForce);
    let sensors = Vec::from_iter(tracks.map(|track| track.info.sensor));
    let list = Vec::from_iter(sensors.iter().map(u8::to_string)).join(", ");
    let reference = reference.or(sensors.first().copied()).unwrap_or_default();
    let others = Vec::from_iter(sensors.iter().copied().filter(|sensor| *sensor != reference));
    let (message, remedy) = match (output, &others[..]) {
        _ if sensors.len() < 2 => (
            "it has one accelerometer: a reference is missing".to_owned(),
            "name the columns of two `Accelerometer 0 X (…)`, `Accelerometer 1 X (…)`".to_owned(),
        ),
        (Some(output), _) if output == reference => (
            format!("accelerometer {output} cannot be its own reference"),
            format!("choose two of {list} with --sensor and --reference"),
        ),
        (Some(output), _) | (None, &[output]) => return Ok([reference, output]),
        _ => (
            format!("it has {} accelerometers", sensors.len()),
            format!("choose the one to calibrate with --sensor: {list}"),
        ),
    };
    Err(Code::Usage.error(message, remedy).at(&recording.name))
}
