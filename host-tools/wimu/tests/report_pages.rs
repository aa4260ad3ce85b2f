//! Reports in a browser: every chart of every report is drawn, zoomed, rotated and asked for its values.

use crate::kit;

use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::Command;

use kit::{folder, noise, spread, wimu};
use serde_json::Value;

/// Appended to a page.
const CHECK: &str = include_str!("report_pages/check.js");
/// Widths of a desktop's and of a phone's window, CSS px.
const WIDTHS: [u32; 2] = [1240, 390];
/// Largest size of a report, bytes.
const MOST_BYTES: usize = 5_000_000;

/// The name by which this machine starts Chromium.
pub fn chromium() -> &'static str {
    let answers = |name: &&str| Command::new(name).arg("--version").output().is_ok();
    let found = ["chromium", "chromium-browser", "google-chrome"].into_iter().find(answers);
    found.expect("Chromium is missing: cargo xtask setup")
}

/// Opens a page in windows of all [`WIDTHS`]; returns what `check.js` saw in each.
fn opened(browser: &str, folder: &Path, page: &str, dark: bool) -> Vec<Value> {
    let text = fs::read_to_string(folder.join(page)).unwrap();
    assert!(text.len() < MOST_BYTES, "{page}: {} bytes", text.len());
    let watch = "<script>window.faults = []; addEventListener('error', (e) => faults.push(e.message));\
        for (const name of ['error', 'warn']) console[name] = (...all) => faults.push(all.join(' '));</script>";
    let text = text.replacen("<head>", &format!("<head>{watch}"), 1);
    let text = text.replace("</body>", &format!("<script>{CHECK}</script></body>"));
    fs::write(folder.join("checked.html"), text).unwrap();
    let frames: String = WIDTHS
        .map(|width| format!("<iframe src=checked.html width={width} height=844></iframe>"))
        .concat();
    let around = "<script>const seen = []; addEventListener('message', (e) => { seen.push(e.data); \
        document.title = JSON.stringify(seen).replaceAll('<', '‹').replaceAll('&', '+'); });</script>";
    fs::write(folder.join("around.html"), format!("{around}{frames}")).unwrap();
    let mut command = Command::new(browser);
    command.args(["--headless", "--no-sandbox", "--disable-gpu"]);
    command.args(["--virtual-time-budget=10000", "--dump-dom"]);
    if dark {
        command.arg("--blink-settings=preferredColorScheme=0");
    }
    command.arg(format!("--user-data-dir={}", folder.join("profile").display()));
    let url = format!("file://{}", folder.join("around.html").display());
    let ran = command.arg(url).output().unwrap();
    let dom = String::from_utf8_lossy(&ran.stdout);
    let title = dom.split_once("<title>").and_then(|(_, rest)| rest.split_once("</title>"));
    let (title, _) = title.unwrap_or_else(|| panic!("{page}: {ran:?}"));
    let mut seen: Vec<Value> = serde_json::from_str(title).unwrap();
    seen.sort_by_key(|one| WIDTHS.iter().position(|w| one["innerWidth"] == *w));
    assert_eq!(seen.len(), WIDTHS.len(), "{page}: {title}");
    seen
}

/// Asserts that a chart answers to the pointer.
fn works(page: &str, chart: &Value) {
    let at = format!("{page}: {chart}");
    for key in ["starts", "tipGone", "tipInside", "reset", "button"] {
        assert_eq!(chart[key], true, "{key}: {at}");
    }
    let number = |key: &str| chart[key].as_f64().unwrap_or_else(|| panic!("{key}: {at}"));
    // A frame around nothing has fewer.
    assert!(number("ink") > 2.0 * (number("width") + number("height")) + 500.0, "{at}");
    let tip = chart["tip"].as_str().unwrap();
    assert!(tip.chars().any(|c| c.is_ascii_digit()), "{at}");
    for zoom in ["wheel", "pinch"] {
        assert!((0.1..0.95).contains(&number(zoom)), "{zoom}: {at}");
    }
    match chart["space"].as_bool() {
        Some(true) => assert_eq!(chart["dragged"], true, "{at}"),
        // 0.3 of the canvas, which is wider than the area inside the axes.
        _ => assert!((0.28..0.4).contains(&number("dragged")), "{at}"),
    }
}

fn titled<'a>(seen: &'a Value, title: &str) -> &'a Value {
    let mut charts = seen["charts"].as_array().unwrap().iter();
    let found = charts.find(|chart| chart["title"].as_str().unwrap().contains(title));
    found.unwrap_or_else(|| panic!("no chart {title:?} in {seen}"))
}

fn write_inputs(folder: &Path) {
    let mut noise = noise();
    for (name, bias) in [("poses.csv", 20.0), ("later.csv", 20.5)] {
        let mut poses =
            "Accelerometer X (LSB),Accelerometer Y (LSB),Accelerometer Z (LSB)\n".to_owned();
        for up in spread(20) {
            let [x, y, z] = up.map(|f| 1024.0 * f + bias + 0.1 * noise());
            writeln!(poses, "{x},{y},{z}").unwrap();
        }
        fs::write(folder.join(name), poses).unwrap();
    }
    let mut rest =
        "Time (s),Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²)".to_owned();
    for k in 0..12_000 {
        let [x, y, z] = [0.0, 0.0, 9.80665].map(|f| f + 0.01 * noise());
        write!(rest, "\n{:.2},{x},{y},{z}", f64::from(k) * 0.01).unwrap();
    }
    // A file may have any name.
    fs::write(folder.join("<img src=x onerror=fail()>.csv"), rest).unwrap();
    crate::localize::write(folder);
}

#[test]
#[ignore = "needs Chromium: cargo xtask release --only heavy"]
fn every_report_works_in_a_browser() {
    let browser = chromium();
    let folder = folder();
    let folder = folder.path();
    write_inputs(folder);
    let at = |name: &str| folder.join(name).display().to_string();
    let report = |page: &str, arguments: &[&str]| {
        wimu(&[arguments, &["--report", &at(page)]].concat()).succeeds();
        let seen = opened(browser, folder, page, false);
        for one in &seen {
            assert_eq!(one["faults"], Value::Array(Vec::new()), "{page}");
            assert_eq!(one["folded"], true, "{page}");
            assert!(one["overflow"].as_f64().unwrap() <= 0.0, "{page}: wider than its window");
            assert_eq!(one["images"], 0, "{page}");
            let order: Vec<f64> = (one["order"].as_array().unwrap().iter())
                .map(|top| top.as_f64().unwrap())
                .collect();
            assert!(order.is_sorted(), "{page}: {order:?}");
            for chart in one["charts"].as_array().unwrap() {
                works(page, chart);
            }
        }
        seen[0].clone()
    };
    report("demo.html", &["demo"]);
    let demo = at("demo.mcap");
    let links = report("compare.html", &["compare", &demo]);
    for title in ["Latency", "did not arrive", "Figure 5", "Figure 6", "Figure 7"] {
        titled(&links, title);
    }
    let path = report("navigate.html", &["navigate", &demo]);
    let plan = &titled(&path, "Plan")["perPixel"];
    let [x, y] = [0, 1].map(|axis| plan[axis].as_f64().unwrap());
    assert!((x / y - 1.0).abs() < 1e-6, "equal scales: {plan}");
    assert!(titled(&path, "space")["space"].as_bool().unwrap());
    let tip = titled(&path, "Velocity")["tip"].as_str().unwrap();
    assert!(tip.contains(" m/s") && tip.contains("time ") && tip.contains(" s"), "{tip}");

    let noise = at("<img src=x onerror=fail()>.csv");
    let allan = report("allan.html", &["allan", &noise]);
    let ticks = &titled(&allan, "Allan")["ticks"];
    assert_eq!(ticks[0].as_array().unwrap()[..3], ["0.01", "0.1", "1"], "{ticks}");
    let poses = at("poses.csv");
    let poses = ["calibrate", &poses, "--poses", "--sensitivity", "1024"];
    let sphere = report("calibrate.html", &poses);
    assert_eq!(titled(&sphere, "sphere")["space"], true);
    let [first, later, cal] = ["poses.csv", "later.csv", "CAL.json"].map(at);
    let several = [&["calibrate", &first, &later][..], &poses[2..], &["-o", &cal]].concat();
    let several = report("several.html", &several);
    titled(&several, "Bias of each session");
    let update = ["calibrate", &later, "--poses", "--method", "update", "--with", &cal];
    titled(&report("update.html", &update), "each rest");
    let reference = report("reference.html", &["calibrate", &demo, "--method", "reference"]);
    titled(&reference, "Z: output less reference");
    let (ranges, anchors) = (at("ranges.csv"), at("anchors.csv"));
    let ranges =
        report("ranges.html", &["navigate", &ranges, "--setup", kit::setup("anchors", &anchors)]);
    titled(&ranges, "Innovation");

    let dark = opened(browser, folder, "allan.html", true);
    assert_ne!(dark[0]["dark"], allan["dark"], "the colours follow the system");
    works("dark", &dark[1]["charts"][0]);
}
