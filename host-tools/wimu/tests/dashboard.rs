//! The dashboard by its WebSocket, without a browser: what pages get, may and may not.

mod bars;
mod browser;

use crate::kit;

use std::collections::{BTreeMap, VecDeque};
use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use kit::{Background, Simulator, folder, wimu};
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

const TIME_LIMIT: Duration = Duration::from_secs(120);
/// A hold every few hundred milliseconds.
const FAST: [&str; 4] = ["--motion", "twelve-poses,slide", "--speed", "8"];

/// A `wimu dashboard` on a free port.
pub struct Served {
    process: Background,
    /// `127.0.0.1:PORT`.
    host: String,
    token: String,
    url: String,
}

impl Served {
    pub fn start(folder: &Path, inputs: &[&str]) -> Self {
        let folder_text = folder.to_str().expect("UTF-8");
        let fixed = ["dashboard", "--port", "0", "--folder", folder_text];
        let mut process = Background::start_as(folder, &[&fixed[..], inputs].concat());
        let started: Value = serde_json::from_str(&process.line()).expect("JSON");
        let url = started["data"]["url"].as_str().expect("a URL").to_owned();
        let (host, token) =
            url.strip_prefix("http://").and_then(|u| u.split_once("/#")).expect("a URL");
        Self { host: host.to_owned(), token: token.to_owned(), process, url }
    }

    /// What a request is answered with.
    fn get(&self, head: &str) -> String {
        let mut stream = TcpStream::connect(&self.host).expect("it listens");
        write!(stream, "{head}\r\n\r\n").expect("it reads");
        let mut answer = String::new();
        let _ = stream.read_to_string(&mut answer);
        answer
    }

    /// A page of this origin; `None` if it is refused.
    fn socket(&self, origin: Option<&str>) -> Option<WebSocket<TcpStream>> {
        let stream = TcpStream::connect(&self.host).expect("it listens");
        stream.set_read_timeout(Some(TIME_LIMIT)).expect("a socket");
        let mut request =
            format!("ws://{}/socket", self.host).into_client_request().expect("a URL");
        if let Some(origin) = origin {
            request.headers_mut().insert("Origin", origin.parse().expect("ASCII"));
        }
        tungstenite::client(request, stream).ok().map(|(socket, _)| socket)
    }

    pub fn page(&self) -> Page {
        self.page_with(&self.token)
    }

    fn page_with(&self, token: &str) -> Page {
        let socket = self.socket(Some(&format!("http://{}", self.host))).expect("a page");
        let mut page = Page {
            socket,
            token: token.to_owned(),
            next: 1,
            topics: BTreeMap::new(),
            frames: Vec::new(),
            answers: BTreeMap::new(),
            closed: false,
        };
        page.send(json!({"do": "hello"}));
        page
    }
}

/// A page without a browser.
pub struct Page {
    socket: WebSocket<TcpStream>,
    token: String,
    next: u64,
    topics: BTreeMap<String, Value>,
    pub frames: Vec<Value>,
    answers: BTreeMap<u64, Value>,
    closed: bool,
}

impl Page {
    fn send(&mut self, mut message: Value) -> u64 {
        let id = self.next;
        self.next += 1;
        message["id"] = id.into();
        message["token"] = self.token.clone().into();
        if self.socket.send(Message::text(message.to_string())).is_err() {
            self.closed = true;
        }
        id
    }

    /// Asks, and returns the answer with its value or error.
    fn ask(&mut self, message: Value) -> Value {
        let id = self.send(message);
        self.until("an answer", |page| page.answers.remove(&id))
    }

    fn take(&mut self) {
        match self.socket.read() {
            Ok(Message::Text(text)) => {
                let message: Value = serde_json::from_str(&text).expect("JSON");
                if message["t"].is_array() {
                    self.frames.push(message);
                } else if let Some(id) = message["answer"].as_u64() {
                    self.answers.insert(id, message);
                } else if let Some(topic) = message["topic"].as_str() {
                    self.topics.insert(topic.to_owned(), message["value"].clone());
                } else if let Some(gone) = message["gone"].as_str() {
                    self.topics.retain(|topic, _| !topic.starts_with(gone));
                }
            }
            Ok(_) => {}
            Err(_) => self.closed = true,
        }
    }

    /// Takes messages until what is named is found.
    pub fn until<T>(&mut self, named: &str, mut found: impl FnMut(&mut Self) -> Option<T>) -> T {
        let until = Instant::now() + TIME_LIMIT;
        loop {
            if let Some(found) = found(self) {
                return found;
            }
            assert!(!self.closed, "{named}: the server has closed the page");
            assert!(Instant::now() < until, "{named}: not in time: {:?}", self.topics);
            self.take();
        }
    }

    fn topic(&mut self, name: &str, holds: impl Fn(&Value) -> bool) -> Value {
        self.until(name, |page| page.topics.get(name).filter(|value| holds(value)).cloned())
    }
}

#[test]
fn a_page_leads_from_a_board_to_a_pushed_calibration() {
    let board = Simulator::start(&FAST);
    let folder = folder();
    let served = Served::start(folder.path(), &[&board.wireless, &board.cable]);
    let mut page = served.page();
    // Two links of one board are one board.
    page.topic("board/0/state", |state| {
        state["links"].as_array().is_some_and(|links| links.len() == 2)
    });
    assert!(!page.topics.contains_key("board/1/state"));
    page.until("samples", |page| (page.frames.len() > 20).then_some(()));
    let frame = page.frames.last().expect("a frame").clone();
    assert_eq!(frame["v"].as_array().unwrap().len(), 4, "{frame}");
    let norm = frame["v"][3][0].as_f64().unwrap();
    assert!((5.0..15.0).contains(&norm), "{frame}");

    page.topic("board/0/parameters", |value| value["calibrated"] == false);
    assert_eq!(page.ask(json!({"do": "calibrate", "board": 0}))["value"], Value::Null);
    page.topic("board/0/guided", |view| {
        view["poses"].as_array().is_some_and(|poses| poses.len() >= 2)
    });
    page.topic("board/0/guided", |view| view["usable"] == true);
    let pushed = page.ask(json!({"do": "push", "board": 0}));
    assert!(pushed["value"].as_str().unwrap().starts_with("pushed "), "{pushed}");
    page.topic("board/0/parameters", |value| value["calibrated"] == true);
    page.topic("board/0/state", |state| state["line"]["corrected"] == true);
    // A file, its difference to itself, and a push of it.
    page.ask(json!({"do": "write_file", "board": 0}));
    let name = page.until("the calibration in the list", |page| {
        let files = page.topics.get("files")?.as_array()?;
        let mut names = files.iter().filter_map(|file| file["name"].as_str());
        let name = names.rfind(|name| name.ends_with(".json"))?;
        Some(name.to_owned())
    });
    let same = page.ask(json!({"do": "difference", "board": 0, "file": name}));
    let result = same["value"]["result"].as_str();
    assert!(result.is_some_and(|text| text.contains("already holds")), "{name}: {same}");
    let pushed = page.ask(json!({"do": "push_file", "board": 0, "file": name}));
    assert!(pushed["value"].as_str().unwrap().starts_with("pushed "), "{pushed}");
    page.ask(json!({"do": "end_calibration", "board": 0}));

    // A recording, its picture, and its replay.
    page.ask(json!({"do": "record", "board": 0}));
    page.topic("board/0/state", |state| state["recording"].is_string());
    thread::sleep(Duration::from_secs(1));
    page.ask(json!({"do": "record", "board": 0}));
    assert!(folder.path().join("wimu-1.mcap").exists());
    page.ask(json!({"do": "open", "file": "wimu-1.mcap"}));
    let shown = page.topic("file/wimu-1.mcap", |file| file["done"] == true);
    assert!(shown["error"].is_null() && !shown["charts"].as_array().unwrap().is_empty(), "{shown}");
    assert_eq!(page.ask(json!({"do": "play", "file": "wimu-1.mcap"}))["error"], Value::Null);
    page.topic("board/1/state", |state| {
        let replay = &state["replay"];
        replay["over"] == true || replay["position_s"].as_f64() > Some(0.0)
    });
    let refused = page.ask(json!({"do": "calibrate", "board": 1}));
    assert!(refused["error"].as_str().unwrap().contains("this is a recording"), "{refused}");

    // A board that is closed is gone.
    page.ask(json!({"do": "close", "board": 1}));
    page.until("it is gone", |page| (!page.topics.contains_key("board/1/state")).then_some(()));
    // The key of a device, its file and the token are in no message.
    let all = format!("{:?}", page.topics);
    assert!(!all.contains(&served.token) && !all.contains("keys/"));
    let id = page.topics["board/0/parameters"]["id"].clone();
    drop(served.process);
    let held = wimu(&["device", "params", "get", &board.cable]).succeeds();
    assert_eq!(held["parameter_id"], id);
}

#[test]
fn every_sample_of_a_link_without_loss_reaches_the_page() {
    let board = Simulator::start(&["--motion", "rest"]);
    let folder = folder();
    let served = Served::start(folder.path(), &[&board.cable]);
    let mut page = served.page();
    page.until("samples", |page| (page.frames.len() > 200).then_some(()));
    let mut times: Vec<f64> = Vec::new();
    for time in page.frames.iter().flat_map(|frame| frame["t"].as_array().expect("times")) {
        // A page that joins gets the latest ones again.
        let time = time.as_f64().expect("a time");
        if times.last().is_none_or(|last| *last < time) {
            times.push(time);
        }
    }
    let steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let least = steps.iter().copied().fold(f64::INFINITY, f64::min);
    let gaps = steps.iter().filter(|step| **step > 1.5 * least).count();
    assert!(times.len() > 200 && gaps == 0, "{gaps} gaps in {} samples", times.len());
}

#[test]
fn foreign_pages_and_forged_tokens_are_refused() {
    let board = Simulator::start(&["--motion", "rest"]);
    let folder = folder();
    let served = Served::start(folder.path(), &[&board.cable]);
    let host = &served.host;
    let page = served.get(&format!("GET / HTTP/1.1\r\nHost: {host}"));
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("default-src 'none'"), "{page}");
    assert!(!page.contains(&served.token));
    for (head, status) in [
        ("GET / HTTP/1.1\r\nHost: evil.example".to_owned(), "403"),
        (format!("GET /../../etc/passwd HTTP/1.1\r\nHost: {host}"), "404"),
        (format!("GET /socket HTTP/1.1\r\nHost: {host}"), "403"),
        (format!("POST / HTTP/1.1\r\nHost: {host}"), "405"),
        ("\u{0}\u{1}nonsense".to_owned(), "400"),
    ] {
        let answer = served.get(&head);
        assert!(answer.starts_with(&format!("HTTP/1.1 {status}")), "{head}: {answer}");
    }
    for origin in [None, Some("http://evil.example"), Some("null")] {
        assert!(served.socket(origin).is_none(), "{origin:?}");
    }

    // Without a token a page reads and writes nothing; with a forged one it is closed.
    let mut reader = served.page_with("");
    reader.topic("board/0/state", |_| true);
    for message in [
        json!({"do": "calibrate", "board": 0}),
        json!({"do": "connect", "link": "tcp://127.0.0.1:1"}),
        json!({"do": "open", "file": "x.csv"}),
    ] {
        let refused = reader.ask(message);
        assert!(refused["error"].as_str().unwrap().contains("may only read"), "{refused}");
    }
    let mut forged = served.page_with(&"0".repeat(32));
    while !forged.closed {
        forged.take();
    }
    assert!(forged.topics.is_empty() && forged.frames.is_empty());
}

/// A request comes a moment after its connection, and a thousand connections between them.
#[test]
fn a_burst_of_connections_closes_no_request() {
    let folder = folder();
    let served = Served::start(folder.path(), &[]);
    let host = &served.host;
    let mut owner = TcpStream::connect(host).expect("it listens");
    let _burst: Vec<_> = (0..1000).filter_map(|_| TcpStream::connect(host).ok()).collect();
    thread::sleep(Duration::from_millis(200));
    write!(owner, "GET / HTTP/1.1\r\nHost: {host}\r\n\r\n").expect("it reads");
    let mut answer = String::new();
    owner.read_to_string(&mut answer).expect("an answer");
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
}

/// 64 connections that send a byte of a head at a time, 1,000 that send nothing, WebSockets without a token, and a page of
/// another site that posts without end.
#[test]
fn strangers_do_not_lock_the_owner_out() {
    let folder = folder();
    let served = Served::start(folder.path(), &[]);
    let host = served.host.clone();
    let ended = Arc::new(AtomicBool::new(false));
    let attack = |attack: fn(&str, &AtomicBool)| {
        let (host, ended) = (host.clone(), ended.clone());
        thread::spawn(move || attack(&host, &ended))
    };
    let slow = |host: &str, ended: &AtomicBool| {
        let mut all: Vec<Option<TcpStream>> = (0..64).map(|_| None).collect();
        while !ended.load(Ordering::Relaxed) {
            for one in &mut all {
                if one.as_mut().is_none_or(|stream| stream.write_all(b"G").is_err()) {
                    *one = TcpStream::connect(host).ok();
                }
            }
            thread::sleep(Duration::from_millis(50));
        }
    };
    let idle = |host: &str, ended: &AtomicBool| {
        let mut all = VecDeque::new();
        while !ended.load(Ordering::Relaxed) {
            all.extend(TcpStream::connect(host));
            if all.len() >= 1000 {
                all.pop_front();
                thread::sleep(Duration::from_millis(10));
            }
        }
    };
    let hostile = |host: &str, ended: &AtomicBool| {
        let mut all = VecDeque::new();
        while !ended.load(Ordering::Relaxed) {
            if let Ok(mut stream) = TcpStream::connect(host) {
                // The body never comes.
                let head = "POST / HTTP/1.1\r\nHost: 127.0.0.1:1\r\nOrigin: http://evil.example\r\nContent-Length: 9\r\n\r\n";
                let _ = stream.write_all(head.as_bytes());
                all.push_back(stream);
            }
            if all.len() > 64 {
                all.pop_front();
            }
            thread::sleep(Duration::from_millis(5));
        }
    };
    let attackers = [attack(slow), attack(idle), attack(hostile)];
    let silent: Vec<_> = (0..64)
        .map(|_| served.socket(Some(&format!("http://{host}"))).expect("a socket"))
        .collect();
    thread::sleep(Duration::from_secs(2));
    let mut first = served.page();
    first.topic("about", |_| true);
    for attempt in 0..25 {
        for path in ["/", "/style.css", "/plot.js", "/dashboard.js"] {
            let answer = served.get(&format!("GET {path} HTTP/1.1\r\nHost: {host}"));
            assert!(answer.starts_with("HTTP/1.1 200"), "{attempt}: {path}: {answer}");
        }
        let mut page = served.page();
        page.topic("about", |_| true);
        assert!(page.ask(json!({"do": "ports"}))["error"].is_null(), "{attempt}");
    }
    // The place of the first page was reserved meanwhile.
    assert!(first.ask(json!({"do": "ports"}))["error"].is_null());
    ended.store(true, Ordering::Relaxed);
    for attacker in attackers {
        attacker.join().expect("no panic");
    }
    drop(silent);
    // A socket without a first message is closed.
    let mut silent = served.socket(Some(&format!("http://{host}"))).expect("a socket");
    let began = Instant::now();
    while silent.read().is_ok() {}
    assert!(began.elapsed() < Duration::from_secs(20), "{:?}", began.elapsed());
}

#[test]
fn bad_requests_and_files_get_a_reason() {
    let folder = folder();
    fs::write(folder.path().join("empty.csv"), "").unwrap();
    fs::write(folder.path().join("cut.mcap"), "\u{89}MCAP0\r\n").unwrap();
    fs::write(folder.path().join("wrong.json"), "{}").unwrap();
    let served = Served::start(folder.path(), &[]);
    let mut page = served.page();
    for message in [
        json!({"do": "open", "file": "../secret.csv"}),
        json!({"do": "open", "file": "/etc/passwd"}),
        json!({"do": "upload", "file": "../x.csv", "at": 0, "data": "", "last": true}),
        json!({"do": "play", "file": "cut.mcap"}),
        json!({"do": "play", "file": "no.mcap"}),
        json!({"do": "connect", "link": "ftp://x"}),
        json!({"do": "nonsense"}),
        json!({"do": "calibrate", "board": 7}),
        json!({"do": "push_file", "board": 0, "file": "wrong.json"}),
        json!({}),
    ] {
        let refused = page.ask(message.clone());
        let reason = refused["error"].as_str();
        assert!(reason.is_some_and(|reason| reason.contains("; ")), "{message}: {refused}");
    }
    page.socket.send(Message::text("no JSON")).unwrap();
    page.socket.send(Message::text("[".repeat(60_000))).unwrap();
    page.ask(json!({"do": "open", "file": "empty.csv"}));
    let shown = page.topic("file/empty.csv", |file| file["done"] == true);
    assert!(shown["error"].as_str().unwrap().contains("empty"), "{shown}");
    // A link that does not answer is named, and tried again.
    page.ask(json!({"do": "connect", "link": "tcp://127.0.0.1:1"}));
    page.topic("link/tcp://127.0.0.1:1", |link| link["error"].is_string());
}

/// A board of which 10 MB/s of empty frames arrive between its own.
fn flooded(board: &str) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address");
    let board = board.trim_start_matches("tcp://").to_owned();
    thread::spawn(move || {
        for host in listener.incoming().flatten() {
            let Ok(device) = TcpStream::connect(&board) else {
                continue;
            };
            let (mut up, mut down) = (host.try_clone().unwrap(), device.try_clone().unwrap());
            thread::spawn(move || std::io::copy(&mut up, &mut down));
            thread::spawn(move || flood(device, host));
        }
    });
    format!("tcp://{address}")
}

fn flood(mut device: TcpStream, mut host: TcpStream) {
    let mut frame = Vec::new();
    let mut buffer = [0; 4096];
    let began = Instant::now();
    let mut sent = 0;
    while let Ok(count @ 1..) = device.read(&mut buffer) {
        frame.extend(&buffer[..count]);
        let Some(end) = frame.iter().rposition(|byte| *byte == 0) else {
            continue;
        };
        let rest = frame.split_off(end + 1);
        let due = (began.elapsed().as_secs_f64() * 10e6) as usize;
        frame.resize(frame.len() + due.saturating_sub(sent), 0);
        sent = due;
        if host.write_all(&std::mem::replace(&mut frame, rest)).is_err() {
            return;
        }
    }
}

#[test]
fn a_flooded_link_still_shows_its_samples() {
    let board = Simulator::start(&["--motion", "rest"]);
    let folder = folder();
    let served = Served::start(folder.path(), &[&flooded(&board.cable)]);
    let mut page = served.page();
    page.topic("board/0/state", |state| state["links"][0]["kilobytes_s"].as_f64() > Some(200.0));
    page.frames.clear();
    page.until("samples", |page| (page.frames.len() > 30).then_some(()));
}
