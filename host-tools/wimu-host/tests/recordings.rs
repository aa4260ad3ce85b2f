//! Recordings in memory: rates and gaps of their times, rows joined and dropped, tables of them.

use wimu_host::formats::{self, ReadOptions};
use wimu_host::inertial::sampled_times;
use wimu_host::recording::{Quantity, Recording, Selection, Sink, TrackInfo, Unit};
use wimu_model::STANDARD_GRAVITY_MPS2;

/// Rate, Hz, and number of gaps of samples at these times, ms.
fn rate_and_gaps(times_ms: impl IntoIterator<Item = i64>) -> (f64, usize) {
    let mut recording = Recording::new("a");
    let track = recording.track(TrackInfo::new("a", Quantity::SpecificForce, Unit::Si));
    let times = times_ms.into_iter();
    times.for_each(|ms| recording.row(track, ms * 1_000_000, &[0.0, 0.0, 9.8]));
    let samples = recording.samples(Selection::default()).unwrap();
    (samples.rate_hz, samples.gaps().0)
}

#[test]
fn a_pause_is_found_and_is_no_part_of_the_rate() {
    for pause in [40, 100, 900, 1000, 1_200_000] {
        let times = (0..2000).map(|k| 10 * k + if k < 700 { 0 } else { pause });
        assert_eq!(rate_and_gaps(times), (100.0, 1), "{pause} ms");
    }
    let often = rate_and_gaps((0..5000).map(|k| 10 * k + 200 * (k / 50)));
    assert!((often.0 - 100.0).abs() < 1e-9 && often.1 == 99, "{often:?}");
    let pause = |k: i64| if k < 2000 { 0 } else { 60_000 };
    let bursts = rate_and_gaps((0..4000).map(|k| 160 * (k / 16) + pause(k)));
    assert!((bursts.0 - 100.0).abs() < 1.0 && bursts.1 == 1, "{bursts:?}");
}

#[test]
fn a_few_late_rows_bursts_and_coarse_times_are_no_pause() {
    let times: [(&str, &dyn Fn(i64) -> i64); 5] = [
        ("late", &|k| 10 * k + if k % 97 == 5 { 25 } else { 0 }),
        ("sixteen at a time", &|k| 160 * (k / 16) + k % 16 / 8),
        ("whole seconds", &|k| k / 100 * 1000),
        // A reader that was held up and then made up for it.
        ("held up", &|k| if (500..540).contains(&k) { 5400 } else { 10 * k }),
        ("slower", &|k| if k < 1000 { 5 * k } else { 10 * k - 5000 }),
    ];
    for (name, time) in times {
        assert_eq!(rate_and_gaps((0..2000).map(time)).1, 0, "{name}");
    }
}

/// Rows of counts at 100 Hz from `first` on, at a scale, with angular rates and a temperature.
fn recording(first: i32, rows: i32, si_per_lsb: f64) -> Recording {
    let mut recording = Recording::new("made");
    let unit = |scale| Unit::Counts { si_per_lsb: Some(scale) };
    let force = recording.track(TrackInfo::new("raw", Quantity::SpecificForce, unit(si_per_lsb)));
    let rate = recording.track(TrackInfo::new("raw", Quantity::AngularRate, unit(0.001)));
    let temperature = recording.track(TrackInfo::new("t", Quantity::Temperature, Unit::Si));
    recording.row(temperature, 0, &[21.5]);
    for k in first..first + rows {
        let time = i64::from(k) * 10_000_000;
        let value = f64::from(k);
        recording.row(force, time, &[value, -value, 16_384.0]);
        recording.row(rate, time, &[value, 0.0, 1.0]);
    }
    recording
}

fn counts(recording: &Recording, quantity: Quantity) -> Vec<f64> {
    let track = recording.first(quantity).expect("a track");
    track.vectors().map(|(_, [x, ..])| x).collect()
}

#[test]
fn a_written_table_reads_back_the_same() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("poses.csv");
    let written = recording(3, 40, STANDARD_GRAVITY_MPS2 / 16_384.0);
    written.write_table(&path).expect("writable");
    let read = formats::load(&path, &ReadOptions::default()).expect("readable");
    for quantity in [Quantity::SpecificForce, Quantity::AngularRate] {
        assert_eq!(counts(&read, quantity), counts(&written, quantity));
    }
    let scale = |recording: &Recording| match recording.first(Quantity::SpecificForce)?.info.unit {
        Unit::Counts { si_per_lsb } => si_per_lsb,
        _ => None,
    };
    let [a, b] = [scale(&read), scale(&written)].map(|scale| scale.expect("counts"));
    assert!((a / b - 1.0).abs() < 1e-12);
    let track = read.first(Quantity::Temperature).expect("a track");
    assert_eq!(track.row(0), Some(&[21.5][..]));
}

/// 30 s at 100 Hz. Arrival is up to 8 ms late, and the first 350 samples arrive within a quarter of their time.
fn arrivals() -> Vec<f64> {
    (0..3000_u32)
        .map(|k| {
            let jitter = f64::from(k.wrapping_mul(2_654_435_761) >> 16) / 65536.0 * 0.008;
            let backlog = 0.0075 * f64::from(350_u32.saturating_sub(k));
            f64::from(k) * 0.01 + backlog + jitter
        })
        .collect()
}

#[test]
fn jitter_and_a_backlog_are_removed() {
    let found = sampled_times(&arrivals()).unwrap();
    for (k, t) in found.iter().enumerate() {
        let error = t - k as f64 * 0.01;
        assert!(error.abs() < 0.003, "{k}: {error}");
    }
}

#[test]
fn lost_samples_stay_lost() {
    let mut times = arrivals();
    for t in &mut times[2000..] {
        *t += 0.5;
    }
    let found = sampled_times(&times).unwrap();
    let step = found[2000] - found[1999];
    assert!((step - 0.51).abs() < 0.005, "{step}");
}

#[test]
fn even_times_and_a_change_of_rate_are_kept() {
    let even: Vec<f64> = (0..900).map(|k| f64::from(k) * 0.01).collect();
    assert_eq!(sampled_times(&even), None);
    for at in [300, 500, 800] {
        let later = |k: i32| f64::from((k - at).max(0)) * 0.03;
        let changed: Vec<f64> = (0..900).map(|k| f64::from(k) * 0.01 + later(k)).collect();
        assert_eq!(sampled_times(&changed), None, "{at}");
    }
}
