//! The page in a real Chromium, driven by the DevTools protocol.

use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tungstenite::{Message, WebSocket};

use super::{FAST, Served, TIME_LIMIT};
use crate::kit::{Background, Simulator, folder, wimu};
use crate::report_pages::chromium;

/// A Chromium without a window; it is killed when dropped.
pub struct Browser {
    child: Child,
    profile: PathBuf,
    socket: WebSocket<TcpStream>,
    next: u64,
    /// What pages have complained of.
    pub faults: Vec<String>,
}

/// A page of it.
#[derive(Clone)]
pub struct Tab(String);

impl Browser {
    pub fn start(folder: &Path) -> Self {
        let profile = folder.join("profile");
        let mut child = Command::new(chromium())
            .args(["--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"])
            .args(["--remote-debugging-port=0", "--disable-renderer-backgrounding"])
            .args(["--disable-backgrounding-occluded-windows", "--enable-precise-memory-info"])
            .arg(format!("--user-data-dir={}", profile.display()))
            .arg("about:blank")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("it answered before");
        let mut lines = BufReader::new(child.stderr.take().expect("piped")).lines();
        let url = lines
            .find_map(|line| Some(line.ok()?.strip_prefix("DevTools listening on ")?.to_owned()))
            .expect("its address");
        // A full pipe would block it.
        std::thread::spawn(move || lines.count());
        let host = url.trim_start_matches("ws://").split('/').next().expect("a host");
        let stream = TcpStream::connect(host).expect("it listens");
        stream.set_read_timeout(Some(TIME_LIMIT)).expect("a socket");
        let (socket, _) = tungstenite::client(url.as_str(), stream).expect("a WebSocket");
        Self { child, profile, socket, next: 1, faults: Vec::new() }
    }

    fn call(&mut self, tab: Option<&Tab>, method: &str, params: Value) -> Value {
        let id = self.next;
        self.next += 1;
        let mut message = json!({"id": id, "method": method, "params": params});
        if let Some(Tab(session)) = tab {
            message["sessionId"] = session.as_str().into();
        }
        self.socket.send(Message::text(message.to_string())).expect("it reads");
        loop {
            let Message::Text(text) = self.socket.read().expect("an answer") else {
                continue;
            };
            let answer: Value = serde_json::from_str(&text).expect("JSON");
            if answer["id"] == id {
                assert!(answer["error"].is_null(), "{method}: {answer}");
                return answer["result"].clone();
            }
            let params = &answer["params"];
            match answer["method"].as_str() {
                Some("Runtime.exceptionThrown") => {
                    self.faults.push(params["exceptionDetails"].to_string())
                }
                Some("Log.entryAdded") if params["entry"]["level"] == "error" => {
                    self.faults.push(params["entry"]["text"].to_string());
                }
                _ => {}
            }
        }
    }

    /// Opens an address in a window of this width.
    pub fn open(&mut self, url: &str, width: u32, dark: bool) -> Tab {
        let target = self.call(
            None,
            "Target.createTarget",
            json!({"url": "about:blank", "newWindow": true}),
        );
        let attach = json!({"targetId": target["targetId"], "flatten": true});
        let attached = self.call(None, "Target.attachToTarget", attach);
        let tab = Tab(attached["sessionId"].as_str().expect("a session").to_owned());
        let phone = width < 600;
        let metrics = json!({"width": width, "height": if phone { 800 } else { 900 },
            "deviceScaleFactor": if phone { 2 } else { 1 }, "mobile": phone});
        self.call(Some(&tab), "Emulation.setDeviceMetricsOverride", metrics);
        let scheme = if dark { "dark" } else { "light" };
        let feature = json!({"features": [{"name": "prefers-color-scheme", "value": scheme}]});
        self.call(Some(&tab), "Emulation.setEmulatedMedia", feature);
        for domain in ["Runtime.enable", "Log.enable", "Page.enable"] {
            self.call(Some(&tab), domain, json!({}));
        }
        self.call(Some(&tab), "Page.navigate", json!({"url": url}));
        tab
    }

    /// The value of an expression.
    pub fn value(&mut self, tab: &Tab, expression: &str) -> Value {
        let params = json!({"expression": expression, "returnByValue": true, "awaitPromise": true});
        let found = self.call(Some(tab), "Runtime.evaluate", params);
        assert!(found["exceptionDetails"].is_null(), "{expression}: {found}");
        found["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    pub fn until(&mut self, tab: &Tab, expression: &str) {
        let end = Instant::now() + TIME_LIMIT;
        // A page that is being loaded has no names yet.
        let safe =
            format!("(() => {{ try {{ return !!({expression}) }} catch {{ return false }} }})()");
        while self.value(tab, &safe) != true {
            if Instant::now() > end {
                let page = self.value(tab, "document.body.innerText");
                panic!("{expression}: not in time; faults: {:?}; page: {page}", self.faults);
            }
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Clicks the visible button with this text.
    pub fn click(&mut self, tab: &Tab, label: &str) {
        let button = format!(
            "[...document.querySelectorAll('button')].find((b) => b.textContent === {label:?} && b.checkVisibility() && !b.disabled)"
        );
        self.until(tab, &button);
        self.value(tab, &format!("{button}.click()"));
    }

    /// Writes a picture of what is visible.
    pub fn picture(&mut self, tab: &Tab, file: &Path) {
        let params = json!({"format": "webp", "quality": 80});
        let found = self.call(Some(tab), "Page.captureScreenshot", params);
        let data = found["data"].as_str().expect("base 64");
        std::fs::write(file, data_encoding::BASE64.decode(data.as_bytes()).expect("base 64"))
            .expect("a file");
    }

    /// Bytes of the page's heap, after its garbage is collected.
    pub fn heap_bytes(&mut self, tab: &Tab) -> f64 {
        self.call(Some(tab), "HeapProfiler.collectGarbage", json!({}));
        let used = self.call(Some(tab), "Runtime.getHeapUsage", json!({}));
        let size = |key: &str| used[key].as_f64().unwrap_or(0.0);
        size("usedSize") + size("backingStorageSize")
    }
}

impl Drop for Browser {
    /// Its helper processes write to the profile a moment longer than it lives, which would keep the folder of the
    /// test from being removed.
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        let end = Instant::now() + TIME_LIMIT;
        while std::fs::remove_dir_all(&self.profile).is_err() && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

/// Drops a table of several pieces on the page.
const DROP: &str = "uploads([new File([
    'Time (s),Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g),\
     Gyroscope X (rad/s),Gyroscope Y (rad/s),Gyroscope Z (rad/s)\\n',
    Array.from({ length: 5000 }, (_, k) => `${k / 100},0.01,${k % 7 / 100},1,0,0,0.1`).join('\\n'),
], 'dropped.csv')])";

/// Chooses the spectrum of |f|.
const SPECTRUM: &str = "(() => {
    const of = document.querySelector('#view-live [aria-label=\"Spectrum of\"]');
    of.value = 3;
    of.dispatchEvent(new Event('change'));
})()";

/// The samples that the page has of its first board.
pub const COUNT: &str = "[...boards.values()][0].ring.count";

#[test]
#[ignore = "needs Chromium: cargo xtask test --only browser"]
fn a_person_calibrates_a_board_by_the_page_alone() {
    let folder = folder();
    let mut browser = Browser::start(folder.path());
    let store = folder.path().join("store");
    let fast = [&FAST[..], &["--store", store.to_str().unwrap()]].concat();
    let board = Simulator::start(&fast);
    let address = board.cable.trim_start_matches("tcp://").to_owned();
    let served = Served::start(folder.path(), &[]);
    let tab = browser.open(&served.url, 1200, false);
    browser.until(&tab, "document.body.innerText.includes('No board yet')");
    // The token is in neither the address nor the page.
    browser.until(&tab, "location.hash === ''");
    browser.value(&tab, &format!("document.getElementById('link').value = {:?}", board.cable));
    browser.click(&tab, "Connect");
    browser.until(&tab, &format!("{COUNT} > 100"));
    let picture = "document.querySelector('#view-live figure canvas').toDataURL()";
    let before = browser.value(&tab, picture);
    browser.until(&tab, &format!("{picture} !== {before}"));
    // A pause holds the picture.
    browser.click(&tab, "Pause");
    let held = browser.value(&tab, picture);
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(browser.value(&tab, picture), held);
    browser.click(&tab, "Go on");
    browser.until(&tab, &format!("{picture} !== {held}"));

    browser.click(&tab, "Calibrate");
    let begin = "document.querySelector('#view-calibrate .main')";
    browser.until(&tab, begin);
    browser.value(&tab, &format!("{begin}.click()"));
    browser.until(&tab, "document.body.innerText.includes('Calibrated. Push it to the board')");
    browser.click(&tab, "Push to the board");
    browser.until(&tab, "document.body.innerText.includes('Calibrated and pushed')");
    assert_eq!(wimu(&["device", "params", "get", &board.wireless]).succeeds()["calibrated"], true);

    // The board is killed and comes back.
    drop(board);
    browser.until(&tab, "document.body.innerText.includes('link lost')");
    let _again = Background::start(&[
        "simulate",
        "--cable",
        &address,
        "--wireless",
        "127.0.0.1:0",
        "--store",
        store.to_str().unwrap(),
    ])
    .after_a_line();
    browser.until(&tab, "!document.body.innerText.includes('link lost')");
    browser.until(&tab, &format!("{COUNT} > 100"));

    // A page that is loaded again has its token, the samples before, and the calibration.
    browser.value(&tab, "location.reload()");
    browser.until(&tab, &format!("{COUNT} > 100 && server.writes"));
    browser.until(&tab, "document.body.innerText.includes('calibrated')");

    // Settings are read and written.
    browser.value(&tab, "choose('settings')");
    let zupt = "document.querySelector('#view-settings [aria-label=\"zero-velocity updates\"]')";
    // They are shown once they are read.
    browser.until(&tab, "document.querySelector('#view-settings .main')?.disabled === false");
    assert_eq!(browser.value(&tab, &format!("{zupt}.value")), "on");
    browser.value(&tab, &format!("{zupt}.value = 'off'"));
    browser.click(&tab, "Write to the board");
    browser.until(&tab, "document.body.innerText.includes('written: the board holds')");
    assert_eq!(browser.value(&tab, &format!("{zupt}.value")), "off");

    // A dropped file is in the folder; its plots share the cursor, and a signal can be hidden.
    browser.value(&tab, DROP);
    browser.until(&tab, "document.querySelectorAll('#view-files figure canvas').length === 2");
    assert!(folder.path().join("dropped.csv").exists());
    let of_files = "WimuPlot.all.filter((plot) => plot.figure.closest('#view-files'))";
    let cursor = format!(
        "(([a, b]) => {{ a.hover(300, 100); return Math.abs(b.time - a.vx(300)) < 1; }})({of_files})"
    );
    assert_eq!(browser.value(&tab, &cursor), true);
    let hide = format!(
        "(([a]) => {{ a.legend.querySelector('button').click(); return a.series[0].off; }})({of_files})"
    );
    assert_eq!(browser.value(&tab, &hide), true);
    browser.value(&tab, "choose('live')");
    browser.value(&tab, SPECTRUM);
    browser.until(&tab, "document.querySelectorAll('#view-live figure').length === 2");
    let notice = "(say('x'), $('message').click(), $('message').textContent)";
    assert_eq!(browser.value(&tab, notice), "");

    // Two pages at once, one of them without the token.
    let bare = served.url.split('#').next().unwrap().to_owned();
    let other = browser.open(&bare, 360, true);
    browser.until(&other, &format!("{COUNT} > 100"));
    browser.until(&other, "document.body.innerText.includes('read only')");
    for page in [&tab, &other] {
        let count = browser.value(page, COUNT);
        browser.until(page, &format!("{COUNT} > {count}"));
    }
    for name in ["live", "space", "noise", "links", "calibrate", "parameters", "settings", "files"]
    {
        browser.value(&other, &format!("choose({name:?})"));
        browser.until(&other, &format!("!document.getElementById('view-{name}').hidden"));
        let wide = browser.value(&other, "document.documentElement.scrollWidth - innerWidth");
        assert!(wide.as_f64() <= Some(0.0), "{name}: {wide} px too wide for a phone");
        let unnamed = "[...document.querySelectorAll('button, input, select, canvas')].filter((e) => e.checkVisibility() && \
            !(e.textContent.trim() || e.ariaLabel || e.title || e.labels?.length)).length";
        assert_eq!(browser.value(&other, unnamed), 0, "{name}: every control has a name");
    }
    assert_eq!(browser.faults, Vec::<String>::new());
}
