//! Recordings as links and starts of a device.

use std::io::Cursor;

use wimu_host::Code;
use wimu_host::calibration::parameter_id;
use wimu_host::calibration::source::{self, ActiveParameters};
use wimu_host::capture::{Boot, Capture, Link};
use wimu_host::decode::{Arrival, Event};
use wimu_host::mcap_file::{ClockAnchor, RecordingReader, RecordingWriter};
use wimu_link::message::{Epoch, Event as DeviceEvent, SetBytes};
use wimu_link::{LinkRole, Settings, Telemetry};
use wimu_model::{CompiledSet, Counts, DeviceTimeUs, ParameterSet, Sensitivity};

use crate::common::frames::{self, hello, raw, telemetry};

const ANCHOR: ClockAnchor = ClockAnchor { monotonic_ns: 0, utc_ns: 1_795_222_920_000_000_000 };
/// Telemetry of version 4, empty.
const FOREIGN: [u8; 7] = [6, 0x44, 0xF2, 0xD9, 0x9C, 0xD4, 0];

/// A second of samples of a start from `first` at 100 Hz, after an epoch.
fn second_of(boot: u32, first: u32) -> Vec<u8> {
    let epoch = frames::epoch(first, u64::from(first) * frames::PERIOD_US);
    let number = (first / 100) as u8;
    let mut bytes = telemetry(&Telemetry::Epoch(Epoch { number, ..epoch }));
    for start in (first..first + 100).step_by(20) {
        let samples: Vec<_> =
            (start..start + 20).map(|s| Counts([s as i16, 0, boot as i16])).collect();
        bytes.extend(raw(start, u64::from(start) * frames::PERIOD_US, &samples));
    }
    bytes
}

/// A recording of these bytes, each with the link and the time of arrival.
fn recorded(entries: &[(LinkRole, u64, Vec<u8>)]) -> Vec<u8> {
    let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), "a.mcap", ANCHOR).unwrap();
    for (role, host_ns, bytes) in entries {
        writer.append(*role, *host_ns, bytes).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

/// Both links for 5 s, the device started anew on the wireless one after 3 s.
fn recording() -> Vec<u8> {
    let mut entries = Vec::new();
    for s in 0..5_u32 {
        let host_ns = u64::from(s + 1) * 1_000_000_000 + 7_000_000;
        entries.push((LinkRole::Cable, host_ns, hello(LinkRole::Cable, 1, 0)));
        entries.push((LinkRole::Cable, host_ns, second_of(1, s * 100)));
        let (boot, first) = if s < 3 { (1, s * 100) } else { (2, (s - 3) * 100) };
        let bytes = [hello(LinkRole::Wireless, boot, 0), second_of(boot, first)].concat();
        // Bytes arrive in pieces that know nothing of frames.
        let pieces = bytes.chunks(23).map(|piece| (LinkRole::Wireless, host_ns, piece.to_vec()));
        entries.extend(pieces);
    }
    recorded(&entries)
}

fn read(bytes: &[u8]) -> wimu_host::Result<Capture> {
    Capture::read(RecordingReader::new(bytes, "a.mcap")?, "a.mcap")
}

#[test]
fn links_and_starts_are_kept_apart() {
    let recording = read(&recording()).unwrap();
    assert_eq!(recording.anchor, Some(ANCHOR));
    assert_eq!(recording.duration_ns, 4_000_000_000);
    let cable = recording.link(None).unwrap();
    assert_eq!(cable.role, LinkRole::Cable);
    assert_eq!((cable.boots.len(), cable.boots[0].raw().len()), (1, 500));
    assert_eq!(cable.statistics.raw.missing, 0);
    // Sample 99, of 0.99 s, arrived at 1.007 s: times are by the fastest transfer.
    let host_ns = cable.boots[0].host_ns(DeviceTimeUs(990_000)).unwrap();
    assert!(host_ns.abs_diff(1_007_000_000) < 1000, "{host_ns}");
    let wireless = recording.link(Some(LinkRole::Wireless)).unwrap();
    let raw: Vec<_> = wireless.boots.iter().map(|boot| boot.raw().len()).collect();
    assert_eq!(raw, [300, 200]);
    let starts =
        |link: &Link| -> Vec<_> { link.boots.iter().map(|boot| boot.start.unwrap()).collect() };
    assert_eq!(starts(wireless)[0], starts(cable)[0]);
    assert_ne!(starts(wireless)[1], starts(cable)[0]);
    assert_eq!(wireless.boots[1].hello.unwrap().boot_count, 2);
}

#[test]
fn links_and_starts_share_the_parameter_sets_that_their_epochs_name() {
    let sensitivity = Sensitivity::from_lsb_per_g(8192.0).unwrap();
    let set = ParameterSet::uncalibrated(4, sensitivity);
    let id = parameter_id(&set).0;
    let compiled = CompiledSet::compile(&set, parameter_id(&set), 0).unwrap();
    let epoch = |number, parameters| {
        let epoch = frames::epoch(0, 0);
        telemetry(&Telemetry::Epoch(Epoch { number, parameters, ..epoch }))
    };
    let parameters = telemetry(&Telemetry::Parameters(SetBytes::from(&compiled)));
    let recording = read(&recorded(&[
        (LinkRole::Cable, 0, [parameters, epoch(0, id)].concat()),
        (LinkRole::Wireless, 1, epoch(0, id)),
        (LinkRole::Wireless, 2, [hello(LinkRole::Wireless, 1, 0), epoch(1, 0xBAD)].concat()),
    ]));
    let recording = recording.unwrap();
    let wireless = recording.link(Some(LinkRole::Wireless)).unwrap();
    let marks: Vec<_> = wireless.boots.iter().flat_map(Boot::epochs).collect();
    let found = |mark: usize| wireless.boots[0].parameters_of(&marks[mark].epoch);
    // The integers of a perfect sensor are one; its source is known by its id.
    let integers = found(0).unwrap();
    let off = integers.model.terms().bias_mps2[0].abs();
    assert!(integers.range_g == 4 && integers.quality.is_none() && off < 1e-4, "{integers:?}");
    source::learn(&set);
    assert_eq!(found(0).unwrap(), set);
    let error = found(1).unwrap_err();
    assert!(error.text.contains("lacks the parameters"), "{error}");
}

#[test]
fn a_recording_cut_off_gives_what_it_has() {
    let bytes = recording();
    let recording = read(&bytes[..bytes.len() * 3 / 4]).unwrap();
    assert!(recording.wholeness.truncated);
    let raw = recording.link(None).unwrap().boots[0].raw().len();
    assert!(raw > 0 && raw < 500, "{raw}");
}

#[test]
fn a_recording_of_another_version_is_named_unless_some_of_it_can_be_read() {
    let foreign = (LinkRole::Cable, 0, FOREIGN.to_vec());
    let error = read(&recorded(std::slice::from_ref(&foreign))).unwrap_err();
    assert_eq!(error.code, Code::BadRecording);
    assert!(error.text.contains("version 3"), "{error}");
    let recording = read(&recorded(&[foreign, (LinkRole::Cable, 1, second_of(1, 0))])).unwrap();
    assert_eq!(recording.link(None).unwrap().boots[0].raw().len(), 100);
}

/// Parameter sets, settings and events of a start that are kept at least.
const MAX_KEPT: usize = 4096;

#[test]
fn changes_and_events_without_end_keep_the_latest_only() {
    let mut link = Link::new(LinkRole::Cable);
    let mut take = |event| {
        link.take(&Arrival { host_ns: 0, began_ns: 0, event });
    };
    let most = MAX_KEPT as u32;
    for n in 0..2 * most + 10 {
        take(Event::Parameters(ActiveParameters { active: None, id: n }));
        take(Event::Settings(Settings { gravity_um_s2: n, ..Settings::default() }));
        take(Event::Device { time: DeviceTimeUs(n.into()), event: DeviceEvent::SensorFound });
    }
    let boot = &link.boots[0];
    let lengths = [boot.parameters.len(), boot.settings.len(), boot.events.len()];
    assert_eq!(lengths, [MAX_KEPT; 3]);
    assert_eq!(boot.parameters[0].id, most + 10);
    assert_eq!(boot.events[0].0, DeviceTimeUs((most + 10).into()));
    assert_eq!(boot.settings.last().map(|last| last.gravity_um_s2), Some(2 * most + 9));
}
