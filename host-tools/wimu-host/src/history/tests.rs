use std::cell::Cell;
use std::fmt;
use std::io::Cursor;

use wimu_link::message::{EpochReason, WireParameters};
use wimu_link::{MAX_FRAME, Telemetry, batch};
use wimu_model::Counts;

use super::recording::share_parameters;
use super::*;
use crate::mcap_file::{ClockAnchor, RecordingReader, RecordingWriter};

const ANCHOR: ClockAnchor = ClockAnchor { monotonic_ns: 0, utc_ns: 1_795_222_920_000_000_000 };

fn hello(role: LinkRole, boot_count: u32) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let hello = Hello { boot_count, ..Hello::new(role) };
    let length = hello.encode(&mut frame).unwrap();
    frame[..length].to_vec()
}

/// A second of samples of a start from `first` at 100 Hz, after an epoch.
fn second_of(boot: u32, first: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut frame = [0; MAX_FRAME];
    let epoch = <Telemetry>::Epoch(Epoch {
        reason: EpochReason::Periodic,
        number: (first / 100) as u8,
        sequence: first,
        time_us: u64::from(first) * 10_000,
        period_ns: 10_000_000,
        range_g: 4,
        sensitivity_lsb_per_g: 8192.0,
        full_scale: 32752,
        parameters: 0,
        temperature_centi_c: None,
        ..Epoch::default()
    });
    let length = epoch.encode(&mut frame).unwrap();
    bytes.extend(&frame[..length]);
    for start in (first..first + 100).step_by(20) {
        let samples: Vec<_> =
            (start..start + 20).map(|s| Counts([s as i16, 0, boot as i16])).collect();
        let time = DeviceTimeUs(u64::from(start) * 10_000);
        let length = batch::encode(start, time, &samples, &mut frame).unwrap();
        bytes.extend(&frame[..length]);
    }
    bytes
}

fn second(first: u32) -> Vec<u8> {
    second_of(1, first)
}

/// Both links for 5 s, the device started anew on the wireless one after 3 s.
fn recording() -> Vec<u8> {
    let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), "a.mcap", ANCHOR).unwrap();
    for s in 0..5_u32 {
        let host_ns = u64::from(s + 1) * 1_000_000_000 + 7_000_000;
        writer.append(LinkRole::Cable, host_ns, &hello(LinkRole::Cable, 1)).unwrap();
        writer.append(LinkRole::Cable, host_ns, &second(s * 100)).unwrap();
        let (boot, first) = if s < 3 { (1, s * 100) } else { (2, (s - 3) * 100) };
        let mut bytes = hello(LinkRole::Wireless, boot);
        bytes.extend(second_of(boot, first));
        // Bytes arrive in pieces that know nothing of frames.
        for piece in bytes.chunks(23) {
            writer.append(LinkRole::Wireless, host_ns, piece).unwrap();
        }
    }
    writer.finish().unwrap().into_inner()
}

fn read(bytes: &[u8]) -> Recording {
    Recording::read(RecordingReader::new(bytes, "a.mcap").unwrap(), "a.mcap").unwrap()
}

#[test]
fn links_and_starts_are_kept_apart() {
    let recording = read(&recording());
    assert_eq!(recording.anchor, Some(ANCHOR));
    assert_eq!(recording.duration_ns, 4_000_000_000);
    let cable = recording.link(None).unwrap();
    assert_eq!(cable.role, LinkRole::Cable);
    assert_eq!((cable.boots.len(), cable.boots[0].raw.len()), (1, 500));
    assert_eq!(cable.statistics.raw.missing, 0);
    let wireless = recording.link(Some(LinkRole::Wireless)).unwrap();
    let raw: Vec<_> = wireless.boots.iter().map(|boot| boot.raw.len()).collect();
    assert_eq!(raw, [300, 200]);
    let starts = |link: &LinkHistory| -> Vec<_> {
        link.boots.iter().map(|boot| boot.start.unwrap()).collect()
    };
    assert_eq!(starts(wireless)[0], starts(cable)[0]);
    assert_ne!(starts(wireless)[1], starts(cable)[0]);
    let boot = &wireless.boots[1];
    assert_eq!(boot.hello.unwrap().boot_count, 2);
    assert!(boot.raw.is_sorted_by(|a, b| a.sequence < b.sequence));
    assert_eq!(boot.parameters_of(&boot.epochs[0].epoch).unwrap().range_g, 4);
}

#[test]
fn links_and_starts_share_the_parameter_sets_that_their_epochs_name() {
    let sensitivity = Sensitivity::from_lsb_per_g(8192.0).unwrap();
    let sets = [4, 8].map(|range_g| {
        let set = ParameterSet::uncalibrated(range_g, sensitivity);
        ActiveParameters {
            id: wimu_link::message::parameter_id(&set).0,
            active: Some(WireParameters::from(&set)),
        }
    });
    let boot = |parameters: &[ActiveParameters], ids: &[u32]| Boot {
        parameters: parameters.to_vec(),
        epochs: (ids.iter())
            .map(|&parameters| EpochMark {
                epoch: Epoch { parameters, ..Epoch::default() },
                after_loss: false,
            })
            .collect(),
        ..Boot::default()
    };
    let [first, second] = sets;
    let lost = ActiveParameters { active: None, ..second };
    let link = |role, boots| LinkHistory { boots, ..LinkHistory::new(role) };
    let mut links = [
        link(LinkRole::Cable, vec![boot(&[first], &[first.id])]),
        link(
            LinkRole::Wireless,
            vec![
                // Its own set has lost its values; that of the other link is not named.
                boot(&[lost], &[0, second.id]),
                boot(&[second], &[first.id, second.id]),
                boot(&[], &[0xBAD]),
            ],
        ),
    ];
    share_parameters(&mut links);
    let [cable, wireless] = &links;
    assert_eq!(cable.boots[0].parameters, [first]);
    assert_eq!(wireless.boots[0].parameters, [second, lost]);
    assert_eq!(wireless.boots[1].parameters, [first, second]);
    assert!(wireless.boots[2].parameters.is_empty());
    let named = |mark: &EpochMark| wireless.boots[1].parameters_of(&mark.epoch).unwrap();
    let ranges: Vec<_> =
        (wireless.boots[1].epochs.iter()).map(|mark| named(mark).range_g).collect();
    assert_eq!(ranges, [4, 8]);
    let unknown = &wireless.boots[2].epochs[0].epoch;
    let error = wireless.boots[2].parameters_of(unknown).unwrap_err();
    assert!(error.message().contains("lacks the parameters"), "{error}");
}

#[test]
fn device_times_become_host_times_by_the_fastest_transfer() {
    let recording = read(&recording());
    let boot = &recording.link(None).unwrap().boots[0];
    // Sample 99, of 0.99 s, arrived at 1.007 s.
    let host_ns = boot.host_ns(DeviceTimeUs(990_000)).unwrap();
    assert!(host_ns.abs_diff(1_007_000_000) < 1000, "{host_ns}");
    assert_eq!(ANCHOR.to_utc_ns(host_ns) - ANCHOR.utc_ns, host_ns);
}

#[test]
fn a_recording_cut_off_gives_what_it_has() {
    let bytes = recording();
    let recording = read(&bytes[..bytes.len() * 3 / 4]);
    assert!(recording.wholeness.truncated);
    let raw = recording.link(None).unwrap().boots[0].raw.len();
    assert!(raw > 0 && raw < 500, "{raw}");
}

#[test]
fn a_recording_of_another_version_is_named_unless_some_of_it_can_be_read() {
    // Telemetry of version 3, empty.
    let foreign = [6, 0x34, 0xFF, 0x8D, 0x04, 0xA5, 0];
    let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), "a.mcap", ANCHOR).unwrap();
    writer.append(LinkRole::Cable, 0, &foreign).unwrap();
    let bytes = writer.finish().unwrap().into_inner();
    let reader = RecordingReader::new(&bytes[..], "a.mcap").unwrap();
    let error = Recording::read(reader, "a.mcap").unwrap_err();
    assert_eq!(error.code(), ErrorCode::BadRecording);
    assert!(error.message().contains("version 3"), "{error}");

    let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), "a.mcap", ANCHOR).unwrap();
    writer.append(LinkRole::Cable, 0, &foreign).unwrap();
    writer.append(LinkRole::Cable, 1, &second(0)).unwrap();
    let recording = read(&writer.finish().unwrap().into_inner());
    assert_eq!(recording.link(None).unwrap().boots[0].raw.len(), 100);
}

#[test]
fn changes_and_events_without_end_keep_the_latest_only() {
    let mut link = LinkHistory::new(LinkRole::Cable);
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
    assert_eq!(lengths, [MAX_KEPT, MAX_KEPT, MAX_KEPT + 10]);
    assert_eq!(boot.parameters[0].id, most + 10);
    assert_eq!(boot.events[0].0, DeviceTimeUs(most.into()));
    assert_eq!(boot.settings.last().map(|last| last.gravity_um_s2), Some(2 * most + 9));
}

#[test]
fn a_link_that_was_not_recorded_is_named() {
    let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), "a.mcap", ANCHOR).unwrap();
    writer.append(LinkRole::Wireless, 0, &second(0)).unwrap();
    let recording = read(&writer.finish().unwrap().into_inner());
    assert_eq!(recording.link(None).unwrap().role, LinkRole::Wireless);
    let error = recording.link(Some(LinkRole::Cable)).unwrap_err();
    assert_eq!(error.code(), ErrorCode::NoRows);
    assert!(error.message().contains("the cable link"), "{error}");
}

#[test]
fn an_event_is_kept_once_without_looking_through_those_before_it() {
    /// Counts how often it is looked at.
    struct Seen<'a>(u32, &'a Cell<u64>);
    impl fmt::Debug for Seen<'_> {
        fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            self.1.set(self.1.get() + 1);
            write!(f, "{}", self.0)
        }
    }
    impl PartialEq for Seen<'_> {
        fn eq(&self, other: &Self) -> bool {
            self.1.set(self.1.get() + 1);
            self.0 == other.0
        }
    }
    let looks = Cell::new(0);
    let (mut all, mut known) = (Vec::new(), HashSet::new());
    for round in 0..2 {
        for k in 0..5000 {
            push_new(&mut all, &mut known, Seen(k, &looks));
        }
        assert!(looks.get() <= 5000 * (round + 1), "{}", looks.get());
    }
    assert!(all.iter().map(|seen| seen.0).eq(0..5000));
}
