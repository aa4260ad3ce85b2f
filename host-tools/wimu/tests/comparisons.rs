//! `wimu compare` on recordings with faults. Their frames are made here, as a board sends them.

use crate::kit;

use std::fs;
use std::path::Path;

use kit::{Transcript, folder, wimu};
use wimu_host::mcap_file::{ClockAnchor, RecordingWriter};
use wimu_link::message::{Epoch, EpochReason};
use wimu_link::{Hello, LinkRole, MAX_FRAME, Telemetry, batch};
use wimu_model::{Counts, DeviceTimeUs};

const CABLE: LinkRole = LinkRole::Cable;
const WIRELESS: LinkRole = LinkRole::Wireless;
/// Samples of a batch.
const BATCH: u32 = 16;

/// A part of a session, at least a second of samples.
#[derive(Clone, Copy)]
struct Part {
    device_id: u64,
    boot: u32,
    /// Batches from and to.
    batches: (u32, u32),
    rate_hz: u32,
    range_g: u8,
    /// Host time at which the device's time was 0, s.
    began_s: f64,
    /// Added to every value, LSB.
    bias_lsb: i16,
    /// Whether some neighbouring batches are swapped.
    swaps: bool,
}

impl Default for Part {
    fn default() -> Self {
        Self {
            device_id: 0x5157_0001,
            boot: 1,
            batches: (0, 100),
            rate_hz: 100,
            range_g: 2,
            began_s: 0.0,
            bias_lsb: 0,
            swaps: false,
        }
    }
}

/// Frames of a link with their host times, ns.
type Frames = Vec<(LinkRole, u64, Vec<u8>)>;

impl Part {
    fn on(&self, role: LinkRole) -> Frames {
        let mut frame = [0; MAX_FRAME];
        let mut frames = Vec::new();
        let hello = Hello { boot_count: self.boot, device_id: self.device_id, ..Hello::new(role) };
        let delay_ns = if role == CABLE { 200_000 } else { 20_000_000 };
        let host_ns = |time_us: u64| (self.began_s * 1e9) as u64 + time_us * 1000 + delay_ns;
        let period_us = 1_000_000 / u64::from(self.rate_hz);
        let time_us = |batch: u32| 1_000_000 + u64::from(batch * BATCH) * period_us;
        let (from, to) = self.batches;
        let length = hello.encode(&mut frame).unwrap();
        let start_ns = host_ns(time_us(from));
        frames.push((role, start_ns, frame[..length].to_vec()));
        for number in from..to {
            let first = number * BATCH;
            if number == from || number % 6 == 0 {
                let epoch = <Telemetry>::Epoch(Epoch {
                    reason: EpochReason::Periodic,
                    number: (number / 6) as u8,
                    sequence: first,
                    time_us: time_us(number),
                    period_ns: (period_us * 1000) as u32,
                    range_g: self.range_g,
                    sensitivity_lsb_per_g: 32_768.0 / f64::from(self.range_g),
                    full_scale: 32_752,
                    parameters: 0,
                    temperature_centi_c: None,
                    ..Epoch::default()
                });
                let length = epoch.encode(&mut frame).unwrap();
                frames.push((role, host_ns(time_us(number)), frame[..length].to_vec()));
            }
            let samples: [Counts; BATCH as usize] = std::array::from_fn(|k| {
                let phase = f64::from(first + k as u32) * 0.11;
                let lsb =
                    |wave: f64| (8000.0 * wave / f64::from(self.range_g)) as i16 + self.bias_lsb;
                Counts([lsb(phase.sin()), lsb(phase.cos()), lsb((0.7 * phase).sin())])
            });
            let time = DeviceTimeUs(time_us(number));
            let length = batch::encode(first, time, &samples, &mut frame).unwrap();
            let at_ns = host_ns(time_us(number + 1));
            frames.push((role, at_ns, frame[..length].to_vec()));
        }
        if self.swaps {
            for pair in frames[8..].chunks_exact_mut(9) {
                let [(.., one), (.., other)] = &mut pair[..2] else {
                    continue;
                };
                std::mem::swap(one, other);
            }
        }
        frames
    }

    fn on_both(&self) -> Frames {
        [self.on(CABLE), self.on(WIRELESS)].concat()
    }
}

/// A recording of it, in `folder`.
fn file(folder: &Path, mut frames: Frames) -> String {
    let path = folder.join("made.mcap");
    let _ = fs::remove_file(&path);
    let anchor = ClockAnchor { monotonic_ns: 0, utc_ns: 1_795_222_920_000_000_000 };
    let mut writer = RecordingWriter::create(&path, anchor).unwrap();
    frames.sort_by_key(|(_, host_ns, _)| *host_ns);
    for (role, host_ns, bytes) in frames {
        writer.append(role, host_ns, &bytes).unwrap();
    }
    writer.finish().unwrap();
    path.to_str().unwrap().to_owned()
}

/// What `wimu compare` finds, all pairs identical.
fn compared(frames: Frames) -> serde_json::Value {
    let folder = folder();
    let found = wimu(&["compare", &file(folder.path(), frames)]).succeeds();
    assert_eq!(found["pairs"], found["identical"], "{found}");
    found
}

#[test]
fn samples_out_of_order_are_all_in_the_decoded_topics() {
    let swapped = Part { swaps: true, ..Part::default() };
    let folder = folder();
    let recorded = file(folder.path(), swapped.on(WIRELESS));
    let decoded = folder.path().join("decoded.mcap");
    let decoded = decoded.to_str().unwrap();
    let found = wimu(&["convert", &recorded, "-o", decoded]).succeeds();
    assert!((1..700).contains(&found["late"].as_u64().unwrap()), "{found}");
    assert_eq!(found["messages"]["/wireless/imu/data_raw"], 1600, "{found}");
}

#[test]
fn a_board_that_cannot_count_its_starts_has_two_all_the_same() {
    let first = Part { boot: 0, ..Part::default() };
    let again = Part { batches: (0, 60), began_s: 30.0, ..first };
    let folder = folder();
    let session = file(folder.path(), [first.on_both(), again.on_both()].concat());
    let found = wimu(&["compare", &session]).succeeds();
    assert_eq!((&found["starts"], &found["pairs"]), (&2.into(), &2560.into()));
    for link in found["links"].as_array().unwrap() {
        assert_eq!(link["lost"], 0, "{link}");
        assert!(link["latency"]["max_ms"].as_f64().unwrap() < 100.0, "{link}");
    }
    let mut texts = Transcript::default();
    let ran = wimu(&["info", &session]);
    assert_eq!(ran.succeeds()["links"][1]["starts"], 2);
    texts.text("info", &ran);
    texts.check("info_two_starts");
    // Where the cable shows which start a sample of the wireless link belongs to, a calibration uses it.
    let found = wimu(&["calibrate", &session, "--method", "reference"]).object();
    assert_eq!(found["samples"], 2560, "{found}");
    // Times go on over the restart, the first start's from 1 s on, the second's from 31 s.
    let table = folder.path().join("a.csv").display().to_string();
    wimu(&["convert", &session, "-o", &table]).succeeds();
    let text = fs::read_to_string(&table).unwrap();
    let times: Vec<f64> =
        text.lines().skip(1).map(|line| line.split(',').next().unwrap().parse().unwrap()).collect();
    assert!(times.is_sorted() && times.len() == 2560);
    let pause = times[1600] - times[1599];
    assert!((pause - 14.01).abs() < 0.05, "{pause}");
}

#[test]
fn batches_at_the_very_end_whose_start_is_unknown_are_counted_and_reported() {
    // A second of a new start that nothing announces: not enough to know that it is one.
    let again = Part { batches: (0, 6), began_s: 30.0, ..Part::default() };
    let folder = folder();
    let frames = [Part::default().on_both(), again.on_both()].concat();
    let session = file(folder.path(), frames);
    let mut texts = Transcript::default();
    texts.text("info", &wimu(&["info", &session]));
    let ran = wimu(&["compare", &session]);
    assert_eq!(ran.succeeds()["links"][0]["unplaced"], 6);
    texts.text("compare", &ran);
    let output = folder.path().join("decoded.mcap").display().to_string();
    let ran = wimu(&["convert", &session, "-o", &output]);
    ran.succeeds();
    texts.text("export", &ran);
    texts.check("unplaced_batches");
}

#[test]
fn range_and_rate_may_change_on_the_way() {
    let first = Part::default();
    let wider = Part { batches: (100, 160), range_g: 8, ..first };
    // 100 batches at 100 Hz took 16 s; the next 60 at 400 Hz begin where they ended.
    let faster =
        Part { batches: (160, 320), rate_hz: 400, began_s: 25.6 - 6.4, range_g: 8, ..first };
    let parts = [first, wider, faster].map(|part| part.on_both());
    let found = compared(parts.concat());
    assert!(found["pairs"].as_u64().unwrap() >= 2560, "{found}");
    let values = &found["values"]["axes"][0];
    assert!(values["rms_before_mps2"].as_f64().unwrap() < 1e-9, "{found}");
}

#[test]
fn pictures_are_drawn_in_the_page() {
    let folder = folder();
    let session = file(folder.path(), Part::default().on_both());
    let page = folder.path().join("page.html");
    wimu(&["compare", &session, "--report", page.to_str().unwrap()]).succeeds();
    // Not the curves that lie upon each other.
    assert_eq!(fs::read_to_string(page).unwrap().matches("<svg xmlns").count(), 6);
}

#[test]
fn a_link_model_takes_off_what_the_comparison_found() {
    let folder = folder();
    let other = Part { bias_lsb: 40, ..Part::default() };
    let frames = [Part::default().on(CABLE), other.on(WIRELESS)].concat();
    let session = file(folder.path(), frames);
    let model = folder.path().join("link.json").display().to_string();
    wimu(&["compare", &session, "-o", &model]).succeeds();
    // The first accelerometer value of each row, LSB.
    let exported = |link: &str, more: &[&str]| -> Vec<i32> {
        let table = folder.path().join(format!("{link}{}.csv", more.len()));
        let table = table.to_str().unwrap();
        let export = ["convert", &session, "-o", table, "--topic", link];
        wimu(&[&export, more].concat()).succeeds();
        let text = fs::read_to_string(table).unwrap();
        let rows = text.lines().skip(1);
        let value = |row: &str| row.split(',').nth(1).unwrap().parse().unwrap();
        rows.map(value).collect()
    };
    let cable = exported("cable", &[]);
    let most = |wireless: Vec<i32>| {
        assert_eq!(wireless.len(), cable.len());
        let apart = wireless.iter().zip(&cable).map(|(a, b)| (a - b).abs());
        apart.max().unwrap()
    };
    assert_eq!(most(exported("wireless", &[])), 40);
    assert!(most(exported("wireless", &["--with", &model])) <= 1);
}
