//! Positions of a recording whose numbers wrap, as a table and as ROS 2 topics.

use wimu_host::export::{ExportSource, ExportStream, to_csv};
use wimu_host::mcap_file::{ClockAnchor, RecordingWriter};
use wimu_host::ros;
use wimu_link::message::{Epoch, Navigation};
use wimu_link::{LinkRole, Telemetry};
use wimu_model::Counts;

use crate::common::frames::{self, raw, telemetry};

#[test]
fn every_position_has_its_time_where_numbers_wrap() {
    let folder = tempfile::tempdir().unwrap();
    let [file, table] = ["wrap.mcap", "wrap.csv"].map(|name| folder.path().join(name));
    let anchor = ClockAnchor { monotonic_ns: 0, utc_ns: 1_795_222_920_000_000_000 };
    let mut writer = RecordingWriter::create(&file, anchor).unwrap();
    // More behind the wrap than a part has, at 100 Hz.
    let (start, steps) = (0_u32.wrapping_sub(1600), 1600 + 20_000);
    for step in (0..steps).step_by(16) {
        let sequence = start.wrapping_add(step);
        let time_us = u64::from(step) * 10_000;
        let mut append = |frame: &[u8]| {
            writer.append(LinkRole::Cable, time_us * 1000, frame).unwrap();
        };
        if step.is_multiple_of(96) {
            let number = (step / 96) as u8;
            let epoch = Epoch { number, ..frames::epoch(sequence, time_us) };
            append(&telemetry(&Telemetry::Epoch(epoch)));
        }
        let counts: Vec<_> = (0..16).map(|k| Counts([k, step as i16, 16384])).collect();
        append(&raw(sequence, time_us, &counts));
        let state = wimu_integrator::Navigation {
            phase: wimu_integrator::Phase::Moving,
            ..wimu_integrator::Navigation::default()
        };
        append(&telemetry(&Telemetry::Navigation(Navigation::new(sequence, &state))));
    }
    writer.finish().unwrap();
    let exported =
        to_csv(&file, &ExportSource::default(), ExportStream::Navigation, &table).unwrap();
    assert_eq!(exported.rows, steps as usize / 16);
    let text = std::fs::read_to_string(&table).unwrap();
    let mut lines = text.lines();
    let header = lines.next().unwrap();
    let column = header.split(',').position(|name| name.starts_with("Time")).unwrap();
    let times: Vec<f64> =
        lines.filter_map(|line| line.split(',').nth(column)?.parse().ok()).collect();
    assert_eq!(times.len(), exported.rows);
    assert!(times.is_sorted_by(|a, b| a < b));
    // The same positions as ROS 2 messages.
    let topics = folder.path().join("topics.mcap");
    let decoded = ros::decode(&file, &topics, None).unwrap();
    let count = |topic: &str| decoded.messages.get(topic).copied().unwrap_or_default();
    assert_eq!(decoded.without_time, 0, "{decoded:?}");
    assert_eq!(count("/cable/odom"), exported.rows as u64, "{decoded:?}");
    assert_eq!(count("/tf"), exported.rows as u64);
    assert_eq!((count("/cable/path"), count("/tf_static")), (1, 1));
}
