//! Bars of the dashboard and its pictures: `cargo xtask campaign dashboard`.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use wimu_testkit::figure;

use super::Served;
use super::browser::{Browser, COUNT};
use crate::kit::{Simulator, folder, record_motion, wimu};

/// CPU time of a process so far, s, and the most memory that it had, MB.
fn used(process: u32) -> Option<(f64, f64)> {
    let stat = fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = fields[11].parse::<f64>().ok()? + fields[12].parse::<f64>().ok()?;
    let status = fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let peak_kb: f64 = peak.split_whitespace().next()?.parse().ok()?;
    Some((ticks / 100.0, peak_kb / 1e3))
}

#[test]
#[ignore = "a campaign: minutes"]
fn two_boards_at_1_khz() {
    let folder = folder();
    let mut browser = Browser::start(folder.path());
    let [one, two] = ["1", "2"].map(|seed| Simulator::start(&["--seed", seed]));
    for board in [&one, &two] {
        wimu(&["device", "settings", "set", &board.cable, "--rate", "1344"]).succeeds();
    }
    let served = Served::start(folder.path(), &[&one.cable, &two.cable]);
    let tab = browser.open(&served.url, 1200, false);
    browser.until(&tab, &format!("{COUNT} > 1000"));
    let before = used(served.process.id());
    browser.value(&tab, "latencies.length = 0");
    let began = Instant::now();
    thread::sleep(Duration::from_secs(20));
    let seconds = began.elapsed().as_secs_f64();
    let latency = browser.value(&tab, "[...latencies].sort((a, b) => a - b)");
    let all: Vec<f64> = latency.as_array().unwrap().iter().filter_map(|ms| ms.as_f64()).collect();
    let at = |part: f64| all[((all.len() - 1) as f64 * part) as usize];
    let measured =
        format!("{:.0} ms (95 %), median {:.0}, largest {:.0}", at(0.95), at(0.5), at(1.0));
    let claim = "dashboard: arrival of a sample to its picture, 2 × 1344 Hz";
    figure(claim, measured, "≤ 100 ms", at(0.95) <= 100.0);
    if let (Some(before), Some(after)) = (before, used(served.process.id())) {
        let percent = 100.0 * (after.0 - before.0) / seconds;
        let measured = format!("{percent:.1} % of a core, {:.0} MB", after.1);
        let claim = "dashboard: load of the server, 2 × 1344 Hz";
        figure(claim, measured, "≤ 20 %", percent <= 20.0);
    }
    let size: usize = ["/", "/style.css", "/plot.js", "/dashboard.js"]
        .map(|path| served.get(&format!("GET {path} HTTP/1.1\r\nHost: {}", served.host)).len())
        .into_iter()
        .sum();
    let measured = format!("{:.0} kB", size as f64 / 1e3);
    figure("dashboard: size of the page", measured, "≤ 2 MB", size <= 2_000_000);
}

/// Takes an hour of frames: 30 a second with 40 points of 7 channels.
const HOUR: &str = "(async () => {
    const one = board(9), count = 30 * 3600;
    for (let k = 0; k < count; k++) {
        const t = Array.from({ length: 40 }, (_, m) => (k + m / 40) / 30);
        server.take({ board: 9, t, v: Array.from({ length: 7 }, () => t), up: [0, 0, 9.8], at_ms: 1 });
        if (k % 3000 === 0) await new Promise((done) => setTimeout(done));
    }
    return one.ring.count;
})()";

#[test]
fn the_page_does_not_grow_in_an_hour_of_frames() {
    let folder = folder();
    let mut browser = Browser::start(folder.path());
    let served = Served::start(folder.path(), &[]);
    let tab = browser.open(&served.url, 1200, false);
    browser.until(&tab, "server.writes");
    let before = browser.heap_bytes(&tab) / 1e6;
    assert_eq!(browser.value(&tab, HOUR), 30 * 3600 * 40);
    let after = browser.heap_bytes(&tab) / 1e6;
    let measured = format!("{before:.1} MB before, {after:.1} MB after");
    let claim = "dashboard: heap of the page, an hour of frames";
    figure(claim, measured, "≤ 10 MB more", after - before <= 10.0);
    assert!(after - before <= 10.0, "{before} MB, then {after} MB");
}

#[test]
#[ignore = "a campaign: minutes"]
fn a_recording_of_1_gb_is_shown_in_little_memory() {
    let folder = folder();
    let path = folder.path().join("large.csv");
    let mut row = String::new();
    let mut file = std::io::BufWriter::new(fs::File::create(&path).unwrap());
    use std::io::Write as _;
    writeln!(file, "Time (s),Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²)")
        .unwrap();
    for k in 0..25_000_000_u32 {
        row.clear();
        let noise = f64::from(k.wrapping_mul(2_654_435_761) >> 20) * 1e-5;
        writeln!(row, "{:.3},{noise:.5},{:.5},9.{:06}", f64::from(k) * 1e-3, -noise, k % 1_000_000)
            .unwrap();
        file.write_all(row.as_bytes()).unwrap();
    }
    file.flush().unwrap();
    let bytes = fs::metadata(&path).unwrap().len();
    let served = Served::start(folder.path(), &[]);
    let mut page = served.page();
    let began = Instant::now();
    page.ask(serde_json::json!({"do": "open", "file": "large.csv"}));
    // It answers meanwhile.
    let first = page.topic("file/large.csv", |file| file["rows"].as_u64() > Some(0));
    assert_eq!(first["done"], false);
    let end = Instant::now() + Duration::from_secs(900);
    while page.topics["file/large.csv"]["done"] != true && Instant::now() < end {
        page.take();
    }
    let shown = page.topics["file/large.csv"].clone();
    assert!(shown["error"].is_null(), "{shown}");
    let points = shown["charts"][0]["series"][0]["x"].as_array().unwrap().len();
    let peak = used(served.process.id()).map_or(0.0, |(_, peak)| peak);
    let (gigabytes, seconds) = (bytes as f64 * 1e-9, began.elapsed().as_secs_f64());
    let measured = format!("{gigabytes:.2} GB in {seconds:.0} s, server at most {peak:.0} MB");
    assert!((1000..10_000).contains(&points));
    let claim = "dashboard: a large table is shown decimated";
    figure(claim, measured, "≤ 300 MB", peak <= 300.0);
}

#[test]
#[ignore = "a campaign: it writes docs/pictures"]
fn pictures() {
    let folder = folder();
    let mut browser = Browser::start(folder.path());
    record_motion("twelve-poses,slide", 3, folder.path().join("session.mcap").to_str().unwrap());
    let board =
        Simulator::start(&["--chip", "lsm6dso", "--motion", "twelve-poses,slide", "--seed", "4"]);
    let served = Served::start(folder.path(), &[&board.wireless, &board.cable]);
    let to = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/pictures");
    let tab = browser.open(&served.url, 1200, false);
    browser.until(&tab, &format!("{COUNT} > 1000"));
    browser.until(&tab, "document.body.innerText.includes('uncalibrated')");
    browser.picture(&tab, &to.join("dashboard-live.webp"));
    let phone = browser.open(&served.url, 360, true);
    browser.until(&phone, &format!("{COUNT} > 100"));
    browser.value(&phone, "choose('calibrate')");
    browser.until(&phone, "!!document.querySelector('#view-calibrate .main')");
    browser.value(&phone, "document.querySelector('#view-calibrate .main').click()");
    browser.until(&phone, "[...boards.values()][0].guided?.poses.length >= 3");
    browser.picture(&phone, &to.join("dashboard-phone.webp"));
    browser.value(&tab, "choose('calibrate')");
    browser.until(&tab, "[...boards.values()][0].guided.poses.length >= 5 && [...boards.values()][0].guided.hold.holding");
    browser.picture(&tab, &to.join("dashboard-calibrate.webp"));
    for name in ["dashboard-live", "dashboard-phone", "dashboard-calibrate"] {
        let bytes = fs::metadata(to.join(name).with_extension("webp")).unwrap().len();
        println!("{name}.webp: {:.0} kB", bytes as f64 / 1e3);
        assert!(bytes < 150_000);
    }
}
