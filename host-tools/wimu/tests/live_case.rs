//! What the live views of a board receive, beside a recording of it: the same samples, none missing.

use crate::kit;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use kit::{Background, Simulator, folder, record_until, wait_until, wimu};
use serde_json::Value;

use crate::dashboard::Served;
use crate::screens::{Terminal, USUAL};

/// 400 samples a second, 25 batches.
const BOARD: [&str; 4] = ["--motion", "twelve-poses", "--speed", "4"];
/// Samples of the dashboard that are compared: 15 s.
const ENOUGH: usize = 6000;
/// Least points of a frame of more than 40 samples, which the dashboard thins; there are such after a stall of this machine.
const THINNED: usize = 28;

/// Samples of the cable as the recording holds them: sequence number, device time in 10 µs, output.
struct Recorded(BTreeMap<u64, (i64, [i64; 3])>);

impl Recorded {
    fn read(file: &str) -> Self {
        let readings = wimu(&["monitor", file]).objects();
        let sample = |reading: &Value| {
            let raw = [0, 1, 2].map(|axis| reading["raw_lsb"][axis].as_i64().expect("counts"));
            (reading["sequence"].as_u64().expect("a number"), (ticks(&reading["time_s"]), raw))
        };
        let samples: BTreeMap<_, _> = readings.iter().map(sample).collect();
        let (first, last) = (samples.keys().next(), samples.keys().next_back());
        let span = last.expect("samples") - first.expect("samples") + 1;
        assert_eq!(samples.len() as u64, span, "the recording is complete");
        Self(samples)
    }

    /// Samples between the first and the last of `numbers` that are not among them.
    fn missing(&self, numbers: impl IntoIterator<Item = u64>) -> Vec<u64> {
        let numbers: BTreeSet<u64> = numbers.into_iter().collect();
        let (Some(first), Some(last)) = (numbers.first(), numbers.last()) else {
            panic!("no samples");
        };
        let expected = self.0.range(first..=last).map(|(number, _)| *number);
        expected.filter(|number| !numbers.contains(number)).collect()
    }

    /// The number of the first of `count` samples in succession with this mean, m/s².
    fn window(&self, count: usize, mean: &Value) -> Option<u64> {
        let samples: Vec<_> = self.0.iter().collect();
        let is_mean = |window: &[(&u64, &(i64, [i64; 3]))]| {
            (0..3).all(|axis| {
                let sum: i64 = window.iter().map(|(_, (_, raw))| raw[axis]).sum();
                let found = sum as f64 / count as f64 / 16384.0 * 9.80665;
                (found - mean[axis].as_f64().expect("a mean")).abs() < 1e-9
            })
        };
        samples.windows(count).find(|window| is_mean(window)).map(|window| *window[0].0)
    }
}

/// A device time in s as the dashboard rounds it.
fn ticks(time_s: &Value) -> i64 {
    (time_s.as_f64().expect("a time") * 1e5).round() as i64
}

/// Sequence numbers that `monitor --json` prints in a terminal.
fn monitored(link: &str, folder: &Path) -> Vec<u64> {
    let arguments = ["monitor", link, "--json", "--for", "4"];
    let mut terminal = Terminal::start(&arguments, folder, USUAL);
    assert!(terminal.ends().success());
    let written = String::from_utf8(terminal.bytes()).expect("text");
    let objects = written.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    objects.filter_map(|object| object["data"]["sequence"].as_u64()).collect()
}

/// Device times of the samples in the dashboard's stream, in runs between frames that may be thinned.
fn streamed(link: &str, folder: &Path) -> Vec<Vec<i64>> {
    let served = Served::start(folder, &[link]);
    let mut page = served.page();
    let mut runs = vec![Vec::new()];
    page.until("samples", |page| {
        for frame in std::mem::take(&mut page.frames) {
            let times = frame["t"].as_array().expect("times");
            if times.len() >= THINNED || frame["whole"] == true {
                runs.push(Vec::new());
                continue;
            }
            runs.last_mut().expect("a run").extend(times.iter().map(ticks));
        }
        (runs.iter().map(Vec::len).sum::<usize>() >= ENOUGH).then_some(())
    });
    runs.retain(|run| !run.is_empty());
    runs
}

#[test]
fn live_case() {
    let board = Simulator::start(&BOARD);
    let folder = folder();
    let file = folder.path().join("all.mcap").display().to_string();
    let record = Background::start(&["record", &board.cable, "-o", &file]);
    wait_until("the recording begins", || wimu(&["info", &file]).code == 0);
    let poses = ["calibrate", &board.wireless, "--count", "4", "--model", "auto"];
    let calibrated = wimu(&poses).refuses();
    let monitored = monitored(&board.wireless, folder.path());
    let streamed = streamed(&board.wireless, folder.path());
    let last = *streamed.last().and_then(|run| run.last()).expect("samples");
    record_until(record, &file, |_| recorded_until(&file) >= last);
    let recorded = Recorded::read(&file);

    // Means of many samples are equal only if each was received; so is the distance of the poses, in samples.
    let poses = calibrated["static_poses"].as_array().expect("poses");
    let begins: Vec<u64> = poses
        .iter()
        .map(|pose| {
            let count = pose["samples"].as_u64().expect("a number") as usize;
            let found = recorded.window(count, &pose["mean_m_s2"]);
            found.unwrap_or_else(|| panic!("not of samples in succession: {pose}"))
                - pose["first_sample"].as_u64().expect("a number")
        })
        .collect();
    assert!(begins.iter().all(|begin| *begin == begins[0]), "{begins:?}");

    assert!(monitored.len() > 500, "{}", monitored.len());
    assert_eq!(recorded.missing(monitored), [0; 0]);

    let numbers: BTreeMap<i64, u64> =
        recorded.0.iter().map(|(number, (time, _))| (*time, *number)).collect();
    // Both round the microseconds of the device.
    let number = |time: &i64| {
        let mut near = numbers.range(time - 1..=time + 1);
        *near.next().unwrap_or_else(|| panic!("{time} is no time of a sample")).1
    };
    let missing = |run: &Vec<i64>| recorded.missing(run.iter().map(number)).len();
    let lost: usize = streamed.iter().map(missing).sum();
    assert_eq!(lost, 0, "samples that did not reach the dashboard");
}

/// Device time of the last sample in a file.
fn recorded_until(file: &str) -> i64 {
    let readings = wimu(&["monitor", file, "--rate", "1"]).objects();
    readings.last().map_or(0, |reading| ticks(&reading["time_s"]))
}
